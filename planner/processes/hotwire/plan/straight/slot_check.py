"""Checks of the slots of straight cuts, and search for a power or feed at which they pass.

**At the ends of the wire** (`check_heat`). A slot follows from power over speed, so one factor on the heat at
both ends represents more power as well as less feed. Factors are tried on the existing wires of the cuts. A
suitable power or feed is confirmed on newly planned cuts before a hint suggests it.

**On the planned path** (`check_path`): the slot that a wire melts all along itself and between its guide
points is compared with the surface and the usable widths.
"""

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.operation import Straight
from planner.processes.hotwire.plan.straight.cut import StraightCut
from planner.processes.hotwire.plan.straight.offset import (
    DAMPING_SCHEDULE,
    WIRE_FRACTIONS,
    MeltedSlots,
    guide_lines,
    melt_slots,
    remaining_foam,
    wire_offset,
)
from planner.processes.hotwire.plan.straight.order import WireLines, concatenate_lines, point_text
from planner.targets import FEED_FRACTION

MIN_HEAT_FACTOR: Final = 1.0 / 64.0
"""Smallest factor on the heat that is tried. The largest is its inverse."""
HEAT_HALVINGS: Final = 8
"""Number of halvings of the (logarithmic) interval between a suitable and an unsuitable heat factor."""
WIRE_ENDS: Final = ("start", "end")
"""Names of the wire's two ends."""

PlanCuts = Callable[[Straight], list[StraightCut]]
"""Plans all cuts of an operation for its power and feed."""
KerfCurveOf = Callable[[Straight], KerfCurve]
"""Returns the kerf over speed for the operation's power."""


def check_heat(
    op: Straight,
    cuts: list[StraightCut],
    box: FloatArray,
    kerf_curve_of: KerfCurveOf,
    plan_cuts: PlanCuts,
    max_power: float,
) -> Iterator[Issue]:
    """Yield ``kerf.too_hot``, ``kerf.too_cold`` and ``kerf.unsettled`` for the cuts of an operation.

    Slots at both ends of the wires are compared with the usable range. Nothing is checked for an operation
    without a stated power. The hint names a power or feed at which newly planned cuts pass, or says why there
    is none.

    Args:
        op: Operation with a straight wire.
        cuts: All cuts.
        box: Lower and upper corner of the block (2, 3) [m].
        kerf_curve_of: Function for the kerf curve of an operation.
        plan_cuts: Function that plans the cuts of an operation.
        max_power: Power that the wire withstands [W].
    """
    if op.power_w is None:
        return
    faults = [fault for cut in cuts for fault in _slot_faults(op, cut)]
    if not faults:
        return
    hint = _heat_advice(op, cuts, box, kerf_curve_of, plan_cuts, max_power)
    for cut, code, wire, end in faults:
        yield _slot_issue(op, cut, code, wire, end, hint)


def _slot_faults(op: Straight, cut: StraightCut) -> Iterator[tuple[StraightCut, str, int, int]]:
    """Yield the faults of a cut's slot: cut, issue code, index of the wire, and its end (0 start, 1 end).

    At most one each of ``kerf.too_hot``, at the widest slot, and ``kerf.too_cold``, at the narrowest, is
    yielded. If neither is, but the half kerfs have not converged, ``kerf.unsettled`` names the slowest end.
    """
    width = 2.0 * cut.on.half / MM
    low, high = op.kerf_range_mm
    # divmod by the two ends converts a flat index to wire and end
    widest, narrowest = (divmod(int(flat), 2) for flat in (np.argmax(width), np.argmin(width)))
    if width[widest] > high:
        yield cut, "kerf.too_hot", *widest
    if width[narrowest] < low:
        yield cut, "kerf.too_cold", *narrowest
    if not cut.on.converged and width.max() <= high and width.min() >= low:
        slowest = divmod(int(np.argmin(cut.on.speed)), 2)
        yield cut, "kerf.unsettled", *slowest


