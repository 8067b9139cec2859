"""Rules on moves: verify.unknown_start, move_kinds, zone_size and zero_length.

verify.unknown_start examines joint moves: the text states only their speeds, and the position before the
first one is unknown.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from planner.issues import Issue
from planner.programs.stages import TaskText
from planner.programs.steps import JointTarget, MoveStep, PassedTarget, RobTarget, StatusTarget
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import task_axes
from planner.proof.language_contribution import check_task, language_of_task
from planner.proof.rule import RuleOutcome, mm, rule, step_issue
from planner.proof.rules.synchronisation import straight_distance

UNKNOWN_START = "verify.unknown_start"
"""Code of the rule on moves from an unknown position."""
BLIND_SPEED_M_S = 0.25
"""Maximum tool speed [m/s] from an unknown position: the limit for arms near people."""
BLIND_ROTATION_RATE_RAD_S = np.deg2rad(45.0)
"""Maximum tool rotation rate [rad/s] from an unknown position."""
BLIND_SPEED_FRACTION = 0.10
"""Maximum fraction of each axis' speed from an unknown position, for languages that state fractions."""
SPEED_ROUNDING_FACTOR = 1.0 + 1e-6
"""Ratio of a speed to its limit that is allowed, because speeds are rounded."""


@rule("verify.unknown_start")
def unknown_start(context: Context) -> RuleOutcome:
    """The first move of each arm starts from an unknown position, so it is slow.
    It is no faster than 250 mm/s and 45 deg/s, or less where the problem allows less, or in KRL and
    URScript 10 % of each axis. Joint moves state no times.
    """
    issues, worst = list[Issue](), 0.0
    arms_by_speed: dict[str, list[str]] = {}
    skip_reason = "nothing moves"
    for task in context.job.tasks:
        outcome = language_of_task(task).checks.get(UNKNOWN_START, _check_axis_fractions)(context, task)
        issues += outcome.issues
        worst = max(worst, outcome.worst or 0.0)
        skip_reason = outcome.nothing or skip_reason
        if outcome.where:
            arms_by_speed.setdefault(outcome.where, []).append(task.arm.name)
    speeds = "; ".join(f"{stated} ({', '.join(arms)})" for stated, arms in arms_by_speed.items())
    where = f"start not known: at most {speeds}"
    nothing = "" if arms_by_speed else skip_reason
    return RuleOutcome(tuple(issues), 100.0 * worst, 100.0, "% of the speed allowed", where, nothing)


def _check_axis_fractions(context: Context, task: TaskText) -> RuleOutcome:
    """Check the fractions of the axes' speeds in a task's first move, for KRL and URScript.

    The move must be a PTP or movej. It is used for languages without a check of their own.
    """
    move = next((step for step in task.steps if isinstance(step, MoveStep)), None)
    if move is None:
        return RuleOutcome()
    if move.speed.axes is None:
        message = f"{move.kind} does not state fractions of the axes' speeds; use PTP or movej"
        return unknown_start_outcome(task, move, 0.0, [message])
    max_fraction = max(move.speed.axes)
    axis = int(np.argmax(move.speed.axes)) + 1
    message = (
        f"axis {axis} has {100.0 * max_fraction:g} % of its speed; allowed: {100.0 * BLIND_SPEED_FRACTION:g} "
        "%"
    )
    faults = [message] if max_fraction > BLIND_SPEED_FRACTION * SPEED_ROUNDING_FACTOR else []
    return unknown_start_outcome(task, move, max_fraction / BLIND_SPEED_FRACTION, faults)


def unknown_start_outcome(
    task: TaskText, move: MoveStep, fraction: float, faults: Sequence[str]
) -> RuleOutcome:
    """Return the outcome of verify.unknown_start for one task, whose first move has the given faults.

    Args:
        task: The task.
        move: Its first move.
        fraction: Speed of the move as a fraction of the allowed speed.
        faults: Faults of the move, for messages.
    """
    issues = tuple(step_issue(UNKNOWN_START, f"start not known: {fault}", task, move) for fault in faults)
    return RuleOutcome(issues, fraction, where=_describe_speed(move))


def _describe_speed(move: MoveStep) -> str:
    """Return the stated speed of a move for messages: fractions of axes, or tool speed and rotation rate."""
    if move.speed.axes is not None:
        return f"{100.0 * max(move.speed.axes):g} % of each axis"
    speed = move.speed.tcp if move.velocity is None else move.velocity
    return f"{mm(speed):g} mm/s, {np.rad2deg(move.speed.turn):g} deg/s"


_ZERO_LENGTH_M, _ZERO_ROTATION = 1e-8, 1e-9
"""Distance [m], and difference of joints [rad] or of quaternion entries, below which a move has no length."""
MAX_TRACK_LEAD_M = 5e-3
"""Distance [m] by which a coordinated track may start to round a corner before its tool does, as in z10.
The replay starts both roundings at once, so the base deviates by at most a quarter of this distance.
"""
_ZONE_TOLERANCE_M = 1e-6
"""Tolerance [m] of zone sizes, because coordinates are rounded, and controllers shorten too large corners."""


@rule("verify.move_kinds")
def move_kinds(context: Context) -> RuleOutcome:
    r"""Only moves with a known path are used.
    RAPID: MoveAbsJ, and MoveL with ConfL as the arm needs it, no \Conc, and no external axes except
    tracks and turntables. KRL: PTP, and LIN or SLIN. URScript: movej, with no higher acceleration than
    the axes allow, and movel.
    """
    issues = list[Issue]()
    for task in context.job.tasks:
        issues += check_task("verify.move_kinds", context, task).issues
        issues += _check_accelerations(task)
    return RuleOutcome(tuple(issues))


