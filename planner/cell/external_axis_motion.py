"""Clearance while external axes move between stations.

A track or gantry moves a folded arm, one axis after another. A turntable or positioner moves the block.

Carried bodies move at most as far as their farthest point: the path of the carriage, or the arc about the
axis. A distance changes by no more than that. Samples are therefore as far apart as the clearance allows, and
a bound holds between two of them.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from planner.cell import clearance, distance
from planner.cell.bodies import Solid, shapes_by_body
from planner.cell.plant import CellModel
from planner.cell.support import SupportGround
from planner.geometry.arrays import BoolArray, FloatArray, Shape, hull_points, transform
from planner.geometry.units import DEG
from planner.problem import (
    END_SUFFIX,
    MAX_BLIND_SPEED_M_S,
    STOCK_AXIS,
    TILT_AXIS,
    TURNTABLE_BODY,
    Arm,
    Cell,
    LinearAxis,
    Problem,
    RotaryAxis,
    Setup,
    Turntable,
    motion_order,
)

UPRIGHT_TOLERANCE: Final = 1e-12
"""Rotary axes are upright if the z component of their unit vector differs from 1 by less than this."""
MIN_STEP_M: Final = 1e-3
"""Minimum distance between samples [m]."""
MAX_STANDING_GAP_M: Final = 5e-3
"""Maximum distance [m] between a base and the body that it stands on, and between two shapes in a bearing."""
MAX_SUPPORT_ABOVE_FOOT_M: Final = 2e-3
"""Height [m] by which the body that a base stands on may be above the lowest point of the base.

Some bases have shapes that end 1 mm below their foot.
"""
MIN_PLANE_NORMAL: Final = 1e-3
"""Minimum length of the component of a shape's axis across the motion that defines a separating plane."""
MIN_UPRIGHT_COMPONENT: Final = 0.5
"""Minimum length of the component of a base's z axis across its motion.

A base that is tilted farther into its motion stands on nothing that it could leave sliding.
"""
MAX_BEARING_DISTANCE_M: Final = 0.15
"""Maximum distance [m] from the tilt axis of shapes that meet face to face in its bearing."""
CONTACT_TOLERANCE_M: Final = 1e-6
"""Distance [m] below which positions coincide."""
MAX_MEASURED_DISTANCE_M: Final = 0.5
"""Distance [m] up to which clearances are measured."""
MAX_ABB_ROTATION_RAD_S: Final = 45.0 * DEG
"""Maximum rotation speed [rad/s] of joint moves in RAPID programs."""
TURNTABLE_BODIES: Final = ("stock", "support")
"""Bodies that a turntable rotates."""
FLOOR: Final = "the floor"
"""Name of the floor, which tilted or lowered bodies may approach and which is not a body of the cell."""
LEVEL_TOLERANCE: Final = 1e-9
"""Linear axes are level if the z component of their unit vector is below this."""


class AxisSample(NamedTuple):
    """Poses of carried bodies at one sample.

    Attributes:
        value: Value of the axis [m, rad].
        poses: Poses in the world by body (4, 4).
    """

    value: float
    poses: Mapping[str, FloatArray]


@dataclasses.dataclass(frozen=True)
class AxisMotionCheck:
    """Result of checking a motion of an external axis.

    Attributes:
        min_distance: Smallest distance [m] of any two bodies, as a lower bound between samples.
        at: Value of the axis [m, rad] at which the distance is smallest.
        pair: The two bodies that are closest there.
        clear: Whether the motion was checked completely and no bodies come closer than required.
        samples: Checked samples, from the start of the motion.
    """

    min_distance: float
    at: float
    pair: tuple[str, str]
    clear: bool = False
    samples: tuple[AxisSample, ...] = dataclasses.field(default=(), compare=False, repr=False)


class AxisTravel(NamedTuple):
    """A motion of an external axis.

    Attributes:
        start: First value [m, rad].
        end: Last value [m, rad].
        seconds: Duration [s].
    """

    start: float
    end: float
    seconds: float


