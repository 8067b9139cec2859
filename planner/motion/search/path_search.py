"""The path of an operation's targets, by the search that suits the number of its freedoms and targets.

Tools that would like to be turned toward a point, such as their robot's base, have wanted values of
their spin; how they are found, and what following them would be worth, stands here too.

**Very many targets** (`search_long`): the path is found on some of them, the skeleton, arm by arm,
then filled in. Where no freedom moves more than one arm, each arm has a ladder of its own, and the
second one keeps clear of the postures of the first. Between two targets of the skeleton the
freedoms go straight, joints follow exactly; where that leaves a branch, a limit or the clearance,
the skeleton gets more targets there.
"""

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, dots
from planner.geometry.units import DEG
from planner.motion.planning_scene import HELD_PREFIX, Scene
from planner.motion.search.ladder import LARGEST_STEP, Path
from planner.motion.search.ladder_search import Blocked, Dead, Found, search, speed_limits
from planner.motion.search.reach import (
    SLIDE_SAMPLES,
    SPIN_STEP,
    Checker,
    Grid,
    Others,
    full_turn,
    reach,
    sample,
    slides_only,
)
from planner.motion.search.roadmap import search_wide
from planner.motion.search.subsampling import own_turn, subset
from planner.motion.trajectory.joint_path import Dense, clear, dense
from planner.targets import Aim, Freedom, ScrewFreedom, Targets

LONG_JOB: Final = 3000
"""Jobs of more targets are planned on a skeleton."""

STEP_TURN_RAD: Final = np.deg2rad(20.0)
"""Tool axes turn by about so much [rad] between targets of the skeleton."""
STEP_WAY_M: Final = 0.1
"""TCPs move by about so much [m] between targets of the skeleton."""

MOST_RUNGS: Final = 4000
"""Targets of the skeleton at most."""
MOST_ROUNDS: Final = 5
"""Skeletons that are tried at most, each with more targets where the one before failed."""
MOST_SPIN_STEPS: Final = 3
"""A spin may go on by so many samples from one target of the skeleton to the next."""

COARSE_SPIN_STEP: Final = np.deg2rad(30.0)
"""Step [rad] of samples of all freedoms, where full turns alone have no path."""
COARSE_SLIDES: Final = 3
"""Samples of a slide there."""


def suits(targets: Targets) -> bool:
    """Whether there are so many targets that a skeleton is wanted, and no freedom, frame or edge joins the
    arms."""
    joined = targets.coupled or targets.edge is not None
    joined |= any(frame.startswith(HELD_PREFIX) for frame in targets.frame.values())
    single = all(isinstance(f, ScrewFreedom) and len(f.axis) == 1 for f in targets.freedoms)
    return targets.count > LONG_JOB and single and not joined


def search_long(scene: Scene, targets: Targets) -> tuple[Grid, Found | Blocked] | None:
    """A path that keeps margins and clearance at and between all targets, or why one arm alone has none.

    None where each arm has a path of its own but none was found for all of them.
    """
    zero = (
        np.stack(
            [
                own_turn(targets, j) if full_turn(f) else np.zeros(targets.count)
                for j, f in enumerate(targets.freedoms)
            ],
            axis=1,
        )
        if targets.freedoms
        else np.zeros((targets.count, 0))
    )
    way = _way(targets)
    rows = _rungs(targets, way)
    for _ in range(MOST_ROUNDS):
        skeleton = _Skeleton(scene, targets, zero, way, rows)
        grid, found = skeleton.arms()
        if not isinstance(found, Found):
            return None if found is None else (grid, found)
        whole = skeleton.whole(found)
        bad = skeleton.faults(whole)
        if not bad.any():
            return Grid(whole.values[:, None], np.zeros((0, 1), dtype=np.intp)), whole
        more = _more(rows, bad)
        if len(more) == len(rows):
            return None
        rows = more
    return None


