"""Reads the task of a KUKA arm: the texts of its programs, and the steps that they execute."""

from typing import Final

from planner.languages.krl.reader import reader
from planner.languages.krl.reader.partial import MOVE_PATTERN, read_partly
from planner.problem import Arm, Problem
from planner.programs.language import Arms, Files, Reader, ReadTasks
from planner.programs.signals import controller_signals
from planner.programs.stages import TaskText
from planner.programs.steps import FlowError, ProgramStep, TextFault


def _read(problem: Problem, arms: Arms, files: Files) -> ReadTasks:
    """Read the programs of the controller's only arm.

    If the texts have faults, or the order of execution is not unique, the task has no steps.
    """
    controller = problem.cell.controller
    ((name, arm),) = arms.items()
    text = reader.read(files, controller.max_bytes, controller.dialect)
    steps: tuple[ProgramStep, ...] = ()
    entered: frozenset[str] = frozenset()
    flow_faults: tuple[TextFault, ...] = ()
    if not text.faults:
        base = arm.base if text.base is None else text.base
        try:
            others = [other.name for other in problem.cell.arms if other.name != arm.name]
            signals = controller_signals(problem, arm)
            steps, entered = reader.main_flow(text, base, signals, arm.name, others, _axis_directions(arm))
        except FlowError as wrong:
            flow_faults = wrong.faults
    called = frozenset(("", program) for program in entered)
    return ReadTasks((TaskText(name, arm, text, steps, files, called=called),), text.faults, flow_faults)


def _axis_directions(arm: Arm) -> dict[int, tuple[float, float, float]]:
    """Return the unit vectors, in the foot's axes, along which external axes move an arm, by column."""
    out = {}
    for rail in arm.linear_axes:
        x, y, z = (float(column @ rail.axis) for column in arm.base[:3, :3].T)
        out[rail.column] = (x, y, z)
    return out


READER: Final = Reader(
    read=_read,
    read_partly=read_partly,
    move_pattern=MOVE_PATTERN,
    known_moves=frozenset({"PTP", "LIN", "SLIN"}),
)
