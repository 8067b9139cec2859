"""Maps of one freedom over the targets: what each arm can do at each value, and where all arms are free.

A grid point of the map is a target with a value of the freedom. At each grid point the best branch and the
best of a few samples of the other freedoms are evaluated for every arm: reach, margin to joint limits and
margin to singularities, with the functions that the path search uses. Where every arm has a state with all
margins, a few combinations of branches are checked for clearance. All counts are bounded, so a grid point
that is reported as colliding may still have a free posture between the samples.

The freedoms are those of the targets. A stock that stands in the cell adds three more: translations of its
position along the axes of the world.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, spread_rows
from planner.geometry.units import DEG, MM
from planner.issues import Issue
from planner.motion.planning_scene import FULL_TURN_RAD, Chain, Scene
from planner.motion.quick_check import find_posture
from planner.motion.search.reach import SOFT_LIMIT_RAD, SOFT_SINGULARITY_RAD, is_full_turn
from planner.motion.search.subsampling import coarse_samples, select_targets
from planner.targets import Freedom, JointFreedom, TableFreedom, Targets

VALUES_PER_FREEDOM: Final = 25
"""Number of values of a freedom. A freedom of a full turn has one less, which is a step of 15 degrees."""
MAX_OTHER_SAMPLES: Final = 36
"""Maximum number of samples of all other freedoms at each grid point."""
MAX_BRANCH_CHOICES: Final = 8
"""Maximum number of branch combinations that are checked for clearance at each grid point, largest margins
first.
"""
MAX_STOCK_SHIFT_M: Final = 0.3
"""Maximum shift [m] of the stock in both directions along an axis."""
STOCK_SHIFT_AXES: Final = ("x", "y", "z")
"""World axes along which the stock is moved."""
STOCK_SHIFT_PREFIX: Final = "place "
"""Prefix of the names of the stock's translations. The axis follows it."""
BRANCH_USE_WEIGHT: Final = 1e3
"""Weight of the number of grid points that a combination of branches suits. Exceeds any penalty of two arms
that are within their margins.
"""
MAX_CLEARANCE_M: Final = 0.1
"""Distance [m] up to which clearance is measured."""
FREE, NO_REACH, JOINT_LIMIT, SINGULAR, COLLISION = range(5)
"""States of an arm at a grid point: all requirements are met, or the first that fails, in this order."""
ISSUE_CODES: Final = ("", "motion.no_reach", "motion.joint_limit", "motion.singular", "motion.collision")
"""Issue codes of the states, in the same order."""
DISPLAY_UNITS: Final = {"rad": ("deg", DEG), "m": ("mm", MM), "": ("", 1.0)}
"""Displayed unit of each unit of a freedom, and the size of one displayed unit in the unit of the targets."""


@dataclasses.dataclass(frozen=True)
class GridStates:
    """States of the arms at K targets with V values each.

    Attributes:
        state: {arm: (K, V)} :data:`FREE`, or the requirement that fails.
        limit: {arm: (K, V)} [rad] distance of the best state to joint limits, -inf where no state exists.
        singular: {arm: (K, V)} [rad] distance of the best state to singularities, -inf where no state exists.
        q: {arm: (K, V, 6)} [rad] joints of the best combination, free or not. NaN where an arm has no allowed
            state.
        pair: (K, V) two bodies that are too close in that state, or two empty names.
    """

    state: Mapping[str, NDArray[np.int8]]
    limit: Mapping[str, FloatArray]
    singular: Mapping[str, FloatArray]
    q: Mapping[str, FloatArray]
    pair: NDArray[np.object_]

    @property
    def free(self) -> BoolArray:
        """For K targets and V values whether every arm meets all requirements."""
        return np.asarray(np.logical_and.reduce([state == FREE for state in self.state.values()]))


@dataclasses.dataclass(frozen=True)
class ReachableFreedomMap:
    """Map of one freedom over K targets.

    Attributes:
        freedom: Name of the freedom.
        unit: Its unit: "rad", "m" or "".
        values: (K, V) values of the freedom.
        grid: States at these values.
        clearance: (K, V) [m] smallest distance between bodies where all arms are free, at most
            :data:`MAX_CLEARANCE_M`; NaN elsewhere.
    """

    freedom: str
    unit: str
    values: FloatArray
    grid: GridStates
    clearance: FloatArray


