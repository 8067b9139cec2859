"""What the user should know of KRL programs beside their text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.issues import Issue, Severity
from planner.plans import Plan
from planner.post import krl_spline, krl_tracks
from planner.post.krl_data import Data
from planner.post.krl_status import near_zero
from planner.post.program import Job, TaskProgram
from planner.problem import KrlDialect, Problem

MEMORY: Final = 4_000_000
"""Bytes that a controller has for programs (KSS 8.3, told in a forum)."""
TURN_OFF: Final = np.deg2rad(0.05)
"""A classical LIN and a turn about one axis may differ by so much [rad] before it is told."""


def notes(job: Job, plan: Plan, problem: Problem, files: Mapping[str, str]) -> tuple[Issue, ...]:
    """Turn bits near zero (``post.turn_near_zero``), large turns in one move (``post.krl_turn``), files
    that are too long for some controllers (``post.krl_size``), what spline blocks rest on (``post.spline``),
    and moves that are in none (``post.spline_left``)."""
    out: list[Issue] = []
    dialect = problem.cell.controller.dialect
    for task in job.tasks:
        if task.robot.family == "KUKA":
            out += [*_turn_bits(task), *_turns(task, plan, dialect), *_size(task, files)]
            if problem.cell.controller.path == "spline":
                out += _splines(task, plan)
    return tuple(out)


def _turn_bits(task: TaskProgram) -> list[Issue]:
    out = []
    for number, operation in enumerate(task.operations, 1):
        q = krl_tracks.first_joints(operation)
        axes = [] if q is None else near_zero(task.robot, q).tolist()
        if axes:
            listed = ", ".join(f"A{axis}" for axis in axes)
            message = (
                f"operation {operation.name}: at its first target p_{number}_start {listed} of arm "
                f"{task.arm.name} is within 2 degrees of zero, where a controller may pass over the turn bit"
            )
            hint = (
                "watch the way from the station before at low speed, or turn or move the stock until these "
            )
            hint += "axes are farther off zero at that target"
            out.append(
                Issue("post.turn_near_zero", message, Severity.WARNING, arm=task.arm.name, index=0, hint=hint)
            )
    return out


def _turns(task: TaskProgram, plan: Plan, dialect: KrlDialect) -> list[Issue]:
    out = []
    for operation, rows in zip(task.operations, krl_tracks.rows(task, Data(task, plan)), strict=True):
        if rows is None or not len(rows.turn):
            continue
        worst = int(np.argmax(rows.turn))
        off = float(rows.turn[worst]) ** 2 / 16.0
        if off > TURN_OFF:
            count = int(np.sum(rows.turn**2 / 16.0 > TURN_OFF))
            place = f"{operation.segments[worst]}, move {worst + 1}"
            message = (
                f"operation {operation.name}: {count} moves of arm {task.arm.name} turn so far at once that "
                f"a controller that swivels and rotates the tool may be {np.rad2deg(off):.2f} degrees off "
                f"between their ends; most at {place}, with {np.rad2deg(rows.turn[worst]):.1f} degrees"
            )
            out.append(
                Issue(
                    "post.krl_turn",
                    message,
                    Severity.WARNING if dialect == "krc2" else Severity.NOTE,
                    arm=task.arm.name,
                    target=place,
                    value=float(np.rad2deg(off)),
                    limit=float(np.rad2deg(TURN_OFF)),
                    unit="deg",
                    hint="look at these moves at low speed, or put targets closer, so that the tool turns by "
                    f"{np.floor(np.rad2deg(4.0 * np.sqrt(TURN_OFF)) * 10.0) / 10.0:.1f} degrees or less in a "
                    "move",
                )
            )
    return out


def _splines(task: TaskProgram, plan: Plan) -> list[Issue]:
    found = krl_tracks.blocks(task, plan, Data(task, plan))
    named = zip(task.operations, found, strict=True)
    return [
        issue
        for operation, runs in named
        for issue in krl_spline.notes(operation.name, task.arm.name, runs, operation.segments)
    ]


def _size(task: TaskProgram, files: Mapping[str, str]) -> list[Issue]:
    size = sum(len(text) for path, text in files.items() if path.startswith(f"{task.arm.name}/"))
    if size <= MEMORY:
        return []
    message = (
        f"the programs of arm {task.arm.name} have {size / 1e6:.1f} MB; some controllers hold "
        f"{MEMORY / 1e6:g} MB"
    )
    hint = "load the files one after the other, or split the job into "
    hint += f"{int(np.ceil(size / MEMORY))} problems of like length"
    return [
        Issue(
            "post.krl_size",
            message,
            Severity.WARNING,
            arm=task.arm.name,
            value=size / 1e6,
            limit=MEMORY / 1e6,
            unit="MB",
            hint=hint,
        )
    ]
