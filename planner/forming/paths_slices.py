"""Closed level lines of a face with its normals along them, all levels at once."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely import Polygon, contains_xy

from planner.issues import Issue, TandemError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_SAME: Final = 1e-7
"""Places of a line nearer than this [m], with the same normal, are one."""
_ALIKE: Final = 1e-4
_FAN: Final = np.radians(2.0)
_SMALLEST: Final = 2e-4


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

    def reversed(self) -> Loop:
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
    """Segments of closed lines, and of each the one that follows it."""
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
        raise TandemError(
            Issue(
                "forming.open_contour",
                f"{name}: the level line at z = {at_mm[2]:.2f} mm ends at ({at_mm[0]:.1f}, {at_mm[1]:.1f}) "
                "mm, closed ones are wanted: the mesh has a hole or a border there; close it, or let the "
                "mesh reach the flat around the feature",
            )
        )
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
    if move.sum() < _SMALLEST:
        return None
    turn = np.linalg.norm(np.diff(normal, axis=0), axis=1)
    kept = np.concatenate([[True], (move > _SAME) | (turn > _ALIKE)])
    kept[-1] = True
    point, normal = point[kept], normal[kept]
    turn = np.linalg.norm(np.diff(normal, axis=0), axis=1)
    still = np.linalg.norm(np.diff(point, axis=0), axis=1) <= _SAME
    fans = np.flatnonzero(still & (turn > _FAN))
    if len(fans):
        parts = np.ceil(turn[fans] / _FAN).astype(np.int64)
        many = np.ones(len(point) - 1, dtype=np.int64)
        many[fans] = parts
        base = np.repeat(np.arange(len(many)), many)
        share = (np.arange(len(base)) - np.repeat(np.cumsum(many) - many, many)) / many[base]
        point = np.concatenate([point[base] + share[:, None] * (point[base + 1] - point[base]), point[-1:]])
        mixed = (1.0 - share)[:, None] * normal[base] + share[:, None] * normal[base + 1]
        mixed /= np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-300)
        normal = np.concatenate([mixed, normal[-1:]])
    return Loop(point, normal, int(segments.level[rows[0]]))
