"""External axes under the stock in a cell file: a turntable or a tilt-turn positioner, with all faults.

Axes under an arm are in :mod:`planner.reading.rail_axes`. Turntables that turn while an arm works are not
supported.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from pydantic import Field

from planner.geometry.arrays import Shape, from_parts
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError
from planner.problem import (
    EXTERNAL_AXIS_FAMILIES,
    MAX_BLIND_SPEED_M_S,
    STOCK_AXIS,
    TURNTABLE_BODY,
    Arm,
    Controller,
    Obstacle,
    Problem,
    RotaryAxis,
    Turntable,
    allows_any_attitude,
)
from planner.reading.rail_axes import MIN_AXIS_LENGTH, UNIT_DESCRIPTION
from planner.reading.strict_yaml import Name, Positive, Strict, Vector

VERTICAL_TOLERANCE: Final = 1e-9
"""Maximum horizontal part of the unit vector of an axis that counts as vertical."""
MIN_KRL_SPEED_FRACTION: Final = 0.01
"""Minimum speed of an external axis in KRL, as a fraction of its maximum: $VEL_EXTAX takes whole percents."""
MAX_KRL_ROTATION_DEG: Final = 358.0
"""Maximum value [deg], to either side, of a rotary axis of a KUKA controller.

Software limits of an axis that is not endless ($AXIS_TYPE 3; KR C2, machine data, 2.1.4).
"""
ROTATION_STEP_RAD: Final = 5.0 * DEG
"""Step [rad] of turntable values at which the distance of the stock from the tilt axis is computed."""
SAMPLING_FACTOR: Final = 1.002
"""Bound on the ratio of the distance between two such steps to that at the steps."""
HOME_DECIMALS: Final = 4
"""Decimals [deg] of a turntable's home value, as programs write it."""


class TurntablePlateFile(Strict):
    """The plate of a turntable, a cylinder under its centre."""

    diameter_mm: Positive
    height_mm: Positive = Field(description="from its top down to the floor or to its support")


class TurntableFile(Strict):
    """A turntable under the block, which turns it from station to station between operations.

    `place` of the block is stated at value 0.
    """

    unit: Name = Field(description=UNIT_DESCRIPTION)
    arm: Name | None = Field(default=None, description="arm whose program moves it; none: the first arm")
    external_axis: int = Field(
        default=1, ge=1, le=6, description="number of the external axis: 1 is eax_a or E1"
    )
    centre_mm: Vector = Field(description="centre of the plate's top, in the world")
    axis: Vector = Field(
        default=(0.0, 0.0, 1.0),
        description="positive rotation is right-handed about it: vertical, up or down",
    )
    range_deg: tuple[float, float] = Field(description="minimum and maximum")
    speed_deg_s: float = Field(ge=0.1, le=720, description="maximum")
    home_deg: float = Field(default=0.0, description="value before a program starts")
    plate: TurntablePlateFile


class TiltFile(Strict):
    """The tilt axis of a positioner, fixed in the world.

    It tilts the turn axis, the plate and the bracket. At value 0 the plate is level.
    """

    external_axis: int = Field(
        default=1, ge=1, le=6, description="number of the external axis: 1 is eax_a or E1"
    )
    centre_mm: Vector = Field(description="a point on it, in the world; it need not intersect the turn axis")
    axis: Vector = Field(description="positive tilt is right-handed about it; not vertical")
    range_deg: tuple[float, float] = Field(description="minimum and maximum, including 0")
    speed_deg_s: float = Field(ge=0.1, le=720, description="maximum")
    acceleration_deg_s2: float = Field(ge=0.1, le=10_000, description="maximum")
    home_deg: float = Field(default=0.0, description="value before a program starts")
    bracket: tuple[Name, ...] = Field(
        default=(), max_length=20, description="bodies of `obstacles` that it tilts, placed at value 0"
    )


class PositionerFile(TurntableFile):
    """A tilt-turn positioner under the block: a turntable on a tilt axis, in one mechanical unit.

    It moves the block from station to station between operations. `place` of the block is stated at both
    values 0.
    """

    external_axis: int = Field(
        default=2, ge=1, le=6, description="number of the turn axis among the external axes"
    )
    acceleration_deg_s2: float = Field(ge=0.1, le=10_000, description="maximum of the turn axis")
    load_kg: Positive | None = Field(default=None, description="maximum payload")
    tilt: TiltFile


MAX_ROTATION_DEG: Final = 3600.0
"""Maximum value of a turntable [deg], ten turns. Chosen: larger values are considered mistakes."""
MIN_TILT_AXIS_SINE: Final = np.sin(5.0 * DEG)
"""Sine of the minimum angle between a tilt axis and the vertical."""


