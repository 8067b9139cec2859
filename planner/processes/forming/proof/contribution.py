"""The contribution of forming to the proof."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.claims.claim import Claim
from planner.processes.forming.claims import SheetState
from planner.processes.forming.proof.formed_sheet import make_formed_sheet
from planner.processes.forming.proof.forming_facts import FORMING, REMAINING_FACES
from planner.processes.forming.proof.rules import claims, level, part, springback, tool, two_tools
from planner.processes.forming.proof.swept_volume import ENVELOPES
from planner.proof.context import Context
from planner.proof.contribution import ProofOfProcess, WorkingEdges
from planner.proof.series import MAX_CURVE_POINTS


def edges(group: Sequence[Claim], arm: str) -> WorkingEdges | None:
    """Return the segments in which heads of forming tools touch the sheet and one another.

    These are the segments with a claim on the sheet's state, with their approach and retreat. The result is
    None if ``arm`` has none.
    """
    state_segments = [claim.segment for claim in group if isinstance(claim, SheetState) and arm in claim.arms]
    segments = frozenset(part.key for segment in state_segments for part in segment.all_phases)
    return WorkingEdges(segments, meet=True) if segments else None


def series(context: Context) -> Mapping[str, Any]:
    """Return curves over time of the actual and the permitted gap between two tools, for each claimed gap."""
    out: dict[str, Any] = {}
    for n, gap in enumerate(context.get(FORMING).gaps if context.has(FORMING) else (), 1):
        last = max(len(gap.knots) - 1, 0)
        selected = np.unique(np.linspace(0, last, MAX_CURVE_POINTS).astype(np.int64))[: len(gap.knots)]
        out |= {
            f"gap/{n}/time": context.motion.time[gap.track.rows[gap.knots[selected]]],
            f"gap/{n}/got": gap.actual_gap[selected],
            f"gap/{n}/low": gap.low[selected] - gap.claim.tolerance,
            f"gap/{n}/high": gap.high[selected] + gap.claim.tolerance,
        }
    return out


PROOF: Final = ProofOfProcess(
    rules=(
        *(
            part.check_forming_part,
            claims.check_forming_claims,
            springback.check_springback,
            level.check_level,
        ),
        *(
            tool.check_feature_order,
            tool.check_feed,
            tool.check_tilt,
            tool.check_gouge,
            tool.check_sheet_state,
            tool.check_holder,
            tool.check_formed,
        ),
        *(two_tools.check_gap, two_tools.check_border, two_tools.check_opposite, two_tools.check_adsif),
    ),
    edges=edges,
    produced_sheet=make_formed_sheet,
    facts_at_start={"tasks": (REMAINING_FACES,), "sheets": (FORMING, ENVELOPES)},
    series=series,
)
