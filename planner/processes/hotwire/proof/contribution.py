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
    """Return the segments in which the wire of an arm's bow may touch the stock, or None without a bow.

    Args:
        group: Claims of one operation.
        arm: Name of the arm.
    """
    if not any(isinstance(claim, StraightWire) and claim.arm == arm for claim in group):
        return None
    return WorkingEdges(cut_segments(group, (arm,)))


def wire_series(context: Context) -> Mapping[str, Any]:
    """Return series over the stations of each wire that could be followed, by name ``wire/<n>/<quantity>``.

    These are time, segment, shape, depth and feed. Bent wires also have stability and curvature.
    """
    out: dict[str, Any] = {}
    for n, wire_motion in enumerate(context.get(WIRES) if context.has(WIRES) else (), 1):
        if wire_motion.fault:
            continue
        out |= {
            f"wire/{n}/time": context.motion.time[wire_motion.sample],
            f"wire/{n}/label": wire_motion.labels,
            f"wire/{n}/points": wire_motion.points,
            f"wire/{n}/depth": wire_motion.depth,
            f"wire/{n}/feed": wire.feed_speed(context, wire_motion),
        }
        if wire_motion.path is not None:
            out |= {
                f"wire/{n}/stability": wire_motion.path.min_eigenvalue,
                f"wire/{n}/curvature": np.linalg.norm(wire_motion.path.curvature, axis=2).max(axis=1),
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
