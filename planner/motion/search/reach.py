"""Reach: freedoms sampled at all targets, all branches and turns of every arm, margins, collisions.

A sample of the freedoms is checked for collisions once, when somebody first asks for it.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.cell.clearance import Pairs
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.motion.planning_scene import FULL_TURN, Chain, Scene
from planner.targets import Freedom, JointFreedom, ScrewFreedom, Targets

SPIN_STEP = np.deg2rad(10.0)
"""Step [rad] of samples of a freedom that turns."""
SLIDE_SAMPLES = 5
"""Samples of a slide or table."""
MOST_SAMPLES = 500_000
"""Samples of all targets at most: freedoms with the most samples get fewer first."""

SOFT_LIMIT_RAD = np.deg2rad(20.0)
"""Postures nearer to a joint limit [rad] than this, beyond what must be kept, cost the more the nearer they
are."""
SOFT_SINGULARITY_RAD = np.deg2rad(15.0)
"""The same of singular postures [rad]."""
PENALTY = 5.0
"""What a path that stays at the edge of what is allowed pays over all its rungs [s]."""


@dataclasses.dataclass(frozen=True)
class Grid:
    """S samples of the freedoms at each target: ``values`` (N, S, F).

    ``before`` (M, S): for each of M kinds of step, the sample that a sample is reached from, -1 for none.
    Samples of a full turn are a ring, others a line; one step changes each freedom by one sample at most.
    """

    values: FloatArray
    before: IndexArray

    @property
    def samples(self) -> int:
        """Number of samples S."""
        return int(self.values.shape[1])


@dataclasses.dataclass(frozen=True)
class Rungs:
    """What one arm can do on one branch at every target and sample.

    ``q`` (N, S, J) principal angles, NaN out of reach; ``turns`` (T, J) [rad] whole turns to add; ``ok`` (N,
    S, T) whether limits with their margin and singularities allow the state; ``penalty`` (N, S, T) [s], inf
    if not.
    """

    arm: str
    branch: int
    q: FloatArray
    turns: FloatArray
    ok: BoolArray
    penalty: FloatArray
    turns_matter: bool = True

    def modulo(self) -> "Rungs":
        """The same with turns forgotten: a state is as good as its best turn."""
        return dataclasses.replace(
            self,
            turns=np.zeros((1, self.q.shape[-1])),
            ok=np.asarray(self.ok.any(axis=-1, keepdims=True)),
            penalty=self.penalty.min(axis=-1, keepdims=True),
            turns_matter=False,
        )


@dataclasses.dataclass(frozen=True)
class Reach:
    """All B branches of one arm: ``branches`` have an allowed state at every target; ``exists`` (B, N) says
    where each has one, ``solved`` (B, N) where it has a solution regardless of limits."""

    arm: str
    branches: dict[int, Rungs]
    exists: BoolArray
    solved: BoolArray


def full_turn(freedom: Freedom) -> bool:
    """Whether a freedom may turn without end at every target."""
    if not isinstance(freedom, ScrewFreedom) or not freedom.periodic:
        return False
    return bool(np.all(freedom.upper - freedom.lower >= FULL_TURN - 1e-9))


def slides_only(freedom: Freedom) -> bool:
    """Whether a freedom turns nothing: a slide, a table, or a joint beside what turns, sampled at few
    places."""
    if isinstance(freedom, JointFreedom):
        return not freedom.alone
    return not (isinstance(freedom, ScrewFreedom) and any(np.any(a[:3]) for a in freedom.axis.values()))


def sample(targets: Targets, spin_step: float = SPIN_STEP, slides: int = SLIDE_SAMPLES, far: int = 1) -> Grid:
    """Samples of all freedoms on a product grid: spins every ``spin_step`` [rad], slides and tables at
    ``slides`` places.

    Bounded freedoms are sampled between their bounds at each target, so that a narrow window is never missed.
    Where one freedom alone is sampled, a step may go ``far`` samples.
    """
    counts = [_count(f, spin_step, slides) for f in targets.freedoms]
    while counts and int(np.prod(counts)) * targets.count > MOST_SAMPLES and max(counts) > 2:
        largest = int(np.argmax(counts))
        counts[largest] = max(2, counts[largest] // 2)
    rings = [full_turn(f) for f in targets.freedoms]
    picks = np.array(list(itertools.product(*(range(c) for c in counts))), dtype=np.intp)
    picks = picks.reshape(int(np.prod(counts)), len(counts))
    columns = [
        _values(f, picks[:, j], counts[j], ring)
        for j, (f, ring) in enumerate(zip(targets.freedoms, rings, strict=True))
    ]
    shape = (targets.count, len(picks))
    values = np.stack(columns, axis=-1) if columns else np.zeros((*shape, 0))
    return Grid(values, _steps(picks, counts, rings, far))


def _count(freedom: Freedom, spin_step: float, slides: int) -> int:
    width = float(np.max(freedom.upper - freedom.lower))
    if width <= 0.0:
        return 1
    if slides_only(freedom):
        return slides
    if full_turn(freedom):
        return max(4, round(FULL_TURN / spin_step))
    return max(3, int(np.ceil(width / spin_step)) + 1)


def _values(freedom: Freedom, picks: IndexArray, count: int, ring: bool) -> FloatArray:
    rows = len(freedom.lower)
    if ring:
        return np.broadcast_to(-np.pi + FULL_TURN * picks / count, (rows, len(picks)))
    share = picks / max(count - 1, 1) if count > 1 else np.full(len(picks), 0.5)
    return freedom.lower[:, None] + share * (freedom.upper - freedom.lower)[:, None]


def _steps(picks: IndexArray, counts: list[int], rings: list[bool], far: int) -> IndexArray:
    """Predecessors (M, S): stay, and each freedom one sample up or down (two freedoms: diagonals as well)."""
    far = far if sum(count > 1 for count in counts) == 1 else 1
    away = (0, *itertools.chain.from_iterable((-k, k) for k in range(1, far + 1)))
    offsets = list(itertools.product(away, repeat=len(counts)))
    if len(counts) > 2:
        offsets = [o for o in offsets if np.count_nonzero(o) <= 1]
    offsets = [o for o in offsets if all(c > 1 or s == 0 for c, s in zip(counts, o, strict=True))]
    offsets.sort(key=lambda o: sum(map(abs, o)))
    out = np.empty((len(offsets), len(picks)), dtype=np.intp)
    for m, offset in enumerate(offsets):
        wanted = picks - np.array(offset, dtype=np.intp).reshape(-1)
        inside = np.ones(len(picks), dtype=bool)
        flat = np.zeros(len(picks), dtype=np.intp)
        for j, count in enumerate(counts):
            column = wanted[:, j] % count if rings[j] else wanted[:, j]
            inside &= (column >= 0) & (column < count)
            flat = flat * count + column
        out[m] = np.where(inside, flat, -1)
    return out


def reach(scene: Scene, targets: Targets, grid: Grid) -> dict[str, Reach]:
    """All states of all arms over the grid."""
    poses, shape = _poses(scene, targets, grid)
    return {arm: _known(scene, arm, poses[arm], _last(targets, grid, arm), shape) for arm in targets.arms}


def apart(scene: Scene, targets: Targets, grid: Grid) -> dict[str, list[Rungs]]:
    """The states of all arms over the grid on every branch, of targets that nothing joins: states are asked
    for one by one, so that a branch of an offset wrist may be another one at the next target."""
    poses, (rows, samples) = _poses(scene, targets, grid)
    out = {}
    for arm in targets.arms:
        chain = scene.chains[arm]
        count = chain.robot.form.branches
        angles = chain.inverse(poses[arm], last=_last(targets, grid, arm))
        angles = angles.reshape(rows, samples, count, chain.robot.axes)
        out[arm] = [rungs_of(scene, chain, branch, angles[:, :, branch]) for branch in range(count)]
    return out


def on_branches(
    scene: Scene, targets: Targets, grid: Grid, branch: Mapping[str, int]
) -> dict[str, Rungs] | None:
    """The states over the grid on one branch of each arm, as :func:`reach` has them; None where at some
    target no sample has one for all arms."""
    poses, shape = _poses(scene, targets, grid)
    out, able = {}, np.ones(shape, dtype=np.bool_)
    for arm in targets.arms:
        chain = scene.chains[arm]
        q = chain.joined_on(poses[arm].reshape(*shape, 4, 4), branch[arm], targets.last(arm, grid.values))
        out[arm] = rungs_of(scene, chain, branch[arm], q)
        able &= out[arm].ok.any(axis=2)
        if not able.any(axis=1).all():
            return None
    return out


def _poses(scene: Scene, targets: Targets, grid: Grid) -> tuple[dict[str, FloatArray], tuple[int, int]]:
    """TCP poses {arm: (N * S, 4, 4)} of all N targets at their S samples, and (N, S)."""
    rows, samples = grid.values.shape[:2]
    index = np.repeat(np.arange(rows), samples)
    return scene.tcp(targets, grid.values.reshape(rows * samples, -1), index), (rows, samples)


def _last(targets: Targets, grid: Grid, arm: str) -> FloatArray | None:
    """The last joint (N * S,) of an arm where it is a freedom."""
    last = targets.last(arm, grid.values)
    return None if last is None else last.reshape(-1)


def _known(
    scene: Scene, arm: str, pose: FloatArray, joint: FloatArray | None, shape: tuple[int, int]
) -> Reach:
    """The table of one arm; that of the last poses is remembered, as paths are searched more than once over
    the same samples."""
    last = scene.last_reach.get(arm)
    if last is not None and last[2] == shape and np.array_equal(last[0], pose) and _same(last[1], joint):
        found = last[3]
        if isinstance(found, Reach):
            return found
    found = _reach(scene, scene.chains[arm], pose, joint, shape)
    for rungs in found.branches.values():
        for array in (rungs.q, rungs.ok, rungs.penalty):
            array.flags.writeable = False
    scene.last_reach[arm] = pose, joint, shape, found
    return found


def _same(one: FloatArray | None, other: FloatArray | None) -> bool:
    return (one is None and other is None) or (one is not None and np.array_equal(one, other))  # type: ignore[arg-type]


def _reach(
    scene: Scene, chain: Chain, pose: FloatArray, joint: FloatArray | None, shape: tuple[int, int]
) -> Reach:
    count = chain.robot.form.branches
    angles = chain.joined(chain.inverse(pose, last=joint).reshape(*shape, count, chain.robot.axes))
    found: dict[int, Rungs] = {}
    exists = []
    solved: BoolArray = np.zeros((count, shape[0]), dtype=bool)
    for branch in range(count):
        q = angles[:, :, branch]
        solved[branch] = ~np.isnan(q[..., 0]).all(axis=1)
        rungs = rungs_of(scene, chain, branch, q)
        exists.append(np.asarray(rungs.ok.any(axis=(1, 2))))
        if exists[branch].all():
            found[branch] = rungs
    return Reach(chain.name, found, np.stack(exists), solved)


def rungs_of(scene: Scene, chain: Chain, branch: int, q: FloatArray) -> Rungs:
    """Margins, turns and penalties of principal angles q (N, S, J) of one branch."""
    hard, bend = scene.settings.joint_margin, scene.settings.singularity_margin
    single = chain.singularity_margin(q)
    turns, bends = _worth_trying(chain.turns, q), single >= bend
    margins = chain.limit_margins(q, turns)
    fits = [(margin >= hard) & bends for margin in margins]
    used = [k for k, fit in enumerate(fits) if k == 0 or bool(fit.any())]
    limit = np.stack([margins[k] for k in used], axis=-1)
    ok = np.stack([fits[k] for k in used], axis=-1)
    turns = turns[used]
    cost = _hinge(limit, hard, SOFT_LIMIT_RAD) + _hinge(single, bend, SOFT_SINGULARITY_RAD)[..., None]
    return Rungs(chain.name, branch, q, turns, ok, np.where(ok, cost * PENALTY / len(q), np.inf))


MOST_TURNS: Final = 27
"""Choices of whole turns of an arm's joints of which all are kept: three joints with three turns each."""