def _slot_issue(op: Straight, cut: StraightCut, code: str, wire: int, end: int, hint: str) -> Issue:
    """Return the issue of a fault that `_slot_faults` yields."""
    speed, foot = cut.on.speed[wire] / MM, cut.on.row.foot
    width = 2.0 * float(cut.on.half[wire, end]) / MM
    point = (foot.start, foot.end)[end][wire] / MM
    position_text = "[" + ", ".join(f"{value:.1f}" for value in point) + "] mm"
    low, high = op.kerf_range_mm
    subject = (
        f"{op.name}: on {cut.nominal.segment} the {WIRE_ENDS[end]} of the wire, at {speed[end]:.2f} mm/s"
    )
    other = f"while its {WIRE_ENDS[1 - end]} moves at {speed[1 - end]:.2f} mm/s"
    if code == "kerf.unsettled":
        message = f"{subject} at {position_text} {other}, has no kerf that is consistent with its own speed"
        return Issue(code, message, field="part", value=float(speed[end]), unit="mm/s", hint=hint)
    effect, limit = ("burns the foam", high) if code == "kerf.too_hot" else ("drags: it is too cold", low)
    return Issue(
        code,
        f"{subject} at {position_text} {other}, melts {width:.2f} mm and {effect}; allowed are {low:g} to "
        f"{high:g} mm",
        field="operations.power_w",
        **measurement(width, limit, "mm"),
        hint=hint,
    )


def _heat_advice(
    op: Straight,
    cuts: list[StraightCut],
    box: FloatArray,
    kerf_curve_of: KerfCurveOf,
    plan_cuts: PlanCuts,
    max_power: float,
) -> str:
    """Return a hint with a power or feed at which all slots are within the range, or why there is none.

    Slots widen with the heat. The largest factor on the power at which no slot is too wide and the smallest
    at which none is too narrow are searched on the existing wires. Power or feed between both factors is then
    tried on newly planned cuts.
    """
    power = op.power_w or 0.0
    max_factor = min(1.0 / MIN_HEAT_FACTOR, 0.9 * max_power / power)  # keeps 10 % below the melting wire

    def width_range(factor: float) -> tuple[float, float]:
        """Return the narrowest and the widest slot [mm] at a multiple of the power."""
        changed = _with_heat(op, power=power * factor)
        curve = kerf_curve_of(changed)
        offsets = [
            wire_offset(
                cut.on.row, curve, FEED_FRACTION * changed.feed(cut.nominal.cut), box, DAMPING_SCHEDULE[:2]
            )
            for cut in cuts
        ]
        widest = max(
            2.0 * float(offset.half.max()) / MM if offset.converged else np.inf for offset in offsets
        )
        return min(2.0 * float(offset.half.min()) / MM for offset in offsets), widest

    low, high = op.kerf_range_mm
    max_suitable = _suitable_limit(lambda factor: width_range(factor)[1] <= high, MIN_HEAT_FACTOR, max_factor)
    min_suitable = _suitable_limit(lambda factor: width_range(factor)[0] >= low, max_factor, MIN_HEAT_FACTOR)
    if max_suitable is not None and min_suitable is not None and min_suitable < max_suitable:
        tried = [text for text in _suitable_settings(op, min_suitable, max_suitable, plan_cuts) if text]
        if tried:
            return f"set {' or '.join(tried)}, which was tried"
    if min_suitable is None or (max_suitable is None and width_range(MIN_HEAT_FACTOR)[0] > high):
        factor_text = f"{max_factor:.3g} times the power" if min_suitable is None else "a 64th of the power"
        return (
            f"even {factor_text} is too {'little' if min_suitable is None else 'much'}; correct power_w or "
            "feed_mm_s"
        )
    remedy = (
        "make the speeds of both ends more even: less taper, edges of equal thickness at both ends (wing: "
        "trailing_edge_mm), rulings between equal fractions of both lines (wing: match: arc_length), or "
        "two panels instead of one"
    )
    if max_suitable is None:
        return f"no power or feed helps: one end almost stops while the other moves on; {remedy}"
    return (
        f"no power or feed suits both ends: if the widest slot is {high:g} mm, at "
        f"{power * max_suitable:.3g} W, the narrowest is {width_range(max_suitable)[0]:.2f} mm; {remedy}"
    )


