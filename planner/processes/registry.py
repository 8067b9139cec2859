"""The registry of processes, for planner and readers.

A process turns an operation on a stock into a job: its targets, and the claims that must hold. What it needs
for that is imported where a problem first asks for it. For the plug-in point see
:mod:`planner.runtime.plugins`.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from planner import issue_codes
from planner.cell import sag
from planner.claims.claim import Claim
from planner.issues import Issue, TandemError
from planner.problem import Part, Problem, Setup
from planner.runtime import plugins
from planner.runtime.plugins import Found, PluginError, Process
from planner.targets import Job


@functools.cache
def all_processes() -> Mapping[str, Process | Issue]:
    """Return all processes by the word that problem files use.

    A process that cannot be used is an issue (``problem.process_package``) that says why. It stops only
    problems that name it.
    """
    return {name: _examined(name, found) for name, found in plugins.installed(Process).items()}


def _examined(name: str, found: Found) -> Process | Issue:
    """Load what reading a problem needs of a process: its schema, claims and issue codes."""
    process = found.plugin
    if not isinstance(process, Process):
        return Issue("problem.process_package", found.fault)
    try:
        if process.codes is not None:
            issue_codes.register(plugins.load(process.codes, dict))
        if process.claims is not None:
            plugins.load(process.claims, tuple)
        lacking = _lacking(plugins.load(process.schema, type))
        if lacking:
            raise PluginError(f"has a schema without {', '.join(lacking)}, which every operation has")
    except (PluginError, ValueError) as error:
        what = f"the process {name!r} of {found.owner} {error}; mend or uninstall {found.owner}"
        return Issue("problem.process_package", what)
    return process


def _lacking(schema: type) -> list[str]:
    """Name what a schema lacks of an operation."""
    if not issubclass(schema, BaseModel):
        raise PluginError(f"has the schema {schema.__name__}, which is no pydantic model")
    lacking = [name for name in ("name", "process", "arms") if name not in schema.model_fields]
    return lacking + ([] if callable(getattr(schema, "leaves", None)) else ["leaves()"])


def _schema(process: Process) -> type[BaseModel]:
    schema: type[BaseModel] = plugins.load(process.schema, type)
    return schema


def make_job(
    process: Process,
    operation: Any,
    setup: Setup,
    part: Part | None,
    advise: bool = True,
    brief: bool = False,
) -> Job[Any]:
    """Return the job of an operation.

    Args:
        process: Process of the operation.
        operation: Operation, an instance of the schema.
        setup: How the operation finds the cell.
        part: Part of the problem.
        advise: Whether the job looks for a remedy where it cannot be made.
        brief: Whether the job makes targets only for a first look.
    """
    made: Job[Any] = plugins.load(process.job, type)(operation, setup, part)
    for name, value in {"advise": advise, "brief": brief}.items():
        object.__setattr__(made, name, value)  # jobs of other packages are made of the three alone
    return made


def schemas() -> dict[str, type[BaseModel]]:
    """The operation schema of every process that can be used, by the word that problem files use."""
    return {name: _schema(one) for name, one in all_processes().items() if isinstance(one, Process)}


def readers() -> dict[str, type[BaseModel] | Issue]:
    """What reads the operations of a problem file, by process: a schema, or why there is none."""
    return {name: _schema(one) if isinstance(one, Process) else one for name, one in all_processes().items()}


def job(problem: Problem, index: int, advise: bool = True, brief: bool = False) -> Job[Any]:
    """The job of one operation, by its index; it looks for what would help where it ends, with ``advise``,
    and makes targets for a first look alone if it is ``brief``. Raises ``TandemError`` where its process
    cannot be used."""
    operation = problem.operations[index]
    process = all_processes()[operation.process]
    if isinstance(process, Issue):
        raise TandemError(process)
    return make_job(process, operation, problem.found_by(index), problem.part, advise, brief)


def jobs(problem: Problem, advise: bool = True, brief: bool = False) -> tuple[Job[Any], ...]:
    """The jobs of all operations, in order; ``advise`` and ``brief`` as in :func:`job`."""
    return tuple(job(problem, index, advise, brief) for index in range(len(problem.operations)))


def claims(problem: Problem, made: Sequence[Job[Any]] | None = None) -> dict[str, tuple[Claim, ...]]:
    """What must hold of each operation, by its name, and of arms that give way in it; ``made`` are the
    problem's jobs where there are some."""
    return {
        operation.name: (*one.claims(), *sag.sags(problem, problem.setup_of(index)))
        for index, (operation, one) in enumerate(zip(problem.operations, made or jobs(problem), strict=True))
    }
