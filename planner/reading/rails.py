"""Linear axes under an arm in a cell file, a track or the axes of a gantry, with what cannot be such told."""

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
from pydantic import Field

from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, refusal
from planner.problem import AXES_WRITTEN, Arm, Controller, LinearAxis, Problem, any_base
from planner.reading.strict_yaml import Name, Strict, Vector

LEAST_AXIS: Final = 1e-9
"""Directions shorter than this have none."""
LEAST_TRACK_MM: Final = 50.0
"""Shorter ranges [mm] of linear axes are taken for metres."""
MOST_TRACK_MM: Final = 100_000.0
"""Values [mm] of linear axes are no farther from 0."""
LEAST_RATE: Final = 1.0
"""Slower axes [mm/s, mm/s^2] are none: their ways would take hours."""
LEAST_ANGLE: Final = 5.0 * DEG
"""Least angle [rad] between the directions of two axes of a gantry, and of one to the plane of two others."""
MOST_KRL_LABEL: Final = 27
"""Characters of a unit's and an axis' name, together, for which a message of KRL has room."""
UNIT: Final = "its name: of the mechanical unit (`MECHANICAL_UNIT` in MOC.cfg), or in KUKA's `MACHINE_DEF`"


class LinearAxisFile(Strict):
    """What a track and an axis of a gantry have alike."""

    axis: Vector = Field(description="direction of growing values in the world, any length")
    range_mm: tuple[float, float] = Field(description="least and largest value")
    unit: Name = Field(description=UNIT)
    speed_mm_s: float = Field(le=5000, description="its highest")
    acceleration_mm_s2: float = Field(le=50_000, description="its highest")
    home_mm: float = Field(default=0.0, description="where it stands before a program begins")
    carries: tuple[Name, ...] = Field(
        default=(), max_length=20, description="bodies of `obstacles`, where they are at 0, that stand on it"
    )


class TrackFile(LinearAxisFile):
    """A linear track under an arm, that takes it from station to station between operations, or goes along
    while the arm works."""

    follow: float | None = Field(
        default=None,
        gt=0.0,
        le=1.0,
        description="the share of the tool's way along it that it goes along while the arm works, within "
        "its range; none: it stands then",
    )


class GantryAxisFile(LinearAxisFile):
    """One axis of a gantry: it takes the axes above it along, and what they carry."""

    name: Name = Field(description="what it is called, such as `bridge`")
    external_axis: int | None = Field(
        default=None,
        ge=1,
        le=6,
        description="which of the targets' external axes it is: 1 is eax_a or E1; none: its place "
        "from the floor up",
    )


NO_GANTRY: Final = (
    "an arm on two or three linear axes is stated by its axes",
    "axes: [{name: bridge, axis: [1, 0, 0], range_mm: ..., unit: ..., carries: [...]}, ...], from "
    "the floor up",
)
"""What is said of linear axes that carry one another and are stated otherwise, and what to do."""
NO_FOLLOW: Final = (
    "the axes of a gantry stand while the arm works; that they go along is not written yet",
    "take follow out and split the work into operations, each of which has a station of its own; a "
    "track alone "
    "(track: follow) goes along",
)
"""The same of such that are to go along."""
_CHAINS: Final = ("gantry", "tracks", "rails", "linear_axes")
"""Keys of an arm under which they are looked for."""


def chained(location: Sequence[str | int], value: object) -> tuple[str, str] | None:
    """What is wrong, and what to do, where a key of an arm that is not known, or a value that is none, states
    several linear axes, or that they go along; None for all else."""
    key = str(location[-1]) if location else ""
    if tuple(location[-3:-2]) == ("arms",) and (
        key in _CHAINS or (key == "track" and isinstance(value, list))
    ):
        return NO_GANTRY
    if key == "follow" and len(location) > 4 and location[-3] == "axes" and location[-5] == "arms":
        return NO_FOLLOW
    return None


