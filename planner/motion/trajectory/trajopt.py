"""Trajectory optimisation with the freedoms as the only variables.

Poses remain exact, because joints follow from the freedoms by closed-form inverse kinematics on the chosen
branch in every trial step. The cost is smooth joint motion plus hinges (limits, singularities, clearance,
preferred values). Gauss-Newton steps on it are a banded system, because a target couples only to its two
neighbours on either side:

    (J' K J + sum of hinge slopes' slopes + damping) step = -gradient / 2, K pentadiagonal.

If a smoother path is too close to a body, the caller narrows the freedoms to a corridor around the path from
which it started (:func:`narrow_freedoms`).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final, Protocol

import numpy as np
from scipy.linalg import solveh_banded

from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, inverse, log_pose
from planner.motion.planning_scene import Scene
from planner.motion.search.layered_graph_search import speed_limits
from planner.motion.search.reach import is_full_turn, is_sampled_as_slide
from planner.motion.trajectory.hinge_costs import HingeResiduals, margin_residuals, preference_residuals
from planner.targets import Freedom, JointFreedom, ScrewFreedom, Targets

CURVATURE_WEIGHT: Final = 64.0
"""Weight of second differences relative to first ones. It spreads changes over about eight targets, because
64 = 8^2.
"""

MAX_ITERATIONS: Final = 30
"""Maximum number of steps of the optimisation."""
MIN_GAIN_FRACTION: Final = 3e-3
"""Relative gain of a step below which it is the last. A step whose expected gain is less than a tenth of this
is not taken.
"""
MIN_EXPECTED_GAIN_FRACTION: Final = 0.02
"""Relative expected gain below which a failed step is the last, once there is a gain."""

MAX_BOUND_ROUNDS: Final = 4
"""Maximum number of rounds in which values at their bounds are found and fixed."""
DIFFERENCE_STEP: Final = 1e-4
"""Step [rad or m] of central differences of a freedom."""
_ANGULAR, _LINEAR = slice(0, 3), slice(3, 6)  # angular and linear part of a twist


Blocks = list[FloatArray]
"""A symmetric block-banded matrix: blocks (N - d, F, F) of targets i and i + d, for d = 0, 1, 2."""


class Obstacles(Protocol):
    """Penalty for small clearances. :mod:`planner.motion.trajectory.hinge_costs` implements it."""

    def rows(self, q: FloatArray) -> Sequence[HingeResiduals]:
        """Return the residuals at joints (N, J)."""

    def cost(self, q: FloatArray) -> float:
        """Return the sum of the squared residuals at joints (N, J)."""


@dataclasses.dataclass(frozen=True)
class OptimisedPath:
    """An optimised path.

    Attributes:
        values: (N, F) values of the freedoms.
        q: {arm: (N, J)} [rad] joints.
        cost: Cost of the path.
        cost_before: Cost of the path from which the optimisation started.
        iterations: Number of steps of the optimisation.
    """

    values: FloatArray
    q: dict[str, FloatArray]
    cost: float
    cost_before: float
    iterations: int

    def select(self, rows: IndexArray) -> "OptimisedPath":
        """Return the path at the targets ``rows`` (K,); costs are unchanged."""
        return dataclasses.replace(
            self, values=self.values[rows], q={arm: angles[rows] for arm, angles in self.q.items()}
        )


def optimise_path(
    scene: Scene,
    targets: Targets,
    branch: Mapping[str, int],
    values: FloatArray,
    q: Mapping[str, FloatArray],
    obstacles: Obstacles | None = None,
) -> OptimisedPath:
    """Lower the cost of a path by changing the freedoms of its targets.

    Each step is a damped Gauss-Newton step (Levenberg-Marquardt), halved until the exact cost falls.

    Args:
        scene: Cell with the arms.
        targets: N targets.
        branch: {arm: branch}.
        values: (N, F) values of the freedoms.
        q: {arm: (N, J)} [rad] joints.
        obstacles: Penalty for small clearances; None to ignore clearance.

    Returns:
        The path, which is the given one if no step lowers the cost.
    """
    problem = PathProblem(scene, targets, branch, obstacles)
    values = problem.unwrap(values)
    joints = problem.stack(q)
    start = cost = problem.cost(values, joints)
    damping, count = 1e-6, 0  # damping is relative to the largest diagonal entry
    while count < MAX_ITERATIONS and values.size:
        count += 1
        step, expected = problem.step(values, joints, damping)
        if not expected > MIN_GAIN_FRACTION * 0.1 * cost:
            break
        # line search: halve the step until the exact cost falls
        step_fraction, is_accepted = 1.0, False
        while step_fraction > 0.05:  # down to 1/16
            trial = problem.clip(values + step_fraction * step)
            trial_joints = problem.joints(trial, joints)
            trial_cost = problem.cost(trial, trial_joints, cost) if trial_joints is not None else np.inf
            if trial_joints is not None and trial_cost < cost:
                is_accepted = True
                break
            step_fraction *= 0.5
        # a step that fails is repeated with more damping; a whole step that succeeds allows less
        if not is_accepted or trial_joints is None:
            damping *= 30.0
            # give up with hardly any step left, or if little more can be gained
            if damping > 1e3 or (cost < start and expected < MIN_EXPECTED_GAIN_FRACTION * cost):
                break
            continue
        gain = cost - trial_cost
        values, joints, cost = trial, trial_joints, trial_cost
        damping = max(damping * (0.1 if step_fraction == 1.0 else 1.0), 1e-9)
        if gain < MIN_GAIN_FRACTION * cost:
            break
    return OptimisedPath(values, problem.split(joints), cost, start, count)


def path_cost(
    scene: Scene,
    targets: Targets,
    values: FloatArray,
    q: Mapping[str, FloatArray],
    obstacles: Obstacles | None = None,
) -> float:
    """Return the cost of a path, as in :func:`optimise_path`.

    Args:
        scene: Cell with the arms.
        targets: N targets.
        values: (N, F) values of the freedoms.
        q: {arm: (N, J)} [rad] joints.
        obstacles: Penalty for small clearances; None to ignore clearance.
    """
    problem = PathProblem(scene, targets, {}, obstacles)
    return problem.cost(problem.unwrap(values), problem.stack(q))


class PathProblem:
    """Cost, exact joints and derivatives of paths over the freedoms of targets, on fixed branches.

    Attributes:
        columns: {arm: columns of its joints in arrays of all J joints}.
        speed: (J,) [rad/s] joint speed limits.
        stencil: Diagonals of K in the cost of motion, as in :class:`CostWeights`.
        count: Number of targets of the whole path.
        is_full_turn: (F,) whether each freedom is a full turn.
        lower: (N, F) lower bounds of the freedoms, -inf for full turns.
        upper: (N, F) upper bounds of the freedoms, inf for full turns.
    """

    def __init__(
        self,
        scene: Scene,
        targets: Targets,
        branch: Mapping[str, int],
        obstacles: Obstacles | None,
        weights: "CostWeights | None" = None,
    ) -> None:
        """Prepare the problem.

        Args:
            scene: Cell with the arms.
            targets: N targets.
            branch: {arm: branch}.
            obstacles: Penalty for small clearances; None to ignore clearance.
            weights: Weights of the cost if the targets are part of a longer path; None for those of a path of
                these targets.
        """
        self.scene, self.targets, self.branch, self.obstacles = scene, targets, branch, obstacles
        self.columns = scene.columns(targets.arms)
        self.speed = np.concatenate([speed_limits(scene, arm) for arm in targets.arms])
        weights = cost_weights(targets) if weights is None else weights
        self.stencil, self.count = weights.stencil, weights.count
        self.is_full_turn = np.array([is_full_turn(f) for f in targets.freedoms], dtype=bool)
        bounds = [(f.lower, f.upper) for f in targets.freedoms]
        shape = (targets.count, len(bounds))
        self.lower = np.stack([b[0] for b in bounds], axis=1) if bounds else np.zeros(shape)
        self.upper = np.stack([b[1] for b in bounds], axis=1) if bounds else np.zeros(shape)
        self.lower[:, self.is_full_turn], self.upper[:, self.is_full_turn] = -np.inf, np.inf

    def stack(self, q: Mapping[str, FloatArray]) -> FloatArray:
        """Return the joints {arm: (..., K)} side by side, (..., J)."""
        return np.concatenate([q[arm] for arm in self.targets.arms], axis=-1)

    def split(self, joints: FloatArray) -> dict[str, FloatArray]:
        """Return joints (..., J) by arm; the inverse of :meth:`stack`."""
        return {arm: joints[..., part].copy() for arm, part in self.columns.items()}

    def clip(self, values: FloatArray) -> FloatArray:
        """Return values of the freedoms (N, F) clipped to their ranges; full turns are unbounded."""
        return np.clip(values, self.lower, self.upper)

    def unwrap(self, values: FloatArray) -> FloatArray:
        """Return values of the freedoms (N, F) without jumps by 2 pi in full turns."""
        out = values.copy()
        out[:, self.is_full_turn] = np.unwrap(values[:, self.is_full_turn], axis=0)
        return out

    def joints(self, values: FloatArray, seed: FloatArray) -> FloatArray | None:
        """Compute the exact joints (N, J) on the branches for values (N, F) of the freedoms.

        ``seed`` (N, J) are joints nearby. Returns None if any target loses its branch or a required margin.
        """
        poses = self.scene.tcp_poses(self.targets, values)
        out = []
        for arm, part in self.columns.items():
            chain = self.scene.chains[arm]
            redundant_angle = self.targets.last_joint_angle(arm, values)
            q = chain.on_branch(poses[arm], self.branch[arm], seed[:, part], redundant_angle)
            if chain.limit_margin(q).min() < self.scene.settings.joint_margin - 1e-12:
                return None
            if chain.singularity_margin(q).min() < self.scene.settings.singularity_margin - 1e-12:
                return None
            out.append(q)
        return np.concatenate(out, axis=-1)

    def rates(self, values: FloatArray, joints: FloatArray) -> FloatArray:
        """Compute the derivatives (N, J, F) of the joints by the freedoms, with closed-form Jacobians."""
        twists = self._freedom_twists(values)
        arm_rates = [
            self.scene.chains[arm].joint_rates(joints[:, part], twists[arm])
            for arm, part in self.columns.items()
        ]
        return self._with_joint_freedoms(np.swapaxes(np.concatenate(arm_rates, axis=-1), 1, 2), joints)

    def _with_joint_freedoms(self, rates: FloatArray, joints: FloatArray) -> FloatArray:
        """Set the derivatives (N, J, F) by freedoms that are redundant joints, which move no tool."""
        for j, freedom in enumerate(self.targets.freedoms):
            if isinstance(freedom, JointFreedom):
                part = self.columns[freedom.arm]
                rates[:, part, j] = self.scene.chains[freedom.arm].null_space_rates(joints[:, part])
        return rates

    def plant_rates(self, model: CellModel, values: FloatArray, joints: FloatArray) -> FloatArray:
        """Compute the derivatives (N, J, F) of :meth:`rates` with the Jacobians of Drake's plant."""
        twists, q = self._freedom_twists(values), self.split(joints)
        poses, rate_parts = self.scene.tcp_poses(self.targets, values), []
        for arm, jacobian in model.jacobians(q).items():
            rotation = poses[arm][:, None, :3, :3]
            world_twist = [
                np.einsum("nkij,nkj->nik", rotation, twists[arm][..., part]) for part in (_ANGULAR, _LINEAR)
            ]
            # J dq/dvalue = twist in world axes, the body twist rotated by the TCP
            arm_rates = np.linalg.solve(jacobian[..., :6], np.concatenate(world_twist, axis=1))
            chain = self.scene.chains[arm]
            rate_parts.append(
                np.swapaxes(chain.with_fixed_last(np.swapaxes(arm_rates, 1, 2)), 1, 2)
                if chain.is_redundant
                else arm_rates
            )
        return self._with_joint_freedoms(np.concatenate(rate_parts, axis=1), joints)

    def _freedom_twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Compute the twists {arm: (N, F, 6)} of the TCPs, in their own frames, per change of each freedom.

        They are central differences, with the angular part first.
        """
        twists: dict[str, list[FloatArray]] = {arm: [] for arm in self.targets.arms}
        for perturbed in self.targets.perturbed_poses(values, DIFFERENCE_STEP):
            plus, minus = (self.scene.world_poses(self.targets, poses) for poses in perturbed)
            for arm in self.targets.arms:
                # twist = log(T(value - h)^-1 T(value + h)) / 2 h
                twists[arm].append(log_pose(inverse(minus[arm]) @ plus[arm]) / (2.0 * DIFFERENCE_STEP))
        return {arm: np.stack(arm_twists, axis=1) for arm, arm_twists in twists.items()}

    def cost(self, values: FloatArray, joints: FloatArray, limit: float = np.inf) -> float:
        """Return the cost of a path, given by values (N, F) of its freedoms and its joints (N, J).

        Returns inf without evaluating obstacles if the cost without them reaches ``limit``.
        """
        arms, total = self.targets.arms, self.smoothness(joints)
        total += sum(r.cost for r in margin_residuals(self.scene, arms, joints, self.count, slopes=False))
        total += sum(
            r.cost for r in preference_residuals(self.targets, values, self.is_full_turn, self.count)
        )
        if total >= limit:
            return np.inf
        return total + (self.obstacles.cost(joints) if self.obstacles else 0.0)

    def smoothness(self, joints: FloatArray) -> float:
        """Return the cost of the motion of joints (N, J), without margins, preferred values and obstacles.

        It is the sum over joints of x' K x with x = q / speed.
        """
        scaled = joints / self.speed
        return float(np.sum(scaled * _multiply_stencil(self.stencil, scaled)))

    def quadratic_model(
        self, values: FloatArray, joints: FloatArray, rates: FloatArray
    ) -> tuple[Blocks, FloatArray]:
        """Compute the quadratic model of the cost about a path, by Gauss-Newton, without obstacles.

        Args:
            values: (N, F) values of the freedoms.
            joints: (N, J) [rad] joints.
            rates: (N, J, F) as by :meth:`rates`.

        Returns:
            The matrix in blocks and half the gradient (N, F), for steps (N, F) of the freedoms.
        """
        # H = J' K J and g = J' K x with x = q / v, plus s s' and s r for each hinge residual r with slope s
        rows = len(values)
        scaled = rates / self.speed[:, None]
        blocks = [
            self.stencil[d][: rows - d, None, None]
            * np.einsum("njf,njg->nfg", scaled[: rows - d], scaled[d:])
            for d in range(3)
        ]
        gradient = np.einsum("njf,nj->nf", scaled, _multiply_stencil(self.stencil, joints / self.speed))
        for hinge in margin_residuals(self.scene, self.targets.arms, joints, self.count):
            _add_residuals(
                blocks[0], gradient, hinge, np.einsum("rj,rjf->rf", hinge.slope, rates[hinge.index])
            )
        for hinge in preference_residuals(self.targets, values, self.is_full_turn, self.count):
            _add_residuals(blocks[0], gradient, hinge, hinge.slope)
        return blocks, gradient

    def step(self, values: FloatArray, joints: FloatArray, damping: float) -> tuple[FloatArray, float]:
        """Return the Gauss-Newton step (N, F) of the freedoms, and the gain that the quadratic model expects.

        The step starts from ``values`` (N, F) with joints ``joints`` (N, J). ``damping`` is relative to the
        largest diagonal entry of the model's matrix.
        """
        rates = self.rates(values, joints)
        blocks, gradient = self.quadratic_model(values, joints, rates)
        for hinge in self.obstacles.rows(joints) if self.obstacles else ():
            _add_residuals(
                blocks[0], gradient, hinge, np.einsum("rj,rjf->rf", hinge.slope, rates[hinge.index])
            )
        step = self._bounded_step(blocks, gradient, values, damping)
        # model: cost(step) = cost + 2 g.step + step' H step with H step = -g, so it falls by -g.step
        return step, float(-np.sum(step * gradient))

    def _bounded_step(
        self, blocks: Blocks, gradient: FloatArray, values: FloatArray, damping: float
    ) -> FloatArray:
        """Compute the Gauss-Newton step (N, F) within the bounds of the freedoms.

        Values that would leave their bounds are fixed at them, and the step of the others is solved again.

        Args:
            blocks: Matrix of the quadratic model.
            gradient: (N, F) half the gradient of the cost.
            values: (N, F) current values.
            damping: Value that is added to the diagonal of the matrix, relative to its largest entry.
        """
        is_fixed = (self.upper <= self.lower) | ((values <= self.lower) & (gradient > 0))
        is_fixed |= (values >= self.upper) & (gradient < 0)
        fixed_step = np.zeros_like(values)
        step = fixed_step
        for _ in range(MAX_BOUND_ROUNDS):
            # H_ll step_l = -(g + H fixed_step)_l for the values l that are not fixed
            right = np.where(is_fixed, 0.0, gradient + _multiply_blocks(blocks, fixed_step))
            banded = _lower_banded(blocks, is_fixed, damping)
            step = -solveh_banded(banded, right.ravel(), lower=True).reshape(values.shape) + fixed_step
            clipped_step = np.clip(values + step, self.lower, self.upper) - values
            is_outside = ~is_fixed & (np.abs(clipped_step - step) > 1e-12)
            if not is_outside.any():
                break
            is_fixed |= is_outside
            fixed_step = np.where(is_outside, clipped_step, fixed_step)
        return np.clip(values + step, self.lower, self.upper) - values


def _add_residuals(
    diagonal: FloatArray, gradient: FloatArray, hinge: HingeResiduals, slope: FloatArray
) -> None:
    """Add R residuals, with derivatives ``slope`` (R, F) by the freedoms, to a quadratic model in place.

    ``diagonal`` (N, F, F) are its diagonal blocks, ``gradient`` (N, F) is half the gradient.
    """
    np.add.at(diagonal, hinge.index, np.einsum("rf,rg->rfg", slope, slope))
    np.add.at(gradient, hinge.index, slope * hinge.value[:, None])


def _multiply_blocks(blocks: Sequence[FloatArray], x: FloatArray) -> FloatArray:
    """Multiply a symmetric block-banded matrix by x (N, F)."""
    out = np.einsum("nfg,ng->nf", blocks[0], x)
    for d in (1, 2):
        if len(x) > d:
            out[:-d] += np.einsum("nfg,ng->nf", blocks[d], x[d:])
            out[d:] += np.einsum("nfg,nf->ng", blocks[d], x[:-d])
    return np.asarray(out)


def _lower_banded(blocks: Sequence[FloatArray], is_fixed: BoolArray, damping: float) -> FloatArray:
    """Convert a block-banded matrix to the lower banded form of :func:`scipy.linalg.solveh_banded`.

    The matrix is given by its ``blocks`` (:data:`Blocks`), and ``is_fixed`` (N, F) says which variables are
    fixed. Rows and columns of fixed variables (N, F) become those of the identity. ``damping``, relative to
    the largest diagonal entry, is added to the diagonal.
    """
    rows, freedom_count = is_fixed.shape
    width = 3 * freedom_count - 1
    banded = np.zeros((width + 1, rows * freedom_count))
    is_free = ~is_fixed
    # banded[r, c] = H[c + r, c]; freedom f of target n has column n F + f
    for d, block in enumerate(blocks):
        if rows <= d:
            continue
        kept = block * is_free[: rows - d, :, None] * is_free[d:, None, :]
        for f in range(freedom_count):
            for g in range(freedom_count):
                offset = d * freedom_count + g - f
                if offset >= 0:
                    columns = np.arange(rows - d) * freedom_count + f
                    banded[offset, columns] = kept[:, f, g]
    # H + damping max(H_ii) 1; a fixed value keeps a row of the identity
    diagonal = banded[0].reshape(rows, freedom_count)
    scale = float(diagonal.max(initial=1e-12))
    diagonal += damping * scale + 1e-12
    diagonal[is_fixed] = 1.0
    banded[0] = diagonal.ravel()
    return banded


@dataclasses.dataclass(frozen=True)
class CostWeights:
    """Weights of the cost of a path.

    Attributes:
        stencil: Diagonals 0, 1 and 2 of the symmetric pentadiagonal K with q' K q = ``count`` * (sum of
            weighted squares of first and second differences).
        count: Number of targets of the whole path.
    """

    stencil: list[FloatArray]
    count: int


def cost_weights(targets: Targets, rows: IndexArray | None = None) -> CostWeights:
    """Return the weights of the cost of a path of all targets, or of some of them.

    ``rows`` (K,) are the indices of these targets, ascending. They keep their weights in the whole path.
    Differences that involve other targets are left out.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(targets.feed > 0, targets.travel / targets.feed, 0.0)[1:]
    mean = float(time.mean()) if targets.count > 1 and time.sum() > 0 else 1.0
    # relative durations, bounded so that very short or long moves do not dominate the cost
    time = np.clip(time / mean, 0.2, 5.0) if mean > 0 else np.ones(targets.count - 1)
    rows = np.arange(targets.count) if rows is None else rows
    stencil = _cost_stencil(time[rows[:-1]], targets.stop[rows], np.diff(rows) == 1, targets.count)
    return CostWeights(stencil, targets.count)


