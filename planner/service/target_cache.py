"""Cache of targets that were computed for uploads. An edit of the cell leaves most of them valid.

- A full check uses cached targets of an identical problem.
- A quick check also uses cached targets of an equivalent problem: one that differs only in values that no
  process uses. A process creates a job from its operation, from tools, controller and wires of the cell, and
  from block and part. Poses of arms and block, obstacles, margins and names do not matter, but the
  orientation of a block to gravity does.
- Brief targets, which are computed for a quick check, are used by quick checks only.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.pipeline import TargetFactory
from planner.problem import Problem
from planner.reading import problem as problem_file
from planner.service.file_cache import FileCache
from planner.targets import Job, Targets

UNUSED_FIELDS: Final = ("name", "settings", "accept")
"""Fields of a problem that no process uses."""
UNUSED_CELL_FIELDS: Final = ("name", "obstacles")
"""Fields of a cell that no process uses."""
UNUSED_ARM_FIELDS: Final = ("base", "home_deg")
"""Fields of an arm that no process uses."""
UNUSED_STOCK_FIELDS: Final = ("place",)
"""Fields of a stock, a sheet and the setup of an operation that no process uses."""
GRAVITY_DECIMALS: Final = 9
"""Decimals to which directions of gravity are compared."""


def used_values_digest(source: Mapping[str, Any]) -> str:
    """Return the digest of those values of a problem that processes use, without the pose of its blocks.

    Args:
        source: Values of the problem file.
    """
    values = _without(source, UNUSED_FIELDS)
    if isinstance(values.get("cell"), Mapping):
        values["cell"] = _without(values["cell"], UNUSED_CELL_FIELDS)
        if isinstance(values["cell"].get("arms"), list):
            values["cell"]["arms"] = _without_in_each(values["cell"]["arms"], UNUSED_ARM_FIELDS)
    for name in ("stock", "sheet"):
        if isinstance(values.get(name), Mapping):
            values[name] = _without(values[name], UNUSED_STOCK_FIELDS)
    if isinstance(values.get("operations"), list):
        values["operations"] = [_without_stock_pose(operation) for operation in values["operations"]]
    return problem_file.problem_digest(values)


def equivalence_digest(problem: Problem) -> str:
    """Return the digest of all that processes use, including the direction of gravity in each setup.

    Gravity matters because wires sag and loose pieces fall.

    Args:
        problem: Problem.
    """
    gravity = [np.round(setup.stock.gravity, GRAVITY_DECIMALS).tolist() for setup in problem.setups]
    return problem_file.problem_digest({"seen": used_values_digest(problem.source), "gravity": gravity})


def _without_stock_pose(operation: Any) -> Any:
    """Return an operation whose setup does not state the block's pose."""
    if not isinstance(operation, Mapping) or not isinstance(operation.get("setup"), Mapping):
        return operation
    return {**operation, "setup": _without(operation["setup"], UNUSED_STOCK_FIELDS)}


def _without_in_each(values: list[Any], fields: tuple[str, ...]) -> list[Any]:
    return [_without(value, fields) if isinstance(value, Mapping) else value for value in values]


def _without(values: Mapping[str, Any], fields: tuple[str, ...]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key not in fields}


def cached_targets_maker(cache: FileCache, problem: Problem, accept_equivalent: bool) -> TargetFactory:
    """Return a function that computes targets of operations and caches them.

    Args:
        cache: Cache.
        problem: Problem.
        accept_equivalent: Also accept targets of equivalent problems, and brief targets.

    Returns:
        Function of the index of an operation and its job.
    """
    exact_key, equivalence_key = problem.digest, equivalence_digest(problem)

    def make(index: int, job: Job[Any]) -> Targets:
        # names of the cached targets of this operation: complete ones, and brief ones of a quick check
        full_names = [f"{exact_key}-{index}", f"{equivalence_key}-{index}"]
        brief_name = f"{equivalence_key}-{index}-brief"
        for name in full_names if accept_equivalent else full_names[:1]:
            if isinstance(cached := cache.get(name), Targets):
                return cached
        if job.is_brief and accept_equivalent and isinstance(cached := cache.get(brief_name), Targets):
            return cached
        targets = job.targets()
        first_name, *other_names = [brief_name] if job.is_brief else full_names
        cache.put(first_name, targets, other_names)
        return targets

    return make