def under(
    track: TrackFile | None,
    axes: Sequence[GantryAxisFile] | None,
    arm: Arm,
    number: int,
    bodies: Sequence[str],
) -> tuple[LinearAxis, ...]:
    """The axes under arm ``number`` of a cell in SI units, from the floor up; ``bodies``: names of its
    obstacles. Raises ``TandemError`` (``problem.field``, ``problem.duplicate_name``, ``problem.track``) with
    all that is wrong."""
    stated: list[tuple[str, TrackFile | GantryAxisFile]] = [] if track is None else [("track", track)]
    stated += [(f"axes.{k}", axis) for k, axis in enumerate(axes or ())]
    if not stated:
        return ()
    place, wrong = f"arms.{number}", list[Issue]()
    if track is not None and axes:
        what = f"arm {arm.name} has a track and axes; state all of them as axes, from the floor up"
        wrong.append(Issue("problem.field", what, field=f"{place}.track", arm=arm.name))
    for name, spec in stated:
        faults = (*_faults(spec), *_carried(spec, bodies))
        for key, what in faults:
            wrong.append(
                Issue("problem.field", f"{key}: {what}", field=f"{place}.{name}.{key}", arm=arm.name)
            )
    if axes:
        wrong += [
            Issue(code, what, field=f"{place}.{field}", arm=arm.name)
            for code, field, what in (*_alike(axes, arm), *_in_one(axes))
        ]
    kind = "track" if track is not None else "gantry"
    if arm.data.family not in AXES_WRITTEN:
        what = f"arm {arm.name} is of {arm.data.family}; tracks and gantries are written for "
        what += f"{' and '.join(AXES_WRITTEN)} controllers alone; take the {kind} out and move the base, or "
        what += "take such an arm"
        wrong.append(Issue("problem.track", what, field=f"{place}.{stated[0][0]}", arm=arm.name))
    if track is not None and track.follow is not None and arm.sag is not None:
        what = f"arm {arm.name} goes along with its track and has its sag compensated; both together are not "
        what += "written yet; take follow or compensate_sag out"
        wrong.append(Issue("problem.track", what, field=f"{place}.track.follow", arm=arm.name))
    if track is not None and track.follow is not None and track.carries:
        what = f"what the track of arm {arm.name} carries is looked at where it stands, and it goes along; "
        what += "both together are not written yet; take follow or carries out"
        wrong.append(Issue("problem.track", what, field=f"{place}.track.carries", arm=arm.name))
    if arm.base_auto:
        what = f"arm {arm.name} stands on a {kind}, whose place is not searched; state its base"
        wrong.append(Issue("problem.track", what, field=f"{place}.base_auto", arm=arm.name))
    if wrong:
        raise TandemError(wrong)
    return tuple(_axis(spec, column) for column, (_, spec) in enumerate(stated))


def _axis(spec: TrackFile | GantryAxisFile, column: int) -> LinearAxis:
    follow, word = None, ""
    if isinstance(spec, TrackFile):
        follow = spec.follow
    else:
        word, column = spec.name, column if spec.external_axis is None else spec.external_axis - 1
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
        word,
        spec.carries,
    )


def _faults(spec: LinearAxisFile) -> list[tuple[str, str]]:
    out = []
    low, high = spec.range_mm
    if not float(np.linalg.norm(spec.axis)) > LEAST_AXIS:
        out.append(("axis", "its length is 0; give the direction in which values grow, such as [0, 1, 0]"))
    if not low < high:
        what = f"it goes from {low:g} to {high:g}; give the least value first, then a larger one"
        out.append(("range_mm", what))
    elif high - low < LEAST_TRACK_MM:
        what = f"it goes from {low:g} to {high:g} mm, and no track is shorter than {LEAST_TRACK_MM:g} mm; "
        out.append(("range_mm", f"{what}values are mm: 3 m are 3000"))
    elif max(-low, high) > MOST_TRACK_MM:
        what = (
            f"it goes from {low:g} to {high:g} mm; allowed are values up to {MOST_TRACK_MM:g} mm either way; "
        )
        out.append(("range_mm", f"{what}let 0 be where the work is, and the range no longer than it takes"))
    elif not low <= spec.home_mm <= high:
        out.append(("home_mm", f"{spec.home_mm:g} is outside the range of {low:g} to {high:g}"))
    for name, value in (("speed_mm_s", spec.speed_mm_s), ("acceleration_mm_s2", spec.acceleration_mm_s2)):
        if not value >= LEAST_RATE:
            out.append((name, f"got {value:g}; allowed: {LEAST_RATE:g} at least; values are mm: 1 m is 1000"))
    return out


