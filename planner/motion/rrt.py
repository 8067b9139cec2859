"""Collision-free path between two points: the straight line, axis by axis, or RRT-Connect.

The search is seeded, so the same query has the same result.

Source: Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray

IsFree = Callable[[FloatArray], BoolArray]
"""Returns whether points (B, D) are free."""
IsSurelyFree = Callable[[FloatArray, FloatArray], BoolArray]
"""Returns whether boxes around points (B, D), with half extents (B, D), are certainly free."""

MAX_GROWTH_STEPS = 8
"""Maximum number of steps by which a tree grows at a time."""

MAX_ROUNDS = 3000
"""Default maximum number of samples."""
MAX_ORDERED_COORDINATES = 6
"""Maximum number of coordinates for axis-by-axis paths. With more there are too many orders."""

FIRST_CHECK_STRIDE = 8
"""Stride of the points of axis-by-axis paths that are checked first, on all paths together."""

MAX_LOOKAHEAD = 32
"""Maximum number of samples whose lines are checked together in advance."""
POINT_TOLERANCE = 1e-12
"""Coordinate difference below which two points are the same."""

MAX_SHORTCUT_TRIES = 40
"""Number of pairs of path points between which a straight line is tried."""


@dataclasses.dataclass(frozen=True)
class ConfigurationSpace:
    """Space of D coordinates in which a collision-free path is searched.

    Attributes:
        free: Returns whether points (B, D) are free.
        lower: (D,) lower bounds of random points.
        upper: (D,) upper bounds of random points.
        step: Spacing of the points that are checked on a line, measured as the largest difference of any
            coordinate.
    """

    free: IsFree
    lower: FloatArray
    upper: FloatArray
    step: float


def connect_points(
    start: FloatArray, goal: FloatArray, space: ConfigurationSpace, seed: int, rounds: int = MAX_ROUNDS
) -> FloatArray | None:
    """Find a collision-free path between two points.

    Args:
        start: (D,) start point.
        goal: (D,) goal point.
        space: Space of the points.
        seed: Seed of the random points.
        rounds: Maximum number of samples.

    Returns:
        Waypoints (M, D) including both ends, with free straight lines between them; None if an end is not
        free or no path was found.
    """
    free, lower, upper, step = space.free, space.lower, space.upper, space.step
    if not free(np.stack([start, goal])).all():
        return None
    if _is_line_free(start, goal, free, step):
        return np.stack([start, goal])
    corner = _connect_by_axes(start, goal, free, step)
    if corner is not None:
        return corner
    # RRT-Connect: one tree grows toward a sample, the other toward the new point; then they swap.
    samples = np.random.default_rng(seed).uniform(lower, upper, (rounds, len(start)))
    trees = (_RrtTree(start), _RrtTree(goal))
    growth = _TreeGrowth(trees, samples, free, step)
    for round_number in range(rounds):
        first_tree, second_tree = trees if round_number % 2 == 0 else trees[::-1]
        new_index = growth.grow_first(round_number)
        # The second tree grows toward the new point until it reaches it or is blocked.
        while new_index is not None:
            other_index = growth.grow_second(round_number, first_tree.points[new_index])
            if other_index is None:
                break
            if np.array_equal(second_tree.points[other_index], first_tree.points[new_index]):
                to_start, to_goal = (
                    (first_tree.path_to_root(new_index), second_tree.path_to_root(other_index))
                    if round_number % 2 == 0
                    else (second_tree.path_to_root(other_index), first_tree.path_to_root(new_index))
                )
                path = np.concatenate([to_start[::-1], to_goal[1:]])
                rng = np.random.default_rng(seed)
                rng.uniform(lower, upper, (round_number + 1, len(start)))  # skip the samples that were used
                return _shortcut_path(path, free, step, rng)
    return None


def _connect_by_axes(start: FloatArray, goal: FloatArray, free: IsFree, step: float) -> FloatArray | None:
    """Find a path from ``start`` (D,) to ``goal`` (D,) with one corner.

    Before the corner some coordinates move, and after it the others. Corners are tried in the order of the
    length of their paths. Returns the waypoints (3, D), or None if no corner gives a free path, or if fewer
    than two or more than :data:`MAX_ORDERED_COORDINATES` coordinates differ by more than ``step``.
    """
    differences = np.abs(goal - start)
    moving = np.flatnonzero(differences > step)
    if len(moving) < 2 or len(moving) > MAX_ORDERED_COORDINATES:
        return None
    # all choices of the coordinates that move later, except none and all, which are the straight line
    moves_later = np.array(list(itertools.product((False, True), repeat=len(moving))))[1:-1]
    corners = np.repeat(goal[None], len(moves_later), axis=0)
    corners[:, moving] = np.where(moves_later, start[moving], goal[moving])
    lengths = np.abs(corners - start).max(axis=1) + np.abs(corners - goal).max(axis=1)
    corners = corners[np.argsort(lengths, kind="stable")]
    corners = corners[free(corners)]
    if not len(corners):
        return None
    lines = [np.concatenate([_line_points(start, c, step), _line_points(c, goal, step)]) for c in corners]
    # Sparse points of all lines are checked together first, because they reject nearly all blocked lines.
    sparse_lines = [line[::FIRST_CHECK_STRIDE] for line in lines]
    line_index = np.repeat(np.arange(len(sparse_lines)), [len(points) for points in sparse_lines])
    is_blocked = np.bincount(line_index, ~free(np.concatenate(sparse_lines)), len(sparse_lines)) > 0
    for k in np.flatnonzero(~is_blocked).tolist():
        if free(lines[k]).all():
            return np.stack([start, corners[k], goal])
    return None


@dataclasses.dataclass(frozen=True)
class PathSamples:
    """Points on a path: on the lines ``move`` (P,) between waypoints, at ``fraction`` (P,) of them."""

    move: IndexArray
    fraction: FloatArray

    def extended(self, other: "PathSamples") -> "PathSamples":
        """Return these points followed by other points on the same path."""
        return PathSamples(np.append(self.move, other.move), np.append(self.fraction, other.fraction))

    def subsampled(self, count: int) -> "PathSamples":
        """Return at most ``count`` of the points, spread evenly over their order."""
        rows = np.unique(np.linspace(0, len(self.move) - 1, min(count, len(self.move))).astype(np.intp))
        return self.select(rows)

    def select(self, rows: IndexArray) -> "PathSamples":
        """Return the points at the given indices, which may repeat."""
        return PathSamples(self.move[rows], self.fraction[rows])

    def points(self, path: FloatArray) -> FloatArray:
        """Return the coordinates (P, D) of the points on a path (M, D)."""
        start, end = path[self.move], path[self.move + 1]
        return np.asarray(start + self.fraction[:, None] * (end - start))


NO_SAMPLES: Final = PathSamples(np.zeros(0, dtype=np.intp), np.zeros(0))
"""No points."""


def find_blocked(
    path: FloatArray,
    free: IsFree,
    step: float,
    surely_free: IsSurelyFree | None = None,
    find_all: bool = True,
) -> PathSamples:
    """Find points of a path that are not free.

    Lines are bisected until they are checked every ``step``. A query of a few points takes hardly longer than
    that of one. While few pieces are left, several generations of halves are therefore checked in one query.
    This does not change the result.

    Args:
        path: (M, D) waypoints.
        free: Returns whether points (B, D) are free.
        step: Spacing of checks, measured as the largest difference of any coordinate.
        surely_free: Returns whether (B,) boxes around points (B, D), with half extents (B, D), are certainly
            free. Pieces of the path in such boxes are not checked.
        find_all: Whether all blocked points are returned, or only those of the first generation of pieces
            that has any. At most about :data:`MAX_BLOCKED_SAMPLES` are returned.
    """
    move = np.arange(len(path) - 1)
    pieces = _PathPieces(move, np.zeros(len(move)), np.ones(len(move)))
    out = NO_SAMPLES
    while len(pieces.move):
        # Add generations of halves while they fit in one query.
        generations = [pieces]
        while (
            sum(len(generation.move) for generation in generations) + 2 * len(generations[-1].move)
            <= MAX_PIECES_AHEAD
        ):
            generations.append(generations[-1].halves())
        points = np.concatenate([generation.midpoints(path) for generation in generations])
        half_extents = np.concatenate([generation.half_extents(path) for generation in generations])
        all_open = (
            np.ones(len(points), dtype=bool) if surely_free is None else ~surely_free(points, half_extents)
        )
        all_fine = half_extents.max(axis=1) <= step
        ends = np.cumsum([len(generation.move) for generation in generations])[:-1]
        queried: list[PathSamples] = []
        # Of each generation only the pieces count whose parents were not decided.
        undecided = np.arange(len(pieces.move))
        for generation, is_open, is_fine in zip(
            generations, np.split(all_open, ends), np.split(all_fine, ends), strict=True
        ):
            # Open pieces are checked at their midpoint. Fine ones are checked at their end, too, and others
            # are bisected.
            open_pieces = undecided[is_open[undecided]]
            last_pieces = undecided[(is_open & is_fine)[undecided]]
            middle = 0.5 * (generation.low + generation.high)
            queried.append(
                PathSamples(
                    np.append(generation.move[open_pieces], generation.move[last_pieces]),
                    np.append(middle[open_pieces], generation.high[last_pieces]),
                )
            )
            bisected = undecided[(is_open & ~is_fine)[undecided]]
            undecided = np.append(bisected, bisected + len(generation.move))
        all_queried = functools.reduce(PathSamples.extended, queried)
        is_blocked = ~free(all_queried.points(path)) if len(all_queried.move) else np.zeros(0, dtype=bool)
        for samples, blocked in zip(
            queried, np.split(is_blocked, np.cumsum([len(a.move) for a in queried])[:-1]), strict=True
        ):
            out = out.extended(samples.select(np.flatnonzero(blocked)))
            if (len(out.move) and not find_all) or len(out.move) > MAX_BLOCKED_SAMPLES:
                return out
        pieces = generations[-1].halves().select(undecided)
    return out


@dataclasses.dataclass(frozen=True)
class _PathPieces:
    """Pieces of the lines ``move`` (P,) from fraction ``low`` to ``high`` (P,)."""

    move: IndexArray
    low: FloatArray
    high: FloatArray

    def select(self, rows: IndexArray) -> "_PathPieces":
        """Return the pieces at the given indices."""
        return _PathPieces(self.move[rows], self.low[rows], self.high[rows])

    def halves(self) -> "_PathPieces":
        """Return the first halves of all pieces, followed by the second halves."""
        middle = 0.5 * (self.low + self.high)
        return _PathPieces(np.tile(self.move, 2), np.append(self.low, middle), np.append(middle, self.high))

    def midpoints(self, path: FloatArray) -> FloatArray:
        """Return the midpoints (P, D) of the pieces on a path (M, D)."""
        return PathSamples(self.move, 0.5 * (self.low + self.high)).points(path)

    def half_extents(self, path: FloatArray) -> FloatArray:
        """Return half of the change (P, D) of each coordinate over the pieces of a path (M, D)."""
        return np.asarray(
            0.5 * (self.high - self.low)[:, None] * np.abs(path[self.move + 1] - path[self.move])
        )


MAX_PIECES_AHEAD: Final = 64
"""Maximum number of pieces that are checked together while there are halves to check in advance."""
MAX_BLOCKED_SAMPLES: Final = 200
"""Number of blocked points after which the search for others ends."""


class _RrtTree:
    """A tree of points that are connected by free straight lines.

    Attributes:
        parent: Index of the parent of each point, -1 for the root.
    """

    def __init__(self, root: FloatArray) -> None:
        self._points = root[None].copy()
        self.parent = [-1]

    @property
    def points(self) -> FloatArray:
        """Points (P, D) of the tree in the order in which they were added, the root first."""
        return self._points[: len(self.parent)]

    def nearest(self, target: FloatArray) -> tuple[int, float]:
        """Return the index of the tree point nearest to a target, and its distance.

        The distance is the largest difference of any coordinate.
        """
        distances = np.abs(self.points - target).max(axis=1)
        index = int(np.argmin(distances))
        return index, float(distances[index])

    def line(self, index: int, distance: float, target: FloatArray, step: float) -> FloatArray:
        """Return points (K, D) on the line from a tree point toward a target.

        Args:
            index: Index of the tree point.
            distance: Distance from the tree point to the target.
            target: (D,) target.
            step: Maximum spacing of the points. The line has at most :data:`MAX_GROWTH_STEPS` of them.
        """
        start = self.points[index]
        fraction = min(1.0, MAX_GROWTH_STEPS * step / distance)
        count = max(1, int(np.ceil(fraction * distance / step)))
        line = start + fraction * (np.arange(1, count + 1) / count)[:, None] * (target - start)
        if fraction == 1.0:
            line[-1] = target  # exactly, so that both trees can meet
        return np.asarray(line)

    def add(self, parent_index: int, line: FloatArray, is_free: BoolArray) -> int | None:
        """Add the end of the free part of a line to the tree.

        Args:
            parent_index: Index of the tree point at which the line starts.
            line: (K, D) points of the line.
            is_free: (K,) whether these points are free.

        Returns:
            Index of the new point, or None if the first point of the line is not free.
        """
        free_count = len(is_free) if is_free.all() else int(np.argmin(is_free))
        if free_count == 0:
            return None
        # the array of points grows by doubling
        if len(self.parent) == len(self._points):
            self._points = np.concatenate([self._points, np.empty_like(self._points)])
        self._points[len(self.parent)] = line[free_count - 1]
        self.parent.append(parent_index)
        return len(self.parent) - 1

    def path_to_root(self, index: int) -> FloatArray:
        """Return the points (M, D) from the point ``index`` to the root, both included."""
        out = []
        while index >= 0:
            out.append(self.points[index])
            index = self.parent[index]
        return np.array(out)


_TreeLine = tuple[int, FloatArray, BoolArray]
"""A line of a tree: index of its start point, its points (K, D), and whether they are free (K,)."""


class _TreeGrowth:
    """Growth of two trees: in each round one grows toward a sample, and the other toward the new point.

    Lines of later rounds are checked together in advance, from the trees as they are, which takes little
    longer than one line. If a tree changes meanwhile so that another point is nearest, the line is discarded
    and another one is checked. The trees therefore grow exactly as they would line by line.
    """

    def __init__(
        self, trees: tuple[_RrtTree, _RrtTree], samples: FloatArray, free: IsFree, step: float
    ) -> None:
        """Prepare the growth; ``samples`` (R, D) are those of R rounds."""
        self._trees, self._samples, self._free, self._step = trees, samples, free, step
        # lines that were checked in advance, by round
        self._first_lines: dict[int, _TreeLine] = {}
        self._second_lines: dict[int, _TreeLine] = {}
        self._queried_until, self._misses, self._lookahead = 0, 0, 1

    def grow_first(self, round_number: int) -> int | None:
        """Grow the first tree of a round toward its sample.

        Returns the index of the new or reached point, or None if the tree could not grow.
        """
        if round_number == self._queried_until:
            # Look farther ahead while most of the lines could be used, and less far otherwise.
            self._lookahead = (
                max(1, self._lookahead // 2) if 4 * self._misses > self._lookahead else 2 * self._lookahead
            )
            self._lookahead, self._misses = min(self._lookahead, MAX_LOOKAHEAD), 0
            self._query_lines(range(round_number, min(round_number + self._lookahead, len(self._samples))))
        return self._extend(
            self._trees[round_number % 2],
            self._samples[round_number],
            self._first_lines.pop(round_number, None),
        )

    def grow_second(self, round_number: int, target: FloatArray) -> int | None:
        """Grow the second tree of a round toward a point (D,), the new point of the first tree.

        Returns the index of the new or reached point, or None if the tree could not grow.
        """
        return self._extend(
            self._trees[1 - round_number % 2], target, self._second_lines.pop(round_number, None)
        )

    def _extend(self, tree: _RrtTree, target: FloatArray, known_line: _TreeLine | None) -> int | None:
        """Grow a tree toward a point, and return the index of the new or reached point, or None.

        ``known_line`` was checked in advance. It is used if it is still the line from the nearest point.
        """
        index, distance = tree.nearest(target)
        if distance < POINT_TOLERANCE:
            return index
        line = tree.line(index, distance, target, self._step)
        if known_line is not None and known_line[0] == index and np.array_equal(known_line[1], line):
            return tree.add(*known_line)
        self._misses += known_line is not None
        return tree.add(index, line, self._free(line))

    def _query_lines(self, rounds: range) -> None:
        """Check lines of several rounds in advance: those toward samples, then those toward their ends."""
        self._first_lines = self._build_lines({n: (self._trees[n % 2], self._samples[n]) for n in rounds})
        ends = {
            n: line[np.argmin(is_free) - 1]
            for n, (_, line, is_free) in self._first_lines.items()
            if is_free[0]
        }
        # lines that are free throughout end at their last point, which the expression above misses
        ends |= {n: line[-1] for n, (_, line, is_free) in self._first_lines.items() if is_free.all()}
        self._second_lines = self._build_lines({n: (self._trees[1 - n % 2], end) for n, end in ends.items()})
        self._queried_until = rounds.stop

    def _build_lines(self, requests: Mapping[int, tuple[_RrtTree, FloatArray]]) -> dict[int, _TreeLine]:
        """Check lines of trees toward points, by round, in one query. Reached points have no line."""
        lines_by_round = {}
        for number, (tree, target) in requests.items():
            index, distance = tree.nearest(target)
            if distance >= POINT_TOLERANCE:
                lines_by_round[number] = index, tree.line(index, distance, target, self._step)
        if not lines_by_round:
            return {}
        lines = [line for _, line in lines_by_round.values()]
        is_free = np.split(self._free(np.concatenate(lines)), np.cumsum([len(line) for line in lines])[:-1])
        return {
            n: (index, line, line_is_free)
            for (n, (index, line)), line_is_free in zip(lines_by_round.items(), is_free, strict=True)
        }


def _is_line_free(a: FloatArray, b: FloatArray, free: IsFree, step: float) -> bool:
    """Whether the straight line from ``a`` (excluded) to ``b`` is free."""
    return bool(free(_line_points(a, b, step)).all())


def _line_points(a: FloatArray, b: FloatArray, step: float) -> FloatArray:
    """Return points (K, D) of the straight line from ``a`` (excluded) to ``b``, at most ``step`` apart."""
    count = max(1, int(np.ceil(np.abs(b - a).max() / step)))
    return np.asarray(a + (np.arange(1, count + 1) / count)[:, None] * (b - a))


def _shortcut_path(path: FloatArray, free: IsFree, step: float, rng: np.random.Generator) -> FloatArray:
    """Replace parts of a path (M, D) by free straight lines between randomly chosen pairs of its points.

    At most :data:`MAX_SHORTCUT_TRIES` pairs are tried. Returns the points that remain.
    """
    points = list(path)
    blocked: set[tuple[int, int]] = set()  # with few points left the same pairs are drawn again
    for _ in range(MAX_SHORTCUT_TRIES):
        if len(points) < 3:
            break
        i, j = sorted(rng.choice(len(points), 2, replace=False).tolist())
        if j - i < 2 or (i, j) in blocked:
            continue
        if _is_line_free(points[i], points[j], free, step):
            del points[i + 1 : j]
            blocked.clear()
        else:
            blocked.add((i, j))
    return np.array(points)