def carried_bodies(cell: Cell, name: str) -> dict[str, tuple[str, ...]]:
    """Return the bodies that a linear axis carries, by the names of the axes that they are mounted on.

    These axes are the given one and those above it.

    Args:
        cell: The cell.
        name: Name of the axis.
    """
    arm, _ = cell.linear_axis(name)
    names = list(arm.axes_by_name)
    return {axis_name: arm.axes_by_name[axis_name].carries for axis_name in names[names.index(name) :]}


def check_linear_motion(
    model: CellModel,
    name: str,
    ends: tuple[float, float],
    q: Mapping[str, FloatArray],
    min_clearance: float,
    ignore: clearance.Pairs = frozenset(),
) -> AxisMotionCheck:
    """Check the motion of a linear axis. The check ends at a distance below ``min_clearance``.

    The base of the arm moves, and all that this axis and those on it carry. The base is not checked against
    shapes on which it stands and slides (:func:`_supporting_shapes`), and carried bodies are not checked
    against shapes that bear them (:func:`_sliding_shapes`). They are checked against other shapes of the same
    bodies. Bodies that move up or down keep clear of the floor too. A base may stand on it.

    Args:
        model: Cell with the base and the carried bodies at the start of the motion.
        name: Name of the axis.
        ends: First and last value of the axis [m].
        q: Joints of all arms meanwhile, by arm (6,) [rad].
        min_clearance: Required distance [m].
        ignore: Pairs of bodies that are not checked.
    """
    arm, axis = model.cell.linear_axis(name)
    base, foot = model.bases[arm.name], f"{arm.name}/base_link"
    bodies_by_axis = carried_bodies(model.cell, name)
    bodies = [body for axis_bodies in bodies_by_axis.values() for body in axis_bodies]
    moving = [solid for solid in model.solids if solid.body in (foot, *bodies)]
    fixed_bodies = [f"{other}/base_link" for other in model.arms if other != arm.name]
    fixed_bodies += [body.name for body in model.cell.obstacles if body.name not in bodies]
    fixed_bodies += ["stock", "support"] if model.stock.held_by is None else []
    fixed = [solid for solid in model.solids if solid.body in fixed_bodies]
    feet = [solid for solid in moving if solid.body == foot]
    excluded = np.zeros((len(moving), len(fixed)), bool)
    excluded[[solid.body == foot for solid in moving]] = _supporting_shapes(
        model, feet, fixed, base[:3, 2], axis.axis
    )
    bearers = _bearing_bodies(model.cell, arm)
    bears = np.array([solid.body in bearers for solid in fixed], bool)
    carries = np.array([solid.body != foot for solid in moving], bool)
    excluded |= _sliding_shapes(model, moving, fixed, axis, ends[0]) & carries[:, None] & bears
    floor = SupportGround.of(model.cell).floor

    def cell_at(value: float) -> CellModel:
        """Return the cell with the axis at a value [m]."""
        displacement = value - ends[0]
        motion = axis.translate(np.eye(4), displacement)
        moved = model.with_axis_motions(
            {
                axis_name: motion @ model.axis_motion(axis_name)
                for axis_name, carried in bodies_by_axis.items()
                if carried
            }
        )
        return moved.with_bases({arm.name: axis.translate(base, displacement)})

    def fixed_distances(placed: CellModel) -> dict[tuple[str, str], float]:
        """Return the distances [m] of what moves to fixed bodies and, if it can move down, to the floor."""
        out = _body_distances(placed, moving, fixed, excluded)
        if abs(axis.axis[2]) < LEVEL_TOLERANCE:
            return out
        # a base may stand on the floor, but not in it
        foot_heights = _floor_distances(placed, moving, [foot], floor)
        below_floor = {pair: low for pair, low in foot_heights.items() if low < -MAX_SUPPORT_ABOVE_FOOT_M}
        return out | below_floor | _floor_distances(placed, moving, bodies, floor)

    motion = _SampledMotion(cell_at, fixed_distances, 1.0, ends, (foot, *bodies))
    return _check_by_samples(motion, q, min_clearance, ignore)


