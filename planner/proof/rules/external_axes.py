"""verify.external_axes: tracks and gantries under arms, and a turntable or positioner under the block.

The rule checks from the text which task moves them, their units and values, that arms are folded, and the
resulting pose of the block. All other rules take the poses of arms and block from here. Motions from
station to station are proven by verify.track_way.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from planner.geometry.arrays import FloatArray, hull_points, transform
from planner.issues import Issue
from planner.problem import STOCK_AXIS, TILT_AXIS, RotaryAxis, Setup, Turntable
from planner.programs.stages import TaskText
from planner.programs.steps import MAX_EXTERNAL_VALUE, UNUSED_AXIS, MoveStep, RobTarget, SettingStep
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import (
    AXIS_VALUE_TOLERANCE,
    TaskAxis,
    axis_translation,
    motion_order,
    task_axes,
)
from planner.proof.language_contribution import AxisFormat, check_task, language_of_task
from planner.proof.rule import RuleOutcome, mm, rule, step_issue
from planner.proof.rules.setups_and_frames import FRAME_TOLERANCE_M, FRAME_TOLERANCE_RAD, at_home

BLIND_AXIS_SPEED_M_S = 0.25
"""Maximum speed [m/s] of a track, and of all that a turntable carries, because people may be near."""
SPEED_SLACK_FACTOR = 1.0 + 1e-6
"""Ratio of a speed to its limit that is allowed, because speeds are rounded."""
HOME_TOLERANCES = {"mm": 1.0, "deg": 0.1}
"""Maximum distance of an axis from home where a program starts, by the unit of its values."""
EXTERNAL_AXES = "verify.external_axes"
"""Code of the rule on external axes."""


def with_text_stations(context: Context) -> Context:
    """Return a context whose problem has the stations (axis values) of the programs' text.

    All rules after verify.external_axes then use the axis values that the programs drive. The context is
    returned unchanged if the programs cannot be replayed or state no axis values.
    """
    if not context.is_replayable or not context.stations:
        return context
    return context.with_changes(context.problem.with_stations(context.stations))


@rule("verify.external_axes")
def external_axes(context: Context) -> RuleOutcome:
    """Tracks, gantries, turntables and positioners are driven as planned.
    An axis is activated once (RAPID), before anything moves, with axis offsets switched off. It is
    checked right before the first move, which does not run unless the axis is at home. Each target has a
    value of each axis, within its range. An axis moves as the first thing of a setup, alone, its load at
    most at 250 mm/s, with all arms folded at home, and is at home at the end. Block and carried bodies
    are where the values put them. A positioner's turn axis moves before its tilt axis. Gantry axes that
    come nearer to home move first, from the arm down, then the others, from the floor up. A coordinated
    track moves in straight moves, too.
    """
    issues: list[Issue] = []
    axis_notes = []
    table = context.problem.cell.turntable
    for task in context.job.tasks:
        axes = task_axes(task.arm, table)
        issues += check_task(EXTERNAL_AXES, context, task).issues
        if axes:
            issues += _check_home_checks(context, task, axes)
            issues += _check_values(context, task, axes)
        for axis in axes:
            where = ", ".join(axis.format_value(v) for v in dict.fromkeys(_axis_values(context, axis)))
            axis_notes.append(f"{axis.label} ({task.arm.name}) at {where}")
    if table is not None:
        issues += _check_table_arm(context, table)
        issues += _check_stock_on_table(context, table)
    issues += _check_carried_bodies(context)
    nothing = "" if axis_notes else "no track or gantry under an arm, no turntable under the block"
    return RuleOutcome(tuple(issues), where="; ".join(axis_notes), nothing=nothing)


def _axis_values(context: Context, axis: TaskAxis) -> list[float]:
    """Return the values [m, rad] of an axis in the setups that have one."""
    values = (setup.axis_values.get(axis.station_name) for setup in context.setups)
    return [value for value in values if value is not None]


def _check_home_checks(context: Context, task: TaskText, axes: Sequence[TaskAxis]) -> Iterator[Issue]:
    """Report axes whose home position a program does not check right before its first move.

    The check ensures that they are at home, so that this move does not move them. Only settings that do not
    stop the program may come between check and move, but not the deactivation of a unit.
    """
    steps = list(task.steps)
    first = next((i for i, step in enumerate(steps) if isinstance(step, MoveStep)), len(steps))
    checks: list[SettingStep] = []
    for step in reversed(steps[:first]):
        if not isinstance(step, SettingStep) or step.stops or step.kind == "DeactUnit":
            break
        checks.append(step)
    for axis in axes:
        is_checked = any(
            language_of_task(task).external_axes.checks_home(context, axis, check) for check in checks
        )
        if not is_checked:
            message = (
                f"an arm moves, but the program does not check right before that {axis.label} is at home"
            )
            move = steps[first] if first < len(steps) else None
            yield step_issue(EXTERNAL_AXES, f"{message} ({axis.format_value(axis.home)})", task, move)


def _check_values(context: Context, task: TaskText, axes: Sequence[TaskAxis]) -> Iterator[Issue]:
    """Check the values of a task's external axes, and the moves in which they change, in order.

    After a target without valid values, the check of the task ends. A station-to-station move is allowed if

    - its arm is at home before and after it, and the axis is not too fast (:func:`_check_axis_move`);
    - no other arm moves with it, and all other arms are at home since the operator's confirmation;
    - the operator has confirmed to keep clear in this setup, and only axes have moved since;
    - one axis moves at a time, each once per setup, in the prescribed order (:func:`motion_order`).

    The first move of the task must leave the axes at home, and the last one must end there. Coordinated
    tracks are exempt in straight moves, which verify.track_along checks.
    """
    previous: MoveStep | None = None
    moved: set[TaskAxis] = set()  # axes that moved in this setup
    last = {axis.column: axis.home for axis in axes}
    previous_stage, setup_index = -1, -1
    is_clear = False  # whether the operator has confirmed to keep clear, and only axes have moved since
    confirmation_stage = 0  # stage of the last confirmation before the axes move
    done_orders: list[tuple[int, int]] = []  # prescribed order of the axes that moved in this setup
    for number, stage in enumerate(context.job.stages):
        index = int(context.spans.of_stage[number])
        for move in stage.moves(task.name):
            target_fault = _target_fault(move, axes, language_of_task(task).external_axes)
            if target_fault:
                yield step_issue(EXTERNAL_AXES, target_fault, task, move)
                return  # later poses are unknown
            values = {axis: axis.scale * float(move.target.external[axis.column]) for axis in axes}
            coordinated = [axis for axis in axes if axis.follow_fraction is not None and not move.by_joints]
            changed = [axis for axis in axes if abs(values[axis] - last[axis.column]) > AXIS_VALUE_TOLERANCE]
            # coordinated: tracks that follow the tool in this straight move (verify.track_along checks them).
            moving = [axis for axis in changed if axis not in coordinated]
            if index != setup_index:
                done_orders, moved, is_clear, setup_index = [], set(), False, index
            confirmation_stages = [
                question.stage
                for question in context.spans.confirmations[index]
                if previous_stage < question.stage < number
            ]
            is_clear = is_clear or bool(confirmation_stages)
            confirmation_stage = max(confirmation_stages, default=confirmation_stage)
            orders = [motion_order(axes, axis, last[axis.column], values[axis]) for axis in moving]
            is_in_order = (
                is_clear
                and not moved & set(moving)
                and (not done_orders or all(done_orders[-1] < order for order in orders))
            )
            done_orders, moved = [*done_orders, *orders], moved | set(moving)
            is_clear = is_clear and bool(moving)  # no other move may come between confirmation and axis moves
            if len(moving) > 1:
                message = (
                    f"{' and '.join(axis.label for axis in moving)} move at the same time, not one by one"
                )
                yield step_issue(EXTERNAL_AXES, message, task, move)
            for axis in axes:
                value = values[axis]
                is_moving = axis in moving
                if previous is None or is_moving:
                    is_announced = previous is None or is_in_order
                    for fault in _check_axis_move(context, task, axis, previous, move):
                        yield step_issue(EXTERNAL_AXES, fault, task, move)
                    if stage.synchronised:
                        yield step_issue(
                            EXTERNAL_AXES, f"{axis.label} moves together with other arms", task, move
                        )
                    if not is_announced:
                        message = (
                            f"{axis.label} moves within setup {index + 1} without a confirmation to keep "
                            "clear"
                        )
                        message += ", or out of order" if len(axes) > 1 else ""
                        yield step_issue(EXTERNAL_AXES, message, task, move)
                if is_moving:
                    for other in _arms_away_from_home(context, task, number, confirmation_stage):
                        yield step_issue(EXTERNAL_AXES, f"{axis.label} moves while {other}", task, move)
                if previous is None and is_moving:
                    message = f"the first move takes {axis.label} to {axis.format_value(value)}, not home "
                    yield step_issue(EXTERNAL_AXES, f"{message}({axis.format_value(axis.home)})", task, move)
                # Otherwise keep the last value, so that small changes do not add up.
                if previous is None or is_moving or axis in coordinated:
                    last[axis.column] = value
            previous, previous_stage = move, number
    for axis in axes:
        if abs(last[axis.column] - axis.home) > AXIS_VALUE_TOLERANCE:
            message = (
                f"the program ends with {axis.label} at {axis.format_value(last[axis.column])}, not at home "
            )
            yield Issue(
                EXTERNAL_AXES, f"{message}({axis.format_value(axis.home)})", arm=task.arm.name, file=task.name
            )


def _check_axis_move(
    context: Context, task: TaskText, axis: TaskAxis, previous: MoveStep | None, move: MoveStep
) -> Iterator[str]:
    """Check that the arm is at home before and after a move of an external axis, and the axis' speed.

    The arm is at home before it if move ``previous`` ends there; None stands for the first move. The speed is
    positive and at most that of the axis. It is also at most 250 mm/s, for a rotary axis at the farthest
    point that it carries. Faults are yielded as texts.
    """
    ends = [end for end in (previous, move) if end is not None]
    if not all(at_home(end, task.arm.data, task.arm.home) for end in ends):
        yield f"{axis.label} moves while {task.arm.name} is not at home"
    table = context.problem.cell.turntable
    if axis.station_name in (STOCK_AXIS, TILT_AXIS) and table is not None:
        radius = max((_max_radius(s, table, axis.station_name) for s in context.setups), default=0.0)
        max_speed = min(BLIND_AXIS_SPEED_M_S / max(radius, 1e-3), axis.speed)
    else:
        max_speed = min(BLIND_AXIS_SPEED_M_S, axis.speed)
    speed = axis.speed_in(move)
    if not 0.0 < speed <= max_speed * SPEED_SLACK_FACTOR:
        yield f"{axis.label} moves at {axis.format_value(speed)}/s; allowed: {axis.format_value(max_speed)}/s"


def _arms_away_from_home(context: Context, task: TaskText, number: int, since: int) -> Iterator[str]:
    """Report arms other than that of ``task`` that are away from home while an axis moves, as texts.

    An arm is at home in stage ``number`` if its last move before that stage ends at home, and all its moves
    in that stage, too. An arm without an earlier move counts as away from home. All moves of an arm since
    stage ``since``, that of the operator's confirmation, must end at home, because from there on all other
    rules assume that the axes are at their new stations.
    """
    stages = context.job.stages
    for other in context.job.tasks:
        if other.name == task.name:
            continue
        earlier = [move for stage in stages[:number] for move in stage.moves(other.name)[-1:]]
        moves = [*earlier[-1:], *stages[number].moves(other.name)]
        between = [move for stage in stages[since:number] for move in stage.moves(other.name)]
        if not earlier or not all(at_home(move, other.arm.data, other.arm.home) for move in moves):
            yield f"{other.arm.name} is not at home"
        elif not all(at_home(move, other.arm.data, other.arm.home) for move in between):
            yield f"{other.arm.name} has left home since the confirmation"


def _target_fault(move: MoveStep, axes: Sequence[TaskAxis], axis_format: AxisFormat) -> str:
    """Return the fault of the external axes of one target as a text, "" if there is none.

    Args:
        move: Move to the target.
        axes: Axes that the task moves.
        axis_format: How the language states external axes.
    """
    external, names = move.target.external, " and ".join(axis.label for axis in axes)
    others = np.delete(external, [axis.column for axis in axes])
    unused = np.abs(others - UNUSED_AXIS) <= 1e3  # 9E9 stands for no axis; the text may round it
    if not np.isfinite(external).all() or not (unused | (axis_format.zero_is_unused & (others == 0.0))).all():
        return f"the target has values for axes other than {names}, which do not exist"
    for axis in axes:
        value = float(external[axis.column])
        if abs(value) >= MAX_EXTERNAL_VALUE:
            return f"the target has no value of {axis.label} ({axis_format.names[axis.column]})"
        position = axis.scale * value
        if not axis.low - AXIS_VALUE_TOLERANCE <= position <= axis.high + AXIS_VALUE_TOLERANCE:
            span = f"{axis.format_value(axis.low)} to {axis.format_value(axis.high)}"
            return f"{axis.label} at {axis.format_value(position)}; its range is {span}"
    if move.by_joints and isinstance(move.target, RobTarget):
        return f"{names} moves in a move to a pose; use a joint target"
    return ""


# ---- gantries ----


def _check_carried_bodies(context: Context) -> Iterator[Issue]:
    """Report bodies that, in the cell of a setup, are not where the axes under arms carry them.

    The expected pose is that of the problem, with the axes at 0, moved by the sum of the axis motions. It is
    computed independently of the planner.
    """
    at_zero = {body.name: body for body in context.problem.cell.obstacles}
    for index, setup in enumerate(context.setups):
        in_setup = {body.name: body for body in setup.cell.obstacles}
        for arm in setup.cell.arms:
            for axis_name, rail in arm.axes_by_name.items():
                for name in rail.carries:
                    shift = axis_translation(arm, arm.axis_values, axis_name)
                    # Distance of the positions [m] plus difference of the rotations, which must be 0.
                    deviation = max(
                        float(np.abs(a.pose[:3, 3] + shift - b.pose[:3, 3]).max())
                        + float(np.abs(a.pose[:3, :3] - b.pose[:3, :3]).max())
                        for a, b in zip(at_zero[name].shapes, in_setup[name].shapes, strict=True)
                    )
                    if deviation > AXIS_VALUE_TOLERANCE:
                        message = f"{name} is not where {rail.label} carries it in setup {index + 1}"
                        yield Issue(EXTERNAL_AXES, message, arm=arm.name)


# ---- turntables ----


def _check_table_arm(context: Context, table: Turntable) -> Iterator[Issue]:
    """Report a turntable whose arm has no program."""
    if all(task.arm.name != table.arm for task in context.job.tasks):
        message = f"{table.unit} is moved by the program of {table.arm}, which is missing"
        yield Issue(EXTERNAL_AXES, message, arm=table.arm)


def _check_stock_on_table(context: Context, table: Turntable) -> Iterator[Issue]:
    """Report blocks and tilted bodies that are not where the axis values of the text put them.

    The rotations are computed independently, with quaternions, from the poses in the problem at value 0. A
    setup for which the text or the problem does not state the values or the pose is reported, too.
    """
    for index, setup in enumerate(context.setups):
        zero_pose = zero_stock_pose(context, index)
        # In a setup without operations, after all others, the axes are at home.
        stock_pose, value = context.stock_frames[index], table.home
        tilt = 0.0 if table.tilt is None else table.tilt.home
        for number in setup.operations:
            value = context.stations.get(number, {}).get(STOCK_AXIS, np.nan)
            tilt = context.stations.get(number, {}).get(TILT_AXIS, tilt if table.tilt is None else np.nan)
        if zero_pose is None or stock_pose is None or not np.isfinite(value + tilt):
            message = f"the programs do not state the position of {table.unit} in setup {index + 1}"
            yield Issue(EXTERNAL_AXES, message, hint=f"state a value of {table.unit} in each target")
            continue
        distance, angle = stock_deviation(table, zero_pose, (value, tilt), stock_pose)
        # Twice the tolerance: both frames are rounded.
        if distance > 2.0 * FRAME_TOLERANCE_M or angle > 2.0 * FRAME_TOLERANCE_RAD:
            shown = " and ".join(f"{np.rad2deg(v):g}" for v in (value, tilt)[: len(table.axes)])
            message = f"{table.unit} at {shown} deg puts the block {mm(distance):.4f} mm and "
            message += f"{np.rad2deg(angle):.4f} deg away from its frame in setup {index + 1}"
            yield Issue(EXTERNAL_AXES, message, value=mm(distance), limit=mm(FRAME_TOLERANCE_M), unit="mm")
        for name in _misplaced_bodies(context, setup, table, tilt):
            message = (
                f"{name} is not where {table.unit} at {np.rad2deg(tilt):g} deg puts it in setup {index + 1}"
            )
            yield Issue(EXTERNAL_AXES, message)


def zero_stock_pose(context: Context, index: int) -> FloatArray | None:
    """Return the pose (4, 4) of the block with all axes at 0, as the problem states it for setup ``index``.

    It is that of the last change of the stock up to this setup, else that of the problem, None without any.
    """
    pose = context.problem.stock.place
    for setup in context.setups[: index + 1]:
        for number in setup.operations:
            change = context.problem.changes.get(number)
            pose = pose if change is None else change.stock.get("place", pose)
    return pose


def _misplaced_bodies(context: Context, setup: Setup, table: Turntable, tilt: float) -> Iterator[str]:
    """Yield the names of tilted bodies whose poses in a setup do not follow from the tilt [rad]."""
    in_setup = {body.name: body for body in setup.cell.obstacles}
    for body in context.problem.cell.obstacles:
        if table.tilt is not None and body.name in table.tilted_bodies:
            for zero_shape, shape in zip(body.shapes, in_setup[body.name].shapes, strict=True):
                tips = np.concatenate([np.zeros((1, 3)), np.eye(3)])
                expected = rotated_points(table.tilt, tilt, transform(zero_shape.pose, tips))
                if np.abs(expected - transform(shape.pose, tips)).max() > FRAME_TOLERANCE_M:
                    yield body.name


def stock_deviation(
    table: Turntable, zero_pose: FloatArray, values: tuple[float, float], stock_pose: FloatArray
) -> tuple[float, float]:
    """Return the deviation of the block from the pose in which a turntable or positioner puts it.

    The expected pose is the one at values 0, rotated about the turn axis and then about the tilt axis.

    Args:
        table: Turntable or positioner.
        zero_pose: Pose (4, 4) of the block with the axes at 0.
        values: Values [rad] of turn and tilt axis.
        stock_pose: Pose (4, 4) of the block.

    Returns:
        Distance [m] of the origins, and approximate angle [rad] from the differences of the unit vectors. A
        rotation by a small angle t moves the ends of three unit vectors by sqrt(2) t together.
    """
    tips = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    expected = zero_pose[:3, 3] + tips @ zero_pose[:3, :3].T
    expected = rotated_points(table, values[0], expected)
    expected = expected if table.tilt is None else rotated_points(table.tilt, values[1], expected)
    difference = expected - (stock_pose[:3, 3] + tips @ stock_pose[:3, :3].T)
    axis_ends = difference[1:] - difference[0]
    return float(np.linalg.norm(difference[0])), float(np.linalg.norm(axis_ends) / np.sqrt(2.0))


def rotated_points(axis: RotaryAxis, value: float, points: FloatArray) -> FloatArray:
    """Rotate points (N, 3) by a value [rad] about an axis through its centre.

    With the unit quaternion q = (w, v), q p q* = p + 2 w (v x p) + 2 v x (v x p).
    """
    w, v = np.cos(0.5 * value), np.sin(0.5 * value) * axis.axis
    relative = points - axis.centre
    cross = np.cross(v, relative)
    return np.asarray(points + 2.0 * (w * cross + np.cross(v, cross)))


def _max_radius(setup: Setup, table: Turntable, name: str) -> float:
    """Return the largest distance [m] from rotary axis ``name`` to what it carries in a setup.

    It bounds the rotation speed.

    An axis carries block and support, and the tilt axis also the bodies that are tilted with them. All are
    measured with the tilt axis at 0, because tilting does not move the block farther from the turn axis. For
    the tilt axis, the block has the turn of the setup.
    """
    stock, stock_pose, axis = setup.stock, setup.stock.place, table.axes[name]
    if stock_pose is None:
        return 0.0
    box = np.stack([stock.lower, stock.upper])
    points = [np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3)]
    points += [transform(shape.pose, hull_points(shape)) for shape in stock.support]
    world_points = transform(stock_pose, np.concatenate(points))
    if table.tilt is not None:
        world_points = rotated_points(table.tilt, -(stock.tilt or 0.0), world_points)
        bodies = [body for body in setup.with_zero_tilt.cell.obstacles if body.name in table.tilted_bodies]
        tilted_points = [
            transform(shape.pose, hull_points(shape)) for body in bodies for shape in body.shapes
        ]
        world_points = np.concatenate([world_points, *tilted_points]) if name == TILT_AXIS else world_points
    along = (world_points - axis.centre) @ axis.axis
    across = world_points - axis.centre - along[:, None] * axis.axis
    return float(np.linalg.norm(across, axis=1).max())
