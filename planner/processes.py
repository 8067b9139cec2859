"""The registry of processes: one line each. A process turns an operation on a stock into Targets and states
its claims.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from pydantic import BaseModel

from planner import posed
from planner.claims import Claim
from planner.forming import forming
from planner.forming.operation import Forming
from planner.hotwire import elastic, straight
from planner.hotwire.operation import ElasticWire
from planner.hotwire.straight_operation import Straight
from planner.milling import milling
from planner.milling.operation import Milling
from planner.problem import Part, Problem, Setup
from planner.targets import Targets


class Process(NamedTuple):
    """Schema of the operation, and the two functions that a process exports: (operation, setup, part) ->
    ...
    """

    schema: type[BaseModel]
    make_targets: Callable[[Any, Setup, Part | None], Targets]
    claims: Callable[[Any, Setup, Part | None], tuple[Claim, ...]]


PROCESSES: Final[Mapping[str, Process]] = {
    "forming": Process(Forming, forming.make_targets, forming.claims),
    "elastic_wire": Process(ElasticWire, elastic.make_targets, elastic.claims),
    "straight_wire": Process(Straight, straight.make_targets, straight.claims),
    "milling": Process(Milling, milling.make_targets, milling.claims),
    "targets": Process(posed.Posed, posed.make_targets, posed.claims),
}


def schemas() -> dict[str, type[BaseModel]]:
    """The operation schema of every process, by the word that problem files use."""
    return {name: process.schema for name, process in PROCESSES.items()}


def make_targets(problem: Problem, index: int) -> Targets:
    """The targets of one operation, by its index; raises ``TandemError`` where the process cannot make the
    part.
    """
    operation = problem.operations[index]
    return PROCESSES[operation.process].make_targets(operation, problem.setup_of(index), problem.part)


def claims(problem: Problem) -> dict[str, tuple[Claim, ...]]:
    """What must hold of each operation, by its name, from the problem alone."""
    return {
        op.name: PROCESSES[op.process].claims(op, problem.setup_of(i), problem.part)
        for i, op in enumerate(problem.operations)
    }
