"""The figures of an outcome that summaries and comparisons show, by names that end in their units."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

from planner.plans import Plan
from planner.verify.result import RuleResult

MARGINS: Final[dict[str, str]] = {
    "verify.clearance": "clearance_mm",
    "verify.joint_limits": "joint_limits_deg",
    "verify.joint_speed": "joint_speed_percent",
    "verify.singularity": "singularity_deg",
    "verify.surface": "surface_percent",
}
"""Rules of the proof whose worst values are figures: least distance, least distance to a limit, greatest
share of a limit, least distance to a singularity, share of the cut faces within tolerance."""


def figures(plan: Plan, rules: Iterable[RuleResult]) -> dict[str, float]:
    """``targets``, ``cycle_s`` [s], ``path_cost``, and the worst values of `MARGINS`.

    What a plan or proof does not know, or is not finite, is left out.
    """
    out: dict[str, float] = {
        "targets": float(sum(operation.targets.count for operation in plan.operations)),
        "cycle_s": sum(float(operation.time[-1]) for operation in plan.operations if len(operation.time)),
    }
    costs = [operation.metrics.get("trajopt_cost") for operation in plan.operations]
    known = [float(cost) for cost in costs if isinstance(cost, int | float)]
    if known and len(known) == len(costs):
        out["path_cost"] = sum(known)
    for rule in rules:
        if rule.code in MARGINS and rule.worst is not None:
            out[MARGINS[rule.code]] = float(rule.worst)
    return {name: value for name, value in out.items() if math.isfinite(value)}
