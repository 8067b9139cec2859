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
"""Relative excess of a path's cost over the bound that ignores turns above which turns are searched, too."""

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
        rounds: Number of rounds.
        has_colliding_moves: The path keeps clearance at the targets, but no path over the samples was found
            that also does between them.
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

    This holds for any samples and any branches that reach all targets.

    Attributes:
        index: The target.
        states: States of the branch combination that comes farthest.
        grid: Samples.
        possible: (S,) whether every arm can take a sample of this target.
        free: (S,) whether such a sample is free.
        later: If none is free: grid, index and free samples of the first later target that has some.
        tried: Branch combinations that were tried, in the order of the arms.
        shorter_count: How many of them end earlier.
        find_connections: Returns :attr:`reached` and :attr:`next`, for which all targets may be checked.
            None: unknown.
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
        """Whether (S,) a free path reaches a sample of the previous target."""
        return self._connections[0]

    @property
    def next(self) -> BoolArray:
        """Whether (S,) a step leads to a sample of this target from those."""
        return self._connections[1]

    @functools.cached_property
    def _connections(self) -> tuple[BoolArray, BoolArray]:
        nothing = np.zeros(len(self.possible), dtype=bool), self.possible
        return nothing if self.find_connections is None else self.find_connections()


@dataclasses.dataclass(frozen=True)
class JointWinding:
    """A joint (0 to 5) that would have to turn beyond its limits.

    Attributes:
        arm: Name of the arm.
        joint: Index of the joint.
        low: Lower end [rad] of its motion along a path that ignores its limits, with the best whole turns.
        high: Upper end [rad].
        jumps: Whether the joint would have to jump between the two values, because it can take both but none
            beyond.
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
        dead_end: Where collisions block all paths.
        collision: A target and joints {arm: (6,)} on the move to it that collide.
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
    without collisions, which is a lower bound of their cost with collisions. The rest is skipped once none
    promises much. Without a path all of them are tried.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        grid: Samples of the freedoms.
        others: Arms that do not take part.
        moves: Whether linear moves between targets have to keep clearance, if possible.
        only: Branch combinations to consider, in the order of the arms; None for all.
    """
    # Best-first over branch combinations: first without turns, then, if that is free, with turns. The key of
    # the queue is a lower bound: cost without turns <= cost with turns <= cost with turns and clearance.
    table = compute_reach(scene, targets, grid)
    choices, common = _branch_choices(scene, targets, grid, table, only)
    best: PathResult | None = None
    loose_result: PathResult | None = None
    checks: dict[int, CollisionChecker] = {}
    shared = SharedCollisions(scene, grid, tuple(table)) if len(table) > 1 and len(choices) > 1 else None
    ends: list[tuple[int, int]] = []
    closed: list[int] = []
    tried, offered = 0, 0
    queue = [
        (p.cost, k, False)
        for k, c in enumerate(choices)
        if (p := c.graph_without_turns.shortest_path()) is not None
    ]
    heapq.heapify(queue)
    while queue:
        bound, k, exact = heapq.heappop(queue)
        # prune: the rest costs at least ``bound`` >= best / (1 + MIN_GAIN_FRACTION), or enough were tried
        if best is not None and (
            best.path.cost <= bound * (1.0 + MIN_GAIN_FRACTION) or tried >= MAX_BRANCH_CHOICES
        ):
            break
        if not exact:  # without a free path that ignores turns, the longer search with turns is not needed
            checks[k] = CollisionChecker(scene, targets, grid, choices[k].states, others, shared)
            # targets that blocked other combinations completely probably block this one
            checks[k].check_targets(np.array(closed, dtype=np.intp))
            _, end = _find_free_path(choices[k].graph_without_turns.farthest_path, checks[k])
            if end == targets.count:
                path_with_turns = choices[k].shortest_path()
                offered += path_with_turns is not None
                queue += [] if path_with_turns is None else [(path_with_turns.path.cost, k, True)]
                heapq.heapify(queue)
                continue
            result = None
        else:
            tried += 1
            result, end = choices[k].find_free_path(checks[k])
        if result is None:
            ends.append((end, k))
            if end not in closed and not checks[k].free_samples(end).any():
                closed.append(end)
            continue
        if moves:
            result = _with_free_moves(scene, targets, choices[k], checks[k], result)
        if result.has_colliding_moves:
            loose_result = loose_result or result
        elif best is None or result.path.cost < best.path.cost:
            best = result
    chosen = best if best is not None else loose_result
    if chosen is not None:
        return dataclasses.replace(chosen, choices=offered)
    # No path: find out whether collisions, branches or turns block it.
    dead_end = _find_dead_end(grid, [(end, choices[k], checks[k]) for end, k in ends])
    if dead_end is not None:
        return BlockedSearch(table, targets.count, dead_end)
    common = max((c.graph_without_turns.first_unreached() for c in choices), default=common)
    winding = None
    if common == targets.count:  # only turns block the path
        common, winding = max((c.find_winding(scene) for c in choices), key=lambda candidate: candidate[0])
    elif choices:
        winding = max(choices, key=lambda c: c.graph_without_turns.first_unreached()).find_jump()
    return BlockedSearch(table, min(common, targets.count - 1), winding=winding)


