"""Arcs of G-code in the three planes, by centre or by radius, as points within a chord error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Point = Sequence[float]

RADIUS_TOL: Final = 2e-5
RADIUS_SHARE: Final = 1e-3
"""How far the radii at both ends of an arc may differ: absolute [m], or as a share of the radius. Files are
rounded to 1 um or 0.0001 inch; a wrong centre is off by far more."""
SAME: Final = 1e-9
WIDEST: Final = math.radians(30.0)


class ArcError(ValueError):
    """An arc that is none; the message says why and what to do."""


def centre_of(start: Point, end: Point, radius: float, normal: int, clockwise: bool) -> tuple[float, float]:
    """Centre [m] in the plane across axis ``normal`` of the arc of ``radius`` [m]: at most half a turn above
    zero, at least half a turn below.

    Raises :class:`ArcError` where the ends are farther apart than the diameter, or in one place.
    """
    a, b = (normal + 1) % 3, (normal + 2) % 3
    across, up = end[a] - start[a], end[b] - start[b]
    chord = math.hypot(across, up)
    if chord <= SAME:
        raise ArcError("an arc by R whose ends are in one place has no centre; give a full circle by I J K")
    size = abs(radius)
    if chord > 2.0 * size + max(RADIUS_TOL, RADIUS_SHARE * size):
        raise ArcError(
            f"R is {size * 1e3:.4f} mm, but the ends are {chord * 1e3:.4f} mm apart, at most twice R is "
            f"allowed; correct the end, or give an R of {math.ceil(0.5e7 * chord) / 1e4:.4f} mm or more"
        )
    height = math.sqrt(max(size * size - 0.25 * chord * chord, 0.0))
    side = height if (radius > 0.0) != clockwise else -height
    return (
        0.5 * (start[a] + end[a]) - side * up / chord,
        0.5 * (start[b] + end[b]) + side * across / chord,
    )


def sweep_of(start: Point, end: Point, centre: tuple[float, float], normal: int, clockwise: bool) -> float:
    """Angle [rad] from start to end, positive counterclockwise seen from +``normal``; a full turn where both
    are in one place.

    Raises :class:`ArcError` where the radii at both ends differ, or are nothing.
    """
    a, b = (normal + 1) % 3, (normal + 2) % 3
    first = math.hypot(start[a] - centre[0], start[b] - centre[1])
    last = math.hypot(end[a] - centre[0], end[b] - centre[1])
    if min(first, last) <= SAME:
        raise ArcError("the centre is at an end of the arc; correct I J K, which lead from the start to it")
    if abs(last - first) > max(RADIUS_TOL, RADIUS_SHARE * first):
        raise ArcError(
            f"the radius is {first * 1e3:.4f} mm at the start and {last * 1e3:.4f} mm at the end, allowed is "
            f"a difference of {max(RADIUS_TOL, RADIUS_SHARE * first) * 1e3:.4f} mm; correct the centre"
            f"{_fitting(start, end, centre, a, b)}, or "
            "state whether centres are incremental or absolute (arc_centre, G90.1, G91.1)"
        )
    if math.hypot(end[a] - start[a], end[b] - start[b]) <= SAME:
        return -2.0 * math.pi if clockwise else 2.0 * math.pi
    before = math.atan2(start[b] - centre[1], start[a] - centre[0])
    after = math.atan2(end[b] - centre[1], end[a] - centre[0])
    turn = (before - after if clockwise else after - before) % (2.0 * math.pi)
    return -turn if clockwise else turn


def _fitting(start: Point, end: Point, centre: tuple[float, float], a: int, b: int) -> str:
    """The place nearest to the centre that is as far from both ends, as the words of an incremental one."""
    way = end[a] - start[a], end[b] - start[b]
    square = way[0] ** 2 + way[1] ** 2
    if square <= SAME**2:
        return ""
    off = centre[0] - 0.5 * (start[a] + end[a]), centre[1] - 0.5 * (start[b] + end[b])
    share = (off[0] * way[0] + off[1] * way[1]) / square
    place = centre[0] - share * way[0] - start[a], centre[1] - share * way[1] - start[b]
    words = " ".join(f"{'IJK'[k]}{v * 1e3:.4f}" for k, v in sorted(zip((a, b), place, strict=True)))
    return f" (the nearest that fits is {words} mm from the start)"


def points(
    start: Point, end: Point, centre: tuple[float, float], sweep: float, normal: int, chord: float
) -> FloatArray:
    """Points (N, 3) [m] of an arc, or of a helix, without its start, within ``chord`` [m] of it between
    them.

    Angle, radius and the way along ``normal`` all grow evenly, so that small differences of the radii leave
    no jump. The last point is ``end`` itself.
    """
    a, b = (normal + 1) % 3, (normal + 2) % 3
    first = math.hypot(start[a] - centre[0], start[b] - centre[1])
    last = math.hypot(end[a] - centre[0], end[b] - centre[1])
    size = max(first, last)
    widest = 2.0 * math.acos(max(1.0 - chord / size, math.cos(0.5 * WIDEST)))
    count = max(math.ceil(abs(sweep) / widest - 1e-9), 1)
    share = np.arange(1, count + 1) / count
    angle = math.atan2(start[b] - centre[1], start[a] - centre[0]) + share * sweep
    radius = first + share * (last - first)
    out = np.empty((count, 3))
    out[:, a] = centre[0] + radius * np.cos(angle)
    out[:, b] = centre[1] + radius * np.sin(angle)
    out[:, normal] = start[normal] + share * (end[normal] - start[normal])
    out[-1] = end
    return out


def length(start: Point, end: Point, centre: tuple[float, float], sweep: float, normal: int) -> float:
    """Length [m] of the arc or helix."""
    a, b = (normal + 1) % 3, (normal + 2) % 3
    radius = math.hypot(start[a] - centre[0], start[b] - centre[1])
    return math.hypot(radius * sweep, end[normal] - start[normal])
