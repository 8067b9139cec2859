"""Joint trajectories through a plan's targets: points with velocities, as dense as straight ways ask for.

A controller lays a cubic through positions and velocities of two points. The velocities are those of splines
with continuous accelerations from rest to rest, or from corner to corner. Where the tool would leave the
straight way between two targets by more than ``KEPT`` a point is set between them, on that way, and the
spline laid anew. Where joints would be too fast, or sped up too fast, points come later."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, log_rotation
from planner.languages.trajectories.writer.straight_ways import (
    Driven,
    NotKeptError,
    carriers_first,
    share_gone,
    spread,
    straight,
)

KEPT: Final = 0.05e-3
"""How far [m] a tool may leave the straight way between two points at most,"""
KEPT_TURN: Final = float(np.deg2rad(0.05))
"""and how far [rad] it may be turned off it."""
GOES: Final = 0.09e-3
"""A tool that goes farther than this [m] between them"""
UNEVEN: Final = 1.53
"""is nowhere faster than so many times its fastest mean there and beside."""
LEAST_TIME: Final = 0.006
"""Least time [s] between two points: most controllers of this kind run at 100 to 1000 Hz."""
SPEED_USED: Final = 0.97
"""Share of the joints' speeds that may be used,"""
ACCELERATION_USED: Final = 0.93
"""and of their accelerations."""
TOOL_SPEED_USED: Final = 0.99
"""Share of the tools' speeds that may be used."""
LEAST_FEED_USED: Final = 1.04
"""So many times as long as its least feed allows a way may take, as a whole,"""
LONG_TIME: Final = 0.004
"""and in each such time [s],"""
CREEPING: Final = 0.12
"""and at no place of it the joints are slower than this share of the mean speed there."""
MARK: Final = 0.3
"""How far [m] from the TCP points are that tell how a tool stands."""
SOON: Final = 1e-6
"""Time [s] over which the speed of such points is taken."""
CORNER_COSINE: Final = float(np.cos(np.deg2rad(15.0)))
"""Joints whose speeds turn by more than this behind a target have a corner there,"""
AT_CORNERS: Final = 0.9
"""Share of the speed beside it that work with a least feed keeps at a corner,"""
MOST_AT_CORNERS: Final = 1.5
"""but no more than so many times the mean of both velocities there."""
CORNER_SHARE: Final = 0.25
"""which takes at most so much of the moves beside it."""
END_SHARE: Final = 0.1
"""A point between two others has this share of their way on either side at least."""
_SHARES: Final = np.array([0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875])
"""Where between two points the way is looked at."""
_PIECES: Final = 16
"""Pieces between two points in which the speed of a tool is looked at."""
_ROUNDS: Final = 16
"""Times points are set between,"""
_ALONE: Final = 2
"""the first of them only where the tool leaves the way,"""
_BESIDE: Final = 3
"""then in so many ways on either side, too."""
_STRETCHES: Final = 60
"""Times points are moved to later."""


