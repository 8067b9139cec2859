"""The rule on the clearance of bent wires."""

from __future__ import annotations

import numpy as np

from planner.cell.clearance import Against, edge
from planner.geometry.arrays import FloatArray, IntArray
from planner.issues import Issue
from planner.processes.hotwire.proof.wire_motion import WIRES
from planner.proof.context import Context
from planner.proof.models import MODELS
from planner.proof.rule import Outcome, at_sample, mm, rule
from planner.proof.rules.clearance import accepted

_NEAR_CLAMP_M = 0.02
"""Length of wire [m] next to a clamp whose distance to that clamp is not checked."""


@rule("verify.wire_clearance", ahead="wires")
def wire_bodies(context: Context) -> Outcome:
    """A bent wire keeps clear of everything, but of the stock only where it does not cut."""
    models, issues = context.get(MODELS), list[Issue]()
    series, least, where = dict[str, FloatArray](), np.inf, ""
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
                measure = (mm(found.distance[i]), mm(limit), "mm")
                sample, arm = int(rows[i]), wire.arms[0]
                issues.append(
                    at_sample("verify.wire_clearance", message, context.motion, arm, sample, measure, pair)
                )
            k = found.worst()
            if found.distance[k] < least:
                least, where = float(found.distance[k]), " and ".join(found.pair[k])
    if not np.isfinite(least):
        return Outcome(tuple(issues), nothing="no bent wire", series=series)
    return Outcome(tuple(issues), mm(least), mm(limit), "mm", where, series=series)
