"""Hinge costs of the optimiser: residuals that are 0 for wide margins and grow as a margin narrows.

They cover margins to joint limits and singularities, distance from preferred values, and clearance of bodies.
Clearance is queried only where it may matter.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import joint_columns
from planner.cell import clearance
from planner.cell.bodies import bounding_size, link_chain
from planner.cell.bounds import ClearanceBounds
from planner.cell.clearance import Pairs
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, transform
from planner.motion.planning_scene import FULL_TURN_RAD, Chain, Scene
from planner.motion.search.reach import MARGIN_PENALTY_S, SOFT_LIMIT_RAD, SOFT_SINGULARITY_RAD
from planner.runtime.executor import SERIAL, Executor
from planner.targets import Targets
from planner.tooling import working_solid


@dataclasses.dataclass(frozen=True)
class HingeResiduals:
    """R values at targets of a path, such as residuals, margins or distances, with their derivatives.

    Attributes:
        index: (R,) target of each value.
        value: (R,) values.
        slope: (R, J) derivatives by joints, or (R, F) by freedoms.
    """

    index: IndexArray
    value: FloatArray
    slope: FloatArray

    @property
    def cost(self) -> float:
        """Sum of the squares of the residuals."""
        return float(np.sum(self.value * self.value))


def hinge_residuals(
    margin: FloatArray, slope: FloatArray, hard: float, soft: float, weight: float, index: IndexArray
) -> HingeResiduals:
    """Compute the residuals sqrt(weight) (hard + soft - margin) / soft of narrow margins.

    A residual is sqrt(weight) at the margin ``hard`` and 0 at ``hard + soft``.

    Args:
        margin: (R,) margins below ``hard + soft``.
        slope: (R, J) derivatives of the margins.
        hard: Margin that must be kept.
        soft: Width of the range above ``hard`` in which a margin costs something.
        weight: Weight of the squared residual.
        index: (R,) target of each margin.
    """
    factor = np.sqrt(weight) / soft
    return HingeResiduals(index, factor * (hard + soft - margin), -factor * slope)


def margin_residuals(
    scene: Scene, arms: tuple[str, ...], joints: FloatArray, count: int, slopes: bool = True
) -> list[HingeResiduals]:
    """Compute the residuals of narrow margins to joint limits and singularities of all arms.

    Args:
        scene: Cell with the arms.
        arms: Names of the arms.
        joints: (N, J) [rad] joints.
        count: Number of targets of the whole path.
        slopes: Whether derivatives are needed.
    """
    weight = MARGIN_PENALTY_S / count
    return [
        hinge_residuals(margin.value, margin.slope, hard, soft, weight, margin.index)
        for margin, hard, soft in narrow_margins(scene, arms, joints, slopes)
    ]


def narrow_margins(
    scene: Scene, arms: tuple[str, ...], joints: FloatArray, slopes: bool = True
) -> list[tuple[HingeResiduals, float, float]]:
    """Select the narrow margins [rad] to joint limits and singularities of all arms at joints (N, J).

    Returns:
        For each arm and kind of margin: the narrow margins (with zero slopes unless ``slopes``), the margin
        ``hard`` that must be kept, and the width ``soft`` above it up to which a margin is narrow.
    """
    out = []
    for arm, part in scene.columns(arms).items():
        chain = scene.chains[arm]
        q = joints[:, part]
        for margins, gradient, hard, soft in (
            (*_limit_margins(chain, q), scene.settings.joint_margin, SOFT_LIMIT_RAD),
            (
                *_singularity_margins(chain, q, slopes),
                scene.settings.singularity_margin,
                SOFT_SINGULARITY_RAD,
            ),
        ):
            index, column = np.nonzero(margins < hard + soft)
            slope = np.zeros((len(index), joints.shape[1]))
            if slopes:
                slope[:, part] = gradient[index, column]
            out.append((HingeResiduals(index, margins[index, column], slope), hard, soft))
    return out


def _limit_margins(chain: Chain, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute all margins (N, L) [rad] to joint limits at joints ``q`` (N, J), with derivatives (N, L, J).

    The L margins are those to the lower and the upper limits of all joints, then those of axis 3 if a
    parallel rod couples it to joint 2.
    """
    robot, identity = chain.robot, np.eye(q.shape[1])
    margins, slopes = [q - robot.lower, robot.upper - q], [identity, -identity]
    if robot.coupling is not None:
        axis3 = q[:, 1:2] + q[:, 2:3]
        axis3_slope = np.array([[0.0, 1.0, 1.0, 0.0, 0.0, 0.0]])
        margins += [axis3 - robot.coupling.axis3_lower, robot.coupling.axis3_upper - axis3]
        slopes += [axis3_slope, -axis3_slope]
    slope = np.concatenate(slopes)
    return np.concatenate(margins, axis=1), np.broadcast_to(slope, (len(q), *slope.shape))


