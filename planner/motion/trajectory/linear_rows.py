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
"""Fraction of the limit above which differences become constraints. Smaller ones are not constrained."""
MAX_BOUND_RATIO: Final = 1e3
"""Distance of a bound from the current value, in multiples of the largest possible change, above which the
bound is left out.
"""
DAMPING: Final = 1e-7
"""Weight of the step itself, for freedoms that change nothing."""


class LinearConstraints:
    """Linear constraints on steps of freedoms (N, F) and on further unknowns, the levels of peaks.

    They are collected row by row for one sparse matrix.

    Attributes:
        count: Number of rows so far.
    """

    def __init__(self, shape: tuple[int, ...], levels: int = 0) -> None:
        """Start without rows; ``shape`` is (N, F) and ``levels`` the number of levels."""
        self.targets, self.freedoms = shape
        self.levels = levels
        self.count = 0
        self._entries: list[tuple[IndexArray, IndexArray, FloatArray]] = []
        self._bounds: list[tuple[FloatArray, FloatArray]] = []

    def _add_rows(self, at: IndexArray, weight: FloatArray, lower: FloatArray, upper: FloatArray) -> None:
        """Add R rows lower <= sum of weight * step <= upper.

        Args:
            at: (R, K) targets of each row.
            weight: (R, K, F) weights of the steps of these targets.
            lower: (R,) lower bounds.
            upper: (R,) upper bounds.
        """
        row = np.broadcast_to(self.count + np.arange(len(at))[:, None, None], weight.shape)
        column = at[:, :, None] * self.freedoms + np.arange(self.freedoms)
        column = np.broadcast_to(column, weight.shape)
        self._entries.append((row.ravel(), column.ravel(), weight.ravel()))
        self._bounds.append((lower, upper))
        self.count += len(at)

    def add_lower_bounds(self, rows: HingeResiduals, rates: FloatArray, lower: FloatArray) -> None:
        """Require that values with derivatives by the joints change by at least ``lower`` (R,).

        ``rates`` (N, J, F) are the derivatives of the joints by the freedoms.
        """
        weight = np.einsum("rj,rjf->rf", rows.slope, rates[rows.index])
        self._add_rows(rows.index[:, None], weight[:, None], lower, np.full(len(lower), np.inf))

    def add_band(
        self, band: DifferenceBand, joints: FloatArray, rates: FloatArray, bound: FloatArray
    ) -> None:
        """Require that accelerations or jerks of the joints stay within a bound.

        Differences below :data:`ACTIVE_FRACTION` of the bound are not constrained. Where a current value
        exceeds the bound, it must not grow.

        Args:
            band: Accelerations or jerks of the path.
            joints: (N, J) [rad] current joints.
            rates: (N, J, F) derivatives of the joints by the freedoms.
            bound: (J,) bound of each joint.
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
        """Require that accelerations or jerks of all joints stay within a bound that is an unknown itself.

        The bound is goal + level * (top - goal). The program lowers the level. Differences below
        :data:`ACTIVE_FRACTION` of the goal are not constrained.

        Args:
            band: Accelerations or jerks of the path.
            joints: (N, J) [rad] current joints.
            rates: (N, J, F) derivatives of the joints by the freedoms.
            bound: Goal and top, which are the bound at level 0 and at level 1.
            level: Index of the level.
        """
        current, (goal, top) = band.differences(joints), bound
        row, joint = np.nonzero(np.abs(current) > ACTIVE_FRACTION * goal)
        at = band.first[row, None] + np.arange(band.weight.shape[1])
        weight = band.weight[row, :, None] * rates[at, joint[:, None]]
        # only rows in which a freedom moves the joint
        is_movable = np.abs(weight).max(axis=(1, 2), initial=0.0) > 0.0
        at, weight, value = at[is_movable], weight[is_movable], current[row, joint][is_movable]
        infinity = np.full(len(value), np.inf)
        # |value + weight.step| <= goal + level (top - goal), as two rows
        for sign, low, high in ((-1.0, -infinity, goal - value), (1.0, -goal - value, infinity)):
            first_row = self.count
            self._add_rows(at, weight, low, high)
            column = np.full(len(value), self.targets * self.freedoms + level)
            self._entries.append(
                (first_row + np.arange(len(value)), column, np.full(len(value), sign * (top - goal)))
            )

    def add_pairs(self, slopes: FloatArray, lower: FloatArray, upper: FloatArray) -> None:
        """Require that C values of each move change by an amount between ``lower`` and ``upper`` (N - 1, C).

        Bounds are moved to 0 if the current values already violate them, so that no change is always allowed.
        ``slopes`` (2, N - 1, C, F) are the derivatives of the values by the freedoms of the target at the
        start and at the end of each move.
        """
        move, component = (index.ravel() for index in np.indices(lower.shape))
        weight = np.moveaxis(slopes[:, move, component], 0, 1)
        at = move[:, None] + np.arange(2)
        self._add_rows(at, weight, np.minimum(lower, 0.0).ravel(), np.maximum(upper, 0.0).ravel())

    def assemble(self, unit: FloatArray) -> tuple[csc_matrix, FloatArray, FloatArray]:
        """Return the matrix and the lower and upper bounds of all rows.

        Each row is divided by its largest entry, and rows of zeros are left out. The unknowns are the steps
        of the freedoms in units of ``unit`` (F,), followed by the levels. All of them are between -1 and 1. A
        bound that is more than :data:`MAX_BOUND_RATIO` times as far away as a row can reach is dropped.
        Otherwise an interior-point solver would start as far away and would not get close enough.
        """
        row, column, weight = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        free = self.targets * self.freedoms
        weight = weight * np.where(column < free, unit[column % self.freedoms], 1.0)
        lower, upper = (np.concatenate(part) for part in zip(*self._bounds, strict=True))
        size = np.zeros(self.count)
        np.maximum.at(size, row, np.abs(weight))
        max_bound = MAX_BOUND_RATIO * np.bincount(row, np.abs(weight), self.count)
        lower = np.where(lower < -max_bound, -np.inf, lower)
        upper = np.where(upper > max_bound, np.inf, upper)
        is_bounded = np.isfinite(lower) | np.isfinite(upper)
        kept = np.flatnonzero((size > 1e-9 * float(size.max(initial=0.0))) & is_bounded)
        size = np.where(size > 0.0, size, 1.0)
        shape = (self.count, free + self.levels)
        matrix = csc_matrix((weight / size[row], (row, column)), shape=shape)
        return matrix[kept].tocsc(), (lower / size)[kept], (upper / size)[kept]


def add_cost(program: MathematicalProgram, unknowns: Any, blocks: Blocks, slope: FloatArray) -> None:
    """Add the quadratic cost x' H x + 2 g' x to a program, as one term for each target and its successors.

    A term covers up to three consecutive targets. Drake sums the terms before a solver sees them, so they can
    be declared convex: the sum is, even if a single term is not.

    Args:
        program: Program to add to.
        unknowns: (N, F) variables x.
        blocks: Block-banded matrix H.
        slope: (N, F) vector g.
    """
    count, free = slope.shape
    for i in range(count):
        neighbours = unknowns[i : i + 3].ravel()
        # Drake takes 1/2 x' Q x + b' x: Q = 2 (H + DAMPING 1), b = 2 g
        block = np.zeros((len(neighbours), len(neighbours)))
        block[:free, :free] = 2.0 * blocks[0][i] + 2.0 * DAMPING * np.eye(free)
        for d in (1, 2):
            if i + d < count:
                neighbour = slice(d * free, d * free + free)
                block[:free, neighbour] = 2.0 * blocks[d][i]
                block[neighbour, :free] = 2.0 * blocks[d][i].T
        linear = np.zeros(len(neighbours))
        linear[:free] = 2.0 * slope[i]
        program.AddQuadraticCost(block, linear, neighbours, is_convex=True)
