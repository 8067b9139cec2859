"""The rule on sheets that a knife trims.

verify.trim_knife: how deep its blade is, how it leans and how it stands along its curve, that its edge is
ahead, and that it goes in and comes out along its axis, not turned.
"""

from __future__ import annotations

import numpy as np

from planner.claims.segments import Segment
from planner.issues import Issue
from planner.processes.trim.claims import TrimBlade, TrimsSheet
from planner.processes.trim.proof.blade_motion import blade_way
from planner.processes.trim.proof.outlines import TRIM
from planner.processes.trim.proof.rules.mill import (
    Found,
    depth,
    goes_down,
    leans,
    leaves,
    straight_down,
    told,
)
from planner.processes.trim.proof.rules.slots import ANGLE_ERROR, ISSUES_SHOWN, NOTHING_TRIMMED, every
from planner.processes.trim.proof.torch_motion import PLACE_ERROR, TRIMMING, TrimWork
from planner.proof.context import Context
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
    trimming = context.get(TRIMMING)
    issues: list[Issue] = []
    worst, where = -np.inf, ""
    for work, _, key, way in every(trimming):
        own = work.claim.knife
        if own is None:
            continue
        gone = np.linalg.norm(way.feet.foot - way.feet.foot[:1], axis=1) > work.claim.tolerance
        issues += straight_down(context, work, KNIFE, key, way)
        for value, some in (
            depth(context, work, KNIFE, key, way, gone),
            leans(context, work, KNIFE, key, way),
            goes_down(context, work, KNIFE, key, way),
            leaves(context, work, KNIFE, key),
            _stands(context, work, own, key),
            _turns(context, work, own, key),
        ):
            issues += some
            if value > worst:
                worst, where = value, key
        issues += _backwards(context, work, own, key)
    if not where:
        return Outcome(tuple(issues), nothing=NOTHING_TRIMMED)
    return Outcome(tuple(issues), 100.0 * worst, 100.0, "% of what is allowed", where)


def _stands(context: Context, work: TrimWork, own: TrimBlade, key: str) -> Found:
    """Along its curve, wherever its tip is behind the face."""
    blade, out = blade_way(work, own, key), list[Issue]()
    turned = np.where(blade.deep > PLACE_ERROR, blade.off_heading(), 0.0)
    share = turned / (own.heading + ANGLE_ERROR + work.sheet.turn)
    bad = np.flatnonzero(share > 1.0)
    for k in bad[np.argsort(-share[bad], kind="stable")][:ISSUES_SHOWN]:
        what = f"the blade stands {np.rad2deg(turned[k]):.1f} deg off its curve while it is in the sheet; "
        what += f"allowed: {np.rad2deg(own.heading):g} deg, and no turn there at a sharp corner"
        out.append(told(context, work, KNIFE, key, what, int(blade.rows[k])))
    return float(share.max()), out


def _backwards(context: Context, work: TrimWork, own: TrimBlade, key: str) -> list[Issue]:
    """Whether it goes on with its edge ahead."""
    blade = blade_way(work, own, key)
    step = np.diff(blade.feet.foot, axis=0)
    on = (step * blade.ahead[1:]).sum(axis=1)
    there = (blade.deep[1:] > PLACE_ERROR) & (np.linalg.norm(step, axis=1) > STILL)
    out = []
    for k in np.flatnonzero(there & (on <= 0.0))[:1]:
        what = "the knife goes backwards in the sheet, its edge behind; wanted: its edge ahead"
        out.append(told(context, work, KNIFE, key, what, int(blade.rows[k + 1])))
    return out


def _turns(context: Context, work: TrimWork, own: TrimBlade, key: str) -> Found:
    """On its way out it is not turned until it is over the sheet."""
    track = work.of_slot(Segment(TRIM, key.split("/", 1)[1]).at("out").key)
    if not len(track.rows):
        return 0.0, []
    deep = work.feet(track.tip, track.axis)[1]
    turned = np.arccos(np.clip(track.ahead @ track.ahead[0], -1.0, 1.0))
    share = np.where(deep > 0.0, turned, 0.0) / (own.heading + ANGLE_ERROR)
    out = []
    for k in np.flatnonzero(share > 1.0)[:1]:
        what = (
            f"the knife turns by {np.rad2deg(turned[k]):.1f} deg while it is {mm(float(deep[k])):.2f} mm in "
        )
        what += "the sheet on its way out; it is lifted first"
        out.append(told(context, work, KNIFE, key, what, int(track.rows[k])))
    return float(share.max()), out
