"""Steady directions along a path: the contact hops over facets, and a tool far from it would jerk."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d, uniform_filter1d

from planner.forming.tilt import leaned, turned_at_most
from planner.forming.values import FloatArray
from planner.units import DEG

STEP: Final = 1e-3
"""Spacing [m] at which a path is looked at."""
WIDTH: Final = 4e-3
"""Way [m] over which directions are steadied: a few facets of a usual mesh."""
MOST_ROWS: Final = 2_000_000


def steady_normals(normal: FloatArray, centre: FloatArray, most: float = 2.5 * DEG) -> FloatArray:
    """Unit normals (N, 3) smoothed along the way of ``centre`` (N, 3) [m], turned by ``most`` [rad] at the
    most, so that real corners stay."""
    at, grid = _grid(centre)
    if len(grid) < 3:
        return normal
    even = np.stack([np.interp(grid, at, normal[:, k]) for k in range(3)], axis=1)
    width = WIDTH / _step(grid)
    even = gaussian_filter1d(even, width, axis=0, mode="nearest")
    mean = np.stack([np.interp(at, grid, even[:, k]) for k in range(3)], axis=1)
    # the mean of directions around a curve is less steep than they are, so steepness has a mean of its own
    steep = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
    steep = np.interp(at, grid, gaussian_filter1d(np.interp(grid, at, steep), width, mode="nearest"))
    return turned_at_most(normal, leaned(mean, steep), most)


def steady_below(value: FloatArray, centre: FloatArray) -> FloatArray:
    """The smooth lower envelope (N,) of values along the way of ``centre`` (N, 3) [m]: never above them."""
    at, grid = _grid(centre)
    if len(grid) < 3:
        return value
    # between its neighbours a value counts with the lower one
    row = np.clip(np.searchsorted(at, grid, side="right") - 1, 0, len(at) - 2)
    even = np.minimum(value[row], value[row + 1])
    size = 2 * round(WIDTH / _step(grid)) + 1
    low = minimum_filter1d(even, size, mode="nearest")
    mean = uniform_filter1d(low, size, mode="nearest")
    return np.asarray(np.minimum(np.interp(at, grid, mean), value))


def _step(grid: FloatArray) -> float:
    return float(grid[1] - grid[0])


def _grid(centre: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The way (N,) [m] at the targets, and an even grid over it."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    count = int(min(way[-1] / STEP, MOST_ROWS)) + 1
    return way, np.linspace(0.0, way[-1], count)
