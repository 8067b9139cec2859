"""Contribution of trimming to the proof."""

from collections.abc import Sequence
from typing import Final

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.processes.trim.claims import TrimsSheet, slot_names
from planner.processes.trim.proof import outlines
from planner.processes.trim.proof.rules import forming_holes, knife, mill, slots
from planner.proof.contribution import ProofOfProcess, WorkingEdges


def contact_segments(group: Sequence[Claim], arm: str) -> WorkingEdges | None:
    """Return the segments in which a tool on ``arm`` is at the sheet: its slots with their leads.

    The result is None if the arm does not trim.

    Args:
        group: Claims of one operation.
        arm: Name of the arm.
    """
    claims = [claim for claim in group if isinstance(claim, TrimsSheet) and claim.arm == arm]
    names = [name for claim in claims for outline in claim.outlines for name in slot_names(claim, outline)]
    segments = frozenset(part.key for name in names for part in Segment("trim", name).all_phases)
    return WorkingEdges(segments) if segments else None


PROOF: Final = ProofOfProcess(
    rules=(
        *(slots.trim_cut, slots.trim_kept, slots.trim_torch, slots.trim_arc, slots.trim_order),
        *(slots.trim_feed, slots.trim_clear, mill.trim_mill, mill.trim_spindle, knife.trim_knife),
        forming_holes.forming_holes,
    ),
    complete=outlines.resolve_claims,
    edges=contact_segments,
)
