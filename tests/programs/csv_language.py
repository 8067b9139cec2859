"""A language of another package: one row of joints [deg] and a time [s] for each move."""

from __future__ import annotations

import dataclasses
from typing import ClassVar, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.problem import Arm, Problem
from planner.programs.language import Arms, Files, Reader, ReadTasks
from planner.programs.program_text import ProgramText
from planner.programs.stages import TaskText
from planner.programs.steps import Fault, JointTarget, Load, MoveStep, Speed, Tool, WorkObject, Zone
from planner.runtime.plugins import Language


@dataclasses.dataclass(frozen=True)
class CsvText(ProgramText):
    """Text with the digest in its first line."""

    language: ClassVar[str] = "csv"

    head: str

    @property
    def digest(self) -> str:
        """The first line without the sign of a comment."""
        return self.head.removeprefix("# ")

    def base_of(self, arm: Arm) -> FloatArray:
        """Return the base of the cell: a row of joints means the same at any base."""
        return arm.base


def _move(file: str, line: int, row: str) -> MoveStep:
    *joints, time = (float(number) for number in row.split(","))
    nowhere = Load(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
    return MoveStep(
        module=file,
        procedure="",
        line=line,
        condition="",
        kind="row",
        target=JointTarget(np.deg2rad(joints), np.zeros(6)),
        target_name="",
        id=None,
        time=time,
        velocity=None,
        speed=Speed(np.inf, np.inf, np.inf, np.inf),
        zone=Zone(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        zone_name="",
        tool=Tool(True, np.eye(4), nowhere),
        tool_name="",
        wobj=WorkObject(False, True, "", np.eye(4), np.eye(4)),
        wobj_name="",
        switches=(),
    )


def read(problem: Problem, arms: Arms, files: Files) -> ReadTasks:
    """Read the one file of an arm."""
    ((name, arm),) = arms.items()
    ((path, text),) = files.items()
    head, *rows = text.splitlines()
    steps, faults = list[MoveStep](), list[Fault]()
    for line, row in enumerate(rows, 2):
        try:
            steps.append(_move(path.rpartition("/")[2], line, row))
        except ValueError as wrong:
            faults.append(Fault(line, 1, "csv.syntax", str(wrong), path))
    task = TaskText(name, arm, CsvText(head), () if faults else tuple(steps), files)
    return ReadTasks((task,), tuple(faults))


READER: Final = Reader(read)
LANGUAGE: Final = Language(
    title="CSV",
    families=("generic",),
    endings=(".csv",),
    reader="tests.programs.csv_language:READER",
    writer="tests.programs.csv_language:WRITER",
)
