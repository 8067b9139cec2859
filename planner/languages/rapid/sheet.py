"""Rows of the setup sheet for ABB controllers: files to load, settings, external axes."""

import itertools
from collections.abc import Sequence
from typing import Final

from planner.geometry.units import MM
from planner.problem import Arm, Problem, Turntable
from planner.report import external_axes_sheet, markup
from planner.report.external_axes_sheet import AxisTerms
from planner.report.plugin_contributions import ControllerCheck, ControllerSetup, ReportOfLanguage, SetupRow
from planner.report.pose_text import point_text

_TERMS: Final = AxisTerms(
    start="before PP to main",
    limits=lambda _: ("joint", ""),
    load=", and set it on the controller (MechUnitLoad)",
)


def _checks(setup: ControllerSetup) -> list[ControllerCheck]:
    """Return rows on the configuration of one ABB controller, each with the item and its required state."""
    problem, controller = setup.problem, setup.problem.cell.controller
    uses_handshake = controller.sync == "handshake"
    ending = "sys" if controller.robotware == 6 else "sysx"
    rows = [("RobotWare", f"{controller.robotware}; its modules end in .{ending.replace('sys', 'mod')}")]
    signals = setup.signals
    folder = f"programs/controller/{setup.arms[0].name}" if uses_handshake else "programs/controller"
    if setup.joined and not signals:
        rows.append((f"EIO.cfg of {folder}", "loaded"))
    if setup.joined:
        rows += _running_wire_checks(problem, setup.arms[0].name)
    if signals:
        rows.append((f"EIO.cfg, SYS.cfg and TandemPower.{ending} of {folder}", "loaded"))
        for signal in signals:
            output = controller.interlock.power_output(signal)
            wiring = (
                f"{output.device}, bit {output.bit}" if output.device else "NO DEVICE stated, so no power"
            )
            rows.append(
                (f"{output.signal} falls at a stop, with the motors, with the enabling device", wiring)
            )
    if signals and setup.hot:
        mounting = (
            "not in automatic: mount it cold, or in manual at reduced speed while a second person holds "
        )
        mounting += "the enabling device, and run the job to its end in manual"
        rows.append((f"mounting while {setup.hot} is hot and the gate open", mounting))
    rows += setup.torch_checks(signals, "PP to main in all tasks, Start")
    rows.append(("SoftES in SYS.cfg (RUNCHN_BOOL)", "selected: arms keep to their path at an emergency stop"))
    for number, arm in enumerate(problem.cell.arms):
        if arm.linear_axes and (arm.name == setup.arms[0].name or not uses_handshake):
            rows += _rail_checks(arm, controller.robot_name(number))
    table = problem.cell.turntable
    if table is not None and (table.arm == setup.arms[0].name or not uses_handshake):
        rows += external_axes_sheet.turntable(problem, table, _TERMS, _turntable_unit_checks(table))
    if any(job_setup.stock.held_by for job_setup in problem.setups):
        rows.append(("ModalPayLoadMode (SYS_MISC)", "1: otherwise GripLoad of the held block has no effect"))
    rows.append(("CAB_REGAIN_DIST, AUTO", "small: within this distance an arm returns to its path by itself"))
    rows.append(("after an error, or a stop that is not resumed", "PP to main in all tasks, then start"))
    return rows


def _running_wire_checks(problem: Problem, arm: str) -> list[ControllerCheck]:
    """Return the rows on the two running wires between the controllers.

    Each row states the device bit of the wire's signal at the controller of ``arm``.
    """
    signals = problem.cell.controller.handshake.of(arm)
    interlock = problem.cell.controller.interlock
    connections = [
        (name, interlock.device_bit(arm, name)) for name in (signals.running, signals.partner_running)
    ]
    return [
        (
            f"{name} is wired",
            f"{connection.device}, bit {connection.bit}"
            if connection
            else "NO DEVICE stated, so the wire is dead",
        )
        for name, connection in connections
    ]


def _rail_checks(arm: Arm, robot: str) -> list[ControllerCheck]:
    """Return rows of the setup sheet on the linear axes that carry a robot.

    They state what the configuration (MOC.cfg) of the robot must contain.
    """
    rows = list[ControllerCheck]()
    for rail in arm.linear_axes:
        direction = ", ".join(markup.fixed_decimals(float(value), 6) for value in rail.axis)
        limits = f"{rail.low / MM:g} to {rail.high / MM:g} mm, at most {rail.speed / MM:g} mm/s and "
        number = "the first external one" if rail.column == 0 else f"external axis number {rail.column + 1}"
        description = f"present, one linear axis, {number} ({_axis_name(rail.column)}), in mm"
        rows += [
            (f"mechanical unit {rail.label}", description),
            (f"{rail.label}: base frame", f"positive direction ({direction}) in the world"),
            (f"{rail.label}: joint", f"{limits}{rail.acceleration / MM:g} mm/s²; home {rail.home / MM:g} mm"),
            *external_axes_sheet.rail_checks(rail),
            (f"{rail.label} {_TERMS.start}", external_axes_sheet.home_check(f"{rail.home / MM:g} mm")),
        ]
    units = list(dict.fromkeys(rail.unit for rail in arm.linear_axes))
    # from the floor up: each unit carries the base frame of the next one
    rows += [(f"{upper}: base frame moved by", lower) for lower, upper in itertools.pairwise(units)]
    return [
        *rows,
        (f"{robot}: base frame moved by", units[-1]),
        (
            f"{robot}: base frame",
            f"that of arm {arm.name} at {external_axes_sheet.rail_zero(arm)}: "
            f"{point_text(arm.base[:3, 3])} mm",
        ),
    ]


def _turntable_unit_checks(table: Turntable) -> list[ControllerCheck]:
    """Return the row on the mechanical unit of a turntable, with or without a tilt axis."""
    column = f"number {table.column + 1} ({_axis_name(table.column)})"
    task = f"of the task of arm {table.arm}"
    description = f"present, one rotary axis, external axis {column} {task}, in deg"
    if table.tilt is not None:
        columns = f"tilt number {table.tilt.column + 1} ({_axis_name(table.tilt.column)}), turn {column}"
        description = f"present, two rotary axes of one unit, external axes {task}: {columns}, in deg"
    return [(f"mechanical unit {table.unit}", description)]


def _axis_name(column: int) -> str:
    """Return the name of an external axis in a jointtarget; ``column`` counts from 0."""
    return f"eax_{'abcdef'[column]}"


def _task_rows(problem: Problem, arms: Sequence[Arm]) -> list[SetupRow]:
    """Return a row with the RAPID task of each of the given arms, or no row if the problem names no tasks."""
    tasks = zip(problem.cell.arms, problem.cell.controller.tasks, strict=False)
    task_names = [f"{arm.name}: {task}" for arm, task in tasks if arm in arms]
    return [("tasks", ", ".join(task_names))] if task_names else []


REPORT: Final = ReportOfLanguage(checks=_checks, programs=_task_rows)