def _bearing_bodies(cell: Cell, arm: Arm) -> set[str]:
    """Return the bodies along which carried bodies of an arm's axes may slide.

    These are bodies of the cell that no axis under another arm carries, but not a block, its support or
    another arm's base.
    """
    carried = {
        name
        for other in cell.arms
        if other.name != arm.name
        for axis in other.linear_axes
        for name in axis.carries
    }
    return {body.name for body in cell.obstacles} - carried


def _floor_distances(
    placed: CellModel, carried: Sequence[Solid], bodies: Sequence[str], floor: float
) -> dict[tuple[str, str], float]:
    """Return the heights [m] of bodies above the floor, by the pair of body and :data:`FLOOR`.

    Args:
        placed: The cell at one sample.
        carried: Solids that move.
        bodies: Bodies whose height is returned.
        floor: Height of the floor [m].
    """
    out: dict[tuple[str, str], float] = {}
    poses = placed.poses({})
    for solid in (candidate for candidate in carried if candidate.body in bodies):
        lowest = float(
            transform(poses[solid.body][0] @ solid.shape.pose, hull_points(solid.shape))[:, 2].min()
        )
        pair = (solid.body, FLOOR)
        out[pair] = min(out.get(pair, np.inf), lowest - floor)
    return out


def check_rotary_motion(
    model: CellModel,
    name: str,
    tilt: float,
    ends: tuple[float, float],
    q: Mapping[str, FloatArray],
    min_clearance: float,
) -> AxisMotionCheck:
    """Check the motion of a turntable or of one axis of a positioner.

    The check ends at a distance below ``min_clearance``.

    The plate is rotationally symmetric about the turn axis, so its rotation brings nothing closer, and the
    distance to what it carries is constant. The tilt axis moves plate and bracket. Shapes of these are not
    checked against fixed shapes that bear them (:func:`_bearing_shapes`), whose distance no tilt reduces.
    They are checked against all other shapes of the same bodies. Bodies that tilt keep clear of the floor
    too.

    Args:
        model: Cell with the block, and what is tilted with it, at the start of the motion.
        name: Name of the axis.
        tilt: Value of the tilt axis in ``model`` [rad].
        ends: First and last value of the axis [rad].
        q: Joints of all arms meanwhile, by arm (6,) [rad].
        min_clearance: Required distance [m].

    Raises:
        ValueError: For a cell without a turntable.
    """
    table = model.cell.turntable
    if table is None:
        raise ValueError("the cell has no turntable")
    pivot = table.axis_at_tilt(name, tilt)
    is_tilt = name == TILT_AXIS
    moving_bodies = (*TURNTABLE_BODIES, *table.tilted_bodies) if is_tilt else TURNTABLE_BODIES
    moving = [solid for solid in model.solids if solid.body in moving_bodies]
    fixed_bodies = [f"{arm}/base_link" for arm in model.arms]
    fixed_bodies += [
        body.name for body in model.cell.obstacles if body.name not in (*moving_bodies, TURNTABLE_BODY)
    ]
    fixed = [solid for solid in model.solids if solid.body in fixed_bodies]
    floor = SupportGround.of(model.cell).floor
    is_upright = abs(pivot.axis[2]) > 1.0 - UPRIGHT_TOLERANCE

    def cell_at(value: float) -> CellModel:
        """Return the cell with the axis at a value [rad]."""
        motion = pivot.rotate(np.eye(4), value - ends[0])
        moved = model.with_stock(motion @ model.stock_pose)
        if not is_tilt:
            return moved
        return moved.with_axis_motions({TILT_AXIS: motion @ model.axis_motion(TILT_AXIS)})

    bearing = _bearing_shapes(cell_at(0.0), moving, fixed, pivot) if is_tilt and moving and fixed else None

    def fixed_distances(placed: CellModel) -> dict[tuple[str, str], float]:
        """Return the distances [m] of what moves to fixed bodies and to the floor."""
        out = _body_distances(placed, moving, fixed, bearing)
        # heights above the floor are constant if the axis is upright
        return out if is_upright else out | _floor_distances(placed, moving, moving_bodies, floor)

    poses = model.poses({})
    lever = max((max_axis_distance([s.shape], poses[s.body][0], pivot) for s in moving), default=0.0)
    # the motion does not change the distances of bodies that it does not move
    unmoved = sorted({solid.body for solid in model.solids} - set(moving_bodies))
    ignored = frozenset(map(frozenset, itertools.combinations(unmoved, 2)))
    with_solids = {solid.body for solid in moving}
    carried = tuple(name for name in moving_bodies if name in with_solids)
    return _check_by_samples(
        _SampledMotion(cell_at, fixed_distances, lever, ends, carried), q, min_clearance, ignored
    )


