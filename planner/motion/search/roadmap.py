"""A path where the freedoms are too many for a ladder over all their samples: from coarse to fine.

At some of the targets, the rungs, all samples are known that every arm can reach. The shortest path from rung
to rung, any sample after any other, is found by dynamic programming; its postures, then the targets and the
moves between its rungs are looked at, what does not do is left out, and the path is found again.
"""

import dataclasses
import itertools
from collections import Counter
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import FloatArray, IndexArray
from planner.motion.planning_scene import FULL_TURN, Scene
from planner.motion.search.ladder import LARGEST_STEP, TIE_SHARE, TURN_CODE, Path, Turns
from planner.motion.search.ladder_search import Blocked, Dead, Found, speed_limits
from planner.motion.search.reach import Grid, Reach, Rungs, on_branches, reach
from planner.motion.search.subsampling import Coordinates, Level, levels, subset
from planner.motion.trajectory.joint_path import dense
from planner.motion.ways import ends_free
from planner.targets import Targets

RUNG_COUNTS: Final = (48, 96)
"""About so many rungs; more where fewer have no path."""

MOST_RUNGS: Final = 300
"""Where so many targets are stops, only some of them are rungs."""

MOST_ROUNDS: Final = 80
"""Paths that are held against bodies and moves at most."""
NEAR_ROUNDS: Final = 20
"""The same of paths near a former one."""
MOST_CHOICES: Final = 6
"""Choices of branches that are looked at in each level."""

DOUBT_COUNT: Final = 3
"""A target between rungs that has been in the way so often is asked whole."""

MOST_STATES: Final = 400
"""States of a rung that are kept at most, evenly spread."""
MOST_KEPT_STEPS: Final = 10_000_000
"""Steps of the best choice of branches at most for it to be kept while the others are looked at: 120 MB."""
_NO_TURN: Final = 3.0
"""Changes of a joint [rad] up to this are no turn and less."""
MOST_DIAGNOSED: Final = 120_000
"""States that are looked at to say why there is no path."""


def search_wide(scene: Scene, targets: Targets) -> tuple[Grid, Found | Blocked]:
    """A path over branches and samples of many freedoms, of few first, that keeps clearance at and between
    targets."""
    coordinates = Coordinates(targets)
    plan = levels(targets, coordinates)
    hit: tuple[int, dict[str, FloatArray]] | None = None
    checks = 0
    in_reach = list(plan)
    closed: list[int] = []
    for rungs, ends in [*((count, True) for count in RUNG_COUNTS), (RUNG_COUNTS[0], False)]:
        rows = _rows(targets, rungs)
        for level in list(in_reach):
            tried = _Attempt(scene, targets, coordinates, level, rows, ends, closed)
            found = tried.run()
            checks += tried.checks
            if found is not None:
                return _as_grid(found), dataclasses.replace(found, checks=checks)
            hit = tried.hit or hit
            if not tried.in_reach:
                in_reach.remove(level)
    return _blocked(scene, targets, coordinates, plan, hit, closed)


def search_near(
    scene: Scene, targets: Targets, samples: FloatArray, branch: Mapping[str, int]
) -> tuple[Grid, Found] | None:
    """A path on given branches through ``samples`` (S, F) of all freedoms and between them, which keeps
    clearance at and between targets; None where there is none. Samples are coordinates."""
    coordinates = Coordinates(targets)
    level = Level(tuple(f.name for f in targets.freedoms), samples)
    rows = _rows(targets, RUNG_COUNTS[0])
    tried = _Attempt(scene, targets, coordinates, level, rows, not targets.coupled, [])
    found = tried.run_on(branch)
    return None if found is None else (_as_grid(found), found)


def _as_grid(found: Found) -> Grid:
    """The one sample of each target that a path goes through."""
    return Grid(found.values[:, None], np.zeros((0, 1), dtype=np.intp))


def _rows(targets: Targets, count: int) -> IndexArray:
    """Targets that are rungs: evenly spread, the ends, stops and where segments change."""
    rows = set(np.linspace(0, targets.count - 1, min(count, targets.count)).round().astype(int).tolist())
    rows |= set(np.flatnonzero(targets.stop).tolist())
    rows |= {i for i in range(1, targets.count) if targets.segment[i] != targets.segment[i - 1]}
    out = np.array(sorted(rows), dtype=np.intp)
    if len(out) <= MOST_RUNGS:
        return out
    return out[np.linspace(0, len(out) - 1, MOST_RUNGS).round().astype(np.intp)]


