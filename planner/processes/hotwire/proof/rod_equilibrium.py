"""Equilibria of the discrete rod: Newton for one instant (dense, pivoted) and for many at once (block
elimination).

Stability is read from the inertia of the saddle-point matrix: the energy has a strict minimum under the
three conditions on the end's place if and only if the matrix has exactly three negative eigenvalues (Gould,
Mathematical Programming 32, 1985).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, lapack

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.processes.hotwire.proof.rod_energy import (
    Derivatives,
    Ends,
    derivatives,
    energy,
    exponential,
    matrix,
    multiply,
)

CONVERGED = 1e-9  # rotation [rad] of the last Newton step; the error left is of its square
# raises all eigenvalues a little: neutral shapes count as stable, and Newton does not drift along them
EIGENVALUE_LIFT = 1e-6 * 4.0 * np.pi**2
_LONGEST_ROTATION = 0.5  # longest rotation [rad] of a segment in one Newton step
_SECOND_STEP_SHARE = 0.3  # most that the second Newton step may be of the first, ...
_SMALL_ROTATION = 2e-3  # ... or this rotation [rad]


@dataclass(frozen=True)
class State:
    """Attitudes `q` (4, N, T) and end forces `force` (3, T), in the start clamp's frame, in units of L and
    EI.
    """

    q: FloatArray
    force: FloatArray


@dataclass(frozen=True)
class Outcome:
    """`state`; by instant: `converged`, `negatives` (eigenvalues below 0 beyond the three of the
    conditions), `steady` (the second Newton step was much shorter than the first, so the shape found is the
    continuation of the guess).
    """

    state: State
    converged: BoolArray
    negatives: IndexArray
    steady: BoolArray

    @property
    def good(self) -> BoolArray:
        """Converged to a stable shape, by instant."""
        found: BoolArray = self.converged & (self.negatives == 0)
        return found


def moved(state: State, rotation: FloatArray, force: FloatArray) -> State:
    """The state after the segments turned by `rotation` (3, N, T) and the force changed by `force` (3, T)."""
    return State(multiply(state.q, exponential(rotation)), state.force + force)


# ---- one instant -------------------------------------------------------------------------------------------


def saddle(parts: Derivatives, lift: float = 0.0) -> FloatArray:
    """The symmetric matrix (3N + 3, 3N + 3) of one instant's Newton step, its second variation raised by
    `lift`.
    """
    n = parts.gradient.shape[1]
    full = np.zeros((3 * n + 3, 3 * n + 3))
    blocks = full[: 3 * n, : 3 * n].reshape(n, 3, n, 3)
    index = np.arange(n)
    blocks[index, :, index, :] = np.moveaxis(parts.diagonal[..., 0], -1, 0)
    beside = np.moveaxis(parts.beside[..., 0], -1, 0)
    blocks[index[:-1], :, index[1:], :] = beside
    blocks[index[1:], :, index[:-1], :] = beside.transpose(0, 2, 1)
    slope = parts.slope[..., 0].transpose(0, 2, 1).reshape(3, 3 * n)
    inside = np.arange(3 * n)
    full[inside, inside] += lift / n
    full[3 * n :, : 3 * n] = -slope
    full[: 3 * n, 3 * n :] = -slope.T
    return full


def factor(full: FloatArray) -> tuple[FloatArray, NDArray[np.intc], int]:
    """Bunch-Kaufman factors and the number of negative eigenvalues."""
    ldu, pivots, _ = lapack.dsytrf(full, lower=1, lwork=64 * len(full))
    single = pivots > 0  # each 2 x 2 pivot has one eigenvalue of either sign
    negatives = int((np.diagonal(ldu)[single] < 0.0).sum()) + int((~single).sum()) // 2
    return ldu, pivots, negatives


def newton(stiffness: FloatArray, state: State, ends: Ends, rounds: int = 12) -> Outcome:
    """Newton from `state` for one instant (T = 1)."""
    n = state.q.shape[1]
    first, steady = 0.0, True
    for count in range(rounds):
        parts = derivatives(stiffness, state.q, state.force, ends)
        ldu, pivots, negatives = factor(saddle(parts, EIGENVALUE_LIFT))
        right = np.concatenate([-parts.gradient[..., 0].T.ravel(), parts.gap[:, 0]])
        step, fault = lapack.dsytrs(ldu, pivots, right, lower=1)
        if fault or not np.isfinite(step).all():
            break
        rotation = step[: 3 * n].reshape(n, 3).T[..., None]
        largest = float(np.abs(rotation).max())
        first = largest if count == 0 else first
        steady = steady and (count != 1 or largest <= max(_SECOND_STEP_SHARE * first, _SMALL_ROTATION))
        short = min(1.0, _LONGEST_ROTATION / max(largest, 1e-300))
        state = moved(state, short * rotation, short * step[3 * n :, None])
        if largest < CONVERGED:
            return Outcome(state, np.array([True]), np.array([negatives - 3]), np.array([steady]))
    return Outcome(state, np.array([False]), np.array([0]), np.array([False]))


def weakest(stiffness: FloatArray, state: State, ends: Ends) -> tuple[float, FloatArray]:
    """Smallest eigenvalue of the second variation on the shapes that keep the end's place, and its
    rotations (3, N).

    Normalised by int |rotation|^2 ds; in units of EI / L^2.
    """
    n = state.q.shape[1]
    full = saddle(derivatives(stiffness, state.q, state.force, ends))
    hessian, slope = full[: 3 * n, : 3 * n], -full[3 * n :, : 3 * n]
    basis = np.linalg.qr(slope.T, mode="complete")[0][:, 3:]
    value, vector = eigh(basis.T @ hessian @ basis, subset_by_index=[0, 0])
    return float(value[0]) * n, (basis @ vector[:, 0]).reshape(n, 3).T


def settle(stiffness: FloatArray, state: State, ends: Ends, rounds: int = 200) -> Outcome:
    """Go down to a stable shape for one instant, from a state that need not be near one.

    Newton steps on the Hessian raised until it is positive on the conditions and the energy falls; after each
    step the end is brought back to its place. From an unstable equilibrium the first step goes along its
    weakest mode.
    """
    n = state.q.shape[1]
    found = newton(stiffness, state, ends)
    if found.good[0]:
        return found
    if found.converged[0]:
        mode = weakest(stiffness, found.state, ends)[1]
        state = moved(found.state, (0.05 / np.abs(mode).max() * mode)[..., None], np.zeros((3, 1)))
    state = _restored(state, ends)
    lift, before = 0.0, float(energy(stiffness, state.q, ends)[0])
    parts = derivatives(stiffness, state.q, state.force, ends)
    for _ in range(rounds):
        ldu, pivots, negatives = factor(saddle(parts, EIGENVALUE_LIFT + lift * n))
        while negatives != 3 and lift < 1e6:
            lift = max(4.0 * lift, 0.1 / n)
            ldu, pivots, negatives = factor(saddle(parts, EIGENVALUE_LIFT + lift * n))
        right = np.concatenate([-parts.gradient[..., 0].T.ravel(), parts.gap[:, 0]])
        step, _ = lapack.dsytrs(ldu, pivots, right, lower=1)
        rotation, force = step[: 3 * n].reshape(n, 3).T[..., None], step[3 * n :, None]
        largest = float(np.abs(rotation).max())
        if (largest < 1e-3 and lift == 0.0) or lift >= 1e6:
            break
        trial = _restored(moved(state, min(1.0, 0.4 / max(largest, 1e-300)) * rotation, force), ends)
        after = float(energy(stiffness, trial.q, ends)[0])
        if after < before:
            state, before = trial, after
            parts = derivatives(stiffness, state.q, state.force, ends)
            lift = 0.0 if lift < 0.1 / n else 0.25 * lift
        else:
            lift = max(4.0 * lift, 0.1 / n)
    return newton(stiffness, state, ends)


def _restored(state: State, ends: Ends) -> State:
    """The state with its end brought to its place by the least rotations."""
    n = state.q.shape[1]
    for _ in range(40):
        turn = matrix(state.q)
        miss = turn[:, 0].sum(axis=1) / n - ends.place
        if float(np.abs(miss).max()) < 1e-11:
            break
        slope = np.stack([0.0 * turn[:, 0], -turn[:, 2], turn[:, 1]], axis=1) / n
        square = np.einsum("ijkt,ljkt->il", slope, slope)
        rotation = -np.einsum("ijkt,i->jkt", slope, np.linalg.lstsq(square, miss[:, 0], rcond=1e-12)[0])
        rotation *= min(1.0, 0.3 / max(float(np.abs(rotation).max()), 1e-300))
        state = moved(state, rotation, np.zeros((3, 1)))
    return state


# ---- many instants at once ---------------------------------------------------------------------------------


class Elimination:
    """Block elimination of the saddle-point matrices of T instants, for any number of right-hand sides."""

    def __init__(self, parts: Derivatives, lift: float = EIGENVALUE_LIFT) -> None:
        self.n = n = parts.gradient.shape[1]
        raised = parts.diagonal + (lift / n) * np.eye(3)[:, :, None, None]
        self.slope = parts.slope
        below = np.zeros(parts.gradient.shape[2], dtype=np.intp)
        self.inverse: list[FloatArray] = []
        self.factors: list[FloatArray] = []  # inverse pivot times the block beside it
        pivot = raised[:, :, 0]
        for k in range(n):
            inverse, negative = _inverse(pivot)
            below += negative
            self.inverse.append(inverse)
            if k + 1 < n:
                beside = parts.beside[:, :, k]
                self.factors.append(_mul(inverse, beside))
                pivot = raised[:, :, k + 1] - _mul_t(beside, self.factors[k])
        slope_t = np.moveaxis(parts.slope, 0, 1)  # (3 rows of a block, 3 conditions, N, T)
        self.spread = self.blocks(slope_t)
        schur = np.einsum("ijkt,jlkt->ilt", parts.slope, self.spread)
        self.schur_inverse, negative = _inverse(0.5 * (schur + schur.transpose(1, 0, 2)))
        self.negatives = below + (3 - negative) - 3

    def blocks(self, right: FloatArray) -> FloatArray:
        """Hessian^-1 times `right` (3, m, N, T)."""
        found = np.empty_like(right)
        run = right[:, :, 0]
        found[:, :, 0] = run
        for k in range(1, self.n):
            run = right[:, :, k] - _mul_t(self.factors[k - 1], run)
            found[:, :, k] = run
        run = _mul(self.inverse[-1], found[:, :, -1])
        found[:, :, -1] = run
        for k in range(self.n - 2, -1, -1):
            run = _mul(self.inverse[k], found[:, :, k]) - _mul(self.factors[k], run)
            found[:, :, k] = run
        return found

    def solve(self, right: FloatArray, gap: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (3, N, T) and forces (3, T) of H r - C^T f = right, -C r = gap."""
        free = self.blocks(right[:, None])[:, 0]
        miss = gap + np.einsum("ijkt,jkt->it", self.slope, free)
        force = -np.einsum("ijt,jt->it", self.schur_inverse, miss)
        return free + np.einsum("ijkt,jt->ikt", self.spread, force), force