def model_at_values(model: CellModel, values: Mapping[str, float], current: Mapping[str, float]) -> CellModel:
    """Return the model with external axes at other values.

    Args:
        model: Cell with the axes at ``current``.
        values: New values by axis [m, rad].
        current: Values by axis [m, rad] that the axes have in ``model``. An axis that neither mapping names
            stays.
    """
    cell, table = model.cell, model.cell.turntable
    moved = model.with_axis_motions(
        {
            name: motion @ model.axis_motion(name)
            for name, motion in cell.carried_motions(values, current).items()
        }
    )
    for arm in cell.arms:
        base = model.bases[arm.name]
        for name, axis in arm.axes_by_name.items():
            base = axis.translate(base, values.get(name, 0.0) - current.get(name, 0.0))
        moved = moved.with_bases({arm.name: base}) if arm.linear_axes else moved
    return moved if table is None else moved.with_stock(table.move_pose(model.stock_pose, values, current))


def max_axis_distance(shapes: Sequence[Shape], pose: FloatArray, axis: RotaryAxis) -> float:
    """Return the distance [m] of the farthest point of shapes from an axis.

    Args:
        shapes: The shapes.
        pose: Pose of their frame (4, 4).
        axis: The axis.
    """
    offsets = [transform(pose @ shape.pose, hull_points(shape)) - axis.centre for shape in shapes]
    return max((float(np.linalg.norm(np.cross(p, axis.axis), axis=1).max()) for p in offsets), default=0.0)


def carried_radius(setup: Setup, pose: FloatArray, table: Turntable, name: str = STOCK_AXIS) -> float:
    """Return the largest distance [m] from an axis under the block of what it carries in a setup.

    Args:
        setup: The setup.
        pose: Pose of the block where the setup's values have it (4, 4).
        table: Turntable or positioner.
        name: Name of the axis.
    """
    stock = setup.stock
    block = (*shapes_by_body(setup.cell, stock)["stock"], *stock.support)
    pivot = table.axis_at_tilt(name, stock.tilt or 0.0)
    tilted = [body for body in setup.cell.obstacles if name == TILT_AXIS and body.name in table.tilted_bodies]
    return max(
        max_axis_distance(block, pose, pivot),
        *(max_axis_distance(body.shapes, np.eye(4), pivot) for body in tilted),
        0.0,
    )


