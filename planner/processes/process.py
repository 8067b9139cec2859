"""The interface of a manufacturing process."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

from pydantic import BaseModel

from planner.claims.claim import Claim
from planner.problem import Part, Setup
from planner.targets import Job


class Process(NamedTuple):
    """A manufacturing process.

    Attributes:
        schema: Schema of the operation (:class:`planner.problem.Operation`: name, process, arms, and
            ``leaves``, the block as the next operation finds it).
        module: Module of the process's jobs. It is imported on first use.
        name: Class of the process's jobs in that module.
        claims: Kinds of claims that only this process makes. They are imported with the process, so that
            plans that contain them can be loaded.
    """

    schema: type[BaseModel]
    module: str
    name: str
    claims: tuple[type[Claim], ...] = ()

    def job(
        self, operation: Any, setup: Setup, part: Part | None, advise: bool = True, brief: bool = False
    ) -> Job[Any]:
        """The job of an operation of this process."""
        made: Job[Any] = getattr(import_module(self.module), self.name)(operation, setup, part)
        for name, value in {"advise": advise, "brief": brief}.items():
            object.__setattr__(made, name, value)  # jobs of installed packages are made of the three alone
        return made
