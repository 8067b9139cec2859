"""Rows of the setup sheet for KUKA controllers: files to load, machine data of external axes."""

from collections.abc import Sequence
from typing import Final

from planner.geometry.units import MM
from planner.problem import Arm, Problem, Turntable
from planner.report import external_axes_sheet, markup
from planner.report.external_axes_sheet import AxisTerms
from planner.report.plugin_contributions import (
    ControllerCheck,
    ControllerSetup,
    ReportOfLanguage,
    SetupRow,
    signal_numbers,
)
from planner.report.pose_text import point_text

_TERMS: Final = AxisTerms(
    start="before the program starts",
    limits=lambda n: (f"$SOFTN_END[{6 + n}], $SOFTP_END[{6 + n}]", f" (at $VEL_EXTAX[{n}] 100)"),
    frame="$WORLD",
)


def _checks(setup: ControllerSetup) -> list[ControllerCheck]:
    """Return what to check at a KUKA controller: name of the setting or file, and its required state."""
    controller = setup.problem.cell.controller
    out: list[ControllerCheck] = []
    (arm,) = setup.arms
    signals = [
        (signal, number)
        for signal in setup.signals
        if (number := controller.signal_number(arm.name, signal)) is not None
    ]
    folder = f"programs/controller/{arm.name}"
    if signals:
        files = f"config_user.dat, sps_user.sub and ir_stopm_user.src of {folder}"
        out.append((files, "in $CONFIG.DAT, SPS.SUB and IR_STOPM.SRC; the submit interpreter runs"))
    elif setup.joined:
        files = f"config_user.dat and sps_user.sub of {folder}"
        out.append((files, "in $CONFIG.DAT and SPS.SUB; the submit interpreter runs"))
    if setup.joined:
        arm_signals = controller.handshake.of(arm.name)
        enable = controller.signal_number(arm.name, arm_signals.move_enable)
        out.append(
            (
                f"$OUT[{enable}] {arm_signals.move_enable}",
                "wired to the input of $MOVE_ENABLE; $CHCK_MOVENA TRUE",
            )
        )
    for signal, number in signals:
        output_number = controller.signal_number(arm.name, controller.interlock.power_output(signal).signal)
        out.append(
            (
                "the power falls at a stop and with the drives",
                f"$OUT[{number if output_number is None else output_number}]",
            )
        )
    if signals and setup.hot:
        mounting = (
            "not in automatic: mount it cold, or in T1 with the enabling switch held by a second person"
        )
        out.append((f"mounting while {setup.hot} is hot and the gate open", mounting))
    out += setup.torch_checks([signal for signal, _ in signals], "reset, start")
    if arm.linear_axes:
        out += _rail_checks(arm)
    table = setup.problem.cell.turntable
    if table is not None and table.arm == arm.name:
        out += external_axes_sheet.turntable(setup.problem, table, _TERMS, _turntable_axis_checks(table))
    out += _unused_axis_checks(arm, table)
    out.append(("after an error, or a stop that is not resumed", "reset the program, then start"))
    return out


