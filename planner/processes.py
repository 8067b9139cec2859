"""The registry of processes: one line each. A process turns an operation on a stock into Targets and states
its claims. What it needs for that is imported where a problem first asks for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, Final, NamedTuple

from pydantic import BaseModel

from planner.claims import Claim
from planner.forming.operation import Forming
from planner.hotwire.operation import ElasticWire
from planner.hotwire.straight_operation import Straight
from planner.milling.operation import Milling
from planner.posed import Posed
from planner.problem import Part, Problem, Setup
from planner.targets import Targets


class Process(NamedTuple):
    """Schema of the operation, and the module that exports the two functions of the process."""

    schema: type[BaseModel]
    module: str

    def make_targets(self, operation: Any, setup: Setup, part: Part | None) -> Targets:
        """The targets of an operation of this process."""
        made: Targets = import_module(self.module).make_targets(operation, setup, part)
        return made

    def claims(self, operation: Any, setup: Setup, part: Part | None) -> tuple[Claim, ...]:
        """What must hold of the operation."""
        made: tuple[Claim, ...] = import_module(self.module).claims(operation, setup, part)
        return made


PROCESSES: Final[Mapping[str, Process]] = {
    "forming": Process(Forming, "planner.forming.forming"),
    "elastic_wire": Process(ElasticWire, "planner.hotwire.elastic"),
    "straight_wire": Process(Straight, "planner.hotwire.straight"),
    "milling": Process(Milling, "planner.milling.milling"),
    "targets": Process(Posed, "planner.posed"),
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
