"""What a planned wire melts all along itself, at and between its guide points: a wire that turns on its way
goes slowly where it turns about, so that its slot grows wide there, though both its ends are fast.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import KerfCurve
from planner.hotwire.straight_inner import guides, unlooped
from planner.hotwire.straight_lines import Lines, distance_to_polyline, fastest, join, move_across
from planner.hotwire.straight_offset import MELTED, Beside, Row, beside
from planner.problem import Ruled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

SHARES: Final = np.linspace(0.0, 1.0, 9)
"""Places along the wire, between its guide points, at which its slot is looked at."""
FINE: Final = 7e-4
"""[m] ways between looks."""
ROUNDS: Final = 4
"""So often ways between wires are halved."""
WELL: Final = 0.4
"""Share of the tolerance that is well within it."""


@dataclasses.dataclass(frozen=True)
class Melted:
    """Wires (N) as they pass, ``number`` (N,) of the line that each comes to; ``half`` and ``speed`` (N, 9)
    [m], [m/s]: half their slots at ``SHARES`` and their speeds across themselves there."""

    lines: Lines
    number: IntArray
    speed: FloatArray
    half: FloatArray

    def off(self, guides: tuple[FloatArray, FloatArray]) -> FloatArray:
        """How far (N, 2) [m] wires are off half their slots from the guide lines (M, 3)."""
        near = [
            distance_to_polyline(*pair)
            for pair in zip((self.lines.start, self.lines.end), guides, strict=True)
        ]
        return np.asarray(np.abs(np.stack(near, axis=1) - self.half[:, [0, -1]]))


def melted(
    lines: Lines, kerf: KerfCurve, feed: float, box: FloatArray, clock: FloatArray | None = None
) -> Melted:
    """The wires at lines (N) and on the straight ways between them, when the fastest point in the foam goes
    at ``feed`` [m/s], or at the times ``clock`` (N,) [s] of the lines."""
    lines, number = _finer(lines, box)
    time = None
    if clock is not None:
        count = np.bincount(number)
        share = (np.arange(len(number)) - np.cumsum(count)[number] + 1) / count[number]
        time = clock[number] + share * np.diff(clock, prepend=clock[0])[number]
    speed = _speeds(lines, feed, box, time)
    return Melted(lines, number, speed, 0.5 * kerf.at(speed))


def followed(
    row: Row, wanted: Ruled, kerf: KerfCurve, feed: float, box: FloatArray, allowed: tuple[float, float]
) -> Beside:
    """The wires beside a surface, with none where its slot cannot reach, and more of them where the slot
    grows and shrinks on the way from one to the next, until all are well within the tolerance of half of it.
    ``allowed`` [m]: that tolerance, and how deep foam may stay."""
    lines, tolerance = guides(wanted), allowed[0]

    def tried(row: Row) -> tuple[Beside, IntArray, FloatArray]:
        made = beside(row, kerf, feed, box)
        passed = melted(made.lines, kerf, feed, box)
        return made, passed.number, passed.off(lines).max(axis=1)

    best = tried(row)
    without = unlooped(best[0], wanted, *allowed)
    best = best if without is None else tried(without)
    for _ in range(ROUNDS):
        made, number, off = best
        to = np.unique(number[(off > WELL * tolerance) & (number > 0)])
        if not len(to):
            break
        other = tried(_halved(made.row, to))
        if other[2].max() >= off.max():  # what slows down for a wider slot may melt a wider one yet
            break
        best = other
    return best[0]


def _halved(row: Row, to: IntArray) -> Row:
    """The row with wires halfway to those numbered ``to`` (K,): normals are meant with the feet, so that
    the wire stays on the straight way beside a flat piece."""
    foot = [np.insert(p, to, 0.5 * (p[to - 1] + p[to]), axis=0) for p in (row.foot.start, row.foot.end)]
    normal = np.insert(row.normal, to, 0.5 * (row.normal[to - 1] + row.normal[to]), axis=0)
    return Row(Lines(*foot), normal, np.insert(row.turn, to, 0.0, axis=0))


def _finer(lines: Lines, box: FloatArray) -> tuple[Lines, IntArray]:
    """Lines with such between them that no guide point, and nothing in the box, moves farther than ``FINE``
    from one to the next, and which of the given ones (N,) each comes to."""
    way = [np.linalg.norm(np.diff(ends, axis=0), axis=1) for ends in (lines.start, lines.end)]
    way.append(np.nan_to_num(fastest(lines, box)[1:]))
    count = np.maximum(np.ceil(np.max(way, axis=0) / FINE).astype(np.intp), 1)
    to = np.repeat(np.arange(1, len(lines)), count)
    step = np.arange(len(to)) - np.repeat(np.cumsum(count) - count, count) + 1
    share = (step / count[to - 1])[:, None]
    ends = [p[to - 1] + share * (p[to] - p[to - 1]) for p in (lines.start, lines.end)]
    return join([lines[:1], Lines(*ends)]), np.concatenate([[0], to])


def _speeds(lines: Lines, feed: float, box: FloatArray, time: FloatArray | None) -> FloatArray:
    """Speeds (N, 9) [m/s] across the wire when the fastest point in the box moves at ``feed``, or at times
    (N,) [s], meant over ``MELTED`` of its way either way."""
    at = [lines.start + share * (lines.end - lines.start) for share in SHARES]
    moves = np.stack([move_across(lines, points[:-1]) for points in at], axis=1)
    quick = fastest(lines, box)[1:]
    quick = np.where(np.isfinite(quick), quick, moves.max(axis=1))
    gone = np.concatenate([[0.0], np.cumsum(np.maximum(quick, 1e-12))])
    low, high = (gone - MELTED).clip(gone[0]), (gone + MELTED).clip(None, gone[-1])
    way = np.concatenate([np.zeros((1, len(SHARES))), np.cumsum(moves, axis=0)])
    over = [np.interp(high, gone, w) - np.interp(low, gone, w) for w in way.T]
    time = gone / feed if time is None else time
    took = np.interp(high, gone, time) - np.interp(low, gone, time)
    return np.asarray(np.stack(over, axis=1) / np.maximum(took, 1e-9)[:, None])
