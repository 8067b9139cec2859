"""What the controller's configuration must say of external axes, for the setup sheet."""

from __future__ import annotations

import itertools

import numpy as np

from planner.geometry.arrays import inverse, transform
from planner.geometry.units import DEG, MM
from planner.problem import Arm, LinearAxis, Problem, RotaryAxis, Turntable
from planner.report import markup
from planner.report.pose_text import point, pose_cells


def abb_rails(arm: Arm, robot: str) -> list[tuple[str, str]]:
    """What the controller's configuration (MOC.cfg) must say of the axes under an arm."""
    out, gantry = list[tuple[str, str]](), arm.track is None
    for rail in arm.axes:
        along = ", ".join(markup.fixed(float(v), 6) for v in rail.axis)
        span = f"{rail.low / MM:g} to {rail.high / MM:g} mm, at most {rail.speed / MM:g} mm/s and "
        number = "the first external one" if rail.column == 0 else f"external axis number {rail.column + 1}"
        what = f"there, one linear axis, {number} (eax_{'abcdef'[rail.column]}), in mm"
        out += [
            (f"mechanical unit {rail.label}", what),
            (f"{rail.label}: base frame", f"its values grow along ({along}) of the world"),
            (f"{rail.label}: joint", f"{span}{rail.acceleration / MM:g} mm/s²; home {rail.home / MM:g} mm"),
            *_carries(rail),
            *_goes_along(rail),
            (f"{rail.label} before PP to main", _jogged(f"{rail.home / MM:g} mm")),
        ]
    units = list(dict.fromkeys(rail.unit for rail in arm.axes))
    # from the floor up: each unit's base frame is moved by the one below it
    out += [(f"{two}: base frame moved by", one) for one, two in itertools.pairwise(units)]
    last = "0 mm" if not gantry else f"{', '.join(rail.word for rail in arm.axes)} at 0 mm"
    return [
        *out,
        (f"{robot}: base frame moved by", units[-1]),
        (f"{robot}: base frame", f"that of arm {arm.name} at {last}: {point(arm.base[:3, 3])} mm"),
    ]


def _carries(rail: LinearAxis) -> list[tuple[str, str]]:
    """What is measured of the bodies that stand on an axis."""
    if not rail.carries:
        return []
    what = f"{', '.join(rail.carries)}: at 0 mm where the cell has them; measure two corners of each"
    return [(f"{rail.label} carries", what)]


def _jogged(home: str) -> str:
    """Where an external axis has to stand before a program begins."""
    return f"jogged home, to {home}: a program looks before its first move, and goes no further elsewhere"


def turntable(problem: Problem, table: Turntable) -> list[tuple[str, str]]:
    """What the controller's configuration (MOC.cfg, KUKA's machine data) must say of a turntable, and how the
    block is clamped."""
    sense = "counter-clockwise" if table.axis[2] > 0.0 else "clockwise"
    place, turn, _ = pose_cells(np.asarray(problem.stock.place))
    mover = problem.cell.arm(table.arm)
    tilt, kuka = table.tilt, mover.data.family == "KUKA"
    root = f"its axis goes upright through {point(table.centre)} mm of the world"
    root += "" if tilt is None else f", with {tilt.label} at 0 deg"
    if kuka:
        root += f", {point(transform(inverse(mover.base), table.centre))} mm of $WORLD"
        first = _kuka_turntable(table)
        start = f"{table.unit} before the program starts"
    else:
        column = f"number {table.column + 1} (eax_{'abcdef'[table.column]})"
        task = f"external axis {column} of the task of arm {table.arm}"
        first = [(f"mechanical unit {table.unit}", f"there, one rotary axis, {task}, in deg")]
        if tilt is not None:
            columns = f"tilt number {tilt.column + 1} (eax_{'abcdef'[tilt.column]}), turn {column}"
            what = (
                f"there, two rotary axes of one unit, external axes of the task of arm {table.arm}: {columns}"
            )
            first = [(f"mechanical unit {table.unit}", f"{what}, in deg")]
        start = f"{table.unit} before PP to main"
    home = ", ".join(f"{axis.word} {axis.home / DEG:g}".strip() for axis in table.axes.values())
    return [
        *first,
        *([] if tilt is None else _tilt(problem, table, tilt)),
        (f"{table.label}: base frame", root),
        (f"{table.label}: sense", f"seen from above, growing values turn it {sense}"),
        _joint(table, kuka),
        (start, _jogged(f"{home} deg")),
        (f"block with {table.unit} at 0 deg", f"at {place} mm, roll, pitch, yaw {turn} deg"),
    ]


def _joint(axis: RotaryAxis, kuka: bool) -> tuple[str, str]:
    """The range of an axis under the block, its speed and acceleration, and its home."""
    n = axis.column + 1
    where = f"$SOFTN_END[{6 + n}], $SOFTP_END[{6 + n}]" if kuka else "joint"
    own = f" (at $VEL_EXTAX[{n}] 100)" if kuka else ""
    ends = f"{axis.low / DEG:g} to {axis.high / DEG:g} deg, at most {axis.speed / DEG:g} deg/s{own}"
    fast = f", {axis.acceleration / DEG:g} deg/s²" if np.isfinite(axis.acceleration) else ""
    return f"{axis.label}: {where}", f"{ends}{fast}; home {axis.home / DEG:g} deg"


