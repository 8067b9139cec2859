"""Rules on trajectory files: start of moves, tolerances, outputs on failure, and the path between points."""

import itertools
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, dots, exp_rotation, inverse, log_rotation
from planner.issues import Issue
from planner.languages.trajectories.reader.flow import columns, pose
from planner.languages.trajectories.reader.program_text import TrajectoryText
from planner.languages.trajectories.reader.rows import (
    AtRow,
    CarryRow,
    MayFail,
    MoveRow,
    OperationRow,
    SetRow,
    ToolRow,
    TrajectoryProgram,
    TrajectoryRow,
)
from planner.problem import Stock
from planner.programs.dialogue_text import panel_text
from planner.programs.stages import TaskText
from planner.programs.steps import PassedTarget
from planner.proof.context import Context
from planner.proof.kinematics.arm_model import robot_machine
from planner.proof.replay.standstill import (
    SAMPLES_PER_BATCH,
    first_sample_of_each_node,
    tool_in_holder_frame,
    work_nodes,
)
from planner.proof.replay.tool_speeds import STANDSTILL_M, tool_speeds
from planner.proof.replay.trajectory_speed import settling_fraction
from planner.proof.rule import RuleOutcome, mm, rule, sample_issue, step_issue
from planner.proof.rules.setups_and_frames import FRAME_TOLERANCE_M, HOME_TOLERANCE_RAD, MASS_TOLERANCE_KG

POSTURE_TOLERANCE_RAD: Final = 1e-9
"""Tolerance [rad] between two numbers for the same posture."""
CHECK_TOLERANCE_FACTOR: Final = 2.0
"""Maximum tolerance of the check before a move, relative to the goal tolerance."""
MAX_DEVIATION_M: Final = 0.1e-3
"""Maximum deviation [m] of a tool from the straight segment between two points."""
MAX_ROTATION_RAD: Final = float(np.deg2rad(0.1))
"""Maximum rotation [rad] of a tool from its orientation on this segment."""
MAX_SPEED_RATIO: Final = 1.55
"""Maximum speed of a tool between two points relative to the fastest mean of the three nearest intervals.

A cubic from rest to rest reaches 1.5 times its own mean.
"""
_MAX_BACKWARD_M: Final = 0.02e-3
"""Maximum distance [m] by which a tool may move backwards between two points."""
_ROUNDING_FACTOR: Final = 1.0 + 1e-6
"""Factor by which tolerances may exceed their limit, because they are rounded."""
_NOT_APPLICABLE: Final = "no trajectories"
"""Why the rules do not apply to jobs without trajectory files."""


def _programs(context: Context) -> Iterator[tuple[TaskText, TrajectoryProgram]]:
    """Yield each trajectory file with the task of its first arm."""
    for task in context.job.tasks:
        text = task.text
        if isinstance(text, TrajectoryText) and task.arm.name == text.program.arms[0].arm:
            yield task, text.program


def _row_issue(
    code: str, message: str, program: TrajectoryProgram, row: TrajectoryRow, hint: str | None = None
) -> Issue:
    return Issue(code, message, file=program.file, line=row.line, hint=hint)


