"""Rulings between two guide curves: which point of one curve is joined to which point of the other.

Anchors (corners, ends, a wing's leading edge) are matched. Between them points are joined at equal fractions
of the arc length, at equal fractions of the curves' parameters, or so that the surface has the least twist.

A ruling from a(s) to b(t) is torsal, so that one plane touches the surface all along it, if

    det(a'(s), b'(t), d) = 0,   a', b' tangents, d the ruling's direction.

f(s, t) is the sine of the angle between the tangent planes at both ends of the ruling, which is zero under
the same condition. The path (s, t) from (0, 0) to (1, 1), both ascending, that minimises the integral of f^2
is found by dynamic programming on a grid. Gauss-Newton steps then move it off the grid. A developable surface
has f = 0 everywhere.

Source: do Carmo, Differential Geometry of Curves and Surfaces, 3.5.
"""

from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_banded

from planner.geometry.arrays import FloatArray, RuledSurface
from planner.geometry.curves import (
    RuledGuide,
    anchor_pieces,
    arc_length,
    interpolate_polyline,
    reverse_guide,
    roll_guide,
)

_GRID_INTERVALS: Final = 160
"""Number of intervals per curve of the grid for the first path. `_refine_path` leaves the grid."""
_GRID_MOVES: Final = ((1, 0), (1, 1), (1, 2), (2, 1), (1, 3), (3, 1), (2, 3), (3, 2), (1, 5), (5, 1))
"""Steps of the path on the grid (along the first curve, along the second one): ten directions between the two
axes.
"""
_EVEN_WEIGHT: Final = 1e-5
"""Weight of (s - t)^2 relative to f^2. It decides if every ruling is torsal, as between planar curves."""
_BEND_WEIGHT: Final = 1e-7
"""Weight of squared bends of the path relative to f^2 in the refinement."""


