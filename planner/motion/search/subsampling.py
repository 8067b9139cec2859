"""Some of the targets and few samples of their freedoms, for searches too large to make in full.

Targets with rows picked, repeated or replaced; a few targets with a few samples, by which places of
the stock are judged; samples of many freedoms at once, and what lies between samples of different
targets.

A sample of many freedoms has one coordinate for each freedom that is the same at every target: the
share of the way between its bounds, or the angle of one that turns without end. Angles are measured
from a zero that does not jump where the nominal poses of the targets turn about the freedom's own
axis, as they do at corners.
"""

import dataclasses
import functools
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, inverse, spread_rows, to_quaternion
from planner.motion.planning_scene import FULL_TURN, holders
from planner.motion.search.reach import full_turn, sample, slides_only
from planner.problem import Cell
from planner.targets import Edge, Freedom, JointFreedom, ScrewFreedom, TableFreedom, Targets


def subset(targets: Targets, rows: IndexArray) -> Targets:
    """The targets ``rows`` (K,), in that order, for looking at; without actions, claims and exhibits."""
    edge = None if targets.edge is None else Edge(targets.edge.points[rows], targets.edge.radius)
    return dataclasses.replace(
        targets,
        pose={arm: pose[rows] for arm, pose in targets.pose.items()},
        freedoms=tuple(pick(f, rows) for f in targets.freedoms),
        feed=targets.feed[rows],
        feed_min=targets.feed_min[rows],
        travel=targets.travel[rows],
        stop=targets.stop[rows],
        segment=tuple(targets.segment[i] for i in rows),
        edge=edge,
        ride={arm: values[rows] for arm, values in targets.ride.items()},
        actions=(),
        claims=(),
        exhibits={},
        issues=(),
    )


def pick(freedom: Freedom, rows: IndexArray) -> Freedom:
    """A freedom at the targets ``rows``."""
    prefer = None if freedom.prefer is None else freedom.prefer[rows]
    if isinstance(freedom, TableFreedom):
        pose = {arm: table[rows] for arm, table in freedom.pose.items()}
        return dataclasses.replace(
            freedom, pose=pose, lower=freedom.lower[rows], upper=freedom.upper[rows], prefer=prefer
        )
    if isinstance(freedom, ScrewFreedom | JointFreedom):
        return dataclasses.replace(
            freedom, lower=freedom.lower[rows], upper=freedom.upper[rows], prefer=prefer
        )
    raise TypeError(f"unknown freedom {type(freedom).__name__}")


FEW_SPIN_STEP: Final = np.deg2rad(30.0)
"""Step [rad] of samples of freedoms that turn, where a few targets are judged."""
MANY_SPIN_STEP: Final = np.deg2rad(15.0)
"""Step [rad] of such samples where they are to be many,"""
MANY_SLIDES: Final = 3
"""with so many of a slide,"""
MOST_MANY: Final = 120
"""as long as each target has no more than this."""
LONG_SHIFT_M: Final = 0.2
"""[m] range of a slide from which on the way that it shifts something counts in the search,"""

SHIFT_SAMPLE_SHARE: Final = 0.75
"""with samples at this share of the way to either end."""

FEW_RING_SAMPLES: Final = 6
"""Samples of each full turn where there are two."""


@dataclasses.dataclass(frozen=True)
class Few:
    """Some targets with samples of their freedoms, one after the other, and the cell with their tools;
    ``every_branch``: whether they are to be looked at on every choice of branches."""

    cell: Cell
    targets: Targets
    index: IndexArray
    poses: dict[str, FloatArray]
    every_branch: bool = False

    @functools.cached_property
    def distinct_poses(self) -> dict[str, tuple[IndexArray, IndexArray]]:
        """{arm: (rows with different poses, which of them each row has)} of arms whose frames and bases
        stand: a holder has few poses."""
        out = {}
        for arm, holder in holders(self.targets):
            if holder is None and arm not in self.targets.ride:
                flat = self.poses[arm].reshape(len(self.index), 16).round(9)
                _, first, back = np.unique(flat, axis=0, return_index=True, return_inverse=True)
                out[arm] = first, back.reshape(-1)
        return out


def few_of(cell: Cell, targets: Targets, count: int, shifted: bool) -> Few:
    """About ``count`` targets of a job, with samples of long shifts as well where ``shifted``."""
    few = subset(targets, spread_rows(targets.count, count))
    values = few_samples(few)
    if shifted:
        values = _shifted(few, values)
    return _sampled(cell, few, values)


