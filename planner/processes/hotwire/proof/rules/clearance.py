"""The rule on the clearance of bent wires."""

import dataclasses

import numpy as np

from planner.cell.clearance import Against, edge
from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.hotwire.proof.wire_motion import WIRES
from planner.proof.context import Context
from planner.proof.findings import Findings, in_mm
from planner.proof.models import MODELS
from planner.proof.rule import Outcome, mm, rule
from planner.proof.rules.clearance import accepted

_NEAR_CLAMP_M = 0.02
"""Length of wire [m] next to a clamp whose distance to that clamp is not checked."""


@rule("verify.wire_clearance", ahead="wires")
def wire_bodies(context: Context) -> Outcome:
    """A bent wire keeps clear of everything, but of the stock only where it does not cut."""
    models, findings = context.get(MODELS), Findings("verify.wire_clearance", context, worst=np.inf)
    series = dict[str, FloatArray]()
    limit = context.problem.settings.clearance
    for number, wire in enumerate(context.get(WIRES), 1):
        distance = np.full(len(wire.sample), np.nan)
        series[f"wire/{number}/clearance"] = distance
        if wire.path is None:
            continue
        cut = wire.cutting
        groups: tuple[tuple[Against, IntArray], ...] = (
            ("no_stock", np.flatnonzero(cut)),
            ("all", np.flatnonzero(~cut)),
        )
        for against, chosen in groups:
            if not len(chosen):
                continue
            rows = wire.sample[chosen]
            found = edge(
                models(wire.setup),
                {arm: context.motion.links[arm][rows] for arm in wire.arms},
                wire.world[chosen],
                wire.radius,
                _NEAR_CLAMP_M,
                against,
            )
            distance[chosen] = found.distance
            for i in np.flatnonzero(~(found.distance >= accepted(limit))):
                pair = found.pair[int(i)]
                message = (
                    f"the wire comes within {mm(found.distance[i]):.2f} mm of {' and '.join(pair)}; "
                    f"allowed: {mm(limit):.2f} mm"
                )
                measure = in_mm(found.distance[i], limit)
                findings.at_sample(message, wire.arms[0], rows[i], measure, pair)
            k = found.worst()
            findings.lowest(found.distance[k], " and ".join(found.pair[k]))
    return dataclasses.replace(findings.outcome(mm, "mm", limit, nothing="no bent wire"), series=series)
