"""Samples of many freedoms at once, and what lies between samples of different targets.

A sample has one coordinate for each freedom that is the same at every target: the share of the way between
its bounds, or the angle of one that turns without end. Angles are measured from a zero that does not jump
where the nominal poses of the targets turn about the freedom's own axis, as they do at corners.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import inverse, to_quaternion
from planner.motion.chain import TWO_PI
from planner.motion.few import shifts
from planner.motion.reach import full_turn, slides_only
from planner.targets import ScrewFreedom, Targets

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

RING = 18
"""Samples of a full turn where only full turns are sampled, on a grid."""

SPREAD = (500, 1500, 900)
"""Samples over full and bounded turns, over full turns and long shifts, and over all freedoms."""

KEPT = 0.25
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

    def way(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """The shortest way (..., F) from coordinates to others."""
        change = end - start
        return np.where(self.rings, change - TWO_PI * np.round(change / TWO_PI), change)


def own_turn(targets: Targets, j: int) -> FloatArray:
    """How far (N,) [rad] the nominal poses have turned about the axis of freedom j since the first target."""
    freedom = targets.freedoms[j]
    if not isinstance(freedom, ScrewFreedom):
        return np.zeros(targets.count)
    arm, twist = next(iter(freedom.axis.items()))
    turn = inverse(targets.pose[arm][:-1]) @ targets.pose[arm][1:]
    quaternion = to_quaternion(turn[:, :3, :3])
    length = float(np.linalg.norm(twist[:3]))
    angle = 2.0 * np.arctan2(quaternion[:, 1:] @ twist[:3] / length, quaternion[:, 0])
    return np.append(0.0, np.cumsum(angle - TWO_PI * np.round(angle / TWO_PI))) / length


def levels(targets: Targets, coordinates: Coordinates) -> list[Level]:
    """Full turns alone, then with bounded turns, then with long shifts instead, then everything: few freedoms
    are run and found more easily."""
    freedoms = targets.freedoms
    wide = np.array([float(np.max(f.upper - f.lower)) > 0.0 for f in freedoms], dtype=bool)
    turns = wide & ~np.array([slides_only(f) for f in freedoms], dtype=bool)
    out: list[Level] = []
    active = coordinates.rings
    if active.any():
        count = RING if active.sum() <= 2 else max(4, int(SPREAD[0] ** (1.0 / active.sum())))
        ring = -np.pi + TWO_PI * np.arange(count) / count
        grid = np.array(list(itertools.product(*(ring for _ in range(active.sum())))))
        samples = np.repeat(coordinates.middle[None], len(grid), axis=0)
        samples[:, active] = grid
        out.append(Level(_names(targets, active), samples))
    shifted = (coordinates.rings & wide) | shifts(targets)
    for more, count in ((turns, SPREAD[0]), (shifted, SPREAD[1]), (wide, SPREAD[2])):
        if (more & ~active).any():
            samples = np.repeat(coordinates.middle[None], count, axis=0)
            spread = _spread(count, int(more.sum()))
            samples[:, more] = np.where(coordinates.rings[more], -np.pi + TWO_PI * spread, spread)
            kept = slice(0, int(KEPT * count))
            samples[kept, more & ~active] = coordinates.middle[more & ~active]
            out.append(Level(_names(targets, more), samples))
            active = more
    return out


def _names(targets: Targets, active: NDArray[np.bool_]) -> tuple[str, ...]:
    return tuple(f.name for f, used in zip(targets.freedoms, active, strict=True) if used)


def _spread(count: int, width: int) -> FloatArray:
    """Points (count, width) that fill the unit cube evenly: multiples of powers of the root of
    x^(width + 1) = x + 1 (Roberts 2018)."""
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (width + 1.0))
    steps = root ** -np.arange(1.0, width + 1.0)
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)
