"""Joint trajectories through a plan's targets: points with velocities, as dense as straight ways ask for.

A controller lays a cubic through positions and velocities of two points. The velocities are those of splines
with continuous accelerations from rest to rest, or from corner to corner. Where the tool would leave the
straight way between two targets by more than ``KEPT`` a point is set between them, on that way, and the
spline laid anew. Where joints would be too fast, or sped up too fast, points come later."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import forward, jacobian
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, exp_rotation, inverse, log_rotation

KEPT: Final = 0.05e-3
"""How far [m] a tool may leave the straight way between two points,"""
KEPT_TURN: Final = float(np.deg2rad(0.05))
"""and how far [rad] it may be turned off it."""
UNEVEN: Final = 2.4
"""How many times as fast as in the mean it may go between them."""
LEAST_TIME: Final = 0.006
"""Least time [s] between two points: most controllers of this kind run at 100 to 1000 Hz."""
SPEED_USED: Final = 0.97
"""Share of the joints' speeds that may be used,"""
ACCELERATION_USED: Final = 0.93
"""and of their accelerations."""
CORNER_COSINE: Final = float(np.cos(np.deg2rad(15.0)))
"""Joints whose speeds turn by more than this behind a target have a corner there,"""
CORNER_SHARE: Final = 0.25
"""which takes at most so much of the moves beside it."""
_SHARES: Final = np.array([0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875])
"""Where between two points the way is looked at."""
_ROUNDS: Final = 16
"""Times points are set between,"""
_ALONE: Final = 2
"""the first of them only where the tool leaves the way,"""
_BESIDE: Final = 3
"""then in so many ways on either side, too."""
_STRETCHES: Final = 60
"""Times points are moved to later."""
_STEPS: Final = 12
"""Steps of Newton's method."""
_EXACT: Final = 1e-9
"""How near [m, rad] it comes."""


@dataclasses.dataclass(frozen=True)
class Driven:
    """An arm with what it carries: ``base`` and ``tcp`` (4, 4), and where its joints stand among all."""

    robot: RobotData
    base: FloatArray
    tcp: FloatArray
    columns: slice

    def tool(self, q: FloatArray) -> FloatArray:
        """TCP poses (..., 4, 4) of joints (..., D) of all arms."""
        return np.asarray(self.base @ forward(self.robot, q[..., self.columns]) @ self.tcp)


@dataclasses.dataclass(frozen=True)
class Curve:
    """Points from rest to rest, the first of which is where the arms stand: times ``t`` (P,) [s], ``q`` and
    ``v`` (P, D), and the ``end`` (P,) of the given ways on which each point lies."""

    t: FloatArray
    q: FloatArray
    v: FloatArray
    end: IntArray


class NotKeptError(Exception):
    """No points keep the way: ``row`` of the given ways, and why."""

    def __init__(self, row: int, why: str) -> None:
        super().__init__(why)
        self.row, self.why = row, why


def curve(
    arms: Sequence[Driven],
    q: FloatArray,
    duration: FloatArray,
    stop: BoolArray,
    tcp_speed: float,
    even: bool = False,
) -> Curve:
    """Points through the joints ``q`` (N + 1, D) of N straight ways, which take ``duration`` (N,) [s] each
    and end at rest where ``stop`` (N,) says so, as the last one does. ``even``: no corner takes longer, for
    work that has a least feed. Raises :class:`NotKeptError`."""
    edges = [0, *(np.flatnonzero(stop) + 1).tolist()]
    if edges[-1] != len(duration):
        edges.append(len(duration))
    parts = []
    for a, b in itertools.pairwise(edges):
        try:
            parts.append(_from_rest(arms, q[a : b + 1], duration[a:b], tcp_speed, even))
        except NotKeptError as lost:
            raise NotKeptError(a + lost.row, lost.why) from None
        parts[-1] = dataclasses.replace(parts[-1], end=parts[-1].end + a)
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


def _from_rest(
    arms: Sequence[Driven], q: FloatArray, duration: FloatArray, tcp_speed: float, even: bool
) -> Curve:
    count = len(duration)
    span = np.maximum(duration, LEAST_TIME)
    points = _Points(q, span, np.arange(-1, count), np.zeros(count + 1, dtype=np.bool_))
    points = _with_corners(arms, points, even)
    for number in range(_ROUNDS):
        points, v = _timed(arms, points, tcp_speed)
        far = _far(arms, points.q, points.span, v)
        if not far.any():
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
    ends = [arm.tool(q) for arm in arms]
    before, behind = np.full((len(found), q.shape[1]), np.nan), np.full((len(found), q.shape[1]), np.nan)
    took = needed[found - 1]
    for out, way, share in (
        (before, found - 1, 1.0 - took / span[found - 1]),
        (behind, found, took / span[found]),
    ):
        near = q[way] + share[:, None] * (q[way + 1] - q[way])
        for arm, poses in zip(arms, ends, strict=True):
            wanted = _straight(poses, _spread(share, way, len(span)))[way, 0]
            out[:, arm.columns] = _solved(arm, wanted, near[:, arm.columns])
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


