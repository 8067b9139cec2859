"""Items and rows of a batch, and the figures of a result that summaries and comparisons show.

The name of a figure ends with its unit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Final

from planner.batch.job import Done

if TYPE_CHECKING:
    from planner.plans import Plan
    from planner.problem import Problem
    from planner.proof.verdict import RuleResult

RECORDS: Final = ".records"
"""The folder, beside the results, of what a batch remembers of its jobs."""


@dataclasses.dataclass(frozen=True)
class Item:
    """One problem of a batch: its ``name`` among the results, where it comes from, how to read it (raises
    ``TandemError``), and the values that a batch file gave it. ``like``: the item whose plan its own begins
    with."""

    name: str
    origin: str
    read: Callable[[], Problem]
    varied: Mapping[str, object] = dataclasses.field(default_factory=dict)
    like: str | None = None


@dataclasses.dataclass(frozen=True)
class Row:
    """One item of a batch and how it ended; ``kept``: in an earlier run."""

    item: Item
    done: Done
    kept: bool = False


FIGURE_OF_RULE: Final[dict[str, str]] = {
    "verify.clearance": "clearance_mm",
    "verify.own_clearance": "own_clearance_mm",
    "verify.joint_limits": "joint_limits_deg",
    "verify.joint_speed": "joint_speed_percent",
    "verify.singularity": "singularity_deg",
    "verify.surface": "surface_percent",
}
"""Rules of the proof whose worst values are figures: least distance, least distance to a limit, greatest
share of a limit, least distance to a singularity, share of the cut faces within tolerance."""


def figures(plan: Plan, rules: Iterable[RuleResult]) -> dict[str, float]:
    """``targets``, ``cycle_s`` [s] from first to last target, ``travel_s`` [s] of tracks and turntables where
    there are any, ``path_cost``, and the worst values of `FIGURE_OF_RULE`.

    What a plan or proof does not know, or is not finite, is left out.
    """
    out: dict[str, float] = {
        "targets": float(sum(operation.targets.count for operation in plan.operations)),
        "cycle_s": plan.duration,
    }
    if "travel_s" in plan.metrics:
        out["travel_s"] = float(plan.metrics["travel_s"])
    costs = [operation.metrics.get("trajopt_cost") for operation in plan.operations]
    known = [float(cost) for cost in costs if isinstance(cost, int | float)]
    if known and len(known) == len(costs):
        out["path_cost"] = sum(known)
    for rule in rules:
        if rule.code in FIGURE_OF_RULE and rule.worst is not None:
            out[FIGURE_OF_RULE[rule.code]] = float(rule.worst)
    return {name: value for name, value in out.items() if math.isfinite(value)}
