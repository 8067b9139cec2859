"""One cut from air to air: the way in through the foam, the wires beside the surface, the way out."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import KerfCurve
from planner.geometry.rulings import resample
from planner.hotwire.straight_even import followed
from planner.hotwire.straight_leads import Start, choose
from planner.hotwire.straight_lines import Lines, exit_length, fastest, grown, join
from planner.hotwire.straight_offset import SHARPEST, Beside, Row, make_row
from planner.hotwire.straight_operation import Straight, SurfaceCut, TrimCut
from planner.hotwire.straight_order import Wanted
from planner.problem import Ruled
from planner.targets import FEED_SHARE
from planner.units import MM

FloatArray = NDArray[np.float64]

CHORD: Final = 0.1
"""Share of the tolerance that straight moves between rulings may cost."""
SHARE: Final = 0.6
"""Share of the tolerance that corners of the polygon around a convex corner may cost."""
LEAST_LEAD: Final = 2e-3
"""[m] least way in and out, where the surface itself begins in the air."""
PLAIN: Final = 3.0
"""Where the wire only goes straight on (sides of the block, ways in and out) steps are longer by this."""
THROUGH: Final = 1e-3
"""[m] the wire's surface is out of the block by this where it turns to go back through its slot."""


@dataclasses.dataclass(frozen=True)
class Cut:
    """A cut: ``into``, ``on`` and ``out`` in order. ``start`` is None for an open strip. ``turns``: number of
    lines of ``out`` after which the wire stands, in the air, and goes back through its slot; 0 for none."""

    wanted: Wanted
    into: Lines
    on: Beside
    out: Lines
    start: Start | None
    turns: int = 0


def make_cut(
    op: Straight,
    wanted: Wanted,
    contours: tuple[Ruled, ...],
    kerf: KerfCurve,
    radius: float,
    box: FloatArray,
    up: FloatArray,
    down: FloatArray | None = None,
) -> Cut:
    """The cut of one surface in the block ``box`` (2, 3); ``radius`` [m] is the wire's, ``contours`` are all
    closed surfaces of the part; ``up`` and ``down`` as for :func:`planner.hotwire.straight_leads.choose`."""
    step, feed = op.step_mm * MM, FEED_SHARE * op.feed(wanted.cut)
    plain = step * PLAIN
    step = plain if isinstance(wanted.cut, TrimCut) else step
    ruled = resample(wanted.ruled, CHORD * op.shape_tol_mm * MM, step)
    start = None
    if wanted.ruled.closed and isinstance(wanted.cut, SurfaceCut):
        start = choose(ruled, contours, wanted.cut, box, up, down)
    allowed = op.shape_tol_mm * MM, op.left_mm * MM
    sharpest = _sharpest(0.5 * float(kerf.at(np.array([feed]))[0]), allowed[0])
    on = followed(_row(ruled, wanted, start, sharpest), wanted.ruled, kerf, feed, box, allowed)
    gone = fastest(on.lines, box)
    longest = float(np.nanmax(gone, initial=0.0))
    if longest > 1.05 * step and on.settled:  # the wire in the foam moves farther than its guide points
        ruled = resample(wanted.ruled, CHORD * op.shape_tol_mm * MM, step * step / longest)
        if start is not None and isinstance(wanted.cut, SurfaceCut):
            start = choose(ruled, contours, wanted.cut, box, up, down)
        on = followed(_row(ruled, wanted, start, sharpest), wanted.ruled, kerf, feed, box, allowed)
    clear = op.margin_mm * MM + radius
    if start is not None:
        return _closed(wanted, on, start, plain, clear, box)
    return _open(wanted, on, plain, clear, radius, box)


def _row(ruled: Ruled, wanted: Wanted, start: Start | None, sharpest: float) -> Row:
    if start is not None:
        return make_row(ruled, start.first, start.backward, sharpest)
    return make_row(ruled, 0, wanted.cut.reverse, sharpest)


