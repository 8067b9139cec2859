"""Common interface of program texts as read, in any language."""

import abc
from collections.abc import Mapping
from typing import ClassVar, Final, NamedTuple

from planner.geometry.arrays import FloatArray
from planner.problem import Arm


class PartSize(NamedTuple):
    """Size of a part of a program that a controller loads separately.

    Attributes:
        part: Name of the part in messages.
        file: Path of its file.
        moves: Number of moves in it.
        unit: Word for what is counted, in the plural.
    """

    part: str
    file: str
    moves: int
    unit: str = "moves"


class ProgramText(abc.ABC):
    """Text of a task as read. Each language has a subclass.

    Attributes:
        language: Name of the language, as in :mod:`planner.runtime.plugins`.
        is_trajectory: Whether moves are cubics in joint space between points with velocities. Before each
            move such programs check that the joints are at its start.
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
        """Return the base of the arm in the world as the program declares it, (4, 4) [m], or None.

        Args:
            arm: The arm of the task.
        """

    @property
    def sizes(self) -> tuple[PartSize, ...]:
        """Sizes of the parts that a controller loads separately."""
        return ()

    @property
    def targets(self) -> Mapping[str, str]:
        """Locations of named targets, as "file:line", by name in lower case with a leading colon."""
        return {}

    def module_of(self, file: str) -> str:
        """Return the name of a file in its steps (:attr:`planner.programs.steps.ProgramStep.module`)."""
        return file.rpartition("/")[2]


class NoText(ProgramText):
    """Text of a task without a program."""

    __slots__ = ()

    language = ""
    digest = ""

    def base_of(self, arm: Arm) -> None:
        """Return None: there is no program that could declare a base."""


NO_TEXT: Final = NoText()
"""The only instance of `NoText` that is needed."""
