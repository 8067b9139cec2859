"""What forming contributes to the proof."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.claims.claim import Claim
from planner.processes.forming.claims import SheetState
from planner.processes.forming.proof.made_sheet import made_sheet
from planner.processes.forming.proof.rules import claims, level, part, springback, tool, two_tools
from planner.processes.forming.proof.state import FORMING, LEFT_FACES
from planner.processes.forming.proof.swept import ENVELOPES
from planner.proof.context import Context
from planner.proof.contribution import Edges, ProofOfProcess
from planner.proof.series import MAX_CURVE_POINTS


def edges(group: Sequence[Claim], arm: str) -> Edges | None:
    """The heads of forming tools touch the sheet, and one another, in the segments that state what they meet
    there, with their ways in and out."""
    own = [claim.segment for claim in group if isinstance(claim, SheetState) and arm in claim.arms]
    segments = frozenset(part.key for segment in own for part in segment.ways)
    return Edges(segments, meet=True) if segments else None


def series(context: Context) -> Mapping[str, Any]:
    """The gap between two tools, as it is and as it is wanted, over time."""
    out: dict[str, Any] = {}
    for n, gap in enumerate(context.get(FORMING).opened if context.has(FORMING) else (), 1):
        last = max(len(gap.knots) - 1, 0)
        some = np.unique(np.linspace(0, last, MAX_CURVE_POINTS).astype(np.int64))[: len(gap.knots)]
        out |= {
            f"gap/{n}/time": context.motion.time[gap.track.rows[gap.knots[some]]],
            f"gap/{n}/got": gap.got[some],
            f"gap/{n}/low": gap.low[some] - gap.claim.tolerance,
            f"gap/{n}/high": gap.high[some] + gap.claim.tolerance,
        }
    return out


PROOF: Final = ProofOfProcess(
    rules=(
        *(part.forming_part, claims.forming_claims, springback.springback, level.level),
        *(tool.feature_order, tool.feed, tool.lean, tool.gouge, tool.sheet, tool.holder, tool.formed),
        *(two_tools.gap, two_tools.border, two_tools.opposite, two_tools.by_table),
    ),
    edges=edges,
    made_sheet=made_sheet,
    begin={"tasks": (LEFT_FACES,), "sheets": (FORMING, ENVELOPES)},
    series=series,
)
