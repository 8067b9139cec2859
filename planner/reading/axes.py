"""Axes under the block in a cell file: a turntable or a tilt-turn positioner, with what cannot be one told.
Those under an arm are in :mod:`planner.reading.rails`. Turntables that turn while an arm works are not
written yet."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from pydantic import Field

from planner.geometry.arrays import Shape, from_parts
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError
from planner.problem import (
    AXES_WRITTEN,
    BLIND_SPEED,
    PLATE,
    STOCK,
    Arm,
    Controller,
    Obstacle,
    Problem,
    RotaryAxis,
    Turntable,
    any_lean,
)
from planner.reading.rails import LEAST_AXIS, UNIT
from planner.reading.strict_yaml import Name, Positive, Strict, Vector

UPRIGHT: Final = 1e-9
"""Axes whose unit vectors are off the vertical by no more stand upright."""
LEAST_SHARE: Final = 0.01
"""Least speed of an external axis in KRL, as a share of its own: $VEL_EXTAX takes whole percents."""
MOST_KRL_TURN: Final = 358.0
"""Farthest [deg] to either side that a KUKA controller lets a rotary axis go: software limits of one that is
not infinite ($AXIS_TYPE 3; KR C2, machine data, 2.1.4)."""
TURN_STEP: Final = 5.0 * DEG
"""Turns are so far apart [rad] at which it is seen how far the block reaches from the tilt axis,"""
BETWEEN: Final = 1.002
"""and between them it reaches farther by this factor at most."""
HOME_DECIMALS: Final = 4
"""Decimals [deg] of where a turntable stands at home, as programs write it."""


class TurntablePlateFile(Strict):
    """The plate of a turntable, a cylinder under its centre."""

    diameter_mm: Positive
    height_mm: Positive = Field(description="from its top down to the floor or to what bears it")


class TurntableFile(Strict):
    """A turntable under the block, that turns it from station to station between operations; `place` of the
    block is that of value 0."""

    unit: Name = Field(description=UNIT)
    arm: Name | None = Field(default=None, description="whose program moves it; none: the first arm")
    external_axis: int = Field(
        default=1, ge=1, le=6, description="which of the targets' external axes it is: 1 is eax_a or E1"
    )
    centre_mm: Vector = Field(description="middle of the plate's top, in the world")
    axis: Vector = Field(
        default=(0.0, 0.0, 1.0),
        description="growing values turn by the right hand about it: straight up or down",
    )
    range_deg: tuple[float, float] = Field(description="least and largest value")
    speed_deg_s: float = Field(ge=0.1, le=720, description="its highest")
    home_deg: float = Field(default=0.0, description="where it stands before a program begins")
    plate: TurntablePlateFile


class TiltFile(Strict):
    """The tilt axis of a positioner, fixed in the world: it tilts the turn axis, the plate and the bracket.
    With value 0 the plate lies flat."""

    external_axis: int = Field(
        default=1, ge=1, le=6, description="which of the targets' external axes it is: 1 is eax_a or E1"
    )
    centre_mm: Vector = Field(description="any point of it, in the world; it need not meet the turn axis")
    axis: Vector = Field(description="growing values tilt by the right hand about it; any but upright")
    range_deg: tuple[float, float] = Field(description="least and largest value, with 0 in it")
    speed_deg_s: float = Field(ge=0.1, le=720, description="its highest")
    acceleration_deg_s2: float = Field(ge=0.1, le=10_000, description="its highest")
    home_deg: float = Field(default=0.0, description="where it stands before a program begins")
    bracket: tuple[Name, ...] = Field(
        default=(), max_length=20, description="bodies of `obstacles`, where they are at 0, that it tilts"
    )


class PositionerFile(TurntableFile):
    """A tilt-turn positioner under the block: a turntable on a tilt axis, two axes of one mechanical unit,
    which take the block from station to station between operations. `place` of the block is that of both
    values 0."""

    external_axis: int = Field(
        default=2, ge=1, le=6, description="of the turn axis among the targets' external axes"
    )
    acceleration_deg_s2: float = Field(ge=0.1, le=10_000, description="highest of the turn axis")
    load_kg: Positive | None = Field(default=None, description="the most that it carries")
    tilt: TiltFile


MOST_TURNS: Final = 3600.0
"""Largest value of a turntable [deg], ten turns: beyond, a figure is taken for a mistake."""
LEAST_SLANT: Final = np.sin(5.0 * DEG)
"""Sine of the least angle between a tilt axis and the vertical."""


def _range_faults(spec: TurntableFile | TiltFile) -> list[tuple[str, str]]:
    """What is wrong with range and home of an axis, by field."""
    low, high = spec.range_deg
    out = []
    if not low < high:
        what = f"it goes from {low:g} to {high:g}; give the least value first, then a larger one"
        out.append(("range_deg", what))
    elif not low <= spec.home_deg <= high:
        out.append(("home_deg", f"{spec.home_deg:g} is outside the range of {low:g} to {high:g}"))
    if not max(abs(low), abs(high)) <= MOST_TURNS:
        out.append(("range_deg", f"got {low:g} to {high:g}; allowed: up to {MOST_TURNS:g} either way"))
    return out


def _tilt_faults(spec: PositionerFile, bodies: Sequence[str]) -> list[tuple[str, str]]:
    """What is wrong with the tilt axis of a positioner, by field; ``bodies``: names of obstacles."""
    tilt = spec.tilt
    out = _range_faults(tilt)
    low, high = tilt.range_deg
    length = float(np.linalg.norm(tilt.axis))
    if not length > LEAST_AXIS:
        out.append(("axis", "its length is 0; give its direction, such as [0, 1, 0]"))
    elif float(np.hypot(tilt.axis[0], tilt.axis[1])) < LEAST_SLANT * length:
        what = (
            "it is upright, as the turn axis is, within 5 degrees; give the axis that tilts the plate, such "
        )
        out.append(("axis", what + "as [0, 1, 0]"))
    if low < high and not low <= 0.0 <= high:
        what = f"0, where the plate lies flat, is outside of {low:g} to {high:g}; count the values from there"
        out.append(("range_deg", what))
    elif low <= tilt.home_deg <= high and tilt.home_deg != 0.0:
        what = (
            f"got {tilt.home_deg:g}; the block is clamped and taken off there, so the plate is to lie flat: 0"
        )
        out.append(("home_deg", what))
    if max(abs(low), abs(high)) > 180.0:
        out.append(("range_deg", f"got {low:g} to {high:g}; allowed: up to 180 either way"))
    if tilt.external_axis == spec.external_axis:
        letter = "abcdef"[tilt.external_axis - 1]
        what = f"it is {tilt.external_axis} (eax_{letter}, E{tilt.external_axis}), as that of the turn axis; "
        what += "each axis has its own"
        out.append(("external_axis", what))
    for name in tilt.bracket:
        if name not in bodies:
            what = f"{name!r} is no body of the cell's obstacles; they are {', '.join(bodies) or 'none'}"
            out.append(("bracket", what))
    return [(f"tilt.{name}", what) for name, what in out]


def turntable(
    spec: TurntableFile | None, arms: Sequence[Arm], controller: Controller, bodies: Sequence[str] = ()
) -> tuple[Turntable | None, tuple[Obstacle, ...]]:
    """The turntable or positioner of a cell in SI units and its plate as a body of the cell; ``bodies``:
    names of its obstacles. Raises ``TandemError`` (``problem.field``, ``problem.unknown_arm``,
    ``problem.duplicate_name``, ``problem.turntable``) with all that is wrong."""
    if spec is None:
        return None, ()
    wrong = list[Issue]()
    kind = "positioner" if isinstance(spec, PositionerFile) else "turntable"

    def told(name: str, what: str, code: str = "problem.field") -> None:
        wrong.append(Issue(code, f"{name}: {what}", field=f"{kind}.{name}"))

    low, high = spec.range_deg
    length = float(np.linalg.norm(spec.axis))
    axis = np.array(spec.axis) / max(length, LEAST_AXIS)
    if not length > LEAST_AXIS:
        told("axis", "its length is 0; give [0, 0, 1], or [0, 0, -1] where values grow the other way round")
    elif float(np.hypot(axis[0], axis[1])) > UPRIGHT:
        what = "it leans; allowed: [0, 0, 1] and [0, 0, -1]"
        if kind == "turntable":
            what += "; what tilts the block as well is a positioner (positioner: tilt)"
        told("axis", what, "problem.turntable")
    faults = _range_faults(spec)
    if isinstance(spec, PositionerFile):
        faults += _tilt_faults(spec, bodies)
    for name, what in faults:
        told(name, what)
    names = {arm.name: arm for arm in arms}
    mover = names.get(arms[0].name if spec.arm is None else spec.arm)
    if mover is None:
        what = f"{spec.arm!r} is not an arm of the cell; it has {', '.join(names)}"
        told("arm", what, "problem.unknown_arm")
    elif any(arm.data.family not in AXES_WRITTEN for arm in arms):
        other = next(arm for arm in arms if arm.data.family not in AXES_WRITTEN)
        what = f"arm {other.name} is of {other.data.family}; {kind}s are written for "
        what += f"{' and '.join(AXES_WRITTEN)} controllers alone; take the {kind} out, or take such arms"
        told("arm", what, "problem.turntable")
    elif mover.data.family == "KUKA" and low < high and max(-low, high) > MOST_KRL_TURN:
        what = f"got {low:g} to {high:g}; a KUKA controller has software limits of rotary axes up to "
        told("range_deg", f"{what}{MOST_KRL_TURN:g} either way; give a range within, as [-180, 180]")
    if controller.sync == "handshake" and len(arms) > 1:
        what = f"with two controllers (handshake) a {kind} is not written yet; use one (sync: multimove)"
        told("unit", what, "problem.turntable")
    if any(arm.axes for arm in arms):
        what = f"a {kind} together with an arm on a track or gantry is not written yet; state one of them"
        told("unit", what, "problem.turntable")
    if spec.unit.lower() in {unit.lower() for unit in controller.units[: len(arms)]}:
        what = f"the unit {spec.unit} is that of a robot, too; give the {kind} its own"
        told("unit", what, "problem.duplicate_name")
    if wrong or mover is None:
        raise TandemError(wrong)
    centre = np.array(spec.centre_mm) * MM
    radius, height = 0.5 * spec.plate.diameter_mm * MM, spec.plate.height_mm * MM
    pose = from_parts(np.eye(3), centre - [0.0, 0.0, 0.5 * height])
    made = Turntable(
        arm=mover.name,
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
        slant = RotaryAxis(
            arm=mover.name,
            unit=spec.unit,
            column=tilt.external_axis - 1,
            centre=np.array(tilt.centre_mm) * MM,
            axis=np.array(tilt.axis) / float(np.linalg.norm(tilt.axis)),
            low=tilt.range_deg[0] * DEG,
            high=tilt.range_deg[1] * DEG,
            speed=tilt.speed_deg_s * DEG,
            home=round(tilt.home_deg, HOME_DECIMALS) * DEG,
            acceleration=tilt.acceleration_deg_s2 * DEG,
            word="tilt",
        )
        most = spec.acceleration_deg_s2 * DEG
        made = dataclasses.replace(
            made, acceleration=most, word="turn", tilt=slant, bracket=tilt.bracket, load=spec.load_kg
        )
    return made, (Obstacle(PLATE, (Shape("cylinder", (radius, height), pose),)),)


def turntable_faults(problem: Problem) -> list[Issue]:
    """What speaks against the block of a problem on the turntable or positioner of its cell
    (``problem.turntable``)."""
    table = problem.cell.turntable
    if table is None:
        return []
    from planner.cell import support  # what reads a problem without a turntable loads nothing of the cell

    out = []
    kind = table.kind

    def told(what: str, field: str) -> None:
        out.append(Issue("problem.turntable", what, field=field))

    if all(table.arm not in operation.arms for operation in problem.operations):
        told(
            f"the {kind} {table.unit} is moved by the program of arm {table.arm}, which has none, as it "
            f"works in no operation; name another one ({kind}: arm)",
            f"cell.{kind}.arm",
        )
    for number, operation in enumerate(problem.operations if table.tilt is not None else ()):
        if not any_lean(operation):
            what = f"operation {operation.name}: {operation.process} counts on how its block lies to "
            what += "gravity, which a positioner tilts; milling and targets take a tilted block; take a "
            what += "turntable "
            told(f"{what}(cell: turntable) for the others", f"operations.{number}")
    for number, change in problem.changes.items() if table.tilt is not None else ():
        if set(change.stock) & {"place", "support"}:
            what = "the block would be unclamped and clamped anew on a plate that may lean then; make it two "
            told(
                f"{what}problems, each of which begins and ends with the plate flat",
                f"operations.{number}.setup",
            )
    floor = support.Ground.of(problem.cell).floor
    (plate,) = next(body.shapes for body in problem.cell.obstacles if body.name == PLATE)
    low = float(plate.pose[2, 3]) - 0.5 * plate.size[1]
    if low < floor - MM:
        above, high = (table.centre[2] - floor) / MM, plate.size[1] / MM
        what = f"the plate's top is {above:g} mm above the floor and the plate {high:g} mm high, so it goes "
        what += f"{(floor - low) / MM:g} mm into the floor; make it less high, or centre_mm higher"
        told(what, f"cell.{kind}.plate.height_mm")
    for setup in (one.upright for one in problem.setups):
        stock, first = setup.stock, setup.operations[0]
        field = "stock" if first == 0 else f"operations.{first}.setup"
        if stock.sheet is not None:
            told(f"a clamped sheet on a {kind} is not written yet; take the {kind} out", "sheet")
        elif stock.held_by is not None:
            told(f"a block that an arm holds does not turn; take the {kind} out of the cell", field)
        elif stock.place is None:
            what = f"the block stands on a {kind} and its place is searched; both together are not written "
            told(f"{what}yet; state stock.place", f"{field}.place")
        elif stock.pedestal is not None:
            what = f"a {stock.pedestal.kind} that is made reaches to the floor and does not turn; state the "
            told(f"{what}shapes that stand on the plate as support, or none", f"{field}.support")
        else:
            gap, name = support.bearer(setup.cell, stock, stock.place)
            if name == PLATE and abs(gap) <= support.FOOT_HEIGHT:
                continue
            under = "the plate" if name == PLATE else f"{name or 'the floor'}, which does not turn"
            what = f"the block does not stand on the {kind}: what is lowest of it and its support is "
            what += f"{gap / MM:.0f} mm above {under}; allowed are {support.FOOT_HEIGHT / MM:g} mm above the "
            at = ", ".join(f"{v / MM:g}" for v in table.centre)
            told(f"{what}plate, whose top is at [{at}] mm; put the block on it", f"{field}.place")
        break
    for setup in problem.setups:
        mass = setup.stock.mass
        if mass is not None and table.load is not None and mass > table.load:
            what = f"the block weighs {mass:.1f} kg, and the {kind} {table.unit} carries {table.load:g} kg; "
            told(f"{what}take a smaller block, or a {kind} for it", f"cell.{kind}.load_kg")
            break
    mover = next(arm for arm in problem.cell.arms if arm.name == table.arm)
    if not out and mover.data.family == "KUKA":
        out += _fast(problem, table)
    return out


def _fast(problem: Problem, table: Turntable) -> list[Issue]:
    """Axes under the block that at the least speed of KRL take what they carry faster than people may be
    near; the tilt axis at any turn."""
    from planner.cell import axis_way

    count = int(np.ceil((table.high - table.low) / TURN_STEP)) + 1
    out = []
    for name, axis in table.axes.items():
        rim, tilts = 0.0, axis is table.tilt
        for setup in (one.upright for one in problem.setups):
            here = setup.stock.stands
            for turn in np.linspace(table.low, table.high, count) if tilts else (here.get(STOCK, 0.0),):
                if setup.stock.place is not None:
                    place = table.placed(setup.stock.place, {**here, STOCK: float(turn)}, here)
                    rim = max(rim, axis_way.rim(setup, place, table, name))
        rim *= BETWEEN if tilts else 1.0
        if LEAST_SHARE * axis.speed * rim <= BLIND_SPEED:
            continue
        most = np.floor(BLIND_SPEED / (LEAST_SHARE * rim) / DEG)
        what = f"what {axis.label} takes along reaches {rim / MM:.0f} mm from its axis, and a KUKA "
        what += f"controller turns it at {LEAST_SHARE * axis.speed / DEG:g} deg/s at least, one percent of "
        what += f"its own, faster there than {BLIND_SPEED / MM:g} mm/s; make its own speed {most:.0f} deg/s "
        what += "or less in "
        field = f"cell.{table.kind}.{'tilt.' if tilts else ''}speed_deg_s"
        out.append(Issue("problem.turntable", f"{what}the machine data", field=field))
    return out
