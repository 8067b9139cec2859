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
"""Minimum advance of the path parameter in cuts, as a fraction of the distance in joints and space. It
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
    """Path between the stops at targets ``first`` and ``last``.

    ``knots`` are the path positions of its targets.
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
    """Sample all linear moves.

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
    parts = np.clip(np.ceil(joint_change / stride).astype(np.intp), min_samples, MAX_MOVE_SAMPLES)
    for values in targets.track_positions.values():
        track_parts = np.ceil(np.abs(np.diff(values)) / TRACK_STEP_M - 1e-9).astype(np.intp)
        parts = np.maximum(parts, np.minimum(track_parts, MAX_TRACK_SAMPLES))
    move = np.concatenate([[0], np.repeat(np.arange(1, targets.count), parts)])
    starts = np.concatenate([[0], np.cumsum(parts)])
    fraction = np.ones(len(move))
    fraction[1:] = (np.arange(len(move) - 1) - np.repeat(starts[:-1], parts) + 1) / np.repeat(parts, parts)
    inner = np.flatnonzero(fraction < 1.0)
    out = {arm: angles[move] for arm, angles in q.items()}
    if len(inner):
        ends = {arm: scene.chains[arm].pose(angles) for arm, angles in q.items()}
        start = {arm: pose[move[inner] - 1] for arm, pose in ends.items()}
        end = {arm: pose[move[inner]] for arm, pose in ends.items()}
        between = scene.interpolate_poses(targets, start, end, fraction[inner])
        for arm, angles in q.items():
            chain = scene.chains[arm]
            seed = angles[move[inner] - 1] + fraction[inner, None] * (
                angles[move[inner]] - angles[move[inner] - 1]
            )
            out[arm][inner] = chain.on_branch(between[arm], branch[arm], seed)
    return MoveSamples(move, fraction, out)


def is_clear(scene: Scene, targets: Targets, samples: MoveSamples) -> BoolArray:
    """Whether (K,) samples of the moves keep clearance.

    Between targets the flexible edge is that of the nearer target.
    """
    nearest = np.where(samples.fraction >= 0.5, samples.move, samples.move - 1)
    positions = MovePositions(samples.move, samples.fraction)
    return scene.keeps_clearance(targets, samples.q, np.maximum(nearest, 0), positions)


def fit_joint_path(scene: Scene, targets: Targets, samples: MoveSamples, speed: FloatArray) -> JointPath:
    """Fit splines through the samples.

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
    """Stops (N,) including the first and the last target."""
    out = stop.copy()
    out[[0, -1]] = True
    return out


def track_positions(targets: Targets, samples: MoveSamples) -> FloatArray:
    """Positions (K, R) [m] of the R coordinated tracks at samples of the moves."""
    previous = np.maximum(samples.move - 1, 0)
    values = [
        v[previous] + samples.fraction * (v[samples.move] - v[previous])
        for v in targets.track_positions.values()
    ]
    return np.stack(values, axis=1) if values else np.zeros((len(samples.move), 0))


def guarded_lengths(targets: Targets, samples: MoveSamples) -> FloatArray:
    """Path length (K - 1,) [m] of the guarded point to each sample but the first, in cuts; 0 elsewhere."""
    previous_fraction = np.where(samples.move[1:] == samples.move[:-1], samples.fraction[:-1], 0.0)
    is_cut = np.array([segment.kind == "cut" for segment in targets.segment])
    return np.asarray(
        (targets.travel * is_cut)[samples.move[1:]] * (samples.fraction[1:] - previous_fraction)
    )


def _deviation(
    scene: Scene, targets: Targets, spline: CubicSpline, parameter: FloatArray, positions: list[FloatArray]
) -> float:
    """Largest distance [m] of TCPs on a spline from the chords between samples.

    It is taken half way between the samples. Both are in the frame in which a TCP moves linearly.
    """
    middle = spline(0.5 * (parameter[1:] + parameter[:-1]))
    columns = scene.columns(targets.arms)
    poses = {arm: scene.chains[arm].pose(middle[:, part]) for arm, part in columns.items()}
    for k, arm in enumerate(targets.track_positions, start=columns[targets.arms[-1]].stop):
        track, station = scene.tracks[arm]
        poses[arm][:, :3, 3] += (middle[:, k, None] - station) * track.axis
    worst = 0.0
    for pose, position in zip(poses_in_work_frames(targets, poses).values(), positions, strict=True):
        offset = pose[:, :3, 3] - position[:-1]
        chord = np.diff(position, axis=0)
        along = dots(offset, chord) / np.maximum(dots(chord, chord), 1e-18)
        deviation = offset - np.clip(along, 0.0, 1.0)[:, None] * chord
        worst = max(worst, float(np.linalg.norm(deviation, axis=1).max()))
    return worst


