"""Reach: freedoms sampled at all targets, with all branches and turns of every arm, margins and collisions.

A sample of the freedoms is checked for collisions once, when it is first needed.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.cell.clearance import Pairs
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.motion.planning_scene import FULL_TURN_RAD, Chain, Scene
from planner.targets import Freedom, JointFreedom, ScrewFreedom, Targets

SPIN_STEP_RAD = np.deg2rad(10.0)
"""Step [rad] of samples of a rotational freedom."""
SLIDE_SAMPLES = 5
"""Number of samples of a slide or table."""
MAX_SAMPLES = 500_000
"""Maximum number of samples of all targets. Freedoms with the most samples are reduced first."""

SOFT_LIMIT_RAD = np.deg2rad(20.0)
"""Distance [rad] beyond the required margin to a joint limit below which postures are penalised."""
SOFT_SINGULARITY_RAD = np.deg2rad(15.0)
"""Distance [rad] beyond the required margin to a singularity below which postures are penalised."""
MARGIN_PENALTY_S = 5.0
"""Total penalty [s] of a path that stays at the required margin all along."""


@dataclasses.dataclass(frozen=True)
class SampleGrid:
    """S samples of the freedoms at each target, and the steps from sample to sample between targets.

    Samples of a full turn form a ring, others a line. One step changes each freedom by at most one sample,
    unless more are allowed.

    Attributes:
        values: (N, S, F) values of the freedoms.
        predecessors: (M, S) for each of M kinds of step, such as "freedom 1 one sample up", the sample of the
            previous target from which a sample is reached, -1 for none.
    """

    values: FloatArray
    predecessors: IndexArray

    @property
    def samples(self) -> int:
        """Number of samples S."""
        return int(self.values.shape[1])


@dataclasses.dataclass(frozen=True)
class BranchStates:
    """States of one arm on one branch at every target and sample.

    Attributes:
        arm: Name of the arm.
        branch: Branch number.
        q: (N, S, J) [rad] angles as from :meth:`Chain.inverse`, NaN out of reach.
        turns: (T, J) [rad] whole turns of the joints that can be added to ``q``.
        ok: (N, S, T) whether the state keeps the margins to limits and singularities.
        penalty: (N, S, T) [s] penalty for small margins, inf if the state does not keep them.
        has_turns: Whether states that differ only by turns are distinguished.
    """

    arm: str
    branch: int
    q: FloatArray
    turns: FloatArray
    ok: BoolArray
    penalty: FloatArray
    has_turns: bool = True

    def without_turns(self) -> "BranchStates":
        """Return states in which turns are not distinguished, with the smallest penalty of any turn."""
        return dataclasses.replace(
            self,
            turns=np.zeros((1, self.q.shape[-1])),
            ok=np.asarray(self.ok.any(axis=-1, keepdims=True)),
            penalty=self.penalty.min(axis=-1, keepdims=True),
            has_turns=False,
        )


@dataclasses.dataclass(frozen=True)
class ArmReach:
    """All B branches of one arm.

    Attributes:
        arm: Name of the arm.
        branches: Branches that have an allowed state at every target.
        exists: (B, N) whether a branch has an allowed state.
        solved: (B, N) whether a branch has a solution regardless of limits.
    """

    arm: str
    branches: dict[int, BranchStates]
    exists: BoolArray
    solved: BoolArray


def is_full_turn(freedom: Freedom) -> bool:
    """Whether a freedom is a spin that may turn without end at every target."""
    if not isinstance(freedom, ScrewFreedom) or not freedom.periodic:
        return False
    return bool(np.all(freedom.upper - freedom.lower >= FULL_TURN_RAD - 1e-9))


def is_sampled_as_slide(freedom: Freedom) -> bool:
    """Whether a freedom is sampled at few positions instead of steps of an angle.

    This holds for slides and tables, which rotate nothing, and for a redundant joint if there are freedoms
    that rotate.
    """
    if isinstance(freedom, JointFreedom):
        return not freedom.is_sole_rotation
    return not (isinstance(freedom, ScrewFreedom) and any(np.any(a[:3]) for a in freedom.axis.values()))


def sample_freedoms(
    targets: Targets, spin_step: float = SPIN_STEP_RAD, slides: int = SLIDE_SAMPLES, max_step: int = 1
) -> SampleGrid:
    """Sample all freedoms on a product grid.

    Bounded freedoms are sampled between their bounds at each target, so that a narrow window is never missed.

    Args:
        targets: Targets with their freedoms.
        spin_step: Step [rad] of rotational freedoms.
        slides: Number of samples of slides and tables.
        max_step: Maximum number of samples by which a freedom changes in one step, if only one freedom is
            sampled. With more freedoms it is 1.
    """
    counts = [_sample_count(f, spin_step, slides) for f in targets.freedoms]
    while counts and int(np.prod(counts)) * targets.count > MAX_SAMPLES and max(counts) > 2:
        largest = int(np.argmax(counts))
        counts[largest] = max(2, counts[largest] // 2)
    are_rings = [is_full_turn(f) for f in targets.freedoms]
    # one row for each sample, with the number of the value that each freedom takes
    numbers = np.array(list(itertools.product(*(range(c) for c in counts))), dtype=np.intp)
    numbers = numbers.reshape(int(np.prod(counts)), len(counts))
    columns = [
        _sample_values(f, numbers[:, j], counts[j], is_ring)
        for j, (f, is_ring) in enumerate(zip(targets.freedoms, are_rings, strict=True))
    ]
    shape = (targets.count, len(numbers))
    values = np.stack(columns, axis=-1) if columns else np.zeros((*shape, 0))
    return SampleGrid(values, _predecessors(numbers, counts, are_rings, max_step))


def _sample_count(freedom: Freedom, spin_step: float, slides: int) -> int:
    """Return the number of values of one freedom; the arguments are those of :func:`sample_freedoms`.

    It is 1 for an empty range, at least 4 for a full turn and at least 3 for a bounded rotation.
    """
    width = float(np.max(freedom.upper - freedom.lower))
    if width <= 0.0:
        return 1
    if is_sampled_as_slide(freedom):
        return slides
    if is_full_turn(freedom):
        return max(4, round(FULL_TURN_RAD / spin_step))
    return max(3, int(np.ceil(width / spin_step)) + 1)


def _sample_values(freedom: Freedom, numbers: IndexArray, count: int, is_ring: bool) -> FloatArray:
    """Return values (N, S) of a freedom at N targets, given their numbers (S,) from 0 to ``count`` - 1."""
    rows = len(freedom.lower)
    if is_ring:
        return np.broadcast_to(-np.pi + FULL_TURN_RAD * numbers / count, (rows, len(numbers)))
    fraction = numbers / max(count - 1, 1) if count > 1 else np.full(len(numbers), 0.5)
    return freedom.lower[:, None] + fraction * (freedom.upper - freedom.lower)[:, None]


def _predecessors(numbers: IndexArray, counts: list[int], are_rings: list[bool], max_step: int) -> IndexArray:
    """Compute the predecessors (M, S) of samples for all kinds of step.

    The kinds are: no change, and one freedom up to ``max_step`` samples up or down. With two freedoms both
    may change in one step.

    Args:
        numbers: (S, F) number of the value of each freedom in each sample.
        counts: Number of values of each freedom.
        are_rings: Whether the last value of each freedom is followed by the first.
        max_step: Maximum number of samples by which the only sampled freedom changes in one step.
    """
    max_step = max_step if sum(count > 1 for count in counts) == 1 else 1
    changes = (0, *itertools.chain.from_iterable((-k, k) for k in range(1, max_step + 1)))
    offsets = list(itertools.product(changes, repeat=len(counts)))
    if len(counts) > 2:
        offsets = [o for o in offsets if np.count_nonzero(o) <= 1]
    offsets = [o for o in offsets if all(c > 1 or s == 0 for c, s in zip(counts, o, strict=True))]
    offsets.sort(key=lambda o: sum(map(abs, o)))
    out = np.empty((len(offsets), len(numbers)), dtype=np.intp)
    for m, offset in enumerate(offsets):
        predecessor = numbers - np.array(offset, dtype=np.intp).reshape(-1)
        exists = np.ones(len(numbers), dtype=bool)
        sample = np.zeros(len(numbers), dtype=np.intp)
        for j, count in enumerate(counts):
            column = predecessor[:, j] % count if are_rings[j] else predecessor[:, j]
            exists &= (column >= 0) & (column < count)
            # index of a sample: mixed radix of its numbers, the last freedom counts fastest
            sample = sample * count + column
        out[m] = np.where(exists, sample, -1)
    return out


def compute_reach(scene: Scene, targets: Targets, grid: SampleGrid) -> dict[str, ArmReach]:
    """Compute the states of all arms on all branches, at all targets and samples of the grid."""
    poses, shape = _sample_poses(scene, targets, grid)
    return {
        arm: _cached_reach(scene, arm, poses[arm], _last_joint(targets, grid, arm), shape)
        for arm in targets.arms
    }


def independent_states(scene: Scene, targets: Targets, grid: SampleGrid) -> dict[str, list[BranchStates]]:
    """Compute the states of all arms on every branch, for targets that are independent of each other.

    A branch of an offset wrist may be another one at the next target, because states are used one by one.
    """
    poses, (rows, samples) = _sample_poses(scene, targets, grid)
    out = {}
    for arm in targets.arms:
        chain = scene.chains[arm]
        count = chain.robot.form.branches
        angles = chain.inverse(poses[arm], last_joint=_last_joint(targets, grid, arm))
        angles = angles.reshape(rows, samples, count, chain.robot.axes)
        out[arm] = [branch_states(scene, chain, branch, angles[:, :, branch]) for branch in range(count)]
    return out


def states_on_branches(
    scene: Scene, targets: Targets, grid: SampleGrid, branch: Mapping[str, int]
) -> dict[str, BranchStates] | None:
    """Compute the states {arm: states} over the grid on one branch of each arm.

    Returns None if there is a target of which no sample has an allowed state for all arms.
    """
    poses, shape = _sample_poses(scene, targets, grid)
    out, is_possible = {}, np.ones(shape, dtype=np.bool_)
    for arm in targets.arms:
        chain = scene.chains[arm]
        q = chain.match_branch(
            poses[arm].reshape(*shape, 4, 4), branch[arm], targets.last_joint_angle(arm, grid.values)
        )
        out[arm] = branch_states(scene, chain, branch[arm], q)
        is_possible &= out[arm].ok.any(axis=2)
        if not is_possible.any(axis=1).all():
            return None
    return out


def _sample_poses(
    scene: Scene, targets: Targets, grid: SampleGrid
) -> tuple[dict[str, FloatArray], tuple[int, int]]:
    """Compute TCP poses {arm: (N * S, 4, 4)} in the world of N targets at their S samples, and (N, S)."""
    rows, samples = grid.values.shape[:2]
    index = np.repeat(np.arange(rows), samples)
    return scene.tcp_poses(targets, grid.values.reshape(rows * samples, -1), index), (rows, samples)


def _last_joint(targets: Targets, grid: SampleGrid, arm: str) -> FloatArray | None:
    """Return the last joint (N * S,) [rad] of an arm in all samples, or None if it is not a freedom."""
    angle = targets.last_joint_angle(arm, grid.values)
    return None if angle is None else angle.reshape(-1)


def _cached_reach(
    scene: Scene, arm: str, pose: FloatArray, joint: FloatArray | None, shape: tuple[int, int]
) -> ArmReach:
    """Compute the reach of one arm, or return that of the previous call with the same poses.

    Paths are searched repeatedly over the same samples.

    Args:
        scene: Cell with the stock in its pose, whose cache is used.
        arm: Name of the arm.
        pose: (N * S, 4, 4) TCP poses in the world.
        joint: (N * S,) [rad] last joint; None if it is not a freedom.
        shape: (N, S).
    """
    cached = scene.reach_cache.get(arm)
    if (
        cached is not None
        and cached[2] == shape
        and np.array_equal(cached[0], pose)
        and _is_same_array(cached[1], joint)
    ):
        arm_reach = cached[3]
        if isinstance(arm_reach, ArmReach):
            return arm_reach
    arm_reach = _compute_arm_reach(scene, scene.chains[arm], pose, joint, shape)
    for states in arm_reach.branches.values():  # cached arrays must not change
        for array in (states.q, states.ok, states.penalty):
            array.flags.writeable = False
    scene.reach_cache[arm] = pose, joint, shape, arm_reach
    return arm_reach


def _is_same_array(first: FloatArray | None, second: FloatArray | None) -> bool:
    return (first is None and second is None) or (first is not None and np.array_equal(first, second))  # type: ignore[arg-type]


def _compute_arm_reach(
    scene: Scene, chain: Chain, pose: FloatArray, joint: FloatArray | None, shape: tuple[int, int]
) -> ArmReach:
    """Compute the reach of one arm on all of its branches.

    The arguments are those of :func:`_cached_reach`. States are kept only of branches that have an allowed
    state at every target.
    """
    count = chain.robot.form.branches
    angles = chain.match_branches(
        chain.inverse(pose, last_joint=joint).reshape(*shape, count, chain.robot.axes)
    )
    allowed_branches: dict[int, BranchStates] = {}
    exists = []
    solved: BoolArray = np.zeros((count, shape[0]), dtype=bool)
    for branch in range(count):
        q = angles[:, :, branch]
        solved[branch] = ~np.isnan(q[..., 0]).all(axis=1)
        states = branch_states(scene, chain, branch, q)
        exists.append(np.asarray(states.ok.any(axis=(1, 2))))
        if exists[branch].all():
            allowed_branches[branch] = states
    return ArmReach(chain.name, allowed_branches, np.stack(exists), solved)


def branch_states(scene: Scene, chain: Chain, branch: int, q: FloatArray) -> BranchStates:
    """Compute the states of one branch from its angles ``q`` (N, S, J) [rad], as from :meth:`Chain.inverse`.

    Turns with which no state keeps its margins are left out, except no turn.
    """
    joint_margin, singularity_margin = scene.settings.joint_margin, scene.settings.singularity_margin
    singularity = chain.singularity_margin(q)
    turns, is_regular = _useful_turns(chain.turns, q), singularity >= singularity_margin
    margins = chain.limit_margins(q, turns)
    allowed = [(margin >= joint_margin) & is_regular for margin in margins]
    used = [k for k, is_allowed in enumerate(allowed) if k == 0 or bool(is_allowed.any())]
    limit = np.stack([margins[k] for k in used], axis=-1)
    ok = np.stack([allowed[k] for k in used], axis=-1)
    turns = turns[used]
    # penalty = MARGIN_PENALTY_S / N (h(limit margin) + h(singularity margin)), h of _squared_hinge
    cost = (
        _squared_hinge(limit, joint_margin, SOFT_LIMIT_RAD)
        + _squared_hinge(singularity, singularity_margin, SOFT_SINGULARITY_RAD)[..., None]
    )
    return BranchStates(
        chain.name, branch, q, turns, ok, np.where(ok, cost * MARGIN_PENALTY_S / len(q), np.inf)
    )


MAX_TURN_COMBINATIONS: Final = 27
"""Number of combinations of whole turns of an arm's joints up to which all are kept: three joints with three
turns each.
"""


def _useful_turns(turns: FloatArray, q: FloatArray) -> FloatArray:
    """Select the turns (T, J) that are worth searching, at most :data:`MAX_TURN_COMBINATIONS` if not all are.

    If there are many turns, only those of joints are kept whose angles ``q`` (N, S, J) may cross the seam of
    their range from one target to the next. Other joints keep their turn on any path, and none gives them a
    larger margin than no turn.
    """
    if len(turns) <= MAX_TURN_COMBINATIONS:
        return turns
    is_missing = np.isnan(q)
    low, high = np.where(is_missing, np.inf, q).min(axis=1), np.where(is_missing, -np.inf, q).max(axis=1)
    largest_change = np.maximum(high[1:] - low[:-1], high[:-1] - low[1:])
    crosses_seam = (largest_change > np.pi).any(axis=0)
    return turns[~turns[:, ~crosses_seam].any(axis=1)][:MAX_TURN_COMBINATIONS]


def _squared_hinge(margin: FloatArray, hard: float, soft: float) -> FloatArray:
    """Return a squared hinge: 1 at the margin ``hard``, falling as a parabola to 0 at ``hard + soft``."""
    return np.square(np.clip((hard + soft - margin) / soft, 0.0, 1.0))


BRANCH_DEPENDENT_LINKS: Final = ("link_1", "link_2", "link_3", "link_4", "link_5")
"""Links whose pose depends on the branch for a given TCP pose.