def freedom_units(targets: Targets, has_stock_pose: bool) -> dict[str, str]:
    """Return the units of all freedoms that can be mapped, by name.

    Args:
        targets: Targets with their freedoms. Freedoms with an empty range are left out.
        has_stock_pose: Whether the stock pose is stated in the problem and can be moved.
    """
    out = {f.name: _unit(f) for f in targets.freedoms if float(np.max(f.upper - f.lower)) > 0.0}
    return out | ({STOCK_SHIFT_PREFIX + axis: "m" for axis in STOCK_SHIFT_AXES} if has_stock_pose else {})


def _unit(freedom: Freedom) -> str:
    """Return the unit of a freedom: "rad", "m", or "" for the value that a table of poses is over."""
    if isinstance(freedom, TableFreedom):
        return ""
    if isinstance(freedom, JointFreedom):
        return "rad"
    return "rad" if any(np.any(axis[:3]) for axis in freedom.axis.values()) else "m"


def compute_freedom_map(
    scene: Scene, targets: Targets, freedom: str, planned: FloatArray | None = None
) -> ReachableFreedomMap:
    """Compute the map of one freedom for a few targets, which shows users where the arms can work.

    The other freedoms take a few samples and, if given, the planned values.

    Args:
        scene: Cell with the stock in its pose.
        targets: K targets.
        freedom: Name of the freedom, one of :func:`freedom_units`.
        planned: (K, F) values of the freedoms in a plan.

    Raises:
        KeyError: The freedom does not exist.
    """
    if freedom.startswith(STOCK_SHIFT_PREFIX):
        return _stock_shift_map(
            scene, targets, STOCK_SHIFT_AXES.index(freedom.removeprefix(STOCK_SHIFT_PREFIX))
        )
    names = [f.name for f in targets.freedoms]
    if freedom not in names:
        raise KeyError(freedom)
    column = names.index(freedom)
    grid_values = _grid_values(targets.freedoms[column])
    other_samples = _other_samples(targets, column)
    if planned is not None:
        other_samples = np.concatenate([planned[:, None], other_samples], axis=1)
    values = np.repeat(other_samples[:, None], grid_values.shape[1], axis=1)
    values[..., column] = grid_values[:, :, None]
    grid = grid_states([scene], targets, values)
    unit = _unit(targets.freedoms[column])
    return ReachableFreedomMap(freedom, unit, grid_values, grid, _free_clearance([scene], targets, grid))


def _grid_values(freedom: Freedom) -> FloatArray:
    """Return values (N, V) of a freedom at N targets, evenly spaced between its bounds at each target.

    The value at -180 degrees of a full turn is not repeated at 180 degrees.
    """
    if is_full_turn(freedom):
        angles = -np.pi + FULL_TURN_RAD * np.arange(VALUES_PER_FREEDOM - 1) / (VALUES_PER_FREEDOM - 1)
        return np.repeat(angles[None], len(freedom.lower), axis=0)
    fraction = np.linspace(0.0, 1.0, VALUES_PER_FREEDOM)
    return freedom.lower[:, None] + fraction * (freedom.upper - freedom.lower)[:, None]


def _other_samples(targets: Targets, column: int | None) -> FloatArray:
    """Return samples (N, S, F) of all freedoms, where that of ``column`` keeps its neutral value.

    At most :data:`MAX_OTHER_SAMPLES` samples are returned for each target. With ``column`` None all vary.
    """
    ranges = list(targets.freedoms)
    if column is not None:
        neutral = targets.neutral_values()[:, column]
        ranges[column] = dataclasses.replace(ranges[column], lower=neutral, upper=neutral)
    samples = coarse_samples(dataclasses.replace(targets, freedoms=tuple(ranges)))
    return samples[:, spread_rows(samples.shape[1], MAX_OTHER_SAMPLES)]


def _stock_shift_map(scene: Scene, targets: Targets, axis: int) -> ReachableFreedomMap:
    """Compute the map of a shift of the stock along a world axis (0 to 2), which needs a scene per shift."""
    shifts = np.linspace(-MAX_STOCK_SHIFT_M, MAX_STOCK_SHIFT_M, VALUES_PER_FREEDOM)
    scenes = []
    for shift in shifts:
        stock = scene.stock.copy()
        stock[axis, 3] += shift
        model = None if scene.model is None else scene.model.with_stock(stock)
        scenes.append(dataclasses.replace(scene, stock=stock, model=model))
    values = np.repeat(_other_samples(targets, column=None)[:, None], VALUES_PER_FREEDOM, axis=1)
    grid = grid_states(scenes, targets, values)
    grid_shifts = np.repeat(shifts[None], targets.count, axis=0)
    name = STOCK_SHIFT_PREFIX + STOCK_SHIFT_AXES[axis]
    return ReachableFreedomMap(name, "m", grid_shifts, grid, _free_clearance(scenes, targets, grid))


