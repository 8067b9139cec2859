"""The rule on sheets that a knife trims.

verify.trim_knife: how deep its blade is, how it leans and how it stands along its curve, that its edge is
ahead, and that it goes in and comes out along its axis, not turned.
"""

import numpy as np

from planner.claims.segments import Segment
from planner.processes.trim.claims import TrimBlade, TrimsSheet
from planner.processes.trim.proof.blade_motion import blade_way
from planner.processes.trim.proof.outlines import TRIM
from planner.processes.trim.proof.rules.mill import (
    MeasuredCut,
    depth,
    goes_down,
    leans,
    leaves,
    straight_down,
)
from planner.processes.trim.proof.rules.slots import ANGLE_ERROR, ISSUES_SHOWN, NOTHING_TRIMMED, every
from planner.processes.trim.proof.torch_motion import PLACE_ERROR, TRIMMING
from planner.proof.context import Context
from planner.proof.findings import Findings, percent
from planner.proof.rule import Outcome, mm, rule

KNIFE = "verify.trim_knife"
"""Code of the rule."""
STILL = 0.02e-3
"""A knife that goes along the face by less than this [m] between two places goes nowhere."""


@rule("verify.trim_knife", TrimsSheet)
def trim_knife(context: Context) -> Outcome:
    """Wherever a knife is in the sheet it stands along its curve within what it may, its edge ahead; where it
    goes on its tip is through the sheet as far as wanted, and it leans no farther than its cone. It goes in
    along its axis no faster than it may, not turned, and comes out so: at sharp corners it is lifted."""
    findings = Findings(KNIFE, context)
    for work, _, key, way in every(context.get(TRIMMING)):
        own = work.claim.knife
        if own is None:
            continue
        gone = np.linalg.norm(way.feet.foot - way.feet.foot[:1], axis=1) > work.claim.tolerance
        slot = MeasuredCut(findings, work, key, way)
        straight_down(slot)
        depth(slot, gone)
        leans(slot)
        goes_down(slot)
        leaves(slot)
        _stands(slot, own)
        _turns(slot, own)
        _backwards(slot, own)
    return findings.outcome(percent, "% of what is allowed", 1.0, nothing=NOTHING_TRIMMED)


def _stands(slot: MeasuredCut, own: TrimBlade) -> None:
    """Along its curve, wherever its tip is behind the face."""
    blade = blade_way(slot.work, own, slot.key)
    turned = np.where(blade.deep > PLACE_ERROR, blade.off_heading(), 0.0)
    share = turned / (own.heading + ANGLE_ERROR + slot.work.sheet.turn)
    bad = np.flatnonzero(share > 1.0)
    for k in bad[np.argsort(-share[bad], kind="stable")][:ISSUES_SHOWN]:
        what = f"the blade stands {np.rad2deg(turned[k]):.1f} deg off its curve while it is in the sheet; "
        what += f"allowed: {np.rad2deg(own.heading):g} deg, and no turn there at a sharp corner"
        slot.add(what, blade.rows[k])
    slot.note(share.max())


def _backwards(slot: MeasuredCut, own: TrimBlade) -> None:
    """Whether it goes on with its edge ahead."""
    blade = blade_way(slot.work, own, slot.key)
    step = np.diff(blade.feet.foot, axis=0)
    on = (step * blade.ahead[1:]).sum(axis=1)
    there = (blade.deep[1:] > PLACE_ERROR) & (np.linalg.norm(step, axis=1) > STILL)
    for k in np.flatnonzero(there & (on <= 0.0))[:1]:
        what = "the knife goes backwards in the sheet, its edge behind; wanted: its edge ahead"
        slot.add(what, blade.rows[k + 1])


def _turns(slot: MeasuredCut, own: TrimBlade) -> None:
    """On its way out it is not turned until it is over the sheet."""
    work = slot.work
    track = work.of_slot(Segment(TRIM, slot.key.split("/", 1)[1]).at("out").key)
    if not len(track.rows):
        return
    deep = work.feet(track.tip, track.axis)[1]
    turned = np.arccos(np.clip(track.ahead @ track.ahead[0], -1.0, 1.0))
    share = np.where(deep > 0.0, turned, 0.0) / (own.heading + ANGLE_ERROR)
    for k in np.flatnonzero(share > 1.0)[:1]:
        what = (
            f"the knife turns by {np.rad2deg(turned[k]):.1f} deg while it is {mm(float(deep[k])):.2f} mm in "
            "the sheet on its way out; it is lifted first"
        )
        slot.add(what, track.rows[k])
    slot.note(share.max())