def _carried(spec: LinearAxisFile, bodies: Sequence[str]) -> list[tuple[str, str]]:
    out = []
    for name in dict.fromkeys(spec.carries):
        if name not in bodies:
            what = f"{name!r} is no body of the cell's obstacles; they are {', '.join(bodies) or 'none'}"
            out.append(("carries", what))
        elif spec.carries.count(name) > 1:
            out.append(("carries", f"{name!r} is there twice; name each body once"))
    return out


def _alike(axes: Sequence[GantryAxisFile], arm: Arm) -> list[tuple[str, str, str]]:
    """Axes of a gantry that cannot be told apart: code, field, what is wrong."""
    out = []
    columns = [k if axis.external_axis is None else axis.external_axis - 1 for k, axis in enumerate(axes)]
    for k, axis in enumerate(axes):
        before = [one.name.lower() for one in axes[:k]]
        if axis.name.lower() in before:
            what = f"two axes of arm {arm.name} are called {axis.name}; give each a name of its own"
            out.append(("problem.duplicate_name", f"axes.{k}.name", what))
        if columns[k] in columns[:k]:
            letter = "abcdef"[columns[k]]
            what = f"external_axis: it is {columns[k] + 1} (eax_{letter}, E{columns[k] + 1}), as that of "
            what += f"axis {axes[columns.index(columns[k])].name}; each axis has its own"
            out.append(("problem.field", f"axes.{k}.external_axis", what))
        if arm.data.family != "KUKA":
            continue
        if axis.unit.lower() != axes[0].unit.lower():
            what = (
                "unit: a KUKA controller has all axes under an arm in one kinematic (#ERSYS), of one name; "
            )
            what += f"it is {axes[0].unit} and {axis.unit} here; give all of them one"
            out.append(("problem.field", f"axes.{k}.unit", what))
        if len(f"{axis.unit} {axis.name}") > MOST_KRL_LABEL:
            what = f"name: {axis.unit} and {axis.name} are too long for a KUKA controller's "
            what += "messages; give names "
            what += f"of {MOST_KRL_LABEL - 1} characters together at most"
            out.append(("problem.field", f"axes.{k}.name", what))
    return out


def _in_one(axes: Sequence[GantryAxisFile]) -> list[tuple[str, str, str]]:
    """Directions of which one does what others do: code, field, what is wrong."""
    ways = [np.array(axis.axis) / max(float(np.linalg.norm(axis.axis)), LEAST_AXIS) for axis in axes]
    if any(float(np.linalg.norm(way)) < 0.5 for way in ways):
        return []  # told already
    for j, k in itertools.combinations(range(len(axes)), 2):
        angle = float(np.arcsin(min(1.0, float(np.linalg.norm(np.cross(ways[j], ways[k]))))))
        if angle < LEAST_ANGLE:
            what = f"axis: {axes[k].name} goes along {axes[j].name}, {np.rad2deg(angle):.3g} degrees "
            what += "off; allowed "
            what += f"are {np.rad2deg(LEAST_ANGLE):g} at least; state two such axes as one"
            return [("problem.field", f"axes.{k}.axis", what)]
    if len(ways) == 3:
        square = np.cross(ways[0], ways[1])
        angle = float(np.arcsin(abs(ways[2] @ square) / float(np.linalg.norm(square))))
        if angle < LEAST_ANGLE:
            what = f"axis: {axes[2].name} goes in the plane of {axes[0].name} and {axes[1].name}, "
            what += f"{np.rad2deg(angle):.3g} degrees off; allowed are {np.rad2deg(LEAST_ANGLE):g} at "
            what += "least; leave "
            what += "one of them out"
            return [("problem.field", "axes.2.axis", what)]
    return []


