"""Reads programs of other origin as far as possible: unread text is recorded, and reading continues.

Nothing is refused and nothing is proven here. :mod:`planner.proof.partial` says what is known of the moves.
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
    """Programs of one arm.

    Attributes:
        reader: Reader of their language.
        arm: The arm.
        name: Name of its task.
        files: Texts of the files by path.
        path: Moves and gaps in order.
        paths: Paths of the files by the names that steps have for them.
        unread: Lines that could not be read, one fault each.
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
    """Read the programs of each arm.

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
    files, strays = job.task_files(problem, texts)
    arms = job.arms_by_task(problem)
    used = {arm for operation in problem.operations for arm in operation.arms}
    if len(used_tasks := [name for name, arm in arms.items() if arm.name in used]) == 1:
        suffixes = job.program_suffixes(arms[used_tasks[0]])
        group_files = {
            path: text for path, text in texts.items() if PurePosixPath(path).suffix.lower() in suffixes
        }
        files, strays = {used_tasks[0]: group_files}, [path for path in texts if path not in group_files]
    groups = tuple(
        _read(problem, reader, together, name, group_files)
        for reader, together, group_files in job.reader_groups(problem, files)
        for name in together
    )
    return groups, tuple(path for path in strays if not job.is_program_list(problem, path))


def _read(problem: Problem, reader: Reader, group: Arms, name: str, files: Files) -> PartialPrograms:
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
    """Read programs as a whole or not at all: any unknown statement may change the path."""
    whole = reader.read(problem, group, files)
    character_faults = (
        fault for file, content in files.items() for fault in unexpected_characters(file, content)
    )
    unread = (*whole.faults, *whole.flow_faults, *character_faults)
    task = next((task for task in whole.tasks if task.name == name), None)
    steps = () if unread or task is None else task.steps
    path = tuple(step for step in steps if isinstance(step, MoveStep))
    return PartlyRead(NO_TEXT if task is None else task.text, path, unread)


def _one_fault_per_line(faults: Iterable[TextFault]) -> tuple[TextFault, ...]:
    first: dict[tuple[str, int], TextFault] = {}
    for fault in faults:
        first.setdefault((fault.file, fault.line), fault)
    return tuple(first[key] for key in sorted(first))


def _move_locations(files: Files, pattern: re.Pattern[str], comment: str) -> tuple[tuple[str, int], ...]:
    locations = []
    for file, text in files.items():
        for number, row in enumerate(text.split("\n"), 1):
            code = re.sub(r'"[^"]*"', '""', row).split(comment)[0]
            locations += [(file, number)] * len(pattern.findall(code))
    return tuple(locations)
