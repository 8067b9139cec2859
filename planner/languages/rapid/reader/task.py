"""Reads the task of an arm: its modules, and what they do."""

import functools
from typing import Final

from planner.languages.rapid.reader.flow import TaskFlow, task_flow
from planner.languages.rapid.reader.partial import MOVE_PATTERN, read_partly
from planner.languages.rapid.reader.program_text import RapidText
from planner.languages.rapid.reader.reader import MAX_CACHED_LENGTH, ModuleLimits, read_task
from planner.problem import Problem
from planner.programs.language import Arms, Files, Reader, ReadTasks, Sharing
from planner.programs.stages import TaskText
from planner.programs.steps import FlowError, TextFault


def _read_and_follow(
    files: tuple[tuple[str, str], ...], max_bytes: int
) -> tuple[RapidText, TaskFlow, tuple[TextFault, ...]]:
    """Read the modules of a task and, if they have no faults, follow all that they may do.

    Returns:
        The text, the flow of the task (empty if there are faults), and the faults of its main flow.
    """
    text = read_task(dict(files), ModuleLimits(bytes=max_bytes))
    main_flow = TaskFlow((), {}, {}, frozenset())
    flow_faults = tuple[TextFault, ...]()
    if not text.faults:
        try:
            main_flow = task_flow(text.modules)
        except FlowError as wrong:
            flow_faults = wrong.faults
    return text, main_flow, flow_faults


_read_and_follow_cached = functools.lru_cache(maxsize=8)(_read_and_follow)
"""Cached :func:`_read_and_follow`: tasks that several program sets share are followed once."""


def _read(problem: Problem, arms: Arms, files: Files) -> ReadTasks:
    """Read the modules of the one task that ``arms`` names, and follow all that they may do.

    Small tasks are cached, because several program sets may contain them. This is the entry point `Reader`.
    """
    controller = problem.cell.controller
    ((name, arm),) = arms.items()
    arm_number = [cell_arm.name for cell_arm in problem.cell.arms].index(arm.name)
    unit = controller.units[arm_number] if arm_number < len(controller.units) else ""
    cacheable = sum(map(len, files.values())) <= MAX_CACHED_LENGTH
    text, main_flow, flow_faults = (_read_and_follow_cached if cacheable else _read_and_follow)(
        tuple(files.items()), controller.max_bytes
    )
    task = TaskText(
        name, arm, text, main_flow.steps, files, unit, main_flow.handlers, main_flow.undos, main_flow.called
    )
    return ReadTasks((task,), text.faults, flow_faults)


READER: Final = Reader(
    read=_read,
    sharing=Sharing.CONTROLLER,
    lists=(".pgf",),
    read_partly=read_partly,
    move_pattern=MOVE_PATTERN,
    known_moves=frozenset({"MoveAbsJ", "MoveL"}),
)
