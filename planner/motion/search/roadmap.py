"""Path search over many freedoms, from coarse to fine.

It is used where a layered graph over all samples would be too large.

At some of the targets, the layers, all samples that every arm can reach are known. Dynamic programming finds
the shortest path from layer to layer, with any sample after any other. Its postures are checked for
collisions, then the targets and moves between its layers. What fails is removed, and the path is searched
again.
"""

import dataclasses
import itertools
from collections import Counter
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import FloatArray, IndexArray
from planner.motion.homing import are_ends_free
from planner.motion.planning_scene import FULL_TURN_RAD, MovePositions, Scene
from planner.motion.search.layered_graph import (
    MAX_JOINT_STEP_RAD,
    TIE_BREAK_WEIGHT,
    TURN_CODE_BASE,
    GraphPath,
    TurnPenalties,
)
from planner.motion.search.layered_graph_search import BlockedSearch, DeadEnd, PathResult, speed_limits
from planner.motion.search.reach import ArmReach, BranchStates, SampleGrid, compute_reach, states_on_branches
from planner.motion.search.subsampling import (
    FreedomCoordinates,
    SamplingLevel,
    sampling_levels,
    select_targets,
)
from planner.motion.trajectory.joint_path import sample_moves
from planner.targets import Targets

LAYER_COUNTS: Final = (48, 96)
"""Approximate numbers of layers. The larger one is used if the smaller one has no path."""

MAX_LAYERS: Final = 300
"""Maximum number of layers. If more targets are stops, only some of them become layers."""

MAX_ROUNDS: Final = 80
"""Maximum number of paths that are checked for collisions and moves."""
MAX_NEAR_ROUNDS: Final = 20
"""Maximum number of paths near a reference path that are checked."""
MAX_BRANCH_CHOICES: Final = 6
"""Maximum number of branch combinations that are checked on each level."""

MAX_DOUBTS: Final = 3
"""Number of collisions at a target between layers after which all of its samples are checked."""

MAX_LAYER_STATES: Final = 400
"""Maximum number of states of a layer, evenly spread."""
MAX_KEPT_STEPS: Final = 10_000_000
"""Maximum number of steps of the best branch combination up to which it is kept while others are examined:
120 MB.
"""
_MAX_CHANGE_WITHOUT_TURN_RAD: Final = 3.0
"""Joint change [rad] up to which no whole turn is involved."""
MAX_DIAGNOSED_STATES: Final = 120_000
"""Maximum number of states that are examined to explain why there is no path."""


def search_roadmap(scene: Scene, targets: Targets) -> tuple[SampleGrid, PathResult | BlockedSearch]:
    """Search a path over branches and samples of many freedoms, starting with few freedoms.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.

    Returns:
        The samples, and a path that keeps clearance at and between targets or the reasons why there is none.
    """
    coordinates = FreedomCoordinates(targets)
    all_levels = sampling_levels(targets, coordinates)
    collision: tuple[int, dict[str, FloatArray]] | None = None
    checks = 0
    in_reach = list(all_levels)
    blocked_targets: list[int] = []
    for layer_count, check_ends in [*((count, True) for count in LAYER_COUNTS), (LAYER_COUNTS[0], False)]:
        layers = _RoadmapLayers(_layer_rows(targets, layer_count), check_ends)
        for level in list(in_reach):
            attempt = _RoadmapSearch(scene, targets, coordinates, level, layers, blocked_targets)
            result = attempt.run()
            checks += attempt.checks
            if result is not None:
                return _path_grid(result), dataclasses.replace(result, checks=checks)
            collision = attempt.collision or collision
            if not attempt.in_reach:
                in_reach.remove(level)
    return _diagnose(scene, targets, coordinates, all_levels, collision, blocked_targets)


def search_near_samples(
    scene: Scene, targets: Targets, samples: FloatArray, branch: Mapping[str, int]
) -> tuple[SampleGrid, PathResult] | None:
    """Search a path on given branches near given samples.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        samples: (S, F) coordinates of all freedoms.
        branch: {arm: branch}.

    Returns:
        The samples and a path that keeps clearance at and between targets; None if there is none.
    """
    coordinates = FreedomCoordinates(targets)
    level = SamplingLevel(tuple(f.name for f in targets.freedoms), samples)
    layers = _RoadmapLayers(_layer_rows(targets, LAYER_COUNTS[0]), check_ends=not targets.coupled)
    attempt = _RoadmapSearch(scene, targets, coordinates, level, layers, [])
    result = attempt.run_on_branch(branch)
    return None if result is None else (_path_grid(result), result)