def _suitable_limit(is_suitable: Callable[[float], bool], inner: float, outer: float) -> float | None:
    """Return the suitable factor that is farthest from ``inner`` towards ``outer``, by bisection.

    Factors are suitable up to some limit. None is returned if ``inner`` is not suitable.
    """
    if not is_suitable(inner):
        return None
    if is_suitable(outer):
        return outer
    for _ in range(HEAT_HALVINGS):
        middle = float(np.sqrt(inner * outer))
        inner, outer = (middle, outer) if is_suitable(middle) else (inner, middle)
    return inner


def _suitable_settings(
    op: Straight, min_factor: float, max_factor: float, plan_cuts: PlanCuts
) -> Iterator[str]:
    """Yield a power and a feed, as text, that lie between two factors on the heat and make new cuts pass.

    Each is tried by planning all cuts again, and left out if they fail. Both are round numbers if one is near
    the middle of the range. A feed is not suggested if cuts state their own.
    """
    low, high = op.kerf_range_mm
    powers = [value * (op.power_w or 0.0) for value in (min_factor, max_factor)]
    feeds = [op.feed_mm_s / value for value in (max_factor, min_factor)]
    has_own_feeds = op.cuts != "all" and any(cut.feed_mm_s is not None for cut in op.cuts)
    # more heat means more power or less feed; 5000 W and 200 mm/s bound what is suggested
    for key, bounds, allowed in (
        ("power_w", powers, not powers[0] > 5000.0),
        ("feed_mm_s", [max(feeds[0], op.feed_min_mm_s), min(feeds[1], 200.0)], not has_own_feeds),
    ):
        value = _round_between(bounds[0], bounds[1]) if allowed and bounds[0] < bounds[1] else None
        if value is None:
            continue
        changed = _with_heat(op, **{key.split("_", maxsplit=1)[0]: value})
        cuts = plan_cuts(changed)
        width = np.concatenate([2.0 * cut.on.half.ravel() for cut in cuts]) / MM
        if all(cut.on.converged for cut in cuts) and low <= width.min() and width.max() <= high:
            yield f"{key}: {value:g}, which melts {width.min():.2f} to {width.max():.2f} mm"


def _with_heat(op: Straight, power: float | None = None, feed: float | None = None) -> Straight:
    """Return the operation with another power [W] or feed [mm/s]."""
    changes = {"power_w": power} if power is not None else {"feed_mm_s": feed}
    return op.model_copy(update=changes)


def _round_between(low: float, high: float) -> float:
    """Return a round number near the geometric mean of an interval, or the mean if none is near.

    "Near" is within a quarter of the distance from the mean to the nearer end.
    """
    middle = float(np.sqrt(low * high))
    for step in (5.0, 1.0, 0.5, 0.1, 0.05, 0.01):
        value = round(middle / step) * step
        if value > 0.0 and abs(value - middle) <= 0.25 * min(high - middle, middle - low):
            return round(value, 2)
    return middle


MAX_NAMED_PLACES: Final = 4
"""Maximum number of positions that a message lists."""
USABLE_TOLERANCE_FRACTION: Final = 0.95
"""Fraction of the tolerance that a plan may use, because controllers smooth the speed at corners."""


