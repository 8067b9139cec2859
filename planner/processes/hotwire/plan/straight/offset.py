"""The wire beside a ruled surface: every end of a ruling moved outward by half of its own kerf.

A convex corner is passed on a polygon around the circle of half a kerf, which nowhere comes nearer
to the part; an inner corner is passed through the point that is half a kerf from both its sides.

**Inner corners.** Where a surface is bent inward more tightly than half a slot, the wire leaves out
what its own slot cannot reach, and what stays there is told. Beside an inner corner whose sides are
shorter than half a slot, or an inner curve of a smaller radius, the wires that stand half a slot
off form a loop. It is cut off where it crosses itself: at the place that is half a slot from both
sides (a vertex of the surface's parallel).

**The slot between guide points** (`melted`). A wire that turns on its way goes slowly where it
turns about, so that its slot grows wide there, though both its ends are fast. So it is looked at
all along the wire, at and between its guide points.
"""

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, Ruled
from planner.geometry.rulings import outward_sides
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.straight.order import (
    Lines,
    chord,
    distance_to_polyline,
    fastest,
    join,
    move_across,
)

Damping = tuple[tuple[float, int], ...]

VERTEX_TURN: Final = np.deg2rad(60.0)
"""Largest turn at one vertex of the polygon around a convex corner: it stays within 1 / cos 30 deg of half a
kerf."""
FLAT_TURN: Final = np.deg2rad(2.0)
"""A turn below this [rad] needs no vertices of its own."""
CUSP_TURN: Final = np.deg2rad(175.0)
"""A turn beyond this [rad] is a cusp of the part: the wire goes round it, whatever the sign says."""
KERF_SETTLED: Final = 1e-7
"""[m] half kerfs have settled where one more round moves none of them by more."""
DAMPING: Final[Damping] = ((0.5, 60), (0.25, 120), (0.1, 300), (0.05, 600))
"""The kerf follows from the speed, the speed from the way, and the way from the kerf: of the step between the
logarithms of two rounds so much is taken, in at most so many rounds; where that is too much to settle, less
from the beginning. A wide slot drives its end on, which makes it narrow: whole steps swing for ever around a
blunt edge at one end and a sharp one at the other."""
LEAST_MOVE: Final = 1e-5
"""[m] shorter moves say nothing of a speed."""
MELTED_WAY: Final = 1e-3
"""[m] a slot takes its width from the speed over so much of the way, to and from each place: what the wire
does within less is melted together. Without it moves shorter than half a kerf would drive the rounds apart.
"""


@dataclasses.dataclass(frozen=True)
class Row:
    """Where wires are to stand beside a surface, in the order of the cut.

    ``foot`` (N) rulings of the surface, ``normal`` (N, 2, 3) how far the wire is off them at start and end
    per half kerf, ``turn`` (N, 2) [rad] the corner's whole turn at both ends, positive where it is convex.
    """

    foot: Lines
    normal: FloatArray
    turn: FloatArray

    def __getitem__(self, rows: BoolArray) -> "Row":
        return Row(self.foot[rows], self.normal[rows], self.turn[rows])

    def lines(self, half: FloatArray) -> Lines:
        """The wires for half kerfs (N, 2) [m]."""
        off = half[:, :, None] * self.normal
        return Lines(self.foot.start + off[:, 0], self.foot.end + off[:, 1])


@dataclasses.dataclass(frozen=True)
class Beside:
    """Wires beside a surface: ``row`` where they stand, ``half`` (N, 2) half kerfs [m] at start and end,
    ``speed`` (N, 2) [m/s] of both guide points where the fastest point in the foam has the feed. Where
    ``settled`` is false no half kerfs were found that fit their own speeds: these are those of wires at one
    distance all along, which is as near as one comes."""

    row: Row
    half: FloatArray
    speed: FloatArray
    settled: bool = True

    @property
    def lines(self) -> Lines:
        """The wires."""
        return self.row.lines(self.half)


