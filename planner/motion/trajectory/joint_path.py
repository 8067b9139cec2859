"""Joint path of linear moves, as splines between stops, and the accelerations that its corners require.

A controller moves at one speed per move and rounds the corners. Joint speeds therefore change within the part
of the moves that a corner takes. At a small zone or a sharp corner they change faster than on the spline that
the clock follows.
"""

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from planner.geometry import corner_rounding
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IndexArray,
    dots,
    inverse,
    lengths,
    log_rotation,
    to_quaternion,
)
from planner.geometry.units import MM
from planner.motion.planning_scene import MovePositions, Scene, frame_holders
from planner.targets import Targets

JOINT_STEP_RAD: Final = np.deg2rad(2.0)
"""Joint change [rad] of a move above which it gets inner samples, because a line in space is curved in joint
space.
"""

MAX_MOVE_SAMPLES: Final = 24
"""Maximum number of samples of one move."""
TRACK_STEP_M: Final = 0.02
"""Travel [m] of a coordinated track above which a move gets inner samples, because links pass bodies even if
no joint moves.
"""
MAX_TRACK_SAMPLES: Final = 400
"""Maximum number of samples of one move of a coordinated track."""
MIN_ADVANCE_FRACTION: Final = 0.3
"""Minimum advance of the path parameter in cuts, as a fraction of the length in joint space and space. It
matters for tools that slide along a wire that hardly moves sideways.
"""


@dataclasses.dataclass(frozen=True)
class MoveSamples:
    """Samples of the linear moves. The first sample is target 0.

    Attributes:
        move: (K,) target to which the move leads.
        fraction: (K,) fraction of the move in (0, 1].
        q: {arm: (K, 6)} [rad] joints.
    """

    move: IndexArray
    fraction: FloatArray
    q: dict[str, FloatArray]


@dataclasses.dataclass(frozen=True)
class PathPiece:
    """Joint path between two stops.

    Attributes:
        first: Index of the target of the first stop.
        last: Index of the target of the last stop.
        spline: Joints of all arms over the path parameter.
        knots: Path parameter of each target from ``first`` to ``last``.
    """

    first: int
    last: int
    spline: CubicSpline
    knots: FloatArray


@dataclasses.dataclass(frozen=True)
class JointPath:
    """All pieces of a path, over the concatenated joints of all arms.

    Attributes:
        count: Number of targets.
        pieces: Pieces between stops.
        deviation: Largest distance [m] of a TCP on the splines from the straight lines between targets.
    """

    count: int
    pieces: tuple[PathPiece, ...]
    deviation: float


def sample_moves(
    scene: Scene,
    targets: Targets,
    branch: Mapping[str, int],
    q: Mapping[str, FloatArray],
    stride: float = JOINT_STEP_RAD,
    min_samples: int = 1,
) -> MoveSamples:
    """Sample all linear moves, at their ends and at inner points of moves that change a joint much.

    Joints are NaN where a linear move leaves the branch or reach between its targets. TCPs in frames that
    another arm holds move linearly in these frames.

    Args:
        scene: Cell with the stock in its pose.
        targets: N targets.
        branch: {arm: branch}.
        q: {arm: (N, J)} [rad] joints at the targets.
        stride: Maximum joint change [rad] between samples.
        min_samples: Minimum number of samples per move.
    """
    joint_change = np.max([np.abs(np.diff(angles, axis=0)).max(axis=1) for angles in q.values()], axis=0)
    counts = np.clip(np.ceil(joint_change / stride).astype(np.intp), min_samples, MAX_MOVE_SAMPLES)
    for values in targets.track_positions.values():
        track_counts = np.ceil(np.abs(np.diff(values)) / TRACK_STEP_M - 1e-9).astype(np.intp)
        counts = np.maximum(counts, np.minimum(track_counts, MAX_TRACK_SAMPLES))
    move = np.concatenate([[0], np.repeat(np.arange(1, targets.count), counts)])
    starts = np.concatenate([[0], np.cumsum(counts)])
    fraction = np.ones(len(move))
    fraction[1:] = (np.arange(len(move) - 1) - np.repeat(starts[:-1], counts) + 1) / np.repeat(counts, counts)
    inner = np.flatnonzero(fraction < 1.0)
    out = {arm: angles[move] for arm, angles in q.items()}
    if len(inner):
        ends = {arm: scene.chains[arm].pose(angles) for arm, angles in q.items()}
        start = {arm: pose[move[inner] - 1] for arm, pose in ends.items()}
        end = {arm: pose[move[inner]] for arm, pose in ends.items()}
        inner_poses = scene.interpolate_poses(targets, start, end, fraction[inner])
        for arm, angles in q.items():
            chain = scene.chains[arm]
            seed = angles[move[inner] - 1] + fraction[inner, None] * (
                angles[move[inner]] - angles[move[inner] - 1]
            )
            out[arm][inner] = chain.on_branch(inner_poses[arm], branch[arm], seed)
    return MoveSamples(move, fraction, out)


