"""Hinge costs of the optimiser: residuals that are 0 while a margin is wide, and grow as it narrows.

Margins to joint limits and singular postures, distance from preferred values, and clearance of
bodies, which Drake is asked for only where it may matter.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import columns_of
from planner.cell import clearance
from planner.cell.bodies import extent, link_chain
from planner.cell.bounds import Bounds
from planner.cell.clearance import Pairs
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, transform
from planner.motion.planning_scene import FULL_TURN, Chain, Scene
from planner.motion.search.reach import PENALTY, SOFT_LIMIT_RAD, SOFT_SINGULARITY_RAD
from planner.runtime.executor import SERIAL, Executor
from planner.targets import Targets
from planner.tooling import working_solid


@dataclasses.dataclass(frozen=True)
class Rows:
    """R residuals: ``index`` (R,) of their targets, ``value`` (R,), ``slope`` (R, J) by joints (or by
    freedoms)."""

    index: IndexArray
    value: FloatArray
    slope: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(np.sum(self.value * self.value))


def hinge(
    margin: FloatArray, slope: FloatArray, hard: float, soft: float, weight: float, index: IndexArray
) -> Rows:
    """Residuals of margins (R,) with their slopes (R, J): sqrt(weight) at ``hard``, 0 from ``hard + soft``
    on."""
    factor = np.sqrt(weight) / soft
    return Rows(index, factor * (hard + soft - margin), -factor * slope)


def margin_rows(
    scene: Scene, arms: tuple[str, ...], joints: FloatArray, count: int, slopes: bool = True
) -> list[Rows]:
    """Hinges on joint limits and singularities of all arms at joints (N, J); ``count``: of how many targets
    the path is."""
    weight = PENALTY / count
    return [
        hinge(margin.value, margin.slope, hard, soft, weight, margin.index)
        for margin, hard, soft in near_margins(scene, arms, joints, slopes)
    ]


def near_margins(
    scene: Scene, arms: tuple[str, ...], joints: FloatArray, slopes: bool = True
) -> list[tuple[Rows, float, float]]:
    """Margins [rad] to joint limits and singularities of all arms at joints (N, J) that are near, their
    slopes 0 without ``slopes``; with each the margin that must stay and the width that counts above it."""
    out = []
    for arm, part in scene.columns(arms).items():
        chain = scene.chains[arm]
        q = joints[:, part]
        for margins, gradient, hard, soft in (
            (*_limits(chain, q), scene.settings.joint_margin, SOFT_LIMIT_RAD),
            (*_singularities(chain, q, slopes), scene.settings.singularity_margin, SOFT_SINGULARITY_RAD),
        ):
            index, which = np.nonzero(margins < hard + soft)
            slope = np.zeros((len(index), joints.shape[1]))
            if slopes:
                slope[:, part] = gradient[index, which]
            out.append((Rows(index, margins[index, which], slope), hard, soft))
    return out


def _limits(chain: Chain, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """All limit margins (N, L) and their slopes (N, L, J)."""
    robot, one = chain.robot, np.eye(q.shape[1])
    margins, slopes = [q - robot.lower, robot.upper - q], [one, -one]
    if robot.coupling is not None:
        axis3 = q[:, 1:2] + q[:, 2:3]
        row = np.array([[0.0, 1.0, 1.0, 0.0, 0.0, 0.0]])
        margins += [axis3 - robot.coupling.axis3_lower, robot.coupling.axis3_upper - axis3]
        slopes += [row, -row]
    slope = np.concatenate(slopes)
    return np.concatenate(margins, axis=1), np.broadcast_to(slope, (len(q), *slope.shape))


def _singularities(chain: Chain, q: FloatArray, slopes: bool) -> tuple[FloatArray, FloatArray]:
    """Singularity margins (N, 3) and their slopes (N, 3, J), by central differences."""
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


def preference_rows(targets: Targets, values: FloatArray, rings: BoolArray, count: int) -> list[Rows]:
    """Residuals (slopes by freedoms) of the distance from preferred values; ``count`` as above."""
    out = []
    index = np.arange(targets.count)
    for j, freedom in enumerate(targets.freedoms):
        if freedom.prefer is None:
            continue
        away = values[:, j] - freedom.prefer
        if rings[j]:
            away = away - FULL_TURN * np.round(away / FULL_TURN)
        factor = 2.0 * np.sqrt(freedom.weight / count) / np.maximum(freedom.upper - freedom.lower, 1e-12)
        slope = np.zeros((targets.count, values.shape[1]))
        slope[:, j] = factor
        out.append(Rows(index, factor * away, slope))
    return out


SOFT_CLEARANCE_M: Final = 0.008
"""Distances [m] up to this above the wanted clearance cost something."""

QUERY_DISTANCE_M: Final = 0.080
"""Distances [m] up to this are asked for."""

BOUND_RANGE_M: Final = 0.25
"""Bounds are worked out up to this far [m] beyond, so that it is known how far joints may move before they
are again."""

CLOSE_RANGE_M: Final = 0.02
"""The same while steps are so large that no bound would hold for the next."""

QUERY_STRIDE: Final = 16
"""Of a new path every so many targets are asked for their distances first."""
BOUND_ERROR: Final = 1e-4
"""Bounds count less by this [m], above the errors of the solvers behind them."""
HAND_REACH_M: Final = 0.1
"""How far [m] a hand is taken to reach beyond its TCP at least, for how far joints carry it."""

WRIST_LEVER_M: Final = 0.25
"""Least lever [m] of the wrist's axes for pairs of hand and forearm."""


