"""The writer of KRL as the planner uses it: functions and properties under the names of `Writer`."""

from collections.abc import Sequence
from typing import Final

from planner.issues import Issue
from planner.languages.krl.writer import controller_files
from planner.languages.krl.writer.program import write
from planner.languages.krl.writer.spline_blocks import spline_refusals
from planner.languages.krl.writer.syntax import snap_poses
from planner.languages.writing.language import PoweredSignals, Writer
from planner.languages.writing.layout import JobPrograms, TaskProgram
from planner.languages.writing.refusals import unnumbered_signals
from planner.problem import Arm, Controller, Problem
from planner.targets import Targets


def _refuse(problem: Problem, targets: Sequence[Targets], arms: Sequence[Arm]) -> list[Issue]:
    """Return issues of signals that have no number, which KRL needs."""
    partners = problem.cell.controller.handshake
    return [
        issue
        for arm in arms
        for issue in unnumbered_signals(problem, targets, arm, "KRL", [partners.of(arm.name).move_enable])
    ]


def _controller_files(
    job: JobPrograms, tasks: Sequence[TaskProgram], controller: Controller, powered: PoweredSignals
) -> dict[str, str]:
    """Return the files of the controller of the one task; KRL files do not depend on the job."""
    del job
    return controller_files.build_files(
        controller, tasks[0].arm.name, powered.signals, powered.wires, powered.torches
    )


WRITER: Final = Writer(
    write,
    syncs=("handshake",),
    stops_at_pauses=True,
    round_poses=snap_poses,
    refuse=_refuse,
    refuse_settings=spline_refusals,
    controller_files=_controller_files,
    notes=controller_files.notes,
)
