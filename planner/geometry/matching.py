"""Rulings between two guide curves: which point of the one is joined to which of the other.

Anchors (corners, ends, a wing's leading edge) are kept together. Between them points are joined that lie at
equal shares of the arc length, at equal shares of the curves' parameters, or so that the surface is twisted
least (:mod:`planner.geometry.least_twist`).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planner.geometry.guides import Guide, along, arc_length, pieces, rolled, turned
from planner.geometry.least_twist import least_twist
from planner.problem import Ruled

FloatArray = NDArray[np.float64]
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
    best: tuple[float, Guide, bool] | None = None
    for candidate, reverse in ((end, False), (turned(end), True)):
        for at in _first_points(candidate, start, match):
            tried = rolled(candidate, int(at))
            cost = _apart(start, tried)
            if best is None or cost < best[0] * (1.0 - 1e-9):
                best = cost, tried, reverse
    if best is None:
        raise ValueError("a closed guide has no points")
    return start, best[1], best[2]


def _first_points(candidate: Guide, start: Guide, match: Match) -> NDArray[np.int64]:
    if candidate.anchor.any():
        return np.flatnonzero(candidate.anchor)
    if match == "parameter":
        return np.array([0])
    # the point that makes the rulings shortest, from the correlation of both curves over the arc length
    own, other = (_even(g, 512) for g in (start, candidate))
    spectrum = np.fft.fft(other, axis=0) * np.conj(np.fft.fft(own, axis=0))
    shift = int(np.argmax(np.fft.ifft(spectrum, axis=0).real.sum(axis=1)))
    length = arc_length(np.concatenate([candidate.points, candidate.points[:1]]))
    return np.array([np.argmin(np.abs(length[:-1] - shift / 512.0 * length[-1]))])


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
        name,
        np.concatenate(rows_start),
        np.concatenate(rows_end),
        np.concatenate(corner),
        start.closed,
        hole,
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
