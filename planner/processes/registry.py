"""The registry of processes, for planner and readers.

A process turns an operation on a stock into a job: its targets, and the claims that must hold. What it needs
for that is imported where a problem first asks for it. For the plug-in point see
:mod:`planner.runtime.plugins`.
"""

import dataclasses
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
        fault = (
            (_fault_of_codes(name, found.owner) if process.codes is not None else "")
            or (_fault_of_claims(name) if process.claims is not None else "")
            or _fault_of_schema(plugins.part_of(Process, name, "schema", type))
        )
    except PluginError as error:
        return Issue("problem.process_package", str(error))
    if fault:
        what = f"the process {name!r} of {found.owner} {fault}; mend or uninstall {found.owner}"
        return Issue("problem.process_package", what)
    return process


def _fault_of_codes(name: str, owner: str) -> str:
    """Say what is wrong with the issue codes of a process."""
    codes = plugins.part_of(Process, name, "codes", dict)
    for code, row in codes.items():
        if not isinstance(row, issue_codes.Code):
            return f"states the issue code {code!r} as {type(row).__name__}, not planner.issue_codes.Code"
        others = sorted(issue_codes.owners(code) - {owner})
        if others:
            return f"states the issue code {code}, as {' and '.join(others)} does"
    return ""


def _fault_of_claims(name: str) -> str:
    """Say what is wrong with the kinds of claims of a process."""
    for kind in plugins.part_of(Process, name, "claims", tuple):
        if not (isinstance(kind, type) and issubclass(kind, Claim) and dataclasses.is_dataclass(kind)):
            return f"lists {kind!r} among its claims, which is no dataclass that inherits from Claim"
    return ""


def _fault_of_schema(schema: type) -> str:
    if not issubclass(schema, BaseModel):
        return f"has the schema {schema.__name__}, which is no pydantic model"
    lacking = [name for name in ("name", "process", "arms") if name not in schema.model_fields]
    lacking += [] if callable(getattr(schema, "leaves", None)) else ["leaves()"]
    return f"has a schema without {', '.join(lacking)}, which every operation has" if lacking else ""


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