def is_clear(scene: Scene, targets: Targets, samples: MoveSamples) -> BoolArray:
    """Return for each of K samples of the moves whether the arms keep clearance there.

    Between targets the flexible edge is that of the nearer target.
    """
    nearest = np.where(samples.fraction >= 0.5, samples.move, samples.move - 1)
    positions = MovePositions(samples.move, samples.fraction)
    return scene.keeps_clearance(targets, samples.q, np.maximum(nearest, 0), positions)


def fit_joint_path(scene: Scene, targets: Targets, samples: MoveSamples, speed: FloatArray) -> JointPath:
    """Fit a cubic spline through the samples between every two stops.

    The path parameter is the length in joint space (each joint divided by its speed limit) plus the length in
    space. In cuts it is the path length of the guarded point, so that a constant speed of that point is a
    constant speed on the spline. Coordinated tracks are additional last joints, in m. They move as evenly as
    the tool and do not count in the parameter.

    Args:
        scene: Cell with the stock in its pose.
        targets: N targets.
        samples: Samples of the moves.
        speed: (J,) joint speed limits.
    """
    joints = np.concatenate([samples.q[arm] for arm in targets.arms], axis=1)
    q = (
        np.concatenate([joints, track_positions(targets, samples)], axis=1)
        if targets.track_positions
        else joints
    )
    joints_by_arm = {arm: samples.q[arm] for arm in targets.arms}
    poses = scene.chain_poses(targets, joints_by_arm, samples.move, samples.fraction)
    positions = [poses[arm][:, :3, 3] for arm in targets.arms]
    work_frame_positions = [pose[:, :3, 3] for pose in poses_in_work_frames(targets, poses).values()]
    parameter = np.linalg.norm(np.diff(joints, axis=0) / speed[: joints.shape[1]], axis=1)
    parameter += sum(np.linalg.norm(np.diff(p, axis=0), axis=1) for p in positions)
    cut = guarded_lengths(targets, samples)
    parameter = np.where(cut > 0.0, np.maximum(cut, MIN_ADVANCE_FRACTION * parameter), parameter)
    parameter = np.concatenate([[0.0], np.cumsum(np.maximum(parameter, 1e-6))])
    at_target = np.flatnonzero(samples.fraction == 1.0)
    pieces, deviation = [], 0.0
    for first, last in itertools.pairwise(np.flatnonzero(stops_with_ends(targets.stop)).tolist()):
        rows = np.arange(at_target[first], at_target[last] + 1)
        spline = CubicSpline(parameter[rows], q[rows], bc_type="natural" if len(rows) < 4 else "not-a-knot")
        pieces.append(PathPiece(first, last, spline, parameter[at_target[first : last + 1]]))
        deviation = max(
            deviation,
            _deviation(scene, targets, spline, parameter[rows], [p[rows] for p in work_frame_positions]),
        )
    return JointPath(targets.count, tuple(pieces), deviation)


def stops_with_ends(stop: BoolArray) -> BoolArray:
    """Return the stops (N,) with the first and the last target added, where a path always rests."""
    out = stop.copy()
    out[[0, -1]] = True
    return out