def match_least_twist(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ascending fractions (K,) of the arc lengths of two curves that are joined with the least twist.

    Args:
        a: Points of the first curve (n, 3) [m].
        b: Points of the second curve (n, 3) [m].
    """
    curves = _arc_length_spline(a), _arc_length_spline(b)
    even = np.linspace(0.0, 1.0, _GRID_INTERVALS + 1)
    cost = (
        _ruling_twist(curves, even[:, None], even[None, :]) ** 2
        + _EVEN_WEIGHT * (even[:, None] - even[None, :]) ** 2
    )
    return best_path(cost, lambda s, t: _ruling_twist(curves, s, t)[:, None], _EVEN_WEIGHT, _BEND_WEIGHT)


def best_path(
    cost: FloatArray,
    residual: Callable[[FloatArray, FloatArray], FloatArray],
    even_weight: float,
    bend_weight: float,
) -> tuple[FloatArray, FloatArray]:
    """Return ascending fractions s and t (K,) of two curves, from (0, 0) to (1, 1), with the least cost.

    Args:
        cost: Costs (n, n) on an even grid.
        residual: Returns residuals (K, R) at s and t (K,), whose sum of squares is minimised off the grid.
        even_weight: Weight of (t - s)^2.
        bend_weight: Weight of bends of the path.
    """
    s, t = _cheapest_path(cost)
    middle = np.linspace(0.0, 1.0, 2 * len(cost) - 1)
    skew = _refine_path(residual, middle, np.interp(middle, 0.5 * (s + t), t - s), even_weight, bend_weight)
    return np.maximum.accumulate(middle - 0.5 * skew), np.maximum.accumulate(middle + 0.5 * skew)


def _arc_length_spline(points: FloatArray) -> CubicSpline:
    """Return the curve over its fraction of the arc length, through as many points as its tangents need."""
    fraction = arc_length(points)
    fraction = fraction / fraction[-1]
    if len(points) > 2 * _GRID_INTERVALS:
        even = np.linspace(0.0, 1.0, 2 * _GRID_INTERVALS + 1)
        return CubicSpline(even, interpolate_polyline(points, fraction, even), axis=0)
    if len(points) == 2:
        points, fraction = np.stack([points[0], points.mean(axis=0), points[1]]), np.array([0.0, 0.5, 1.0])
    return CubicSpline(fraction, points, axis=0)


def _ruling_twist(curves: tuple[CubicSpline, CubicSpline], s: FloatArray, t: FloatArray) -> FloatArray:
    """Return f (...,) at fractions s and t, which are broadcast against each other."""
    first, second = curves
    tangent_a, tangent_b = _unit(first(s, 1)), _unit(second(t, 1))
    ruling = _unit(second(t) - first(s))
    sines = np.linalg.norm(np.cross(tangent_a, ruling), axis=-1) * np.linalg.norm(
        np.cross(tangent_b, ruling), axis=-1
    )
    return np.asarray(np.sum(np.cross(tangent_a, tangent_b) * ruling, axis=-1) / np.maximum(sines, 1e-3))


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))


def _cheapest_path(cost: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return fractions (K,) along the cheapest ascending path over the grid (n, n) of costs.

    The path leads from corner to corner.
    """
    n = len(cost)
    min_cost = np.full((n, n), np.inf)
    origins = np.zeros((n, n, 2), dtype=np.int64)
    for i in range(n):
        row, source = np.full(n, np.inf), np.zeros((n, 2), dtype=np.int64)
        if i == 0:
            row[0] = 0.0
        for p, q in _GRID_MOVES:
            if i < p:
                continue
            length = 0.5 * (p + q)
            step_cost = min_cost[i - p, : n - q] + length * (cost[i - p, : n - q] + cost[i, q:])
            better = step_cost < row[q:]
            row[q:] = np.where(better, step_cost, row[q:])
            source[q:][better] = np.stack([np.full(n - q, i - p), np.arange(n - q)], axis=1)[better]
        # moves along the row: minimum over earlier points of cost plus path length
        row_cost = np.concatenate([[0.0], np.cumsum(0.5 * (cost[i, 1:] + cost[i, :-1]))])
        best_lead = np.minimum.accumulate(row - row_cost)
        origin = np.maximum.accumulate(np.where(row - row_cost <= best_lead, np.arange(n), 0))
        # rounding must not make a node its own origin
        is_along_row = (best_lead + row_cost < row) & (origin < np.arange(n))
        min_cost[i] = np.where(is_along_row, best_lead + row_cost, row)
        origins[i] = np.where(is_along_row[:, None], np.stack([np.full(n, i), origin], axis=1), source)
    path = [(n - 1, n - 1)]
    while path[-1] != (0, 0):
        i, j = origins[path[-1]]
        path.append((int(i), int(j)))
    path_points = np.array(path[::-1], dtype=np.float64) / (n - 1)
    return path_points[:, 0], path_points[:, 1]


def _refine_path(
    residual: Callable[[FloatArray, FloatArray], FloatArray],
    middle: FloatArray,
    skew: FloatArray,
    even_weight: float,
    bend_weight: float,
) -> FloatArray:
    """Return the path as t - s (K,) over (s + t) / 2 (K,), optimised for residuals and bends."""
    gap = middle[1] - middle[0]
    bend = np.diff(np.eye(len(middle)), 2, axis=0)
    stiffness = bend_weight / gap**2 * (bend.T @ bend)
    bands = np.zeros((5, len(middle)))
    for k in range(-2, 3):
        bands[2 - k, max(0, k) : len(middle) + min(0, k)] = np.diagonal(stiffness, k)

    def residual_at(w: FloatArray) -> FloatArray:
        return residual(middle - 0.5 * w, middle + 0.5 * w)

    def total_cost(w: FloatArray) -> float:
        return float(np.sum(residual_at(w) ** 2) + even_weight * np.sum(w * w) + w @ (stiffness @ w))

    current, min_cost, damping = skew, total_cost(skew), 1e-6
    for _ in range(40):
        f = residual_at(current)
        slope = (residual_at(current + 1e-6) - residual_at(current - 1e-6)) / 2e-6
        matrix = bands.copy()
        matrix[2] += np.sum(slope * slope, axis=1) + even_weight + damping
        gradient = np.sum(slope * f, axis=1) + even_weight * current + stiffness @ current
        # both ends of the path stay in place
        matrix[1, 1] = matrix[0, 2] = matrix[3, -2] = matrix[4, -3] = 0.0
        matrix[2, [0, -1]], gradient[[0, -1]] = 1.0, 0.0
        trial = _make_ascending(current - solve_banded((2, 2), matrix, gradient), gap)
        cost = total_cost(trial)
        if cost < min_cost:
            done = min_cost - cost <= 1e-12 * min_cost
            current, min_cost, damping = trial, cost, 0.3 * damping
            if done:
                break
        else:
            damping = max(10.0 * damping, 1e-9)
            if damping > 1e3:
                break
    return current


def _make_ascending(skew: FloatArray, gap: float) -> FloatArray:
    """Return the nearest path along which neither s nor t decreases, from (0, 0) to (1, 1)."""
    reach = 2.0 * gap * np.arange(len(skew))
    limit = np.minimum(reach, reach[::-1])
    w = np.clip(skew, -limit, limit)

    def below(v: FloatArray) -> FloatArray:
        """The largest path under v whose slope stays within -2 and 2."""
        forward = np.minimum.accumulate(v - reach) + reach
        return np.asarray((np.minimum.accumulate(forward[::-1] - reach) + reach)[::-1])

    return np.asarray(np.clip(0.5 * (below(w) - below(-w)), -limit, limit))


Match = Literal["arc_length", "parameter", "least_twist"]


def align_guides(start: RuledGuide, end: RuledGuide, match: Match) -> tuple[RuledGuide, RuledGuide, bool]:
    """Return the guides with corresponding anchors in order, and whether ``end`` was reversed.

    Of an open guide's two directions, and a closed guide's directions and first anchors, those with the
    shortest rulings (least squares) are used. Closed guides without anchors start at the points that give
    the shortest rulings. If they are matched by parameter, they keep their first points.

    Args:
        start: First guide.
        end: Second guide, with an equal number of anchors.
        match: How points are matched.

    Raises:
        ValueError: The guides have different numbers of anchors.
    """
    if not start.closed:
        forward, reverse = _mean_square_length(start, end), _mean_square_length(start, reverse_guide(end))
        return (start, reverse_guide(end), True) if reverse < forward else (start, end, False)
    first = np.flatnonzero(start.anchor)
    start = roll_guide(start, int(first[0])) if len(first) else start
    forward, forward_start = _best_start(start, end, match)
    reverse, reverse_start = _best_start(start, reverse_guide(end), match)
    if reverse < forward * (1.0 - 1e-9):
        return start, roll_guide(reverse_guide(end), reverse_start), True
    return start, roll_guide(end, forward_start), False


def _best_start(start: RuledGuide, end: RuledGuide, match: Match) -> tuple[float, int]:
    """Return the first point of the closed guide ``end`` that gives the shortest rulings.

    Returns:
        Mean square [m^2] of the rulings' lengths, and index of the point.
    """
    anchors = np.flatnonzero(end.anchor)
    if len(anchors) == 0:
        if match == "parameter":
            return _mean_square_length(start, end), 0
        # over the arc length, with a resolution of 1/512
        mean_square, shift = _best_shift(_even_points(start, 512)[:, None], _even_points(end, 512)[:, None])
        length = arc_length(np.concatenate([end.points, end.points[:1]]))
        return mean_square, int(np.argmin(np.abs(length[:-1] - shift / 512.0 * length[-1])))
    start_samples, end_samples = (_piece_samples(g) for g in (start, roll_guide(end, int(anchors[0]))))
    if len(start_samples) != len(end_samples):
        raise ValueError(f"guides with {len(start_samples)} and {len(end_samples)} anchors cannot be aligned")
    mean_square, shift = _best_shift(start_samples, end_samples)
    return mean_square, int(anchors[shift])


def _best_shift(first: FloatArray, second: FloatArray) -> tuple[float, int]:
    """Find the cyclic shift of ``second`` (C, S, 3) that is nearest to ``first``, by cross-correlation.

    Returns:
        Mean square distance [m^2], and index in ``second`` that corresponds to index 0 in ``first``.
    """
    spectrum = np.fft.fft(second, axis=0) * np.conj(np.fft.fft(first, axis=0))
    correlation = np.fft.ifft(spectrum, axis=0).real.sum(axis=(1, 2))
    shift = int(np.argmax(correlation))
    mean_square = (np.sum(first * first) + np.sum(second * second) - 2.0 * correlation[shift]) / first[
        ..., 0
    ].size
    return float(mean_square), shift


def _piece_samples(guide: RuledGuide) -> FloatArray:
    """Return points (C, 8, 3) at equal fractions of the arc length of every piece."""
    fractions = np.arange(8) / 8.0
    return np.stack(
        [
            interpolate_polyline(points, _length_fractions(points), fractions)
            for points, _ in anchor_pieces(guide)
        ]
    )


def _even_points(guide: RuledGuide, count: int) -> FloatArray:
    """Return points (``count``, 3) of a closed guide at equal steps of the arc length."""
    points = np.concatenate([guide.points, guide.points[:1]])
    length = arc_length(points)
    return interpolate_polyline(points, length, np.arange(count) / count * length[-1])


def _mean_square_length(start: RuledGuide, end: RuledGuide) -> float:
    """Return the mean square [m^2] of the rulings' lengths at equal fractions of each piece."""
    fractions = np.linspace(0.0, 1.0, 33)
    total = 0.0
    for (a, _), (b, _) in zip(anchor_pieces(start), anchor_pieces(end), strict=True):
        difference = interpolate_polyline(a, _length_fractions(a), fractions) - interpolate_polyline(
            b, _length_fractions(b), fractions
        )
        total += float(np.sum(difference * difference))
    return total / (33 * len(anchor_pieces(start)))


def join_guides(
    name: str, start: RuledGuide, end: RuledGuide, match: Match = "arc_length", hole: bool = False
) -> RuledSurface:
    """Return the ruled surface between two aligned guides, with a ruling at every point of both.

    The outside is where the guides' direction x the rulings' points to.

    Args:
        name: Name of the surface.
        start: First guide.
        end: Second guide.
        match: How points are matched.
        hole: Whether the part is outside of the closed contour.

    Raises:
        ValueError: The guides have different numbers of anchors.
    """
    starts, ends, corner_flags = [], [], []
    corners = start.corner[start.anchor] | end.corner[end.anchor]
    if start.closed and not start.anchor.any():
        corners = np.zeros(1, dtype=np.bool_)
    pieces = list(zip(anchor_pieces(start), anchor_pieces(end), strict=True))
    for number, ((a, at_a), (b, at_b)) in enumerate(pieces):
        s, t = _match_fractions(a, at_a, b, at_b, match)
        ends_open = number == len(pieces) - 1 and not start.closed
        keep = slice(None) if ends_open else slice(-1)
        starts.append(interpolate_polyline(a, _point_fractions(a, at_a, match), s)[keep])
        ends.append(interpolate_polyline(b, _point_fractions(b, at_b, match), t)[keep])
        piece_corner = np.zeros(len(starts[-1]), dtype=np.bool_)
        piece_corner[0] = corners[number]
        corner_flags.append(piece_corner)
    return RuledSurface(
        name, np.concatenate(starts), np.concatenate(ends), np.concatenate(corner_flags), start.closed, hole
    )


def _match_fractions(
    a: FloatArray, at_a: FloatArray, b: FloatArray, at_b: FloatArray, match: Match
) -> tuple[FloatArray, FloatArray]:
    """Return fractions (K,) of both pieces that are joined: those of every point of either piece."""
    fractions_a, fractions_b = _point_fractions(a, at_a, match), _point_fractions(b, at_b, match)
    if match != "least_twist":
        fractions = np.union1d(fractions_a, fractions_b)
        fractions = fractions[np.concatenate([[True], np.diff(fractions) > 1e-9])]
        fractions[-1] = 1.0
        return fractions, fractions
    # straight pieces are joined evenly: other matches have the same twist, or are two flat triangles
    if _is_straight(a) and _is_straight(b):
        return np.array([0.0, 1.0]), np.array([0.0, 1.0])
    s, t = match_least_twist(a, b)
    path = s + t
    path_samples = np.concatenate([path, np.interp(fractions_a, s, path), np.interp(fractions_b, t, path)])
    path_all = np.unique(np.round(path_samples, 9))
    return np.interp(path_all, path, s), np.interp(path_all, path, t)


def _point_fractions(points: FloatArray, parameter: FloatArray, match: Match) -> FloatArray:
    """Return ascending fractions (n,) from 0 to 1 of a piece's points."""
    if match == "parameter":
        return np.asarray((parameter - parameter[0]) / (parameter[-1] - parameter[0]))
    return _length_fractions(points)


def _length_fractions(points: FloatArray) -> FloatArray:
    length = arc_length(points)
    if length[-1] <= 0.0:  # a side that is a point, such as a sharp trailing edge that becomes blunt
        return np.linspace(0.0, 1.0, len(points))
    return np.asarray(length / length[-1])


def _is_straight(points: FloatArray) -> bool:
    chord = points[-1] - points[0]
    length = float(np.linalg.norm(chord))
    distances = np.linalg.norm(np.cross(points - points[0], chord), axis=1)
    return bool((distances <= 1e-9 * length).all()) if length > 0.0 else True
