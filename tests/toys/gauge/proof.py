"""Contributions of the gauge to the proof: ring.above."""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.issues import Issue
from planner.proof.context import Context
from planner.proof.contribution import ProofOfProcess
from planner.proof.replay.tool_track import tool_path
from planner.proof.rule import RuleOutcome, mm, rule, sample_issue
from tests.toys.gauge.claims import KeepsAbove

ROUNDING: Final = 2e-7
"""Poses in programs are rounded to 0.1 micrometres, and so may be lower by so much [m]."""


@rule("ring.above", KeepsAbove, stage="motion")
def above(context: Context) -> RuleOutcome:
    """While a gauge goes round, its tip stays as far above the block as the operation states."""
    issues: list[Issue] = []
    series, found = {}, []
    for number, claim in enumerate(context.claims_of(KeepsAbove), 1):
        index = context.setup_of(claim)
        track = tool_path(context, index, claim.arm, (claim.segment.key,))
        if not len(track.rows):
            issues.append(Issue("ring.above", f"the programs have no {claim.segment}", arm=claim.arm))
            continue
        height = track.tip[:, 2] - context.stock_at(index).upper[2]
        series |= {f"ring/{number}/time": track.time, f"ring/{number}/height": height}
        lowest = int(np.argmin(height))
        got, limit = mm(float(height[lowest])), mm(claim.height)
        found.append((got - limit, got, limit, str(claim.segment)))
        if height[lowest] < claim.height - ROUNDING:
            what = f"the tip is {got:.3f} mm above the block, allowed: {limit:.3f} mm and more"
            sample, measure = int(track.rows[lowest]), (got, limit, "mm")
            issues.append(sample_issue("ring.above", what, context.motion, claim.arm, sample, measure))
    if not found:
        return RuleOutcome(tuple(issues), nothing="no gauge goes round")
    _, worst, limit, where = min(found)
    return RuleOutcome(tuple(issues), worst, limit, "mm", where, series=series)


PROOF: Final = ProofOfProcess(rules=(above,))