def announcement_issues(context: Context) -> list[Issue]:
    """Return issues of rows that inform the operator incorrectly.

    - Each operation is announced once, in order, by name, setup and holder of the block.
    - Each tool is announced by name and mass.
    - Only tools, then the check of the joints, follow an operation or a tool.
    - Each move is in the setup that was announced last.
    - The operator is not asked twice in succession what one arm holds.
    """
    issues: list[Issue] = []
    setups = context.setups
    code = "verify.dialogue"
    expected = [
        (context.problem.operations[k].name, setup.number) for setup in setups for k in setup.operations
    ]
    for _, program in _programs(context):
        # number of the setup of each point of a move, by its line
        setup_by_line = {
            step.line: setups[int(context.spans.of_stage[number])].number
            for number, stage in enumerate(context.job.stages)
            for arm in program.arms
            for step in stage.moves(arm.arm)
        }
        remaining = iter(expected)
        current_setup = 0
        for row, next_row in itertools.zip_longest(program.rows, program.rows[1:]):
            fault = ""
            if isinstance(row, OperationRow):
                name, current_setup = next(remaining, ("", 0))
                if (row.operation, row.setup) != (panel_text(name) or "operation", current_setup):
                    fault = f"operation {row.operation!r}, setup {row.setup}, is announced; expected: "
                    fault += f"{name!r}, setup {current_setup}" if current_setup else "no further operation"
                elif held_fault := _held_fault(setups[current_setup - 1].stock, row):
                    fault = f"operation {row.operation!r}: {held_fault}"
            elif isinstance(row, ToolRow) and 0 < current_setup <= len(setups):
                tool = setups[current_setup - 1].cell.arm(row.arm).tool
                if row.tool != tool.name or abs(row.mass - tool.mass) > MASS_TOLERANCE_KG:
                    fault = (
                        f"announced for arm {row.arm}: {row.tool}, {row.mass:g} kg; expected: {tool.name}, "
                    )
                    fault += f"{tool.mass:g} kg"
            elif (
                isinstance(row, MoveRow)
                and setup_by_line.get(row.points[0].line, current_setup) != current_setup
            ):
                fault = (
                    f"this move is in setup {setup_by_line[row.points[0].line]}; setup {current_setup} was "
                    "announced"
                )
            if isinstance(row, OperationRow | ToolRow) and not isinstance(next_row, ToolRow | AtRow):
                fault = fault or "an operation and its tools must be followed by the check of the joints"
            if isinstance(row, CarryRow) and isinstance(next_row, CarryRow) and row.arm == next_row.arm:
                fault = f"arm {row.arm} is asked twice what it holds"
            if fault:
                issues.append(_row_issue(code, fault, program, row))
        if unannounced := [name for name, _ in remaining]:
            issues.append(
                _row_issue(code, f"operation {unannounced[0]!r} is not announced", program, program.rows[-1])
            )
    return issues


def _held_fault(stock: Stock, row: OperationRow) -> str:
    """Return what is wrong with the announced holder of the block, or its pose in the holder's TCP frame.

    The result is a clause for a message, "" if nothing is wrong.
    """
    if row.held_by != (stock.held_by or ""):
        return f"announced block holder: {row.held_by or 'no arm'}; expected: {stock.held_by or 'none'}"
    if not row.held_by:
        return ""  # verify.work_object checks its pose
    difference = inverse(stock.grip) @ pose(row.block)
    if np.linalg.norm(difference[:3, 3]) > FRAME_TOLERANCE_M or not np.allclose(
        difference[:3, :3], np.eye(3), atol=1e-6
    ):
        return f"the announced pose of the block in the tool of {row.held_by} is wrong"
    return ""


