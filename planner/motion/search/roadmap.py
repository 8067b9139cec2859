"""Path search over many freedoms, from coarse to fine.

It is used where a layered graph over all samples would be too large.

Some of the targets are layers. At each layer, all samples that every arm can reach are computed. Dynamic
programming finds the shortest path from layer to layer, on which any sample may follow any other. The
postures of the path are checked for collisions, then the targets and the moves between its layers. States and
steps that fail are forbidden, and the path is searched again.
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
"""Maximum number of states of a layer. If there are more, evenly spread ones are used."""
MAX_KEPT_STEPS: Final = 10_000_000
"""Maximum number of steps of a graph (120 MB) that is kept in memory while other branch combinations are
examined. Larger graphs are built again.
"""
_MAX_CHANGE_WITHOUT_TURN_RAD: Final = 3.0
"""Joint change [rad] up to which a step involves no whole turn; slightly less than half a turn."""
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
    reachable_levels = list(all_levels)
    blocked_targets: list[int] = []
    # The ends are checked first. Without a path, the smaller number of layers is searched without that check.
    for layer_count, check_ends in [*((count, True) for count in LAYER_COUNTS), (LAYER_COUNTS[0], False)]:
        layers = _RoadmapLayers(_layer_rows(targets, layer_count), check_ends)
        for level in list(reachable_levels):
            search = _RoadmapSearch(scene, targets, coordinates, level, layers, blocked_targets)
            result = search.run()
            checks += search.checks
            if result is not None:
                return _path_grid(result), dataclasses.replace(result, checks=checks)
            collision = search.collision or collision
            if not search.in_reach:
                reachable_levels.remove(level)
    return _diagnose(scene, targets, coordinates, all_levels, collision, blocked_targets)


def search_near_samples(
    scene: Scene, targets: Targets, samples: FloatArray, branch: Mapping[str, int]
) -> tuple[SampleGrid, PathResult] | None:
    """Search a path on given branches near given samples, to start from the path of a reference plan.

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
    search = _RoadmapSearch(scene, targets, coordinates, level, layers, blocked_targets=[])
    result = search.run_on_branch(branch)
    return None if result is None else (_path_grid(result), result)


def _path_grid(result: PathResult) -> SampleGrid:
    """Return a grid with one sample of each target: the one that a path uses.

    The grid has no steps between samples. It replaces the grid of a search in the planner's result.
    """
    return SampleGrid(result.values[:, None], np.zeros((0, 1), dtype=np.intp))


