"""Chooses branches for all arms together; feeds collisions back to the ladder until its path is free."""

import dataclasses
import functools
import heapq
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.motion.planning_scene import FULL_TURN, TRANSIT_KIND, Scene
from planner.motion.search.ladder import Ladder, Path, Steps, joint_path, steps
from planner.motion.search.reach import Checker, Grid, Others, Parts, Reach, Rungs, full_turn, reach
from planner.motion.trajectory.joint_path import Dense, clear, dense
from planner.targets import Targets

LAZY_ROUNDS = 8
"""So often a path's own samples alone are looked at; then all samples of targets that collide, and of ever
more targets around these, so that every search comes to an end."""

MOST_CHOICES = 6
"""Choices of branches of which the best path is taken, once one has a path; without one all are tried."""

WORTHWHILE_GAIN_SHARE = 0.3
"""Share by which other branches must promise a cheaper path for them to be checked for collisions as well."""

TOLERATED_EXCESS_SHARE = 1e-3
"""Share of its cost by which a path may be dearer than the bound that ignores turns before turns are searched
too."""

MOVE_ROUNDS = 40
"""So often steps are left out whose straight moves collide."""


@dataclasses.dataclass(frozen=True)
class Found:
    """A path over the samples: freedom ``values`` (N, F), joints {arm: (N, 6)}, and how it was found.

    ``loose``: it keeps clearance at the targets, but no path over the samples was found that does between
    them too.
    """

    path: Path
    values: FloatArray
    q: dict[str, FloatArray]
    choices: int
    checks: int = 0
    rounds: int = 1
    loose: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Dead:
    """Where all paths end for collisions: none passes target ``index``, with any samples and any branches
    that reach all targets.

    Of the choice of branches ``rungs`` that comes farthest: samples (S,) of this target that every arm can
    take (``possible``) and that are ``free``; ``later`` where there are none: the first target after this one
    with free samples, with the grid and these. ``tried``: the choices of branches, of all arms in their
    order, ``shorter`` how many of them end sooner. ``before`` gives what :attr:`reached` and :attr:`next`
    are, and may look at all targets for that; None: nothing is known of them.
    """

    index: int
    rungs: Mapping[str, Rungs]
    grid: Grid
    possible: BoolArray
    free: BoolArray
    later: tuple[Grid, int, BoolArray] | None
    tried: frozenset[tuple[int, ...]]
    shorter: int
    before: Callable[[], tuple[BoolArray, BoolArray]] | None = None

    @property
    def reached(self) -> BoolArray:
        """Samples (S,) of the target before that a free path reaches."""
        return self._before[0]

    @property
    def next(self) -> BoolArray:
        """Samples (S,) of this target that a step leads to from those."""
        return self._before[1]

    @functools.cached_property
    def _before(self) -> tuple[BoolArray, BoolArray]:
        nothing = np.zeros(len(self.possible), dtype=bool), self.possible
        return nothing if self.before is None else self.before()


@dataclasses.dataclass(frozen=True)
class Wound:
    """A ``joint`` (0 to 5) of ``arm`` that would have to turn on and on: along a path that forgets its limits
    it goes from ``low`` to ``high`` [rad], which no whole turns bring within them; with ``jumps`` it would
    have to jump from the one to the other, as it can take both but nothing beyond."""

    arm: str
    joint: int
    low: float
    high: float
    jumps: bool = False


@dataclasses.dataclass(frozen=True)
class Blocked:
    """Why there is no path, and what is known of it.

    ``reach`` is the table of all arms; ``common`` the first target that no choice of branches passes, N if it
    is collisions that are in the way; then ``dead`` says where, or ``hit`` is a target with joints
    {arm: (6,)} on the move to it that collide. ``few``: the targets that all this is about, with their
    indices (K,) in the job, where only some of it was looked at. ``wound``: the joint whose turns end the
    paths, if it is turns.
    """

    reach: Mapping[str, Reach]
    common: int
    dead: Dead | None = None
    hit: tuple[int, dict[str, FloatArray]] | None = None
    few: tuple[Targets, IndexArray] | None = None
    wound: Wound | None = None