@rule("verify.start_posture")
def start_posture(context: Context) -> RuleOutcome:
    """Trajectories: all joints are checked before each move, which starts at rest from that posture.

    The check has at most twice the goal tolerance. The posture is the end of the previous move, or home for
    the first one. The first point of the move is that posture, at rest, late enough that joints with the
    allowed deviation reach it within the limits of joints and tools.
    """
    issues: list[Issue] = []
    code = "verify.start_posture"
    worst = limit = 0.0
    for _, program in _programs(context):
        controller = context.problem.cell.controller
        limit = CHECK_TOLERANCE_FACTOR * controller.goal_tolerance
        homes = {arm.name: arm.home for arm in context.problem.cell.arms}
        posture = np.concatenate([homes[row.arm] for row in program.arms])
        tolerance = HOME_TOLERANCE_RAD
        previous: TrajectoryRow | None = None
        tools: dict[str, FloatArray] = {}
        for row in program.rows:
            if isinstance(row, ToolRow):
                tools[row.arm] = pose(row.tcp)
            if isinstance(row, AtRow):
                worst = max(worst, row.within)
                if not 0.0 < row.within <= limit * _ROUNDING_FACTOR:
                    message = (
                        f"joints are checked within {np.rad2deg(row.within):g} deg; allowed: above 0, to "
                        f"{np.rad2deg(limit):g}"
                    )
                    issues.append(_row_issue(code, message, program, row))
                deviation = np.abs(np.array(row.at) - posture)
                if deviation.max() > tolerance:
                    reference = "home" if tolerance == HOME_TOLERANCE_RAD else "the end of the previous move"
                    message = (
                        f"number {int(np.argmax(deviation)) + 1} is {np.rad2deg(deviation.max()):.6f} deg "
                        f"from {reference}"
                    )
                    issues.append(_row_issue(code, message, program, row))
            if isinstance(row, MoveRow):
                if not isinstance(previous, AtRow):
                    issues.append(
                        _row_issue(code, "the joints are not checked right before this move", program, row)
                    )
                else:
                    issues += _first_point_issues(context, program, row, previous, tools)
                posture = np.array(row.points[-1].q)
                tolerance = POSTURE_TOLERANCE_RAD
            previous = row
    measure = float(np.rad2deg(worst)), float(np.rad2deg(limit)), "deg"
    return RuleOutcome(tuple(issues), *measure, nothing="" if limit else _NOT_APPLICABLE)


def _first_point_issues(
    context: Context, program: TrajectoryProgram, row: MoveRow, check: AtRow, tools: Mapping[str, FloatArray]
) -> list[Issue]:
    """Return issues of the first point of a move.

    The point must be the checked posture, at rest. Its time must be sufficient for each arm to correct the
    deviation that the check allows. ``row`` is the move, ``check`` the check of the joints before it.
    ``tools`` are the TCPs in the flange frame, (4, 4) [m], by arm.
    """
    first = row.points[0]
    code = "verify.start_posture"
    deviation = np.abs(np.array(first.q) - np.array(check.at)).max()
    if deviation > POSTURE_TOLERANCE_RAD or any(first.v):
        return [
            _row_issue(code, "the first point of this move is not the checked posture, at rest", program, row)
        ]
    out: list[Issue] = []
    arm_columns = columns(program)
    for task in context.job.tasks:
        if not isinstance(task.text, TrajectoryText) or task.text.program is not program:
            continue
        arm = task.arm
        q = np.array(first.q)[arm_columns[arm.name]]
        tcp = tools.get(arm.name, arm.tool.tcp)
        speed = context.problem.settings.tcp_speed
        limit_fraction = settling_fraction(robot_machine(arm.data), tcp, q, check.within, first.t, speed)
        if limit_fraction > 1.0:
            message = (
                f"{arm.name} has {first.t:g} s to correct {np.rad2deg(check.within):g} deg at the start of "
                f"this move, for which it would need {100.0 * limit_fraction:.0f} % of its limits"
            )
            out.append(_row_issue(code, message, program, first, "make the first point later"))
    return out


@rule("verify.goal_tolerances")
def goal_tolerances(context: Context) -> RuleOutcome:
    """Trajectories: path, goal and time tolerances of each move are positive and at most those of the cell.

    Controllers take a tolerance of 0 for no tolerance.
    """
    issues: list[Issue] = []
    code = "verify.goal_tolerances"
    worst = 0.0
    applies = False
    controller = context.problem.cell.controller
    for _, program in _programs(context):
        applies = True
        for row in program.rows:
            if not isinstance(row, MoveRow):
                continue
            kinds = (
                ("path", row.path, controller.path_tolerance),
                ("goal", row.goal, controller.goal_tolerance),
            )
            for kind, values, limit in kinds:
                worst = max(worst, max(values) / limit)
                for i, value in enumerate(values):
                    if not 0.0 < value <= limit * _ROUNDING_FACTOR:
                        value_deg, limit_deg = np.rad2deg([value, limit])
                        message = (
                            f"the {kind} tolerance of number {i + 1} is {value_deg:g} deg; allowed: above 0, "
                        )
                        message += f"to {limit_deg:g}"
                        issues.append(_row_issue(code, message, program, row))
            if not 0.0 < row.goal_time <= controller.goal_time * _ROUNDING_FACTOR:
                message = (
                    f"the goal may be {row.goal_time:g} s late; allowed: above 0, to {controller.goal_time:g}"
                )
                issues.append(_row_issue(code, message, program, row))
    return RuleOutcome(
        tuple(issues), 100.0 * worst, 100.0, "% of the cell's", nothing="" if applies else _NOT_APPLICABLE
    )


