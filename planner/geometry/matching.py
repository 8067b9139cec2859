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
