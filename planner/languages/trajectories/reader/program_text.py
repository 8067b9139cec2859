"""The text of an arm that a file of trajectories moves."""

import dataclasses
from typing import ClassVar

from planner.geometry.arrays import FloatArray
from planner.languages.trajectories.reader.rows import Program
from planner.problem import Arm
from planner.programs.program_text import ProgramText, Size


@dataclasses.dataclass(frozen=True, eq=False)
class TrajectoryText(ProgramText):
    """What was read.

    Attributes:
        program: The program that moves the arm, perhaps with others.
        base: Base (4, 4) of the arm in the world.
    """

    language: ClassVar[str] = "trajectories"
    is_trajectory: ClassVar[bool] = True

    program: Program
    base: FloatArray

    @property
    def digest(self) -> str:
        """The problem that the file names."""
        return self.program.digest

    def base_of(self, arm: Arm) -> FloatArray:
        """Return the base that the file declares for the arm."""
        return self.base

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Number of points of the file."""
        file = self.program.file
        return (Size(file, file, self.program.points, "points"),)