def _cost_stencil(time: FloatArray, stop: BoolArray, is_move: BoolArray, count: int) -> list[FloatArray]:
    """Compute the diagonals of K in :class:`CostWeights` for K targets.

    Args:
        time: (K - 1,) relative durations of the moves.
        stop: (K,) whether the arms stop at a target.
        is_move: (K - 1,) whether the arms move from a target to the next; False between two windows.
        count: Number of targets of the whole path.
    """
    rows = len(stop)
    out = [np.zeros(rows), np.zeros(max(rows - 1, 0)), np.zeros(max(rows - 2, 0))]
    # first differences: sum of (x_(i+1) - x_i)^2 / t_i
    rate = is_move / time
    out[0][:-1] += rate
    out[0][1:] += rate
    out[1] -= rate
    # second differences, none across a stop, with a = 1 / t_(i-1) and b = 1 / t_i:
    # sum of CURVATURE_WEIGHT (b (x_(i+1) - x_i) - a (x_i - x_(i-1)))^2 / ((t_(i-1) + t_i) / 2)
    inner = ~stop[1:-1] & is_move[:-1] & is_move[1:]
    weight = CURVATURE_WEIGHT * inner / (0.5 * (time[:-1] + time[1:]))
    a, b = 1.0 / time[:-1], 1.0 / time[1:]
    out[0][:-2] += weight * a * a
    out[0][1:-1] += weight * (a + b) ** 2
    out[0][2:] += weight * b * b
    out[1][:-1] -= weight * a * (a + b)
    out[1][1:] -= weight * b * (a + b)
    out[2] += weight * a * b
    return [count * part for part in out]


