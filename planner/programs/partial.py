"""Programs of others, read as far as the readers know them: what is not read is noted, and reading goes on
behind it.

Here nothing is refused and nothing is proven: :mod:`planner.proof.partial` says what of the moves is.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

from planner.problem import Arm, Problem
from planner.programs import job, stages
from planner.programs.language import Arms, Files, PartlyRead, Reader, Way
from planner.programs.program_text import NO_TEXT
from planner.programs.steps import Fault, MoveStep
from planner.programs.text import settled, strange
from planner.runtime import plugins
from planner.runtime.plugins import Language


@dataclass(frozen=True, eq=False)
class Read:
    """Programs of one arm.

    Attributes:
        reader: Reader of their language.
        arm: The arm.
        name: Name of its task.
        files: Texts of the files by path.
        way: Moves and gaps in order.
        places: Paths of the files by the names that steps have for them.
        unread: Lines that are not read, one fault each.
        moves: File and line of each move in the texts, whether it is read or not.
    """

    reader: Reader
    arm: Arm
    name: str
    files: Files
    way: Way
    places: Mapping[str, str]
    unread: tuple[Fault, ...]
    moves: tuple[tuple[str, int], ...]


def read(problem: Problem, programs: Mapping[str, str]) -> tuple[tuple[Read, ...], tuple[str, ...]]:
    """Read the programs of each arm.

    Args:
        problem: The problem. If it uses one arm, all files of the arm's language belong to this arm.
        programs: Texts by path.

    Returns:
        The programs of each arm that has any, and the paths of files that belong to no arm.
    """
    texts = {path: settled(path, text)[0] for path, text in programs.items() if not stages.beside(path)}
    files, strays = job.task_files(problem, texts)
    arms = job.arms_by_task(problem)
    used = {arm for operation in problem.operations for arm in operation.arms}
    if len(mine := [name for name, arm in arms.items() if arm.name in used]) == 1:
        ends = job.endings(arms[mine[0]])
        own = {path: text for path, text in texts.items() if PurePosixPath(path).suffix.lower() in ends}
        files, strays = {mine[0]: own}, [path for path in texts if path not in own]
    found = tuple(
        _read(problem, reader, together, name, own)
        for reader, together, own in job.by_reader(problem, files)
        for name in together
    )
    return found, tuple(path for path in strays if not job.is_list(problem, path))


def _read(problem: Problem, reader: Reader, together: Arms, name: str, files: Files) -> Read:
    arm = together[name]
    if reader.read_partly is not None:
        found = reader.read_partly(problem, arm, files)
    else:
        found = _read_whole(problem, reader, together, name, files)
    places = {found.text.module_of(file): file for file in files}
    if reader.move_pattern is None:
        steps = (step for step in found.way if isinstance(step, MoveStep))
        moves = tuple((places.get(step.module, step.module), step.line) for step in steps)
    else:
        language = plugins.usable(Language)[found.text.language]
        moves = _moves(files, reader.move_pattern, language.comment)
    return Read(reader, arm, name, files, found.way, places, _one_a_line(found.unread), moves)


def _read_whole(problem: Problem, reader: Reader, together: Arms, name: str, files: Files) -> PartlyRead:
    """Read programs as a whole or not at all: any unknown statement may change the way."""
    whole = reader.read(problem, together, files)
    odd = (fault for file, own in files.items() for fault in strange(file, own))
    unread = (*whole.faults, *whole.flow_faults, *odd)
    task = next((task for task in whole.tasks if task.name == name), None)
    steps = () if unread or task is None else task.steps
    way = tuple(step for step in steps if isinstance(step, MoveStep))
    return PartlyRead(NO_TEXT if task is None else task.text, way, unread)


def _one_a_line(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    first: dict[tuple[str, int], Fault] = {}
    for fault in faults:
        first.setdefault((fault.file, fault.line), fault)
    return tuple(first[key] for key in sorted(first))


def _moves(files: Files, pattern: re.Pattern[str], comment: str) -> tuple[tuple[str, int], ...]:
    found = []
    for file, text in files.items():
        for number, row in enumerate(text.split("\n"), 1):
            code = re.sub(r'"[^"]*"', '""', row).split(comment)[0]
            found += [(file, number)] * len(pattern.findall(code))
    return tuple(found)
