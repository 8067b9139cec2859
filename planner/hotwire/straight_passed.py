"""What must hold of a planned straight wire on its way: the slot that it melts all along itself and between
its guide points, held against the surface and the usable widths."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import KerfCurve
from planner.hotwire.straight_cut import Cut
from planner.hotwire.straight_even import SHARES, Melted, melted
from planner.hotwire.straight_inner import guides, stays
from planner.hotwire.straight_lines import join
from planner.hotwire.straight_operation import Straight
from planner.issues import Issue, Severity
from planner.targets import FEED_SHARE
from planner.units import MM

FloatArray = NDArray[np.float64]

TOLD: Final = 4
"""So many places are named."""
SPARE: Final = 0.95
"""Share of the tolerance that a plan may use up: controllers round the speed at corners."""


def check_passed(op: Straight, cut: Cut, kerf: KerfCurve, box: FloatArray) -> Iterator[Issue]:
    """``straight.uneven`` where the slot grows and shrinks so fast that the wire does not keep half of it off
    the surface, ``kerf.too_hot`` and ``kerf.too_cold`` where it does so between the guide points."""
    feed, count = FEED_SHARE * op.feed(cut.wanted.cut), len(cut.on.lines)
    out = cut.out[: cut.turns] if cut.turns else cut.out
    ahead = cut.into[-2:]
    whole = melted(join([ahead, cut.on.lines, out[:2]]), kerf, feed, box)
    number = whole.number - len(ahead)
    own = (number > 0) & (number < count)
    own[np.flatnonzero(number == 0)[-1:]] = True  # what comes to the first wire is still on the way in
    passed = Melted(whole.lines[own], number[own], whole.speed[own], whole.half[own])
    low, high = op.kerf_range_mm
    at_guides = 2.0 * cut.on.half / MM
    if op.power_w is not None:
        if not low <= at_guides.min() <= at_guides.max() <= high:
            return  # it is uneven since it is too hot or too cold somewhere, which is told with advice
        yield from _width(op, cut, passed)
    yield from _off(op, cut, passed)


def check_driven(
    op: Straight, cut: Cut, kerf: KerfCurve, box: FloatArray, clock: FloatArray
) -> Iterator[Issue]:
    """As :func:`check_passed`, at the times ``clock`` (N,) [s] of the wires on the surface that the arms can
    keep."""
    passed = melted(cut.on.lines, kerf, op.feed(cut.wanted.cut), box, clock)
    why = "the arm cannot turn the bow as fast as the feed asks for, so that it melts a wider slot"
    if op.power_w is not None:
        yield from _width(op, cut, passed)
        yield from _off(op, cut, passed, why)


def check_inner(op: Straight, cut: Cut, box: FloatArray) -> Iterator[Issue]:
    """``straight.corner``: what a round wire leaves in inner corners and curves, as a note, or refused where
    it is deeper than the operation allows."""
    left = stays(cut.on, cut.wanted.ruled, op.shape_tol_mm * MM, box)
    if not left:
        return
    deep = left[0].depth / MM
    volume = sum(one.volume for one in left) / MM**3
    places = ", ".join(_point(one.point) for one in left[:TOLD])
    more = f" and {len(left) - TOLD} more places" if len(left) > TOLD else ""
    what = (
        f"{op.name}: the wire is round and leaves foam in inner corners of {cut.wanted.segment}, "
        f"{deep:.2f} mm deep at most, {volume:.0f} mm3 in all, at {places}{more}"
    )
    over = deep > op.left_mm
    yield Issue(
        "straight.corner",
        f"{what}; allowed: {op.left_mm:g} mm (left_mm): take a thinner slot, round the corner, or allow more"
        if over
        else f"{what}; cut it off by hand, take a thinner slot or round the corner",
        Severity.ERROR if over else Severity.NOTE,
        field=str(cut.wanted.segment),
        value=deep,
        limit=op.left_mm,
        unit="mm",
    )


def _width(op: Straight, cut: Cut, passed: Melted) -> Iterator[Issue]:
    """The slot between the guide points is neither burnt nor dragged."""
    low, high = op.kerf_range_mm
    width = 2.0 * passed.half / MM
    for code, k, limit, words in (
        ("kerf.too_hot", int(np.argmax(width)), high, "burns the foam; cut faster or with less power"),
        ("kerf.too_cold", int(np.argmin(width)), low, "is too cold and drags; cut slower or with more power"),
    ):
        value = float(width.ravel()[k])
        if (value > limit) if code == "kerf.too_hot" else (value < limit):
            row, column = np.unravel_index(k, width.shape)
            speed = float(passed.speed[row, column]) / MM
            yield Issue(
                code,
                f"{op.name}: on {cut.wanted.segment} the wire turns on its way; at {speed:.2f} mm/s, at "
                f"{_place(passed, int(row), float(SHARES[column]))}, it melts {value:.2f} mm and {words}",
                field="operations.power_w",
                value=value,
                limit=limit,
                unit="mm",
            )


def _off(op: Straight, cut: Cut, passed: Melted, why: str = "") -> Iterator[Issue]:
    """All along its way, and all along itself but for the share that may be out, the wire is half its slot
    off the surface."""
    allowed = op.shape_tol_mm * MM
    off = passed.off(guides(cut.wanted.ruled))
    row, end = np.unravel_index(int(np.argmax(off)), off.shape)
    worst, where = float(off[row, end]), _place(passed, int(row), float(end))
    between = passed.half[:, :1] + SHARES * (passed.half[:, -1:] - passed.half[:, :1])
    inside = np.abs(passed.half - between)
    if worst <= SPARE * allowed and (inside > allowed).mean() > SPARE * (1.0 - op.share):
        row, column = np.unravel_index(int(np.argmax(inside)), inside.shape)
        worst, where = float(inside[row, column]), _place(passed, int(row), float(SHARES[column]))
    why = why or "the wire slows down and melts its slot wider faster than it can move aside"
    # wires are laid as coarsely as the tolerance lets them, so that what is missing grows with it
    remedy = "take less power, which evens the slot, or a shape_tol_mm of some times as much"
    if op.power_w is None:
        why = "the wire does not follow the surface"
        remedy = "take a shape_tol_mm of some times as much, or a smaller step_mm"
    if worst > SPARE * allowed:
        yield Issue(
            "straight.uneven",
            f"{op.name}: on {cut.wanted.segment} {why}, at {where}: {worst / MM:.2f} mm are missing or left; "
            f"{remedy}",
            field=str(cut.wanted.segment),
            value=worst / MM,
            limit=allowed / MM,
            unit="mm",
        )


def _place(passed: Melted, row: int, share: float) -> str:
    return _point((1.0 - share) * passed.lines.start[row] + share * passed.lines.end[row])


def _point(point: FloatArray) -> str:
    return "[" + ", ".join(f"{value / MM:.1f}" for value in point) + "] mm"