@dataclasses.dataclass(frozen=True)
class _Skeleton:
    """The targets ``rows`` (K,) of a job; ``zero`` (N, F) is the angle that full turns are counted from,
    ``way`` (N,) grows along the job."""

    scene: Scene
    targets: Targets
    zero: FloatArray
    way: FloatArray
    rows: IndexArray

    def arms(self) -> tuple[Grid, Found | Blocked | None]:
        """A path of all arms on the skeleton, each arm on its own way round those before it."""
        none = Grid(np.zeros((0, 1, 0)), np.zeros((0, 1), dtype=np.intp))
        for order in itertools.permutations(self.targets.arms):
            done: dict[str, Found] = {}
            for arm in order:
                standing = {a: found.q[a] for a, found in done.items()}
                absent = frozenset(self.targets.arms) - {arm, *standing}
                grid, found = self._alone(arm, Others(standing, absent))
                if isinstance(found, Blocked) and (not standing or found.common < len(self.rows)):
                    return grid, found
                if isinstance(found, Blocked):
                    break
                done[arm] = found
            if len(done) == len(order):
                return none, self._together(done)
        return none, None

    def _alone(self, arm: str, others: Others) -> tuple[Grid, Found | Blocked]:
        """The path of one arm: over full turns alone, then over all its freedoms."""
        few, columns = subset(_one(self.targets, arm), self.rows), self._columns(arm)
        held = dataclasses.replace(few, freedoms=tuple(map(_held_at, few.freedoms, few.neutral().T)))
        for some, step in ((held, None), (few, COARSE_SPIN_STEP)):
            grid = sample(some, far=MOST_SPIN_STEPS) if step is None else sample(some, step, COARSE_SLIDES)
            grid = Grid(grid.values - self.zero[self.rows][:, None, columns], grid.before)
            found = search(self.scene, some, grid, others)
            if isinstance(found, Found) or not _wider(held, few):
                break
        if isinstance(found, Blocked):
            return grid, dataclasses.replace(found, few=(some, self.rows))
        return grid, found

    def _columns(self, arm: str) -> IndexArray:
        return np.array([j for j, f in enumerate(self.targets.freedoms) if _moves(f, arm)], dtype=np.intp)

    def _together(self, done: Mapping[str, Found]) -> Found:
        arms = self.targets.arms
        values = np.zeros((len(self.rows), len(self.targets.freedoms)))
        for arm in arms:
            values[:, self._columns(arm)] = done[arm].values
        branch = {arm: done[arm].path.branch[arm] for arm in arms}
        cost = max(found.path.cost for found in done.values())
        path = Path(branch, np.zeros(len(self.rows), dtype=np.intp), {}, cost)
        checks, rounds = (sum(getattr(f, name) for f in done.values()) for name in ("checks", "rounds"))
        choices = int(np.prod([found.choices for found in done.values()]))
        return Found(path, values, {arm: done[arm].q[arm] for arm in arms}, choices, checks, rounds)

    def whole(self, found: Found) -> Found:
        """The path at all targets: freedoms straight between those of the skeleton, joints exact."""
        targets, at = self.targets, self.way[self.rows]
        values = np.zeros((targets.count, len(targets.freedoms)))
        for j, freedom in enumerate(targets.freedoms):
            rung = found.values[:, j] + self.zero[self.rows, j]
            ring = full_turn(freedom)
            column = np.interp(self.way, at, np.unwrap(rung) if ring else rung) - self.zero[:, j]
            values[:, j] = column if ring else np.clip(column, freedom.lower, freedom.upper)
        q = {}
        for arm, pose in self.scene.tcp(targets, values).items():
            chain = self.scene.chains[arm]
            near = np.stack([np.interp(self.way, at, joint) for joint in found.q[arm].T], axis=1)
            q[arm] = chain.on_branch(pose, found.path.branch[arm], near)
        path = dataclasses.replace(found.path, sample=np.zeros(targets.count, dtype=np.intp))
        return dataclasses.replace(found, path=path, values=values, q=q, checks=found.checks + targets.count)

    def faults(self, path: Found) -> BoolArray:
        """(N,) targets at which, or on the straight move to which, a limit, the branch or the clearance is
        lost."""
        scene, targets = self.scene, self.targets
        out = np.zeros(targets.count, dtype=np.bool_)
        for arm, angles in path.q.items():
            chain = scene.chains[arm]
            out |= ~(chain.limit_margin(angles) >= scene.settings.joint_margin)
            out |= ~(chain.singularity_margin(angles) >= scene.settings.singularity_margin)
            out[1:] |= ~(np.abs(np.diff(angles, axis=0)) <= LARGEST_STEP).all(axis=1)
        if out.any():
            return out
        samples = dense(scene, targets, path.path.branch, path.q)
        lost = np.isnan(np.concatenate(list(samples.q.values()), axis=1)).any(axis=1)
        good = np.flatnonzero(~lost)
        some = Dense(samples.move[good], samples.share[good], {a: v[good] for a, v in samples.q.items()})
        lost[good] = ~clear(scene, targets, some)
        out[samples.move[lost]] = True
        return out


