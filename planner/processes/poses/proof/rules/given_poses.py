"""verify.follows: the tools pass the given poses in order, as the problem states."""

import csv
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, inverse
from planner.issues import Issue
from planner.processes.poses.claims import FollowsPoses, FollowsTable, FreeAxisRange
from planner.processes.poses.proof import pose_passing
from planner.processes.poses.proof.pose_passing import (
    PoseMatch,
    PoseTable,
    PoseTiming,
    find_feed_shortfalls,
    free_values,
    match_poses,
)
from planner.proof.context import Context
from planner.proof.findings import Findings, measure_in_mm
from planner.proof.replay.tool_speeds import peak_tool_speeds
from planner.proof.rule import MAX_FEED_FACTOR, RuleOutcome, measured_issue, mm, rule

FOLLOWS: Final = "verify.follows"
"""Code of this rule."""
FEED_ROUNDING: Final = 1.002
"""Factor by which moves may be faster than the feed, because their times in programs are rounded."""
FULL_REVOLUTION_RAD: Final = 2.0 * np.pi
"""One revolution [rad]."""
OWN_TARGET_TOLERANCE: Final = (1e-5, float(np.deg2rad(0.01)))
"""Maximum distance [m] and angle [rad] of a pose from its target, if each pose has a target of its own."""


@rule("verify.follows", FollowsPoses, FollowsTable)
def follows(context: Context) -> RuleOutcome:
    """The tools pass the given poses in order, up to the free axes, with their feeds.

    Free axes stay within their ranges. The tools are no faster than their feeds and no slower than their
    minimum feeds.
    """
    findings = Findings(FOLLOWS, context, worst=0.0)
    limits = []
    for index, setup in enumerate(context.setup_claims):
        for claim in (c for group in setup.groups for c in group):
            if isinstance(claim, FollowsPoses):
                _check_poses(findings, index, claim)
            elif isinstance(claim, FollowsTable):
                _check_table(findings, index, claim)
            else:
                continue
            limits.append(claim.position_tol)
    if not limits:
        return RuleOutcome(nothing="no such claim")
    return findings.outcome(mm, "mm", max(limits))


def _check_poses(findings: Findings, index: int, claim: FollowsPoses) -> None:
    """Check that an arm passes the claimed poses in the setup ``index``."""
    rows, paths = _tool_paths(findings.context, index, (claim.arm,), claim.frame)
    if not len(rows):
        _report_no_motion(findings, (claim.arm,))
        return
    tolerance = claim.position_tol, claim.angle_tol
    match = match_poses(paths, (np.asarray(claim.poses),), (claim.free,), tolerance)
    _report_missed(findings, match, (claim.arm,), claim.position_tol)


def _check_table(findings: Findings, index: int, claim: FollowsTable) -> None:
    """Check that arms pass the poses of a table in order, and keep the ranges of free axes and the feeds.

    The proof reads the table itself. If a pose is missed, ranges and feeds are not checked. ``index`` is that
    of the setup.
    """
    context = findings.context
    operation = next(op for op in context.problem.operations if op.name == claim.operation)
    file = operation.file  # type: ignore[attr-defined]
    try:
        table = pose_passing.read_pose_table(file, claim.arms)
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        message = f"{file.name}: the proof cannot read the poses ({type(error).__name__}: {error})"
        findings.add(f"{message}; write the table again", file=str(file))
        return
    rows, paths = _tool_paths(context, index, claim.arms, claim.frame)
    if not len(rows):
        _report_no_motion(findings, claim.arms)
        return
    poses = [table.poses[arm] for arm in claim.arms]
    twists = [[_axis_twist(axis) for axis in claim.free if arm in axis.arms] for arm in claim.arms]
    tolerance = (claim.position_tol, claim.angle_tol)
    # Usually each pose has its own target, which defines the values of free axes and the feed there. So the
    # search starts with a narrow tolerance. If it misses a pose, the claimed tolerance is tried. Then free
    # axes without ranges are tried, so that a value beyond its range is not reported as a missed pose.
    bounds = [_free_ranges(claim, arm) for arm in claim.arms]
    narrow_tolerance = (
        min(tolerance[0], OWN_TARGET_TOLERANCE[0]),
        min(tolerance[1], OWN_TARGET_TOLERANCE[1]),
    )
    for search_tolerance in (narrow_tolerance, tolerance):
        match = match_poses(paths, poses, twists, search_tolerance, bounds)
        if match.is_matched.all():
            break
    else:
        match = match_poses(paths, poses, twists, tolerance)
    if _report_missed(findings, match, claim.arms, claim.position_tol):
        return
    shared_values: dict[str, FloatArray] = {}
    for arm, path, pose, arm_twists in zip(claim.arms, paths, poses, twists, strict=True):
        axis_values = free_values(inverse(pose) @ path[match.target], arm_twists)[0]
        free = [axis for axis in claim.free if arm in axis.arms]
        for axis, value in zip(free, axis_values.T, strict=True):
            _check_range(findings, claim, axis, arm, value, shared_values)
    _check_feeds(findings, claim, table, rows[match.target])
    findings.issues += _min_feed_issues(context, claim, table, rows, paths, match.target)


