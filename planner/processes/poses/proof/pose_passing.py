"""Supplied poses in the proof: their tables, the targets that match them in order, and their minimum feeds.

The proof reads tables of poses itself, as ``process: targets`` takes them: CSV, or JSON with the same keys.
It shares no code with the planner's reader. The search for the targets of a path that match the poses in
order takes a time that is linear in their number.

**Minimum feeds**: the check finds tools that are too slow between poses, or stop where they must not. A
stretch is a run of poses with a minimum feed between two stops of the table. It also starts and ends where
the minimum feed does, and where the permitted speeds of two moves have no speed in common. The motion is
compared with a reference point, which moves along the stretch at the minimum feed. It accelerates uniformly
to it over the run-up from the start, and decelerates in the same way to the end.

- From pose to pose the tools take no longer than the reference point.
- The moves of the program between the ends of a stretch, and the corners between them, have at least the
  fraction ``MIN_FEED_FRACTION`` of the reference point's speed.
- No move inside a stretch ends in a stop.
"""

import csv
import dataclasses
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    exp_twist,
    inverse,
    log_pose,
    log_rotation,
)

MAX_MISSED = 100
"""Number of missed poses at which the search ends.

Each of them is compared with all of the remaining path.
"""
_FIRST_WINDOW = 16
"""Number of targets in the first batch that a pose is compared with. Each further batch is larger."""
_MAX_BATCH = 4096
"""Maximum number of poses that are compared with consecutive targets at once."""
_NEWTON_ITERATIONS = 8
"""Number of Newton iterations for values of freedoms."""
_INITIAL_ROTATION_RAD = 2.1
"""Other initial rotations of Newton's method [rad]: plus and minus about a third of a revolution."""
_RESTART_RESIDUAL = 1e-3
"""Poses with a larger residual [m or rad] are solved again from other initial rotations."""
_MAX_REPETITIONS = 2
"""Maximum number of repetitions for poses that have not converged."""
_CONVERGENCE_LIMIT = 1e-6
"""Residual [m or rad] below which a solution has converged."""


@dataclasses.dataclass(frozen=True)
class PoseMatch:
    """Match of poses with targets.

    Attributes:
        target: Index (P,) of the first target that matches each pose, at or after that of the previous pose.
            For a missed pose it is the nearest one of these targets.
        deviation: Distance and angle between pose and target (P, 2) [m, rad], NaN if the pose was not
            checked.
        is_matched: Whether the pose is matched (P,).
        checked_count: Number of poses that were checked, less than P if too many were missed.
    """

    target: IntArray
    deviation: FloatArray
    is_matched: BoolArray
    checked_count: int


