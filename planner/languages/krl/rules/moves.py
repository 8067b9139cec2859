"""KRL's part of the rules on moves: approximation, minimum speeds and status."""

import itertools
from collections.abc import Sequence

import numpy as np

from planner.issues import Issue
from planner.languages.krl.reader.reader import KrlText
from planner.programs.stages import TaskText
from planner.programs.steps import (
    MAX_EXTERNAL_VALUE,
    JointTarget,
    MoveStep,
    PassedTarget,
    RobTarget,
    StatusTarget,
)
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.external_axes import axis_translation, axis_values, task_axes
from planner.proof.kinematics.inverse_kinematics import select_by_status
from planner.proof.replay.moves import flange_at, status_solutions
from planner.proof.rule import RuleOutcome, mm, rule, step_issue

_POSITION_TOLERANCE_M = 1e-5
"""Distance of the TCP [m] below which a move only rotates."""
_MIN_ZONE_M = 1.001e-6
"""Smallest approximation distance [m]. It needs no check: controllers use at most half of a move anyway."""
_MIN_ZONE_ANGLE_RAD = 1.001 * np.deg2rad(0.001)
"""Smallest approximation angle [rad], which needs no check either."""
_MIN_SPEED_M_S = 0.11e-3
"""Smallest speed of a move that KRL programs state [m/s], with its rounding. No feed or limit is so low."""
_MIN_ROTATION_SPEED_RAD_S = np.deg2rad(0.15)
"""Smallest rotation speed of a move that KRL programs state [rad/s], with its rounding."""
_SOLUTION_TOLERANCE_RAD = np.deg2rad(0.01)
"""Joint difference [rad] above which two solutions are different."""


def move_kinds(context: Context, task: TaskText) -> RuleOutcome:
    """Return an issue for each move that uses external axes in a task without external axes.

    Their code is verify.move_kinds.

    Args:
        context: The proof.
        task: The task.
    """
    if task_axes(task.arm, context.problem.cell.turntable):  # covered by verify.external_axes
        return RuleOutcome()
    out = []
    for step in task.steps:
        if not isinstance(step, MoveStep):
            continue
        stated = np.abs(step.target.external)
        if stated[stated < MAX_EXTERNAL_VALUE].max(initial=0.0) > 0.0:
            message = "the target moves an external axis; E1 to E6 must be 0 here"
            out.append(step_issue("verify.move_kinds", message, task, step))
    return RuleOutcome(tuple(out))


def hidden(context: Context, task: TaskText) -> RuleOutcome:
    """Return an issue for each program that is never called (verify.hidden).

    Args:
        context: The proof.
        task: The task.
    """
    programs = task.text.programs if isinstance(task.text, KrlText) else {}
    return RuleOutcome(
        tuple(
            Issue("verify.hidden", f"{program.name}() is never called", arm=task.arm.name, file=program.file)
            for name, program in programs.items()
            if ("", name) not in task.called
        )
    )


def corners(task: TaskText, moves: Sequence[MoveStep]) -> tuple[list[Issue], float]:
    """Return an issue for each corner that uses more than half of an adjacent move, and the largest excess.

    A corner is compared with the shorter one of the moves to it and from it: by distance or, if the TCP does
    not move in one of them, by angle. Exact stops, joint moves, and corners without an adjacent straight move
    are left out, and so are the smallest corners that KRL programs state.

    Args:
        task: The task.
        moves: Its moves.

    Returns:
        The issues, and the largest excess of a distance [mm]; angles do not count for it.
    """
    out, max_excess = [], 0.0
    steps = [_distance_and_angle(a, b) for a, b in itertools.pairwise(moves)]
    for i, move in enumerate(moves):
        if move.zone.fine or move.by_joints:
            continue
        adjacent = [step for step in steps[max(i - 1, 0) : i + 1] if step is not None]
        if not adjacent:
            continue
        distance, angle = min(step[0] for step in adjacent), min(step[1] for step in adjacent)
        if distance > _POSITION_TOLERANCE_M:
            excess = move.zone.tcp - max(0.5 * distance, _MIN_ZONE_M)
            max_excess = max(max_excess, mm(excess))
            size, half = mm(move.zone.tcp), mm(0.5 * distance)
            message = f"the corner uses {size:g} mm; half of the shorter move is {half:.4f} mm"
        else:
            excess = move.zone.turn_angle - max(0.5 * angle, _MIN_ZONE_ANGLE_RAD)
            angles = np.rad2deg([move.zone.turn_angle, 0.5 * angle])
            message = (
                f"the corner uses {angles[0]:g} deg; half of the smaller rotation is {angles[1]:.5f} deg"
            )
        if excess > 1e-9:
            out.append(step_issue("verify.zone_size", message, task, move))
    return out, max_excess


