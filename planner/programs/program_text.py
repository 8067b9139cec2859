"""Text of a task, as all languages have it."""

import abc
from collections.abc import Mapping
from typing import ClassVar, Final, NamedTuple

from planner.geometry.arrays import FloatArray
from planner.problem import Arm


class Size(NamedTuple):
    """How many moves a part of a program has.

    Attributes:
        part: The part in messages.
        file: File of the part.
        moves: Number of moves.
        unit: What is counted, in the plural.
    """

    part: str
    file: str
    moves: int
    unit: str = "moves"


class ProgramText(abc.ABC):
    """Text of a task. Each language has a subclass of its own.

    Attributes:
        language: Name of the language, as in :mod:`planner.runtime.plugins`.
        is_trajectory: Whether moves are cubics of the joints between points with velocities. Such programs
            compare the joints with the start of each move before it begins.
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
        """Return the base (4, 4) of the arm in the world that the program declares, None without one.

        Args:
            arm: The arm of the task.
        """

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Numbers of moves, of each part that a controller loads on its own."""
        return ()

    @property
    def targets(self) -> Mapping[str, str]:
        """Places of the targets with names: "file:line" by name in lower case behind a colon."""
        return {}

    def module_of(self, file: str) -> str:
        """Return the name that steps have for a file (:attr:`planner.programs.steps.Step.module`)."""
        return file.rpartition("/")[2]


class NoText(ProgramText):
    """Text of a task without a program."""

    __slots__ = ()

    language = ""
    digest = ""

    def base_of(self, arm: Arm) -> None:
        """Return None."""


NO_TEXT: Final = NoText()