def make_row(ruled: Ruled, first: int = 0, backward: bool = False, sharpest: float = VERTEX_TURN) -> Row:
    """Where wires stand beside a surface; a closed one from ruling ``first`` once around and back to it.
    ``sharpest`` [rad]: largest turn at one vertex around a convex corner."""
    count = len(ruled.start)
    order = np.arange(count + 1 if ruled.closed else count)
    order = (first - order if backward else first + order) % count if ruled.closed else order
    if backward and not ruled.closed:
        order = order[::-1]
    before, after = outward_sides(ruled)
    before, after = (after, before) if backward else (before, after)
    before, after = before[order], after[order]
    corner = ruled.corner[order].copy()
    if ruled.closed and corner[0]:  # each side of the first corner is an end of its own
        before[0], after[-1] = after[0], before[-1]
        corner[[0, -1]] = False
    foot = Lines(ruled.start[order], ruled.end[order])
    turn = _turns(before, after, foot.direction, -1.0 if backward else 1.0) * corner[:, None]
    return _with_vertices(foot, before, turn, -1.0 if backward else 1.0, sharpest)


def _turns(before: FloatArray, after: FloatArray, direction: FloatArray, sense: float) -> FloatArray:
    """Turns (N, 2) [rad] from normals to normals (N, 2, 3) about the wires, positive where convex."""
    axis = direction[:, None]
    angle = np.arctan2(np.sum(np.cross(before, after) * axis, axis=2), np.sum(before * after, axis=2))
    return np.asarray(np.where(np.abs(angle) > CUSP_TURN, np.abs(angle), sense * angle))


def _with_vertices(foot: Lines, before: FloatArray, turn: FloatArray, sense: float, sharpest: float) -> Row:
    """The row with as many vertices at every corner as its turn needs."""
    largest = np.abs(turn).max(axis=1)
    inner = turn.min(axis=1) < -FLAT_TURN
    parts = np.where(inner | (largest < FLAT_TURN), 1, np.ceil(largest / sharpest)).astype(np.intp)
    rows = np.repeat(np.arange(len(foot)), parts)
    number = np.arange(len(rows)) - np.repeat(np.cumsum(parts) - parts, parts)
    part = turn[rows] / parts[rows, None]
    angle = sense * part * (number[:, None] + 0.5)
    n, axis = before[rows], foot.direction[rows][:, None]
    normal = np.cos(angle)[..., None] * n + np.sin(angle)[..., None] * np.cross(axis, n)
    normal /= np.cos(0.5 * part)[..., None]
    return Row(foot[rows], normal, turn[rows])


def beside(row: Row, kerf: KerfCurve, feed: float, box: FloatArray, damping: Damping = DAMPING) -> Beside:
    """The wires beside a surface with the kerf of their own speeds at both ends, ``feed`` [m/s] being the
    speed of the fastest point in the box (2, 3). ``damping``: how they are looked for, as ``DAMPING``."""
    made = _settle(row, kerf, feed, box, damping)
    kept = _clear_of_inner_corners(made) if made.settled else np.ones(len(row.foot), dtype=np.bool_)
    return made if kept.all() else _settle(row[kept], kerf, feed, box, damping)


def _settle(row: Row, kerf: KerfCurve, feed: float, box: FloatArray, damping: Damping) -> Beside:
    """Half kerfs that are those of their own speeds, by damped rounds from those at the feed."""
    first = 0.5 * kerf.at(np.full((len(row.foot), 2), feed))
    for share, rounds in damping:
        half = first
        for _ in range(rounds):
            speed = end_speeds(row.lines(half), feed, box)
            wanted = 0.5 * kerf.at(speed)
            if np.abs(wanted - half).max() <= KERF_SETTLED:
                return Beside(row, half, speed)
            half = half * (wanted / half) ** share
    speed = end_speeds(row.lines(first), feed, box)
    return Beside(row, 0.5 * kerf.at(speed), speed, False)