def check_path(op: Straight, cut: StraightCut, kerf: KerfCurve, box: FloatArray) -> Iterator[Issue]:
    """Yield issues of the slot along the planned path, at the feed.

    ``straight.uneven``: the slot grows and shrinks so fast that the wire's distance from the surface is not
    half of it. ``kerf.too_hot`` and ``kerf.too_cold``, only for a stated power: the slot leaves the range
    between the guide points. Nothing is yielded if it already leaves the range at a guide point, which
    `check_heat` reports.

    Args:
        op: Operation with a straight wire.
        cut: The cut.
        kerf: Kerf over speed.
        box: Lower and upper corner of the block (2, 3) [m].
    """
    feed = FEED_FRACTION * op.feed(cut.nominal.cut)
    count = len(cut.on.lines)
    out = cut.out[: cut.reversal] if cut.reversal else cut.out
    lead_end = cut.into[-2:]  # two wires of each lead give the first and last wire their speeds
    slots = melt_slots(concatenate_lines([lead_end, cut.on.lines, out[:2]]), kerf, feed, box)
    number = slots.line_index - len(lead_end)
    on_surface = (number > 0) & (number < count)
    # of the samples on the move to the first wire, only the last one is on the surface: at the wire itself
    on_surface[np.flatnonzero(number == 0)[-1:]] = True
    passed = slots.select(on_surface)
    low, high = op.kerf_range_mm
    at_guides = 2.0 * cut.on.half / MM
    if op.power_w is not None:
        if not low <= at_guides.min() <= at_guides.max() <= high:
            return  # check_heat reports a slot that is too wide or too narrow at a guide point
        yield from _width_issues(op, cut, passed)
    yield from _deviation_issues(op, cut, passed)


def wires_along(cut: StraightCut) -> WireLines:
    """Return the wires of a cut from the lead-in to the lead-out, up to the reversal."""
    return concatenate_lines([cut.into, cut.on.lines, cut.out[: cut.reversal] if cut.reversal else cut.out])


def check_driven(
    op: Straight, cut: StraightCut, kerf: KerfCurve, box: FloatArray, clock: FloatArray
) -> Iterator[Issue]:
    """Yield the issues of :func:`check_path` at the speeds of the planned timing, for a stated power.

    In addition, ``straight.uneven`` is yielded if the wire is so slow on a lead that it melts into the
    surface, except for holes.

    Args:
        op: Operation with a straight wire.
        cut: The cut.
        kerf: Kerf over speed.
        box: Lower and upper corner of the block (2, 3) [m].
        clock: Positions among the lines of :func:`wires_along` the cut, 3.5 being halfway from line 3 to line
            4, and times [s] at which the wire passes them (2, K).
    """
    if op.power_w is None:
        return
    slots = melt_slots(wires_along(cut), kerf, op.feed(cut.nominal.cut), box, clock)
    number = slots.line_index - len(cut.into)
    on_surface = (number > 0) & (number < len(cut.on.lines))
    on_surface[np.flatnonzero(number == 0)[-1:]] = True  # as in check_path
    passed = slots.select(on_surface)
    cause = "the arm cannot rotate the bow as fast as the feed requires, so that the slot becomes wider"
    yield from _width_issues(op, cut, passed)
    yield from _deviation_issues(op, cut, passed, cause)
    if cut.nominal.ruled.hole:
        return  # its leads come through the part anyway
    on_leads = slots.select(~on_surface)
    depth = on_leads.penetration(guide_lines(cut.nominal.ruled))
    row, end = np.unravel_index(int(np.argmax(depth)), depth.shape)
    worst, allowed = float(depth[row, end]), op.shape_tol_mm * MM
    if worst > USABLE_TOLERANCE_FRACTION * allowed:
        hint = "use a lower feed_mm_s with less power_w, which corners slow down less, or a larger "
        hint += "shape_tol_mm"
        yield Issue(
            "straight.uneven",
            f"{op.name}: next to {cut.nominal.segment} the arm cannot move the bow round the corner as fast "
            f"as the feed requires, so that it melts {worst / MM:.2f} mm into the part at "
            f"{_position_text(on_leads, int(row), float(end))}",
            field=str(cut.nominal.segment),
            **measurement(worst / MM, allowed / MM, "mm"),
            hint=hint,
        )


