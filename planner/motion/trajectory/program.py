"""Trajectory optimisation by sequential quadratic programming (SQP) with Drake's ``MathematicalProgram``.

It starts from the result of :mod:`planner.motion.trajectory.trajopt` (the banded optimisation).

Each round is a convex quadratic program over the freedoms of all targets, solved by Clarabel or OSQP. Its
cost is that of :mod:`planner.motion.trajectory.trajopt` without obstacles, in Gauss-Newton form, with the
Jacobians of Drake's plant. Constraints replace the penalties of the banded form: every clearance, the margins
to joint limits and singularities, the peaks of joint acceleration and jerk, and for coupled tools (a wire)
the deviation of their relative pose between targets. At targets the relative pose is exact, because only the
freedoms can change. Joints follow by closed-form inverse kinematics in every trial step.

The result is a path of lower cost that keeps all limits that the seed keeps, or the reason why there is none.
The work is bounded by the number of rounds and of distance queries.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram, OsqpSolver, SolverInterface

from planner.cell.plant import CellModel, drake_log_suppressed
from planner.geometry.arrays import BoolArray, FloatArray, interpolate, inverse, log_pose
from planner.motion.planning_scene import Scene
from planner.motion.search.reach import is_sampled_as_slide
from planner.motion.trajectory.differences import DifferenceBand, difference_bands
from planner.motion.trajectory.hinge_costs import ClearancePenalty, HingeResiduals, narrow_margins
from planner.motion.trajectory.linear_rows import LinearConstraints, add_cost
from planner.motion.trajectory.trajopt import OptimisedPath, PathProblem
from planner.motion.trajectory.windows import Windows
from planner.targets import TableFreedom, Targets

MAX_TARGETS: Final = 1000
"""Number of targets above which the program changes only some windows of the path
(:mod:`planner.motion.trajectory.windows`).
"""
MIN_TARGETS: Final = 3
"""Minimum number of targets. With fewer there is no acceleration."""
MAX_ROUNDS: Final = 6
"""Maximum number of quadratic programs."""
MIN_GAIN_FRACTION: Final = 3e-3
"""Relative gain of a round below which it is the last."""
MIN_STEP_FRACTION: Final = 0.1
"""Minimum fraction of the program's step down to which it is halved."""

TRUST_FRACTION: Final = 0.3
"""Maximum change of a slide or table in a round, as a fraction of its range."""
TRUST_RAD: Final = 0.3
"""Maximum change [rad] of a rotation in a round."""
EXTRA_CLEARANCE_M: Final = 0.5e-3
"""Extra clearance [m] kept at targets (or the present distance if that is less), because moves between
targets are curved.
"""
MAX_PEAK_RATIO: Final = 1.02
"""Maximum ratio of the peaks of acceleration and jerk to those of the seed, each path on its own clock."""
MAX_TRIAL_PEAK_RATIO: Final = 1.01
"""Maximum ratio of the peaks of a trial step to those of the seed, on the seed's clock. It exceeds 1 because
the programs constrain linearised peaks.
"""
MIN_COUPLING_DEVIATION: Final = 1e-6
"""Deviation [m, rad] of the relative pose of coupled tools between targets that is always allowed."""
POSITION_TOLERANCE_M: Final = 1e-12
"""Maximum position error [m] of TCPs."""
DIFFERENCE_FRACTION: Final = 0.01
"""Step of central differences, as a fraction of the change of a freedom in a round."""
MAX_COST_ENTRY: Final = 2e3
"""Largest entry of the scaled cost matrix. Clarabel ended early with entries a hundred times as large."""
PRICE_FACTOR: Final = 0.1
"""Factor by which the price of peaks in windows is multiplied after each program whose step is rejected. The
first price is the cost of the joints that freedoms move in the windows.
"""
MIN_PRICE_FRACTION: Final = 1e-4
"""Minimum price, as a fraction of the first one."""
SOLVER_TYPES: Final = (ClarabelSolver, OsqpSolver)
"""Solvers of the quadratic programs: the first one that this build of Drake has and that solves one is
used.
"""


@dataclasses.dataclass(frozen=True)
class ProgramResult:
    """Result of the program.

    Attributes:
        path: The improved path, or None.
        reason: Why there is no improved path; empty if there is one.
        solver: Name of the solver of the last round.
        rounds: Number of rounds.
        query_count: Number of targets whose distances were queried.
    """

    path: OptimisedPath | None
    reason: str
    solver: str = ""
    rounds: int = 0
    query_count: int = 0


