"""Linear axes under an arm in a cell file, a track or the axes of a gantry: schema, conversion and faults."""

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
from pydantic import Field

from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, issue_error
from planner.problem import EXTERNAL_AXIS_FAMILIES, Arm, Controller, LinearAxis, Problem, allows_moving_base
from planner.reading.strict_yaml import Name, Strict, Vector

MIN_AXIS_LENGTH: Final = 1e-9
"""Minimum length of a vector that has a direction."""
MIN_TRACK_RANGE_MM: Final = 50.0
"""Minimum range [mm] of a linear axis. Chosen: a shorter one is probably stated in metres."""
MAX_TRACK_VALUE_MM: Final = 100_000.0
"""Maximum absolute value [mm] of a linear axis."""
MIN_RATE_MM: Final = 1.0
"""Minimum speed and acceleration [mm/s, mm/s^2] of an axis; with less its motions would take hours."""
MIN_AXIS_ANGLE_RAD: Final = 5.0 * DEG
"""Minimum angle [rad] between two axes of a gantry, and of one to the plane of two others."""
MAX_KRL_LABEL_LENGTH: Final = 27
"""Maximum number of characters of unit and axis name together that fits a KRL message."""
UNIT_DESCRIPTION: Final = (
    "its name: of the mechanical unit (`MECHANICAL_UNIT` in MOC.cfg), or in KUKA's `MACHINE_DEF`"
)


class LinearAxisFile(Strict):
    """Keys of a track and of an axis of a gantry."""

    axis: Vector = Field(description="direction of growing values in the world, any length")
    range_mm: tuple[float, float] = Field(description="minimum and maximum")
    unit: Name = Field(description=UNIT_DESCRIPTION)
    speed_mm_s: float = Field(le=5000, description="maximum")
    acceleration_mm_s2: float = Field(le=50_000, description="maximum")
    home_mm: float = Field(default=0.0, description="value before a program starts")
    carries: tuple[Name, ...] = Field(
        default=(), max_length=20, description="bodies of `obstacles` mounted on it, placed at value 0"
    )


class TrackFile(LinearAxisFile):
    """A linear track under an arm.

    It moves the arm from station to station between operations, or follows while the arm works.
    """

    follow: float | None = Field(
        default=None,
        gt=0.0,
        le=1.0,
        description="fraction of the tool's motion along it that it follows while the arm works, within "
        "its range; none: it stands still then",
    )


class GantryAxisFile(LinearAxisFile):
    """One axis of a gantry. It carries the axes above it, and what they carry."""

    name: Name = Field(description="name, such as `bridge`")
    external_axis: int | None = Field(
        default=None,
        ge=1,
        le=6,
        description="number of the external axis: 1 is eax_a or E1; none: its position from the floor up",
    )


GANTRY_FAULT: Final = (
    "an arm on two or three linear axes is stated with the key axes",
    "axes: [{name: bridge, axis: [1, 0, 0], range_mm: ..., unit: ..., carries: [...]}, ...], from "
    "the floor up",
)
"""Fault and remedy for linear axes that carry one another and are not stated as axes."""
GANTRY_FOLLOW_FAULT: Final = (
    "the axes of a gantry stand still while the arm works; coordinated motion is not supported yet",
    "remove follow and split the work into operations, each with its own station; only a "
    "track "
    "(track: follow) moves while the arm works",
)
"""Fault and remedy for axes of a gantry that are to move while the arm works."""
_MISNAMED_KEYS: Final = ("gantry", "tracks", "rails", "linear_axes")
"""Unknown keys of an arm under which users may state linear axes."""


def linear_axes_fault(location: Sequence[str | int], value: object) -> tuple[str, str] | None:
    """Return fault and remedy if an invalid key of an arm states several linear axes, or coordinated ones.

    None for all other keys.

    Args:
        location: Path of the key in the document.
        value: Invalid value.
    """
    key = str(location[-1]) if location else ""
    if tuple(location[-3:-2]) == ("arms",) and (
        key in _MISNAMED_KEYS or (key == "track" and isinstance(value, list))
    ):
        return GANTRY_FAULT
    if key == "follow" and len(location) > 4 and location[-3] == "axes" and location[-5] == "arms":
        return GANTRY_FOLLOW_FAULT
    return None


