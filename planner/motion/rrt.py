"""A free way between two points: the straight line, some coordinates after the others, or a tree from either
end; then made shorter by optimisation of its corners.

The search: Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA
2000. Seeded, so the same question has the same answer. The optimisation: sequential convex programming with a
trust region and an exact penalty, after Schulman et al., "Motion planning with sequential convex optimization
and convex collision checking", IJRR 2014; its steps are quadratic programs by Drake's `MathematicalProgram`.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from pydrake.solvers import MathematicalProgram, SolverInterface
from scipy import sparse

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.motion.trajectory.program import solvers

Free = Callable[[FloatArray], BoolArray]
Sure = Callable[[FloatArray, FloatArray], BoolArray]

MOST_GROWTH_STEPS = 8
"""A tree grows by at most this many steps at a time."""

MOST_ROUNDS = 3000
"""Samples that are drawn at most."""
MOST_ORDERED_COORDINATES = 6
"""With more coordinates than this there are too many orders in which they may go."""

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
    for corner in corners[free(corners)]:
        if _line_free(start, corner, free, step) and _line_free(corner, goal, free, step):
            return np.stack([start, corner, goal])
    return None


def way_free(way: FloatArray, free: Free, step: float, sure: Sure | None = None) -> bool:
    """Whether the straight lines between waypoints (M, D) are free, looked at every ``step``.

    ``sure`` tells of points (B, D) and how far (B, D) the coordinates go from there either way whether (B,)
    all of that is free for sure; there nothing is looked at, elsewhere halves are asked about.
    """
    return not len(blocked_places(way, free, step, sure, every=False).move)


@dataclasses.dataclass(frozen=True)
class Places:
    """Places of a way: on the lines ``move`` (P,) between waypoints, at ``share`` (P,) of them."""

    move: IndexArray
    share: FloatArray

    def and_also(self, other: Places) -> Places:
        """These and the other ones."""
        return Places(np.append(self.move, other.move), np.append(self.share, other.share))

    def thinned(self, count: int) -> Places:
        """At most so many of them, evenly."""
        some = np.unique(np.linspace(0, len(self.move) - 1, min(count, len(self.move))).astype(np.intp))
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
    """Where the lines are not free, as :func:`way_free` finds it: all places where looks fail, of which there
    is one wherever a line is halved, too; or not ``every`` one, but those of the first that do."""
    move = np.arange(len(way) - 1)
    low, high = np.zeros(len(move)), np.ones(len(move))
    out = NOWHERE
    while len(move):
        middle = 0.5 * (low + high)
        points = Places(move, middle).points(way)
        half = 0.5 * (high - low)[:, None] * np.abs(way[move + 1] - way[move])
        open_ = np.ones(len(move), dtype=bool) if sure is None else ~sure(points, half)
        fine = half.max(axis=1) <= step
        look, last = np.flatnonzero(open_), np.flatnonzero(open_ & fine)
        if len(look):
            asked = Places(np.append(move[look], move[last]), np.append(middle[look], high[last]))
            bad = ~free(asked.points(way))
            out = out.and_also(Places(asked.move[bad], asked.share[bad]))
            if len(out.move) and not every:
                break
        split = open_ & ~fine
        move = np.tile(move[split], 2)
        low, high = np.append(low[split], middle[split]), np.append(middle[split], high[split])
        if len(out.move) > MOST_BLOCKED:
            break
    return out


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


@dataclasses.dataclass(frozen=True)
class Rooms:
    """What there is of room at points (B, D): R values ``room`` (R,), each at one of them, ``row`` (R,), with
    its ``slope`` (R, D) by the coordinates. A point is free where all are at least 0; wide ones may be left
    out."""

    row: IndexArray
    room: FloatArray
    slope: FloatArray


Near = Callable[[FloatArray], Rooms]

MOST_MOVES: Final = 8
"""Straight lines of a shortened way at most, unless it had more before."""
LOOK_SPACING_M: Final = 0.05
"""Way [m] between the places at which an optimised line is looked at in each round."""
MOST_LOOKS: Final = 80
"""Such places of a way, about, at most."""
RESERVE_M: Final = 1e-3
"""More than the room that is asked for [m], so that what lies between two looks keeps that."""
RESERVE_SHARE: Final = 0.5
"""Near an end whose own room is less no more than this share of it is asked for beyond."""
RESERVE_SLOPE: Final = 0.1
"""How fast [m/m] what is asked for grows from there."""
ROUNDS: Final = 12
"""Quadratic programs before the first last look at most."""
REPAIR_ROUNDS: Final = 5
"""Quadratic programs between two last looks at most."""
LAST_LOOKS: Final = 8
"""Last looks at a way from one seed at most: so often places that fail are fed back."""
FED_BACK: Final = 30
"""Places that fail in a last look and are looked at in all later rounds, at most."""
TRUST_RAD: Final = 0.25
"""How far [rad] a coordinate goes in the first round; halved when a round makes things worse."""
LEAST_TRUST_RAD: Final = 2e-3
"""No round goes less far [rad]."""
LEAST_GAIN: Final = 5e-4
"""A round that gains less, as a share of the cost, is the last."""
EVENNESS: Final = 0.02
"""Weight of squared lengths of the lines beside the travel: of ways with the same travel straight and even
ones."""
ROOM_PRICE: Final = 1e3
"""Price [rad/m] of room that lacks: 1 mm is worth more than any detour."""
HOPEFUL_ROUNDS: Final = 3
"""After so many rounds there is no hope for a bent way that lacks more room [m] than this:"""
HOPEFUL_M: Final = 0.01
SAME_POINT: Final = 1e-9
"""Waypoints [rad] nearer than this are one."""
SAME_TRAVEL_RAD: Final = 1e-6
"""A way that is longer than the straight line by less [rad] is as short as can be."""


@dataclasses.dataclass(frozen=True)
class Task:
    """What a way is made shorter in. ``near``: what there is of room, [m]; ``blocked``: where a way is not
    free after all, every place or the first ones; ``lower``, ``upper`` (D,) of the corners; ``lever`` (D,)
    [m/rad]: how far a coordinate carries anything at most."""

    near: Near
    blocked: Callable[[FloatArray, bool], Places]
    lower: FloatArray
    upper: FloatArray
    lever: FloatArray


def travel(way: FloatArray) -> float:
    """Sum over all coordinates of how far they go along waypoints (M, D)."""
    return float(np.abs(np.diff(way, axis=0)).sum())


def shortened(
    way: FloatArray, task: Task, looks: int = LAST_LOOKS, rounds: int = ROUNDS
) -> FloatArray | None:
    """A way (K, D) of less travel between the ends of ``way`` (M, D), free as ``task.blocked`` finds it and
    without corners that it can do without; None where none was found. ``way`` itself need not be free.

    The work is bounded by last ``looks``, quadratic programs before the first of them (``rounds``),
    :data:`REPAIR_ROUNDS` and the looks that a line has; the same way has the same answer.
    """
    return _optimised_free(way, task, looks, rounds, None)


def bent(way: FloatArray, task: Task, longer: float = 1.0) -> FloatArray | None:
    """A free way (K, D) between the ends of a ``way`` (M, D) that is not free, of no more than ``longer``
    times its travel; None where none was found. Of those that know this and a tree, this one is asked first:
    its work is over as soon as a way has room and no more travel than before, when it is longer than may be,
    or without hope after :data:`HOPEFUL_ROUNDS`."""
    most = longer * travel(way) + SAME_TRAVEL_RAD
    out = _optimised_free(way, task, LAST_LOOKS, ROUNDS, most)
    return None if out is None or travel(out) > most else out


def _optimised_free(
    way: FloatArray, task: Task, looks: int, rounds: int, most: float | None
) -> FloatArray | None:
    """What :func:`shortened` gives, or :func:`bent` of ``most`` travel."""
    ready = solvers()
    if not ready or len(way) < 2:
        return None
    now, also, bad = _padded(way, task.lever), NOWHERE, NOWHERE
    enough = None if most is None else travel(way) + SAME_TRAVEL_RAD
    straight = enough == most
    hoped = 0.0 if straight else most  # straight ones are soon bent, or never
    for number in range(looks):
        before, failed = now, bad
        soon = enough if straight or not number else None
        now = _optimised(now, also, task, ready[0], REPAIR_ROUNDS if number else rounds, soon, hoped)
        if most is not None and travel(now) > most:
            break
        bad = task.blocked(now, True)
        if not len(bad.move):
            return _with_fewer_corners(now, task)
        if len(failed.move) == len(bad.move) and np.array_equal(before, now):
            break  # what was fed back has moved nothing
        also = also.and_also(bad.thinned(FED_BACK))
    return None


def _padded(way: FloatArray, lever: FloatArray) -> FloatArray:
    """The way with its longest lines halved until there are :data:`MOST_MOVES`."""
    out = way
    while len(out) <= MOST_MOVES:
        k = int(np.argmax(np.abs(np.diff(out, axis=0)) @ lever))
        out = np.insert(out, k + 1, 0.5 * (out[k] + out[k + 1]), axis=0)
    return out


def _with_fewer_corners(way: FloatArray, task: Task) -> FloatArray:
    """The way without corners between whose neighbours the straight line is free."""
    out, k = way, 1
    while k < len(out) - 1:
        straight = out[[k - 1, k + 1]]
        same = bool(np.abs(out[k] - straight).max(axis=1).min() < SAME_POINT)
        if same or not len(task.blocked(straight, False).move):
            out = np.delete(out, k, axis=0)
        else:
            k += 1
    return out


def _cost(way: FloatArray, weight: FloatArray) -> float:
    step = np.diff(way, axis=0)
    return travel(way) + EVENNESS * len(step) * float(np.sum((step * weight) ** 2))


@dataclasses.dataclass(frozen=True)
class _Looked:
    """A way with what there is of room at places of it beyond what is asked for, and its merit."""

    way: FloatArray
    places: Places
    rooms: Rooms
    wanting: FloatArray
    merit: float

    @property
    def lacks(self) -> float:
        """The room [m] that lacks most."""
        return float(self.wanting.max(initial=0.0))


def _look(way: FloatArray, also: Places, task: Task, weight: FloatArray, ends: float) -> _Looked:
    """Looks at a way; ``ends``: the least room at its ends [m]."""
    length = np.abs(np.diff(way, axis=0)) @ task.lever
    spacing = max(LOOK_SPACING_M, float(length.sum()) / MOST_LOOKS)
    count = np.maximum(np.ceil(length / spacing), 2.0).astype(np.intp)
    move = np.repeat(np.arange(len(count)), count)
    share = np.concatenate([(np.arange(n) + 0.5) / n for n in count.tolist()])
    corner = np.arange(len(count) - 1)
    places = Places(move, share).and_also(Places(corner, np.ones(len(corner)))).and_also(also)
    rooms = task.near(places.points(way))
    start = np.append(0.0, np.cumsum(length))
    gone = (start[:-1][places.move] + places.share * length[places.move])[rooms.row]
    aside = np.minimum(gone, start[-1] - gone)
    asked = np.minimum(RESERVE_M, RESERVE_SHARE * max(ends, 0.0) + RESERVE_SLOPE * aside)
    wanting = asked - rooms.room
    worst = np.zeros(len(count))
    np.maximum.at(worst, places.move[rooms.row], wanting)
    merit = _cost(way, weight) + ROOM_PRICE * float(worst.sum())
    return _Looked(way, places, rooms, wanting, merit)


def _optimised(
    way: FloatArray,
    also: Places,
    task: Task,
    program: SolverInterface,
    rounds: int,
    enough: float | None,
    hoped: float | None,
) -> FloatArray:
    """The way with its corners moved so that cost and lacking room become least, near where they were; with
    a travel that is ``enough`` only until it has room and that, and as long as there is hope of ``hoped``."""
    weight = task.lever / task.lever.max()
    ends = task.near(way[[0, -1]])
    best = _look(way, also, task, weight, float(ends.room.min(initial=np.inf)))
    trust = TRUST_RAD
    for number in range(rounds):
        far = hoped is not None and travel(best.way) > hoped
        if far and number >= HOPEFUL_ROUNDS and best.lacks > HOPEFUL_M:
            break
        if enough is not None and best.lacks <= 0.0 and travel(best.way) <= enough:
            break
        moved = _step(best, task, weight, trust, program)
        if moved is None:
            break
        tried = _look(moved, also, task, weight, float(ends.room.min(initial=np.inf)))
        gain = best.merit - tried.merit
        if gain > 0.0:
            best = tried
        if gain < LEAST_GAIN * best.merit:
            trust *= 0.5
            if trust < LEAST_TRUST_RAD:
                break
    return best.way


def _step(
    looked: _Looked, task: Task, weight: FloatArray, trust: float, program: SolverInterface
) -> FloatArray | None:
    """The way after one quadratic program about it, None where that has no solution.

    Unknowns: the inner corners x, of each line what each coordinate travels t >= |step|, and of each line the
    room s >= 0 that lacks most on it.
    """
    way, rooms, places = looked.way, looked.rooms, looked.places
    lines, width = len(way) - 1, way.shape[1]
    inner = (lines - 1) * width
    count = inner + lines * width + lines
    steps = sparse.kron(sparse.diags([1.0, -1.0], [0, -1], shape=(lines, lines - 1)), sparse.eye(width))
    fixed = np.zeros((lines, width))
    fixed[0], fixed[-1] = fixed[0] - way[0], fixed[-1] + way[-1]
    travelled, none = sparse.eye(lines * width), sparse.csc_matrix((lines * width, lines))
    row = rooms.row
    k, share = places.move[row], places.share[row]
    at = np.arange(len(row))
    lacking = sparse.csc_matrix((np.ones(len(row)), (at, k)), shape=(len(row), lines))
    parts = []
    for corner, part in ((k - 1, 1.0 - share), (k, share)):
        own = np.flatnonzero((corner >= 0) & (corner < lines - 1))
        columns = corner[own, None] * width + np.arange(width)
        values = part[own, None] * rooms.slope[own]
        index = (np.repeat(own, width), columns.ravel())
        parts.append(sparse.csc_matrix((values.ravel(), index), shape=(len(row), inner)))
    slope = parts[0] + parts[1]
    here = slope @ way[1:-1].ravel()
    blocks: list[list[Any]] = [
        [-steps, travelled, none],
        [steps, travelled, none],
        [slope, sparse.csc_matrix((len(row), lines * width)), lacking],
    ]
    matrix = sparse.bmat(blocks, format="csc")
    least = np.concatenate([fixed.ravel(), -fixed.ravel(), looked.wanting + here])
    square = sparse.diags(np.tile(weight**2, lines))
    stiff = 2.0 * EVENNESS * lines * (steps.T @ square @ steps)
    pull = 2.0 * EVENNESS * lines * (steps.T @ square @ fixed.ravel())
    problem = MathematicalProgram()
    unknown = problem.NewContinuousVariables(count)
    problem.AddLinearConstraint(matrix, least, np.full(len(least), np.inf), unknown)
    lower = np.maximum(way[1:-1] - trust, np.minimum(task.lower, way[1:-1])).ravel()
    upper = np.minimum(way[1:-1] + trust, np.maximum(task.upper, way[1:-1])).ravel()
    problem.AddBoundingBoxConstraint(lower, upper, unknown[:inner])
    problem.AddBoundingBoxConstraint(0.0, np.inf, unknown[inner:])
    problem.AddQuadraticCost(stiff.toarray(), pull, unknown[:inner], is_convex=True)
    problem.AddLinearCost(np.ones(lines * width), unknown[inner : inner + lines * width])
    problem.AddLinearCost(np.full(lines, ROOM_PRICE), unknown[inner + lines * width :])
    result = program.Solve(problem)
    if not result.is_success():
        return None
    out = way.copy()
    out[1:-1] = np.clip(result.GetSolution(unknown[:inner]), lower, upper).reshape(lines - 1, width)
    return out