def travel_speeds(problem: Problem, poses: Sequence[FloatArray]) -> dict[str, float]:
    """Return the speeds [m/s, rad/s] of external axes between stations, as programs state them, by axis.

    Carried bodies move at most at :data:`planner.problem.MAX_BLIND_SPEED_M_S`. In KRL speeds are whole
    percents of the axis' maximum.

    Args:
        problem: The problem.
        poses: Pose of the block in each setup (4, 4).
    """
    out: dict[str, float] = {}
    for arm in problem.cell.arms:
        max_speeds = {name: min(axis.speed, MAX_BLIND_SPEED_M_S) for name, axis in arm.axes_by_name.items()}
        if arm.data.family == "ABB":  # speeddata has one value for all of them
            max_speeds = dict.fromkeys(max_speeds, min(max_speeds.values(), default=0.0))
        out |= {
            name: _whole_percent_speed(max_speeds[name], axis.speed, arm)
            for name, axis in arm.axes_by_name.items()
        }
    table = problem.cell.turntable
    if table is not None:
        mover = problem.cell.arm(table.arm)
        setups_with_poses = list(zip(problem.setups, poses, strict=False))
        closing_setup = problem.closing_setup
        if closing_setup is not None and closing_setup.stock.place is not None:
            setups_with_poses.append((closing_setup, closing_setup.stock.place))
        table_speeds: dict[str, float] = {}
        for name, axis in table.axes.items():
            radius = max(
                carried_radius(setup, np.asarray(pose), table, name) for setup, pose in setups_with_poses
            )
            table_speeds[name] = min(axis.speed, MAX_BLIND_SPEED_M_S / radius)
        if mover.data.family == "ABB":  # speeddata has one value for all of them
            table_speeds = dict.fromkeys(table_speeds, min(*table_speeds.values(), MAX_ABB_ROTATION_RAD_S))
        out |= {
            name: _whole_percent_speed(table_speeds[name], axis.speed, mover)
            for name, axis in table.axes.items()
        }
    return out


def _whole_percent_speed(speed: float, axis_speed: float, mover: Arm) -> float:
    """Return the speed that a program of the arm ``mover`` states for an axis.

    KRL states whole percents of the axis' maximum ``axis_speed``, so the speed is rounded down to them, to at
    least 1 %. Other languages state the speed itself.
    """
    if mover.data.family != "KUKA":
        return speed
    return max(1.0, float(np.floor(100.0 * speed / axis_speed + 1e-9))) / 100.0 * axis_speed


def axis_travels(problem: Problem, poses: Sequence[FloatArray]) -> tuple[dict[str, AxisTravel], ...]:
    """Return the motions of external axes before each operation, and home after the last one.

    Each entry has the motions by axis, in the order in which they occur. Axes that do not move are left out.
    A motion takes the distance divided by the speed, plus the speed divided by the axis' acceleration. Short
    motions reach only the speed at which they still can brake.

    Args:
        problem: The problem.
        poses: Pose of the block in each setup (4, 4).
    """
    if not problem.axis_homes or not problem.operations:
        return ()
    speeds, current = travel_speeds(problem, poses), problem.axis_homes
    out: list[dict[str, AxisTravel]] = []
    arms, table = problem.cell.arms, problem.cell.turntable
    ramps = {name: axis.acceleration for arm in arms for name, axis in arm.axes_by_name.items()}
    ramps |= {} if table is None else {name: axis.acceleration for name, axis in table.axes.items()}
    for index in range(len(problem.operations) + 1):
        target = (
            problem.axis_homes if index == len(problem.operations) else problem.stations.get(index, current)
        )
        motions: dict[str, AxisTravel] = {}
        ends = {name: target.get(name, current[name]) for name in current}
        order = [name for arm in arms for name in motion_order(arm.axes_by_name, current, ends)]
        for name in (*order, *(() if table is None else table.axes)):
            value = ends[name]
            distance = abs(value - current[name])
            if distance > 0.0:
                ramp = ramps[name]
                top_speed = min(speeds[name], float(np.sqrt(distance * ramp)))
                motions[name] = AxisTravel(current[name], value, distance / top_speed + top_speed / ramp)
        out.append(motions)
        current = {
            name: target.get(f"{name}{END_SUFFIX}", target.get(name, current[name])) for name in current
        }
    return tuple(out)


@dataclasses.dataclass(frozen=True)
class _SampledMotion:
    """A motion of one axis that is checked by samples.

    Attributes:
        cell_at: Returns the cell at a value of the axis.
        fixed_distances: Returns distances [m] of carried bodies to fixed ones, by pairs of bodies without
            joints.
        lever: Displacement of the farthest point per change of the value [-, m/rad].
        ends: First and last value of the axis [m, rad].
        carried_bodies: Bodies that move.
    """

    cell_at: Callable[[float], CellModel]
    fixed_distances: Callable[[CellModel], Mapping[tuple[str, str], float]]
    lever: float
    ends: tuple[float, float]
    carried_bodies: tuple[str, ...]