def search(
    scene: Scene,
    targets: Targets,
    grid: Grid,
    others: Others | None = None,
    moves: bool = False,
    only: frozenset[tuple[int, ...]] | None = None,
) -> Found | Blocked:
    """The path of least cost over branches, samples and turns that keeps clearance at every target, and with
    ``moves`` on the straight moves between them, if there is one.

    Branches stay the same over the whole run. Choices of branches are tried in the order of their cost
    without collisions, which bounds their cost with collisions from below; the rest are left out
    once none promises much. Without a path all of them are tried. ``others`` are arms that do not take part;
    ``only`` names the branches of all arms, in their order, that are looked at.
    """
    table = reach(scene, targets, grid)
    choices, common = _choices(scene, targets, grid, table, only)
    best: Found | None = None
    loose: Found | None = None
    checks: dict[int, Checker] = {}
    parts = Parts(scene, grid, tuple(table)) if len(table) > 1 and len(choices) > 1 else None
    ends: list[tuple[int, int]] = []
    closed: list[int] = []
    tried, offered = 0, 0
    queue = [(p.cost, k, False) for k, c in enumerate(choices) if (p := c.modulo.shortest()) is not None]
    heapq.heapify(queue)
    while queue:
        bound, k, exact = heapq.heappop(queue)
        if best is not None and (
            best.path.cost <= bound * (1.0 + WORTHWHILE_GAIN_SHARE) or tried >= MOST_CHOICES
        ):
            break
        if not exact:  # what has no free path without turns needs no search with them, which takes longer
            checks[k] = Checker(scene, targets, grid, choices[k].rungs, others, parts)
            checks[k].whole(np.array(closed, dtype=np.intp))
            _, end = _free_path(choices[k].modulo.farthest, checks[k])
            if end == targets.count:
                plain = choices[k].shortest()
                offered += plain is not None
                queue += [] if plain is None else [(plain.path.cost, k, True)]
                heapq.heapify(queue)
                continue
            found = None
        else:
            tried += 1
            found, end = choices[k].free_path(checks[k])
        if found is None:
            ends.append((end, k))
            if end not in closed and not checks[k].free(end).any():
                closed.append(end)
            continue
        if moves:
            found = _with_free_moves(scene, targets, choices[k], checks[k], found)
        if found.loose:
            loose = loose or found
        elif best is None or found.path.cost < best.path.cost:
            best = found
    chosen = best if best is not None else loose
    if chosen is not None:
        return dataclasses.replace(chosen, choices=offered)
    dead = _dead(grid, [(end, choices[k], checks[k]) for end, k in ends])
    if dead is not None:
        return Blocked(table, targets.count, dead)
    common = max((c.modulo.furthest() for c in choices), default=common)
    wound = None
    if common == targets.count:  # turns alone are in the way
        common, wound = max((c.wound(scene) for c in choices), key=lambda one: one[0])
    elif choices:
        wound = max(choices, key=lambda c: c.modulo.furthest()).jump()
    return Blocked(table, min(common, targets.count - 1), wound=wound)