def match_poses(
    paths: Sequence[FloatArray],
    poses: Sequence[FloatArray],
    free: Sequence[Sequence[FloatArray]],
    tolerance: tuple[float, float],
    bounds: Sequence[FloatArray] | None = None,
) -> PoseMatch:
    """Match the poses of one or more tools with the targets of their paths, to prove that none is missed.

    Tools move together: a target matches a pose only if every tool is within the tolerance of its pose. A
    target may match several consecutive poses, but no pose is matched by a target before that of the previous
    pose. The search ends after ``MAX_MISSED`` missed poses.

    Args:
        paths: Poses (S, 4, 4) [m] of each tool at the S targets of its path, S > 0.
        poses: Required poses (P, 4, 4) [m] of each tool.
        free: For each tool its F free twists (6,), angular part first. Along these the tool may differ from a
            pose, in the frame of the pose. Later twists act after earlier ones.
        tolerance: Allowed distance [m] and angle [rad].
        bounds: For each tool the ranges (F, 2) [rad or m] of its free twists. The part of a value beyond its
            range counts as deviation. With ``bounds`` a pose prefers the target after that of the previous
            pose, even if the target of the previous pose matches it as well. Otherwise one target could take
            many poses along a free translation or within a wide tolerance.
    """
    limits: Sequence[FloatArray | None] = [None] * len(paths) if bounds is None else bounds
    tools = zip(paths, poses, free, limits, strict=True)
    search = _PoseSearch(
        tuple(_PosedTool(a, inverse(b), tuple(c), d) for a, b, c, d in tools), np.array(tolerance)
    )
    count, length = len(poses[0]), len(paths[0])
    target, deviation = np.zeros(count, dtype=np.int64), np.full((count, 2), np.nan)
    is_matched = np.zeros(count, dtype=bool)
    i = start = missed = 0  # next pose, target of the previous pose, number of missed poses
    block = 1
    while i < count and missed < MAX_MISSED:
        # usual case, checked for a batch of poses at once: each pose is matched by the target after that of
        # the previous pose and not by that target itself; with ``bounds`` the latter is not required, except
        # that pose 0, which has no previous pose, may be at target 0
        size = min(block, count - i, length - 1 - start)
        run = 0
        if size > 0:
            pose = np.arange(i, i + size)
            at_same = search.deviation(start + pose - i, pose)
            at_next = search.deviation(start + 1 + pose - i, pose)
            is_usual = search.is_within(at_next) & (
                ~search.is_within(at_same) if bounds is None else pose > 0
            )
            run = size if is_usual.all() else int(np.argmin(is_usual))
            target[i : i + run], deviation[i : i + run] = start + 1 + pose[:run] - i, at_next[:run]
            is_matched[i : i + run] = True
        i, start, block = i + run, start + run, min(max(1, 2 * run), _MAX_BATCH)
        if run == size > 0 or i == count:  # the whole batch was usual, or all poses are matched
            continue
        target[i], deviation[i], is_matched[i] = search.find_target(start, i)
        start = int(target[i]) if is_matched[i] else start
        missed += not is_matched[i]
        i += 1
    return PoseMatch(target, deviation, is_matched, i)


@dataclasses.dataclass(frozen=True)
class _PosedTool:
    """A tool: its path (S, 4, 4) [m], the inverses (P, 4, 4) of its poses, and its F free twists (6,).

    ``bounds`` (F, 2) [rad or m] are the ranges of the free twists, None if they are unlimited.
    """

    path: FloatArray
    inverse_poses: FloatArray
    free: tuple[FloatArray, ...]
    bounds: FloatArray | None = None

    def deviation(self, target: IntArray, pose: IntArray) -> FloatArray:
        """Return distance and angle (K, 2) [m, rad] that remain between targets and poses.

        ``target`` (K,) and ``pose`` (K,) are indices of the path and of the poses. Motion along the free
        twists does not count, except for the part of a value that is beyond its range.
        """
        value, twist = free_values(self.inverse_poses[pose] @ self.path[target], self.free)
        residual = np.stack(
            [np.linalg.norm(twist[:, 3:], axis=1), np.linalg.norm(twist[:, :3], axis=1)], axis=1
        )
        if self.bounds is None or not self.free:
            return residual
        is_rotation = np.linalg.norm(np.stack(self.free)[:, :3], axis=1) > 0.0
        offset = value - self.bounds.mean(axis=1)
        offset = np.abs(offset - np.where(is_rotation, 2.0 * np.pi * np.round(offset / (2.0 * np.pi)), 0.0))
        beyond = np.maximum(offset - 0.5 * np.diff(self.bounds, axis=1)[:, 0], 0.0)
        return np.asarray(
            residual
            + np.stack([beyond[:, ~is_rotation].sum(axis=1), beyond[:, is_rotation].sum(axis=1)], axis=1)
        )


