"""Fits joint trajectories to a plan's targets: points with velocities, as dense as straight segments require.

A controller interpolates a cubic between positions and velocities of two points. The velocities come from
splines with continuous accelerations from rest to rest, or from corner to corner. Where the tool would leave
the straight segment between two targets by more than ``MAX_DEVIATION_M``, a point is inserted on the segment
and the spline is computed again. Where joints would be too fast or accelerate too much, the times between
points are extended. P is the number of points, D the number of joints of all arms that move.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, log_rotation
from planner.languages.trajectories.writer.straight_segments import (
    PathNotKeptError,
    TrajectoryArm,
    carriers_first,
    interpolate_segments,
    segment_progress,
    spread_fractions,
)

MAX_DEVIATION_M: Final = 0.05e-3
"""Maximum deviation [m] of a tool from the straight segment between two points; half of the proof's limit."""
MAX_ROTATION_RAD: Final = float(np.deg2rad(0.05))
"""Maximum rotation deviation [rad] of a tool from the segment; half of the proof's limit."""
MIN_MOVING_DISTANCE_M: Final = 0.09e-3
"""Distance [m] between two points above which the uniformity of the tool's speed is checked."""
MAX_SPEED_RATIO: Final = 1.53
"""Maximum speed of a tool between two points relative to its mean speed there.

The largest mean of this and the two adjacent intervals counts. Chosen: slightly below the limit of the proof,
1.55.
"""
MIN_INTERVAL_S: Final = 0.006
"""Minimum time [s] between two points: most controllers of this kind run at 100 to 1000 Hz."""
SPEED_FRACTION: Final = 0.97
"""Fraction of the joints' maximum speeds that curves may use."""
ACCELERATION_FRACTION: Final = 0.93
"""Fraction of the joints' maximum accelerations that curves may use."""
TOOL_SPEED_FRACTION: Final = 0.99
"""Fraction of the tools' maximum speeds that curves may use."""
MIN_FEED_TIME_FACTOR: Final = 1.04
"""Maximum time of a whole segment relative to the time that its minimum feed allows."""
MIN_FEED_INTERVAL_S: Final = 0.004
"""Interval [s] within a segment over which the minimum feed must also hold on average."""
STANDSTILL_FRACTION: Final = 0.12
"""Minimum joint speed between two points relative to the mean there, for tools that melt the work."""
MARK_DISTANCE_M: Final = 0.3
"""Distance [m] from the TCP of the points that represent the orientation of a tool."""
DIFFERENCE_STEP_S: Final = 1e-6
"""Time step [s] of the finite difference for the speed of the points that represent an orientation."""
CORNER_COSINE: Final = float(np.cos(np.deg2rad(15.0)))
"""Cosine of the angle between joint velocities before and after a target; below it the target is a corner."""
CORNER_SPEED_FRACTION: Final = 0.9
"""Fraction of the adjacent speed that work with a minimum feed keeps at a corner."""
MAX_CORNER_SPEED_FACTOR: Final = 1.5
"""Maximum speed at a corner relative to the mean of the two velocities there."""
MAX_CORNER_FRACTION: Final = 0.25
"""Maximum fraction of the time of each adjacent move that a corner uses."""
MIN_END_FRACTION: Final = 0.1
"""Minimum fraction of an interval on either side of an inserted point."""
_CHECK_FRACTIONS: Final = np.array([0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875])
"""Fractions of the time between two points at which the path is checked."""
_PIECES: Final = 16
"""Number of pieces between two points in which the speed of a tool is checked."""
_MAX_INSERTION_ROUNDS: Final = 16
"""Maximum number of rounds in which points are inserted."""
_SINGLE_ROUNDS: Final = 2
"""Number of first rounds in which points are inserted only where the tool leaves the segment."""
_ADJACENT_INTERVALS: Final = 3
"""Number of adjacent intervals on either side that get points in later rounds."""
_MAX_TIMING_ROUNDS: Final = 60
"""Maximum number of rounds in which points are moved to later times."""