class Choice:
    """One branch for each arm. Turns are searched only where forgetting them gives a path that cannot be
    lifted."""

    def __init__(
        self,
        scene: Scene,
        grid: Grid,
        rungs: Mapping[str, Rungs],
        modulo: Mapping[str, tuple[Rungs, Steps]],
        extra: FloatArray | None,
    ) -> None:
        self.rungs = rungs
        self._scene, self._grid, self._extra = scene, grid, extra
        self.modulo = Ladder(grid, [r for r, _ in modulo.values()], [m for _, m in modulo.values()], extra)
        self._exact: Ladder | None = None
        self._closed: list[tuple[int, int, int]] = []

    def _search_turns(self) -> Ladder:
        moves = [_moves(self._scene, r, self._grid) for r in self.rungs.values()]
        ladder = Ladder(self._grid, tuple(self.rungs.values()), moves, self._extra)
        for step in self._closed:
            ladder.close(*step)
        return ladder

    def shortest(self, blocked: FloatArray | None = None) -> Found | None:
        """The path of least cost, turns and limits included; ``blocked`` (N, S) as in :class:`Ladder`."""
        found = self.farthest(blocked)
        return found if found is not None and len(found.values) == len(self._grid.values) else None

    def farthest(self, blocked: FloatArray | None = None) -> Found | None:
        """The path of least cost to the last target that any path reaches; it is as long as that. None if no
        sample of the first target is allowed."""
        path = self.modulo.farthest(blocked)
        if path is None:
            return None
        lifted, whole = self._lift(path), len(path.sample) == len(self._grid.values)
        dear = lifted is None or (whole and lifted.path.cost > path.cost * (1.0 + TOLERATED_EXCESS_SHARE))
        if lifted is not None and not dear:
            return lifted
        if self._exact is None:
            self._exact = self._search_turns()
        exact = self._exact.farthest(blocked)
        if exact is None:
            return None
        rows = np.arange(len(exact.sample))
        return Found(exact, self._grid.values[rows, exact.sample], joint_path(exact, self.rungs), 1)

    def free_path(self, check: Checker) -> tuple[Found | None, int]:
        """The shortest path whose targets are all free, turns included, and N; or None, and the first target
        that no free path reaches."""
        found, end = _free_path(self.farthest, check)
        if not isinstance(found, Found):
            return None, end
        return dataclasses.replace(found, checks=check.checks, rounds=check.rounds), end

    def wound(self, scene: Scene) -> tuple[int, Wound | None]:
        """The first target that no path reaches whose joints keep to their turns, and the joint that has too
        few of them; None where that is not one joint alone."""
        path, found = self.modulo.farthest(), self.farthest()
        end = 0 if found is None else len(found.values)
        if path is None or len(path.sample) < len(self._grid.values):
            return end, None
        rows, worst, out = np.arange(len(path.sample)), 0.0, None
        turns = FULL_TURN * np.arange(-2, 3)[:, None]
        for arm, own in self.rungs.items():
            q, robot = np.unwrap(own.q[rows, path.sample], axis=0), scene.chains[arm].robot
            low, high = q.min(axis=0) + turns, q.max(axis=0) + turns
            margin = scene.settings.joint_margin
            beyond = np.maximum(robot.lower + margin - low, high - robot.upper + margin)
            turn = beyond.argmin(axis=0)
            joint = int(beyond.min(axis=0).argmax())
            if beyond[turn[joint], joint] > worst:
                worst = float(beyond[turn[joint], joint])
                out = Wound(arm, joint, float(low[turn[joint], joint]), float(high[turn[joint], joint]))
        return end, out

    def jump(self) -> Wound | None:
        """The joint that would have to jump by more than half a turn from the last target that a path reaches
        to the next one; None if there is none, or none alone."""
        path = self.modulo.farthest()
        if path is None or not 0 < len(path.sample) < len(self._grid.values):
            return None
        row, found = len(path.sample), list[Wound]()
        for arm, own in self.rungs.items():
            before, after = own.q[row - 1, path.sample[-1]], own.q[row][own.ok[row].any(axis=-1)]
            if not len(after):
                continue
            change = after[int(np.abs(after - before).max(axis=1).argmin())] - before
            for joint in np.flatnonzero(np.abs(change) > 0.5 * FULL_TURN).tolist():
                at = float(before[joint])
                found.append(Wound(arm, joint, at, at + float(change[joint]), True))
        return found[0] if len(found) == 1 else None

    def ladder(self) -> Ladder:
        """The one with turns where these were searched, else the one that forgets them."""
        return self.modulo if self._exact is None else self._exact

    def close(self, i: int, before: int, sample: int) -> None:
        """Forbids the step to ``sample`` of target i from sample ``before`` of the one before it."""
        self._closed.append((i, before, sample))
        for ladder in (self.modulo, self._exact):
            if ladder is not None:
                ladder.close(i, before, sample)

    def _lift(self, path: Path) -> Found | None:
        """The path with the turns that follow from continuity, from the first turn that costs least."""
        rows = np.arange(len(path.sample))
        q, turns, cost = {}, {}, path.cost
        for arm, r in self.rungs.items():
            many = self._scene.chains[arm].many_turns
            angles = r.q[rows, path.sample]
            change = np.where(many, np.round(np.diff(angles, axis=0) / FULL_TURN), 0.0)
            whole = np.concatenate([np.zeros((1, len(many))), -np.cumsum(change, axis=0)])
            wanted = np.round(r.turns / FULL_TURN) + whole[:, None, :]
            same = (wanted[:, :, None, :] == np.round(r.turns / FULL_TURN)).all(axis=-1)
            state = np.where(same.any(axis=-1), same.argmax(axis=-1), -1)
            paid = np.where(state >= 0, r.penalty[rows[:, None], path.sample[:, None], state], np.inf).sum(
                axis=0
            )
            start = int(np.argmin(paid))
            if not np.isfinite(paid[start]):
                return None
            cost += float(paid[start] - r.penalty[rows, path.sample].min(axis=-1).sum())
            turns[arm] = state[:, start]
            q[arm] = angles + r.turns[turns[arm]]
        values = self._grid.values[rows, path.sample]
        return Found(Path(path.branch, path.sample, turns, cost), values, q, 1)


