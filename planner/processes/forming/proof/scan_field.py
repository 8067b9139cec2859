"""Shifts of the next part from a scan of a formed part, calculated by the proof's own code.

The planner measures along normals, at the nearest points of the face. Here heights are compared: a point of
the scan minus the part's face at the same point in plan, and the median of these in plan around a point. On a
plane wall both give the same along z. The position of the scan is checked by its flat and its marks.
"""

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, Mesh
from planner.processes.forming.proof import springback_bounds
from planner.processes.forming.proof.formed_shapes import PlanLookup
from planner.processes.forming.proof.springback_file import ScanData
from planner.proof.part_files.meshes import read_points

MAX_SCAN_POINTS = 300_000
"""Maximum number of points of a scan. Larger scans are decimated."""
MAX_HEIGHT_M = 0.03
"""Points farther than this [m] above or below the face do not belong to the part."""
NEIGHBOUR_RADIUS_M = 2e-3
"""Radius [m] in plan of the points that determine the height of the part at a point."""
MAX_NEIGHBOURS = 41
"""Maximum number of these points, the nearest ones."""
FEW_NEIGHBOURS = 9
"""Number of the nearest of them for the median of the nearest few."""
MIN_NEIGHBOURS = 5
"""Minimum number of points at a known point."""
MAX_SPREAD_FACTOR, SPREAD_OFFSET_M = 5.0, 2e-4
"""Points whose neighbours are spread by more than this factor of the usual spread plus ``SPREAD_OFFSET_M``
[m] are not known: they are stray.
"""
PLANE_FIT_ROUNDS, INLIER_FACTOR = 3, 4.0
"""Rounds of the fit of a plane, and factor of the median deviation up to which points are used."""
MIN_PLANE_POINTS, PLANE_REGULARISATION_M = 12, 5e-5
"""Minimum number of points for an inclined plane, and spread [m] below which it is level."""
WALL_LENGTH_M, SLOPE_STEP_M = 2.5e-3, 5e-4
"""Length [m] along a wall over which its rise is evaluated, and distance [m] of the points that determine its
direction.
"""
EDGE_DISTANCE_M, MIN_EDGE_SLOPE_CHANGE = 1e-3, 0.25
"""Distance [m] within which edges are detected, and the change of the slope that makes an edge."""
MIN_RISE_M, FORMED_FRACTION_RANGE = 5e-4, (0.1, 4.0)
"""Minimum rise [m], and minimum and maximum fraction of it that counts as formed at once."""
MAX_FLAT_DEVIATION_M = 1e-4
"""Maximum distance [m] of the flat of a scan from that of the sheet, in each of its corners."""
FLAT_BAND_M = 1.5e-3
"""Points within this distance [m] of the flat belong to it."""
MIN_FLAT_POINTS = 30
"""Minimum number of points of the flat in a corner that is checked; at least one corner must have them."""
RIM_WIDTH_M = 0.01
"""Width [m] around the part in which the sheet may not be flat."""
MAX_MARK_EXCESS_M = 5e-5
"""Maximum excess [m] of the mean deviation of marks over the best possible fit."""
MAX_UNMARKED_SHIFT_M, MAX_UNMARKED_ROTATION_RAD = 1e-4, 1e-3
"""Tolerances [m] and [rad] within which a scan without marks must keep its position in the sheet's plane."""