@rule("verify.power_on_failure")
def power_on_failure(context: Context) -> RuleOutcome:
    """Trajectories: each step that may fail names exactly the outputs that are on, so that they go off.

    At the end of the file all outputs are off. The operator is not asked about a load while an output is on.
    """
    issues: list[Issue] = []
    code = "verify.power_on_failure"
    checked = 0
    for _, program in _programs(context):
        on: dict[str, str] = {}
        for row in program.rows:
            if isinstance(row, SetRow):
                on = {key: name for key, name in on.items() if key != row.signal.lower()}
                if row.to:
                    on[row.signal.lower()] = row.signal
            if not isinstance(row, MayFail):
                continue
            checked += 1
            named = {name.lower(): name for name in row.on_failure}
            if unnamed := [name for key, name in on.items() if key not in named]:
                message = f"{', '.join(unnamed)} stays on if this step fails; on_failure must name it"
                issues.append(_row_issue(code, message, program, row))
            if isinstance(row, CarryRow) and on:
                message = f"the operator is asked about a load while {', '.join(on.values())} is on"
                issues.append(_row_issue(code, message, program, row))
            if not_on := [name for key, name in named.items() if key not in on]:
                issues.append(
                    _row_issue(code, f"on_failure names {', '.join(not_on)}, which is not on", program, row)
                )
        if on:
            message = f"{', '.join(on.values())} is on at the end of the file"
            issues.append(_row_issue(code, message, program, program.rows[-1]))
    summary = f"{checked} steps", "" if checked else _NOT_APPLICABLE
    return RuleOutcome(tuple(issues), float(len(issues)), 0.0, "steps", *summary)


@rule("verify.between_points")
def between_points(context: Context) -> RuleOutcome:
    """Trajectories: between two points of work the tool keeps its straight segment and an even speed.
    The cubic in joint space stays within 0.1 mm and 0.1 degrees of the segment. The tool never moves
    backwards, and is nowhere faster than 1.55 times its mean speed to this point and in the adjacent
    intervals.
    """
    issues: list[Issue] = []
    code = "verify.between_points"
    worst = 0.0
    applies = False
    motion = context.motion
    for task in context.job.tasks:
        if not isinstance(task.text, TrajectoryText):
            continue
        arm = task.arm.name
        applies = True
        is_work, start_pose, end_pose, holders = work_nodes(context, task)
        issues += _speed_issues(context, task)
        samples = motion.merged_samples
        work_samples = np.flatnonzero(is_work[samples.node])
        for first in range(0, len(work_samples), SAMPLES_PER_BATCH):
            batch = work_samples[first : first + SAMPLES_PER_BATCH]
            node = samples.node[batch]
            poses = tool_in_holder_frame(context, arm, holders[node], samples.row[batch], motion.poses)
            deviation, rotation = _segment_deviation(start_pose[node], end_pose[node], poses)
            worst = max(worst, float(deviation.max(initial=0.0)))
            faulty = np.flatnonzero((deviation > MAX_DEVIATION_M) | (rotation > MAX_ROTATION_RAD))
            for k in first_sample_of_each_node(node[faulty], faulty)[:20].tolist():
                message = f"between two points the tool of {arm} is {mm(deviation[k]):.4f} mm and "
                message += (
                    f"{np.rad2deg(rotation[k]):.4f} deg off the straight path; allowed: "
                    f"{mm(MAX_DEVIATION_M):g} mm and {np.rad2deg(MAX_ROTATION_RAD):g} deg"
                )
                measure = (mm(float(deviation[k])), mm(MAX_DEVIATION_M), "mm")
                sample = int(samples.sample[batch[k]])
                issues.append(sample_issue(code, message, motion, arm, sample, measure))
    return RuleOutcome(
        tuple(issues), mm(worst), mm(MAX_DEVIATION_M), "mm", nothing="" if applies else _NOT_APPLICABLE
    )


