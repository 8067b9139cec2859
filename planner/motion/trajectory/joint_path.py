"""The joint path that linear moves draw, as splines between stops, and what its corners ask for.

A controller gives each move a speed of its own and rounds off the corners, so joint speeds change
within what a corner takes of the moves beside it. Where a zone is small, or a corner sharp, they
change faster there than on the spline that the clock follows.
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
from planner.motion.planning_scene import Scene, holders
from planner.targets import Targets

JOINT_STEP_RAD: Final = np.deg2rad(2.0)
"""A move that turns a joint farther than this [rad] gets samples of its own, since a line in space bends in
the joints."""

MOST_MOVE_SAMPLES: Final = 24
"""Samples of one move at most."""
RIDE_STEP_M: Final = 0.02
"""A move along which a base rides farther than this [m] gets samples of its own, since links pass bodies
then, though no joint may turn;"""
MOST_RIDE_SAMPLES: Final = 400
"""so many at most."""
LEAST_ADVANCE_SHARE: Final = 0.3
"""In cuts the path advances at least by this share of the way in joints and space, for tools that slide along
a wire that hardly moves across itself."""


@dataclasses.dataclass(frozen=True)
class Dense:
    """Samples of the linear moves: ``move`` (K,) the target that each leads to, ``share`` (K,) of the move in
    (0, 1], the first one being target 0 itself; ``q`` {arm: (K, 6)}."""

    move: IndexArray
    share: FloatArray
    q: dict[str, FloatArray]


@dataclasses.dataclass(frozen=True)
class Piece:
    """Path between the stops at targets ``first`` and ``last``; ``knots`` are the path positions of its
    targets."""

    first: int
    last: int
    spline: CubicSpline
    knots: FloatArray


@dataclasses.dataclass(frozen=True)
class JointPath:
    """All pieces, over joints of all arms side by side; ``deviation`` [m] is the greatest distance of a TCP
    on the splines from the straight lines between targets."""

    count: int
    pieces: tuple[Piece, ...]
    deviation: float


def dense(
    scene: Scene,
    targets: Targets,
    branch: Mapping[str, int],
    q: Mapping[str, FloatArray],
    stride: float = JOINT_STEP_RAD,
    least: int = 1,
) -> Dense:
    """Samples of all moves at most ``stride`` [rad] apart in the joints, at least ``least`` a move.

    Joints are NaN where a linear move leaves the branch or reach between its targets. TCPs in frames that
    another arm holds move straight in these.
    """
    turn = np.max([np.abs(np.diff(angles, axis=0)).max(axis=1) for angles in q.values()], axis=0)
    parts = np.clip(np.ceil(turn / stride).astype(np.intp), least, MOST_MOVE_SAMPLES)
    for values in targets.ride.values():
        rides = np.ceil(np.abs(np.diff(values)) / RIDE_STEP_M - 1e-9).astype(np.intp)
        parts = np.maximum(parts, np.minimum(rides, MOST_RIDE_SAMPLES))
    move = np.concatenate([[0], np.repeat(np.arange(1, targets.count), parts)])
    starts = np.concatenate([[0], np.cumsum(parts)])
    share = np.ones(len(move))
    share[1:] = (np.arange(len(move) - 1) - np.repeat(starts[:-1], parts) + 1) / np.repeat(parts, parts)
    inner = np.flatnonzero(share < 1.0)
    out = {arm: angles[move] for arm, angles in q.items()}
    if len(inner):
        ends = {arm: scene.chains[arm].pose(angles) for arm, angles in q.items()}
        start = {arm: pose[move[inner] - 1] for arm, pose in ends.items()}
        end = {arm: pose[move[inner]] for arm, pose in ends.items()}
        between = scene.between(targets, start, end, share[inner])
        for arm, angles in q.items():
            chain = scene.chains[arm]
            near = angles[move[inner] - 1] + share[inner, None] * (
                angles[move[inner]] - angles[move[inner] - 1]
            )
            out[arm][inner] = chain.on_branch(between[arm], branch[arm], near)
    return Dense(move, share, out)


def clear(scene: Scene, targets: Targets, samples: Dense) -> BoolArray:
    """(K,) whether samples of the moves keep clearance; the edge between targets is taken from the nearer
    target."""
    near = np.where(samples.share >= 0.5, samples.move, samples.move - 1)
    return scene.free(targets, samples.q, np.maximum(near, 0), samples.move, share=samples.share)


def joint_path(scene: Scene, targets: Targets, samples: Dense, speed: FloatArray) -> JointPath:
    """Splines through the samples, by the length of the way in the joints (each by its speed limit (J,)) and
    in space; in cuts by the way of the guarded point, so that an even speed of it is one of the spline too.
    Tracks that go along are joints behind all others, in m; they go as evenly as the tool, so the way is not
    theirs.
    """
    joints = np.concatenate([samples.q[arm] for arm in targets.arms], axis=1)
    q = np.concatenate([joints, rides(targets, samples)], axis=1) if targets.ride else joints
    own = {arm: samples.q[arm] for arm in targets.arms}
    poses = scene.chain_poses(targets, own, samples.move, samples.share)
    places = [poses[arm][:, :3, 3] for arm in targets.arms]
    straight = [pose[:, :3, 3] for pose in in_work_frames(targets, poses).values()]
    way = np.linalg.norm(np.diff(joints, axis=0) / speed[: joints.shape[1]], axis=1)
    way += sum(np.linalg.norm(np.diff(p, axis=0), axis=1) for p in places)
    cut = guarded(targets, samples)
    way = np.where(cut > 0.0, np.maximum(cut, LEAST_ADVANCE_SHARE * way), way)
    way = np.concatenate([[0.0], np.cumsum(np.maximum(way, 1e-6))])
    at_target = np.flatnonzero(samples.share == 1.0)
    pieces, worst = [], 0.0
    for first, last in itertools.pairwise(np.flatnonzero(with_ends(targets.stop)).tolist()):
        rows = np.arange(at_target[first], at_target[last] + 1)
        spline = CubicSpline(way[rows], q[rows], bc_type="natural" if len(rows) < 4 else "not-a-knot")
        pieces.append(Piece(first, last, spline, way[at_target[first : last + 1]]))
        worst = max(worst, _deviation(scene, targets, spline, way[rows], [p[rows] for p in straight]))
    return JointPath(targets.count, tuple(pieces), worst)


def with_ends(stop: BoolArray) -> BoolArray:
    """Stops (N,) with the first and the last target, at which everything stands."""
    out = stop.copy()
    out[[0, -1]] = True
    return out


def rides(targets: Targets, samples: Dense) -> FloatArray:
    """Values (K, R) [m] of the R tracks that go along at samples of the moves."""
    before = np.maximum(samples.move - 1, 0)
    values = [v[before] + samples.share * (v[samples.move] - v[before]) for v in targets.ride.values()]
    return np.stack(values, axis=1) if values else np.zeros((len(samples.move), 0))


def guarded(targets: Targets, samples: Dense) -> FloatArray:
    """Way (K - 1,) [m] of the guarded point to each sample but the first, in cuts; 0 elsewhere."""
    before = np.where(samples.move[1:] == samples.move[:-1], samples.share[:-1], 0.0)
    cuts = np.array([segment.kind == "cut" for segment in targets.segment])
    return np.asarray((targets.travel * cuts)[samples.move[1:]] * (samples.share[1:] - before))


def _deviation(
    scene: Scene, targets: Targets, spline: CubicSpline, way: FloatArray, places: list[FloatArray]
) -> float:
    """Greatest distance [m] of TCPs on a spline, half way between samples, from the chords between the
    samples at ``places``, both in the frame in which a TCP moves straight."""
    middle = spline(0.5 * (way[1:] + way[:-1]))
    columns = scene.columns(targets.arms)
    poses = {arm: scene.chains[arm].pose(middle[:, part]) for arm, part in columns.items()}
    for k, arm in enumerate(targets.ride, start=columns[targets.arms[-1]].stop):
        track, station = scene.tracks[arm]
        poses[arm][:, :3, 3] += (middle[:, k, None] - station) * track.axis
    worst = 0.0
    for found, place in zip(in_work_frames(targets, poses).values(), places, strict=True):
        at = found[:, :3, 3] - place[:-1]
        chord = np.diff(place, axis=0)
        along = dots(at, chord) / np.maximum(dots(chord, chord), 1e-18)
        away = at - np.clip(along, 0.0, 1.0)[:, None] * chord
        worst = max(worst, float(np.linalg.norm(away, axis=1).max()))
    return worst


def in_work_frames(targets: Targets, poses: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """TCP poses {arm: (K, 4, 4)} of those in the world: in the world still, or in a frame that is held."""
    held = dict(holders(targets))
    out = {}
    for arm in targets.arms:
        holder = held[arm]
        out[arm] = poses[arm] if holder is None else inverse(poses[holder]) @ poses[arm]
    return out


def tcp_ways(scene: Scene, targets: Targets, samples: Dense) -> dict[str, FloatArray]:
    """How far {arm: (N,)} [m] each TCP would go in the world on the way to each target if it kept its
    greatest speed on that way; between targets a TCP in a held frame speeds up and slows down."""
    parts = np.bincount(samples.move, minlength=targets.count)[samples.move]
    out = {}
    poses = scene.chain_poses(targets, samples.q, samples.move, samples.share)
    for arm in targets.arms:
        place = poses[arm][:, :3, 3]
        step = np.append(0.0, np.linalg.norm(np.diff(place, axis=0), axis=1)) * parts
        out[arm] = np.maximum.reduceat(step, np.flatnonzero(np.diff(samples.move, prepend=-1)))
    return out


MOST_CORNER_SHARE: Final = 0.5
"""Share of a move that a corner takes at most: corners at both its ends meet in the middle."""
LEAST_CORNER_SHARE: Final = 1e-4
"""Least share of a move that a corner counts with."""
MOST_RAMP: Final = 2.0
"""A move from or to a stop ends or begins at most so many times as fast as it is on average."""
RAMP_LEVER_M: Final = 0.3
"""Turning counts as this way [m/rad] where the speed of such a move is matched to its neighbour's."""
RAMP_SAMPLES: Final = 65
"""Moments at which a move from or to a stop is looked at."""


