"""Guide curves of ruled surfaces: dense points with their corners, from polylines and splines."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.curves import CurveKind, curve_points

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

CORNER_ANGLE: Final = float(np.deg2rad(20.0))
"""Where a polyline turns by more than this [rad] it has a corner; by less it stands for a smooth curve."""


@dataclasses.dataclass(frozen=True)
class Guide:
    """A curve as dense points (N, 3) [m]; a ``closed`` one does not repeat its first point.

    ``corner`` (N,): where it has an edge. ``anchor`` (N,): where a guide is matched to its fellow point by
    point; all corners are, and the ends of an open guide. ``parameter`` (N,): ascending in [0, 1], of the
    curve that the points come from; a closed one comes back to its first point at 1.
    """

    points: FloatArray
    corner: BoolArray
    parameter: FloatArray
    closed: bool = False
    anchor: BoolArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        anchor = self.corner.copy() if len(self.anchor) == 0 else self.anchor | self.corner
        if not self.closed:
            anchor[[0, -1]] = True
        object.__setattr__(self, "anchor", anchor)

    @property
    def length(self) -> float:
        """Length [m], the closing step of a closed guide included."""
        return float(np.linalg.norm(np.diff(ring(self), axis=0), axis=1).sum())


def ring(guide: Guide) -> FloatArray:
    """Points (N or N + 1, 3), with the first one again at the end of a closed guide."""
    return np.concatenate([guide.points, guide.points[:1]]) if guide.closed else guide.points


def turns(points: FloatArray, closed: bool) -> FloatArray:
    """Angles (N,) [rad] by which a polyline turns at its points; 0 at the ends of an open one."""
    way = np.diff(np.concatenate([points[-1:], points, points[:1]]), axis=0)
    unit = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
    cross = np.linalg.norm(np.cross(unit[:-1], unit[1:]), axis=1)
    turn = np.arctan2(cross, np.sum(unit[:-1] * unit[1:], axis=1))
    if not closed:
        turn[[0, -1]] = 0.0
    return np.asarray(turn)


def polyline(points: FloatArray, closed: bool = False, angle: float = CORNER_ANGLE) -> Guide:
    """A guide through points (N, 3) with corners where it turns by more than ``angle`` [rad].

    Points that repeat the one before them are left out, as is the last one of a closed guide where it repeats
    the first. Its parameter counts the points.
    """
    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9])
    own = points[keep]
    if closed and len(own) > 1 and np.linalg.norm(own[-1] - own[0]) <= 1e-9:
        own = own[:-1]
    count = len(own)
    parameter = np.arange(count) / max(1, count if closed else count - 1)
    return Guide(own, turns(own, closed) > angle, parameter, closed)


def spline(kind: CurveKind, control: FloatArray, chord: float, closed: bool = False) -> Guide:
    """A guide along a Bezier curve or clamped cubic B-spline with ``control`` points (C, 3), within ``chord``
    [m] of it. A closed one has a corner where its ends meet at an angle.
    """
    t = np.linspace(0.0, 1.0, 257)
    for _ in range(6):
        points = curve_points(kind, control, t)
        middle = curve_points(kind, control, 0.5 * (t[1:] + t[:-1]))
        off = np.linalg.norm(middle - 0.5 * (points[1:] + points[:-1]), axis=1)
        if off.max() <= chord:
            break
        t = np.sort(np.concatenate([t, 0.5 * (t[1:] + t[:-1])[off > chord]]))
    points = curve_points(kind, control, t)
    corner = np.zeros(len(t), dtype=np.bool_)
    if not closed:
        return Guide(points, corner, t)
    corner[0] = turns(points[:-1], True)[0] > CORNER_ANGLE
    return Guide(points[:-1], corner[:-1], t[:-1], closed=True)


def with_corners(guide: Guide, at: FloatArray) -> Guide:
    """The guide with corners at its points nearest to ``at`` (C, 3) and nowhere else."""
    distance = np.linalg.norm(guide.points[:, None] - at[None], axis=2)
    corner = np.zeros(len(guide.points), dtype=np.bool_)
    corner[np.argmin(distance, axis=0)] = True
    if not guide.closed:
        corner[[0, -1]] = False
    return dataclasses.replace(guide, corner=corner, anchor=np.zeros(0, dtype=np.bool_))


def turned(guide: Guide) -> Guide:
    """The guide run the other way round; a closed one keeps its first point."""
    if not guide.closed:
        return dataclasses.replace(
            guide,
            points=guide.points[::-1],
            corner=guide.corner[::-1],
            anchor=guide.anchor[::-1],
            parameter=1.0 - guide.parameter[::-1],
        )
    order = (-np.arange(len(guide.points))) % len(guide.points)
    parameter = (1.0 - guide.parameter[order]) % 1.0
    return dataclasses.replace(
        guide,
        points=guide.points[order],
        corner=guide.corner[order],
        anchor=guide.anchor[order],
        parameter=parameter,
    )


def rolled(guide: Guide, first: int) -> Guide:
    """A closed guide that starts at its point ``first``."""
    if not guide.closed:
        raise ValueError("only a closed guide can start elsewhere")
    order = (np.arange(len(guide.points)) + first) % len(guide.points)
    parameter = (guide.parameter[order] - guide.parameter[first]) % 1.0
    return dataclasses.replace(
        guide,
        points=guide.points[order],
        corner=guide.corner[order],
        anchor=guide.anchor[order],
        parameter=parameter,
    )


def pieces(guide: Guide) -> list[tuple[FloatArray, FloatArray]]:
    """Points (n, 3) and parameters (n,) of every piece from anchor to anchor, in order.

    A closed guide must start at an anchor, or have none: then it is one piece.
    """
    points = ring(guide)
    parameter = np.append(guide.parameter, 1.0) if guide.closed else guide.parameter
    at = np.flatnonzero(guide.anchor)
    if guide.closed:
        at = np.append(at if len(at) else [0], len(points) - 1)
    return [(points[i : j + 1], parameter[i : j + 1]) for i, j in itertools.pairwise(at)]


def arc_length(points: FloatArray) -> FloatArray:
    """Ways (N,) [m] along a polyline (N, 3) from its first point."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def along(points: FloatArray, places: FloatArray, wanted: FloatArray) -> FloatArray:
    """Points (K, 3) of a polyline (N, 3) at ``wanted`` (K,) of its ascending ``places`` (N,)."""
    return np.stack([np.interp(wanted, places, points[:, axis]) for axis in range(points.shape[1])], axis=1)
