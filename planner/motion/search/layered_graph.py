"""Layered graph: the shortest path over freedom samples and turns, for fixed branches.

The path is found by dynamic programming. Each target is a layer of states (called a rung of the ladder graph
in Descartes). The cost of a step is its duration at the joint speed limits of the slowest joint, plus a small
fraction of the durations of all joints, which breaks ties toward little motion. The cost of a state is its
penalty:

    cost(i, s) = penalty(i, s) + min over predecessors p of (cost(i - 1, p) + time(p, s)).

A joint that may turn more than once moves continuously, so for given samples each turn state can come from
exactly one turn state of the previous target. The whole turns of all joints of an arm (a row of
:attr:`BranchStates.turns`) are one turn state.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.motion.planning_scene import FULL_TURN_RAD, Chain
from planner.motion.search.reach import BranchStates, SampleGrid

MAX_JOINT_STEP_RAD = np.deg2rad(100.0)
"""Maximum change [rad] of a joint in one linear move. A larger change means another branch, whatever the
branch number.
"""

TIE_BREAK_WEIGHT = 0.02
"""Weight of the motion of all joints relative to that of the slowest one, which breaks ties."""


@dataclasses.dataclass(frozen=True)
class GraphSteps:
    """Steps of one arm on one branch, for the M kinds of step of a :class:`SampleGrid`.

    Attributes:
        time: (M, N-1, S) [s] duration of the step that arrives at a sample, inf if there is none.
        turn: (M, N-1, S, T) turn state of the previous target that the step to a turn state comes from, -1 if
            there is none.
    """

    time: FloatArray
    turn: IndexArray


@dataclasses.dataclass(frozen=True)
class GraphPath:
    """A path through the graph.

    Attributes:
        branch: {arm: branch}.
        sample: (N,) sample of each target.
        turn: {arm: (N,)} turn state at each target.
        cost: Cost [s] of the whole path.
    """

    branch: Mapping[str, int]
    sample: IndexArray
    turn: Mapping[str, IndexArray]
    cost: float


def compute_steps(states: BranchStates, chain: Chain, grid: SampleGrid, speed: FloatArray) -> GraphSteps:
    """Compute step durations and turn changes of one branch, from which :class:`LayeredGraph` is built.

    A step in which a joint changes by more than :data:`MAX_JOINT_STEP_RAD` takes an infinite time. States
    without turns (:meth:`BranchStates.without_turns`) get steps that ignore turns.

    Args:
        states: States of the branch.
        chain: Kinematic chain of the arm.
        grid: Samples.
        speed: (J,) [rad/s] joint speed limits.
    """
    predecessors = np.maximum(grid.predecessors, 0)
    shape = (len(predecessors), max(len(states.q) - 1, 0), grid.samples)
    slowest, total = np.zeros(shape), np.zeros(shape)
    is_forbidden = np.broadcast_to((grid.predecessors < 0)[:, None, :], shape).copy()
    joints = states.q.shape[-1]
    whole_turns = np.zeros((*shape, joints)) if states.has_turns else None
    # time = max_j |dq_j| / v_j + tie weight * sum_j |dq_j| / v_j, dq_j modulo whole turns
    for j in range(joints):
        angle = states.q[..., j]
        change = angle[None, 1:] - np.moveaxis(angle[:-1][:, predecessors], 1, 0)
        if chain.has_many_turns[j]:
            # q_p + 2 pi t_p is nearest to q_i + 2 pi t_i if t_p = t_i + round((q_i - q_p) / 2 pi)
            turn_changes = np.round(change / FULL_TURN_RAD)
            change -= FULL_TURN_RAD * turn_changes
            if whole_turns is not None:
                whole_turns[..., j] = turn_changes
        np.abs(change, out=change)
        with np.errstate(invalid="ignore"):
            is_forbidden |= ~(change <= MAX_JOINT_STEP_RAD)
        change /= speed[j]
        np.maximum(slowest, change, out=slowest)
        total += change
    time = slowest + TIE_BREAK_WEIGHT * total
    if whole_turns is not None:
        turn = _previous_turn(states.turns, whole_turns)
    else:
        turn = np.broadcast_to(np.zeros(1, dtype=np.intp), (*shape, 1))
    return GraphSteps(np.where(is_forbidden, np.inf, time), turn)


def _previous_turn(turns: FloatArray, whole_turns: FloatArray) -> IndexArray:
    """Find the turn state of the previous target from which each turn state is reached.

    Args:
        turns: (T, J) [rad] turn states.
        whole_turns: (M, N-1, S, J) number of whole turns that each joint has more at the previous target.

    Returns:
        Index (M, N-1, S, T) of the previous turn state; -1 if there is no such state.
    """
    counts = np.round(turns / FULL_TURN_RAD).astype(np.int64)
    out = np.full((*whole_turns.shape[:-1], len(turns)), -1, dtype=np.intp)
    is_unchanged = ~np.nan_to_num(whole_turns).any(axis=-1)
    out[is_unchanged] = np.arange(len(turns))
    if not is_unchanged.all():
        required = counts + np.nan_to_num(whole_turns[~is_unchanged]).astype(np.int64)[:, None, :]
        is_equal = (required[:, :, None, :] == counts).all(axis=-1)
        out[~is_unchanged] = np.where(is_equal.any(axis=-1), is_equal.argmax(axis=-1), -1)
    return out


class LayeredGraph:
    """Layered graph of one combination of branches.

    :meth:`shortest_path` may be called again with more states blocked.
    """

    def __init__(
        self,
        grid: SampleGrid,
        states: Sequence[BranchStates],
        moves: Sequence[GraphSteps],
        sample_cost: FloatArray | None = None,
    ) -> None:
        """Build the graph.

        Args:
            grid: Samples.
            states: States of each arm on its branch.
            moves: Steps of each arm.
            sample_cost: (N, S) [s] cost of samples for all arms, such as the distance from a preferred value.
        """
        self._arms = tuple(r.arm for r in states)
        self._branches = tuple(r.branch for r in states)
        self._grid = grid
        self._turns = tuple(len(r.turns) for r in states)
        rows, samples = grid.values.shape[:2]
        width = int(np.prod(self._turns))  # number of combinations of the arms' turn states
        node_cost = (
            np.zeros((rows, samples, width))
            if sample_cost is None
            else np.repeat(sample_cost[..., None], width, axis=2)
        )
        time = np.full((len(grid.predecessors), max(rows - 1, 0), samples), -np.inf)
        predecessors = np.maximum(grid.predecessors, 0)[:, None, :, None]
        if not any(r.has_turns for r in states):
            for r, m in zip(states, moves, strict=True):
                node_cost += r.penalty
                time = np.maximum(time, m.time)
            self._node_cost, self._time = node_cost, time
            self._origin = np.broadcast_to(predecessors, (*time.shape, 1))
            return
        # number of a node: sample * width + sum over arms of stride * turn state
        origin = np.zeros((*time.shape, width), dtype=np.intp)
        is_known = np.ones(origin.shape, dtype=bool)
        # mixed radix number of the turn states of all arms, in which the last arm counts fastest
        strides = np.cumprod((1, *self._turns[::-1]))[-2::-1]
        turn_indices = np.stack(np.unravel_index(np.arange(width), self._turns))
        for r, m, stride, turn_index in zip(states, moves, strides, turn_indices, strict=True):
            node_cost += r.penalty[..., turn_index]
            time = np.maximum(time, m.time)
            turn = m.turn[..., turn_index]
            is_known &= turn >= 0
            origin += stride * turn
        origin += predecessors * width
        self._node_cost, self._time = node_cost, time
        # a step without turn state comes from the padding of _forward, which costs inf
        self._origin = np.where(is_known, origin, samples * width)

    def shortest_path(self, blocked: FloatArray | None = None) -> GraphPath | None:
        """Find the path of least cost through all targets, or None.

        Args:
            blocked: (N, S) [s] added cost of samples; inf forbids them.
        """
        path = self.farthest_path(blocked)
        return path if path is not None and len(path.sample) == len(self._node_cost) else None

    def farthest_path(self, blocked: FloatArray | None = None) -> GraphPath | None:
        """Find the path of least cost to the last target that any path reaches.

        The path covers the targets up to that one. Returns None if no sample of the first target is allowed.
        ``blocked`` is as in :meth:`shortest_path`.
        """
        costs, choice = self._forward(blocked)
        is_reached = np.asarray(np.isfinite(costs).any(axis=1))
        count = len(is_reached) if is_reached.all() else int(np.argmin(is_reached))
        if count == 0:
            return None
        samples, width = self._node_cost.shape[1:]
        nodes = np.empty(count, dtype=np.intp)
        nodes[-1] = int(np.argmin(costs[count - 1]))
        origin = self._origin.reshape(len(self._grid.predecessors), -1, samples * width)
        for i in range(count - 1, 0, -1):
            nodes[i - 1] = origin[choice[i - 1, nodes[i]], i - 1, nodes[i]]
        turns = np.unravel_index(nodes % width, self._turns)
        return GraphPath(
            dict(zip(self._arms, self._branches, strict=True)),
            nodes // width,
            {arm: np.asarray(t) for arm, t in zip(self._arms, turns, strict=True)},
            float(costs[count - 1].min()),
        )

    def reachable_samples(self, blocked: FloatArray | None = None) -> BoolArray:
        """Return for N targets and S samples whether some path from the first target reaches the sample.

        ``blocked`` is as in :meth:`shortest_path`.
        """
        costs, _ = self._forward(blocked)
        rows, samples, width = self._node_cost.shape
        return np.asarray(np.isfinite(costs).reshape(rows, samples, width).any(axis=-1))

    def samples_after(self, i: int, reached: BoolArray) -> BoolArray:
        """Return for each of S samples of target i whether a step from a reached sample leads to it.

        ``reached`` (S,) says which samples of the previous target are reached. Whether the samples of target
        i are allowed does not matter.
        """
        steps = np.isfinite(self._time[:, i - 1]) & (self._grid.predecessors >= 0)
        return np.asarray((steps & reached[np.maximum(self._grid.predecessors, 0)]).any(axis=0))

    def forbid_step(self, i: int, previous_sample: int, sample: int) -> None:
        """Forbid the step to ``sample`` of target i from a sample of the previous target."""
        self._time[self._grid.predecessors[:, sample] == previous_sample, i - 1, sample] = np.inf

    def first_unreached(self, blocked: FloatArray | None = None) -> int:
        """Return the index of the first target that no path reaches; N if paths reach all targets."""
        path = self.farthest_path(blocked)
        return 0 if path is None else len(path.sample)

    def _forward(self, blocked: FloatArray | None) -> tuple[FloatArray, NDArray[np.int8]]:
        """Compute the cost (N, S*T) [s] to reach every state, and the kind of step (N-1, S*T) to it.

        T is the number of combinations of the arms' turn states. The kind of step is the one with which the
        state is reached at this cost. ``blocked`` is as in :meth:`shortest_path`.
        """
        rows, samples, width = self._node_cost.shape
        node_cost = self._node_cost if blocked is None else self._node_cost + blocked[..., None]
        node_cost = node_cost.reshape(rows, samples * width)
        origin = self._origin.reshape(len(self._grid.predecessors), -1, samples * width)
        time = self._time if width == 1 else np.repeat(self._time, width, axis=-1)
        costs = np.empty((rows, samples * width))
        choice = np.zeros((max(rows - 1, 0), samples * width), dtype=np.int8)
        costs[0] = node_cost[0]
        padded = np.full(samples * width + 1, np.inf)
        columns = np.arange(samples * width)
        # c_i(n) = node_i(n) + min over kinds m of step (c_(i-1)(origin_m(n)) + time_m(n))
        for i in range(1, rows):
            padded[:-1] = costs[i - 1]
            offers = padded[origin[:, i - 1]] + time[:, i - 1]
            best = offers.argmin(axis=0)
            choice[i - 1] = best
            costs[i] = offers[best, columns] + node_cost[i]
        return costs, choice


def path_joints(path: GraphPath, states: Mapping[str, BranchStates]) -> dict[str, FloatArray]:
    """Return the joint angles {arm: (N, J)} [rad] of a path, including whole turns."""
    rows = np.arange(len(path.sample))
    return {arm: r.q[rows, path.sample] + r.turns[path.turn[arm]] for arm, r in states.items()}


TURN_CODE_BASE: Final = 16
"""Base of the code of turns: turns of joint j count base ** j."""


class TurnPenalties:
    """Penalties of the states of one arm, looked up by a code of their whole turns.

    The code is the sum over the joints of turns * :data:`TURN_CODE_BASE` ** joint, so that codes of turns can
    be added.
    """

    def __init__(self, branch_states: BranchStates, states: list[IndexArray]) -> None:
        """Prepare the lookup; ``states`` are for each layer the samples (S,) that are its states."""
        counts = np.round(branch_states.turns / FULL_TURN_RAD).astype(np.intp)
        codes = counts @ (TURN_CODE_BASE ** np.arange(counts.shape[1]))
        self._min_code, span = int(codes.min()), int(codes.max() - codes.min()) + 1
        self._turns: dict[int, FloatArray] = {
            int(c): t for c, t in zip(codes, branch_states.turns, strict=True)
        }
        # Column of the penalties by code. The last column, inf, and both ends stand for forbidden turns.
        self._column_by_code = np.full(span + 2, len(codes), dtype=np.intp)
        self._column_by_code[codes - self._min_code + 1] = np.arange(len(codes))
        self._penalty = [
            np.concatenate([branch_states.penalty[k, s], np.full((len(s), 1), np.inf)], axis=1)
            for k, s in enumerate(states)
        ]
        self._codes = codes

    def start_codes(self) -> list[IndexArray]:
        """Return codes (S,) of the first layer's turns in the order in which they are tried.

        The first array holds the best turns of each state, the others the same turns for all states.
        """
        best = self._codes[np.argmin(self._penalty[0][:, :-1], axis=1)]
        return [best, *(np.full(len(best), code, dtype=np.intp) for code in self._codes[1:])]

    def penalty(self, k: int, code: IndexArray) -> FloatArray:
        """Return the penalty (..., S) [s] of the states of layer k at codes of turns (..., S).

        It is inf where these turns are not allowed.
        """
        # codes below and above all known ones fall on the ends of the table, which stand for forbidden turns
        column = self._column_by_code[np.clip(code - (self._min_code - 1), 0, len(self._column_by_code) - 1)]
        # from the column in the row of a state to the position in the flattened penalties
        column += self._penalty[k].shape[1] * np.arange(code.shape[-1])
        return np.asarray(self._penalty[k].ravel()[column])

    def turn_of(self, code: int) -> FloatArray:
        """Return the whole turns (J,) [rad] that a code stands for."""
        return self._turns[code]