def _check_accelerations(task: TaskText) -> list[Issue]:
    """Report moves whose stated acceleration of the leading axis is more than the weakest axis allows.

    Moves of languages that do not state it are skipped.
    """
    limit, out = float(np.min(task.arm.data.acceleration)), []
    for step in task.steps:
        if isinstance(step, MoveStep) and step.acceleration is not None and step.acceleration > limit:
            stated_deg, limit_deg = np.rad2deg([step.acceleration, limit])
            message = (
                f"the acceleration of the leading axis is {stated_deg:.1f} deg/s^2; allowed: {limit_deg:.1f}"
            )
            out.append(step_issue("verify.move_kinds", message, task, step))
    return out


@rule("verify.zone_size")
def zone_size(context: Context) -> RuleOutcome:
    """A zone takes at most half of the shorter of the two moves that meet in it.
    The zone of a coordinated track starts at most 5 mm before that of the tool.
    """
    issues, worst = [], 0.0
    for _, _, task, moves in context.moves():
        if task.text.is_trajectory:
            continue  # trajectories round no corners
        find_corners = language_of_task(task).corners
        if find_corners is not None:
            corner_issues, excess = find_corners(task, moves)
            issues += corner_issues
            worst = max(worst, excess)
            continue
        # lengths[i]: from the target of move i to that of move i + 1, None if it is unknown.
        lengths = [straight_distance(a, b) for a, b in itertools.pairwise(moves)]
        has_coordinated_track = any(axis.follow_fraction is not None for axis in task_axes(task.arm, None))
        for i, move in enumerate(moves):
            if move.zone.fine:
                continue
            track_lead = move.zone.external - max(move.zone.tcp, 0.0)
            if has_coordinated_track and (
                track_lead > MAX_TRACK_LEAD_M + _ZONE_TOLERANCE_M or move.zone.linear < 0.0
            ):
                message = (
                    f"zone {move.zone_name}: the track leaves its path {mm(move.zone.external):g} mm before "
                    f"the target, the tool {mm(move.zone.tcp):g} mm; allowed: {mm(MAX_TRACK_LEAD_M):g} mm "
                    "more than the tool, and no negative length"
                )
                issues.append(step_issue("verify.zone_size", message, task, move))
            sizes = (move.zone.tcp, move.zone.turn, move.zone.turn_angle)
            if min(sizes) < 0.0 or max(sizes) <= 0.0:
                message = f"zone {move.zone_name} has no positive size and is not a stop point"
                issues.append(step_issue("verify.zone_size", message, task, move))
            # The moves before and after the target. Unknown lengths are left out; with none known, half is 0.
            adjacent = [length for length in lengths[max(i - 1, 0) : i + 1] if length is not None]
            half = 0.5 * min(adjacent) if adjacent else 0.0
            size = max(move.zone.tcp, move.zone.turn, 0.0)
            worst = max(worst, mm(size - half))
            if size > half + _ZONE_TOLERANCE_M:
                message = (
                    f"zone {move.zone_name} is {mm(size):g} mm; half of the shorter move is {mm(half):.4f} mm"
                )
                issues.append(step_issue("verify.zone_size", message, task, move))
    return RuleOutcome(tuple(issues), worst, 0.0, "mm over")


@rule("verify.zero_length")
def zero_length(context: Context) -> RuleOutcome:
    """No move has zero length for all arms.
    Excepted is a move to where a goal of trajectories starts. URScript has no movel of zero length at
    all, because no manual states what it does.
    """
    issues = []
    for stage in context.job.stages:
        rows = [(task, stage.moves(task.name)) for task in context.job.tasks if stage.moves(task.name)]
        # In a synchronised stage the moves of all arms with one index count together.
        for group in [rows] if stage.synchronised else [[row] for row in rows]:
            for i in range(1, min((len(moves) for _, moves in group), default=0)):
                still = [(task, moves[i]) for task, moves in group if _is_zero_length(moves[i - 1], moves[i])]
                # Nothing to report: no move has zero length, or only moves at which trajectory goals start.
                if all(move.kind in language_of_task(task).starting_kinds for task, move in still):
                    continue
                if len(still) == len(group):
                    task, move = still[0]
                    issues.append(step_issue("verify.zero_length", "the move has zero length", task, move))
                    continue
                for task, move in still:
                    message = language_of_task(task).zero_length_fault(move)
                    issues += [step_issue("verify.zero_length", message, task, move)] if message else []
    return RuleOutcome(tuple(issues))


def _is_zero_length(a: MoveStep, b: MoveStep) -> bool:
    """Return whether move ``b`` has no length, because the target of move ``a`` before it equals its own.

    Targets of different forms, such as joints and a pose, are never equal.
    """
    if isinstance(a.target, JointTarget) and isinstance(b.target, JointTarget):
        axis_moves = np.abs(a.target.external - b.target.external).max() > 0.0  # an external axis moves
        return not axis_moves and bool(np.abs(a.target.joints - b.target.joints).max() < _ZERO_ROTATION)
    if isinstance(a.target, PassedTarget) and isinstance(b.target, PassedTarget):
        return bool(np.abs(a.target.joints - b.target.joints).max() < _ZERO_ROTATION)
    if isinstance(a.target, RobTarget | StatusTarget) and isinstance(b.target, RobTarget):
        # q and -q are one rotation.
        rotation = min(np.abs(a.target.quaternion - s * b.target.quaternion).max() for s in (1.0, -1.0))
        length = straight_distance(a, b)
        return length is not None and length < _ZERO_LENGTH_M and bool(rotation < _ZERO_ROTATION)
    return False
