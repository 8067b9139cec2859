"""How a tool follows a way of tips and axes, in order, and how fast it may be at each place of it.

The order counts also where the way crosses itself, goes back on itself, or turns the tool in place.
The feed may change along a way.
"""

import dataclasses
import math
from bisect import bisect_left
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.milling.claims import MillsAlong
from planner.proof.replay.moves import ACCURACY

Row = list[float]

AXIS_LEVER = 0.05
"""What a turn of the axis by one radian counts as, against ways of the tip [m]."""
SEARCH_AHEAD = 0.05
"""How far ahead on its way [m] a tool is looked for."""
WRITTEN_ROUNDING = 1e-7
"""How far [m] written places are off what they stand for: half of the last digit along each axis. A corner
that is rounded by all that is allowed is off by so much more or less."""
_PAIRS_AT_ONCE = 200_000
"""Pairs of a place and a piece of a track that are worked on at once."""
_PLACES_AT_ONCE = 16_384
"""Places of a track that are plain numbers at once."""


@dataclasses.dataclass(frozen=True)
class Followed:
    """Of T samples: how far the tip is ``off`` its way (T,) [m] and the axis ``turn`` (T,) [rad] off the one
    that is wanted there; ``missed``: how many places of the way the motion does not pass.
    ``at`` (T,) [m]: how far along the way each sample is, places being ``along`` (K,) [m], turns with
    ``AXIS_LEVER``; it never falls."""

    off: FloatArray
    turn: FloatArray
    missed: int
    at: FloatArray
    along: FloatArray


def follow(claim: MillsAlong, tip: FloatArray, axis: FloatArray, some: IntArray | None = None) -> Followed:
    """How the track ``tip``, ``axis`` (N, 3), which goes straight from sample to sample, follows the claimed
    way by its samples ``some`` (T,), else by all.

    Each of them is put on the first stretch of the way from where the one before is that it keeps the
    tolerances to, or as far along the stretches that follow as it keeps them without a break and nears the
    way. One that keeps them to none counts by the nearest, and the next goes on from where this one began.
    Every place that is passed over must be near the track between both samples, or the next ones beside
    them: on a corner the place may be nearer to the leg that the tool has left.
    """
    way = _Way(claim)
    rows = np.arange(len(tip)) if some is None else some
    count = len(rows)
    off, turn, at = np.empty(count), np.empty(count), np.empty(count)
    passed = np.zeros(len(claim.tip), dtype=np.int64)
    stretch, share = 0, 0.0
    for i, (own_tip, own_axis) in enumerate(_numbers(tip, axis, rows)):
        near = way.put(own_tip, own_axis, stretch, share)
        off[i], turn[i] = near.apart, near.angle
        if near.cost > 1.0:
            at[i] = way.at(stretch, share)
            continue
        passed[stretch + 1 : near.stretch + 1] = i
        stretch, share = near.stretch, near.share
        at[i] = way.at(stretch, share)
    passed[stretch + 1 :] = count
    # a tool that turns back sharply stays on the stretch that it leaves until it is off that
    waits = np.flatnonzero(np.append(True, np.diff(at) > 0.0))
    since = waits[np.searchsorted(waits, np.maximum(passed - 1, 0), side="right") - 1]
    low = rows[np.maximum(since - 1, 0)]
    high = rows[np.minimum(passed + 1, count - 1)]
    missed = _missed(claim, tip, axis, low, high)
    return Followed(off, turn, missed, at, np.array(way.along))


def _numbers(tip: FloatArray, axis: FloatArray, rows: IntArray) -> Iterator[tuple[Row, Row]]:
    """Tips and axes at ``rows`` (T,) as plain numbers, which take ten times the memory of arrays."""
    for first in range(0, len(rows), _PLACES_AT_ONCE):
        some = rows[first : first + _PLACES_AT_ONCE]
        yield from zip(tip[some].tolist(), axis[some].tolist(), strict=True)


