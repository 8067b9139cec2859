"""Distances of points from a body of revolution on its way: the least over all of its places.

Bounds over groups of places, and over cells of points, say where the least cannot be; whatever they
leave open is looked at, so that nothing is missed.

The bound of a group, for a point p: places k have pivots q_k and axes a_k, near to m + t h and u +
t g for some t from -1 to 1, by d and e at most; u is of unit length. Seen along u, the axis at the
depth b = (p - m) u slides along a segment, and p is beside it by r at least. Where the body at k is
within sight of p, no farther than w beside the axis and no farther than l along it, the depth of p
there is b to within f = |(q_k - m) u| + w c + l c c / 2, with c = |a_k - u|, and p is beside that
axis by r - f |g| - d - l e at least.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, columns, dots
from planner.geometry.mesh import small_pieces

GROUP_PLACES: Final = 4
"""Places of a group of the lowest level."""
GROUPS_JOINED: Final = 2
"""Groups of one level in a group of the next one."""
MOST_TOP_GROUPS: Final = 12
"""Groups of the highest level at most."""


@dataclasses.dataclass(frozen=True)
class RoundBody:
    """A convex body of revolution from ``start`` to ``end`` [m] along its axis, no wider than ``widest`` [m].

    ``distance``: of points ``back`` from the origin along the axis and ``beside`` it [m], signed, in the
    shape of both; it must change by no more than its arguments do, and not fall with ``beside``. ``plain``:
    it is a cylinder with sharp edges."""

    start: float
    end: float
    widest: float
    distance: Callable[[FloatArray, FloatArray], FloatArray]
    plain: bool = False

    @property
    def middle(self) -> float:
        """How far its pivot is along the axis [m]."""
        return 0.5 * (self.start + self.end)

    @property
    def half(self) -> float:
        """Half of its length [m]."""
        return 0.5 * (self.end - self.start)

    def least(self, depth: FloatArray, beside: FloatArray, within: FloatArray) -> FloatArray:
        """A bound below the distances of points at ``depth`` [m] from the pivot along the axis, to
        ``within`` [m], and ``beside`` it or more: that of the cylinder that holds the body."""
        ends = np.maximum(np.abs(depth) - within, 0.0) - self.half
        aside = beside - self.widest
        out = np.maximum(ends, aside)
        edge = np.nonzero((ends > 0.0) & (aside > 0.0))
        out[edge] = np.hypot(ends[edge], aside[edge])
        return np.asarray(out)


@dataclasses.dataclass(frozen=True)
class Level:
    """G groups of ``size`` consecutive places: rows of ``of`` (14, G) are m, u, the part of h beside u,
    g, f, and what is lost beside the axis, as above."""

    size: int
    of: FloatArray

    @property
    def count(self) -> int:
        """How many groups there are."""
        return len(self.of[0])

    def bound(self, points: FloatArray, group: IntArray, body: RoundBody) -> tuple[FloatArray, FloatArray]:
        """Bounds below the distances (M,) [m] of points (3, M) from the body at all places of a group (M,)
        where it is within sight of them, and the share (M,) from -1 to 1 of the way through the group at
        which it is nearest, about."""
        g = self.of.take(group, axis=1)
        rest = points - g[:3]
        depth = columns(rest, g[3:6])
        way = depth * g[9:12]
        way += g[6:9]
        along, square = columns(rest, way), columns(way, way)
        share = along / np.maximum(square, 1e-300)
        np.clip(share, -1.0, 1.0, out=share)
        # of what is left of rest beside the way: |rest - share way|^2
        square *= share
        square -= 2.0 * along
        square *= share
        square += columns(rest, rest)
        square -= depth * depth
        beside = np.sqrt(np.maximum(square, 0.0))
        beside -= g[13]
        low = body.least(depth, beside, g[12])
        if not body.plain:
            near = body.distance(depth + body.middle, np.maximum(beside, 0.0)) - g[12]
            np.maximum(low, near, out=low)
        return low, share


def group_levels(tip: FloatArray, axis: FloatArray, body: RoundBody, sight: float) -> list[Level]:
    """Groups of ``GROUP_PLACES`` places, of ``GROUPS_JOINED`` times as many and so on, until they are few:
    of a body at places ``tip`` and ``axis`` (N, 3), for points within ``sight`` [m] of it."""
    pivot = tip + body.middle * axis
    wide, far = body.widest + sight, body.half + sight
    out: list[Level] = []
    size = GROUP_PLACES
    while not out or out[-1].count > MOST_TOP_GROUPS:
        count = -(-len(tip) // size)
        rows = np.minimum(np.arange(count * size).reshape(count, size), len(tip) - 1)
        mean = axis[rows[:, 0]] + axis[rows[:, -1]]
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        unit = np.where(length > 1e-3, mean / np.maximum(length, 1e-3), axis[rows[:, 0]])
        middle = 0.5 * (pivot[rows[:, 0]] + pivot[rows[:, -1]])
        half, turn = (0.5 * (of[rows[:, -1]] - of[rows[:, 0]]) for of in (pivot, axis))
        turn -= dots(turn, unit)[:, None] * unit
        off, lean = pivot[rows] - middle[:, None], axis[rows] - unit[:, None]
        chord = np.sqrt(dots(lean, lean).max(axis=1))
        depth = np.abs(np.einsum("gkd,gd->gk", off, unit)).max(axis=1)
        depth += wide * chord + 0.5 * far * chord * chord
        share = np.einsum("gkd,gd->gk", off, half) + far**2 * np.einsum("gkd,gd->gk", lean, turn)
        share /= np.maximum(dots(half, half) + far**2 * dots(turn, turn), 1e-300)[:, None]
        np.clip(share, -1.0, 1.0, out=share)
        off -= share[..., None] * half[:, None]
        lean -= share[..., None] * turn[:, None]
        lost = np.sqrt(dots(off, off).max(axis=1))
        lost += far * np.sqrt(dots(lean, lean).max(axis=1))
        lost += depth * np.linalg.norm(turn, axis=1)
        half -= dots(half, unit)[:, None] * unit
        out.append(Level(size, np.vstack([middle.T, unit.T, half.T, turn.T, depth, lost])))
        size *= GROUPS_JOINED
    return out


PLACES_AT_ONCE: Final = 1 << 19
"""Places that are looked at at once."""
POINTS_PER_CELL: Final = 24
"""Points of a cell, about."""
SPLIT_PLACES: Final = 8
"""Cells are taken apart into their points at groups of so many places."""
PAIRS_AT_ONCE: Final = 20_000
"""Points and groups that are looked at at once."""
COARSE_PIECE: Final = 4e-3
"""Size of pieces of a face [m] of which those far from a body's way are left out."""
PIECES_AT_ONCE: Final = 20_000
"""Pieces that are divided at once."""
TRIED_TRIANGLES: Final = 200
"""Triangles by whose size it is told whether a mesh is to be divided at all."""
CLOSER_SHARE: Final = 0.25
"""Where pieces are smaller than this part of coarse ones, these are held against the body itself first."""
COUNT_SHARE: Final = 0.25
"""Pieces that are more than this part of the most are counted one by one."""
ANY_NUMBER: Final = np.iinfo(np.int64).max
"""As many pieces as there are."""
SAME_DISTANCE: Final = 1e-10
"""Places at which a point is nearer by less than this [m] are one as good as the other."""