def _one(targets: Targets, arm: str) -> Targets:
    return dataclasses.replace(
        targets,
        arms=(arm,),
        pose={arm: targets.pose[arm]},
        frame={arm: targets.frame.get(arm, "stock")},
        freedoms=tuple(f for f in targets.freedoms if _moves(f, arm)),
    )


def _moves(freedom: Freedom, arm: str) -> bool:
    return isinstance(freedom, ScrewFreedom) and arm in freedom.axis


def _held_at(freedom: Freedom, neutral: FloatArray) -> Freedom:
    """A freedom as it is if it turns without end, else kept at its ``neutral`` values (N,)."""
    return freedom if full_turn(freedom) else dataclasses.replace(freedom, lower=neutral, upper=neutral)


def _wider(held: Targets, few: Targets) -> bool:
    return any(np.any(a.upper - a.lower != b.upper - b.lower) for a, b in _pairs(held, few))


def _pairs(held: Targets, few: Targets) -> list[tuple[Freedom, Freedom]]:
    return list(zip(held.freedoms, few.freedoms, strict=True))


def _way(targets: Targets) -> FloatArray:
    """A measure (N,) that grows along the job by about 1 from one target of the skeleton to the next."""
    step = np.full(targets.count - 1, 1e-6)
    for arm, pose in targets.pose.items():
        step += np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1) / STEP_WAY_M
        turn = np.einsum("nij,nij->n", pose[1:, :3, :3], pose[:-1, :3, :3])
        angle = np.arccos(np.clip(0.5 * (turn - 1.0), -1.0, 1.0))
        spins = [
            f.axis[arm][:3]
            for f in targets.freedoms
            if isinstance(f, ScrewFreedom) and arm in f.axis and full_turn(f)
        ]
        if len(spins) == 1 and np.any(spins[0]):  # what turns about the free axis alone is no turn
            axis = pose[:, :3, :3] @ (spins[0] / np.linalg.norm(spins[0]))
            angle = np.arccos(np.clip(dots(axis[1:], axis[:-1]), -1.0, 1.0))
        step += angle / STEP_TURN_RAD
    return np.append(0.0, np.cumsum(step))


def _rungs(targets: Targets, way: FloatArray) -> IndexArray:
    """Targets (K,) about 1 apart on ``way`` (N,), both ends, and both ends of long moves."""
    scale = max(1.0, float(way[-1]) / MOST_RUNGS)
    number = np.floor(way / scale)
    pick = np.zeros(targets.count, dtype=np.bool_)
    pick[[0, -1]] = True
    pick[1:] |= np.diff(number) > 0
    pick[:-1] |= np.diff(way) > 0.5 * scale
    return np.flatnonzero(pick)


def _more(rows: IndexArray, bad: BoolArray) -> IndexArray:
    """The skeleton with the first, the middle and the last fault between each two of its targets."""
    at = np.flatnonzero(bad)
    gap = np.searchsorted(rows, at)
    first = np.flatnonzero(np.diff(gap, prepend=-1))
    last = np.append(first[1:], len(at)) - 1
    middle = (first + last) // 2
    return np.union1d(rows, at[np.concatenate([first, middle, last])])


MOST_LADDER_TURNS = 1
"""With more freedoms that turn something the ladder over all their samples would be too large."""

FINE_SAMPLING = (SPIN_STEP / 2.0, 2 * SLIDE_SAMPLES - 1)
"""Step [rad] of spins and places of slides of the samples that are tried at last."""

AROUND = 16
"""Targets on either side of a dead end that have to have a path among themselves before more samples are
tried for all targets."""


