"""Ladder: the shortest path over freedom samples and turns, for fixed branches.

By dynamic programming. The cost of a step is its time at the joint speed limits of the slowest
joint, plus a small share of all joints' times so that ties are broken toward little motion; the
cost of a state is its penalty. A joint with more than one turn keeps its turn: each step has
exactly one turn state that it can come from. Whole turns of an arm's joints are coded as one
number.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.motion.planning_scene import FULL_TURN, Chain
from planner.motion.search.reach import Grid, Rungs

LARGEST_STEP = np.deg2rad(100.0)
"""A joint that would move more than this [rad] in one linear move has changed its branch, whatever its
number says."""

TIE_SHARE = 0.02
"""Weight of the motion of all joints together against that of the slowest: it settles ties."""


@dataclasses.dataclass(frozen=True)
class Steps:
    """One arm and branch: ``time`` (M, N-1, S) of the step that arrives at a sample, inf if it is none;
    ``turn`` (M, N-1, S, T) the turn state that it comes from, -1 if there is none."""

    time: FloatArray
    turn: IndexArray


@dataclasses.dataclass(frozen=True)
class Path:
    """A path: ``sample`` (N,), ``turn`` {arm: (N,)}, ``cost`` [s] and the branch of each arm."""

    branch: Mapping[str, int]
    sample: IndexArray
    turn: Mapping[str, IndexArray]
    cost: float


def steps(rungs: Rungs, chain: Chain, grid: Grid, speed: FloatArray) -> Steps:
    """Step times and turn changes of one branch; ``speed`` (J,) are the joint speed limits [rad/s].

    Rungs without turns (:meth:`Rungs.modulo`) get steps that ignore turns.
    """
    before = np.maximum(grid.before, 0)
    shape = (len(before), max(len(rungs.q) - 1, 0), grid.samples)
    slowest, total = np.zeros(shape), np.zeros(shape)
    bad = np.broadcast_to((grid.before < 0)[:, None, :], shape).copy()
    joints = rungs.q.shape[-1]
    whole = np.zeros((*shape, joints)) if rungs.turns_matter else None
    for j in range(joints):
        angle = rungs.q[..., j]
        change = angle[None, 1:] - np.moveaxis(angle[:-1][:, before], 1, 0)
        if chain.many_turns[j]:
            turned = np.round(change / FULL_TURN)
            change -= FULL_TURN * turned
            if whole is not None:
                whole[..., j] = turned
        np.abs(change, out=change)
        with np.errstate(invalid="ignore"):
            bad |= ~(change <= LARGEST_STEP)
        change /= speed[j]
        np.maximum(slowest, change, out=slowest)
        total += change
    time = slowest + TIE_SHARE * total
    if whole is not None:
        turn = _previous_turn(rungs.turns, whole)
    else:
        turn = np.broadcast_to(np.zeros(1, dtype=np.intp), (*shape, 1))
    return Steps(np.where(bad, np.inf, time), turn)


def _previous_turn(turns: FloatArray, whole: FloatArray) -> IndexArray:
    """Index (M, N-1, S, T) of the turn state ``whole`` (M, N-1, S, J) turns above each state, or -1."""
    counts = np.round(turns / FULL_TURN).astype(np.int64)
    out = np.full((*whole.shape[:-1], len(turns)), -1, dtype=np.intp)
    stay = ~np.nan_to_num(whole).any(axis=-1)
    out[stay] = np.arange(len(turns))
    if not stay.all():
        wanted = counts + np.nan_to_num(whole[~stay]).astype(np.int64)[:, None, :]
        same = (wanted[:, :, None, :] == counts).all(axis=-1)
        out[~stay] = np.where(same.any(axis=-1), same.argmax(axis=-1), -1)
    return out


class Ladder:
    """The layered graph of one choice of branches; :meth:`shortest` may be asked again with more states
    blocked."""

    def __init__(
        self, grid: Grid, rungs: Sequence[Rungs], moves: Sequence[Steps], extra: FloatArray | None = None
    ) -> None:
        """``extra`` (N, S) [s] is a cost of samples for all arms, such as the distance from a preferred
        value."""
        self._arms = tuple(r.arm for r in rungs)
        self._branches = tuple(r.branch for r in rungs)
        self._grid = grid
        self._turns = tuple(len(r.turns) for r in rungs)
        rows, samples = grid.values.shape[:2]
        width = int(np.prod(self._turns))
        node = (
            np.zeros((rows, samples, width)) if extra is None else np.repeat(extra[..., None], width, axis=2)
        )
        time = np.full((len(grid.before), max(rows - 1, 0), samples), -np.inf)
        before = np.maximum(grid.before, 0)[:, None, :, None]
        if not any(r.turns_matter for r in rungs):
            for r, m in zip(rungs, moves, strict=True):
                node += r.penalty
                time = np.maximum(time, m.time)
            self._node, self._time = node, time
            self._origin = np.broadcast_to(before, (*time.shape, 1))
            return
        origin = np.zeros((*time.shape, width), dtype=np.intp)
        known = np.ones(origin.shape, dtype=bool)
        strides = np.cumprod((1, *self._turns[::-1]))[-2::-1]
        places = np.stack(np.unravel_index(np.arange(width), self._turns))
        for r, m, stride, place in zip(rungs, moves, strides, places, strict=True):
            node += r.penalty[..., place]
            time = np.maximum(time, m.time)
            turn = m.turn[..., place]
            known &= turn >= 0
            origin += stride * turn
        origin += before * width
        self._node, self._time = node, time
        self._origin = np.where(known, origin, samples * width)

    def shortest(self, blocked: FloatArray | None = None) -> Path | None:
        """The path of least cost, or None; ``blocked`` (N, S) adds to the cost of samples, inf forbids."""
        path = self.farthest(blocked)
        return path if path is not None and len(path.sample) == len(self._node) else None

    def farthest(self, blocked: FloatArray | None = None) -> Path | None:
        """The path of least cost to the last target that any path reaches, all of them if it can be; it is as
        long as that. None if no sample of the first target is allowed."""
        costs, choice = self._forward(blocked)
        ends = np.asarray(np.isfinite(costs).any(axis=1))
        count = len(ends) if ends.all() else int(np.argmin(ends))
        if count == 0:
            return None
        samples, width = self._node.shape[1:]
        states = np.empty(count, dtype=np.intp)
        states[-1] = int(np.argmin(costs[count - 1]))
        flat = self._origin.reshape(len(self._grid.before), -1, samples * width)
        for i in range(count - 1, 0, -1):
            states[i - 1] = flat[choice[i - 1, states[i]], i - 1, states[i]]
        turns = np.unravel_index(states % width, self._turns)
        return Path(
            dict(zip(self._arms, self._branches, strict=True)),
            states // width,
            {arm: np.asarray(t) for arm, t in zip(self._arms, turns, strict=True)},
            float(costs[count - 1].min()),
        )

    def reachable(self, blocked: FloatArray | None = None) -> BoolArray:
        """(N, S) samples that some path reaches from the first target."""
        costs, _ = self._forward(blocked)
        rows, samples, width = self._node.shape
        return np.asarray(np.isfinite(costs).reshape(rows, samples, width).any(axis=-1))

    def after(self, i: int, reached: BoolArray) -> BoolArray:
        """(S,) samples of target i to which a step leads from one of those ``reached`` (S,) at the target
        before, whether or not they are allowed."""
        steps = np.isfinite(self._time[:, i - 1]) & (self._grid.before >= 0)
        return np.asarray((steps & reached[np.maximum(self._grid.before, 0)]).any(axis=0))

    def close(self, i: int, before: int, sample: int) -> None:
        """Forbids the step to ``sample`` of target i from sample ``before`` of the one before it."""
        self._time[self._grid.before[:, sample] == before, i - 1, sample] = np.inf

    def furthest(self, blocked: FloatArray | None = None) -> int:
        """Index of the first target that no path reaches; N if there is none."""
        path = self.farthest(blocked)
        return 0 if path is None else len(path.sample)

    def _forward(self, blocked: FloatArray | None) -> tuple[FloatArray, NDArray[np.int8]]:
        """Cost (N, S*T) to reach every state and the kind of step (N-1, S*T) that reaches it best."""
        rows, samples, width = self._node.shape
        node = self._node if blocked is None else self._node + blocked[..., None]
        node = node.reshape(rows, samples * width)
        origin = self._origin.reshape(len(self._grid.before), -1, samples * width)
        time = self._time if width == 1 else np.repeat(self._time, width, axis=-1)
        costs = np.empty((rows, samples * width))
        choice = np.zeros((max(rows - 1, 0), samples * width), dtype=np.int8)
        costs[0] = node[0]
        padded = np.full(samples * width + 1, np.inf)
        columns = np.arange(samples * width)
        for i in range(1, rows):
            padded[:-1] = costs[i - 1]
            offers = padded[origin[:, i - 1]] + time[:, i - 1]
            best = offers.argmin(axis=0)
            choice[i - 1] = best
            costs[i] = offers[best, columns] + node[i]
        return costs, choice


def joint_path(path: Path, rungs: Mapping[str, Rungs]) -> dict[str, FloatArray]:
    """Joint angles {arm: (N, J)} of a path, turns included."""
    rows = np.arange(len(path.sample))
    return {arm: r.q[rows, path.sample] + r.turns[path.turn[arm]] for arm, r in rungs.items()}


TURN_CODE: Final = 16
"""Turns of joint j count CODE ** j."""


class Turns:
    """Penalties of the states of one arm by their whole turns, which are coded as one number."""

    def __init__(self, rungs: Rungs, states: list[IndexArray]) -> None:
        counts = np.round(rungs.turns / FULL_TURN).astype(np.intp)
        codes = counts @ (TURN_CODE ** np.arange(counts.shape[1]))
        self._least, span = int(codes.min()), int(codes.max() - codes.min()) + 1
        self._turns: dict[int, FloatArray] = {int(c): t for c, t in zip(codes, rungs.turns, strict=True)}
        self._place = np.full(span + 2, len(codes), dtype=np.intp)  # both ends: turns that are not allowed
        self._place[codes - self._least + 1] = np.arange(len(codes))
        self._penalty = [
            np.concatenate([rungs.penalty[k, s], np.full((len(s), 1), np.inf)], axis=1)
            for k, s in enumerate(states)
        ]
        self._codes = codes

    def starts(self) -> list[IndexArray]:
        """Turns of the first states that are tried: each one's best, then each of the turns for all."""
        best = self._codes[np.argmin(self._penalty[0][:, :-1], axis=1)]
        return [best, *(np.full(len(best), code, dtype=np.intp) for code in self._codes[1:])]

    def penalty(self, k: int, code: IndexArray) -> FloatArray:
        """Penalty (..., S) [s] of the states of rung k at turns (..., S), inf where these are not allowed."""
        place = self._place[np.clip(code - (self._least - 1), 0, len(self._place) - 1)]
        place += self._penalty[k].shape[1] * np.arange(code.shape[-1])
        return np.asarray(self._penalty[k].ravel()[place])

    def turn(self, code: int) -> FloatArray:
        """Turns (J,) [rad] of a code."""
        return self._turns[code]