def available_solvers() -> list[SolverInterface]:
    """Return the solvers of :data:`SOLVER_TYPES` that this build of Drake has, in the order of preference."""
    return [solver for solver in (kind() for kind in SOLVER_TYPES) if solver.available() and solver.enabled()]


def solver_name(kind: type) -> str:
    """Return the name of a solver for users, such as "Clarabel"."""
    return kind.__name__.removesuffix("Solver")


@dataclasses.dataclass(frozen=True)
class ProgramSeed:
    """Path from which the program starts, on its clock.

    Attributes:
        branch: {arm: branch}.
        path: The path, over N targets.
        duration: (N - 1,) [s] durations of the moves.
        stop: (N,) whether the arms stop at a target.
    """

    branch: Mapping[str, int]
    path: OptimisedPath
    duration: FloatArray
    stop: BoolArray


def optimise_program(
    scene: Scene,
    targets: Targets,
    seed: ProgramSeed,
    penalty: ClearancePenalty,
    budget: int,
    windows: Windows | None = None,
) -> ProgramResult:
    """Find a path of lower cost than the seed on the same branches.

    The first and the last target stay as they are, because approach and retreat end there. The caller has to
    check moves between targets. With ``windows`` of a longer path, ``targets``, ``seed.path`` and the result
    cover the targets of the windows only. The windows contain the accelerations and jerks on the clock of the
    whole path, so the clock of the seed is not used.

    Args:
        scene: Cell with a collision model.
        targets: N targets.
        seed: Path to start from.
        penalty: Measures distances between bodies.
        budget: Maximum number of targets whose distances are queried before the last round.
        windows: Windows of a longer path; None to change all targets.
    """
    if scene.model is None or not targets.freedoms or targets.count < MIN_TARGETS:
        return ProgramResult(path=None, reason="no target has a freedom, or there are too few targets")
    available = available_solvers()
    if not available:
        return ProgramResult(path=None, reason="this build of Drake has no solver for it")
    bands = difference_bands(seed.duration, seed.stop) if windows is None else windows.bands
    weights = None if windows is None else windows.weights
    problem = PathProblem(scene, targets, seed.branch, obstacles=None, weights=weights)
    search = _ProgramSearch(problem, scene.model, seed.path, bands, penalty, windows)
    return search.run(available, budget)


@dataclasses.dataclass(frozen=True)
class _PathEvaluation:
    """Evaluation of a path.

    Attributes:
        cost: Cost of the path.
        near_distances: Small distances between bodies [m], with derivatives by the joints.
        distances: (N,) [m] smallest distance at each target, inf if bodies are far apart.
        peaks: Peaks (J,) of the accelerations and of the jerks of each joint.
        coupling_deviation: (N - 1, 6) [rad, m] deviation of the relative pose of coupled tools half way
            between targets.
    """

    cost: float
    near_distances: HingeResiduals
    distances: FloatArray
    peaks: tuple[FloatArray, ...]
    coupling_deviation: FloatArray


