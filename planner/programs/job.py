"""The job as its programs state it: the tasks of all arms and their stages.

A stage consists of the steps of all tasks between two synchronisation points. In a synchronised stage the
moves of all tasks run in pairs. In any other stage at most one task may move, so that the order of events
does not depend on chance. For two controllers that meet by signals the meetings are the synchronisation
points.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath

from planner.problem import Arm, Problem, all_setups
from planner.programs import text as program_text
from planner.programs.handshake import automata
from planner.programs.handshake.automata import ProgramAutomaton
from planner.programs.language import Reader, Sharing, reader_of
from planner.programs.stages import (
    JobStage,
    JobText,
    TaskText,
    controller_wiring,
    handshake_stages,
    is_controller_file,
    program_automata,
    split_into_stages,
)
from planner.programs.steps import TextFault
from planner.runtime import plugins


def task_names(problem: Problem) -> tuple[str, ...]:
    """Return the names of the tasks of the arms, in the order of the arms.

    Tasks of two controllers may have the same name, and many languages have no task names. Such tasks get the
    names of their arms. Arms for which the cell states no task are left out.
    """
    stated = (*problem.cell.controller.tasks, *("" for _ in problem.cell.arms))
    names = (
        task if _sharing(problem, arm) is Sharing.CONTROLLER else arm.name
        for arm, task in zip(problem.cell.arms, stated, strict=False)
    )
    return tuple(filter(None, names))


def arms_by_task(problem: Problem) -> dict[str, Arm]:
    """Return the arms by the names of their tasks."""
    return dict(zip(task_names(problem), problem.cell.arms, strict=False))


def _sharing(problem: Problem, arm: Arm) -> Sharing:
    """Return what an arm shares with others of its language in this cell.

    An arm without a reader counts as one on a common controller. If the controllers of the cell meet by
    handshake, arms share no controller.
    """
    reader = reader_of(arm)
    sharing = Sharing.CONTROLLER if reader is None else reader.sharing
    uses_handshake = problem.cell.controller.sync == "handshake"
    return Sharing.NOTHING if uses_handshake and sharing is Sharing.CONTROLLER else sharing


def program_suffixes(arm: Arm) -> tuple[str, ...]:
    """Return the file name suffixes of the programs in an arm's language, () if it has none."""
    language = plugins.language_of(arm.data.family)
    return () if language is None else language.endings


def is_program_list(problem: Problem, path: str) -> bool:
    """Return whether a file lists the files that a controller of the cell loads.

    Args:
        problem: The problem.
        path: Path of the file.
    """
    readers = filter(None, map(reader_of, problem.cell.arms))
    return any(path.lower().endswith(reader.lists) for reader in readers if reader.lists)