def _rail_checks(arm: Arm) -> list[ControllerCheck]:
    """Return rows on what the machine data must contain for the linear axes under an arm.

    The kinematic of these axes is #ERSYS, of up to three linear axes. It moves $ROBROOT_C without a statement
    in the program. Source: KR C2, machine data, 2.1.9 $ERSYSROOT.
    """
    unit, gantry = arm.linear_axes[0].unit, arm.track is None
    numbers = [rail.column + 1 for rail in arm.linear_axes]
    out: list[ControllerCheck] = []
    for n, rail in zip(numbers, arm.linear_axes, strict=True):
        travel = f"{rail.low / MM:g} to {rail.high / MM:g} mm, at most {rail.speed / MM:g} mm/s"
        world_direction = ", ".join(markup.fixed_decimals(float(v), 6) for v in rail.axis)
        foot_direction = ", ".join(markup.fixed_decimals(float(v), 6) for v in arm.base[:3, :3].T @ rail.axis)
        ends, speed = _TERMS.limits(n)
        limits = f"{travel} and {rail.acceleration / MM:g} mm/s²; home {rail.home / MM:g} mm"
        out += [
            (f"E{n}, axis {6 + n}: {rail.label}", "present, one linear axis, synchronous, in mm"),
            (
                f"{rail.label}: direction",
                f"positive direction ({world_direction}) in the world, ({foot_direction}) in $WORLD",
            ),
            *external_axes_sheet.rail_checks(rail),
            (f"{rail.label}: {ends}", limits + (speed if gantry else "")),
            (f"{rail.label} {_TERMS.start}", external_axes_sheet.home_check(f"{rail.home / MM:g} mm")),
        ]
    chain = f"E{numbers[0]} as its only axis"
    if gantry:
        chain = ", ".join(f"TR_A{k} #E{n}" for k, n in enumerate(numbers, 1)) + " from the floor up"
    zero = (
        f"so that $WORLD is at the foot of arm {arm.name} with {unit} at {external_axes_sheet.rail_zero(arm)}"
    )
    return [
        (f"{unit} in MACHINE_DEF, $EX_KIN", f"#ERSYS with {chain}: it moves $ROBROOT_C"),
        *out,
        ("$ERSYSROOT", zero),
        ("that foot, the base frame", f"{point_text(arm.base[:3, 3])} mm of the world"),
    ]


def _turntable_axis_checks(table: Turntable) -> list[ControllerCheck]:
    """Return rows on the axes of a turntable or positioner in the machine data.

    The axes must not be endless: an endless axis counts modulo 360 and takes the shorter direction. This was
    not tested.

    Source: KR C2, machine data, 2.1.4 $AXIS_TYPE; order of the axes: 2.2.6 $ET1_AX.
    """
    out = []
    for axis in reversed(table.axes.values()):  # from the floor up
        n = axis.column + 1
        kind = f"present, rotary, synchronous, in deg; $AXIS_TYPE[{6 + n}] 3, not 5 (shorter direction)"
        out.append((f"E{n}, axis {6 + n}: {axis.label}", kind))
    fixed = "or #NONE: programs set $BASE to a fixed frame for each station, and couple it to no axis"
    if table.tilt is None:
        return [*out, (f"{table.unit} in MACHINE_DEF, $EX_KIN", f"#EASYS, {fixed}")]
    chain = f"TR_A1 #E{table.tilt.column + 1} (tilt), TR_A2 #E{table.column + 1} (turn)"
    return [*out, (f"{table.unit} in MACHINE_DEF, $EX_KIN, $ET1_AX", f"#EASYS with {chain}, {fixed}")]


def _unused_axis_checks(arm: Arm, table: Turntable | None) -> list[ControllerCheck]:
    """Return a row on the external axes that the program of an arm does not use, if it uses others.

    The program's joint positions state 0 for each unused axis, so a PTP would move it there.
    """
    used_columns = {rail.column for rail in arm.linear_axes}
    if table is not None and table.arm == arm.name:
        used_columns |= {axis.column for axis in table.axes.values()}
    unused = ", ".join(f"E{column + 1}" for column in range(6) if column not in used_columns)
    requirement = f"none of {unused} is present, or it is decoupled: PTP would move it to 0"
    return [("other external axes", requirement)] if used_columns else []


def _program_rows(problem: Problem, arms: Sequence[Arm]) -> list[SetupRow]:
    """Return a row on the program of each arm: dialect, signal numbers, and whether it has spline blocks."""
    controller = problem.cell.controller
    dialect = {"krc4": "KRC4, KSS 8.3 or later", "krc2": "KRC2"}[controller.dialect]
    blocks = "; spline blocks, not seen on a controller" if controller.path == "spline" else ""
    return [
        (f"KRL of {arm.name}", f"{dialect}; $ROBROOT zero{signal_numbers(problem, arm)}{blocks}")
        for arm in arms
    ]


REPORT: Final = ReportOfLanguage(
    checks=_checks, programs=_program_rows, load_compensation="model of a positionally accurate robot"
)