def _kuka_turntable(table: Turntable) -> list[tuple[str, str]]:
    """The axes of a turntable or positioner in the machine data of a KUKA controller. Of one that turns
    infinitely the values count modulo 360, and it goes the shorter way (KR C2, machine data, 2.1.4), which
    nobody has looked at; the order of axes in a kinematic: 2.2.6 $ET1_AX."""
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


def _tilt(problem: Problem, table: Turntable, tilt: RotaryAxis) -> list[tuple[str, str]]:
    """What the controller's configuration must say of a positioner's tilt axis and of its load."""
    mover = problem.cell.arm(table.arm)
    kuka, base = mover.data.family == "KUKA", inverse(mover.base)
    frames = [("the world", tilt.axis, tilt.centre)]
    frames += [("$WORLD", base[:3, :3] @ tilt.axis, transform(base, tilt.centre))] if kuka else []
    lies = "; ".join(
        f"it goes along ({', '.join(markup.fixed(float(v), 6) for v in axis)}) of {name}, {point(at)} mm is "
        "on it"
        for name, axis, at in frames
    )
    masses = [setup.stock.mass for setup in problem.setups if setup.stock.mass is not None]
    most = "not stated" if table.load is None else f"{table.load:g} kg"
    block = f"the block weighs {max(masses):.1f} kg" if masses else "weigh the block"
    carried = f"carries: {most}; {block}, with its support"
    carried += "" if kuka else ", and tell the controller (MechUnitLoad)"
    return [
        (f"{tilt.label}: base frame", lies),
        (f"{tilt.label}: zero", "with 0 deg the plate lies flat, its top upwards: measure with a level"),
        (f"{tilt.label}: sense", "growing values tilt it by the right hand about that direction"),
        _joint(tilt, kuka),
        (f"{table.unit}: load", carried),
    ]


def _goes_along(track: LinearAxis) -> list[tuple[str, str]]:
    """What is to be told of a track that goes along while the arm works."""
    if track.follow is None:
        return []
    what = f"by {track.follow:g} of the tool's way along it, within its range, coordinated with the arm"
    return [(f"{track.unit} while the arm works goes along", what)]


def kuka_rails(arm: Arm) -> list[tuple[str, str]]:
    """What the machine data of a KUKA controller must say of the axes under an arm. That their kinematic is
    #ERSYS, of up to three linear axes, and moves $ROBROOT_C without a word in the program: KR C2, machine
    data, 2.1.9 $ERSYSROOT."""
    unit, gantry = arm.axes[0].unit, arm.track is None
    out, numbers = list[tuple[str, str]](), [rail.column + 1 for rail in arm.axes]
    for n, rail in zip(numbers, arm.axes, strict=True):
        span = f"{rail.low / MM:g} to {rail.high / MM:g} mm, at most {rail.speed / MM:g} mm/s"
        along = ", ".join(markup.fixed(float(v), 6) for v in rail.axis)
        seen = ", ".join(markup.fixed(float(v), 6) for v in arm.base[:3, :3].T @ rail.axis)
        limits = f"{span} and {rail.acceleration / MM:g} mm/s²; home {rail.home / MM:g} mm"
        limits += f" (at $VEL_EXTAX[{n}] 100)" if gantry else ""
        out += [
            (f"E{n}, axis {6 + n}: {rail.label}", "there, one linear axis, synchronous, in mm"),
            (f"{rail.label}: direction", f"its values grow along ({along}) of the world, ({seen}) of $WORLD"),
            *_carries(rail),
            *_goes_along(rail),
            (f"{rail.label}: $SOFTN_END[{6 + n}], $SOFTP_END[{6 + n}]", limits),
            (f"{rail.label} before the program starts", _jogged(f"{rail.home / MM:g} mm")),
        ]
    chain, zero = f"E{numbers[0]} as its only axis", "0 mm"
    if gantry:
        chain = ", ".join(f"TR_A{k} #E{n}" for k, n in enumerate(numbers, 1)) + " from the floor up"
        zero = f"{', '.join(rail.word for rail in arm.axes)} at 0 mm"
    return [
        (f"{unit} in MACHINE_DEF, $EX_KIN", f"#ERSYS with {chain}: it moves $ROBROOT_C"),
        *out,
        ("$ERSYSROOT", f"so that $WORLD lies in the foot of arm {arm.name} with {unit} at {zero}"),
        ("that foot, the base frame", f"{point(arm.base[:3, 3])} mm of the world"),
    ]


def other_axes(arm: Arm, table: Turntable | None) -> list[tuple[str, str]]:
    """External axes of a KUKA controller that the program of an arm does not know. Its data of joints have 0
    for each, and a PTP would take them there."""
    own = {rail.column for rail in arm.axes}
    if table is not None and table.arm == arm.name:
        own |= {axis.column for axis in table.axes.values()}
    rest = ", ".join(f"E{column + 1}" for column in range(6) if column not in own)
    what = f"none of {rest} is there, or it is decoupled: PTP would take it to 0"
    return [("other external axes", what)] if own else []
