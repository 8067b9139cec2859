"""Linear constraints and the cost of the optimiser's quadratic programs, in the form that Drake takes."""

from typing import Any, Final

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.sparse import csc_matrix

from planner.geometry.arrays import FloatArray, IndexArray
from planner.motion.trajectory.differences import DifferenceBand
from planner.motion.trajectory.hinge_costs import HingeResiduals
from planner.motion.trajectory.trajopt import Blocks

ACTIVE_FRACTION: Final = 0.5
"""Fraction of the limit above which differences become constraints."""
MAX_BOUND_RATIO: Final = 1e3
"""Distance of a bound, in multiples of the largest possible change, above which it is left out."""
DAMPING: Final = 1e-7
"""Weight of the step itself, for freedoms that change nothing."""


class LinearConstraints:
    """Linear constraints on steps of freedoms (N, F) and on ``levels``.

    They are collected by row for one sparse matrix.
    """

    def __init__(self, shape: tuple[int, ...], levels: int = 0) -> None:
        self.targets, self.freedoms = shape
        self.levels = levels
        self.count = 0
        self._entries: list[tuple[IndexArray, IndexArray, FloatArray]] = []
        self._bounds: list[tuple[FloatArray, FloatArray]] = []

    def _add_rows(self, at: IndexArray, weight: FloatArray, lower: FloatArray, upper: FloatArray) -> None:
        """Add rows of ``weight`` (R, K, F) at targets ``at`` (R, K)."""
        row = np.broadcast_to(self.count + np.arange(len(at))[:, None, None], weight.shape)
        column = at[:, :, None] * self.freedoms + np.arange(self.freedoms)
        column = np.broadcast_to(column, weight.shape)
        self._entries.append((row.ravel(), column.ravel(), weight.ravel()))
        self._bounds.append((lower, upper))
        self.count += len(at)

    def add_lower_bounds(self, rows: HingeResiduals, rates: FloatArray, lower: FloatArray) -> None:
        """Require that values with derivatives by the joints change by at least ``lower`` (R,)."""
        weight = np.einsum("rj,rjf->rf", rows.slope, rates[rows.index])
        self._add_rows(rows.index[:, None], weight[:, None], lower, np.full(len(lower), np.inf))

    def add_band(
        self, band: DifferenceBand, joints: FloatArray, rates: FloatArray, bound: FloatArray
    ) -> None:
        """Require that differences of joints stay within ``bound`` (J,).

        Where their current values are larger, these are the bound.
        """
        current = band.differences(joints)
        row, joint = np.nonzero(np.abs(current) > ACTIVE_FRACTION * bound)
        at = band.first[row, None] + np.arange(band.weight.shape[1])
        weight = band.weight[row, :, None] * rates[at, joint[:, None]]
        value, limit = current[row, joint], bound[joint]
        self._add_rows(at, weight, np.minimum(-limit - value, 0.0), np.maximum(limit - value, 0.0))

    def add_level(
        self,
        band: DifferenceBand,
        joints: FloatArray,
        rates: FloatArray,
        bound: tuple[float, float],
        level: int,
    ) -> None:
        """Require that differences of the joint with the largest ones stay within ``bound``.

        The bound is its first value at level 0 and its second one at level 1.
        """
        current, (goal, top) = band.differences(joints), bound
        row, joint = np.nonzero(np.abs(current) > ACTIVE_FRACTION * goal)
        at = band.first[row, None] + np.arange(band.weight.shape[1])
        weight = band.weight[row, :, None] * rates[at, joint[:, None]]
        is_movable = (
            np.abs(weight).max(axis=(1, 2), initial=0.0) > 0.0
        )  # rows in which a freedom moves the joint
        at, weight, value = at[is_movable], weight[is_movable], current[row, joint][is_movable]
        infinity = np.full(len(value), np.inf)
        # |value + weight.step| <= goal + level (top - goal), as two rows
        for sign, low, high in ((-1.0, -infinity, goal - value), (1.0, -goal - value, infinity)):
            first = self.count
            self._add_rows(at, weight, low, high)
            column = np.full(len(value), self.targets * self.freedoms + level)
            self._entries.append(
                (first + np.arange(len(value)), column, np.full(len(value), sign * (top - goal)))
            )

    def add_pairs(self, slopes: FloatArray, lower: FloatArray, upper: FloatArray) -> None:
        """Require that a change stays within ``lower`` and ``upper`` (N - 1, C).

        ``slopes`` (2, N - 1, C, F) are its derivatives by the freedoms of the targets at both ends of each
        move.
        """
        move, part = (index.ravel() for index in np.indices(lower.shape))
        weight = np.moveaxis(slopes[:, move, part], 0, 1)
        at = move[:, None] + np.arange(2)
        self._add_rows(at, weight, np.minimum(lower, 0.0).ravel(), np.maximum(upper, 0.0).ravel())

    def assemble(self, unit: FloatArray) -> tuple[csc_matrix, FloatArray, FloatArray]:
        """Return the matrix and both bounds, each row divided by its largest entry, without rows of zeros.

        Freedoms are in units of ``unit`` (F,); the levels follow them. Unknowns are within 1 of zero. A bound
        that is :data:`MAX_BOUND_RATIO` times as far away as these reach is dropped, because an interior-point
        solver would start as far away and would not get close enough.
        """
        row, column, weight = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        free = self.targets * self.freedoms
        weight = weight * np.where(column < free, unit[column % self.freedoms], 1.0)
        lower, upper = (np.concatenate(part) for part in zip(*self._bounds, strict=True))
        size = np.zeros(self.count)
        np.maximum.at(size, row, np.abs(weight))
        reach = MAX_BOUND_RATIO * np.bincount(row, np.abs(weight), self.count)
        lower, upper = np.where(lower < -reach, -np.inf, lower), np.where(upper > reach, np.inf, upper)
        bound = np.isfinite(lower) | np.isfinite(upper)
        kept = np.flatnonzero((size > 1e-9 * float(size.max(initial=0.0))) & bound)
        size = np.where(size > 0.0, size, 1.0)
        shape = (self.count, free + self.levels)
        matrix = csc_matrix((weight / size[row], (row, column)), shape=shape)
        return matrix[kept].tocsc(), (lower / size)[kept], (upper / size)[kept]


def add_cost(program: MathematicalProgram, unknowns: Any, blocks: Blocks, slope: FloatArray) -> None:
    """Add the cost in terms of three neighbouring targets each.

    Drake sums the terms before a solver sees them. The sum is convex even if a single term is not.
    """
    count, free = slope.shape
    for i in range(count):
        neighbours = unknowns[i : i + 3].ravel()
        # Drake takes 1/2 x' Q x + b' x: Q = 2 (H + DAMPING 1), b = 2 g
        block = np.zeros((len(neighbours), len(neighbours)))
        block[:free, :free] = 2.0 * blocks[0][i] + 2.0 * DAMPING * np.eye(free)
        for d in (1, 2):
            if i + d < count:
                other = slice(d * free, d * free + free)
                block[:free, other] = 2.0 * blocks[d][i]
                block[other, :free] = 2.0 * blocks[d][i].T
        linear = np.zeros(len(neighbours))
        linear[:free] = 2.0 * slope[i]
        program.AddQuadraticCost(block, linear, neighbours, is_convex=True)
