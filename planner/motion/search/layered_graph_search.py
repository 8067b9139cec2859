"""Search over branch combinations of all arms.

It feeds collisions back to the layered graph until its path is free.
"""

import dataclasses
import functools
import heapq
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.motion.planning_scene import FULL_TURN_RAD, TRANSIT_KIND, Scene
from planner.motion.search.layered_graph import (
    GraphPath,
    GraphSteps,
    LayeredGraph,
    compute_steps,
    path_joints,
)
from planner.motion.search.reach import (
    ArmReach,
    BranchStates,
    CollisionChecker,
    OtherArms,
    SampleGrid,
    SharedCollisions,
    compute_reach,
    is_full_turn,
)
from planner.motion.trajectory.joint_path import MoveSamples, is_clear, sample_moves
from planner.targets import Targets

LAZY_ROUND_COUNT = 8
"""Number of rounds in which only the samples of the path are checked. Then all samples of colliding targets
are checked, and of a growing neighbourhood of them, so that every search ends.
"""

MAX_BRANCH_CHOICES = 6
"""Maximum number of branch combinations among which the best path is chosen. Without a path all are tried."""

MIN_GAIN_FRACTION = 0.3
"""Relative gain that other branches must promise for them to be checked for collisions as well."""

MAX_EXCESS_FRACTION = 1e-3
"""Relative excess of a path's cost over its cost without turns, above which turns are searched, too."""

MAX_MOVE_ROUNDS = 40
"""Maximum number of rounds in which steps with colliding linear moves are removed."""


@dataclasses.dataclass(frozen=True)
class PathResult:
    """A path over the samples.

    Attributes:
        path: Path through the graph.
        values: (N, F) values of the freedoms.
        q: {arm: (N, 6)} [rad] joints.
        choices: Number of branch combinations that have a path.
        checks: Number of collision checks.
        rounds: Number of rounds in which a path was checked for collisions.
        has_colliding_moves: Whether the path keeps clearance at the targets only. No path over the samples
            was found that also does between them.
    """

    path: GraphPath
    values: FloatArray
    q: dict[str, FloatArray]
    choices: int
    checks: int = 0
    rounds: int = 1
    has_colliding_moves: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class DeadEnd:
    """Dead end: the target that no path passes because of collisions.

    This holds for all samples of the grid and all branches that reach all targets.

    Attributes:
        index: Index of the target.
        states: States of the branch combination whose paths come farthest.
        grid: Samples of the freedoms at all targets.
        possible: (S,) whether every arm can take a sample of this target.
        free: (S,) whether such a sample is free.
        later: Grid, index and free samples (S,) of the first later target that has some; None if a sample of
            this target is free, or if no later one has any.
        tried: Branch combinations that were tried, in the order of the arms.
        shorter_count: Number of these combinations whose paths end at an earlier target.
        find_connections: Computes :attr:`reached` and :attr:`next`, for which it may have to check all
            targets. None if they are unknown.
    """

    index: int
    states: Mapping[str, BranchStates]
    grid: SampleGrid
    possible: BoolArray
    free: BoolArray
    later: tuple[SampleGrid, int, BoolArray] | None
    tried: frozenset[tuple[int, ...]]
    shorter_count: int
    find_connections: Callable[[], tuple[BoolArray, BoolArray]] | None = None

    @property
    def reached(self) -> BoolArray:
        """For each of S samples of the previous target whether a free path reaches it; False if unknown."""
        return self._connections[0]

    @property
    def next(self) -> BoolArray:
        """For each of S samples whether a step from a reached one leads to it; ``possible`` if unknown."""
        return self._connections[1]

    @functools.cached_property
    def _connections(self) -> tuple[BoolArray, BoolArray]:
        unknown = np.zeros(len(self.possible), dtype=bool), self.possible
        return unknown if self.find_connections is None else self.find_connections()


@dataclasses.dataclass(frozen=True)
class JointWinding:
    """A joint (0 to 5) that would have to turn beyond its limits.

    Attributes:
        arm: Name of the arm.
        joint: Index of the joint.
        low: Lower end [rad] of its motion along a path that ignores its limits, with the best whole turns.
        high: Upper end [rad].
        jumps: Whether the joint would have to jump from one value to the other, because it cannot turn beyond
            the first.
    """

    arm: str
    joint: int
    low: float
    high: float
    jumps: bool = False


