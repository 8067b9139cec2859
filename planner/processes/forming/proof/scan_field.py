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
"""Minimum number of neighbours at a point for which a height is calculated."""
MAX_SPREAD_FACTOR, SPREAD_OFFSET_M = 5.0, 2e-4
"""A point has no height if its neighbours are spread by more than this multiple of the usual spread plus
``SPREAD_OFFSET_M`` [m], because some of them are outliers.
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
        ValueError: If the scan cannot be read, or is not the one from which the adjustments were made.
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
    """Height of a scan above the scanned face of the part, as a function of the position in plan.

    Args:
        mesh: Lower face [m] of the part.
        size: Size (3,) [m] of the sheet.
        top: Whether the scan is of the top face of the sheet, otherwise of the bottom face.
        points: Points (N, 3) [m] of the scan in the sheet's frame.
    """

    def __init__(self, mesh: Mesh, size: FloatArray, top: bool, points: FloatArray) -> None:
        self._level = float(size[2]) if top else 0.0
        self._size, self._points, self._mesh = size, points, mesh
        corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)] + np.array([0.0, 0.0, self._level])
        self._lookup, self._corners = PlanLookup(corners), corners
        row, triangle, weight = self._lookup.locate(points[:, :2], 0.0)
        row, first = np.unique(row, return_index=True)
        face_height = (weight[first] * corners[triangle[first], :, 2]).sum(axis=1)
        scan_height = points[row, 2] - face_height
        belongs_to_part = np.abs(scan_height) <= MAX_HEIGHT_M
        self._plan_tree = cKDTree(points[row[belongs_to_part], :2])
        self._scan_height = scan_height[belongs_to_part]

    def part_height(self, points: FloatArray) -> FloatArray:
        """Return heights (P,) [m] of the part above its flat at points (P, 2) [m] in plan, NaN outside."""
        out = np.full(len(points), np.nan)
        row, triangle, weight = self._lookup.locate(points, 1e-6)
        out[row] = (weight * self._corners[triangle, :, 2]).sum(axis=1)
        return out - self._level

    def scan_height(self, points: FloatArray) -> FloatArray:
        """Return how far (2, P) [m] the scan is above the part along z at points (P, 2) [m] in plan.

        The first row follows from a plane through the nearest points of the scan, the second one is the
        median of the nearest few. Both are NaN where the scan has too few points, or outliers.
        """
        if not len(self._scan_height) or not len(points):
            return np.full((2, len(points)), np.nan)
        count = min(MAX_NEIGHBOURS, len(self._scan_height))
        _, neighbours = self._plan_tree.query(
            points, k=[*range(1, count + 1)], distance_upper_bound=NEIGHBOUR_RADIUS_M
        )
        exists = neighbours < len(self._scan_height)  # the tree returns its size for missing neighbours
        neighbours = np.minimum(neighbours, len(self._scan_height) - 1)
        value = np.where(exists, self._scan_height[neighbours], np.nan)
        offset = np.asarray(self._plan_tree.data)[neighbours] - points[:, None]
        out, spread = np.full((2, len(points)), np.nan), np.full(len(points), np.inf)
        covered = np.flatnonzero(exists.sum(axis=1) >= MIN_NEIGHBOURS)
        rest = value[covered] - _plane_heights(offset[covered], value[covered])
        out[:, covered] = np.nanmedian(rest, axis=1), np.nanmedian(value[covered, :FEW_NEIGHBOURS], axis=1)
        spread[covered] = np.nanmedian(np.abs(rest - out[0, covered, None]), axis=1)
        out[:, spread > MAX_SPREAD_FACTOR * float(np.median(spread)) + SPREAD_OFFSET_M] = np.nan
        return out

    def uphill_direction(self, points: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return the direction in which the part goes up at points (P, 2) [m] in plan.

        Returns:
            Unit directions (P, 2) in plan, slopes (P,), and whether (P,) the part has an edge within
            `EDGE_DISTANCE_M`.
        """
        height = self.part_height(points)
        gradient = np.empty((len(points), 2))
        has_edge = np.zeros(len(points), dtype=bool)
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
        slope = np.sqrt((gradient * gradient).sum(axis=1))
        return gradient / np.maximum(slope, 1e-9)[:, None], slope, has_edge

    def deviation(self, points: FloatArray, side: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the deviation of the scan from the part at points in plan, positive toward the tool.

        It is compared with the deviation at a second point, `WALL_LENGTH_M` along the wall toward the tool.

        Args:
            points: Points (P, 2) [m] in plan.
            side: +1 if the forming tool is above the sheet, -1 below.

        Returns:
            Minimum and maximum deviation (2, P) [m]; how much (P,) [m] larger the deviation is than at the
            second point; and how much (P,) [m] farther toward the tool the part is at the second point.
        """
        direction, slope, has_edge = self.uphill_direction(points)
        heights = side * self.scan_height(points)
        bounds = [heights.min(axis=0), heights.max(axis=0)]
        for sign in (1.0, -1.0):
            # near an edge of the part the scan has an edge, too, whose position is only as exact as its
            # points
            edge_heights = side * self.scan_height(
                points[has_edge] + sign * EDGE_DISTANCE_M * direction[has_edge]
            )
            bounds[0][has_edge] = np.fmin(bounds[0][has_edge], edge_heights.min(axis=0))
            bounds[1][has_edge] = np.fmax(bounds[1][has_edge], edge_heights.max(axis=0))
        up_points = points + side * (WALL_LENGTH_M / np.sqrt(1.0 + slope * slope))[:, None] * direction
        rise = side * (self.part_height(up_points) - self.part_height(points))
        return np.array(bounds), heights[0] - side * self.scan_height(up_points)[0], rise

    def flat_deviation(self) -> tuple[float, int]:
        """Return the height difference [m] of the flats of scan and sheet in the worst of four corners.

        Returns:
            The maximum absolute difference, infinite if no corner has enough points, and the number of
            corners that have enough.
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
    """Return the heights (P, K) [m] of planes through the neighbours of P points.

    They are relative to the plane at the point itself. The planes are least squares fits to the values that
    do not deviate much. With few values they are level.

    Args:
        offset: Vectors (P, K, 2) [m] in plan from the points to their neighbours.
        value: Values (P, K) [m] at the neighbours, NaN where missing.
    """
    exists = np.isfinite(value)
    gradient = np.zeros((len(value), 2))
    for _ in range(PLANE_FIT_ROUNDS):
        rest = value - (offset * gradient[:, None]).sum(axis=2)
        rest = np.abs(rest - np.nanmedian(rest, axis=1)[:, None])
        is_inlier = exists & (rest <= INLIER_FACTOR * np.nanmedian(rest, axis=1)[:, None])
        weight = is_inlier / is_inlier.sum(axis=1)[:, None]
        centred = offset - (weight[..., None] * offset).sum(axis=1)[:, None]
        inlier_value = np.where(is_inlier, value, 0.0)
        covariance = np.einsum(
            "pk,pki,pkj->pij", weight, centred, centred
        ) + PLANE_REGULARISATION_M**2 * np.eye(2)
        moment = np.einsum("pk,pki,pk->pi", weight, centred, inlier_value)
        gradient = np.linalg.solve(covariance, moment[..., None])[..., 0]
    gradient[exists.sum(axis=1) < MIN_PLANE_POINTS] = 0.0
    return np.asarray((offset * gradient[:, None]).sum(axis=2))


def mark_excess(scan: ScanData) -> float:
    """Return how much [m] the root mean square deviation of marks in the stated pose exceeds the best fit.

    Without marks it is how far the scan is moved or rotated in the sheet's plane as a multiple of what is
    allowed, times `MAX_MARK_EXCESS_M`, so that the same limit applies.
    """
    if not len(scan.marks[0]):
        shift_ratio = float(np.abs(scan.pose[:2, 3]).max()) / MAX_UNMARKED_SHIFT_M
        rotation_ratio = abs(float(np.arctan2(scan.pose[1, 0], scan.pose[0, 0]))) / MAX_UNMARKED_ROTATION_RAD
        return MAX_MARK_EXCESS_M * max(shift_ratio, rotation_ratio)
    sheet_marks, scan_marks = scan.marks
    stated = _rms_distance(sheet_marks, scan_marks @ scan.pose[:3, :3].T + scan.pose[:3, 3])
    sheet_middle, scan_middle = sheet_marks.mean(axis=0), scan_marks.mean(axis=0)
    u, _, v = np.linalg.svd((scan_marks - scan_middle).T @ (sheet_marks - sheet_middle))  # Kabsch 1976
    sign = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ v)))])  # a rotation, not a reflection
    best = (scan_marks - scan_middle) @ u @ sign @ v + sheet_middle
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
    """Return bounds of the shifts of a pass that follow from a scan of the last part and the file's gain.

    The required shift is that of the scanned part plus the gain times the scan's deviation, averaged along
    the path and limited in slope.

    Args:
        field: Field of the scan.
        scan: Scan data of the file.
        previous: Shifts with which the scanned part was formed.
        path: Points (P) of the ball's path.
        slope: Maximum slope of the shifts.

    Returns:
        Minimum and maximum shift (P,) [m], NaN if the scan covers no point of the path, and the fraction of
        the path that the scan covers.
    """
    arc, radius = path.arc, path.radius
    deviation, difference, wall_rise = field.deviation(path.plan, path.side)
    is_scanned = np.isfinite(deviation).all(axis=0)
    fraction = float(is_scanned.mean())
    if not is_scanned.any():
        return np.full(len(arc), np.nan), np.full(len(arc), np.nan), fraction
    previous_shift, factor = np.interp(arc, previous.arc, previous.shift), np.zeros(len(arc))
    has_difference = np.isfinite(difference) & np.isfinite(wall_rise)
    if has_difference.any():
        formed_fraction = np.interp(
            arc, arc[has_difference], (1.0 - difference / np.maximum(wall_rise, MIN_RISE_M))[has_difference]
        )
        # S ~ F^0.55, F ~ h^0.09, h ~ step^2: springback where all of the step is formed
        factor = np.clip(formed_fraction, *FORMED_FRACTION_RANGE) ** -(0.55 * 0.09 * 2.0) - 1.0
    bounds = []
    for bound in deviation:
        springback = np.interp(arc, arc[is_scanned], bound[is_scanned])
        springback += np.maximum(previous_shift + springback, 0.0) * factor
        required = previous_shift + scan.gain * springback_bounds.moving_mean(arc, springback, radius)
        limited = springback_bounds.limit_slope(arc, np.maximum(required, 0.0), slope)
        bounds.append(springback_bounds.moving_mean(arc, limited, radius))
    return bounds[0], bounds[1], fraction