def least_distances(
    points: FloatArray,
    tip: FloatArray,
    axis: FloatArray,
    body: RoundBody,
    sight: float,
    below: float = np.inf,
) -> tuple[FloatArray, IntArray]:
    """Least signed distance (P,) [m] of points (P, 3) from a body at any of the places ``tip``, ``axis``
    (N, 3), the axes of unit length, and the index (P,) of the place; ``sight`` [m] and 0 where it is no less
    than that.

    With ``below`` [m] only distances less than that are wanted, and the least one of all: the others may be
    told too large, but stay at ``below`` and at the least one of all or above.
    """
    best, where = np.full(len(points), sight), np.zeros(len(points), dtype=np.int64)
    points = np.ascontiguousarray(points.T)
    for first in range(0, len(tip), PLACES_AT_ONCE):
        rows = slice(first, first + PLACES_AT_ONCE)
        some = _in_box(points, tip[rows], axis[rows], body, sight)
        if len(some):
            wanted = _Wanted(sight, below, float(best.min()))
            _Search(points, some, tip[rows], axis[rows], body, wanted, best, where, first).run()
    return best, where


def _in_box(points: FloatArray, tip: FloatArray, axis: FloatArray, body: RoundBody, sight: float) -> IntArray:
    """Which of the points (3, P) are in the box around the body on its way."""
    ends = np.stack([tip + body.start * axis, tip + body.end * axis])
    room = body.widest + sight
    low, high = ends.min(axis=(0, 1)) - room, ends.max(axis=(0, 1)) + room
    return np.flatnonzero(((points >= low[:, None]) & (points <= high[:, None])).all(axis=0))