def _speed_issues(context: Context, task: TaskText) -> list[Issue]:
    """Return issues of moves in which the tool moves backwards, or much faster than its mean speed nearby.

    Only moves of work are checked, to points that are passed, in which the tool moves more than
    ``STANDSTILL_M``. The mean speed nearby is the largest mean of this move and the two adjacent ones. There
    are at most 20 issues of either kind.
    """
    out: list[Issue] = []
    speeds = tool_speeds(context)[task.arm.name]
    moves, mean = speeds.moves, speeds.mean
    is_work = np.array([isinstance(move.target, PassedTarget) for move in moves])
    # 0 stands for the missing neighbours of the first and last move
    nearby_mean = np.maximum(mean, np.maximum(np.append(mean[1:], 0.0), np.append(0.0, mean[:-1])))
    is_moving = is_work & (speeds.length > STANDSTILL_M)
    speed_ratio = np.where(is_moving, speeds.peak / np.maximum(nearby_mean, 1e-9), 0.0)
    for k in np.flatnonzero(speed_ratio > MAX_SPEED_RATIO)[:20].tolist():
        message = f"before this point the tool of {task.arm.name} reaches {mm(speeds.peak[k]):.2f} mm/s, "
        message += f"{speed_ratio[k]:.2f} times its mean speed there; allowed: {MAX_SPEED_RATIO:g} times"
        out.append(step_issue("verify.between_points", message, task, moves[k]))
    for k in np.flatnonzero(is_moving & (speeds.back > _MAX_BACKWARD_M))[:20].tolist():
        message = f"before this point the tool of {task.arm.name} moves back by {mm(speeds.back[k]):.3f} mm; "
        out.append(
            step_issue(
                "verify.between_points", f"{message}allowed: {mm(_MAX_BACKWARD_M):g} mm", task, moves[k]
            )
        )
    return out


def _segment_deviation(start: FloatArray, end: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distance (S,) [m] and the rotation (S,) [rad] of each pose from its segment.

    Each of the poses (S, 4, 4) has one segment, straight and with a uniform rotation. It leads from ``start``
    to ``end``, (S, 4, 4) each. Both deviations are those from one pose of the segment: the one with the
    nearest position, or with the nearest rotation if the segment has no length.
    """
    step = end[:, :3, 3] - start[:, :3, 3]
    segment_rotation = log_rotation(np.swapaxes(start[:, :3, :3], 1, 2) @ end[:, :3, :3])
    offset = pose[:, :3, 3] - start[:, :3, 3]
    length = np.linalg.norm(step, axis=1)
    angle = np.linalg.norm(segment_rotation, axis=1)
    pose_rotation = log_rotation(np.swapaxes(start[:, :3, :3], 1, 2) @ pose[:, :3, :3])
    translation_progress = dots(offset, step) / np.maximum(length, 1e-9) ** 2
    rotation_progress = dots(pose_rotation, segment_rotation) / np.maximum(angle, 1e-9) ** 2
    progress = np.clip(
        np.where(length > 1e-6, translation_progress, np.where(angle > 1e-6, rotation_progress, 0.0)),
        0.0,
        1.0,
    )
    deviation = np.linalg.norm(offset - progress[:, None] * step, axis=1)
    expected = start[:, :3, :3] @ exp_rotation(progress[:, None] * segment_rotation)
    rotation_deviation = log_rotation(np.swapaxes(expected, 1, 2) @ pose[:, :3, :3])
    return deviation, np.asarray(np.linalg.norm(rotation_deviation, axis=1))