def end_speeds(lines: Lines, feed: float, box: FloatArray) -> FloatArray:
    """Speeds (N, 2) [m/s] of starts and ends across the wire, meant over the moves to and from each line,
    or over more of them up to ``MELTED_WAY`` either way, when the fastest point in the box moves at
    ``feed``; at the first and last line those of the move beside it, which is how the wire comes and goes
    on."""
    ends = np.stack([move_across(lines, lines.start[:-1]), move_across(lines, lines.end[:-1])], axis=1)
    quick = fastest(lines, box)[1:]
    quick = np.where(np.isfinite(quick), quick, ends.max(axis=1))
    gone = np.concatenate([[0.0], np.cumsum(np.maximum(quick, 1e-12))])
    low = np.minimum(np.concatenate([gone[:1], gone[:-1]]), gone - MELTED_WAY).clip(gone[0])
    high = np.maximum(np.concatenate([gone[1:], gone[-1:]]), gone + MELTED_WAY).clip(None, gone[-1])
    out = np.empty((len(lines), 2))
    for k in range(2):
        way = np.concatenate([[0.0], np.cumsum(ends[:, k])])
        out[:, k] = feed * (np.interp(high, gone, way) - np.interp(low, gone, way)) / (high - low)
    for row, move in ((0, 0), (-1, -1)):
        if quick[move] > LEAST_MOVE:
            out[row] = feed * ends[move] / quick[move]
    return out


def _clear_of_inner_corners(made: Beside) -> BoolArray:
    """Wires (N,) to keep: near an inner corner, sides are left out that the other side's wire has cut off."""
    lines, foot = made.lines, made.row.foot
    keep = np.ones(len(lines), dtype=np.bool_)
    for j in np.flatnonzero(made.row.turn.min(axis=1) < -FLAT_TURN).tolist():
        for step in (-1, 1):
            i = j + step
            while 0 <= i < len(lines):
                if not 0 <= i + step < len(lines):
                    break
                if (np.abs(made.row.turn[i]) > FLAT_TURN).any() or _beyond(
                    lines, foot, j, i, step, made.half
                ):
                    break
                keep[i] = False
                i += step
    return keep


def _beyond(lines: Lines, foot: Lines, j: int, i: int, step: int, half: FloatArray) -> bool:
    """Whether wire i lies on its own side of the inner corner j at both ends."""
    for ends, feet, end in ((lines.start, foot.start, 0), (lines.end, foot.end, 1)):
        way = feet[j + step] - feet[j]
        length = np.linalg.norm(way)
        if length > 1e-9 and (ends[i] - ends[j]) @ way / length < 0.2 * half[j, end]:
            return False
    return True


NEARER_SHARE: Final = 0.1
"""Share of the tolerance by which wires beside a smooth surface may be nearer to it than half a slot."""
RULING_SPACING: Final = 5e-4
"""[m] distance of the rulings at which a surface is looked at."""
QUARTER_PIECES: Final = 64
"""Pieces of a quarter of an arc that lines are widened by."""
LEFT_SHARE: Final = 0.03
"""Share of the tolerance at which foam that stays begins."""
LOOP_FACTOR: Final = 3.0
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
    bad = np.asarray((near < made.half - NEARER_SHARE * tolerance).any(axis=1))
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
        if way > LOOP_FACTOR * float(made.half[before].max()) + 2.0 * left:
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
class FoamLeft:
    """Foam that stays in one place: ``depth`` [m] at most, at ``point`` (3,) of the surface; ``volume``
    [m^3]."""

    depth: float
    point: FloatArray
    volume: float


def foam_left(made: Beside, ruled: Ruled, tolerance: float, box: FloatArray) -> list[FoamLeft]:
    """What the wires leave on the surface because they are round, deeper than ``tolerance`` [m], the deepest
    first."""
    fine, lines = _dense(ruled), made.lines
    depth = np.empty((len(fine), 2))
    for k, (points, ends) in enumerate(((fine.start, lines.start), (fine.end, lines.end))):
        near = cKDTree(ends).query(points)[1]
        depth[:, k] = distance_to_polyline(points, ends) - made.half[near, k]
    half = float(made.half.mean())
    found: list[FoamLeft] = []
    for rows in _runs(depth.max(axis=1) > LEFT_SHARE * tolerance, ruled.closed):
        k = int(rows[int(np.argmax(depth[rows].max(axis=1)))])
        deep = float(depth[k].max())
        if deep > tolerance:
            found.append(
                FoamLeft(deep, fine.start[k], _volume(fine, k, half, deep, lines, box, ruled.closed))
            )
    return sorted(found, key=lambda one: -one.depth)


