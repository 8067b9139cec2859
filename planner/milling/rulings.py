"""The rulings of a surface as a flank cutter passes them: tip guide and top guide in the order of the cut,
with tangents and outward normals, one smooth piece at a time."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rulings import resample, runs
from planner.problem import Ruled

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Strip:
    """A smooth piece: ruling i from ``low[i]``, at the tip, to ``high[i]`` (M, 3) [m].

    ``out`` is +1 where the outward normal is tangent x (high - low), else -1. A ``ring`` is a whole closed
    surface without corners: its last ruling is its first one again.
    """

    low: FloatArray
    high: FloatArray
    out: float
    ring: bool = False

    def tangents(self) -> tuple[FloatArray, FloatArray]:
        """Unit tangents (M, 3) of both guides; where one stands still, that of the other."""
        low, high = (np.gradient(side, axis=0) for side in (self.low, self.high))
        sizes = [np.linalg.norm(t, axis=1, keepdims=True) for t in (low, high)]
        still = 1e-3 * np.maximum(*sizes)
        low, high = np.where(sizes[0] > still, low, high), np.where(sizes[1] > still, high, low)
        return _unit(low), _unit(high)

    def normals(self) -> tuple[FloatArray, FloatArray]:
        """Outward unit normals (M, 3) of the surface at both guides."""
        along = self.high - self.low
        first, second = self.tangents()
        return _unit(self.out * np.cross(first, along)), _unit(self.out * np.cross(second, along))

    def reversed(self) -> Strip:
        """The same piece the other way."""
        return Strip(self.low[::-1], self.high[::-1], -self.out, self.ring)


def strips(ruled: Ruled, tip_at_start: bool, chord: float, step: float) -> list[Strip]:
    """The smooth pieces of a ruled surface along its guides, rulings at most ``step`` [m] apart."""
    fine = resample(ruled, chord, step)
    ring = fine.closed and not fine.corner.any()
    out = []
    for rows in runs(fine):
        start, end = fine.start[rows], fine.end[rows]
        out.append(Strip(start, end, 1.0, ring) if tip_at_start else Strip(end, start, -1.0, ring))
    return out


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-15))