MAX_SEARCHED_TARGETS: Final = 12
"""Maximum number of targets without a posture among few samples for which the path search is run."""


def find_postures(
    scene: Scene, targets: Targets, rows: IndexArray
) -> list[dict[str, FloatArray] | list[Issue]]:
    """Find a posture for each target, or the reasons why there is none.

    Few samples of the freedoms are checked first, with branches that suit as many targets as possible. If
    they have no free posture, :func:`find_posture` searches the single target, with all samples for at most
    :data:`MAX_SEARCHED_TARGETS` targets.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        rows: (K,) indices of the targets.

    Returns:
        For each row the joints {arm: (6,)} [rad], or issues.
    """
    subset_targets = select_targets(targets, rows)
    grid = grid_states(
        [scene],
        subset_targets,
        _other_samples(subset_targets, column=None)[:, None],
        prefer_common_branches=True,
    )
    out: list[dict[str, FloatArray] | list[Issue]] = []
    searched = 0
    for k, row in enumerate(rows.tolist()):
        if grid.free[k, 0]:
            out.append({arm: _with_best_turns(scene.chains[arm], q[k, 0]) for arm, q in grid.q.items()})
            continue
        result = find_posture(scene, targets, row, thorough=False)
        if isinstance(result, list):
            searched += 1
            over_budget = searched > MAX_SEARCHED_TARGETS  # the thorough search takes long
            result = (
                _sampled_issues(targets, grid, k, row) if over_budget else find_posture(scene, targets, row)
            )
        if isinstance(result, dict):
            result = {arm: _with_best_turns(scene.chains[arm], q) for arm, q in result.items()}
        out.append(result)
    return out


def _with_best_turns(chain: Chain, q: FloatArray) -> FloatArray:
    """Add whole turns to joints (6,) [rad] so that they have the largest margin to the joint limits."""
    turns = chain.turns
    margins = [float(margin) for margin in chain.limit_margins(q, turns)]
    return np.asarray(q + turns[int(np.argmax(margins))])


def _sampled_issues(targets: Targets, grid: GridStates, k: int, row: int) -> list[Issue]:
    """Return one issue for each arm that has no free posture among the few samples of a target.

    Args:
        targets: Targets of the operation.
        grid: States of the arms at the samples of a subset of the targets.
        k: Index of the target in ``grid``.
        row: Index of the target in ``targets``.
    """
    out = []
    for arm, state in grid.state.items():
        code = ISSUE_CODES[state[k, 0]]
        if code:
            pair = grid.pair[k, 0] if code == ISSUE_CODES[COLLISION] else ("", "")
            message = f"{arm} at {targets.name(row)}: {CAUSE_TEXTS[code]} in all postures that were tried"
            out.append(Issue(code, message, arm=arm, target=targets.name(row), index=row, bodies=pair))
    return out


CAUSE_TEXTS: Final = {
    "motion.no_reach": "out of reach",
    "motion.joint_limit": "a joint is beyond its limit",
    "motion.singular": "too close to a singularity",
    "motion.collision": "bodies are too close to each other",
}
"""What fails, in a few words, by issue code."""


def grid_states(
    scenes: Sequence[Scene], targets: Targets, values: FloatArray, prefer_common_branches: bool = False
) -> GridStates:
    """Evaluate all arms at K targets with V values and S samples each.

    Args:
        scenes: One scene for all values, or V scenes, one for each value.
        targets: K targets.
        values: (K, V, S, F) values of the freedoms.
        prefer_common_branches: Whether branches that suit most grid points are preferred to those with the
            largest margins.
    """
    shape = values.shape[:3]
    index = np.broadcast_to(np.arange(shape[0])[:, None, None], shape)
    poses: dict[str, FloatArray] = {arm: np.empty((*shape, 4, 4)) for arm in targets.arms}
    for number, scene in enumerate(scenes):
        columns = slice(None) if len(scenes) == 1 else slice(number, number + 1)
        tcp_poses = scene.tcp_poses(targets, values[:, columns], index[:, columns])
        for arm, pose in tcp_poses.items():
            poses[arm][:, columns] = pose
    states, limits, singulars, costs, angles = {}, {}, {}, {}, {}
    for arm, pose in poses.items():
        arm_grid = arm_states(scenes[0], arm, pose, targets.last_joint_angle(arm, values))
        states[arm], limits[arm], singulars[arm] = arm_grid.state, arm_grid.limit, arm_grid.singular
        costs[arm], angles[arm] = arm_grid.cost, arm_grid.q
    chosen, pair = _choose_free(scenes, targets, costs, angles, states, prefer_common_branches)
    return GridStates(states, limits, singulars, chosen, pair)


