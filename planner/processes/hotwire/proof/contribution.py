"""Contribution of hot-wire cutting to the proof."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.claims.claim import Claim
from planner.processes.hotwire.claims import StraightWire
from planner.processes.hotwire.proof.rules import (
    clearance,
    cut_part,
    dialogue_figures,
    straight_wire,
    wire,
    wire_alone,
)
from planner.processes.hotwire.proof.surfaces import SURFACES
from planner.processes.hotwire.proof.wire_motion import WIRES, cut_segments
from planner.proof.context import Context
from planner.proof.contribution import ParallelGroup, ProofOfProcess, WorkingEdges


def cutting_edges(group: Sequence[Claim], arm: str) -> WorkingEdges | None:
    """Return the cutting edge of a bow, whose straight wire touches the stock where it cuts.

    None for other arms.

    Args:
        group: Claims of one operation.
        arm: Name of the arm.
    """
    if not any(isinstance(claim, StraightWire) and claim.arm == arm for claim in group):
        return None
    return WorkingEdges(cut_segments(group, (arm,)))


def wire_series(context: Context) -> Mapping[str, Any]:
    """Return shape, depth and feed of each wire over its stations.

    Bent wires also have stability and curvature.
    """
    out: dict[str, Any] = {}
    for n, one in enumerate(context.get(WIRES) if context.has(WIRES) else (), 1):
        if one.fault:
            continue
        out |= {
            f"wire/{n}/time": context.motion.time[one.sample],
            f"wire/{n}/label": one.labels,
            f"wire/{n}/points": one.points,
            f"wire/{n}/depth": one.depth,
            f"wire/{n}/feed": wire.feed_speed(context, one),
        }
        if one.path is not None:
            out |= {
                f"wire/{n}/stability": one.path.min_eigenvalue,
                f"wire/{n}/curvature": np.linalg.norm(one.path.curvature, axis=2).max(axis=1),
            }
    return out


PROOF: Final = ProofOfProcess(
    rules=(
        *(wire_alone.wire_alone, wire.wire_mount, wire.wire_length, wire.wire_stability, wire.curvature),
        *(wire.contact, wire.stop_in_foam, wire.wire_power, dialogue_figures.message_figures, wire.feed),
        *(straight_wire.bow, straight_wire.rulings, straight_wire.slit, straight_wire.kerf),
        *(cut_part.surface, cut_part.ridges, cut_part.part, clearance.wire_bodies),
    ),
    edges=cutting_edges,
    surface_producer=SURFACES,
    facts_at_start={"wires": (WIRES,)},
    parallel_groups=(
        ParallelGroup("wires", "wires", lambda context: bool(context.get(WIRES)) and not context.is_long),
    ),
    series=wire_series,
)
