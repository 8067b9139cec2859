"""The door of this package: a plan and its problem in, program files out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planner.issues import Issue, TandemError
from planner.plans import Plan
from planner.post import controller, handshake_drift, krl, krl_notes, krl_spline, languages, names, rapid
from planner.post.handshake import refusals as refused
from planner.post.program import Job
from planner.post.steps import build
from planner.problem import Problem
from planner.targets import Targets


def programs(plan: Plan, problem: Problem, margins: Mapping[str, str] | None = None) -> dict[str, str]:
    """Texts of the program files by relative name, such as ``T_ROB1/TandemMain_1.mod``; of two controllers,
    and of KUKA arms, in folders by arm, such as ``left/TandemMain_1.mod`` or ``left/ruled_wall.src``.

    Each arm gets the language of its controller; files for the controllers themselves are in
    ``controller/``. ``margins``: results of the proof by name, as text; they go into the headers' comments
    only. Raises :class:`TandemError` with codes ``post.*`` when the plan cannot be written.
    """
    return _texts(_job(plan, problem), plan, problem, margins or {})


def refusals(problem: Problem, targets: Sequence[Targets]) -> tuple[Issue, ...]:
    """Why no program can be written for these targets, one an operation, however they are planned."""
    alone = problem.cell.controller.sync == "handshake"
    return (
        *languages.refusals(problem, targets),
        *krl_spline.refusals(problem, targets),
        *names.refusals(problem, targets),
        *(refused(problem, targets) if alone else ()),
    )


def notes(plan: Plan, problem: Problem) -> tuple[Issue, ...]:
    """What the user should know of the programs beside their text: the drift of arms that meet by handshake,
    and what is left to a KUKA controller.

    Raises as :func:`programs` does.
    """
    krl_spoken = any(map(languages.speaks_krl, problem.cell.arms))
    if problem.cell.controller.sync != "handshake" and not krl_spoken:
        return ()
    job = _job(plan, problem)
    files = _texts(job, plan, problem, {}) if krl_spoken else {}
    return (*handshake_drift.issues(job), *krl_notes.notes(job, plan, problem, files))


def _job(plan: Plan, problem: Problem) -> Job:
    issues = languages.refusals(problem, [operation.targets for operation in plan.operations])
    if issues:
        raise TandemError(issues)
    return build(plan, problem)


def _texts(job: Job, plan: Plan, problem: Problem, margins: Mapping[str, str]) -> dict[str, str]:
    families = {task.robot.family for task in job.tasks}
    out = rapid.texts(job, plan, problem, margins) if "ABB" in families else {}
    out |= krl.texts(job, plan, problem, margins) if "KUKA" in families else {}
    return out | controller.texts(job, plan, problem)