def _distance_and_angle(a: MoveStep, b: MoveStep) -> tuple[float, float] | None:
    """Return the distance [m] and angle [rad] between the targets of two consecutive moves.

    None if the first has no pose, the second is not a straight move, or their work objects differ.
    """
    if (
        isinstance(a.target, JointTarget | PassedTarget)
        or not isinstance(b.target, RobTarget)
        or a.wobj is not b.wobj
    ):
        return None
    distance = float(np.linalg.norm(a.target.position - b.target.position))
    cosine = abs(float(a.target.quaternion @ b.target.quaternion))
    return distance, 2.0 * float(np.arccos(min(cosine, 1.0)))


def is_slowest(move: MoveStep) -> bool:
    """Return whether a move is as slow as KRL can state it."""
    return move.speed.tcp <= _MIN_SPEED_M_S and move.speed.turn <= np.sqrt(2.0) * _MIN_ROTATION_SPEED_RAD_S


@rule("verify.status")
def status(context: Context) -> RuleOutcome:
    """KRL: Status and Turn of each PTP target pose select exactly one joint solution within the limits.

    This must hold whether or not Turn counts for axes near zero.
    """
    issues: list[Issue] = []
    axes_near_zero: list[str] = []
    targets = 0
    for task in context.job.tasks:
        for move in task.steps:
            if isinstance(move, MoveStep) and isinstance(move.target, StatusTarget):
                targets += 1
                faults, axes = _status_faults(context, task, move, move.target)
                issues += [step_issue("verify.status", fault, task, move) for fault in faults]
                axes_near_zero += [f"axis {axis} at {move.target_name}" for axis in axes]
    summary = f"{targets} targets" if targets else ""
    where = f"{summary}; near zero: {', '.join(axes_near_zero)}" if axes_near_zero else summary
    return RuleOutcome(
        tuple(issues), where=where, nothing="" if targets else "no target states Status and Turn"
    )


def _status_faults(
    context: Context, task: TaskText, move: MoveStep, target: StatusTarget
) -> tuple[list[str], tuple[int, ...]]:
    """Return messages on Status and Turn of a move's target, and the axes, from 1, that are near zero.

    There is a message unless exactly one joint solution within the limits has these bits. There is also one
    for each axis near zero for which the opposite Turn bit selects another solution.
    """
    machine, base = arm_model.robot_machine(task.arm.data), context.bases[task.arm.name]
    if task.arm.linear_axes:  # at the axis values that the target states
        base = np.array(base)
        base[:3, 3] += axis_translation(task.arm, axis_values(task.arm, target.external))
    bits = f"S {target.status} and T {target.turn}"
    selected = status_solutions(move, machine, base)
    if len(selected.q) != 1:
        count = "no joint solution" if not len(selected.q) else f"{len(selected.q)} joint solutions"
        return [f"{bits} select {count} within the limits; exactly one is required"], ()
    faults = []
    for axis in selected.near_zero:  # a controller may ignore their bits, so try the other value of each
        other = select_by_status(
            machine, flange_at(move, base), target.status, target.turn ^ (1 << (axis - 1))
        )
        if any(np.abs(q - selected.q[0]).max() > _SOLUTION_TOLERANCE_RAD for q in other.q):
            faults.append(f"{bits}: axis {axis} is near zero, and without its turn another solution fits")
    return faults, selected.near_zero
