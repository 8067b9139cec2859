"""The rule on ways to cuts: where a straight wire comes from, and what its slit takes of the part."""

from __future__ import annotations

from planner.claims import LeadsFrom
from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.rules_wire import wire_issue
from planner.verify.slits import ROUNDED, off_lead, slits, way_in
from planner.verify.wire import Wire

THROUGH = 1e-4
"""A slit that is in the part for less [m] is none."""


def slit(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The wire comes to a cut from where the problem says; a slit through the part is one plane for both
    ways, and not longer there than it has to be."""
    issues: list[Issue] = []
    worst, where = 0.0, ""
    leads = [claim for claim in context.claims if isinstance(claim, LeadsFrom)]
    for claim in leads:
        label = claim.segment.lower()
        surface = next((c for c in context.surfaces if c.segment == claim.segment), None)
        here = [w for w in wires if not w.fault and w.setup == context.of_segment.get(label)]
        ways = [(w, way_in(context, w, claim.segment, surface)) for w in here if surface is not None]
        found = [(w, way) for w, way in ways if way is not None]
        if not found:
            issues.append(Issue("verify.slit", f"nothing leads to {claim.segment}", field=claim.segment))
        for wire, way in found:
            off, k = off_lead(claim, wire, way)
            limit = claim.tolerance + ROUNDED
            if off > limit:
                what = (
                    f"the wire comes to {claim.segment} {mm(off):.2f} mm beside the stated direction; "
                    f"allowed: {mm(limit):g} mm"
                )
                issues.append(wire_issue(context, wire, "verify.slit", what, k, mm(off), mm(limit), "mm"))
    for wire in wires:
        for one in slits(context, wire).values():
            if one.used <= THROUGH:
                continue
            allowed = one.allowed
            if one.used / allowed > worst:
                worst, where = one.used / allowed, one.segment
            if one.used > allowed:
                what = (
                    f"the slit to {one.segment} is {mm(one.used):.1f} mm long in the part; allowed, as "
                    f"others are shorter: {mm(allowed):.1f} mm"
                )
                measure = mm(one.used), mm(allowed), "mm"
                row = int(one.into.rows[0])
                issues.append(wire_issue(context, wire, "verify.slit", what, row, *measure))
            wide = 2.0 * max(one.into.half, one.out.half) + ROUNDED
            if one.apart > wide:
                what = (
                    f"the wire leaves {one.segment} through the part {mm(one.apart):.2f} mm beside the slit "
                    f"by which it came; allowed: {mm(wide):.2f} mm"
                )
                measure = mm(one.apart), mm(wide), "mm"
                row = int(one.out.rows[0])
                issues.append(wire_issue(context, wire, "verify.slit", what, row, *measure))
    if not where and not leads:
        return Outcome(tuple(issues), where="no slit through the part and no stated lead")
    return Outcome(tuple(issues), worst, 1.0, "of what is allowed", where or leads[0].segment)
