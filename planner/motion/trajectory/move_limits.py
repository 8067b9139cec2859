"""Lower limits of moves: minimum feed of the process, minimum duration of the controllers.

**Minimum feed.** Between stops a tool is at least as fast as the minimum feed, on average over each move. At
corners it has at every instant at least :data:`MIN_CORNER_SPEED_FRACTION` of the minimum feed. The tool
accelerates from a stop, and brakes before the next one, at least as fast as a point that accelerates evenly
over the run-up. The same holds where the minimum feed starts and ends, and between two moves of which one has
a minimum feed above the feed of the other.

**Stops at sharp corners.** A controller executes each move at one speed. If a zone leaves hardly any time to
change it, both moves at the corner would be slow over their whole length, which takes longer than a stop.
There the tool stops.

**Minimum duration.** Moves that are shorter than controllers handle well are joined with neighbours on one
line. Controllers plan a move for about 20 to 50 ms at least. A run of shorter ones ends in unintended stops
at corners (ABB: 50024, corner path failure; KUKA: approximation not possible).
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from planner.geometry import corner_rounding
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IndexArray,
    lengths,
    log_rotation,
    skew,
    to_quaternion,
)
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, aggregate
from planner.motion.planning_scene import Scene
from planner.motion.search.layered_graph_search import speed_limits
from planner.motion.search.subsampling import select_targets
from planner.motion.trajectory.joint_path import (
    MAX_RAMP_RATIO,
    JointPath,
    MoveSamples,
    fit_joint_path,
    ramp_end_ratios,
)
from planner.motion.trajectory.timing import (
    MIN_SEGMENT_TIME_S,
    SPEED_FRACTION,
    Clock,
    ClockLimits,
    CornerFractions,
    TimedPiece,
    settle_clock,
)
from planner.targets import Targets

MIN_CORNER_SPEED_FRACTION: Final = 0.82
"""Minimum speed of a tool at a corner, as a fraction of the minimum feed. The proof requires 0.8."""
USED_TIME_FRACTION: Final = 0.999
"""Fraction of the allowed duration that moves may take, because durations are rounded in programs."""
KRL_MAX_ANGULAR_SPEED_RAD_S: Final = float(np.deg2rad(200.0))
"""Maximum angular speed [rad/s] of tools in KRL programs whose moves are led by their path length."""
SLOWING_CORNER_RATIO: Final = 0.99
"""Ratio of the slowest speed at a corner to the lower of the speeds before and after it. Below this ratio the
corner itself slows the tool.
"""
CORNER_SAMPLES: Final = 33
"""Number of instants at which a corner is evaluated."""


def require_min_feeds(scene: Scene, targets: Targets, samples: MoveSamples, time: FloatArray) -> None:
    """Require that the clock keeps the minimum feeds.

    Moves, corners and, for KUKA arms, rotations of the tool are checked. Nothing is required of targets
    without a run-up, whose slow moves are only warned of.

    Args:
        scene: Cell with the arms.
        targets: N targets.
        samples: Samples of the moves.
        time: (N,) [s] times of the targets.

    Raises:
        TandemError: ``motion.feed_min``.
    """
    if targets.run_up is None or not np.any(targets.feed_min[1:] > 0.0):
        return
    durations = np.diff(time, prepend=time[0])
    max_times = max_move_times(targets)
    is_slow = durations > USED_TIME_FRACTION * max_times
    slow_moves = np.flatnonzero(is_slow).tolist()
    issues = [
        _slow_move_issue(scene, targets, samples, i, float(durations[i]), float(max_times[i]))
        for i in slow_moves
    ]
    issues += [
        *_slow_corner_issues(targets, durations, is_slow),
        *_krl_rotation_issues(scene, targets, samples, durations),
    ]
    hints = dict.fromkeys(issue.hint for issue in issues)
    if hints:  # issues with the same hint have the same cause and are reported as one
        raise TandemError(
            [issue for hint in hints for issue in aggregate(i for i in issues if i.hint == hint)]
        )


def min_feed_runs(targets: Targets) -> list[tuple[int, int]]:
    """Return the runs of moves that keep a minimum feed, as indices of the first and the last target.

    A run ends at a stop, at the end of the minimum feed, and between two moves of which one has a minimum
    feed above the feed of the other.
    """
    min_feed, feed, stop = targets.feed_min, targets.feed, targets.stop
    out: list[tuple[int, int]] = []
    for i in range(1, targets.count):
        if min_feed[i] <= 0.0:
            continue
        is_compatible = min_feed[i] <= feed[i - 1] and min_feed[i - 1] <= feed[i] and min_feed[i - 1] > 0.0
        if out and out[-1][1] == i - 1 and not stop[i - 1] and is_compatible:
            out[-1] = out[-1][0], i
        else:
            out.append((i, i))
    return out


def max_move_times(targets: Targets) -> FloatArray:
    """Return the longest allowed duration (N,) [s] of the move to each target; inf without a minimum feed.

    At the start and the end of each run, a move may take as long as a point that accelerates or brakes evenly
    over the run-up.
    """
    run_up = targets.run_up or 0.0
    out = np.full(targets.count, np.inf)
    for first, last in min_feed_runs(targets):
        distance = np.concatenate([[0.0], np.cumsum(targets.travel[first : last + 1])])
        middle = 0.5 * distance[-1]
        rising = _run_up_time(np.minimum(distance, middle), run_up)
        falling = _run_up_time(distance[-1] - np.maximum(distance, middle), run_up)
        out[first : last + 1] = np.diff(rising - falling) / targets.feed_min[first : last + 1]
    return out


def _run_up_time(distance: FloatArray, run_up: float) -> FloatArray:
    """Return the time at which a point has covered a distance, in the time for 1 m at its final speed.

    The point accelerates evenly to that speed over ``run_up`` [m] and continues at it.
    """
    return np.where(distance < run_up, 2.0 * np.sqrt(distance * run_up), distance + run_up)


def _slow_move_issue(
    scene: Scene, targets: Targets, samples: MoveSamples, i: int, duration: float, max_time: float
) -> Issue:
    """Return the issue of a move that takes too long, with what prevents the minimum feed.

    Args:
        scene: Cell with the arms.
        targets: Targets of the path.
        samples: Samples of the moves.
        i: Target to which the move leads.
        duration: Duration [s] of the move.
        max_time: Longest allowed duration [s].
    """
    hint = "lower feed_min_mm_s there, or state 0 or a stop in the table"
    settings = scene.settings
    min_feed = float(targets.feed_min[i]) / MM
    rows = np.flatnonzero(samples.move == i)
    rows = np.concatenate([[rows[0] - 1], rows])  # with the target from which the move starts
    # The fastest joint of each arm in the allowed time: fraction of its speed limit, and speed [deg/s].
    joint_speeds = {}
    for arm in targets.arms:
        rate = np.abs(np.diff(samples.q[arm][rows], axis=0)).max(axis=0) * (len(rows) - 1) / max_time
        fraction = rate / (SPEED_FRACTION * speed_limits(scene, arm))
        joint_speeds[arm, int(np.argmax(fraction))] = (
            float(fraction.max()),
            float(np.rad2deg(rate[int(np.argmax(fraction))])),
        )
    (arm, joint), (fraction, rate) = max(joint_speeds.items(), key=lambda item: item[1][0])
    travel = float(targets.travel[i])
    if USED_TIME_FRACTION * max_time < MIN_SEGMENT_TIME_S / SPEED_FRACTION:
        cause = (
            f"it is {travel / MM:.3f} mm long, and controllers plan no move below "
            f"{MIN_SEGMENT_TIME_S * 1e3:g} ms"
        )
        hint = "space the poses farther apart"
    elif travel / (SPEED_FRACTION * settings.tcp_speed) > max_time * USED_TIME_FRACTION:
        cause = (
            f"settings.tcp_speed_mm_s is {settings.tcp_speed / MM:g} mm/s, of which plans use "
            f"{SPEED_FRACTION:g}"
        )
        hint = "raise it, or lower feed_min_mm_s"
    elif fraction > 1.0:
        allowed_rate = float(np.rad2deg(SPEED_FRACTION * speed_limits(scene, arm)[joint]))
        cause = f"joint {joint + 1} of {arm} would turn at {rate:.1f} deg/s, allowed {allowed_rate:.1f} deg/s"
        hint += "; or give the poses more freedom, or move the stock"
    elif _is_at_run_end(targets, i):
        run_up = (targets.run_up or 0.0) / MM
        cause = f"the joint accelerations need a longer run-up than {run_up:g} mm from and to stops"
        hint = "state a longer run_up_mm, or lower feed_min_mm_s there"
    else:
        cause = "the joints cannot change their speeds as fast as the corners there require"
        hint += "; or round the corner over more poses, or give the poses more freedom"
    got = travel / duration / MM
    return Issue(
        "motion.feed_min",
        f"the move to {targets.name(i)} runs at {got:.4g} mm/s and may take {max_time:.4g} s at the minimum "
        f"feed of {min_feed:g} mm/s, including the run-up, but takes {duration:.4g} s: {cause}",
        arm=arm if fraction > 1.0 else None,
        index=i,
        target=targets.name(i),
        **measurement(got, min_feed, "mm/s"),
        hint=hint,
    )


def _is_at_run_end(targets: Targets, i: int) -> bool:
    """Whether the move to target ``i`` is the first or last of its run, or in a run-up."""
    first, last = next((a, b) for a, b in min_feed_runs(targets) if a <= i <= b)
    distance_before, distance_after = targets.travel[first:i].sum(), targets.travel[i + 1 : last + 1].sum()
    return i in (first, last) or min(distance_before, distance_after) < (targets.run_up or 0.0)


def _slow_corner_issues(targets: Targets, durations: FloatArray, is_slow: BoolArray) -> list[Issue]:
    """Return issues of corners that tools round below :data:`MIN_CORNER_SPEED_FRACTION` of the minimum feed.

    At a corner the velocity changes linearly from that of one move to that of the next. Corners next to a
    slow move are skipped if that move is the cause.

    Args:
        targets: N targets.
        durations: (N,) [s] durations of the moves.
        is_slow: (N,) whether a move takes too long, which is an issue of its own.
    """
    out: list[Issue] = []
    for first, last in min_feed_runs(targets):
        moves = np.arange(first, last + 1)
        if len(moves) < 2:
            continue
        distance = np.cumsum(targets.travel[moves])[:-1]
        run_up = np.minimum(distance, targets.travel[moves].sum() - distance) / (targets.run_up or np.inf)
        min_feed = np.minimum(targets.feed_min[moves[:-1]], targets.feed_min[moves[1:]])
        # after the fraction f of its run-up, a point that accelerates evenly has the fraction sqrt(f) of its
        # speed
        limit = MIN_CORNER_SPEED_FRACTION * min_feed * np.sqrt(np.minimum(run_up, 1.0))
        scale = np.ones(len(moves))  # moves from and to stops are faster at their moving end than on average
        scale[[0, -1]] = ramp_end_ratios(targets.travel[moves], durations[moves])
        fastest = np.zeros((CORNER_SAMPLES, len(moves) - 1))
        is_next_to_slow = is_slow[moves[:-1]] | is_slow[moves[1:]]
        progress = (np.arange(CORNER_SAMPLES) / (CORNER_SAMPLES - 1))[:, None, None]
        for pose in targets.pose.values():
            step = pose[moves, :3, 3] - pose[moves - 1, :3, 3]
            rate = step * (scale / durations[moves])[:, None]
            velocity = (1.0 - progress) * rate[:-1] + progress * rate[1:]
            fastest = np.maximum(fastest, np.linalg.norm(velocity, axis=2))
        slowest = fastest.min(axis=0)
        slows_itself = slowest < SLOWING_CORNER_RATIO * np.minimum(fastest[0], fastest[-1])
        slow_corners = np.flatnonzero((slowest < limit) & (slows_itself | ~is_next_to_slow)).tolist()
        out += [
            _make_corner_issue(targets, first + k, float(slowest[k]), float(limit[k])) for k in slow_corners
        ]
    return out


def _krl_rotation_issues(
    scene: Scene, targets: Targets, samples: MoveSamples, durations: FloatArray
) -> list[Issue]:
    """Return issues of moves on which the tool of a KUKA arm rotates faster than KRL programs allow.

    The controller would slow such a move below the minimum feed. ``durations`` (N,) [s] are those of the
    moves.
    """
    out = []
    rows = np.flatnonzero(samples.fraction == 1.0)
    for arm in targets.arms:
        chain = scene.chains[arm]
        if chain.robot.family != "KUKA":
            continue
        rotations = chain.pose(samples.q[arm][rows])[:, :3, :3]
        angle = np.linalg.norm(log_rotation(np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]), axis=1)
        rate = angle / np.maximum(durations[1:], 1e-9)
        for i in (
            np.flatnonzero((rate > KRL_MAX_ANGULAR_SPEED_RAD_S) & (targets.feed_min[1:] > 0.0)) + 1
        ).tolist():
            got, limit = (float(np.rad2deg(value)) for value in (rate[i - 1], KRL_MAX_ANGULAR_SPEED_RAD_S))
            message = f"on the move to {targets.name(i)} the tool of {arm} turns at {got:.4g} deg/s; KRL "
            message += f"programs with a minimum feed allow {limit:g} deg/s"
            fields: dict[str, Any] = {"value": got, "limit": limit, "unit": "deg/s"}
            hint = "lower feed_min_mm_s and feed_mm_s there, or turn the tool over a longer path"
            out.append(
                Issue(
                    "motion.feed_min", message, arm=arm, index=i, target=targets.name(i), hint=hint, **fields
                )
            )
    return out


def _make_corner_issue(targets: Targets, i: int, got: float, limit: float) -> Issue:
    """Return the issue of the corner at target ``i``, which is rounded at ``got`` [m/s] below ``limit``."""
    name = targets.name(i)
    return Issue(
        "motion.feed_min",
        f"the corner at {name} is so sharp that the tool rounds it at {got / MM:.4g} mm/s (at least "
        f"{limit / MM:.4g} mm/s required, {MIN_CORNER_SPEED_FRACTION:g} of the minimum feed)",
        index=i,
        target=name,
        **measurement(got / MM, limit / MM, "mm/s"),
        hint="state a stop there, or round the corner over more poses",
    )


SHARP_CORNER_FRACTION: Final = 0.1
"""Fraction of a move below which a corner that is rounded over it is sharp."""
MIN_CRAWL_RATIO: Final = 3.0
"""Ratio of the duration of two moves to the minimum duration by their feeds above which the moves crawl."""
MAX_STOPPING_TIME_RATIO: Final = 0.8
"""Ratio of the durations with and without stops below which the stops are made."""
MAX_STOP_ROUNDS: Final = 3
"""Maximum number of rounds in which stops are added."""


def clock_with_stops(
    scene: Scene,
    targets: Targets,
    samples: MoveSamples,
    limits: ClockLimits,
    corner_fractions: CornerFractions,
    clock_pieces: dict[bytes, TimedPiece] | None = None,
) -> tuple[Targets, JointPath, Clock]:
    """Compute the joint path and its clock, and add stops at sharp corners that save time.

    All sharp corners become stops together. They are kept if the whole motion then takes at most
    :data:`MAX_STOPPING_TIME_RATIO` times as long.

    Args:
        scene: Cell with the arms.
        targets: N targets.
        samples: Samples of the moves.
        limits: Limits of the clock.
        corner_fractions: Returns the corner fractions for durations and stops.
        clock_pieces: Timed pieces, as for :func:`planner.motion.trajectory.timing.compute_clock`.

    Returns:
        The targets with added stops, their joint path and their clock.

    Raises:
        TimingError: No clock exists.
    """
    path = fit_joint_path(scene, targets, samples, limits.speed)
    clock = settle_clock(path, limits, corner_fractions, clock_pieces)
    for _ in range(MAX_STOP_ROUNDS):
        is_sharp = _sharp_corners(targets, clock, limits)
        if not is_sharp.any():
            break
        stopping_targets = dataclasses.replace(targets, stop=targets.stop | is_sharp)
        stopping_path = fit_joint_path(scene, stopping_targets, samples, limits.speed)
        stopping_clock = settle_clock(stopping_path, limits, corner_fractions, clock_pieces)
        if stopping_clock.time[-1] > MAX_STOPPING_TIME_RATIO * clock.time[-1]:
            break
        targets, path, clock = stopping_targets, stopping_path, stopping_clock
    return targets, path, clock


def _sharp_corners(targets: Targets, clock: Clock, limits: ClockLimits) -> BoolArray:
    """Return for each of N targets whether it is a sharp corner between crawling moves.

    Moves crawl if they take much longer than their feeds require. Only corners at which the tool may stop
    count. It may if a single arm works, and if neither of the moves has a minimum feed.
    """
    out = np.zeros(targets.count, dtype=bool)
    if not targets.may_stop or targets.coupled or len(targets.arms) > 1:
        return out
    durations, min_time = np.diff(clock.time, prepend=0.0), limits.min_time
    crawls = durations[1:-1] + durations[2:] > MIN_CRAWL_RATIO * (min_time[1:-1] + min_time[2:])
    may_stop = (targets.feed_min[1:-1] == 0.0) & (targets.feed_min[2:] == 0.0) & ~targets.stop[1:-1]
    out[1:-1] = crawls & may_stop & (limits.corner_fractions[1:-1] < SHARP_CORNER_FRACTION)
    return out


def stop_notes(targets_before: Targets, targets_after: Targets) -> list[Issue]:
    """Return a note on the stops that were added to the targets; no note if none were."""
    new_stops = np.flatnonzero(targets_after.stop & ~targets_before.stop)
    if not len(new_stops):
        return []
    first = int(new_stops[0])
    name, count = targets_after.name(first), float(len(new_stops))
    message = format_message("motion.stops", stop_count=len(new_stops), target=name)
    hint = "round these corners over more targets to avoid the stops"
    return [Issue("motion.stops", message, Severity.NOTE, index=first, target=name, value=count, hint=hint)]


MIN_MOVE_TIME_S: Final = 0.04
"""Minimum duration [s] of a move that controllers handle well."""
MIN_MOVE_LENGTH_MM: Final = 0.2
"""Minimum length [mm] of a move that controllers handle well. Rotation counts by
:data:`planner.geometry.corner_rounding.ROTATION_LEVER_MM`.
"""
JOINED_TIME_FACTOR: Final = 1.25
"""Factor of the minimum duration up to which moves are joined, because the clock is computed again
afterwards.
"""
MAX_SLOWING_FACTOR: Final = 2.5
"""Maximum factor by which moves are slowed to reach the minimum duration."""


def are_short(targets: Targets, values: FloatArray, time: FloatArray) -> BoolArray:
    """Return for each of N targets whether the move to it is too short for controllers, in time or length.

    Such moves are joined where possible, and reported if they remain. Entry i is the move from target i - 1
    to target i. The first target has no move, so its value is False. The length includes rotation and is
    that of the arm that moves farthest.

    Args:
        targets: N targets.
        values: (N, F) values of the freedoms.
        time: (N,) [s] times of the targets.
    """
    out = (np.diff(time, prepend=-np.inf) < MIN_MOVE_TIME_S) | (
        _move_lengths(targets, values) < MIN_MOVE_LENGTH_MM
    )
    out[0] = False
    return np.asarray(out)


def join_short_moves(targets: Targets, values: FloatArray, time: FloatArray, kept: IndexArray) -> IndexArray:
    """Select the targets that remain if short moves are joined into longer ones.

    No target deviates from the joined moves by more than a corner may, neither across nor along the path. Two
    TCPs keep their relative position within ``targets.max_tcp_distance_error``, and within
    ``targets.max_lead_lag`` if one is a move ahead. Stops, targets with actions and the ends of segments
    remain.

    Args:
        targets: All targets.
        values: (N, F) values of the freedoms.
        time: (K,) [s] clock of the kept targets.
        kept: (K,) targets that remained so far.

    Returns:
        Indices of the targets that remain; ``kept`` if these targets may not be joined.
    """
    if not targets.may_join or (len(targets.arms) > 1 and targets.max_tcp_distance_error <= 0.0):
        return kept
    is_short = are_short(select_targets(targets, kept), values[kept], time)
    if not is_short.any():
        return kept
    line = _StraightMoves(targets, values)
    fixed = _are_fixed(targets)[kept]
    kept_rows = [0]
    for row in range(1, len(kept)):
        first = kept_rows[-1]
        is_long_enough = (
            time[row] - time[first] >= JOINED_TIME_FACTOR * MIN_MOVE_TIME_S
            and line.distance(kept[first], kept[row]) >= MIN_MOVE_LENGTH_MM
        )
        # Leave a target out if the move that ends there is short and can be joined with the next one.
        may_join = row + 1 < len(kept) and not fixed[row] and not is_long_enough
        if (
            may_join
            and (is_short[row] or is_short[row + 1])
            and line.are_straight(kept[first], kept[row + 1])
        ):
            continue
        kept_rows.append(row)
        # If the move is still short, try to join it with the previous one instead.
        is_still_short = (
            time[row] - time[first] < MIN_MOVE_TIME_S
            or line.distance(kept[first], kept[row]) < MIN_MOVE_LENGTH_MM
        )
        if (
            is_still_short
            and len(kept_rows) > 2
            and not fixed[first]
            and line.are_straight(kept[kept_rows[-3]], kept[row])
        ):
            kept_rows.pop(-2)
    return kept[kept_rows]


def select_joined(targets: Targets, kept: IndexArray) -> Targets:
    """Return the targets that remain after short moves were joined.

    The path length of a joined move is the sum of its parts. A joined move is no faster than any part may be.

    Args:
        targets: All targets.
        kept: (K,) indices of the targets that remain.
    """
    new_index = np.zeros(targets.count, dtype=np.intp)
    new_index[kept] = np.arange(len(kept))
    starts = np.append(0, kept[:-1] + 1)
    travel, min_time, max_time = (
        np.add.reduceat(parts, starts)
        for parts in (
            targets.travel,
            _move_times(targets.travel, targets.feed),
            _move_times(targets.travel, targets.feed_min),
        )
    )
    is_single = np.diff(kept, prepend=-1) == 1
    ends_at_stop = targets.stop[kept]
    starts_at_stop = np.append(True, ends_at_stop[:-1])
    # a free move has no feed of its own: its feed only states the minimum duration of a move
    free = _move_times(targets.travel, targets.feed) <= 1.01 * MIN_SEGMENT_TIME_S  # 1 % for rounding
    slowest_feed = np.minimum.reduceat(np.where(free, np.inf, targets.feed), starts)
    with np.errstate(divide="ignore", invalid="ignore"):
        feed = np.where(is_single | (min_time <= 0.0), targets.feed[kept], travel / min_time)
    # Moves from and to rest are faster in between. The feed of their part at the stop allows for that, unless
    # that part is free, possibly with almost no length at almost no feed.
    has_free_end = (starts_at_stop & free[starts]) | (ends_at_stop & free[kept])
    ramp_feed = np.where(has_free_end, slowest_feed / MAX_RAMP_RATIO, slowest_feed)
    ramp_feed = np.where(np.isfinite(ramp_feed), ramp_feed, feed)
    is_ramp = starts_at_stop | ends_at_stop
    feed = np.where(is_single, feed, np.where(is_ramp, ramp_feed, np.minimum(feed, slowest_feed)))
    with np.errstate(divide="ignore", invalid="ignore"):
        min_feed = np.where(
            is_single, targets.feed_min[kept], np.where(max_time > 0.0, travel / max_time, 0.0)
        )
    return dataclasses.replace(
        select_targets(targets, kept),
        feed=feed,
        feed_min=np.where(np.isfinite(min_feed), min_feed, 0.0),
        travel=travel,
        actions=tuple(dataclasses.replace(a, target=int(new_index[a.target])) for a in targets.actions),
        claims=targets.claims,
        exhibits=targets.exhibits,
        issues=targets.issues,
    )


def with_slowed_short_moves(targets: Targets, min_times: FloatArray) -> FloatArray:
    """Return minimum durations (N,) [s] of the moves, in which those of short moves are lengthened.

    They are lengthened if no minimum feed is required and if the targets may be joined.

    Args:
        targets: N targets.
        min_times: (N,) [s] minimum durations.
    """
    free = (targets.feed_min == 0.0) & targets.may_join
    return np.where(
        free, np.maximum(min_times, np.minimum(MIN_MOVE_TIME_S, MAX_SLOWING_FACTOR * min_times)), min_times
    )


def short_move_warnings(targets: Targets, values: FloatArray, time: FloatArray) -> Iterator[Issue]:
    """Yield one warning ``motion.short_moves`` if moves remain shorter than controllers handle well.

    If the moves are long enough and only too fast, the hint suggests a feed at which they are not.

    Args:
        targets: N targets of the final path.
        values: (N, F) values of the freedoms.
        time: (N,) [s] times of the targets.
    """
    rows = np.flatnonzero(are_short(targets, values, time))
    if not len(rows):
        return
    durations, lengths = np.diff(time, prepend=0.0)[rows], _move_lengths(targets, values)[rows]
    first, name = int(rows[0]), targets.name(int(rows[0]))
    count_text = "1 move is" if len(rows) == 1 else f"{len(rows)} moves are"
    message = format_message(
        "motion.short_moves",
        moves=count_text,
        min_time_s=MIN_MOVE_TIME_S,
        min_length_mm=MIN_MOVE_LENGTH_MM,
        target=name,
        shortest_time_s=durations.min(),
        shortest_length_mm=lengths.min(),
    )
    hint = "use a coarser tolerance or path there"
    shortest = float(targets.travel[rows].min()) / MM
    if min(shortest, lengths.min()) > MIN_MOVE_LENGTH_MM:
        feed = np.floor(shortest / MIN_MOVE_TIME_S * 100.0) / 100.0
        hint = f"lower the feed there to {feed:g} mm/s, or {hint}"
    yield Issue(
        "motion.short_moves",
        message,
        Severity.WARNING,
        index=first,
        target=name,
        **measurement(float(durations.min()), MIN_MOVE_TIME_S, "s"),
        hint=hint,
    )


class _StraightMoves:
    """Tests whether targets lie on the linear move between two other targets.

    Attributes:
        positions: For each arm the positions (N, 3) [m] of its TCP.
        quaternions: For each arm the rotations (N, 4) of its TCP.
        path_length: (N,) [mm] path length to each target, including rotation.
        allowed: (N,) [m] deviation that each target may have.
    """

    def __init__(self, targets: Targets, values: FloatArray) -> None:
        """Prepare the tests; ``values`` (N, F) are those of the freedoms."""
        poses = targets.poses(values).values()
        self.positions = [pose[:, :3, 3].copy() for pose in poses]
        self.quaternions = [to_quaternion(pose[:, :3, :3]) for pose in poses]
        self.path_length = np.cumsum(_move_lengths(targets, values))
        deviations = targets.rounding.deviations(targets.segment)
        self.allowed = np.minimum(deviations, corner_rounding.CORNER_DEVIATION_MM * MM)
        self.max_distance_error, self.max_lead_lag = targets.max_tcp_distance_error, targets.max_lead_lag
        self.track_values = list(targets.track_positions.values())

    def distance(self, first: int, last: int) -> float:
        """Return the path length [mm] between two targets, including rotation."""
        return float(self.path_length[last] - self.path_length[first])

    def are_straight(self, first: int, last: int) -> bool:
        """Whether a linear move from one target to another passes all targets between them closely enough.

        Each target is compared with the point at its fraction of the path length. The distance, including
        rotation, must not exceed the allowed deviation, and two TCPs must keep their relative position.
        """
        whole_length = self.distance(first, last)
        if whole_length <= 0.0:
            return True
        fraction = (self.path_length[first + 1 : last] - self.path_length[first]) / whole_length
        allowed = float(self.allowed[first + 1 : last + 1].min())
        for track in self.track_values:
            interpolated = track[first] + fraction * (track[last] - track[first])
            if (np.abs(interpolated - track[first + 1 : last]) > allowed).any():
                return False
        offsets = []
        for position, quaternion in zip(self.positions, self.quaternions, strict=True):
            start, end = position[first], position[last]
            offsets.append(start + fraction[:, None] * (end - start) - position[first + 1 : last])
            distance = lengths(offsets[-1])
            if (distance > allowed).any():
                return False
            rotation_error = _rotation_errors(quaternion[first : last + 1], fraction)
            if (distance + MM * corner_rounding.ROTATION_LEVER_MM * rotation_error > allowed).any():
                return False
        if len(offsets) < 2:
            return True
        return self._keep_distance(first, last) and not np.any(
            lengths(offsets[1] - offsets[0]) > self.max_distance_error
        )

    def _keep_distance(self, first: int, last: int) -> bool:
        """Whether the distance of two TCPs changes by at most ``max_lead_lag`` if one is a move ahead.

        The move from ``first`` to ``last`` may be finished by one arm and not started by the other.
        """
        if np.isinf(self.max_lead_lag):
            return True
        first_ends, second_ends = (position[[first, last]] for position in self.positions)
        distances = lengths(first_ends[:, None] - second_ends)
        return bool(
            np.abs(distances[[0, 1], [1, 0]][:, None] - distances[[0, 1], [0, 1]]).max() <= self.max_lead_lag
        )


def _rotation_errors(quaternions: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the angles (K,) [rad] between inner rotations and an even rotation from the first to the last.

    Quaternions are used because this is called thousands of times with a few rotations each.

    Args:
        quaternions: (K + 2, 4) rotations w, x, y, z: the first, K inner ones and the last.
        fraction: (K,) fraction of the even rotation at which each inner rotation is compared.
    """
    w, v = quaternions[0, 0], quaternions[0, 1:]
    inverse_product = np.empty((4, 4))  # matrix of the left product with the inverse of the first quaternion
    inverse_product[0, 0], inverse_product[0, 1:], inverse_product[1:, 0] = w, v, -v
    inverse_product[1:, 1:] = w * np.eye(3) - skew(v)
    relative = quaternions[1:] @ inverse_product.T
    whole, relative = relative[-1] if relative[-1, 0] >= 0.0 else -relative[-1], relative[:-1]
    sine = float(np.sqrt(whole[1:] @ whole[1:]))
    axis = whole[1:] / (sine or 1.0)
    half_angle = float(np.arctan2(sine, whole[0])) * fraction
    # error quaternion: the inverse of the even rotation (c, s axis) times the relative rotation
    c, s = np.cos(half_angle), np.sin(half_angle)
    along_axis = relative[:, 1:] @ axis
    error = (
        c[:, None] * relative[:, 1:]
        - (s * relative[:, 0])[:, None] * axis
        - s[:, None] * (relative[:, 1:] @ skew(axis).T)
    )
    return np.asarray(2.0 * np.arctan2(lengths(error), np.abs(c * relative[:, 0] + s * along_axis)))


def _move_lengths(targets: Targets, values: FloatArray) -> FloatArray:
    """Return the length (N,) [mm] of the move to each target, including rotation.

    It is that of the arm that moves farthest.
    """
    out = np.zeros(targets.count)
    for pose in targets.poses(values).values():
        distance = lengths(np.diff(pose[:, :3, 3], axis=0)) / MM
        rotation = log_rotation(np.swapaxes(pose[:-1, :3, :3], -1, -2) @ pose[1:, :3, :3])
        out[1:] = np.maximum(out[1:], distance + corner_rounding.ROTATION_LEVER_MM * lengths(rotation))
    return out


def _are_fixed(targets: Targets) -> BoolArray:
    """Return for each of N targets whether it must remain when short moves are joined.

    These are both ends, stops, targets with actions, and the last targets of segments.
    """
    out = targets.stop.copy()
    out[[0, -1]] = True
    out[[action.target for action in targets.actions]] = True
    out[:-1] |= np.array([a != b for a, b in zip(targets.segment[:-1], targets.segment[1:], strict=True)])
    return np.asarray(out)


def _move_times(travel: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the durations (N,) [s] of path lengths [m] at speeds [m/s]; 0 without length."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(travel > 0.0, travel / speed, 0.0)