def newton_many(stiffness: FloatArray, state: State, ends: Ends, rounds: int = 8) -> Outcome:
    """Newton for T instants at once, each from its own state."""
    converged = np.zeros(ends.place.shape[1], dtype=bool)
    negatives = np.zeros(ends.place.shape[1], dtype=np.intp)
    q, total = state.q.copy(), state.force.copy()
    left = np.arange(len(converged))
    first, steady = np.zeros(len(left)), np.ones(len(left), dtype=bool)
    for count in range(rounds):
        if len(left) == 0:
            break
        part, here = State(q[:, :, left], total[:, left]), ends.at(left)
        parts = derivatives(stiffness, part.q, part.force, here)
        with np.errstate(all="ignore"):
            work = Elimination(parts)
            rotation, force = work.solve(-parts.gradient, parts.gap)
        sound = np.isfinite(rotation).all(axis=(0, 1)) & np.isfinite(force).all(axis=0)
        rotation, force = np.where(sound, rotation, 0.0), np.where(sound, force, 0.0)
        largest = np.abs(rotation).max(axis=(0, 1))
        if count == 0:
            first[left] = largest
        if count == 1:
            steady[left] = largest <= np.maximum(_SECOND_STEP_SHARE * first[left], _SMALL_ROTATION)
        short = np.minimum(1.0, _LONGEST_ROTATION / np.maximum(largest, 1e-300))
        part = moved(part, short * rotation, short * force)
        q[:, :, left], total[:, left] = part.q, part.force
        done = sound & (largest < CONVERGED)
        converged[left[done]] = True
        negatives[left[done]] = work.negatives[done]
        left = left[sound & ~done]
    return Outcome(State(q, total), converged, negatives, steady)