@dataclasses.dataclass(frozen=True)
class ArmStates:
    """States of one arm at grid points (...) with S poses and B branches each.

    Attributes:
        state: (...) as in :class:`GridStates`, without collisions.
        limit: (...) [rad] distance of the best state to joint limits.
        singular: (...) [rad] distance of the best state to singularities.
        cost: (..., S, B) penalty of each branch, inf where it is not allowed.
        q: (..., S, B, 6) [rad] joints of each branch.
    """

    state: NDArray[np.int8]
    limit: FloatArray
    singular: FloatArray
    cost: FloatArray
    q: FloatArray


def arm_states(scene: Scene, arm: str, pose: FloatArray, last_joint: FloatArray | None = None) -> ArmStates:
    """Evaluate one arm at given TCP poses.

    Args:
        scene: Cell; its bodies are not checked.
        arm: Name of the arm.
        pose: (..., S, 4, 4) TCP poses in the world.
        last_joint: (..., S) values of the redundant joint, as in :meth:`Chain.inverse`.
    """
    chain = scene.chains[arm]
    q = chain.inverse(pose, last_joint=last_joint)  # (..., S, B, J)
    limit, singular = chain.best_limit_margin(q), chain.singularity_margin(q)
    joint_margin, singularity_margin = scene.settings.joint_margin, scene.settings.singularity_margin
    cost = _margin_penalty(limit, joint_margin, SOFT_LIMIT_RAD) + _margin_penalty(
        singular, singularity_margin, SOFT_SINGULARITY_RAD
    )
    # The best state of a grid point is the sample and branch with the smallest penalty.
    flat_shape = (*pose.shape[:-3], -1)
    best = np.nan_to_num(cost, nan=np.inf, posinf=np.inf).reshape(flat_shape).argmin(axis=-1)[..., None]
    limits = np.take_along_axis(limit.reshape(flat_shape), best, axis=-1)[..., 0]
    singulars = np.take_along_axis(singular.reshape(flat_shape), best, axis=-1)[..., 0]
    # Each requirement includes the one before it. The state is the first that no sample and branch meets.
    requirements = (
        limit > -np.inf,
        limit >= joint_margin,
        (limit >= joint_margin) & (singular >= singularity_margin),
    )
    passed = [is_met.any(axis=(-2, -1)) for is_met in requirements]
    state = np.select([~ok for ok in passed], [NO_REACH, JOINT_LIMIT, SINGULAR], FREE)
    return ArmStates(state.astype(np.int8), limits, singulars, np.where(requirements[2], cost, np.inf), q)


def _margin_penalty(margin: FloatArray, required: float, soft_range: float) -> FloatArray:
    """Return the penalty of margins [rad].

    It is 0 from ``soft_range`` above the required margin on, 1 at the required margin, and larger below it.
    """
    return np.asarray(np.maximum((required + soft_range - margin) / soft_range, 0.0))


