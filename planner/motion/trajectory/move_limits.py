"""Lower limits of moves: the least feed that a process asks for, the least time that controllers need.

**Least feed.** Between stops a tool is as fast as a least feed asks for, in the mean over each move
and, at corners, at every instant by the share ``LEAST_SPEED_SHARE``. It comes up to it from a stop,
and goes down to the next one, no slower than a point that accelerates evenly over the run-up; so it
does where the least feed begins and ends, and between two feeds that no speed keeps both.

A move has one speed. Where a zone leaves hardly any time to change it, both moves beside the corner
would crawl over all of their length, which takes longer than a stop: there the tool stops.

**Least time.** Where moves are shorter than controllers like, neighbours on one line become one
move. Controllers plan a move for some 20 to 50 ms at least; a run of shorter ones ends in stops at
corners that nobody asked for (ABB: 50024, corner path failure; KUKA: approximation not possible).
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
from planner.issues import Issue, Severity, TandemError, aggregate
from planner.motion.planning_scene import Scene
from planner.motion.search.ladder_search import speed_limits
from planner.motion.search.subsampling import subset
from planner.motion.trajectory.joint_path import MOST_RAMP, Dense, JointPath, ends_of_ramps, joint_path
from planner.motion.trajectory.timing import RESERVE, SHORTEST, Clock, Limits, Rounded, TimedPiece, settled
from planner.targets import Targets

LEAST_SPEED_SHARE: Final = 0.82
"""A tool that rounds a corner is nowhere slower than this share of its least feed; the proof asks for 0.8."""
USED_TIME_SHARE: Final = 0.999
"""Moves take at most this share of the time they may, for it is rounded when it is written."""
KRL_TURN_RAD_S: Final = float(np.deg2rad(200.0))
"""How fast tools may turn in programs in KRL [rad/s], whose moves are led by their way."""
BENT_SHARE: Final = 0.99
"""A corner at which a tool is slower than this share of its speeds before and behind slows it by itself."""
CORNER_SAMPLES: Final = 33
"""Instants of a corner that are looked at."""


def require(scene: Scene, targets: Targets, samples: Dense, time: FloatArray) -> None:
    """Raises :class:`TandemError` where the clock ``time`` (N,) [s] does not keep the least feeds."""
    if targets.run_up is None or not np.any(targets.feed_min[1:] > 0.0):
        return
    took = np.diff(time, prepend=time[0])
    most = allowed(targets)
    slow = took > USED_TIME_SHARE * most
    late = np.flatnonzero(slow).tolist()
    issues = [_slow(scene, targets, samples, i, float(took[i]), float(most[i])) for i in late]
    issues += [*_corners(targets, took, slow), *_turns(scene, targets, samples, took)]
    causes = dict.fromkeys(issue.hint for issue in issues)  # each with its worst
    if causes:
        raise TandemError([one for why in causes for one in aggregate(i for i in issues if i.hint == why)])


def stretches(targets: Targets) -> list[tuple[int, int]]:
    """Runs of moves (first, last) to targets with a least feed, each between stops, or from where one begins
    to where it ends."""
    least, feed, stop = targets.feed_min, targets.feed, targets.stop
    out: list[tuple[int, int]] = []
    for i in range(1, targets.count):
        if least[i] <= 0.0:
            continue
        together = least[i] <= feed[i - 1] and least[i - 1] <= feed[i] and least[i - 1] > 0.0
        if out and out[-1][1] == i - 1 and not stop[i - 1] and together:
            out[-1] = out[-1][0], i
        else:
            out.append((i, i))
    return out


def allowed(targets: Targets) -> FloatArray:
    """The longest time (N,) [s] of the move to each target; infinite where it has no least feed."""
    run_up = targets.run_up or 0.0
    out = np.full(targets.count, np.inf)
    for first, last in stretches(targets):
        way = np.concatenate([[0.0], np.cumsum(targets.travel[first : last + 1])])
        middle = 0.5 * way[-1]
        rising = _ramp(np.minimum(way, middle), run_up)
        falling = _ramp(way[-1] - np.maximum(way, middle), run_up)
        out[first : last + 1] = np.diff(rising - falling) / targets.feed_min[first : last + 1]
    return out


def _ramp(way: FloatArray, run_up: float) -> FloatArray:
    """How long a point takes that speeds up evenly to the speed 1 over ``run_up`` [m] and goes on at it."""
    return np.where(way < run_up, 2.0 * np.sqrt(way * run_up), way + run_up)


def _slow(scene: Scene, targets: Targets, samples: Dense, i: int, took: float, most: float) -> Issue:
    """Why the move to target ``i`` takes longer than it may, by what would not do at the least feed."""
    hint = "lower feed_min_mm_s there, give 0 or a stop in the table"
    settings = scene.settings
    least = float(targets.feed_min[i]) / MM
    rows = np.flatnonzero(samples.move == i)
    rows = np.concatenate([[rows[0] - 1], rows])
    need = {}
    for arm in targets.arms:
        rate = np.abs(np.diff(samples.q[arm][rows], axis=0)).max(axis=0) * (len(rows) - 1) / most
        share = rate / (RESERVE * speed_limits(scene, arm))
        need[arm, int(np.argmax(share))] = float(share.max()), float(np.rad2deg(rate[int(np.argmax(share))]))
    (arm, joint), (share, rate) = max(need.items(), key=lambda item: item[1][0])
    travel = float(targets.travel[i])
    if USED_TIME_SHARE * most < SHORTEST / RESERVE:
        why = f"it goes {travel / MM:.3f} mm, and controllers plan no move in less than {SHORTEST * 1e3:g} ms"
        hint = "put the poses farther apart"
    elif travel / (RESERVE * settings.tcp_speed) > most * USED_TIME_SHARE:
        why = f"settings.tcp_speed_mm_s is {settings.tcp_speed / MM:g} mm/s, of which plans use {RESERVE:g}"
        hint = "raise it, or lower feed_min_mm_s"
    elif share > 1.0:
        allowed_rate = float(np.rad2deg(RESERVE * speed_limits(scene, arm)[joint]))
        why = f"joint {joint + 1} of {arm} would turn at {rate:.1f} deg/s, allowed {allowed_rate:.1f} deg/s"
        hint += "; or let more of the poses be free, or move the block"
    elif _at_an_end(targets, i):
        run_up = (targets.run_up or 0.0) / MM
        why = f"the joints' accelerations need a longer run-up than {run_up:g} mm from and to stops"
        hint = "give a longer run_up_mm, or lower feed_min_mm_s there"
    else:
        why = "the joints cannot change their speeds so fast as the corners there ask of them"
        hint += "; or round the corner over more poses, or let more of the poses be free"
    got = travel / took / MM
    return Issue(
        "motion.feed_min",
        f"the move to {targets.name(i)} runs at {got:.4g} mm/s and may take {most:.4g} s at the least feed "
        f"of {least:g} mm/s, run-up counted, but takes {took:.4g} s: {why}",
        arm=arm if share > 1.0 else None,
        index=i,
        target=targets.name(i),
        **measurement(got, least, "mm/s"),
        hint=hint,
    )


def _at_an_end(targets: Targets, i: int) -> bool:
    """Whether the move to target ``i`` is the first or last of its stretch, or in a run-up."""
    first, last = next((a, b) for a, b in stretches(targets) if a <= i <= b)
    before, behind = targets.travel[first:i].sum(), targets.travel[i + 1 : last + 1].sum()
    return i in (first, last) or min(before, behind) < (targets.run_up or 0.0)


def _corners(targets: Targets, took: FloatArray, slow: BoolArray) -> list[Issue]:
    """Corners that tools round at less than their share of the least feed: there they go evenly from the
    speed of one move to that of the next. Not where it is a move beside them that is ``slow`` (N,)."""
    out: list[Issue] = []
    for first, last in stretches(targets):
        moves = np.arange(first, last + 1)
        if len(moves) < 2:
            continue
        way = np.cumsum(targets.travel[moves])[:-1]
        run_up = np.minimum(way, targets.travel[moves].sum() - way) / (targets.run_up or np.inf)
        least = np.minimum(targets.feed_min[moves[:-1]], targets.feed_min[moves[1:]])
        limit = LEAST_SPEED_SHARE * least * np.sqrt(np.minimum(run_up, 1.0))
        scale = np.ones(len(moves))  # moves from and to stops end and begin faster than they are on average
        scale[[0, -1]] = ends_of_ramps(targets.travel[moves], took[moves])
        fastest = np.zeros((CORNER_SAMPLES, len(moves) - 1))
        beside = slow[moves[:-1]] | slow[moves[1:]]
        share = (np.arange(CORNER_SAMPLES) / (CORNER_SAMPLES - 1))[:, None, None]
        for pose in targets.pose.values():
            step = pose[moves, :3, 3] - pose[moves - 1, :3, 3]
            rate = step * (scale / took[moves])[:, None]
            between = (1.0 - share) * rate[:-1] + share * rate[1:]
            fastest = np.maximum(fastest, np.linalg.norm(between, axis=2))
        slowest = fastest.min(axis=0)
        bends = slowest < BENT_SHARE * np.minimum(fastest[0], fastest[-1])
        bad = np.flatnonzero((slowest < limit) & (bends | ~beside)).tolist()
        out += [_corner_issue(targets, first + k, float(slowest[k]), float(limit[k])) for k in bad]
    return out


def _turns(scene: Scene, targets: Targets, samples: Dense, took: FloatArray) -> list[Issue]:
    """Moves in which the tool of a KUKA arm turns faster than programs in KRL let it, so that it would be
    slow."""
    out = []
    rows = np.flatnonzero(samples.share == 1.0)
    for arm in targets.arms:
        chain = scene.chains[arm]
        if chain.robot.family != "KUKA":
            continue
        turned = chain.pose(samples.q[arm][rows])[:, :3, :3]
        angle = np.linalg.norm(log_rotation(np.swapaxes(turned[:-1], 1, 2) @ turned[1:]), axis=1)
        rate = angle / np.maximum(took[1:], 1e-9)
        for i in (np.flatnonzero((rate > KRL_TURN_RAD_S) & (targets.feed_min[1:] > 0.0)) + 1).tolist():
            got, limit = (float(np.rad2deg(value)) for value in (rate[i - 1], KRL_TURN_RAD_S))
            what = f"on the way to {targets.name(i)} the tool of {arm} turns at {got:.4g} deg/s; programs in "
            what += f"KRL with a least feed allow {limit:g} deg/s"
            measure: dict[str, Any] = {"value": got, "limit": limit, "unit": "deg/s"}
            hint = "lower feed_min_mm_s and feed_mm_s there, or turn the tool over a longer way"
            out.append(
                Issue("motion.feed_min", what, arm=arm, index=i, target=targets.name(i), hint=hint, **measure)
            )
    return out


def _corner_issue(targets: Targets, i: int, got: float, limit: float) -> Issue:
    name = targets.name(i)
    return Issue(
        "motion.feed_min",
        f"the corner at {name} is so sharp that the tool rounds it at {got / MM:.4g} mm/s, allowed is "
        f"{limit / MM:.4g} mm/s at least, {LEAST_SPEED_SHARE:g} of the least feed",
        index=i,
        target=name,
        **measurement(got / MM, limit / MM, "mm/s"),
        hint="give a stop there, or round the corner over more poses",
    )


SHARP_CORNER_SHARE: Final = 0.1
"""A corner that is rounded over less than this share of a move is sharp."""
CRAWL_FACTOR: Final = 3.0
"""Moves crawl that take so many times as long as their feeds ask for."""
WORTH_STOPPING_SHARE: Final = 0.8
"""Stops are made where the way takes less than this share of the time then."""
STOP_ROUNDS: Final = 3


def clocked_with_stops(
    scene: Scene,
    targets: Targets,
    samples: Dense,
    limits: Limits,
    rounded: Rounded,
    known: dict[bytes, TimedPiece] | None = None,
) -> tuple[Targets, JointPath, Clock]:
    """The path and its clock, and the targets with the stops that are worth it; ``known`` as for
    :func:`planner.motion.trajectory.timing.clock`. Raises
    :class:`planner.motion.trajectory.timing.TimingError`."""
    path = joint_path(scene, targets, samples, limits.speed)
    ticks = settled(path, limits, rounded, known)
    for _ in range(STOP_ROUNDS):
        sharp = _sharp_corners(targets, ticks, limits)
        if not sharp.any():
            break
        other = dataclasses.replace(targets, stop=targets.stop | sharp)
        way = joint_path(scene, other, samples, limits.speed)
        again = settled(way, limits, rounded, known)
        if again.time[-1] > WORTH_STOPPING_SHARE * ticks.time[-1]:
            break
        targets, path, ticks = other, way, again
    return targets, path, ticks


def _sharp_corners(targets: Targets, ticks: Clock, limits: Limits) -> BoolArray:
    """Sharp corners (N,) between moves that crawl, where one arm alone is at work and may stop: not where a
    least feed is asked for."""
    out = np.zeros(targets.count, dtype=bool)
    if not targets.may_stop or targets.coupled or len(targets.arms) > 1:
        return out
    took, least = np.diff(ticks.time, prepend=0.0), limits.least_time
    crawls = took[1:-1] + took[2:] > CRAWL_FACTOR * (least[1:-1] + least[2:])
    stands = (targets.feed_min[1:-1] == 0.0) & (targets.feed_min[2:] == 0.0) & ~targets.stop[1:-1]
    out[1:-1] = crawls & stands & (limits.rounded[1:-1] < SHARP_CORNER_SHARE)
    return out


def stop_notes(before: Targets, after: Targets) -> list[Issue]:
    """What users are told of stops that ``after`` has more than ``before``."""
    more = np.flatnonzero(after.stop & ~before.stop)
    if not len(more):
        return []
    first = int(more[0])
    what = (
        f"the arm stops at {len(more)} targets, first at {after.name(first)}, where it would have to pass a "
        "sharp corner at less than a third of the feed"
    )
    hint = "round these corners by more targets if it is not to stop there"
    name, count = after.name(first), float(len(more))
    return [Issue("motion.stops", what, Severity.NOTE, index=first, target=name, value=count, hint=hint)]


LEAST_MOVE_TIME_S: Final = 0.04
"""Least time of a move [s] that controllers take gladly,"""
LEAST_MOVE_WAY_MM: Final = 0.2
"""and its least way [mm]; turning counts by :data:`planner.geometry.corner_rounding.TURNING_LEVER_MM`."""
WANTED_TIME_FACTOR: Final = 1.25
"""Moves are joined until they last so many times the least time: the clock is worked out anew then."""
MOST_SLOWING_FACTOR: Final = 2.5
"""At most so many times as long as their feeds ask for do moves take so as to last the least time."""


def short(targets: Targets, values: FloatArray, time: FloatArray) -> BoolArray:
    """Whether (N,) the move to each target takes or goes less than controllers like; the first leads nowhere.

    ``values`` (N, F) of the freedoms, ``time`` (N,) [s].
    """
    out = (np.diff(time, prepend=-np.inf) < LEAST_MOVE_TIME_S) | (_ways(targets, values) < LEAST_MOVE_WAY_MM)
    out[0] = False
    return np.asarray(out)


def joined(targets: Targets, values: FloatArray, time: FloatArray, kept: IndexArray) -> IndexArray:
    """Those of the targets ``kept`` (K,) that stay where short moves are joined to longer ones.

    ``time`` (K,) [s] is the clock of the kept ones. No target is farther off the joined moves than a corner
    may be, along the way too, nor do two TCPs stand to each other otherwise than by ``targets.apart``, or by
    ``targets.ahead`` with one a move ahead. Targets that may not be joined stay, and so do stops, actions and
    the ends of segments.
    """
    if not targets.may_join or (len(targets.arms) > 1 and targets.apart <= 0.0):
        return kept
    brief = short(subset(targets, kept), values[kept], time)
    if not brief.any():
        return kept
    line = _Line(targets, values)
    fixed = _fixed(targets)[kept]
    stay = [0]
    for row in range(1, len(kept)):
        first = stay[-1]
        enough = (
            time[row] - time[first] >= WANTED_TIME_FACTOR * LEAST_MOVE_TIME_S
            and line.way(kept[first], kept[row]) >= LEAST_MOVE_WAY_MM
        )
        follows = row + 1 < len(kept) and not fixed[row] and not enough
        if follows and (brief[row] or brief[row + 1]) and line.straight(kept[first], kept[row + 1]):
            continue
        stay.append(row)
        short_end = (
            time[row] - time[first] < LEAST_MOVE_TIME_S
            or line.way(kept[first], kept[row]) < LEAST_MOVE_WAY_MM
        )
        if short_end and len(stay) > 2 and not fixed[first] and line.straight(kept[stay[-3]], kept[row]):
            stay.pop(-2)
    return kept[stay]


def picked(targets: Targets, kept: IndexArray) -> Targets:
    """The targets with the rows ``kept`` (K,) alone. Ways of joined moves are those of their parts together;
    they are no faster than any part may be."""
    place = np.zeros(targets.count, dtype=np.intp)
    place[kept] = np.arange(len(kept))
    starts = np.append(0, kept[:-1] + 1)
    travel, fastest, slowest = (
        np.add.reduceat(parts, starts)
        for parts in (
            targets.travel,
            _times(targets.travel, targets.feed),
            _times(targets.travel, targets.feed_min),
        )
    )
    alone = np.diff(kept, prepend=-1) == 1
    ends = targets.stop[kept]
    begins = np.append(True, ends[:-1])
    free = _times(targets.travel, targets.feed) <= 1.01 * SHORTEST  # their feeds say how short a move may be
    slowest_feed = np.minimum.reduceat(np.where(free, np.inf, targets.feed), starts)
    with np.errstate(divide="ignore", invalid="ignore"):
        feed = np.where(alone | (fastest <= 0.0), targets.feed[kept], travel / fastest)
    # moves from and to rest are faster in between: the feed of their part at the stop allows for that, unless
    # it is free, perhaps with next to no way at next to no feed
    bare = (begins & free[starts]) | (ends & free[kept])
    slow = np.where(bare, slowest_feed / MOST_RAMP, slowest_feed)
    slow = np.where(np.isfinite(slow), slow, feed)
    feed = np.where(alone, feed, np.where(begins | ends, slow, np.minimum(feed, slowest_feed)))
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.where(alone, targets.feed_min[kept], np.where(slowest > 0.0, travel / slowest, 0.0))
    return dataclasses.replace(
        subset(targets, kept),
        feed=feed,
        feed_min=np.where(np.isfinite(least), least, 0.0),
        travel=travel,
        actions=tuple(dataclasses.replace(a, at=int(place[a.at])) for a in targets.actions),
        claims=targets.claims,
        exhibits=targets.exhibits,
        issues=targets.issues,
    )


def slowed(targets: Targets, least: FloatArray) -> FloatArray:
    """Least times (N,) [s] by which short moves take longer than ``least`` (N,) [s] where no least feed is
    asked for, if short moves may be made longer at all."""
    free = (targets.feed_min == 0.0) & targets.may_join
    return np.where(
        free, np.maximum(least, np.minimum(LEAST_MOVE_TIME_S, MOST_SLOWING_FACTOR * least)), least
    )


def short_move_notes(targets: Targets, values: FloatArray, time: FloatArray) -> Iterator[Issue]:
    """A warning about moves that stay shorter than controllers like (``motion.short_moves``)."""
    rows = np.flatnonzero(short(targets, values, time))
    if not len(rows):
        return
    took, way = np.diff(time, prepend=0.0)[rows], _ways(targets, values)[rows]
    first, name = int(rows[0]), targets.name(int(rows[0]))
    many = "1 move takes" if len(rows) == 1 else f"{len(rows)} moves take"
    what = (
        f"{many} less than {LEAST_MOVE_TIME_S:g} s, or no more way than {LEAST_MOVE_WAY_MM:g} mm, first that "
        f"to {name}; the least take {took.min():.3f} s and go {way.min():.3f} mm: a controller may stop there"
    )
    hint = "give a coarser tolerance or path there"
    least = float(targets.travel[rows].min()) / MM
    if min(least, way.min()) > LEAST_MOVE_WAY_MM:
        feed = np.floor(least / LEAST_MOVE_TIME_S * 100.0) / 100.0
        hint = f"lower the feed there to {feed:g} mm/s, or {hint}"
    yield Issue(
        "motion.short_moves",
        what,
        Severity.WARNING,
        index=first,
        target=name,
        **measurement(float(took.min()), LEAST_MOVE_TIME_S, "s"),
        hint=hint,
    )


class _Line:
    """Poses of all arms at all targets, and whether targets lie on the straight move between two others."""

    def __init__(self, targets: Targets, values: FloatArray) -> None:
        poses = targets.poses(values).values()
        self.places = [pose[:, :3, 3].copy() for pose in poses]
        self.turns = [to_quaternion(pose[:, :3, :3]) for pose in poses]
        self.along = np.cumsum(_ways(targets, values))
        off = targets.rounding.deviations(targets.segment)
        self.allowed = np.minimum(off, corner_rounding.CORNER_DEVIATION_MM * MM)
        self.apart, self.ahead = targets.apart, targets.ahead
        self.rides = list(targets.ride.values())

    def way(self, first: int, last: int) -> float:
        """Way and turning [mm] from one target to another."""
        return float(self.along[last] - self.along[first])

    def straight(self, first: int, last: int) -> bool:
        """Whether all targets between two are passed within what is allowed [m], at the share of the way at
        which they stand."""
        whole = self.way(first, last)
        if whole <= 0.0:
            return True
        share = (self.along[first + 1 : last] - self.along[first]) / whole
        allowed = float(self.allowed[first + 1 : last + 1].min())
        for ride in self.rides:
            even = ride[first] + share * (ride[last] - ride[first])
            if (np.abs(even - ride[first + 1 : last]) > allowed).any():
                return False
        off = []
        for place, turns in zip(self.places, self.turns, strict=True):
            start, end = place[first], place[last]
            off.append(start + share[:, None] * (end - start) - place[first + 1 : last])
            away = lengths(off[-1])
            if (away > allowed).any():
                return False
            turned = _off_turn(turns[first : last + 1], share)
            if (away + MM * corner_rounding.TURNING_LEVER_MM * turned > allowed).any():
                return False
        if len(off) < 2:
            return True
        return self._together(first, last) and not np.any(lengths(off[1] - off[0]) > self.apart)

    def _together(self, first: int, last: int) -> bool:
        """Whether two TCPs keep their distance within ``ahead`` with either of them a move ahead."""
        if np.isinf(self.ahead):
            return True
        one, two = (place[[first, last]] for place in self.places)
        apart = lengths(one[:, None] - two)
        return bool(np.abs(apart[[0, 1], [1, 0]][:, None] - apart[[0, 1], [0, 1]]).max() <= self.ahead)


def _off_turn(turns: FloatArray, share: FloatArray) -> FloatArray:
    """Angles (K,) [rad] by which the rotations between the ends of ``turns`` (K + 2, 4), quaternions w, x, y,
    z, are off one that turns evenly from end to end, at the ``share`` (K,) of its way. With quaternions, as
    this is asked thousands of times of a few rotations each."""
    w, v = turns[0, 0], turns[0, 1:]
    back = np.empty((4, 4))  # a product with it is one from the left with the first, inverted
    back[0, 0], back[0, 1:], back[1:, 0] = w, v, -v
    back[1:, 1:] = w * np.eye(3) - skew(v)
    since = turns[1:] @ back.T
    whole, since = since[-1] if since[-1, 0] >= 0.0 else -since[-1], since[:-1]
    sine = float(np.sqrt(whole[1:] @ whole[1:]))
    axis = whole[1:] / (sine or 1.0)
    half = float(np.arctan2(sine, whole[0])) * share
    c, s = np.cos(half), np.sin(half)
    along = since[:, 1:] @ axis
    left = (
        c[:, None] * since[:, 1:]
        - (s * since[:, 0])[:, None] * axis
        - s[:, None] * (since[:, 1:] @ skew(axis).T)
    )
    return np.asarray(2.0 * np.arctan2(lengths(left), np.abs(c * since[:, 0] + s * along)))


def _ways(targets: Targets, values: FloatArray) -> FloatArray:
    """Ways (N,) [mm] to the targets, turning included: of the arm that goes farthest."""
    out = np.zeros(targets.count)
    for pose in targets.poses(values).values():
        moved = lengths(np.diff(pose[:, :3, 3], axis=0)) / MM
        turn = log_rotation(np.swapaxes(pose[:-1, :3, :3], -1, -2) @ pose[1:, :3, :3])
        out[1:] = np.maximum(out[1:], moved + corner_rounding.TURNING_LEVER_MM * lengths(turn))
    return out


def _fixed(targets: Targets) -> BoolArray:
    """Targets (N,) that stay: ends, stops, those with actions, and the last ones of segments."""
    out = targets.stop.copy()
    out[[0, -1]] = True
    out[[action.at for action in targets.actions]] = True
    out[:-1] |= np.array([a != b for a, b in zip(targets.segment[:-1], targets.segment[1:], strict=True)])
    return np.asarray(out)


def _times(travel: FloatArray, speed: FloatArray) -> FloatArray:
    """Times (N,) [s] of ways at speeds; of no way at no speed: without end."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(travel > 0.0, travel / speed, 0.0)