def _singularity_margins(chain: Chain, q: FloatArray, slopes: bool) -> tuple[FloatArray, FloatArray]:
    """Compute the singularity margins (N, 3) [rad] and their derivatives (N, 3, J), by central differences.

    The derivatives are 0 unless ``slopes``.
    """
    margin = chain.singularities(q)
    gradient = np.zeros((len(q), 3, q.shape[1]))
    if slopes:
        step = 1e-6
        for j in chain.robot.form.singular:
            shift = np.zeros(q.shape[1])
            shift[j] = step
            gradient[:, :, j] = (chain.singularities(q + shift) - chain.singularities(q - shift)) / (
                2.0 * step
            )
    return margin, gradient


def preference_residuals(
    targets: Targets, values: FloatArray, are_rings: BoolArray, count: int
) -> list[HingeResiduals]:
    """Compute the residuals of the distance from preferred values, with derivatives by freedoms.

    Args:
        targets: N targets with freedoms.
        values: (N, F) values of the freedoms.
        are_rings: (F,) whether a freedom is a full turn.
        count: Number of targets of the whole path.
    """
    out = []
    index = np.arange(targets.count)
    for j, freedom in enumerate(targets.freedoms):
        if freedom.prefer is None:
            continue
        deviation = values[:, j] - freedom.prefer
        if are_rings[j]:
            deviation = deviation - FULL_TURN_RAD * np.round(deviation / FULL_TURN_RAD)
        factor = 2.0 * np.sqrt(freedom.weight / count) / np.maximum(freedom.upper - freedom.lower, 1e-12)
        slope = np.zeros((targets.count, values.shape[1]))
        slope[:, j] = factor
        out.append(HingeResiduals(index, factor * deviation, slope))
    return out


SOFT_CLEARANCE_M: Final = 0.008
"""Width [m] of the range above the required clearance in which a distance of bodies costs something."""

QUERY_DISTANCE_M: Final = 0.080
"""Distance [m] up to which distances are queried."""

BOUND_RANGE_M: Final = 0.25
"""Extra distance [m] up to which bounds are computed, so that it is known how far joints may move before the
next query.
"""

CLOSE_RANGE_M: Final = 0.02
"""Extra distance [m] up to which bounds are computed while steps of the optimiser are so large that no bound
would hold for the next step.
"""

QUERY_STRIDE: Final = 16
"""Stride of the targets of a new path whose distances are queried first."""
BOUND_ERROR_M: Final = 1e-4
"""Reduction [m] of bounds, larger than the errors of the underlying solvers."""
MIN_HAND_EXTENT_M: Final = 0.1
"""Minimum extent [m] of a hand beyond its TCP, for the levers of joints."""

MIN_WRIST_LEVER_M: Final = 0.25
"""Minimum lever [m] of the wrist axes for pairs of hand and forearm."""

MIN_SHARED_BATCHES: Final = 4
"""Number of batches of bounds from which on every other batch is computed in another process."""


def _lower_bounds(
    bounds: ClearanceBounds, poses: Mapping[str, FloatArray], limit: float
) -> Iterator[FloatArray]:
    """Yield lower bounds (B,) [m] of the smallest distance of bodies at poses, at most ``limit`` [m]."""
    yield bounds.min_distance_bounds(poses, limit, both=False)[0]