@dataclasses.dataclass(frozen=True)
class BlockedSearch:
    """Why there is no path.

    Attributes:
        reach: Reach of all arms.
        common: First target that no branch combination passes; N if only collisions block paths.
        dead_end: Target at which collisions block all paths, if they do.
        collision: Index of a target, and joints {arm: (6,)} on the move to it that collide.
        subset: The targets and their indices (K,) in the job, if only a subset was searched.
        winding: The joint whose turns end the paths, if turns do.
    """

    reach: Mapping[str, ArmReach]
    common: int
    dead_end: DeadEnd | None = None
    collision: tuple[int, dict[str, FloatArray]] | None = None
    subset: tuple[Targets, IndexArray] | None = None
    winding: JointWinding | None = None


def search_graph(
    scene: Scene,
    targets: Targets,
    grid: SampleGrid,
    others: OtherArms | None = None,
    moves: bool = False,
    only: frozenset[tuple[int, ...]] | None = None,
) -> PathResult | BlockedSearch:
    """Find the path of least cost over branches, samples and turns that keeps clearance.

    Branches stay the same over the whole operation. Branch combinations are tried in the order of their cost
    without collisions, which is a lower bound of their cost with collisions. Once a path is found, the others
    are skipped if they cannot be much better. If none is found, all of them are tried.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        grid: Samples of the freedoms.
        others: Arms that this search does not move.
        moves: Whether linear moves between targets have to keep clearance, if possible.
        only: Branch combinations to consider, in the order of the arms; None for all.

    Returns:
        The path, or why there is none. If no path has free moves, one that is free at the targets only is
        returned, with ``has_colliding_moves``.
    """
    # Best-first over branch combinations: first without turns, then, if that is free, with turns. The key of
    # the queue is a lower bound: cost without turns <= cost with turns <= cost with turns and clearance.
    reach = compute_reach(scene, targets, grid)
    choices, common = _branch_choices(scene, targets, grid, reach, only)
    best: PathResult | None = None
    colliding_result: PathResult | None = None
    checkers: dict[int, CollisionChecker] = {}
    shared = SharedCollisions(scene, grid, tuple(reach)) if len(reach) > 1 and len(choices) > 1 else None
    ends: list[tuple[int, int]] = []
    blocked_targets: list[int] = []
    tried_count, path_count = 0, 0
    queue: list[tuple[float, int, bool]] = []
    for k, choice in enumerate(choices):
        path = choice.graph_without_turns.shortest_path()
        if path is not None:
            queue.append((path.cost, k, False))
    heapq.heapify(queue)
    while queue:
        bound, k, includes_turns = heapq.heappop(queue)
        # prune: the rest costs at least ``bound`` >= best / (1 + MIN_GAIN_FRACTION), or enough were tried
        if best is not None and (
            best.path.cost <= bound * (1.0 + MIN_GAIN_FRACTION) or tried_count >= MAX_BRANCH_CHOICES
        ):
            break
        if not includes_turns:
            # without a free path that ignores turns, the longer search with turns is not needed
            checkers[k] = CollisionChecker(scene, targets, grid, choices[k].states, others, shared)
            # targets that blocked other combinations completely probably block this one
            checkers[k].check_targets(np.array(blocked_targets, dtype=np.intp))
            _, end = _find_free_path(choices[k].graph_without_turns.farthest_path, checkers[k])
            if end == targets.count:
                path_with_turns = choices[k].shortest_path()
                if path_with_turns is not None:
                    path_count += 1
                    queue.append((path_with_turns.path.cost, k, True))
                heapq.heapify(queue)
                continue
            result = None
        else:
            tried_count += 1
            result, end = choices[k].find_free_path(checkers[k])
        if result is None:
            ends.append((end, k))
            if end not in blocked_targets and not checkers[k].free_samples(end).any():
                blocked_targets.append(end)
            continue
        if moves:
            result = _with_free_moves(scene, targets, choices[k], checkers[k], result)
        if result.has_colliding_moves:
            colliding_result = colliding_result or result
        elif best is None or result.path.cost < best.path.cost:
            best = result
    chosen = best if best is not None else colliding_result
    if chosen is not None:
        return dataclasses.replace(chosen, choices=path_count)
    # No path: find out whether collisions, branches or turns block it.
    dead_end = _find_dead_end(grid, [(end, choices[k], checkers[k]) for end, k in ends])
    if dead_end is not None:
        return BlockedSearch(reach, targets.count, dead_end)
    common = max((c.graph_without_turns.first_unreached() for c in choices), default=common)
    winding = None
    if common == targets.count:  # only turns block the path
        common, winding = max((c.find_winding(scene) for c in choices), key=lambda candidate: candidate[0])
    elif choices:
        winding = max(choices, key=lambda c: c.graph_without_turns.first_unreached()).find_jump()
    return BlockedSearch(reach, min(common, targets.count - 1), winding=winding)