def _tool_paths(
    context: Context, index: int, arms: tuple[str, ...], frame: str
) -> tuple[IntArray, list[FloatArray]]:
    """Return the program targets of a setup from which on all arms have a known pose, and these poses.

    An arm that rests while another one moves alone keeps the pose of its last target.

    Args:
        context: Context of the proof.
        index: Index of the setup.
        arms: Names of the arms.
        frame: Frame of the poses: ``stock`` or ``world``.

    Returns:
        Targets (R,) as indices of the motion's nodes, and for each arm the poses (R, 4, 4) [m] of its TCP at
        them. Both are empty if an arm has no program.
    """
    motion = context.motion
    rows = np.flatnonzero(context.spans.of_stage[motion.node_stage] == index)
    if any(arm not in motion.node_tcp for arm in arms):
        return rows[:0], []
    # for each arm and target the last target at or before it at which the arm has a pose, -1 for none
    last_own = np.zeros((len(arms), len(rows)), dtype=np.int64)
    for arm_last_own, arm in zip(last_own, arms, strict=True):
        has_pose = np.isfinite(motion.node_tcp[arm][rows, 0, 0])
        arm_last_own[:] = np.maximum.accumulate(np.where(has_pose, np.arange(len(rows)), -1))
    has_started = (last_own >= 0).all(axis=0)
    paths = [
        motion.node_tcp[arm][rows[arm_last_own[has_started]]]
        for arm_last_own, arm in zip(last_own, arms, strict=True)
    ]
    rows = rows[has_started]
    if frame == "stock" and len(rows):
        back = inverse(context.stock_poses(index, motion.node_sample[rows]))
        paths = [back @ path for path in paths]
    return rows, paths


def _report_no_motion(findings: Findings, arms: tuple[str, ...]) -> None:
    message = (
        f"arm {arms[0]} never moves" if len(arms) == 1 else f"arms {' and '.join(arms)} never move together"
    )
    findings.add(message, arm=arms[0])


def _report_missed(findings: Findings, match: PoseMatch, arms: tuple[str, ...], within: float) -> bool:
    """Report each missed pose, and note the largest distance of a pose from its target.

    If too many poses are missed, one more message says from which pose on they are not checked. ``within`` is
    the allowed distance [m] of the messages.

    Returns:
        Whether any pose is missed.
    """
    arm_names, issue_count = " and ".join(arms), len(findings.issues)
    for i in np.flatnonzero(~match.is_matched[: match.checked_count]).tolist():
        distance, angle = match.deviation[i].tolist()
        message = (
            f"pose {i + 1} of {arm_names} is missed by {mm(distance):.4f} mm and {np.rad2deg(angle):.4f} deg"
        )
        findings.add(message, measure_in_mm(distance, within), arm=arms[0], index=i)
    if match.checked_count < len(match.is_matched):
        message = (
            f"so many poses of {arm_names} are missed that those from {match.checked_count + 1} on are not "
            "checked"
        )
        findings.add(message, arm=arms[0], index=match.checked_count)
    findings.note_highest(match.deviation[: match.checked_count, 0].max(initial=0.0))
    return len(findings.issues) > issue_count


def _free_ranges(claim: FollowsTable, arm: str) -> FloatArray:
    """Return the lower and upper bounds (F, 2) [rad or m] of the F free axes that an arm has."""
    ranges = [(axis.lower, axis.upper) for axis in claim.free if arm in axis.arms]
    return np.array(ranges, dtype=np.float64).reshape(-1, 2)


def _axis_twist(axis: FreeAxisRange) -> FloatArray:
    """Return the unit twist (6,) of a free axis, angular part first."""
    twist = np.zeros((2, 3))
    twist[0 if axis.is_rotation else 1, axis.axis] = 1.0
    return twist.ravel()