class _ProgramSearch:
    """Improves a path by a sequence of quadratic programs."""

    def __init__(
        self,
        problem: PathProblem,
        model: CellModel,
        seed: OptimisedPath,
        bands: tuple[DifferenceBand, ...],
        penalty: ClearancePenalty,
        windows: Windows | None = None,
    ) -> None:
        """Evaluate the seed, and derive from it the limits that an improved path has to keep.

        Args:
            problem: Cost and joints of paths over the targets, with the weights of the windows if there are
                any.
            model: Collision model.
            seed: Path to start from.
            bands: Accelerations and jerks on the clock of the seed.
            penalty: Measures distances.
            windows: Windows of a longer path.
        """
        scene, targets = problem.scene, problem.targets
        self.scene, self.model, self.targets, self.penalty = scene, model, targets, penalty
        self.windows = windows
        self.problem = problem
        self.values = self.problem.unwrap(seed.values)
        self.joints = self.problem.stack(seed.q)
        self.initial_queries = penalty.query_count
        self.bands = bands
        self.held = np.zeros(targets.count, dtype=np.bool_) if windows is None else windows.held.copy()
        self.held[[0, -1]] = True  # approach and retreat end there
        self.evaluation = self._evaluate(self.values, self.joints)
        # tops: peaks of each joint; price: value of lowering the highest peak in windows from top to goal;
        # fixed_cost: cost of the joints that no freedom moves
        tops, self.price, self.fixed_cost = self.evaluation.peaks, 0.0, 0.0
        if windows is not None:
            tops = windows.tops
            self.fixed_cost = self.problem.smoothness(np.where(windows.moved, 0.0, self.joints))
            self.price = self.evaluation.cost - self.fixed_cost
        self.min_price, self.seed_cost = MIN_PRICE_FRACTION * self.price, self.evaluation.cost
        strength = np.concatenate([scene.chains[arm].robot.acceleration for arm in targets.arms])
        # no joint may exceed the largest peak of any joint, nor the largest fraction of any joint's limit
        self.allowed = [np.minimum(peak.max(), (peak / strength).max() * strength) for peak in tops]
        self.required = np.minimum(scene.settings.clearance + EXTRA_CLEARANCE_M, self.evaluation.distances)
        self.max_coupling_deviation = np.maximum(
            np.abs(self.evaluation.coupling_deviation).max(axis=0, initial=0.0), MIN_COUPLING_DEVIATION
        )
        ranges = [float((f.upper - f.lower).max()) for f in targets.freedoms]
        spans = [
            TRUST_FRACTION * (span or 1.0)
            if is_sampled_as_slide(f)
            else TRUST_RAD  # without range the bounds fix it
            for f, span in zip(targets.freedoms, ranges, strict=True)
        ]
        self.trust = np.array(spans)

    def run(self, ready: Sequence[SolverInterface], budget: int) -> ProgramResult:
        """Solve programs until the gain of a round is small or the budget of distance queries is used up.

        There are at most :data:`MAX_ROUNDS` programs. A rejected step lowers the price of peaks in windows.
        Otherwise the trust region shrinks to the fraction of the step that was taken. ``ready`` are the
        solvers in the order of preference.
        """
        rounds, solver, reason = 0, "", "the banded result cannot be improved"
        while rounds < MAX_ROUNDS and self._query_count() < budget:
            rounds += 1
            step, solver = self._solve(ready)
            if step is None:
                reason = f"{solver} did not solve the program"
                break
            value = self._path_value(self.evaluation.cost, self.joints)
            step_fraction = self._advance(step)
            gain = value - self._path_value(self.evaluation.cost, self.joints)
            if step_fraction > 0.0 and (gain < MIN_GAIN_FRACTION * value or self._has_no_peaks()):
                break
            if step_fraction == 0.0 and self.price > self.min_price:
                self.price *= PRICE_FACTOR
                continue
            self.trust = self.trust * (1.0 if step_fraction == 1.0 else max(step_fraction, MIN_STEP_FRACTION))
        query_count = self._query_count()
        if not self.evaluation.cost < self.seed_cost:
            return ProgramResult(None, reason, solver, rounds, query_count)
        q = self.problem.split(self.joints)
        if not self._reaches_poses(q):
            reason = f"poses deviate by more than {POSITION_TOLERANCE_M} m"
            return ProgramResult(None, reason, solver, rounds, query_count)
        path = OptimisedPath(self.values, q, self.evaluation.cost, self.seed_cost, rounds)
        return ProgramResult(path, "", solver, rounds, query_count)

    def _query_count(self) -> int:
        """Return the number of targets whose distances this search has queried so far."""
        return self.penalty.query_count - self.initial_queries

    def _evaluate(self, values: FloatArray, joints: FloatArray) -> _PathEvaluation:
        """Evaluate a path, given by values (N, F) of its freedoms and its joints (N, J)."""
        near_distances = self.penalty.near_distances(joints)
        smallest = np.full(len(joints), np.inf)
        np.minimum.at(smallest, near_distances.index, near_distances.value)
        peaks = tuple(np.abs(band.differences(joints)).max(axis=0, initial=0.0) for band in self.bands)
        return _PathEvaluation(
            self.problem.cost(values, joints),
            near_distances,
            smallest,
            peaks,
            self._coupling_deviation(values),
        )

    def _advance(self, step: FloatArray) -> float:
        """Take the largest fraction of a step (N, F) that keeps all limits and improves the path.

        The step is halved until it does. In windows only the whole step is tried while the price of peaks can
        be lowered. Returns the fraction, 0 if no step was taken.
        """
        fraction, min_fraction = 1.0, 0.5 if self.price > self.min_price else MIN_STEP_FRACTION
        while fraction > min_fraction:
            values = self.problem.clip(self.values + fraction * step)
            joints = self.problem.joints(values, self.joints)
            if joints is not None and self._is_improvement(values, joints):
                evaluation = self._evaluate(values, joints)
                if self._keeps_limits(evaluation):
                    self.values, self.joints, self.evaluation = values, joints, evaluation
                    return fraction
            fraction *= 0.5
        return 0.0

    def _path_value(self, cost: float, joints: FloatArray) -> float:
        """Return the value that the search lowers, given the cost of a path and its joints (N, J).

        Without windows it is the cost. With windows it is the part of the cost that can change, plus the
        price of the peaks.
        """
        if self.windows is None:
            return cost
        return cost - self.fixed_cost + self.price * sum(self.windows.peak_levels(joints))

    def _is_improvement(self, values: FloatArray, joints: FloatArray) -> bool:
        """Whether a path has a lower value than the current one and a lower cost than the seed."""
        cost = self.problem.cost(values, joints)
        return cost < self.seed_cost and self._path_value(cost, joints) < self._path_value(
            self.evaluation.cost, self.joints
        )

    def _has_no_peaks(self) -> bool:
        """Whether the windows have no peak left that could be lowered, so programs hardly change them."""
        return self.windows is not None and not any(self.windows.peak_levels(self.joints))

    def _keeps_limits(self, evaluation: _PathEvaluation) -> bool:
        """Whether a path keeps clearance, the peaks of the seed, and the coupling of tools, with tolerances.

        Half of the extra clearance may be used up, because the programs constrain linearised distances.
        """
        required = np.minimum(self.required, self.scene.settings.clearance + 0.5 * EXTRA_CLEARANCE_M)
        peaks = zip(evaluation.peaks, self.allowed, strict=True)
        return bool(
            (evaluation.distances >= required).all()
            and all((peak <= MAX_TRIAL_PEAK_RATIO * limit).all() for peak, limit in peaks)
            and (
                np.abs(evaluation.coupling_deviation) <= MAX_TRIAL_PEAK_RATIO * self.max_coupling_deviation
            ).all()
        )

    def _reaches_poses(self, q: Mapping[str, FloatArray]) -> bool:
        """Whether the joints reach the TCP poses that the freedoms define."""
        expected = self.scene.tcp_poses(self.targets, self.values)
        actual = {arm: self.scene.chains[arm].pose(q[arm]) for arm in q}
        return all(
            float(np.abs(actual[arm] - expected[arm])[:, :3, 3].max()) <= POSITION_TOLERANCE_M for arm in q
        )

    def _solve(self, available: Sequence[SolverInterface]) -> tuple[FloatArray | None, str]:
        """Solve the next program by the first solver that succeeds.

        Returns the step (N, F) of the freedoms and the name of the solver; None and the name of the last
        solver if none succeeds.
        """
        program, unknowns = self._build_program()
        name = ""
        for solver in available:
            name = solver_name(type(solver))
            with drake_log_suppressed():
                solution = solver.Solve(program)
            step = np.asarray(solution.GetSolution(unknowns.ravel())).reshape(unknowns.shape)
            if solution.is_success() and np.isfinite(step).all():
                step[self.held] = 0.0  # solvers meet bounds to a tolerance
                return step * self.trust, name
        return None, name

    def _build_program(self) -> tuple[MathematicalProgram, Any]:
        """Build the program of the next step.

        Returns the program and its unknowns (N, F): steps of the freedoms in units of the change that a round
        allows.
        """
        # Minimise x' H x + 2 g' x + price * sum of levels, with H block-pentadiagonal, over the steps
        # x = step / trust in [-1, 1] and levels in [0, 1], subject to (linear in x) ranges of the freedoms,
        # distances and margins, peaks of joint acceleration and jerk, and coupling of tools. In windows also
        # |difference| <= goal + level (top - goal).
        problem, values, joints = self.problem, self.values, self.joints
        rates = problem.plant_rates(self.model, values, joints)
        blocks, slope = problem.quadratic_model(values, joints, rates)
        program = MathematicalProgram()
        unknowns = program.NewContinuousVariables(*values.shape, "step")
        blocks = [block * self.trust[:, None] * self.trust for block in blocks]
        unit = MAX_COST_ENTRY / (float(np.abs(blocks[0]).max()) or 1.0)
        blocks, slope = [unit * block for block in blocks], unit * slope * self.trust
        add_cost(program, unknowns, blocks, slope)
        low, high = (problem.lower - values) / self.trust, (problem.upper - values) / self.trust
        low, high = np.clip(low, -1.0, 0.0), np.clip(high, 0.0, 1.0)
        low[self.held] = high[self.held] = 0.0
        flat = unknowns.ravel()
        program.AddBoundingBoxConstraint(low.ravel(), high.ravel(), flat)
        levels = 0 if self.windows is None else len(self.bands)
        rows = LinearConstraints(values.shape, levels)
        self._add_distances(rows, rates)
        for band, limit in zip(self.bands, self.allowed, strict=True):
            rows.add_band(band, joints, rates, limit)
        self._add_coupling(rows)
        if self.windows is not None:
            level_variables = program.NewContinuousVariables(levels, "level")
            program.AddBoundingBoxConstraint(0.0, 1.0, level_variables)
            program.AddLinearCost(np.full(levels, unit * self.price), level_variables)
            for level, (band, bound) in enumerate(zip(self.bands, self.windows.peak_bounds, strict=True)):
                rows.add_level(band, joints, rates, bound, level)
            flat = np.concatenate([flat, level_variables])
        if rows.count:
            matrix, lower, upper = rows.assemble(self.trust)
            if len(lower):
                program.AddLinearConstraint(matrix, lower, upper, flat)
        return program, unknowns

    def _add_distances(self, rows: LinearConstraints, rates: FloatArray) -> None:
        """Add rows for small distances between bodies and for narrow margins to limits and singularities.

        ``rates`` (N, J, F) are the derivatives of the joints by the freedoms.
        """
        near_distances = self.evaluation.near_distances
        rows.add_lower_bounds(
            near_distances, rates, np.minimum(self.required[near_distances.index] - near_distances.value, 0.0)
        )
        for margins, hard, _ in narrow_margins(self.scene, self.targets.arms, self.joints):
            rows.add_lower_bounds(margins, rates, np.minimum(hard - margins.value, 0.0))

    def _coupling_deviation(self, values: FloatArray) -> FloatArray:
        """Compute the deviation (N - 1, 6) [rad, m] of the relative pose of coupled tools between targets.

        It is evaluated half way between targets, relative to the pose with the mean of the freedoms at both
        targets. It is 0 if no freedom changes the relative pose.
        """
        if not _is_coupled(self.targets):
            return np.zeros((self.targets.count - 1, 6))
        deviation = _coupling_deviation(self.targets, values[:-1], values[1:])
        if self.windows is not None:
            deviation[np.diff(self.windows.rows) > 1] = 0.0  # a gap between windows is not a move
        return deviation

    def _add_coupling(self, rows: LinearConstraints) -> None:
        """Add rows that bound the deviation of the relative pose of coupled tools between targets.

        The derivatives by the freedoms at both ends of each move are central differences.
        """
        if not _is_coupled(self.targets):
            return
        current, ends = self.evaluation.coupling_deviation, (self.values[:-1], self.values[1:])
        slopes = np.zeros((2, *current.shape, self.values.shape[1]))
        for j, step in enumerate(DIFFERENCE_FRACTION * self.trust):
            shift = np.zeros(self.values.shape[1])
            shift[j] = step
            for side, (shift_start, shift_end) in enumerate(((shift, 0.0 * shift), (0.0 * shift, shift))):
                plus = _coupling_deviation(self.targets, ends[0] + shift_start, ends[1] + shift_end)
                minus = _coupling_deviation(self.targets, ends[0] - shift_start, ends[1] - shift_end)
                slopes[side, ..., j] = (plus - minus) / (2.0 * step)
        rows.add_pairs(slopes, -self.max_coupling_deviation - current, self.max_coupling_deviation - current)