def _choices(
    scene: Scene,
    targets: Targets,
    grid: Grid,
    table: Mapping[str, Reach],
    only: frozenset[tuple[int, ...]] | None,
) -> tuple[list[Choice], int]:
    """Choices of branches with a common sample at every target; the farthest target where others fail."""
    extra = _preference(targets, grid)
    flat = {
        (arm, b): (r.modulo(), _moves(scene, r.modulo(), grid))
        for arm, one in table.items()
        for b, r in one.branches.items()
    }
    out, common = [], 0
    for branches in itertools.product(*(r.branches for r in table.values())):
        if only is not None and branches not in only:
            continue
        rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
        both = np.logical_and.reduce([r.ok.any(axis=-1) for r in rungs.values()]).any(axis=1)
        if both.all():
            modulo = {arm: flat[arm, b] for arm, b in zip(table, branches, strict=True)}
            out.append(Choice(scene, grid, rungs, modulo, extra))
        else:
            common = max(common, int(np.argmin(both)))
    return out, common


def _moves(scene: Scene, rungs: Rungs, grid: Grid) -> Steps:
    return steps(rungs, scene.chains[rungs.arm], grid, speed_limits(scene, rungs.arm))


def speed_limits(scene: Scene, arm: str) -> FloatArray:
    """Joint speed limits (J,) [rad/s] of an arm with the settings' fraction."""
    return np.asarray(scene.chains[arm].robot.velocity * scene.settings.speed_fraction)


def _preference(targets: Targets, grid: Grid) -> FloatArray | None:
    """Cost (N, S) [s] of the distance from preferred values, relative to the width of the range."""
    out: FloatArray | None = None
    for j, freedom in enumerate(targets.freedoms):
        if freedom.prefer is None:
            continue
        away = grid.values[..., j] - freedom.prefer[:, None]
        if full_turn(freedom):
            away = away - FULL_TURN * np.round(away / FULL_TURN)
        width = np.maximum(freedom.upper - freedom.lower, 1e-12)[:, None]
        part = freedom.weight / targets.count * np.square(2.0 * away / width)
        out = part if out is None else out + part
    return out


_Way = TypeVar("_Way", Path, Found)