def _range_faults(spec: TurntableFile | TiltFile) -> list[tuple[str, str]]:
    """Return what is wrong with the range and the home value of a rotary axis, as (field, message)."""
    low, high = spec.range_deg
    out = []
    if not low < high:
        message = f"got {low:g} to {high:g}; give the lower value first, then a larger one"
        out.append(("range_deg", message))
    elif not low <= spec.home_deg <= high:
        out.append(("home_deg", f"{spec.home_deg:g} is outside the range of {low:g} to {high:g}"))
    if not max(abs(low), abs(high)) <= MAX_ROTATION_DEG:
        out.append(("range_deg", f"got {low:g} to {high:g}; allowed: up to {MAX_ROTATION_DEG:g} either way"))
    return out


def _tilt_faults(spec: PositionerFile, bodies: Sequence[str]) -> list[tuple[str, str]]:
    """Return what is wrong with the tilt axis of a positioner in a cell file, as (field, message).

    Fields are relative to the positioner, such as ``tilt.axis``. ``bodies`` are the names of the obstacles
    of the cell, among which the bracket of the axis must be.
    """
    tilt = spec.tilt
    out = _range_faults(tilt)
    low, high = tilt.range_deg
    length = float(np.linalg.norm(tilt.axis))
    if not length > MIN_AXIS_LENGTH:
        out.append(("axis", "its length is 0; give its direction, such as [0, 1, 0]"))
    elif float(np.hypot(tilt.axis[0], tilt.axis[1])) < MIN_TILT_AXIS_SINE * length:
        text = "it is vertical within 5 degrees, as the turn axis; give the axis that tilts the plate, such "
        out.append(("axis", text + "as [0, 1, 0]"))
    if low < high and not low <= 0.0 <= high:
        text = f"0, where the plate is level, is outside {low:g} to {high:g}; count the values from there"
        out.append(("range_deg", text))
    elif low <= tilt.home_deg <= high and tilt.home_deg != 0.0:
        text = f"got {tilt.home_deg:g}; the block is clamped and removed there, so the plate must be level: 0"
        out.append(("home_deg", text))
    if max(abs(low), abs(high)) > 180.0:
        out.append(("range_deg", f"got {low:g} to {high:g}; allowed: up to 180 either way"))
    if tilt.external_axis == spec.external_axis:
        letter = "abcdef"[tilt.external_axis - 1]
        text = f"it is {tilt.external_axis} (eax_{letter}, E{tilt.external_axis}), as for the turn axis; "
        text += "give each axis its own"
        out.append(("external_axis", text))
    for name in tilt.bracket:
        if name not in bodies:
            text = f"{name!r} is not an obstacle of the cell; obstacles are {', '.join(bodies) or 'none'}"
            out.append(("bracket", text))
    return [(f"tilt.{name}", text) for name, text in out]


