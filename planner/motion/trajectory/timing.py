"""Timing: one clock for all arms, by TOPPRA over the joint path between stops.

If the package ``toppra`` fails, Drake's ``Toppra`` with relaxed constraints is used on the same path and
limits, and the clock names its solver. Drake's solver is also the cross-check in benchmarks.

Source: Pham and Pham, "A new approach to time-optimal path parameterization based on reachability analysis",
IEEE T-RO 2018.
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
    JointPath,
    PathCorners,
    corner_limits_on_grid,
    min_stop_to_stop_time,
    ramp_acceleration_fractions,
    ramp_peak_ratios,
)
from planner.motion.trajectory.toppra_solver import path_speeds
from planner.targets import FEED_FRACTION

RELAXATION: Final = 1e-4
"""Relaxation of TOPPRA's constraints. Without it fine grids are reported as infeasible (drake 20619, 21381).
Not every release offers it.
"""

DRAKE_GRID_STRIDES: Final = (1, 2, 4, 8)
"""Strides of the grid points that are tried, in this order, until Drake's solver finds a solution."""


def parameterise_drake(
    spline: CubicSpline, grid: FloatArray, limit: FloatArray, acceleration: FloatArray
) -> FloatArray | None:
    """Compute path speeds with Drake's solver.

    The speed limit enters as one more joint whose slope over the path is the inverse of the limit. If the
    fine grid fails, coarser ones are tried. Their points have the smallest limit of the points around them.

    Args:
        spline: Joint path.
        grid: (G,) grid points.
        limit: (G,) bound of the path speed.
        acceleration: (J,) joint acceleration limits.

    Returns:
        Path speeds (G,), or None.
    """
    for stride in DRAKE_GRID_STRIDES:
        rows = np.unique(np.append(np.arange(0, len(grid), stride), len(grid) - 1))
        if len(rows) < 3:
            break
        smallest_limit = np.minimum.reduceat(limit, rows)
        smallest_limit[1:] = np.minimum(smallest_limit[1:], smallest_limit[:-1])
        try:
            speeds = solve_drake(spline, grid[rows], smallest_limit if stride > 1 else limit, acceleration)
        except (RuntimeError, SystemExit):  # Drake raises SystemExit if one of its own conditions fails
            speeds = None
        if speeds is not None:
            return np.asarray(np.sqrt(np.interp(grid, grid[rows], speeds**2)))
    return None


def solve_drake(
    spline: CubicSpline, grid: FloatArray, limit: FloatArray, acceleration: FloatArray
) -> FloatArray | None:
    """Compute path speeds (G,) by one run of Drake's solver on exactly this grid, or None.

    None means that the solver found no solution, or one on another grid. The arguments are those of
    :func:`parameterise_drake`.
    """
    joints = spline.c.shape[2]
    # an additional joint q = integral of ds / limit, whose speed limit is 1
    slope = 1.0 / np.clip(limit, 1e-9, 1e4)
    limit_joint = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(grid))])
    values = np.column_stack([spline(grid), limit_joint])
    rates = np.column_stack([spline(grid, 1), slope])
    path = PiecewisePolynomial.CubicHermite(grid, values.T, rates.T)
    solver = Toppra(path, _slider_plant(joints + 1), grid)
    relax = getattr(solver, "set_constraint_relaxation", None)
    if relax is not None:
        relax(RELAXATION)
    # joint speeds are part of ``limit``, so 1e6 means no limit here, and so does the acceleration 1e9 below
    max_velocity = np.full(joints + 1, 1e6)
    max_velocity[-1] = 1.0
    solver.AddJointVelocityLimit(-max_velocity, max_velocity)
    max_acceleration = np.append(acceleration, 1e9)
    solver.AddJointAccelerationLimit(-max_acceleration, max_acceleration)
    trajectory = solver.SolvePathParameterization()
    if trajectory is None:
        return None
    path_speed = trajectory.derivative(1)
    speeds = [float(path_speed.value(t)[0, 0]) for t in trajectory.get_segment_times()]
    return np.maximum(speeds, 0.0) if len(speeds) == len(grid) else None