@dataclasses.dataclass(frozen=True)
class TrajectoryPoints:
    """Points of a trajectory from rest to rest; the first one is the start posture.

    Attributes:
        t: Times, (P,) [s].
        q: Joints, (P, D) [rad].
        v: Joint velocities, (P, D) [rad/s].
        end: Index of the given segment on which each point lies, (P,); -1 for the start.
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    end: IntArray


@dataclasses.dataclass(frozen=True)
class SegmentRequirements:
    """Requirements on N straight segments, on each of which A arms move at once.

    Attributes:
        duration: Planned times, (N,) [s].
        tcp_speed: Maximum speed of any tool in the world [m/s].
        max_speed: Maximum speed of each arm's tool on a segment, (A, N) [m/s], relative to the block if
            another arm holds it, in the world otherwise; infinite for none.
        min_speed: Minimum speed of each arm's tool, (A, N) [m/s]; 0 for none. It does not hold in the first
            and last segment of a curve, which starts and ends at rest, or where a slower motion is planned.
        min_progress: Minimum fraction of the segment per second, (N,) [1/s]; 0 for none.
        may_stop: Whether the motion may stop after the segment if no points keep the path otherwise, (N,).
        melts: Whether the tool melts the work, so that the motion must not nearly stop, (N,).
        max_deviation: Maximum deviation of a tool from its segment [m].
        max_rotation: Maximum rotation of each arm's tool away from its orientation on the segment [rad], one
            value for each of the A arms.
    """

    duration: FloatArray
    tcp_speed: float
    max_speed: FloatArray
    min_speed: FloatArray
    min_progress: FloatArray
    may_stop: BoolArray
    melts: BoolArray
    max_deviation: float = MAX_DEVIATION_M
    max_rotation: tuple[float, ...] = (MAX_ROTATION_RAD, MAX_ROTATION_RAD)

    def section(self, a: int, b: int) -> "SegmentRequirements":
        """Return the requirements on segments a to b - 1.

        Args:
            a: First segment.
            b: Segment after the last one.
        """
        section = slice(a, b)
        return dataclasses.replace(
            self,
            duration=self.duration[section],
            max_speed=self.max_speed[:, section],
            min_speed=self.min_speed[:, section],
            min_progress=self.min_progress[section],
            may_stop=self.may_stop[section],
            melts=self.melts[section],
        )

    @property
    def has_min_feed(self) -> bool:
        """Whether some segments have a minimum feed, so that corners must not slow the tool down much."""
        return bool((self.min_progress > 0.0).any())


def fit_curve(
    arms: Sequence[TrajectoryArm], q: FloatArray, stop: BoolArray, requirements: SegmentRequirements
) -> TrajectoryPoints:
    """Return the points of a curve through the targets at the ends of N straight segments.

    The points become one goal of the controller. The curve may stop at more targets than ``stop`` states, see
    ``SegmentRequirements.may_stop``.

    Args:
        arms: The arms that move.
        q: Joints of the start posture and of the N targets, (N + 1, D) [rad].
        stop: Whether each segment ends at rest, (N,); the last one always does.
        requirements: Requirements on the segments.

    Raises:
        PathNotKeptError: No points keep the path.
    """
    parts = _fit_parts(arms, q, requirements, np.flatnonzero(stop) + 1)
    parts_on_one_clock = [parts[0]]  # each later part starts at the last point of the previous one
    end_time = parts[0].t[-1]
    for part in parts[1:]:
        parts_on_one_clock.append(
            TrajectoryPoints(part.t[1:] + end_time, part.q[1:], part.v[1:], part.end[1:])
        )
        end_time += part.t[-1]
    return TrajectoryPoints(
        *(
            np.concatenate([getattr(part, name) for part in parts_on_one_clock])
            for name in ("t", "q", "v", "end")
        )
    )


@dataclasses.dataclass(frozen=True)
class _PointSequence:
    """Points from rest to rest.

    Attributes:
        q: Joints, (P, D) [rad].
        span: Times between points, (P - 1,) [s].
        end: Index of the given segment on which each point lies, (P,); -1 for the start.
        corner: Whether a point is a corner, (P,); it has a separate point before and after it.
    """

    q: FloatArray
    span: FloatArray
    end: IntArray
    corner: BoolArray


def _fit_parts(
    arms: Sequence[TrajectoryArm], q: FloatArray, requirements: SegmentRequirements, stops: IntArray
) -> list[TrajectoryPoints]:
    """Fit consecutive curves from rest to rest through the targets ``q`` (N + 1, D) [rad].

    The curves meet at the targets whose indices in ``q`` are ``stops``. Where no points keep the path, the
    motion also stops at the start and at the end of that segment, as far as the requirements allow it there.

    Returns:
        The curves in order, each with times from 0. ``end`` counts the N segments of all curves.

    Raises:
        PathNotKeptError: No points keep the path, and no further stop is allowed.
    """
    out: list[TrajectoryPoints] = []
    edges = sorted({0, *stops.tolist(), len(requirements.duration)})
    for a, b in itertools.pairwise(edges):
        joints = q[a : b + 1]
        section = requirements.section(a, b)
        try:
            parts = [_fit_from_rest(arms, joints, section)]
        except PathNotKeptError as error:
            # k: targets at both ends of the failing segment; may_stop[k - 1] is the segment before target k
            cuts = [k for k in (error.row, error.row + 1) if 0 < k < b - a and section.may_stop[k - 1]]
            if not cuts:
                raise PathNotKeptError(a + error.row, error.reason, error.feed_fraction) from None
            try:
                parts = _fit_parts(arms, joints, section, np.array(cuts))
            except PathNotKeptError as next_error:
                raise PathNotKeptError(
                    a + next_error.row, next_error.reason, next_error.feed_fraction
                ) from None
        out += [dataclasses.replace(part, end=part.end + a) for part in parts]
    return out


def _fit_from_rest(
    arms: Sequence[TrajectoryArm], q: FloatArray, requirements: SegmentRequirements
) -> TrajectoryPoints:
    """Fit one curve from rest to rest through ``q`` (N + 1, D) [rad], without stops between.

    Points are inserted until no tool deviates from its segments. Minimum feed and even speed are checked
    once, on the final points.

    Raises:
        PathNotKeptError: A limit cannot be kept, or points would be too close in time or too many.
    """
    count = len(requirements.duration)
    span = np.maximum(requirements.duration, MIN_INTERVAL_S)
    points = _PointSequence(q, span, np.arange(-1, count), np.zeros(count + 1, dtype=np.bool_))
    points = _with_corners(arms, points, requirements.has_min_feed)
    for number in range(_MAX_INSERTION_ROUNDS):
        points, v = _with_feasible_times(arms, points, requirements)
        deviating = _deviating_intervals(arms, points, v, requirements)
        if not deviating.any():
            _require_min_feed(arms, points, v, requirements)
            uneven = np.flatnonzero(_uneven_intervals(arms, points, v))
            if len(uneven):
                segment = int(points.end[uneven[0] + 1])
                raise PathNotKeptError(
                    segment, "between two points the tool would move backwards, or much faster than its feed"
                )
            return TrajectoryPoints(np.append(0.0, np.cumsum(points.span)), points.q, v, points.end)
        too_short = np.flatnonzero(deviating & (points.span < 2.0 * MIN_INTERVAL_S))
        if len(too_short):
            segment = int(points.end[too_short[0] + 1])
            raise PathNotKeptError(segment, "points would be too close in time to keep the path")
        halved = deviating if number < _SINGLE_ROUNDS else _with_adjacent(points, deviating)
        points = _insert_midpoints(arms, points, v, np.flatnonzero(halved))
    raise PathNotKeptError(
        int(points.end[np.flatnonzero(deviating)[0] + 1]), f"{len(points.q)} points do not keep the path"
    )


def _with_adjacent(points: _PointSequence, deviating: BoolArray) -> BoolArray:
    """Return which intervals between two points are to be halved, (P - 1,).

    These are the intervals ``deviating`` (P - 1,) and up to :data:`_ADJACENT_INTERVALS` on either side. If a
    single interval is halved, the spline oscillates into the next one. An adjacent interval is left out if it
    is too short to be halved, or starts or ends at a corner.
    """
    adjacent = np.zeros(len(deviating), dtype=np.bool_)
    indices = np.flatnonzero(deviating)[:, None] + np.arange(-_ADJACENT_INTERVALS, _ADJACENT_INTERVALS + 1)
    adjacent[np.clip(indices, 0, len(deviating) - 1)] = True
    free = (points.span >= 2.0 * MIN_INTERVAL_S) & ~(points.corner[:-1] | points.corner[1:])
    return np.asarray(deviating | (adjacent & free))


def _with_corners(
    arms: Sequence[TrajectoryArm], points: _PointSequence, has_min_feed: bool
) -> _PointSequence:
    """Insert a point before and a point after each corner, so close that the velocity changes only there.

    A spline through the corner itself would oscillate far to both sides. A corner is a target at which the
    joint velocity turns by more than 15 degrees, see :data:`CORNER_COSINE`, and next to which the moves are
    long enough for both points. Other targets are unchanged.

    The tool slows down uniformly to the corner and accelerates uniformly after it. With a minimum feed it may
    lose only half of the time that this takes.

    Args:
        arms: The arms that move.
        points: Targets, none of which is a corner yet.
        has_min_feed: Whether some segments have a minimum feed.
    """
    q, span = points.q, points.span
    max_velocity = np.concatenate([arm.robot.velocity for arm in arms])
    max_acceleration = np.concatenate([arm.robot.acceleration for arm in arms]) * ACCELERATION_FRACTION
    rate = np.diff(q, axis=0) / span[:, None]  # mean velocity of each interval (P - 1, D) [rad/s]
    scaled = rate / max_velocity
    size = np.maximum(np.linalg.norm(scaled, axis=1), 1e-12)
    cosine = dots(scaled[:-1], scaled[1:]) / (size[:-1] * size[1:])
    corner_rate = 0.5 * (rate[:-1] + rate[1:])  # velocity at a target if it is a corner
    # the arrays from here to `available_time` are per inner target (P - 2,): entry i is target i + 1
    min_time = (np.abs(rate[:-1] - corner_rate) / max_acceleration).max(axis=1)
    # with a minimum feed the tool has less time than uniform braking takes, so the points are farther away
    needed_time = np.maximum(4.0 * min_time if has_min_feed else min_time, MIN_INTERVAL_S)
    available_time = MAX_CORNER_FRACTION * np.minimum(span[:-1], span[1:])
    corners = np.flatnonzero((cosine < CORNER_COSINE) & (needed_time <= available_time)) + 1
    if not len(corners):
        return points
    corner_time = needed_time[corners - 1]
    # points on the straight segments before and after each corner, at `corner_time` from it
    corner_ends: list[FloatArray] = []
    for interval, fraction in (
        (corners - 1, 1.0 - corner_time / span[corners - 1]),
        (corners, corner_time / span[corners]),
    ):
        joints = q[interval] + fraction[:, None] * (q[interval + 1] - q[interval])
        for arm in carriers_first(arms):
            poses = interpolate_segments(
                arm.relative_pose(q), spread_fractions(fraction, interval, len(span))
            )[interval, 0]
            joints[:, arm.columns] = arm.solve_joints(poses, joints, interval)
        corner_ends.append(joints)
    corner_entry, corner_exit = corner_ends
    weight = 1.0 / max_velocity**2
    # a uniform change from speed s to c s over the distance s T takes the time 2 T / (1 + c); c is bounded
    # by -0.5, because the time would be infinite for a reversal
    slow_in, slow_out = (
        2.0
        * corner_time
        / (1.0 + np.clip(_relative_component(corner_rate[corners - 1], rate[interval], weight), -0.5, 1.0))
        for interval in (corners - 1, corners)
    )
    if has_min_feed:  # half of the lost time: mean of this time and of the time T without slowing down
        slow_in = 0.5 * (slow_in + corner_time)
        slow_out = 0.5 * (slow_out + corner_time)
    out_q = [q[0]]
    out_span: list[float] = []
    out_end = [int(points.end[0])]
    out_corner = [False]
    corner_numbers = {int(k): i for i, k in enumerate(corners)}  # index in `corners` by target
    for k in range(1, len(q)):
        # time of the interval before target k without the part that a corner at its start uses
        remaining = span[k - 1] - (corner_time[corner_numbers[k - 1]] if k - 1 in corner_numbers else 0.0)
        if k in corner_numbers:
            i = corner_numbers[k]
            out_q += [corner_entry[i], q[k], corner_exit[i]]
            out_span += [remaining - corner_time[i], slow_in[i], slow_out[i]]
            out_end += [int(points.end[k]), int(points.end[k]), int(points.end[k + 1])]
            out_corner += [False, True, False]
        else:
            out_q.append(q[k])
            out_span.append(remaining)
            out_end.append(int(points.end[k]))
            out_corner.append(False)
    return _PointSequence(np.array(out_q), np.array(out_span), np.array(out_end), np.array(out_corner))


def _relative_component(vector: FloatArray, other: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the components (K,) of vectors (K, D) along other vectors (K, D), as fractions of the latter.

    c = <vector, other> / <other, other>, with the scalar product weighted by ``weight`` (D,). For velocities,
    c is the ratio of the speed at a corner to the speed before or after it.
    """
    return np.asarray(
        (vector * other * weight).sum(axis=1) / np.maximum((other**2 * weight).sum(axis=1), 1e-18)
    )