def _sharpest(half: float, tolerance: float) -> float:
    """The largest turn [rad] at one vertex around a convex corner, at which the wire stands off by 1 / cos of
    half of it: no more than ``SHARE`` of the tolerance [m] farther than ``half`` a slot."""
    return float(min(SHARPEST, 2.0 * np.arccos(half / (half + SHARE * tolerance))))


def _closed(wanted: Wanted, on: Beside, start: Start, step: float, clear: float, box: FloatArray) -> Cut:
    """In through the slit, beyond the first corner by half a kerf on both sides of it, and out again."""
    legs = []
    for k, after in ((0, 1), (-1, -2)):
        corner = _gap(on) > 0.5 * float(on.half[k].max())
        end = _beyond(on, k, after) if corner else on.lines[[k]]
        leg = _straight(end, start.way, step, clear, box)
        legs.append(join([end, leg]) if corner else leg)
    return Cut(wanted, legs[0].reversed(), on, legs[1], start)


def _beyond(on: Beside, k: int, after: int) -> Lines:
    """The wire (1) beyond line ``k``, farther on by half its kerf: both ends at their own speeds, so that the
    slot keeps its width up to the end of the surface."""
    lines = on.lines
    move = np.stack([lines.start[k] - lines.start[after], lines.end[k] - lines.end[after]])
    move *= float(on.half[k].max()) / max(float(np.linalg.norm(move, axis=1).max()), 1e-12)
    return Lines(lines.start[[k]] + move[0], lines.end[[k]] + move[1])


def _gap(on: Beside) -> float:
    """Distance [m] between the first and the last wire of a closed cut, which are apart at a corner."""
    lines = on.lines
    return float(
        np.linalg.norm(lines.start[0] - lines.start[-1]) + np.linalg.norm(lines.end[0] - lines.end[-1])
    )


def _open(wanted: Wanted, on: Beside, step: float, clear: float, radius: float, box: FloatArray) -> Cut:
    """Straight on from both ends of the strip, or back through the slot."""
    lines = on.lines
    ends = [_beyond(on, 0, 1), _beyond(on, -1, -2)]
    first, last = _way(on.row.foot, 0, 1), _way(on.row.foot, -1, -2)
    if isinstance(wanted.cut, SurfaceCut) and wanted.cut.lead != "auto":
        first = -_across(np.array(wanted.cut.lead), lines.direction[0])
    into = join([ends[0], _straight(ends[0], -first, step, clear, box)]).reversed()
    if wanted.cut.leave == "onwards":
        return Cut(wanted, into, on, join([ends[1], _straight(ends[1], -last, step, clear, box)]), None)
    through = radius + float(on.half[-1].max()) + THROUGH
    away = join([ends[1], _straight(ends[1], -last, step, through, box)])
    out = join([away, away.reversed()[1:], lines.reversed(), into.reversed()])
    return Cut(wanted, into, on, out, None, len(away))


def _way(foot: Lines, k: int, next_one: int) -> FloatArray:
    """Unit vector (3,) from ruling ``k`` to ``next_one``, across the wire."""
    move = foot.start[next_one] - foot.start[k] + foot.end[next_one] - foot.end[k]
    return _across(move, foot.direction[k])


def _across(way: FloatArray, direction: FloatArray) -> FloatArray:
    way = way - (way @ direction) * direction
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))


def _straight(line: Lines, way: FloatArray, step: float, clear: float, box: FloatArray) -> Lines:
    """Wires from one (1) along ``way`` (3,) until it is ``clear`` [m] of the block, at most ``step`` apart,
    the first one left out."""
    length = max(float(exit_length(line, way[None], grown(box, clear))[0]), LEAST_LEAD)
    count = max(1, int(np.ceil(length / step - 1e-9)))
    share = length * np.arange(1, count + 1) / count
    return Lines(line.start + share[:, None] * way, line.end + share[:, None] * way)