@dataclasses.dataclass(frozen=True)
class _PoseSearch:
    """Tools that move together, and the allowed distance [m] and angle [rad] (2,)."""

    tools: tuple[_PosedTool, ...]
    tolerance: FloatArray

    def deviation(self, target: IntArray, pose: IntArray) -> FloatArray:
        """Return the largest distance and the largest angle (K, 2) [m, rad] of all tools.

        ``target`` (K,) and ``pose`` (K,) are the indices of the targets and poses that are compared.
        """
        return np.asarray(np.max([tool.deviation(target, pose) for tool in self.tools], axis=0))

    def is_within(self, deviation: FloatArray) -> BoolArray:
        """Return whether distances and angles (K, 2) are within the tolerances."""
        return np.asarray((deviation <= self.tolerance).all(axis=1))

    def find_target(self, start: int, pose: int) -> tuple[int, FloatArray, bool]:
        """Search the first target that matches a pose, from target ``start`` on.

        Returns:
            Index of the target, its deviation (2,) [m, rad] from the pose, and whether it matches. If no
            target matches, it is the one with the smallest deviation in units of the tolerances.
        """
        size, first, length = _FIRST_WINDOW, start, len(self.tools[0].path)
        deviations: list[FloatArray] = []
        while first < length:
            targets = np.arange(first, min(first + size, length))
            deviation = self.deviation(targets, np.full(len(targets), pose))
            matching = np.flatnonzero(self.is_within(deviation))
            if len(matching):
                return int(targets[matching[0]]), deviation[matching[0]], True
            deviations.append(deviation)
            first, size = first + len(targets), 4 * size
        deviation = np.concatenate(deviations)
        best = int(np.argmin((deviation / self.tolerance).max(axis=1)))
        return start + best, deviation[best], False