def read_scan(path: Path, scan: ScanData) -> FloatArray:
    """Return the points (N, 3) [m] of a scan in the sheet's frame.

    Raises:
        ValueError: the fault of the scan.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"its scan cannot be read ({error.strerror})") from None
    if hashlib.sha256(data).hexdigest() != scan.digest:
        raise ValueError("its scan is not the file from which it was made")
    points = read_points(path)
    points = points[np.isfinite(points).all(axis=1)]
    points = points[:: max(1, len(points) // MAX_SCAN_POINTS)] * scan.unit
    return np.asarray(points @ scan.pose[:3, :3].T + scan.pose[:3, 3])


class ScanField:
    """Height of a scan above the part.

    Args:
        mesh: Lower face [m] of the part.
        size: Size (3,) [m] of the sheet.
        top: Whether the scan is of the top or the bottom.
        points: Points (N, 3) [m] in the sheet's frame.
    """

    def __init__(self, mesh: Mesh, size: FloatArray, top: bool, points: FloatArray) -> None:
        self._level = float(size[2]) if top else 0.0
        self._size, self._points, self._mesh = size, points, mesh
        corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)] + np.array([0.0, 0.0, self._level])
        self._over, self._corners = PlanLookup(corners), corners
        row, triangle, weight = self._over.locate(points[:, :2], 0.0)
        row, first = np.unique(row, return_index=True)
        z = (weight[first] * corners[triangle[first], :, 2]).sum(axis=1)
        up = points[row, 2] - z
        belongs_to_part = np.abs(up) <= MAX_HEIGHT_M
        self._plan, self._up = cKDTree(points[row[belongs_to_part], :2]), up[belongs_to_part]

    def part_height(self, points: FloatArray) -> FloatArray:
        """Return the heights (P,) [m] of the part itself at points (P, 2) [m] in plan, NaN beside it."""
        out = np.full(len(points), np.nan)
        row, triangle, weight = self._over.locate(points, 1e-6)
        out[row] = (weight * self._corners[triangle, :, 2]).sum(axis=1)
        return out - self._level

    def scan_height(self, points: FloatArray) -> FloatArray:
        """Return how far (2, P) [m] the scan is above the part along z at points (P, 2) [m] in plan.

        By a plane through the nearest points, and by the median of the nearest few; NaN where the scan has
        too few points.
        """
        if not len(self._up) or not len(points):
            return np.full((2, len(points)), np.nan)
        count = min(MAX_NEIGHBOURS, len(self._up))
        _, neighbours = self._plan.query(
            points, k=[*range(1, count + 1)], distance_upper_bound=NEIGHBOUR_RADIUS_M
        )
        exists = neighbours < len(self._up)
        neighbours = np.minimum(neighbours, len(self._up) - 1)
        value = np.where(exists, self._up[neighbours], np.nan)
        offset = np.asarray(self._plan.data)[neighbours] - points[:, None]
        out, spread = np.full((2, len(points)), np.nan), np.full(len(points), np.inf)
        known = np.flatnonzero(exists.sum(axis=1) >= MIN_NEIGHBOURS)
        rest = value[known] - _plane_heights(offset[known], value[known])
        out[:, known] = np.nanmedian(rest, axis=1), np.nanmedian(value[known, :FEW_NEIGHBOURS], axis=1)
        spread[known] = np.nanmedian(np.abs(rest - out[0, known, None]), axis=1)
        out[:, spread > MAX_SPREAD_FACTOR * float(np.median(spread)) + SPREAD_OFFSET_M] = np.nan
        return out

    def uphill_direction(self, points: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return the direction in which the part goes up at points (P, 2) [m] in plan.

        Returns:
            Unit directions (P, 2), slopes (P,), and whether (P,) the part has an edge within
                `EDGE_DISTANCE_M`.
        """
        height, gradient, has_edge = (
            self.part_height(points),
            np.empty((len(points), 2)),
            np.zeros(len(points), dtype=bool),
        )
        for axis in range(2):
            for reach in (SLOPE_STEP_M, EDGE_DISTANCE_M):
                step = reach * np.eye(2)[axis]
                upper, lower = (self.part_height(points + sign * step) for sign in (1.0, -1.0))
                # outside of the part the sheet is flat
                upper, lower = (np.where(np.isfinite(heights), heights, height) for heights in (upper, lower))
                if reach == SLOPE_STEP_M:
                    gradient[:, axis] = np.nan_to_num(upper - lower) / (2.0 * reach)
                else:
                    has_edge |= np.abs(upper + lower - 2.0 * height) > MIN_EDGE_SLOPE_CHANGE * EDGE_DISTANCE_M
        steep = np.sqrt((gradient * gradient).sum(axis=1))
        return gradient / np.maximum(steep, 1e-9)[:, None], steep, has_edge

    def deviation(self, points: FloatArray, side: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the deviation of the scan on a side at points (P, 2) [m] in plan.

        Returns:
            Minimum and maximum deviation (2, P) [m]; how much more (P,) [m] it is than at `WALL_LENGTH_M`
                along the part
            up the wall, away from the direction of the tool; and how much (P,) [m] higher the wall is there.
        """
        direction, steep, has_edge = self.uphill_direction(points)
        heights = side * self.scan_height(points)
        bounds = [heights.min(axis=0), heights.max(axis=0)]
        for sign in (1.0, -1.0):
            # an edge of the part is an edge of the field, whose position is known as well as points are
            edge_heights = side * self.scan_height(
                points[has_edge] + sign * EDGE_DISTANCE_M * direction[has_edge]
            )
            bounds[0][has_edge] = np.fmin(bounds[0][has_edge], edge_heights.min(axis=0))
            bounds[1][has_edge] = np.fmax(bounds[1][has_edge], edge_heights.max(axis=0))
        up_points = points + side * (WALL_LENGTH_M / np.sqrt(1.0 + steep * steep))[:, None] * direction
        rise = side * (self.part_height(up_points) - self.part_height(points))
        return np.array(bounds), heights[0] - side * self.scan_height(up_points)[0], rise

    def flat_deviation(self) -> tuple[float, int]:
        """Return the distance [m] of the scan's flat from the sheet's in its worst corner.

        Returns:
            The distance and the number of corners with a flat.
        """
        vertices = np.asarray(self._mesh.vertices)[:, :2]
        formed = shapely.convex_hull(shapely.multipoints(vertices)).buffer(RIM_WIDTH_M)
        shapely.prepare(formed)
        deviation = self._points[:, 2] - self._level
        inside = (np.abs(self._points[:, :2]) <= 0.5 * self._size[:2]).all(axis=1)
        flat = np.flatnonzero(inside & (np.abs(deviation) <= FLAT_BAND_M))
        flat = flat[~shapely.contains_xy(formed, self._points[flat, 0], self._points[flat, 1])]
        corner = 2 * (self._points[flat, 0] > 0.0) + (self._points[flat, 1] > 0.0)
        corner_medians = [
            float(np.median(deviation[flat[corner == k]]))
            for k in range(4)
            if (corner == k).sum() >= MIN_FLAT_POINTS
        ]
        return max(map(abs, corner_medians), default=np.inf), len(corner_medians)


def _plane_heights(offset: FloatArray, value: FloatArray) -> FloatArray:
    """How much higher a plane through ``value`` is at each ``offset`` than in the middle.

    ``value`` (P, K) is NaN where missing, ``offset`` is (P, K, 2) [m]. Least squares of the values that do
    not deviate much; with few values the plane is level.
    """
    exists = np.isfinite(value)
    gradient = np.zeros((len(value), 2))
    for _ in range(PLANE_FIT_ROUNDS):
        rest = value - (offset * gradient[:, None]).sum(axis=2)
        rest = np.abs(rest - np.nanmedian(rest, axis=1)[:, None])
        is_inlier = exists & (rest <= INLIER_FACTOR * np.nanmedian(rest, axis=1)[:, None])
        weight = is_inlier / is_inlier.sum(axis=1)[:, None]
        centred = offset - (weight[..., None] * offset).sum(axis=1)[:, None]
        high = np.where(is_inlier, value, 0.0)
        square = np.einsum("pk,pki,pkj->pij", weight, centred, centred) + PLANE_REGULARISATION_M**2 * np.eye(
            2
        )
        moment = np.einsum("pk,pki,pk->pi", weight, centred, high)
        gradient = np.linalg.solve(square, moment[..., None])[..., 0]
    gradient[exists.sum(axis=1) < MIN_PLANE_POINTS] = 0.0
    return np.asarray((offset * gradient[:, None]).sum(axis=2))


def mark_excess(scan: ScanData) -> float:
    """Return how much [m] the mean deviation of marks exceeds the best fit.

    Without marks: how far the scan is moved or rotated in the sheet's plane, relative to what is allowed, in
    the same measure.
    """
    if not len(scan.marks[0]):
        shift_ratio = float(np.abs(scan.pose[:2, 3]).max()) / MAX_UNMARKED_SHIFT_M
        rotation_ratio = abs(float(np.arctan2(scan.pose[1, 0], scan.pose[0, 0]))) / MAX_UNMARKED_ROTATION_RAD
        return MAX_MARK_EXCESS_M * max(shift_ratio, rotation_ratio)
    sheet_marks, scan_marks = scan.marks
    stated = _rms_distance(sheet_marks, scan_marks @ scan.pose[:3, :3].T + scan.pose[:3, 3])
    middle = sheet_marks.mean(axis=0), scan_marks.mean(axis=0)
    u, _, v = np.linalg.svd((scan_marks - middle[1]).T @ (sheet_marks - middle[0]))  # Kabsch 1976
    sign = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ v)))])
    best = (scan_marks - middle[1]) @ u @ sign @ v + middle[0]
    return stated - _rms_distance(sheet_marks, best)


def _rms_distance(a: FloatArray, b: FloatArray) -> float:
    return float(np.sqrt(((a - b) ** 2).sum(axis=1).mean()))


@dataclasses.dataclass(frozen=True)
class ShiftProfile:
    """Shifts along a path.

    Attributes:
        arc: Arc lengths (K,) [m].
        shift: Shifts (K,) [m] at them.
    """

    arc: FloatArray
    shift: FloatArray


@dataclasses.dataclass(frozen=True)
class TouchedPath:
    """Points at which a ball touches the face along its path.

    Attributes:
        plan: Touched points (P, 2) [m] in plan.
        arc: Arc lengths (P,) [m] of the path at them.
        side: +1 if the ball is above the face, -1 below.
        radius: Radius [m] of the ball.
    """

    plan: FloatArray
    arc: FloatArray
    side: int
    radius: float


def shift_bounds(
    field: ScanField, scan: ScanData, previous: ShiftProfile, path: TouchedPath, slope: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return bounds of the shifts of a pass by a scan and the file's gain.

    Args:
        field: Field of the scan.
        scan: Scan data of the file.
        previous: Shifts of the scanned part along its path.
        path: Path of the ball, P points.
        slope: Maximum slope of the shifts.

    Returns:
        Minimum and maximum shift (P,) [m], and the fraction of the path that the scan covers.
    """
    arc, radius = path.arc, path.radius
    deviation, difference, wall_rise = field.deviation(path.plan, path.side)
    seen = np.isfinite(deviation).all(axis=0)
    fraction = float(seen.mean())
    if not seen.any():
        return np.full(len(arc), np.nan), np.full(len(arc), np.nan), fraction
    previous_shift, factor = np.interp(arc, previous.arc, previous.shift), np.zeros(len(arc))
    known = np.isfinite(difference) & np.isfinite(wall_rise)
    if known.any():
        formed_fraction = np.interp(
            arc, arc[known], (1.0 - difference / np.maximum(wall_rise, MIN_RISE_M))[known]
        )
        # S ~ F^0.55, F ~ h^0.09, h ~ step^2: springback where all of the step is formed
        factor = np.clip(formed_fraction, *FORMED_FRACTION_RANGE) ** -(0.55 * 0.09 * 2.0) - 1.0
    ends = []
    for bound in deviation:
        springback = np.interp(arc, arc[seen], bound[seen])
        springback += np.maximum(previous_shift + springback, 0.0) * factor
        required = previous_shift + scan.gain * springback_bounds.moving_mean(arc, springback, radius)
        limited = springback_bounds.limit_slope(arc, np.maximum(required, 0.0), slope)
        ends.append(springback_bounds.moving_mean(arc, limited, radius))
    return ends[0], ends[1], fraction
