"""The task of an arm: its modules, and what they do."""

import functools
from typing import Final

from planner.languages.rapid.reader.flow import Flow, flow
from planner.languages.rapid.reader.partial import MOVE_PATTERN, read_partly
from planner.languages.rapid.reader.program_text import RapidText
from planner.languages.rapid.reader.reader import MOST_KEPT, Limits, read_task
from planner.problem import Problem
from planner.programs.language import Arms, Files, Reader, ReadTasks, Sharing
from planner.programs.stages import TaskText
from planner.programs.steps import Fault, FlowError


def _followed(
    files: tuple[tuple[str, str], ...], most_bytes: int
) -> tuple[RapidText, Flow, tuple[Fault, ...]]:
    """Modules of a task, all that they may do, and why they have no straight way."""
    text = read_task(dict(files), Limits(bytes=most_bytes))
    way, lost = Flow((), {}, {}, frozenset()), tuple[Fault, ...]()
    if not text.faults:
        try:
            way = flow(text.modules)
        except FlowError as wrong:
            lost = wrong.faults
    return text, way, lost


_kept = functools.lru_cache(maxsize=8)(_followed)
"""Remembered: where programs differ in one task, the others are followed once."""


def _read(problem: Problem, arms: Arms, files: Files) -> ReadTasks:
    controller = problem.cell.controller
    ((name, arm),) = arms.items()
    number = [one.name for one in problem.cell.arms].index(arm.name)
    unit = controller.units[number] if number < len(controller.units) else ""
    short = sum(map(len, files.values())) <= MOST_KEPT
    text, way, lost = (_kept if short else _followed)(tuple(files.items()), controller.max_bytes)
    task = TaskText(name, arm, text, way.steps, files, unit, way.handlers, way.undos, way.called)
    return ReadTasks((task,), text.faults, lost)


READER: Final = Reader(
    read=_read,
    sharing=Sharing.CONTROLLER,
    lists=(".pgf",),
    read_partly=read_partly,
    move_pattern=MOVE_PATTERN,
    known_moves=frozenset({"MoveAbsJ", "MoveL"}),
)
