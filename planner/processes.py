"""The registry of processes: one line each. A process turns an operation on a stock into Targets and states
its claims.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from pydantic import BaseModel

from planner import posed
from planner.claims import Claim
from planner.hotwire import elastic
from planner.hotwire.operation import ElasticWire
from planner.problem import Operation, Part, Problem, Stock
from planner.targets import Targets


class Process(NamedTuple):
    """Schema of the operation, and the two functions that a process exports: (operation, stock, part) ->
    ...
    """

    schema: type[BaseModel]
    make_targets: Callable[[Any, Stock, Part | None], Targets]
    claims: Callable[[Any, Stock, Part | None], tuple[Claim, ...]]


PROCESSES: Final[Mapping[str, Process]] = {
    "elastic_wire": Process(ElasticWire, elastic.make_targets, elastic.claims),
    "targets": Process(posed.Posed, posed.make_targets, posed.claims),
}


def schemas() -> dict[str, type[BaseModel]]:
    """The operation schema of every process, by the word that problem files use."""
    return {name: process.schema for name, process in PROCESSES.items()}


def make_targets(problem: Problem, operation: Operation) -> Targets:
    """The targets of one operation; raises ``TandemError`` where the process cannot make the part."""
    return PROCESSES[operation.process].make_targets(operation, problem.stock, problem.part)


def claims(problem: Problem) -> dict[str, tuple[Claim, ...]]:
    """What must hold of each operation, by its name, from the problem alone."""
    return {
        op.name: PROCESSES[op.process].claims(op, problem.stock, problem.part) for op in problem.operations
    }
