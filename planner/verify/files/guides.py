"""Ruled surfaces between two guides, as the problem's words on them say which points are joined.

Corners, and the ends of open guides, are kept together; between them points at equal shares of the way, or of
the parameter, are joined. Of the ways in which two guides may be laid on each other that one counts with the
shortest rulings; where several are as short, each of them.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SAME: Final = 1e-3
"""Ways to lay guides on each other are as short within this share of the rulings' mean square."""
SLACK: Final = 1e-9
LOOKS: Final = 720
"""Places about a smooth closed guide at which it may begin."""


@dataclasses.dataclass(frozen=True)
class Curve:
    """A guide: points (N, 3) [m], the first not repeated where it is ``closed``; ``parameter`` (N,) ascends
    in [0, 1); ``anchor`` (N,) marks corners and what else is kept together. ``either``: nothing says which
    way it runs."""

    points: FloatArray
    parameter: FloatArray
    anchor: BoolArray
    closed: bool
    either: bool = False


@dataclasses.dataclass(frozen=True)
class Ruled:
    """Rulings from ``start`` to ``end`` (M, 3), the first again at the end of a closed surface; away from the
    part is the direction of ``start`` x the rulings."""

    start: FloatArray
    end: FloatArray


def through(points: FloatArray, closed: bool, angle: float, either: bool = False) -> Curve:
    """A polyline with a corner where it turns by more than ``angle`` [rad]."""
    apart = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > SLACK)
    own = points[apart]
    if closed and len(own) > 1 and np.linalg.norm(own[0] - own[-1]) <= SLACK:
        own = own[:-1]
    count = len(own)
    way = np.roll(own, -1, axis=0) - own
    way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
    cosine = np.einsum("ij,ij->i", way, np.roll(way, 1, axis=0))
    corner = np.arccos(np.clip(cosine, -1.0, 1.0)) > angle
    if not closed:
        corner[[0, -1]] = True
    return Curve(own, np.arange(count) / (count if closed else max(count - 1, 1)), corner, closed, either)


def anchored(curve: Curve, at: FloatArray) -> Curve:
    """The curve with corners where it is nearest to ``at`` (C, 3), and nowhere else."""
    anchor = np.zeros(len(curve.points), dtype=np.bool_)
    if len(at):
        anchor[np.linalg.norm(curve.points[:, None] - at[None], axis=2).argmin(axis=0)] = True
    if not curve.closed:
        anchor[[0, -1]] = True
    return dataclasses.replace(curve, anchor=anchor)


def joined(start: Curve, end: Curve, match: str) -> list[Ruled]:
    """The surfaces that the words on two guides allow: one, or more where guides fit as well in several ways.

    Empty where the guides' corners are not as many.
    """
    found: list[tuple[float, Ruled]] = []
    for own in (start, reversed_(start)) if start.either and not start.closed else (start,):
        for other in (end, reversed_(end)):
            found += _laid(own, other, match)
    if not found:
        return []
    best = min(apart for apart, _ in found)
    return [ruled for apart, ruled in found if apart <= best * (1.0 + SAME) + SLACK**2]


def matched(start: Curve, end: Curve, match: str) -> Ruled:
    """The surface between two guides that begin together and run the same way."""
    return _ruled(start, end, match)[1]


def reversed_(curve: Curve) -> Curve:
    """The curve run the other way; a closed one keeps its first point."""
    if not curve.closed:
        parameter = 1.0 - curve.parameter[::-1]
        return dataclasses.replace(
            curve, points=curve.points[::-1], parameter=parameter, anchor=curve.anchor[::-1]
        )
    order = np.append(0, np.arange(len(curve.points) - 1, 0, -1))
    parameter = np.where(order == 0, 0.0, 1.0 - curve.parameter[order])
    return dataclasses.replace(
        curve, points=curve.points[order], parameter=parameter, anchor=curve.anchor[order]
    )


def begun(curve: Curve, first: int) -> Curve:
    """A closed curve begun at its point ``first``."""
    parameter = np.roll(curve.parameter - curve.parameter[first], -first) % 1.0
    return dataclasses.replace(
        curve,
        points=np.roll(curve.points, -first, axis=0),
        parameter=parameter,
        anchor=np.roll(curve.anchor, -first),
    )


def _laid(start: Curve, end: Curve, match: str) -> list[tuple[float, Ruled]]:
    """Surfaces, with the mean square of the rulings' lengths, for a direction of both guides."""
    if int(start.anchor.sum()) != int(end.anchor.sum()):
        return []
    if not start.closed:
        return [_ruled(start, end, match)]
    own = np.flatnonzero(start.anchor)
    if len(own):
        start = begun(start, int(own[0]))
        return [_ruled(start, begun(end, int(i)), match) for i in np.flatnonzero(end.anchor)]
    if match == "parameter":
        return [_ruled(start, end, match)]
    marks = np.arange(LOOKS) / LOOKS
    a, b = _along(start, marks), _along(end, marks)
    apart = np.array([np.mean(np.sum((a - np.roll(b, -k, axis=0)) ** 2, axis=1)) for k in range(LOOKS)])
    k = int(apart.argmin())
    length = _length(np.concatenate([end.points, end.points[:1]]))
    first = int(np.abs(length[:-1] / length[-1] - k / LOOKS).argmin())
    return [_ruled(start, begun(end, first), match)]


def _ruled(start: Curve, end: Curve, match: str) -> tuple[float, Ruled]:
    rows: list[FloatArray] = []
    others: list[FloatArray] = []
    total, weight = 0.0, 0
    for (a, at_a), (b, at_b) in zip(_pieces(start), _pieces(end), strict=True):
        share_a, share_b = (at_a, at_b) if match == "parameter" else (_share(a), _share(b))
        both = np.union1d(share_a, share_b)
        both = both[np.append(True, np.diff(both) > SLACK)]
        both[-1] = 1.0
        even = np.linspace(0.0, 1.0, 33)
        apart = _at(a, _share(a), even) - _at(b, _share(b), even)
        total, weight = total + float(np.sum(apart**2)), weight + len(even)
        rows.append(_at(a, share_a, both)[slice(1 if rows else 0, None)])
        others.append(_at(b, share_b, both)[slice(1 if others else 0, None)])
    return total / max(weight, 1), Ruled(np.concatenate(rows), np.concatenate(others))


def _pieces(curve: Curve) -> list[tuple[FloatArray, FloatArray]]:
    """Points and parameters, from 0 to 1 each, from anchor to anchor."""
    points, parameter = curve.points, curve.parameter
    cut = np.flatnonzero(curve.anchor)
    if curve.closed:
        points, parameter = np.concatenate([points, points[:1]]), np.append(parameter, 1.0)
        cut = np.append(cut if len(cut) else [0], len(points) - 1)
    out = []
    for i, j in itertools.pairwise(cut.tolist()):
        own = parameter[i : j + 1]
        out.append((points[i : j + 1], (own - own[0]) / max(float(own[-1] - own[0]), 1e-300)))
    return out


def _length(points: FloatArray) -> FloatArray:
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _share(points: FloatArray) -> FloatArray:
    length = _length(points)
    return length / length[-1] if length[-1] > 0.0 else np.linspace(0.0, 1.0, len(points))


def _at(points: FloatArray, share: FloatArray, wanted: FloatArray) -> FloatArray:
    return np.stack([np.interp(wanted, share, column) for column in points.T], axis=1)


def _along(curve: Curve, share: FloatArray) -> FloatArray:
    ring = np.concatenate([curve.points, curve.points[:1]])
    return _at(ring, _share(ring), share)
