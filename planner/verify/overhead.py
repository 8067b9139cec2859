"""Triangles as they are seen along z: which of them lie over a place in plan, and where on them it is."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.geometry.closest import closest_on_triangles

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_STEPS = (0.7548776662466927, 0.5698402909980532)
"""Steps of the plastic number's powers, whose multiples fill a square evenly (Roberts 2018)."""


class Overhead:
    """Triangles ``corners`` (T, 3, 3) [m] of which each place in plan is asked."""

    def __init__(self, corners: FloatArray) -> None:
        self.plan = corners * np.array([1.0, 1.0, 0.0])
        rings = np.concatenate([corners[:, :, :2], corners[:, :1, :2]], axis=1)
        self._low = corners[:, :, :2].min(axis=(0, 1), initial=np.inf)
        self._high = corners[:, :, :2].max(axis=(0, 1), initial=-np.inf)
        self._tree = shapely.STRtree(shapely.polygons(rings))

    def at(self, places: FloatArray, within: float) -> tuple[IntArray, IntArray, FloatArray]:
        """Which of ``places`` (N, 2) [m] are over which triangles, or beside them by no more than ``within``
        [m]: rows (M,) ascending, triangles (M,), and the barycentric weights (M, 3) of the nearest place
        there."""
        near = ((places >= self._low - within) & (places <= self._high + within)).all(axis=1)
        some = np.flatnonzero(near)
        points = shapely.points(places[some])
        row, triangle = self._tree.query(points, predicate="dwithin", distance=within)
        row = some[row]
        order = np.lexsort((triangle, row))
        row, triangle = row[order].astype(np.int64), triangle[order].astype(np.int64)
        flat = np.column_stack([places[row], np.zeros(len(row))])
        return row, triangle, closest_on_triangles(flat, *np.moveaxis(self.plan[triangle], 1, 0))


def spread_over(corners: FloatArray, count: int) -> tuple[FloatArray, IntArray]:
    """Places (``count``, 3) spread evenly by area over triangles (T, 3, 3), always the same ones, and the
    triangle (``count``,) of each."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.cumsum(np.linalg.norm(cross, axis=1))
    number = np.arange(count)
    owner = np.minimum(np.searchsorted(area, (number + 0.5) / count * area[-1]), len(area) - 1)
    u, v = np.mod(number * _STEPS[0], 1.0), np.mod(number * _STEPS[1], 1.0)
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    return np.einsum("pk,pkd->pd", np.stack([1.0 - u - v, u, v], axis=1), corners[owner]), owner
