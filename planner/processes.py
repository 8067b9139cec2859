"""The registry of processes: one line each. A process turns an operation on a stock into a job: its targets
and what must hold of them. What it needs for that is imported where a problem first asks for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from planner.targets import Job


class Process(NamedTuple):
    """Schema of the operation, and the module and class of the process's jobs."""

    schema: type[BaseModel]
    module: str
    name: str

    def job(self, operation: Any, setup: Setup, part: Part | None) -> Job[Any]:
        """The job of an operation of this process."""
        made: Job[Any] = getattr(import_module(self.module), self.name)(operation, setup, part)
        return made


PROCESSES: Final[Mapping[str, Process]] = {
    "forming": Process(Forming, "planner.forming.forming", "FormingJob"),
    "elastic_wire": Process(ElasticWire, "planner.hotwire.elastic", "ElasticJob"),
    "straight_wire": Process(Straight, "planner.hotwire.straight", "StraightJob"),
    "milling": Process(Milling, "planner.milling.milling", "MillingJob"),
    "targets": Process(Posed, "planner.posed", "PosedJob"),
}


def schemas() -> dict[str, type[BaseModel]]:
    """The operation schema of every process, by the word that problem files use."""
    return {name: process.schema for name, process in PROCESSES.items()}


def job(problem: Problem, index: int) -> Job[Any]:
    """The job of one operation, by its index."""
    operation = problem.operations[index]
    return PROCESSES[operation.process].job(operation, problem.setup_of(index), problem.part)


def jobs(problem: Problem) -> tuple[Job[Any], ...]:
    """The jobs of all operations, in order."""
    return tuple(job(problem, index) for index in range(len(problem.operations)))


def claims(problem: Problem, made: Sequence[Job[Any]] | None = None) -> dict[str, tuple[Claim, ...]]:
    """What must hold of each operation, by its name; ``made`` are the problem's jobs where there are some."""
    return {
        operation.name: one.claims()
        for operation, one in zip(problem.operations, made or jobs(problem), strict=True)
    }