def _is_coupled(targets: Targets) -> bool:
    """Whether a freedom changes the relative pose of two coupled tools."""
    return targets.coupled and any(isinstance(f, TableFreedom) for f in targets.freedoms)


def _coupling_deviation(targets: Targets, start: FloatArray, end: FloatArray) -> FloatArray:
    """Compute the deviation (N - 1, 6) [rad, m] of the relative pose of coupled tools between targets.

    It is evaluated half way between the targets. It is relative to the pose with the mean of the freedoms at
    both targets.

    Args:
        targets: N targets.
        start: (N - 1, F) values of the freedoms at the start of each move.
        end: (N - 1, F) values of the freedoms at the end of each move.
    """
    first_arm, second_arm = targets.arms[0], targets.arms[-1]
    start_index, end_index = np.arange(targets.count - 1), np.arange(1, targets.count)
    half, mean = np.full(targets.count - 1, 0.5), 0.5 * (start + end)

    def relative_pose(start_values: FloatArray, end_values: FloatArray) -> FloatArray:
        """Return the pose (N - 1, 4, 4) of the second tool in the frame of the first, half way."""
        start_poses = targets.poses(start_values, start_index)
        end_poses = targets.poses(end_values, end_index)
        middle = {arm: interpolate(start_poses[arm], end_poses[arm], half) for arm in (first_arm, second_arm)}
        return inverse(middle[first_arm]) @ middle[second_arm]

    return log_pose(inverse(relative_pose(mean, mean)) @ relative_pose(start, end))