def _check_by_samples(
    motion: _SampledMotion,
    q: Mapping[str, FloatArray],
    min_clearance: float,
    ignore: clearance.Pairs = frozenset(),
) -> AxisMotionCheck:
    """Check a motion by samples whose spacing is the excess of the current distance over the required one.

    The spacing is at least :data:`MIN_STEP_M`. The check ends at the first sample at which bodies are too
    close.

    Args:
        motion: The motion.
        q: Joints of all arms, by arm (6,) [rad].
        min_clearance: Required distance [m].
        ignore: Pairs of bodies that are not checked.
    """
    (start, end), lever = motion.ends, motion.lever
    rows = {name: np.asarray(joints)[None] for name, joints in q.items()}
    sign, length = float(np.sign(end - start)), lever * abs(end - start)
    closest = AxisMotionCheck(MAX_MEASURED_DISTANCE_M, start, ("", ""))
    travelled, previous_gap, step = 0.0, np.inf, 0.0
    samples: list[AxisSample] = []
    while True:
        value = start + sign * (travelled / lever if lever > 0.0 else 0.0)
        placed = motion.cell_at(value)
        result = clearance.min_clearance(placed, rows, MAX_MEASURED_DISTANCE_M, ignore)
        gap, pair = float(result.distance[0]), result.pair[0]
        for bodies, fixed_gap in motion.fixed_distances(placed).items():
            if fixed_gap < gap:
                gap, pair = fixed_gap, bodies
        poses = placed.poses({})
        samples.append(AxisSample(value, {name: poses[name][0] for name in motion.carried_bodies}))
        # between two samples the distance is at least (d1 + d2 - step) / 2
        bound = min(gap, 0.5 * (previous_gap + gap - step)) if np.isfinite(previous_gap) else gap
        if bound < closest.min_distance:
            closest = AxisMotionCheck(bound, value, pair)
        if travelled >= length or gap < min_clearance:
            return dataclasses.replace(closest, clear=gap >= min_clearance, samples=tuple(samples))
        step = min(max(gap - min_clearance, MIN_STEP_M), length - travelled)
        travelled, previous_gap = travelled + step, gap


def _body_distances(
    model: CellModel, moving: list[Solid], fixed: list[Solid], excluded: BoolArray | None
) -> dict[tuple[str, str], float]:
    """Return the smallest distances [m] between carried and fixed bodies, by pair of bodies.

    They are at most 0 for bodies that overlap. Pairs of solids in ``excluded`` (R, F) do not count.
    """
    out: dict[tuple[str, str], float] = {}
    if not moving or not fixed:
        return out
    gaps = _gaps(model, moving, fixed)
    for i, j in zip(*np.nonzero(np.ones_like(gaps, bool) if excluded is None else ~excluded), strict=True):
        pair = (moving[i].body, fixed[j].body)
        out[pair] = min(out.get(pair, np.inf), float(gaps[i, j]))
    return out


def _solid_poses(model: CellModel, solids: Sequence[Solid]) -> FloatArray:
    """Return the world poses (S, 4, 4) of solids of bodies without joints."""
    poses = model.poses({})
    return np.stack([poses[solid.body][0] @ solid.shape.pose for solid in solids])


def _gaps(
    model: CellModel, moving: list[Solid], fixed: list[Solid], shift: FloatArray | None = None
) -> FloatArray:
    """Return the distances (R, F) [m] between carried and fixed solids, at most 0 if they overlap.

    Carried solids are shifted by ``shift`` (3,) [m] from where ``model`` has them.
    """
    solids = [*moving, *fixed]
    placed = _solid_poses(model, solids)
    if shift is not None:
        placed[: len(moving), :3, 3] += shift
    first, second = (v.ravel() for v in np.indices((len(moving), len(fixed))))
    second = second + len(moving)
    gaps, _, _ = distance.measure_distances(
        distance.make_cores(solids), first, second, placed[first], placed[second]
    )
    return gaps.reshape(len(moving), len(fixed))