def free_values(relative: FloatArray, free: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Solve for the values of free twists that reproduce relative poses best, to see what deviation remains.

    The value of a single twist follows from the logarithm of the pose. Several twists need Newton's method,
    because rotations do not commute. Where it does not converge, it starts again from other rotations. Where
    it converges slowly, it continues from the best values so far.

    Args:
        relative: Relative poses (K, 4, 4) [m].
        free: F free twists (6,), angular part first, that act one after the other.

    Returns:
        Values (K, F) [rad or m], and residual twists (K, 6) [rad, m], angular part first: the relative poses
        without the motion along the free twists.
    """
    count = len(relative)
    if not free:
        return np.zeros((count, 0)), _pose_twist(relative)
    axes = np.stack(free)
    if len(free) == 1:
        twist = _pose_twist(relative)
        value = twist @ axes.T / (axes[0] @ axes[0])
        return value, twist - value @ axes
    best, residuals = _solve_newton(relative, axes, _pose_twist(relative) @ np.linalg.pinv(axes))
    is_rotation = np.linalg.norm(axes[:, :3], axis=1) > 0.0
    for start in itertools.product(
        *(
            (0.0, -_INITIAL_ROTATION_RAD, _INITIAL_ROTATION_RAD) if rotates else (0.0,)
            for rotates in is_rotation
        )
    ):
        unconverged = np.flatnonzero(np.linalg.norm(residuals, axis=1) > _RESTART_RESIDUAL)
        if not len(unconverged):
            break
        new_values, residual = _solve_newton(
            relative[unconverged], axes, np.tile(start, (len(unconverged), 1))
        )
        better = np.linalg.norm(residual, axis=1) < np.linalg.norm(residuals[unconverged], axis=1)
        best[unconverged[better]], residuals[unconverged[better]] = new_values[better], residual[better]
    for _ in range(_MAX_REPETITIONS):  # convergence is slow if two axes nearly coincide
        unconverged = np.flatnonzero(np.linalg.norm(residuals, axis=1) > _CONVERGENCE_LIMIT)
        if not len(unconverged):
            break
        new_values, residual = _solve_newton(relative[unconverged], axes, best[unconverged])
        better = np.linalg.norm(residual, axis=1) < np.linalg.norm(residuals[unconverged], axis=1)
        best[unconverged[better]], residuals[unconverged[better]] = new_values[better], residual[better]
    return best, residuals


def _solve_newton(relative: FloatArray, axes: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve for the values (K, F) of twists ``axes`` (F, 6) by Newton's method from values ``start`` (K, F).

    Returns the values, and the residual twists (K, 6) of the relative poses (K, 4, 4).
    """
    value = np.array(start, dtype=np.float64)
    for _ in range(_NEWTON_ITERATIONS):
        later_motion = np.broadcast_to(np.eye(4), relative.shape)  # motion of the axes after axis j
        columns: list[FloatArray] = []
        for j in range(len(axes) - 1, -1, -1):  # twist of each axis in the frame after the later ones
            columns.insert(0, _transform_twist(inverse(later_motion), axes[j]))
            later_motion = exp_twist(value[:, j, None] * axes[j]) @ later_motion
        residual = log_pose(inverse(later_motion) @ relative)
        step = np.linalg.pinv(np.stack(columns, axis=2)) @ residual[..., None]
        value = value + step[..., 0]
    for axis in range(len(axes)):
        relative = exp_twist(-value[:, axis, None] * axes[axis]) @ relative
    return value, _pose_twist(relative)


def _transform_twist(pose: FloatArray, twist: FloatArray) -> FloatArray:
    """Transform a twist (6,) to other frames (K, 6), by the adjoint of poses (K, 4, 4).

    Source: Lynch and Park, "Modern Robotics", 2017, definition 3.20.
    """
    angular = pose[:, :3, :3] @ twist[:3]
    linear = pose[:, :3, :3] @ twist[3:] + np.cross(pose[:, :3, 3], angular)
    return np.concatenate([angular, linear], axis=1)


def _pose_twist(relative: FloatArray) -> FloatArray:
    """Return rotation vectors and translations (K, 6) of poses (K, 4, 4)."""
    return np.concatenate([log_rotation(relative[:, :3, :3]), relative[:, :3, 3]], axis=1)


MIN_FEED_FRACTION: Final = 0.8
"""Fraction of the minimum feed that tools have to keep at every instant between both ramps."""
TIME_ROUNDING: Final = 1.001, 2e-5
"""Factor and additional time [s] by which durations may be longer, because times in programs are rounded."""
MOVE_INSTANTS: Final = np.linspace(0.0, 1.0, 21)
"""Instants of a corner at which the speed is checked, as fractions of its duration."""
MAX_ISSUES: Final = 20
"""Maximum number of issues of one kind."""


@dataclasses.dataclass(frozen=True)
class PoseTiming:
    """P poses of a table, and the R targets of the programs that pass them.

    The programs may have more targets than the table has poses, and one target may match several poses.

    Attributes:
        step: Distance from each pose to the next (P - 1,) [m], of the tool that moves farthest.
        min_feed: Minimum feed from each pose to the next (P - 1,) [m/s], 0 for none.
        feed: Feed from each pose to the next (P - 1,) [m/s].
        may_stop: Whether the table has a stop at each pose (P,), where the motion may therefore stop.
        node: Index (P,), ascending, of the target that matches each pose, from 0 to R - 1.
        end: Time at which the move to each target ends, pauses excluded (R,) [s].
        stops: Whether the arms stop at each target (R,).
        positions: Positions of each tool at the targets (R, 3) [m].
    """

    step: FloatArray
    min_feed: FloatArray
    feed: FloatArray
    may_stop: BoolArray
    node: IntArray
    end: FloatArray
    stops: BoolArray
    positions: tuple[FloatArray, ...]


@dataclasses.dataclass(frozen=True)
class SlowFault:
    """A place at which the tools are too slow.

    Attributes:
        message: Message for the user.
        pose: Index of the pose.
        got: Actual speed [m/s].
        limit: Minimum speed [m/s].
    """

    message: str
    pose: int
    got: float
    limit: float


def find_feed_shortfalls(timing: PoseTiming, run_up: float) -> list[SlowFault]:
    """Return faults where minimum feeds are not kept, for the rule ``verify.follows``.

    On each stretch three things are faults: a stop that the table does not have, a mean speed between poses
    below that of the reference point, and a move or corner that is too slow at some instant. At most
    ``MAX_ISSUES`` faults of each kind are returned, in this order.

    Args:
        timing: Poses and targets.
        run_up: Length over which tools accelerate to the minimum feed [m].
    """
    slow_means: list[SlowFault] = []
    slow_instants: list[SlowFault] = []
    stop_faults: list[SlowFault] = []
    for first, last in _find_stretches(timing):
        along = np.concatenate([[0.0], np.cumsum(timing.step[first:last])])
        slow_means += _slow_means(timing, first, last, _reference_times(along, run_up))
        stop_faults += _stop_faults(timing, first, last)
        slow_instants += _slow_instants(timing, first, last, run_up)
    return [*stop_faults[:MAX_ISSUES], *slow_means[:MAX_ISSUES], *slow_instants[:MAX_ISSUES]]


def _find_stretches(timing: PoseTiming) -> list[tuple[int, int]]:
    """Divide the poses with a minimum feed into stretches, over which the minimum feed is then checked.

    On a stretch the tools must keep up with a reference point that starts and ends at rest. Stretches start
    and end at the first and last pose of the table, and at each pose where one of these conditions holds:

    - The table has a stop at the pose.
    - The minimum feed starts or ends there: either the move to the pose or the move from it has none.
    - The moves to and from the pose have no permitted speed in common: the minimum feed of one of them is
      above the feed of the other.

    Returns:
        Indices (first, last) of the first and last pose of each stretch, both inclusive. A stretch has the
        moves ``first`` to ``last - 1``, where move k leads from pose k to pose k + 1. Moves without a minimum
        feed belong to no stretch.
    """
    # min_feed and max_feed (P - 1,) are per move; cut (P - 2,) is per inner pose, cut[k] that of pose k + 1
    min_feed, max_feed = timing.min_feed, timing.feed
    cut = timing.may_stop[1:-1] | (min_feed[1:] > max_feed[:-1]) | (min_feed[:-1] > max_feed[1:])
    cut |= (min_feed[1:] > 0.0) != (min_feed[:-1] > 0.0)
    edges = [0, *(np.flatnonzero(cut) + 1).tolist(), len(min_feed)]
    return [(a, b) for a, b in itertools.pairwise(edges) if min_feed[a] > 0.0]


def _reference_times(along: FloatArray, run_up: float) -> FloatArray:
    """Return the times (K,) at which the reference point passes the K poses of a stretch, at 1 m/s.

    The minimum feed is taken as 1 m/s. To get seconds, the caller divides the time between two poses by the
    minimum feed [m/s] there. The point accelerates from rest with v^2 = s / run_up over the run-up, and
    decelerates to rest in the same way. ``along`` (K,) [m] is the distance of each pose from the start of the
    stretch, and ``run_up`` is in m.
    """

    def time_from_rest(s: FloatArray) -> FloatArray:
        # dt = ds / v: t = 2 sqrt(run_up s) up to s = run_up, and then t = 2 run_up + (s - run_up)
        return np.where(s < run_up, 2.0 * np.sqrt(run_up * s), s + run_up)

    half_length = along[-1] / 2.0
    in_first_half = along <= half_length
    total_time = 2.0 * float(time_from_rest(np.array(half_length)))
    return np.where(in_first_half, time_from_rest(along), total_time - time_from_rest(along[-1] - along))


def _slow_means(timing: PoseTiming, first: int, last: int, clock: FloatArray) -> list[SlowFault]:
    """Return faults where the tools take longer from pose to pose of a stretch than the reference point.

    Consecutive poses that the same target matches count as one. ``first`` and ``last`` are the indices of the
    first and last pose of the stretch, both inclusive. ``clock`` (K,) is the result of
    :func:`_reference_times` for these K poses.
    """
    node = timing.node[first : last + 1]
    first_poses = np.flatnonzero(np.diff(node, prepend=-1))  # first of the poses that a target matches
    out = []
    max_times = np.concatenate([[0.0], np.cumsum(np.diff(clock) / timing.min_feed[first:last])])
    durations = np.diff(timing.end[node[first_poses]])
    allowed = np.diff(max_times[first_poses])
    if first_poses[-1] < last - first:  # one target matches all of the last poses
        allowed[-1:] += max_times[-1] - max_times[first_poses[-1]]
    for k in np.flatnonzero(durations > allowed * TIME_ROUNDING[0] + TIME_ROUNDING[1]).tolist():
        pose, previous = first + int(first_poses[k + 1]), first + int(first_poses[k])
        step = float(timing.step[previous:pose].sum())
        got, limit = step / float(durations[k]), step / max(float(allowed[k]), 1e-9)
        message = f"on the way to pose {pose + 1} the tool moves at {got * 1e3:.2f} mm/s, required at least "
        message += f"{limit * 1e3:.2f} mm/s"
        out.append(SlowFault(message, pose, got, limit))
    return out


def _stop_faults(timing: PoseTiming, first: int, last: int) -> list[SlowFault]:
    """Return a fault for each target of a stretch at which the tools stop although the table has no stop.

    A stop is allowed if the table has one at any of the poses that the target matches.

    Args:
        timing: Poses and targets.
        first: Index of the first pose of the stretch.
        last: Index of its last pose, inclusive.
    """
    out = []
    first_target, last_target = int(timing.node[first]), int(timing.node[last])
    stop_targets = np.flatnonzero(timing.stops[first_target : last_target + 1]) + first_target
    for target in stop_targets.tolist():
        # the first pose that this target matches, or else the next pose after it
        pose = int(np.searchsorted(timing.node, target))
        if timing.node[pose] == target and timing.may_stop[timing.node == target].any():
            continue
        # min_feed[k] belongs to the motion from pose k to k + 1: the stretch has k from first to last - 1
        limit = float(timing.min_feed[min(max(pose - 1, first), last - 1)])
        message = f"the tool stops at pose {pose + 1} or on the way to it, but the table has no stop there"
        out.append(SlowFault(message, pose, got=0.0, limit=limit))
    return out


def _slow_instants(timing: PoseTiming, first: int, last: int, run_up: float) -> list[SlowFault]:
    """Return faults where moves of the programs inside a stretch, or corners between them, are too slow.

    The limit is ``MIN_FEED_FRACTION`` of the reference point's speed: the minimum feed, reduced over the
    run-up [m] from both ends of the stretch. A move has one speed. In a corner, which is the transition
    between two moves at a target, the velocity changes linearly from that of one move to that of the next.
    The first and the last move of a stretch, in which the tools accelerate and decelerate, are not checked;
    their corners with the other moves are. ``first`` and ``last`` are the indices of the first and last pose
    of the stretch, both inclusive.
    """
    first_target, last_target = int(timing.node[first]), int(timing.node[last])
    if last_target - first_target < 2:
        return []
    in_stretch = slice(first_target, last_target + 1)
    span = np.maximum(np.diff(timing.end[in_stretch]), 1e-9)
    steps = [np.diff(path[in_stretch], axis=0) for path in timing.positions]
    size = np.max([np.linalg.norm(step, axis=1) for step in steps], axis=0)
    along = np.concatenate([[0.0], np.cumsum(size)])
    end_distance = np.minimum(along, along[-1] - along)
    # speed of the reference point at each target, as a fraction of the minimum feed: v^2 = s / run_up
    ramp = np.sqrt(np.minimum(end_distance / run_up, 1.0))
    # each move is identified by the target at its end; ``pose`` is the pose that it leads to
    end_targets = np.arange(first_target + 1, last_target + 1)
    pose = np.clip(np.searchsorted(timing.node, end_targets), first + 1, last)
    min_speed = MIN_FEED_FRACTION * timing.min_feed[pose - 1]
    speed = size / span
    is_inner = np.ones(len(size), dtype=bool)
    is_inner[[0, -1]] = False
    is_slow = is_inner & (speed < min_speed * np.minimum(ramp[:-1], ramp[1:]) / TIME_ROUNDING[0])
    out = [
        _slow_fault(pose[j], speed[j], min_speed[j], "on the way to pose")
        for j in np.flatnonzero(is_slow).tolist()
    ]
    # at the inner ends of the first and the last move the speed is at most twice the mean speed of the move
    speed = speed.copy()
    speed[0] = np.clip(speed[1], speed[0], 2.0 * speed[0])
    speed[-1] = np.clip(speed[-2], speed[-1], 2.0 * speed[-1])
    scale = (speed / np.maximum(size, 1e-12))[:, None]
    # speed of the fastest tool at each instant of each corner
    fastest = np.zeros((len(MOVE_INSTANTS), len(size) - 1))
    for step in steps:
        velocity = step * scale
        corner_velocity = (1.0 - MOVE_INSTANTS)[:, None, None] * velocity[:-1] + (
            MOVE_INSTANTS[:, None, None] * velocity[1:]
        )
        fastest = np.maximum(fastest, np.linalg.norm(corner_velocity, axis=2))
    slowest = fastest.min(axis=0)
    limit = np.minimum(min_speed[:-1], min_speed[1:]) * ramp[1:-1]
    slow_corners = np.flatnonzero(slowest < limit / TIME_ROUNDING[0]).tolist()
    return out + [_slow_fault(pose[j], slowest[j], limit[j], "in the corner at pose") for j in slow_corners]


def _slow_fault(pose: int, speed: float, limit: float, where: str) -> SlowFault:
    """Return the fault of a speed [m/s] that is below its limit at some instant on a move or in a corner."""
    message = f"{where} {int(pose) + 1} the tool is as slow as {speed * 1e3:.2f} mm/s, required at every "
    message += f"instant at least {limit * 1e3:.2f} mm/s"
    return SlowFault(message, int(pose), float(speed), float(limit))


POSITION_COLUMNS = ("x_mm", "y_mm", "z_mm")
"""Columns of a position [mm]."""
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
"""Columns of a unit quaternion."""
FEED_COLUMN = "feed_mm_s"
"""Column of the feed [mm/s]."""
MIN_FEED_COLUMN = "feed_min_mm_s"
"""Column of the minimum feed [mm/s]."""
STOP_COLUMN = "stop"
"""Column of stops."""
_YES_WORDS = ("1", "true", "yes")
"""Words for true in the column of stops."""


@dataclasses.dataclass(frozen=True)
class PoseTable:
    """A table of poses.

    Attributes:
        poses: Poses (P, 4, 4) [m] by arm.
        feed: Feed on the way to each pose (P,) [m/s], NaN if the row has none.
        min_feed: Minimum feed on the way to each pose (P,) [m/s], NaN if the row has none.
        stop: Whether the motion may stop at each pose (P,).
    """

    poses: Mapping[str, FloatArray]
    feed: FloatArray
    min_feed: FloatArray
    stop: BoolArray


def read_pose_table(path: Path, arms: Sequence[str]) -> PoseTable:
    """Read a table of poses independently of the planner's reader, as input of the rule ``verify.follows``.

    A file with the suffix ``.json`` is read as JSON, any other file as CSV.

    Args:
        path: The file.
        arms: Names of the arms.

    Raises:
        ValueError: If the file is not a table of numbers; also ``KeyError``, ``TypeError``, ``csv.Error``,
            ``OSError``.
    """
    text = path.read_text("utf-8-sig")
    rows: list[dict[str, Any]]
    if path.suffix.lower() == ".json":
        rows = json.loads(text)
    else:
        lines = [line for line in text.splitlines() if line.replace(",", " ").strip()]
        rows = list(csv.DictReader(lines, skipinitialspace=True))
        rows = [{str(key).strip(): value for key, value in row.items()} for row in rows]
    poses = {}
    for arm in arms:
        values = np.array(
            [[float(row[f"{arm}.{key}"]) for key in (*POSITION_COLUMNS, *QUATERNION_COLUMNS)] for row in rows]
        )
        poses[arm] = _parse_poses(values)
    feed, min_feed = (
        np.array([_parse_number(row.get(key)) for row in rows]) for key in (FEED_COLUMN, MIN_FEED_COLUMN)
    )
    stop = np.array([str(row.get(STOP_COLUMN) or "").strip().lower() in _YES_WORDS for row in rows])
    return PoseTable(poses, feed / 1000.0, min_feed / 1000.0, stop)


def _parse_number(value: Any) -> float:
    """Return the number in a cell, or NaN for an empty or missing cell."""
    return float("nan") if value is None or str(value).strip() == "" else float(value)


def _parse_poses(values: FloatArray) -> FloatArray:
    """Return poses (P, 4, 4) [m] from values (P, 7): position [mm] and quaternion, real part first.

    R v = v + 2 w (u x v) + 2 u x (u x v) for the unit quaternion (w, u), column by column.

    Source: Shuster, "A survey of attitude representations", 1993.
    """
    q = values[:, 3:] / np.sqrt((values[:, 3:] ** 2).sum(axis=1, keepdims=True))
    real, u = q[:, :1], q[:, 1:]
    out = np.zeros((len(values), 4, 4))
    for column, axis in enumerate(np.eye(3)):
        cross = np.cross(u, axis)
        out[:, :3, column] = axis + 2.0 * real * cross + 2.0 * np.cross(u, cross)
    out[:, :3, 3] = values[:, :3] / 1000.0
    out[:, 3, 3] = 1.0
    return out
