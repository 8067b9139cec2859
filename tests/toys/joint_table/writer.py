"""Writes joint tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np

from planner.cell.kinematics import forward_kinematics
from planner.claims import sentences
from planner.geometry.arrays import FloatArray, to_quaternion
from planner.geometry.units import MM
from planner.issues import Issue
from planner.languages.writing.language import Margins, Writer, WrittenPrograms
from planner.languages.writing.layout import JobPrograms, JointMove, SegmentRun, TaskProgram
from planner.plans import Plan
from planner.problem import Arm, Problem, Settings
from planner.targets import Targets

PEAK: Final = 1.5  # highest speed of a cubic from rest to rest, of its mean


def _write(
    tasks: Sequence[TaskProgram], job: JobPrograms, plan: Plan, problem: Problem, margins: Margins
) -> WrittenPrograms:
    (task,) = tasks  # WRITER states no value of `sync`
    arm, clocks = task.arm, dict[int, FloatArray]()
    load = _numbers((arm.tool.mass, *(np.asarray(arm.tool.cog) / MM)))
    rows = [("digest", plan.digest), ("arm", arm.name, arm.robot), ("base", *_pose(task.base))]
    rows += [("tool", arm.tool.name, *_pose(arm.tool.tcp), *load), ("block", *_pose(plan.stock_poses[0]))]
    rows += [("ask", sentences.READY.format()), _row("", 0.0, arm.home)]
    time, here = 0.0, arm.home
    for index, operation in enumerate(task.operations):
        passed = list[float]()
        for step in operation.steps:
            moves = [(step.q, 0.0)] if isinstance(step, JointMove) else []
            if isinstance(step, SegmentRun) and operation.moves is not None:
                some = slice(step.first, step.last)
                moves = list(zip(operation.moves.q[some], operation.moves.duration[some], strict=True))
            for q, duration in moves:
                segment = str(step.segment) if isinstance(step, SegmentRun) else ""
                passed = passed or ([time] if segment else [])
                if segment or np.abs(q - here).max() > 1e-6:
                    time = round(time + max(PEAK * duration, _time(arm, here, q, problem.settings)) + 1e-5, 5)
                    rows, here = [*rows, _row(segment, time, q)], q
                passed += [time] if segment else []
        clocks[index] = np.stack([np.append(0, operation.targets), np.array(passed) - passed[0]])
    return WrittenPrograms(
        {f"{arm.name}/joints.csv": "".join(f"{','.join(row)}\r\n" for row in rows)}, clocks
    )


def _time(arm: Arm, start: FloatArray, end: FloatArray, settings: Settings) -> float:
    """Time [s] in which a move from rest to rest keeps all limits of joints and of the tool."""
    change, data = np.abs(end - start), arm.data
    place = (forward_kinematics(data, np.linspace(start, end, 201)) @ arm.tool.tcp)[:, :3, 3]
    fastest = 200.0 * np.linalg.norm(np.diff(place, axis=0), axis=1).max()
    return max(
        float((PEAK * change / (settings.speed_fraction * data.velocity)).max()),
        float(np.sqrt(6.0 * change / (settings.acceleration_fraction * data.acceleration)).max()),
        float(1.01 * PEAK * fastest / settings.tcp_speed),
    )


def _row(segment: str, time: float, q: FloatArray) -> tuple[str, ...]:
    return ("row", segment, f"{time:.5f}", *_numbers(np.rad2deg(q)))


def _pose(pose: FloatArray) -> Iterator[str]:
    return _numbers([*(pose[:3, 3] / MM), *to_quaternion(pose[:3, :3])])


def _numbers(values: Iterable[float]) -> Iterator[str]:
    return (f"{value:.8f}" for value in values)


def _refuse(problem: Problem, planned: Sequence[Targets], arms: Sequence[Arm]) -> Iterator[Issue]:
    lacking = {
        "actions": any(targets.actions for targets in planned),
        "setups": len(problem.setups) > 1 or bool(problem.setups[0].steps),
        "blocks that an arm holds": any(setup.stock.held_by for setup in problem.setups),
        "turntables": problem.cell.turntable is not None,
    }
    for what in (word for word, found in lacking.items() if found):
        yield Issue("joint_table.job", f"joint tables have no rows for {what}", arm=arms[0].name)


WRITER: Final = Writer(_write, opt_in="set controller: {language: joint_table}", refuse=_refuse)
