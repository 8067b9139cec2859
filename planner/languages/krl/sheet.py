"""Rows of the setup sheet for KUKA controllers: files to load, machine data of external axes."""

from collections.abc import Sequence
from typing import Final

from planner.geometry.units import MM
from planner.problem import Arm, Problem, Turntable
from planner.report import axes_sheet, markup
from planner.report.axes_sheet import AxisTerms
from planner.report.contribution import Check, ControllerSetup, ReportOfLanguage, Row, numbered_signals
from planner.report.pose_text import point

_TERMS: Final = AxisTerms(
    start="before the program starts",
    limits=lambda n: (f"$SOFTN_END[{6 + n}], $SOFTP_END[{6 + n}]", f" (at $VEL_EXTAX[{n}] 100)"),
    frame="$WORLD",
)


def _checks(setup: ControllerSetup) -> list[Check]:
    controller, out = setup.problem.cell.controller, list[Check]()
    (arm,) = setup.arms
    signals = [
        (signal, number)
        for signal in setup.signals
        if (number := controller.number(arm.name, signal)) is not None
    ]
    folder = f"programs/controller/{arm.name}"
    if signals:
        files = f"config_user.dat, sps_user.sub and ir_stopm_user.src of {folder}"
        out.append((files, "in $CONFIG.DAT, SPS.SUB and IR_STOPM.SRC; the submit interpreter runs"))
    elif setup.joined:
        files = f"config_user.dat and sps_user.sub of {folder}"
        out.append((files, "in $CONFIG.DAT and SPS.SUB; the submit interpreter runs"))
    if setup.joined:
        own = controller.handshake.of(arm.name)
        enable = controller.number(arm.name, own.move_enable)
        out.append(
            (f"$OUT[{enable}] {own.move_enable}", "wired to the input of $MOVE_ENABLE; $CHCK_MOVENA TRUE")
        )
    for signal, number in signals:
        real = controller.number(arm.name, controller.interlock.of(signal).signal)
        out.append(
            ("the power falls at a stop and with the drives", f"$OUT[{number if real is None else real}]")
        )
    if signals and setup.hot:
        how = "not in automatic: mount cold, or in T1 with the enabling switch held by somebody else"
        out.append((f"mounting while {setup.hot} is hot and the gate open", how))
    out += setup.torch_checks([signal for signal, _ in signals], "reset, start")
    if arm.axes:
        out += _rails(arm)
    table = setup.problem.cell.turntable
    if table is not None and table.arm == arm.name:
        out += axes_sheet.turntable(setup.problem, table, _TERMS, _units(table))
    out += _other_axes(arm, table)
    out.append(("behind an error or a stop that is given up", "reset the program, then start"))
    return out


def _rails(arm: Arm) -> list[Check]:
    """What the machine data must say of the axes under an arm.

    Source: KR C2, machine data, 2.1.9 $ERSYSROOT. Their kinematic is #ERSYS, of up to three linear axes, and
    moves $ROBROOT_C without a statement in the program.
    """
    unit, gantry = arm.axes[0].unit, arm.track is None
    out, numbers = list[Check](), [rail.column + 1 for rail in arm.axes]
    for n, rail in zip(numbers, arm.axes, strict=True):
        span = f"{rail.low / MM:g} to {rail.high / MM:g} mm, at most {rail.speed / MM:g} mm/s"
        along = ", ".join(markup.fixed(float(v), 6) for v in rail.axis)
        seen = ", ".join(markup.fixed(float(v), 6) for v in arm.base[:3, :3].T @ rail.axis)
        ends, speed = _TERMS.limits(n)
        limits = f"{span} and {rail.acceleration / MM:g} mm/s²; home {rail.home / MM:g} mm"
        out += [
            (f"E{n}, axis {6 + n}: {rail.label}", "there, one linear axis, synchronous, in mm"),
            (f"{rail.label}: direction", f"its values grow along ({along}) of the world, ({seen}) of $WORLD"),
            *axes_sheet.rail_checks(rail),
            (f"{rail.label}: {ends}", limits + (speed if gantry else "")),
            (f"{rail.label} {_TERMS.start}", axes_sheet.jogged(f"{rail.home / MM:g} mm")),
        ]
    chain = f"E{numbers[0]} as its only axis"
    if gantry:
        chain = ", ".join(f"TR_A{k} #E{n}" for k, n in enumerate(numbers, 1)) + " from the floor up"
    zero = f"so that $WORLD lies in the foot of arm {arm.name} with {unit} at {axes_sheet.rail_zero(arm)}"
    return [
        (f"{unit} in MACHINE_DEF, $EX_KIN", f"#ERSYS with {chain}: it moves $ROBROOT_C"),
        *out,
        ("$ERSYSROOT", zero),
        ("that foot, the base frame", f"{point(arm.base[:3, 3])} mm of the world"),
    ]


def _units(table: Turntable) -> list[Check]:
    """The axes of a turntable or positioner in the machine data.

    Values of an endless axis count modulo 360, and it goes the shorter way. That was not tested.

    Source: KR C2, machine data, 2.1.4 $AXIS_TYPE; order of the axes: 2.2.6 $ET1_AX.
    """
    out = []
    for axis in reversed(table.axes.values()):  # from the floor up
        n = axis.column + 1
        kind = f"there, rotary, synchronous, in deg; $AXIS_TYPE[{6 + n}] 3, not 5, which goes the shorter way"
        out.append((f"E{n}, axis {6 + n}: {axis.label}", kind))
    fixed = "or #NONE: programs set $BASE to a fixed frame of each station, and couple it to none"
    if table.tilt is None:
        return [*out, (f"{table.unit} in MACHINE_DEF, $EX_KIN", f"#EASYS, {fixed}")]
    chain = f"TR_A1 #E{table.tilt.column + 1} (tilt), TR_A2 #E{table.column + 1} (turn)"
    return [*out, (f"{table.unit} in MACHINE_DEF, $EX_KIN, $ET1_AX", f"#EASYS with {chain}, {fixed}")]


def _other_axes(arm: Arm, table: Turntable | None) -> list[Check]:
    """External axes that the program of an arm does not know.

    Its joint positions state 0 for each, so a PTP would move it there.
    """
    own = {rail.column for rail in arm.axes}
    if table is not None and table.arm == arm.name:
        own |= {axis.column for axis in table.axes.values()}
    rest = ", ".join(f"E{column + 1}" for column in range(6) if column not in own)
    what = f"none of {rest} is there, or it is decoupled: PTP would take it to 0"
    return [("other external axes", what)] if own else []


def _programs(problem: Problem, arms: Sequence[Arm]) -> list[Row]:
    controller = problem.cell.controller
    dialect = {"krc4": "KRC4, KSS 8.3 on", "krc2": "KRC2"}[controller.dialect]
    blocks = "; spline blocks, not seen on a controller" if controller.path == "spline" else ""
    return [
        (f"KRL of {arm.name}", f"{dialect}; $ROBROOT zero{numbered_signals(problem, arm)}{blocks}")
        for arm in arms
    ]


REPORT: Final = ReportOfLanguage(
    checks=_checks, programs=_programs, load_compensation="model of a positionally accurate robot"
)