def _velocities(points: _Points) -> FloatArray:
    """Velocities (P, D): of splines with continuous accelerations, from rest to rest, and from corner to
    corner, at which speeds are the mean of those before and behind."""
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
    return v


def _timed(arms: Sequence[Driven], points: _Points, tcp_speed: float) -> tuple[_Points, FloatArray]:
    """The points with times at which joints and tools keep their limits, and the velocities."""
    fastest = np.concatenate([arm.robot.velocity for arm in arms]) * SPEED_USED
    quickest = np.concatenate([arm.robot.acceleration for arm in arms]) * ACCELERATION_USED
    for _ in range(_STRETCHES):
        v = _velocities(points)
        over = _over(arms, points.q, points.span, v, fastest, quickest, tcp_speed)
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
    q: FloatArray,
    span: FloatArray,
    v: FloatArray,
    fastest: FloatArray,
    quickest: FloatArray,
    tcp_speed: float,
) -> FloatArray:
    """By what factor (P - 1,) the times between points are too short."""
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
    shares = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    way = _at(q, span, v, shares)
    for arm in arms:
        place = arm.tool(way)[..., :3, 3]
        steps = np.linalg.norm(np.diff(place, axis=1), axis=2).max(axis=1) / (0.25 * span)
        out = np.maximum(out, steps / (0.99 * tcp_speed))
    return np.asarray(out)


def _at(q: FloatArray, span: FloatArray, v: FloatArray, shares: FloatArray) -> FloatArray:
    """Joints (P - 1, S, D) at shares of the times between points."""
    t = np.append(0.0, np.cumsum(span))
    when = t[:-1, None] + shares * span[:, None]
    when[:, shares == 1.0] = t[1:, None]
    return np.asarray(CubicHermiteSpline(t, q, v, axis=0)(when))


def _far(arms: Sequence[Driven], q: FloatArray, span: FloatArray, v: FloatArray) -> BoolArray:
    """Between which points (P - 1,) a tool leaves the straight way."""
    out = np.zeros(len(span), dtype=bool)
    way = _at(q, span, v, _SHARES)
    for arm in arms:
        ends, here = arm.tool(q), arm.tool(way)
        share, _, _ = _share(ends, here)
        wanted = _straight(ends, share)
        off = np.linalg.norm(here[..., :3, 3] - wanted[..., :3, 3], axis=2)
        turned = log_rotation(np.swapaxes(wanted[..., :3, :3], -1, -2) @ here[..., :3, :3])
        out |= (off > KEPT).any(axis=1) | (np.linalg.norm(turned, axis=2) > KEPT_TURN).any(axis=1)
    return out


def _uneven(arms: Sequence[Driven], points: _Points, v: FloatArray) -> BoolArray:
    """Between which points (P - 1,) a tool goes back, or faster than :data:`UNEVEN` times as in the mean."""
    out = np.zeros(len(points.span), dtype=np.bool_)
    way = _at(points.q, points.span, v, np.linspace(0.0, 1.0, 9))
    for arm in arms:
        place = arm.tool(way)[..., :3, 3]
        whole = place[:, -1] - place[:, 0]
        length = np.linalg.norm(whole, axis=1)
        steps = np.diff(place, axis=1)
        along = (steps * whole[:, None]).sum(axis=2) / np.maximum(length, 1e-9)[:, None]
        fast = 8.0 * np.linalg.norm(steps, axis=2).max(axis=1) > UNEVEN * length
        out |= (length > 0.5 * KEPT) & (fast | (along.min(axis=1) < -0.2 * KEPT))
    return out


