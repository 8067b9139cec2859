"""Whether the slots of straight cuts come out right, and at which power or feed they would.

**At the ends of the wire** (`check_heat`). A slot follows from power over speed, so that one factor
on both ends' heat stands for more power as well as for less feed. Advice is found by trying factors
on the cuts' own rows, and tried once more on whole cuts, made anew, before it is given.

**On the planned way** (`check_passed`): the slot that a wire melts all along itself and between its
guide points, held against the surface and the usable widths.
"""

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.operation import Straight
from planner.processes.hotwire.plan.straight.cut import Cut
from planner.processes.hotwire.plan.straight.offset import (
    DAMPING,
    WIRE_SHARES,
    Melted,
    beside,
    foam_left,
    guides,
    melted,
)
from planner.processes.hotwire.plan.straight.order import Lines, join, place_text
from planner.targets import FEED_SHARE

LEAST_HEAT: Final = 1.0 / 64.0
"""Heats between this share of the given one and its inverse are tried."""
HEAT_HALVINGS: Final = 8
"""So often the interval between a heat that is right and one that is not is halved: to 4 %."""
WIRE_ENDS: Final = ("start", "end")
"""Names of the wire's two ends."""

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
    wire = f"{op.name}: on {cut.wanted.segment} the {WIRE_ENDS[end]} of the wire, at {speed[end]:.2f} mm/s"
    other = f"while its {WIRE_ENDS[1 - end]} moves at {speed[1 - end]:.2f} mm/s"
    if code == "kerf.unsettled":
        what = f"{wire} at {place} {other}, has no slot that fits its own speed"
        return Issue(code, what, field="part", value=float(speed[end]), unit="mm/s", hint=hint)
    what, limit = ("burns the foam", high) if code == "kerf.too_hot" else ("drags: it is too cold", low)
    return Issue(
        code,
        f"{wire} at {place} {other}, melts {width:.2f} mm and {what}; allowed are {low:g} to {high:g} mm",
        field="operations.power_w",
        **measurement(width, limit, "mm"),
        hint=hint,
    )


def _advice(
    op: Straight, cuts: list[Cut], box: FloatArray, slots: Slots, remake: Remake, bears: float
) -> str:
    """A power, and a feed, at which all slots are within the range; or that there is none."""
    power = op.power_w or 0.0
    top = min(1.0 / LEAST_HEAT, 0.9 * bears / power)

    def widths(factor: float) -> tuple[float, float]:
        hot = _with(op, power=power * factor)
        curve = slots(hot)
        made = [
            beside(cut.on.row, curve, FEED_SHARE * hot.feed(cut.wanted.cut), box, DAMPING[:2]) for cut in cuts
        ]
        widest = max(2.0 * float(one.half.max()) / MM if one.settled else np.inf for one in made)
        return min(2.0 * float(one.half.min()) / MM for one in made), widest

    low, high = op.kerf_range_mm
    most = _edge(lambda factor: widths(factor)[1] <= high, LEAST_HEAT, top)
    least = _edge(lambda factor: widths(factor)[0] >= low, top, LEAST_HEAT)
    if most is not None and least is not None and least < most:
        tried = [text for text in _choices(op, least, most, remake) if text]
        if tried:
            return f"{' or '.join(tried)}, as was tried"
    if least is None or (most is None and widths(LEAST_HEAT)[0] > high):
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
    for _ in range(HEAT_HALVINGS):
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


PLACES_NAMED: Final = 4
"""So many places are named."""
USABLE_SHARE: Final = 0.95
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
    passed = whole.some(own)
    low, high = op.kerf_range_mm
    at_guides = 2.0 * cut.on.half / MM
    if op.power_w is not None:
        if not low <= at_guides.min() <= at_guides.max() <= high:
            return  # it is uneven since it is too hot or too cold somewhere, which is told with advice
        yield from _width(op, cut, passed)
    yield from _off(op, cut, passed)


def along(cut: Cut) -> Lines:
    """The wires of a cut from the way in to the way out, up to where it turns back."""
    return join([cut.into, cut.on.lines, cut.out[: cut.turns] if cut.turns else cut.out])