def places_near(
    corners: FloatArray,
    tip: FloatArray,
    axis: FloatArray,
    body: RoundBody,
    sight: float,
    size: float,
    most: int,
) -> tuple[FloatArray, IntArray, int]:
    """Places (P, 3) of triangles (T, 3, 3) that are within ``sight`` [m] of a body at some of the places
    ``tip``, ``axis`` (N, 3), and the triangle (P,) of each: the middles of all pieces there, none of which
    has an edge longer than ``size`` [m]. Also how many pieces that takes, about; above ``most`` there are no
    places."""
    near, owner, count = _pieces_near(corners, tip, axis, body, sight, size, most)
    if count > most or not len(near):
        return corners[:0, 0], owner[:0], count
    places, owners = [corners[:0, 0]], [owner[:0]]
    for rows in np.array_split(np.arange(len(near)), len(near) // PIECES_AT_ONCE + 1):
        pieces, own = small_pieces(near[rows], size, ANY_NUMBER)
        places.append(pieces.mean(axis=1))
        owners.append(owner[rows][own])
    found = np.concatenate(places)
    return found, np.concatenate(owners), len(found)


def count_near(
    corners: FloatArray,
    tip: FloatArray,
    axis: FloatArray,
    body: RoundBody,
    sight: float,
    size: float,
    most: int,
) -> int:
    """How many places :func:`places_near` finds; where these are far fewer than ``most``, about."""
    near, _, count = _pieces_near(corners, tip, axis, body, sight, size, most)
    if COUNT_SHARE * most < count <= most and len(near):
        return places_near(corners, tip, axis, body, sight, size, most)[2]
    return count


def _pieces_near(
    corners: FloatArray,
    tip: FloatArray,
    axis: FloatArray,
    body: RoundBody,
    sight: float,
    size: float,
    most: int,
) -> tuple[FloatArray, IntArray, int]:
    """Coarse pieces (P, 3, 3) of triangles that may be within ``sight``, the triangle (P,) of each, and how
    many fine ones they are, about, as in :func:`places_near`."""
    centre, reach = _around(tip, axis, body, sight)
    owner = np.arange(len(corners))
    kept = _within(corners, centre, reach)
    near, owner = corners[kept], owner[kept]
    longest = float(np.linalg.norm(near - np.roll(near, 1, axis=1), axis=2).max(initial=0.0))
    while len(near) and longest > max(size, COARSE_PIECE):
        longest = max(0.5 * longest, size, COARSE_PIECE)
        near, own = small_pieces(near, longest, ANY_NUMBER)
        kept = _within(near, centre, reach)
        near, owner = near[kept], owner[own][kept]
        if len(near) > most:
            break
    if len(near) and size < CLOSER_SHARE * COARSE_PIECE:
        kept = _closer(near, tip, axis, body, sight)
        near, owner = near[kept], owner[kept]
    return near, owner, _count(near, size)


def _closer(
    corners: FloatArray, tip: FloatArray, axis: FloatArray, body: RoundBody, sight: float
) -> BoolArray:
    """Which triangles (T, 3, 3) may come within ``sight`` [m] of the body itself: those whose middles are as
    far from it as their corners from these, and no more."""
    middle = corners.mean(axis=1)
    size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    reach = sight + float(size.max())
    away, _ = least_distances(middle, tip, axis, body, reach, reach)
    return np.asarray(away - size < sight)


def _count(corners: FloatArray, size: float) -> int:
    """How many pieces of triangles (T, 3, 3) have no edge longer than ``size`` [m], by trying a few."""
    if not len(corners):
        return 0
    some = corners[:: max(1, len(corners) // TRIED_TRIANGLES)]
    longest = np.linalg.norm(some - np.roll(some, 1, axis=1), axis=2).max(axis=1)
    # so large triangles would be too many alone: their pieces are like them, and four times as many
    halves = np.maximum(np.ceil(np.log2(longest / size / 16.0)), 0.0)
    few = [
        len(small_pieces(some[halves == half], size * 2.0**half, ANY_NUMBER)[0]) * 4.0**half
        for half in np.unique(halves)
    ]
    return int(np.ceil(np.sum(few) * len(corners) / len(some)))


def _around(tip: FloatArray, axis: FloatArray, body: RoundBody, sight: float) -> tuple[cKDTree, float]:
    """Places and a reach [m]: whatever is within ``sight`` of a body somewhere is within that of one."""
    count = max(int(np.ceil((body.end - body.start) / max(body.widest, COARSE_PIECE))), 1)
    back = body.start + (body.end - body.start) * (np.arange(count) + 0.5) / count
    cells = [np.unique(np.floor((tip + b * axis) / COARSE_PIECE).astype(np.int64), axis=0) for b in back]
    every = np.unique(np.concatenate(cells), axis=0)
    half = 0.5 * (body.end - body.start) / count
    return cKDTree((every + 0.5) * COARSE_PIECE), float(np.hypot(body.widest, half)) + sight + COARSE_PIECE


def _within(corners: FloatArray, centre: cKDTree, reach: float) -> BoolArray:
    """Which triangles (T, 3, 3) may come within ``reach`` [m] of some centre."""
    middle = corners.mean(axis=1)
    size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    away, _ = centre.query(middle, distance_upper_bound=reach + float(size.max(initial=0.0)))
    return np.asarray(away - size <= reach)


@dataclasses.dataclass
class _Wanted:
    """What is looked for: distances below ``sight`` [m]; of those from ``below`` [m] on only the least of
    all, of which ``lowest`` [m] is known."""

    sight: float
    below: float
    lowest: float

    @property
    def limit(self) -> float:
        """No other distances matter."""
        return max(self.below, self.lowest)


class _Search:
    """The search of one block of places; points, places and axes have their x, y and z in rows, which is
    how many of them are worked out fastest."""

    def __init__(
        self,
        points: FloatArray,
        some: IntArray,
        tip: FloatArray,
        axis: FloatArray,
        body: RoundBody,
        wanted: _Wanted,
        best: FloatArray,
        where: IntArray,
        first: int,
    ) -> None:
        self.body, self.wanted, self.places = body, wanted, len(tip)
        self.tip, self.axis = np.ascontiguousarray(tip.T), np.ascontiguousarray(axis.T)
        self.best, self.where, self.first = best, where, first
        points = points.take(some, axis=1)
        order, start = _cells(points)
        self.some, self.points = some[order], points.take(order, axis=1)
        self.start = np.append(start, len(some))
        low, high = (op.reduceat(self.points, start, axis=1) for op in (np.minimum, np.maximum))
        self.middle = 0.5 * (low + high)
        off = self.points - np.repeat(self.middle, np.diff(self.start), axis=1)
        self.size = np.sqrt(np.maximum.reduceat(columns(off, off), start))
        # where a point of a cell is within sight, its middle is not much farther
        self.levels = group_levels(tip, axis, body, wanted.sight + float(self.size.max()))
        self.near = np.maximum.reduceat(best[self.some], start)
        self.told = best[self.some]

    def run(self) -> None:
        """Takes groups and cells apart until nothing is left open."""
        top = len(self.levels) - 1
        count = self.levels[top].count
        cells = np.arange(len(self.size))
        stack = [
            (True, top, np.repeat(part, count), np.tile(np.arange(count), len(part)))
            for part in np.array_split(cells, -(-len(cells) // 512))
        ]
        while stack:
            cell, level, own, group = stack.pop()
            if len(own) > PAIRS_AT_ONCE and own[0] != own[-1]:
                cut = int(np.searchsorted(own, own[len(own) // 2], side="left"))
                cut = cut or int(np.searchsorted(own, own[0], side="right"))
                stack += [(cell, level, own[:cut], group[:cut]), (cell, level, own[cut:], group[cut:])]
                continue
            if level < 0:
                self._look(own, group)
                continue
            keep = self._open(cell, level, own, group)
            own, group = own[keep], group[keep]
            if not len(own):
                continue
            if cell and self.levels[level].size <= SPLIT_PLACES:
                stack.append((False, level, *self._apart(own, group)))
                continue
            below = self.levels[level - 1].count if level else self.places
            parts = GROUPS_JOINED if level else GROUP_PLACES
            own, group = np.repeat(own, parts), (parts * group[:, None] + np.arange(parts)).ravel()
            there = group < below
            stack.append((cell, level - 1, own[there], group[there]))

    def _apart(self, own: IntArray, group: IntArray) -> tuple[IntArray, IntArray]:
        """The points of cells, each with the groups of its cell, by point."""
        first = np.flatnonzero(np.diff(own, prepend=-1))
        groups = np.diff(np.append(first, len(own)))
        cells = own[first]
        many = self.start[cells + 1] - self.start[cells]
        point = np.repeat(self.start[cells] - (np.cumsum(many) - many), many) + np.arange(int(many.sum()))
        per = np.repeat(groups, many)
        base = np.repeat(np.repeat(first, many) - (np.cumsum(per) - per), per)
        return np.repeat(point, per), group[base + np.arange(int(per.sum()))]

    def _open(self, cell: bool, level: int, own: IntArray, group: IntArray) -> BoolArray:
        """Which groups may hold a nearer place than the nearest known one, which is sought in the best."""
        points = (self.middle if cell else self.points).take(own, axis=1)
        low, share = self.levels[level].bound(points, group, self.body)
        if cell:
            low -= self.size[own]
        first = np.flatnonzero(np.diff(own, prepend=-1))
        best = np.repeat(np.minimum.reduceat(low, first), np.diff(np.append(first, len(own))))
        hit = np.flatnonzero(low == best)
        known = self.near if cell else self.told
        hit = hit[low[hit] < known[own[hit]]]
        size = self.levels[level].size
        place = size * group[hit] + np.rint((share[hit] + 1.0) * 0.5 * (size - 1)).astype(np.int64)
        np.minimum(place, self.places - 1, out=place)
        if cell:
            far = self._off(self.middle.take(own[hit], axis=1), place) + self.size[own[hit]]
            np.minimum.at(self.near, own[hit], far)
            # what is known of a cell is not yet told of its points
            return np.asarray(low < np.minimum(self.near[own], self.wanted.limit) + SAME_DISTANCE)
        self._note(own[hit], place)
        return np.asarray(low < np.minimum(self.told[own], self.wanted.limit) - SAME_DISTANCE)

    def _look(self, own: IntArray, place: IntArray) -> None:
        off = self._off(self.points.take(own, axis=1), place)
        first = np.flatnonzero(np.diff(own, prepend=-1))
        best = np.repeat(np.minimum.reduceat(off, first), np.diff(np.append(first, len(own))))
        hit = np.flatnonzero(off == best)
        self._keep(own[hit], place[hit], off[hit])

    def _note(self, own: IntArray, place: IntArray) -> None:
        self._keep(own, place, self._off(self.points.take(own, axis=1), place))

    def _keep(self, own: IntArray, place: IntArray, off: FloatArray) -> None:
        """Told where it is nearer."""
        nearer = off < self.told[own]
        own, place, off = own[nearer], place[nearer], off[nearer]
        self.told[own] = off
        rows = self.some[own]
        self.best[rows], self.where[rows] = off, place + self.first
        # of a point that comes twice one place was told, not always the nearer one
        self.wanted.lowest = min(self.wanted.lowest, float(self.told[own].min(initial=np.inf)))

    def _off(self, points: FloatArray, place: IntArray) -> FloatArray:
        """Distances (M,) [m] of points (3, M) from the body at places (M,)."""
        rest, axis = points - self.tip.take(place, axis=1), self.axis.take(place, axis=1)
        back = columns(rest, axis)
        square = columns(rest, rest) - back * back
        return self.body.distance(back, np.sqrt(np.maximum(square, 0.0)))


def _cells(points: FloatArray) -> tuple[IntArray, IntArray]:
    """Points (3, P) in cells of a grid: their order, and where in it each cell begins."""
    low = points.min(axis=1)[:, None]
    rest = points - low
    side = max(float(rest.max()) / 64.0, 1e-9)
    key, many = _keys(rest, side)
    taken = np.zeros(many, dtype=bool)
    taken[key] = True
    # the points are those of faces: cells become fewer with the square of their sides
    key, _ = _keys(rest, side * float(np.sqrt(taken.sum() * POINTS_PER_CELL / len(key))))
    order = np.argsort(key)
    return order, np.flatnonzero(np.diff(key[order], prepend=-1))


def _keys(rest: FloatArray, side: float) -> tuple[IntArray, int]:
    """Numbers (P,) of a grid's cells that points ``rest`` (3, P) from its corner are in; how many it has."""
    x, y, z = (rest / side).astype(np.int64)
    wide = [int(row.max()) + 1 for row in (x, y, z)]
    return x + wide[0] * (y + wide[1] * z), wide[0] * wide[1] * wide[2]