def _dense(ruled: Ruled) -> Lines:
    """The rulings (M) of a surface, and such between them that both ends are ``RULING_SPACING`` apart at
    most."""
    a, b = guides(ruled)
    way = np.maximum(*(np.linalg.norm(np.diff(p, axis=0), axis=1) for p in (a, b)))
    count = np.maximum(np.ceil(way / RULING_SPACING).astype(np.intp), 1)
    row = np.repeat(np.arange(len(count)), count)
    share = ((np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / count[row])[:, None]
    start, end = (p[row] + share * (p[row + 1] - p[row]) for p in (a, b))
    if ruled.closed:
        return Lines(start, end)
    return Lines(np.concatenate([start, a[-1:]]), np.concatenate([end, b[-1:]]))


def _runs(chosen: BoolArray, closed: bool) -> Iterator[IndexArray]:
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
    wide = int(np.ceil((3.0 * half + 2.0 * deep) / RULING_SPACING))
    rows = np.arange(k - wide, k + wide + 1)
    rows = rows % len(fine) if closed else rows[(rows >= 0) & (rows < len(fine))]
    line = 0.5 * (fine.start + fine.end)[rows] @ plane
    here = 0.5 * (fine.start + fine.end)[k] @ plane
    wires = 0.5 * (lines.start + lines.end) @ plane
    to = wires[int(np.argmin(np.linalg.norm(wires - here, axis=1)))] - here
    filled = (
        shapely.LineString(line)
        .buffer(half, quad_segs=QUARTER_PIECES)
        .buffer(-half, quad_segs=QUARTER_PIECES)
    )
    inside = shapely.Point(here + 0.3 * deep * to / max(float(np.linalg.norm(to)), 1e-12))
    area = sum(piece.area for piece in shapely.get_parts(filled) if piece.distance(inside) < 0.1 * deep)
    first, last = chord(fine[[k]], box)
    return float(area * np.nan_to_num(last - first)[0])


WIRE_SHARES: Final = np.linspace(0.0, 1.0, 9)
"""Places along the wire, between its guide points, at which its slot is looked at."""
SLOWED_SPACING: Final = 2e-4
"""[m] spacing of places where a clock tells how slow the wire is in a corner."""
SLOT_SPACING: Final = 7e-4
"""[m] ways between looks."""
MOST_HALVINGS: Final = 4
"""So often ways between wires are halved."""
INNER_SHARE: Final = 0.4
"""Share of the tolerance that is well within it."""


@dataclasses.dataclass(frozen=True)
class Melted:
    """Wires (N) as they pass, ``number`` (N,) of the line that each comes to; ``half`` and ``speed`` (N, 9)
    [m], [m/s]: half their slots at ``WIRE_SHARES`` and their speeds across themselves there."""

    lines: Lines
    number: IndexArray
    speed: FloatArray
    half: FloatArray

    def some(self, rows: BoolArray) -> "Melted":
        """Those of ``rows`` (N,)."""
        return Melted(self.lines[rows], self.number[rows], self.speed[rows], self.half[rows])

    def into(self, guides: tuple[FloatArray, FloatArray]) -> FloatArray:
        """How much nearer (N, 2) [m] than half their slots wires are to the guide lines (M, 3)."""
        near = [
            distance_to_polyline(*pair)
            for pair in zip((self.lines.start, self.lines.end), guides, strict=True)
        ]
        return np.asarray(self.half[:, [0, -1]] - np.stack(near, axis=1))

    def off(self, guides: tuple[FloatArray, FloatArray]) -> FloatArray:
        """How far (N, 2) [m] wires are off half their slots from the guide lines (M, 3)."""
        return np.abs(self.into(guides))


def melted(
    lines: Lines, kerf: KerfCurve, feed: float, box: FloatArray, clock: FloatArray | None = None
) -> Melted:
    """The wires at lines (N) and on the straight ways between them, when the fastest point in the foam goes
    at ``feed`` [m/s], or at the times [s] of places by ``clock`` (2, K): 3.5 is half way from line 3 to line
    4."""
    lines, number = _finer(lines, box, SLOT_SPACING if clock is None else SLOWED_SPACING)
    time = None
    if clock is not None:
        count = np.bincount(number)
        share = (np.arange(len(number)) - np.cumsum(count)[number] + 1) / count[number]
        time = np.interp(number + share, *clock)
    speed = _speeds(lines, feed, box, time)
    return Melted(lines, number, speed, 0.5 * kerf.at(speed))


def followed(
    row: Row, wanted: Ruled, kerf: KerfCurve, feed: float, box: FloatArray, allowed: tuple[float, float]
) -> Beside:
    """The wires beside a surface, with none where its slot cannot reach, and more of them where the slot
    grows and shrinks on the way from one to the next, until all are well within the tolerance of half of it.
    ``allowed`` [m]: that tolerance, and how deep foam may stay."""
    lines, tolerance = guides(wanted), allowed[0]

    def tried(row: Row) -> tuple[Beside, IndexArray, FloatArray]:
        made = beside(row, kerf, feed, box)
        passed = melted(made.lines, kerf, feed, box)
        return made, passed.number, passed.off(lines).max(axis=1)

    best = tried(row)
    without = unlooped(best[0], wanted, *allowed)
    best = best if without is None else tried(without)
    for _ in range(MOST_HALVINGS):
        made, number, off = best
        to = np.unique(number[(off > INNER_SHARE * tolerance) & (number > 0)])
        if not len(to):
            break
        other = tried(_halved(made.row, to))
        if other[2].max() >= off.max():  # what slows down for a wider slot may melt a wider one yet
            break
        best = other
    return best[0]


def _halved(row: Row, to: IndexArray) -> Row:
    """The row with wires halfway to those numbered ``to`` (K,): normals are meant with the feet, so that
    the wire stays on the straight way beside a flat piece."""
    foot = [np.insert(p, to, 0.5 * (p[to - 1] + p[to]), axis=0) for p in (row.foot.start, row.foot.end)]
    normal = np.insert(row.normal, to, 0.5 * (row.normal[to - 1] + row.normal[to]), axis=0)
    return Row(Lines(*foot), normal, np.insert(row.turn, to, 0.0, axis=0))


def _finer(lines: Lines, box: FloatArray, spacing: float) -> tuple[Lines, IndexArray]:
    """Lines with such between them that no guide point, and nothing in the box, moves farther than
    ``spacing`` [m] from one to the next, and which of the given ones (N,) each comes to."""
    way = [np.linalg.norm(np.diff(ends, axis=0), axis=1) for ends in (lines.start, lines.end)]
    way.append(np.nan_to_num(fastest(lines, box)[1:]))
    count = np.maximum(np.ceil(np.max(way, axis=0) / spacing).astype(np.intp), 1)
    to = np.repeat(np.arange(1, len(lines)), count)
    step = np.arange(len(to)) - np.repeat(np.cumsum(count) - count, count) + 1
    share = (step / count[to - 1])[:, None]
    ends = [p[to - 1] + share * (p[to] - p[to - 1]) for p in (lines.start, lines.end)]
    return join([lines[:1], Lines(*ends)]), np.concatenate([[0], to])


def _speeds(lines: Lines, feed: float, box: FloatArray, time: FloatArray | None) -> FloatArray:
    """Speeds (N, 9) [m/s] across the wire when the fastest point in the box moves at ``feed``, or at times
    (N,) [s], meant over ``MELTED_WAY`` of its way either way."""
    at = [lines.start + share * (lines.end - lines.start) for share in WIRE_SHARES]
    moves = np.stack([move_across(lines, points[:-1]) for points in at], axis=1)
    quick = fastest(lines, box)[1:]
    quick = np.where(np.isfinite(quick), quick, moves.max(axis=1))
    gone = np.concatenate([[0.0], np.cumsum(np.maximum(quick, 1e-12))])
    low, high = (gone - MELTED_WAY).clip(gone[0]), (gone + MELTED_WAY).clip(None, gone[-1])
    way = np.concatenate([np.zeros((1, len(WIRE_SHARES))), np.cumsum(moves, axis=0)])
    over = [np.interp(high, gone, w) - np.interp(low, gone, w) for w in way.T]
    time = gone / feed if time is None else time
    took = np.interp(high, gone, time) - np.interp(low, gone, time)
    return np.asarray(np.stack(over, axis=1) / np.maximum(took, 1e-9)[:, None])