class ClearancePenalty:
    """Penalty for small distances between bodies along a path, at joints (N, J) of the arms that move.

    Each distance below the required clearance plus :data:`SOFT_CLEARANCE_M` is a residual.

    Distances are queried only at targets where cheap bounds do not exclude that bodies are close. Pairs that
    only the wrist moves relative to each other (hand and forearm of one arm) are always close and would make
    the bounds useless. They are called local pairs and tracked by their gradients instead.

    Attributes:
        query_count: Number of targets whose distances were queried.
    """

    def __init__(
        self,
        model: CellModel,
        arms: tuple[str, ...],
        required: float,
        weight: float,
        kinds: Sequence[tuple[Pairs, IndexArray]] = (),
        executor: Executor = SERIAL,
    ) -> None:
        """Prepare the bounds.

        Args:
            model: Collision model.
            arms: Arms that move.
            required: Required clearance [m].
            weight: Weight of the squared residuals.
            kinds: Pairs of bodies that may touch, with the indices of the targets at which they may.
            executor: Computes half of the bounds if there are many.
        """
        self._model, self._arms, self._required, self._weight = model, arms, required, weight
        self._executor = executor
        self.query_count = 0
        self._columns = np.concatenate([np.arange(model.home.size)[model.columns[arm]] for arm in arms])
        self._parts = joint_columns({arm: model.robots[arm] for arm in arms})
        self._levers = np.concatenate([joint_levers(model, arm) for arm in arms])
        self._wrist_lever = max(
            MIN_WRIST_LEVER_M, *(_hand_extent(model, arm) for arm in arms if _is_long_hand(model, arm)), 0.0
        )
        unmoved = clearance.unmoved_pairs(model, arms)  # pairs whose distance no joint here changes
        self._ignored_pairs = [pairs | unmoved for pairs, _ in kinds] or [unmoved]
        self._kinds = list(kinds)
        self._kind = np.zeros(0, dtype=np.intp)  # (N,) index of the kind of each target
        local = _local_pairs(model, arms)
        self._bounds = [model.bounds.without_bodies(local | pairs) for pairs in self._ignored_pairs]
        self._mask_by_pair = self._moving_joint_masks()
        # joints (N, J) at which bounds (N,) and distances were computed last
        self._bound_joints = self._queried_joints = np.zeros((0, 0))
        self._bound = np.zeros(0)
        # distances (N, P), gradients (N, P, J) and masks (N, P, J) of the pairs at each target, padded
        self._distance = np.zeros((0, 0))
        self._gradient = self._mask = np.zeros((0, 0, 0))

    def cost(self, q: FloatArray) -> float:
        """Return the sum of the squared residuals at joints (N, J)."""
        return float(np.sum(self._residual_values(self._near_targets(q)) ** 2))

    def rows(self, q: FloatArray) -> list[HingeResiduals]:
        """Return the residuals above 0 at joints (N, J)."""
        index = self._near_targets(q)
        values = self._residual_values(index)
        row, pair = np.nonzero(values > 0.0)
        slope = -np.sqrt(self._weight) / SOFT_CLEARANCE_M * self._gradient[index[row], pair]
        return [HingeResiduals(index[row], values[row, pair], slope)]

    def near_distances(self, q: FloatArray) -> HingeResiduals:
        """Return all distances [m] below the required clearance plus the soft range, at joints (N, J)."""
        index = self._near_targets(q)
        row, pair = np.nonzero(self._distance[index] < self._required + SOFT_CLEARANCE_M)
        near = index[row]
        return HingeResiduals(near, self._distance[near, pair], self._gradient[near, pair])

    def _residual_values(self, index: IndexArray) -> FloatArray:
        """Return the residuals (K, P) of the stored distances at targets ``index`` (K,)."""
        excess = np.maximum(self._required + SOFT_CLEARANCE_M - self._distance[index], 0.0)
        return np.asarray(np.sqrt(self._weight) / SOFT_CLEARANCE_M * excess)

    def _near_targets(self, q: FloatArray) -> IndexArray:
        """Return the targets at which bodies may be closer than the required clearance plus the soft range.

        The distances that are stored for these targets are those at joints ``q`` (N, J) afterwards.
        """
        if self._queried_joints.shape != q.shape:
            self._initialise(q)
        limit = self._required + SOFT_CLEARANCE_M
        may_be_near = self._clearance_bounds(q) < limit
        # Local pairs: distance >= d + g . dq - 0.5 lever * |dq_wrist|^2 (second-order bound)
        step = q - self._queried_joints
        # sum of the changes of those joints that move the bodies of a pair relative to each other
        wrist_part = np.einsum("nkj,nj->nk", self._mask, np.abs(step))
        linear = self._distance + np.einsum("nkj,nj->nk", self._gradient, step)
        linear -= 0.5 * self._wrist_lever * wrist_part * wrist_part
        local_near = (self._mask.sum(axis=-1) <= 2.0) & (linear < limit)  # moved by at most two joints: local
        joint_changes = np.abs(step)
        wrist_change = np.max(
            [joint_changes[:, part][:, -2:].sum(axis=-1) for part in self._parts.values()], axis=0
        )
        may_be_near |= local_near.any(axis=1) | (QUERY_DISTANCE_M - self._wrist_lever * wrist_change < limit)
        # any pair: d >= d0 + g.dq - max(lever) |dq|_1^2 / 2 if measured, else QUERY_DISTANCE_M - lever.|dq|
        measured = linear + 0.5 * (self._wrist_lever - self._levers.max()) * wrist_part * wrist_part
        unmeasured = QUERY_DISTANCE_M - np.abs(step) @ self._levers
        lower = np.minimum(unmeasured, measured.min(axis=1, initial=np.inf))
        may_be_near &= ~(self._is_queried & (lower > limit))
        index = np.flatnonzero(may_be_near)
        self._query(q, index[step[index].any(axis=1) | ~self._is_queried[index]])
        return index

    def _clearance_bounds(self, q: FloatArray) -> FloatArray:
        """Return lower bounds (N,) [m] of the smallest distance of all but local pairs at joints (N, J).

        Bounds at earlier joints are reduced by the largest displacement since then. They are recomputed only
        where the result would be below the limit that matters.
        """
        limit = self._required + SOFT_CLEARANCE_M
        # d(q) >= d(q0) - sum of lever_j |q_j - q0_j|
        displacement = np.abs(q - self._bound_joints) @ self._levers
        bound = self._bound - displacement
        # a body that was closer than the limit by more than it moved is still close: no new bound is needed
        is_doubtful = (bound < limit) & (np.isneginf(self._bound) | (self._bound + displacement >= limit))
        extra_range = BOUND_RANGE_M if float(np.median(displacement)) < BOUND_RANGE_M else CLOSE_RANGE_M
        # batches of at most CONFIGURATIONS_AT_ONCE targets; -(-a // b) is a / b rounded up
        batches = [
            (bounds, index)
            for kind, bounds in enumerate(self._bounds)
            for rows in [np.flatnonzero(is_doubtful & (self._kind == kind))]
            for index in np.array_split(rows, -(-len(rows) // clearance.CONFIGURATIONS_AT_ONCE) or 1)
            if len(index)
        ]
        executor = self._executor if len(batches) >= MIN_SHARED_BATCHES else SERIAL
        submitted = [
            executor.submit(_lower_bounds, *self._posed_bounds(q, *batch), limit + extra_range)
            for batch in batches[1::2]
        ]
        for k, (bounds, index) in enumerate(batches):
            lower = next(
                submitted[k // 2]
                if k % 2
                else _lower_bounds(*self._posed_bounds(q, bounds, index), limit + extra_range)
            )
            bound[index] = np.minimum(lower, limit + extra_range) - BOUND_ERROR_M
            self._bound[index], self._bound_joints[index] = bound[index], q[index]
        return np.asarray(bound)

    def _posed_bounds(
        self, q: FloatArray, bounds: ClearanceBounds, index: IndexArray
    ) -> tuple[ClearanceBounds, Mapping[str, FloatArray]]:
        """Return the bounds, and the poses of all bodies at the targets ``index`` (B,) of joints (N, J)."""
        rows = self._model.stack_rows({arm: q[index, part] for arm, part in self._parts.items()})
        return bounds, self._model.at_rows(index).poses(self._model.split_by_arm(rows))

    def _initialise(self, q: FloatArray) -> None:
        """Start with a new path: query every :data:`QUERY_STRIDE`-th target.

        The results are stored for the following targets as well, together with the joints to which they
        apply, so that they serve as bounds there.
        """
        self._queried_joints, self._bound_joints = q.copy(), q.copy()
        self._bound = np.full(len(q), -np.inf)
        self._is_queried = np.zeros(len(q), dtype=bool)
        self._kind = np.zeros(len(q), dtype=np.intp)
        for kind, (_, rows) in enumerate(self._kinds):
            self._kind[rows] = kind
        index = np.arange(0, len(q), QUERY_STRIDE)
        self._query(q, index)
        source = index[np.arange(len(q)) // QUERY_STRIDE]
        self._queried_joints = q[source]
        self._distance, self._gradient = self._distance[source], self._gradient[source]
        self._mask = self._mask[source]

    def _query(self, q: FloatArray, index: IndexArray) -> None:
        """Query distances and gradients at the targets ``index`` (B,) of joints (N, J), and store them.

        Rows of the stored arrays are padded to the largest number of pairs at any target: distance inf,
        gradient and mask 0.
        """
        if not len(index):
            return
        self.query_count += len(index)
        index = np.concatenate([index[self._kind[index] == k] for k in range(len(self._ignored_pairs))])
        queries = []
        for kind, ignored_pairs in enumerate(self._ignored_pairs):
            rows = index[self._kind[index] == kind]
            model_joints = np.repeat(self._model.home[None], len(rows), axis=0)
            model_joints[:, self._columns] = q[rows]
            queries += clearance.distance_gradients_at(
                self._model.at_rows(rows), model_joints, QUERY_DISTANCE_M, ignored_pairs
            )
        self._resize(len(q), max(len(query.distance) for query in queries))
        self._queried_joints[index] = q[index]
        self._is_queried[index] = True
        self._distance[index] = np.inf
        self._gradient[index] = 0.0
        self._mask[index] = 0.0
        width = self._model.home.size
        for i, query in zip(index, queries, strict=True):
            count = len(query.distance)
            self._distance[i, :count] = query.distance
            self._gradient[i, :count] = query.gradient.reshape(count, width)[:, self._columns]
            self._mask[i, :count] = self._mask_by_pair[query.bodies[:, 0], query.bodies[:, 1]]

    def _resize(self, rows: int, count: int) -> None:
        """Make room for ``count`` pairs at each of ``rows`` targets. Results of the same path are kept."""
        stored_count = self._distance.shape[1] if len(self._distance) == rows else 0
        if stored_count >= count and len(self._distance) == rows:
            return
        width = len(self._columns)
        distance, gradient = np.full((rows, count), np.inf), np.zeros((rows, count, width))
        mask = np.zeros((rows, count, width))
        if stored_count:
            distance[:, :stored_count], gradient[:, :stored_count] = self._distance, self._gradient
            mask[:, :stored_count] = self._mask
        self._distance, self._gradient, self._mask = distance, gradient, mask

    def _moving_joint_masks(self) -> FloatArray:
        """Return an array (bodies, bodies, J) that says which joints change the distance of two bodies.

        It is 1 for the joints that move one of the bodies relative to the other, and 0 for other joints.
        """
        bodies = range(self._model.plant.num_bodies())
        names = [self._model.body_name(i) for i in bodies]
        out = np.zeros((len(names), len(names), len(self._columns)))
        for arm, part in self._parts.items():
            joint_counts = [self._model.joints_of(arm, name) for name in names]
            for a, b in itertools.product(bodies, repeat=2):
                low, high = sorted((joint_counts[a], joint_counts[b]))
                out[a, b, part.start + low : part.start + high] = 1.0
        return out


def joint_levers(model: CellModel, arm: str) -> FloatArray:
    """Return bounds (J,) [m/rad] of the displacement of any point of an arm and its tool per joint change."""
    hand, count = _hand_extent(model, arm), model.robots[arm].axes
    return np.array([model.robots[arm].reach + hand] * (count - 3) + [hand] * 3)


def _hand_extent(model: CellModel, arm: str) -> float:
    """Return a bound [m] of the distance from the wrist centre to any point of the tool and what it holds."""
    tool = model.cell.arm(arm).tool
    tcp_extent = float(np.linalg.norm(tool.tcp[:3, 3])) + MIN_HAND_EXTENT_M
    return model.robots[arm].form.hand + max(tcp_extent, _tool_extent(model, arm))


def _tool_extent(model: CellModel, arm: str) -> float:
    """Return the distance [m] from the flange within which the tool, its edge and a held stock lie."""
    extent = 0.0
    for solid in model.solids:
        if model.carrier(solid.body) != arm or not solid.body.endswith(("/tool", "/edge", "stock")):
            continue
        pose = solid.shape.pose
        if solid.body == "stock":
            pose = model.cell.arm(arm).tool.tcp @ model.stock.grip @ pose
        corners = 0.5 * bounding_size(solid) * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        extent = max(extent, float(np.linalg.norm(transform(pose, corners), axis=1).max()))
    return extent


def _is_long_hand(model: CellModel, arm: str) -> bool:
    """Whether a hand holds a stock or a tool with a rigid edge, and so extends farther than a wire holder."""
    return model.stock.held_by == arm or working_solid(model.cell.arm(arm).tool) is not None


def _local_pairs(model: CellModel, arms: tuple[str, ...]) -> Pairs:
    """Return the pairs of bodies of one arm that only its last two axes move relative to each other.

    These are the forearm with each of the wrist, the flange, the tool, its edge and a held stock.
    """
    pairs = set()
    for arm in arms:
        *_, forearm, wrist, flange, tool = link_chain(model.robots[arm].axes)
        pairs |= {frozenset((f"{arm}/{forearm}", f"{arm}/{end}")) for end in (wrist, flange, tool, "edge")}
        if model.stock.held_by == arm:
            pairs.add(frozenset((f"{arm}/{forearm}", "stock")))
    return frozenset(pairs)
