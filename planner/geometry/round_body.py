"""Bodies of revolution on their way, and bounds below their distance from points for groups of places.

The bound of a group, for a point p: places k have pivots q_k and axes a_k, near to m + t h and u + t g for
some t from -1 to 1, by d and e at most; u is of unit length. Seen along u, the axis at the depth
b = (p - m) u slides along a segment, and p is beside it by r at least. Where the body at k is within sight of
p, no farther than w beside the axis and no farther than l along it, the depth of p there is b to within
f = |(q_k - m) u| + w c + l c c / 2, with c = |a_k - u|, and p is beside that axis by r - f |g| - d - l e at
least.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.vectors import columns, dots

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FIRST: Final = 4
"""Places of a group of the lowest level."""
PARTS: Final = 2
"""Groups of one level in a group of the next one."""
FEW: Final = 12
"""Groups of the highest level at most."""


@dataclasses.dataclass(frozen=True)
class Round:
    """A convex body of revolution from ``start`` to ``end`` [m] along its axis, no wider than ``widest`` [m].

    ``distance``: of points ``back`` from the origin along the axis and ``beside`` it [m], signed, in the
    shape of both; it must change by no more than its arguments do, and not fall with ``beside``. ``plain``:
    it is a cylinder with sharp edges."""

    start: float
    end: float
    widest: float
    distance: Callable[[FloatArray, FloatArray], FloatArray]
    plain: bool = False

    @property
    def middle(self) -> float:
        """How far its pivot is along the axis [m]."""
        return 0.5 * (self.start + self.end)

    @property
    def half(self) -> float:
        """Half of its length [m]."""
        return 0.5 * (self.end - self.start)

    def least(self, depth: FloatArray, beside: FloatArray, within: FloatArray) -> FloatArray:
        """A bound below the distances of points at ``depth`` [m] from the pivot along the axis, to
        ``within`` [m], and ``beside`` it or more: that of the cylinder that holds the body."""
        ends = np.maximum(np.abs(depth) - within, 0.0) - self.half
        aside = beside - self.widest
        out = np.maximum(ends, aside)
        edge = np.nonzero((ends > 0.0) & (aside > 0.0))
        out[edge] = np.hypot(ends[edge], aside[edge])
        return np.asarray(out)


@dataclasses.dataclass(frozen=True)
class Level:
    """G groups of ``size`` consecutive places: rows of ``of`` (14, G) are m, u, the part of h beside u,
    g, f, and what is lost beside the axis, as above."""

    size: int
    of: FloatArray

    @property
    def count(self) -> int:
        """How many groups there are."""
        return len(self.of[0])

    def bound(self, points: FloatArray, group: IntArray, body: Round) -> tuple[FloatArray, FloatArray]:
        """Bounds below the distances (M,) [m] of points (3, M) from the body at all places of a group (M,)
        where it is within sight of them, and the share (M,) from -1 to 1 of the way through the group at
        which it is nearest, about."""
        g = self.of.take(group, axis=1)
        rest = points - g[:3]
        depth = columns(rest, g[3:6])
        way = depth * g[9:12]
        way += g[6:9]
        along, square = columns(rest, way), columns(way, way)
        share = along / np.maximum(square, 1e-300)
        np.clip(share, -1.0, 1.0, out=share)
        # of what is left of rest beside the way: |rest - share way|^2
        square *= share
        square -= 2.0 * along
        square *= share
        square += columns(rest, rest)
        square -= depth * depth
        beside = np.sqrt(np.maximum(square, 0.0))
        beside -= g[13]
        low = body.least(depth, beside, g[12])
        if not body.plain:
            near = body.distance(depth + body.middle, np.maximum(beside, 0.0)) - g[12]
            np.maximum(low, near, out=low)
        return low, share


def ladder(tip: FloatArray, axis: FloatArray, body: Round, sight: float) -> list[Level]:
    """Groups of ``FIRST`` places, of ``PARTS`` times as many and so on, until they are few: of a body at
    places ``tip`` and ``axis`` (N, 3), for points within ``sight`` [m] of it."""
    pivot = tip + body.middle * axis
    wide, far = body.widest + sight, body.half + sight
    out: list[Level] = []
    size = FIRST
    while not out or out[-1].count > FEW:
        count = -(-len(tip) // size)
        rows = np.minimum(np.arange(count * size).reshape(count, size), len(tip) - 1)
        mean = axis[rows[:, 0]] + axis[rows[:, -1]]
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        unit = np.where(length > 1e-3, mean / np.maximum(length, 1e-3), axis[rows[:, 0]])
        middle = 0.5 * (pivot[rows[:, 0]] + pivot[rows[:, -1]])
        half, turn = (0.5 * (of[rows[:, -1]] - of[rows[:, 0]]) for of in (pivot, axis))
        turn -= dots(turn, unit)[:, None] * unit
        off, lean = pivot[rows] - middle[:, None], axis[rows] - unit[:, None]
        chord = np.sqrt(dots(lean, lean).max(axis=1))
        depth = np.abs(np.einsum("gkd,gd->gk", off, unit)).max(axis=1)
        depth += wide * chord + 0.5 * far * chord * chord
        share = np.einsum("gkd,gd->gk", off, half) + far**2 * np.einsum("gkd,gd->gk", lean, turn)
        share /= np.maximum(dots(half, half) + far**2 * dots(turn, turn), 1e-300)[:, None]
        np.clip(share, -1.0, 1.0, out=share)
        off -= share[..., None] * half[:, None]
        lean -= share[..., None] * turn[:, None]
        lost = np.sqrt(dots(off, off).max(axis=1))
        lost += far * np.sqrt(dots(lean, lean).max(axis=1))
        lost += depth * np.linalg.norm(turn, axis=1)
        half -= dots(half, unit)[:, None] * unit
        out.append(Level(size, np.vstack([middle.T, unit.T, half.T, turn.T, depth, lost])))
        size *= PARTS
    return out
