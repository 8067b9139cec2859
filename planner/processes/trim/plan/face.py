"""The face of a formed sheet that a tool follows, and closed curves projected onto it."""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh, dots, unit
from planner.geometry.face_from_above import FaceFromAbove
from planner.geometry.units import MM

CURVE_SPACING_M: Final = 0.4 * MM
"""Distance [m] of the points at which a curve is projected onto the face."""
POINT_TOLERANCE_M: Final = 1e-7
"""Points closer than this [m] are one."""


class SheetFace:
    """Upper or lower face of a formed sheet.

    By the sine law the upper face is the lower one moved along z by the thickness. Beyond the mesh the sheet
    is flat.

    Attributes:
        side: +1 for the upper face, -1 for the lower one.
        rise: Height z of the flat of this face [m].
        mesh: Mesh of this face.

    Args:
        mesh: Lower face in the sheet's frame.
        thickness: Thickness of the flat sheet [m].
        side: +1 for the upper face, -1 for the lower one.
    """

    def __init__(self, mesh: Mesh, thickness: float, side: int) -> None:
        self.side, self.rise = side, thickness if side > 0 else 0.0
        self.mesh = Mesh(mesh.vertices + np.array([0.0, 0.0, self.rise]), mesh.faces)
        self._from_above = FaceFromAbove(self.mesh.vertices, self.mesh.faces)

    def at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (N, 3) [m] of the face over ``xy`` (N, 2) [m], and upward normals (N, 3) there."""
        projected = self._from_above.at(xy)
        point = np.where(
            projected.on[:, None], projected.point, np.column_stack([xy, np.full(len(xy), self.rise)])
        )
        return point, np.where(projected.on[:, None], projected.normal, np.array([0.0, 0.0, 1.0]))

    def sheet_triangles(self, size: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the whole face of the sheet as vertices (V, 3) [m] and triangles (F, 3).

        They are the mesh and eight rectangles of flat sheet around it, as far as these are in the sheet.

        Args:
            size: Size of the sheet (2,) [m]. The result is larger if the mesh is.
        """
        low, high = self.mesh.vertices[:, :2].min(axis=0), self.mesh.vertices[:, :2].max(axis=0)
        half_size = np.maximum(np.maximum(-low, high), 0.5 * size)
        xs = np.unique([-half_size[0], low[0], high[0], half_size[0]])
        ys = np.unique([-half_size[1], low[1], high[1], half_size[1]])
        corners = [
            np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
            for x0, x1 in itertools.pairwise(xs.tolist())
            for y0, y1 in itertools.pairwise(ys.tolist())
            if not (x0 == low[0] and x1 == high[0] and y0 == low[1] and y1 == high[1])
        ]
        count = len(self.mesh.vertices)
        flat = np.concatenate(corners) if corners else np.zeros((0, 2))
        vertices = np.concatenate(
            [self.mesh.vertices, np.column_stack([flat, np.full(len(flat), self.rise)])]
        )
        first = count + 4 * np.arange(len(corners))[:, None]
        faces = np.concatenate([self.mesh.faces, first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
        return vertices, faces


@dataclasses.dataclass(frozen=True)
class FaceCurve:
    """A closed curve on the face, counter-clockwise seen from above.

    Attributes:
        name: Name of the outline.
        point: Points (N, 3) [m]; the first one is not repeated.
        normal: Upward normals (N, 3).
        along: Length up to each point and back to the first one (N + 1,) [m].
    """

    name: str
    point: FloatArray
    normal: FloatArray
    along: FloatArray

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(self.along[-1])


def project_curve(name: str, points: FloatArray, face: SheetFace) -> FaceCurve:
    """Project a closed curve along z onto the face.

    The result is counter-clockwise in plan. It has the curve's own points, without adjacent duplicates, and
    evenly spaced points between them.

    Args:
        name: Name of the outline.
        points: Points of the curve (K, 2 or 3) [m].
        face: Face of the sheet.
    """
    xy = np.concatenate([points[:, :2], points[:1, :2]])
    step = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    xy = xy[np.append(True, step > POINT_TOLERANCE_M)]
    x, y = xy[:-1, 0], xy[:-1, 1]
    if float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) < 0.0:
        xy = xy[::-1]
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    count = max(int(np.ceil(lengths[-1] / CURVE_SPACING_M)), 24)  # at least 24 on a small curve
    # evenly spaced points and the curve's own ones, without duplicates
    sampled = np.union1d(lengths[-1] * np.arange(count) / count, lengths[:-1])
    is_distinct = np.append(
        np.diff(sampled) > POINT_TOLERANCE_M, lengths[-1] - sampled[-1] > POINT_TOLERANCE_M
    )
    sampled = sampled[is_distinct]
    plan = np.stack([np.interp(sampled, lengths, xy[:, k]) for k in range(2)], axis=1)
    point, normal = face.at(plan)
    ring = np.concatenate([point, point[:1]])
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1)))
    return FaceCurve(name, point, normal, along)


ARC_STEP_RAD: Final = np.deg2rad(6.0)
"""Rotation [rad] between points of a slot's centre line round a corner."""
OFFSET_TOLERANCE_M: Final = 0.02 * MM
"""Points of a slot's centre line that are nearer to the curve than half the kerf by this [m] are left out."""
SMOOTH_ANGLE_RAD: Final = np.deg2rad(3.0)
"""Angle of a curve [rad] below which its slot has no corner."""