class BranchGraph:
    """Layered graph of one branch combination.

    A path is searched without turns first and then lifted: turns are added that follow from continuity. The
    larger graph with turns is searched only if the path cannot be lifted, or if turns make it costlier.
    """

    def __init__(
        self,
        scene: Scene,
        grid: SampleGrid,
        states: Mapping[str, BranchStates],
        states_without_turns: Mapping[str, tuple[BranchStates, GraphSteps]],
        sample_cost: FloatArray | None,
    ) -> None:
        """Build the graph without turns.

        Args:
            scene: Cell with the stock in its pose.
            grid: Samples of the freedoms.
            states: {arm: states on its branch}.
            states_without_turns: {arm: these states without turns, and the steps between them}.
            sample_cost: (N, S) [s] cost of samples for all arms; None for no cost.
        """
        self.states = states
        self._scene, self._grid, self._sample_cost = scene, grid, sample_cost
        self.graph_without_turns = LayeredGraph(
            grid,
            [r for r, _ in states_without_turns.values()],
            [m for _, m in states_without_turns.values()],
            sample_cost,
        )
        self._graph_with_turns: LayeredGraph | None = None
        self._forbidden_steps: list[tuple[int, int, int]] = []

    def _build_graph_with_turns(self) -> LayeredGraph:
        """Build the graph with turns, without the steps that were forbidden so far."""
        moves = [_branch_steps(self._scene, r, self._grid) for r in self.states.values()]
        graph = LayeredGraph(self._grid, tuple(self.states.values()), moves, self._sample_cost)
        for step in self._forbidden_steps:
            graph.forbid_step(*step)
        return graph

    def shortest_path(self, blocked: FloatArray | None = None) -> PathResult | None:
        """Find the path of least cost through all targets, including turns and joint limits, or None.

        ``blocked`` (N, S) [s] is as in :meth:`LayeredGraph.shortest_path`.
        """
        result = self.farthest_path(blocked)
        return result if result is not None and len(result.values) == len(self._grid.values) else None

    def farthest_path(self, blocked: FloatArray | None = None) -> PathResult | None:
        """Find the path of least cost to the last target that any path reaches, including turns and limits.

        The path covers the targets up to that one. Returns None if no sample of the first target is allowed.
        ``blocked`` (N, S) [s] is as in :meth:`LayeredGraph.shortest_path`.
        """
        path = self.graph_without_turns.farthest_path(blocked)
        if path is None:
            return None
        lifted, is_complete = self._lift(path), len(path.sample) == len(self._grid.values)
        is_costly = lifted is None or (
            is_complete and lifted.path.cost > path.cost * (1.0 + MAX_EXCESS_FRACTION)
        )
        if lifted is not None and not is_costly:
            return lifted
        if self._graph_with_turns is None:
            self._graph_with_turns = self._build_graph_with_turns()
        path_with_turns = self._graph_with_turns.farthest_path(blocked)
        if path_with_turns is None:
            return None
        values = self._grid.values[np.arange(len(path_with_turns.sample)), path_with_turns.sample]
        return PathResult(path_with_turns, values, path_joints(path_with_turns, self.states), choices=1)

    def find_free_path(self, check: CollisionChecker) -> tuple[PathResult | None, int]:
        """Find the path of least cost whose targets are all free, including turns.

        Returns:
            The path and N; or None and the first target that no free path reaches.
        """
        result, end = _find_free_path(self.farthest_path, check)
        if not isinstance(result, PathResult):
            return None, end
        return dataclasses.replace(result, checks=check.checks, rounds=check.rounds), end

    def find_winding(self, scene: Scene) -> tuple[int, JointWinding | None]:
        """Find the first target that no path with continuous turns reaches, and the joint that prevents it.

        On the path without turns, this is the joint that exceeds its limits most, with the best whole turns.
        It is None if that path ends early or if no joint exceeds its limits.
        """
        path, path_with_turns = self.graph_without_turns.farthest_path(), self.farthest_path()
        end = 0 if path_with_turns is None else len(path_with_turns.values)
        if path is None or len(path.sample) < len(self._grid.values):
            return end, None
        rows = np.arange(len(path.sample))
        max_excess, winding = 0.0, None
        # whole motions shifted by up to two turns: for each joint the shift that exceeds its limits least
        turns = FULL_TURN_RAD * np.arange(-2, 3)[:, None]
        for arm, states in self.states.items():
            q, robot = np.unwrap(states.q[rows, path.sample], axis=0), scene.chains[arm].robot
            low, high = q.min(axis=0) + turns, q.max(axis=0) + turns
            margin = scene.settings.joint_margin
            excess = np.maximum(robot.lower + margin - low, high - robot.upper + margin)
            best_turn = excess.argmin(axis=0)
            joint = int(excess.min(axis=0).argmax())
            turn = best_turn[joint]
            if excess[turn, joint] > max_excess:
                max_excess = float(excess[turn, joint])
                winding = JointWinding(arm, joint, float(low[turn, joint]), float(high[turn, joint]))
        return end, winding

    def find_jump(self) -> JointWinding | None:
        """Find the joint that would jump by more than half a turn after the last target that a path reaches.

        The jump is that to the nearest allowed state of the next target. Returns None if no joint jumps, or
        more than one.
        """
        path = self.graph_without_turns.farthest_path()
        if path is None or not 0 < len(path.sample) < len(self._grid.values):
            return None
        row = len(path.sample)
        windings: list[JointWinding] = []
        for arm, states in self.states.items():
            previous_joints = states.q[row - 1, path.sample[-1]]
            next_joints = states.q[row][states.ok[row].any(axis=-1)]
            if not len(next_joints):
                continue
            nearest = int(np.abs(next_joints - previous_joints).max(axis=1).argmin())
            change = next_joints[nearest] - previous_joints
            for joint in np.flatnonzero(np.abs(change) > 0.5 * FULL_TURN_RAD).tolist():
                start = float(previous_joints[joint])
                windings.append(JointWinding(arm, joint, start, start + float(change[joint]), jumps=True))
        return windings[0] if len(windings) == 1 else None

    def active_graph(self) -> LayeredGraph:
        """Return the graph with turns if turns were searched, else the one that ignores them."""
        return self.graph_without_turns if self._graph_with_turns is None else self._graph_with_turns

    def forbid_step(self, i: int, previous_sample: int, sample: int) -> None:
        """Forbid the step to ``sample`` of target i from a sample of the previous target."""
        self._forbidden_steps.append((i, previous_sample, sample))
        for graph in (self.graph_without_turns, self._graph_with_turns):
            if graph is not None:
                graph.forbid_step(i, previous_sample, sample)

    def _lift(self, path: GraphPath) -> PathResult | None:
        """Add turns to a path without turns, or return None if it then exceeds joint limits.

        The turns at the first target are those with the least cost of the whole path. All others follow,
        because the joints move continuously.
        """
        rows = np.arange(len(path.sample))
        q, turns, cost = {}, {}, path.cost
        for arm, r in self.states.items():
            has_many_turns = self._scene.chains[arm].has_many_turns
            angles = r.q[rows, path.sample]
            change = np.where(has_many_turns, np.round(np.diff(angles, axis=0) / FULL_TURN_RAD), 0.0)
            whole = np.concatenate([np.zeros((1, len(has_many_turns))), -np.cumsum(change, axis=0)])
            # t_i = t_0 - sum of round(dq / 2 pi) up to i, for each turn t_0 of the first target
            required = np.round(r.turns / FULL_TURN_RAD) + whole[:, None, :]
            is_equal = (required[:, :, None, :] == np.round(r.turns / FULL_TURN_RAD)).all(axis=-1)
            state = np.where(is_equal.any(axis=-1), is_equal.argmax(axis=-1), -1)
            penalties = np.where(
                state >= 0, r.penalty[rows[:, None], path.sample[:, None], state], np.inf
            ).sum(axis=0)
            start = int(np.argmin(penalties))
            if not np.isfinite(penalties[start]):
                return None
            cost += float(penalties[start] - r.penalty[rows, path.sample].min(axis=-1).sum())
            turns[arm] = state[:, start]
            q[arm] = angles + r.turns[turns[arm]]
        values = self._grid.values[rows, path.sample]
        return PathResult(GraphPath(path.branch, path.sample, turns, cost), values, q, choices=1)