def _extents(cores: distance.Cores, placed: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the lower and upper extent (2, S) [m] of solids at poses (S, 4, 4) along a unit vector (3,)."""
    indices, ends = np.arange(len(placed)), []
    for sign in (-1.0, 1.0):
        ray = np.broadcast_to(sign * direction, (len(placed), 3))
        local_tips = cores.support(indices, np.einsum("sc,scd->sd", ray, placed[:, :3, :3]))
        tips = np.einsum("scd,sd->sc", placed[:, :3, :3], local_tips) + placed[:, :3, 3]
        ends.append(tips @ direction + sign * cores.rounding)
    return np.stack(ends)


def _supporting_shapes(
    model: CellModel, base_solids: list[Solid], fixed: list[Solid], upright: FloatArray, direction: FloatArray
) -> BoolArray:
    """Return for each of F fixed shapes whether a base stands and slides on it, so that it is not checked.

    These are shapes of obstacles that end below the foot of the base, so that the base comes no closer to
    them while it moves. At least one shape of the obstacle is closer to the base than
    :data:`MAX_STANDING_GAP_M`. Shapes that are higher than the foot by more than
    :data:`MAX_SUPPORT_ABOVE_FOOT_M` do not count, such as a box on a rail, or a mesh, whose hull contains
    both.

    Args:
        model: Cell with the base at the start of the motion.
        base_solids: Solids of the base.
        fixed: Fixed solids.
        upright: Unit vector (3,) of the base's z axis in the world.
        direction: Unit vector (3,) of the motion.
    """
    up = upright - (upright @ direction) * direction
    length = float(np.linalg.norm(up))
    if not base_solids or not fixed or length < MIN_UPRIGHT_COMPONENT:
        return np.zeros(len(fixed), bool)
    solids = [*base_solids, *fixed]
    low, high = _extents(distance.make_cores(solids), _solid_poses(model, solids), up / length)
    is_below = high[len(base_solids) :] < low[: len(base_solids)].min() + MAX_SUPPORT_ABOVE_FOOT_M
    is_close = _gaps(model, base_solids, fixed).min(axis=0) < MAX_STANDING_GAP_M
    bodies = {fixed[j].body for j in np.flatnonzero(is_below & is_close)}
    bodies &= {body.name for body in model.cell.obstacles}
    return np.asarray(is_below & np.array([solid.body in bodies for solid in fixed]))


def _sliding_shapes(
    model: CellModel, moving: list[Solid], fixed: list[Solid], axis: LinearAxis, value: float
) -> BoolArray:
    """Return for R carried and F fixed shapes whether one slides along the other, as in a bearing.

    Such shapes are less than :data:`MAX_STANDING_GAP_M` apart over the whole range of the axis, and a plane
    along the motion separates them. Both shapes are convex, so shapes that are that close at both ends of the
    range are so in between. Planes are tried whose normals are the axes of both shapes, without their
    component along the motion, and the cross products of the motion with these axes. Boxes that overlap do
    not count, and neither do shapes that obstruct the motion, such as an end stop, or that the motion leaves
    behind, such as a post next to the path.

    Args:
        model: Cell with the carried solids at ``value``.
        moving: Carried solids.
        fixed: Fixed solids.
        axis: The axis.
        value: Value [m] of the axis.
    """
    out = np.zeros((len(moving), len(fixed)), bool)
    if not moving or not fixed:
        return out
    solids, direction = [*moving, *fixed], axis.axis
    cores, placed = distance.make_cores(solids), _solid_poses(model, solids)
    is_close = np.ones_like(out)
    for end in (axis.low, axis.high):
        is_close &= _gaps(model, moving, fixed, (end - value) * direction) < MAX_STANDING_GAP_M
    for i, j in zip(*np.nonzero(is_close), strict=True):
        pair = [int(i), len(moving) + int(j)]
        axes = np.concatenate([placed[k, :3, :3].T for k in pair])
        for normal in (*(axes - (axes @ direction)[:, None] * direction), *np.cross(direction, axes)):
            length = float(np.linalg.norm(normal))
            if length > MIN_PLANE_NORMAL:
                low, high = _extents(cores, placed, normal / length)
                separation = max(low[pair[1]] - high[pair[0]], low[pair[0]] - high[pair[1]])
                out[i, j] |= separation > -CONTACT_TOLERANCE_M
    return out


def _bearing_shapes(model: CellModel, moving: list[Solid], fixed: list[Solid], axis: RotaryAxis) -> BoolArray:
    """Return for R moving and F fixed shapes whether the fixed one bears the moving one in the tilt bearing.

    Only shapes of plate and bracket can be borne. Pairs in a bearing are not checked, because they are less
    than :data:`MAX_STANDING_GAP_M` apart and the tilt cannot bring them closer. There are two kinds:

    - One shape is rotationally symmetric about the tilt axis, such as a shaft or its seat.
    - One shape starts along the axis where the other ends, and their faces slide past each other, such as a
      cradle in front of its posts. Their distance is that of these ends, and both come within
      :data:`MAX_BEARING_DISTANCE_M` of the axis.

    All other pairs are checked: a column next to the bracket, a box that a fixed one overlaps, and a bar
    above the end of a post that the tilt lowers next to it.

    Args:
        model: Cell with the tilt at 0.
        moving: Solids that tilt.
        fixed: Fixed solids.
        axis: Tilt axis.
    """
    solids = [*moving, *fixed]
    cores, placed = distance.make_cores(solids), _solid_poses(model, solids)
    indices = np.arange(len(solids))
    low, high = _extents(cores, placed, axis.axis) - axis.centre @ axis.axis
    moving_rows, fixed_rows = slice(len(moving)), slice(len(moving), None)
    separation = np.maximum(
        low[fixed_rows] - high[moving_rows, None], low[moving_rows, None] - high[fixed_rows]
    )

    # a thin rod along the part of the axis along which shapes lie, to measure their distance from the axis
    rod_pose = np.eye(4)
    rod_pose[:3, 3] = axis.centre + 0.5 * (low.min() + high.max()) * axis.axis
    rod_pose[:3, :3] = np.linalg.svd(axis.axis[None])[2].T[:, [1, 2, 0]]
    rod = Solid("", Shape("capsule", (CONTACT_TOLERANCE_M, float(high.max() - low.min())), np.eye(4)))
    rod_index = np.full(len(solids), len(solids))
    axis_distance, _, _ = distance.measure_distances(
        distance.make_cores([*solids, rod]),
        indices,
        rod_index,
        placed,
        np.broadcast_to(rod_pose, placed.shape),
    )
    is_close = axis_distance < MAX_BEARING_DISTANCE_M

    # offset of each shape's centre from the axis, and sine of the angle between its z and the axis
    aside = np.cross(placed[:, :3, 3] - axis.centre, axis.axis)
    skew = np.linalg.norm(np.cross(placed[:, :3, 2], axis.axis), axis=1)
    is_sphere = np.array([solid.shape.kind == "sphere" for solid in solids])
    is_rod = np.array([solid.shape.kind in ("cylinder", "capsule") for solid in solids])
    is_symmetric = (is_sphere | is_rod & (skew < CONTACT_TOLERANCE_M)) & (
        np.linalg.norm(aside, axis=1) < CONTACT_TOLERANCE_M
    )

    gaps = _gaps(model, moving, fixed)
    slides = (
        (separation > -CONTACT_TOLERANCE_M)
        & (gaps < separation + CONTACT_TOLERANCE_M)
        & is_close[moving_rows, None]
        & is_close[fixed_rows]
    )
    is_shaft = is_symmetric[moving_rows, None] | is_symmetric[fixed_rows]
    is_tilted = np.array([solid.body not in TURNTABLE_BODIES for solid in moving])[:, None]
    return np.asarray(is_tilted & (gaps < MAX_STANDING_GAP_M) & (slides | is_shaft))