The last link, which is the flange, is not one of them. Neither is the link before it on arms with seven axes,
for a given sample of the last joint.
"""

COARSE_STRIDE: Final = 12
"""Stride of the targets whose samples are all checked once a path has collided, before the next path is
chosen.
"""

SUSPECT_COST_S: Final = 0.05
"""Cost [s] of a sample between two of these targets if it collides at one of them."""


@dataclasses.dataclass(frozen=True)
class OtherArms:
    """Arms that a search does not move.

    Attributes:
        standing: {arm: (N, 6)} [rad] joints at every target of arms that are avoided.
        absent: Arms that are ignored.
    """

    standing: Mapping[str, FloatArray]
    absent: frozenset[str]

    def ignored_pairs(self, scene: Scene) -> Pairs:
        """Return the pairs of bodies of which at least one belongs to an absent arm."""
        if scene.model is None:
            return frozenset()
        bodies = {solid.body for solid in scene.model.solids}
        absent_bodies = {body for body in bodies if body.partition("/")[0] in self.absent}
        return frozenset(frozenset((a, b)) for a in absent_bodies for b in bodies if a != b)


class SharedCollisions:
    """Collision results that branch combinations share.

    A pair of bodies belongs to an arm if one body is a link of that arm and the other is not a link of
    another arm. It has the same poses in all combinations with the same branch of that arm, because tools and
    held stocks have the poses that targets and samples determine.

    Attributes:
        pairs: {arm: pairs that belong to it}.
        other_pairs: {arm: all other pairs}.
    """

    def __init__(self, scene: Scene, grid: SampleGrid, arms: Sequence[str]) -> None:
        """Find the pairs that belong to each of the arms that take part."""
        bodies = [] if scene.model is None else sorted({solid.body for solid in scene.model.solids})
        owner = {
            body: arm
            for body in bodies
            for arm in arms
            if body in {f"{arm}/{k}" for k in BRANCH_DEPENDENT_LINKS}
        }
        all_pairs = [frozenset(pair) for pair in itertools.combinations(bodies, 2)]
        owners = {pair: {owner[body] for body in pair if body in owner} for pair in all_pairs}
        self.pairs: dict[str, Pairs] = {
            arm: frozenset(pair for pair, arms_of_pair in owners.items() if arms_of_pair == {arm})
            for arm in arms
        }
        self.other_pairs: dict[str, Pairs] = {
            arm: frozenset(all_pairs) - arm_pairs for arm, arm_pairs in self.pairs.items()
        }
        self._shape = grid.values.shape[:2]
        self._results: dict[tuple[str, int], tuple[BoolArray, BoolArray]] = {}

    def known_collisions(self, arm: str, branch: int) -> tuple[BoolArray, BoolArray]:
        """Return the results for the pairs that belong to an arm on a branch.

        Returns:
            Two arrays (N, S): whether each sample of each target has been checked, and whether it collides.
            The caller adds new results to these arrays.
        """
        if (arm, branch) not in self._results:
            unknown = np.zeros(self._shape, dtype=np.bool_)
            self._results[arm, branch] = unknown, unknown.copy()
        return self._results[arm, branch]


class CollisionChecker:
    """Checks samples of one branch combination for collisions, and keeps the results.

    Attributes:
        known: (N, S) whether a sample has been checked.
        collided: (N, S) whether it collides.
        possible: (N, S) whether every arm can take a sample.
        checks: Number of samples that were checked.
        rounds: Number of rounds of a path search, which the search counts.
        suspect_cost: (N, S) [s] cost of samples that probably collide; None until :meth:`check_coarsely`.
    """

    def __init__(
        self,
        scene: Scene,
        targets: Targets,
        grid: SampleGrid,
        states: Mapping[str, BranchStates],
        others: OtherArms | None = None,
        shared: SharedCollisions | None = None,
    ) -> None:
        """Prepare the checks.

        Args:
            scene: Cell with the stock in its pose.
            targets: Targets of the operation.
            grid: Samples of the freedoms.
            states: {arm: states on its branch}.
            others: Arms that the search does not move.
            shared: Results that are shared with other branch combinations; not used with ``others``.
        """
        self._shared = shared if others is None else None
        self._standing = others.standing if others else {}
        self._ignored: Pairs = others.ignored_pairs(scene) if others else frozenset()
        self._scene, self._targets, self._states = scene, targets, states
        shape = grid.values.shape[:2]
        self._shape = (int(shape[0]), int(shape[1]))
        self.collided = np.zeros(shape, dtype=bool)
        self.known = np.zeros(shape, dtype=bool)
        self.checks = self.rounds = 0
        self.suspect_cost: FloatArray | None = None
        self._checks_shared_pairs = False
        is_allowed = np.stack([np.asarray(r.ok.any(axis=-1)) for r in states.values()])
        self.possible = np.asarray(np.logical_and.reduce(is_allowed, axis=0))
        if self._shared is not None:
            for arm, branch_states in states.items():
                self.collided |= self._shared.known_collisions(arm, branch_states.branch)[1] & self.possible
        self.known |= self.collided

    def check_targets(self, rows: IndexArray) -> None:
        """Check all samples of targets ``rows`` (K,) that every arm can take."""
        unknown = np.argwhere(self.possible[rows] & ~self.known[rows])
        self.check_states(rows[unknown[:, 0]], unknown[:, 1])

    def free_samples(self, row: int) -> BoolArray:
        """Return for S samples of target ``row`` whether all arms can take them without collision."""
        self.check_targets(np.array([row]))
        return np.asarray(self.possible[row] & ~self.collided[row])

    def check_states(self, index: IndexArray, sample: IndexArray) -> None:
        """Check samples (B,) of targets ``index`` (B,), except those that are known already.

        The results are stored in :attr:`known` and :attr:`collided`.
        """
        is_new = ~self.known[index, sample]
        index, sample = index[is_new], sample[is_new]
        if len(index) == 0:
            return
        q = {arm: r.q[index, sample] for arm, r in self._states.items()}
        q |= {arm: angles[index] for arm, angles in self._standing.items()}
        ignored = self._ignored
        if self._shared is not None and self._checks_shared_pairs:
            # other branch combinations may reuse the results of the pairs that belong to one arm
            for arm, branch_states in self._states.items():
                self._check_arm_pairs(self._shared, arm, branch_states.branch, q, index, sample)
                ignored |= self._shared.pairs[arm]
        undecided = np.flatnonzero(~self.collided[index, sample])
        free = self._scene.keeps_clearance(
            self._targets, {a: v[undecided] for a, v in q.items()}, index[undecided], ignored=ignored
        )
        self.collided[index[undecided], sample[undecided]] = ~free
        self.known[index, sample] = True
        self.checks += len(index)

    def _check_arm_pairs(
        self,
        shared: SharedCollisions,
        arm: str,
        branch: int,
        q: Mapping[str, FloatArray],
        index: IndexArray,
        sample: IndexArray,
    ) -> None:
        """Check the pairs of bodies that belong to one arm, and share the results with other combinations.

        A sample is skipped if these pairs were checked on another combination, or if it is known to collide.

        Args:
            shared: Results, which are extended.
            arm: Name of the arm.
            branch: Branch of the arm.
            q: {arm: (B, J)} [rad] joints of all arms.
            index: (B,) targets.
            sample: (B,) samples.
        """
        known, collides = shared.known_collisions(arm, branch)
        unknown = np.flatnonzero(~known[index, sample] & ~self.collided[index, sample])
        if len(unknown):
            checked = index[unknown], sample[unknown]
            joints = {a: v[unknown] for a, v in q.items()}
            collides[checked] = ~self._scene.keeps_clearance(
                self._targets, joints, checked[0], ignored=shared.other_pairs[arm], edge=False
            )
            known[checked] = True
        self.collided[index, sample] |= collides[index, sample]

    def sample_cost(self) -> FloatArray | None:
        """Return the cost (N, S) [s] of samples by known collisions; None until :meth:`check_coarsely`.

        Samples that collide cost inf, and those that probably do cost :data:`SUSPECT_COST_S`.
        """
        return None if self.suspect_cost is None else np.where(self.collided, np.inf, self.suspect_cost)

    def check_coarsely(self) -> None:
        """Check all samples of every :data:`COARSE_STRIDE`-th target.

        A sample that collides at one of two consecutive checked targets becomes costly at all targets between
        them.
        """
        rows, samples = self._shape
        self._checks_shared_pairs = True
        checked = np.unique(np.append(np.arange(0, rows, COARSE_STRIDE), rows - 1))
        self.check_targets(checked)
        suspect_cost = np.zeros((rows, samples))
        for a, b in itertools.pairwise(checked):
            suspect_cost[a : b + 1, self.collided[a] | self.collided[b]] = SUSPECT_COST_S
        self.suspect_cost = suspect_cost
