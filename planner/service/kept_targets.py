"""Targets that were made for uploads, kept as files for a while: an edit of the cell leaves them as they are.

A whole check takes those of the very same problem. A first look takes those of a problem that differs in
nothing that a process sees as well: a job is made of its operation, of tools, controller and wires of the
cell, of block and part, so where arms and block stand, obstacles, margins and names do not count, but how a
block leans does. Brief ones, which a first look made, are for first looks alone.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.pipeline import Make
from planner.problem import Problem
from planner.reading import problem as problem_file
from planner.service.kept_files import KeptFiles
from planner.targets import Job, Targets

UNSEEN: Final = ("name", "settings", "accept")
"""Fields of a problem that no process sees;"""
UNSEEN_CELL: Final = ("name", "obstacles")
"""of its cell,"""
UNSEEN_ARM: Final = ("base", "home_deg")
"""of an arm,"""
UNSEEN_STOCK: Final = ("place",)
"""of the stock, or a sheet, and of the setup of an operation."""
DECIMALS: Final = 9
"""To which directions are compared."""


def seen(source: Mapping[str, Any]) -> str:
    """The digest of what processes see of a problem's values, but how its blocks lean."""
    out = _without(source, UNSEEN)
    if isinstance(out.get("cell"), Mapping):
        out["cell"] = _without(out["cell"], UNSEEN_CELL)
        if isinstance(out["cell"].get("arms"), list):
            out["cell"]["arms"] = _each_without(out["cell"]["arms"], UNSEEN_ARM)
    for name in ("stock", "sheet"):
        if isinstance(out.get(name), Mapping):
            out[name] = _without(out[name], UNSEEN_STOCK)
    if isinstance(out.get("operations"), list):
        out["operations"] = [_placeless(one) for one in out["operations"]]
    return problem_file.digest(out)


def seen_alike(problem: Problem) -> str:
    """The same of a problem, with how each setup's block leans: wires sag, and what is cut loose falls."""
    lean = [np.round(setup.stock.gravity, DECIMALS).tolist() for setup in problem.setups]
    return problem_file.digest({"seen": seen(problem.source), "gravity": lean})


def _placeless(operation: Any) -> Any:
    """An operation whose setup says of the block's place nothing."""
    if not isinstance(operation, Mapping) or not isinstance(operation.get("setup"), Mapping):
        return operation
    return {**operation, "setup": _without(operation["setup"], UNSEEN_STOCK)}


def _each_without(values: list[Any], fields: tuple[str, ...]) -> list[Any]:
    return [_without(one, fields) if isinstance(one, Mapping) else one for one in values]


def _without(values: Mapping[str, Any], fields: tuple[str, ...]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key not in fields}


def maker(kept: KeptFiles, problem: Problem, alike: bool) -> Make:
    """What makes the targets of a problem's operations and keeps them, or finds them; ``alike``: those of a
    problem that processes see alike will do."""
    same, like = problem.digest, seen_alike(problem)

    def make(index: int, job: Job[Any]) -> Targets:
        whole = [f"{same}-{index}", f"{like}-{index}"]
        brief = f"{like}-{index}-brief"
        for name in whole if alike else whole[:1]:
            if isinstance(found := kept.get(name), Targets):
                return found
        if job.brief and alike and isinstance(found := kept.get(brief), Targets):
            return found
        made = job.targets()
        first, *others = [brief] if job.brief else whole
        kept.put(first, made, others)
        return made

    return make
