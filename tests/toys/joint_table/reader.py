"""Reads joint tables."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import ClassVar, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.problem import Arm, Problem
from planner.programs import steps
from planner.programs.language import Arms, Files, Reader, ReadTasks
from planner.programs.program_text import NO_TEXT, ProgramText
from planner.programs.stages import TaskText

StepOrigin = tuple[str, str, int, str]
Frames = tuple[steps.Tool, str, steps.WorkObject, str]
NUMBER: Final = re.compile(r"-?\d{1,9}\.\d{1,12}", re.ASCII)
NO_AXES: Final = np.zeros(6)
NO_TURN: Final = np.array([1.0, 0.0, 0.0, 0.0])
NO_LIMIT: Final = steps.MoveSpeed(np.inf, np.inf, np.inf, np.inf)
STOP: Final = steps.Zone(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class JointTable(ProgramText):
    """What a table states; ``start`` (J,) [rad] is where the arm has to stand, by its first row."""

    language: ClassVar[str] = "joint_table"
    is_trajectory: ClassVar[bool] = True

    problem: str
    base: FloatArray
    start: FloatArray

    @property
    def digest(self) -> str:
        return self.problem

    def base_of(self, arm: Arm) -> FloatArray:
        return self.base


def _read(problem: Problem, arms: Arms, files: Files) -> ReadTasks:
    ((name, arm),) = arms.items()
    path, text = min(files.items())
    file, line, done = path.rpartition("/")[2], 1, list[steps.ProgramStep]()
    try:
        rows = [row.split(",") for row in text.splitlines()]
        digest, base, frames = _head(arm, rows if len(files) == 1 else [])
        start, time = np.empty(0), 0.0
        for line, row in enumerate(rows[5:], 6):
            match row:
                case ["ask", words]:
                    done.append(steps.MessageStep(file, "main", line, "", "ask", (words,), True, words, True))
                case ["row", "", "0.00000", *joints] if not len(start):
                    start = np.deg2rad(_numbers(joints, arm.data.axes))
                case ["row", segment, *numbers] if len(start):
                    before, (time, *joint) = time, _numbers(numbers, 1 + arm.data.axes)
                    place = (file, segment or "main", line, "")
                    done.append(_move(place, arm, np.deg2rad(joint), time - before, frames))
                case _:
                    raise ValueError(f"{','.join(row)[:60]!r} is not allowed there")
        if not len(start):
            raise ValueError("no row of joints at the time 0")
    except ValueError as error:
        fault = steps.TextFault(line, 1, "joint_table.syntax", str(error), path)
        return ReadTasks((TaskText(name, arm, NO_TEXT, (), files),), (fault,))
    table = JointTable(digest, base, start)
    return ReadTasks((TaskText(name, arm, table, tuple(done), files),))


def _head(arm: Arm, rows: list[list[str]]) -> tuple[str, FloatArray, Frames]:
    if [row[0] for row in rows[:5]] != ["digest", "arm", "base", "tool", "block"]:
        raise ValueError("an arm has one table, which begins with digest, arm, base, tool and block")
    (digest, *_), names, base, (tool, *numbers), block = (row[1:] or [""] for row in rows[:5])
    if names != [arm.name, arm.robot]:
        raise ValueError(f"the arm is {' '.join(names)}; wanted: {arm.name} {arm.robot}")
    mass, *centre = _numbers(numbers[7:], 4)
    load = steps.LoadData(mass, np.array(centre) * MM, NO_TURN, np.zeros(3))
    frame = steps.WorkObject(False, True, "", np.eye(4), _pose(block))
    return digest, _pose(base), (steps.Tool(True, _pose(numbers[:7]), load), tool, frame, "block")


def _move(origin: StepOrigin, arm: Arm, q: FloatArray, time: float, frames: Frames) -> steps.MoveStep:
    if not time > 0.0:
        raise ValueError("times do not ascend")
    way = steps.JointTarget(arm.data.to_controller(q), NO_AXES)
    target = way if origin[1] == "main" else steps.PassedTarget(q, np.zeros_like(q), NO_AXES)
    return steps.MoveStep(*origin, "row", target, "", None, time, None, NO_LIMIT, STOP, "a stop", *frames, ())


def _numbers(cells: Sequence[str], count: int) -> list[float]:
    if len(cells) != count or not all(map(NUMBER.fullmatch, cells)):
        raise ValueError(f"{','.join(cells)[:60]!r} are not {count} numbers")
    return [float(cell) for cell in cells]


def _pose(cells: Sequence[str]) -> FloatArray:
    values = np.array(_numbers(cells, 7))
    if not values[3:].any():
        raise ValueError("a quaternion of zeros")
    return steps.poses(values[:3] * MM, values[3:])


READER: Final = Reader(_read)