def build_turntable(
    spec: TurntableFile | None, arms: Sequence[Arm], controller: Controller, bodies: Sequence[str] = ()
) -> tuple[Turntable | None, tuple[Obstacle, ...]]:
    """Convert the turntable or positioner of a cell to SI units, with its plate as a body of the cell.

    Args:
        spec: Turntable or positioner of the file; None for none.
        arms: Arms of the cell.
        controller: Controller of the cell.
        bodies: Names of the obstacles of the cell.

    Raises:
        TandemError: ``problem.field``, ``problem.unknown_arm``, ``problem.duplicate_name`` or
            ``problem.turntable``, with all faults.
    """
    if spec is None:
        return None, ()
    issues = list[Issue]()
    kind = "positioner" if isinstance(spec, PositionerFile) else "turntable"

    def report(name: str, text: str, code: str = "problem.field") -> None:
        issues.append(Issue(code, f"{name}: {text}", field=f"{kind}.{name}"))

    # faults of the axis itself
    low, high = spec.range_deg
    length = float(np.linalg.norm(spec.axis))
    axis = np.array(spec.axis) / max(length, MIN_AXIS_LENGTH)
    if not length > MIN_AXIS_LENGTH:
        report("axis", "its length is 0; give [0, 0, 1], or [0, 0, -1] if values grow in the other direction")
    elif float(np.hypot(axis[0], axis[1])) > VERTICAL_TOLERANCE:
        text = "it is not vertical; allowed: [0, 0, 1] and [0, 0, -1]"
        if kind == "turntable":
            text += "; for a device that also tilts the block, state a positioner (positioner: tilt)"
        report("axis", text, "problem.turntable")
    faults = _range_faults(spec)
    if isinstance(spec, PositionerFile):
        faults += _tilt_faults(spec, bodies)
    for name, text in faults:
        report(name, text)
    # the controller that moves it
    arms_by_name = {arm.name: arm for arm in arms}
    moving_arm = arms_by_name.get(arms[0].name if spec.arm is None else spec.arm)
    if moving_arm is None:
        text = f"{spec.arm!r} is not an arm of the cell; it has {', '.join(arms_by_name)}"
        report("arm", text, "problem.unknown_arm")
    elif any(arm.data.family not in EXTERNAL_AXIS_FAMILIES for arm in arms):
        other = next(arm for arm in arms if arm.data.family not in EXTERNAL_AXIS_FAMILIES)
        text = f"arm {other.name} is of {other.data.family}; {kind}s are only supported for "
        text += f"{' and '.join(EXTERNAL_AXIS_FAMILIES)} controllers; remove the {kind}, or use such arms"
        report("arm", text, "problem.turntable")
    elif moving_arm.data.family == "KUKA" and low < high and max(-low, high) > MAX_KRL_ROTATION_DEG:
        text = f"got {low:g} to {high:g}; software limits of rotary axes of a KUKA controller are up to "
        report("range_deg", f"{text}{MAX_KRL_ROTATION_DEG:g} either way; give a range such as [-180, 180]")
    if controller.sync == "handshake" and len(arms) > 1:
        text = f"with two controllers (handshake) a {kind} is not supported yet; use one (sync: multimove)"
        report("unit", text, "problem.turntable")
    if any(arm.linear_axes for arm in arms):
        text = f"a {kind} together with an arm on a track or gantry is not supported yet; state one of them"
        report("unit", text, "problem.turntable")
    if spec.unit.lower() in {unit.lower() for unit in controller.units[: len(arms)]}:
        text = f"the unit {spec.unit} is also that of a robot; give the {kind} its own"
        report("unit", text, "problem.duplicate_name")
    if issues or moving_arm is None:
        raise TandemError(issues)
    # the plate hangs below its centre
    centre = np.array(spec.centre_mm) * MM
    radius, height = 0.5 * spec.plate.diameter_mm * MM, spec.plate.height_mm * MM
    pose = from_parts(np.eye(3), centre - [0.0, 0.0, 0.5 * height])
    table = Turntable(
        arm=moving_arm.name,
        unit=spec.unit,
        column=spec.external_axis - 1,
        centre=centre,
        axis=np.array([0.0, 0.0, float(np.sign(axis[2]))]),
        low=low * DEG,
        high=high * DEG,
        speed=spec.speed_deg_s * DEG,
        home=round(spec.home_deg, HOME_DECIMALS) * DEG,
    )
    if isinstance(spec, PositionerFile):
        tilt = spec.tilt
        tilt_axis = RotaryAxis(
            arm=moving_arm.name,
            unit=spec.unit,
            column=tilt.external_axis - 1,
            centre=np.array(tilt.centre_mm) * MM,
            axis=np.array(tilt.axis) / float(np.linalg.norm(tilt.axis)),
            low=tilt.range_deg[0] * DEG,
            high=tilt.range_deg[1] * DEG,
            speed=tilt.speed_deg_s * DEG,
            home=round(tilt.home_deg, HOME_DECIMALS) * DEG,
            acceleration=tilt.acceleration_deg_s2 * DEG,
            axis_name="tilt",
        )
        max_acceleration = spec.acceleration_deg_s2 * DEG
        table = dataclasses.replace(
            table,
            acceleration=max_acceleration,
            axis_name="turn",
            tilt=tilt_axis,
            bracket=tilt.bracket,
            load=spec.load_kg,
        )
    return table, (Obstacle(TURNTABLE_BODY, (Shape("cylinder", (radius, height), pose),)),)