def build_linear_axes(
    track: TrackFile | None,
    axes: Sequence[GantryAxisFile] | None,
    arm: Arm,
    number: int,
    bodies: Sequence[str],
) -> tuple[LinearAxis, ...]:
    """Convert the axes under an arm to SI units, from the floor up.

    Args:
        track: Track, or None.
        axes: Axes of a gantry, or None.
        arm: Arm without its axes.
        number: Index of the arm in the cell.
        bodies: Names of the obstacles of the cell.

    Raises:
        TandemError: ``problem.field``, ``problem.duplicate_name`` or ``problem.track``, with all faults.
    """
    specs: list[tuple[str, TrackFile | GantryAxisFile]] = [] if track is None else [("track", track)]
    specs += [(f"axes.{k}", axis) for k, axis in enumerate(axes or ())]
    if not specs:
        return ()
    arm_field = f"arms.{number}"
    issues: list[Issue] = []
    if track is not None and axes:
        text = f"arm {arm.name} has a track and axes; state all of them as axes, from the floor up"
        issues.append(Issue("problem.field", text, field=f"{arm_field}.track", arm=arm.name))
    for name, spec in specs:
        faults = (*_axis_faults(spec), *_carried_body_faults(spec, bodies))
        for key, text in faults:
            issues.append(
                Issue("problem.field", f"{key}: {text}", field=f"{arm_field}.{name}.{key}", arm=arm.name)
            )
    if axes:
        issues += [
            Issue(code, text, field=f"{arm_field}.{field}", arm=arm.name)
            for code, field, text in (*_duplicate_axis_faults(axes, arm), *_dependent_axis_faults(axes))
        ]
    kind = "track" if track is not None else "gantry"
    if arm.data.family not in EXTERNAL_AXIS_FAMILIES:
        text = f"arm {arm.name} is of {arm.data.family}; tracks and gantries are only supported for "
        text += (
            f"{' and '.join(EXTERNAL_AXIS_FAMILIES)} controllers; remove the {kind} and move the base, or "
        )
        text += "use such an arm"
        issues.append(Issue("problem.track", text, field=f"{arm_field}.{specs[0][0]}", arm=arm.name))
    if track is not None and track.follow is not None and arm.sag is not None:
        text = f"arm {arm.name} has a coordinated track and sag compensation; both together are not "
        text += "supported yet; remove follow or compensate_sag"
        issues.append(Issue("problem.track", text, field=f"{arm_field}.track.follow", arm=arm.name))
    if track is not None and track.follow is not None and track.carries:
        text = f"the coordinated track of arm {arm.name} carries bodies; "
        text += "this is not supported yet; remove follow or carries"
        issues.append(Issue("problem.track", text, field=f"{arm_field}.track.carries", arm=arm.name))
    if arm.base_auto:
        text = f"arm {arm.name} is on a {kind}, whose pose is not searched; state its base"
        issues.append(Issue("problem.track", text, field=f"{arm_field}.base_auto", arm=arm.name))
    if issues:
        raise TandemError(issues)
    return tuple(_build_axis(spec, column) for column, (_, spec) in enumerate(specs))


def _build_axis(spec: TrackFile | GantryAxisFile, column: int) -> LinearAxis:
    """Convert one axis. ``column`` is its index from the floor up, unless it states its external axis."""
    follow = None
    axis_name = ""
    if isinstance(spec, TrackFile):
        follow = spec.follow
    else:
        axis_name = spec.name
        if spec.external_axis is not None:
            column = spec.external_axis - 1
    return LinearAxis(
        np.array(spec.axis) / float(np.linalg.norm(spec.axis)),
        spec.range_mm[0] * MM,
        spec.range_mm[1] * MM,
        spec.speed_mm_s * MM,
        spec.acceleration_mm_s2 * MM,
        spec.unit,
        spec.home_mm * MM,
        follow,
        column,
        axis_name,
        spec.carries,
    )