@dataclasses.dataclass(frozen=True)
class Curve:
    """Points from rest to rest, the first of which is where the arms stand: times ``t`` (P,) [s], ``q`` and
    ``v`` (P, D), and the ``end`` (P,) of the given ways on which each point lies."""

    t: FloatArray
    q: FloatArray
    v: FloatArray
    end: IntArray


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What is wanted of N straight ways: ``duration`` (N,) [s] as planned; ``tcp_speed`` [m/s] of any tool in
    the world, ``fastest`` and ``slowest`` (A, N) [m/s] of those of A arms anywhere on a way, in their frames,
    the latter 0 where nothing is asked, and not beside a rest or where it is planned slower; ``least`` (N,)
    [1/s] share of it that is gone in a second at least, 0 where nothing is asked; whether the motion
    ``may_stop`` (N,) behind it where no points keep the way else, and whether something ``melts`` (N,) where
    it comes near to a standstill on it. No tool leaves a way by more than ``kept`` [m] and ``kept_turn``
    (A,) [rad]."""

    duration: FloatArray
    tcp_speed: float
    fastest: FloatArray
    slowest: FloatArray
    least: FloatArray
    may_stop: BoolArray
    melts: BoolArray
    kept: float = KEPT
    kept_turn: tuple[float, ...] = (KEPT_TURN, KEPT_TURN)

    def some(self, a: int, b: int) -> "Wanted":
        """Of the ways a to b - 1."""
        own = slice(a, b)
        return dataclasses.replace(
            self,
            duration=self.duration[own],
            fastest=self.fastest[:, own],
            slowest=self.slowest[:, own],
            least=self.least[own],
            may_stop=self.may_stop[own],
            melts=self.melts[own],
        )

    @property
    def even(self) -> bool:
        """Whether some of them have a least feed: then no corner takes longer."""
        return bool((self.least > 0.0).any())


def curve(arms: Sequence[Driven], q: FloatArray, stop: BoolArray, wanted: Wanted) -> Curve:
    """Points through the joints ``q`` (N + 1, D) of N straight ways, which end at rest where ``stop`` (N,)
    says so, as the last one does. Raises :class:`NotKeptError`."""
    parts = _parts(arms, q, wanted, np.flatnonzero(stop) + 1)
    whole, late = [parts[0]], parts[0].t[-1]
    for part in parts[1:]:
        whole.append(Curve(part.t[1:] + late, part.q[1:], part.v[1:], part.end[1:]))
        late += part.t[-1]
    return Curve(
        *(np.concatenate([getattr(part, name) for part in whole]) for name in ("t", "q", "v", "end"))
    )


@dataclasses.dataclass(frozen=True)
class _Points:
    """Points from rest to rest: ``q`` (P, D), times ``span`` (P - 1,) between them, the ``end`` (P,) of the
    given ways on which each lies, and which are a ``corner`` (P,), with a point of its own before and
    behind."""

    q: FloatArray
    span: FloatArray
    end: IntArray
    corner: BoolArray


def _parts(arms: Sequence[Driven], q: FloatArray, wanted: Wanted, stops: IntArray) -> list[Curve]:
    """Curves from rest to rest behind one another, which stop at the rows ``stops`` of ``q`` (N + 1, D) and
    where nothing else keeps the way."""
    out, edges = list[Curve](), sorted({0, *stops.tolist(), len(wanted.duration)})
    for a, b in itertools.pairwise(edges):
        rows, own = q[a : b + 1], wanted.some(a, b)
        try:
            parts = [_from_rest(arms, rows, own)]
        except NotKeptError as lost:
            cuts = [k for k in (lost.row, lost.row + 1) if 0 < k < b - a and own.may_stop[k - 1]]
            if not cuts:
                raise NotKeptError(a + lost.row, lost.why, lost.share) from None
            try:
                parts = _parts(arms, rows, own, np.array(cuts))
            except NotKeptError as still:
                raise NotKeptError(a + still.row, still.why, still.share) from None
        out += [dataclasses.replace(part, end=part.end + a) for part in parts]
    return out


def _from_rest(arms: Sequence[Driven], q: FloatArray, wanted: Wanted) -> Curve:
    count = len(wanted.duration)
    span = np.maximum(wanted.duration, LEAST_TIME)
    points = _Points(q, span, np.arange(-1, count), np.zeros(count + 1, dtype=np.bool_))
    points = _with_corners(arms, points, wanted.even)
    for number in range(_ROUNDS):
        points, v = _timed(arms, points, wanted)
        far = _far(arms, points, v, wanted)
        if not far.any():
            _keeps_up(arms, points, v, wanted)
            uneven = np.flatnonzero(_uneven(arms, points, v))
            if len(uneven):
                row = int(points.end[uneven[0] + 1])
                raise NotKeptError(
                    row, "between two points the tool would go back, or far faster than its feed"
                )
            return Curve(np.append(0.0, np.cumsum(points.span)), points.q, v, points.end)
        short = np.flatnonzero(far & (points.span < 2.0 * LEAST_TIME))
        if len(short):
            row = int(points.end[short[0] + 1])
            raise NotKeptError(row, "points would have to follow one another too fast to keep the way")
        wide = far if number < _ALONE else _widened(points, far)
        points = _between(arms, points, v, np.flatnonzero(wide))
    raise NotKeptError(
        int(points.end[np.flatnonzero(far)[0] + 1]), f"{len(points.q)} points do not keep the way"
    )


def _widened(points: _Points, far: BoolArray) -> BoolArray:
    """The ways ``far`` (P - 1,) with those beside them that points may be set in: where a way alone is
    halved, the spline swings on to the next one."""
    near = np.zeros(len(far), dtype=np.bool_)
    beside = np.flatnonzero(far)[:, None] + np.arange(-_BESIDE, _BESIDE + 1)
    near[np.clip(beside, 0, len(far) - 1)] = True
    free = (points.span >= 2.0 * LEAST_TIME) & ~(points.corner[:-1] | points.corner[1:])
    return np.asarray(far | (near & free))


def _with_corners(arms: Sequence[Driven], points: _Points, even: bool) -> _Points:
    """The points with one before and one behind each corner, so near that only there the speed changes: a
    spline that passed it as it stands would swing far to both sides. Through it the tool goes evenly slower,
    and for an ``even`` feed loses half of the time that this takes."""
    q, span = points.q, points.span
    fastest = np.concatenate([arm.robot.velocity for arm in arms])
    quickest = np.concatenate([arm.robot.acceleration for arm in arms]) * ACCELERATION_USED
    rate = np.diff(q, axis=0) / span[:, None]
    scaled = rate / fastest
    size = np.maximum(np.linalg.norm(scaled, axis=1), 1e-12)
    cosine = dots(scaled[:-1], scaled[1:]) / (size[:-1] * size[1:])
    middle = 0.5 * (rate[:-1] + rate[1:])
    rise = (np.abs(rate[:-1] - middle) / quickest).max(axis=1)
    needed = np.maximum(4.0 * rise if even else rise, LEAST_TIME)
    room = CORNER_SHARE * np.minimum(span[:-1], span[1:])
    found = np.flatnonzero((cosine < CORNER_COSINE) & (needed <= room)) + 1
    if not len(found):
        return points
    took, beside = needed[found - 1], list[FloatArray]()
    for way, share in ((found - 1, 1.0 - took / span[found - 1]), (found, took / span[found])):
        near = q[way] + share[:, None] * (q[way + 1] - q[way])
        for arm in carriers_first(arms):
            wanted = straight(arm.tool(q), spread(share, way, len(span)))[way, 0]
            near[:, arm.columns] = arm.solved(wanted, near, way)
        beside.append(near)
    before, behind = beside
    weight = 1.0 / fastest**2
    slow_in, slow_out = (
        2.0 * took / (1.0 + np.clip(_along(middle[found - 1], rate[way], weight), -0.5, 1.0))
        for way in (found - 1, found)
    )
    if even:  # half way between that and a speed that swings beyond the one before
        slow_in, slow_out = 0.5 * (slow_in + took), 0.5 * (slow_out + took)
    out_q, out_span, out_end, out_corner = [q[0]], list[float](), [int(points.end[0])], [False]
    corner = {int(k): i for i, k in enumerate(found)}
    for k in range(1, len(q)):
        gone = span[k - 1] - (took[corner[k - 1]] if k - 1 in corner else 0.0)
        if k in corner:
            i = corner[k]
            out_q += [before[i], q[k], behind[i]]
            out_span += [gone - took[i], slow_in[i], slow_out[i]]
            out_end += [int(points.end[k]), int(points.end[k]), int(points.end[k + 1])]
            out_corner += [False, True, False]
        else:
            out_q.append(q[k])
            out_span.append(gone)
            out_end.append(int(points.end[k]))
            out_corner.append(False)
    return _Points(np.array(out_q), np.array(out_span), np.array(out_end), np.array(out_corner))


def _along(some: FloatArray, other: FloatArray, weight: FloatArray) -> FloatArray:
    """What (K,) of ``other`` (K, D) lies in ``some``."""
    return np.asarray(
        (some * other * weight).sum(axis=1) / np.maximum((other**2 * weight).sum(axis=1), 1e-18)
    )


def _velocities(points: _Points, even: bool) -> FloatArray:
    """Velocities (P, D): of splines with continuous accelerations, from rest to rest, and from corner to
    corner, at which speeds are the mean of those before and behind; for an ``even`` feed in direction alone,
    as far as :data:`AT_CORNERS` goes."""
    q, span = points.q, points.span
    t = np.append(0.0, np.cumsum(span))
    v = np.zeros_like(q)
    corners = np.flatnonzero(points.corner)
    first, last = np.append(0, corners + 1), np.append(corners - 1, len(q) - 1)
    for a, b in zip(first, last, strict=True):
        low = np.zeros(q.shape[1]) if a == 0 else (q[a + 1] - q[a]) / span[a]
        high = np.zeros(q.shape[1]) if b == len(q) - 1 else (q[b] - q[b - 1]) / span[b - 1]
        some = slice(a, b + 1)
        v[some] = CubicSpline(t[some], q[some], axis=0, bc_type=((1, low), (1, high)))(t[some], 1)
        v[a], v[b] = low, high
    v[corners] = 0.5 * (v[corners - 1] + v[corners + 1])
    if even and len(corners):
        size = np.linalg.norm(v, axis=1)
        due = AT_CORNERS * np.minimum(size[corners - 1], size[corners + 1])
        factor = np.clip(due / np.maximum(size[corners], 1e-12), 1.0, MOST_AT_CORNERS)
        v[corners] *= factor[:, None]
    return v


def _timed(arms: Sequence[Driven], points: _Points, wanted: Wanted) -> tuple[_Points, FloatArray]:
    """The points with times at which joints keep their limits and tools their speeds, and the velocities."""
    fastest = np.concatenate([arm.robot.velocity for arm in arms]) * SPEED_USED
    quickest = np.concatenate([arm.robot.acceleration for arm in arms]) * ACCELERATION_USED
    for _ in range(_STRETCHES):
        v = _velocities(points, wanted.even)
        over = _over(arms, points, v, fastest, quickest, wanted)
        if over.max() <= 1.0:
            return points, v
        wide = np.maximum(over, 1.0)
        wide = np.maximum(wide, np.maximum(np.append(wide[1:], 1.0), np.append(1.0, wide[:-1])))
        for corner in np.flatnonzero(points.corner).tolist():  # what goes through a corner slows down as one
            some = slice(max(corner - 2, 0), corner + 2)
            wide[some] = wide[some].max()
        span = points.span * np.minimum(1.0 + 1.05 * (wide - 1.0), 2.0)
        points = dataclasses.replace(points, span=span)
    row = int(points.end[int(np.argmax(over)) + 1])
    raise NotKeptError(row, "joints cannot follow at any speed that was tried")


def _over(
    arms: Sequence[Driven],
    points: _Points,
    v: FloatArray,
    fastest: FloatArray,
    quickest: FloatArray,
    wanted: Wanted,
) -> FloatArray:
    """By what factor (P - 1,) the times between points are too short."""
    q, span = points.q, points.span
    T = span[:, None]
    change = np.diff(q, axis=0) / T
    first = (6.0 * change - 4.0 * v[:-1] - 2.0 * v[1:]) / T
    last = (-6.0 * change + 2.0 * v[:-1] + 4.0 * v[1:]) / T
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.clip(np.nan_to_num(first / (first - last)), 0.0, 1.0)  # where the speed is highest between
    middle = v[:-1] + T * at * (first + 0.5 * at * (last - first))
    speed = np.abs(np.stack([v[:-1], v[1:], middle])).max(axis=0) / fastest
    rise = np.sqrt(np.maximum(np.abs(first), np.abs(last)) / quickest)
    out = np.maximum(speed.max(axis=1), rise.max(axis=1))
    way = between(q, span, v, np.linspace(0.0, 1.0, _PIECES + 1))
    for arm, most in zip(arms, wanted.fastest, strict=True):
        most = np.minimum(most[points.end[1:]], np.inf if arm.carrier else wanted.tcp_speed)
        out = np.maximum(out, _fastest(arm.tool(way), span) / (TOOL_SPEED_USED * most))
        if arm.carrier:
            out = np.maximum(out, _fastest(arm.place(way), span) / (TOOL_SPEED_USED * wanted.tcp_speed))
    return np.asarray(out)


def _fastest(way: FloatArray, span: FloatArray) -> FloatArray:
    """The highest speeds (P - 1,) [m/s] of poses (P - 1, S, 4, 4), which are as far apart in time."""
    steps = np.linalg.norm(np.diff(way[..., :3, 3], axis=1), axis=2)
    return np.asarray(steps.max(axis=1) * steps.shape[1] / span)


def _keeps_up(arms: Sequence[Driven], points: _Points, v: FloatArray, wanted: Wanted) -> None:
    """Raise where ways that have a least feed take longer than it allows, or what melts comes near to a
    standstill."""
    took = np.bincount(points.end[1:], points.span, len(wanted.duration))
    asked = wanted.least > 0.0
    most = np.maximum(wanted.duration, 1.0 / np.where(asked, wanted.least, np.inf)) * LEAST_FEED_USED
    kept = np.where(asked, most / took, np.inf)
    row, way = points.end[1:], between(points.q, points.span, v, np.linspace(0.0, 1.0, _PIECES + 1))
    bound = asked & (wanted.duration * wanted.least <= LEAST_FEED_USED)
    bound[[0, -1]] = False
    for arm, floor in zip(arms, wanted.slowest, strict=True):
        share = _slowest(arm.tool(way)[..., :3, 3], points.span) * LEAST_FEED_USED
        share = np.where(bound[row] & (floor[row] > 0.0), share / np.maximum(floor[row], 1e-9), np.inf)
        np.minimum.at(kept, row, share)
    if kept.min() < 1.0:
        why = "tools would fall below the least feed"
        raise NotKeptError(int(np.argmin(kept)), why, float(kept.min()))
    scale = np.concatenate([arm.robot.velocity for arm in arms])
    way = way[:, :: _PIECES // 8] / scale
    stands = _creeps(way, v / scale, points.span)
    for arm in arms:
        if arm.carrier is not None:  # two arms may move, and one stand still as the other one sees it
            seen, soon = (_marks(arm.tool(some)) for some in (points.q, points.q + SOON * v))
            stands |= _creeps(_marks(arm.tool(way * scale)), (soon - seen) / SOON, points.span)
    creeps = np.flatnonzero(stands & wanted.melts[row])
    if len(creeps):
        raise NotKeptError(int(points.end[creeps[0] + 1]), "joints would come near to a standstill")


def _slowest(place: FloatArray, span: FloatArray) -> FloatArray:
    """The least mean speeds (P - 1,) [m/s] of places (P - 1, S, 3), at even times, over :data:`LONG_TIME` at
    least."""
    count, out = place.shape[1] - 1, np.empty(len(span))
    parts = 2 ** np.floor(np.log2(np.clip(span / LONG_TIME, 1.0, count))).astype(np.int64)
    for part in np.unique(parts).tolist():
        some, steps = parts == part, count // part
        ways = np.linalg.norm(place[some, steps:] - place[some, :-steps], axis=2).min(axis=1)
        out[some] = ways * part / span[some]
    return out


def _marks(pose: FloatArray) -> FloatArray:
    """Places (..., 9) [m] of three points of poses (..., 4, 4), which tell how they stand."""
    points = pose[..., :3, 3, None] + np.array([0.0, MARK, MARK]) * pose[..., :3, [2, 0, 1]]
    return points.reshape(*pose.shape[:-2], 9)


def _creeps(way: FloatArray, rate: FloatArray, span: FloatArray) -> BoolArray:
    """Between which points (P - 1,), or at the ends of which, what is at ``way`` (P - 1, S, D), with
    velocities ``rate`` (P, D) at the points, comes near to a standstill, but from rest and to it."""
    mean = np.linalg.norm(way[:, -1] - way[:, 0], axis=1) / span
    least = np.linalg.norm(np.diff(way, axis=1), axis=2).min(axis=1) * (way.shape[1] - 1) / span
    out = np.asarray(least < CREEPING * mean)
    out[:-1] |= np.linalg.norm(rate[1:-1], axis=1) < CREEPING * np.minimum(mean[:-1], mean[1:])
    out[[0, -1]] = False
    return out


def between(q: FloatArray, span: FloatArray, v: FloatArray, shares: FloatArray) -> FloatArray:
    """Joints (P - 1, S, D) at shares of the times between points."""
    t = np.append(0.0, np.cumsum(span))
    when = t[:-1, None] + shares * span[:, None]
    when[:, shares == 1.0] = t[1:, None]
    return np.asarray(CubicHermiteSpline(t, q, v, axis=0)(when))


def _far(arms: Sequence[Driven], points: _Points, v: FloatArray, wanted: Wanted) -> BoolArray:
    """Between which points (P - 1,) a tool leaves the straight way."""
    out = np.zeros(len(points.span), dtype=bool)
    way = between(points.q, points.span, v, _SHARES)
    for arm, most in zip(arms, wanted.kept_turn, strict=False):
        ends, here = arm.tool(points.q), arm.tool(way)
        share, _, _ = share_gone(ends, here)
        due = straight(ends, share)
        off = np.linalg.norm(here[..., :3, 3] - due[..., :3, 3], axis=2)
        turned = log_rotation(np.swapaxes(due[..., :3, :3], -1, -2) @ here[..., :3, :3])
        out |= (off > wanted.kept).any(axis=1) | (np.linalg.norm(turned, axis=2) > most).any(axis=1)
    return out


def _uneven(arms: Sequence[Driven], points: _Points, v: FloatArray) -> BoolArray:
    """Between which points (P - 1,) a tool goes back, or faster than :data:`UNEVEN` times as in the mean
    there and beside."""
    out = np.zeros(len(points.span), dtype=np.bool_)
    way = between(points.q, points.span, v, np.linspace(0.0, 1.0, _PIECES + 1))
    for arm in arms:
        place = arm.tool(way)[..., :3, 3]
        whole = place[:, -1] - place[:, 0]
        length = np.linalg.norm(whole, axis=1)
        mean = np.pad(length / points.span, 1)
        steps = np.diff(place, axis=1)
        along = (steps * whole[:, None]).sum(axis=2) / np.maximum(length, 1e-9)[:, None]
        fast = np.linalg.norm(steps, axis=2).max(axis=1) * _PIECES / points.span
        about = np.maximum(mean[1:-1], np.maximum(mean[:-2], mean[2:]))
        out |= (length > GOES) & ((fast > UNEVEN * about) | (along.min(axis=1) < -0.2 * KEPT))
    return out


def _between(arms: Sequence[Driven], points: _Points, v: FloatArray, rows: IntArray) -> _Points:
    """The points with one in the middle of each of the ways ``rows``, straight between its ends for all arms
    at once; between a corner and the point beside it there is room for none."""
    q, span, end = points.q, points.span, points.end
    beside = points.corner[rows] | points.corner[rows + 1]
    if beside.any():
        raise NotKeptError(int(end[rows[beside][0] + 1]), "a corner there leaves the way at this speed")
    middle = between(q, span, v, np.array([0.5]))
    shares, weights = [], []
    for arm in arms:
        share, length, angle = share_gone(arm.tool(q), arm.tool(middle))
        shares.append(share[rows, 0])
        weights.append(length[rows] + 0.3 * angle[rows] + 1e-9)
    # a cubic that swings beyond the end of its way there would set the point on that end
    share = np.clip(np.average(shares, axis=0, weights=weights), END_SHARE, 1.0 - END_SHARE)
    found = middle[rows, 0]
    for arm in carriers_first(arms):
        wanted = straight(arm.tool(q), spread(share, rows, len(span)))
        found[:, arm.columns] = arm.solved(wanted[rows, 0], found, end[rows + 1])
    halved = span.copy()
    halved[rows] *= 0.5
    return _Points(
        np.insert(q, rows + 1, found, axis=0),
        np.insert(halved, rows + 1, halved[rows]),
        np.insert(end, rows + 1, end[rows + 1]),
        np.insert(points.corner, rows + 1, False),
    )