def _layer_rows(targets: Targets, count: int) -> IndexArray:
    """Choose the targets (L,) that become layers: evenly spread ones, the ends, stops and segment changes.

    ``count`` is the number of evenly spread ones. If there are more than :data:`MAX_LAYERS`, only some are
    used.
    """
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
        check_ends: Whether postures of the first and the last layer must be free with other arms at home, so
            that the arms can reach them one after the other (:func:`are_ends_free`).
    """

    rows: IndexArray
    check_ends: bool


class _RoadmapSearch:
    """Search on one sampling level over one set of layers.

    Attributes:
        collision: A collision that blocked paths: index of the target, and joints {arm: (6,)}; None if none.
        checks: Number of postures that were checked for collisions.
        in_reach: Whether a branch combination has a sample at every layer that all arms can take.
    """

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
        """Whether no sample of the level is free at a target, on given branches.

        All samples within the margins are checked for clearance. If none is free, the target becomes the last
        of the blocked targets, so that later searches check it first.
        """
        index = np.full(len(self.samples), target)
        values = self.coordinates.values(self.samples, index)
        poses = self.scene.tcp_poses(self.targets, values, index)
        is_allowed, q = np.ones(len(index), dtype=bool), {}
        for arm, pose in poses.items():
            chain = self.scene.chains[arm]
            q[arm] = chain.inverse(pose, [branch[arm]], self.targets.last_joint_angle(arm, values))[:, 0]
            is_allowed &= chain.best_limit_margin(q[arm]) >= self.scene.settings.joint_margin
            is_allowed &= chain.singularity_margin(q[arm]) >= self.scene.settings.singularity_margin
        allowed = np.flatnonzero(is_allowed)
        self.checks += len(allowed)
        joints = {arm: v[allowed] for arm, v in q.items()}
        if len(allowed) and self.scene.keeps_clearance(self.targets, joints, index[allowed]).any():
            return False
        if target in self._blocked_targets:
            self._blocked_targets.remove(target)
        self._blocked_targets.append(target)
        return True

    def run(self) -> PathResult | None:
        """Find a path over the best branch combinations, or return None.

        Without a path, :attr:`collision` holds a collision that blocked paths, if any did.
        """
        # Rank the branch combinations by their penalties, then the best of them by the cost of their paths.
        layer_targets, grid = self._layer_grid()
        reach = compute_reach(self.scene, layer_targets, grid)
        choices: list[tuple[float, int, dict[str, BranchStates]]] = []
        for branches in itertools.product(*(r.branches for r in reach.values())):
            states = {arm: r.branches[b] for (arm, r), b in zip(reach.items(), branches, strict=True)}
            cost = sum(r.penalty.min(axis=-1) for r in states.values())
            if np.isfinite(cost).any(axis=1).all():
                choices.append((float(np.min(cost, axis=1).sum()), len(choices), states))
        self.in_reach = bool(choices)
        choices.sort(key=lambda choice: choice[:2])
        choices_with_path: list[tuple[float, int, dict[str, BranchStates]]] = []
        best_graph: dict[int, _RoadmapGraph] = {}
        for _, _, states in choices[:MAX_BRANCH_CHOICES]:
            graph = _RoadmapGraph(self, states)
            result = graph.shortest_path()
            if result is not None:
                number = len(choices_with_path)
                if all(result[1] < cost for cost, _, _ in choices_with_path):
                    best_graph = {number: graph} if graph.step_count <= MAX_KEPT_STEPS else {}
                choices_with_path.append((result[1], number, states))
            del graph
        # Search free paths, cheapest first.
        for _, number, states in sorted(choices_with_path, key=lambda choice: choice[:2]):
            branch = {arm: r.branch for arm, r in states.items()}
            if any(self.is_blocked(branch, i) for i in self._blocked_targets[::-1]):
                continue
            # all graphs at once would fill the memory, so those except the best are built again
            path = (best_graph.pop(number, None) or _RoadmapGraph(self, states)).find_free_path(MAX_ROUNDS)
            if path is not None:
                return dataclasses.replace(path, choices=len(choices))
        return None

    def run_on_branch(self, branch: Mapping[str, int]) -> PathResult | None:
        """Find a path on one branch of each arm, or None, with fewer rounds."""
        states = states_on_branches(self.scene, *self._layer_grid(), branch)
        return None if states is None else _RoadmapGraph(self, states).find_free_path(MAX_NEAR_ROUNDS)

    def _layer_grid(self) -> tuple[Targets, SampleGrid]:
        """Return the targets that are layers, and a grid of all samples of the level.

        The grid has no kinds of step, because any sample of a layer may follow any other.
        """
        count = len(self.samples)
        rows = np.repeat(self.rows[:, None], count, axis=1)
        values = self.coordinates.values(
            np.broadcast_to(self.samples, (len(self.rows), *self.samples.shape)), rows
        )
        return select_targets(self.targets, self.rows), SampleGrid(
            values, np.zeros((0, count), dtype=np.intp)
        )


class _BestPaths:
    """Best paths from the first layer to all states of the layers up to some layer.

    Attributes:
        rows: For each of these layers the cost (S,) [s] and the codes of turns {arm: (S,)} of each state.
        predecessors: For each of these layers except the first, the state (S,) of the previous layer that
            each state comes from.
        is_dead_end: Whether no state of the next layer can be reached.
    """

    def __init__(self) -> None:
        self.rows: list[tuple[FloatArray, dict[str, IndexArray]]] = []
        self.predecessors: list[IndexArray] = []
        self.is_dead_end = False

    def extend(self, predecessor: IndexArray, cost: FloatArray, turn: dict[str, IndexArray]) -> None:
        """Add the best paths to the next layer: predecessor (S,), cost (S,) [s] and codes of turns (S,)."""
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
    """States of one branch combination at every layer, and the cost of steps between adjacent layers.

    A state of a layer is one of its samples that every arm can take. Lists have an entry for each layer, or
    for each step from a layer to the next.

    Attributes:
        states: Index (S,) of the sample of each state.
        q: {arm: joints (S, J) [rad] of each state}.
        blocked: Whether (S,) a state is forbidden.
        known: Whether (S,) a state has been checked.
        tables: {arm: penalties of the states by their whole turns}.
        time: Duration (A, B) [s] of the step from every state of a layer to every state of the next.
        code: {arm: code (A, B) of the whole turns by which the joints change on these steps, or None if none
            changes by a turn}.
        doubts: Number of collisions at each target between layers.
        fine: {(layer, state, state of the next layer): joints {arm: (K, J)} at the targets between them}, for
            steps that are free.
    """

    def __init__(self, search: _RoadmapSearch, layer_states: Mapping[str, BranchStates]) -> None:
        """Build the graph; ``layer_states`` are {arm: states on its branch at all layers and samples}."""
        self.search, self.layer_states = search, layer_states
        self.scene, self.targets, self.rows = search.scene, search.targets, search.rows
        self.branch = {arm: r.branch for arm, r in layer_states.items()}
        cost = sum(r.penalty.min(axis=-1) for r in layer_states.values())
        is_allowed = np.isfinite(cost)
        self.states = [_subsample(np.flatnonzero(allowed)) for allowed in is_allowed]
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
        """Add durations and changes of turns from every state of layer k to every state of the next.

        The duration of a step is that of its slowest joint at the speed limits, plus a small fraction of the
        durations of all joints, which breaks ties. It is inf where a joint moves too far. The changes of
        turns are the whole turns by which the angles of the two states differ, as codes of
        :class:`TurnPenalties`.
        """
        slowest = np.zeros((len(self.states[k]), len(self.states[k + 1])), dtype=np.float32)
        total, change = np.zeros_like(slowest), np.empty_like(slowest)
        # half a maximum step for each move between the layers; the moves themselves are checked later
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
                    whole_turns = np.round(change / FULL_TURN_RAD)
                    change -= FULL_TURN_RAD * whole_turns
                    code += (TURN_CODE_BASE**j * whole_turns).astype(np.int32)
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
        """Find the path of least cost: its state (L,) at each layer, and its cost [s]; or None.

        Every state keeps only the turns of the path that reaches it best, so a path may be missed. If there
        is no path, other turns at the first layer are tried, at most 12 combinations of the arms' turns.
        """
        starts = [t.start_codes() for t in self.tables.values()]
        for number, codes in enumerate(itertools.islice(itertools.product(*starts), 12)):
            result = self._forward(number, dict(zip(self.tables, codes, strict=True)))
            if result is not None:
                return result
        return None

    def _forward(self, number: int, start: Mapping[str, IndexArray]) -> tuple[IndexArray, float] | None:
        """Find the path of least cost that starts with given turns, as :meth:`shortest_path`.

        Best paths of an earlier call with the same ``number`` are continued, as far as they are still valid.

        Args:
            number: Number of the combination of turns at the first layer, under which best paths are kept.
            start: {arm: codes (S,) of the turns of the first layer's states}.
        """
        best_paths = self._best_paths.setdefault(number, _BestPaths())
        if not best_paths.rows:
            cost = np.where(self.blocked[0], np.inf, 0.0)
            for arm, table in self.tables.items():
                cost = cost + table.penalty(0, start[arm])
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
        """Extend best paths from layer k to the next layer.

        Args:
            k: Index of the layer.
            cost: (A,) [s] cost of the best paths to the states of layer k.
            turn: {arm: codes (A,) of the turns of these states}.

        Returns:
            For each of B states of the next layer the best predecessor (B,), the cost (B,) [s] and the codes
            of the turns {arm: (B,)}.
        """
        total_cost = cost[:, None] + self.time[k]
        next_codes = {}
        for arm, table in self.tables.items():
            step = self.code[arm][k]
            if step is None:  # no joint changes its turn: few turns, each for all states of the next layer
                codes, code_index = np.unique(turn[arm], return_inverse=True)
                codes_of_states = np.broadcast_to(codes[:, None], (len(codes), total_cost.shape[1]))
                total_cost += table.penalty(k + 1, codes_of_states)[code_index]
            else:
                # a joint whose angle jumps by whole turns has as many turns less, so that it is continuous
                next_codes[arm] = turn[arm][:, None] - step
                total_cost += table.penalty(k + 1, next_codes[arm])
        total_cost[:, self.blocked[k + 1]] = np.inf
        predecessor = np.argmin(total_cost, axis=0)
        columns = np.arange(total_cost.shape[1])
        next_turn = {
            arm: next_codes[arm][predecessor, columns] if arm in next_codes else c[predecessor]
            for arm, c in turn.items()
        }
        return predecessor, total_cost[predecessor, columns], next_turn

    def _discard_from(self, k: int) -> None:
        """Discard best paths to layer k and beyond, because states or steps there were forbidden."""
        for best_paths in self._best_paths.values():
            best_paths.discard_from(k)

    def find_free_path(self, rounds: int) -> PathResult | None:
        """Find the path of least cost that keeps margins and clearance everywhere, or None.

        At most ``rounds`` paths are checked. States and steps that fail are forbidden.
        """
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
        """Whether a target between layers that has collided several times is blocked for all samples.

        No path on these branches exists then. Each such target is checked only once.
        """
        doubtful_targets = [i for i, count in self.doubts.items() if count >= MAX_DOUBTS]
        for i in doubtful_targets:
            self.doubts[i] = -MAX_ROUNDS  # check it only once
        return any(self.search.is_blocked(self.branch, i) for i in doubtful_targets)

    def _block_states(self, states: IndexArray) -> bool:
        """Check the states (L,) of a path for collisions, and forbid those that collide.

        If some do, all states of their layers are checked together. Returns whether any state collides.
        """
        blocked_layers = self._check_states(np.arange(len(states)), states)
        if blocked_layers:
            unknown_states = [np.flatnonzero(~self.known[k]) for k in blocked_layers]
            self._check_states(
                np.repeat(blocked_layers, [len(unknown) for unknown in unknown_states]),
                np.concatenate(unknown_states),
            )
        for k in blocked_layers:
            # if all states collide, record the target so that other searches check it first
            if self.blocked[k].all():
                self.search.is_blocked(self.branch, int(self.rows[k]))
        return len(blocked_layers) > 0

    def _check_states(self, layer: IndexArray, state: IndexArray) -> list[int]:
        """Check the states (B,) of layers (B,) that have not been checked yet, and forbid the blocked ones.

        A state is blocked if it collides. If the ends are checked, a state of the first or the last layer is
        also blocked if the arms cannot reach it one after the other (:func:`are_ends_free`).

        Returns:
            The layers of the blocked states, one entry for each state.
        """
        is_new = np.array([not self.known[k][s] for k, s in zip(layer, state, strict=True)], dtype=bool)
        layer, state = layer[is_new], state[is_new]
        if len(layer) == 0:
            return []
        q = {
            arm: np.array([joints[k][s] for k, s in zip(layer, state, strict=True)])
            for arm, joints in self.q.items()
        }
        free = self.scene.keeps_clearance(self.targets, q, self.rows[layer])
        self.search.checks += len(layer)
        colliding = np.flatnonzero(~free)
        if self.search.check_ends:
            ends = np.flatnonzero(free & ((layer == 0) | (layer == len(self.rows) - 1)))
            if len(ends):
                free[ends] = are_ends_free(self.scene, {arm: v[ends] for arm, v in q.items()})
        for k, s, ok in zip(layer, state, free, strict=True):
            self.known[k][s], self.blocked[k][s] = True, not ok
        for k in np.unique(layer[~free]).tolist():
            self._discard_from(k)
        if len(colliding):
            first = int(colliding[0])
            self.search.collision = int(self.rows[layer[first]]), {arm: v[first] for arm, v in q.items()}
        return [int(k) for k in layer[~free]]

    def _edge_coordinates(self, k: int, states: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Return the coordinates (F,) of a path at layer k and at the next layer.

        Full turns change by the shortest way, so the second coordinates may exceed the range of the samples.
        """
        samples, coordinates = self.search.samples, self.search.coordinates
        start = samples[self.states[k][states[k]]]
        end = samples[self.states[k + 1][states[k + 1]]]
        return start, start + coordinates.shortest_change(start, end)

    def _block_edges(self, states: IndexArray) -> bool:
        """Check the targets between the layers of a path, and forbid the steps of the path that fail.

        ``states`` (L,) are those of the path at the layers. The coordinates change linearly between the
        layers. The joints of free steps are kept in :attr:`fine`, and collisions are counted in
        :attr:`doubts`. Returns whether any step fails.
        """
        steps = [k for k in range(len(states) - 1) if (k, states[k], states[k + 1]) not in self.fine]
        row_parts, layer_parts, coordinate_parts = [], [], []
        for k in steps:
            inner = np.arange(self.rows[k] + 1, self.rows[k + 1])
            start, end = self._edge_coordinates(k, states)
            fraction = (inner - self.rows[k]) / (self.rows[k + 1] - self.rows[k])
            row_parts.append(inner)
            layer_parts.append(np.full(len(inner), k))
            coordinate_parts.append(start + fraction[:, None] * (end - start))
        if not steps:
            return False
        rows, layer = np.concatenate(row_parts), np.concatenate(layer_parts)
        values = self.search.coordinates.values(np.concatenate(coordinate_parts), rows)
        poses = self.scene.tcp_poses(self.targets, values, rows)
        is_allowed, q = np.ones(len(rows), dtype=bool), {}
        for arm, pose in poses.items():
            chain = self.scene.chains[arm]
            q[arm] = chain.inverse(pose, [self.branch[arm]], self.targets.last_joint_angle(arm, values))[:, 0]
            is_allowed &= chain.best_limit_margin(q[arm]) >= self.scene.settings.joint_margin
            is_allowed &= chain.singularity_margin(q[arm]) >= self.scene.settings.singularity_margin
        in_limits = np.flatnonzero(is_allowed)
        if len(in_limits):
            free = self.scene.keeps_clearance(
                self.targets, {arm: v[in_limits] for arm, v in q.items()}, rows[in_limits]
            )
            self.search.checks += len(in_limits)
            if not free.all():
                first = in_limits[int(np.argmin(free))]
                self.search.collision = int(rows[first]), {arm: v[first] for arm, v in q.items()}
                self.doubts.update(rows[in_limits[~free]].tolist())
            is_allowed[in_limits] = free
        failed_layers = set(layer[~is_allowed].tolist())
        for k in steps:
            key = (k, int(states[k]), int(states[k + 1]))
            if k in failed_layers:
                self._forbid_step(*key)
            else:
                self.fine[key] = {arm: v[layer == k] for arm, v in q.items()}
        return bool(failed_layers)

    def _forbid_step(self, k: int, state: int, next_state: int) -> None:
        """Forbid the step from this state of layer k to that state of the next layer."""
        self.time[k][state, next_state] = np.inf
        self._discard_from(k + 1)

    def _assemble_path(self, states: IndexArray, cost: float, rounds: int) -> PathResult:
        """Assemble the path at all targets, including turns, from its states (L,) at the layers.

        All of its steps are free, so the joints at the targets between layers are known.
        """
        coordinates = np.empty((self.targets.count, self.search.samples.shape[1]))
        q = {
            arm: np.empty((self.targets.count, layer_joints[0].shape[1]))
            for arm, layer_joints in self.q.items()
        }
        current = self.search.samples[self.states[0][states[0]]]
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
        # The turns at the last target are known. Those before follow from continuity, summed from the end.
        for arm, angles in q.items():
            chain, last_turns = self.scene.chains[arm], self.tables[arm].turn_of(self._last_turns[arm])
            change = np.diff(angles, axis=0)
            change -= np.where(chain.has_many_turns, FULL_TURN_RAD * np.round(change / FULL_TURN_RAD), 0.0)
            change_to_end = np.cumsum(change[::-1], axis=0)[::-1]
            last_angles = angles[-1] + last_turns
            q[arm] = np.concatenate([last_angles - change_to_end, last_angles[None]])
        values = self.search.coordinates.values(coordinates, np.arange(self.targets.count))
        path = GraphPath(self.branch, np.zeros(self.targets.count, dtype=np.intp), {}, cost)
        return PathResult(path, values, q, choices=1, checks=self.search.checks, rounds=rounds)

    def _block_moves(self, states: IndexArray, path: PathResult) -> bool:
        """Check a whole path, including turns and linear moves, and forbid the steps that fail.

        A step fails if a target violates the joint margin with its turns, or if a joint changes too much in
        one move. It also fails if a linear move leaves its branch or keeps no clearance. ``states`` (L,) are
        those of the path at the layers. Returns whether any step fails.
        """
        has_failed = np.zeros(self.targets.count, dtype=bool)
        for arm, angles in path.q.items():
            has_failed |= self.scene.chains[arm].limit_margin(angles) < self.scene.settings.joint_margin
            has_failed[1:] |= (np.abs(np.diff(angles, axis=0)) > MAX_JOINT_STEP_RAD).any(axis=1)
        samples = sample_moves(self.scene, self.targets, self.branch, path.q)
        lost = np.isnan(np.concatenate(list(samples.q.values()), axis=1)).any(axis=1)
        rows = np.flatnonzero(~lost & (samples.fraction < 1.0))
        if len(rows):
            nearest = np.where(samples.fraction >= 0.5, samples.move, samples.move - 1)[rows]
            joints = {arm: v[rows] for arm, v in samples.q.items()}
            positions = MovePositions(samples.move[rows], samples.fraction[rows])
            free = self.scene.keeps_clearance(self.targets, joints, np.maximum(nearest, 0), positions)
            self.search.checks += len(rows)
            if not free.all():
                first = int(np.argmin(free))
                self.search.collision = (
                    int(samples.move[rows[first]]),
                    {arm: v[first] for arm, v in joints.items()},
                )
            lost[rows] |= ~free
        has_failed[samples.move[lost]] = True
        # the step from layer k to the next contains the moves to all targets after layer k
        failed_layers = np.unique(
            np.clip(np.searchsorted(self.rows, np.flatnonzero(has_failed)) - 1, 0, len(self.time) - 1)
        )
        for k in failed_layers.tolist():
            self._forbid_step(k, int(states[k]), int(states[k + 1]))
        return len(failed_layers) > 0


def _subsample(states: IndexArray) -> IndexArray:
    """Return the states of a layer, or :data:`MAX_LAYER_STATES` evenly spread ones if there are more."""
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
    """Find out why an operation has no path, over samples of all levels at all targets.

    If some branch combination reaches all targets, collisions are the reason. Otherwise the target that no
    combination passes is reported. If no reason is found, it is the last target.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        coordinates: Converts samples to values of the freedoms.
        all_levels: Levels that were searched.
        collision: A collision that blocked paths: index of the target, and joints {arm: (6,)}.
        blocked_targets: Targets at which searches ended, latest last.
    """
    samples = np.concatenate([level.samples for level in all_levels])
    count = max(1, min(len(samples), MAX_DIAGNOSED_STATES // targets.count))
    samples = samples[np.linspace(0, len(samples) - 1, count).round().astype(np.intp)]
    rows = np.repeat(np.arange(targets.count)[:, None], count, axis=1)
    values = coordinates.values(np.broadcast_to(samples, (targets.count, *samples.shape)), rows)
    grid = SampleGrid(values, np.zeros((0, count), dtype=np.intp))
    reach: dict[str, ArmReach] = compute_reach(scene, targets, grid)
    common = 0  # number of first targets with a sample that all arms can take, on the best combination
    for branches in itertools.product(*(r.branches for r in reach.values())):
        states = [r.branches[b] for r, b in zip(reach.values(), branches, strict=True)]
        is_possible = np.logical_and.reduce([r.ok.any(axis=-1) for r in states]).any(axis=1)
        common = max(common, targets.count if is_possible.all() else int(np.argmin(is_possible)))
    if common == targets.count:
        for index in blocked_targets[::-1]:
            dead_end = _find_dead_end(scene, targets, grid, reach, index)
            if dead_end is not None:
                return grid, BlockedSearch(reach, common, dead_end, collision)
    if common == targets.count and collision is None:
        common = targets.count - 1
    return grid, BlockedSearch(reach, common, collision=collision)


def _find_dead_end(
    scene: Scene, targets: Targets, grid: SampleGrid, reach: Mapping[str, ArmReach], index: int
) -> DeadEnd | None:
    """Describe target ``index`` as a dead end if none of its samples is free on any branches, else None.

    The states are those of the branch combination with the most samples that all arms can take.
    """
    best_combination, tried = None, []
    for branches in itertools.product(*(r.branches for r in reach.values())):
        states = {arm: r.branches[b] for (arm, r), b in zip(reach.items(), branches, strict=True)}
        is_possible = np.logical_and.reduce([r.ok[index].any(axis=-1) for r in states.values()])
        samples = np.flatnonzero(is_possible)
        q = {arm: r.q[index, samples] for arm, r in states.items()}
        if scene.keeps_clearance(targets, q, np.full(len(samples), index)).any():
            return None
        tried.append(branches)
        if best_combination is None or is_possible.sum() > best_combination[1].sum():
            best_combination = states, is_possible
    if best_combination is None or not best_combination[1].any():
        return None
    no_samples = np.zeros(grid.samples, dtype=bool)
    states, is_possible = best_combination
    return DeadEnd(
        index, states, grid, is_possible, no_samples, later=None, tried=frozenset(tried), shorter_count=0
    )
