"""Rulings between two guide curves: which point of the one is joined to which of the other.

Anchors (corners, ends, a wing's leading edge) are kept together. Between them points are joined
that lie at equal shares of the arc length, at equal shares of the curves' parameters, or so that
the surface is twisted least.

A ruling from a(s) to b(t) is torsal, so that one plane touches the surface all along it, where

    det(a'(s), b'(t), d) = 0,   a', b' tangents, d the ruling's direction

(do Carmo, Differential Geometry of Curves and Surfaces, 3.5); f(s, t) is the sine of the angle
between the tangent planes at both ends of the ruling, which goes with it. The path (s, t) from (0,
0) to (1, 1), both ascending, that makes the integral of f^2 along it least is found by dynamic
programming on a grid and then moved off the grid by Gauss-Newton steps. A developable surface has f
= 0 all along.
"""

from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_banded

from planner.geometry.arrays import FloatArray, Ruled
from planner.geometry.curves import Guide, along, arc_length, pieces, rolled, turned

_GRID: Final = 160
"""Intervals per curve of the grid on which the first path is looked for; `_refine` leaves the grid."""
_GRID_MOVES: Final = ((1, 0), (1, 1), (1, 2), (2, 1), (1, 3), (3, 1), (2, 3), (3, 2), (1, 5), (5, 1))
"""Steps of the path on the grid (along the first curve, along the second one): ten directions between the two
axes."""
_EVEN_WEIGHT: Final = 1e-5
"""Weight of (s - t)^2 beside f^2: it decides where every ruling is torsal, as between curves of a plane."""
_BEND_WEIGHT: Final = 1e-7
"""Weight of squared bends of the path beside f^2 when it is refined."""