def turntable_faults(problem: Problem) -> list[Issue]:
    """Return the faults of the stock on the turntable or positioner (``problem.turntable``)."""
    table = problem.cell.turntable
    if table is None:
        return []
    from planner.cell import support  # lazy: other problems are read without the cell model

    out = []
    kind = table.kind

    def report(text: str, field: str) -> None:
        out.append(Issue("problem.turntable", text, field=field))

    if all(table.arm not in operation.arms for operation in problem.operations):
        report(
            f"the program of arm {table.arm} moves the {kind} {table.unit}, but the arm has no program, as "
            f"it works in no operation; name another arm ({kind}: arm)",
            f"cell.{kind}.arm",
        )
    for number, operation in enumerate(problem.operations if table.tilt is not None else ()):
        if not allows_any_attitude(operation):
            text = (
                f"operation {operation.name}: {operation.process} depends on the direction of gravity in the "
                "block, which a positioner changes; milling and targets allow it; use a turntable "
            )
            report(f"{text}(cell: turntable) for the others", f"operations.{number}")
    for number, change in problem.changes.items() if table.tilt is not None else ():
        if set(change.stock) & {"place", "support"}:
            text = "the block would be clamped again on a plate that may be tilted then; make it two "
            report(
                f"{text}problems, each of which begins and ends with the plate level",
                f"operations.{number}.setup",
            )
    floor = support.SupportGround.of(problem.cell).floor
    (plate,) = next(body.shapes for body in problem.cell.obstacles if body.name == TURNTABLE_BODY)
    low = float(plate.pose[2, 3]) - 0.5 * plate.size[1]
    if low < floor - MM:
        top_mm, height_mm = (table.centre[2] - floor) / MM, plate.size[1] / MM
        text = f"the plate's top is {top_mm:g} mm above the floor and the plate {height_mm:g} mm high, so it "
        text += f"extends {(floor - low) / MM:g} mm into the floor; make it lower, or centre_mm higher"
        report(text, f"cell.{kind}.plate.height_mm")
    # only the first setup with a fault is reported
    for setup in (original.with_zero_tilt for original in problem.setups):
        stock, first = setup.stock, setup.operations[0]
        field = "stock" if first == 0 else f"operations.{first}.setup"
        if stock.sheet is not None:
            report(f"a clamped sheet on a {kind} is not supported yet; remove the {kind}", "sheet")
        elif stock.held_by is not None:
            report(f"a block that an arm holds does not turn; remove the {kind} from the cell", field)
        elif stock.place is None:
            text = f"the block is on a {kind} and its place is searched; both together are not supported "
            report(f"{text}yet; state stock.place", f"{field}.place")
        elif stock.pedestal is not None:
            text = f"a {stock.pedestal.kind} that Tandem designs reaches to the floor and does not turn; "
            report(f"{text}state the shapes on the plate as support, or none", f"{field}.support")
        else:
            gap, name = support.bearing_body(setup.cell, stock, stock.place)
            if name == TURNTABLE_BODY and abs(gap) <= support.MAX_FOOT_HEIGHT_M:
                continue
            body_text = (
                "the plate" if name == TURNTABLE_BODY else f"{name or 'the floor'}, which does not turn"
            )
            text = f"the block is not on the {kind}: its lowest point, or that of its support, is "
            text += (
                f"{gap / MM:.0f} mm above {body_text}; allowed: {support.MAX_FOOT_HEIGHT_M / MM:g} mm "
                "above the "
            )
            centre_text = ", ".join(f"{v / MM:g}" for v in table.centre)
            report(f"{text}plate, whose top is at [{centre_text}] mm; put the block on it", f"{field}.place")
        break
    for setup in problem.setups:
        mass = setup.stock.mass
        if mass is not None and table.load is not None and mass > table.load:
            text = f"the block weighs {mass:.1f} kg, but the {kind} {table.unit} carries {table.load:g} kg; "
            report(f"{text}use a smaller block or a larger {kind}", f"cell.{kind}.load_kg")
            break
    moving_arm = next(arm for arm in problem.cell.arms if arm.name == table.arm)
    if not out and moving_arm.data.family == "KUKA":
        out += _min_speed_issues(problem, table)
    return out


def _min_speed_issues(problem: Problem, table: Turntable) -> list[Issue]:
    """Return an issue for each axis that, at KRL's minimum speed, moves the stock too fast near people.

    The limit is ``MAX_BLIND_SPEED_M_S``. The tilt axis is checked at all values of the turntable.
    """
    from planner.cell import external_axis_motion

    count = int(np.ceil((table.high - table.low) / ROTATION_STEP_RAD)) + 1
    out = []
    for name, axis in table.axes.items():
        radius = 0.0
        is_tilt = axis is table.tilt
        for setup in (original.with_zero_tilt for original in problem.setups):
            axis_values = setup.stock.axis_values
            for rotation in (
                np.linspace(table.low, table.high, count) if is_tilt else (axis_values.get(STOCK_AXIS, 0.0),)
            ):
                if setup.stock.place is not None:
                    pose = table.move_pose(
                        setup.stock.place, {**axis_values, STOCK_AXIS: float(rotation)}, axis_values
                    )
                    radius = max(radius, external_axis_motion.carried_radius(setup, pose, table, name))
        radius *= SAMPLING_FACTOR if is_tilt else 1.0
        if MIN_KRL_SPEED_FRACTION * axis.speed * radius <= MAX_BLIND_SPEED_M_S:
            continue
        max_speed = np.floor(MAX_BLIND_SPEED_M_S / (MIN_KRL_SPEED_FRACTION * radius) / DEG)
        message = f"the load of {axis.label} extends {radius / MM:.0f} mm from its axis. A KUKA "
        message += (
            f"controller turns it at {MIN_KRL_SPEED_FRACTION * axis.speed / DEG:g} deg/s at least, one "
            f"percent of its maximum, which exceeds {MAX_BLIND_SPEED_M_S / MM:g} mm/s there; set its speed "
            f"to {max_speed:.0f} deg/s or less in "
        )
        field = f"cell.{table.kind}.{'tilt.' if is_tilt else ''}speed_deg_s"
        out.append(Issue("problem.turntable", f"{message}the machine data", field=field))
    return out
