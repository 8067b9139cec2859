"""Text of an arm that a trajectory file moves."""

import dataclasses
from typing import ClassVar

from planner.geometry.arrays import FloatArray
from planner.languages.trajectories.reader.rows import TrajectoryProgram
from planner.problem import Arm
from planner.programs.program_text import PartSize, ProgramText


@dataclasses.dataclass(frozen=True, eq=False)
class TrajectoryText(ProgramText):
    """A trajectory file as one of its arms has read it.

    Attributes:
        program: The program that moves the arm, perhaps with others.
        base: Base of the arm in the world, (4, 4) [m].
    """

    language: ClassVar[str] = "trajectories"
    is_trajectory: ClassVar[bool] = True

    program: TrajectoryProgram
    base: FloatArray

    @property
    def digest(self) -> str:
        """Digest of the problem that the file names."""
        return self.program.digest

    def base_of(self, arm: Arm) -> FloatArray:
        """Return the pose of the arm's base in the world that the file declares, (4, 4) [m]."""
        return self.base

    @property
    def sizes(self) -> tuple[PartSize, ...]:
        """Number of points of the file."""
        file = self.program.file
        return (PartSize(file, file, self.program.points, "points"),)