def least_twist(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ascending shares (K,) of the arc lengths of two curves (n, 3) that are to be joined."""
    curves = _spline(a), _spline(b)
    even = np.linspace(0.0, 1.0, _GRID + 1)
    cost = (
        _twist(curves, even[:, None], even[None, :]) ** 2
        + _EVEN_WEIGHT * (even[:, None] - even[None, :]) ** 2
    )
    return best_path(cost, lambda s, t: _twist(curves, s, t)[:, None], _EVEN_WEIGHT, _BEND_WEIGHT)


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
        for p, q in _GRID_MOVES:
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


Match = Literal["arc_length", "parameter", "least_twist"]


def aligned(start: Guide, end: Guide, match: Match) -> tuple[Guide, Guide, bool]:
    """The guides so that their anchors correspond in order, and whether ``end`` had to be run the other way.

    Of an open guide's two directions and a closed guide's directions and first anchors those are taken that
    make the rulings shortest (least squares). Closed guides without anchors start at the points that do so,
    or, matched by parameter, where they are given to start. Numbers of anchors must be equal.
    """
    if not start.closed:
        ahead, back = _apart(start, end), _apart(start, turned(end))
        return (start, turned(end), True) if back < ahead else (start, end, False)
    first = np.flatnonzero(start.anchor)
    start = rolled(start, int(first[0])) if len(first) else start
    ahead, at_ahead = _nearest_start(start, end, match)
    back, at_back = _nearest_start(start, turned(end), match)
    if back < ahead * (1.0 - 1e-9):
        return start, rolled(turned(end), at_back), True
    return start, rolled(end, at_ahead), False


def _nearest_start(start: Guide, end: Guide, match: Match) -> tuple[float, int]:
    """The point at which a closed guide is to start, and the mean square [m^2] of the rulings' lengths
    then.
    """
    anchors = np.flatnonzero(end.anchor)
    if len(anchors) == 0:
        if match == "parameter":
            return _apart(start, end), 0
        # over the arc length, to a 512th of it
        apart, shift = _correlated(_even(start, 512)[:, None], _even(end, 512)[:, None])
        length = arc_length(np.concatenate([end.points, end.points[:1]]))
        return apart, int(np.argmin(np.abs(length[:-1] - shift / 512.0 * length[-1])))
    own, other = (_samples(g) for g in (start, rolled(end, int(anchors[0]))))
    if len(own) != len(other):
        raise ValueError(f"guides with {len(own)} and {len(other)} anchors cannot be aligned")
    apart, shift = _correlated(own, other)
    return apart, int(anchors[shift])


def _correlated(own: FloatArray, other: FloatArray) -> tuple[float, int]:
    """The cyclic shift of ``other`` (C, S, 3) that is nearest to ``own``, and the mean square distance
    then.
    """
    spectrum = np.fft.fft(other, axis=0) * np.conj(np.fft.fft(own, axis=0))
    together = np.fft.ifft(spectrum, axis=0).real.sum(axis=(1, 2))
    shift = int(np.argmax(together))
    apart = (np.sum(own * own) + np.sum(other * other) - 2.0 * together[shift]) / own[..., 0].size
    return float(apart), shift


def _samples(guide: Guide) -> FloatArray:
    """Points (C, 8, 3) at equal shares of the arc length of every piece."""
    share = np.arange(8) / 8.0
    return np.stack([along(own, _share(own), share) for own, _ in pieces(guide)])


def _even(guide: Guide, count: int) -> FloatArray:
    points = np.concatenate([guide.points, guide.points[:1]])
    length = arc_length(points)
    return along(points, length, np.arange(count) / count * length[-1])


def _apart(start: Guide, end: Guide) -> float:
    """Mean square [m^2] of the rulings' lengths, piece by piece at equal shares of the arc length."""
    share = np.linspace(0.0, 1.0, 33)
    total = 0.0
    for (a, _), (b, _) in zip(pieces(start), pieces(end), strict=True):
        difference = along(a, _share(a), share) - along(b, _share(b), share)
        total += float(np.sum(difference * difference))
    return total / (33 * len(pieces(start)))


def join(name: str, start: Guide, end: Guide, match: Match = "arc_length", hole: bool = False) -> Ruled:
    """The ruled surface between two aligned guides; a ruling stands at every point of both.

    Outside is where the guides' direction x the rulings' points to. Raises ``ValueError`` where the guides
    have different numbers of anchors.
    """
    rows_start, rows_end, corner = [], [], []
    corners = start.corner[start.anchor] | end.corner[end.anchor]
    if start.closed and not start.anchor.any():
        corners = np.zeros(1, dtype=np.bool_)
    parts = list(zip(pieces(start), pieces(end), strict=True))
    for number, ((a, at_a), (b, at_b)) in enumerate(parts):
        s, t = _places(a, at_a, b, at_b, match)
        last = number == len(parts) - 1 and not start.closed
        keep = slice(None) if last else slice(-1)
        rows_start.append(along(a, _own(a, at_a, match), s)[keep])
        rows_end.append(along(b, _own(b, at_b, match), t)[keep])
        own = np.zeros(len(rows_start[-1]), dtype=np.bool_)
        own[0] = corners[number]
        corner.append(own)
    return Ruled(
        name, np.concatenate(rows_start), np.concatenate(rows_end), np.concatenate(corner), start.closed, hole
    )


def _places(
    a: FloatArray, at_a: FloatArray, b: FloatArray, at_b: FloatArray, match: Match
) -> tuple[FloatArray, FloatArray]:
    """Shares (K,) of both pieces that are joined: those of every point of either piece."""
    own_a, own_b = _own(a, at_a, match), _own(b, at_b, match)
    if match != "least_twist":
        both = np.union1d(own_a, own_b)
        both = both[np.concatenate([[True], np.diff(both) > 1e-9])]
        both[-1] = 1.0
        return both, both
    if _straight(a) and _straight(b):  # then evenly, as twisted as any but for two flat triangles
        return np.array([0.0, 1.0]), np.array([0.0, 1.0])
    s, t = least_twist(a, b)
    path = s + t
    more = np.concatenate([path, np.interp(own_a, s, path), np.interp(own_b, t, path)])
    path_all = np.unique(np.round(more, 9))
    return np.interp(path_all, path, s), np.interp(path_all, path, t)


def _own(points: FloatArray, parameter: FloatArray, match: Match) -> FloatArray:
    """Ascending shares (n,) from 0 to 1 of a piece's points."""
    if match == "parameter":
        return np.asarray((parameter - parameter[0]) / (parameter[-1] - parameter[0]))
    return _share(points)


def _share(points: FloatArray) -> FloatArray:
    length = arc_length(points)
    if length[-1] <= 0.0:  # a side that is a point, as a sharp trailing edge that becomes blunt
        return np.linspace(0.0, 1.0, len(points))
    return np.asarray(length / length[-1])


def _straight(points: FloatArray) -> bool:
    way = points[-1] - points[0]
    length = float(np.linalg.norm(way))
    off = np.linalg.norm(np.cross(points - points[0], way), axis=1)
    return bool((off <= 1e-9 * length).all()) if length > 0.0 else True