def _velocities(points: _PointSequence, has_min_feed: bool) -> FloatArray:
    """Return the joint velocities (P, D) [rad/s] at the points, from splines between rests and corners.

    The velocity is 0 at the first and last point. A spline ends at the points next to a corner, where its
    velocity is that of the straight line to the adjacent point of the spline. At a corner the velocity is the
    mean of those at the points before and after it. With a minimum feed this mean is scaled up to
    :data:`CORNER_SPEED_FRACTION` of the slower one, at most by :data:`MAX_CORNER_SPEED_FACTOR`.
    """
    q, span = points.q, points.span
    t = np.append(0.0, np.cumsum(span))
    v = np.zeros_like(q)
    corners = np.flatnonzero(points.corner)
    # first and last point of each spline; corners belong to none
    first, last = np.append(0, corners + 1), np.append(corners - 1, len(q) - 1)
    for a, b in zip(first, last, strict=True):
        start_velocity = np.zeros(q.shape[1]) if a == 0 else (q[a + 1] - q[a]) / span[a]
        end_velocity = np.zeros(q.shape[1]) if b == len(q) - 1 else (q[b] - q[b - 1]) / span[b - 1]
        spline_points = slice(a, b + 1)
        v[spline_points] = CubicSpline(
            t[spline_points], q[spline_points], axis=0, bc_type=((1, start_velocity), (1, end_velocity))
        )(t[spline_points], 1)
        v[a] = start_velocity
        v[b] = end_velocity
    v[corners] = 0.5 * (v[corners - 1] + v[corners + 1])
    if has_min_feed and len(corners):
        speed = np.linalg.norm(v, axis=1)
        target_speed = CORNER_SPEED_FRACTION * np.minimum(speed[corners - 1], speed[corners + 1])
        factor = np.clip(target_speed / np.maximum(speed[corners], 1e-12), 1.0, MAX_CORNER_SPEED_FACTOR)
        v[corners] *= factor[:, None]
    return v