def _choose_free(
    scenes: Sequence[Scene],
    targets: Targets,
    costs: Mapping[str, FloatArray],
    angles: Mapping[str, FloatArray],
    states: Mapping[str, NDArray[np.int8]],
    prefer_common_branches: bool,
) -> tuple[dict[str, FloatArray], NDArray[np.object_]]:
    """Choose a collision-free combination of the arms' branches at each grid point, if there is one.

    Args:
        scenes: One scene for all values, or one for each value.
        targets: K targets.
        costs: {arm: (K, V, S, B)} penalties of sample and branch, inf where it is not allowed.
        angles: {arm: (K, V, S, B, 6)} [rad] joints of sample and branch.
        states: {arm: (K, V)} states without collisions. Set to :data:`COLLISION` where all arms have an
            allowed state, but none of the checked combinations is free.
        prefer_common_branches: Whether branches that suit most grid points are preferred to those with the
            largest margins.

    Returns:
        ``q`` and ``pair`` as in :class:`GridStates`.
    """
    arms = targets.arms
    shape = next(iter(states.values())).shape
    combos = np.array(list(itertools.product(*(range(costs[arm].shape[-1]) for arm in arms))))
    cost = np.full((*shape, len(combos)), np.inf)
    sample = np.zeros((*shape, len(combos)), dtype=np.intp)
    # The total penalty of a combination is the sum over the arms, minimised over the samples.
    for number, combo in enumerate(combos):
        total = sum(costs[arm][..., branch] for arm, branch in zip(arms, combo, strict=True))
        sample[..., number] = np.argmin(total, axis=-1)
        cost[..., number] = np.min(total, axis=-1)
    use_counts = np.isfinite(cost).sum(axis=(0, 1)) if prefer_common_branches else np.zeros(len(combos))
    rank_cost = np.where(np.isfinite(cost), cost - BRANCH_USE_WEIGHT * use_counts, np.inf)
    order = np.argsort(rank_cost, axis=-1, kind="stable")[..., :MAX_BRANCH_CHOICES]
    ranked = np.take_along_axis(cost, order, axis=-1)
    # Check combinations in rank order. A grid point is done with its first free combination.
    q = {arm: np.full((*shape, angles[arm].shape[-1]), np.nan) for arm in arms}
    unresolved = np.asarray(np.logical_and.reduce([states[arm] == FREE for arm in arms]))
    for rank in range(ranked.shape[-1]):
        k, v = np.nonzero(unresolved & np.isfinite(ranked[..., rank]))
        if not len(k):
            break
        combo = order[k, v, rank]
        s = sample[k, v, combo]
        candidate = {arm: angles[arm][k, v, s, combos[combo, number]] for number, arm in enumerate(arms)}
        free = np.zeros(len(k), dtype=bool)
        for rows, scene in _rows_by_scene(scenes, v):
            free[rows] = scene.keeps_clearance(
                targets, {arm: joints[rows] for arm, joints in candidate.items()}, k[rows]
            )
        for arm, joints in candidate.items():
            # the first combination is stored even if it collides, and kept if no other one is free
            chosen = free if rank else np.ones(len(k), dtype=bool)
            q[arm][k[chosen], v[chosen]] = joints[chosen]
        unresolved[k[free], v[free]] = False
    # Grid points that are still open collide. Name the closest pair of their best combination.
    pair = np.full(shape, None, dtype=object)
    for point in np.ndindex(shape):
        pair[point] = ("", "")
    k, v = np.nonzero(unresolved)
    for arm in arms:
        states[arm][k, v] = COLLISION
    for rows, scene in _rows_by_scene(scenes, v):
        rows_with_joints = rows[np.isfinite(q[arms[0]][k[rows], v[rows], 0])]
        joints = {arm: q[arm][k[rows_with_joints], v[rows_with_joints]] for arm in arms}
        clearances = scene.smallest_clearances(targets, joints, k[rows_with_joints], scene.settings.clearance)
        for row, names in zip(rows_with_joints, clearances.pair, strict=True):
            pair[k[row], v[row]] = names
    return q, pair


def _rows_by_scene(scenes: Sequence[Scene], value: NDArray[np.intp]) -> list[tuple[NDArray[np.intp], Scene]]:
    """Group grid points by the scene that applies to them.

    Args:
        scenes: One scene for all values, or one for each value.
        value: (B,) index of the value of each grid point.

    Returns:
        For each scene that applies to a grid point: indices of its grid points, and the scene.
    """
    if len(scenes) == 1:
        return [(np.arange(len(value)), scenes[0])] if len(value) else []
    parts = [(np.flatnonzero(value == number), scene) for number, scene in enumerate(scenes)]
    return [(rows, scene) for rows, scene in parts if len(rows)]


def _free_clearance(scenes: Sequence[Scene], targets: Targets, grid: GridStates) -> FloatArray:
    """Measure the clearance (K, V) [m] where all arms are free, at most `MAX_CLEARANCE_M`; NaN elsewhere."""
    k, v = np.nonzero(grid.free)
    out = np.full(grid.free.shape, np.nan)
    for rows, scene in _rows_by_scene(scenes, v):
        q = {arm: joints[k[rows], v[rows]] for arm, joints in grid.q.items()}
        out[k[rows], v[rows]] = scene.smallest_clearances(targets, q, k[rows], MAX_CLEARANCE_M).distance
    return out
