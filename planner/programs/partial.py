"""Reads programs that the planner did not write, as far as possible.

Text that cannot be read is recorded, and reading continues. Nothing is refused and nothing is proven here.
:mod:`planner.proof.partial` states what is known about the moves.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

from planner.problem import Arm, Problem
from planner.programs import job, stages
from planner.programs.language import Arms, Files, PartialPath, PartlyRead, Reader
from planner.programs.program_text import NO_TEXT
from planner.programs.steps import MoveStep, TextFault
from planner.programs.text import normalise_text, unexpected_characters
from planner.runtime import plugins
from planner.runtime.plugins import Language


@dataclass(frozen=True, eq=False)
class PartialPrograms:
    """Programs of one arm, read as far as possible.

    Attributes:
        reader: Reader of the language.
        arm: The arm.
        name: Name of its task.
        files: Texts of the files by path.
        path: Moves and gaps in order.
        paths: Paths of the files, by the module names in the steps.
        unread: Faults of the lines that could not be read, one for each line.
        moves: File and line of each move in the texts, whether it was read or not.
    """

    reader: Reader
    arm: Arm
    name: str
    files: Files
    path: PartialPath
    paths: Mapping[str, str]
    unread: tuple[TextFault, ...]
    moves: tuple[tuple[str, int], ...]


def read_partial(
    problem: Problem, programs: Mapping[str, str]
) -> tuple[tuple[PartialPrograms, ...], tuple[str, ...]]:
    """Read the programs of each arm as far as possible.

    Args:
        problem: The problem. If it uses one arm, all files of the arm's language belong to this arm.
        programs: Texts by path.

    Returns:
        The programs of each arm that has any, and the paths of files that belong to no arm.
    """
    texts = {
        path: normalise_text(path, text)[0]
        for path, text in programs.items()
        if not stages.is_controller_file(path)
    }
    files, unassigned = job.task_files(problem, texts)
    arms = job.arms_by_task(problem)
    used_arms = {arm for operation in problem.operations for arm in operation.arms}
    if len(used_tasks := [name for name, arm in arms.items() if arm.name in used_arms]) == 1:
        suffixes = job.program_suffixes(arms[used_tasks[0]])
        group_files = {
            path: text for path, text in texts.items() if PurePosixPath(path).suffix.lower() in suffixes
        }
        files = {used_tasks[0]: group_files}
        unassigned = [path for path in texts if path not in group_files]
    groups = tuple(
        _read(problem, reader, group, name, group_files)
        for reader, group, group_files in job.reader_groups(problem, files)
        for name in group
    )
    return groups, tuple(path for path in unassigned if not job.is_program_list(problem, path))


def _read(problem: Problem, reader: Reader, group: Arms, name: str, files: Files) -> PartialPrograms:
    """Read the programs of one task as far as possible, and find all moves in the texts.

    Args:
        problem: The problem.
        reader: Reader of the language.
        group: Arms whose programs are read together, by task.
        name: Name of the task.
        files: Texts of the files by path.
    """
    arm = group[name]
    if reader.read_partly is not None:
        result = reader.read_partly(problem, arm, files)
    else:
        result = _read_whole(problem, reader, group, name, files)
    paths = {result.text.module_of(file): file for file in files}
    if reader.move_pattern is None:
        steps = (step for step in result.path if isinstance(step, MoveStep))
        moves = tuple((paths.get(step.module, step.module), step.line) for step in steps)
    else:
        language = plugins.usable(Language)[result.text.language]
        moves = _move_locations(files, reader.move_pattern, language.comment)
    return PartialPrograms(
        reader, arm, name, files, result.path, paths, _one_fault_per_line(result.unread), moves
    )


def _read_whole(problem: Problem, reader: Reader, group: Arms, name: str, files: Files) -> PartlyRead:
    """Read programs of a language that has no partial reader.

    The path is complete if there is no fault. With any fault it is empty, because a line that was not read
    may change all later moves.
    """
    result = reader.read(problem, group, files)
    character_faults = (
        fault for file, content in files.items() for fault in unexpected_characters(file, content)
    )
    unread = (*result.faults, *result.flow_faults, *character_faults)
    task = next((task for task in result.tasks if task.name == name), None)
    steps = () if unread or task is None else task.steps
    path = tuple(step for step in steps if isinstance(step, MoveStep))
    return PartlyRead(NO_TEXT if task is None else task.text, path, unread)


def _one_fault_per_line(faults: Iterable[TextFault]) -> tuple[TextFault, ...]:
    """Return the first fault of each line, sorted by file and line."""
    first: dict[tuple[str, int], TextFault] = {}
    for fault in faults:
        first.setdefault((fault.file, fault.line), fault)
    return tuple(first[key] for key in sorted(first))


def _move_locations(files: Files, pattern: re.Pattern[str], comment: str) -> tuple[tuple[str, int], ...]:
    """Return file and line of each match of a pattern outside strings and comments."""
    locations = []
    for file, text in files.items():
        for number, row in enumerate(text.split("\n"), 1):
            code = re.sub(r'"[^"]*"', '""', row).split(comment)[0]
            locations += [(file, number)] * len(pattern.findall(code))
    return tuple(locations)