class BranchGraph:
    """Graph of one branch combination.

    Turns are searched only if ignoring them gives a path that cannot be lifted.
    """

    def __init__(
        self,
        scene: Scene,
        grid: SampleGrid,
        states: Mapping[str, BranchStates],
        states_without_turns: Mapping[str, tuple[BranchStates, GraphSteps]],
        sample_cost: FloatArray | None,
    ) -> None:
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
        moves = [_branch_steps(self._scene, r, self._grid) for r in self.states.values()]
        ladder = LayeredGraph(self._grid, tuple(self.states.values()), moves, self._sample_cost)
        for step in self._forbidden_steps:
            ladder.forbid_step(*step)
        return ladder

    def shortest_path(self, blocked: FloatArray | None = None) -> PathResult | None:
        """Path of least cost, including turns and limits; ``blocked`` (N, S) as in :class:`LayeredGraph`."""
        result = self.farthest_path(blocked)
        return result if result is not None and len(result.values) == len(self._grid.values) else None

    def farthest_path(self, blocked: FloatArray | None = None) -> PathResult | None:
        """Path of least cost to the last target that any path reaches, which is as long as that.

        None if no sample of the first target is allowed.
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
        exact = self._graph_with_turns.farthest_path(blocked)
        if exact is None:
            return None
        rows = np.arange(len(exact.sample))
        return PathResult(exact, self._grid.values[rows, exact.sample], path_joints(exact, self.states), 1)

    def find_free_path(self, check: CollisionChecker) -> tuple[PathResult | None, int]:
        """Shortest path whose targets are all free, including turns, and N.

        Otherwise None, and the first target that no free path reaches.
        """
        result, end = _find_free_path(self.farthest_path, check)
        if not isinstance(result, PathResult):
            return None, end
        return dataclasses.replace(result, checks=check.checks, rounds=check.rounds), end

    def find_winding(self, scene: Scene) -> tuple[int, JointWinding | None]:
        """First target that no path with continuous turns reaches, and the joint that has too few turns.

        The joint is None if it is not one joint alone.
        """
        path, lifted = self.graph_without_turns.farthest_path(), self.farthest_path()
        end = 0 if lifted is None else len(lifted.values)
        if path is None or len(path.sample) < len(self._grid.values):
            return end, None
        rows, worst, winding = np.arange(len(path.sample)), 0.0, None
        turns = FULL_TURN_RAD * np.arange(-2, 3)[:, None]
        for arm, states in self.states.items():
            q, robot = np.unwrap(states.q[rows, path.sample], axis=0), scene.chains[arm].robot
            low, high = q.min(axis=0) + turns, q.max(axis=0) + turns
            margin = scene.settings.joint_margin
            beyond = np.maximum(robot.lower + margin - low, high - robot.upper + margin)
            turn = beyond.argmin(axis=0)
            joint = int(beyond.min(axis=0).argmax())
            if beyond[turn[joint], joint] > worst:
                worst = float(beyond[turn[joint], joint])
                winding = JointWinding(
                    arm, joint, float(low[turn[joint], joint]), float(high[turn[joint], joint])
                )
        return end, winding

    def find_jump(self) -> JointWinding | None:
        """The joint that would jump by more than half a turn after the last target that a path reaches.

        None if there is none, or not one alone.
        """
        path = self.graph_without_turns.farthest_path()
        if path is None or not 0 < len(path.sample) < len(self._grid.values):
            return None
        row, windings = len(path.sample), list[JointWinding]()
        for arm, states in self.states.items():
            previous_joints, next_joints = (
                states.q[row - 1, path.sample[-1]],
                states.q[row][states.ok[row].any(axis=-1)],
            )
            if not len(next_joints):
                continue
            change = (
                next_joints[int(np.abs(next_joints - previous_joints).max(axis=1).argmin())] - previous_joints
            )
            for joint in np.flatnonzero(np.abs(change) > 0.5 * FULL_TURN_RAD).tolist():
                start = float(previous_joints[joint])
                windings.append(JointWinding(arm, joint, start, start + float(change[joint]), True))
        return windings[0] if len(windings) == 1 else None

    def active_graph(self) -> LayeredGraph:
        """The graph with turns if these were searched, else the one that ignores them."""
        return self.graph_without_turns if self._graph_with_turns is None else self._graph_with_turns

    def forbid_step(self, i: int, previous_sample: int, sample: int) -> None:
        """Forbid the step to ``sample`` of target i from a sample of the previous target."""
        self._forbidden_steps.append((i, previous_sample, sample))
        for ladder in (self.graph_without_turns, self._graph_with_turns):
            if ladder is not None:
                ladder.forbid_step(i, previous_sample, sample)

    def _lift(self, path: GraphPath) -> PathResult | None:
        """The path with the turns that follow from continuity, from the first turn that costs least."""
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
        return PathResult(GraphPath(path.branch, path.sample, turns, cost), values, q, 1)


def _branch_choices(
    scene: Scene,
    targets: Targets,
    grid: SampleGrid,
    table: Mapping[str, ArmReach],
    only: frozenset[tuple[int, ...]] | None,
) -> tuple[list[BranchGraph], int]:
    """Branch combinations with a common sample at every target; and the farthest target where others fail."""
    extra = _preference_cost(targets, grid)
    states_and_steps = {
        (arm, b): (r.without_turns(), _branch_steps(scene, r.without_turns(), grid))
        for arm, arm_reach in table.items()
        for b, r in arm_reach.branches.items()
    }
    out, common = [], 0
    for branches in itertools.product(*(r.branches for r in table.values())):
        if only is not None and branches not in only:
            continue
        rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
        is_possible = np.logical_and.reduce([r.ok.any(axis=-1) for r in rungs.values()]).any(axis=1)
        if is_possible.all():
            modulo = {arm: states_and_steps[arm, b] for arm, b in zip(table, branches, strict=True)}
            out.append(BranchGraph(scene, grid, rungs, modulo, extra))
        else:
            common = max(common, int(np.argmin(is_possible)))
    return out, common


def _branch_steps(scene: Scene, rungs: BranchStates, grid: SampleGrid) -> GraphSteps:
    return compute_steps(rungs, scene.chains[rungs.arm], grid, speed_limits(scene, rungs.arm))


def speed_limits(scene: Scene, arm: str) -> FloatArray:
    """Joint speed limits (J,) [rad/s] of an arm, with the fraction from the settings."""
    return np.asarray(scene.chains[arm].robot.velocity * scene.settings.speed_fraction)


def _preference_cost(targets: Targets, grid: SampleGrid) -> FloatArray | None:
    """Cost (N, S) [s] of the distance from preferred values, relative to the width of the range."""
    out: FloatArray | None = None
    for j, freedom in enumerate(targets.freedoms):
        if freedom.prefer is None:
            continue
        away = grid.values[..., j] - freedom.prefer[:, None]
        if is_full_turn(freedom):
            away = away - FULL_TURN_RAD * np.round(away / FULL_TURN_RAD)
        width = np.maximum(freedom.upper - freedom.lower, 1e-12)[:, None]
        part = freedom.weight / targets.count * np.square(2.0 * away / width)
        out = part if out is None else out + part
    return out


_AnyPath = TypeVar("_AnyPath", GraphPath, PathResult)


def _find_free_path(
    farthest: Callable[[FloatArray | None], _AnyPath | None], check: CollisionChecker
) -> tuple[_AnyPath | None, int]:
    """Shortest path whose targets are all free, and N.

    If there is none, None and the first target that no free path reaches.

    Checks the path to the last target that ``farthest`` can still reach, removes what collides, and repeats.
    After the first few rounds, every round makes at least one target completely known.
    """
    count = len(check.known)
    for number in itertools.count():
        check.rounds += 1
        path = farthest(check.sample_cost())
        if path is None:
            return None, 0
        sample = path.sample if isinstance(path, GraphPath) else path.path.sample
        rows = np.arange(len(sample))
        check.check_states(rows, sample)
        hit = rows[check.collided[rows, sample]]
        if not len(hit):
            return (path if len(rows) == count else None), len(rows)
        if check.suspect_cost is None:
            check.check_coarsely()
        elif number > LAZY_ROUND_COUNT:
            # the radius doubles: 1, 2, 4, ...
            radius = min(2 ** (number - LAZY_ROUND_COUNT) // 2, count)
            neighbourhood = np.unique(hit[:, None] + np.arange(-radius, radius + 1))
            check.check_targets(neighbourhood[(neighbourhood >= 0) & (neighbourhood < count)])
    raise AssertionError("unreachable")


def _with_free_moves(
    scene: Scene, targets: Targets, choice: BranchGraph, check: CollisionChecker, result: PathResult
) -> PathResult:
    """The path, or the next one whose linear moves are free as well.

    If there is none, the same path, marked loose. Transits of coupled TCPs are left to
    :mod:`planner.motion.transit`.
    """
    first = result
    is_transit = np.array([targets.coupled and s.kind == TRANSIT_KIND for s in targets.segment], dtype=bool)
    for _ in range(MAX_MOVE_ROUNDS):
        samples = sample_moves(scene, targets, result.path.branch, result.q)
        lost = np.isnan(np.concatenate(list(samples.q.values()), axis=1)).any(axis=1)
        to_check = np.flatnonzero(~lost & (samples.fraction < 1.0) & ~is_transit[samples.move])
        checked = MoveSamples(
            samples.move[to_check], samples.fraction[to_check], {a: q[to_check] for a, q in samples.q.items()}
        )
        lost[to_check] = ~is_clear(scene, targets, checked)
        bad = np.unique(samples.move[lost & ~is_transit[samples.move]])
        if not len(bad):
            return result
        for i in bad.tolist():
            choice.forbid_step(i, int(result.path.sample[i - 1]), int(result.path.sample[i]))
        again, _ = choice.find_free_path(check)
        if again is None:
            break
        result = again
    return dataclasses.replace(first, has_colliding_moves=True)


def _find_dead_end(
    grid: SampleGrid, ends: Sequence[tuple[int, BranchGraph, CollisionChecker]]
) -> DeadEnd | None:
    """Dead end of the branch combination that comes farthest.

    None if no combination has a path even without collisions.
    """
    queue = [(-end, k, False) for k, (end, _, _) in enumerate(ends)]
    heapq.heapify(queue)
    while queue:
        end, k, exact = heapq.heappop(queue)
        _, choice, check = ends[k]
        if exact:
            shorter = sum(other < -end for other, _, _ in ends)
            tried = frozenset(tuple(r.branch for r in c.states.values()) for _, c, _ in ends)
            return _make_dead_end(grid, -end, choice, check, tried, shorter)
        if choice.shortest_path() is not None:
            heapq.heappush(queue, (-choice.find_free_path(check)[1], k, True))
    return None


def _make_dead_end(
    grid: SampleGrid,
    index: int,
    choice: BranchGraph,
    check: CollisionChecker,
    tried: frozenset[tuple[int, ...]],
    shorter: int,
) -> DeadEnd:
    count = len(check.known)
    free: BoolArray = check.free_samples(index)
    possible: BoolArray = np.asarray(check.possible[index])

    def find_connections() -> tuple[BoolArray, BoolArray]:
        if index == 0:
            return np.zeros(grid.samples, dtype=bool), possible
        check.check_targets(np.arange(index))
        reached = choice.active_graph().reachable_samples(check.sample_cost())[index - 1]
        return reached, choice.active_graph().samples_after(index, reached) & possible

    later = None
    for i in range(index + 1, count) if not free.any() else ():
        if check.free_samples(i).any():
            later = grid, i, check.free_samples(i)
            break
    return DeadEnd(index, choice.states, grid, possible, free, later, tried, shorter, find_connections)
