"""Whether a cut's slot is right at both ends of the wire, and at which power or feed it would be.

A slot follows from power over speed, so that one factor on both ends' heat stands for more power as well as
for less feed. Advice is found by trying factors on the cuts' own rows, and tried once more on whole cuts,
made anew, before it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import KerfCurve
from planner.hotwire.straight_cut import Cut
from planner.hotwire.straight_offset import DAMPING, beside
from planner.hotwire.straight_operation import Straight
from planner.issues import Issue
from planner.targets import FEED_SHARE
from planner.units import MM

FloatArray = NDArray[np.float64]

LEAST: Final = 1.0 / 64.0
"""Heats between this share of the given one and its inverse are tried."""
HALVINGS: Final = 8
"""So often the interval between a heat that is right and one that is not is halved: to 4 %."""
ENDS: Final = ("start", "end")

Remake = Callable[[Straight], list[Cut]]
"""All cuts of an operation, made for its power and feed."""
Slots = Callable[[Straight], KerfCurve]
"""The slot over the speed, for the operation's power."""


def check_heat(
    op: Straight, cuts: list[Cut], box: FloatArray, slots: Slots, remake: Remake, most: float
) -> Iterator[Issue]:
    """kerf.too_hot, kerf.too_cold and kerf.unsettled of the cuts of an operation with a power, in the block
    ``box`` (2, 3), with a power or feed that was tried where there is one; the wire bears ``most`` [W]."""
    if op.power_w is None:
        return
    found = [fault for cut in cuts for fault in _faults(op, cut)]
    if not found:
        return
    hint = _advice(op, cuts, box, slots, remake, most)
    for cut, code, row, end in found:
        yield _issue(op, cut, code, row, end, hint)


def _faults(op: Straight, cut: Cut) -> Iterator[tuple[Cut, str, int, int]]:
    """What is wrong with a cut's slot: the code, the row of the place and the wire's end there."""
    width = 2.0 * cut.on.half / MM
    low, high = op.kerf_range_mm
    widest, narrowest = (divmod(int(at), 2) for at in (np.argmax(width), np.argmin(width)))
    if width[widest] > high:
        yield cut, "kerf.too_hot", *widest
    if width[narrowest] < low:
        yield cut, "kerf.too_cold", *narrowest
    if not cut.on.settled and width.max() <= high and width.min() >= low:
        slowest = divmod(int(np.argmin(cut.on.speed)), 2)
        yield cut, "kerf.unsettled", *slowest


def _issue(op: Straight, cut: Cut, code: str, row: int, end: int, hint: str) -> Issue:
    speed, foot = cut.on.speed[row] / MM, cut.on.row.foot
    width = 2.0 * float(cut.on.half[row, end]) / MM
    point = (foot.start, foot.end)[end][row] / MM
    place = "[" + ", ".join(f"{value:.1f}" for value in point) + "] mm"
    low, high = op.kerf_range_mm
    wire = f"{op.name}: on {cut.wanted.segment} the {ENDS[end]} of the wire, at {speed[end]:.2f} mm/s"
    other = f"while its {ENDS[1 - end]} moves at {speed[1 - end]:.2f} mm/s"
    if code == "kerf.unsettled":
        what = f"{wire} at {place} {other}, has no slot that fits its own speed"
        return Issue(code, what, field="part", value=float(speed[end]), unit="mm/s", hint=hint)
    what, limit = ("burns the foam", high) if code == "kerf.too_hot" else ("drags: it is too cold", low)
    return Issue(
        code,
        f"{wire} at {place} {other}, melts {width:.2f} mm and {what}; allowed are {low:g} to {high:g} mm",
        field="operations.power_w",
        value=width,
        limit=limit,
        unit="mm",
        hint=hint,
    )