def _branch_choices(
    scene: Scene,
    targets: Targets,
    grid: SampleGrid,
    reach: Mapping[str, ArmReach],
    only: frozenset[tuple[int, ...]] | None,
) -> tuple[list[BranchGraph], int]:
    """Build the graph of each branch combination with a sample at every target that all arms can take.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        grid: Samples of the freedoms.
        reach: {arm: its reach over the samples}.
        only: Branch combinations to consider, in the order of the arms; None for all.

    Returns:
        The graphs, and the largest index of a target at which another combination has no such sample; 0 if
        there is none.
    """
    sample_cost = _preference_cost(targets, grid)
    states_and_steps = {
        (arm, b): (r.without_turns(), _branch_steps(scene, r.without_turns(), grid))
        for arm, arm_reach in reach.items()
        for b, r in arm_reach.branches.items()
    }
    out, common = [], 0
    for branches in itertools.product(*(r.branches for r in reach.values())):
        if only is not None and branches not in only:
            continue
        states = {arm: r.branches[b] for (arm, r), b in zip(reach.items(), branches, strict=True)}
        is_possible = np.logical_and.reduce([r.ok.any(axis=-1) for r in states.values()]).any(axis=1)
        if is_possible.all():
            states_without_turns = {
                arm: states_and_steps[arm, b] for arm, b in zip(reach, branches, strict=True)
            }
            out.append(BranchGraph(scene, grid, states, states_without_turns, sample_cost))
        else:
            common = max(common, int(np.argmin(is_possible)))
    return out, common


