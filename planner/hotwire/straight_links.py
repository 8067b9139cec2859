"""Ways of the wire through the air from one cut to the next, around the block.

A wire that keeps its direction is a point in the plane across it, and the block a convex polygon there. To
turn, it is taken to a place beyond one side of the block where there is room for that.
"""

from __future__ import annotations

import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from planner.geometry.rigid import exp_rotation
from planner.hotwire.straight_lines import Lines, grown, join

FloatArray = NDArray[np.float64]

AIR_STEP: Final = 0.012
"""[m] largest move of any point of the wire between targets in the air."""
SAME: Final = np.deg2rad(0.5)
"""Directions that differ by less need no place to turn."""
SHY: Final = 1e-4
"""[m] a way may come nearer to the block by this than its ends are."""
BELOW: Final = 10.0
"""What a way below the block costs, against one elsewhere: there is its support or its holder."""


def link(a: Lines, b: Lines, box: FloatArray, clear: float, half: float, down: FloatArray) -> Lines:
    """Wires from ``a`` (1) to ``b`` (1), the first left out, that stay ``clear`` [m] of the block ``box``.

    ``half`` [m] is half the wire's length, ``down`` (D, 3) the sides of the block to keep away from. Both
    ends point the same way along the wire, within 90 degrees.
    """
    hull = grown(box, clear - SHY)
    ways: list[tuple[float, Lines]] = []
    if _angle(a, b) < SAME:
        ways += _around(a, b, hull, down, box)
    for normal in np.concatenate([np.eye(3), -np.eye(3)]):
        ways += _over(a, b, hull, half, normal, down, box)
    if not ways:
        raise ValueError("no way around the block")
    return min(ways, key=lambda way: way[0])[1]


def _angle(a: Lines, b: Lines) -> float:
    return float(np.arccos(np.clip(a.direction[0] @ b.direction[0], -1.0, 1.0)))


def _over(
    a: Lines, b: Lines, hull: FloatArray, half: float, normal: FloatArray, down: FloatArray, box: FloatArray
) -> list[tuple[float, Lines]]:
    """Ways by a place beyond one side, where the wire turns from one direction to the other."""
    tilt = 1.5 * half * max(abs(float(line.direction[0] @ normal)) for line in (a, b))
    if tilt > 0.6 * half and _angle(a, b) < SAME:
        return []  # along the side's normal: nothing to turn for there
    centre = 0.5 * (hull[0] + hull[1])
    # clearly outside the hull, so that it is a corner of what lies around both
    place = centre + normal * (0.5 * np.abs(normal) @ (hull[1] - hull[0]) + tilt + 10.0 * SHY)
    turning = _turn(a.direction[0], b.direction[0], place, half)
    first, last = (_around(*ends, hull, down, box) for ends in ((a, turning[:1]), (turning[-1:], b)))
    return [
        (c + d + 0.3 * half * _angle(a, b), join([one, turning[1:], two]))
        for (c, one), (d, two) in itertools.product(first, last)
    ]


def _turn(a: FloatArray, b: FloatArray, place: FloatArray, half: float) -> Lines:
    """The wire turning about a place from direction a to b (3,), no point of it faster than in the air."""
    axis = np.cross(a, b)
    size = float(np.linalg.norm(axis))
    angle = float(np.arctan2(size, a @ b))
    count = max(1, int(np.ceil(angle * half / AIR_STEP)))
    turns = exp_rotation(np.arange(count + 1)[:, None] / count * angle * axis / max(size, 1e-12))
    way = turns @ a
    return Lines(place - half * way, place + half * way)


def _around(
    a: Lines, b: Lines, hull: FloatArray, down: FloatArray, box: FloatArray
) -> list[tuple[float, Lines]]:
    """Ways from a to b, which has nearly a's direction, around the block's shadow: straight, or both ways
    round."""
    direction = a.direction[0]
    plane = np.linalg.svd(direction[None])[2][1:].T
    shadow = np.array(list(itertools.product(*hull.T))) @ plane
    block = np.array(list(itertools.product(*box.T)))
    ends = [_foot(line, box) for line in (a, b)]
    start, goal = (point @ plane for point in ends)
    polygon = shadow[ConvexHull(shadow).vertices]
    if _free(start, goal, polygon):
        chains = [np.stack([start, goal])]
    else:
        points = np.concatenate([polygon, [start, goal]])
        order: list[int] = [int(v) for v in ConvexHull(points).vertices]
        if len(points) - 2 not in order or len(points) - 1 not in order:
            return []
        k = order.index(len(points) - 2)
        ring = order[k:] + order[:k]
        m = ring.index(len(points) - 1)
        chains = [points[ring[: m + 1]], points[[ring[0], *ring[: m - 1 : -1]]]]
    out = []
    for chain in chains:
        length = np.linalg.norm(np.diff(chain, axis=0), axis=1)
        middle = 0.5 * (chain[1:] + chain[:-1]) @ plane.T
        low = np.any([middle @ side > (block @ side).max() - SHY for side in down], axis=0)
        below = BELOW * float(length[low].sum())
        out.append((float(length.sum()) + below, _along(a, b, chain @ plane.T, direction, ends)))
    return out


def _foot(line: Lines, box: FloatArray) -> FloatArray:
    """The point (3,) of a line (1) that is abreast of the block's middle."""
    return np.asarray(line.at(line.abreast(0.5 * (box[:1] + box[1:])))[0])


def _free(a: FloatArray, b: FloatArray, polygon: FloatArray) -> bool:
    """Whether the straight way from a to b (2,) stays out of a convex polygon (M, 2), counter-clockwise."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    u, v = ((point - polygon) @ normal.T for point in (a, b))
    u, v = np.diagonal(u), np.diagonal(v)
    enter, leave = 0.0, 1.0
    for p, q in zip(u, v, strict=True):  # inside is where all are negative
        if p > -1e-9 and q > -1e-9:
            return True
        if p > 0.0 or q > 0.0:
            cross = p / (p - q)
            enter, leave = (max(enter, cross), leave) if p > 0.0 else (enter, min(leave, cross))
    return enter >= leave - 1e-9


def _along(a: Lines, b: Lines, chain: FloatArray, direction: FloatArray, ends: list[FloatArray]) -> Lines:
    """Wires along a chain of points across the wire, from a (left out) to b; what is along the wire goes
    evenly with the way."""
    length = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    gone = np.concatenate([[0.0], np.cumsum(length)])
    slide = [float(point @ direction) for point in ends]
    total = max(float(gone[-1]), abs(slide[1] - slide[0]))
    if total < 1e-6:
        return b[:0]  # there already
    own = [
        np.linspace(gone[k], gone[k + 1], max(1, int(np.ceil(piece / AIR_STEP))) + 1)[1:]
        for k, piece in enumerate(length)
        if piece > 1e-9
    ]
    at = np.concatenate(own) if own else np.array([gone[-1]])
    points = np.stack([np.interp(at, gone, chain[:, k]) for k in range(3)], axis=1)
    share = at / gone[-1] if gone[-1] > 1e-9 else np.ones(len(at))
    points += (slide[0] + share * (slide[1] - slide[0]))[:, None] * direction
    way = a.direction + share[:, None] * (b.direction - a.direction)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    half = 0.5 * float(np.linalg.norm(b.end[0] - b.start[0]))
    lines = Lines(points - half * way, points + half * way)
    return Lines(np.concatenate([lines.start[:-1], b.start]), np.concatenate([lines.end[:-1], b.end]))