def _multiply_stencil(stencil: Sequence[FloatArray], x: FloatArray) -> FloatArray:
    """Multiply a symmetric pentadiagonal matrix, given by its diagonals, by x (N, J)."""
    out = stencil[0][:, None] * x
    for d in (1, 2):
        if len(x) > d:
            out[:-d] += stencil[d][:, None] * x[d:]
            out[d:] += stencil[d][:, None] * x[:-d]
    return np.asarray(out)


WIDE_BOUND_RAD = 1e3
"""Bounds [rad] of a full turn that is narrowed at some targets only."""


def unwrap_freedoms(targets: Targets, values: FloatArray) -> FloatArray:
    """Return values (N, F) with full turns continuous from target to target, without jumps."""
    out = values.copy()
    for j, freedom in enumerate(targets.freedoms):
        if is_full_turn(freedom):
            out[:, j] = np.unwrap(values[:, j])
    return out


def narrow_freedoms(targets: Targets, values: FloatArray, rows: BoolArray, width: float) -> Targets:
    """Restrict freedoms to a corridor at some targets, so that an optimised path stays close to a free one.

    Args:
        targets: N targets.
        values: (N, F) unwrapped centre of the corridor.
        rows: (N,) targets at which it applies.
        width: Half width [rad] of the corridor for rotations. The corridor of a slide or table is the same
            fraction of its range that this is of half a turn.
    """
    freedoms: list[Freedom] = []
    for j, freedom in enumerate(targets.freedoms):
        lower, upper = freedom.lower, freedom.upper
        if is_full_turn(freedom):
            lower, upper = np.full_like(lower, -WIDE_BOUND_RAD), np.full_like(upper, WIDE_BOUND_RAD)
        fraction = width / np.pi
        half_width = (
            0.5 * fraction * (freedom.upper - freedom.lower) if is_sampled_as_slide(freedom) else width
        )
        low = np.where(rows, np.maximum(lower, values[:, j] - half_width), lower)
        high = np.where(rows, np.minimum(upper, values[:, j] + half_width), upper)
        if isinstance(freedom, ScrewFreedom):
            freedom = dataclasses.replace(freedom, periodic=False)
        freedoms.append(dataclasses.replace(freedom, lower=low, upper=high))
    return dataclasses.replace(targets, freedoms=tuple(freedoms))


def targets_around(count: int, moves: IndexArray, reach: int) -> BoolArray:
    """Return for each of ``count`` targets whether it is close to one of the moves.

    Close means at most ``reach`` targets from the start or the end of a move. ``moves`` (M,) are the targets
    to which the moves lead.
    """
    is_end = np.zeros(count, dtype=np.bool_)
    is_end[moves] = True
    is_end[np.maximum(moves - 1, 0)] = True
    # +1 where the neighbourhood of an end starts and -1 after it: their running sum counts neighbourhoods
    counts = np.zeros(count + 1, dtype=np.intp)
    end_rows = np.flatnonzero(is_end)
    np.add.at(counts, np.maximum(end_rows - reach, 0), 1)
    np.add.at(counts, np.minimum(end_rows + reach + 1, count), -1)
    return np.asarray(np.cumsum(counts)[:-1] > 0)