def _path_grid(result: PathResult) -> SampleGrid:
    """The one sample of each target that a path uses."""
    return SampleGrid(result.values[:, None], np.zeros((0, 1), dtype=np.intp))


def _layer_rows(targets: Targets, count: int) -> IndexArray:
    """Targets that become layers: evenly spread ones, the ends, stops and segment changes."""
    rows = set(np.linspace(0, targets.count - 1, min(count, targets.count)).round().astype(int).tolist())
    rows |= set(np.flatnonzero(targets.stop).tolist())
    rows |= {i for i in range(1, targets.count) if targets.segment[i] != targets.segment[i - 1]}
    out = np.array(sorted(rows), dtype=np.intp)
    if len(out) <= MAX_LAYERS:
        return out
    return out[np.linspace(0, len(out) - 1, MAX_LAYERS).round().astype(np.intp)]


@dataclasses.dataclass(frozen=True)
class _RoadmapLayers:
    """Layers of a roadmap.

    Attributes:
        rows: (L,) targets that become layers, in order.
        check_ends: Whether the arms must be able to reach the first and the last layer one after the other.
    """

    rows: IndexArray
    check_ends: bool


class _RoadmapSearch:
    """Search on one sampling level over one set of layers."""

    def __init__(
        self,
        scene: Scene,
        targets: Targets,
        coordinates: FreedomCoordinates,
        level: SamplingLevel,
        layers: _RoadmapLayers,
        blocked_targets: list[int],
    ) -> None:
        """Prepare the search.

        Args:
            scene: Cell with the stock in its pose.
            targets: N targets.
            coordinates: Converts samples to values of the freedoms.
            level: Freedoms that are sampled, and their samples.
            layers: Layers of the roadmap.
            blocked_targets: Targets that ended other searches, latest last. The target that ends this search
                is added.
        """
        self.check_ends = layers.check_ends
        self.scene, self.targets, self.coordinates, self.rows = scene, targets, coordinates, layers.rows
        self.samples, self.names = level.samples, level.names
        self.collision: tuple[int, dict[str, FloatArray]] | None = None
        self.checks = 0
        self.in_reach = False
        self._blocked_targets = blocked_targets

    def is_blocked(self, branch: Mapping[str, int], target: int) -> bool:
        """Whether no sample of the level is free at a target. Later searches then check that target first."""
        index = np.full(len(self.samples), target)
        values = self.coordinates.values(self.samples, index)
        poses = self.scene.tcp_poses(self.targets, values, index)
        ok, q = np.ones(len(index), dtype=bool), {}
        for arm, pose in poses.items():
            chain = self.scene.chains[arm]
            q[arm] = chain.inverse(pose, [branch[arm]], self.targets.last_joint_angle(arm, values))[:, 0]
            ok &= chain.best_limit_margin(q[arm]) >= self.scene.settings.joint_margin
            ok &= chain.singularity_margin(q[arm]) >= self.scene.settings.singularity_margin
        allowed = np.flatnonzero(ok)
        self.checks += len(allowed)
        joints = {arm: v[allowed] for arm, v in q.items()}
        if len(allowed) and self.scene.keeps_clearance(self.targets, joints, index[allowed]).any():
            return False
        if target in self._blocked_targets:
            self._blocked_targets.remove(target)
        self._blocked_targets.append(target)
        return True

    def run(self) -> PathResult | None:
        """Find a path, or None. ``collision`` then holds a collision that blocked paths, if there was one."""
        layer_targets, grid = self._layer_grid()
        table = compute_reach(self.scene, layer_targets, grid)
        offers: list[tuple[float, int, dict[str, BranchStates]]] = []
        for branches in itertools.product(*(r.branches for r in table.values())):
            rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
            cost = sum(r.penalty.min(axis=-1) for r in rungs.values())
            if np.isfinite(cost).any(axis=1).all():
                offers.append((float(np.min(cost, axis=1).sum()), len(offers), rungs))
        self.in_reach = bool(offers)
        offers.sort(key=lambda offer: offer[:2])
        graph_costs: list[tuple[float, int, dict[str, BranchStates]]] = []
        best: dict[int, _RoadmapGraph] = {}
        for _, _, rungs in offers[:MAX_BRANCH_CHOICES]:
            graph = _RoadmapGraph(self, rungs)
            result = graph.shortest_path()
            if result is not None:
                if all(result[1] < cost for cost, _, _ in graph_costs):
                    best = {len(graph_costs): graph} if graph.step_count <= MAX_KEPT_STEPS else {}
                graph_costs.append((result[1], len(graph_costs), rungs))
            del graph
        for _, number, rungs in sorted(graph_costs, key=lambda offer: offer[:2]):
            branch = {arm: r.branch for arm, r in rungs.items()}
            if any(self.is_blocked(branch, i) for i in self._blocked_targets[::-1]):
                continue
            # all graphs at once would fill the memory, so those except the best are built again
            path = (best.pop(number, None) or _RoadmapGraph(self, rungs)).find_free_path(MAX_ROUNDS)
            if path is not None:
                return dataclasses.replace(path, choices=len(offers))
        return None

    def run_on_branch(self, branch: Mapping[str, int]) -> PathResult | None:
        """Find a path on one branch of each arm, or None, with fewer rounds."""
        rungs = states_on_branches(self.scene, *self._layer_grid(), branch)
        return None if rungs is None else _RoadmapGraph(self, rungs).find_free_path(MAX_NEAR_ROUNDS)

    def _layer_grid(self) -> tuple[Targets, SampleGrid]:
        """The targets that are layers, with all samples of the level."""
        count = len(self.samples)
        every = np.repeat(self.rows[:, None], count, axis=1)
        values = self.coordinates.values(
            np.broadcast_to(self.samples, (len(self.rows), *self.samples.shape)), every
        )
        return select_targets(self.targets, self.rows), SampleGrid(
            values, np.zeros((0, count), dtype=np.intp)
        )


