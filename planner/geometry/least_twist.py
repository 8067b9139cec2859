"""The matching of two curves whose ruled surface is twisted least.

A ruling from a(s) to b(t) is torsal, so that one plane touches the surface all along it, where

    det(a'(s), b'(t), d) = 0,   a', b' tangents, d the ruling's direction

(do Carmo, Differential Geometry of Curves and Surfaces, 3.5); f(s, t) is the sine of the angle between the
tangent planes at both ends of the ruling, which goes with it. The path (s, t) from (0, 0) to (1, 1), both
ascending, that makes the integral of f^2 along it least is found by dynamic programming on a grid and then
moved off the grid by Gauss-Newton steps. A developable surface has f = 0 all along.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_banded

from planner.geometry.guides import along, arc_length

FloatArray = NDArray[np.float64]

_GRID: Final = 160
_MOVES: Final = ((1, 0), (1, 1), (1, 2), (2, 1), (1, 3), (3, 1), (2, 3), (3, 2), (1, 5), (5, 1))
_EVEN: Final = 1e-5
"""Weight of (s - t)^2 beside f^2: it decides where every ruling is torsal, as between curves of a plane."""
_SMOOTH: Final = 1e-7
"""Weight of bends of the path beside f^2 in the last steps."""


def least_twist(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ascending shares (K,) of the arc lengths of two curves (n, 3) that are to be joined."""
    curves = _spline(a), _spline(b)
    even = np.linspace(0.0, 1.0, _GRID + 1)
    cost = _twist(curves, even[:, None], even[None, :]) ** 2 + _EVEN * (even[:, None] - even[None, :]) ** 2
    return best_path(cost, lambda s, t: _twist(curves, s, t)[:, None], _EVEN, _SMOOTH)


def best_path(
    cost: FloatArray, residual: Callable[[FloatArray, FloatArray], FloatArray], even: float, smooth: float
) -> tuple[FloatArray, FloatArray]:
    """Ascending shares s and t (K,) of two curves, from (0, 0) to (1, 1), along which ``cost`` is least.

    ``cost`` (n, n) is on an even grid; ``residual`` gives (K, R) at s and t (K,), whose squares' sum is to be
    least off the grid. ``even`` and ``smooth`` weigh (t - s)^2 and bends of the path beside it.
    """
    s, t = _cheapest(cost)
    middle = np.linspace(0.0, 1.0, 2 * len(cost) - 1)
    skew = _refine(residual, middle, np.interp(middle, 0.5 * (s + t), t - s), even, smooth)
    return np.maximum.accumulate(middle - 0.5 * skew), np.maximum.accumulate(middle + 0.5 * skew)


def _spline(points: FloatArray) -> CubicSpline:
    """The curve over its share of the arc length, through as many of its points as tell its tangents."""
    share = arc_length(points)
    share = share / share[-1]
    if len(points) > 2 * _GRID:
        even = np.linspace(0.0, 1.0, 2 * _GRID + 1)
        return CubicSpline(even, along(points, share, even), axis=0)
    if len(points) == 2:
        points, share = np.stack([points[0], points.mean(axis=0), points[1]]), np.array([0.0, 0.5, 1.0])
    return CubicSpline(share, points, axis=0)


def _twist(curves: tuple[CubicSpline, CubicSpline], s: FloatArray, t: FloatArray) -> FloatArray:
    """f (...,) at shares s and t, which are broadcast against each other."""
    one, two = curves
    tangent_a, tangent_b = _unit(one(s, 1)), _unit(two(t, 1))
    ruling = _unit(two(t) - one(s))
    wide = np.linalg.norm(np.cross(tangent_a, ruling), axis=-1) * np.linalg.norm(
        np.cross(tangent_b, ruling), axis=-1
    )
    return np.asarray(np.sum(np.cross(tangent_a, tangent_b) * ruling, axis=-1) / np.maximum(wide, 1e-3))


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))


