"""A free way between two points: the straight line, some coordinates after the others, or a tree from either
end.

Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000. Seeded, so
the same question has the same answer.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray

Free = Callable[[FloatArray], BoolArray]
Sure = Callable[[FloatArray, FloatArray], BoolArray]

MOST_GROWTH_STEPS = 8
"""A tree grows by at most this many steps at a time."""

MOST_ROUNDS = 3000
"""Samples that are drawn at most."""
MOST_ORDERED_COORDINATES = 6
"""With more coordinates than this there are too many orders in which they may go."""

FIRST_LOOKS = 8
"""Of the points of lines around corners one of so many is asked about first, of all lines at once."""

MOST_AHEAD = 32
"""Lines toward so many samples are asked about at once at most."""
SAME_PLACE = 1e-12
"""Points whose coordinates differ by less are the same."""

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
    samples = np.random.default_rng(seed).uniform(lower, upper, (rounds, len(start)))
    trees = (_Tree(start), _Tree(goal))
    growth = _Growth(trees, samples, free, step)
    for count in range(rounds):
        a, b = trees if count % 2 == 0 else trees[::-1]
        new = growth.first(count)
        while new is not None:
            other = growth.second(count, a.points[new])
            if other is None:
                break
            if np.array_equal(b.points[other], a.points[new]):
                ends = (a.way(new), b.way(other)) if count % 2 == 0 else (b.way(other), a.way(new))
                way = np.concatenate([ends[0][::-1], ends[1][1:]])
                rng = np.random.default_rng(seed)
                rng.uniform(lower, upper, (count + 1, len(start)))  # goes on behind the samples so far
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
    corners = corners[free(corners)]
    if not len(corners):
        return None
    lines = [np.concatenate([_line(start, c, step), _line(c, goal, step)]) for c in corners]
    some = [line[::FIRST_LOOKS] for line in lines]  # of nearly all lines these already tell
    own = np.repeat(np.arange(len(some)), [len(points) for points in some])
    bad = np.bincount(own, ~free(np.concatenate(some)), len(some)) > 0
    for k in np.flatnonzero(~bad).tolist():
        if free(lines[k]).all():
            return np.stack([start, corners[k], goal])
    return None


@dataclasses.dataclass(frozen=True)
class Places:
    """Places of a way: on the lines ``move`` (P,) between waypoints, at ``share`` (P,) of them."""

    move: IndexArray
    share: FloatArray

    def and_also(self, other: "Places") -> "Places":
        """These and the other ones."""
        return Places(np.append(self.move, other.move), np.append(self.share, other.share))

    def thinned(self, count: int) -> "Places":
        """At most so many of them, evenly."""
        some = np.unique(np.linspace(0, len(self.move) - 1, min(count, len(self.move))).astype(np.intp))
        return self.at(some)

    def at(self, some: IndexArray) -> "Places":
        """Some of them, perhaps more than once."""
        return Places(self.move[some], self.share[some])

    def points(self, way: FloatArray) -> FloatArray:
        """The points (P, D) there of a way (M, D)."""
        start, end = way[self.move], way[self.move + 1]
        return np.asarray(start + self.share[:, None] * (end - start))


NOWHERE: Final = Places(np.zeros(0, dtype=np.intp), np.zeros(0))
"""No places."""


def blocked_places(
    way: FloatArray, free: Free, step: float, sure: Sure | None = None, every: bool = True
) -> Places:
    """Where the straight lines between waypoints (M, D) are not free, looked at every ``step``: all places
    where looks fail, of which there is one wherever a line is halved, too; or not ``every`` one, but those of
    the first that do.

    ``sure`` tells of points (B, D) and how far (B, D) the coordinates go from there either way whether (B,)
    all of that is free for sure; there nothing is looked at, elsewhere halves are asked about.
    A few points take hardly longer than one, so of few pieces their halves are asked about with them, and the
    halves of these; what is found is the same.
    """
    move = np.arange(len(way) - 1)
    pieces = _Pieces(move, np.zeros(len(move)), np.ones(len(move)))
    out = NOWHERE
    while len(pieces.move):
        generations = [pieces]
        while sum(len(some.move) for some in generations) + 2 * len(generations[-1].move) <= ASKED_AHEAD:
            generations.append(generations[-1].halves())
        points = np.concatenate([some.middles(way) for some in generations])
        reach = np.concatenate([some.half(way) for some in generations])
        open_ = np.ones(len(points), dtype=bool) if sure is None else ~sure(points, reach)
        fine = reach.max(axis=1) <= step
        ends = np.cumsum([len(some.move) for some in generations])[:-1]
        asked: list[Places] = []
        own = np.arange(len(pieces.move))  # what is come to of a generation
        for some, still, last in zip(generations, np.split(open_, ends), np.split(fine, ends), strict=True):
            look, end = own[still[own]], own[(still & last)[own]]
            middle = 0.5 * (some.low + some.high)
            asked.append(
                Places(np.append(some.move[look], some.move[end]), np.append(middle[look], some.high[end]))
            )
            split = own[(still & ~last)[own]]
            own = np.append(split, split + len(some.move))
        looked = functools.reduce(Places.and_also, asked)
        bad = ~free(looked.points(way)) if len(looked.move) else np.zeros(0, dtype=bool)
        for where, failed in zip(
            asked, np.split(bad, np.cumsum([len(a.move) for a in asked])[:-1]), strict=True
        ):
            out = out.and_also(where.at(np.flatnonzero(failed)))
            if (len(out.move) and not every) or len(out.move) > MOST_BLOCKED:
                return out
        pieces = generations[-1].halves().at(own)
    return out


@dataclasses.dataclass(frozen=True)
class _Pieces:
    """Pieces of the lines ``move`` (P,) from their shares ``low`` to ``high`` (P,)."""

    move: IndexArray
    low: FloatArray
    high: FloatArray

    def at(self, some: IndexArray) -> "_Pieces":
        """Some of them."""
        return _Pieces(self.move[some], self.low[some], self.high[some])

    def halves(self) -> "_Pieces":
        """The first halves of all, then the second ones."""
        middle = 0.5 * (self.low + self.high)
        return _Pieces(np.tile(self.move, 2), np.append(self.low, middle), np.append(middle, self.high))

    def middles(self, way: FloatArray) -> FloatArray:
        """Their middles (P, D)."""
        return Places(self.move, 0.5 * (self.low + self.high)).points(way)

    def half(self, way: FloatArray) -> FloatArray:
        """How far (P, D) coordinates go from there to their ends."""
        return np.asarray(0.5 * (self.high - self.low)[:, None] * np.abs(way[self.move + 1] - way[self.move]))


ASKED_AHEAD: Final = 64
"""Pieces of a way that are asked about at once, where there are halves to be asked about with them."""
MOST_BLOCKED: Final = 200
"""Places of a way that are not free after which no others are looked for."""


class _Tree:
    def __init__(self, root: FloatArray) -> None:
        self._points = root[None].copy()
        self.parent = [-1]

    @property
    def points(self) -> FloatArray:
        """The points (P, D) so far."""
        return self._points[: len(self.parent)]

    def nearest(self, toward: FloatArray) -> tuple[int, float]:
        """The point that is nearest to a point by the largest coordinate, and how far off it is."""
        away = np.abs(self.points - toward).max(axis=1)
        near = int(np.argmin(away))
        return near, float(away[near])

    def line(self, near: int, away: float, toward: FloatArray, step: float) -> FloatArray:
        """Points (K, D) on the line from one of its points, ``away`` from it, toward a point."""
        base = self.points[near]
        share = min(1.0, MOST_GROWTH_STEPS * step / away)
        count = max(1, int(np.ceil(share * away / step)))
        line = base + share * (np.arange(1, count + 1) / count)[:, None] * (toward - base)
        if share == 1.0:
            line[-1] = toward
        return np.asarray(line)

    def add(self, near: int, line: FloatArray, ok: BoolArray) -> int | None:
        """Adds the end of the free part of a line from a point; its index, or None if there is none."""
        good = len(ok) if ok.all() else int(np.argmin(ok))
        if good == 0:
            return None
        if len(self.parent) == len(self._points):
            self._points = np.concatenate([self._points, np.empty_like(self._points)])
        self._points[len(self.parent)] = line[good - 1]
        self.parent.append(near)
        return len(self.parent) - 1

    def way(self, index: int) -> FloatArray:
        """Points from ``index`` to the root."""
        out = []
        while index >= 0:
            out.append(self.points[index])
            index = self.parent[index]
        return np.array(out)


_Line = tuple[int, FloatArray, BoolArray]
"""A line of a tree: the point that it begins at, its points (K, D), and which of these are free (K,)."""


class _Growth:
    """Two trees, of which in each round one grows toward a sample (R, D) and the other toward what it got to.

    Lines of rounds to come are asked about at once, from the trees as they are, which takes little longer
    than one line. Where a tree has changed meanwhile so that another of its points is nearest, a line is not
    used and asked about anew: trees grow as they do line by line.
    """

    def __init__(self, trees: tuple[_Tree, _Tree], samples: FloatArray, free: Free, step: float) -> None:
        self._trees, self._samples, self._free, self._step = trees, samples, free, step
        self._first: dict[int, _Line] = {}
        self._second: dict[int, _Line] = {}
        self._asked, self._missed, self._ahead = 0, 0, 1

    def first(self, count: int) -> int | None:
        """A round's first tree grows toward its sample: its new point, or None."""
        if count == self._asked:
            self._ahead = max(1, self._ahead // 2) if 4 * self._missed > self._ahead else 2 * self._ahead
            self._ahead, self._missed = min(self._ahead, MOST_AHEAD), 0
            self._ask(range(count, min(count + self._ahead, len(self._samples))))
        return self._grown(self._trees[count % 2], self._samples[count], self._first.pop(count, None))

    def second(self, count: int, toward: FloatArray) -> int | None:
        """The other tree grows toward a point; as :meth:`first`."""
        return self._grown(self._trees[1 - count % 2], toward, self._second.pop(count, None))

    def _grown(self, tree: _Tree, toward: FloatArray, known: _Line | None) -> int | None:
        near, away = tree.nearest(toward)
        if away < SAME_PLACE:
            return near
        line = tree.line(near, away, toward, self._step)
        if known is not None and known[0] == near and np.array_equal(known[1], line):
            return tree.add(*known)
        self._missed += known is not None
        return tree.add(near, line, self._free(line))

    def _ask(self, rounds: range) -> None:
        self._first = self._lines({n: (self._trees[n % 2], self._samples[n]) for n in rounds})
        ends = {n: line[np.argmin(ok) - 1] for n, (_, line, ok) in self._first.items() if ok[0]}
        ends |= {n: line[-1] for n, (_, line, ok) in self._first.items() if ok.all()}
        self._second = self._lines({n: (self._trees[1 - n % 2], end) for n, end in ends.items()})
        self._asked = rounds.stop

    def _lines(self, wanted: Mapping[int, tuple[_Tree, FloatArray]]) -> dict[int, _Line]:
        """Lines of trees toward points, by the rounds that want them."""
        found = {}
        for number, (tree, toward) in wanted.items():
            near, away = tree.nearest(toward)
            if away >= SAME_PLACE:
                found[number] = near, tree.line(near, away, toward, self._step)
        if not found:
            return {}
        lines = [line for _, line in found.values()]
        ok = np.split(self._free(np.concatenate(lines)), np.cumsum([len(line) for line in lines])[:-1])
        return {n: (near, line, own) for (n, (near, line)), own in zip(found.items(), ok, strict=True)}


def _line_free(a: FloatArray, b: FloatArray, free: Free, step: float) -> bool:
    return bool(free(_line(a, b, step)).all())


def _line(a: FloatArray, b: FloatArray, step: float) -> FloatArray:
    """Points (K, D) of the straight line behind ``a`` to ``b``."""
    count = max(1, int(np.ceil(np.abs(b - a).max() / step)))
    return np.asarray(a + (np.arange(1, count + 1) / count)[:, None] * (b - a))


def _shorten(way: FloatArray, free: Free, step: float, rng: np.random.Generator) -> FloatArray:
    points = list(way)
    blocked: set[tuple[int, int]] = set()  # few points are left soon, and the same ones are drawn again
    for _ in range(SHORTCUT_TRIES):
        if len(points) < 3:
            break
        i, j = sorted(rng.choice(len(points), 2, replace=False).tolist())
        if j - i < 2 or (i, j) in blocked:
            continue
        if _line_free(points[i], points[j], free, step):
            del points[i + 1 : j]
            blocked.clear()
        else:
            blocked.add((i, j))
    return np.array(points)
