"""Closed level lines of a face with their normals, and the levels by step or by ridge height.

Lines are cut at all levels at once. From which level to which loops go: a constant step, or one
that leaves ridges of a wanted height. A ball of radius R leaves ridges of height h between two ways
that are d apart along a flat wall, h = R - sqrt(R^2 - d^2 / 4), so d = 2 sqrt(2 R h - h^2), and
levels on a wall at angle a are d sin a apart (Malhotra and others 2010, who look at the flattest
wall of the next contour; here of both). All levels here fall: for a feature that rises, mirror it
first.

`ridge_heights`: what constant steps of a ball leave standing, place by place: ridges that grow where a
wall is flat.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from shapely import Polygon, contains_xy

from planner.geometry.arrays import FloatArray, IntArray, distinct_rows
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
from planner.geometry.units import DEG
from planner.issues import refusal

_SAME_PLACE: Final = 1e-7
"""Places of a line nearer than this [m], with the same normal, are one."""
_SAME_NORMAL: Final = 1e-4
"""Unit normals whose difference is shorter than this [-] are the same."""
_FAN_STEP: Final = np.radians(2.0)
"""Step [rad] of the normals between which a ball rolls over a crease at one place."""
_LEAST_LOOP: Final = 2e-4
"""Level lines shorter than this [m] are none."""


@dataclasses.dataclass(frozen=True)
class Loop:
    """A closed level line: ``point`` (K, 3) [m] and unit ``normal`` (K, 3), the last row as the first.
    Neighbouring rows lie on one facet, or at one place between normals of a crease. ``level``: its number."""

    point: FloatArray
    normal: FloatArray
    level: int

    def length(self) -> float:
        """Length [m]."""
        return float(np.linalg.norm(np.diff(self.point, axis=0), axis=1).sum())

    def area(self) -> float:
        """Area [m^2] in plan, positive where the line runs anticlockwise as seen from +z."""
        x, y = self.point[:, 0], self.point[:, 1]
        return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))

    def reversed(self) -> "Loop":
        """The same line the other way round."""
        return Loop(self.point[::-1], self.normal[::-1], self.level)


@dataclasses.dataclass(frozen=True)
class Segments:
    """Pieces of level lines, each on one facet: ``level`` (S,), ``face`` (S,), ``start`` and ``stop`` (S, 3)
    [m], unit normals there (S, 3), and keys (S,) of the mesh's edges at both ends, unique over levels. The
    higher side is to the right."""

    level: IntArray
    face: IntArray
    start: FloatArray
    stop: FloatArray
    start_normal: FloatArray
    stop_normal: FloatArray
    start_key: IntArray
    stop_key: IntArray


def cut(vertices: FloatArray, faces: IntArray, normals: FloatArray, levels: FloatArray) -> Segments:
    """Where the planes z = ``levels`` (L,) cut the facets, with ``normals`` (F, 3, 3) at their corners. A
    vertex on a level counts as above it, so what is flat at a level is not cut."""
    height = vertices[:, 2]
    corner = height[faces]
    order = np.argsort(levels)
    ordered = levels[order]
    # levels z with least < z <= greatest of the face's corners
    first = np.searchsorted(ordered, corner.min(axis=1), side="right")
    count = np.searchsorted(ordered, corner.max(axis=1), side="right") - first
    face = np.repeat(np.arange(len(faces)), count)
    place = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    level = order[np.repeat(first, count) + place]
    up = corner[face] >= levels[level][:, None]
    rises = ~up & np.roll(up, -1, axis=1)
    falls = up & ~np.roll(up, -1, axis=1)
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
    low, high = edges.min(axis=2), edges.max(axis=2)
    key = low * len(vertices) + high
    _, key = np.unique(key.ravel(), return_inverse=True)
    key = np.reshape(key, faces.shape)
    width = int(key.max()) + 1 if len(faces) else 1
    ends = []
    for side in (np.argmax(rises, axis=1), np.argmax(falls, axis=1)):
        one, two = side, (side + 1) % 3
        a, b = faces[face, one], faces[face, two]
        swap = a > b  # both facets at an edge compute the very same place
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        share = (levels[level] - height[a]) / (height[b] - height[a])
        spot = vertices[a] + share[:, None] * (vertices[b] - vertices[a])
        spot[:, 2] = levels[level]
        mine = np.where(swap, 1.0 - share, share)[:, None]
        mixed = (1.0 - mine) * normals[face, one] + mine * normals[face, two]
        mixed /= np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-300)
        ends.append((spot, mixed, level * width + key[face, side]))
    (start, start_normal, start_key), (stop, stop_normal, stop_key) = ends
    return Segments(level, face, start, stop, start_normal, stop_normal, start_key, stop_key)


def loops(segments: Segments, region: Polygon | None, name: str) -> list[Loop]:
    """The closed lines within ``region`` that segments make up, in order of level, each at least 0.2 mm long.

    Raises ``TandemError`` with ``forming.open_contour`` where a line ends at a border of the mesh within it.
    """
    segments, follow = _followers(segments, region, name)
    count = len(segments.level)
    if not count:
        return []
    least, jump = np.arange(count), follow.copy()
    rounds = int(np.ceil(np.log2(max(count, 2)))) + 1
    for _ in range(rounds):
        lower = np.minimum(least, least[jump])
        if np.array_equal(lower, least):
            break
        least, jump = lower, jump[jump]
    head = least == np.arange(count)
    ahead = np.where(head, 0, 1)
    jump = np.where(head, np.arange(count), follow)
    for _ in range(rounds):
        step = ahead[jump]
        if not step.any():
            break
        ahead, jump = ahead + step, jump[jump]
    place = np.where(head, 0, -ahead)
    rank = np.lexsort((np.where(head, -(count + 1), place), least, segments.level))
    label = least[rank]
    cuts = np.flatnonzero(label[1:] != label[:-1]) + 1
    found = []
    for rows in np.split(rank, cuts):
        loop = _loop(segments, rows)
        if loop is not None and (region is None or _share_inside(loop.point, region) > 0.99):
            found.append(loop)
    return found


def _share_inside(point: FloatArray, region: Polygon) -> float:
    return float(np.mean(contains_xy(region, point[:, 0], point[:, 1])))


def _followers(segments: Segments, region: Polygon | None, name: str) -> tuple[Segments, IntArray]:
    count = len(segments.level)
    if not count:
        return segments, np.zeros(0, dtype=np.int64)
    order = np.argsort(segments.start_key, kind="stable")
    keys = segments.start_key[order]
    at = np.minimum(np.searchsorted(keys, segments.stop_key), count - 1)
    follow, ends = order[at], keys[at] != segments.stop_key
    if not ends.any():
        return segments, follow
    spot = segments.stop[ends]
    inside = np.ones(len(spot), bool) if region is None else contains_xy(region, spot[:, 0], spot[:, 1])
    if inside.any():
        at_mm = 1e3 * spot[inside][0]
        what = f"{name}: the level line at z = {at_mm[2]:.2f} mm ends at ({at_mm[0]:.1f}, {at_mm[1]:.1f}) "
        what += "mm, closed ones are wanted: the mesh has a hole or a border there; close it, or let the "
        what += "mesh reach the flat around the feature"
        raise refusal("forming.open_contour", what)
    rows = np.flatnonzero(~ends)
    graph = coo_array((np.ones(len(rows)), (rows, follow[rows])), shape=(count, count))
    _, piece = connected_components(graph, directed=False)
    kept = ~np.isin(piece, piece[ends])
    rank = np.cumsum(kept) - 1
    some = Segments(*(getattr(segments, field.name)[kept] for field in dataclasses.fields(segments)))
    return some, rank[follow[kept]]


def _loop(segments: Segments, rows: IntArray) -> Loop | None:
    point = np.stack([segments.start[rows], segments.stop[rows]], axis=1).reshape(-1, 3)
    normal = np.stack([segments.start_normal[rows], segments.stop_normal[rows]], axis=1).reshape(-1, 3)
    point, normal = np.concatenate([point, point[:1]]), np.concatenate([normal, normal[:1]])
    move = np.linalg.norm(np.diff(point, axis=0), axis=1)
    if move.sum() < _LEAST_LOOP:
        return None
    turn = np.linalg.norm(np.diff(normal, axis=0), axis=1)
    kept = np.concatenate([[True], (move > _SAME_PLACE) | (turn > _SAME_NORMAL)])
    kept[-1] = True
    point, normal = point[kept], normal[kept]
    turn = np.linalg.norm(np.diff(normal, axis=0), axis=1)
    still = np.linalg.norm(np.diff(point, axis=0), axis=1) <= _SAME_PLACE
    fans = np.flatnonzero(still & (turn > _FAN_STEP))
    if len(fans):
        parts = np.ceil(turn[fans] / _FAN_STEP).astype(np.int64)
        many = np.ones(len(point) - 1, dtype=np.int64)
        many[fans] = parts
        base = np.repeat(np.arange(len(many)), many)
        share = (np.arange(len(base)) - np.repeat(np.cumsum(many) - many, many)) / many[base]
        point = np.concatenate([point[base] + share[:, None] * (point[base + 1] - point[base]), point[-1:]])
        mixed = (1.0 - share)[:, None] * normal[base] + share[:, None] * normal[base + 1]
        mixed /= np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-300)
        normal = np.concatenate([mixed, normal[-1:]])
    return Loop(point, normal, int(segments.level[rows[0]]))


FLAT_MARGIN: Final = 1e-6
"""The last line is so far above the flat end of a feature [m], where there are no lines."""
_PROFILE_STEPS: Final = 400
"""Heights of a wall between which its ridges are worked out."""
_SHELF_WIDTHS: Final = 4.0
"""A shelf between two neighbouring levels counts as so many ridges wide at most."""


def scallop_width(radius: float, scallop: float) -> float:
    """How far apart [m] along a flat wall ways of a ball may be that leave ridges ``scallop`` [m] high."""
    return 2.0 * float(np.sqrt(2.0 * radius * scallop - scallop * scallop))


def scallop_height(radius: float, width: float | FloatArray) -> FloatArray:
    """Height [m] of the ridges between ways ``width`` [m] apart along a flat wall: the inverse."""
    return np.asarray(radius - np.sqrt(np.maximum(radius**2 - 0.25 * np.square(width), 0.0)))


def constant_levels(start: float, end: float, step: float) -> FloatArray:
    """Levels below ``start`` down to ``end``, ``step`` [m] apart, the last step being what is left."""
    count = max(int(np.ceil((start - end) / step - 1e-6)), 1)
    return np.asarray(np.append(start - step * np.arange(1, count), end))


def flattest(segments: Segments, region: Polygon | None, count: int) -> FloatArray:
    """The least wall angle (count,) [rad] on each level, NaN where there is no line."""
    if region is not None:
        middle = 0.5 * (segments.start[:, :2] + segments.stop[:, :2])
        inside = contains_xy(region, middle[:, 0], middle[:, 1])
    else:
        inside = np.ones(len(segments.level), dtype=np.bool_)
    up = np.full(count, -1.0)
    rows = segments.level[inside]
    np.maximum.at(up, rows, np.maximum(segments.start_normal[inside, 2], segments.stop_normal[inside, 2]))
    return np.asarray(np.where(up < 0.0, np.nan, np.arccos(np.clip(up, -1.0, 1.0))))


def scallop_levels(
    vertices: FloatArray,
    faces: IntArray,
    normals: FloatArray,
    region: Polygon | None,
    start: float,
    end: float,
    width: float,
) -> FloatArray:
    """Levels below ``start`` down to ``end`` whose lines are ``width`` [m] apart along the face.

    A step is ``width`` times the sine of the flattest wall of both its lines; where the face turns so flat
    that this comes to little, lines are at least half of ``width`` apart along the face instead, as nothing
    is gained from more of them.
    """
    share = np.linspace(0.0, 1.0, _PROFILE_STEPS + 1)
    smooth = share * share * (3.0 - 2.0 * share)  # dense at both ends, where faces turn into the flat
    grid = start - FLAT_MARGIN - (start - end - 2.0 * FLAT_MARGIN) * smooth
    angle = flattest(cut(vertices, faces, normals, grid), region, len(grid))
    known = np.isfinite(angle)
    sine = np.interp(-grid, -grid[known], np.sin(angle[known])) if known.any() else np.ones(len(grid))
    way = -np.diff(grid) * 2.0 / np.maximum(sine[1:] + sine[:-1], 1e-9)
    along = np.concatenate([[0.0], np.cumsum(np.minimum(way, _SHELF_WIDTHS * width))])
    depth = grid[0] - grid
    levels = []
    at = 0.0
    while at < depth[-1] - FLAT_MARGIN:
        here = float(np.interp(at, depth, sine))
        # the farthest level of the profile to which the step holds, then the place between it and the next
        ahead = depth > at
        flat = np.minimum(np.minimum.accumulate(np.where(ahead, sine, np.inf)), here)
        holds = ahead & (depth - at <= width * flat)
        step = 0.0
        if holds.any():
            last = int(np.flatnonzero(holds)[-1])
            beyond = min(last + 1, len(depth) - 1)
            step = max(depth[last] - at, min(width * flat[beyond], depth[beyond] - at))
        else:
            nearest = int(np.argmax(ahead))
            step = min(width * flat[nearest], depth[nearest] - at)
        least = float(np.interp(np.interp(at, depth, along) + 0.5 * width, along, depth)) - at
        at = at + max(step, least, FLAT_MARGIN)
        levels.append(grid[0] - min(at, depth[-1]))
    levels[-1] = end
    return np.asarray(levels)


FLATTEST_WALL: Final = 2.0 * DEG
"""Walls flatter than this [rad] count as flat: no finite steps leave them without ridges."""
_LINE_NEIGHBOURS: Final = 32
"""Nearest places among which the nearest one of another line is looked for."""


def ridge_heights(mesh: TriangleMesh, radius: float, step: float, share: float) -> FloatArray:
    """Height (F,) [m] of the ridges between ways of a ball of ``radius`` [m] that are ``step`` [m] apart in
    z, on the triangles of a face.

    On a wall at angle a ways are dz / sin a apart; where the wall bends, the flattest place within that
    distance counts, for the ways on both sides of a ridge lie about there. Where it is nearly flat no step is
    small enough: there the height is that at the angle that most of ``share`` of the walls stay above.
    """
    angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
    area = np.where(angle > FLATTEST_WALL, face_areas(mesh), 0.0)
    order = np.argsort(angle)
    passed = np.cumsum(area[order]) / max(float(area.sum()), 1e-12)
    least = max(float(angle[order[int(np.searchsorted(passed, 0.5 * (1.0 - share)))]]), FLATTEST_WALL)
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    near = _least_within(
        middle, np.maximum(angle, least), step / np.sin(np.maximum(angle, least)), 0.5 * step
    )
    return scallop_height(radius, np.minimum(step / np.sin(near), 2.0 * radius))


def _least_within(places: FloatArray, value: FloatArray, reach: FloatArray, cell: float) -> FloatArray:
    """The least value (N,) of all places (N, 3) that are no farther than ``reach`` (N,) [m]: of those in one
    cell of size ``cell`` [m] the least stands for all, so that fine meshes take no longer."""
    which = distinct_rows(np.floor(places / cell).astype(np.int64))[2]
    order = np.lexsort((value, which))
    first = order[np.diff(which[order], prepend=-1) != 0]
    count = min(_LINE_NEIGHBOURS, len(first))
    apart, other = cKDTree(places[first]).query(places, k=[*range(1, count + 1)])
    found = np.where(apart <= reach[:, None], value[first[other]], np.inf).min(axis=1)
    return np.asarray(np.minimum(value, found))
