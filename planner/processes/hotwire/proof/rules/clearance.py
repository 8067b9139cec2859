"""Rule on the clearance of bent wires."""

import dataclasses

import numpy as np

from planner.cell.clearance import Against, FlexibleEdge, edge_clearance
from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.hotwire.proof.wire_motion import WIRES
from planner.proof.context import Context
from planner.proof.findings import Findings, measure_in_mm
from planner.proof.models import MODELS
from planner.proof.rule import RuleOutcome, mm, rule
from planner.proof.rules.clearance import min_accepted_clearance

_NEAR_CLAMP_M = 0.02
"""Length of wire [m] next to a clamp for which the clearance to that clamp is not checked."""


@rule("verify.wire_clearance", parallel_group="wires")
def wire_bodies(context: Context) -> RuleOutcome:
    """A bent wire keeps clear of everything. The stock is exempt only where the wire cuts."""
    models, findings = context.get(MODELS), Findings("verify.wire_clearance", context, worst=np.inf)
    series = dict[str, FloatArray]()
    limit = context.problem.settings.clearance
    for number, wire in enumerate(context.get(WIRES), 1):
        distance = np.full(len(wire.sample), np.nan)
        series[f"wire/{number}/clearance"] = distance
        if wire.path is None:
            continue
        is_cutting = wire.is_cutting
        groups: tuple[tuple[Against, IntArray], ...] = (
            ("no_stock", np.flatnonzero(is_cutting)),
            ("all", np.flatnonzero(~is_cutting)),
        )
        for against, selected in groups:
            if not len(selected):
                continue
            samples = wire.sample[selected]
            result = edge_clearance(
                models(wire.setup),
                {arm: context.motion.link_joints[arm][samples] for arm in wire.arms},
                FlexibleEdge(wire.world_points[selected], wire.radius, _NEAR_CLAMP_M),
                against,
            )
            distance[selected] = result.distance
            for i in np.flatnonzero(~(result.distance >= min_accepted_clearance(limit))):
                pair = result.pair[int(i)]
                message = (
                    f"the wire comes within {mm(result.distance[i]):.2f} mm of {' and '.join(pair)}; "
                    f"allowed: {mm(limit):.2f} mm"
                )
                measure = measure_in_mm(result.distance[i], limit)
                findings.add_at_sample(message, wire.arms[0], samples[i], measure, pair)
            k = result.worst()
            findings.note_lowest(result.distance[k], " and ".join(result.pair[k]))
    return dataclasses.replace(findings.outcome(mm, "mm", limit, nothing="no bent wire"), series=series)
