"""The writer of RAPID as the planner uses it."""

import re
from collections.abc import Sequence
from typing import Final

from planner.claims.segments import Segment
from planner.issues import Issue, TandemError
from planner.languages.rapid.writer import controller_files
from planner.languages.rapid.writer.controller_files import SignalType
from planner.languages.rapid.writer.program import write
from planner.languages.rapid.writer.syntax import procedure
from planner.languages.writing.language import PoweredSignals, Writer
from planner.languages.writing.layout import ActionStep, JobPrograms, TaskProgram
from planner.problem import Controller

_USED_NAMES: Final = re.compile(
    r"main|operation_\d+|handshake\w*|block_\d+_\w+|meet_\d+|j_\w+|t_\w+|w_\w+|z_turn_\d+|z\d+[mu]m|v_entry|"
    r"load_block\w*|check_(cell|pose|true|stop)|base_frame|problem_digest|all_tasks"
)
"""Lower-case names that RAPID programs use for data, and for procedures other than those of segments."""


def _refuse_segment(segment: Segment) -> tuple[Issue, ...]:
    """Return an issue if a segment gives no valid procedure name, or one that the programs use already."""
    try:
        name = procedure(segment)
    except TandemError as error:
        return error.issues
    if _USED_NAMES.fullmatch(name.lower()) is None:
        return ()
    message = f"segment {str(segment)!r} would be called {name}, a name that RAPID programs use already"
    return (Issue("post.name", message, hint="give it another kind or name"),)


def _controller_files(
    job: JobPrograms, tasks: Sequence[TaskProgram], controller: Controller, powered: PoweredSignals
) -> dict[str, str]:
    """Return the texts of the configuration files of one controller, by file name."""
    other_signals = _other_signals(job, tasks, powered.signals)
    task_names = [task.task for task in tasks]
    arm_names = [task.arm.name for task in tasks]
    return controller_files.build_files(controller, task_names, arm_names, powered, other_signals)


def _other_signals(
    job: JobPrograms, tasks: Sequence[TaskProgram], signals: Sequence[str]
) -> dict[str, SignalType]:
    """Return the type (DI or DO) of each signal in the programs of one controller that is no power output.

    They are inputs that programs wait for, outputs that programs switch, and the handshake signals between
    two controllers. ``signals`` are the power outputs, which other rows of the configuration declare.
    """
    steps = [step for task in tasks for operation in task.operations for step in operation.steps]
    inputs = {
        step.action.signal for step in steps if isinstance(step, ActionStep) and step.action.kind == "input"
    }
    outputs = {signal for task in tasks for signal in job.switched_signals(task)} - set(signals)
    if job.handshake is not None:
        lines = [job.handshake.of(task.arm.name) for task in tasks]
        inputs |= {line.input for line in lines}
        outputs |= {line.output for line in lines}
    kinds: dict[str, SignalType] = dict.fromkeys(sorted(outputs, key=str.lower), "DO")
    return kinds | dict.fromkeys(sorted(inputs, key=str.lower), "DI")


WRITER: Final = Writer(
    write,
    syncs=("multimove", "handshake"),
    refuse_segment=_refuse_segment,
    controller_files=_controller_files,
)