def many_of(cell: Cell, targets: Targets, count: int) -> Few:
    """About ``count`` targets of a job with more samples, to be looked at on every branch."""
    few = subset(targets, spread_rows(targets.count, count))
    values = sample(few, MANY_SPIN_STEP, MANY_SLIDES).values
    values = values if values.shape[1] <= MOST_MANY else few_samples(few)
    return dataclasses.replace(_sampled(cell, few, values), every_branch=True)


def _sampled(cell: Cell, few: Targets, values: FloatArray) -> Few:
    index = np.repeat(np.arange(few.count), values.shape[1])
    return Few(cell, few, index, few.poses(values.reshape(len(index), -1), index))


def few_samples(targets: Targets) -> FloatArray:
    """Values (N, S, F): what turns at every 30 degrees, slides in their middle; of many freedoms those
    that turn without end, at every 60 degrees."""
    rings = np.array([full_turn(f) for f in targets.freedoms], dtype=bool)
    if rings.sum() < 2:
        return sample(targets, FEW_SPIN_STEP, slides=1).values
    ring = -np.pi + 2.0 * np.pi * np.arange(FEW_RING_SAMPLES) / FEW_RING_SAMPLES
    grid = np.array(list(itertools.product(ring, repeat=int(rings.sum()))))
    values = np.repeat(targets.neutral()[:, None], len(grid), axis=1)
    values[..., rings] = grid
    return values


def shifts(targets: Targets) -> BoolArray:
    """(F,) which freedoms shift something by more than a little."""
    return np.array(
        [slides_only(f) and float(np.max(f.upper - f.lower)) > LONG_SHIFT_M for f in targets.freedoms],
        dtype=bool,
    )


def _shifted(targets: Targets, values: FloatArray) -> FloatArray:
    """Values (N, S, F) again with each long shift at SHARE of the way to either end."""
    out = [values]
    for j in np.flatnonzero(shifts(targets)):
        freedom = targets.freedoms[j]
        middle, half = 0.5 * (freedom.upper + freedom.lower), 0.5 * (freedom.upper - freedom.lower)
        for sign in (-SHIFT_SAMPLE_SHARE, SHIFT_SAMPLE_SHARE):
            moved = values.copy()
            moved[..., j] = (middle + sign * half)[:, None]
            out.append(moved)
    return np.concatenate(out, axis=1)


RING_SAMPLES = 18
"""Samples of a full turn where only full turns are sampled, on a grid."""

SPREAD_COUNTS = (500, 1500, 900)
"""Samples over full and bounded turns, over full turns and long shifts, and over all freedoms."""

MIDDLE_SHARE = 0.25
"""Share of the samples of a wider spread that leave the freedoms that are new in it in their middle."""


@dataclasses.dataclass(frozen=True)
class Level:
    """Which freedoms are sampled: ``names``, and the coordinates ``samples`` (S, F)."""

    names: tuple[str, ...]
    samples: FloatArray


