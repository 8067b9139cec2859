"""Triangles as they are seen along z: which of them lie over a place in plan, and where on them it is."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.geometry.closest import closest_on_triangles

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Overhead:
    """Triangles ``corners`` (T, 3, 3) [m] of which each place in plan is asked."""

    def __init__(self, corners: FloatArray) -> None:
        self.plan = corners * np.array([1.0, 1.0, 0.0])
        rings = np.concatenate([corners[:, :, :2], corners[:, :1, :2]], axis=1)
        self._tree = shapely.STRtree(shapely.polygons(rings))

    def at(self, places: FloatArray, within: float) -> tuple[IntArray, IntArray, FloatArray]:
        """Which of ``places`` (N, 2) [m] are over which triangles, or beside them by no more than ``within``
        [m]: rows (M,) ascending, triangles (M,), and the barycentric weights (M, 3) of the nearest place
        there."""
        row, triangle = self._tree.query(shapely.points(places), predicate="dwithin", distance=within)
        order = np.lexsort((triangle, row))
        row, triangle = row[order].astype(np.int64), triangle[order].astype(np.int64)
        points = np.column_stack([places[row], np.zeros(len(row))])
        return row, triangle, closest_on_triangles(points, *np.moveaxis(self.plan[triangle], 1, 0))
