"""Closed level lines of a face with their normals, and the levels by step or by ridge height.

Lines are cut at all levels at once. Levels follow from a constant step, or from the required height of the
ridges. A ball of radius R leaves ridges of height h between two paths that are d apart along a flat wall, h =
R - sqrt(R^2 - d^2 / 4), so d = 2 sqrt(2 R h - h^2), and levels on a wall at angle a are d sin a apart
(Malhotra and others 2010, who use the flattest wall of the next contour; here of both). All levels here fall:
mirror a feature that rises first.

`ridge_heights` gives the ridges that constant steps of a ball leave, point by point; they grow where a wall
is flat.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from shapely import Polygon, contains_xy

from planner.geometry.arrays import FloatArray, IntArray, unique_rows
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
from planner.geometry.units import DEG
from planner.issues import issue_error

_POINT_TOLERANCE_M: Final = 1e-7
"""Points of a line nearer than this [m], with the same normal, are one."""
_NORMAL_TOLERANCE: Final = 1e-4
"""Unit normals whose difference is shorter than this [-] are equal."""
_FAN_STEP_RAD: Final = np.radians(2.0)
"""Step [rad] of the normals between which a ball rolls over a crease at one point."""
_MIN_LOOP_LENGTH_M: Final = 2e-4
"""Level lines shorter than this [m] are ignored."""


@dataclasses.dataclass(frozen=True)
class LevelLoop:
    """A closed level line.

    Adjacent points are on one facet, or at one position between the normals on both sides of a crease.

    Attributes:
        point: Points (K, 3) [m], the last equal to the first.
        normal: Unit normals (K, 3), the last equal to the first.
        level: Number of its level.
    """

    point: FloatArray
    normal: FloatArray
    level: int

    def length(self) -> float:
        """Return the length [m]."""
        return float(np.linalg.norm(np.diff(self.point, axis=0), axis=1).sum())

    def area(self) -> float:
        """Return the area [m^2] in plan, positive if the line runs anticlockwise seen from +z."""
        x, y = self.point[:, 0], self.point[:, 1]
        return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))

    def reversed(self) -> "LevelLoop":
        """Return the line in the opposite direction."""
        return LevelLoop(self.point[::-1], self.normal[::-1], self.level)


@dataclasses.dataclass(frozen=True)
class LevelSegments:
    """Pieces of level lines, each on one facet. The higher side is on the right.

    Attributes:
        level: Level (S,).
        face: Face (S,).
        start: Start points (S, 3) [m].
        stop: End points (S, 3) [m].
        start_normal: Unit normals (S, 3) at the start.
        stop_normal: Unit normals (S, 3) at the end.
        start_key: Key (S,) of the mesh edge at the start, unique over levels.
        stop_key: Key (S,) of the mesh edge at the end, unique over levels.
    """

    level: IntArray
    face: IntArray
    start: FloatArray
    stop: FloatArray
    start_normal: FloatArray
    stop_normal: FloatArray
    start_key: IntArray
    stop_key: IntArray


def cut_levels(
    vertices: FloatArray, faces: IntArray, normals: FloatArray, levels: FloatArray
) -> LevelSegments:
    """Return the segments in which horizontal planes cut the facets.

    A vertex on a level counts as above it, so facets that are flat at a level are not cut.

    Args:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3).
        normals: Unit normals (F, 3, 3) at their corners.
        levels: Levels (L,) [m] of the planes.
    """
    height = vertices[:, 2]
    corner = height[faces]
    order = np.argsort(levels)
    ordered = levels[order]
    # levels z with min < z <= max of the face's corners
    first = np.searchsorted(ordered, corner.min(axis=1), side="right")
    count = np.searchsorted(ordered, corner.max(axis=1), side="right") - first
    face = np.repeat(np.arange(len(faces)), count)
    offset = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    level = order[np.repeat(first, count) + offset]
    is_above = corner[face] >= levels[level][:, None]
    rises = ~is_above & np.roll(is_above, -1, axis=1)
    falls = is_above & ~np.roll(is_above, -1, axis=1)
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
    low, high = edges.min(axis=2), edges.max(axis=2)
    key = low * len(vertices) + high
    _, key = np.unique(key.ravel(), return_inverse=True)
    key = np.reshape(key, faces.shape)
    edge_count = int(key.max()) + 1 if len(faces) else 1
    ends = []
    for corner_index in (np.argmax(rises, axis=1), np.argmax(falls, axis=1)):
        first_corner, second_corner = corner_index, (corner_index + 1) % 3
        a, b = faces[face, first_corner], faces[face, second_corner]
        # from the lower to the higher vertex, so that both facets at an edge compute exactly the same point
        is_swapped = a > b
        a, b = np.where(is_swapped, b, a), np.where(is_swapped, a, b)
        fraction = (levels[level] - height[a]) / (height[b] - height[a])
        point = vertices[a] + fraction[:, None] * (vertices[b] - vertices[a])
        point[:, 2] = levels[level]
        weight = np.where(is_swapped, 1.0 - fraction, fraction)[:, None]
        normal = (1.0 - weight) * normals[face, first_corner] + weight * normals[face, second_corner]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        ends.append((point, normal, level * edge_count + key[face, corner_index]))
    (start, start_normal, start_key), (stop, stop_normal, stop_key) = ends
    return LevelSegments(level, face, start, stop, start_normal, stop_normal, start_key, stop_key)


def closed_loops(segments: LevelSegments, region: Polygon | None, name: str) -> list[LevelLoop]:
    """Return the closed lines that segments make up, in order of level, each at least 0.2 mm long.

    Args:
        segments: Segments.
        region: Region in plan in which at least 99 % of the points of a line must lie; None for all lines.
        name: Name of the pass, for messages.

    Raises:
        TandemError: ``forming.open_contour`` if a line ends at a border of the mesh inside the region.
    """
    segments, successor = _successors(segments, region, name)
    count = len(segments.level)
    if not count:
        return []
    # pointer doubling: the smallest member names each cycle, then the steps to it order its segments
    smallest, jump = np.arange(count), successor.copy()
    rounds = int(np.ceil(np.log2(max(count, 2)))) + 1
    for _ in range(rounds):
        lower = np.minimum(smallest, smallest[jump])
        if np.array_equal(lower, smallest):
            break
        smallest, jump = lower, jump[jump]
    is_smallest = smallest == np.arange(count)
    steps = np.where(is_smallest, 0, 1)
    jump = np.where(is_smallest, np.arange(count), successor)
    for _ in range(rounds):
        step = steps[jump]
        if not step.any():
            break
        steps, jump = steps + step, jump[jump]
    position = np.where(is_smallest, 0, -steps)
    rank = np.lexsort((np.where(is_smallest, -(count + 1), position), smallest, segments.level))
    label = smallest[rank]
    cuts = np.flatnonzero(label[1:] != label[:-1]) + 1
    result = []
    for members in np.split(rank, cuts):
        loop = _make_loop(segments, members)
        if loop is not None and (region is None or _inside_fraction(loop.point, region) > 0.99):
            result.append(loop)
    return result


def _inside_fraction(point: FloatArray, region: Polygon) -> float:
    """Return the fraction of points (K, 3) that are in a region in plan."""
    return float(np.mean(contains_xy(region, point[:, 0], point[:, 1])))


def _successors(segments: LevelSegments, region: Polygon | None, name: str) -> tuple[LevelSegments, IntArray]:
    """Return the segments of closed lines, and the index (S,) of the segment that follows each.

    Lines that end at a border of the mesh outside the region are left out. Raises ``TandemError``
    (forming.open_contour) if one ends inside it.
    """
    count = len(segments.level)
    if not count:
        return segments, np.zeros(0, dtype=np.int64)
    order = np.argsort(segments.start_key, kind="stable")
    keys = segments.start_key[order]
    match = np.minimum(np.searchsorted(keys, segments.stop_key), count - 1)
    successor = order[match]
    is_end = keys[match] != segments.stop_key
    if not is_end.any():
        return segments, successor
    end_points = segments.stop[is_end]
    inside = (
        np.ones(len(end_points), bool)
        if region is None
        else contains_xy(region, end_points[:, 0], end_points[:, 1])
    )
    if inside.any():
        at_mm = 1e3 * end_points[inside][0]
        message = f"{name}: the level line at z = {at_mm[2]:.2f} mm ends at ({at_mm[0]:.1f}, {at_mm[1]:.1f}) "
        message += (
            "mm, where the mesh has a hole or a border; close it, or let the mesh reach the flat around "
        )
        message += "the feature"
        raise issue_error("forming.open_contour", message)
    linked = np.flatnonzero(~is_end)
    graph = coo_array((np.ones(len(linked)), (linked, successor[linked])), shape=(count, count))
    _, piece = connected_components(graph, directed=False)
    kept = ~np.isin(piece, piece[is_end])
    rank = np.cumsum(kept) - 1
    kept_segments = LevelSegments(
        *(getattr(segments, field.name)[kept] for field in dataclasses.fields(segments))
    )
    return kept_segments, rank[successor[kept]]


def _make_loop(segments: LevelSegments, members: IntArray) -> LevelLoop | None:
    """Return the loop of consecutive segments, or None if it is too short.

    At a crease the normal turns at one point. The loop gets several points there, between which the normal
    turns by at most `_FAN_STEP_RAD`. ``members`` (M,) are the indices of the segments, in order.
    """
    point = np.stack([segments.start[members], segments.stop[members]], axis=1).reshape(-1, 3)
    normal = np.stack([segments.start_normal[members], segments.stop_normal[members]], axis=1).reshape(-1, 3)
    point, normal = np.concatenate([point, point[:1]]), np.concatenate([normal, normal[:1]])
    move = np.linalg.norm(np.diff(point, axis=0), axis=1)
    if move.sum() < _MIN_LOOP_LENGTH_M:
        return None
    normal_change = np.linalg.norm(np.diff(normal, axis=0), axis=1)
    kept = np.concatenate([[True], (move > _POINT_TOLERANCE_M) | (normal_change > _NORMAL_TOLERANCE)])
    kept[-1] = True
    point, normal = point[kept], normal[kept]
    normal_change = np.linalg.norm(np.diff(normal, axis=0), axis=1)
    is_same_point = np.linalg.norm(np.diff(point, axis=0), axis=1) <= _POINT_TOLERANCE_M
    fans = np.flatnonzero(is_same_point & (normal_change > _FAN_STEP_RAD))
    if len(fans):
        parts = np.ceil(normal_change[fans] / _FAN_STEP_RAD).astype(np.int64)
        repeats = np.ones(len(point) - 1, dtype=np.int64)
        repeats[fans] = parts
        base = np.repeat(np.arange(len(repeats)), repeats)
        fraction = (np.arange(len(base)) - np.repeat(np.cumsum(repeats) - repeats, repeats)) / repeats[base]
        point = np.concatenate(
            [point[base] + fraction[:, None] * (point[base + 1] - point[base]), point[-1:]]
        )
        blended = (1.0 - fraction)[:, None] * normal[base] + fraction[:, None] * normal[base + 1]
        blended /= np.maximum(np.linalg.norm(blended, axis=1, keepdims=True), 1e-300)
        normal = np.concatenate([blended, normal[-1:]])
    return LevelLoop(point, normal, int(segments.level[members[0]]))


FLAT_MARGIN_M: Final = 1e-6
"""Distance [m] of the last line above the flat end of a feature, where there are no lines."""
_PROFILE_STEPS: Final = 400
"""Number of heights of a wall between which its ridges are calculated."""
_SHELF_WIDTHS: Final = 4.0
"""Maximum width of a shelf between two adjacent levels, in ridge widths."""


def scallop_spacing(radius: float, scallop: float) -> float:
    """Return the spacing [m] along a flat wall of paths of a ball that leave ridges ``scallop`` [m] high."""
    return 2.0 * float(np.sqrt(2.0 * radius * scallop - scallop * scallop))


def scallop_height(radius: float, width: float | FloatArray) -> FloatArray:
    """Return the height [m] of the ridges between paths ``width`` [m] apart along a flat wall.

    It is the inverse of `scallop_spacing`: h = R - sqrt(R^2 - d^2 / 4).
    """
    return np.asarray(radius - np.sqrt(np.maximum(radius**2 - 0.25 * np.square(width), 0.0)))


def constant_levels(start: float, end: float, step: float) -> FloatArray:
    """Return levels below ``start`` down to ``end``, ``step`` [m] apart; the last step is the remainder."""
    count = max(int(np.ceil((start - end) / step - 1e-6)), 1)
    return np.asarray(np.append(start - step * np.arange(1, count), end))


def flattest_wall(segments: LevelSegments, region: Polygon | None, count: int) -> FloatArray:
    """Return the smallest wall angle (count,) [rad] on each level, NaN where there is no line."""
    if region is not None:
        middle = 0.5 * (segments.start[:, :2] + segments.stop[:, :2])
        inside = contains_xy(region, middle[:, 0], middle[:, 1])
    else:
        inside = np.ones(len(segments.level), dtype=np.bool_)
    max_normal_z = np.full(count, -1.0)
    levels = segments.level[inside]
    np.maximum.at(
        max_normal_z, levels, np.maximum(segments.start_normal[inside, 2], segments.stop_normal[inside, 2])
    )
    return np.asarray(np.where(max_normal_z < 0.0, np.nan, np.arccos(np.clip(max_normal_z, -1.0, 1.0))))


def scallop_levels(
    mesh: TriangleMesh, normals: FloatArray, region: Polygon | None, start: float, end: float, width: float
) -> FloatArray:
    """Return the descending levels of a path whose lines are about ``width`` apart along the face.

    A step in height is ``width`` times the smallest sine of the wall angles between its two lines. Where the
    face is so flat that this step becomes small, lines are at least half of ``width`` apart along the face
    instead, because more lines would not reduce the ridges.

    Args:
        mesh: Face, F triangles.
        normals: Unit normals (F, 3, 3) at the corners of the triangles.
        region: Region in plan; None for all.
        start: Upper level [m], not included.
        end: Lower level [m].
        width: Spacing [m] along the face.
    """
    fraction = np.linspace(0.0, 1.0, _PROFILE_STEPS + 1)
    # dense at both ends, where faces turn into the flat
    eased = fraction * fraction * (3.0 - 2.0 * fraction)
    grid = start - FLAT_MARGIN_M - (start - end - 2.0 * FLAT_MARGIN_M) * eased
    angle = flattest_wall(cut_levels(mesh.vertices, mesh.faces, normals, grid), region, len(grid))
    found = np.isfinite(angle)
    sine = np.interp(-grid, -grid[found], np.sin(angle[found])) if found.any() else np.ones(len(grid))
    path_length = -np.diff(grid) * 2.0 / np.maximum(sine[1:] + sine[:-1], 1e-9)
    along = np.concatenate([[0.0], np.cumsum(np.minimum(path_length, _SHELF_WIDTHS * width))])
    depth = grid[0] - grid
    levels = []
    depth_reached = 0.0
    while depth_reached < depth[-1] - FLAT_MARGIN_M:
        local_sine = float(np.interp(depth_reached, depth, sine))
        # farthest level of the profile for which step <= width * min sine, then interpolate to the next
        is_ahead = depth > depth_reached
        min_sine = np.minimum(np.minimum.accumulate(np.where(is_ahead, sine, np.inf)), local_sine)
        is_allowed = is_ahead & (depth - depth_reached <= width * min_sine)
        step = 0.0
        if is_allowed.any():
            last = int(np.flatnonzero(is_allowed)[-1])
            beyond = min(last + 1, len(depth) - 1)
            step = max(
                depth[last] - depth_reached, min(width * min_sine[beyond], depth[beyond] - depth_reached)
            )
        else:
            nearest = int(np.argmax(is_ahead))
            step = min(width * min_sine[nearest], depth[nearest] - depth_reached)
        min_step = (
            float(np.interp(np.interp(depth_reached, depth, along) + 0.5 * width, along, depth))
            - depth_reached
        )
        depth_reached = depth_reached + max(step, min_step, FLAT_MARGIN_M)
        levels.append(grid[0] - min(depth_reached, depth[-1]))
    levels[-1] = end
    return np.asarray(levels)


MIN_WALL_ANGLE_RAD: Final = 2.0 * DEG
"""Walls flatter than this [rad] count as flat: no finite step leaves them without ridges."""
_LINE_NEIGHBOURS: Final = 32
"""Number of nearest points among which the nearest one of another line is searched."""


def ridge_heights(mesh: TriangleMesh, radius: float, step: float, fraction: float) -> FloatArray:
    """Return the height (F,) [m] of the ridges that a ball leaves on the triangles of a face.

    On a wall at angle a the paths are dz / sin(a) apart. Where the wall bends, the flattest point within that
    distance counts, because the paths on both sides of a ridge are about there. Angles have a lower bound,
    because no step is small enough for a nearly flat wall. It is the angle below which (1 - fraction) / 2 of
    the walls' area lies, and at least MIN_WALL_ANGLE_RAD.

    Args:
        mesh: Face.
        radius: Radius [m] of the ball.
        step: Distance dz [m] of the paths in z.
        fraction: Fraction of the walls that must be formed.
    """
    angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
    area = np.where(angle > MIN_WALL_ANGLE_RAD, face_areas(mesh), 0.0)
    order = np.argsort(angle)
    cumulative = np.cumsum(area[order]) / max(float(area.sum()), 1e-12)
    min_angle = max(
        float(angle[order[int(np.searchsorted(cumulative, 0.5 * (1.0 - fraction)))]]), MIN_WALL_ANGLE_RAD
    )
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    local_angle = _min_within(
        middle, np.maximum(angle, min_angle), step / np.sin(np.maximum(angle, min_angle)), 0.5 * step
    )
    return scallop_height(radius, np.minimum(step / np.sin(local_angle), 2.0 * radius))


def _min_within(points: FloatArray, value: FloatArray, reach: FloatArray, cell: float) -> FloatArray:
    """Return the minimum (N,) of the values (N,) of all points (N, 3) within ``reach`` (N,) [m] of each.

    The minimum of each cell of size ``cell`` [m] represents the whole cell, so that fine meshes take no
    longer.
    """
    cell_index = unique_rows(np.floor(points / cell).astype(np.int64))[2]
    order = np.lexsort((value, cell_index))
    first = order[np.diff(cell_index[order], prepend=-1) != 0]
    neighbour_count = min(_LINE_NEIGHBOURS, len(first))
    distance, other = cKDTree(points[first]).query(points, k=[*range(1, neighbour_count + 1)])
    neighbour_minimum = np.where(distance <= reach[:, None], value[first[other]], np.inf).min(axis=1)
    return np.asarray(np.minimum(value, neighbour_minimum))
