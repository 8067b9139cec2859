"""Clearance of bodies as hinges for the optimiser, asked of Drake only where it may matter."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.cell import clearance
from planner.cell.plant import CellModel
from planner.motion.hinges import Rows

FloatArray = NDArray[np.float64]

SOFT: Final = 0.010
"""Distances [m] up to this above the wanted clearance cost something."""

QUERY: Final = 0.080
"""Distances [m] up to this are asked for, so that it is known how far joints may move before asking again."""


@dataclasses.dataclass(frozen=True)
class _Known:
    """What is known around one configuration: distances (K,) within reach with gradients (K, J)."""

    q: FloatArray
    distance: FloatArray
    gradient: FloatArray

    def least(self, q: FloatArray, lever: float) -> float:
        """A lower bound [m] of the least distance at q: linear, less the most that the curvature can take off."""
        step = q - self.q
        moved = float(np.abs(step).sum())
        beyond = QUERY - lever * moved
        if not len(self.distance):
            return beyond
        linear = self.distance + self.gradient @ step - 0.5 * lever * moved * moved
        return min(beyond, float(linear.min()))


class Avoid:
    """Hinges on all distances below the wanted clearance and a little more, at joints (N, J) of the arms ``arms``."""

    def __init__(self, model: CellModel, arms: tuple[str, ...], wanted: float, weight: float) -> None:
        self._model, self._arms, self._wanted, self.weight = model, arms, wanted, weight
        self._columns = np.concatenate([np.arange(6) + 6 * model.arms.index(arm) for arm in arms])
        self._lever = max(model.robots[arm].reach for arm in arms) + 0.3
        self._known: list[_Known] = []
        self.queries = 0

    def cost(self, q: FloatArray) -> float:
        """Sum of squares of the hinges."""
        return sum(float(np.sum(self._values(k) ** 2)) for _, k in self._near(q))

    def rows(self, q: FloatArray) -> list[Rows]:
        """Hinges at joints q (N, J)."""
        out = []
        for i, known in self._near(q):
            values = self._values(known)
            used = values > 0.0
            if used.any():
                factor = np.sqrt(self.weight) / SOFT
                index = np.full(int(used.sum()), i, dtype=np.intp)
                out.append(Rows(index, values[used], -factor * known.gradient[used]))
        return out

    def _values(self, known: _Known) -> FloatArray:
        near = np.maximum(self._wanted + SOFT - known.distance, 0.0)
        return np.asarray(np.sqrt(self.weight) / SOFT * near)

    def _near(self, q: FloatArray) -> list[tuple[int, _Known]]:
        """Exact knowledge of the rows that may be near something."""
        if len(self._known) != len(q):
            self._known = [self._ask(row) for row in q]
        out = []
        for i, row in enumerate(q):
            known = self._known[i]
            if known.least(row, self._lever) < self._wanted + SOFT:
                if not np.array_equal(known.q, row):
                    known = self._known[i] = self._ask(row)
                out.append((i, known))
        return out

    def _ask(self, row: FloatArray) -> _Known:
        self.queries += 1
        full = self._model.home.copy()
        full[self._columns] = row
        found = clearance.gradients(self._model, full, QUERY)
        distance = np.array([d for d, _, _ in found])
        gradient = np.array([g[self._columns] for _, g, _ in found]).reshape(len(found), len(row))
        return _Known(row.copy(), distance, gradient)
