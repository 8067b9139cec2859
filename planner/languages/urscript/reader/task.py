"""The task of an arm: its program, and what it does."""

import dataclasses
import re
from typing import Final

from planner.issues import TandemError
from planner.languages.urscript.reader import flow, reader
from planner.problem import Problem
from planner.programs.language import Arms, Files, Reader, ReadTasks
from planner.programs.signals import controller_signals
from planner.programs.stages import TaskText
from planner.programs.steps import FlowError, ProgramStep, TextFault
from planner.proof.kinematics.arm_model import robot_machine

_MOVE_PATTERN: Final = re.compile(r"\b((?:move[jlpc]|servo[jc]|speed[jl]|optimove[jl]))[ \t]*\(")
"""Functions that move the arm."""


def _read(problem: Problem, arms: Arms, files: Files) -> ReadTasks:
    """Read the files of the one task that ``arms`` names, and follow its program if it has no faults.

    The base that the program states is used for its moves. Without one it is that of the arm in the cell.
    """
    controller = problem.cell.controller
    ((name, arm),) = arms.items()
    text = reader.read(files, controller.max_bytes)
    steps = tuple[ProgramStep, ...]()
    flow_faults = tuple[TextFault, ...]()
    if not text.faults and text.program is not None:
        names = controller_signals(problem, arm)
        wires = flow.ControllerWires(names.outputs, names.inputs)
        others = [other.name for other in problem.cell.arms if other.name != arm.name]
        if controller.sync == "handshake" and others:
            partner_signals = controller.handshake.of(arm.name)
            wires = dataclasses.replace(
                wires, other=others[0], line=partner_signals.output, running=partner_signals.running
            )
        try:
            base = arm.base @ robot_machine(arm.data).table.base if text.base is None else text.base
            steps = flow.flow_steps(text, base, wires, arm.name, arm.robot, arm.data.velocity)
        except FlowError as wrong:
            flow_faults = wrong.faults
        except TandemError as wrong:
            message = wrong.issues[0].message
            flow_faults = (TextFault(1, 1, "urscript.flow", message, text.program.file),)
    return ReadTasks((TaskText(name, arm, text, steps, files),), text.faults, flow_faults)


READER: Final = Reader(read=_read, move_pattern=_MOVE_PATTERN, known_moves=frozenset({"movej", "movel"}))