class Coordinates:
    """Turns coordinates of samples into values of the freedoms and fills in between."""

    def __init__(self, targets: Targets) -> None:
        freedoms = targets.freedoms
        self.rings = np.array([full_turn(f) for f in freedoms], dtype=bool)
        self._lower = np.stack([f.lower for f in freedoms], axis=1)
        self._width = np.stack([f.upper - f.lower for f in freedoms], axis=1)
        self._zero = np.zeros_like(self._lower)
        for j in np.flatnonzero(self.rings):
            self._zero[:, j] = own_turn(targets, int(j))
        neutral = targets.neutral()
        share = (neutral - self._lower) / np.where(self._width > 0.0, self._width, 1.0)
        self.middle = np.where(self.rings, neutral[0] + self._zero[0], np.median(share, axis=0))

    def values(self, coordinates: FloatArray, rows: IndexArray) -> FloatArray:
        """Values (..., F) of coordinates (..., F) at targets ``rows`` (...,)."""
        share = self._lower[rows] + coordinates * self._width[rows]
        return np.where(self.rings, coordinates - self._zero[rows], share)

    def of(self, values: FloatArray) -> FloatArray:
        """Coordinates (N, F) of values (N, F) at all targets."""
        share = (values - self._lower) / np.where(self._width > 0.0, self._width, 1.0)
        return np.where(self.rings, values + self._zero, share)

    def way(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """The shortest way (..., F) from coordinates to others."""
        change = end - start
        return np.where(self.rings, change - FULL_TURN * np.round(change / FULL_TURN), change)


def own_turn(targets: Targets, j: int) -> FloatArray:
    """How far (N,) [rad] the nominal poses have turned about the axis of freedom j since the first target."""
    freedom = targets.freedoms[j]
    if not isinstance(freedom, ScrewFreedom):
        return np.zeros(targets.count)
    arm, twist = next(iter(freedom.axis.items()))
    turn = inverse(targets.pose[arm][:-1]) @ targets.pose[arm][1:]
    return np.append(0.0, np.cumsum(_about(twist, turn)))


def _about(twist: FloatArray, change: FloatArray) -> FloatArray:
    """How far (...,) [rad], up to half a turn, changes of poses (..., 4, 4) turn about a twist's axis."""
    quaternion = to_quaternion(change[..., :3, :3])
    length = float(np.linalg.norm(twist[:3]))
    angle = 2.0 * np.arctan2(quaternion[..., 1:] @ twist[:3] / length, quaternion[..., 0])
    return np.asarray(angle - FULL_TURN * np.round(angle / FULL_TURN)) / length


SAME_TURN: Final = np.deg2rad(3.0)
"""Angles [rad] that differ by no more are sampled once."""


def carried(former: Targets, values: FloatArray, targets: Targets) -> list[FloatArray]:
    """Values (N, F) of the freedoms of ``former`` targets as coordinates of the same freedoms of other ones.

    They stand to the frames of the targets as they did. Where an arm that may turn a frame without end holds
    it, there are others besides: with the frame turned until its first targets stand in the world as they
    did, wherever on it they are.
    """
    stands = Coordinates(former).of(values)
    turned, held = stands.copy(), False
    holds = [(arm, holder) for arm, holder in holders(targets) if holder is not None]
    for j, freedom in enumerate(targets.freedoms):
        if not isinstance(freedom, ScrewFreedom) or not full_turn(freedom):
            continue
        arm, twist = next(iter(freedom.axis.items()))
        before, now = former.pose[arm][0], targets.pose[arm][0]
        stands[:, j] -= _about(twist, inverse(before) @ now)
        if arm not in dict(holds):
            turned[:, j] = stands[:, j]
        for other in (own for own, holder in holds if holder == arm):
            held = True
            turned[:, j] += _about(twist, former.pose[other][0] @ inverse(targets.pose[other][0]))
    return [stands, turned] if held and np.abs(turned - stands).max() > SAME_TURN else [stands]


def levels(targets: Targets, coordinates: Coordinates) -> list[Level]:
    """Full turns alone, then with bounded turns, then with long shifts instead, then everything: few freedoms
    are run and found more easily."""
    freedoms = targets.freedoms
    wide = np.array([float(np.max(f.upper - f.lower)) > 0.0 for f in freedoms], dtype=bool)
    turns = wide & ~np.array([slides_only(f) for f in freedoms], dtype=bool)
    out: list[Level] = []
    active = coordinates.rings
    if active.any():
        count = RING_SAMPLES if active.sum() <= 2 else max(4, int(SPREAD_COUNTS[0] ** (1.0 / active.sum())))
        ring = -np.pi + FULL_TURN * np.arange(count) / count
        grid = np.array(list(itertools.product(*(ring for _ in range(active.sum())))))
        samples = np.repeat(coordinates.middle[None], len(grid), axis=0)
        samples[:, active] = grid
        out.append(Level(_names(targets, active), samples))
    shifted = (coordinates.rings & wide) | shifts(targets)
    for more, count in ((turns, SPREAD_COUNTS[0]), (shifted, SPREAD_COUNTS[1]), (wide, SPREAD_COUNTS[2])):
        if (more & ~active).any():
            samples = np.repeat(coordinates.middle[None], count, axis=0)
            spread = _spread(count, int(more.sum()))
            samples[:, more] = np.where(coordinates.rings[more], -np.pi + FULL_TURN * spread, spread)
            kept = slice(0, int(MIDDLE_SHARE * count))
            samples[kept, more & ~active] = coordinates.middle[more & ~active]
            out.append(Level(_names(targets, more), samples))
            active = more
    return out


def _names(targets: Targets, active: BoolArray) -> tuple[str, ...]:
    return tuple(f.name for f, used in zip(targets.freedoms, active, strict=True) if used)


def _spread(count: int, width: int) -> FloatArray:
    """Points (count, width) that fill the unit cube evenly: multiples of powers of the root of
    x^(width + 1) = x + 1 (Roberts 2018)."""
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (width + 1.0))
    steps = root ** -np.arange(1.0, width + 1.0)
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)