def _branch_steps(scene: Scene, states: BranchStates, grid: SampleGrid) -> GraphSteps:
    """Compute the steps between the states of one branch, at the speed limits of its arm."""
    return compute_steps(states, scene.chains[states.arm], grid, speed_limits(scene, states.arm))


def speed_limits(scene: Scene, arm: str) -> FloatArray:
    """Return the joint speed limits (J,) [rad/s] of an arm, multiplied by the fraction from the settings."""
    return np.asarray(scene.chains[arm].robot.velocity * scene.settings.speed_fraction)


def _preference_cost(targets: Targets, grid: SampleGrid) -> FloatArray | None:
    """Compute the cost (N, S) [s] of samples for their distance from preferred values of freedoms.

    The cost is the weight of the freedom divided by N, times the square of the distance relative to half of
    the range. Returns None if no freedom has preferred values.
    """
    out: FloatArray | None = None
    for j, freedom in enumerate(targets.freedoms):
        if freedom.prefer is None:
            continue
        distance = grid.values[..., j] - freedom.prefer[:, None]
        if is_full_turn(freedom):
            distance = distance - FULL_TURN_RAD * np.round(distance / FULL_TURN_RAD)
        width = np.maximum(freedom.upper - freedom.lower, 1e-12)[:, None]
        cost = freedom.weight / targets.count * np.square(2.0 * distance / width)
        out = cost if out is None else out + cost
    return out


_AnyPath = TypeVar("_AnyPath", GraphPath, PathResult)