def _axis_faults(spec: LinearAxisFile) -> list[tuple[str, str]]:
    """Return faults of the direction, range, home and rates of an axis, as (key, message)."""
    out = []
    low, high = spec.range_mm
    if not float(np.linalg.norm(spec.axis)) > MIN_AXIS_LENGTH:
        out.append(("axis", "its length is 0; give the direction of growing values, such as [0, 1, 0]"))
    if not low < high:
        text = f"got {low:g} to {high:g}; give the lower value first, then a larger one"
        out.append(("range_mm", text))
    elif high - low < MIN_TRACK_RANGE_MM:
        text = f"got {low:g} to {high:g} mm, but the minimum range of a track is {MIN_TRACK_RANGE_MM:g} mm; "
        out.append(("range_mm", f"{text}values are mm: 3 m are 3000"))
    elif max(-low, high) > MAX_TRACK_VALUE_MM:
        text = f"got {low:g} to {high:g} mm; allowed are values up to {MAX_TRACK_VALUE_MM:g} mm either way; "
        out.append(("range_mm", f"{text}put 0 near the work, and make the range no longer than required"))
    elif not low <= spec.home_mm <= high:
        out.append(("home_mm", f"{spec.home_mm:g} is outside the range of {low:g} to {high:g}"))
    for name, value in (("speed_mm_s", spec.speed_mm_s), ("acceleration_mm_s2", spec.acceleration_mm_s2)):
        if not value >= MIN_RATE_MM:
            out.append(
                (name, f"got {value:g}; allowed: {MIN_RATE_MM:g} at least; values are mm: 1 m is 1000")
            )
    return out


def _carried_body_faults(spec: LinearAxisFile, bodies: Sequence[str]) -> list[tuple[str, str]]:
    """Return faults of the bodies that an axis carries, as (key, message)."""
    out = []
    for name in dict.fromkeys(spec.carries):
        if name not in bodies:
            message = f"{name!r} is not an obstacle of the cell; obstacles are {', '.join(bodies) or 'none'}"
            out.append(("carries", message))
        elif spec.carries.count(name) > 1:
            out.append(("carries", f"{name!r} is listed twice; name each body once"))
    return out


def _duplicate_axis_faults(axes: Sequence[GantryAxisFile], arm: Arm) -> list[tuple[str, str, str]]:
    """Return faults of gantry axes that cannot be distinguished: code, field, message."""
    out = []
    columns = [k if axis.external_axis is None else axis.external_axis - 1 for k, axis in enumerate(axes)]
    for k, axis in enumerate(axes):
        previous_names = [previous.name.lower() for previous in axes[:k]]
        if axis.name.lower() in previous_names:
            message = f"two axes of arm {arm.name} are called {axis.name}; give each its own name"
            out.append(("problem.duplicate_name", f"axes.{k}.name", message))
        if columns[k] in columns[:k]:
            letter = "abcdef"[columns[k]]
            message = f"external_axis: it is {columns[k] + 1} (eax_{letter}, E{columns[k] + 1}), as for "
            message += f"axis {axes[columns.index(columns[k])].name}; give each axis its own"
            out.append(("problem.field", f"axes.{k}.external_axis", message))
        if arm.data.family != "KUKA":
            continue
        if axis.unit.lower() != axes[0].unit.lower():
            message = (
                "unit: a KUKA controller has all axes under an arm in one kinematic (#ERSYS) with one name; "
            )
            message += f"got {axes[0].unit} and {axis.unit}; give all of them the same"
            out.append(("problem.field", f"axes.{k}.unit", message))
        if len(f"{axis.unit} {axis.name}") > MAX_KRL_LABEL_LENGTH:
            message = f"name: {axis.unit} and {axis.name} are too long for a KUKA controller's "
            message += f"messages; give names of {MAX_KRL_LABEL_LENGTH - 1} characters together at most"
            out.append(("problem.field", f"axes.{k}.name", message))
    return out


def _dependent_axis_faults(axes: Sequence[GantryAxisFile]) -> list[tuple[str, str, str]]:
    """Return faults of linearly dependent directions: code, field, message."""
    directions = [
        np.array(axis.axis) / max(float(np.linalg.norm(axis.axis)), MIN_AXIS_LENGTH) for axis in axes
    ]
    if any(float(np.linalg.norm(direction)) < 0.5 for direction in directions):
        return []  # already reported
    for j, k in itertools.combinations(range(len(axes)), 2):
        angle = float(np.arcsin(min(1.0, float(np.linalg.norm(np.cross(directions[j], directions[k]))))))
        if angle < MIN_AXIS_ANGLE_RAD:
            text = (
                f"axis: {axes[k].name} is nearly parallel to {axes[j].name}, {np.rad2deg(angle):.3g} degrees "
                f"off; allowed are {np.rad2deg(MIN_AXIS_ANGLE_RAD):g} at least; state two such axes as one"
            )
            return [("problem.field", f"axes.{k}.axis", text)]
    if len(directions) == 3:
        normal = np.cross(directions[0], directions[1])
        angle = float(np.arcsin(abs(directions[2] @ normal) / float(np.linalg.norm(normal))))
        if angle < MIN_AXIS_ANGLE_RAD:
            text = f"axis: {axes[2].name} is nearly in the plane of {axes[0].name} and {axes[1].name}, "
            text += f"{np.rad2deg(angle):.3g} degrees off; allowed are {np.rad2deg(MIN_AXIS_ANGLE_RAD):g} at "
            text += "least; leave one of them out"
            return [("problem.field", "axes.2.axis", text)]
    return []


