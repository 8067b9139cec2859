"""The wire as the real one moves: a discrete elastic rod with weight, followed from the mounted state.

Clamped at both ends to full frames (x along the wire, z the section plane's normal), of fixed
length. `mount` finds the shape the wire has when it is put in; `follow` carries it through the
motion of its ends. Where the shape in hand stops being stable, the real wire snaps to another one:
that instant is marked, and the rod goes on from the shape that it falls into. No closed form is
used: see `rod_energy` for the model.

What the shapes say in the world: points, frames, curvature, twist, tension, margins of stability.
The discrete rod is of second order in h = L / N. The same shapes are found once more with half the
segments, and both results are combined (Richardson: (4 fine - coarse) / 3), which leaves errors of
the order h^4 and tells the size of the error that was taken out.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from planner.geometry.arrays import BoolArray, FloatArray
from planner.processes.hotwire.proof.rod_energy import (
    Ends,
    conjugate,
    energy,
    exponential,
    joints,
    logarithm,
    matrix,
    multiply,
    quaternion,
    spacing,
)
from planner.processes.hotwire.proof.rod_equilibrium import (
    Outcome,
    State,
    moved,
    newton,
    newton_many,
    settle,
    weakest,
    weakest_many,
)


class RodError(ValueError):
    """No stable shape could be found for the mounted rod, or the input has no meaning."""


@dataclass(frozen=True)
class Rod:
    """A straight, weightless-when-`weight`-is-0 rod. Bending stiffnesses `soft` (about the frame's z) and
    `stiff` (about y) and `torsion` GJ in N m^2, `length` in m, `weight` per length in N/m, `segments` of
    the discrete rod.
    """

    length: float
    soft: float
    stiff: float
    torsion: float
    weight: float = 0.0
    segments: int = 64

    def __post_init__(self) -> None:
        numbers = (self.length, self.soft, self.stiff, self.torsion)
        if not all(math.isfinite(value) and value > 0 for value in numbers):
            raise RodError(f"length and stiffnesses must be above 0; got {numbers}")
        if not (
            math.isfinite(self.weight) and self.weight >= 0 and self.segments >= 8 and self.segments % 2 == 0
        ):
            raise RodError(f"weight must be >= 0, segments even and >= 8; got {self.weight}, {self.segments}")

    @property
    def stiffness(self) -> FloatArray:
        """(torsion, bending about y, bending about z) over `soft`."""
        return np.array([self.torsion, self.stiff, self.soft]) / self.soft


@dataclass(frozen=True)
class RodShape:
    """One shape: segment attitudes (4, N) wxyz in the start clamp's frame and the end's force (3,) in units
    of EI/L^2.
    """

    attitudes: FloatArray
    force: FloatArray


@dataclass(frozen=True)
class RodPath:
    """The rod at T instants, at N + 1 points of equal arc length.

    `points` (T, N+1, 3) [m] and `frames` (T, N+1, 3, 3) in the world. `curvature` (T, N+1, 2) about y and z
    and `twist` (T, N+1) [1/m], `tension` (T, N+1) [N]. `residual` (T,): error of the end's place [m].
    `error` (T,) [m]: how far refining moved the points (the discretisation error before it; that behind it
    is far smaller); inf where the coarser rod did not hold the shape and nothing was refined. `stable`
    (T,): the shape at the instant is a strict minimum of energy. `min_eig` (T,): smallest eigenvalue of the
    second variation over that of the first bending mode of a straight clamped rod (4 pi^2 EI / L^2 with
    `soft`); 0 where stability is lost. `jump` (T,): since the instant before, the rod lost its shape and
    fell into another one; `moved` (T,) [m]: how far its points then went (0 without a jump). `shapes`: to
    go on from any instant.
    """

    points: FloatArray
    frames: FloatArray
    curvature: FloatArray
    twist: FloatArray
    tension: FloatArray
    residual: FloatArray
    error: FloatArray
    stable: BoolArray
    min_eig: FloatArray
    jump: BoolArray
    moved: FloatArray
    shapes: tuple[RodShape, ...]


class Drive:
    """The ends' motion in units of the rod: at whole instants, and between them as a controller moves."""

    def __init__(self, rod: Rod, start: FloatArray, end: FloatArray, gravity: FloatArray) -> None:
        self.start, self.end = (np.asarray(frames, dtype=float) for frames in (start, end))
        if self.start.shape != self.end.shape or self.start.ndim != 3 or self.start.shape[1:] != (4, 4):
            raise RodError(f"start and end frames must be (T,4,4); got {self.start.shape}, {self.end.shape}")
        if len(self.start) == 0 or not (np.isfinite(self.start).all() and np.isfinite(self.end).all()):
            raise RodError("end frames must be finite numbers, at least one instant")
        direction = np.asarray(gravity, dtype=float)
        norm = float(np.linalg.norm(direction))
        self.weight = direction * (rod.weight * rod.length**3 / rod.soft / norm) if norm > 0 else np.zeros(3)
        self.length = rod.length
        self.q = [quaternion(np.moveaxis(frames[:, :3, :3], 0, -1)) for frames in (self.start, self.end)]
        self.p = [frames[:, :3, 3].T for frames in (self.start, self.end)]
        self.ends = self._relative(*self.p, *self.q)

    def _relative(self, pa: FloatArray, pb: FloatArray, qa: FloatArray, qb: FloatArray) -> Ends:
        turn = matrix(qa)
        place = np.einsum("jit,jt->it", turn, pb - pa) / self.length
        weight = np.einsum("jit,j->it", turn, self.weight)
        return Ends(place, multiply(conjugate(qa), qb), weight)

    def at(self, time: float) -> Ends:
        """The ends at a time between instants: positions linear, attitudes by the shortest turn."""
        k = min(int(time), self.start.shape[0] - 1)
        rest = time - k
        if rest <= 0.0:
            return self.ends.at(slice(k, k + 1))
        place = [p[:, k : k + 1] * (1.0 - rest) + p[:, k + 1 : k + 2] * rest for p in self.p]
        turns = []
        for q in self.q:
            a, b = q[:, k : k + 1], q[:, k + 1 : k + 2]
            turns.append(multiply(a, exponential(rest * logarithm(multiply(conjugate(a), b)))))
        return self._relative(*place, *turns)


def apart(a: State, b: State) -> float:
    """Largest angle between the segments of two states of one instant [rad]."""
    return float(apart_many(a.q, b.q)[0])


def apart_many(a: FloatArray, b: FloatArray) -> FloatArray:
    """Largest angles (T,) [rad] between the segments of rods of quaternions (4, N, T)."""
    dot = np.clip(np.abs((a * b).sum(axis=0)), 0.0, 1.0)
    found: FloatArray = 2.0 * np.arccos(dot.min(axis=0))
    return found


_STEP_TURN = 0.4  # most a segment may turn in one accepted step [rad]


def mount(
    rod: Rod,
    start: FloatArray,
    end: FloatArray,
    gravity: FloatArray,
    turning: float | None = None,
    bow: float | None = None,
) -> RodShape:
    """The stable shape of a rod mounted between two frames (4, 4).

    The rod starts as a planar curve that turns by `turning` [rad] about the plane's normal (default: the
    least turn between the frames) and bows to the side `bow` (+1 or -1: towards y or away; default: the one
    of less bending), and its end and weight are then brought to where they are. Raises `RodError` when no
    stable shape is found.
    """
    drive = Drive(rod, np.asarray(start)[None], np.asarray(end)[None], gravity)
    goal = drive.ends
    distance = float(np.linalg.norm(goal.place))
    if distance >= 1.0:
        got = f"{distance * rod.length * 1e3:.4f} mm apart"
        raise RodError(f"the ends are {got}; a rod of {rod.length * 1e3:.4f} mm must be longer than that")
    rotation = _rotation(logarithm(goal.turn)[:, 0], turning)
    sides = (1.0, -1.0) if bow is None else (math.copysign(1.0, bow),)
    found: list[tuple[float, RodShape]] = []
    for side in sides:
        outcome = _brought(rod, _first(rod, rotation, distance, side), goal)
        if outcome.good[0]:
            state = outcome.state
            value = float(energy(rod.stiffness, state.q, goal)[0])
            found.append((value, RodShape(state.q[..., 0], state.force[:, 0])))
    if not found:
        raise RodError(
            "no stable shape found for the mounted rod; give another turning or bow, or other end frames"
        )
    least = min(value for value, _ in found)
    return next(shape for value, shape in found if value <= least + 1e-9 * (1.0 + abs(least)))


def _first(rod: Rod, rotation: FloatArray, distance: float, side: float) -> State:
    middle = (np.arange(rod.segments) + 0.5) / rod.segments
    size = _bow(rotation[2], distance, middle, side)
    wave = np.outer([0.0, 0.0, 1.0], size * np.sin(2.0 * np.pi * middle))
    q = multiply(exponential(np.outer(rotation, middle)), exponential(wave))[..., None]
    return State(q, np.zeros((3, 1)))


def _brought(rod: Rod, state: State, goal: Ends) -> Outcome:
    """The shape after the end went from its place in `state` to the wanted one, and the weight from 0."""
    first = matrix(state.q)[:, 0].mean(axis=1)
    outcome = settle(rod.stiffness, state, Ends(first, goal.turn, 0.0 * goal.weight))
    done, step = 0.0, 0.1
    while outcome.good[0] and done < 1.0:
        part = min(1.0, done + step)
        ends = Ends(first + part * (goal.place - first), goal.turn, part * goal.weight)
        trial = newton(rod.stiffness, outcome.state, ends)
        if trial.good[0] and apart(outcome.state, trial.state) < _STEP_TURN:
            outcome, done, step = trial, part, min(2.0 * step, 0.25)
        elif step > 0.02:
            step *= 0.5
        else:
            outcome, done = settle(rod.stiffness, outcome.state, ends), part
    return outcome


def _rotation(vector: FloatArray, turning: float | None) -> FloatArray:
    """The rotation vector that means the same attitude as `vector` and turns about z most nearly by
    `turning`.
    """
    if turning is None:
        return vector
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 1e-6 else np.array([0.0, 0.0, 1.0])
    rounds = [vector + axis * 2.0 * math.pi * k for k in range(-3, 4)]
    return min(rounds, key=lambda found: abs(float(found[2]) - turning))


def _bow(turning: float, distance: float, middle: FloatArray, side: float) -> float:
    """Size a [rad] of theta = turning s + a sin(2 pi s) with its ends `distance` apart, to one side."""

    def excess(size: float) -> float:
        theta = turning * middle + size * np.sin(2.0 * np.pi * middle)
        return math.hypot(float(np.cos(theta).mean()), float(np.sin(theta).mean())) - distance

    sizes = [math.copysign(0.05, side) * k for k in range(71)]
    misses = [excess(size) for size in sizes]
    for k in range(70):
        if misses[k] * misses[k + 1] <= 0.0:
            return float(brentq(excess, sizes[k], sizes[k + 1], xtol=1e-14))
    return sizes[int(np.argmin(np.abs(misses)))]


_INSTANTS_AT_ONCE = 512  # instants at once, for bounded memory
_COARSE_DIFFERENCE = 0.2  # most by which the coarser rod's shape may differ from the finer one's [rad]


class _Measures(NamedTuple):
    """In the start frame and in units of the rod: `nodes` (3, N+1, T), `rate` (3, N+1, T), `tension` (N+1,
    T).
    """

    nodes: FloatArray
    rate: FloatArray
    tension: FloatArray


def measured(
    rod: Rod, drive: Drive, state: State, good: BoolArray, jump: BoolArray, moved: FloatArray
) -> RodPath:
    """The path of the shapes `state` at all instants of `drive`."""
    ends, length, count = drive.ends, rod.length, state.q.shape[2]
    parts, least, errors = [], [], []
    for at in range(0, count, _INSTANTS_AT_ONCE):
        some = slice(at, at + _INSTANTS_AT_ONCE)
        here, place = State(state.q[..., some], state.force[:, some]), ends.at(some)
        least.append(weakest_many(rod.stiffness, here, place))
        part, error = _refined(rod.stiffness, here, place)
        parts.append(part)
        errors.append(error)
    nodes, rate, tension = (np.concatenate(items, axis=-1) for items in zip(*parts, strict=True))
    eigenvalue = np.concatenate(least)
    for k in np.flatnonzero(~good):
        one = slice(k, k + 1)
        eigenvalue[k] = weakest(rod.stiffness, State(state.q[..., one], state.force[:, one]), ends.at(one))[0]
    frame = matrix(drive.q[0])
    last = matrix(state.q)[:, 0].mean(axis=1) - ends.place
    return RodPath(
        points=length * np.einsum("ijt,jkt->tki", frame, nodes) + drive.start[:, None, :3, 3],
        frames=np.einsum("ijt,jlkt->tkil", frame, matrix(_at_nodes(state.q, ends))),
        curvature=np.moveaxis(rate[1:], (0, 1, 2), (2, 1, 0)) / length,
        twist=rate[0].T / length,
        tension=tension.T * rod.soft / length**2,
        residual=length * np.sqrt((last * last).sum(axis=0)),
        error=length * np.concatenate(errors),
        stable=good,
        min_eig=eigenvalue / (4.0 * math.pi**2),
        jump=jump,
        moved=moved,
        shapes=tuple(RodShape(state.q[..., k], state.force[:, k]) for k in range(count)),
    )


def _refined(stiffness: FloatArray, state: State, ends: Ends) -> tuple[_Measures, FloatArray]:
    fine = _measures(state, ends)
    left, right = state.q[:, ::2], state.q[:, 1::2]
    half = left + np.where((left * right).sum(axis=0) < 0.0, -right, right)
    half /= np.sqrt((half * half).sum(axis=0))
    outcome = newton_many(stiffness, State(half, state.force), ends)
    same = outcome.good & outcome.steady & (apart_many(half, outcome.state.q) < _COARSE_DIFFERENCE)
    coarse = _measures(outcome.state, ends)
    n = state.q.shape[1]
    even, every = np.linspace(0.0, 1.0, n // 2 + 1), np.linspace(0.0, 1.0, n + 1)
    better = []
    for a, b in zip(fine, coarse, strict=True):
        change = np.where(same, (a[..., ::2, :] - b) / 3.0, 0.0)
        better.append(a + CubicSpline(even, change, axis=-2)(every))
    shift = better[0] - fine.nodes
    return _Measures(*better), np.where(same, np.sqrt((shift * shift).sum(axis=0)).max(axis=0), np.inf)


def _at_nodes(q: FloatArray, ends: Ends) -> FloatArray:
    """Attitudes (4, N + 1, T) at the points: the clamps' own, and half-way between neighbouring segments."""
    left, right = q[:, :-1], q[:, 1:]
    inner = left + np.where((left * right).sum(axis=0) < 0.0, -right, right)
    inner = inner / np.sqrt((inner * inner).sum(axis=0))
    start = np.zeros_like(q[:, :1])
    start[0] = 1.0
    return np.concatenate([start, inner, ends.turn[:, None]], axis=1)


def _measures(state: State, ends: Ends) -> _Measures:
    n = state.q.shape[1]
    steps = matrix(state.q)[:, 0] / n
    nodes = np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)
    p = joints(state.q, ends.turn)
    rate = p[1:] * ((8.0 - 2.0 * p[0]) / 3.0) / spacing(n)[:, None]
    # the outer joints belong to the clamps' half segments; a cubic through the inner ones is as smooth as
    # they are
    rate[:, 0] = 4.0 * rate[:, 1] - 6.0 * rate[:, 2] + 4.0 * rate[:, 3] - rate[:, 4]
    rate[:, -1] = 4.0 * rate[:, -2] - 6.0 * rate[:, -3] + 4.0 * rate[:, -4] - rate[:, -5]
    tangent = matrix(_at_nodes(state.q, ends))[:, 0]
    force = state.force[:, None] + ends.weight[:, None] * np.linspace(1.0, 0.0, n + 1)[:, None]
    return _Measures(nodes, rate, (tangent * force).sum(axis=0))


_STRIDE = 8  # instants between those that are followed one after the other
_GUESS_DIFFERENCE = 0.15  # most a shape may differ from the one between its neighbours [rad]
_LEAST_STEP = 1.0 / 64.0  # of the way from one instant to the next


@dataclass
class _Found:
    """States by instant, as they are found."""

    q: FloatArray
    force: FloatArray
    jump: BoolArray
    moved: FloatArray
    good: BoolArray

    def put(self, k: int, state: State, good: bool) -> None:
        self.q[..., k], self.force[:, k], self.good[k] = state.q[..., 0], state.force[:, 0], good

    def get(self, k: int) -> State:
        return State(self.q[..., k : k + 1], self.force[:, k : k + 1])


def follow(
    rod: Rod,
    start_frames: FloatArray,
    end_frames: FloatArray,
    gravity: FloatArray,
    initial: RodShape,
    stride: int = _STRIDE,
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
            elif step > _LEAST_STEP:
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
    return bool(outcome.good[0] and outcome.steady[0]) and apart(state, outcome.state) < _STEP_TURN


def _too_far(ends: Ends) -> bool:
    return float(np.linalg.norm(ends.place)) >= 1.0 - 1e-12


def _last(state: State, outcome: Outcome) -> State:
    """Where to fall from: an equilibrium near by that has become unstable, else the last stable shape."""
    near = outcome.converged[0] and apart(state, outcome.state) < _STEP_TURN
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
            outcome.good
            & outcome.steady
            & (apart_many(guess.q[..., some], outcome.state.q) < _GUESS_DIFFERENCE)
        )
        found.q[..., which[some]], found.force[:, which[some]] = outcome.state.q, outcome.state.force
    found.good[which] = good
    for a, b in spans:
        if not found.good[a + 1 : b].all():
            failed.append((a, b))
    return failed
