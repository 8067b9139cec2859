"""Contribution of milling to the proof."""

from collections.abc import Sequence
from typing import Final

from planner.claims.claim import Claim, ContactOnlyIn, FeedWindow
from planner.claims.segments import Segment
from planner.processes.milling.claims import MILL, MillsAlong, MillsFlank, MillsOver, MillsSurface, SparesPart
from planner.processes.milling.proof import resolve_claims
from planner.processes.milling.proof.milled_surfaces import SURFACES
from planner.processes.milling.proof.rules import cutter
from planner.processes.milling.proof.tool_motion import MILLING
from planner.proof.contribution import ProofOfProcess, WorkingEdges


def contact_segments(group: Sequence[Claim], arm: str) -> WorkingEdges | None:
    """Return the segments in which a cutter on ``arm`` may touch the block, None if there are none.

    They are segments with a claim on the feed and with a claim on what is milled, or at least on a spared
    face. The operation must claim that its cutter touches the block only in such segments.

    Args:
        group: Claims of one operation.
        arm: Name of the arm.
    """
    if not any(isinstance(claim, ContactOnlyIn) and MILL in claim.kinds for claim in group):
        return None
    claimed: set[Segment] = set()
    for claim in group:
        if isinstance(claim, MillsSurface | MillsFlank | MillsOver | SparesPart) and claim.arm == arm:
            claimed |= set(claim.segments)
        elif isinstance(claim, MillsAlong) and claim.arm == arm:
            claimed.add(claim.segment)
    with_feed = {claim.segment.key for claim in group if isinstance(claim, FeedWindow)}
    segments = frozenset(part.key for segment in claimed for part in segment.all_phases) & with_feed
    return WorkingEdges(segments) if segments else None


PROOF: Final = ProofOfProcess(
    rules=(cutter.milled, cutter.mill_gouge, cutter.mill_path, cutter.mill_feed, cutter.spindle),
    complete=resolve_claims.resolve_claims,
    edges=contact_segments,
    surface_producer=SURFACES,
    release={"verify.part_file": (MILLING,)},
)
