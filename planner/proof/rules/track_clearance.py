"""verify.track_way: clearance while tracks, gantries, turntables and positioners move between stations.

The distances are those of the planner's distance queries. The poses of carried bodies in the queries are
compared with independent sums and rotations. The distances of carried bodies from all stationary bodies,
except for those that support them, are then checked along the lines on which the queries found them: for any
line, the extents of two convex shapes along it prove a distance between them.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from planner.cell import external_axis_motion
from planner.cell.external_axis_motion import AxisMotionCheck, AxisSample
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, hull_points, transform
from planner.problem import END_SUFFIX, STOCK_AXIS, TILT_AXIS, TURNTABLE_BODY, Arm, Cell, Setup, Turntable
from planner.programs.steps import MAX_EXTERNAL_VALUE
from planner.proof.clearance.separating_lines import (
    DISTANCE_TOLERANCE_M,
    CarriedSolids,
    extent,
    is_round_about,
    slides_along,
    stationary_solids,
    unproven_clearance,
)
from planner.proof.context import Context
from planner.proof.findings import Findings, measure_in_mm
from planner.proof.kinematics.external_axes import (
    AXIS_VALUE_TOLERANCE,
    TaskAxis,
    axis_translation,
    carried_motions,
    floor_height,
    task_axes,
)
from planner.proof.models import MODELS
from planner.proof.rule import RuleOutcome, mm, rule
from planner.proof.rules.clearance import self_clearance_pairs
from planner.proof.rules.external_axes import rotated_points, stock_deviation, zero_stock_pose
from planner.proof.rules.setups_and_frames import FRAME_TOLERANCE_M, FRAME_TOLERANCE_RAD

_CODE = "verify.track_way"
"""Code of the rule."""
MAX_SUPPORT_ABOVE_FOOT_M = 2e-3
"""Height [m] above the foot of a base up to which the body on which the base slides may extend."""
MIN_UPRIGHT_PART = 0.5
"""Minimum length of the component of a base's z axis perpendicular to the motion. If it is shorter, the base
has no foot on which it slides.
"""
POSE_TOLERANCE = 1e-6
"""Tolerance [m, and each entry of the rotation] within which poses of bodies are equal."""
MAX_LEVEL_HEIGHT = 1e-9
"""Maximum z component of the unit vector of an axis that counts as horizontal."""


@dataclasses.dataclass(frozen=True)
class AxisMove:
    """Motion of one axis between the stations of two setups, or of a coordinated track within a setup.

    Attributes:
        axis: Axis that moves.
        ends: Start and end value [m, rad].
        values: Values [m, rad] of all axes before the motion, by name.
    """

    axis: TaskAxis
    ends: tuple[float, float]
    values: Mapping[str, float]


@rule("verify.track_way", parallel_group="bodies")
def track_clearance(context: Context) -> RuleOutcome:
    """Bodies keep their clearance while a track, gantry axis, turntable or positioner moves between
    stations. All arms are folded at home meanwhile. What is tilted, raised or lowered also keeps its
    clearance from the floor. What axes carry is, in each setup, where independent sums put it. The poses
    in the distance queries are compared with such sums and rotations, and carried shapes with all
    stationary shapes except their supports, along lines. The base of a coordinated track keeps its
    clearance while it moves, too.
    """
    models, limit = context.get(MODELS), context.problem.settings.clearance
    findings, query_count = Findings(_CODE, context, worst=np.inf), 0
    values = context.problem.axis_homes  # current values of all axes by name, updated after each motion
    for index, setup in enumerate(context.setups):
        for fault in _check_model_poses(context, models(index), setup):
            findings.add(fault)
        for axis, ends in _moving_axes(context, index, setup, values):
            model = _model_before(context, models(index), setup, values)
            move = AxisMove(axis=axis, ends=ends, values=values)
            motion = _axis_motion(model, setup, move, limit)
            query_count += len(motion.samples)
            findings.note_lowest(
                motion.min_distance, f"{' and '.join(motion.pair)} at {axis.format_value(motion.at)}"
            )
            prefix = (
                f"motion of {axis.label} from {axis.format_value(ends[0])} to {axis.format_value(ends[1])}: "
            )
            arm = axis.arm
            if motion.min_distance < limit or not motion.clear:
                distance_text = (
                    f"{' and '.join(motion.pair)} are {mm(motion.min_distance):.3f} mm apart at "
                    f"{axis.format_value(motion.at)}"
                )
                findings.add(prefix + distance_text, measure_in_mm(motion.min_distance, limit), arm=arm)
            fault = _check_query_poses(context, models(index).cell, index, move, motion)
            # Independent check of carried bodies along lines. An axis without an arm belongs to a turntable.
            if not fault and motion.clear:
                table, tilt = setup.cell.turntable, values.get(TILT_AXIS, 0.0)
                if arm is not None:
                    fault = _check_carried_clearance(context, model, values, axis, motion, limit)
                elif table is not None:
                    fault = _check_stock_clearance(model, table, tilt, axis, motion, limit)
            if fault:
                findings.add(prefix + fault, arm=arm)
            values = {**values, axis.station_name: ends[1]}
        for axis, ends in _coordinated_tracks(context, index, setup):
            arm_on_track = setup.cell.arm(axis.station_name)
            model = models(index).with_bases(
                {arm_on_track.name: _base_pose(context, arm_on_track, {axis.station_name: ends[0]})}
            )
            motion = _base_motion(model, setup, axis, ends, limit)
            query_count += len(motion.samples)
            findings.note_lowest(
                motion.min_distance, f"{' and '.join(motion.pair)} at {axis.format_value(motion.at)}"
            )
            prefix = (
                f"coordinated motion of {axis.label} from {axis.format_value(ends[0])} to "
                f"{axis.format_value(ends[1])}: "
            )
            distance_text = (
                f"{' and '.join(motion.pair)} are {mm(motion.min_distance):.3f} mm apart at "
                f"{axis.format_value(motion.at)}"
            )
            fault = "" if motion.min_distance >= limit and motion.clear else distance_text
            move = AxisMove(axis=axis, ends=ends, values=values)
            fault = fault or _check_query_poses(context, setup.cell, index, move, motion)
            fault = fault or _check_carried_clearance(context, model, values, axis, motion, limit)
            if fault:
                findings.add(prefix + fault, arm=axis.station_name)
            end_value = context.problem.stations.get(setup.operations[0], {}).get(
                f"{axis.station_name}{END_SUFFIX}"
            )
            values = values if end_value is None else {**values, axis.station_name: end_value}
    findings.where += f", {query_count} queries"
    return findings.outcome(mm, "mm", limit, nothing="no track or turntable moves")


def _moving_axes(
    context: Context, index: int, setup: Setup, values: dict[str, float]
) -> list[tuple[TaskAxis, tuple[float, float]]]:
    """Return the axes that move from their current values to the station of setup ``index``.

    They are in the order in which the text moves them. Axes that keep their value are left out.

    Args:
        context: The proof.
        index: Index of the setup.
        setup: The setup.
        values: Values [m, rad] of all axes before the setup, by name.

    Returns:
        Each axis with its start and end value [m, rad].
    """
    table, moving = context.problem.cell.turntable, []
    for arm in setup.cell.arms:
        for axis in task_axes(arm, table):
            value = setup.axis_values.get(axis.station_name)
            if value is not None and abs(value - values[axis.station_name]) > AXIS_VALUE_TOLERANCE:
                moving.append(
                    (
                        _arrival(context, index, arm.name, axis, value),
                        axis,
                        (values[axis.station_name], value),
                    )
                )
    return [(axis, ends) for _, axis, ends in sorted(moving, key=lambda item: item[0])]


def _coordinated_tracks(
    context: Context, index: int, setup: Setup
) -> list[tuple[TaskAxis, tuple[float, float]]]:
    """Return the coordinated tracks that move in setup ``index``, none in a setup without operations.

    Each has the smallest and the largest value [m] at the targets of its arm's straight moves, clipped to its
    range.
    """
    out = []
    for task in context.job.tasks if setup.operations else ():
        for axis in task_axes(task.arm, None):
            values = [
                axis.scale * float(move.target.external[axis.column])
                for number, _, other, moves in context.moves()
                if other is task and int(context.spans.of_stage[number]) == index
                for move in moves
                if not move.by_joints and abs(move.target.external[axis.column]) < MAX_EXTERNAL_VALUE
            ]
            # verify.external_axes reports values beyond the range.
            if axis.follow_fraction is not None and values:
                low, high = np.clip([min(values), max(values)], axis.low, axis.high).tolist()
                out.append((axis, (low, high)))
    return out


def _base_pose(context: Context, arm: Arm, values: Mapping[str, float]) -> FloatArray:
    """Return the base pose (4, 4) of an arm in the world at ``values`` [m] by name of the axes that carry it.

    It is the base at value 0 plus the translations of the axes, independent of the planner.
    """
    out = np.array(context.bases[arm.name])
    out[:3, 3] += axis_translation(arm, values)
    return out


def _base_motion(
    model: CellModel, setup: Setup, axis: TaskAxis, ends: tuple[float, float], limit: float
) -> AxisMotionCheck:
    """Measure distances while the base of a coordinated track moves between ``ends`` [m] in a setup.

    All arms are at home. Only the distances of the base, and of bodies that the track carries, from
    stationary bodies are measured. The rest of the arm is checked while it works (verify.clearance).
    """
    homes = {other.name: other.home for other in setup.cell.arms}
    bodies = sorted({solid.body for solid in model.solids})
    # The usual query ignores all pairs. The check still measures what moves against what stands still.
    all_pairs = frozenset(map(frozenset, itertools.combinations(bodies, 2)))
    return external_axis_motion.check_linear_motion(model, axis.station_name, ends, homes, limit, all_pairs)


def _arrival(context: Context, index: int, arm: str, axis: TaskAxis, value: float) -> tuple[int, int]:
    """Return the number of the stage, and the index of the move in it, with which an axis reaches a value.

    Axes are sorted by it. It is the first such move of the arm in setup ``index``. If there is none, the
    number is that after the last stage, so that the axis comes last.
    """
    for number, _, task, moves in context.moves():
        if task.arm.name == arm and int(context.spans.of_stage[number]) == index:
            values = [axis.scale * float(move.target.external[axis.column]) for move in moves]
            arrived = [k for k, reached in enumerate(values) if abs(reached - value) <= AXIS_VALUE_TOLERANCE]
            if arrived:
                return number, arrived[0]
    return len(context.job.stages), 0


def _model_before(context: Context, model: CellModel, setup: Setup, values: dict[str, float]) -> CellModel:
    """Return the model of a setup with all axes at ``values``, as they are before one of them moves.

    Args:
        context: The proof.
        model: Model of the cell, with the axes at the station of the setup.
        setup: The setup.
        values: Values [m, rad] of all axes before the motion, by name.
    """
    arms_on_axes = [arm for arm in setup.cell.arms if arm.linear_axes]
    model = model.with_bases({arm.name: _base_pose(context, arm, values) for arm in arms_on_axes})
    motions = carried_motions(setup.cell, values, setup.axis_values)
    model = model.with_axis_motions(
        {name: body_motion @ model.axis_motion(name) for name, body_motion in motions.items()}
    )
    table = setup.cell.turntable
    table_values = {} if table is None else {name: setup.stock.axis_values[name] for name in table.axes}
    return (
        external_axis_motion.model_at_values(
            model, {name: values[name] for name in table_values}, table_values
        )
        if table_values
        else model
    )


def _axis_motion(model: CellModel, setup: Setup, move: AxisMove, limit: float) -> AxisMotionCheck:
    """Measure distances while one axis moves from station to station, with all arms at home.

    Args:
        model: Model of the cell before the motion (:func:`_model_before`).
        setup: Setup to which the axes move.
        move: Motion of the axis.
        limit: Required clearance [m].
    """
    axis, ends = move.axis, move.ends
    homes = {other.name: other.home for other in setup.cell.arms}
    table = setup.cell.turntable
    if table is not None and axis.station_name in table.axes:
        return external_axis_motion.check_rotary_motion(
            model, axis.station_name, move.values.get(TILT_AXIS, 0.0), ends, homes, limit
        )
    self_pairs = self_clearance_pairs(model)  # checked by verify.own_clearance, and unchanged by the motion
    return external_axis_motion.check_linear_motion(model, axis.station_name, ends, homes, limit, self_pairs)


def _check_query_poses(
    context: Context, cell: Cell, index: int, move: AxisMove, motion: AxisMotionCheck
) -> str:
    """Check that the distance queries used the right poses of carried bodies, over the whole motion.

    The expected poses are computed from the axis values by sums and rotations, without the planner's code.

    Args:
        context: The proof.
        cell: Cell of the model.
        index: Index of the setup.
        move: Motion of the axis as the programs state it.
        motion: The motion with its queries.

    Returns:
        The fault as a text, "" if there is none.
    """
    axis, ends, values = move.axis, move.ends, move.values
    first, last = motion.samples[0].value, motion.samples[-1].value
    if abs(first - ends[0]) > AXIS_VALUE_TOLERANCE or (
        motion.clear and abs(last - ends[1]) > AXIS_VALUE_TOLERANCE
    ):
        return f"distances were measured only from {axis.format_value(first)} to {axis.format_value(last)}"
    table, zero_pose = context.problem.cell.turntable, zero_stock_pose(context, index)
    if axis.arm is not None:
        return _check_carried_poses(context, cell, cell.arm(axis.arm), values, axis, motion)
    at_zero = {body.name: body for body in context.problem.cell.obstacles}
    in_setup = {body.name: body for body in cell.obstacles}
    if table is None:
        return "no turntable is stated"
    # Poses are compared by four points: the origin and the ends of the three unit vectors.
    tips = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    for query in motion.samples:
        current = {**values, axis.station_name: query.value}
        for name, pose in query.poses.items():
            if name in in_setup and table.tilt is not None:
                deviation = 0.0
                for shape, shape_in_setup in zip(at_zero[name].shapes, in_setup[name].shapes, strict=True):
                    expected = rotated_points(table.tilt, current[TILT_AXIS], transform(shape.pose, tips))
                    deviation = max(
                        deviation, float(np.abs(expected - transform(pose @ shape_in_setup.pose, tips)).max())
                    )
                is_wrong = deviation > FRAME_TOLERANCE_M
            elif zero_pose is None:
                return "the pose of the block is not stated"
            else:
                deviation, angle = stock_deviation(
                    table, zero_pose, (current[STOCK_AXIS], current.get(TILT_AXIS, 0.0)), pose
                )
                is_wrong = deviation > 2.0 * FRAME_TOLERANCE_M or angle > 2.0 * FRAME_TOLERANCE_RAD
            if is_wrong:
                return (
                    f"distances of {name} were measured at a wrong pose for {axis.format_value(query.value)}"
                )
    return ""


def _check_carried_poses(
    context: Context,
    cell: Cell,
    arm: Arm,
    values: Mapping[str, float],
    axis: TaskAxis,
    motion: AxisMotionCheck,
) -> str:
    """Check that the distance queries for an axis under an arm used the right poses.

    The poses are those of the arm's base and of all bodies that the axis, or an axis on it, carries. The
    expected pose is that of the problem at value 0, moved by the sum of all values times their directions.

    Args:
        context: The proof.
        cell: Cell of the model.
        arm: Arm on the axis.
        values: Values [m, rad] of all axes before the motion, by name.
        axis: Axis that moves.
        motion: The motion with its queries.

    Returns:
        The fault as a text, "" if there is none.
    """
    # axes_by_name lists the axes from the floor up, so later axes are carried by earlier ones.
    foot, names = f"{arm.name}/base_link", list(arm.axes_by_name)
    carried = {
        body
        for axis_name in names[names.index(axis.station_name) :]
        for body in arm.axes_by_name[axis_name].carries
    }
    in_setup = {body.name: body for body in cell.obstacles}
    for query in motion.samples:
        current = {**values, axis.station_name: query.value}
        if missing := {foot, *carried} ^ set(query.poses):  # bodies that are in only one of both sets
            return f"distances were measured without {', '.join(sorted(missing))}"
        deviation = float(np.abs(query.poses[foot] - _base_pose(context, arm, current)).max())
        if deviation > AXIS_VALUE_TOLERANCE:
            return f"distances of the base were measured at a wrong pose for {axis.format_value(query.value)}"
        for name, expected in _carried_shapes(context, arm, current).items():
            if name in carried:
                measured_poses = np.stack([query.poses[name] @ shape.pose for shape in in_setup[name].shapes])
                if float(np.abs(measured_poses - expected).max()) > POSE_TOLERANCE:
                    return (
                        f"distances of {name} were measured at a wrong pose for "
                        f"{axis.format_value(query.value)}"
                    )
    return ""


def _carried_shapes(context: Context, arm: Arm, values: Mapping[str, float]) -> dict[str, FloatArray]:
    """Return the expected poses of the shapes of bodies that the axes of an arm carry.

    Poses that the planner uses are compared with them.

    Args:
        context: The proof.
        arm: The arm.
        values: Values [m] of its axes by name.

    Returns:
        Poses {body: (K, 4, 4)} in the world of the K shapes of each body: those of the problem, moved by the
        sum of the axis motions.
    """
    zero = {body.name: body for body in context.problem.cell.obstacles}
    out = {}
    for axis_name, rail in arm.axes_by_name.items():
        for name in rail.carries:
            out[name] = np.stack([shape.pose for shape in zero[name].shapes])
            out[name][:, :3, 3] += axis_translation(arm, values, axis_name)
    return out


def _check_model_poses(context: Context, model: CellModel, setup: Setup) -> Iterator[str]:
    """Check the poses of bodies that linear axes carry in the model of a setup, and yield faults as texts.

    They are checked both in the proof's model and in Drake, which measures some of the distances. Each body
    is reported at most once.
    """
    model_poses = model.poses({})
    drake = model.checker.UpdatePositions(np.concatenate([model.cell.arm(a).home for a in model.arms]))
    in_setup = {body.name: body for body in model.cell.obstacles}
    for arm in setup.cell.arms:
        for name, expected in _carried_shapes(context, arm, arm.axis_values).items():
            drake_pose = model.plant.EvalBodyPoseInWorld(drake, model.body(name)).GetAsMatrix4()
            for pose in (model_poses[name][0], np.asarray(drake_pose)):
                shape_poses = np.stack([pose @ shape.pose for shape in in_setup[name].shapes])
                if float(np.abs(shape_poses - expected).max()) > POSE_TOLERANCE:
                    yield f"{name} is not where the axes under it put it in setup {setup.number}"
                    break


def _check_carried_clearance(
    context: Context,
    model: CellModel,
    values: Mapping[str, float],
    axis: TaskAxis,
    motion: AxisMotionCheck,
    limit: float,
) -> str:
    """Check that all bodies that a linear axis carries keep ``limit`` [m] from stationary bodies.

    Pairs of a carried shape and its support are left out, because they touch:

    - The base of the arm: shapes of obstacles that end at or below its foot, up to
      :data:`MAX_SUPPORT_ABOVE_FOOT_M` above it. The foot stays in a plane along the motion. If the z axis of
      the base is nearly along the motion (:data:`MIN_UPRIGHT_PART`), there is no such foot, and nothing is
      left out.
    - Other carried bodies: shapes of obstacles along which they slide over the whole range of the axis.

    If the axis is not horizontal, the bodies must also keep ``limit`` from the floor at both ends of the
    motion. The base may stand on the floor.

    Args:
        context: The proof.
        model: Model of the cell before the motion.
        values: Values of all axes before the motion.
        axis: Axis that moves.
        motion: The motion with its queries.
        limit: Required clearance [m].

    Returns:
        Text about the first bodies that come too close, or whose distance no line proves, "" if there are
        none.
    """
    arm, foot = model.cell.arm(str(axis.arm)), f"{axis.arm}/base_link"
    direction = np.array(axis.direction)
    names = list(arm.axes_by_name)
    carried_names = {
        foot,
        *(body for on in names[names.index(axis.station_name) :] for body in arm.axes_by_name[on].carries),
    }
    carried = [solid for solid in model.solids if solid.body in carried_names]
    still, still_poses = stationary_solids(model, carried_names)
    if not carried:
        return ""
    on_axis = {body: on for on, rail in arm.axes_by_name.items() for body in rail.carries}
    # Translations of the bodies in the cell of the model, by the axis that carries them.
    model_shifts = {name: axis_translation(arm, arm.axis_values, name) for name in names}

    def placed(query: AxisSample) -> list[FloatArray]:
        """Return the poses (4, 4) of the carried shapes at a query."""
        current = {**values, axis.station_name: query.value}
        base, out = _base_pose(context, arm, current), []
        for solid in carried:
            pose = np.array(solid.shape.pose)
            if solid.body == foot:
                pose = base @ pose
            else:
                pose[:3, 3] += (
                    axis_translation(arm, current, on_axis[solid.body]) - model_shifts[on_axis[solid.body]]
                )
            out.append(pose)
        return out

    start_poses = placed(motion.samples[0])
    base = _base_pose(context, arm, dict(values))
    # Upward direction of the base: the part of its z axis perpendicular to the motion.
    up = base[:3, 2] - (base[:3, 2] @ direction) * direction
    length = float(np.linalg.norm(up))
    up = up / max(length, MIN_UPRIGHT_PART)
    feet = [
        -extent(s.shape, pose, -up) for s, pose in zip(carried, start_poses, strict=True) if s.body == foot
    ]
    bodies = {body.name for body in model.cell.obstacles} if length >= MIN_UPRIGHT_PART else set()
    max_height = min(feet, default=0.0) + MAX_SUPPORT_ABOVE_FOOT_M + DISTANCE_TOLERANCE_M
    below_foot = np.array(
        [
            solid.body in bodies and extent(solid.shape, pose, up) <= max_height
            for solid, pose in zip(still, still_poses, strict=True)
        ],
        dtype=bool,
    )
    # Bodies that may support others: obstacles that no axis of another arm carries.
    supports = {body.name for body in model.cell.obstacles}
    supports -= {
        name
        for other_arm in model.cell.arms
        if other_arm != arm
        for linear_axis in other_arm.linear_axes
        for name in linear_axis.carries
    }
    start_value = motion.samples[0].value
    travel = axis.low - start_value, axis.high - start_value  # over the axis' range, not only this motion
    left_out = np.zeros((len(carried), len(still)), bool)
    for i, solid_a in enumerate(carried):
        if solid_a.body == foot:
            left_out[i] = below_foot
        else:
            left_out[i] = [
                solid_b.body in supports
                and slides_along((solid_a.shape, start_poses[i]), (solid_b.shape, pose), direction, travel)
                for solid_b, pose in zip(still, still_poses, strict=True)
            ]
    if abs(direction[2]) > MAX_LEVEL_HEIGHT:
        floor = floor_height(model.cell)
        for query in (motion.samples[0], motion.samples[-1]):
            for solid, pose in zip(carried, placed(query), strict=True):
                height = -extent(solid.shape, pose, np.array([0.0, 0.0, -1.0])) - floor
                if (
                    height
                    < (limit if solid.body != foot else -MAX_SUPPORT_ABOVE_FOOT_M) - DISTANCE_TOLERANCE_M
                ):
                    return (
                        f"{solid.body} is {mm(height):.3f} mm above the floor at "
                        f"{axis.format_value(query.value)}"
                    )
    moving = CarriedSolids(solids=carried, poses_at=placed, lever=1.0)
    return unproven_clearance(axis, motion, moving, (still, still_poses), left_out, limit)


def _check_stock_clearance(
    model: CellModel, table: Turntable, tilt: float, axis: TaskAxis, motion: AxisMotionCheck, limit: float
) -> str:
    """Check that the bodies that a turn axis or tilt axis carries keep ``limit`` [m] from stationary bodies.

    The poses of carried bodies are those of the queries. These pairs are left out, because they touch or
    nearly touch:

    - While the turn axis moves: all pairs with the plate of the turntable, which supports the block.
    - While the tilt axis moves: pairs of a carried shape and a stationary shape if one of them is round about
      the axis, or if one follows the other along the axis within a bearing's gap. No tilt brings these
      closer. This exception does not apply to the block and its support (``TURNTABLE_BODIES``).

    Args:
        model: Model of the cell before the motion.
        table: Turntable or positioner.
        tilt: Value [rad] of the tilt axis before the motion.
        axis: Axis that moves.
        motion: The motion with its queries.
        limit: Required clearance [m].

    Returns:
        Text about the first bodies that come too close, or whose distance no line proves, "" if there are
        none.
    """
    pivot = table.axes[axis.station_name]
    ends = np.stack([pivot.centre, pivot.centre + pivot.axis])
    if axis.station_name == STOCK_AXIS and table.tilt is not None:
        ends = rotated_points(table.tilt, tilt, ends)
    centre, along = ends[0], ends[1] - ends[0]
    carried_names = set(motion.samples[0].poses)
    carried = [solid for solid in model.solids if solid.body in carried_names]
    still, still_poses = stationary_solids(
        model, carried_names if axis.station_name == TILT_AXIS else {*carried_names, TURNTABLE_BODY}
    )
    if not carried or not still:
        return ""

    def placed(query: AxisSample) -> list[FloatArray]:
        """Return the poses (4, 4) of the carried shapes at a query."""
        return [query.poses[solid.body] @ solid.shape.pose for solid in carried]

    start_poses = placed(motion.samples[0])
    left_out = np.zeros((len(carried), len(still)), bool)
    for i, solid_a in enumerate(carried if axis.station_name == TILT_AXIS else ()):
        for j, solid_b in enumerate(
            still if solid_a.body not in external_axis_motion.TURNTABLE_BODIES else ()
        ):
            gap_after = -extent(solid_a.shape, start_poses[i], -along) - extent(
                solid_b.shape, still_poses[j], along
            )
            gap_before = -extent(solid_b.shape, still_poses[j], -along) - extent(
                solid_a.shape, start_poses[i], along
            )
            left_out[i, j] = (
                -DISTANCE_TOLERANCE_M < max(gap_after, gap_before) < external_axis_motion.MAX_STANDING_GAP_M
            )
            left_out[i, j] |= any(
                is_round_about(s.shape, at, centre, along)
                for s, at in ((solid_a, start_poses[i]), (solid_b, still_poses[j]))
            )
    tips = np.concatenate(
        [transform(at, hull_points(s.shape)) for s, at in zip(carried, start_poses, strict=True)]
    )
    # Lever [m/rad]: largest distance of a carried point from the axis.
    lever = float(np.linalg.norm(np.cross(tips - centre, along), axis=1).max())
    moving = CarriedSolids(solids=carried, poses_at=placed, lever=lever)
    return unproven_clearance(axis, motion, moving, (still, still_poses), left_out, limit)