def _worth_trying(turns: FloatArray, q: FloatArray) -> FloatArray:
    """Of ``turns`` (T, J), where they are many, those of joints that pass the seam of their principal angles
    q (N, S, J) in some step: another joint keeps its turn on any path, and none leaves it more room than no
    turn. Of those at most :data:`MOST_TURNS`, the fewest turns first."""
    if len(turns) <= MOST_TURNS:
        return turns
    gone = np.isnan(q)
    low, high = np.where(gone, np.inf, q).min(axis=1), np.where(gone, -np.inf, q).max(axis=1)
    far = np.maximum(high[1:] - low[:-1], high[:-1] - low[1:])
    passes = (far > np.pi).any(axis=0)
    return turns[~turns[:, ~passes].any(axis=1)][:MOST_TURNS]


def _hinge(margin: FloatArray, hard: float, soft: float) -> FloatArray:
    """1 at the hard margin, falling as a parabola to 0 at the soft one."""
    return np.square(np.clip((hard + soft - margin) / soft, 0.0, 1.0))


BENT_LINKS: Final = ("link_1", "link_2", "link_3", "link_4", "link_5")
"""Links that stand elsewhere on another branch, wherever the tool is; the last one is the flange, and where
it is one of seven axes so is the one before, for a sample of the last joint."""

