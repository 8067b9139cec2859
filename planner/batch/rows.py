"""Items and rows of a batch, and the numeric values of a result that summaries and comparisons show.

The name of a value ends with its unit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Final

from planner.batch.job import JobResult

if TYPE_CHECKING:
    from planner.plans import Plan
    from planner.problem import Problem
    from planner.proof.verdict import RuleResult

RECORDS_FOLDER: Final = ".records"
"""Folder of the batch's records of its jobs, next to the results."""


@dataclasses.dataclass(frozen=True)
class BatchItem:
    """One problem of a batch.

    Attributes:
        name: Name of its result.
        origin: Where it comes from.
        read: Function that reads the problem. It raises ``TandemError``.
        varied: Values of the fields that a batch file varies, by path.
        reference: Name of the item whose plan is the reference plan, or None.
    """

    name: str
    origin: str
    read: Callable[[], Problem]
    varied: Mapping[str, object] = dataclasses.field(default_factory=dict)
    reference: str | None = None


@dataclasses.dataclass(frozen=True)
class BatchRow:
    """One item of a batch and its result.

    Attributes:
        item: The item.
        done: The result.
        is_kept: Whether the result is from an earlier run.
    """

    item: BatchItem
    done: JobResult
    is_kept: bool = False


FIGURE_OF_RULE: Final[dict[str, str]] = {
    "verify.clearance": "clearance_mm",
    "verify.own_clearance": "own_clearance_mm",
    "verify.joint_limits": "joint_limits_deg",
    "verify.joint_speed": "joint_speed_percent",
    "verify.singularity": "singularity_deg",
    "verify.surface": "surface_percent",
}
"""Names of the values that are the worst values of rules of the proof, by rule code.

In this order: smallest distance between bodies, and between an arm and itself, smallest distance to a joint
limit, largest fraction of a speed limit, smallest distance to a singularity, and fraction of the cut faces
within tolerance.
"""


def result_figures(plan: Plan, rules: Iterable[RuleResult]) -> dict[str, float]:
    """Return the values of a result by name.

    These are ``targets``, ``cycle_s`` [s] from first to last target, ``travel_s`` [s] of tracks and
    turntables if there are any, ``path_cost`` if all operations have one, and the worst values of
    `FIGURE_OF_RULE`. Unknown and infinite values are left out.
    """
    values: dict[str, float] = {
        "targets": float(sum(operation.targets.count for operation in plan.operations)),
        "cycle_s": plan.duration,
    }
    if "travel_s" in plan.metrics:
        values["travel_s"] = float(plan.metrics["travel_s"])
    costs = [operation.metrics.get("trajopt_cost") for operation in plan.operations]
    known_costs = [float(cost) for cost in costs if isinstance(cost, int | float)]
    if known_costs and len(known_costs) == len(costs):
        values["path_cost"] = sum(known_costs)
    for rule in rules:
        if rule.code in FIGURE_OF_RULE and rule.worst is not None:
            values[FIGURE_OF_RULE[rule.code]] = float(rule.worst)
    return {name: value for name, value in values.items() if math.isfinite(value)}