def track_positions(targets: Targets, samples: MoveSamples) -> FloatArray:
    """Return the positions (K, R) [m] of the R coordinated tracks at samples of the moves."""
    previous = np.maximum(samples.move - 1, 0)
    values = [
        v[previous] + samples.fraction * (v[samples.move] - v[previous])
        for v in targets.track_positions.values()
    ]
    return np.stack(values, axis=1) if values else np.zeros((len(samples.move), 0))


def guarded_lengths(targets: Targets, samples: MoveSamples) -> FloatArray:
    """Return the path length (K - 1,) [m] of the guarded point from each sample to the next.

    The path parameter advances by it in cuts. It is 0 outside of cuts. The guarded point is the one to which
    feeds apply.
    """
    previous_fraction = np.where(samples.move[1:] == samples.move[:-1], samples.fraction[:-1], 0.0)
    is_cut = np.array([segment.kind == "cut" for segment in targets.segment])
    return np.asarray(
        (targets.travel * is_cut)[samples.move[1:]] * (samples.fraction[1:] - previous_fraction)
    )


def _deviation(
    scene: Scene, targets: Targets, spline: CubicSpline, parameter: FloatArray, positions: list[FloatArray]
) -> float:
    """Return the largest distance [m] of the TCPs on a spline from the straight lines between samples.

    It is evaluated half way between the samples, in the frame in which a TCP moves linearly.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the path.
        spline: Joint path.
        parameter: (K,) path parameter of the samples.
        positions: For each arm the positions (K, 3) [m] of the TCP at the samples, in that frame.
    """
    middle = spline(0.5 * (parameter[1:] + parameter[:-1]))
    columns = scene.columns(targets.arms)
    poses = {arm: scene.chains[arm].pose(middle[:, part]) for arm, part in columns.items()}
    for k, arm in enumerate(targets.track_positions, start=columns[targets.arms[-1]].stop):
        track, station = scene.tracks[arm]
        poses[arm][:, :3, 3] += (middle[:, k, None] - station) * track.axis
    max_deviation = 0.0
    for pose, position in zip(poses_in_work_frames(targets, poses).values(), positions, strict=True):
        offset = pose[:, :3, 3] - position[:-1]
        chord = np.diff(position, axis=0)
        fraction = dots(offset, chord) / np.maximum(dots(chord, chord), 1e-18)
        deviation = offset - np.clip(fraction, 0.0, 1.0)[:, None] * chord
        max_deviation = max(max_deviation, float(np.linalg.norm(deviation, axis=1).max()))
    return max_deviation