COARSE_STRIDE: Final = 12
"""Once a path has collided, all samples of every 12th target are checked before the next path is chosen."""

SUSPECT_COST: Final = 0.05
"""Cost [s] of a sample between two of these targets one of which collides with it."""


@dataclasses.dataclass(frozen=True)
class Others:
    """Arms that a search leaves alone: the joints ``standing`` {arm: (N, 6)} at every target, and arms that
    are ``absent``, as if they were not there."""

    standing: Mapping[str, FloatArray]
    absent: frozenset[str]

    def ignored(self, scene: Scene) -> Pairs:
        """Pairs of bodies that absent arms are part of."""
        if scene.model is None:
            return frozenset()
        bodies = {solid.body for solid in scene.model.solids}
        gone = {body for body in bodies if body.partition("/")[0] in self.absent}
        return frozenset(frozenset((a, b)) for a in gone for b in bodies if a != b)


class Parts:
    """What choices of branches have in common: pairs of bodies of which the links of one arm are one body and
    links of no other arm the second stand as they do in all choices with the same branch of that arm, for
    tools and blocks that arms hold stand where the targets and samples say.

    ``pairs`` {arm: pairs}; by arm and branch what is known of samples, and which collide there (N, S).
    """

    def __init__(self, scene: Scene, grid: Grid, arms: Sequence[str]) -> None:
        bodies = [] if scene.model is None else sorted({solid.body for solid in scene.model.solids})
        owner = {body: arm for body in bodies for arm in arms if body in {f"{arm}/{k}" for k in BENT_LINKS}}
        every = [frozenset(pair) for pair in itertools.combinations(bodies, 2)]
        owners = {pair: {owner[body] for body in pair if body in owner} for pair in every}
        self.pairs: dict[str, Pairs] = {
            arm: frozenset(pair for pair, own in owners.items() if own == {arm}) for arm in arms
        }
        self.others: dict[str, Pairs] = {arm: frozenset(every) - own for arm, own in self.pairs.items()}
        self._shape = grid.values.shape[:2]
        self._seen: dict[tuple[str, int], tuple[BoolArray, BoolArray]] = {}

    def seen(self, arm: str, branch: int) -> tuple[BoolArray, BoolArray]:
        """What is known of an arm's own pairs on a branch and where they collide (N, S), to be written to."""
        if (arm, branch) not in self._seen:
            nothing = np.zeros(self._shape, dtype=np.bool_)
            self._seen[arm, branch] = nothing, nothing.copy()
        return self._seen[arm, branch]