def _with_feasible_times(
    arms: Sequence[TrajectoryArm], points: _PointSequence, requirements: SegmentRequirements
) -> tuple[_PointSequence, FloatArray]:
    """Extend the times between points until joints and tools keep their speeds and accelerations.

    Returns:
        The points with their new times, and the joint velocities (P, D) [rad/s] at the points.

    Raises:
        PathNotKeptError: The limits do not hold after :data:`_MAX_TIMING_ROUNDS` rounds.
    """
    max_velocity = np.concatenate([arm.robot.velocity for arm in arms]) * SPEED_FRACTION
    max_acceleration = np.concatenate([arm.robot.acceleration for arm in arms]) * ACCELERATION_FRACTION
    for _ in range(_MAX_TIMING_ROUNDS):
        v = _velocities(points, requirements.has_min_feed)
        excess = _time_excess(arms, points, v, max_velocity, max_acceleration, requirements)
        if excess.max() <= 1.0:
            return points, v
        factor = np.maximum(excess, 1.0)
        # each interval is extended at least as much as its two neighbours, which the spline couples
        factor = np.maximum(factor, np.maximum(np.append(factor[1:], 1.0), np.append(1.0, factor[:-1])))
        # all intervals around a corner slow down together
        for corner in np.flatnonzero(points.corner).tolist():
            around = slice(max(corner - 2, 0), corner + 2)
            factor[around] = factor[around].max()
        # 5 % more than needed, because the spline changes with the times, but at most double in one round
        span = points.span * np.minimum(1.0 + 1.05 * (factor - 1.0), 2.0)
        points = dataclasses.replace(points, span=span)
    segment = int(points.end[int(np.argmax(excess)) + 1])
    raise PathNotKeptError(segment, "joints cannot follow at any tried speed")