def poses_in_work_frames(targets: Targets, poses: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Transform TCP poses {arm: (K, 4, 4)} from the world to the frames in which the TCPs move linearly.

    These are the work frames that another arm holds. Poses in other frames stay in the world.
    """
    holder_by_arm = dict(frame_holders(targets))
    out = {}
    for arm in targets.arms:
        holder = holder_by_arm[arm]
        out[arm] = poses[arm] if holder is None else inverse(poses[holder]) @ poses[arm]
    return out


def tcp_lengths(scene: Scene, targets: Targets, samples: MoveSamples) -> dict[str, FloatArray]:
    """Return path lengths {arm: (N,)} [m] of the TCPs on the move to each target, for limits of their speed.

    The speed of a TCP in a held frame varies during a move. The length is therefore that at the largest
    speed: the longest distance between two samples times the number of samples.
    """
    sample_count = np.bincount(samples.move, minlength=targets.count)[samples.move]
    out = {}
    poses = scene.chain_poses(targets, samples.q, samples.move, samples.fraction)
    for arm in targets.arms:
        position = poses[arm][:, :3, 3]
        step = np.append(0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)) * sample_count
        out[arm] = np.maximum.reduceat(step, np.flatnonzero(np.diff(samples.move, prepend=-1)))
    return out


MAX_CORNER_FRACTION: Final = 0.5
"""Maximum fraction of a move that a corner takes: corners at both ends meet in the middle."""
MIN_CORNER_FRACTION: Final = 1e-4
"""Minimum fraction of a move with which a corner counts."""
MAX_RAMP_RATIO: Final = 2.0
"""Maximum ratio of the end speed of a move from or to a stop to its mean speed."""
RAMP_LEVER_M: Final = 0.3
"""Length [m/rad] that weighs rotation when the speed of a move from or to a stop is matched to that of its
neighbour.
"""
RAMP_SAMPLES: Final = 65
"""Number of instants at which a move from or to a stop is evaluated."""


def _target_poses(scene: Scene, targets: Targets, samples: MoveSamples) -> dict[str, FloatArray]:
    """Compute the TCP poses {arm: (N, 4, 4)} in the world at the targets."""
    rows = np.flatnonzero(samples.fraction == 1.0)
    joints = {arm: samples.q[arm][rows] for arm in targets.arms}
    return scene.chain_poses(targets, joints, samples.move[rows])


def corner_fractions(
    scene: Scene,
    targets: Targets,
    samples: MoveSamples,
    length: FloatArray,
    duration: FloatArray,
    stop: BoolArray,
) -> FloatArray:
    """Compute the minimum fraction (N,) of the shorter adjacent move over which each corner is rounded.

    The arms round their corners together, so the arm with the smallest fraction counts.

    Args:
        scene: Cell with the stock in its pose.
        targets: N targets.
        samples: Samples of the moves.
        length: (N,) [m] lengths of the moves, as by :func:`ramp_lengths`.
        duration: (N,) durations of the moves, up to a common factor.
        stop: (N,) whether the arms stop at a target.
    """
    poses = _target_poses(scene, targets, samples)
    timing = corner_rounding.MoveTiming(duration[1:], *end_speed_ratios(length[1:], duration[1:], stop))
    deviation = 1e3 * targets.rounding.deviations(targets.segment[1:])
    # fractions for the positions and for the rotations of the tools
    position_fraction, rotation_fraction = np.full((2, targets.count), MAX_CORNER_FRACTION)
    for arm, pose in poses_in_work_frames(targets, poses).items():
        levers: FloatArray = np.full(3, corner_rounding.ROTATION_LEVER_MM)
        if scene.model is not None:
            levers = 1e3 * targets.rounding.rotation_lever(arm, scene.model.cell.arm(arm).tool)
        quaternion = to_quaternion(pose[:, :3, :3])
        track_values = targets.track_positions[arm] / MM if arm in targets.track_positions else None
        fractions = corner_rounding.corner_fractions(
            pose[:, :3, 3] / MM, quaternion, timing, levers, deviation, track_values
        )
        position_fraction[1:-1] = np.minimum(position_fraction[1:-1], fractions[0])
        rotation_fraction[1:-1] = np.minimum(rotation_fraction[1:-1], fractions[1])
    if scene.model is not None and scene.model.cell.controller.path == "spline":
        position_fraction[1:-1] = 0.0  # spline blocks have no zone: the proof rounds corners as without one
    return np.asarray(np.maximum(np.maximum(position_fraction, rotation_fraction), MIN_CORNER_FRACTION))


def end_speed_ratios(
    length: FloatArray, duration: FloatArray, stop: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the ratios of the start and end speeds of M moves to their mean speeds; 0 at stops.

    A move from or to a stop has at its other end the mean speed of the neighbouring move, but at least its
    own mean speed and at most :data:`MAX_RAMP_RATIO` times that. Other moves keep their mean speed.

    Args:
        length: (M,) lengths of the moves.
        duration: (M,) [s] durations of the moves.
        stop: (M + 1,) whether the arms stop at the ends.
    """
    speed = length / np.maximum(duration, 1e-12)
    start, end = np.ones((2, len(speed)))
    starts_at_rest, ends_at_rest = stop[:-1], stop[1:]
    start[1:] = np.clip(speed[:-1] / np.maximum(speed[1:], 1e-12), 1.0, MAX_RAMP_RATIO)
    end[:-1] = np.clip(speed[1:] / np.maximum(speed[:-1], 1e-12), 1.0, MAX_RAMP_RATIO)
    start = np.where(starts_at_rest, 0.0, np.where(ends_at_rest, start, 1.0))
    return start, np.where(ends_at_rest, 0.0, np.where(starts_at_rest, end, 1.0))


def ramp_lengths(scene: Scene, targets: Targets, samples: MoveSamples) -> FloatArray:
    """Compute the lengths (N,) [m] of the moves that define the speeds in :func:`end_speed_ratios`.

    They are path lengths of the TCPs including rotation, combined over the arms by the root of the sum of
    squares, as in the proof.
    """
    out = np.zeros(targets.count)
    for pose in poses_in_work_frames(targets, _target_poses(scene, targets, samples)).values():
        rotation = log_rotation(np.swapaxes(pose[:-1, :3, :3], 1, 2) @ pose[1:, :3, :3])
        distance = lengths(np.diff(pose[:, :3, 3], axis=0))
        out[1:] = np.hypot(out[1:], np.hypot(distance, RAMP_LEVER_M * lengths(rotation)))
    return out


def min_stop_to_stop_time(spline: CubicSpline, acceleration: FloatArray) -> float:
    """Return the minimum duration [s] of a piece of a single move, within the joint accelerations (J,).

    Controllers execute such a move by a cubic, whose ends need more acceleration than a clock that brakes as
    late as possible.
    """
    # accelerations fall with T^2: fraction(T) = fraction(1 s) / T^2 = 1
    return float(np.sqrt(_cubic_acceleration_fraction(spline(spline.x), 0.0, acceleration)))


def ramp_acceleration_fractions(
    spline: CubicSpline, knots: FloatArray, length: FloatArray, duration: FloatArray, acceleration: FloatArray
) -> tuple[float, float]:
    """Return the fractions of the joint acceleration limits that the first and the last move require.

    Controllers execute these moves between rest and the speed of the neighbouring move as cubics.

    Args:
        spline: Joint path between two stops.
        knots: (n + 1,) path positions of the targets.
        length: (n,) lengths of the moves, as by :func:`ramp_lengths`.
        duration: (n,) [s] durations of the moves.
        acceleration: (J,) joint acceleration limits.
    """
    target_index = np.searchsorted(spline.x, knots)
    values = spline(spline.x)
    # the last move is reversed in time, so that it starts at rest as the first one does
    first_move, last_move = values[: target_index[1] + 1], values[target_index[-2] :][::-1]
    first_ratio, last_ratio = ramp_end_ratios(length, duration)
    first_fraction = _cubic_acceleration_fraction(first_move, first_ratio, acceleration) / duration[0] ** 2
    return (
        first_fraction,
        _cubic_acceleration_fraction(last_move, last_ratio, acceleration) / duration[-1] ** 2,
    )


def ramp_peak_ratios(length: FloatArray, duration: FloatArray) -> tuple[float, float]:
    """Return the ratios of peak to mean speed of the first and the last of n moves between two stops.

    They are those of the cubics of :func:`ramp_acceleration_fractions`. The only move of a path has the ratio
    1.5.

    Args:
        length: (n,) lengths of the moves.
        duration: (n,) [s] durations of the moves.
    """
    ends = (0.0, 0.0) if len(duration) == 1 else ramp_end_ratios(length, duration)
    peaks = []
    for end in ends:
        # s'(x) = 2 c2 x + 3 c3 x^2 is largest at x = -c2 / (3 c3), where it is c2 x
        c2, c3 = 3.0 - end, end - 2.0
        peak_position = -c2 / (3.0 * c3) if c3 < 0.0 else 1.0
        peaks.append(c2 * peak_position if peak_position < 1.0 else end)
    return peaks[0], peaks[1]


def ramp_end_ratios(length: FloatArray, duration: FloatArray) -> tuple[float, float]:
    """Return the ratios of end to mean speed of the first and the last of n moves, at their moving ends.

    The moves lie between two stops. The moving end is the one where the move meets another.

    Args:
        length: (n,) lengths of the moves.
        duration: (n,) [s] durations of the moves.
    """
    start, end = end_speed_ratios(length, duration, stops_with_ends(np.zeros(len(length) + 1, dtype=bool)))
    return float(end[0]), float(start[-1])


def _ramp_state(time_to_end: float, duration: float, step: float, ratio: float) -> tuple[float, float]:
    """Return the path speed on a ramp at some time before its moving end, and the distance to that end.

    A ramp is a move from a stop (or, reversed in time, to a stop).

    Args:
        time_to_end: Time [s] before the moving end.
        duration: Duration [s] of the move.
        step: Length of the move in the path parameter.
        ratio: Ratio of its end speed to its mean speed.
    """
    # s(x) = x^2 (c2 + c3 x) with s(1) = 1, s'(1) = ratio; the result is s' step / T and (1 - s) step
    x, c2, c3 = 1.0 - time_to_end / duration, 3.0 - ratio, ratio - 2.0
    return x * (2.0 * c2 + 3.0 * c3 * x) * step / duration, (1.0 - x * x * (c2 + c3 * x)) * step


def _cubic_acceleration_fraction(values: FloatArray, end: float, acceleration: FloatArray) -> float:
    """Return the largest fraction of the joint acceleration limits that a move of duration 1 s requires.

    Args:
        values: (K, J) joints along the move, evenly spaced in space.
        end: Ratio of its end speed to its mean speed. It starts at rest.
        acceleration: (J,) joint acceleration limits.
    """
    # s(x) = x^2 (c2 + c3 x) on [0, 1] with s(1) = 1, s'(0) = 0, s'(1) = end; q'' = q_s s'' + q_ss s'^2
    spline = CubicSpline(np.linspace(0.0, 1.0, len(values)), values)
    x = np.linspace(0.0, 1.0, RAMP_SAMPLES)
    c2, c3 = 3.0 - end, end - 2.0
    progress, rate, change = x * x * (c2 + c3 * x), x * (2.0 * c2 + 3.0 * c3 * x), 2.0 * c2 + 6.0 * c3 * x
    fraction = (
        np.abs(spline(progress, 1) * change[:, None] + spline(progress, 2) * rate[:, None] ** 2)
        / acceleration
    )
    return float(fraction.max())


@dataclasses.dataclass(frozen=True)
class PathCorners:
    """Corners at the inner targets (n,) of a piece.

    Attributes:
        slope_before: (n, J) derivatives of the joints [rad] by the path parameter just before each corner, at
            constant speed in space.
        slope_after: (n, J) derivatives just after each corner.
        step: (n + 1,) lengths of the moves in the path parameter.
        fraction: (n,) fraction of the shorter adjacent move over which a corner is rounded on each side.
    """

    slope_before: FloatArray
    slope_after: FloatArray
    step: FloatArray
    fraction: FloatArray

    @staticmethod
    def from_spline(spline: CubicSpline, knots: FloatArray, fraction: FloatArray) -> "PathCorners":
        """Create the corners of a path.

        The breaks of the spline divide each move evenly in space. The slope next to a corner is that between
        it and the next break, with each break interval taken as an equal part of the move.

        Args:
            spline: Joint path between two stops.
            knots: (n + 2,) path parameters of the targets.
            fraction: (n,) fraction over which each corner is rounded.
        """
        target_index = np.searchsorted(spline.x, knots)
        intervals, step = np.diff(target_index), np.diff(knots)
        slope = np.diff(spline(spline.x), axis=0) * np.repeat(intervals / step, intervals)[:, None]
        corner_index = target_index[1:-1]
        return PathCorners(slope[corner_index - 1], slope[corner_index], step, fraction)

    def acceleration_fractions(
        self, length: FloatArray, duration: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Return the fractions (n,) of the joint acceleration limits that the corners require.

        A fraction exceeds 1 if a corner requires more than is allowed. Each corner is rounded by the cubic
        that continues the adjacent moves in position and velocity. The first move starts from rest and the
        last one ends at rest, each with a ramp of speed.

        Args:
            length: (n + 1,) lengths of the moves, which determine the ramps. Only their ratios matter: they
                are in m, or in the unit of the path parameter.
            duration: (n + 1,) [s] durations of the moves.
            acceleration: (J,) joint acceleration limits [rad/s^2].
        """
        mean_speed = self.step / duration
        half_time = self.fraction * np.minimum(duration[:-1], duration[1:])
        speed_in, speed_out = mean_speed[:-1].copy(), mean_speed[1:].copy()
        distance_before, distance_after = speed_in * half_time, speed_out * half_time
        if len(half_time):
            first_ratio, last_ratio = ramp_end_ratios(length, duration)
            speed_in[0], distance_before[0] = _ramp_state(
                half_time[0], duration[0], self.step[0], first_ratio
            )
            speed_out[-1], distance_after[-1] = _ramp_state(
                half_time[-1], duration[-1], self.step[-1], last_ratio
            )
        # Hermite cubic over the time T = 2 half_time with displacement D and end velocities v0, v1. Its
        # largest accelerations are those at its ends: 6 D / T^2 - (4 v0 + 2 v1) / T and
        # (2 v0 + 4 v1) / T - 6 D / T^2.
        displacement = (
            self.slope_before * distance_before[:, None] + self.slope_after * distance_after[:, None]
        )
        v0, v1 = self.slope_before * speed_in[:, None], self.slope_after * speed_out[:, None]
        span = 2.0 * half_time[:, None]
        at_start = 6.0 * displacement / span**2 - (4.0 * v0 + 2.0 * v1) / span
        at_end = (2.0 * v0 + 4.0 * v1) / span - 6.0 * displacement / span**2
        return np.asarray((np.maximum(np.abs(at_start), np.abs(at_end)) / acceleration).max(axis=1))

    def acceleration_coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Return slope and bend, (n, J) each, of the joint accelerations that the corners require.

        The accelerations are slope u + bend x, where u is the path acceleration and x the squared path speed.
        """
        # At path speed s the corner takes the time window / s. Meanwhile the joint velocity changes by
        # (after - before) s, and by the mean slope times the speed gained between the middles of both moves,
        # u middle / s. Both divided by the time, with x = s^2: slope u + bend x.
        shorter = np.minimum(self.step[:-1], self.step[1:])
        window = (2.0 * self.fraction * shorter)[:, None]
        middle = 0.5 * (self.step[:-1] + self.step[1:])[:, None]
        return 0.5 * (self.slope_before + self.slope_after) * middle / window, (
            self.slope_after - self.slope_before
        ) / window


@dataclasses.dataclass(frozen=True)
class CornerLimits:
    """Limits of the joint accelerations slope u + bend x that corners require at G grid points.

    u is the path acceleration and x the squared path speed.

    Attributes:
        slope: (G, J) coefficients of u; zeros where there is no limit.
        bend: (G, J) coefficients of x; zeros where there is no limit.
        acceleration: (J,) limits of the joint accelerations.
    """

    slope: FloatArray
    bend: FloatArray
    acceleration: FloatArray


def corner_limits_on_grid(
    corners: PathCorners, knots: FloatArray, grid: FloatArray, weaker: FloatArray, acceleration: FloatArray
) -> CornerLimits:
    """Compute the limits at grid points that keep the corners within their acceleration limits.

    Each half of a move is limited by the corner next to it. Moves from and to stops are not limited, because
    they are ramps.

    Args:
        corners: n corners.
        knots: (n + 2,) path positions of the targets.
        grid: (G,) grid points.
        weaker: (n,) factor by which the limit of each corner is divided, 1 or more.
        acceleration: (J,) joint acceleration limits.
    """
    slope, bend = corners.acceleration_coefficients()
    inner = knots[1:-1]
    middle = 0.5 * (inner[1:] + inner[:-1])
    nearest = np.searchsorted(middle, grid)
    is_limited = (grid >= inner[0]) & (grid <= inner[-1])
    scale = np.where(is_limited, weaker[nearest], 0.0)[:, None]
    return CornerLimits(slope[nearest] * scale, bend[nearest] * scale, acceleration)