def task_files(problem: Problem, programs: Mapping[str, str]) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Distribute program files to tasks.

    A file belongs to the tasks whose arms share one file in the language of its suffix. Otherwise it belongs
    to the one task of this language that its path names. If its path names no such task, or several, it
    belongs to no task. Lists of files are left out.

    Args:
        problem: The problem.
        programs: Texts by path.

    Returns:
        The files of each task by its name, and the paths of files that belong to no task.
    """
    arms = arms_by_task(problem)
    files_by_task: dict[str, dict[str, str]] = {task: {} for task in arms}
    unassigned: list[str] = []
    for path, text in sorted(programs.items()):
        if is_program_list(problem, path):
            continue
        suffix = PurePosixPath(path).suffix.lower()
        candidates = {
            task: _sharing(problem, arm) for task, arm in arms.items() if suffix in program_suffixes(arm)
        }
        shared = [task for task, sharing in candidates.items() if sharing is Sharing.FILE]
        tasks = shared or [task for task, sharing in candidates.items() if _belongs(path, task, sharing)]
        if not shared and len(tasks) != 1:
            unassigned.append(path)
            continue
        for task in tasks:
            files_by_task[task][path] = text
    return files_by_task, unassigned


def _belongs(path: str, task: str, sharing: Sharing) -> bool:
    """Return whether the path of a file names a task.

    A task with a controller of its own must be the name of a folder in the path. A task on a common
    controller may be any word of the path, between characters other than letters and digits.
    """
    if sharing is Sharing.NOTHING:
        return task.lower() in (part.lower() for part in PurePosixPath(path).parent.parts)
    return re.search(rf"(?i)(?<![a-z0-9]){re.escape(task)}(?![a-z0-9])", path) is not None


def reader_groups(
    problem: Problem, files: Mapping[str, Mapping[str, str]]
) -> Iterator[tuple[Reader, dict[str, Arm], Mapping[str, str]]]:
    """Yield the groups of arms whose programs are read together.

    Each is a reader, the arms by the names of their tasks, and their files. Tasks without files are left out.

    Args:
        problem: The problem.
        files: The files of each task (:func:`task_files`).
    """
    arms = arms_by_task(problem)
    done: set[str] = set()
    for task, arm in arms.items():
        reader = reader_of(arm)
        if reader is None or task in done or not files.get(task):
            continue
        group = {task: arm}
        if reader.sharing is Sharing.FILE:
            language = plugins.language_of(arm.data.family)
            group = {
                name: other_arm
                for name, other_arm in arms.items()
                if plugins.language_of(other_arm.data.family) is language
            }
        done |= group.keys()
        yield reader, group, files[task]


def group_by_controller(problem: Problem, tasks: Sequence[TaskText]) -> tuple[tuple[TaskText, ...], ...]:
    """Group tasks by the controllers that run them, because each controller has separate signals.

    Args:
        problem: The problem.
        tasks: The tasks.
    """
    out: dict[str, list[TaskText]] = {}
    for task in tasks:
        has_own_controller = _sharing(problem, task.arm) is Sharing.NOTHING
        out.setdefault(task.arm.name if has_own_controller else "", []).append(task)
    return tuple(map(tuple, out.values()))


def read_job(problem: Problem, programs: Mapping[str, str]) -> JobText:
    """Read all programs: normalise the texts, read each task, and split the tasks into stages.

    Args:
        problem: The problem.
        programs: Texts by path. Files for the configuration of controllers are ignored.

    Returns:
        The tasks with their stages, and all faults. A task that cannot be read has no steps.
    """
    controller = problem.cell.controller
    normalised = {
        path: program_text.normalise_text(path, text)
        for path, text in programs.items()
        if not is_controller_file(path)
    }
    texts = {path: text for path, (text, _) in normalised.items()}
    notes = tuple(note for _, file_notes in normalised.values() for note in file_notes)
    files, unassigned = task_files(problem, texts)
    tasks: list[TaskText] = []
    faults: list[TextFault] = []
    flow_faults: list[TextFault] = []
    for reader, arms, group_files in reader_groups(problem, files):
        group_tasks = reader.read(problem, arms, group_files)
        tasks += group_tasks.tasks
        faults += group_tasks.faults
        flow_faults += group_tasks.flow_faults
    lists = {path: text for path, text in texts.items() if is_program_list(problem, path)}
    confirmations = {setup.confirmation for setup in all_setups(problem) if setup.steps}
    # two controllers: the automata of their programs, and stages between their meetings instead
    automata_by_arm: Mapping[str, ProgramAutomaton] | None = None
    stages = split_into_stages(tasks, confirmations)
    if controller.sync == "handshake":
        steps_by_task = {task.name: task.steps for task in tasks}
        sections = {task.name: (task.handlers, task.undos) for task in tasks}
        if not (len(tasks) == 1 and _is_single_program(problem, tasks[0])):
            automata_by_arm = program_automata(problem, steps_by_task, sections)
        if automata_by_arm is not None and len(tasks) > 1:
            stages = tuple(JobStage(*part) for part in handshake_stages(automata_by_arm, steps_by_task))
    return JobText(
        tuple(tasks),
        stages,
        tuple(faults),
        tuple(flow_faults),
        tuple(unassigned),
        lists,
        automata_by_arm,
        notes,
    )


def _is_single_program(problem: Problem, task: TaskText) -> bool:
    """Return whether one arm of a cell with two controllers does the whole job alone.

    No operation needs another arm, no other arm holds a stock, and the program does not use the wires between
    the controllers.
    """
    holders = (setup.stock.held_by for setup in problem.setups)
    required_arms = {arm for operation in problem.operations for arm in operation.arms} | set(
        filter(None, holders)
    )
    sections = task.handlers, task.undos
    uses_wires = automata.uses_wires(task.name, task.steps, sections, controller_wiring(problem))
    return required_arms <= {task.arm.name} and not uses_wires