def _free_path(
    farthest: Callable[[FloatArray | None], _Way | None], check: Checker
) -> tuple[_Way | None, int]:
    """The shortest path whose targets are all free, and N; or None, and the first target that no free path
    reaches.

    The path to the last target that ``farthest`` can still reach is looked at, what collides is left out,
    again. Every round after the first few makes at least one target wholly known.
    """
    count = len(check.known)
    for number in itertools.count():
        check.rounds += 1
        found = farthest(check.cost())
        if found is None:
            return None, 0
        sample = found.sample if isinstance(found, Path) else found.path.sample
        rows = np.arange(len(sample))
        check.check(rows, sample)
        hit = rows[check.collided[rows, sample]]
        if not len(hit):
            return (found if len(rows) == count else None), len(rows)
        if check.suspect is None:
            check.coarse()
        elif number > LAZY_ROUNDS:
            away = min(2 ** (number - LAZY_ROUNDS) // 2, count)
            near = np.unique(hit[:, None] + np.arange(-away, away + 1))
            check.whole(near[(near >= 0) & (near < count)])
    raise AssertionError("unreachable")


def _with_free_moves(scene: Scene, targets: Targets, choice: Choice, check: Checker, found: Found) -> Found:
    """The path, or the next one whose straight moves are free as well; the same path, loose, if there is
    none. Transits of joined TCPs are left to :mod:`planner.motion.transit`."""
    first = found
    later = np.array([targets.coupled and s.kind == TRANSIT_KIND for s in targets.segment], dtype=bool)
    for _ in range(MOVE_ROUNDS):
        samples = dense(scene, targets, found.path.branch, found.q)
        lost = np.isnan(np.concatenate(list(samples.q.values()), axis=1)).any(axis=1)
        look = np.flatnonzero(~lost & (samples.share < 1.0) & ~later[samples.move])
        some = Dense(samples.move[look], samples.share[look], {a: q[look] for a, q in samples.q.items()})
        lost[look] = ~clear(scene, targets, some)
        bad = np.unique(samples.move[lost & ~later[samples.move]])
        if not len(bad):
            return found
        for i in bad.tolist():
            choice.close(i, int(found.path.sample[i - 1]), int(found.path.sample[i]))
        again, _ = choice.free_path(check)
        if again is None:
            break
        found = again
    return dataclasses.replace(first, loose=True)


def _dead(grid: Grid, ends: Sequence[tuple[int, Choice, Checker]]) -> Dead | None:
    """What is known of the target where the choice of branches ends that comes farthest; None if none of them
    has a path without collisions either."""
    queue = [(-end, k, False) for k, (end, _, _) in enumerate(ends)]
    heapq.heapify(queue)
    while queue:
        end, k, exact = heapq.heappop(queue)
        _, choice, check = ends[k]
        if exact:
            shorter = sum(other < -end for other, _, _ in ends)
            tried = frozenset(tuple(r.branch for r in c.rungs.values()) for _, c, _ in ends)
            return _dead_end(grid, -end, choice, check, tried, shorter)
        if choice.shortest() is not None:
            heapq.heappush(queue, (-choice.free_path(check)[1], k, True))
    return None


def _dead_end(
    grid: Grid, index: int, choice: Choice, check: Checker, tried: frozenset[tuple[int, ...]], shorter: int
) -> Dead:
    count = len(check.known)
    free: BoolArray = check.free(index)
    possible: BoolArray = np.asarray(check.possible[index])

    def before() -> tuple[BoolArray, BoolArray]:
        if index == 0:
            return np.zeros(grid.samples, dtype=bool), possible
        check.whole(np.arange(index))
        reached = choice.ladder().reachable(check.cost())[index - 1]
        return reached, choice.ladder().after(index, reached) & possible

    later = None
    for i in range(index + 1, count) if not free.any() else ():
        if check.free(i).any():
            later = grid, i, check.free(i)
            break
    return Dead(index, choice.rungs, grid, possible, free, later, tried, shorter, before)
