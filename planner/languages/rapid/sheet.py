"""Rows of the setup sheet for ABB controllers: files to load, settings, external axes."""

import itertools
from collections.abc import Sequence
from typing import Final

from planner.geometry.units import MM
from planner.problem import Arm, Problem, Turntable
from planner.report import axes_sheet, markup
from planner.report.axes_sheet import AxisTerms
from planner.report.contribution import Check, ControllerSetup, ReportOfLanguage, Row
from planner.report.pose_text import point

_TERMS: Final = AxisTerms(
    start="before PP to main", limits=lambda _: ("joint", ""), load=", and tell the controller (MechUnitLoad)"
)


def _checks(setup: ControllerSetup) -> list[Check]:
    problem, controller = setup.problem, setup.problem.cell.controller
    alone = controller.sync == "handshake"
    ending = "sys" if controller.robotware == 6 else "sysx"
    out = [("RobotWare", f"{controller.robotware}; its modules end in .{ending.replace('sys', 'mod')}")]
    signals = setup.signals
    folder = f"programs/controller/{setup.arms[0].name}" if alone else "programs/controller"
    if setup.joined and not signals:
        out.append((f"EIO.cfg of {folder}", "loaded"))
    if setup.joined:
        out += _running_wires(problem, setup.arms[0].name)
    if signals:
        out.append((f"EIO.cfg, SYS.cfg and TandemPower.{ending} of {folder}", "loaded"))
        for signal in signals:
            real = controller.interlock.of(signal)
            place = f"{real.device}, bit {real.bit}" if real.device else "NO DEVICE stated, so no power"
            out.append((f"{real.signal} falls at a stop, with the motors, with the enabling device", place))
    if signals and setup.hot:
        how = "not in automatic: mount cold, or in manual at reduced speed while somebody else holds the "
        how += "enabling device, and run to the end in manual"
        out.append((f"mounting while {setup.hot} is hot and the gate open", how))
    out += setup.torch_checks(signals, "PP to main in all tasks, Start")
    out.append(("SoftES in SYS.cfg (RUNCHN_BOOL)", "selected: arms keep to their path at an emergency stop"))
    for number, arm in enumerate(problem.cell.arms):
        if arm.axes and (arm.name == setup.arms[0].name or not alone):
            out += _rails(arm, controller.robot(number))
    table = problem.cell.turntable
    if table is not None and (table.arm == setup.arms[0].name or not alone):
        out += axes_sheet.turntable(problem, table, _TERMS, _units(table))
    if any(one.stock.held_by for one in problem.setups):
        out.append(("ModalPayLoadMode (SYS_MISC)", "1: else GripLoad of the held block counts for nothing"))
    out.append(("CAB_REGAIN_DIST, AUTO", "small: an arm goes back to its path by itself from so far away"))
    out.append(("behind an error or a stop that is given up", "PP to main in all tasks, then start"))
    return out


def _running_wires(problem: Problem, arm: str) -> list[Check]:
    own, lock = problem.cell.controller.handshake.of(arm), problem.cell.controller.interlock
    places = [(name, lock.place(arm, name)) for name in (own.running, own.partner_running)]
    return [
        (f"{name} is wired", f"{at.device}, bit {at.bit}" if at else "NO DEVICE stated, so the wire is dead")
        for name, at in places
    ]


def _rails(arm: Arm, robot: str) -> list[Check]:
    """What the configuration (MOC.cfg) must say of the axes under an arm."""
    out = list[Check]()
    for rail in arm.axes:
        along = ", ".join(markup.fixed(float(v), 6) for v in rail.axis)
        span = f"{rail.low / MM:g} to {rail.high / MM:g} mm, at most {rail.speed / MM:g} mm/s and "
        number = "the first external one" if rail.column == 0 else f"external axis number {rail.column + 1}"
        what = f"there, one linear axis, {number} ({_eax(rail.column)}), in mm"
        out += [
            (f"mechanical unit {rail.label}", what),
            (f"{rail.label}: base frame", f"its values grow along ({along}) of the world"),
            (f"{rail.label}: joint", f"{span}{rail.acceleration / MM:g} mm/s²; home {rail.home / MM:g} mm"),
            *axes_sheet.rail_checks(rail),
            (f"{rail.label} {_TERMS.start}", axes_sheet.jogged(f"{rail.home / MM:g} mm")),
        ]
    units = list(dict.fromkeys(rail.unit for rail in arm.axes))
    # from the floor up: each unit's base frame is moved by the one below it
    out += [(f"{two}: base frame moved by", one) for one, two in itertools.pairwise(units)]
    return [
        *out,
        (f"{robot}: base frame moved by", units[-1]),
        (
            f"{robot}: base frame",
            f"that of arm {arm.name} at {axes_sheet.rail_zero(arm)}: {point(arm.base[:3, 3])} mm",
        ),
    ]


def _units(table: Turntable) -> list[Check]:
    column, task = f"number {table.column + 1} ({_eax(table.column)})", f"of the task of arm {table.arm}"
    what = f"there, one rotary axis, external axis {column} {task}, in deg"
    if table.tilt is not None:
        columns = f"tilt number {table.tilt.column + 1} ({_eax(table.tilt.column)}), turn {column}"
        what = f"there, two rotary axes of one unit, external axes {task}: {columns}, in deg"
    return [(f"mechanical unit {table.unit}", what)]


def _eax(column: int) -> str:
    """The name of an external axis in a jointtarget."""
    return f"eax_{'abcdef'[column]}"


def _programs(problem: Problem, arms: Sequence[Arm]) -> list[Row]:
    tasks = zip(problem.cell.arms, problem.cell.controller.tasks, strict=False)
    named = [f"{arm.name}: {task}" for arm, task in tasks if arm in arms]
    return [("tasks", ", ".join(named))] if named else []


REPORT: Final = ReportOfLanguage(checks=_checks, programs=_programs)
