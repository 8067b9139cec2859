"""The wire beside a ruled surface: every end of every ruling moved outward by half of its own kerf.

A convex corner is passed on a polygon around the circle of half a kerf, which nowhere comes nearer to the
part; an inner corner is passed through the point that is half a kerf from both its sides.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import KerfCurve
from planner.geometry.rulings import outward_sides
from planner.hotwire.straight_lines import Lines, fastest, move_across
from planner.problem import Ruled

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
Damping = tuple[tuple[float, int], ...]

SHARPEST: Final = np.deg2rad(60.0)
"""Largest turn at one vertex of the polygon around a convex corner: it stays within 1 / cos 30 deg of half a
kerf."""
FLAT: Final = np.deg2rad(2.0)
"""A turn below this needs no vertices of its own."""
CUSP: Final = np.deg2rad(175.0)
"""A turn beyond this is a cusp of the part: the wire goes round it, whatever the sign says."""
SETTLED: Final = 1e-7
"""[m] half kerfs have settled where one more round moves none of them by more."""
DAMPING: Final[Damping] = ((0.5, 60), (0.25, 120), (0.1, 300), (0.05, 600))
"""The kerf follows from the speed, the speed from the way, and the way from the kerf: of the step between the
logarithms of two rounds so much is taken, in at most so many rounds; where that is too much to settle, less
from the beginning. A wide slot drives its end on, which makes it narrow: whole steps swing for ever around a
blunt edge at one end and a sharp one at the other."""
STILL: Final = 1e-5
"""[m] shorter moves say nothing of a speed."""
MELTED: Final = 1e-3
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

    def __getitem__(self, rows: BoolArray) -> Row:
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


def make_row(ruled: Ruled, first: int = 0, backward: bool = False, sharpest: float = SHARPEST) -> Row:
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
    return np.asarray(np.where(np.abs(angle) > CUSP, np.abs(angle), sense * angle))


def _with_vertices(foot: Lines, before: FloatArray, turn: FloatArray, sense: float, sharpest: float) -> Row:
    """The row with as many vertices at every corner as its turn needs."""
    largest = np.abs(turn).max(axis=1)
    inner = turn.min(axis=1) < -FLAT
    parts = np.where(inner | (largest < FLAT), 1, np.ceil(largest / sharpest)).astype(np.intp)
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
            if np.abs(wanted - half).max() <= SETTLED:
                return Beside(row, half, speed)
            half = half * (wanted / half) ** share
    speed = end_speeds(row.lines(first), feed, box)
    return Beside(row, 0.5 * kerf.at(speed), speed, False)


def end_speeds(lines: Lines, feed: float, box: FloatArray) -> FloatArray:
    """Speeds (N, 2) [m/s] of starts and ends across the wire, meant over the moves to and from each line,
    or over more of them up to ``MELTED`` either way, when the fastest point in the box moves at ``feed``; at
    the first and last line those of the move beside it, which is how the wire comes and goes on."""
    ends = np.stack([move_across(lines, lines.start[:-1]), move_across(lines, lines.end[:-1])], axis=1)
    quick = fastest(lines, box)[1:]
    quick = np.where(np.isfinite(quick), quick, ends.max(axis=1))
    gone = np.concatenate([[0.0], np.cumsum(np.maximum(quick, 1e-12))])
    low = np.minimum(np.concatenate([gone[:1], gone[:-1]]), gone - MELTED).clip(gone[0])
    high = np.maximum(np.concatenate([gone[1:], gone[-1:]]), gone + MELTED).clip(None, gone[-1])
    out = np.empty((len(lines), 2))
    for k in range(2):
        way = np.concatenate([[0.0], np.cumsum(ends[:, k])])
        out[:, k] = feed * (np.interp(high, gone, way) - np.interp(low, gone, way)) / (high - low)
    for row, move in ((0, 0), (-1, -1)):
        if quick[move] > STILL:
            out[row] = feed * ends[move] / quick[move]
    return out


def _clear_of_inner_corners(made: Beside) -> BoolArray:
    """Wires (N,) to keep: near an inner corner, sides are left out that the other side's wire has cut off."""
    lines, foot = made.lines, made.row.foot
    keep = np.ones(len(lines), dtype=np.bool_)
    for j in np.flatnonzero(made.row.turn.min(axis=1) < -FLAT).tolist():
        for step in (-1, 1):
            i = j + step
            while 0 <= i < len(lines):
                if not 0 <= i + step < len(lines):
                    break
                if (np.abs(made.row.turn[i]) > FLAT).any() or _beyond(lines, foot, j, i, step, made.half):
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