def _find_free_path(
    farthest_path: Callable[[FloatArray | None], _AnyPath | None], checker: CollisionChecker
) -> tuple[_AnyPath | None, int]:
    """Find the path of least cost whose targets are all free.

    A path is searched and its samples are checked for collisions. Samples that collide are forbidden, and the
    search is repeated. After the first collision, some targets are checked with all of their samples, which
    makes samples that probably collide costly. After :data:`LAZY_ROUND_COUNT` rounds, every round checks all
    samples of at least one more target, so the search ends.

    Args:
        farthest_path: Finds the path of least cost to the last target that can be reached, given the cost
            (N, S) [s] of samples.
        checker: Checks samples for collisions and remembers the results.

    Returns:
        The path and N; or None and the first target that no free path reaches.
    """
    count = len(checker.known)
    for number in itertools.count():
        checker.rounds += 1
        path = farthest_path(checker.sample_cost())
        if path is None:
            return None, 0
        sample = path.sample if isinstance(path, GraphPath) else path.path.sample
        rows = np.arange(len(sample))
        checker.check_states(rows, sample)
        colliding = rows[checker.collided[rows, sample]]
        if not len(colliding):
            return (path if len(rows) == count else None), len(rows)
        if checker.suspect_cost is None:
            checker.check_coarsely()
        elif number > LAZY_ROUND_COUNT:
            # the radius doubles: 1, 2, 4, ...
            radius = min(2 ** (number - LAZY_ROUND_COUNT) // 2, count)
            neighbourhood = np.unique(colliding[:, None] + np.arange(-radius, radius + 1))
            checker.check_targets(neighbourhood[(neighbourhood >= 0) & (neighbourhood < count)])
    raise AssertionError("unreachable")


def _with_free_moves(
    scene: Scene, targets: Targets, choice: BranchGraph, checker: CollisionChecker, result: PathResult
) -> PathResult:
    """Return a path whose linear moves keep clearance: the given one, or the next one in the order of cost.

    Steps with colliding moves are forbidden in the graph ``choice``, and the path is searched again. If there
    is no such path, the given one is returned with ``has_colliding_moves``. Transits of coupled TCPs are not
    checked, because :mod:`planner.motion.transit` repairs them.
    """
    first_result = result
    is_transit = np.array([targets.coupled and s.kind == TRANSIT_KIND for s in targets.segment], dtype=bool)
    for _ in range(MAX_MOVE_ROUNDS):
        samples = sample_moves(scene, targets, result.path.branch, result.q)
        lost = np.isnan(np.concatenate(list(samples.q.values()), axis=1)).any(axis=1)
        to_check = np.flatnonzero(~lost & (samples.fraction < 1.0) & ~is_transit[samples.move])
        checked = MoveSamples(
            samples.move[to_check], samples.fraction[to_check], {a: q[to_check] for a, q in samples.q.items()}
        )
        lost[to_check] = ~is_clear(scene, targets, checked)
        blocked_moves = np.unique(samples.move[lost & ~is_transit[samples.move]])
        if not len(blocked_moves):
            return result
        for i in blocked_moves.tolist():
            choice.forbid_step(i, int(result.path.sample[i - 1]), int(result.path.sample[i]))
        next_result, _ = choice.find_free_path(checker)
        if next_result is None:
            break
        result = next_result
    return dataclasses.replace(first_result, has_colliding_moves=True)


def _find_dead_end(
    grid: SampleGrid, ends: Sequence[tuple[int, BranchGraph, CollisionChecker]]
) -> DeadEnd | None:
    """Return the dead end of the branch combination whose free paths come farthest, to explain the failure.

    Args:
        grid: Samples of the freedoms.
        ends: For each combination that was tried: the first target that no free path reaches, its graph and
            its collision checker. The target may have been found without turns. With turns, paths may end at
            an earlier target.

    Returns:
        The dead end; None if no combination has a path even without collisions.
    """
    # The queue has negative targets, so that the farthest comes first. Its target is computed with turns, and
    # it is queued again, because another combination may then come farther.
    queue = [(-end, k, False) for k, (end, _, _) in enumerate(ends)]
    heapq.heapify(queue)
    while queue:
        negative_end, k, includes_turns = heapq.heappop(queue)
        _, choice, checker = ends[k]
        if includes_turns:
            shorter_count = sum(other_end < -negative_end for other_end, _, _ in ends)
            tried = frozenset(tuple(r.branch for r in c.states.values()) for _, c, _ in ends)
            return _make_dead_end(grid, -negative_end, choice, checker, tried, shorter_count)
        if choice.shortest_path() is not None:
            heapq.heappush(queue, (-choice.find_free_path(checker)[1], k, True))
    return None


def _make_dead_end(
    grid: SampleGrid,
    index: int,
    choice: BranchGraph,
    checker: CollisionChecker,
    tried: frozenset[tuple[int, ...]],
    shorter_count: int,
) -> DeadEnd:
    """Describe the dead end at target ``index`` of a branch combination, for the issue that reports it.

    Args:
        grid: Samples of the freedoms.
        index: First target that no free path reaches.
        choice: Graph of the branch combination.
        checker: Collision checker of the branch combination.
        tried: Branch combinations that were tried.
        shorter_count: Number of these combinations whose paths end at an earlier target.
    """
    count = len(checker.known)
    free: BoolArray = checker.free_samples(index)
    possible: BoolArray = np.asarray(checker.possible[index])

    def find_connections() -> tuple[BoolArray, BoolArray]:
        if index == 0:
            return np.zeros(grid.samples, dtype=bool), possible
        checker.check_targets(np.arange(index))
        reached = choice.active_graph().reachable_samples(checker.sample_cost())[index - 1]
        return reached, choice.active_graph().samples_after(index, reached) & possible

    later = None
    for i in range(index + 1, count) if not free.any() else ():
        if checker.free_samples(i).any():
            later = grid, i, checker.free_samples(i)
            break
    return DeadEnd(index, choice.states, grid, possible, free, later, tried, shorter_count, find_connections)
