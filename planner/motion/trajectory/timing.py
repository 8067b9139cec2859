"""Timing: the clock for all arms at once, by TOPPRA over the joint path between stops.

Pham and Pham, "A new approach to time-optimal path parameterization based on reachability
analysis", IEEE T-RO 2018 (package ``toppra``). Where it fails, Drake's ``Toppra`` with relaxed
constraints takes over, on the same path and limits; the result says so. It is the cross-check in
benchmarks, too.
"""

import dataclasses
import hashlib
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from pydrake.multibody.optimization import Toppra
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia
from pydrake.trajectories import PiecewisePolynomial
from scipy.interpolate import CubicSpline

from planner.geometry.arrays import BoolArray, FloatArray
from planner.motion.trajectory.joint_path import (
    CornerLimits,
    Corners,
    JointPath,
    from_stop_to_stop,
    on_grid,
    ramp_peaks,
    ramps,
)
from planner.motion.trajectory.toppra_solver import path_speeds
from planner.targets import FEED_SHARE

RELAXATION: Final = 1e-4
"""Relaxation of TOPPRA's constraints: without it fine grids are reported as infeasible (drake 20619, 21381);
not every release offers it."""

GRID_STRIDES: Final = (1, 2, 4, 8)
"""Every so many points of a grid are taken, in this order, until TOPPRA finds a solution."""


def parameterise_drake(
    spline: CubicSpline, grid: FloatArray, limit: FloatArray, acceleration: FloatArray
) -> FloatArray | None:
    """Path speeds (G,) at the grid points, or None.

    ``limit`` (G,) bounds the path speed: it enters as one more joint whose slope over the path is the bound's
    inverse. Where the fine grid fails, coarser ones are tried, with the least bound of the points left out.
    """
    for stride in GRID_STRIDES:
        rows = np.unique(np.append(np.arange(0, len(grid), stride), len(grid) - 1))
        if len(rows) < 3:
            break
        tight = np.minimum.reduceat(limit, rows)
        tight[1:] = np.minimum(tight[1:], tight[:-1])
        try:
            found = solve_once(spline, grid[rows], tight if stride > 1 else limit, acceleration)
        except (RuntimeError, SystemExit):  # by SystemExit Drake tells of its own conditions that fail
            found = None
        if found is not None:
            return np.asarray(np.sqrt(np.interp(grid, grid[rows], found**2)))
    return None


def solve_once(
    spline: CubicSpline, grid: FloatArray, limit: FloatArray, acceleration: FloatArray
) -> FloatArray | None:
    """Path speeds (G,) by one run of Drake's solver on this very grid, or None."""
    joints = spline.c.shape[2]
    slope = 1.0 / np.clip(limit, 1e-9, 1e4)
    extra = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(grid))])
    values = np.column_stack([spline(grid), extra])
    rates = np.column_stack([spline(grid, 1), slope])
    path = PiecewisePolynomial.CubicHermite(grid, values.T, rates.T)
    solver = Toppra(path, _sliders(joints + 1), grid)
    relax = getattr(solver, "set_constraint_relaxation", None)
    if relax is not None:
        relax(RELAXATION)
    wide = np.full(joints + 1, 1e6)
    wide[-1] = 1.0
    solver.AddJointVelocityLimit(-wide, wide)
    strong = np.append(acceleration, 1e9)
    solver.AddJointAccelerationLimit(-strong, strong)
    found = solver.SolvePathParameterization()
    if found is None:
        return None
    rate = found.derivative(1)
    ends = [float(rate.value(t)[0, 0]) for t in found.get_segment_times()]
    return np.maximum(ends, 0.0) if len(ends) == len(grid) else None