def _slider_plant(count: int) -> MultibodyPlant:
    """Create a plant of ``count`` prismatic joints, because Drake's solver takes limits only with a plant."""
    plant = MultibodyPlant(0.0)
    parent = plant.world_body()
    for k in range(count):
        body = plant.AddRigidBody(f"slider_{k}", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.AddJoint(
            PrismaticJoint(f"axis_{k}", parent.body_frame(), body.body_frame(), np.array([1.0, 0.0, 0.0]))
        )
    plant.Finalize()
    return plant


SPEED_FRACTION: Final = 0.97
"""Fraction of the joint speed limits that the clock uses. The rest covers the path between grid points."""
ACCELERATION_FRACTION: Final = 0.74
"""Fraction of the joint acceleration limits that the clock uses. The rest covers the path between grid
points.
"""
CORNER_ACCELERATION_FRACTION: Final = 0.9
"""Fraction of the acceleration limits that the clock uses at rounded corners. The rest covers corners between
targets.
"""
MAX_RAMP_SPEED_RATIO: Final = 1.08
"""Maximum ratio of the peak speed of a tool on a move from or to a stop to its allowed speed. Controllers
execute these moves by cubics, whose peak speed exceeds the mean. The proof allows 1.1.
"""
MAX_CORNER_ROUNDS: Final = 8
"""Maximum number of times that a piece is timed while its corners exceed the acceleration limits."""
CORNER_SLOWING_FACTOR: Final = 1.1
"""Factor by which corners are slowed in each round beyond what their excess of acceleration requires."""

MAX_CLOCK_ROUNDS: Final = 4
"""Maximum number of times that a path is timed while corners are smaller than assumed."""
MAX_CORNER_DEMAND: Final = 0.97
"""Fraction of the acceleration limits that corners may require if they are smaller than assumed. Above it,
another round follows.
"""

GRID_PER_KNOT: Final = 2
"""Minimum number of grid intervals between two knots."""
MIN_SEGMENT_TIME_S: Final = 6e-3
"""Minimum duration [s] of a move, even of almost no length. Controllers plan no move below 5 ms."""

MIN_GRID_INTERVALS: Final = 100
"""Minimum number of grid intervals of a piece."""
MANY_PIECES_COUNT: Final = 500
"""Number of pieces of a path above which each piece is short and needs few grid points."""
MIN_GRID_INTERVALS_OF_MANY: Final = 24
"""Minimum number of grid intervals of a piece if there are more than :data:`MANY_PIECES_COUNT` pieces."""


@dataclasses.dataclass(frozen=True)
class ClockLimits:
    """Limits of a clock.

    Attributes:
        speed: (J,) joint speed limits.
        acceleration: (J,) joint acceleration limits.
        min_time: (N,) [s] minimum duration of the move to each target by feeds.
        corner_fractions: (N,) fraction of the shorter adjacent move over which each corner is rounded.
        tcp_time: (N,) [s] duration of each move at the maximum speed of tools and coordinated tracks; None if
            unlimited.
        length: (N,) lengths of the moves, from which the speeds of moves from and to stops follow
            (:func:`ramp_end_ratios`); None for the lengths in the path parameter.
    """

    speed: FloatArray
    acceleration: FloatArray
    min_time: FloatArray
    corner_fractions: FloatArray
    tcp_time: FloatArray | None = None
    length: FloatArray | None = None


@dataclasses.dataclass(frozen=True)
class Clock:
    """Times of a path.

    Attributes:
        time: (N,) [s] times of the targets.
        corner_demand: (N,) fractions of the joint acceleration limits that the corners require; 0 at stops.
        solvers: Name of the solver of each piece.
        peak_speed: Largest fraction of the joint speed limits that the path uses.
        peak_acceleration: Largest fraction of the joint acceleration limits that the path uses.
    """

    time: FloatArray
    corner_demand: FloatArray
    solvers: tuple[str, ...]
    peak_speed: float
    peak_acceleration: float


class TimingError(ArithmeticError):
    """No solver could time the piece that ends at target ``index``."""

    def __init__(self, index: int) -> None:
        self.index = index
        super().__init__(f"no timing for the piece that ends at target {index}")


CornerFractions = Callable[[FloatArray, BoolArray], FloatArray]
"""Returns the corner fractions (N,) of :class:`ClockLimits` for move durations (N,) [s] and stops (N,)."""


def settle_clock(
    path: JointPath,
    limits: ClockLimits,
    corner_fractions: CornerFractions,
    clock_pieces: "dict[bytes, TimedPiece] | None" = None,
) -> Clock:
    """Compute the clock with corner fractions that suit its own durations, for the final timing of a path.

    Corner fractions depend on the durations of the moves, and the clock depends on the corner fractions. The
    clock is computed again while corners are smaller than assumed and require too much acceleration.

    Args:
        path: Joint path.
        limits: Limits with assumed corner fractions.
        corner_fractions: Returns the corner fractions for durations and stops.
        clock_pieces: Pieces as for :func:`compute_clock`.

    Raises:
        TimingError: A piece has no timing.
    """
    stop = np.zeros(path.count, dtype=bool)
    stop[[end for piece in path.pieces for end in (piece.first, piece.last)]] = True
    for rounds_left in reversed(range(MAX_CLOCK_ROUNDS)):
        current_clock = compute_clock(path, limits, clock_pieces)
        available = np.minimum(
            corner_fractions(np.diff(current_clock.time, prepend=0.0), stop), limits.corner_fractions
        )
        if rounds_left == 0 or not np.any(
            current_clock.corner_demand * limits.corner_fractions > MAX_CORNER_DEMAND * available
        ):
            break
        limits = dataclasses.replace(limits, corner_fractions=available)
    return current_clock


def compute_clock(
    path: JointPath, limits: ClockLimits, clock_pieces: "dict[bytes, TimedPiece] | None" = None
) -> Clock:
    """Compute the times of all targets, at rest at stops.

    Args:
        path: Joint path.
        limits: Limits.
        clock_pieces: Pieces that are already timed, by a digest of their data; new ones are added. If a path
            changes at a few places, most of its pieces are the same.

    Raises:
        TimingError: A piece has no timing.
    """
    min_intervals = (
        MIN_GRID_INTERVALS if len(path.pieces) <= MANY_PIECES_COUNT else MIN_GRID_INTERVALS_OF_MANY
    )
    clock_pieces = {} if clock_pieces is None else clock_pieces
    pieces = []
    for piece_path in path.pieces:
        key = _piece_key(
            piece_path.spline, piece_path.knots, limits, piece_path.first, piece_path.last, min_intervals
        )
        if key not in clock_pieces:
            clock_pieces[key] = _time_piece(
                piece_path.spline, piece_path.knots, limits, piece_path.first, piece_path.last, min_intervals
            )
        pieces.append(clock_pieces[key])
    time, corner_demand = np.zeros((2, path.count))
    peak_speeds, peak_accelerations = [0.0], [0.0]
    for piece, (piece_time, piece_demand, profile, _) in zip(path.pieces, pieces, strict=True):
        corner_demand[piece.first + 1 : piece.last] = piece_demand
        time[piece.first + 1 : piece.last + 1] = time[piece.first] + piece_time[1:]
        peak_speed, peak_acceleration = profile.peak_fractions(limits)
        peak_speeds.append(peak_speed)
        peak_accelerations.append(peak_acceleration)
    solvers = tuple(solver for *_, solver in pieces)
    return Clock(time, corner_demand, solvers, max(peak_speeds), max(peak_accelerations))


@dataclasses.dataclass(frozen=True)
class SpeedProfile:
    """Path speeds of a piece at grid points. The squared path speed is linear in between.

    Attributes:
        spline: Joint path.
        grid: (G,) grid points of the path parameter.
        speed: (G,) path speeds.
    """

    spline: CubicSpline
    grid: FloatArray
    speed: FloatArray

    @property
    def time(self) -> FloatArray:
        """Times (G,) [s] of the grid points from the start of the piece."""
        mean = 0.5 * (self.speed[1:] + self.speed[:-1])
        return np.concatenate([[0.0], np.cumsum(np.diff(self.grid) / np.maximum(mean, 1e-12))])

    def peak_fractions(self, limits: ClockLimits, dense: int = 4) -> tuple[float, float]:
        """Return the largest fractions of the joint speed and acceleration limits that the profile uses.

        They are evaluated at ``dense`` points in each grid interval.
        """
        # q' = q_s sqrt(x) and q'' = q_s u + q_ss x, with the squared path speed x and the path acceleration u
        fraction = (np.arange(dense) + 0.5) / dense
        square = self.speed**2
        s = (self.grid[:-1, None] + fraction * np.diff(self.grid)[:, None]).ravel()
        x = (square[:-1, None] + fraction * np.diff(square)[:, None]).ravel()
        u = np.repeat(0.5 * np.diff(square) / np.diff(self.grid), dense)
        first, second = self.spline(s, 1), self.spline(s, 2)
        speed = np.abs(first) * np.sqrt(x)[:, None] / limits.speed
        acceleration = np.abs(first * u[:, None] + second * x[:, None]) / limits.acceleration
        return float(speed.max()), float(acceleration.max())


TimedPiece = tuple[FloatArray, FloatArray, SpeedProfile, str]
"""Timing of a piece with n targets: times (n,) [s] of the targets, fractions (n - 2,) of the joint
acceleration limits that its corners require, profile, and name of the solver.
"""


def _piece_key(
    spline: CubicSpline, knots: FloatArray, limits: ClockLimits, first: int, last: int, min_intervals: int
) -> bytes:
    """Return a digest of all numbers that :func:`_time_piece` uses, with which its result is found again."""
    piece_limits = (
        limits.min_time[first + 1 : last + 1],
        limits.corner_fractions[first + 1 : last],
        _tcp_times(limits, first, last),
        _move_lengths(knots, limits, first, last),
    )
    arrays = (spline.x, spline.c, knots, *piece_limits, limits.speed, limits.acceleration)
    out = hashlib.sha256(repr((min_intervals, [part.shape for part in arrays])).encode())
    for part in arrays:
        out.update(np.ascontiguousarray(part).tobytes())
    return out.digest()


def _tcp_times(limits: ClockLimits, first: int, last: int) -> FloatArray:
    """Return the durations (2,) [s] of the first and the last move of a piece at the maximum speed of tools.

    ``first`` and ``last`` are the targets at the ends of the piece. The durations are 0 if unlimited.
    """
    return np.zeros(2) if limits.tcp_time is None else limits.tcp_time[[first + 1, last]]


def _move_lengths(knots: FloatArray, limits: ClockLimits, first: int, last: int) -> FloatArray:
    """Return the lengths (n - 1,) of the moves of a piece for :func:`ramp_end_ratios`.

    They are in the path parameter if the limits state no lengths.
    """
    return np.diff(knots) if limits.length is None else limits.length[first + 1 : last + 1]


def _time_piece(
    spline: CubicSpline,
    knots: FloatArray,
    limits: ClockLimits,
    first: int,
    last: int,
    min_intervals: int = MIN_GRID_INTERVALS,
) -> TimedPiece:
    """Time one piece, with ramps and corners as controllers execute them.

    A ramp is a move from or to a stop. If the limits are not met after :data:`MAX_CORNER_ROUNDS` rounds, or a
    later round has no solution, the whole piece is slowed by one factor.

    Args:
        spline: Joint path.
        knots: (n,) path parameters of the targets.
        limits: Limits.
        first: Index of the first target of the piece.
        last: Index of the last target of the piece.
        min_intervals: Minimum number of grid intervals.

    Raises:
        TimingError: No solver can time the piece.
    """
    steps, move_lengths = np.diff(knots), _move_lengths(knots, limits, first, last)
    max_speed = FEED_FRACTION * steps / np.maximum(limits.min_time[first + 1 : last + 1], 1e-9)
    grid = _grid_points(spline.x, min_intervals)
    # the bound of the path speed is that of the move, and at a target that of the slower of both moves
    move = np.clip(np.searchsorted(knots, grid, side="right") - 1, 0, len(steps) - 1)
    bound = max_speed[move]
    on_knot = np.flatnonzero(np.isin(grid, knots[1:-1]))
    bound[on_knot] = np.minimum(max_speed[move[on_knot]], max_speed[move[on_knot] - 1])
    speed, acceleration = SPEED_FRACTION * limits.speed, ACCELERATION_FRACTION * limits.acceleration
    corners = PathCorners.from_spline(spline, knots, limits.corner_fractions[first + 1 : last])
    weaker = np.ones(len(knots) - 2)  # factor by which the acceleration limit of each corner is divided
    corner_limits: CornerLimits | None = None
    rounds = 0
    slower: TimedPiece | None = None
    # Time the piece, then evaluate ramps and corners as controllers execute them. Those that exceed a limit
    # are slowed in the next round.
    while True:
        profile, solver = compute_profile(spline, grid, bound, speed, acceleration, corner_limits)
        if profile is None:
            if slower is None:
                raise TimingError(last)
            return slower
        time: FloatArray = np.interp(knots, grid, profile.time)
        if len(steps) == 1:
            time[1] = max(
                time[1], min_stop_to_stop_time(spline, CORNER_ACCELERATION_FRACTION * limits.acceleration)
            )
        durations = np.diff(time)
        ramp_excess = (
            np.array(ramp_peak_ratios(move_lengths, durations))
            * _tcp_times(limits, first, last)
            / durations[[0, -1]]
            / MAX_RAMP_SPEED_RATIO
        )
        if len(steps) == 1:  # a piece of one move has no neighbour to match, so it is slowed directly
            time[1] *= max(1.0, ramp_excess[0])
            ramp_excess[:] = 0.0
        demand = corners.acceleration_fractions(move_lengths, np.diff(time), limits.acceleration)
        ramp_demand = (0.0, 0.0)
        if len(steps) > 1:
            ramp_demand = ramp_acceleration_fractions(
                spline, knots, move_lengths, np.diff(time), limits.acceleration
            )
        rounds += 1
        excess = max(max([*ramp_demand, *demand]) / CORNER_ACCELERATION_FRACTION, ramp_excess.max() ** 2)
        if excess <= 1.0:
            return time, demand, profile, solver
        # slow the whole piece by one factor: accelerations fall with its square
        slower = time * np.sqrt(excess), demand / excess, profile, solver
        if rounds == MAX_CORNER_ROUNDS:
            return slower
        if corner_limits is not None:
            weaker = np.maximum(
                weaker, weaker * demand / CORNER_ACCELERATION_FRACTION * CORNER_SLOWING_FACTOR
            )
        corner_limits = corner_limits_on_grid(
            corners, knots, grid, weaker, CORNER_ACCELERATION_FRACTION * limits.acceleration
        )
        # a ramp faster than its neighbour would have to brake at the corner
        mean_speed = steps / np.diff(time)
        bound[grid < knots[1]] = np.minimum(bound[grid < knots[1]], mean_speed[1])
        bound[grid > knots[-2]] = np.minimum(bound[grid > knots[-2]], mean_speed[-2])
        on_ramps = (grid <= knots[1], grid >= knots[-2])
        for on_ramp, acceleration_fraction, speed_excess in zip(
            on_ramps, ramp_demand, ramp_excess, strict=True
        ):
            if acceleration_fraction > CORNER_ACCELERATION_FRACTION:
                bound[on_ramp] *= np.sqrt(
                    CORNER_ACCELERATION_FRACTION / acceleration_fraction / CORNER_SLOWING_FACTOR
                )
            if speed_excess > 1.0:
                bound[on_ramp] /= speed_excess


def _grid_points(breaks: FloatArray, min_intervals: int) -> FloatArray:
    """Return grid points (G,): the breaks of a spline and points between them.

    There are at least ``min_intervals`` intervals, and at least :data:`GRID_PER_KNOT` between two breaks.
    """
    points_per_knot = max(GRID_PER_KNOT, int(np.ceil(min_intervals / (len(breaks) - 1))))
    fraction = np.arange(points_per_knot) / points_per_knot
    inner = breaks[:-1, None] + fraction * np.diff(breaks)[:, None]
    return np.append(inner.ravel(), breaks[-1])


def compute_profile(
    spline: CubicSpline,
    grid: FloatArray,
    bound: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    corners: CornerLimits | None = None,
) -> tuple[SpeedProfile | None, str]:
    """Compute the fastest profile that is at rest at both ends.

    If the package ``toppra`` finds none, Drake's solver is used, without the limits at corners.

    Args:
        spline: Joint path.
        grid: (G,) grid points.
        bound: (G,) bound of the path speed.
        speed: (J,) joint speed limits.
        acceleration: (J,) joint acceleration limits.
        corners: Limits at corners, which Drake's solver does not know.

    Returns:
        The profile or None, and the name of the solver.
    """
    with np.errstate(divide="ignore", over="ignore"):  # joints that hardly move do not limit the path
        fastest = np.min(speed / np.abs(spline(grid, 1)), axis=1)
    limit = np.minimum(bound, fastest)
    speeds = path_speeds(spline, grid, limit, acceleration, corners)
    if speeds is not None:
        return SpeedProfile(spline, grid, speeds), "toppra"
    drake_speeds = parameterise_drake(spline, grid, limit, acceleration)
    return (None if drake_speeds is None else SpeedProfile(spline, grid, drake_speeds)), "drake"


def min_times(
    travel: FloatArray, feed: FloatArray, lengths: Mapping[str, FloatArray], tcp: float
) -> FloatArray:
    """Compute the minimum duration (N,) [s] of the move to each target.

    The guarded point stays within its feed and every TCP within its speed limit. No move is shorter than
    controllers can plan.

    Args:
        travel: (N,) [m] path lengths of the guarded point.
        feed: (N,) [m/s] feeds.
        lengths: {arm: (N,)} [m] path lengths of the TCPs.
        tcp: Maximum TCP speed [m/s].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        out = np.where(travel > 0.0, travel / feed, 0.0)
    for length in lengths.values():
        out = np.maximum(out, length / tcp)
    return np.asarray(np.maximum(out, MIN_SEGMENT_TIME_S))
