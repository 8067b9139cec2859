"""A free way between two points: the straight line, some coordinates after the others, or a tree from either
end, shortened.

Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000. Seeded, so
the same question has the same answer.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray

Free = Callable[[FloatArray], BoolArray]
Sure = Callable[[FloatArray, FloatArray], BoolArray]

MOST_GROWTH_STEPS = 8
"""A tree grows by at most this many steps at a time."""

MOST_ROUNDS = 3000
"""Samples that are drawn at most."""
MOST_ORDERED_COORDINATES = 6
"""With more coordinates than this there are too many orders in which they may go."""

SHORTCUT_TRIES = 40
"""Pairs of points of a way between which a straight one is tried."""


def connect(
    start: FloatArray,
    goal: FloatArray,
    free: Free,
    lower: FloatArray,
    upper: FloatArray,
    step: float,
    seed: int,
    rounds: int = MOST_ROUNDS,
) -> FloatArray | None:
    """Waypoints (M, D) from ``start`` to ``goal`` (D,), both included, straight lines between them being
    free.

    ``free`` tells of points (B, D) whether they are; lines are checked every ``step`` of the largest
    coordinate. Random points lie between ``lower`` and ``upper``. None if an end is not free or no way was
    found within ``rounds``.
    """
    if not free(np.stack([start, goal])).all():
        return None
    if _line_free(start, goal, free, step):
        return np.stack([start, goal])
    corner = _around_corner(start, goal, free, step)
    if corner is not None:
        return corner
    rng = np.random.default_rng(seed)
    trees = (_Tree(start), _Tree(goal))
    for count in range(rounds):
        a, b = trees if count % 2 == 0 else trees[::-1]
        sample = rng.uniform(lower, upper)
        new = a.grow(sample, free, step)
        if new is None:
            continue
        while True:
            other = b.grow(a.points[new], free, step)
            if other is None:
                break
            if np.array_equal(b.points[other], a.points[new]):
                ends = (a.way(new), b.way(other)) if count % 2 == 0 else (b.way(other), a.way(new))
                way = np.concatenate([ends[0][::-1], ends[1][1:]])
                return _shorten(way, free, step, rng)
    return None


def _around_corner(start: FloatArray, goal: FloatArray, free: Free, step: float) -> FloatArray | None:
    """A free way on which some coordinates go after the others, a short one; None if there is none."""
    far = np.abs(goal - start)
    live = np.flatnonzero(far > step)
    if len(live) < 2 or len(live) > MOST_ORDERED_COORDINATES:
        return None
    later = np.array(list(itertools.product((False, True), repeat=len(live))))[1:-1]
    corners = np.repeat(goal[None], len(later), axis=0)
    corners[:, live] = np.where(later, start[live], goal[live])
    lengths = np.abs(corners - start).max(axis=1) + np.abs(corners - goal).max(axis=1)
    corners = corners[np.argsort(lengths, kind="stable")]
    for corner in corners[free(corners)]:
        if _line_free(start, corner, free, step) and _line_free(corner, goal, free, step):
            return np.stack([start, corner, goal])
    return None


def way_free(way: FloatArray, free: Free, step: float, sure: Sure | None = None) -> bool:
    """Whether the straight lines between waypoints (M, D) are free, looked at every ``step``.

    ``sure`` tells of points (B, D) and how far (B, D) the coordinates go from there either way whether (B,)
    all of that is free for sure; there nothing is looked at, elsewhere halves are asked about.
    """
    starts, ends = way[:-1], way[1:]
    while len(starts):
        middle, half = 0.5 * (starts + ends), 0.5 * np.abs(ends - starts)
        open_ = np.ones(len(starts), dtype=bool) if sure is None else ~sure(middle, half)
        fine = half.max(axis=1) <= step
        look = open_ & fine
        if look.any() and not free(np.concatenate([middle[look], ends[look]])).all():
            return False
        split = open_ & ~fine
        starts, ends = (
            np.concatenate([starts[split], middle[split]]),
            np.concatenate([middle[split], ends[split]]),
        )
    return True


class _Tree:
    def __init__(self, root: FloatArray) -> None:
        self.points = [root]
        self.parent = [-1]

    def grow(self, toward: FloatArray, free: Free, step: float) -> int | None:
        """Adds a point on the free part of the line toward a point; its index, or None if there is no free
        part."""
        away = np.abs(np.array(self.points) - toward).max(axis=1)
        near = int(np.argmin(away))
        if away[near] < 1e-12:
            return near
        base = self.points[near]
        share = min(1.0, MOST_GROWTH_STEPS * step / float(away[near]))
        count = max(1, int(np.ceil(share * away[near] / step)))
        line = base + share * (np.arange(1, count + 1) / count)[:, None] * (toward - base)
        if share == 1.0:
            line[-1] = toward
        ok = free(line)
        good = count if ok.all() else int(np.argmin(ok))
        if good == 0:
            return None
        self.points.append(line[good - 1])
        self.parent.append(near)
        return len(self.points) - 1

    def way(self, index: int) -> FloatArray:
        """Points from ``index`` to the root."""
        out = []
        while index >= 0:
            out.append(self.points[index])
            index = self.parent[index]
        return np.array(out)


def _line_free(a: FloatArray, b: FloatArray, free: Free, step: float) -> bool:
    count = max(1, int(np.ceil(np.abs(b - a).max() / step)))
    return bool(free(a + (np.arange(1, count + 1) / count)[:, None] * (b - a)).all())


def _shorten(way: FloatArray, free: Free, step: float, rng: np.random.Generator) -> FloatArray:
    points = list(way)
    for _ in range(SHORTCUT_TRIES):
        if len(points) < 3:
            break
        i, j = sorted(rng.choice(len(points), 2, replace=False))
        if j - i > 1 and _line_free(points[i], points[j], free, step):
            del points[i + 1 : j]
    return np.array(points)