def check_driven(
    op: Straight, cut: Cut, kerf: KerfCurve, box: FloatArray, clock: FloatArray
) -> Iterator[Issue]:
    """As :func:`check_passed`, at the times that the arms can keep: ``clock`` (2, K) of places between the
    wires :func:`along` the cut and when [s] they are passed; nor does a wire that is slow on the way in or
    out melt into the surface."""
    if op.power_w is None:
        return
    whole = melted(along(cut), kerf, op.feed(cut.wanted.cut), box, clock)
    number = whole.number - len(cut.into)
    own = (number > 0) & (number < len(cut.on.lines))
    own[np.flatnonzero(number == 0)[-1:]] = True
    passed = whole.some(own)
    why = "the arm cannot turn the bow as fast as the feed asks for, so that it melts a wider slot"
    yield from _width(op, cut, passed)
    yield from _off(op, cut, passed, why)
    if cut.wanted.ruled.hole:
        return  # the ways in and out pass its surface in a slit
    beside = whole.some(~own)
    deep = beside.into(guides(cut.wanted.ruled))
    row, end = np.unravel_index(int(np.argmax(deep)), deep.shape)
    worst, allowed = float(deep[row, end]), op.shape_tol_mm * MM
    if worst > USABLE_SHARE * allowed:
        hint = "take a lower feed_mm_s with less power_w, which corners slow down less, or a larger "
        hint += "shape_tol_mm"
        yield Issue(
            "straight.uneven",
            f"{op.name}: beside {cut.wanted.segment} the arm cannot drive the bow round the corner as fast "
            f"as the feed asks for, so that it melts {worst / MM:.2f} mm into the part at "
            f"{_place(beside, int(row), float(end))}",
            field=str(cut.wanted.segment),
            **measurement(worst / MM, allowed / MM, "mm"),
            hint=hint,
        )


def check_inner(op: Straight, cut: Cut, box: FloatArray) -> Iterator[Issue]:
    """``straight.corner``: what a round wire leaves in inner corners and curves, as a note, or refused where
    it is deeper than the operation allows."""
    left = foam_left(cut.on, cut.wanted.ruled, op.shape_tol_mm * MM, box)
    if not left:
        return
    deep = left[0].depth / MM
    volume = sum(one.volume for one in left) / MM**3
    places = ", ".join(place_text(one.point) for one in left[:PLACES_NAMED])
    more = f" and {len(left) - PLACES_NAMED} more places" if len(left) > PLACES_NAMED else ""
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
        **measurement(deep, op.left_mm, "mm"),
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
            what = f"{op.name}: on {cut.wanted.segment} the wire turns on its way; at {speed:.2f} mm/s, at "
            what += f"{_place(passed, int(row), float(WIRE_SHARES[column]))}, it melts {value:.2f} mm and "
            what += f"{words}"
            yield Issue(code, what, field="operations.power_w", **measurement(value, limit, "mm"))


def _off(op: Straight, cut: Cut, passed: Melted, why: str = "") -> Iterator[Issue]:
    """All along its way, and all along itself but for the share that may be out, the wire is half its slot
    off the surface."""
    allowed = op.shape_tol_mm * MM
    off = passed.off(guides(cut.wanted.ruled))
    row, end = np.unravel_index(int(np.argmax(off)), off.shape)
    worst, where = float(off[row, end]), _place(passed, int(row), float(end))
    between = passed.half[:, :1] + WIRE_SHARES * (passed.half[:, -1:] - passed.half[:, :1])
    inside = np.abs(passed.half - between)
    if worst <= USABLE_SHARE * allowed and (inside > allowed).mean() > USABLE_SHARE * (1.0 - op.share):
        row, column = np.unravel_index(int(np.argmax(inside)), inside.shape)
        worst, where = float(inside[row, column]), _place(passed, int(row), float(WIRE_SHARES[column]))
    why = why or "the wire slows down and melts its slot wider faster than it can move aside"
    # wires are laid as coarsely as the tolerance lets them, so that what is missing grows with it
    remedy = "take less power, which evens the slot, or a shape_tol_mm of some times as much"
    if op.power_w is None:
        why = "the wire does not follow the surface"
        remedy = "take a shape_tol_mm of some times as much, or a smaller step_mm"
    if worst > USABLE_SHARE * allowed:
        yield Issue(
            "straight.uneven",
            f"{op.name}: on {cut.wanted.segment} {why}, at {where}: {worst / MM:.2f} mm are missing or left; "
            f"{remedy}",
            field=str(cut.wanted.segment),
            **measurement(worst / MM, allowed / MM, "mm"),
        )


def _place(passed: Melted, row: int, share: float) -> str:
    return place_text((1.0 - share) * passed.lines.start[row] + share * passed.lines.end[row])
