"""What milling contributes to the proof."""

from collections.abc import Sequence
from typing import Final

from planner.claims.claim import Claim, ContactOnlyIn, FeedWindow
from planner.claims.segments import Segment
from planner.processes.milling.claims import MILL, MillsAlong, MillsFlank, MillsOver, MillsSurface, SparesPart
from planner.processes.milling.proof import wanted_ways
from planner.processes.milling.proof.made_surfaces import SURFACES
from planner.processes.milling.proof.rules import cutter
from planner.processes.milling.proof.tool_motion import MILLING
from planner.proof.contribution import Edges, ProofOfProcess


def edges(group: Sequence[Claim], arm: str) -> Edges | None:
    """A cutter touches the block in segments with a feed that state what they mill, or at least what they
    spare, of an operation whose cutter may touch the block."""
    if not any(isinstance(claim, ContactOnlyIn) and MILL in claim.kinds for claim in group):
        return None
    own: set[Segment] = set()
    for claim in group:
        if isinstance(claim, MillsSurface | MillsFlank | MillsOver | SparesPart) and claim.arm == arm:
            own |= set(claim.segments)
        elif isinstance(claim, MillsAlong) and claim.arm == arm:
            own.add(claim.segment)
    fed = {claim.segment.key for claim in group if isinstance(claim, FeedWindow)}
    segments = frozenset(part.key for segment in own for part in segment.ways) & fed
    return Edges(segments) if segments else None


PROOF: Final = ProofOfProcess(
    rules=(cutter.milled, cutter.mill_gouge, cutter.mill_path, cutter.mill_feed, cutter.spindle),
    complete=wanted_ways.worked_out,
    edges=edges,
    made_surfaces=SURFACES,
    release={"verify.part_file": (MILLING,)},
)
