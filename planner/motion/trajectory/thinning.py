"""Fewer targets where moves are shorter than controllers like: neighbours on one line become one move.

Controllers plan a move for some 20 to 50 ms at least; a run of shorter ones ends in stops at corners that
nobody asked for (ABB: 50024, corner path failure; KUKA: approximation not possible).
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from planner.geometry import corner_rounding
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, lengths
from planner.geometry.rigid import interpolate, log_rotation
from planner.issues import Issue, Severity
from planner.motion.search.subsampling import subset
from planner.motion.trajectory.joint_path import MOST_RAMP
from planner.motion.trajectory.timing import SHORTEST
from planner.targets import Targets
from planner.units import MM

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


def short_move_notes(targets: Targets, values: FloatArray, time: FloatArray) -> list[Issue]:
    """A warning about moves that stay shorter than controllers like (``motion.short_moves``)."""
    rows = np.flatnonzero(short(targets, values, time))
    if not len(rows):
        return []
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
    return [
        Issue(
            "motion.short_moves",
            what,
            Severity.WARNING,
            index=first,
            target=name,
            value=float(took.min()),
            limit=LEAST_MOVE_TIME_S,
            unit="s",
            hint=hint,
        )
    ]


class _Line:
    """Poses of all arms at all targets, and whether targets lie on the straight move between two others."""

    def __init__(self, targets: Targets, values: FloatArray) -> None:
        self.poses = targets.poses(values)
        self.along = np.cumsum(_ways(targets, values))
        off = targets.rounding.deviations(targets.segment)
        self.allowed = np.minimum(off, corner_rounding.CORNER_DEVIATION_MM * MM)
        self.apart, self.ahead = targets.apart, targets.ahead

    def way(self, first: int, last: int) -> float:
        """Way and turning [mm] from one target to another."""
        return float(self.along[last] - self.along[first])

    def straight(self, first: int, last: int) -> bool:
        """Whether all targets between two are passed within what is allowed [m], at the share of the way at
        which they stand."""
        inner = np.arange(first + 1, last)
        whole = self.way(first, last)
        if whole <= 0.0:
            return True
        share = (self.along[inner] - self.along[first]) / whole
        allowed = float(self.allowed[first + 1 : last + 1].min())
        off = []
        for pose in self.poses.values():
            there = interpolate(pose[first], pose[last], share)
            off.append(there[:, :3, 3] - pose[inner, :3, 3])
            turn = log_rotation(np.swapaxes(there[:, :3, :3], -1, -2) @ pose[inner, :3, :3])
            if np.any(lengths(off[-1]) + MM * corner_rounding.TURNING_LEVER_MM * lengths(turn) > allowed):
                return False
        if len(off) < 2:
            return True
        return self._together(first, last) and not np.any(lengths(off[1] - off[0]) > self.apart)

    def _together(self, first: int, last: int) -> bool:
        """Whether two TCPs keep their distance within ``ahead`` with either of them a move ahead."""
        if np.isinf(self.ahead):
            return True
        one, two = (pose[[first, last], :3, 3] for pose in self.poses.values())
        apart = lengths(one[:, None] - two)
        return bool(np.abs(apart[[0, 1], [1, 0]][:, None] - apart[[0, 1], [0, 1]]).max() <= self.ahead)


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