def _at_targets(scene: Scene, targets: Targets, samples: Dense) -> dict[str, FloatArray]:
    """Poses (N, 4, 4) of the TCPs at the targets."""
    rows = np.flatnonzero(samples.share == 1.0)
    own = {arm: samples.q[arm][rows] for arm in targets.arms}
    return scene.chain_poses(targets, own, samples.move[rows])


def corner_shares(
    scene: Scene, targets: Targets, samples: Dense, length: FloatArray, duration: FloatArray, stop: BoolArray
) -> FloatArray:
    """At least which share (N,) of the shorter move beside it the corner at each target is rounded over, for
    moves to the targets whose times are in proportion to ``duration`` (N,), with stops at targets (N,);
    ``length`` (N,) as :func:`ramp_lengths` has it."""
    poses = _at_targets(scene, targets, samples)
    rates = end_rates(length[1:], duration[1:], stop)
    deviation = 1e3 * targets.rounding.deviations(targets.segment[1:])
    zone, own = np.full((2, targets.count), MOST_CORNER_SHARE)
    for arm, pose in in_work_frames(targets, poses).items():
        levers: FloatArray = np.full(3, corner_rounding.TURNING_LEVER_MM)
        if scene.model is not None:
            levers = 1e3 * targets.rounding.turning(arm, scene.model.cell.arm(arm).tool)
        quaternion = to_quaternion(pose[:, :3, :3])
        ride = targets.ride[arm] / MM if arm in targets.ride else None
        found = corner_rounding.shares(
            pose[:, :3, 3] / MM, quaternion, duration[1:], rates, levers, deviation, ride
        )
        zone[1:-1] = np.minimum(zone[1:-1], found[0])
        own[1:-1] = np.minimum(own[1:-1], found[1])
    if scene.model is not None and scene.model.cell.controller.path == "spline":
        zone[1:-1] = 0.0  # blocks have none: the proof rounds their corners as it does where there is no zone
    return np.asarray(np.maximum(np.maximum(zone, own), LEAST_CORNER_SHARE))


