"""Interface of the text of a task in any language."""

import abc
from collections.abc import Mapping
from typing import ClassVar, Final, NamedTuple

from planner.geometry.arrays import FloatArray
from planner.problem import Arm


class PartSize(NamedTuple):
    """Number of moves of a part of a program.

    Attributes:
        part: Name of the part in messages.
        file: File of the part.
        moves: Number of moves.
        unit: What is counted, in the plural.
    """

    part: str
    file: str
    moves: int
    unit: str = "moves"


class ProgramText(abc.ABC):
    """Text of a task. Each language has a subclass.

    Attributes:
        language: Name of the language, as in :mod:`planner.runtime.plugins`.
        is_trajectory: Whether moves are cubics of the joints between points with velocities. Such programs
            check the joints against the start of each move before it begins.
    """

    __slots__ = ()

    language: ClassVar[str]
    is_trajectory: ClassVar[bool] = False

    @property
    @abc.abstractmethod
    def digest(self) -> str:
        """Digest of the problem that the program names, "" if it names none."""

    @abc.abstractmethod
    def base_of(self, arm: Arm) -> FloatArray | None:
        """Return the base of the arm in the world that the program declares, (4, 4) [m], or None.

        Args:
            arm: The arm of the task.
        """

    @property
    def sizes(self) -> tuple[PartSize, ...]:
        """Numbers of moves, for each part that a controller loads separately."""
        return ()

    @property
    def targets(self) -> Mapping[str, str]:
        """Locations of named targets: "file:line" by a colon and the lower-case name."""
        return {}

    def module_of(self, file: str) -> str:
        """Return the name that steps have for a file (:attr:`planner.programs.steps.ProgramStep.module`)."""
        return file.rpartition("/")[2]


class NoText(ProgramText):
    """Text of a task without a program."""

    __slots__ = ()

    language = ""
    digest = ""

    def base_of(self, arm: Arm) -> None:
        """Return None."""


NO_TEXT: Final = NoText()