def find_path(scene: Scene, targets: Targets, fine: bool = True) -> tuple[Grid, Found | Blocked]:
    """The path of least cost, or what is known of why there is none, and the samples that were looked at.

    With few freedoms slides and tables are in their middle first, and at more places only where that has no
    path whose moves are free; at last, if ``fine``, spins and slides are sampled twice as densely; if not,
    a dead end that more places do not pass either ends the search, with the reasons of middle slides. Very
    many targets are planned on a skeleton first.
    """
    if suits(targets):
        long = search_long(scene, targets)
        if long is not None:
            return long
    if turning(targets) > MOST_LADDER_TURNS:
        return search_wide(scene, targets)
    free = [f for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    moves, kept = scene.model is not None, None
    places = (1, SLIDE_SAMPLES) if any(slides_only(f) for f in free) else (1,)
    for slides in places:
        grid = sample(targets, SPIN_STEP, slides)
        found = search(scene, targets, grid, moves=moves)
        if isinstance(found, Found):
            if not found.loose:
                return grid, found
            kept = kept or (grid, found)
        elif slides < places[-1] and not fine and _leads_no_further(scene, targets, found):
            return grid, found
    if fine and free:
        last = _finely(scene, targets, found)
        if last is not None and not (kept and isinstance(last[1], Blocked)):
            return last
    return kept or (grid, found)


def _leads_no_further(scene: Scene, targets: Targets, found: Blocked) -> bool:
    """Whether targets about a dead end have no path among themselves with slides at more places either, so
    that all targets have none."""
    if found.dead is None or targets.count <= 2 * AROUND:
        return False
    end = found.dead.index
    some = subset(targets, np.arange(max(end - AROUND, 0), min(end + AROUND, targets.count)))
    return isinstance(search(scene, some, sample(some, SPIN_STEP, SLIDE_SAMPLES)), Blocked)


def turning(targets: Targets) -> int:
    """How many freedoms turn something."""
    return sum(not slides_only(f) for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0)


def _finely(scene: Scene, targets: Targets, found: Found | Blocked) -> tuple[Grid, Found | Blocked] | None:
    """What the finest samples give. They have to come past the target where paths end, before they are taken
    for all targets; None if they do not help at all."""
    moves = scene.model is not None
    if isinstance(found, Blocked):
        if found.dead is not None and _closed(scene, targets, found.dead):
            return None
        rows = np.arange(min(_end(found) + 2, targets.count))
        some = subset(targets, rows)
        grid = sample(some, *FINE_SAMPLING)
        only = found.dead.tried if found.dead is not None else None
        start = search(scene, some, grid, moves=moves, only=only)
        if isinstance(start, Blocked):
            if start.dead is None or found.dead is None or start.dead.index < found.dead.index:
                return None
            later = found.dead.later if not start.dead.free.any() else None
            later = later if later is not None and later[1] > start.dead.index else None
            dead = dataclasses.replace(start.dead, later=later)
            return grid, dataclasses.replace(start, dead=dead, common=targets.count)
    grid = sample(targets, *FINE_SAMPLING)
    return grid, search(scene, targets, grid, moves=moves)


def _closed(scene: Scene, targets: Targets, dead: Dead) -> bool:
    """Whether the target where paths end is not free with the finest samples either, with any branches."""
    one = subset(targets, np.array([dead.index]))
    grid = sample(one, *FINE_SAMPLING)
    table = reach(scene, one, grid)
    for branches in dead.tried:
        if all(b in r.branches for r, b in zip(table.values(), branches, strict=True)):
            rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
            if Checker(scene, one, grid, rungs).free(0).any():
                return False
    return True


def _end(found: Blocked) -> int:
    if found.dead is not None:
        return found.dead.index
    ends = [int(np.argmin(r.exists, axis=1).max()) for r in found.reach.values() if not r.branches]
    return min(ends) if ends else found.common


SPIN_COLUMNS: Final = (
    "spin",
    "joint motion [deg]",
    "most by one joint",
    "[deg]",
    "at full joint speed [s]",
    "least margin to limits [deg]",
    "least margin to singularities [deg]",
)
"""Headings of the table of spins that reports show."""


def with_aims(scene: Scene, targets: Targets) -> Targets:
    """The targets with wanted values for every spin that aims and wants to."""
    if not any(_aim(f) is not None for f in targets.freedoms):
        return targets
    freedoms = []
    for freedom in targets.freedoms:
        aim = _aim(freedom)
        if isinstance(freedom, ScrewFreedom) and aim is not None and aim.wanted:
            freedom = dataclasses.replace(
                freedom, prefer=aimed_values(scene, targets, freedom, aim), weight=aim.weight
            )
        freedoms.append(freedom)
    return dataclasses.replace(targets, freedoms=tuple(freedoms))


def aimed_values(scene: Scene, targets: Targets, freedom: ScrewFreedom, aim: Aim) -> FloatArray:
    """Values (N,) [rad] of a spin at which its ray points to the aim as nearly as a turn can make it."""
    pose = scene.world(targets, {arm: targets.pose[arm] for arm in targets.arms})[aim.arm]
    if aim.at is None:
        place = scene.chains[aim.arm].base[:3, 3]
    else:
        own = scene.world(targets, {arm: np.eye(4) for arm in targets.arms})[aim.arm]
        place = own[..., :3, :3] @ aim.at + own[..., :3, 3]
    way = np.einsum("nji,nj->ni", pose[:, :3, :3], place - pose[:, :3, 3])
    axis = freedom.axis[aim.arm][:3] / np.linalg.norm(freedom.axis[aim.arm][:3])
    across = way - (way @ axis)[:, None] * axis
    angle = np.arctan2(np.cross(aim.ray, across) @ axis, across @ aim.ray)
    return np.asarray(np.clip(angle, freedom.lower, freedom.upper))


def aim_exhibit(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, Any]:
    """A table for the report, empty where nothing aims: the plan beside the path that aims all along and the
    one that never does."""
    aims = [f for f in targets.freedoms if _aim(f) is not None]
    if not aims:
        return {}
    # first the one whose samples are those of the plan: what the arm reaches there is remembered
    free = _found(scene, targets, _free(targets))
    held = _found(scene, targets, _held(scene, targets))
    rows = [
        ("as planned", *_figures(scene, targets, q)),
        ("toward the base all along, not optimised", *held),
        ("free, not optimised", *free),
    ]
    columns = tuple(c for c in SPIN_COLUMNS if c != "[deg]")
    return {
        "aim": {
            "kind": "table",
            "title": "What turning the tool toward the base is worth",
            "columns": columns,
            "rows": rows,
        }
    }


def _found(scene: Scene, targets: Targets, freedoms: tuple[Any, ...]) -> tuple[str, ...]:
    """Figures of the path of targets with other freedoms."""
    other = dataclasses.replace(targets, freedoms=freedoms, exhibits={}, claims=())
    _, found = find_path(scene, other)
    return _figures(scene, other, found.q) if isinstance(found, Found) else ("no path", *[""] * 4)


def _figures(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> tuple[str, ...]:
    moved, most, time, limit, single = 0.0, 0.0, 0.0, np.inf, np.inf
    for arm in targets.arms:
        chain = scene.chains[arm]
        steps = np.abs(np.diff(q[arm], axis=0))
        moved += float(steps.sum())
        most = max(most, float(steps.sum(axis=0).max()))
        time = max(time, float((steps / speed_limits(scene, arm)).max(axis=1).sum()))
        limit = min(limit, float(chain.limit_margin(q[arm]).min()))
        single = min(single, float(chain.singularity_margin(q[arm]).min()))
    shown = [moved / DEG, most / DEG, time, limit / DEG, single / DEG]
    return tuple(f"{value:.{digits}f}" for value, digits in zip(shown, (0, 0, 1, 1, 1), strict=True))


def _held(scene: Scene, targets: Targets) -> tuple[Any, ...]:
    out = []
    for freedom in targets.freedoms:
        aim = _aim(freedom)
        if isinstance(freedom, ScrewFreedom) and aim is not None:
            held = aimed_values(scene, targets, freedom, aim)
            freedom = dataclasses.replace(freedom, lower=held, upper=held, prefer=None, aim=None)
        out.append(freedom)
    return tuple(out)


def _free(targets: Targets) -> tuple[Any, ...]:
    return tuple(
        dataclasses.replace(f, prefer=None, aim=None)
        if isinstance(f, ScrewFreedom) and _aim(f) is not None
        else f
        for f in targets.freedoms
    )


def _aim(freedom: object) -> Aim | None:
    return freedom.aim if isinstance(freedom, ScrewFreedom) else None