def _cheapest(cost: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shares (K,) along the cheapest ascending path over the grid (n, n) of costs, corner to corner."""
    n = len(cost)
    best = np.full((n, n), np.inf)
    came = np.zeros((n, n, 2), dtype=np.int64)
    for i in range(n):
        row, source = np.full(n, np.inf), np.zeros((n, 2), dtype=np.int64)
        if i == 0:
            row[0] = 0.0
        for p, q in _MOVES:
            if i < p:
                continue
            length = 0.5 * (p + q)
            step = best[i - p, : n - q] + length * (cost[i - p, : n - q] + cost[i, q:])
            better = step < row[q:]
            row[q:] = np.where(better, step, row[q:])
            source[q:][better] = np.stack([np.full(n - q, i - p), np.arange(n - q)], axis=1)[better]
        # moves along the row: least of an earlier place's cost plus the way from it
        way = np.concatenate([[0.0], np.cumsum(0.5 * (cost[i, 1:] + cost[i, :-1]))])
        lead = np.minimum.accumulate(row - way)
        origin = np.maximum.accumulate(np.where(row - way <= lead, np.arange(n), 0))
        sideways = (lead + way < row) & (origin < np.arange(n))  # rounding must not lead it to itself
        best[i] = np.where(sideways, lead + way, row)
        came[i] = np.where(sideways[:, None], np.stack([np.full(n, i), origin], axis=1), source)
    path = [(n - 1, n - 1)]
    while path[-1] != (0, 0):
        i, j = came[path[-1]]
        path.append((int(i), int(j)))
    places = np.array(path[::-1], dtype=np.float64) / (n - 1)
    return places[:, 0], places[:, 1]


def _refine(
    residual: Callable[[FloatArray, FloatArray], FloatArray],
    middle: FloatArray,
    skew: FloatArray,
    even: float,
    smooth: float,
) -> FloatArray:
    """The path as t - s (K,) over (s + t) / 2 (K,), moved to where residuals and bends are least."""
    gap = middle[1] - middle[0]
    bend = np.diff(np.eye(len(middle)), 2, axis=0)
    stiff = smooth / gap**2 * (bend.T @ bend)
    bands = np.zeros((5, len(middle)))
    for k in range(-2, 3):
        bands[2 - k, max(0, k) : len(middle) + min(0, k)] = np.diagonal(stiff, k)

    def value(w: FloatArray) -> FloatArray:
        return residual(middle - 0.5 * w, middle + 0.5 * w)

    def total(w: FloatArray) -> float:
        return float(np.sum(value(w) ** 2) + even * np.sum(w * w) + w @ (stiff @ w))

    best, least, damping = skew, total(skew), 1e-6
    for _ in range(40):
        f = value(best)
        slope = (value(best + 1e-6) - value(best - 1e-6)) / 2e-6
        matrix = bands.copy()
        matrix[2] += np.sum(slope * slope, axis=1) + even + damping
        down = np.sum(slope * f, axis=1) + even * best + stiff @ best
        matrix[1, 1] = matrix[0, 2] = matrix[3, -2] = matrix[4, -3] = 0.0
        matrix[2, [0, -1]], down[[0, -1]] = 1.0, 0.0
        tried = _ascending(best - solve_banded((2, 2), matrix, down), gap)
        cost = total(tried)
        if cost < least:
            done = least - cost <= 1e-12 * least
            best, least, damping = tried, cost, 0.3 * damping
            if done:
                break
        else:
            damping = max(10.0 * damping, 1e-9)
            if damping > 1e3:
                break
    return best


def _ascending(skew: FloatArray, gap: float) -> FloatArray:
    """The nearest path along which neither s nor t goes back, from (0, 0) to (1, 1)."""
    reach = 2.0 * gap * np.arange(len(skew))
    limit = np.minimum(reach, reach[::-1])
    w = np.clip(skew, -limit, limit)

    def below(v: FloatArray) -> FloatArray:
        """The largest path under v whose slope stays within -2 and 2."""
        forward = np.minimum.accumulate(v - reach) + reach
        return np.asarray((np.minimum.accumulate(forward[::-1] - reach) + reach)[::-1])

    return np.asarray(np.clip(0.5 * (below(w) - below(-w)), -limit, limit))