def end_rates(length: FloatArray, duration: FloatArray, stop: BoolArray) -> tuple[FloatArray, FloatArray]:
    """How many times as fast as on average M moves of ``length`` and ``duration`` (M,) [s] between stops
    (M + 1,) begin and end; where that is a stop, it is 0."""
    speed = length / np.maximum(duration, 1e-12)
    begin, end = np.ones((2, len(speed)))
    first, last = stop[:-1], stop[1:]
    begin[1:] = np.clip(speed[:-1] / np.maximum(speed[1:], 1e-12), 1.0, MOST_RAMP)
    end[:-1] = np.clip(speed[1:] / np.maximum(speed[:-1], 1e-12), 1.0, MOST_RAMP)
    begin = np.where(first, 0.0, np.where(last, begin, 1.0))
    return begin, np.where(last, 0.0, np.where(first, end, 1.0))


def ramp_lengths(scene: Scene, targets: Targets, samples: Dense) -> FloatArray:
    """Lengths (N,) [m] of the moves to the targets by which a move from or to a stop matches its neighbour's
    speed: ways of the TCPs with their turning, as the proof takes it."""
    out = np.zeros(targets.count)
    for pose in in_work_frames(targets, _at_targets(scene, targets, samples)).values():
        turn = log_rotation(np.swapaxes(pose[:-1, :3, :3], 1, 2) @ pose[1:, :3, :3])
        way = lengths(np.diff(pose[:, :3, 3], axis=0))
        out[1:] = np.hypot(out[1:], np.hypot(way, RAMP_LEVER_M * lengths(turn)))
    return out