def check_units(arms: Sequence[Arm], controller: Controller) -> None:
    """Check that units of a controller have unique names and that no body is carried by two axes.

    Raises:
        TandemError: ``problem.duplicate_name``, ``problem.field``.
    """
    robots = {name.lower(): f"the robot {name}" for name in controller.units[: len(arms)]}
    owner_by_unit = dict(robots)
    carrying_axis: dict[str, str] = {}
    for number, arm in enumerate(arms):
        kind = "track" if arm.track is not None else "gantry"
        if controller.sync == "handshake":  # each arm has its own controller
            name = controller.units[number]
            owner_by_unit = {name.lower(): robots[name.lower()]}
        arm_units: dict[str, str] = {}
        for axis_index, rail in enumerate(arm.linear_axes):
            field = f"arms.{number}.{'track' if arm.track is not None else f'axes.{axis_index}'}"
            if rail.unit.lower() in owner_by_unit:
                text = f"the unit {rail.unit} is also that of {owner_by_unit[rail.unit.lower()]}; give each "
                text += f"{kind} its own"
                raise issue_error("problem.duplicate_name", text, field=f"{field}.unit", arm=arm.name)
            arm_units[rail.unit.lower()] = f"arm {arm.name}"
            for body in rail.carries:
                if body in carrying_axis:
                    text = (
                        f"carries: {body} is mounted on {carrying_axis[body]} and on {rail.label}; name it "
                    )
                    text += "at one axis, because axes above an axis move with it"
                    raise issue_error("problem.field", text, field=f"{field}.carries", arm=arm.name)
                carrying_axis[body] = rail.label
        owner_by_unit |= arm_units


def carrying_faults(problem: Problem) -> list[Issue]:
    """Return faults of axes that would move the support of the block (``problem.track``)."""
    carrying_axis = {
        body: axis for arm in problem.cell.arms for axis in arm.linear_axes for body in axis.carries
    }
    if not carrying_axis:
        return []
    from planner.cell import support  # lazy: other problems are read without the cell model

    for setup in problem.setups:
        stock = setup.stock
        if stock.held_by is not None or stock.place is None:
            continue
        gap, name = support.bearing_body(setup.cell, stock, stock.place)
        if name in carrying_axis and abs(gap) <= support.MAX_FOOT_HEIGHT_M:
            text = f"the block stands on {name}, which {carrying_axis[name].label} carries; put the block on "
            text += "a body that stands still, or remove the body from carries"
            return [Issue("problem.track", text, field=f"operations.{setup.operations[0]}")]
    return []


def coordinated_track_faults(problem: Problem) -> list[Issue]:
    """Return faults of operations with a coordinated track (``problem.track``)."""
    out: list[Issue] = []
    coordinated_arms = {
        arm.name: f"cell.arms.{k}.track.follow"
        for k, arm in enumerate(problem.cell.arms)
        if arm.has_coordinated_track
    }
    for name, field in coordinated_arms.items():
        if any(setup.stock.held_by == name for setup in problem.setups):
            text = f"arm {name} holds the block, so its track cannot move while it works; remove follow"
            out.append(Issue("problem.track", text, field=field, arm=name))
    for index, operation in enumerate(problem.operations if coordinated_arms else ()):
        arms = [name for name in operation.arms if name in coordinated_arms]
        if not arms:
            continue
        if not allows_moving_base(operation):
            text = f"{operation.process} does not support a coordinated track; milling and targets do; "
            text += "remove follow from the track for other operations"
        elif len(operation.arms) > 1 and problem.cell.controller.sync == "handshake":
            text = "with two controllers (handshake) one arm may be a step ahead of the other, and the "
            text += f"proof requires fixed bases then, but {arms[0]} has a coordinated track; remove follow, "
            text += "use one controller (sync: multimove), or give each arm its own operation"
        elif len(arms) > 1:
            text = f"the tracks of {' and '.join(arms)} move while the arms work, which is not supported for "
            text += "two bases yet; remove follow from one of them, or give each arm its own operation"
        else:
            continue
        text = f"operation {operation.name}: {text}"
        out.append(Issue("problem.track", text, field=f"operations.{index}", arm=arms[0]))
    return out
