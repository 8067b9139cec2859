"""Where a surface is bent inward more tightly than half a slot: the wire leaves out what its own slot cannot
reach, and what stays there is told.

Beside an inner corner whose sides are shorter than half a slot, or an inner curve of a smaller radius, the
wires that stand half a slot off form a loop. It is cut off where it crosses itself: at the place that is half
a slot from both sides (a vertex of the surface's parallel).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.hotwire.straight_lines import Lines, chord, distance_to_polyline
from planner.hotwire.straight_offset import Beside, Row
from planner.problem import Ruled

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

NEAR: Final = 0.1
"""Share of the tolerance by which wires beside a smooth surface may be nearer to it than half a slot."""
DENSE: Final = 5e-4
"""[m] distance of the rulings at which a surface is looked at."""
QUARTER: Final = 64
"""Pieces of a quarter of an arc that lines are widened by."""
SHALLOW: Final = 0.03
"""Share of the tolerance at which foam that stays begins."""
AROUND: Final = 3.0
"""A loop goes over no more of the surface than this many half slots and twice the depth that may stay."""


def guides(ruled: Ruled) -> tuple[FloatArray, FloatArray]:
    """Both guide lines (M, 3), those of a closed surface ending where they begin."""
    if not ruled.closed:
        return ruled.start, ruled.end
    return np.concatenate([ruled.start, ruled.start[:1]]), np.concatenate([ruled.end, ruled.end[:1]])


def unlooped(made: Beside, ruled: Ruled, tolerance: float, left: float) -> Row | None:
    """The row without its loops, one wire in place of each; None where it has none that can be cut off.
    ``tolerance`` [m] of the surface, ``left`` [m] how deep foam may stay."""
    lines = made.lines
    ends = (lines.start, lines.end)
    near = np.stack([distance_to_polyline(*pair) for pair in zip(ends, guides(ruled), strict=True)], axis=1)
    bad = np.asarray((near < made.half - NEAR * tolerance).any(axis=1))
    if not bad.any() or bad[0] or bad[-1]:
        return None
    edges = np.flatnonzero(np.diff(bad))
    row = made.row
    keep = np.ones(len(bad), dtype=np.bool_)
    foot = [row.foot.start.copy(), row.foot.end.copy()]
    normal, turn = row.normal.copy(), row.turn.copy()
    for before, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        behind = last + 1
        way = max(float(np.linalg.norm(np.diff(f[before : behind + 1], axis=0), axis=1).sum()) for f in foot)
        if way > AROUND * float(made.half[before].max()) + 2.0 * left:
            continue
        middle = (before + behind) // 2
        places = [_crossing(end, before, behind, lines.direction[middle]) for end in ends]
        for k, place in enumerate(places):
            point = ends[k][middle] if place is None else place
            normal[middle, k] = (point - foot[k][middle]) / made.half[middle, k]
        turn[middle] = 0.0
        keep[before + 1 : behind] = False
        keep[middle] = True
    if keep.all():
        return None
    return Row(Lines(*foot), normal, turn)[keep]


def _crossing(points: FloatArray, before: int, behind: int, axis: FloatArray) -> FloatArray | None:
    """Where the way of wires' ends (N, 3), as seen along ``axis`` (3,), crosses itself between two wires:
    nearest to the first one; None where it does not."""
    one = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    one /= np.linalg.norm(one)
    own = points[before : behind + 1]
    flat = np.stack([own @ one, own @ np.cross(axis, one)], axis=1)
    a, way = flat[:-1], np.diff(flat, axis=0)
    for i in range(len(way) - 2):
        for j in range(len(way) - 1, i + 1, -1):
            det = way[i, 0] * way[j, 1] - way[i, 1] * way[j, 0]
            gap = a[j] - a[i]
            if abs(det) < 1e-18:
                continue
            s = (gap[0] * way[j, 1] - gap[1] * way[j, 0]) / det
            t = (gap[0] * way[i, 1] - gap[1] * way[i, 0]) / det
            if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                return np.asarray(own[i] + s * (own[i + 1] - own[i]))
    return None


@dataclasses.dataclass(frozen=True)
class Left:
    """Foam that stays in one place: ``depth`` [m] at most, at ``point`` (3,) of the surface; ``volume``
    [m^3]."""

    depth: float
    point: FloatArray
    volume: float


def stays(made: Beside, ruled: Ruled, tolerance: float, box: FloatArray) -> list[Left]:
    """What the wires leave on the surface because they are round, deeper than ``tolerance`` [m], the deepest
    first."""
    fine, lines = _dense(ruled), made.lines
    depth = np.empty((len(fine), 2))
    for k, (points, ends) in enumerate(((fine.start, lines.start), (fine.end, lines.end))):
        near = cKDTree(ends).query(points)[1]
        depth[:, k] = distance_to_polyline(points, ends) - made.half[near, k]
    half = float(made.half.mean())
    found: list[Left] = []
    for rows in _runs(depth.max(axis=1) > SHALLOW * tolerance, ruled.closed):
        k = int(rows[int(np.argmax(depth[rows].max(axis=1)))])
        deep = float(depth[k].max())
        if deep > tolerance:
            found.append(Left(deep, fine.start[k], _volume(fine, k, half, deep, lines, box, ruled.closed)))
    return sorted(found, key=lambda one: -one.depth)


def _dense(ruled: Ruled) -> Lines:
    """The rulings (M) of a surface, and such between them that both ends are ``DENSE`` apart at most."""
    a, b = guides(ruled)
    way = np.maximum(*(np.linalg.norm(np.diff(p, axis=0), axis=1) for p in (a, b)))
    count = np.maximum(np.ceil(way / DENSE).astype(np.intp), 1)
    row = np.repeat(np.arange(len(count)), count)
    share = ((np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / count[row])[:, None]
    start, end = (p[row] + share * (p[row + 1] - p[row]) for p in (a, b))
    if ruled.closed:
        return Lines(start, end)
    return Lines(np.concatenate([start, a[-1:]]), np.concatenate([end, b[-1:]]))


def _runs(chosen: BoolArray, closed: bool) -> Iterator[NDArray[np.intp]]:
    """Indices of every run of chosen places, one over the end of a closed line being one run."""
    rows = np.flatnonzero(chosen)
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else []
    if closed and len(parts) > 1 and chosen[0] and chosen[-1]:
        parts = [np.concatenate([parts[-1], parts[0]]), *parts[1:-1]]
    yield from parts


def _volume(
    fine: Lines, k: int, half: float, deep: float, lines: Lines, box: FloatArray, closed: bool
) -> float:
    """Volume [m^3] of the foam that stays at ruling ``k`` in the block: the line across it widened by half
    a slot, ``half`` [m], and narrowed again, on the side of the wires."""
    axis = fine.direction[k]
    one = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    plane = np.stack([one, np.cross(axis, one)], axis=1) / np.linalg.norm(one)
    wide = int(np.ceil((3.0 * half + 2.0 * deep) / DENSE))
    rows = np.arange(k - wide, k + wide + 1)
    rows = rows % len(fine) if closed else rows[(rows >= 0) & (rows < len(fine))]
    line = 0.5 * (fine.start + fine.end)[rows] @ plane
    here = 0.5 * (fine.start + fine.end)[k] @ plane
    wires = 0.5 * (lines.start + lines.end) @ plane
    to = wires[int(np.argmin(np.linalg.norm(wires - here, axis=1)))] - here
    filled = shapely.LineString(line).buffer(half, quad_segs=QUARTER).buffer(-half, quad_segs=QUARTER)
    inside = shapely.Point(here + 0.3 * deep * to / max(float(np.linalg.norm(to)), 1e-12))
    area = sum(piece.area for piece in shapely.get_parts(filled) if piece.distance(inside) < 0.1 * deep)
    first, last = chord(fine[[k]], box)
    return float(area * np.nan_to_num(last - first)[0])