def poses_in_work_frames(targets: Targets, poses: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Transform TCP poses {arm: (K, 4, 4)} from the world to held work frames.

    Poses in other frames stay in the world.
    """
    held = dict(frame_holders(targets))
    out = {}
    for arm in targets.arms:
        holder = held[arm]
        out[arm] = poses[arm] if holder is None else inverse(poses[holder]) @ poses[arm]
    return out


def tcp_lengths(scene: Scene, targets: Targets, samples: MoveSamples) -> dict[str, FloatArray]:
    """Path length {arm: (N,)} [m] of each TCP on each move if it kept its largest speed on that move.

    Between targets the speed of a TCP in a held frame varies.
    """
    parts = np.bincount(samples.move, minlength=targets.count)[samples.move]
    out = {}
    poses = scene.chain_poses(targets, samples.q, samples.move, samples.fraction)
    for arm in targets.arms:
        position = poses[arm][:, :3, 3]
        step = np.append(0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)) * parts
        out[arm] = np.maximum.reduceat(step, np.flatnonzero(np.diff(samples.move, prepend=-1)))
    return out


MAX_CORNER_FRACTION: Final = 0.5
"""Maximum fraction of a move that a corner takes: corners at both ends meet in the middle."""
MIN_CORNER_FRACTION: Final = 1e-4
"""Minimum fraction of a move with which a corner counts."""
MAX_RAMP_RATIO: Final = 2.0
"""Maximum ratio of the end speed of a move from or to a stop to its mean speed."""
RAMP_LEVER_M: Final = 0.3
"""Length [m/rad] that weighs rotation when the speed of such a move is matched to its neighbour's."""
RAMP_SAMPLES: Final = 65
"""Number of instants at which a move from or to a stop is evaluated."""


def _target_poses(scene: Scene, targets: Targets, samples: MoveSamples) -> dict[str, FloatArray]:
    """TCP poses (N, 4, 4) at the targets."""
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
    """Fraction (N,) of the shorter adjacent move over which the corner at each target is rounded at least.

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
    zone, turning_zone = np.full((2, targets.count), MAX_CORNER_FRACTION)
    for arm, pose in poses_in_work_frames(targets, poses).items():
        levers: FloatArray = np.full(3, corner_rounding.ROTATION_LEVER_MM)
        if scene.model is not None:
            levers = 1e3 * targets.rounding.rotation_lever(arm, scene.model.cell.arm(arm).tool)
        quaternion = to_quaternion(pose[:, :3, :3])
        track_values = targets.track_positions[arm] / MM if arm in targets.track_positions else None
        fractions = corner_rounding.corner_fractions(
            pose[:, :3, 3] / MM, quaternion, timing, levers, deviation, track_values
        )
        zone[1:-1] = np.minimum(zone[1:-1], fractions[0])
        turning_zone[1:-1] = np.minimum(turning_zone[1:-1], fractions[1])
    if scene.model is not None and scene.model.cell.controller.path == "spline":
        zone[1:-1] = 0.0  # spline blocks have no zone: the proof rounds their corners as without one
    return np.asarray(np.maximum(np.maximum(zone, turning_zone), MIN_CORNER_FRACTION))


def end_speed_ratios(
    length: FloatArray, duration: FloatArray, stop: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Ratios of the start and end speeds of M moves to their mean speeds; 0 at stops.

    Args:
        length: (M,) lengths of the moves.
        duration: (M,) [s] durations of the moves.
        stop: (M + 1,) whether the arms stop at the ends.
    """
    speed = length / np.maximum(duration, 1e-12)
    start, end = np.ones((2, len(speed)))
    first, last = stop[:-1], stop[1:]
    start[1:] = np.clip(speed[:-1] / np.maximum(speed[1:], 1e-12), 1.0, MAX_RAMP_RATIO)
    end[:-1] = np.clip(speed[1:] / np.maximum(speed[:-1], 1e-12), 1.0, MAX_RAMP_RATIO)
    start = np.where(first, 0.0, np.where(last, start, 1.0))
    return start, np.where(last, 0.0, np.where(first, end, 1.0))


def ramp_lengths(scene: Scene, targets: Targets, samples: MoveSamples) -> FloatArray:
    """Lengths (N,) [m] of the moves by which moves from and to stops match the speed of their neighbours.

    They are path lengths of the TCPs including rotation, as in the proof.
    """
    out = np.zeros(targets.count)
    for pose in poses_in_work_frames(targets, _target_poses(scene, targets, samples)).values():
        rotation = log_rotation(np.swapaxes(pose[:-1, :3, :3], 1, 2) @ pose[1:, :3, :3])
        distance = lengths(np.diff(pose[:, :3, 3], axis=0))
        out[1:] = np.hypot(out[1:], np.hypot(distance, RAMP_LEVER_M * lengths(rotation)))
    return out


def min_stop_to_stop_time(spline: CubicSpline, acceleration: FloatArray) -> float:
    """Minimum duration [s] of a path of a single move within the joint accelerations (J,).

    Controllers execute such a move by a cubic, whose ends need more acceleration than a clock that brakes as
    late as possible.
    """
    # accelerations fall with T^2: fraction(T) = fraction(1 s) / T^2 = 1
    return float(np.sqrt(_cubic_acceleration_fraction(spline(spline.x), 0.0, acceleration)))


def ramp_acceleration_fractions(
    spline: CubicSpline, knots: FloatArray, length: FloatArray, duration: FloatArray, acceleration: FloatArray
) -> tuple[float, float]:
    """Fractions of the joint accelerations that the first and the last move between stops require.

    Each is a cubic that ends at the speed of its neighbour.

    Args:
        spline: Joint path.
        knots: (n + 1,) path positions of the targets.
        length: (n,) lengths of the moves.
        duration: (n,) [s] durations of the moves.
        acceleration: (J,) joint acceleration limits.
    """
    at = np.searchsorted(spline.x, knots)
    values = spline(spline.x)
    first, last = values[: at[1] + 1], values[at[-2] :][::-1]
    starts, ends = ramp_end_ratios(length, duration)
    begins = _cubic_acceleration_fraction(first, starts, acceleration) / duration[0] ** 2
    return begins, _cubic_acceleration_fraction(last, ends, acceleration) / duration[-1] ** 2


def ramp_peak_ratios(length: FloatArray, duration: FloatArray) -> tuple[float, float]:
    """Ratios of peak to mean speed of the first move from a stop and the last move to a stop.

    They are those of the cubics of :func:`ramp_acceleration_fractions`. The only move of a path has the ratio
    1.5.
    """
    ends = (0.0, 0.0) if len(duration) == 1 else ramp_end_ratios(length, duration)
    peaks = []
    for end in ends:
        # s'(x) = 2 c2 x + 3 c3 x^2 is largest at x = -c2 / (3 c3), where it is c2 x
        c2, c3 = 3.0 - end, end - 2.0
        top = -c2 / (3.0 * c3) if c3 < 0.0 else 1.0  # position of the peak speed of the cubic
        peaks.append(c2 * top if top < 1.0 else end)
    return peaks[0], peaks[1]


def ramp_end_ratios(length: FloatArray, duration: FloatArray) -> tuple[float, float]:
    """Ratios of end to mean speed of the first and the last of n moves where they meet others.

    Args:
        length: (n,) lengths of the moves.
        duration: (n,) [s] durations of the moves.
    """
    start, end = end_speed_ratios(length, duration, stops_with_ends(np.zeros(len(length) + 1, dtype=bool)))
    return float(end[0]), float(start[-1])


def _ramp_state(half: float, duration: float, step: float, rate: float) -> tuple[float, float]:
    """Path speed at ``half`` [s] from the moving end of a ramp, and the distance from there to that end.

    The move covers ``step`` in ``duration`` [s]. ``rate`` is the ratio of its end speed to its mean speed.
    """
    # s(x) = x^2 (c2 + c3 x) with s(1) = 1, s'(1) = rate; the result is s' step / T and (1 - s) step
    x, c2, c3 = 1.0 - half / duration, 3.0 - rate, rate - 2.0
    return x * (2.0 * c2 + 3.0 * c3 * x) * step / duration, (1.0 - x * x * (c2 + c3 * x)) * step


def _cubic_acceleration_fraction(values: FloatArray, end: float, acceleration: FloatArray) -> float:
    """Largest fraction of the accelerations (J,) that a move of duration 1 s requires.

    The move is from rest to ``end`` times its mean speed. The joints ``values`` (K, J) divide it evenly in
    space.
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
        slope_before: (n, J) slopes of the joints over the path just before each corner, at constant speed in
            space.
        slope_after: (n, J) slopes just after it.
        step: (n + 1,) lengths of the moves.
        fraction: (n,) fraction of the shorter adjacent move over which a corner is rounded on each side.
    """

    slope_before: FloatArray
    slope_after: FloatArray
    step: FloatArray
    fraction: FloatArray

    @staticmethod
    def from_spline(spline: CubicSpline, knots: FloatArray, fraction: FloatArray) -> "PathCorners":
        """Create the corners of a path with targets at the positions ``knots`` (n + 2,).

        The breaks of the spline divide each move evenly in space. There it moves at constant speed, whatever
        the joints do.
        """
        at = np.searchsorted(spline.x, knots)
        parts, step = np.diff(at), np.diff(knots)
        slope = np.diff(spline(spline.x), axis=0) * np.repeat(parts / step, parts)[:, None]
        return PathCorners(slope[at[1:-1] - 1], slope[at[1:-1]], step, fraction)

    def acceleration_fractions(
        self, length: FloatArray, duration: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Fractions (n,) of the acceleration limits that the corners require.

        Each corner is rounded by the cubic that continues the adjacent moves. Moves from and to stops are
        ramps.

        Args:
            length: (n + 1,) lengths of the moves.
            duration: (n + 1,) [s] durations of the moves.
            acceleration: (J,) joint acceleration limits.
        """
        mean = self.step / duration
        half = self.fraction * np.minimum(duration[:-1], duration[1:])
        speed_in, speed_out = mean[:-1].copy(), mean[1:].copy()
        distance_before, distance_after = speed_in * half, speed_out * half
        if len(half):
            starts, stops = ramp_end_ratios(length, duration)
            speed_in[0], distance_before[0] = _ramp_state(half[0], duration[0], self.step[0], starts)
            speed_out[-1], distance_after[-1] = _ramp_state(half[-1], duration[-1], self.step[-1], stops)
        # Hermite cubic over the time T = 2 half with displacement D and end velocities v0, v1. Its largest
        # accelerations are those at its ends: 6 D / T^2 - (4 v0 + 2 v1) / T, (2 v0 + 4 v1) / T - 6 D / T^2.
        displacement = (
            self.slope_before * distance_before[:, None] + self.slope_after * distance_after[:, None]
        )
        first, last = self.slope_before * speed_in[:, None], self.slope_after * speed_out[:, None]
        span = 2.0 * half[:, None]
        begins = 6.0 * displacement / span**2 - (4.0 * first + 2.0 * last) / span
        ends = (2.0 * first + 4.0 * last) / span - 6.0 * displacement / span**2
        return np.asarray((np.maximum(np.abs(begins), np.abs(ends)) / acceleration).max(axis=1))

    def acceleration_coefficients(self) -> tuple[FloatArray, FloatArray]:
        """``slope`` and ``bend`` (n, J) of the joint accelerations slope u + bend x that a corner requires.

        u is the path acceleration and x the squared path speed.
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
    """Limits ``acceleration`` (J,) of ``slope`` u + ``bend`` x, (G, J) each, at the grid points.

    u is the path acceleration and x the squared path speed. Rows of zeros are not limited.
    """

    slope: FloatArray
    bend: FloatArray
    acceleration: FloatArray


def corner_limits_on_grid(
    corners: PathCorners, knots: FloatArray, grid: FloatArray, weaker: FloatArray, acceleration: FloatArray
) -> CornerLimits:
    """Limits of the corners at grid points.

    Each half of a move is limited by the corner next to it. Moves from and to stops are not limited, because
    they are ramps.

    Args:
        corners: n corners.
        knots: (n + 2,) path positions of the targets.
        grid: (G,) grid points.
        weaker: (n,) factor that divides the limits of the corners.
        acceleration: (J,) joint acceleration limits.
    """
    slope, bend = corners.acceleration_coefficients()
    inner = knots[1:-1]
    middle = 0.5 * (inner[1:] + inner[:-1])
    nearest = np.searchsorted(middle, grid)
    is_limited = (grid >= inner[0]) & (grid <= inner[-1])
    scale = np.where(is_limited, weaker[nearest], 0.0)[:, None]
    return CornerLimits(slope[nearest] * scale, bend[nearest] * scale, acceleration)
