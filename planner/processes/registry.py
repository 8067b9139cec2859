"""Registry of processes, for the planner and the readers of problem files.

A process turns an operation on a stock into a job: its targets, and the claims that must hold. Its modules
are imported when a problem first needs them. For the plug-in point see :mod:`planner.runtime.plugins`.
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
from planner.runtime.plugins import LoadedPlugin, PluginError, Process
from planner.targets import Job


@functools.cache
def all_processes() -> Mapping[str, Process | Issue]:
    """Return all processes by the word that problem files use.

    A process that cannot be used is an issue (``problem.process_package``) that says why. It stops only
    problems that name it.
    """
    return {name: _validate_process(name, plugin) for name, plugin in plugins.installed(Process).items()}


def _validate_process(name: str, plugin: LoadedPlugin) -> Process | Issue:
    """Return the process of a plug-in, or the issue that it cannot be used.

    The parts that reading a problem needs are loaded and checked: schema, claims and issue codes.
    """
    process = plugin.plugin
    if not isinstance(process, Process):
        return Issue("problem.process_package", plugin.fault)
    try:
        fault = (
            (_codes_fault(name, plugin.owner) if process.codes is not None else "")
            or (_claims_fault(name) if process.claims is not None else "")
            or _schema_fault(plugins.part_of(Process, name, "schema", type))
        )
    except PluginError as error:
        return Issue("problem.process_package", str(error))
    if fault:
        message = f"the process {name!r} of {plugin.owner} {fault}; repair or uninstall {plugin.owner}"
        return Issue("problem.process_package", message)
    return process


def _codes_fault(name: str, owner: str) -> str:
    """Return what is wrong with the issue codes of a process; empty if nothing is."""
    codes = plugins.part_of(Process, name, "codes", dict)
    for code, entry in codes.items():
        if not isinstance(entry, issue_codes.IssueCode):
            return (
                f"states the issue code {code!r} as {type(entry).__name__}, not planner.issue_codes.IssueCode"
            )
        others = sorted(issue_codes.code_owners(code) - {owner})
        if others:
            return f"states the issue code {code}, as {' and '.join(others)} does"
    return ""


def _claims_fault(name: str) -> str:
    """Return what is wrong with the kinds of claims of a process; empty if nothing is."""
    for kind in plugins.part_of(Process, name, "claims", tuple):
        if not (isinstance(kind, type) and issubclass(kind, Claim) and dataclasses.is_dataclass(kind)):
            return f"lists {kind!r} among its claims, which is not a dataclass that inherits from Claim"
    return ""


def _schema_fault(schema: type) -> str:
    """Return what is wrong with the operation schema of a process; empty if nothing is."""
    if not issubclass(schema, BaseModel):
        return f"has the schema {schema.__name__}, which is not a pydantic model"
    missing = [name for name in ("name", "process", "arms") if name not in schema.model_fields]
    missing += [] if callable(getattr(schema, "leaves", None)) else ["leaves()"]
    return f"has a schema without {', '.join(missing)}, which every operation has" if missing else ""


def _load_schema(process: Process) -> type[BaseModel]:
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
        setup: Cell and stock as the operation finds them.
        part: Part of the problem.
        advise: Whether the job searches for a remedy if it cannot be made.
        brief: Whether the job makes targets only for a quick check.
    """
    result: Job[Any] = plugins.load(process.job, type)(operation, setup, part)
    for name, value in {"advise": advise, "is_brief": brief}.items():
        object.__setattr__(result, name, value)  # job classes of other packages take only three arguments
    return result


def schemas() -> dict[str, type[BaseModel]]:
    """Return the operation schema of every process that can be used, by the word that problem files use."""
    return {
        name: _load_schema(process)
        for name, process in all_processes().items()
        if isinstance(process, Process)
    }


def readers() -> dict[str, type[BaseModel] | Issue]:
    """Return what reads the operations of a problem file, by process: a schema, or why there is none."""
    return {
        name: _load_schema(process) if isinstance(process, Process) else process
        for name, process in all_processes().items()
    }


def job(problem: Problem, index: int, advise: bool = True, brief: bool = False) -> Job[Any]:
    """Return the job of one operation.

    Args:
        problem: The problem.
        index: Index of the operation.
        advise: Whether the job searches for a remedy if it cannot be made.
        brief: Whether the job makes targets only for a quick check.

    Raises:
        TandemError: The process cannot be used.
    """
    operation = problem.operations[index]
    process = all_processes()[operation.process]
    if isinstance(process, Issue):
        raise TandemError(process)
    return make_job(process, operation, problem.setup_on_arrival(index), problem.part, advise, brief)


def jobs(problem: Problem, advise: bool = True, brief: bool = False) -> tuple[Job[Any], ...]:
    """Return the jobs of all operations in order. For ``advise`` and ``brief`` see :func:`job`."""
    return tuple(job(problem, index, advise, brief) for index in range(len(problem.operations)))


def claims(problem: Problem, known_jobs: Sequence[Job[Any]] | None = None) -> dict[str, tuple[Claim, ...]]:
    """Return the claims of each operation by its name.

    These are the claims of its job, and the claims on the sag of arms whose sag is compensated.

    Args:
        problem: The problem.
        known_jobs: Jobs of the problem, None to make them.
    """
    return {
        operation.name: (*operation_job.claims(), *sag.sag_claims(problem, problem.setup_of(index)))
        for index, (operation, operation_job) in enumerate(
            zip(problem.operations, known_jobs or jobs(problem), strict=True)
        )
    }
