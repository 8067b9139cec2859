"""The joint path that linear moves between targets draw, as splines between stops."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from planner.geometry.rigid import inverse
from planner.geometry.vectors import dots
from planner.motion.scene import Scene, holders
from planner.targets import Targets

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

STRIDE: Final = np.deg2rad(2.0)
"""A move that turns a joint farther than this gets samples of its own, since a line in space bends in the
joints."""

MOST_SAMPLES: Final = 24
LEAST_SHARE: Final = 0.3
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
    stride: float = STRIDE,
    least: int = 1,
) -> Dense:
    """Samples of all moves at most ``stride`` [rad] apart in the joints, at least ``least`` a move.

    Joints are NaN where a linear move leaves the branch or reach between its targets. TCPs in frames that
    another arm holds move straight in these.
    """
    turn = np.max([np.abs(np.diff(angles, axis=0)).max(axis=1) for angles in q.values()], axis=0)
    parts = np.clip(np.ceil(turn / stride).astype(np.intp), least, MOST_SAMPLES)
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
            found = chain.inverse(between[arm], [branch[arm]])[:, 0]
            near = angles[move[inner] - 1] + share[inner, None] * (
                angles[move[inner]] - angles[move[inner] - 1]
            )
            out[arm][inner] = chain.continuous(found, near)
    return Dense(move, share, out)


def clear(scene: Scene, targets: Targets, samples: Dense) -> NDArray[np.bool_]:
    """(K,) whether samples of the moves keep clearance; the edge between targets is taken from the nearer
    target."""
    near = np.where(samples.share >= 0.5, samples.move, samples.move - 1)
    return scene.free(targets, samples.q, np.maximum(near, 0), samples.move)


def joint_path(scene: Scene, targets: Targets, samples: Dense, speed: FloatArray) -> JointPath:
    """Splines through the samples, by the length of the way in the joints (each by its speed limit (J,)) and
    in space; in cuts by the way of the guarded point, so that an even speed of it is one of the spline too.
    """
    q = np.concatenate([samples.q[arm] for arm in targets.arms], axis=1)
    poses = {arm: scene.chains[arm].pose(samples.q[arm]) for arm in targets.arms}
    places = [poses[arm][:, :3, 3] for arm in targets.arms]
    straight = [pose[:, :3, 3] for pose in in_work_frames(targets, poses).values()]
    way = np.linalg.norm(np.diff(q, axis=0) / speed, axis=1)
    way += sum(np.linalg.norm(np.diff(p, axis=0), axis=1) for p in places)
    cut = guarded(targets, samples)
    way = np.where(cut > 0.0, np.maximum(cut, LEAST_SHARE * way), way)
    way = np.concatenate([[0.0], np.cumsum(np.maximum(way, 1e-6))])
    at_target = np.flatnonzero(samples.share == 1.0)
    stops = sorted({0, targets.count - 1, *np.flatnonzero(targets.stop).tolist()})
    pieces, worst = [], 0.0
    for first, last in itertools.pairwise(stops):
        rows = np.arange(at_target[first], at_target[last] + 1)
        spline = CubicSpline(way[rows], q[rows], bc_type="natural" if len(rows) < 4 else "not-a-knot")
        pieces.append(Piece(first, last, spline, way[at_target[first : last + 1]]))
        worst = max(worst, _deviation(scene, targets, spline, way[rows], [p[rows] for p in straight]))
    return JointPath(targets.count, tuple(pieces), worst)


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
    poses = {arm: scene.chains[arm].pose(middle[:, 6 * k : 6 * k + 6]) for k, arm in enumerate(targets.arms)}
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
    for arm in targets.arms:
        place = scene.chains[arm].pose(samples.q[arm])[:, :3, 3]
        step = np.append(0.0, np.linalg.norm(np.diff(place, axis=0), axis=1)) * parts
        out[arm] = np.maximum.reduceat(step, np.flatnonzero(np.diff(samples.move, prepend=-1)))
    return out
