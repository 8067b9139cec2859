"""Linear constraints and the cost of the optimiser's quadratic programs, as Drake takes them."""

from typing import Any, Final

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.sparse import csc_matrix

from planner.geometry.arrays import FloatArray, IndexArray
from planner.motion.trajectory.differences import Band
from planner.motion.trajectory.hinges import Rows
from planner.motion.trajectory.trajopt import Blocks

ACTIVE_SHARE: Final = 0.5
"""Differences above this share of what is allowed are constraints."""
NEVER: Final = 1e3
"""A bound so many times as far away as a step can reach is left out."""
DAMPING: Final = 1e-7
"""Weight of the step itself, for freedoms that change nothing."""


class Linear:
    """Linear constraints on steps of freedoms (N, F) and on the values of some ``levels``, collected row by
    row for one sparse matrix."""

    def __init__(self, shape: tuple[int, ...], levels: int = 0) -> None:
        self.targets, self.freedoms = shape
        self.levels = levels
        self.count = 0
        self._parts: list[tuple[IndexArray, IndexArray, FloatArray]] = []
        self._bounds: list[tuple[FloatArray, FloatArray]] = []

    def _add(self, at: IndexArray, weight: FloatArray, lower: FloatArray, upper: FloatArray) -> None:
        """Rows of ``weight`` (R, K, F) at targets ``at`` (R, K)."""
        row = np.broadcast_to(self.count + np.arange(len(at))[:, None, None], weight.shape)
        column = at[:, :, None] * self.freedoms + np.arange(self.freedoms)
        column = np.broadcast_to(column, weight.shape)
        self._parts.append((row.ravel(), column.ravel(), weight.ravel()))
        self._bounds.append((lower, upper))
        self.count += len(at)

    def add_slopes(self, rows: Rows, rates: FloatArray, lower: FloatArray) -> None:
        """What has slopes by the joints changes by ``lower`` (R,) at least."""
        weight = np.einsum("rj,rjf->rf", rows.slope, rates[rows.index])
        self._add(rows.index[:, None], weight[:, None], lower, np.full(len(lower), np.inf))

    def add_band(self, band: Band, joints: FloatArray, rates: FloatArray, most: FloatArray) -> None:
        """Differences of joints stay within ``most`` (J,), or where they are if that is more."""
        now = band.of(joints)
        row, joint = np.nonzero(np.abs(now) > ACTIVE_SHARE * most)
        at = band.first[row, None] + np.arange(band.weight.shape[1])
        weight = band.weight[row, :, None] * rates[at, joint[:, None]]
        value, limit = now[row, joint], most[joint]
        self._add(at, weight, np.minimum(-limit - value, 0.0), np.maximum(limit - value, 0.0))

    def add_level(
        self, band: Band, joints: FloatArray, rates: FloatArray, bound: tuple[float, float], level: int
    ) -> None:
        """Differences of the hardest joint stay within ``bound``: its first value where the level is 0, its
        second one where it is 1."""
        now, (goal, top) = band.of(joints), bound
        row, joint = np.nonzero(np.abs(now) > ACTIVE_SHARE * goal)
        at = band.first[row, None] + np.arange(band.weight.shape[1])
        weight = band.weight[row, :, None] * rates[at, joint[:, None]]
        loose = np.abs(weight).max(axis=(1, 2), initial=0.0) > 0.0  # where a freedom moves the joint
        at, weight, value = at[loose], weight[loose], now[row, joint][loose]
        endless = np.full(len(value), np.inf)
        for sign, low, high in ((-1.0, -endless, goal - value), (1.0, -goal - value, endless)):
            first = self.count
            self._add(at, weight, low, high)
            column = np.full(len(value), self.targets * self.freedoms + level)
            self._parts.append(
                (first + np.arange(len(value)), column, np.full(len(value), sign * (top - goal)))
            )

    def add_pairs(self, slopes: FloatArray, lower: FloatArray, upper: FloatArray) -> None:
        """What changes by ``slopes`` (2, N - 1, C, F) of the targets at both ends of moves stays within
        ``lower`` and ``upper`` (N - 1, C)."""
        move, part = (index.ravel() for index in np.indices(lower.shape))
        weight = np.moveaxis(slopes[:, move, part], 0, 1)
        at = move[:, None] + np.arange(2)
        self._add(at, weight, np.minimum(lower, 0.0).ravel(), np.maximum(upper, 0.0).ravel())

    def stacked(self, unit: FloatArray) -> tuple[csc_matrix, FloatArray, FloatArray]:
        """The matrix for freedoms in units of ``unit`` (F,), then the levels, and both bounds, each row
        divided by its largest entry; rows of zeros are left out. Unknowns are within 1 of zero, so that a
        bound :data:`NEVER` times as far as these reach is none: a solver that works from inside of all bounds
        would begin as far away, and would not get near enough."""
        row, column, weight = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        free = self.targets * self.freedoms
        weight = weight * np.where(column < free, unit[column % self.freedoms], 1.0)
        lower, upper = (np.concatenate(part) for part in zip(*self._bounds, strict=True))
        size = np.zeros(self.count)
        np.maximum.at(size, row, np.abs(weight))
        reach = NEVER * np.bincount(row, np.abs(weight), self.count)
        lower, upper = np.where(lower < -reach, -np.inf, lower), np.where(upper > reach, np.inf, upper)
        bound = np.isfinite(lower) | np.isfinite(upper)
        kept = np.flatnonzero((size > 1e-9 * float(size.max(initial=0.0))) & bound)
        size = np.where(size > 0.0, size, 1.0)
        shape = (self.count, free + self.levels)
        matrix = csc_matrix((weight / size[row], (row, column)), shape=shape)
        return matrix[kept].tocsc(), (lower / size)[kept], (upper / size)[kept]


def add_cost(program: MathematicalProgram, unknowns: Any, blocks: Blocks, slope: FloatArray) -> None:
    """The cost by terms of three neighbouring targets each. Drake adds them up before a solver sees them: the
    sum is convex, whatever one term is."""
    count, free = slope.shape
    for i in range(count):
        near = unknowns[i : i + 3].ravel()
        part = np.zeros((len(near), len(near)))
        part[:free, :free] = 2.0 * blocks[0][i] + 2.0 * DAMPING * np.eye(free)
        for d in (1, 2):
            if i + d < count:
                other = slice(d * free, d * free + free)
                part[:free, other] = 2.0 * blocks[d][i]
                part[other, :free] = 2.0 * blocks[d][i].T
        linear = np.zeros(len(near))
        linear[:free] = 2.0 * slope[i]
        program.AddQuadraticCost(part, linear, near, is_convex=True)
