"""Ways made shorter by optimisation of their corners.

Sequential convex programming with a trust region and an exact penalty, after Schulman et al., "Motion
planning with sequential convex optimization and convex collision checking", IJRR 2014; its steps are
quadratic programs by Drake's `MathematicalProgram`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from pydrake.solvers import MathematicalProgram, SolverInterface
from scipy import sparse

from planner.geometry.arrays import FloatArray, IndexArray
from planner.motion.rrt import NOWHERE, Places
from planner.motion.trajectory.program import solvers


@dataclasses.dataclass(frozen=True)
class Rooms:
    """What there is of room at points (B, D): R values ``room`` (R,), each at one of them, ``row`` (R,), with
    its ``slope`` (R, D) by the coordinates. A point is free where all are at least 0; wide ones may be left
    out."""

    row: IndexArray
    room: FloatArray
    slope: FloatArray


Near = Callable[[FloatArray, float], Rooms]
"""What there is of room at points (B, D), at least of what has less than so much [m]."""

MOST_MOVES: Final = 8
"""Straight lines of a shortened way at most, unless it had more before."""
NEAR_M: Final = 0.1
"""Bodies [m] that have more room than this do not count in one quadratic program."""
CLOSE_M: Final = 0.01
"""What has less room [m] than this beyond what is asked for is in a program from its start; what has more
comes in where the solution would leave it less than that,"""
SOLVED_M: Final = 1e-6
"""by more than this [m],"""
CLOSE_BEHIND_M: Final = 1e-3
"""together with what is left no more than this [m] beyond it."""
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
"""How far [rad] a coordinate goes in the first round; halved when two rounds make things worse."""
LEAST_TRUST_RAD: Final = 2e-3
"""No round goes less far [rad]."""
LEAST_GAIN: Final = 5e-4
"""A round that gains, but less, as a share of the cost, is the last."""
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
class _Rows:
    """What quadratic programs ask of the inner corners x (C,): ``slope`` (R, C) times x is ``least`` (R,) at
    least, less what the lines ``move`` (R,) lack of room."""

    move: IndexArray
    slope: sparse.csr_matrix
    least: FloatArray

    def and_also(self, other: "_Rows") -> "_Rows":
        """These and the other ones."""
        return _Rows(
            np.append(self.move, other.move),
            sparse.vstack([self.slope, other.slope], format="csr"),
            np.append(self.least, other.least),
        )

    def lacking(self, x: FloatArray) -> FloatArray:
        """How much (R,) [m] they lack at corners x."""
        return np.asarray(self.least - self.slope @ x)


@dataclasses.dataclass(frozen=True)
class _Looked:
    """A way that was looked at, at places of it: what of ``rooms`` is less than what is asked for, its merit,
    and the room [m] that lacks most. ``ends``: the least room at the ends [m]."""

    way: FloatArray
    places: Places
    rooms: Rooms
    merit: float
    lacks: float
    ends: float
    lever: FloatArray

    def rows(self, rooms: Rooms) -> _Rows:
        """What programs ask about rooms at these places, as they change near the way."""
        lines, width = len(self.way) - 1, self.way.shape[1]
        where = self.places.at(rooms.row)
        shape = (len(rooms.row), (lines - 1) * width)
        slope = sparse.csr_matrix(shape)
        for corner, part in ((where.move - 1, 1.0 - where.share), (where.move, where.share)):
            own = np.flatnonzero((corner >= 0) & (corner < lines - 1))
            columns = corner[own, None] * width + np.arange(width)
            values = part[own, None] * rooms.slope[own]
            index = (np.repeat(own, width), columns.ravel())
            slope = slope + sparse.csr_matrix((values.ravel(), index), shape=shape)
        asked = _asked(self.way, self.places, self.lever, self.ends)[rooms.row]
        return _Rows(where.move, slope, asked - rooms.room + slope @ self.way[1:-1].ravel())


def _asked(way: FloatArray, places: Places, lever: FloatArray, ends: float) -> FloatArray:
    """The room (P,) [m] that is asked for at places of a way with the room ``ends`` at its ends."""
    length = np.abs(np.diff(way, axis=0)) @ lever
    start = np.append(0.0, np.cumsum(length))
    gone = start[:-1][places.move] + places.share * length[places.move]
    aside = np.minimum(gone, start[-1] - gone)
    return np.asarray(np.minimum(RESERVE_M, RESERVE_SHARE * max(ends, 0.0) + RESERVE_SLOPE * aside))


def _look(way: FloatArray, also: Places, task: Task, weight: FloatArray, ends: float) -> _Looked:
    length = np.abs(np.diff(way, axis=0)) @ task.lever
    spacing = max(LOOK_SPACING_M, float(length.sum()) / MOST_LOOKS)
    count = np.maximum(np.ceil(length / spacing), 2.0).astype(np.intp)
    move = np.repeat(np.arange(len(count)), count)
    share = np.concatenate([(np.arange(n) + 0.5) / n for n in count.tolist()])
    corner = np.arange(len(count) - 1)
    places = Places(move, share).and_also(Places(corner, np.ones(len(corner)))).and_also(also)
    rooms = task.near(places.points(way), RESERVE_M)
    wanting = _asked(way, places, task.lever, ends)[rooms.row] - rooms.room
    some = np.flatnonzero(wanting > 0.0)
    rooms, wanting = Rooms(rooms.row[some], rooms.room[some], rooms.slope[some]), wanting[some]
    worst = np.zeros(len(count))
    np.maximum.at(worst, places.move[rooms.row], wanting)
    merit = _cost(way, weight) + ROOM_PRICE * float(worst.sum())
    return _Looked(way, places, rooms, merit, float(wanting.max(initial=0.0)), ends, task.lever)


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
    a travel that is ``enough`` only until it has room and that, and as long as there is hope of ``hoped``.

    What lacks room on a way that a program gave, but that makes things worse, is asked for in the next one,
    too, as it changes near that way: about the way before alone programs would give such a one again.
    """
    weight = task.lever / task.lever.max()
    ends = float(task.near(way[[0, -1]], NEAR_M).room.min(initial=np.inf))
    best = _look(way, also, task, weight, ends)
    trust, worse = TRUST_RAD, 0
    rows: _Rows | None = None
    for number in range(rounds):
        far = hoped is not None and travel(best.way) > hoped
        if far and number >= HOPEFUL_ROUNDS and best.lacks > HOPEFUL_M:
            break
        if enough is not None and best.lacks <= 0.0 and travel(best.way) <= enough:
            break
        if rows is None:
            rows = best.rows(task.near(best.places.points(best.way), NEAR_M))
        moved = _step(best.way, rows, task, weight, trust, program)
        if moved is None:
            break
        tried = _look(moved, also, task, weight, ends)
        gain = best.merit - tried.merit
        if gain > 0.0:
            last = gain < LEAST_GAIN * best.merit
            best, rows, worse = tried, None, 0
            if last:
                break
        else:
            rows, worse = rows.and_also(tried.rows(tried.rooms)), worse + 1
            trust *= 0.5 if worse % 2 == 0 else 1.0
            if trust < LEAST_TRUST_RAD:
                break
    return best.way