def _time_excess(
    arms: Sequence[TrajectoryArm],
    points: _PointSequence,
    v: FloatArray,
    max_velocity: FloatArray,
    max_acceleration: FloatArray,
    requirements: SegmentRequirements,
) -> FloatArray:
    """Return the factors (P - 1,) by which the times between points are too short.

    A factor is at most 1 if the interval keeps all limits: joint speeds and accelerations, the speed of each
    tool on its segment, and the speed of each tool in the world. ``v`` (P, D) [rad/s] are the velocities at
    the points. ``max_velocity`` (D,) [rad/s] and ``max_acceleration`` (D,) [rad/s^2] limit the joints.
    """
    q, span = points.q, points.span
    T = span[:, None]
    change = np.diff(q, axis=0) / T
    # accelerations of the cubic at its two ends, between which they are linear
    first = (6.0 * change - 4.0 * v[:-1] - 2.0 * v[1:]) / T
    last = (-6.0 * change + 2.0 * v[:-1] + 4.0 * v[1:]) / T
    with np.errstate(divide="ignore", invalid="ignore"):
        # fraction of the time at which the acceleration is 0, so that the speed is extreme
        at = np.clip(np.nan_to_num(first / (first - last)), 0.0, 1.0)
    inner_velocity = v[:-1] + T * at * (first + 0.5 * at * (last - first))
    speed_excess = np.abs(np.stack([v[:-1], v[1:], inner_velocity])).max(axis=0) / max_velocity
    # accelerations fall with the square of the time
    acceleration_excess = np.sqrt(np.maximum(np.abs(first), np.abs(last)) / max_acceleration)
    out = np.maximum(speed_excess.max(axis=1), acceleration_excess.max(axis=1))
    samples = joints_between(q, span, v, np.linspace(0.0, 1.0, _PIECES + 1))
    for arm, max_speed in zip(arms, requirements.max_speed, strict=True):
        # without a carrier the relative pose is that in the world, so that one check covers both limits
        max_speed = np.minimum(max_speed[points.end[1:]], np.inf if arm.carrier else requirements.tcp_speed)
        out = np.maximum(
            out, _max_speeds(arm.relative_pose(samples), span) / (TOOL_SPEED_FRACTION * max_speed)
        )
        if arm.carrier:
            out = np.maximum(
                out, _max_speeds(arm.tcp_pose(samples), span) / (TOOL_SPEED_FRACTION * requirements.tcp_speed)
            )
    return np.asarray(out)


