"""The rule on the order of segments."""

import numpy as np

from planner.claims.claim import FeedWindow
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.rule import Outcome, rule


@rule("verify.order", FeedWindow)
def order(context: Context) -> Outcome:
    """Cuts follow one another as the operations state them, each in one go from its way in to its way out."""
    findings = Findings("verify.order", context)
    motion = context.motion
    setups = context.spans.of_stage[motion.node_stage]
    arm = context.job.tasks[0].arm.name
    for index in range(len(context.setups)):
        rank = _ranks(context, index)
        last, before = -1, ""
        for node in np.flatnonzero(setups == index):
            label = str(motion.node_segment[node])
            here = rank.get(label, last)
            if here < last:
                what = f"{label} is cut behind {before}; it comes first"
                findings.at_node(what, arm, node)
            last, before = here, label if label in rank else before
    return findings.outcome_without_value()


def _ranks(context: Context, index: int) -> dict[str, int]:
    """Segments in which a setup cuts, in lower case, in the order in which they must come."""
    out: dict[str, int] = {}
    for group in context.setup_claims[index].groups:
        own = [claim.segment for claim in group if isinstance(claim, FeedWindow)]
        fed = {segment.key for segment in own}
        for segment in own:
            for way in segment.ways:
                if way.key in fed:
                    out.setdefault(way.key, len(out))
    return out