def check_units(arms: Sequence[Arm], controller: Controller) -> None:
    """On each controller units have names of their own, and no body rides on two axes. Raises
    ``TandemError``: ``problem.duplicate_name``, ``problem.field``."""
    robots = {name.lower(): f"the robot {name}" for name in controller.units[: len(arms)]}
    taken, riding = dict(robots), dict[str, str]()
    for number, arm in enumerate(arms):
        kind = "track" if arm.track is not None else "gantry"
        if controller.sync == "handshake":  # each arm has a controller of its own
            name = controller.units[number]
            taken = {name.lower(): robots[name.lower()]}
        own: dict[str, str] = {}
        for place, rail in enumerate(arm.axes):
            field = f"arms.{number}.{'track' if arm.track is not None else f'axes.{place}'}"
            if rail.unit.lower() in taken:
                what = f"the unit {rail.unit} is that of {taken[rail.unit.lower()]}, too; give each "
                what += f"{kind} its own"
                raise refusal("problem.duplicate_name", what, field=f"{field}.unit", arm=arm.name)
            own[rail.unit.lower()] = f"arm {arm.name}"
            for body in rail.carries:
                if body in riding:
                    what = f"carries: {body} rides on {riding[body]} and on {rail.label}; name it "
                    what += "where it stands, those above an axis go along with it"
                    raise refusal("problem.field", what, field=f"{field}.carries", arm=arm.name)
                riding[body] = rail.label
        taken |= own


def carrying_faults(problem: Problem) -> list[Issue]:
    """Axes that would take the block's stand away (``problem.track``)."""
    riders = {body: on for arm in problem.cell.arms for on in arm.axes for body in on.carries}
    if not riders:
        return []
    from planner.cell import support  # what reads a problem without such axes loads nothing of the cell

    for setup in problem.setups:
        stock = setup.stock
        if stock.held_by is not None or stock.place is None:
            continue
        gap, name = support.bearer(setup.cell, stock, stock.place)
        if name in riders and abs(gap) <= support.FOOT_HEIGHT:
            what = f"the block stands on {name}, which {riders[name].label} takes along; put the block on "
            what += "what stands, or take the body out of carries"
            return [Issue("problem.track", what, field=f"operations.{setup.operations[0]}")]
    return []


def following_faults(problem: Problem) -> list[Issue]:
    """What cannot be worked at while the tracks of arms go along (``problem.track``)."""
    out: list[Issue] = []
    riders = {
        arm.name: f"cell.arms.{k}.track.follow" for k, arm in enumerate(problem.cell.arms) if arm.follows
    }
    for name, field in riders.items():
        if any(setup.stock.held_by == name for setup in problem.setups):
            what = f"arm {name} holds the block, and its track cannot go along then; take follow out"
            out.append(Issue("problem.track", what, field=field, arm=name))
    for index, operation in enumerate(problem.operations if riders else ()):
        own = [name for name in operation.arms if name in riders]
        if not own:
            continue
        if not any_base(operation):
            what = f"{operation.process} is worked at standing; milling and targets take a track that goes "
            what += "along; take follow out of the track for the others"
        elif len(operation.arms) > 1 and problem.cell.controller.sync == "handshake":
            what = "with two controllers (handshake) one arm may be a step ahead of the other one, and the "
            what += f"proof has bases stand then; {own[0]} goes along with its track; take follow out, so "
            what += "that it stands, use one controller (sync: multimove), or give each arm an operation of "
            what += "its own"
        elif len(own) > 1:
            what = f"the tracks of {' and '.join(own)} go along, and two bases that go at once are not held "
            what += "apart yet; take follow out of one of them, or give each arm an operation of its own"
        else:
            continue
        what = f"operation {operation.name}: {what}"
        out.append(Issue("problem.track", what, field=f"operations.{index}", arm=own[0]))
    return out
