"""Interface between the planner and the reader of a robot language.

The language of an arm is the one that lists the family of the arm's controller
(:class:`planner.runtime.plugins.Language`). Readers are imported on first use.
"""

import enum
import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from planner.issues import issue_error
from planner.problem import Arm, Problem
from planner.programs.program_text import ProgramText
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, TextFault
from planner.runtime import plugins
from planner.runtime.plugins import Language


class Sharing(enum.Enum):
    """What several arms of one language have in common."""

    NOTHING = "nothing"
    """Each arm has a controller. Task and folder of the files have the name of the arm."""
    CONTROLLER = "controller"
    """One controller has a task for each arm.

    The cell states the names of the tasks, and paths of files contain them. If the controllers of the cell
    meet by handshake, NOTHING applies instead.
    """
    FILE = "file"
    """One controller moves all arms by one file, in any folder."""


@dataclass(frozen=True)
class ReadTasks:
    """Result of reading the files of one or several tasks.

    Attributes:
        tasks: The tasks. A task that cannot be read has no steps.
        faults: Faults of the texts.
        flow_faults: Reasons why tasks have no steps although their texts have no faults.
    """

    tasks: tuple[TaskText, ...]
    faults: tuple[TextFault, ...] = ()
    flow_faults: tuple[TextFault, ...] = ()


@dataclass(frozen=True, eq=False)
class Gap:
    """Part of a program between two moves that could not be read.

    Attributes:
        shifts: Whether this part may shift the targets of all later moves.
    """

    shifts: bool = False


PartialPath = tuple[MoveStep | Gap, ...]
"""Moves and gaps of a program in order."""


@dataclass(frozen=True, eq=False)
class PartlyRead:
    """Programs of any origin, read as far as possible.

    Attributes:
        text: Text of the program.
        path: Moves and gaps in order.
        unread: Faults of the lines that could not be read.
    """

    text: ProgramText
    path: PartialPath
    unread: tuple[TextFault, ...]


Arms = Mapping[str, Arm]
"""Arms by the names of their tasks."""
Files = Mapping[str, str]
"""Texts by path."""


@dataclass(frozen=True)
class Reader:
    """Reader of a language.

    Attributes:
        read: Reads the files of one arm, or those of all arms that share a file. It returns faults and raises
            no exception.
        sharing: What several arms have in common.
        lists: Suffixes of files that list the files to load, in lower case, with the dot.
        read_partly: Reads the files of one arm as far as possible. Without it programs are read as a whole
            or not at all.
        move_pattern: Regular expression with one group that finds all moves, whether the reader knows them or
            not, in a line without strings and comments. Without it only the moves that were read count.
        known_moves: Kinds of moves (:attr:`planner.programs.steps.MoveStep.kind`) whose path between their
            targets is known, None if all are.
    """

    read: Callable[[Problem, Arms, Files], ReadTasks]
    sharing: Sharing = Sharing.NOTHING
    lists: tuple[str, ...] = ()
    read_partly: Callable[[Problem, Arm, Files], PartlyRead] | None = None
    move_pattern: re.Pattern[str] | None = None
    known_moves: frozenset[str] | None = None


def reader_of(arm: Arm) -> Reader | None:
    """Return the reader of the language of an arm, or None.

    Raises:
        TandemError: The reader cannot be loaded (``post.language``).
    """
    language = plugins.language_of(arm.data.family)
    return None if language is None else _load(language)


@functools.cache
def _load(language: Language) -> Reader:
    """Import the reader of a language on first use."""
    try:
        return plugins.load(language.reader, Reader)
    except plugins.PluginError as error:
        message = f"the reader of {language.title} {error}; fix or uninstall its package"
        raise issue_error("post.language", message) from error