def check_inner_corners(op: Straight, cut: StraightCut, box: FloatArray) -> Iterator[Issue]:
    """Yield ``straight.corner`` if a round wire leaves foam in inner corners and curves.

    It is a note, or an error if the foam is deeper than the operation allows.
    """
    remaining = remaining_foam(cut.on, cut.nominal.ruled, op.shape_tol_mm * MM, box)
    if not remaining:
        return
    max_depth = remaining[0].depth / MM
    volume = sum(foam.volume for foam in remaining) / MM**3
    places = ", ".join(point_text(foam.point) for foam in remaining[:MAX_NAMED_PLACES])
    more = (
        f" and {len(remaining) - MAX_NAMED_PLACES} more places" if len(remaining) > MAX_NAMED_PLACES else ""
    )
    message = (
        f"{op.name}: the wire is round and leaves foam in inner corners of {cut.nominal.segment}, "
        f"at most {max_depth:.2f} mm deep, {volume:.0f} mm3 in total, at {places}{more}"
    )
    is_too_deep = max_depth > op.left_mm
    yield Issue(
        "straight.corner",
        f"{message}; allowed: {op.left_mm:g} mm (left_mm); use a thinner slot, round the corner or allow more"
        if is_too_deep
        else f"{message}; remove it by hand, use a thinner slot or round the corner",
        Severity.ERROR if is_too_deep else Severity.NOTE,
        field=str(cut.nominal.segment),
        **measurement(max_depth, op.left_mm, "mm"),
    )


def _width_issues(op: Straight, cut: StraightCut, passed: MeltedSlots) -> Iterator[Issue]:
    """Yield ``kerf.too_hot`` and ``kerf.too_cold`` for the widest and narrowest slot along the path."""
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
            message = f"{op.name}: on {cut.nominal.segment} the wire rotates; at {speed:.2f} mm/s, at "
            message += (
                f"{_position_text(passed, int(row), float(WIRE_FRACTIONS[column]))}, it melts {value:.2f} mm "
                "and "
            )
            message += f"{words}"
            yield Issue(code, message, field="operations.power_w", **measurement(value, limit, "mm"))


def _deviation_issues(
    op: Straight, cut: StraightCut, passed: MeltedSlots, cause: str = ""
) -> Iterator[Issue]:
    """Yield ``straight.uneven`` if the distance of wires from the surface is not half their slot.

    The guide points are checked all along the path. If they pass, the slot between them is compared with its
    linear interpolation along the wire. This deviation is reported only if more of the surface is out of
    tolerance than the operation's share allows. At most one issue is yielded.

    Args:
        op: Operation with a straight wire.
        cut: The cut.
        passed: Slots along the path on the surface.
        cause: Why the slot is uneven, for the message. By default it is the slowing down of the wire.
    """
    allowed = op.shape_tol_mm * MM
    deviation = passed.deviation(guide_lines(cut.nominal.ruled))
    row, end = np.unravel_index(int(np.argmax(deviation)), deviation.shape)
    worst, position = float(deviation[row, end]), _position_text(passed, int(row), float(end))
    interpolated = passed.half[:, :1] + WIRE_FRACTIONS * (passed.half[:, -1:] - passed.half[:, :1])
    inner_deviation = np.abs(passed.half - interpolated)
    if worst <= USABLE_TOLERANCE_FRACTION * allowed and (
        inner_deviation > allowed
    ).mean() > USABLE_TOLERANCE_FRACTION * (1.0 - op.share):
        row, column = np.unravel_index(int(np.argmax(inner_deviation)), inner_deviation.shape)
        worst = float(inner_deviation[row, column])
        position = _position_text(passed, int(row), float(WIRE_FRACTIONS[column]))
    cause = cause or "the wire slows down and its slot widens faster than the wire can move aside"
    # wires are as sparse as the tolerance allows, so the deviation grows with the tolerance
    remedy = "use less power, which makes the slot more even, or a several times larger shape_tol_mm"
    if op.power_w is None:
        cause = "the wire does not follow the surface"
        remedy = "use a several times larger shape_tol_mm, or a smaller step_mm"
    if worst > USABLE_TOLERANCE_FRACTION * allowed:
        yield Issue(
            "straight.uneven",
            f"{op.name}: on {cut.nominal.segment} {cause}, at {position}: {worst / MM:.2f} mm missing or "
            f"left; {remedy}",
            field=str(cut.nominal.segment),
            **measurement(worst / MM, allowed / MM, "mm"),
        )


def _position_text(passed: MeltedSlots, wire: int, fraction: float) -> str:
    """Return the point at a fraction of a wire between its guide points, as text."""
    return point_text((1.0 - fraction) * passed.lines.start[wire] + fraction * passed.lines.end[wire])
