"""verify.order: the order of cuts."""

import numpy as np

from planner.claims.claim import FeedWindow
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.rule import RuleOutcome, rule


@rule("verify.order", FeedWindow)
def order(context: Context) -> RuleOutcome:
    """Cuts follow one another as the operations state them, each without interruption from lead-in to
    lead-out.
    """
    findings = Findings("verify.order", context)
    motion = context.motion
    setups = context.spans.of_stage[motion.node_stage]
    arm = context.job.tasks[0].arm.name
    for index in range(len(context.setups)):
        rank = _ranks(context, index)
        last_rank, previous = -1, ""  # rank and label of the last move so far that has a rank
        for node in np.flatnonzero(setups == index):
            label = str(motion.node_segment[node])
            current = rank.get(label, last_rank)
            if current < last_rank:
                message = f"{label} is cut after {previous}, but must come first"
                findings.add_at_node(message, arm, node)
            last_rank, previous = current, label if label in rank else previous
    return findings.outcome_without_value()


def _ranks(context: Context, index: int) -> dict[str, int]:
    """Return the rank of each segment in which a setup cuts, by its key in lower case."""
    out: dict[str, int] = {}
    for group in context.setup_claims[index].groups:
        windows = [claim.segment for claim in group if isinstance(claim, FeedWindow)]
        cut_keys = {segment.key for segment in windows}
        for segment in windows:
            for phase in segment.all_phases:
                if phase.key in cut_keys:
                    out.setdefault(phase.key, len(out))
    return out