def _sliders(count: int) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    parent = plant.world_body()
    for k in range(count):
        body = plant.AddRigidBody(f"slider_{k}", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.AddJoint(
            PrismaticJoint(f"axis_{k}", parent.body_frame(), body.body_frame(), np.array([1.0, 0.0, 0.0]))
        )
    plant.Finalize()
    return plant


RESERVE: Final = 0.97
"""Share of the joints' speed limits that the clock uses: the rest covers what is between grid points."""
ACCELERATION_SHARE: Final = 0.74
"""Share of the joints' acceleration limits that the clock uses: the rest covers what is between grid
points."""
CORNER_SHARE: Final = 0.9
"""The same at rounded corners, where the rest covers what corners do between targets. Of feeds the clock
uses ``FEED_SHARE``."""
RAMP_SPEED: Final = 1.08
"""From and to stops tools are at most so many times as fast as they may go on average: controllers take such
moves by cubics, which are faster in between. The proof allows 1.1."""
CORNER_ROUNDS: Final = 8
"""So often a piece is timed where corners ask for too much,"""
CORNER_FACTOR: Final = 1.1
"""each time with so many times the room that they lacked."""

ROOM_ROUNDS: Final = 4
"""So often a path is timed where corners have less room than thought"""
ROOM_SHARE: Final = 0.97
"""and would ask for more than this share of the accelerations."""

GRID_PER_KNOT: Final = 2
"""Least intervals of the grid between two knots."""
SHORTEST: Final = 6e-3
"""Least time of a move [s], also of one that hardly goes anywhere: controllers plan none in less than 5 ms.
"""

LEAST_GRID: Final = 100
"""Least intervals of the grid of a piece."""
MANY_PIECES: Final = 500
"""With more pieces than this each is a short way that needs few points:"""
MANY_GRID: Final = 24
"""least intervals of the grid of a piece then."""


@dataclasses.dataclass(frozen=True)
class Limits:
    """Joint speeds and accelerations (J,), the least time (N,) [s] that feeds allow for the move to each
    target, and which share (N,) of the shorter move beside it each corner is rounded over. ``tcp_time`` (N,)
    [s]: what each move takes at the fastest that tools, and tracks that go along, may go, None where nothing
    limits them. ``length`` (N,): of the moves, by which those from and to stops match their neighbours'
    speeds; None for the path's own."""

    speed: FloatArray
    acceleration: FloatArray
    least_time: FloatArray
    rounded: FloatArray
    tcp_time: FloatArray | None = None
    length: FloatArray | None = None


@dataclasses.dataclass(frozen=True)
class Clock:
    """``time`` (N,) of the targets [s]; ``asked`` (N,) the shares of the joint accelerations that the corners
    at them ask for; ``used`` names the solver of each piece; ``peak_speed`` and ``peak_acceleration`` are the
    greatest shares of the joint limits on a dense check of the timed path."""

    time: FloatArray
    asked: FloatArray
    used: tuple[str, ...]
    peak_speed: float
    peak_acceleration: float


class TimingError(ArithmeticError):
    """No solver could time the piece that ends at target ``index``."""

    def __init__(self, index: int) -> None:
        self.index = index
        super().__init__(f"no timing for the piece that ends at target {index}")


Rounded = Callable[[FloatArray, BoolArray], FloatArray]
"""The shares (N,) of :class:`Limits` for the times (N,) [s] of the moves to all targets, with stops (N,)."""


def settled(
    path: JointPath, limits: Limits, rounded: Rounded, known: "dict[bytes, TimedPiece] | None" = None
) -> Clock:
    """The clock of :func:`clock`, again where its own times leave the corners less room than the limits
    have."""
    stop = np.zeros(path.count, dtype=bool)
    stop[[end for piece in path.pieces for end in (piece.first, piece.last)]] = True
    for left in reversed(range(ROOM_ROUNDS)):
        ticks = clock(path, limits, known)
        room = np.minimum(rounded(np.diff(ticks.time, prepend=0.0), stop), limits.rounded)
        if left == 0 or not np.any(ticks.asked * limits.rounded > ROOM_SHARE * room):
            break
        limits = dataclasses.replace(limits, rounded=room)
    return ticks


def clock(path: JointPath, limits: Limits, known: "dict[bytes, TimedPiece] | None" = None) -> Clock:
    """Times of all targets, at rest at stops. Raises :class:`TimingError`.

    ``known``: pieces that were timed before, to which those are added that are not among them: of a path that
    was changed at a few places most are the same.
    """
    least = LEAST_GRID if len(path.pieces) <= MANY_PIECES else MANY_GRID
    known = {} if known is None else known
    pieces = []
    for one in path.pieces:
        key = _key(one.spline, one.knots, limits, one.first, one.last, least)
        if key not in known:
            known[key] = _piece(one.spline, one.knots, limits, one.first, one.last, least)
        pieces.append(known[key])
    time, hardest = np.zeros((2, path.count))
    speeds, accelerations = [0.0], [0.0]
    for piece, (at, asked, profile, _) in zip(path.pieces, pieces, strict=True):
        hardest[piece.first + 1 : piece.last] = asked
        time[piece.first + 1 : piece.last + 1] = time[piece.first] + at[1:]
        fast, hard = profile.peaks(limits)
        speeds.append(fast)
        accelerations.append(hard)
    return Clock(time, hardest, tuple(used for *_, used in pieces), max(speeds), max(accelerations))


@dataclasses.dataclass(frozen=True)
class Profile:
    """A timed piece: path speeds at grid points, with the path speed's square linear in between."""

    spline: CubicSpline
    grid: FloatArray
    speed: FloatArray

    @property
    def time(self) -> FloatArray:
        """Times (G,) of the grid points from the piece's start."""
        mean = 0.5 * (self.speed[1:] + self.speed[:-1])
        return np.concatenate([[0.0], np.cumsum(np.diff(self.grid) / np.maximum(mean, 1e-12))])

    def peaks(self, limits: Limits, dense: int = 4) -> tuple[float, float]:
        """Greatest shares of the joint speed and acceleration limits at ``dense`` points an interval."""
        share = (np.arange(dense) + 0.5) / dense
        square = self.speed**2
        s = (self.grid[:-1, None] + share * np.diff(self.grid)[:, None]).ravel()
        x = (square[:-1, None] + share * np.diff(square)[:, None]).ravel()
        u = np.repeat(0.5 * np.diff(square) / np.diff(self.grid), dense)
        first, second = self.spline(s, 1), self.spline(s, 2)
        speed = np.abs(first) * np.sqrt(x)[:, None] / limits.speed
        acceleration = np.abs(first * u[:, None] + second * x[:, None]) / limits.acceleration
        return float(speed.max()), float(acceleration.max())


TimedPiece = tuple[FloatArray, FloatArray, Profile, str]
"""What :func:`_piece` gives."""


def _key(spline: CubicSpline, knots: FloatArray, limits: Limits, first: int, last: int, least: int) -> bytes:
    """A digest of all numbers that :func:`_piece` looks at."""
    own = (
        limits.least_time[first + 1 : last + 1],
        limits.rounded[first + 1 : last],
        _tcp(limits, first, last),
        _lengths(knots, limits, first, last),
    )
    arrays = (spline.x, spline.c, knots, *own, limits.speed, limits.acceleration)
    out = hashlib.sha256(repr((least, [part.shape for part in arrays])).encode())
    for part in arrays:
        out.update(np.ascontiguousarray(part).tobytes())
    return out.digest()


def _tcp(limits: Limits, first: int, last: int) -> FloatArray:
    """What the first and the last move of a piece take at least (2,) [s] at the fastest that tools may go."""
    return np.zeros(2) if limits.tcp_time is None else limits.tcp_time[[first + 1, last]]


def _lengths(knots: FloatArray, limits: Limits, first: int, last: int) -> FloatArray:
    """Lengths of the moves of a piece by which speeds beside stops are matched."""
    return np.diff(knots) if limits.length is None else limits.length[first + 1 : last + 1]


def _piece(
    spline: CubicSpline, knots: FloatArray, limits: Limits, first: int, last: int, least: int = LEAST_GRID
) -> TimedPiece:
    """Times of the targets ``first`` to ``last`` of one piece, which lie at the path positions ``knots``, and
    the shares of the accelerations that the corners at its inner ones ask for."""
    steps, gone = np.diff(knots), _lengths(knots, limits, first, last)
    top = FEED_SHARE * steps / np.maximum(limits.least_time[first + 1 : last + 1], 1e-9)
    grid = _grid(spline.x, least)
    at = np.searchsorted(knots, grid, side="right") - 1
    inner = np.clip(at, 0, len(steps) - 1)
    bound = top[inner]
    on_knot = np.flatnonzero(np.isin(grid, knots[1:-1]))
    bound[on_knot] = np.minimum(top[inner[on_knot]], top[inner[on_knot] - 1])
    speed, acceleration = RESERVE * limits.speed, ACCELERATION_SHARE * limits.acceleration
    corners = Corners.of(spline, knots, limits.rounded[first + 1 : last])
    weaker = np.ones(len(knots) - 2)
    held: CornerLimits | None = None
    rounds = 0
    slower: TimedPiece | None = None
    while True:
        profile, used = parameterise(spline, grid, bound, speed, acceleration, held)
        if profile is None:
            if slower is None:
                raise TimingError(last)
            return slower
        time: FloatArray = np.interp(knots, grid, profile.time)
        if len(steps) == 1:
            time[1] = max(time[1], from_stop_to_stop(spline, CORNER_SHARE * limits.acceleration))
        took = np.diff(time)
        quick = np.array(ramp_peaks(gone, took)) * _tcp(limits, first, last) / took[[0, -1]] / RAMP_SPEED
        if len(steps) == 1:
            time[1] *= max(1.0, quick[0])
            quick[:] = 0.0
        asked = corners.acceleration_shares(gone, np.diff(time), limits.acceleration)
        ends = (0.0, 0.0)
        if len(steps) > 1:
            ends = ramps(spline, knots, gone, np.diff(time), limits.acceleration)
        rounds += 1
        over = max(max([*ends, *asked]) / CORNER_SHARE, quick.max() ** 2)
        if over <= 1.0:
            return time, asked, profile, used
        # all of the piece slower by one factor: accelerations fall with its square
        slower = time * np.sqrt(over), asked / over, profile, used
        if rounds == CORNER_ROUNDS:
            return slower
        if held is not None:
            weaker = np.maximum(weaker, weaker * asked / CORNER_SHARE * CORNER_FACTOR)
        held = on_grid(corners, knots, grid, weaker, CORNER_SHARE * limits.acceleration)
        mean = steps / np.diff(time)  # a ramp that is faster than its neighbour would brake at the corner
        bound[grid < knots[1]] = np.minimum(bound[grid < knots[1]], mean[1])
        bound[grid > knots[-2]] = np.minimum(bound[grid > knots[-2]], mean[-2])
        for ramp, hard, fast in zip((grid <= knots[1], grid >= knots[-2]), ends, quick, strict=True):
            if hard > CORNER_SHARE:
                bound[ramp] *= np.sqrt(CORNER_SHARE / hard / CORNER_FACTOR)
            if fast > 1.0:
                bound[ramp] /= fast


def _grid(breaks: FloatArray, least: int) -> FloatArray:
    """Grid points: the spline's own knots and points between them, at least ``least`` intervals in all."""
    per = max(GRID_PER_KNOT, int(np.ceil(least / (len(breaks) - 1))))
    share = np.arange(per) / per
    inner = breaks[:-1, None] + share * np.diff(breaks)[:, None]
    return np.append(inner.ravel(), breaks[-1])


def parameterise(
    spline: CubicSpline,
    grid: FloatArray,
    bound: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    corners: CornerLimits | None = None,
) -> tuple[Profile | None, str]:
    """Fastest profile over ``grid`` (G,) with path speed below ``bound`` (G,), at rest at both ends.

    ``speed`` and ``acceleration`` (J,) are joint limits, ``corners`` what is to hold besides, which Drake's
    solver does not know. The second value names the solver.
    """
    with np.errstate(divide="ignore", over="ignore"):  # of joints that hardly move nothing limits the path
        fastest = np.min(speed / np.abs(spline(grid, 1)), axis=1)
    limit = np.minimum(bound, fastest)
    found = path_speeds(spline, grid, limit, acceleration, corners)
    if found is not None:
        return Profile(spline, grid, found), "toppra"
    again = parameterise_drake(spline, grid, limit, acceleration)
    return (None if again is None else Profile(spline, grid, again)), "drake"


def least_times(
    travel: FloatArray, feed: FloatArray, lengths: Mapping[str, FloatArray], tcp: float
) -> FloatArray:
    """Least time (N,) [s] of the move to each target: its guarded point within ``feed``, every TCP within
    ``tcp`` m/s, and none shorter than a controller can plan it.

    ``lengths`` {arm: (N,)} are the ways of the TCPs [m].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        out = np.where(travel > 0.0, travel / feed, 0.0)
    for length in lengths.values():
        out = np.maximum(out, length / tcp)
    return np.asarray(np.maximum(out, SHORTEST))