class _Attempt:
    """One level over one set of rungs."""

    def __init__(
        self,
        scene: Scene,
        targets: Targets,
        coordinates: Coordinates,
        level: Level,
        rows: IndexArray,
        ends: bool,
        closed: list[int],
    ) -> None:
        """``ends``: the arms must be able to come to the first and the last target one after the other.
        ``closed``: targets that ended other attempts, the last one last; what ends this one is added."""
        self.ends = ends
        self.scene, self.targets, self.coordinates, self.rows = scene, targets, coordinates, rows
        self.samples, self.names = level.samples, level.names
        self.hit: tuple[int, dict[str, FloatArray]] | None = None
        self.checks = 0
        self.in_reach = False
        self._closed = closed

    def closes(self, branch: Mapping[str, int], target: int) -> bool:
        """Whether no sample of the level is free at a target, which is then asked first of what is tried
        next."""
        index = np.full(len(self.samples), target)
        values = self.coordinates.values(self.samples, index)
        poses = self.scene.tcp(self.targets, values, index)
        ok, q = np.ones(len(index), dtype=bool), {}
        for arm, pose in poses.items():
            chain = self.scene.chains[arm]
            q[arm] = chain.inverse(pose, [branch[arm]], self.targets.last(arm, values))[:, 0]
            ok &= chain.best_limit_margin(q[arm]) >= self.scene.settings.joint_margin
            ok &= chain.singularity_margin(q[arm]) >= self.scene.settings.singularity_margin
        good = np.flatnonzero(ok)
        self.checks += len(good)
        some = {arm: v[good] for arm, v in q.items()}
        if len(good) and self.scene.free(self.targets, some, index[good]).any():
            return False
        if target in self._closed:
            self._closed.remove(target)
        self._closed.append(target)
        return True

    def run(self) -> Found | None:
        """A path, or None; ``hit`` then has a collision that was in the way, if there was one."""
        few, grid = self._grid()
        table = reach(self.scene, few, grid)
        offers: list[tuple[float, int, dict[str, Rungs]]] = []
        for branches in itertools.product(*(r.branches for r in table.values())):
            rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
            cost = sum(r.penalty.min(axis=-1) for r in rungs.values())
            if np.isfinite(cost).any(axis=1).all():
                offers.append((float(np.min(cost, axis=1).sum()), len(offers), rungs))
        self.in_reach = bool(offers)
        offers.sort(key=lambda offer: offer[:2])
        known: list[tuple[float, int, dict[str, Rungs]]] = []
        best: dict[int, _Graph] = {}
        for _, _, rungs in offers[:MOST_CHOICES]:
            graph = _Graph(self, rungs)
            found = graph.shortest()
            if found is not None:
                if all(found[1] < cost for cost, _, _ in known):
                    best = {len(known): graph} if graph.steps <= MOST_KEPT_STEPS else {}
                known.append((found[1], len(known), rungs))
            del graph
        for _, number, rungs in sorted(known, key=lambda offer: offer[:2]):
            branch = {arm: r.branch for arm, r in rungs.items()}
            if any(self.closes(branch, i) for i in self._closed[::-1]):
                continue
            # made again but for the best: all of them at once would fill the memory
            path = (best.pop(number, None) or _Graph(self, rungs)).free_path(MOST_ROUNDS)
            if path is not None:
                return dataclasses.replace(path, choices=len(offers))
        return None

    def run_on(self, branch: Mapping[str, int]) -> Found | None:
        """A path on one branch of each arm, or None; fewer rounds are spent on it."""
        rungs = on_branches(self.scene, *self._grid(), branch)
        return None if rungs is None else _Graph(self, rungs).free_path(NEAR_ROUNDS)

    def _grid(self) -> tuple[Targets, Grid]:
        """The targets that are rungs, with all samples of the level."""
        count = len(self.samples)
        every = np.repeat(self.rows[:, None], count, axis=1)
        values = self.coordinates.values(
            np.broadcast_to(self.samples, (len(self.rows), *self.samples.shape)), every
        )
        return subset(self.targets, self.rows), Grid(values, np.zeros((0, count), dtype=np.intp))