def _step(
    way: FloatArray, rows: _Rows, task: Task, weight: FloatArray, trust: float, program: SolverInterface
) -> FloatArray | None:
    """The way after one quadratic program about it, None where that has no solution.

    Unknowns: the inner corners x, of each line what each coordinate travels t >= |step|, and of each line the
    room s >= 0 that lacks most on it. Rows that are asked for first are few; those that the solution does not
    keep follow, until it keeps all.
    """
    lines, width = len(way) - 1, way.shape[1]
    inner = (lines - 1) * width
    steps = sparse.kron(sparse.diags([1.0, -1.0], [0, -1], shape=(lines, lines - 1)), sparse.eye(width))
    fixed = np.zeros((lines, width))
    fixed[0], fixed[-1] = fixed[0] - way[0], fixed[-1] + way[-1]
    travelled, none = sparse.eye(lines * width), sparse.csc_matrix((lines * width, lines))
    square = sparse.diags(np.tile(weight**2, lines))
    stiff = (2.0 * EVENNESS * lines * (steps.T @ square @ steps)).toarray()
    pull = 2.0 * EVENNESS * lines * (steps.T @ square @ fixed.ravel())
    lower = np.maximum(way[1:-1] - trust, np.minimum(task.lower, way[1:-1])).ravel()
    upper = np.minimum(way[1:-1] + trust, np.maximum(task.upper, way[1:-1])).ravel()
    taken = rows.lacking(way[1:-1].ravel()) > -CLOSE_M
    while True:
        some = np.flatnonzero(taken)
        by_line = (np.ones(len(some)), (np.arange(len(some)), rows.move[some]))
        blocks: list[list[Any]] = [
            [-steps, travelled, none],
            [steps, travelled, none],
            [
                rows.slope[some],
                sparse.csc_matrix((len(some), lines * width)),
                sparse.csc_matrix(by_line, shape=(len(some), lines)),
            ],
        ]
        least = np.concatenate([fixed.ravel(), -fixed.ravel(), rows.least[some]])
        problem = MathematicalProgram()
        unknown = problem.NewContinuousVariables(inner + lines * width + lines)
        matrix = sparse.bmat(blocks, format="csc")
        problem.AddLinearConstraint(matrix, least, np.full(len(least), np.inf), unknown)
        problem.AddBoundingBoxConstraint(lower, upper, unknown[:inner])
        problem.AddBoundingBoxConstraint(0.0, np.inf, unknown[inner:])
        problem.AddQuadraticCost(stiff, pull, unknown[:inner], is_convex=True)
        problem.AddLinearCost(np.ones(lines * width), unknown[inner : inner + lines * width])
        problem.AddLinearCost(np.full(lines, ROOM_PRICE), unknown[inner + lines * width :])
        result = program.Solve(problem)
        if not result.is_success():
            return None
        x = np.clip(result.GetSolution(unknown[:inner]), lower, upper)
        lacks = rows.lacking(x) - result.GetSolution(unknown[inner + lines * width :])[rows.move]
        if not np.any(~taken & (lacks > SOLVED_M)):
            break
        taken |= lacks > -CLOSE_BEHIND_M
    out = way.copy()
    out[1:-1] = x.reshape(lines - 1, width)
    return out
