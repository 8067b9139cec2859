"""The rule on ways to cuts: where a straight wire comes from, and what its slit takes of the part."""

from __future__ import annotations

from collections.abc import Iterator

from planner.claims import LeadsFrom
from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.rules_wire import wire_issue
from planner.verify.slits import ROUNDED, Slit, off_lead, slits, way_in
from planner.verify.wire import Wire

THROUGH = 1e-4
"""A slit that is in the part for less [m] is none."""


def slit(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The wire comes to a cut from where the problem says; a slit through the part is one plane for both
    ways, not longer there than it has to be, and takes nothing along other contours."""
    leads = [claim for claim in context.claims if isinstance(claim, LeadsFrom)]
    issues = [issue for claim in leads for issue in _lead(context, wires, claim)]
    worst, where = 0.0, ""
    for wire in wires:
        for one in slits(context, wire).values():
            if one.used <= THROUGH:
                continue
            allowed = one.allowed
            if one.used / allowed > worst:
                worst, where = one.used / allowed, str(one.segment)
            issues += [
                wire_issue(context, wire, "verify.slit", what, row, mm(got), mm(limit), "mm")
                for what, row, got, limit in _faults(one, allowed)
            ]
    if not where and not leads:
        return Outcome(tuple(issues), where="no slit through the part and no stated lead")
    return Outcome(tuple(issues), worst, 1.0, "of what is allowed", where or str(leads[0].segment))


def _lead(context: Context, wires: tuple[Wire, ...], claim: LeadsFrom) -> Iterator[Issue]:
    """What is wrong with the way in to a cut whose direction is stated."""
    surface = next((c for c in context.surfaces if c.segment == claim.segment), None)
    setup = context.setup_of(claim)
    here = [wire for wire in wires if not wire.fault and wire.setup == setup]
    found = False
    for wire in here:
        way = None if surface is None else way_in(context, wire, claim.segment, surface)
        if way is None:
            continue
        found = True
        off, k = off_lead(claim, wire, way)
        limit = claim.tolerance + ROUNDED
        if off > limit:
            what = (
                f"the wire comes to {claim.segment} {mm(off):.2f} mm beside the stated direction; "
                f"allowed: {mm(limit):g} mm"
            )
            yield wire_issue(context, wire, "verify.slit", what, k, mm(off), mm(limit), "mm")
    if not found:
        yield Issue("verify.slit", f"nothing leads to {claim.segment}", field=str(claim.segment))


def _faults(one: Slit, allowed: float) -> Iterator[tuple[str, int, float, float]]:
    """What is wrong with a slit: text, station, length [m] and what is allowed."""
    first, last = int(one.into.rows[0]), int(one.out.rows[0])
    if one.used > allowed:
        what = (
            f"the slit to {one.segment} is {mm(one.used):.1f} mm long in the part; allowed, as others are "
            f"shorter: {mm(allowed):.1f} mm"
        )
        yield what, first, one.used, allowed
    along = one.along
    if along > ROUNDED:
        what = (
            f"the slit to {one.segment} runs {mm(along):.1f} mm farther beside another contour than it takes "
            f"to cross it; allowed: {mm(ROUNDED):g} mm"
        )
        yield what, first, along, ROUNDED
    wide = 2.0 * max(one.into.half, one.out.half) + ROUNDED
    if one.apart > wide:
        what = (
            f"the wire leaves {one.segment} through the part {mm(one.apart):.2f} mm beside the slit by which "
            f"it came; allowed: {mm(wide):.2f} mm"
        )
        yield what, last, one.apart, wide
