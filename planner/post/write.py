"""The door of this package: a plan and its problem in, program files out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planner.issues import Issue, TandemError
from planner.plans import Plan
from planner.post import handshake_drift, rapid
from planner.post.handshake import refusals as refused
from planner.post.program import Job
from planner.post.steps import build
from planner.problem import Problem
from planner.targets import Targets


def programs(plan: Plan, problem: Problem, margins: Mapping[str, str] | None = None) -> dict[str, str]:
    """Texts of the program files by relative name, such as ``T_ROB1/TandemMain_1.mod``; of two controllers in
    folders by arm, such as ``left/TandemMain_1.mod``.

    ``margins``: results of the proof by name, as text; they go into the headers' comments only.
    Raises :class:`TandemError` with codes ``post.*`` when the plan cannot be written.
    """
    job = build(plan, problem)
    return rapid.texts(_checked(job), plan, problem, margins or {})


def refusals(problem: Problem, targets: Sequence[Targets]) -> tuple[Issue, ...]:
    """Why no program can be written for these targets, one an operation, however they are planned."""
    return refused(problem, targets) if problem.cell.controller.sync == "handshake" else ()


def notes(plan: Plan, problem: Problem) -> tuple[Issue, ...]:
    """What the user should know of the programs beside their text: the drift of arms that meet by handshake.

    Raises as :func:`programs` does.
    """
    if problem.cell.controller.sync != "handshake":
        return ()
    return handshake_drift.issues(_checked(build(plan, problem)))


def _checked(job: Job) -> Job:
    foreign = [task.arm for task in job.tasks if task.robot.family != "ABB"]
    if foreign:
        names = ", ".join(f"{arm.name} ({arm.robot})" for arm in foreign)
        message = f"no program can be written for {names}; allowed are robots with an ABB controller"
        raise TandemError(Issue("post.controller", message, hint="take an ABB robot of the catalogue"))
    return job