def curve_distance(points: FloatArray, curve: FloatArray) -> FloatArray:
    """Return the distance (N,) [m] of points from a closed polyline.

    It is that from the edges adjacent to the three nearest vertices, so it may be too large where the lengths
    of edges differ much.

    Args:
        points: Points (N, 3) [m].
        curve: Vertices of the polyline (K, 3) [m].
    """
    from scipy.spatial import cKDTree  # slow to import

    nearest = np.asarray(cKDTree(curve).query(points, k=min(3, len(curve)))[1]).reshape(len(points), -1)
    next_vertex = np.roll(curve, -1, axis=0)
    best = np.full(len(points), np.inf)
    for first in (*nearest.T, *((column - 1) % len(curve) for column in nearest.T)):
        start, edge = curve[first], next_vertex[first] - curve[first]
        fraction = np.clip(dots(points - start, edge) / np.maximum(dots(edge, edge), 1e-24), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - start - fraction[:, None] * edge, axis=1))
    return best


REACH_ITERATIONS: Final = 8
"""Number of fixed-point iterations for a point at half the kerf from its curve."""
REACH_SCALES: Final = (0.2, 2.0)
"""Bounds of the scale along the tangent plane in that iteration."""


def offset_curve(
    curve: FaceCurve, face: SheetFace, half_kerf: float, inside: bool
) -> tuple[FloatArray, FloatArray]:
    """Offset a curve by half the kerf into the waste. The result is the centre line of its slots.

    Each point of the curve is moved across it in the face's tangent plane, and from there along z onto the
    face, so that its distance is half the kerf. At corners that turn away from the slot, the centre line goes
    round the corner. At corners that turn toward it, points nearer to the curve than half the kerf are left
    out, so that the two sides meet.

    Args:
        curve: Curve on the face.
        face: Face of the sheet.
        half_kerf: Half of the kerf [m].
        inside: Whether the waste is inside the curve.

    Returns:
        Centre line of the slot (M, 3) [m], closed without repeating the first point, and directions into the
        waste (M, 3).
    """
    point, normal = curve.point, curve.normal
    direction = unit(np.roll(point, -1, axis=0) - point)
    sign = 1.0 if inside else -1.0
    next_side = unit(sign * np.cross(normal, direction))
    previous_side = unit(sign * np.cross(normal, np.roll(direction, 1, axis=0)))
    angle = np.arctan2(
        np.linalg.norm(np.cross(previous_side, next_side), axis=1), dots(previous_side, next_side)
    )
    # corners that turn away from the slot
    is_convex = sign * dots(np.cross(np.roll(direction, 1, axis=0), direction), normal) < 0.0
    directions_of_points: list[FloatArray] = []
    owner: list[IntArray] = []
    for i in range(len(point)):
        if angle[i] < SMOOTH_ANGLE_RAD:
            directions = unit((previous_side[i] + next_side[i])[None])
        elif is_convex[i]:
            fraction = np.linspace(0.0, 1.0, int(np.ceil(angle[i] / ARC_STEP_RAD)) + 1)[:, None]
            directions = (
                np.sin((1.0 - fraction) * angle[i]) * previous_side[i]
                + np.sin(fraction * angle[i]) * next_side[i]
            )
            # spherical interpolation, which is singular at half a revolution
            directions = directions / np.sin(angle[i]) if angle[i] < np.pi - 1e-3 else unit(directions)
        else:
            directions = np.stack([previous_side[i], next_side[i]])
        directions_of_points.append(directions)
        owner.append(np.full(len(directions), i))
    into_waste, curve_index = np.concatenate(directions_of_points), np.concatenate(owner)
    scale = np.ones(len(curve_index))
    for _ in range(REACH_ITERATIONS):  # scale the step until the distance is half the kerf on a bent face too
        middle, _ = face.at((point[curve_index] + (half_kerf * scale)[:, None] * into_waste)[:, :2])
        reach = np.linalg.norm(middle - point[curve_index], axis=1)
        scale = np.clip(scale * half_kerf / np.maximum(reach, 0.2 * half_kerf), *REACH_SCALES)
    kept = curve_distance(middle, point) >= half_kerf - OFFSET_TOLERANCE_M
    return _join_sides(middle, unit(into_waste), kept)


def _join_sides(middle: FloatArray, out: FloatArray, kept: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the points of a closed path that are kept, joined where others are left out.

    Points are left out at inner corners. If the straight sides of the path next to such a gap intersect, the
    intersection is added.

    Returns:
        Points (M, 3) [m], and directions (M, 3) into the waste, from ``out`` (N, 3).
    """
    kept_indices = np.flatnonzero(kept)
    if kept.all() or len(kept_indices) < 4:
        return middle[kept_indices], out[kept_indices]
    points, directions = [], []
    for k, index in enumerate(kept_indices.tolist()):
        points.append(middle[index])
        directions.append(out[index])
        next_index = kept_indices[(k + 1) % len(kept_indices)]
        if (next_index - index) % len(kept) == 1:
            continue
        a, b = middle[index], middle[next_index]
        ahead, back = a - middle[kept_indices[k - 1]], b - middle[kept_indices[(k + 2) % len(kept_indices)]]
        # nearest points of both lines
        parameters = np.linalg.lstsq(np.stack([ahead, -back], axis=1), b - a, rcond=None)[0]
        on_first, on_second = a + parameters[0] * ahead, b + parameters[1] * back
        if parameters.min() > 0.0 and float(np.linalg.norm(on_first - on_second)) < OFFSET_TOLERANCE_M:
            points.append(0.5 * (on_first + on_second))
            directions.append(unit((out[index] + out[next_index])[None])[0])
    return np.array(points), np.array(directions)