def from_stop_to_stop(spline: CubicSpline, acceleration: FloatArray) -> float:
    """Least time [s] of a path that is one move, within the joint accelerations (J,): controllers take such a
    move by a cubic, whose ends ask for more than a clock that brakes as late as it can."""
    return float(np.sqrt(_cubic(spline(spline.x), 0.0, acceleration)))


def ramps(
    spline: CubicSpline, knots: FloatArray, length: FloatArray, duration: FloatArray, acceleration: FloatArray
) -> tuple[float, float]:
    """Shares of the joint accelerations (J,) that the first move from a stop and the last one to a stop ask
    for, if the moves between the positions ``knots``, of ``length`` (n,), last ``duration`` (n,) [s]: each is
    a cubic too, which is as fast at its other end as its neighbour is."""
    at = np.searchsorted(spline.x, knots)
    values = spline(spline.x)
    first, last = values[: at[1] + 1], values[at[-2] :][::-1]
    starts, ends = ends_of_ramps(length, duration)
    begins = _cubic(first, starts, acceleration) / duration[0] ** 2
    return begins, _cubic(last, ends, acceleration) / duration[-1] ** 2


def ramp_peaks(length: FloatArray, duration: FloatArray) -> tuple[float, float]:
    """How many times as fast as on average the first move from a stop and the last one to a stop get, as
    :func:`ramps` has them; the only move of a path 1.5 times."""
    ends = (0.0, 0.0) if len(duration) == 1 else ends_of_ramps(length, duration)
    peaks = []
    for end in ends:
        c2, c3 = 3.0 - end, end - 2.0
        top = -c2 / (3.0 * c3) if c3 < 0.0 else 1.0  # where the cubic is fastest
        peaks.append(c2 * top if top < 1.0 else end)
    return peaks[0], peaks[1]


def ends_of_ramps(length: FloatArray, duration: FloatArray) -> tuple[float, float]:
    """How many times as fast as on average the first and the last one of moves of ``length`` (n,) in
    ``duration`` (n,) [s] are where they meet others."""
    begin, end = end_rates(length, duration, with_ends(np.zeros(len(length) + 1, dtype=bool)))
    return float(end[0]), float(begin[-1])


def _ramp(half: float, duration: float, step: float, rate: float) -> tuple[float, float]:
    """Path speed at ``half`` [s] from the moving end of a ramp, and the way from there to that end: of a move
    over ``step`` that lasts ``duration`` [s] and is ``rate`` times as fast there as on average."""
    x, c2, c3 = 1.0 - half / duration, 3.0 - rate, rate - 2.0
    return x * (2.0 * c2 + 3.0 * c3 * x) * step / duration, (1.0 - x * x * (c2 + c3 * x)) * step


def _cubic(values: FloatArray, end: float, acceleration: FloatArray) -> float:
    """The most that a move over the joints ``values`` (K, J), which part it evenly in space, asks for of the
    accelerations (J,) if it lasts a second: from rest to ``end`` times as fast as it is on average."""
    way = CubicSpline(np.linspace(0.0, 1.0, len(values)), values)
    x = np.linspace(0.0, 1.0, RAMP_SAMPLES)
    c2, c3 = 3.0 - end, end - 2.0
    share, rate, change = x * x * (c2 + c3 * x), x * (2.0 * c2 + 3.0 * c3 * x), 2.0 * c2 + 6.0 * c3 * x
    asked = np.abs(way(share, 1) * change[:, None] + way(share, 2) * rate[:, None] ** 2) / acceleration
    return float(asked.max())