def _max_speeds(poses: FloatArray, span: FloatArray) -> FloatArray:
    """Return the maximum speeds (P - 1,) [m/s] of tools, from poses (P - 1, S, 4, 4) at equal time steps."""
    steps = np.linalg.norm(np.diff(poses[..., :3, 3], axis=1), axis=2)
    return np.asarray(steps.max(axis=1) * steps.shape[1] / span)


def _require_min_feed(
    arms: Sequence[TrajectoryArm], points: _PointSequence, v: FloatArray, requirements: SegmentRequirements
) -> None:
    """Check that a curve keeps the minimum feeds, and that no tool that melts the work nearly stops.

    Three conditions hold, with ``v`` (P, D) [rad/s] the velocities at the points:

    - A whole segment with a minimum feed takes at most the planned time or the time that the minimum feed
      allows, whichever is longer, times :data:`MIN_FEED_TIME_FACTOR`.
    - Within such a segment each tool keeps its ``min_speed`` on average over short intervals. This does not
      apply to the first and last segment, next to the rests, nor to segments that are planned slower.
    - In segments that melt, neither the joints nor a tool relative to the arm that holds the block nearly
      stop, see :func:`_nearly_stops`.

    Raises:
        PathNotKeptError: A condition does not hold.
    """
    # arrays per segment (N,), except `segment`, which is the segment of each interval (P - 1,)
    segment_time = np.bincount(points.end[1:], points.span, len(requirements.duration))
    has_min_feed = requirements.min_progress > 0.0
    max_time = (
        np.maximum(requirements.duration, 1.0 / np.where(has_min_feed, requirements.min_progress, np.inf))
        * MIN_FEED_TIME_FACTOR
    )
    feed_fraction = np.where(has_min_feed, max_time / segment_time, np.inf)
    segment = points.end[1:]
    samples = joints_between(points.q, points.span, v, np.linspace(0.0, 1.0, _PIECES + 1))
    # within segments the feed is checked where the planned times keep it
    is_bound = has_min_feed & (requirements.duration * requirements.min_progress <= MIN_FEED_TIME_FACTOR)
    is_bound[[0, -1]] = False  # the first segment starts at rest, the last one ends at rest
    for arm, min_speed in zip(arms, requirements.min_speed, strict=True):
        speed_ratio = (
            _min_mean_speeds(arm.relative_pose(samples)[..., :3, 3], points.span) * MIN_FEED_TIME_FACTOR
        )
        speed_ratio = np.where(
            is_bound[segment] & (min_speed[segment] > 0.0),
            speed_ratio / np.maximum(min_speed[segment], 1e-9),
            np.inf,
        )
        np.minimum.at(feed_fraction, segment, speed_ratio)
    if feed_fraction.min() < 1.0:
        reason = "tools would fall below the minimum feed"
        raise PathNotKeptError(int(np.argmin(feed_fraction)), reason, float(feed_fraction.min()))
    # joints are compared as fractions of their maximum speeds, at 8 pieces of each interval
    scale = np.concatenate([arm.robot.velocity for arm in arms])
    samples = samples[:, :: _PIECES // 8] / scale
    nearly_stops = _nearly_stops(samples, v / scale, points.span)
    for arm in arms:
        # both arms may move although the tool stands still relative to the carrier
        if arm.carrier is not None:
            marks, later_marks = (
                _marks(arm.relative_pose(joints)) for joints in (points.q, points.q + DIFFERENCE_STEP_S * v)
            )
            nearly_stops |= _nearly_stops(
                _marks(arm.relative_pose(samples * scale)),
                (later_marks - marks) / DIFFERENCE_STEP_S,
                points.span,
            )
    near_stops = np.flatnonzero(nearly_stops & requirements.melts[segment])
    if len(near_stops):
        raise PathNotKeptError(int(points.end[near_stops[0] + 1]), "joints would nearly stop")


def _min_mean_speeds(position: FloatArray, span: FloatArray) -> FloatArray:
    """Return the minimum mean speed (P - 1,) [m/s] of a TCP in each interval between two points.

    ``position`` (P - 1, S, 3) [m] are samples at equal time steps, with S - 1 a power of two. A mean is the
    straight distance over a part of the interval, divided by its time. The part is 1, 1/2, 1/4... of the
    interval, down to one step: the smallest one that lasts :data:`MIN_FEED_INTERVAL_S` or longer. It starts
    at each sample.
    """
    count = position.shape[1] - 1
    out = np.empty(len(span))
    parts = 2 ** np.floor(np.log2(np.clip(span / MIN_FEED_INTERVAL_S, 1.0, count))).astype(np.int64)
    for part in np.unique(parts).tolist():
        selected, steps = parts == part, count // part
        distances = np.linalg.norm(position[selected, steps:] - position[selected, :-steps], axis=2).min(
            axis=1
        )
        out[selected] = distances * part / span[selected]
    return out


def _marks(pose: FloatArray) -> FloatArray:
    """Return the positions (..., 9) [m] of three points that are fixed to a tool, at poses (..., 4, 4).

    The points are the TCP, and one each on the x and y axes of the tool. All three stand still only if the
    tool neither moves nor rotates.
    """
    points = (
        pose[..., :3, 3, None] + np.array([0.0, MARK_DISTANCE_M, MARK_DISTANCE_M]) * pose[..., :3, [2, 0, 1]]
    )
    return points.reshape(*pose.shape[:-2], 9)


def _nearly_stops(samples: FloatArray, rate: FloatArray, span: FloatArray) -> BoolArray:
    """Return in which intervals between two points a motion nearly stops, (P - 1,).

    A tool that melts the work would cut a wider kerf there, so that the curve is then refused. Entry i is the
    interval from point i to point i + 1. It nearly stops if its lowest speed is below
    :data:`STANDSTILL_FRACTION` of its mean speed, or if the speed at point i + 1 is below this fraction of
    the slower mean before and after that point. The first and last interval are always False, because the
    motion starts and ends at rest there.

    Args:
        samples: Positions at S equal time steps of each interval, including both ends, (P - 1, S, D). They
            are joints or points of a tool, in any unit.
        rate: Velocities at the points, (P, D), in this unit per second.
        span: Times between points, (P - 1,) [s].
    """
    # the mean speed is that along the straight line between the two ends of the interval
    mean = np.linalg.norm(samples[:, -1] - samples[:, 0], axis=1) / span
    min_speed = np.linalg.norm(np.diff(samples, axis=1), axis=2).min(axis=1) * (samples.shape[1] - 1) / span
    out = np.asarray(min_speed < STANDSTILL_FRACTION * mean)
    out[:-1] |= np.linalg.norm(rate[1:-1], axis=1) < STANDSTILL_FRACTION * np.minimum(mean[:-1], mean[1:])
    out[[0, -1]] = False
    return out


def joints_between(q: FloatArray, span: FloatArray, v: FloatArray, fractions: FloatArray) -> FloatArray:
    """Return the joints (P - 1, S, D) [rad] at fractions of the times between points.

    They lie on the cubics that the controller interpolates through positions and velocities of the points.

    Args:
        q: Joints of the points, (P, D) [rad].
        span: Times between points, (P - 1,) [s].
        v: Joint velocities at the points, (P, D) [rad/s].
        fractions: Fractions from 0 to 1, (S,), the same ones in each interval.
    """
    t = np.append(0.0, np.cumsum(span))
    times = t[:-1, None] + fractions * span[:, None]
    times[:, fractions == 1.0] = t[1:, None]  # exactly, without rounding into the next interval
    return np.asarray(CubicHermiteSpline(t, q, v, axis=0)(times))


def _deviating_intervals(
    arms: Sequence[TrajectoryArm], points: _PointSequence, v: FloatArray, requirements: SegmentRequirements
) -> BoolArray:
    """Return in which intervals a tool leaves the straight segment by more than the tolerances, (P - 1,).

    The segment is that between the two points of the interval. Position and orientation are compared at seven
    instants with the nearest pose on it. Points are inserted in these intervals.
    """
    out = np.zeros(len(points.span), dtype=bool)
    samples = joints_between(points.q, points.span, v, _CHECK_FRACTIONS)
    # not strict, because the default of max_rotation has two values also for one arm
    for arm, max_rotation in zip(arms, requirements.max_rotation, strict=False):
        ends = arm.relative_pose(points.q)
        poses = arm.relative_pose(samples)
        fraction, _, _ = segment_progress(ends, poses)
        expected = interpolate_segments(ends, fraction)
        deviation = np.linalg.norm(poses[..., :3, 3] - expected[..., :3, 3], axis=2)
        rotation = log_rotation(np.swapaxes(expected[..., :3, :3], -1, -2) @ poses[..., :3, :3])
        out |= (deviation > requirements.max_deviation).any(axis=1) | (
            np.linalg.norm(rotation, axis=2) > max_rotation
        ).any(axis=1)
    return out


def _uneven_intervals(arms: Sequence[TrajectoryArm], points: _PointSequence, v: FloatArray) -> BoolArray:
    """Return in which intervals a tool moves backwards or much faster than on average, (P - 1,).

    The rules of the proof refuse such a curve. The maximum speed in an interval is compared with the largest
    mean speed of this and the two adjacent intervals; the limit is :data:`MAX_SPEED_RATIO`. Intervals in
    which the tool moves at most :data:`MIN_MOVING_DISTANCE_M` are not checked.
    """
    out = np.zeros(len(points.span), dtype=np.bool_)
    samples = joints_between(points.q, points.span, v, np.linspace(0.0, 1.0, _PIECES + 1))
    for arm in arms:
        position = arm.relative_pose(samples)[..., :3, 3]
        chord = position[:, -1] - position[:, 0]
        length = np.linalg.norm(chord, axis=1)
        mean = np.pad(length / points.span, 1)  # 0 before the first and after the last interval
        steps = np.diff(position, axis=1)
        progress_steps = (steps * chord[:, None]).sum(axis=2) / np.maximum(length, 1e-9)[:, None]
        max_speed = np.linalg.norm(steps, axis=2).max(axis=1) * _PIECES / points.span
        nearby_mean = np.maximum(mean[1:-1], np.maximum(mean[:-2], mean[2:]))
        out |= (length > MIN_MOVING_DISTANCE_M) & (
            (max_speed > MAX_SPEED_RATIO * nearby_mean)
            # 0.01 mm: half of the proof's limit
            | (progress_steps.min(axis=1) < -0.2 * MAX_DEVIATION_M)
        )
    return out


def _insert_midpoints(
    arms: Sequence[TrajectoryArm], points: _PointSequence, v: FloatArray, intervals: IntArray
) -> _PointSequence:
    """Insert a point at half of the time of each of the ``intervals``, on the straight segments of all tools.

    ``intervals`` (K,) are indices i of intervals from point i to point i + 1. At the new point all arms have
    one common progress on their segments: the mean of their progress on the curve, weighted by how far they
    move and rotate.

    Raises:
        PathNotKeptError: An interval starts or ends at a corner, or a pose has no joint solution.
    """
    q, span, end = points.q, points.span, points.end
    next_to_corner = points.corner[intervals] | points.corner[intervals + 1]
    if next_to_corner.any():
        raise PathNotKeptError(
            int(end[intervals[next_to_corner][0] + 1]), "a corner there leaves the path at this speed"
        )
    middle = joints_between(q, span, v, np.array([0.5]))
    fractions, weights = [], []
    for arm in arms:
        fraction, length, angle = segment_progress(arm.relative_pose(q), arm.relative_pose(middle))
        fractions.append(fraction[intervals, 0])
        weights.append(length[intervals] + 0.3 * angle[intervals] + 1e-9)  # rotation counts as at 0.3 m
    # a cubic that overshoots the end of its segment would put the point on that end
    fraction = np.clip(
        np.average(fractions, axis=0, weights=weights), MIN_END_FRACTION, 1.0 - MIN_END_FRACTION
    )
    inserted = middle[intervals, 0]
    for arm in carriers_first(arms):
        poses = interpolate_segments(arm.relative_pose(q), spread_fractions(fraction, intervals, len(span)))
        inserted[:, arm.columns] = arm.solve_joints(poses[intervals, 0], inserted, end[intervals + 1])
    halved = span.copy()
    halved[intervals] *= 0.5
    return _PointSequence(
        np.insert(q, intervals + 1, inserted, axis=0),
        np.insert(halved, intervals + 1, halved[intervals]),
        np.insert(end, intervals + 1, end[intervals + 1]),
        np.insert(points.corner, intervals + 1, False),
    )