class Checker:
    """What is known of the samples of one choice of branches: ``known``, ``collided`` (N, S). ``parts``: what
    it has in common with others, of which it begins with what is known to collide."""

    def __init__(
        self,
        scene: Scene,
        targets: Targets,
        grid: Grid,
        rungs: Mapping[str, Rungs],
        others: Others | None = None,
        parts: Parts | None = None,
    ) -> None:
        self._parts = parts if others is None else None
        self._standing = others.standing if others else {}
        self._ignored: Pairs = others.ignored(scene) if others else frozenset()
        self._scene, self._targets, self._rungs = scene, targets, rungs
        shape = grid.values.shape[:2]
        self._rungs_shape = (int(shape[0]), int(shape[1]))
        self.collided = np.zeros(shape, dtype=bool)
        self.known = np.zeros(shape, dtype=bool)
        self.checks = self.rounds = 0
        self.suspect: FloatArray | None = None
        self._looking = False
        able = np.stack([np.asarray(r.ok.any(axis=-1)) for r in rungs.values()])
        self.possible = np.asarray(np.logical_and.reduce(able, axis=0))
        if self._parts is not None:
            for arm, one in rungs.items():
                self.collided |= self._parts.seen(arm, one.branch)[1] & self.possible
        self.known |= self.collided

    def whole(self, rows: IndexArray) -> None:
        """Checks all samples of targets ``rows`` (K,) that every arm can take."""
        where = np.argwhere(self.possible[rows] & ~self.known[rows])
        self.check(rows[where[:, 0]], where[:, 1])

    def free(self, row: int) -> BoolArray:
        """(S,) samples of one target that every arm can take and that collide with nothing."""
        self.whole(np.array([row]))
        return np.asarray(self.possible[row] & ~self.collided[row])

    def check(self, index: IndexArray, sample: IndexArray) -> None:
        """Checks states (B,), (B,) that are not known yet."""
        new = ~self.known[index, sample]
        index, sample = index[new], sample[new]
        if len(index) == 0:
            return
        q = {arm: r.q[index, sample] for arm, r in self._rungs.items()}
        q |= {arm: angles[index] for arm, angles in self._standing.items()}
        apart = self._ignored
        if self._parts is not None and self._looking:  # other choices may have use for what is found
            for arm, one in self._rungs.items():
                self._look_at(self._parts, arm, one.branch, q, index, sample)
                apart |= self._parts.pairs[arm]
        left = np.flatnonzero(~self.collided[index, sample])
        free = self._scene.free(self._targets, {a: v[left] for a, v in q.items()}, index[left], ignored=apart)
        self.collided[index[left], sample[left]] = ~free
        self.known[index, sample] = True
        self.checks += len(index)

    def _look_at(
        self,
        parts: Parts,
        arm: str,
        branch: int,
        q: Mapping[str, FloatArray],
        index: IndexArray,
        sample: IndexArray,
    ) -> None:
        """Looks at an arm's own pairs at states (B,), (B,) with joints {arm: (B, 6)}, where it is not known
        yet and nothing else collides."""
        known, hit = parts.seen(arm, branch)
        some = np.flatnonzero(~known[index, sample] & ~self.collided[index, sample])
        if len(some):
            at = index[some], sample[some]
            there = {a: v[some] for a, v in q.items()}
            hit[at] = ~self._scene.free(self._targets, there, at[0], ignored=parts.others[arm], edge=False)
            known[at] = True
        self.collided[index, sample] |= hit[index, sample]

    def cost(self) -> FloatArray | None:
        """What samples (N, S) cost for what is known of collisions [s], inf where they collide; None as long
        as no path has."""
        return None if self.suspect is None else np.where(self.collided, np.inf, self.suspect)

    def coarse(self) -> None:
        """Checks all samples of every 12th target; samples between that are suspect cost something."""
        rows, samples = self._rungs_shape
        self._looking = True
        at = np.unique(np.append(np.arange(0, rows, COARSE_STRIDE), rows - 1))
        self.whole(at)
        suspect = np.zeros((rows, samples))
        for a, b in itertools.pairwise(at):
            suspect[a : b + 1, self.collided[a] | self.collided[b]] = SUSPECT_COST
        self.suspect = suspect
