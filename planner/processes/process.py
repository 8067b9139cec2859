"""The interface of a manufacturing process."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

from pydantic import BaseModel

from planner.problem import Part, Setup
from planner.targets import Job


class Process(NamedTuple):
    """Schema of the operation (:class:`planner.problem.Operation`: name, process, arms, and ``leaves``, the
    block as the next operation finds it), and the module and class of the process's jobs."""

    schema: type[BaseModel]
    module: str
    name: str

    def job(
        self, operation: Any, setup: Setup, part: Part | None, advise: bool = True, brief: bool = False
    ) -> Job[Any]:
        """The job of an operation of this process."""
        made: Job[Any] = getattr(import_module(self.module), self.name)(operation, setup, part)
        for name, value in {"advise": advise, "brief": brief}.items():
            object.__setattr__(made, name, value)  # jobs of installed packages are made of the three alone
        return made