def weakest_many(stiffness: FloatArray, state: State, ends: Ends, rounds: int = 12) -> FloatArray:
    """Eigenvalue nearest to 0 (T,) of the second variation (see `weakest`), by inverse iteration."""
    parts = derivatives(stiffness, state.q, state.force, ends)
    work = Elimination(parts)
    n, instants = state.q.shape[1], state.q.shape[2]
    s = (np.arange(n) + 0.5) / n
    mode = np.stack([np.sin(3.0 * s + i) + s * (1.0 + i) for i in range(3)])[..., None] * np.ones(instants)
    value = np.zeros(instants)
    for _ in range(rounds):
        mode /= np.sqrt((mode * mode).sum(axis=(0, 1)) / n)
        after, _ = work.solve(mode / n, np.zeros((3, instants)))
        value = 1.0 / ((mode * after).sum(axis=(0, 1)) / n)
        mode = after
    return value - EIGENVALUE_LIFT


def _mul(a: FloatArray, b: FloatArray) -> FloatArray:
    """a b for (3, 3, T) and (3, m, T)."""
    found: FloatArray = a[:, 0, None] * b[None, 0] + a[:, 1, None] * b[None, 1] + a[:, 2, None] * b[None, 2]
    return found


def _mul_t(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a^T b for (3, 3, T) and (3, m, T)."""
    found: FloatArray = a[0, :, None] * b[None, 0] + a[1, :, None] * b[None, 1] + a[2, :, None] * b[None, 2]
    return found


def _inverse(a: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Inverse of symmetric (3, 3, T) and the number of negative eigenvalues (T,), from the leading minors."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    second = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    c11 = a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]
    c12 = a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
    found = np.empty_like(a)
    found[0, 0], found[1, 1], found[2, 2] = c00, c11, second
    found[0, 1] = found[1, 0] = c01
    found[0, 2] = found[2, 0] = c02
    found[1, 2] = found[2, 1] = c12
    found /= determinant
    signs = [a[0, 0] < 0, (second < 0) != (a[0, 0] < 0), (determinant < 0) != (second < 0)]
    return found, np.sum(signs, axis=0)