def _share(ends: FloatArray, here: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How far (P - 1, S) of the straight ways between ``ends`` (P, 4, 4) poses (P - 1, S, 4, 4) have gone,
    and the ways' lengths and angles (P - 1,)."""
    way = np.diff(ends[:, :3, 3], axis=0)[:, None]
    turn = log_rotation(np.swapaxes(ends[:-1, :3, :3], -1, -2) @ ends[1:, :3, :3])[:, None]
    length, angle = np.linalg.norm(way, axis=2), np.linalg.norm(turn, axis=2)
    gone = here[..., :3, 3] - ends[:-1, None, :3, 3]
    turned = log_rotation(np.swapaxes(ends[:-1, None, :3, :3], -1, -2) @ here[..., :3, :3])
    by_way = (gone * way).sum(axis=2) / np.maximum(length, 1e-9) ** 2
    by_turn = (turned * turn).sum(axis=2) / np.maximum(angle, 1e-9) ** 2
    share = np.where(length > 1e-6, by_way, np.where(angle > 1e-6, by_turn, 0.5))
    return np.clip(share, 0.0, 1.0), length[:, 0], angle[:, 0]


def _straight(ends: FloatArray, share: FloatArray) -> FloatArray:
    """Poses (P - 1, S, 4, 4) at shares (P - 1, S) of the straight ways, turning evenly."""
    turn = log_rotation(np.swapaxes(ends[:-1, :3, :3], -1, -2) @ ends[1:, :3, :3])[:, None]
    out = np.zeros((*share.shape, 4, 4))
    out[..., :3, :3] = ends[:-1, None, :3, :3] @ exp_rotation(share[..., None] * turn)
    out[..., :3, 3] = ends[:-1, None, :3, 3] + share[..., None] * np.diff(ends[:, :3, 3], axis=0)[:, None]
    out[..., 3, 3] = 1.0
    return out


def _between(arms: Sequence[Driven], points: _Points, v: FloatArray, rows: IntArray) -> _Points:
    """The points with one in the middle of each of the ways ``rows``, straight between its ends for all arms
    at once; between a corner and the point beside it there is room for none."""
    q, span, end = points.q, points.span, points.end
    beside = points.corner[rows] | points.corner[rows + 1]
    if beside.any():
        raise NotKeptError(int(end[rows[beside][0] + 1]), "a corner there leaves the way at this speed")
    middle = _at(q, span, v, np.array([0.5]))
    shares, weights = [], []
    for arm in arms:
        share, length, angle = _share(arm.tool(q), arm.tool(middle))
        shares.append(share[rows, 0])
        weights.append(length[rows] + 0.3 * angle[rows] + 1e-9)
    share = np.average(shares, axis=0, weights=weights)
    found = middle[rows, 0]
    for arm in arms:
        wanted = _straight(arm.tool(q), _spread(share, rows, len(span)))
        found[:, arm.columns] = _solved(arm, wanted[rows, 0], found[:, arm.columns])
    halved = span.copy()
    halved[rows] *= 0.5
    return _Points(
        np.insert(q, rows + 1, found, axis=0),
        np.insert(halved, rows + 1, halved[rows]),
        np.insert(end, rows + 1, end[rows + 1]),
        np.insert(points.corner, rows + 1, False),
    )


def _spread(share: FloatArray, rows: IntArray, count: int) -> FloatArray:
    out = np.full((count, 1), 0.5)
    out[rows, 0] = share
    return out


def _solved(arm: Driven, wanted: FloatArray, q: FloatArray) -> FloatArray:
    """Joints (K, J) near ``q`` at which the tool is at poses (K, 4, 4), by Newton's method; of seven joints
    the smallest steps are taken."""
    flange = inverse(arm.base) @ wanted @ inverse(arm.tcp)
    out = q.copy()
    for _ in range(_STEPS):
        here = forward(arm.robot, out)
        turn = (
            here[:, :3, :3] @ log_rotation(np.swapaxes(here[:, :3, :3], 1, 2) @ flange[:, :3, :3])[..., None]
        )
        off = np.concatenate([turn[..., 0], flange[:, :3, 3] - here[:, :3, 3]], axis=1)
        if np.abs(off).max(initial=0.0) <= _EXACT:
            return out
        out = out + np.einsum("kij,kj->ki", np.linalg.pinv(jacobian(arm.robot, out)), off)
    raise NotKeptError(0, "no joints are found on the straight way")


def way_time(
    arms: Mapping[str, Driven],
    start: FloatArray,
    end: FloatArray,
    shares: tuple[float, float],
    tcp_speed: float,
) -> float:
    """Time [s] of a move from rest to rest, straight in joint space from ``start`` to ``end`` (D,), at which
    joints keep ``shares`` of their speeds and accelerations and tools the speed [m/s]."""
    change = np.abs(end - start)
    out = LEAST_TIME
    x = np.linspace(0.0, 1.0, 401)
    q = start + (x * x * (3.0 - 2.0 * x))[:, None] * (end - start)
    for arm in arms.values():
        own = change[arm.columns]
        out = max(out, float((1.5 * own / (shares[0] * arm.robot.velocity)).max()))
        out = max(out, float(np.sqrt(6.0 * own / (shares[1] * arm.robot.acceleration)).max()))
        steps = np.linalg.norm(np.diff(arm.tool(q)[:, :3, 3], axis=0), axis=1).max()
        out = max(out, float(steps * (len(x) - 1) / (0.99 * tcp_speed)))
    return out