class _BestPaths:
    """Best paths to all states of the first layers.

    Attributes:
        rows: For each layer the cost (S,) [s] and the turns {arm: (S,)} of each state.
        predecessors: For each later layer the state (S,) of the previous layer that each state comes from.
        is_dead_end: Whether no state of the layer after the last row can be reached.
    """

    def __init__(self) -> None:
        self.rows: list[tuple[FloatArray, dict[str, IndexArray]]] = []
        self.predecessors: list[IndexArray] = []
        self.is_dead_end = False

    def extend(self, predecessor: IndexArray, cost: FloatArray, turn: dict[str, IndexArray]) -> None:
        """Add paths to the next layer."""
        self.is_dead_end = not np.isfinite(cost).any()
        if not self.is_dead_end:
            self.rows.append((cost, turn))
            self.predecessors.append(predecessor)

    def discard_from(self, k: int) -> None:
        """Discard layer k and all later ones, because layer k is reached differently."""
        if k <= len(self.rows):
            self.is_dead_end = False
            del self.rows[k:], self.predecessors[max(k - 1, 0) :]


class _RoadmapGraph:
    """States of one branch combination at every layer, and the cost of steps between adjacent layers."""

    def __init__(self, attempt: _RoadmapSearch, layer_states: Mapping[str, BranchStates]) -> None:
        self.attempt, self.layer_states = attempt, layer_states
        self.scene, self.targets, self.rows = attempt.scene, attempt.targets, attempt.rows
        self.branch = {arm: r.branch for arm, r in layer_states.items()}
        cost = sum(r.penalty.min(axis=-1) for r in layer_states.values())
        good = np.isfinite(cost)
        self.states = [_subsample(np.flatnonzero(g)) for g in good]
        self.q = {arm: [r.q[k, s] for k, s in enumerate(self.states)] for arm, r in layer_states.items()}
        self.blocked = [np.zeros(len(s), dtype=bool) for s in self.states]
        self.known = [np.zeros(len(s), dtype=bool) for s in self.states]
        self.tables = {arm: TurnPenalties(r, self.states) for arm, r in layer_states.items()}
        self.time: list[NDArray[np.float32]] = []
        self.code: dict[str, list[NDArray[np.int32] | None]] = {arm: [] for arm in layer_states}
        self._best_paths: dict[int, _BestPaths] = {}
        self.doubts: Counter[int] = Counter()
        self.fine: dict[tuple[int, int, int], dict[str, FloatArray]] = {}
        for k in range(len(self.rows) - 1):
            self._add_step_times(k)

    def _add_step_times(self, k: int) -> None:
        """Add the duration (A, B) from every state of layer k to every one of the next.

        It is inf where a joint moves too far.
        """
        slowest = np.zeros((len(self.states[k]), len(self.states[k + 1])), dtype=np.float32)
        total, change = np.zeros_like(slowest), np.empty_like(slowest)
        max_change = MAX_JOINT_STEP_RAD * max(1.0, 0.5 * float(self.rows[k + 1] - self.rows[k]))
        is_forbidden = np.zeros(slowest.shape, dtype=bool)
        for arm, q in self.q.items():
            has_many_turns = self.scene.chains[arm].has_many_turns
            speed = speed_limits(self.scene, arm).astype(np.float32)
            previous_joints, next_joints = np.asfortranarray(q[k]), np.asfortranarray(q[k + 1])
            ends = (
                next_joints.max(axis=0) - previous_joints.min(axis=0),
                previous_joints.max(axis=0) - next_joints.min(axis=0),
            )
            largest_change = np.maximum(*ends).astype(np.float32)  # largest change of each joint
            code = np.zeros(
                slowest.shape if (largest_change > _MAX_CHANGE_WITHOUT_TURN_RAD)[has_many_turns].any() else 0,
                dtype=np.int32,
            )
            for j in range(len(has_many_turns)):
                np.subtract(
                    next_joints[None, :, j], previous_joints[:, None, j], out=change, casting="same_kind"
                )
                if has_many_turns[j] and largest_change[j] > _MAX_CHANGE_WITHOUT_TURN_RAD:
                    whole = np.round(change / FULL_TURN_RAD)
                    change -= FULL_TURN_RAD * whole
                    code += (TURN_CODE_BASE**j * whole).astype(np.int32)
                np.abs(change, out=change)
                if largest_change[j] > max_change:
                    is_forbidden |= change > max_change
                change /= speed[j]
                np.maximum(slowest, change, out=slowest)
                total += change
            self.code[arm].append(code if code.any() else None)
        total *= np.float32(TIE_BREAK_WEIGHT)
        slowest += total
        slowest[is_forbidden] = np.inf
        self.time.append(slowest)

    @property
    def step_count(self) -> int:
        """Number of steps between states of adjacent layers."""
        return sum(time.size for time in self.time)

    def shortest_path(self) -> tuple[IndexArray, float] | None:
        """States (K,) of the path of least cost, and that cost; or None.

        Every state keeps the turns of the path that reaches it best. Other turns at the start are tried if
        there is no path.
        """
        starts = [t.start_codes() for t in self.tables.values()]
        for number, codes in enumerate(itertools.islice(itertools.product(*starts), 12)):
            result = self._forward(number, dict(zip(self.tables, codes, strict=True)))
            if result is not None:
                return result
        return None

    def _forward(self, number: int, start: Mapping[str, IndexArray]) -> tuple[IndexArray, float] | None:
        """Find the path from the turns ``start``, continuing what is already known of it."""
        best_paths = self._best_paths.setdefault(number, _BestPaths())
        if not best_paths.rows:
            cost = np.where(self.blocked[0], np.inf, 0.0)
            for arm, t in self.tables.items():
                cost = cost + t.penalty(0, start[arm])
            best_paths.rows.append((cost, dict(start)))
        while not best_paths.is_dead_end and len(best_paths.rows) <= len(self.time):
            best_paths.extend(*self._relax(len(best_paths.rows) - 1, *best_paths.rows[-1]))
        cost, turn = best_paths.rows[-1]
        if best_paths.is_dead_end or not np.isfinite(cost).any():
            return None
        states = np.empty(len(self.rows), dtype=np.intp)
        states[-1] = int(np.argmin(cost))
        self._last_turns = {arm: int(c[states[-1]]) for arm, c in turn.items()}
        for k in range(len(best_paths.predecessors) - 1, -1, -1):
            states[k] = best_paths.predecessors[k][states[k + 1]]
        return states, float(cost.min())

    def _relax(
        self, k: int, cost: FloatArray, turn: Mapping[str, IndexArray]
    ) -> tuple[IndexArray, FloatArray, dict[str, IndexArray]]:
        """Best predecessor in layer k of each state of the next layer, with its cost and turns."""
        offers = cost[:, None] + self.time[k]
        new = {}
        for arm, t in self.tables.items():
            step = self.code[arm][k]
            if step is None:  # no joint changes its turn: few turns, each for all states of the next layer
                codes, which = np.unique(turn[arm], return_inverse=True)
                every = np.broadcast_to(codes[:, None], (len(codes), offers.shape[1]))
                offers += t.penalty(k + 1, every)[which]
            else:
                new[arm] = turn[arm][:, None] - step
                offers += t.penalty(k + 1, new[arm])
        offers[:, self.blocked[k + 1]] = np.inf
        predecessor = np.argmin(offers, axis=0)
        columns = np.arange(offers.shape[1])
        turns_after = {
            arm: new[arm][predecessor, columns] if arm in new else c[predecessor] for arm, c in turn.items()
        }
        return predecessor, offers[predecessor, columns], turns_after

    def _discard_from(self, k: int) -> None:
        """Discard known paths to layer k and beyond."""
        for known in self._best_paths.values():
            known.discard_from(k)

    def find_free_path(self, rounds: int) -> PathResult | None:
        """Find the shortest path that keeps margins and clearance everywhere, or None."""
        for count in range(rounds):
            result = self.shortest_path()
            if result is None or self._is_blocked():
                return None
            states, cost = result
            if self._block_states(states) or self._block_edges(states):
                continue
            path = self._assemble_path(states, cost, count + 1)
            if self._block_moves(states, path):
                continue
            return path
        return None

    def _is_blocked(self) -> bool:
        """Whether a target that collided often collides with all samples."""
        often = [i for i, count in self.doubts.items() if count >= MAX_DOUBTS]
        for i in often:
            self.doubts[i] = -MAX_ROUNDS  # check it only once
        return any(self.attempt.is_blocked(self.branch, i) for i in often)

    def _block_states(self, states: IndexArray) -> bool:
        """Check the states of the path; where some collide, check all states of their layers together."""
        hits = self._check_states(np.arange(len(states)), states)
        if hits:
            unknown_states = [np.flatnonzero(~self.known[k]) for k in hits]
            self._check_states(
                np.repeat(hits, [len(unknown) for unknown in unknown_states]), np.concatenate(unknown_states)
            )
        for k in hits:
            if self.blocked[k].all():
                self.attempt.is_blocked(self.branch, int(self.rows[k]))
        return len(hits) > 0

    def _check_states(self, rung: IndexArray, state: IndexArray) -> list[int]:
        new = np.array([not self.known[k][s] for k, s in zip(rung, state, strict=True)], dtype=bool)
        rung, state = rung[new], state[new]
        if len(rung) == 0:
            return []
        q = {arm: np.array([a[k][s] for k, s in zip(rung, state, strict=True)]) for arm, a in self.q.items()}
        free = self.scene.keeps_clearance(self.targets, q, self.rows[rung])
        self.attempt.checks += len(rung)
        hits = np.flatnonzero(~free)
        if self.attempt.check_ends:
            last = np.flatnonzero(free & ((rung == 0) | (rung == len(self.rows) - 1)))
            if len(last):
                free[last] = are_ends_free(self.scene, {arm: v[last] for arm, v in q.items()})
        for k, s, ok in zip(rung, state, free, strict=True):
            self.known[k][s], self.blocked[k][s] = True, not ok
        for k in np.unique(rung[~free]).tolist():
            self._discard_from(k)
        if len(hits):
            first = int(hits[0])
            self.attempt.collision = int(self.rows[rung[first]]), {arm: v[first] for arm, v in q.items()}
        return [int(k) for k in rung[~free]]

    def _edge_coordinates(self, k: int, states: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Coordinates at layer k and, by the shortest change, at the next layer."""
        samples, c = self.attempt.samples, self.attempt.coordinates
        start = samples[self.states[k][states[k]]]
        return start, start + c.shortest_change(start, samples[self.states[k + 1][states[k + 1]]])

    def _block_edges(self, states: IndexArray) -> bool:
        """Check the targets between the path's layers, and forbid the steps that fail."""
        steps = [k for k in range(len(states) - 1) if (k, states[k], states[k + 1]) not in self.fine]
        rows, owner, coordinates = [], [], []
        for k in steps:
            inner = np.arange(self.rows[k] + 1, self.rows[k + 1])
            start, end = self._edge_coordinates(k, states)
            fraction = (inner - self.rows[k]) / (self.rows[k + 1] - self.rows[k])
            rows.append(inner)
            owner.append(np.full(len(inner), k))
            coordinates.append(start + fraction[:, None] * (end - start))
        if not steps:
            return False
        all_rows, all_owners = np.concatenate(rows), np.concatenate(owner)
        values = self.attempt.coordinates.values(np.concatenate(coordinates), all_rows)
        poses = self.scene.tcp_poses(self.targets, values, all_rows)
        ok, q = np.ones(len(all_rows), dtype=bool), {}
        for arm, pose in poses.items():
            chain = self.scene.chains[arm]
            q[arm] = chain.inverse(pose, [self.branch[arm]], self.targets.last_joint_angle(arm, values))[:, 0]
            best = chain.best_limit_margin(q[arm])
            ok &= best >= self.scene.settings.joint_margin
            ok &= chain.singularity_margin(q[arm]) >= self.scene.settings.singularity_margin
        good = np.flatnonzero(ok)
        if len(good):
            free = self.scene.keeps_clearance(
                self.targets, {arm: v[good] for arm, v in q.items()}, all_rows[good]
            )
            self.attempt.checks += len(good)
            if not free.all():
                first = good[int(np.argmin(free))]
                self.attempt.collision = int(all_rows[first]), {arm: v[first] for arm, v in q.items()}
                self.doubts.update(all_rows[good[~free]].tolist())
            ok[good] = free
        lost_layers = set(all_owners[~ok].tolist())
        for k in steps:
            key = (k, int(states[k]), int(states[k + 1]))
            if k in lost_layers:
                self._forbid_step(*key)
            else:
                self.fine[key] = {arm: v[all_owners == k] for arm, v in q.items()}
        return bool(lost_layers)

    def _forbid_step(self, k: int, state: int, next_state: int) -> None:
        """Forbid the step from this state of layer k to that state of the next layer."""
        self.time[k][state, next_state] = np.inf
        self._discard_from(k + 1)

    def _assemble_path(self, states: IndexArray, cost: float, rounds: int) -> PathResult:
        """The path at all targets, including turns."""
        coordinates = np.empty((self.targets.count, self.attempt.samples.shape[1]))
        q = {
            arm: np.empty((self.targets.count, layer_joints[0].shape[1]))
            for arm, layer_joints in self.q.items()
        }
        current = self.attempt.samples[self.states[0][states[0]]]
        for k in range(len(self.rows)):
            coordinates[self.rows[k]] = current
            for arm in self.layer_states:
                q[arm][self.rows[k]] = self.q[arm][k][states[k]]
            if k + 1 < len(self.rows):
                start, end = self._edge_coordinates(k, states)
                inner = np.arange(self.rows[k] + 1, self.rows[k + 1])
                fraction = (inner - self.rows[k]) / (self.rows[k + 1] - self.rows[k])
                coordinates[inner] = current + fraction[:, None] * (end - start)
                current = current + (end - start)
                fine = self.fine[k, int(states[k]), int(states[k + 1])]
                for arm in self.layer_states:
                    q[arm][inner] = fine[arm]
        for arm, angles in q.items():
            chain, last = self.scene.chains[arm], self.tables[arm].turn_of(self._last_turns[arm])
            change = np.diff(angles, axis=0)
            change -= np.where(chain.has_many_turns, FULL_TURN_RAD * np.round(change / FULL_TURN_RAD), 0.0)
            back = np.cumsum(change[::-1], axis=0)[::-1]
            q[arm] = np.concatenate([angles[-1] + last - back, (angles[-1] + last)[None]])
        values = self.attempt.coordinates.values(coordinates, np.arange(self.targets.count))
        path = GraphPath(self.branch, np.zeros(self.targets.count, dtype=np.intp), {}, cost)
        return PathResult(path, values, q, 1, self.attempt.checks, rounds)

    def _block_moves(self, states: IndexArray, path: PathResult) -> bool:
        """Check the whole path, including turns and linear moves between targets."""
        out = np.zeros(self.targets.count, dtype=bool)
        for arm, angles in path.q.items():
            out |= self.scene.chains[arm].limit_margin(angles) < self.scene.settings.joint_margin
            out[1:] |= (np.abs(np.diff(angles, axis=0)) > MAX_JOINT_STEP_RAD).any(axis=1)
        samples = sample_moves(self.scene, self.targets, self.branch, path.q)
        lost = np.isnan(np.concatenate(list(samples.q.values()), axis=1)).any(axis=1)
        rows = np.flatnonzero(~lost & (samples.fraction < 1.0))
        if len(rows):
            nearest = np.where(samples.fraction >= 0.5, samples.move, samples.move - 1)[rows]
            joints = {arm: v[rows] for arm, v in samples.q.items()}
            positions = MovePositions(samples.move[rows], samples.fraction[rows])
            free = self.scene.keeps_clearance(self.targets, joints, np.maximum(nearest, 0), positions)
            self.attempt.checks += len(rows)
            if not free.all():
                first = int(np.argmin(free))
                self.attempt.collision = (
                    int(samples.move[rows[first]]),
                    {arm: v[first] for arm, v in joints.items()},
                )
            lost[rows] |= ~free
        out[samples.move[lost]] = True
        failed_layers = np.unique(
            np.clip(np.searchsorted(self.rows, np.flatnonzero(out)) - 1, 0, len(self.time) - 1)
        )
        for k in failed_layers.tolist():
            self._forbid_step(k, int(states[k]), int(states[k + 1]))
        return len(failed_layers) > 0


def _subsample(states: IndexArray) -> IndexArray:
    if len(states) <= MAX_LAYER_STATES:
        return states
    return states[np.linspace(0, len(states) - 1, MAX_LAYER_STATES).round().astype(np.intp)]


def _diagnose(
    scene: Scene,
    targets: Targets,
    coordinates: FreedomCoordinates,
    all_levels: list[SamplingLevel],
    collision: tuple[int, dict[str, FloatArray]] | None,
    blocked_targets: list[int],
) -> tuple[SampleGrid, BlockedSearch]:
    """Diagnose a job without a path, over samples of all levels at all targets."""
    samples = np.concatenate([level.samples for level in all_levels])
    count = max(1, min(len(samples), MAX_DIAGNOSED_STATES // targets.count))
    samples = samples[np.linspace(0, len(samples) - 1, count).round().astype(np.intp)]
    rows = np.repeat(np.arange(targets.count)[:, None], count, axis=1)
    values = coordinates.values(np.broadcast_to(samples, (targets.count, *samples.shape)), rows)
    grid = SampleGrid(values, np.zeros((0, count), dtype=np.intp))
    table: dict[str, ArmReach] = compute_reach(scene, targets, grid)
    common = 0
    for branches in itertools.product(*(r.branches for r in table.values())):
        rungs = [r.branches[b] for r, b in zip(table.values(), branches, strict=True)]
        both = np.logical_and.reduce([r.ok.any(axis=-1) for r in rungs]).any(axis=1)
        common = max(common, targets.count if both.all() else int(np.argmin(both)))
    if common == targets.count:
        for index in blocked_targets[::-1]:
            dead = _find_dead_end(scene, targets, grid, table, index)
            if dead is not None:
                return grid, BlockedSearch(table, common, dead, collision)
    if common == targets.count and collision is None:
        common = targets.count - 1
    return grid, BlockedSearch(table, common, collision=collision)


def _find_dead_end(
    scene: Scene, targets: Targets, grid: SampleGrid, table: Mapping[str, ArmReach], index: int
) -> DeadEnd | None:
    """A target that is not free with any sample and branches; None if it is."""
    best_combination, tried = None, []
    for branches in itertools.product(*(r.branches for r in table.values())):
        rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
        is_possible = np.logical_and.reduce([r.ok[index].any(axis=-1) for r in rungs.values()])
        samples = np.flatnonzero(is_possible)
        q = {arm: r.q[index, samples] for arm, r in rungs.items()}
        if scene.keeps_clearance(targets, q, np.full(len(samples), index)).any():
            return None
        tried.append(branches)
        if best_combination is None or is_possible.sum() > best_combination[1].sum():
            best_combination = rungs, is_possible
    if best_combination is None or not best_combination[1].any():
        return None
    no_samples = np.zeros(grid.samples, dtype=bool)
    rungs, is_possible = best_combination
    return DeadEnd(index, rungs, grid, is_possible, no_samples, None, frozenset(tried), 0)
