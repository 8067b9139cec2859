"""Trajectory optimisation in which the freedoms are the only variables.

Poses stay exact, because joints follow from the freedoms by closed-form inverse kinematics on the
chosen branch in every trial step. The cost is smooth motion at the joints plus hinges (limits,
singularities, clearance, preferred values); Gauss-Newton steps on it are a banded system, since a
target meets only its two neighbours on either side.

Where a smoother path came too near to something, the freedoms are narrowed to a corridor around the
path that is kept.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final, Protocol

import numpy as np
from scipy.linalg import solveh_banded

from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, inverse, log_pose
from planner.motion.planning_scene import Scene
from planner.motion.search.ladder_search import speed_limits
from planner.motion.search.reach import full_turn, slides_only
from planner.motion.trajectory.hinges import Rows, margin_rows, preference_rows
from planner.targets import Freedom, JointFreedom, ScrewFreedom, Targets

CURVATURE_WEIGHT: Final = 64.0
"""Weight of second differences against first ones: changes are spread over some eight targets."""

MOST_ITERATIONS: Final = 30
"""Steps of the optimisation at most."""
LEAST_GAIN_SHARE: Final = 3e-3
"""A step that gains less than this share of the cost is the last; one that promises less than a tenth of it
is not taken."""
LEAST_PROMISE_SHARE: Final = 0.02
"""Once there is a gain, a step that fails and promised less than this share of the cost is the last."""

BOUND_ROUNDS: Final = 4
"""Rounds at most in which values at their bounds are found and held there."""
DIFFERENCE_STEP: Final = 1e-4
"""Step [rad or m] of the central differences of a freedom."""
_TURN, _MOVE = slice(0, 3), slice(3, 6)  # parts of a twist


Blocks = list[FloatArray]
"""A symmetric block-banded matrix: blocks (N - d, F, F) of targets i and i + d, for d = 0, 1, 2."""


class Obstacles(Protocol):
    """Clearance as hinges; :mod:`planner.motion.trajectory.hinges` has the real one."""

    def rows(self, q: FloatArray) -> Sequence[Rows]:
        """Hinges at joints q (N, J)."""

    def cost(self, q: FloatArray) -> float:
        """Their cost alone."""


@dataclasses.dataclass(frozen=True)
class Improved:
    """The optimised path, with its cost and that of the path it started from."""

    values: FloatArray
    q: dict[str, FloatArray]
    cost: float
    cost_before: float
    iterations: int

    def at(self, rows: IndexArray) -> "Improved":
        """The path at some of its targets."""
        return dataclasses.replace(
            self, values=self.values[rows], q={arm: angles[rows] for arm, angles in self.q.items()}
        )


def improve(
    scene: Scene,
    targets: Targets,
    branch: Mapping[str, int],
    values: FloatArray,
    q: Mapping[str, FloatArray],
    obstacles: Obstacles | None = None,
) -> Improved:
    """Smooths a path of freedom ``values`` (N, F) and joints {arm: (N, J)} on the branches ``branch``."""
    problem = PathProblem(scene, targets, branch, obstacles)
    values = problem.unwrapped(values)
    joints = problem.stack(q)
    start = cost = problem.cost(values, joints)
    damping, count = 1e-6, 0
    while count < MOST_ITERATIONS and values.size:
        count += 1
        step, expected = problem.step(values, joints, damping)
        if not expected > LEAST_GAIN_SHARE * 0.1 * cost:
            break
        scale, done = 1.0, False
        while scale > 0.05:
            trial = problem.clip(values + scale * step)
            moved = problem.joints(trial, joints)
            offered = problem.cost(trial, moved, cost) if moved is not None else np.inf
            if moved is not None and offered < cost:
                done = True
                break
            scale *= 0.5
        if not done or moved is None:
            damping *= 30.0
            if damping > 1e3 or (cost < start and expected < LEAST_PROMISE_SHARE * cost):
                break
            continue
        gain = cost - offered
        values, joints, cost = trial, moved, offered
        damping = max(damping * (0.1 if scale == 1.0 else 1.0), 1e-9)
        if gain < LEAST_GAIN_SHARE * cost:
            break
    return Improved(values, problem.split(joints), cost, start, count)


def path_cost(
    scene: Scene,
    targets: Targets,
    values: FloatArray,
    q: Mapping[str, FloatArray],
    obstacles: Obstacles | None = None,
) -> float:
    """The cost of :func:`improve` of any path."""
    problem = PathProblem(scene, targets, {}, obstacles)
    return problem.cost(problem.unwrapped(values), problem.stack(q))


class PathProblem:
    """Cost, exact joints and slopes of paths over the freedoms of targets, on the branches ``branch``;
    ``weights`` of the cost where the targets are some of a longer path."""

    def __init__(
        self,
        scene: Scene,
        targets: Targets,
        branch: Mapping[str, int],
        obstacles: Obstacles | None,
        weights: "Weights | None" = None,
    ) -> None:
        self.scene, self.targets, self.branch, self.obstacles = scene, targets, branch, obstacles
        self.columns = scene.columns(targets.arms)
        self.speed = np.concatenate([speed_limits(scene, arm) for arm in targets.arms])
        weights = weights_of(targets) if weights is None else weights
        self.stencil, self.count = weights.stencil, weights.count
        self.rings = np.array([full_turn(f) for f in targets.freedoms], dtype=bool)
        bounds = [(f.lower, f.upper) for f in targets.freedoms]
        shape = (targets.count, len(bounds))
        self.lower = np.stack([b[0] for b in bounds], axis=1) if bounds else np.zeros(shape)
        self.upper = np.stack([b[1] for b in bounds], axis=1) if bounds else np.zeros(shape)
        self.lower[:, self.rings], self.upper[:, self.rings] = -np.inf, np.inf

    def stack(self, q: Mapping[str, FloatArray]) -> FloatArray:
        return np.concatenate([q[arm] for arm in self.targets.arms], axis=-1)

    def split(self, joints: FloatArray) -> dict[str, FloatArray]:
        return {arm: joints[..., part].copy() for arm, part in self.columns.items()}

    def clip(self, values: FloatArray) -> FloatArray:
        return np.clip(values, self.lower, self.upper)

    def unwrapped(self, values: FloatArray) -> FloatArray:
        out = values.copy()
        out[:, self.rings] = np.unwrap(values[:, self.rings], axis=0)
        return out

    def joints(self, values: FloatArray, near: FloatArray) -> FloatArray | None:
        """Exact joints (N, J) on the branches, or None where a branch or a hard margin is lost."""
        poses = self.scene.tcp(self.targets, values)
        out = []
        for arm, part in self.columns.items():
            chain = self.scene.chains[arm]
            last = self.targets.last(arm, values)
            q = chain.on_branch(poses[arm], self.branch[arm], near[:, part], last)
            if chain.limit_margin(q).min() < self.scene.settings.joint_margin - 1e-12:
                return None
            if chain.singularity_margin(q).min() < self.scene.settings.singularity_margin - 1e-12:
                return None
            out.append(q)
        return np.concatenate(out, axis=-1)

    def rates(self, values: FloatArray, joints: FloatArray) -> FloatArray:
        """dq/dvalue (N, J, F): the body twist of each freedom through the arms' closed-form Jacobians."""
        twists = self._twists(values)
        parts = [
            self.scene.chains[arm].rates(joints[:, part], twists[arm]) for arm, part in self.columns.items()
        ]
        return self._with_own(np.swapaxes(np.concatenate(parts, axis=-1), 1, 2), joints)

    def _with_own(self, rates: FloatArray, joints: FloatArray) -> FloatArray:
        """Rates (N, J, F) with those of joints that are freedoms, which move no tool."""
        for j, freedom in enumerate(self.targets.freedoms):
            if isinstance(freedom, JointFreedom):
                part = self.columns[freedom.arm]
                rates[:, part, j] = self.scene.chains[freedom.arm].own_rates(joints[:, part])
        return rates

    def plant_rates(self, model: CellModel, values: FloatArray, joints: FloatArray) -> FloatArray:
        """What :meth:`rates` gives, through the Jacobians of Drake's plant."""
        twists, q = self._twists(values), self.split(joints)
        poses, parts = self.scene.tcp(self.targets, values), []
        for arm, jacobian in model.jacobians(q).items():
            turn = poses[arm][:, None, :3, :3]
            world = [np.einsum("nkij,nkj->nik", turn, twists[arm][..., part]) for part in (_TURN, _MOVE)]
            own = np.linalg.solve(jacobian[..., :6], np.concatenate(world, axis=1))
            chain = self.scene.chains[arm]
            parts.append(np.swapaxes(chain.with_last(np.swapaxes(own, 1, 2)), 1, 2) if chain.spare else own)
        return self._with_own(np.concatenate(parts, axis=1), joints)

    def _twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Body twists {arm: (N, F, 6)} of the TCPs by each freedom, by central differences."""
        twists: dict[str, list[FloatArray]] = {arm: [] for arm in self.targets.arms}
        for sides in self.targets.poses_beside(values, DIFFERENCE_STEP):
            ahead, behind = (self.scene.world(self.targets, poses) for poses in sides)
            for arm in self.targets.arms:
                twists[arm].append(log_pose(inverse(behind[arm]) @ ahead[arm]) / (2.0 * DIFFERENCE_STEP))
        return {arm: np.stack(each, axis=1) for arm, each in twists.items()}

    def cost(self, values: FloatArray, joints: FloatArray, limit: float = np.inf) -> float:
        """The cost, or inf where it is ``limit`` or more before obstacles are looked at."""
        arms, total = self.targets.arms, self.smoothness(joints)
        total += sum(r.cost for r in margin_rows(self.scene, arms, joints, self.count, slopes=False))
        total += sum(r.cost for r in preference_rows(self.targets, values, self.rings, self.count))
        if total >= limit:
            return np.inf
        return total + (self.obstacles.cost(joints) if self.obstacles else 0.0)

    def smoothness(self, joints: FloatArray) -> float:
        """What the differences of joints (N, J) cost, without any hinges."""
        scaled = joints / self.speed
        return float(np.sum(scaled * _times(self.stencil, scaled)))

    def model(self, values: FloatArray, joints: FloatArray, rates: FloatArray) -> tuple[Blocks, FloatArray]:
        """The cost about a path as a quadratic form of steps (N, F) of the freedoms: its matrix in blocks and
        half its gradient (N, F), by Gauss and Newton, without obstacles; ``rates`` as :meth:`rates` gives."""
        rows = len(values)
        scaled = rates / self.speed[:, None]
        blocks = [
            self.stencil[d][: rows - d, None, None]
            * np.einsum("njf,njg->nfg", scaled[: rows - d], scaled[d:])
            for d in range(3)
        ]
        gradient = np.einsum("njf,nj->nf", scaled, _times(self.stencil, joints / self.speed))
        for hinge in margin_rows(self.scene, self.targets.arms, joints, self.count):
            _add(blocks[0], gradient, hinge, np.einsum("rj,rjf->rf", hinge.slope, rates[hinge.index]))
        for hinge in preference_rows(self.targets, values, self.rings, self.count):
            _add(blocks[0], gradient, hinge, hinge.slope)
        return blocks, gradient

    def step(self, values: FloatArray, joints: FloatArray, damping: float) -> tuple[FloatArray, float]:
        """Gauss-Newton step (N, F) and the gain that its model expects."""
        rates = self.rates(values, joints)
        blocks, gradient = self.model(values, joints, rates)
        for hinge in self.obstacles.rows(joints) if self.obstacles else ():
            _add(blocks[0], gradient, hinge, np.einsum("rj,rjf->rf", hinge.slope, rates[hinge.index]))
        step = self._bounded(blocks, gradient, values, damping)
        return step, float(-np.sum(step * gradient))

    def _bounded(
        self, blocks: Blocks, gradient: FloatArray, values: FloatArray, damping: float
    ) -> FloatArray:
        """The Gauss-Newton step within the bounds: what would leave them goes to its bound, the rest is
        solved again."""
        held = (self.upper <= self.lower) | ((values <= self.lower) & (gradient > 0))
        held |= (values >= self.upper) & (gradient < 0)
        fixed = np.zeros_like(values)
        step = fixed
        for _ in range(BOUND_ROUNDS):
            right = np.where(held, 0.0, gradient + _blocks_times(blocks, fixed))
            banded = _banded(blocks, held, damping)
            step = -solveh_banded(banded, right.ravel(), lower=True).reshape(values.shape) + fixed
            target = np.clip(values + step, self.lower, self.upper) - values
            out = ~held & (np.abs(target - step) > 1e-12)
            if not out.any():
                break
            held |= out
            fixed = np.where(out, target, fixed)
        return np.clip(values + step, self.lower, self.upper) - values


def _add(diagonal: FloatArray, gradient: FloatArray, hinge: Rows, slope: FloatArray) -> None:
    """Adds residuals with slopes (R, F) by freedoms to the diagonal blocks and to half the gradient."""
    np.add.at(diagonal, hinge.index, np.einsum("rf,rg->rfg", slope, slope))
    np.add.at(gradient, hinge.index, slope * hinge.value[:, None])


def _blocks_times(blocks: Sequence[FloatArray], x: FloatArray) -> FloatArray:
    """The symmetric block-banded matrix times x (N, F)."""
    out = np.einsum("nfg,ng->nf", blocks[0], x)
    for d in (1, 2):
        if len(x) > d:
            out[:-d] += np.einsum("nfg,ng->nf", blocks[d], x[d:])
            out[d:] += np.einsum("nfg,nf->ng", blocks[d], x[:-d])
    return np.asarray(out)


def _banded(blocks: Sequence[FloatArray], held: BoolArray, damping: float) -> FloatArray:
    """Lower banded form of the block-banded matrix, held variables taken out, the diagonal damped."""
    rows, free = held.shape
    width = 3 * free - 1
    banded = np.zeros((width + 1, rows * free))
    loose = ~held
    for d, block in enumerate(blocks):
        if rows <= d:
            continue
        kept = block * loose[: rows - d, :, None] * loose[d:, None, :]
        for f in range(free):
            for g in range(free):
                offset = d * free + g - f
                if offset >= 0:
                    columns = np.arange(rows - d) * free + f
                    banded[offset, columns] = kept[:, f, g]
    diagonal = banded[0].reshape(rows, free)
    scale = float(diagonal.max(initial=1e-12))
    diagonal += damping * scale + 1e-12
    diagonal[held] = 1.0
    banded[0] = diagonal.ravel()
    return banded


@dataclasses.dataclass(frozen=True)
class Weights:
    """How the cost weighs a path: the diagonals ``stencil`` of the pentadiagonal K with q' K q = ``count``
    (sum of weighted first and second differences), and of how many targets the path is."""

    stencil: list[FloatArray]
    count: int


def weights_of(targets: Targets, rows: IndexArray | None = None) -> Weights:
    """Those of a path of all targets; or of the ``rows`` (K,) of it, in their order: as on the whole path,
    without differences from targets that are not among them."""
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(targets.feed > 0, targets.travel / targets.feed, 0.0)[1:]
    mean = float(time.mean()) if targets.count > 1 and time.sum() > 0 else 1.0
    time = np.clip(time / mean, 0.2, 5.0) if mean > 0 else np.ones(targets.count - 1)
    rows = np.arange(targets.count) if rows is None else rows
    stencil = _stencil(time[rows[:-1]], targets.stop[rows], np.diff(rows) == 1, targets.count)
    return Weights(stencil, targets.count)


def _stencil(time: FloatArray, stop: BoolArray, joins: BoolArray, count: int) -> list[FloatArray]:
    """The diagonals of targets with stops (K,), by the times (K - 1,) of the moves that ``joins`` (K - 1,)
    tells to be ones."""
    rows = len(stop)
    out = [np.zeros(rows), np.zeros(max(rows - 1, 0)), np.zeros(max(rows - 2, 0))]
    rate = joins / time
    out[0][:-1] += rate
    out[0][1:] += rate
    out[1] -= rate
    inner = ~stop[1:-1] & joins[:-1] & joins[1:]
    weight = CURVATURE_WEIGHT * inner / (0.5 * (time[:-1] + time[1:]))
    a, b = 1.0 / time[:-1], 1.0 / time[1:]
    out[0][:-2] += weight * a * a
    out[0][1:-1] += weight * (a + b) ** 2
    out[0][2:] += weight * b * b
    out[1][:-1] -= weight * a * (a + b)
    out[1][1:] -= weight * b * (a + b)
    out[2] += weight * a * b
    return [count * part for part in out]


def _times(stencil: Sequence[FloatArray], x: FloatArray) -> FloatArray:
    """K x for the diagonals of a symmetric pentadiagonal K and x (N, J)."""
    out = stencil[0][:, None] * x
    for d in (1, 2):
        if len(x) > d:
            out[:-d] += stencil[d][:, None] * x[d:]
            out[d:] += stencil[d][:, None] * x[:-d]
    return np.asarray(out)


WIDE_BOUND_RAD = 1e3
"""[rad] bounds of a full turn that is narrowed at some targets only."""


def unwrapped(targets: Targets, values: FloatArray) -> FloatArray:
    """Values (N, F) with full turns counted on from target to target instead of jumping at half a turn."""
    out = values.copy()
    for j, freedom in enumerate(targets.freedoms):
        if full_turn(freedom):
            out[:, j] = np.unwrap(values[:, j])
    return out


def narrowed_freedoms(targets: Targets, values: FloatArray, rows: BoolArray, width: float) -> Targets:
    """The targets with freedoms kept near ``values`` (N, F), unwrapped, at ``rows`` (N,).

    ``width`` [rad] either way for what turns; slides and tables keep the same share of their range that
    ``width`` is of half a turn.
    """
    freedoms: list[Freedom] = []
    for j, freedom in enumerate(targets.freedoms):
        lower, upper = freedom.lower, freedom.upper
        if full_turn(freedom):
            lower, upper = np.full_like(lower, -WIDE_BOUND_RAD), np.full_like(upper, WIDE_BOUND_RAD)
        share = width / np.pi
        away = 0.5 * share * (freedom.upper - freedom.lower) if slides_only(freedom) else width
        low = np.where(rows, np.maximum(lower, values[:, j] - away), lower)
        high = np.where(rows, np.minimum(upper, values[:, j] + away), upper)
        if isinstance(freedom, ScrewFreedom):
            freedom = dataclasses.replace(freedom, periodic=False)
        freedoms.append(dataclasses.replace(freedom, lower=low, upper=high))
    return dataclasses.replace(targets, freedoms=tuple(freedoms))


def targets_around(count: int, moves: IndexArray, reach: int) -> BoolArray:
    """(count,) the targets at most ``reach`` away from either end of the moves to targets ``moves`` (M,)."""
    hit = np.zeros(count, dtype=np.bool_)
    hit[moves] = True
    hit[np.maximum(moves - 1, 0)] = True
    near = np.zeros(count + 1, dtype=np.intp)
    at = np.flatnonzero(hit)
    np.add.at(near, np.maximum(at - reach, 0), 1)
    np.add.at(near, np.minimum(at + reach + 1, count), -1)
    return np.asarray(np.cumsum(near)[:-1] > 0)
