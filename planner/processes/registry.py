"""The registry of processes: one line each, and those of installed packages.

A process turns an operation on a stock into a job: its targets and what must hold of them. What it
needs for that is imported where a problem first asks for it. A package adds one by an entry point of
the group ``tandem.processes``: its name is the word in problem files, its object a :class:`Process`.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

from pydantic import BaseModel

from planner.cell import sag
from planner.claims.claim import Claim
from planner.issues import Issue, TandemError
from planner.problem import Problem
from planner.processes.forming import claims as forming_claims
from planner.processes.forming.plan.operation import Forming
from planner.processes.hotwire import claims as hotwire_claims
from planner.processes.hotwire.plan.operation import ElasticWire, Straight
from planner.processes.milling import claims as milling_claims
from planner.processes.milling.plan.operation import Milling
from planner.processes.poses import claims as poses_claims
from planner.processes.poses.plan.job import Posed
from planner.processes.process import Process
from planner.processes.trim import claims as trim_claims
from planner.processes.trim.plan.operation import Trim
from planner.targets import Job

PROCESSES: Final[Mapping[str, Process]] = {
    "forming": Process(Forming, "planner.processes.forming.plan.job", "FormingJob", forming_claims.CLAIMS),
    "elastic_wire": Process(
        ElasticWire, "planner.processes.hotwire.plan.elastic.job", "ElasticJob", hotwire_claims.CLAIMS
    ),
    "straight_wire": Process(
        Straight, "planner.processes.hotwire.plan.straight.job", "StraightJob", hotwire_claims.CLAIMS
    ),
    "milling": Process(Milling, "planner.processes.milling.plan.job", "MillingJob", milling_claims.CLAIMS),
    "trim": Process(Trim, "planner.processes.trim.plan.job", "TrimJob", trim_claims.CLAIMS),
    "targets": Process(Posed, "planner.processes.poses.plan.job", "PosedJob", poses_claims.CLAIMS),
}
GROUP: Final = "tandem.processes"
"""Entry points by which installed packages add processes."""


@functools.cache
def all_processes() -> Mapping[str, Process | Issue]:
    """All processes by the word that problem files use; of what cannot be used, or is claimed twice, the
    issue (``problem.process_package``) that says why. It stops no problem but those that name it."""
    found: dict[str, Process | Issue] = dict(PROCESSES)
    owners = dict.fromkeys(PROCESSES, "Tandem")
    for point in sorted(entry_points(group=GROUP), key=lambda one: (one.name, one.value)):
        owner = f"package {point.dist.name}" if point.dist is not None else point.value
        if point.name in owners:
            what = f"the process {point.name!r} is claimed by {owners[point.name]} and by {owner}"
            hint = "uninstall one of them, or give its entry point another name"
            found[point.name] = Issue("problem.process_package", f"{what}; {hint}")
        else:
            found[point.name] = _loaded(point, owner)
            owners[point.name] = owner
    return found


def _loaded(point: EntryPoint, owner: str) -> Process | Issue:
    try:
        made = point.load()
    except Exception as error:  # whatever goes wrong while somebody else's code is imported
        fault = f"cannot be imported ({type(error).__name__}: {error})"
    else:
        if isinstance(made, Process) and isinstance(made.schema, type) and issubclass(made.schema, BaseModel):
            lacking = [name for name in ("name", "process", "arms") if name not in made.schema.model_fields]
            lacking += ["leaves()"] if not callable(getattr(made.schema, "leaves", None)) else []
            if not lacking:
                return made
            fault = f"has a schema without {', '.join(lacking)}, which every operation has"
        else:
            kind = type(made).__name__
            fault = f"is {kind}, not a planner.processes.Process with the schema of its operation"
    what = f"the process {point.name!r} of {owner} {fault}"
    return Issue("problem.process_package", f"{what}; mend or uninstall {owner} ({point.value})")


def schemas() -> dict[str, type[BaseModel]]:
    """The operation schema of every process that can be used, by the word that problem files use."""
    return {name: one.schema for name, one in all_processes().items() if isinstance(one, Process)}


def readers() -> dict[str, type[BaseModel] | Issue]:
    """What reads the operations of a problem file, by process: a schema, or why there is none."""
    return {name: one.schema if isinstance(one, Process) else one for name, one in all_processes().items()}


def job(problem: Problem, index: int, advise: bool = True, brief: bool = False) -> Job[Any]:
    """The job of one operation, by its index; it looks for what would help where it ends, with ``advise``,
    and makes targets for a first look alone if it is ``brief``. Raises ``TandemError`` where its process
    cannot be used."""
    operation = problem.operations[index]
    process = all_processes()[operation.process]
    if isinstance(process, Issue):
        raise TandemError(process)
    return process.job(operation, problem.found_by(index), problem.part, advise, brief)


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
