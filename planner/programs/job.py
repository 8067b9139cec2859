"""The job as its programs state it: the tasks of all arms and their stages.

The programs of all tasks are read side by side. A stage is what happens between two synchronisation
points. In a synchronised stage the moves of all tasks run in pairs. In any other stage at most one task
may move, so that no order of events depends on chance. Two controllers that meet by signals are treated
in the same way: a stage is what happens between their meetings.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath

from planner.problem import Arm, Problem, setups_of
from planner.programs import text as program_text
from planner.programs.handshake import automata
from planner.programs.handshake.automata import Reading
from planner.programs.language import Reader, Sharing, reader_of
from planner.programs.stages import (
    JobText,
    Stage,
    TaskText,
    beside,
    parts,
    readings,
    split_into_stages,
    wiring,
)
from planner.programs.steps import Fault
from planner.runtime import plugins


def task_names(problem: Problem) -> tuple[str, ...]:
    """Return the names of the tasks of the arms.

    Tasks of two controllers may have one name, and many languages have no names of tasks. Such tasks have the
    names of their arms.
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
    reader = reader_of(arm)
    sharing = Sharing.CONTROLLER if reader is None else reader.sharing
    alone = problem.cell.controller.sync == "handshake"
    return Sharing.NOTHING if alone and sharing is Sharing.CONTROLLER else sharing


def endings(arm: Arm) -> tuple[str, ...]:
    """Return the endings of the names of the files of an arm's programs."""
    language = plugins.language_of(arm.data.family)
    return () if language is None else language.endings


def is_list(problem: Problem, path: str) -> bool:
    """Return whether a file lists the files that a controller of the cell loads."""
    readers = filter(None, map(reader_of, problem.cell.arms))
    return any(path.lower().endswith(reader.lists) for reader in readers if reader.lists)


def task_files(problem: Problem, programs: Mapping[str, str]) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Distribute files to tasks.

    Args:
        problem: The problem.
        programs: Texts by path.

    Returns:
        The files of each task by its name, and the paths of files that belong to no task.
    """
    arms = arms_by_task(problem)
    found: dict[str, dict[str, str]] = {task: {} for task in arms}
    strays: list[str] = []
    for path, text in sorted(programs.items()):
        if is_list(problem, path):
            continue
        suffix = PurePosixPath(path).suffix.lower()
        able = {task: _sharing(problem, arm) for task, arm in arms.items() if suffix in endings(arm)}
        shared = [task for task, sharing in able.items() if sharing is Sharing.FILE]
        own = shared or [task for task, sharing in able.items() if _belongs(path, task, sharing)]
        if not shared and len(own) != 1:
            strays.append(path)
            continue
        for task in own:
            found[task][path] = text
    return found, strays


def _belongs(path: str, task: str, sharing: Sharing) -> bool:
    if sharing is Sharing.NOTHING:
        return task.lower() in (part.lower() for part in PurePosixPath(path).parent.parts)
    return re.search(rf"(?i)(?<![a-z0-9]){re.escape(task)}(?![a-z0-9])", path) is not None


def by_reader(
    problem: Problem, files: Mapping[str, Mapping[str, str]]
) -> Iterator[tuple[Reader, dict[str, Arm], Mapping[str, str]]]:
    """Yield what is read at once: a reader, the arms by their tasks, and their files.

    Args:
        problem: The problem.
        files: The files of each task (:func:`task_files`).
    """
    arms, done = arms_by_task(problem), set[str]()
    for task, arm in arms.items():
        reader = reader_of(arm)
        if reader is None or task in done or not files.get(task):
            continue
        together = {task: arm}
        if reader.sharing is Sharing.FILE:
            language = plugins.language_of(arm.data.family)
            together = {
                name: one for name, one in arms.items() if plugins.language_of(one.data.family) is language
            }
        done |= together.keys()
        yield reader, together, files[task]


def controllers(problem: Problem, tasks: Sequence[TaskText]) -> tuple[tuple[TaskText, ...], ...]:
    """Group tasks by the controllers that run them. A signal belongs to one controller."""
    out: dict[str, list[TaskText]] = {}
    for task in tasks:
        own = _sharing(problem, task.arm) is Sharing.NOTHING
        out.setdefault(task.arm.name if own else "", []).append(task)
    return tuple(map(tuple, out.values()))


def read(problem: Problem, programs: Mapping[str, str]) -> JobText:
    """Read all programs.

    Args:
        problem: The problem.
        programs: Texts by path.

    Returns:
        The tasks, and all faults. A task that cannot be read has no steps.
    """
    controller = problem.cell.controller
    plain = {path: program_text.settled(path, text) for path, text in programs.items() if not beside(path)}
    programs = {path: text for path, (text, _) in plain.items()}
    notes = tuple(note for _, found in plain.values() for note in found)
    files, strays = task_files(problem, programs)
    tasks: list[TaskText] = []
    faults: list[Fault] = []
    flow: list[Fault] = []
    for reader, arms, own in by_reader(problem, files):
        one = reader.read(problem, arms, own)
        tasks += one.tasks
        faults += one.faults
        flow += one.flow_faults
    lists = {path: text for path, text in programs.items() if is_list(problem, path)}
    asked = {setup.confirmation for setup in setups_of(problem) if setup.steps}
    found: Mapping[str, Reading] | None = None
    stages = split_into_stages(tasks, asked)
    if controller.sync == "handshake":
        ways = {task.name: task.steps for task in tasks}
        aside = {task.name: (task.handlers, task.undos) for task in tasks}
        if not (len(tasks) == 1 and _alone(problem, tasks[0])):
            found = readings(problem, ways, aside)
        if found is not None and len(tasks) > 1:
            stages = tuple(Stage(*part) for part in parts(found, ways))
    return JobText(tuple(tasks), stages, tuple(faults), tuple(flow), tuple(strays), lists, found, notes)


def _alone(problem: Problem, task: TaskText) -> bool:
    """Whether the job needs one arm of a cell of two controllers, and its program leaves the other one's
    wires alone."""
    holders = (setup.stock.held_by for setup in problem.setups)
    needed = {arm for operation in problem.operations for arm in operation.arms} | set(filter(None, holders))
    aside = task.handlers, task.undos
    touches = automata.touches(task.name, task.steps, aside, wiring(problem))
    return needed <= {task.arm.name} and not touches