def _advice(
    op: Straight, cuts: list[Cut], box: FloatArray, slots: Slots, remake: Remake, bears: float
) -> str:
    """A power, and a feed, at which all slots are within the range; or that there is none."""
    power = op.power_w or 0.0
    top = min(1.0 / LEAST, 0.9 * bears / power)

    def widths(factor: float) -> tuple[float, float]:
        hot = _with(op, power=power * factor)
        curve = slots(hot)
        made = [
            beside(cut.on.row, curve, FEED_SHARE * hot.feed(cut.wanted.cut), box, DAMPING[:2]) for cut in cuts
        ]
        widest = max(2.0 * float(one.half.max()) / MM if one.settled else np.inf for one in made)
        return min(2.0 * float(one.half.min()) / MM for one in made), widest

    low, high = op.kerf_range_mm
    most = _edge(lambda factor: widths(factor)[1] <= high, LEAST, top)
    least = _edge(lambda factor: widths(factor)[0] >= low, top, LEAST)
    if most is not None and least is not None and least < most:
        tried = [text for text in _choices(op, least, most, remake) if text]
        if tried:
            return f"{' or '.join(tried)}, as was tried"
    if least is None or (most is None and widths(LEAST)[0] > high):
        share = f"{top:.3g} times the power" if least is None else "a 64th of the power"
        return f"even {share} is too {'little' if least is None else 'much'}: correct power_w or feed_mm_s"
    alike = (
        "let both ends move more alike: less taper, edges of one thickness at both ends (wing: "
        "trailing_edge_mm), rulings that join equal shares of both lines (wing: match: arc_length), or two "
        "panels instead of one"
    )
    if most is None:
        return f"no power and no feed mends that: one end nearly stands while the other goes on; {alike}"
    return (
        f"no power and no feed holds both ends: where the widest slot is {high:g} mm, at "
        f"{power * most:.3g} W, the narrowest is {widths(most)[0]:.2f} mm; {alike}"
    )


def _edge(good: Callable[[float], bool], inner: float, outer: float) -> float | None:
    """How far from ``inner`` towards ``outer`` a factor may go and is good, by halving; None where even
    ``inner`` is not."""
    if not good(inner):
        return None
    if good(outer):
        return outer
    for _ in range(HALVINGS):
        middle = float(np.sqrt(inner * outer))
        inner, outer = (middle, outer) if good(middle) else (inner, middle)
    return inner


def _choices(op: Straight, least: float, most: float, remake: Remake) -> Iterator[str]:
    """A power and a feed between two factors on the heat, in round figures, where whole cuts hold."""
    low, high = op.kerf_range_mm
    powers = [value * (op.power_w or 0.0) for value in (least, most)]
    feeds = [op.feed_mm_s / value for value in (most, least)]
    own = op.cuts != "all" and any(cut.feed_mm_s is not None for cut in op.cuts)
    for what, bounds, allowed in (
        ("power_w", powers, not powers[0] > 5000.0),
        ("feed_mm_s", [max(feeds[0], op.feed_min_mm_s), min(feeds[1], 200.0)], not own),
    ):
        value = _round(bounds[0], bounds[1]) if allowed and bounds[0] < bounds[1] else None
        if value is None:
            continue
        changed = _with(op, **{what.split("_", maxsplit=1)[0]: value})
        made = remake(changed)
        width = np.concatenate([2.0 * cut.on.half.ravel() for cut in made]) / MM
        if all(cut.on.settled for cut in made) and low <= width.min() and width.max() <= high:
            yield f"{what}: {value:g}, which melts {width.min():.2f} to {width.max():.2f} mm"


def _with(op: Straight, power: float | None = None, feed: float | None = None) -> Straight:
    """The operation with another power [W] or feed [mm/s]."""
    changes = {"power_w": power} if power is not None else {"feed_mm_s": feed}
    return op.model_copy(update=changes)


def _round(low: float, high: float) -> float:
    """A round figure near the middle of an interval."""
    middle = float(np.sqrt(low * high))
    for step in (5.0, 1.0, 0.5, 0.1, 0.05, 0.01):
        value = round(middle / step) * step
        if value > 0.0 and abs(value - middle) <= 0.25 * min(high - middle, middle - low):
            return round(value, 2)
    return middle
