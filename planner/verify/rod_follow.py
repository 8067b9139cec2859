"""Continuation of a rod's shape through the motion of its ends."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planner.verify.rod_energy import Array, Ends, conjugate, logarithm, matrix, multiply
from planner.verify.rod_model import Drive, Rod, RodError, RodPath, RodShape, apart, apart_many
from planner.verify.rod_path import measured
from planner.verify.rod_solve import Outcome, State, moved, newton, newton_many, settle

_STRIDE = 8  # instants between those that are followed one after the other
_TURN = 0.4  # most a segment may turn in one accepted step [rad]
_GUESS = 0.15  # most a shape may differ from the one between its neighbours [rad]
_FINEST = 1.0 / 64.0  # of the way from one instant to the next


@dataclass
class _Found:
    """States by instant, as they are found."""

    q: Array
    force: Array
    jump: NDArray[np.bool_]
    moved: Array
    good: NDArray[np.bool_]

    def put(self, k: int, state: State, good: bool) -> None:
        self.q[..., k], self.force[:, k], self.good[k] = state.q[..., 0], state.force[:, 0], good

    def get(self, k: int) -> State:
        return State(self.q[..., k : k + 1], self.force[:, k : k + 1])


def follow(
    rod: Rod, start_frames: Array, end_frames: Array, gravity: Array, initial: RodShape, stride: int = _STRIDE
) -> RodPath:
    """Carry the rod from `initial` through the frames (T, 4, 4) of its ends; `gravity` (3,) gives the
    direction only.

    Every `stride`-th instant is found from the one before it, in smaller steps where the shape changes
    fast; those between are found all at once and belong to the same branch (near the shape between their
    neighbours, and stable).
    """
    drive = Drive(rod, start_frames, end_frames, gravity)
    count, n = len(drive.start), initial.attitudes.shape[1]
    if n != rod.segments:
        raise RodError(f"the initial shape has {n} segments, the rod {rod.segments}")
    flags = np.zeros(count, dtype=bool)
    found = _Found(np.zeros((4, n, count)), np.zeros((3, count)), flags, np.zeros(count), flags.copy())
    state = State(initial.attitudes[..., None], initial.force[:, None])
    _stand(rod, drive, found, 0, state)
    marks = [*range(0, count, max(1, stride))]
    marks += [count - 1] if marks[-1] != count - 1 else []
    todo: list[tuple[int, int]] = []
    for a, b in pairwise(marks):
        direct = newton(rod.stiffness, found.get(a), drive.at(float(b)))
        if b - a > 1 and _continues(found.get(a), direct):
            found.put(b, direct.state, True)
            todo.append((a, b))
        else:
            _walk(rod, drive, found, a, b)
    for a, b in _between(rod, drive, found, todo):
        _walk(rod, drive, found, a, b)
    return measured(rod, drive, State(found.q, found.force), found.good, found.jump, found.moved)


def _stand(rod: Rod, drive: Drive, found: _Found, k: int, state: State) -> None:
    """Take `state` to the ends of instant k on the spot; a jump where that takes another shape."""
    ends = drive.at(float(k))
    outcome = newton(rod.stiffness, state, ends)
    if _too_far(ends):
        found.put(k, state, False)
        return
    if not _continues(state, outcome):
        outcome = settle(rod.stiffness, state, ends)
        found.jump[k] = True
        found.moved[k] = rod.length * _distance(state, outcome.state)
    found.put(k, outcome.state, bool(outcome.good[0]))


def _walk(rod: Rod, drive: Drive, found: _Found, a: int, b: int) -> None:
    """From instant a to b, one after the other, with smaller steps where needed; jumps are marked."""
    state, good = found.get(a), bool(found.good[a])
    for k in range(a, b):
        time, step = float(k), 1.0
        while time < k + 1:
            goal = min(time + step, k + 1.0)
            outcome = newton(rod.stiffness, state, drive.at(goal))
            if _continues(state, outcome):
                state, time, step, good = outcome.state, goal, 2.0 * step, True
            elif step > _FINEST:
                step *= 0.5
            elif _too_far(drive.at(goal)):  # the ends pull the wire out of its clamps: no shape exists
                time, good = goal, False
            else:
                fallen = settle(rod.stiffness, _last(state, outcome), drive.at(goal))
                found.jump[k + 1] = True
                found.moved[k + 1] += rod.length * _distance(state, fallen.state)
                state, time, good = fallen.state, goal, bool(fallen.good[0])
        found.put(k + 1, state, good)


def _continues(state: State, outcome: Outcome) -> bool:
    """Whether the outcome is stable and the same shape carried on."""
    return bool(outcome.good[0] and outcome.steady[0]) and apart(state, outcome.state) < _TURN


def _too_far(ends: Ends) -> bool:
    return float(np.linalg.norm(ends.place)) >= 1.0 - 1e-12


def _last(state: State, outcome: Outcome) -> State:
    """Where to fall from: an equilibrium near by that has become unstable, else the last stable shape."""
    near = outcome.converged[0] and apart(state, outcome.state) < _TURN
    return outcome.state if near else state


def _distance(a: State, b: State) -> float:
    """Largest distance between the points of two states of one instant, in units of the length."""
    n = a.q.shape[1]
    gap = np.cumsum(matrix(a.q)[:, 0] - matrix(b.q)[:, 0], axis=1) / n
    return float(np.sqrt((gap * gap).sum(axis=0)).max())


def _between(rod: Rod, drive: Drive, found: _Found, spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """All instants inside the spans at once; gives the spans where that failed."""
    inside = [np.arange(a + 1, b) for a, b in spans]
    if not inside:
        return []
    which = np.concatenate(inside)
    left = np.concatenate([np.full(b - a - 1, a) for a, b in spans])
    right = np.concatenate([np.full(b - a - 1, b) for a, b in spans])
    part = (which - left) / (right - left)
    qa, qb = found.q[..., left], found.q[..., right]
    guess = moved(
        State(qa, found.force[:, left]),
        part * logarithm(multiply(conjugate(qa), qb)),
        part * (found.force[:, right] - found.force[:, left]),
    )
    failed: list[tuple[int, int]] = []
    good = np.zeros(len(which), dtype=bool)
    for at in range(0, len(which), 512):  # bounded memory
        some = slice(at, at + 512)
        outcome = newton_many(
            rod.stiffness, State(guess.q[..., some], guess.force[:, some]), drive.ends.at(which[some])
        )
        good[some] = (
            outcome.good & outcome.steady & (apart_many(guess.q[..., some], outcome.state.q) < _GUESS)
        )
        found.q[..., which[some]], found.force[:, which[some]] = outcome.state.q, outcome.state.force
    found.good[which] = good
    for a, b in spans:
        if not found.good[a + 1 : b].all():
            failed.append((a, b))
    return failed
