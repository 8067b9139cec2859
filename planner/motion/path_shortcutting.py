"""Shortening of joint paths by optimisation of their corners.

Sequential convex programming with a trust region and an exact penalty. The steps are quadratic programs in
Drake's `MathematicalProgram`.

Source: Schulman et al., "Motion planning with sequential convex optimization and convex collision checking",
IJRR 2014.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from pydrake.solvers import MathematicalProgram, SolverInterface
from scipy import sparse

from planner.geometry.arrays import FloatArray, IndexArray
from planner.motion.rrt import NO_SAMPLES, PathSamples
from planner.motion.trajectory.program import available_solvers


@dataclasses.dataclass(frozen=True)
class ClearanceMargins:
    """Margins of clearance at points (B, D).

    A point is free if all of its margins are at least 0. Wide margins may be left out.

    Attributes:
        row: (R,) point of each margin.
        margin: (R,) margins beyond the required clearance.
        slope: (R, D) derivatives by the coordinates.
    """

    row: IndexArray
    margin: FloatArray
    slope: FloatArray


MarginQuery = Callable[[FloatArray, float], ClearanceMargins]
"""Returns the margins at points (B, D), at least those below a distance [m]."""

MAX_MOVES: Final = 8
"""Maximum number of straight lines of a shortened path, unless it had more before."""
QUERY_DISTANCE_M: Final = 0.1
"""Margin [m] above which bodies are ignored in one quadratic program."""
INITIAL_ROW_MARGIN_M: Final = 0.01
"""Excess margin [m] below which a row is in a program from its start. Other rows are added if the solution
violates them.
"""
ROW_TOLERANCE_M: Final = 1e-6
"""Violation [m] of a row outside the program above which that row is added to the program."""
ADDED_ROW_MARGIN_M: Final = 1e-3
"""Excess margin [m] below which further rows are added together with violated ones."""
SAMPLE_SPACING_M: Final = 0.05
"""Spacing [m of travel] of the samples at which margins are evaluated in each round."""
MAX_SAMPLES: Final = 80
"""Approximate maximum number of samples of a path in each round. Longer paths have a larger spacing."""
EXTRA_MARGIN_M: Final = 1e-3
"""Margin [m] required at samples, so that the path between two samples keeps clearance."""
EXTRA_MARGIN_FRACTION: Final = 0.5
"""Fraction of the margin of the ends. Near an end with a smaller margin, no more than this fraction is
required at samples.
"""
EXTRA_MARGIN_SLOPE: Final = 0.1
"""Rate [m/m] at which the required margin grows with the distance from an end."""
MAX_ROUNDS: Final = 12
"""Maximum number of quadratic programs before the first final check."""
MAX_REPAIR_ROUNDS: Final = 5
"""Maximum number of quadratic programs between two final checks."""
MAX_FINAL_CHECKS: Final = 8
"""Maximum number of final checks of a path from one seed. After each, the blocked points are fed back."""
MAX_FED_BACK: Final = 30
"""Maximum number of blocked points of a final check that are evaluated in all later rounds."""
INITIAL_TRUST_RAD: Final = 0.25
"""Trust region [rad] of a coordinate in the first round. It is halved if two rounds bring no improvement."""
MIN_TRUST_RAD: Final = 2e-3
"""Minimum trust region [rad]."""
MIN_GAIN_FRACTION: Final = 5e-4
"""Relative gain of a round below which it is the last."""
EVENNESS_WEIGHT: Final = 0.02
"""Weight of the squared lengths of lines relative to the travel. Of paths with equal travel it prefers
straight, even ones.
"""
MARGIN_PENALTY: Final = 1e3
"""Penalty [rad/m] of missing margin. Chosen so that 1 mm is worth more than any detour."""
MIN_PROMISING_ROUNDS: Final = 3
"""Number of rounds after which a bent path with a large deficit of margin is given up."""
MAX_PROMISING_DEFICIT_M: Final = 0.01
"""Deficit of margin [m] above which a bent path is given up."""
WAYPOINT_TOLERANCE_RAD: Final = 1e-9
"""Distance [rad] below which two waypoints are the same."""
TRAVEL_TOLERANCE_RAD: Final = 1e-6
"""Extra travel [rad] over the straight line below which a path cannot be shortened."""


@dataclasses.dataclass(frozen=True)
class ShortcutTask:
    """Environment in which a path is shortened.

    Attributes:
        margins: Returns the margins [m] at points.
        blocked: Returns the points of a path (M, D) that are not free at the final check: all of them if the
            second argument is true, else only those of the first check that fails.
        lower: (D,) lower bounds of the corners.
        upper: (D,) upper bounds of the corners.
        lever: (D,) [m/rad] largest displacement of any body per change of a coordinate.
    """

    margins: MarginQuery
    blocked: Callable[[FloatArray, bool], PathSamples]
    lower: FloatArray
    upper: FloatArray
    lever: FloatArray


def path_travel(path: FloatArray) -> float:
    """Return the travel [rad] of waypoints (M, D), summed over all moves and all coordinates."""
    return float(np.abs(np.diff(path, axis=0)).sum())


def shorten_path(
    path: FloatArray, task: ShortcutTask, final_checks: int = MAX_FINAL_CHECKS, rounds: int = MAX_ROUNDS
) -> FloatArray | None:
    """Find a path of less travel between the ends of a path.

    The work is bounded by the final checks, by ``rounds`` and :data:`MAX_REPAIR_ROUNDS`, and by the checks of
    a line. The same path has the same result.

    Args:
        path: (M, D) waypoints, which need not be free.
        task: Environment.
        final_checks: Maximum number of final checks.
        rounds: Maximum number of quadratic programs before the first final check.

    Returns:
        Waypoints (K, D), free as by ``task.blocked`` and without unnecessary corners; None if none was found.
    """
    return _optimise_to_free(path, task, final_checks, rounds, max_travel=None)


def bend_path(path: FloatArray, task: ShortcutTask, max_ratio: float = 1.0) -> FloatArray | None:
    """Find a free path between the ends of a path that is not free.

    This is tried before a tree search. It ends as soon as a path has margin and no more travel than before,
    if the path gets longer than allowed, or if it is not promising after :data:`MIN_PROMISING_ROUNDS`.

    Args:
        path: (M, D) waypoints.
        task: Environment.
        max_ratio: Maximum ratio of the travel to that of ``path``.

    Returns:
        Waypoints (K, D), or None if none was found.
    """
    max_travel = max_ratio * path_travel(path) + TRAVEL_TOLERANCE_RAD
    out = _optimise_to_free(path, task, MAX_FINAL_CHECKS, MAX_ROUNDS, max_travel)
    return None if out is None or path_travel(out) > max_travel else out


def _optimise_to_free(
    path: FloatArray, task: ShortcutTask, final_checks: int, rounds: int, max_travel: float | None
) -> FloatArray | None:
    """Optimise the corners of a path until the final check finds it free.

    The path first gets :data:`MAX_MOVES` lines, so that there are corners to move. Points that a final check
    finds blocked become samples of the next rounds.

    Args:
        path: (M, D) waypoints.
        task: Environment.
        final_checks: Maximum number of final checks.
        rounds: Maximum number of quadratic programs before the first final check.
        max_travel: Travel [rad] above which a bent path is given up (:func:`bend_path`). None: the path is
            shortened (:func:`shorten_path`).

    Returns:
        Free waypoints (K, D) without unnecessary corners, or None if none was found.
    """
    solvers = available_solvers()
    if not solvers or len(path) < 2:
        return None
    current, extra_samples, blocked = _pad(path, task.lever), NO_SAMPLES, NO_SAMPLES
    sufficient_travel = None if max_travel is None else path_travel(path) + TRAVEL_TOLERANCE_RAD
    keeps_length = sufficient_travel == max_travel
    hoped_travel = 0.0 if keeps_length else max_travel  # a path that may not get longer is bent soon or never
    for number in range(final_checks):  # each round ends with a final check
        previous, previous_blocked = current, blocked
        round_travel = sufficient_travel if keeps_length or not number else None
        stopping = _StoppingCriteria(MAX_REPAIR_ROUNDS if number else rounds, round_travel, hoped_travel)
        current = _optimise_corners(current, extra_samples, task, solvers[0], stopping)
        if max_travel is not None and path_travel(current) > max_travel:
            break
        blocked = task.blocked(current, True)  # all blocked points
        if not len(blocked.move):
            return _remove_corners(current, task)
        if len(previous_blocked.move) == len(blocked.move) and np.array_equal(previous, current):
            break  # the blocked points that were fed back changed nothing
        extra_samples = extra_samples.extended(blocked.subsampled(MAX_FED_BACK))
    return None


def _pad(path: FloatArray, lever: FloatArray) -> FloatArray:
    """Halve the longest line of a path again and again until it has :data:`MAX_MOVES` lines."""
    out = path
    while len(out) <= MAX_MOVES:
        k = int(np.argmax(np.abs(np.diff(out, axis=0)) @ lever))
        out = np.insert(out, k + 1, 0.5 * (out[k] + out[k + 1]), axis=0)
    return out


def _remove_corners(path: FloatArray, task: ShortcutTask) -> FloatArray:
    """Remove corners whose neighbours are connected by a free straight line, and repeated waypoints."""
    out, k = path, 1
    while k < len(out) - 1:
        straight = out[[k - 1, k + 1]]
        is_duplicate = bool(np.abs(out[k] - straight).max(axis=1).min() < WAYPOINT_TOLERANCE_RAD)
        if is_duplicate or not len(task.blocked(straight, False).move):
            out = np.delete(out, k, axis=0)
        else:
            k += 1
    return out


def _path_cost(path: FloatArray, weight: FloatArray) -> float:
    """Return travel plus evenness: sum |step| + e n sum |W step|^2 over n lines; ``weight`` (D,) is W."""
    step = np.diff(path, axis=0)
    return path_travel(path) + EVENNESS_WEIGHT * len(step) * float(np.sum((step * weight) ** 2))


@dataclasses.dataclass(frozen=True)
class _ProgramRows:
    """Rows of quadratic programs for the inner corners x (C,).

    ``slope`` (R, C) x >= ``lower`` (R,) - s[``move`` (R,)], where s is the missing margin of each line.
    """

    move: IndexArray
    slope: sparse.csr_matrix
    lower: FloatArray

    def extended(self, other: "_ProgramRows") -> "_ProgramRows":
        """Return these rows followed by other rows for the same corners."""
        return _ProgramRows(
            np.append(self.move, other.move),
            sparse.vstack([self.slope, other.slope], format="csr"),
            np.append(self.lower, other.lower),
        )

    def deficit(self, x: FloatArray) -> FloatArray:
        """Return the violation (R,) [m] of the rows at corners x; negative where a row has room."""
        return np.asarray(self.lower - self.slope @ x)


@dataclasses.dataclass(frozen=True)
class _EvaluatedPath:
    """A path that was evaluated at samples.

    Attributes:
        path: (M, D) waypoints.
        samples: Samples of the path.
        margins: Margins at samples that are below the required margin.
        merit: Cost plus the penalty for the largest missing margin of each line.
        max_deficit: Largest missing margin [m].
        end_margin: Smallest margin [m] at the two ends of the path.
        lever: (D,) [m/rad] largest displacement of any body per change of a coordinate.
    """

    path: FloatArray
    samples: PathSamples
    margins: ClearanceMargins
    merit: float
    max_deficit: float
    end_margin: float
    lever: FloatArray

    def program_rows(self, margins: ClearanceMargins) -> _ProgramRows:
        """Linearise the margins at the samples as rows of a quadratic program for the inner corners.

        A sample lies on a line between two corners, so a row has entries for these two. Ends are no unknowns.
        """
        lines, width = len(self.path) - 1, self.path.shape[1]
        samples = self.samples.select(margins.row)
        shape = (len(margins.row), (lines - 1) * width)
        slope = sparse.csr_matrix(shape)
        for corner, weight in ((samples.move - 1, 1.0 - samples.fraction), (samples.move, samples.fraction)):
            inner = np.flatnonzero((corner >= 0) & (corner < lines - 1))
            columns = corner[inner, None] * width + np.arange(width)
            values = weight[inner, None] * margins.slope[inner]
            index = (np.repeat(inner, width), columns.ravel())
            slope = slope + sparse.csr_matrix((values.ravel(), index), shape=shape)
        required = _required_margin(self.path, self.samples, self.lever, self.end_margin)[margins.row]
        return _ProgramRows(samples.move, slope, required - margins.margin + slope @ self.path[1:-1].ravel())


def _required_margin(
    path: FloatArray, samples: PathSamples, lever: FloatArray, end_margin: float
) -> FloatArray:
    """Return the required margin (P,) [m] at samples of a path.

    It is :data:`EXTRA_MARGIN_M`, but less near an end whose own margin ``end_margin`` [m] is small. Distances
    from the ends are weighted by ``lever`` (D,) [m/rad].
    """
    length = np.abs(np.diff(path, axis=0)) @ lever
    start = np.append(0.0, np.cumsum(length))
    path_length = start[:-1][samples.move] + samples.fraction * length[samples.move]
    end_distance = np.minimum(path_length, start[-1] - path_length)
    return np.asarray(
        np.minimum(
            EXTRA_MARGIN_M, EXTRA_MARGIN_FRACTION * max(end_margin, 0.0) + EXTRA_MARGIN_SLOPE * end_distance
        )
    )


def _evaluate(
    path: FloatArray, extra_samples: PathSamples, task: ShortcutTask, weight: FloatArray, end_margin: float
) -> _EvaluatedPath:
    """Evaluate a path at evenly spaced samples of its lines, at its corners and at ``extra_samples``.

    Args:
        path: (M, D) waypoints.
        extra_samples: Points that final checks found blocked.
        task: Environment.
        weight: (D,) weight of each coordinate, as for :func:`_path_cost`.
        end_margin: Smallest margin [m] at the ends of the path.
    """
    length = np.abs(np.diff(path, axis=0)) @ task.lever
    spacing = max(SAMPLE_SPACING_M, float(length.sum()) / MAX_SAMPLES)
    count = np.maximum(np.ceil(length / spacing), 2.0).astype(np.intp)
    move = np.repeat(np.arange(len(count)), count)
    fraction = np.concatenate([(np.arange(n) + 0.5) / n for n in count.tolist()])
    corner = np.arange(len(count) - 1)
    samples = (
        PathSamples(move, fraction)
        .extended(PathSamples(corner, np.ones(len(corner))))
        .extended(extra_samples)
    )
    margins = task.margins(samples.points(path), EXTRA_MARGIN_M)
    deficits = _required_margin(path, samples, task.lever, end_margin)[margins.row] - margins.margin
    deficient = np.flatnonzero(deficits > 0.0)
    margins = ClearanceMargins(margins.row[deficient], margins.margin[deficient], margins.slope[deficient])
    deficits = deficits[deficient]
    max_deficits = np.zeros(len(count))  # of each line
    np.maximum.at(max_deficits, samples.move[margins.row], deficits)
    merit = _path_cost(path, weight) + MARGIN_PENALTY * float(max_deficits.sum())
    return _EvaluatedPath(
        path, samples, margins, merit, float(deficits.max(initial=0.0)), end_margin, task.lever
    )


@dataclasses.dataclass(frozen=True)
class _StoppingCriteria:
    """Criteria by which the optimisation of corners ends before it converges.

    Attributes:
        max_rounds: Maximum number of quadratic programs.
        sufficient_travel: Travel [rad] at which it ends as soon as the path has margin; None to continue.
        hoped_travel: Travel [rad] above which it ends if the deficit of margin stays large; None to continue.
    """

    max_rounds: int
    sufficient_travel: float | None
    hoped_travel: float | None


def _optimise_corners(
    path: FloatArray,
    extra_samples: PathSamples,
    task: ShortcutTask,
    program: SolverInterface,
    stopping: _StoppingCriteria,
) -> FloatArray:
    """Minimise cost and missing margin over the corners, starting from the path.

    If a step does not reduce the merit, the rows of its path are added to the next program, linearised at
    that rejected path. With rows of the current path only, the program would return the same path again.
    """
    sufficient_travel, hoped_travel = stopping.sufficient_travel, stopping.hoped_travel
    weight = task.lever / task.lever.max()
    # smallest margin at the two ends, which do not move
    end_margin = float(task.margins(path[[0, -1]], QUERY_DISTANCE_M).margin.min(initial=np.inf))
    best = _evaluate(path, extra_samples, task, weight, end_margin)
    trust, rejected_count = INITIAL_TRUST_RAD, 0
    rows: _ProgramRows | None = None
    for number in range(stopping.max_rounds):
        is_too_long = hoped_travel is not None and path_travel(best.path) > hoped_travel
        if is_too_long and number >= MIN_PROMISING_ROUNDS and best.max_deficit > MAX_PROMISING_DEFICIT_M:
            break
        has_margin = best.max_deficit <= 0.0
        if sufficient_travel is not None and has_margin and path_travel(best.path) <= sufficient_travel:
            break
        if rows is None:
            rows = best.program_rows(task.margins(best.samples.points(best.path), QUERY_DISTANCE_M))
        moved = _solve_step(best.path, rows, task, weight, trust, program)
        if moved is None:
            break
        tried = _evaluate(moved, extra_samples, task, weight, end_margin)
        gain = best.merit - tried.merit
        if gain > 0.0:
            is_last = gain < MIN_GAIN_FRACTION * best.merit
            best, rows, rejected_count = tried, None, 0
            if is_last:
                break
        else:
            rows = rows.extended(tried.program_rows(tried.margins))
            rejected_count += 1
            trust *= 0.5 if rejected_count % 2 == 0 else 1.0
            if trust < MIN_TRUST_RAD:
                break
    return best.path


def _solve_step(
    path: FloatArray,
    rows: _ProgramRows,
    task: ShortcutTask,
    weight: FloatArray,
    trust: float,
    program: SolverInterface,
) -> FloatArray | None:
    """Solve one quadratic program linearised at the path.

    Returns the new path, or None if it has no solution.

    Unknowns: the inner corners x, for each line the travel t >= |step| of each coordinate, and for each line
    the largest missing margin s >= 0 on it. The first program has few rows. Rows that the solution violates
    are added until it keeps all.
    """
    # minimise sum(t) + e n |W (D x + fixed)|^2 + p sum(s), subject to -t <= D x + fixed <= t,
    # slope x + s[move] >= lower, x within the trust region and the bounds
    lines, width = len(path) - 1, path.shape[1]
    inner_count = (lines - 1) * width
    steps = sparse.kron(sparse.diags([1.0, -1.0], [0, -1], shape=(lines, lines - 1)), sparse.eye(width))
    fixed = np.zeros((lines, width))
    fixed[0], fixed[-1] = fixed[0] - path[0], fixed[-1] + path[-1]
    travel_identity, no_margin = sparse.eye(lines * width), sparse.csc_matrix((lines * width, lines))
    square = sparse.diags(np.tile(weight**2, lines))
    quadratic_cost = (2.0 * EVENNESS_WEIGHT * lines * (steps.T @ square @ steps)).toarray()
    linear_cost = 2.0 * EVENNESS_WEIGHT * lines * (steps.T @ square @ fixed.ravel())
    lower = np.maximum(path[1:-1] - trust, np.minimum(task.lower, path[1:-1])).ravel()
    upper = np.minimum(path[1:-1] + trust, np.maximum(task.upper, path[1:-1])).ravel()
    is_active = rows.deficit(path[1:-1].ravel()) > -INITIAL_ROW_MARGIN_M
    while True:
        active = np.flatnonzero(is_active)
        by_line = (np.ones(len(active)), (np.arange(len(active)), rows.move[active]))
        blocks: list[list[Any]] = [
            [-steps, travel_identity, no_margin],
            [steps, travel_identity, no_margin],
            [
                rows.slope[active],
                sparse.csc_matrix((len(active), lines * width)),
                sparse.csc_matrix(by_line, shape=(len(active), lines)),
            ],
        ]
        lower_bounds = np.concatenate([fixed.ravel(), -fixed.ravel(), rows.lower[active]])
        problem = MathematicalProgram()
        unknown = problem.NewContinuousVariables(inner_count + lines * width + lines)
        matrix = sparse.bmat(blocks, format="csc")
        problem.AddLinearConstraint(matrix, lower_bounds, np.full(len(lower_bounds), np.inf), unknown)
        problem.AddBoundingBoxConstraint(lower, upper, unknown[:inner_count])
        problem.AddBoundingBoxConstraint(0.0, np.inf, unknown[inner_count:])
        problem.AddQuadraticCost(quadratic_cost, linear_cost, unknown[:inner_count], is_convex=True)
        problem.AddLinearCost(np.ones(lines * width), unknown[inner_count : inner_count + lines * width])
        problem.AddLinearCost(np.full(lines, MARGIN_PENALTY), unknown[inner_count + lines * width :])
        result = program.Solve(problem)
        if not result.is_success():
            return None
        x = np.clip(result.GetSolution(unknown[:inner_count]), lower, upper)
        violation = rows.deficit(x) - result.GetSolution(unknown[inner_count + lines * width :])[rows.move]
        if not np.any(~is_active & (violation > ROW_TOLERANCE_M)):
            break
        is_active |= violation > -ADDED_ROW_MARGIN_M
    out = path.copy()
    out[1:-1] = x.reshape(lines - 1, width)
    return out