@dataclasses.dataclass(frozen=True)
class Corners:
    """Corners at the inner targets (n,) of a piece: ``before``, ``after`` (n, J) the slopes of the joints
    over the path just before and behind each at an even speed in space, ``step`` (n + 1,) the lengths of the
    moves, ``taken`` (n,) the share of the shorter one of two that their corner is rounded over on each side.
    """

    before: FloatArray
    after: FloatArray
    step: FloatArray
    taken: FloatArray

    @staticmethod
    def of(spline: CubicSpline, knots: FloatArray, taken: FloatArray) -> "Corners":
        """Of a path with targets at the positions ``knots`` (n + 2,), among the breaks of the spline, which
        part each move evenly in space: there it goes at an even speed, whatever the joints do."""
        at = np.searchsorted(spline.x, knots)
        parts, step = np.diff(at), np.diff(knots)
        slope = np.diff(spline(spline.x), axis=0) * np.repeat(parts / step, parts)[:, None]
        return Corners(slope[at[1:-1] - 1], slope[at[1:-1]], step, taken)

    def acceleration_shares(
        self, length: FloatArray, duration: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Shares (n,) of the limits ``acceleration`` (J,) that the corners ask for if the moves, of
        ``length`` (n + 1,), last ``duration`` (n + 1,) [s]: each is rounded by the cubic that goes on from
        the moves beside it, of which those from and to stops are ramps."""
        mean = self.step / duration
        half = self.taken * np.minimum(duration[:-1], duration[1:])
        comes, goes = mean[:-1].copy(), mean[1:].copy()
        behind, ahead = comes * half, goes * half
        if len(half):
            starts, stops = ends_of_ramps(length, duration)
            comes[0], behind[0] = _ramp(half[0], duration[0], self.step[0], starts)
            goes[-1], ahead[-1] = _ramp(half[-1], duration[-1], self.step[-1], stops)
        way = self.before * behind[:, None] + self.after * ahead[:, None]
        first, last = self.before * comes[:, None], self.after * goes[:, None]
        span = 2.0 * half[:, None]
        begins = 6.0 * way / span**2 - (4.0 * first + 2.0 * last) / span
        ends = (2.0 * first + 4.0 * last) / span - 6.0 * way / span**2
        return np.asarray((np.maximum(np.abs(begins), np.abs(ends)) / acceleration).max(axis=1))

    def demand(self) -> tuple[FloatArray, FloatArray]:
        """``slope`` and ``bend`` (n, J): at the path's acceleration u and squared speed x a corner asks for
        the joint accelerations slope u + bend x."""
        shorter = np.minimum(self.step[:-1], self.step[1:])
        window = (2.0 * self.taken * shorter)[:, None]
        middle = 0.5 * (self.step[:-1] + self.step[1:])[:, None]
        return 0.5 * (self.before + self.after) * middle / window, (self.after - self.before) / window


@dataclasses.dataclass(frozen=True)
class CornerLimits:
    """Accelerations within ``acceleration`` (J,) at corners: ``slope`` u + ``bend`` x, (G, J) each at the
    grid points, with the path's acceleration u and squared speed x; rows of zeros ask for nothing."""

    slope: FloatArray
    bend: FloatArray
    acceleration: FloatArray


def on_grid(
    corners: Corners, knots: FloatArray, grid: FloatArray, weaker: FloatArray, acceleration: FloatArray
) -> CornerLimits:
    """What the corners ask for at the grid points (G,): each half of a move by the corner next to it, and
    nothing in moves from and to stops, which are ramps. ``weaker`` (n,) divides the limits of the corners."""
    slope, bend = corners.demand()
    inner = knots[1:-1]
    middle = 0.5 * (inner[1:] + inner[:-1])
    near = np.searchsorted(middle, grid)
    apart = (grid >= inner[0]) & (grid <= inner[-1])
    scale = np.where(apart, weaker[near], 0.0)[:, None]
    return CornerLimits(slope[near] * scale, bend[near] * scale, acceleration)
