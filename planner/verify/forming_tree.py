"""Which triangles may be nearest to points or straight ways: groups of triangles as flat disks, in levels."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.vectors import dots, lengths

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

BRANCH: Final = 4


@dataclasses.dataclass(frozen=True)
class Level:
    """Groups as disks that hold their triangles: ``centre``, ``normal`` (K, 3), ``radius`` and half the
    thickness ``half`` (K,) [m]; a level's children of group k are 4 k to 4 k + 3 of the next."""

    centre: FloatArray
    normal: FloatArray
    radius: FloatArray
    half: FloatArray


class Tree:
    """Triangles (F, 3, 3) in groups of four, these in groups of four, and so on."""

    def __init__(self, corners: FloatArray) -> None:
        count = len(corners)
        depth = max(int(np.ceil(np.log(max(count, 1)) / np.log(BRANCH))), 0)
        full = BRANCH**depth
        middle = corners.mean(axis=1)
        order = np.arange(count)
        slots = np.full(full, -1, dtype=np.int64)
        # equal shares along the widest way of each group, so that the order of the slots is the tree
        place = np.zeros(count, dtype=np.int64)
        size = full
        while size > 1:
            half = size // 2
            group = place // size
            low = np.full((full // size, 3), np.inf)
            high = -low
            np.minimum.at(low, group, middle[order])
            np.maximum.at(high, group, middle[order])
            widest = np.argmax(high - low, axis=1)
            value = middle[order, widest[group]]
            turn = np.lexsort((value, group))
            order, group = order[turn], group[turn]
            first = np.searchsorted(group, group)
            rank = np.arange(count) - first
            number = np.bincount(group, minlength=full // size)[group]
            cut = np.minimum((number + 1) // 2, half)
            place = group * size + np.where(rank < cut, rank, half + rank - cut)
            size = half
        slots[place] = order
        self.triangle = slots
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.levels = tuple(_level(corners, cross, slots.reshape(BRANCH**k, -1)) for k in range(depth + 1))

    def near_points(self, points: FloatArray, limit: FloatArray) -> tuple[IntArray, IntArray]:
        """Pairs of points (N, 3) and triangles that may be nearer than ``limit`` (N,) [m]."""
        return self._near(limit, lambda level, node, which: _off_points(level, node, points[which]))

    def near_ways(self, start: FloatArray, end: FloatArray, limit: FloatArray) -> tuple[IntArray, IntArray]:
        """Pairs of straight ways from ``start`` to ``end`` (N, 3) and triangles that may be nearer than
        ``limit`` (N,) [m]."""
        return self._near(limit, lambda level, node, which: _off_ways(level, node, start[which], end[which]))

    def _near(
        self, limit: FloatArray, off: Callable[[Level, IntArray, IntArray], FloatArray]
    ) -> tuple[IntArray, IntArray]:
        which = np.arange(len(limit))
        node = np.zeros(len(limit), dtype=np.int64)
        for k, level in enumerate(self.levels):
            if k:
                which = np.repeat(which, BRANCH)
                node = (BRANCH * node[:, None] + np.arange(BRANCH)).ravel()
            near = off(level, node, which) < limit[which]
            which, node = which[near], node[near]
        return which, self.triangle[node]


def _level(corners: FloatArray, cross: FloatArray, slots: IntArray) -> Level:
    used = slots >= 0
    group, column = np.nonzero(used)
    triangle = slots[group, column]
    count = len(slots)
    points = corners[triangle]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, group, points.min(axis=1))
    np.maximum.at(high, group, points.max(axis=1))
    held = np.isfinite(low)
    centre = 0.5 * (np.where(held, low, 0.0) + np.where(held, high, 0.0))
    normal = np.zeros((count, 3))
    np.add.at(normal, group, cross[triangle])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-30, normal / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0]))
    rest = points - centre[group][:, None]
    height = np.einsum("nkd,nd->nk", rest, normal[group])
    flat = np.sqrt(np.maximum((rest * rest).sum(axis=2) - height**2, 0.0))
    radius, half = np.full(count, -np.inf), np.zeros(count)
    np.maximum.at(radius, group, flat.max(axis=1))
    np.maximum.at(half, group, np.abs(height).max(axis=1))
    return Level(centre, normal, radius + 1e-12, half + 1e-12)


def _off_points(level: Level, node: IntArray, points: FloatArray) -> FloatArray:
    """A lower bound (M,) [m] of the distance of points from what groups hold; infinite for groups that hold
    nothing."""
    rest = points - level.centre[node]
    height = dots(rest, level.normal[node])
    flat = np.sqrt(np.maximum(dots(rest, rest) - height * height, 0.0))
    return _off(level, node, flat, np.abs(height))


def _off_ways(level: Level, node: IntArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """As :func:`_off_points`, of straight ways."""
    normal, centre = level.normal[node], level.centre[node]
    one, two = start - centre, end - centre
    low, high = dots(one, normal), dots(two, normal)
    height = np.where(low * high > 0.0, np.minimum(np.abs(low), np.abs(high)), 0.0)
    middle = 0.5 * (one + two)
    up = 0.5 * (low + high)
    flat = np.sqrt(np.maximum(dots(middle, middle) - up * up, 0.0)) - 0.5 * lengths(end - start)
    return _off(level, node, flat, height)


def _off(level: Level, node: IntArray, flat: FloatArray, height: FloatArray) -> FloatArray:
    """Distance (M,) [m] from disks, of what is ``flat`` along them from their middle and ``height`` over."""
    radius = level.radius[node]
    beside = np.maximum(flat - radius, 0.0)
    above = np.maximum(height - level.half[node], 0.0)
    return np.where(radius < 0.0, np.inf, np.hypot(above, beside))