SHARED_PARTS: Final = 4
"""Of so many parts of targets with bounds to work out, or more, every other one goes to another process."""


def _bounded(bounds: Bounds, poses: Mapping[str, FloatArray], limit: float) -> Iterator[FloatArray]:
    """Lower bounds (B,) [m] of the least distance of bodies at poses, up to ``limit``."""
    yield bounds.least(poses, limit, both=False)[0]


class Avoid:
    """Hinges on all distances below the wanted clearance and a little more, at joints (N, J) of ``arms``.

    Distances are measured only at rows where cheap bounds do not show that nothing is near. Pairs that only
    the wrist moves against each other (hand and forearm of one arm) are always near, and would spoil the
    bounds: they are followed by their gradients. ``kinds`` are pairs of bodies that may meet, with the rows
    where they may. ``soft`` [m]: distances up to this above ``wanted`` count.
    ``asked`` counts the targets that were measured. ``executor`` computes half of the
    bounds if there are many.
    """

    def __init__(
        self,
        model: CellModel,
        arms: tuple[str, ...],
        wanted: float,
        weight: float,
        kinds: Sequence[tuple[Pairs, IndexArray]] = (),
        soft: float = SOFT_CLEARANCE_M,
        executor: Executor = SERIAL,
    ) -> None:
        self._model, self._arms, self._wanted, self._weight = model, arms, wanted, weight
        self._soft, self._executor = soft, executor
        self.asked = 0
        self._columns = np.concatenate([np.arange(model.home.size)[model.columns[arm]] for arm in arms])
        self._parts = columns_of({arm: model.robots[arm] for arm in arms})
        self._levers = np.concatenate([levers(model, arm) for arm in arms])
        self._wrist = max(WRIST_LEVER_M, *(_hand(model, arm) for arm in arms if _is_long(model, arm)), 0.0)
        resting = clearance.resting(model, arms)  # nothing that is done here changes these
        self._meeting = [pairs | resting for pairs, _ in kinds] or [resting]
        self._kinds = list(kinds)
        self._kind = np.zeros(0, dtype=np.intp)
        local = _local_pairs(model, arms)
        self._bounds = [model.bounds.among(local | pairs) for pairs in self._meeting]
        self._table = self._masks()
        self._bound_at = self._at = np.zeros((0, 0))
        self._bound = np.zeros(0)
        self._distance = np.zeros((0, 0))
        self._gradient = self._mask = np.zeros((0, 0, 0))

    def cost(self, q: FloatArray) -> float:
        """Sum of squares of the hinges."""
        return float(np.sum(self._values(self._near(q)) ** 2))

    def rows(self, q: FloatArray) -> list[Rows]:
        """Hinges at joints q (N, J)."""
        index = self._near(q)
        values = self._values(index)
        row, which = np.nonzero(values > 0.0)
        slope = -np.sqrt(self._weight) / self._soft * self._gradient[index[row], which]
        return [Rows(index[row], values[row, which], slope)]

    def distances(self, q: FloatArray) -> Rows:
        """All distances [m] below ``wanted`` and ``soft`` more, and their slopes by joints q (N, J)."""
        index = self._near(q)
        row, which = np.nonzero(self._distance[index] < self._wanted + self._soft)
        at = index[row]
        return Rows(at, self._distance[at, which], self._gradient[at, which])

    def _values(self, index: IndexArray) -> FloatArray:
        near = np.maximum(self._wanted + self._soft - self._distance[index], 0.0)
        return np.asarray(np.sqrt(self._weight) / self._soft * near)

    def _near(self, q: FloatArray) -> IndexArray:
        """Rows that may be near something; what is known of these is then exact."""
        if self._at.shape != q.shape:
            self._start(q)
        limit = self._wanted + self._soft
        near = self._lower(q) < limit
        step = q - self._at
        part = np.einsum("nkj,nj->nk", self._mask, np.abs(step))
        linear = self._distance + np.einsum("nkj,nj->nk", self._gradient, step)
        linear -= 0.5 * self._wrist * part * part
        local = (self._mask.sum(axis=-1) <= 2.0) & (linear < limit)
        turned = np.abs(step)
        wrist = np.max([turned[:, part][:, -2:].sum(axis=-1) for part in self._parts.values()], axis=0)
        near |= local.any(axis=1) | (QUERY_DISTANCE_M - self._wrist * wrist < limit)
        curved = linear + 0.5 * (self._wrist - self._levers.max()) * part * part
        beyond = QUERY_DISTANCE_M - np.abs(step) @ self._levers
        near &= ~(self._own & (np.minimum(beyond, curved.min(axis=1, initial=np.inf)) > limit))
        index = np.flatnonzero(near)
        self._ask(q, index[step[index].any(axis=1) | ~self._own[index]])
        return index

    def _lower(self, q: FloatArray) -> FloatArray:
        """Lower bounds (N,) of the least distance of all but local pairs, worked out anew only where they may
        matter."""
        limit = self._wanted + self._soft
        moved = np.abs(q - self._bound_at) @ self._levers
        bound = self._bound - moved
        # what was nearer by more than it moved is near still
        doubt = (bound < limit) & (np.isneginf(self._bound) | (self._bound + moved >= limit))
        far = BOUND_RANGE_M if float(np.median(moved)) < BOUND_RANGE_M else CLOSE_RANGE_M
        parts = [
            (bounds, index)
            for kind, bounds in enumerate(self._bounds)
            for rows in [np.flatnonzero(doubt & (self._kind == kind))]
            for index in np.array_split(rows, -(-len(rows) // clearance.CONFIGURATIONS_AT_ONCE) or 1)
            if len(index)
        ]
        executor = self._executor if len(parts) >= SHARED_PARTS else SERIAL
        aside = [executor.submit(_bounded, *self._placed(q, *part), limit + far) for part in parts[1::2]]
        for k, (bounds, index) in enumerate(parts):
            lower = next(aside[k // 2] if k % 2 else _bounded(*self._placed(q, bounds, index), limit + far))
            bound[index] = np.minimum(lower, limit + far) - BOUND_ERROR
            self._bound[index], self._bound_at[index] = bound[index], q[index]
        return np.asarray(bound)

    def _placed(
        self, q: FloatArray, bounds: Bounds, index: IndexArray
    ) -> tuple[Bounds, Mapping[str, FloatArray]]:
        """Bounds, and poses of their bodies at the rows ``index`` of q."""
        rows = self._model.stack({arm: q[index, part] for arm, part in self._parts.items()})
        return bounds, self._model.at_rows(index).poses(self._model.split(rows))

    def _start(self, q: FloatArray) -> None:
        """Asks at a few rows; what is found there of local pairs holds for their neighbours to begin with."""
        self._at, self._bound_at = q.copy(), q.copy()
        self._bound = np.full(len(q), -np.inf)
        self._own = np.zeros(len(q), dtype=bool)
        self._kind = np.zeros(len(q), dtype=np.intp)
        for kind, (_, rows) in enumerate(self._kinds):
            self._kind[rows] = kind
        index = np.arange(0, len(q), QUERY_STRIDE)
        self._ask(q, index)
        source = index[np.arange(len(q)) // QUERY_STRIDE]
        self._at = q[source]
        self._distance, self._gradient = self._distance[source], self._gradient[source]
        self._mask = self._mask[source]

    def _ask(self, q: FloatArray, index: IndexArray) -> None:
        if not len(index):
            return
        self.asked += len(index)
        index = np.concatenate([index[self._kind[index] == k] for k in range(len(self._meeting))])
        found = []
        for kind, meeting in enumerate(self._meeting):
            part = index[self._kind[index] == kind]
            full = np.repeat(self._model.home[None], len(part), axis=0)
            full[:, self._columns] = q[part]
            found += clearance.gradients_at(self._model.at_rows(part), full, QUERY_DISTANCE_M, meeting)
        self._widen(len(q), max(len(one.distance) for one in found))
        self._at[index] = q[index]
        self._own[index] = True
        self._distance[index] = np.inf
        self._gradient[index] = 0.0
        self._mask[index] = 0.0
        width = self._model.home.size
        for i, one in zip(index, found, strict=True):
            count = len(one.distance)
            self._distance[i, :count] = one.distance
            self._gradient[i, :count] = one.gradient.reshape(count, width)[:, self._columns]
            self._mask[i, :count] = self._table[one.bodies[:, 0], one.bodies[:, 1]]

    def _widen(self, rows: int, count: int) -> None:
        have = self._distance.shape[1] if len(self._distance) == rows else 0
        if have >= count and len(self._distance) == rows:
            return
        wide = len(self._columns)
        distance, gradient = np.full((rows, count), np.inf), np.zeros((rows, count, wide))
        mask = np.zeros((rows, count, wide))
        if have:
            distance[:, :have], gradient[:, :have] = self._distance, self._gradient
            mask[:, :have] = self._mask
        self._distance, self._gradient, self._mask = distance, gradient, mask

    def _masks(self) -> FloatArray:
        """(bodies, bodies, J) 1 for the joints that move one body of a pair against the other."""
        bodies = range(self._model.plant.num_bodies())
        names = [self._model.body_name(i) for i in bodies]
        out = np.zeros((len(names), len(names), len(self._columns)))
        for arm, part in self._parts.items():
            moved = [self._model.joints_of(arm, name) for name in names]
            for a, b in itertools.product(bodies, repeat=2):
                low, high = sorted((moved[a], moved[b]))
                out[a, b, part.start + low : part.start + high] = 1.0
        return out


def levers(model: CellModel, arm: str) -> FloatArray:
    """How far (J,) [m/rad] each joint can at most carry a point of its arm."""
    hand, count = _hand(model, arm), model.robots[arm].axes
    return np.array([model.robots[arm].reach + hand] * (count - 3) + [hand] * 3)


def _hand(model: CellModel, arm: str) -> float:
    """Greatest distance [m] of the hand, with what it holds, from the wrist's centre."""
    tool = model.cell.arm(arm).tool
    out = float(np.linalg.norm(tool.tcp[:3, 3])) + HAND_REACH_M
    return model.robots[arm].form.hand + max(out, _outermost(model, arm))


def _outermost(model: CellModel, arm: str) -> float:
    """Distance [m] from the flange within which the tool, its edge and a held block lie."""
    far = 0.0
    for solid in model.solids:
        if model.carrier(solid.body) != arm or not solid.body.endswith(("/tool", "/edge", "stock")):
            continue
        pose = solid.shape.pose
        if solid.body == "stock":
            pose = model.cell.arm(arm).tool.tcp @ model.stock.grip @ pose
        corners = 0.5 * extent(solid) * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        far = max(far, float(np.linalg.norm(transform(pose, corners), axis=1).max()))
    return far


def _is_long(model: CellModel, arm: str) -> bool:
    """Whether a hand reaches farther than wire holders do: it holds a block or has a rigid edge."""
    return model.stock.held_by == arm or working_solid(model.cell.arm(arm).tool) is not None


def _local_pairs(model: CellModel, arms: tuple[str, ...]) -> Pairs:
    """Pairs of bodies of one arm that its last two axes alone move against each other."""
    pairs = set()
    for arm in arms:
        *_, before, one, last, tool = link_chain(model.robots[arm].axes)
        pairs |= {frozenset((f"{arm}/{before}", f"{arm}/{end}")) for end in (one, last, tool, "edge")}
        if model.stock.held_by == arm:
            pairs.add(frozenset((f"{arm}/{before}", "stock")))
    return frozenset(pairs)