def _check_range(
    findings: Findings,
    claim: FollowsTable,
    axis: FreeAxisRange,
    arm: str,
    value: FloatArray,
    shared_values: dict[str, FloatArray],
) -> None:
    """Check that the values of a free axis are in its range, and equal for arms that share it.

    Rotations are compared up to whole revolutions. Values of two arms may differ by twice the tolerance,
    because each of them may deviate by the tolerance.

    Args:
        findings: Receives the issues.
        claim: Claim with the tolerances.
        axis: Free axis.
        arm: Name of the arm.
        value: Value (P,) [rad or m] of the axis at each pose of the table.
        shared_values: Values (P,) of each axis for the first arm that has it, by the axis as text. The values
            of an axis that is not yet there are added.
    """
    unit, scale = ("deg", np.rad2deg(1.0)) if axis.is_rotation else ("mm", 1e3)
    tolerance = claim.angle_tol if axis.is_rotation else claim.position_tol
    middle, half = 0.5 * (axis.lower + axis.upper), 0.5 * (axis.upper - axis.lower)
    offset = value - middle
    if axis.is_rotation:
        offset = offset - FULL_REVOLUTION_RAD * np.round(offset / FULL_REVOLUTION_RAD)
    beyond = np.abs(offset) - half
    name = f"{'rotation about' if axis.is_rotation else 'slide along'} {'xyz'[axis.axis]}"
    if beyond.max() > tolerance:
        i = int(np.argmax(beyond))
        got = float(middle + offset[i]) * scale
        allowed = f"{axis.lower * scale:g} to {axis.upper * scale:g} {unit}"
        message = f"pose {i + 1} of {arm}: the free {name} is {got:.3f} {unit}, allowed {allowed}"
        limit = axis.upper if offset[i] > 0.0 else axis.lower
        findings.add(message, (got, float(limit) * scale, unit), arm=arm, index=i)
    key = repr(axis)
    difference = value - shared_values.setdefault(key, value)
    if axis.is_rotation:
        difference = difference - FULL_REVOLUTION_RAD * np.round(difference / FULL_REVOLUTION_RAD)
    if np.abs(difference).max() > 2.0 * tolerance:
        i = int(np.argmax(np.abs(difference)))
        message = f"pose {i + 1}: {' and '.join(axis.arms)} share the {name}, but their values differ by "
        message += f"{abs(difference[i]) * scale:.4f} {unit}"
        measure = float(abs(difference[i])) * scale, 2.0 * tolerance * scale, unit
        findings.add(message, measure, arm=arm, index=i)


def _check_feeds(findings: Findings, claim: FollowsTable, table: PoseTable, node: IntArray) -> None:
    """Check that the tools are no faster than their feeds, on average between poses and at every instant.

    The feed of a row, or the claim's feed for rows without their own, limits the motion to the row's pose
    from the previous one. At most 20 issues of each kind are reported. ``node`` (P,) is the index, among the
    motion's nodes, of the target that matches each pose.
    """
    motion = findings.context.motion
    times = np.cumsum(motion.node_duration)[node]  # exact, while samples are too far apart for short moves
    lengths = [np.linalg.norm(np.diff(table.poses[arm][:, :3, 3], axis=0), axis=1) for arm in claim.arms]
    durations = np.diff(times)
    feed = np.where(np.isnan(table.feed), np.nan if claim.feed is None else claim.feed, table.feed)[1:]
    moved = np.diff(node) > 0
    speed = np.where(moved, np.max(lengths, axis=0) / np.maximum(durations, 1e-9), 0.0)
    peak = peak_tool_speeds(findings.context)
    peak_speeds = np.array([peak[a:b].max(initial=0.0) for a, b in itertools.pairwise((node + 1).tolist())])
    for speeds, tolerance_factor, preposition in (
        (speed, FEED_ROUNDING, "at"),
        (peak_speeds, MAX_FEED_FACTOR, "at up to"),
    ):
        # ~(a <= b), not a > b: a speed is also reported if its feed is NaN, which means that there is none
        for i in np.flatnonzero(~(speeds <= tolerance_factor * feed))[:20].tolist():
            got, allowed = mm(speeds[i]), mm(feed[i])
            message = f"on the way to pose {i + 2} the tool moves {preposition} {got:.2f} mm/s, allowed "
            message += f"{allowed:.2f} mm/s"
            findings.add(message, (got, allowed, "mm/s"), arm=claim.arms[0], index=i + 1)


def _min_feed_issues(
    context: Context,
    claim: FollowsTable,
    table: PoseTable,
    rows: IntArray,
    paths: list[FloatArray],
    target: IntArray,
) -> list[Issue]:
    """Return issues where the tools are slower than the minimum feed, or stop where they must not.

    There are none if no row has a minimum feed.

    Args:
        context: Context of the proof.
        claim: Claim with the feed and the minimum feed of rows without their own, and the run-up.
        table: Table of P poses.
        rows: Program targets (R,), as indices of the motion's nodes.
        paths: For each arm the poses (R, 4, 4) [m] of its TCP at these targets.
        target: For each pose the index (P,) into ``rows`` of the target that matches it.
    """
    min_feed = np.where(np.isnan(table.min_feed), claim.feed_min, table.min_feed)
    if not (min_feed[1:] > 0.0).any():
        return []
    feed = np.where(np.isnan(table.feed), np.nan if claim.feed is None else claim.feed, table.feed)
    stop = table.stop.copy()
    stop[[0, -1]] = True  # the motion may always stop at the first and the last pose
    motion = context.motion
    steps = [np.diff(table.poses[arm][:, :3, 3], axis=0) for arm in claim.arms]
    timing = PoseTiming(
        step=np.max([np.linalg.norm(step, axis=1) for step in steps], axis=0),
        min_feed=min_feed[1:],
        feed=feed[1:],
        may_stop=stop,
        node=target,
        end=np.cumsum(motion.node_duration)[rows],
        stops=motion.node_stop[rows],
        positions=tuple(path[:, :3, 3] for path in paths),
    )
    arm = claim.arms[0]
    return [
        measured_issue(
            FOLLOWS, fault.message, (mm(fault.got), mm(fault.limit), "mm/s"), arm=arm, index=fault.pose
        )
        for fault in find_feed_shortfalls(timing, claim.run_up)
    ]