def _missed(claim: MillsAlong, tip: FloatArray, axis: FloatArray, low: IntArray, high: IntArray) -> int:
    """How many places (K,) of a way the track ``tip``, ``axis`` (N, 3) does not pass between its samples
    ``low`` and ``high`` (K,), each no sooner than the ones before it: a step back that is left out lies on
    the track too, but in another order."""
    missed, reached = 0, 0.0
    ends = np.cumsum(np.maximum(high - low, 1))
    start = 0
    while start < len(low):
        stop = max(start + 1, int(np.searchsorted(ends, ends[start] + _PAIRS_AT_ONCE)))
        place, first, last = _stretches_near(claim, tip, axis, low[start:stop], high[start:stop], start)
        bounds = np.searchsorted(place, np.arange(start, stop + 1))
        soonest, latest = first.tolist(), last.tolist()
        for begin, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
            found = next((k for k in range(begin, end) if latest[k] >= reached), None)
            if found is None:
                missed += 1
            else:
                reached = max(reached, soonest[found])
        start = stop
    return missed


def _stretches_near(
    claim: MillsAlong, tip: FloatArray, axis: FloatArray, low: IntArray, high: IntArray, start: int
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Where the track is near the places from number ``start`` on, each between its samples ``low`` and
    ``high`` (K,): M stretches of it, by place and in order, each the place (M,) and where it begins and ends
    (M,), as the number of a sample and a share of the way to the next one."""
    number = np.maximum(high - low, 1)
    begun = np.cumsum(number) - number
    own = np.repeat(np.arange(len(low)), number)
    piece = low[own] + np.arange(len(own)) - begun[own]
    after = np.minimum(piece + 1, len(tip) - 1)
    place = start + own
    within = passing_tolerance(claim)
    ends = [
        _shares_within(tip[piece] - claim.tip[place], tip[after] - tip[piece], within),
        _shares_within(axis[piece] - claim.axis[place], axis[after] - axis[piece], claim.turn),
    ]
    first, last = np.maximum(ends[0][0], ends[1][0]), np.minimum(ends[0][1], ends[1][1])
    near = np.flatnonzero(first <= last)
    return place[near], piece[near] + first[near], piece[near] + last[near]


def _shares_within(off: FloatArray, step: FloatArray, within: float) -> tuple[FloatArray, FloatArray]:
    """First and last share (M,), from 0 to 1, of steps (M, 3) at which what begins ``off`` (M, 3) a place is
    no farther than ``within`` from it; infinite and below where there is none."""
    square = np.maximum((step * step).sum(axis=1), 1e-30)
    middle = -(off * step).sum(axis=1) / square
    nearest = off + middle[:, None] * step
    room = (within * within - (nearest * nearest).sum(axis=1)) / square
    half = np.sqrt(np.maximum(room, 0.0))
    first, last = np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)
    none = (room < 0.0) | (first > last)
    return np.where(none, np.inf, first), np.where(none, -np.inf, last)


def passing_tolerance(claim: MillsAlong) -> float:
    """How near [m] a tool passes the places of its way: what is rounded within the tolerance of both legs of
    a corner, which is no less than how near arms are taken to keep to them anyway, is off the corner by the
    root of two of that at 90 degrees, by less at wider ones, and by more at sharper ones, where arms stop;
    and what is written is rounded."""
    return math.sqrt(2.0) * max(claim.tolerance, ACCURACY) + WRITTEN_ROUNDING


def rows_to_check(tip: FloatArray, axis: FloatArray, tolerance: float) -> IntArray:
    """Rows (K,) of samples (T, 3) at which a way is held against what is claimed: all that are two tolerances
    [m] apart, and both ends. Between them a tool goes no farther off than by one more."""
    if len(tip) < 2:
        return np.arange(len(tip))
    ways = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    ways = np.maximum(ways, AXIS_LEVER * np.linalg.norm(np.diff(axis, axis=0), axis=1))
    number = np.floor(np.append(0.0, np.cumsum(ways)) / (2.0 * tolerance))
    # the first sample behind each mark; the last one before it, too, where the next is farther on than that
    marks = np.diff(number)
    return np.flatnonzero(np.append(True, marks > 0.0) | np.append(marks > 1.0, True))


class _Near(NamedTuple):
    """A place on a way: ``share`` of a stretch, by its number; how far a sample is off there [m], [rad] and
    of what is allowed."""

    stretch: int
    share: float
    apart: float
    angle: float
    cost: float


class _Way:
    """A claimed way as stretches from place to place, along which the tip goes straight and the axis turns
    evenly by the shortest turn."""

    def __init__(self, claim: MillsAlong) -> None:
        self.claim = claim
        self.tip, self.axis = claim.tip, claim.axis
        self.step, lean = np.diff(claim.tip, axis=0), np.diff(claim.axis, axis=0)
        square = np.maximum((self.step * self.step).sum(axis=1), 1e-24)
        leant = np.maximum((lean * lean).sum(axis=1), 1e-24)
        angle = 2.0 * np.arcsin(np.clip(0.5 * np.sqrt(leant), 0.0, 1.0))
        # samples come one after the other, and few stretches are looked at for each: plain numbers are faster
        self.along: Row = np.append(0.0, np.cumsum(np.sqrt(square + AXIS_LEVER**2 * leant))).tolist()
        self.places: list[tuple[Row, Row]] = list(zip(claim.tip.tolist(), claim.axis.tolist(), strict=True))
        self.steps: list[Row] = self.step.tolist()
        self.leans: list[Row] = lean.tolist()
        half, wide = np.maximum(0.5 * angle, 1e-12), np.maximum(angle, 1e-9)
        # squares of step and lean; half of the turn, and all of it, each with its sine
        sizes = [square, leant, half, np.sin(half), wide, np.sin(wide)]
        self.sizes: list[Row] = np.stack(sizes, axis=1).tolist()

    def at(self, stretch: int, share: float) -> float:
        """How far along the way [m] a share of a stretch is."""
        return self.along[stretch] + share * (self.along[stretch + 1] - self.along[stretch])

    def put(self, tip: Row, axis: Row, stretch: int, share: float) -> _Near:
        """Where a sample is on the stretches ahead, from ``share`` of ``stretch`` on: the first one that it
        keeps the tolerances to, or the nearest of those that follow it as long as it keeps them, of equal
        ones the first; where it keeps them to none, the nearest of all."""
        here = self.at(stretch, share)
        end = bisect_left(self.along, here + SEARCH_AHEAD + 20.0 * self.claim.tolerance)
        end = min(max(end, stretch + 1), len(self.step))
        near = best = self._near(tip, axis, stretch, share)
        for number in range(stretch + 1, end):
            if near.cost <= 1.0:
                break
            near = self._near(tip, axis, number)
            best = near if near.cost < best.cost else best
        return self._onward(tip, axis, near, end) if near.cost <= 1.0 else best

    def _onward(self, tip: Row, axis: Row, first: _Near, end: int) -> _Near:
        """The nearest stretch among those from ``first`` on that keep the tolerances, as do all places
        between them; of equal ones the first."""
        kept = [first]
        for number in range(first.stretch + 1, end):
            near = self._near(tip, axis, number)
            if near.cost > 1.0 or self._cost(*_off(tip, axis, *self.places[number])) > 1.0:
                break
            kept.append(near)
        least = min(near.cost for near in kept)
        return next(near for near in kept if near.cost <= least + 1e-6)

    def _near(self, tip: Row, axis: Row, number: int, least: float = 0.0) -> _Near:
        """Where a sample is nearest to a stretch, not before ``least`` of it. It is looked for by the tip and
        by the axis, of which one may stand still; the better one counts."""
        start, lean_from = self.places[number]
        square, leant, half, sine_of_half, _, _ = self.sizes[number]
        by_tip = _dot(_less(tip, start), self.steps[number]) / square
        chord = min(max(_dot(_less(axis, lean_from), self.leans[number]) / leant, 0.0), 1.0)
        by_axis = 0.5 + 0.5 * math.asin((2.0 * chord - 1.0) * sine_of_half) / half
        first, second = (max(min(max(guess, 0.0), 1.0), least) for guess in (by_tip, by_axis))
        near = self._at(tip, axis, number, first)
        if second == first:
            return near
        other = self._at(tip, axis, number, second)
        return other if other.cost < near.cost else near

    def _at(self, tip: Row, axis: Row, number: int, share: float) -> _Near:
        """How far a sample is off a place of a stretch."""
        start, lean_from = self.places[number]
        lean_to, step = self.places[number + 1][1], self.steps[number]
        *_, wide, sine = self.sizes[number]
        one, two = math.sin((1.0 - share) * wide) / sine, math.sin(share * wide) / sine
        apart, turn = _off(tip, axis, _sum(start, 1.0, step, share), _sum(lean_from, one, lean_to, two))
        return _Near(number, share, apart, turn, self._cost(apart, turn))

    def _cost(self, apart: float, angle: float) -> float:
        """How far off, of what is allowed."""
        return max(apart / (self.claim.tolerance + WRITTEN_ROUNDING), angle / self.claim.turn)


def _off(tip: Row, axis: Row, place: Row, wanted: Row) -> tuple[float, float]:
    """How far [m] and [rad] a sample is off one place and axis, as :func:`_apart` says it of many."""
    return math.dist(tip, place), 2.0 * math.asin(min(0.5 * math.dist(axis, wanted), 1.0))


def _less(a: Row, b: Row) -> Row:
    return [a[0] - b[0], a[1] - b[1], a[2] - b[2]]


def _sum(a: Row, one: float, b: Row, two: float) -> Row:
    return [one * a[0] + two * b[0], one * a[1] + two * b[1], one * a[2] + two * b[2]]


def _dot(a: Row, b: Row) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


FEED_TOLERANCES = 2.0
"""Feeds that begin or end so many tolerances ahead or behind count, too: corners are rounded, and where the
tool is on its way is known no better."""


def allowed(claim: MillsAlong, some: IntArray, found: Followed, count: int) -> FloatArray:
    """The feed (T - 1,) [m/s] from each of T samples to the next, of which the rows ``some`` (K,) were put on
    the way: the highest of all stretches that the tool may be on meanwhile."""
    before = np.clip(np.searchsorted(some, np.arange(count - 1), side="right") - 1, 0, len(some) - 1)
    after = np.clip(np.searchsorted(some, np.arange(1, count), side="left"), 0, len(some) - 1)
    near = FEED_TOLERANCES * claim.tolerance
    last = len(found.along) - 2
    first = np.searchsorted(found.along, found.at[before] - near, side="right") - 1
    end = np.searchsorted(found.along, found.at[after] + near, side="left") - 1
    first = np.clip(first, 0, last)
    return highest(claim.feed[1:], first, np.clip(end, first, last))


def highest(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """The highest (M,) of the values from each of ``first`` (M,) to ``last`` (M,), both with it; by the
    highest of all stretches of 1, 2, 4 ... values."""
    level = np.floor(np.log2(last - first + 1)).astype(np.int64)
    out, table = np.empty(len(first)), values
    for k in range(int(level.max(initial=0)) + 1):
        rows = np.flatnonzero(level == k)
        out[rows] = np.maximum(table[first[rows]], table[last[rows] - (1 << k) + 1])
        table = np.maximum(table[: -(1 << k) or None], table[1 << k :]) if len(table) > 1 << k else table
    return out