class _Reached:
    """The best paths to all states of the first rungs. ``rows``: cost (S,) [s] and turns {arm: (S,)} of each
    at every rung; ``before``: the state (S,) that each of the next one comes from. ``ends``: no state of the
    rung behind the last row can be reached."""

    def __init__(self) -> None:
        self.rows: list[tuple[FloatArray, dict[str, IndexArray]]] = []
        self.before: list[IndexArray] = []
        self.ends = False

    def add(self, before: IndexArray, cost: FloatArray, turn: dict[str, IndexArray]) -> None:
        """Paths to the next rung."""
        self.ends = not np.isfinite(cost).any()
        if not self.ends:
            self.rows.append((cost, turn))
            self.before.append(before)

    def forget(self, k: int) -> None:
        """Rung k is reached otherwise."""
        if k <= len(self.rows):
            self.ends = False
            del self.rows[k:], self.before[max(k - 1, 0) :]


class _Graph:
    """States of one choice of branches at every rung, and the cost of going from one to the next."""

    def __init__(self, attempt: _Attempt, rungs: Mapping[str, Rungs]) -> None:
        self.attempt, self.rungs = attempt, rungs
        self.scene, self.targets, self.rows = attempt.scene, attempt.targets, attempt.rows
        self.branch = {arm: r.branch for arm, r in rungs.items()}
        cost = sum(r.penalty.min(axis=-1) for r in rungs.values())
        good = np.isfinite(cost)
        self.states = [_thinned(np.flatnonzero(g)) for g in good]
        self.q = {arm: [r.q[k, s] for k, s in enumerate(self.states)] for arm, r in rungs.items()}
        self.blocked = [np.zeros(len(s), dtype=bool) for s in self.states]
        self.known = [np.zeros(len(s), dtype=bool) for s in self.states]
        self.tables = {arm: Turns(r, self.states) for arm, r in rungs.items()}
        self.time: list[NDArray[np.float32]] = []
        self.code: dict[str, list[NDArray[np.int32] | None]] = {arm: [] for arm in rungs}
        self._reached: dict[int, _Reached] = {}
        self.doubt: Counter[int] = Counter()
        self.fine: dict[tuple[int, int, int], dict[str, FloatArray]] = {}
        for k in range(len(self.rows) - 1):
            self._steps(k)

    def _steps(self, k: int) -> None:
        """Time (A, B) from every state of rung k to every one of the next, inf where a joint goes too far."""
        slowest = np.zeros((len(self.states[k]), len(self.states[k + 1])), dtype=np.float32)
        total, change = np.zeros_like(slowest), np.empty_like(slowest)
        most = LARGEST_STEP * max(1.0, 0.5 * float(self.rows[k + 1] - self.rows[k]))
        bad = np.zeros(slowest.shape, dtype=bool)
        for arm, q in self.q.items():
            many = self.scene.chains[arm].many_turns
            speed = speed_limits(self.scene, arm).astype(np.float32)
            before, after = np.asfortranarray(q[k]), np.asfortranarray(q[k + 1])
            ends = after.max(axis=0) - before.min(axis=0), before.max(axis=0) - after.min(axis=0)
            farthest = np.maximum(*ends).astype(np.float32)  # that each joint goes
            code = np.zeros(slowest.shape if (farthest > _NO_TURN)[many].any() else 0, dtype=np.int32)
            for j in range(len(many)):
                np.subtract(after[None, :, j], before[:, None, j], out=change, casting="same_kind")
                if many[j] and farthest[j] > _NO_TURN:
                    whole = np.round(change / FULL_TURN)
                    change -= FULL_TURN * whole
                    code += (TURN_CODE**j * whole).astype(np.int32)
                np.abs(change, out=change)
                if farthest[j] > most:
                    bad |= change > most
                change /= speed[j]
                np.maximum(slowest, change, out=slowest)
                total += change
            self.code[arm].append(code if code.any() else None)
        total *= np.float32(TIE_SHARE)
        slowest += total
        slowest[bad] = np.inf
        self.time.append(slowest)

    @property
    def steps(self) -> int:
        """Steps from a state to one of the next rung."""
        return sum(time.size for time in self.time)

    def shortest(self) -> tuple[IndexArray, float] | None:
        """States (K,) of the path of least cost and that cost, or None.

        Every state keeps the turns of the path that reaches it best; other turns at the start are tried where
        there is no path.
        """
        starts = [t.starts() for t in self.tables.values()]
        for number, pick in enumerate(itertools.islice(itertools.product(*starts), 12)):
            found = self._forward(number, dict(zip(self.tables, pick, strict=True)))
            if found is not None:
                return found
        return None

    def _forward(self, number: int, start: Mapping[str, IndexArray]) -> tuple[IndexArray, float] | None:
        """The path from the turns ``start`` on; what was found of it before is gone on with."""
        known = self._reached.setdefault(number, _Reached())
        if not known.rows:
            cost = np.where(self.blocked[0], np.inf, 0.0)
            for arm, t in self.tables.items():
                cost = cost + t.penalty(0, start[arm])
            known.rows.append((cost, dict(start)))
        while not known.ends and len(known.rows) <= len(self.time):
            known.add(*self._next(len(known.rows) - 1, *known.rows[-1]))
        cost, turn = known.rows[-1]
        if known.ends or not np.isfinite(cost).any():
            return None
        states = np.empty(len(self.rows), dtype=np.intp)
        states[-1] = int(np.argmin(cost))
        self._last = {arm: int(c[states[-1]]) for arm, c in turn.items()}
        for k in range(len(known.before) - 1, -1, -1):
            states[k] = known.before[k][states[k + 1]]
        return states, float(cost.min())

    def _next(
        self, k: int, cost: FloatArray, turn: Mapping[str, IndexArray]
    ) -> tuple[IndexArray, FloatArray, dict[str, IndexArray]]:
        """From which state of rung k each of the next is reached best, at what cost and with which turns."""
        offer = cost[:, None] + self.time[k]
        new = {}
        for arm, t in self.tables.items():
            step = self.code[arm][k]
            if step is None:  # no joint goes round: few turns, each for all states of the next rung
                codes, which = np.unique(turn[arm], return_inverse=True)
                every = np.broadcast_to(codes[:, None], (len(codes), offer.shape[1]))
                offer += t.penalty(k + 1, every)[which]
            else:
                new[arm] = turn[arm][:, None] - step
                offer += t.penalty(k + 1, new[arm])
        offer[:, self.blocked[k + 1]] = np.inf
        before = np.argmin(offer, axis=0)
        columns = np.arange(offer.shape[1])
        after = {arm: new[arm][before, columns] if arm in new else c[before] for arm, c in turn.items()}
        return before, offer[before, columns], after

    def _changed(self, k: int) -> None:
        """What is known of paths to rung k and beyond holds no longer."""
        for known in self._reached.values():
            known.forget(k)

    def free_path(self, rounds: int) -> Found | None:
        """The shortest path that keeps margins and clearance everywhere, or None."""
        for count in range(rounds):
            found = self.shortest()
            if found is None or self._is_closed():
                return None
            states, cost = found
            if self._block_states(states) or self._block_edges(states):
                continue
            path = self._whole(states, cost, count + 1)
            if self._block_moves(states, path):
                continue
            return path
        return None

    def _is_closed(self) -> bool:
        """Whether a target that has been in the way often is so with all samples."""
        often = [i for i, count in self.doubt.items() if count >= DOUBT_COUNT]
        for i in often:
            self.doubt[i] = -MOST_ROUNDS  # once is enough
        return any(self.attempt.closes(self.branch, i) for i in often)

    def _block_states(self, states: IndexArray) -> bool:
        """Looks at the path's states; where some collide, at all states of their rungs at once."""
        hits = self._check(np.arange(len(states)), states)
        if hits:
            some = [np.flatnonzero(~self.known[k]) for k in hits]
            self._check(np.repeat(hits, [len(one) for one in some]), np.concatenate(some))
        for k in hits:
            if self.blocked[k].all():
                self.attempt.closes(self.branch, int(self.rows[k]))
        return len(hits) > 0

    def _check(self, rung: IndexArray, state: IndexArray) -> list[int]:
        new = np.array([not self.known[k][s] for k, s in zip(rung, state, strict=True)], dtype=bool)
        rung, state = rung[new], state[new]
        if len(rung) == 0:
            return []
        q = {arm: np.array([a[k][s] for k, s in zip(rung, state, strict=True)]) for arm, a in self.q.items()}
        free = self.scene.free(self.targets, q, self.rows[rung])
        self.attempt.checks += len(rung)
        hits = np.flatnonzero(~free)
        if self.attempt.ends:
            last = np.flatnonzero(free & ((rung == 0) | (rung == len(self.rows) - 1)))
            if len(last):
                free[last] = ends_free(self.scene, {arm: v[last] for arm, v in q.items()})
        for k, s, ok in zip(rung, state, free, strict=True):
            self.known[k][s], self.blocked[k][s] = True, not ok
        for k in np.unique(rung[~free]).tolist():
            self._changed(k)
        if len(hits):
            first = int(hits[0])
            self.attempt.hit = int(self.rows[rung[first]]), {arm: v[first] for arm, v in q.items()}
        return [int(k) for k in rung[~free]]

    def _ends(self, k: int, states: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Coordinates at rung k and, by the shortest way, at the next."""
        samples, c = self.attempt.samples, self.attempt.coordinates
        start = samples[self.states[k][states[k]]]
        return start, start + c.way(start, samples[self.states[k + 1][states[k + 1]]])

    def _block_edges(self, states: IndexArray) -> bool:
        """Looks at the targets between the path's rungs; leaves out the steps that do not do."""
        steps = [k for k in range(len(states) - 1) if (k, states[k], states[k + 1]) not in self.fine]
        rows, owner, coordinates = [], [], []
        for k in steps:
            inner = np.arange(self.rows[k] + 1, self.rows[k + 1])
            start, end = self._ends(k, states)
            share = (inner - self.rows[k]) / (self.rows[k + 1] - self.rows[k])
            rows.append(inner)
            owner.append(np.full(len(inner), k))
            coordinates.append(start + share[:, None] * (end - start))
        if not steps:
            return False
        at, who = np.concatenate(rows), np.concatenate(owner)
        values = self.attempt.coordinates.values(np.concatenate(coordinates), at)
        poses = self.scene.tcp(self.targets, values, at)
        ok, q = np.ones(len(at), dtype=bool), {}
        for arm, pose in poses.items():
            chain = self.scene.chains[arm]
            q[arm] = chain.inverse(pose, [self.branch[arm]], self.targets.last(arm, values))[:, 0]
            best = chain.best_limit_margin(q[arm])
            ok &= best >= self.scene.settings.joint_margin
            ok &= chain.singularity_margin(q[arm]) >= self.scene.settings.singularity_margin
        good = np.flatnonzero(ok)
        if len(good):
            free = self.scene.free(self.targets, {arm: v[good] for arm, v in q.items()}, at[good])
            self.attempt.checks += len(good)
            if not free.all():
                first = good[int(np.argmin(free))]
                self.attempt.hit = int(at[first]), {arm: v[first] for arm, v in q.items()}
                self.doubt.update(at[good[~free]].tolist())
            ok[good] = free
        lost = set(who[~ok].tolist())
        for k in steps:
            key = (k, int(states[k]), int(states[k + 1]))
            if k in lost:
                self._leave_out(*key)
            else:
                self.fine[key] = {arm: v[who == k] for arm, v in q.items()}
        return bool(lost)

    def _leave_out(self, k: int, state: int, after: int) -> None:
        """Nothing goes from this state of rung k to that one of the next."""
        self.time[k][state, after] = np.inf
        self._changed(k + 1)

    def _whole(self, states: IndexArray, cost: float, rounds: int) -> Found:
        """The path at all targets, turns included."""
        coordinates = np.empty((self.targets.count, self.attempt.samples.shape[1]))
        q = {arm: np.empty((self.targets.count, own[0].shape[1])) for arm, own in self.q.items()}
        at = self.attempt.samples[self.states[0][states[0]]]
        for k in range(len(self.rows)):
            coordinates[self.rows[k]] = at
            for arm in self.rungs:
                q[arm][self.rows[k]] = self.q[arm][k][states[k]]
            if k + 1 < len(self.rows):
                start, end = self._ends(k, states)
                inner = np.arange(self.rows[k] + 1, self.rows[k + 1])
                share = (inner - self.rows[k]) / (self.rows[k + 1] - self.rows[k])
                coordinates[inner] = at + share[:, None] * (end - start)
                at = at + (end - start)
                fine = self.fine[k, int(states[k]), int(states[k + 1])]
                for arm in self.rungs:
                    q[arm][inner] = fine[arm]
        for arm, angles in q.items():
            chain, last = self.scene.chains[arm], self.tables[arm].turn(self._last[arm])
            change = np.diff(angles, axis=0)
            change -= np.where(chain.many_turns, FULL_TURN * np.round(change / FULL_TURN), 0.0)
            back = np.cumsum(change[::-1], axis=0)[::-1]
            q[arm] = np.concatenate([angles[-1] + last - back, (angles[-1] + last)[None]])
        values = self.attempt.coordinates.values(coordinates, np.arange(self.targets.count))
        path = Path(self.branch, np.zeros(self.targets.count, dtype=np.intp), {}, cost)
        return Found(path, values, q, 1, self.attempt.checks, rounds)

    def _block_moves(self, states: IndexArray, path: Found) -> bool:
        """Looks at the whole path, turns and straight moves between targets included."""
        out = np.zeros(self.targets.count, dtype=bool)
        for arm, angles in path.q.items():
            out |= self.scene.chains[arm].limit_margin(angles) < self.scene.settings.joint_margin
            out[1:] |= (np.abs(np.diff(angles, axis=0)) > LARGEST_STEP).any(axis=1)
        samples = dense(self.scene, self.targets, self.branch, path.q)
        lost = np.isnan(np.concatenate(list(samples.q.values()), axis=1)).any(axis=1)
        rows = np.flatnonzero(~lost & (samples.share < 1.0))
        if len(rows):
            near = np.where(samples.share >= 0.5, samples.move, samples.move - 1)[rows]
            some = {arm: v[rows] for arm, v in samples.q.items()}
            move, share = samples.move[rows], samples.share[rows]
            free = self.scene.free(self.targets, some, np.maximum(near, 0), move, share=share)
            self.attempt.checks += len(rows)
            if not free.all():
                first = int(np.argmin(free))
                self.attempt.hit = int(samples.move[rows[first]]), {arm: v[first] for arm, v in some.items()}
            lost[rows] |= ~free
        out[samples.move[lost]] = True
        bad = np.unique(np.clip(np.searchsorted(self.rows, np.flatnonzero(out)) - 1, 0, len(self.time) - 1))
        for k in bad.tolist():
            self._leave_out(k, int(states[k]), int(states[k + 1]))
        return len(bad) > 0


def _thinned(states: IndexArray) -> IndexArray:
    if len(states) <= MOST_STATES:
        return states
    return states[np.linspace(0, len(states) - 1, MOST_STATES).round().astype(np.intp)]


def _blocked(
    scene: Scene,
    targets: Targets,
    coordinates: Coordinates,
    plan: list[Level],
    hit: tuple[int, dict[str, FloatArray]] | None,
    closed: list[int],
) -> tuple[Grid, Blocked]:
    """What is known of a job without a path, over samples of all levels at all targets."""
    samples = np.concatenate([level.samples for level in plan])
    count = max(1, min(len(samples), MOST_DIAGNOSED // targets.count))
    samples = samples[np.linspace(0, len(samples) - 1, count).round().astype(np.intp)]
    rows = np.repeat(np.arange(targets.count)[:, None], count, axis=1)
    values = coordinates.values(np.broadcast_to(samples, (targets.count, *samples.shape)), rows)
    grid = Grid(values, np.zeros((0, count), dtype=np.intp))
    table: dict[str, Reach] = reach(scene, targets, grid)
    common = 0
    for branches in itertools.product(*(r.branches for r in table.values())):
        rungs = [r.branches[b] for r, b in zip(table.values(), branches, strict=True)]
        both = np.logical_and.reduce([r.ok.any(axis=-1) for r in rungs]).any(axis=1)
        common = max(common, targets.count if both.all() else int(np.argmin(both)))
    if common == targets.count:
        for index in closed[::-1]:
            dead = _dead(scene, targets, grid, table, index)
            if dead is not None:
                return grid, Blocked(table, common, dead, hit)
    if common == targets.count and hit is None:
        common = targets.count - 1
    return grid, Blocked(table, common, hit=hit)


def _dead(scene: Scene, targets: Targets, grid: Grid, table: Mapping[str, Reach], index: int) -> Dead | None:
    """A target that is not free with any of the samples and any branches; None if it is."""
    most, tried = None, []
    for branches in itertools.product(*(r.branches for r in table.values())):
        rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
        able = np.logical_and.reduce([r.ok[index].any(axis=-1) for r in rungs.values()])
        samples = np.flatnonzero(able)
        q = {arm: r.q[index, samples] for arm, r in rungs.items()}
        if scene.free(targets, q, np.full(len(samples), index)).any():
            return None
        tried.append(branches)
        if most is None or able.sum() > most[1].sum():
            most = rungs, able
    if most is None or not most[1].any():
        return None
    none = np.zeros(grid.samples, dtype=bool)
    rungs, able = most
    return Dead(index, rungs, grid, able, none, None, frozenset(tried), 0)
