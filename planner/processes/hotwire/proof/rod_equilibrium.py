"""Equilibria of the discrete rod by Newton's method.

For one instant the Newton matrix is dense and factored with pivots. For many instants at once it is factored
by block elimination.

Stability follows from the inertia of the saddle-point matrix: the energy has a strict minimum under the three
conditions on the end's position if and only if the matrix has exactly three negative eigenvalues (Gould,
Mathematical Programming 32, 1985).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, lapack

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.processes.hotwire.proof.rod_energy import (
    RodDerivatives,
    RodEnds,
    quaternion_exp,
    quaternion_product,
    rod_derivatives,
    rod_energy,
    rotation_matrix,
)

# largest rotation [rad] in the last Newton step; the remaining error is of the order of its square
ROTATION_TOLERANCE_RAD = 1e-9
# raises all eigenvalues slightly (by 1e-6 of the first bending mode of a straight clamped rod): neutral
# shapes count as stable, and Newton does not drift along them
EIGENVALUE_LIFT = 1e-6 * 4.0 * np.pi**2
_MAX_ROTATION_RAD = 0.5  # maximum rotation [rad] of a segment in one Newton step
_MAX_SECOND_STEP_RATIO = 0.3  # maximum ratio of the second to the first Newton step of a steady solution
_MAX_STEADY_ROTATION_RAD = 2e-3  # rotation [rad] of the second Newton step that is always accepted as steady


@dataclass(frozen=True)
class RodState:
    """State of a rod at T instants, in the start clamp's frame, in units of L and EI.

    Attributes:
        attitudes: Attitudes (4, N, T).
        force: Forces at the end (3, T).
    """

    attitudes: FloatArray
    force: FloatArray


@dataclass(frozen=True)
class NewtonResult:
    """Result of a solver at T instants.

    Attributes:
        state: The states.
        converged: Whether Newton converged (T,).
        excess_negatives: Number of negative eigenvalues of the saddle-point matrix, minus the three that the
            conditions on the end's position cause (T,). 0 for a stable shape.
        is_continuation: Whether the second Newton step was much shorter than the first, so that the shape is
            the continuation of the guess (T,).
    """

    state: RodState
    converged: BoolArray
    excess_negatives: IndexArray
    is_continuation: BoolArray

    @property
    def is_stable(self) -> BoolArray:
        """Whether the solver converged to a stable shape (T,)."""
        result: BoolArray = self.converged & (self.excess_negatives == 0)
        return result


def apply_step(state: RodState, rotation: FloatArray, force: FloatArray) -> RodState:
    """Return the state after rotations of the segments (3, N, T) and a change of the force (3, T)."""
    return RodState(quaternion_product(state.attitudes, quaternion_exp(rotation)), state.force + force)


# ---- one instant -------------------------------------------------------------------------------------------


def saddle_matrix(parts: RodDerivatives, lift: float = 0.0) -> FloatArray:
    """Return the symmetric matrix (3N + 3, 3N + 3) of one instant's Newton step.

    Args:
        parts: Derivatives of one instant.
        lift: Amount that is added to all eigenvalues of the second variation, as `weakest_mode` scales them.
    """
    # (H + lift h 1, -C^T; -C, 0) (rotations; force) = (-gradient; end error), C = d(end position)
    n = parts.gradient.shape[1]
    full = np.zeros((3 * n + 3, 3 * n + 3))
    blocks = full[: 3 * n, : 3 * n].reshape(n, 3, n, 3)
    index = np.arange(n)
    blocks[index, :, index, :] = np.moveaxis(parts.diagonal[..., 0], -1, 0)
    off_diagonal = np.moveaxis(parts.off_diagonal[..., 0], -1, 0)
    blocks[index[:-1], :, index[1:], :] = off_diagonal
    blocks[index[1:], :, index[:-1], :] = off_diagonal.transpose(0, 2, 1)
    slope = parts.end_jacobian[..., 0].transpose(0, 2, 1).reshape(3, 3 * n)
    unknown = np.arange(3 * n)
    full[unknown, unknown] += lift / n
    full[3 * n :, : 3 * n] = -slope
    full[: 3 * n, 3 * n :] = -slope.T
    return full


def factorise(full: FloatArray) -> tuple[FloatArray, NDArray[np.intc], int]:
    """Return the Bunch-Kaufman factors, their pivots, and the number of negative eigenvalues."""
    ldu, pivots, _ = lapack.dsytrf(full, lower=1, lwork=64 * len(full))
    single = pivots > 0  # each 2 x 2 pivot has one eigenvalue of either sign
    negatives = int((np.diagonal(ldu)[single] < 0.0).sum()) + int((~single).sum()) // 2
    return ldu, pivots, negatives


def solve_newton(stiffness: FloatArray, state: RodState, ends: RodEnds, rounds: int = 12) -> NewtonResult:
    """Run Newton from a state for one instant (T = 1).

    Args:
        stiffness: Torsion and bending stiffnesses (3,).
        state: Initial state.
        ends: The clamps.
        rounds: Maximum number of iterations.
    """
    n = state.attitudes.shape[1]
    first_step, is_continuation = 0.0, True
    for iteration in range(rounds):
        parts = rod_derivatives(stiffness, state.attitudes, state.force, ends)
        ldu, pivots, negatives = factorise(saddle_matrix(parts, EIGENVALUE_LIFT))
        right_side = np.concatenate([-parts.gradient[..., 0].T.ravel(), parts.end_error[:, 0]])
        step, fault = lapack.dsytrs(ldu, pivots, right_side, lower=1)
        if fault or not np.isfinite(step).all():
            break
        rotation = step[: 3 * n].reshape(n, 3).T[..., None]
        largest = float(np.abs(rotation).max())
        first_step = largest if iteration == 0 else first_step
        is_continuation = is_continuation and (
            iteration != 1 or largest <= max(_MAX_SECOND_STEP_RATIO * first_step, _MAX_STEADY_ROTATION_RAD)
        )
        step_factor = min(1.0, _MAX_ROTATION_RAD / max(largest, 1e-300))
        state = apply_step(state, step_factor * rotation, step_factor * step[3 * n :, None])
        if largest < ROTATION_TOLERANCE_RAD:
            return NewtonResult(
                state, np.array([True]), np.array([negatives - 3]), np.array([is_continuation])
            )
    return NewtonResult(state, np.array([False]), np.array([0]), np.array([False]))


def weakest_mode(stiffness: FloatArray, state: RodState, ends: RodEnds) -> tuple[float, FloatArray]:
    """Return the smallest eigenvalue of the second variation, and its mode: rotations of segments (3, N).

    Only modes that keep the end's position count. The eigenvalue is normalised by int |rotation|^2 ds, in
    units of EI / L^2.

    Args:
        stiffness: Torsion and bending stiffnesses (3,).
        state: State of one instant.
        ends: The clamps.
    """
    n = state.attitudes.shape[1]
    full = saddle_matrix(rod_derivatives(stiffness, state.attitudes, state.force, ends))
    hessian, slope = full[: 3 * n, : 3 * n], -full[3 * n :, : 3 * n]
    # min of x' H x over C x = 0, with int |x|^2 ds = |x|^2 / n = 1
    basis = np.linalg.qr(slope.T, mode="complete")[0][:, 3:]
    value, vector = eigh(basis.T @ hessian @ basis, subset_by_index=[0, 0])
    return float(value[0]) * n, (basis @ vector[:, 0]).reshape(n, 3).T


def descend(stiffness: FloatArray, state: RodState, ends: RodEnds, rounds: int = 200) -> NewtonResult:
    """Descend to a stable shape for one instant, from a state that need not be near one.

    It finds the shape into which a rod falls that has lost its own. A multiple of the unit matrix is added to
    the Hessian of each Newton step until the Hessian is positive for all rotations that keep the end's
    position, and until the step lowers the energy. After each step the end is moved back to its position.
    From an unstable equilibrium the first step goes along its weakest mode. Newton's method completes the
    result, which may still not be stable.

    Args:
        stiffness: Torsion and bending stiffnesses (3,).
        state: Initial state.
        ends: The clamps.
        rounds: Maximum number of iterations.
    """
    n = state.attitudes.shape[1]
    result = solve_newton(stiffness, state, ends)
    if result.is_stable[0]:
        return result
    if result.converged[0]:
        mode = weakest_mode(stiffness, result.state, ends)[1]
        state = apply_step(result.state, (0.05 / np.abs(mode).max() * mode)[..., None], np.zeros((3, 1)))
    state = _restore_end(state, ends)
    lift = 0.0
    last_energy = float(rod_energy(stiffness, state.attitudes, ends)[0])
    parts = rod_derivatives(stiffness, state.attitudes, state.force, ends)
    for _ in range(rounds):
        ldu, pivots, negatives = factorise(saddle_matrix(parts, EIGENVALUE_LIFT + lift * n))
        while negatives != 3 and lift < 1e6:  # 3 negative eigenvalues: positive for all allowed rotations
            lift = max(4.0 * lift, 0.1 / n)
            ldu, pivots, negatives = factorise(saddle_matrix(parts, EIGENVALUE_LIFT + lift * n))
        right_side = np.concatenate([-parts.gradient[..., 0].T.ravel(), parts.end_error[:, 0]])
        step, _ = lapack.dsytrs(ldu, pivots, right_side, lower=1)
        rotation, force = step[: 3 * n].reshape(n, 3).T[..., None], step[3 * n :, None]
        largest = float(np.abs(rotation).max())
        # near a stable shape, or nothing lowers the energy
        if (largest < 1e-3 and lift == 0.0) or lift >= 1e6:
            break
        trial = _restore_end(apply_step(state, min(1.0, 0.4 / max(largest, 1e-300)) * rotation, force), ends)
        trial_energy = float(rod_energy(stiffness, trial.attitudes, ends)[0])
        if trial_energy < last_energy:
            state, last_energy = trial, trial_energy
            parts = rod_derivatives(stiffness, state.attitudes, state.force, ends)
            lift = 0.0 if lift < 0.1 / n else 0.25 * lift
        else:
            lift = max(4.0 * lift, 0.1 / n)
    return solve_newton(stiffness, state, ends)


def _restore_end(state: RodState, ends: RodEnds) -> RodState:
    """Return the state with its end moved to its position by the smallest rotations."""
    n = state.attitudes.shape[1]
    for _ in range(40):
        axes = rotation_matrix(state.attitudes)
        end_error = axes[:, 0].sum(axis=1) / n - ends.position
        if float(np.abs(end_error).max()) < 1e-11:
            break
        # smallest rotations: r = -C^T (C C^T)^-1 error
        slope = np.stack([0.0 * axes[:, 0], -axes[:, 2], axes[:, 1]], axis=1) / n
        square = np.einsum("ijkt,ljkt->il", slope, slope)
        rotation = -np.einsum("ijkt,i->jkt", slope, np.linalg.lstsq(square, end_error[:, 0], rcond=1e-12)[0])
        rotation *= min(1.0, 0.3 / max(float(np.abs(rotation).max()), 1e-300))
        state = apply_step(state, rotation, np.zeros((3, 1)))
    return state


# ---- many instants at once ---------------------------------------------------------------------------------


class BlockElimination:
    """Block elimination of the saddle-point matrices of T instants, for any number of right-hand sides.

    Args:
        parts: Derivatives of T instants.
        lift: Amount that is added to all eigenvalues of the second variation.
    """

    def __init__(self, parts: RodDerivatives, lift: float = EIGENVALUE_LIFT) -> None:
        self.n = n = parts.gradient.shape[1]
        raised = parts.diagonal + (lift / n) * np.eye(3)[:, :, None, None]
        self.slope = parts.end_jacobian
        negative_count = np.zeros(parts.gradient.shape[2], dtype=np.intp)
        self.inverse: list[FloatArray] = []
        self.factors: list[FloatArray] = []  # inverse pivot times the block next to it
        pivot = raised[:, :, 0]
        # block LDL^T of the tridiagonal H: D_0 = H_00, D_(k+1) = H_(k+1,k+1) - B_k^T D_k^-1 B_k
        for k in range(n):
            inverse, negative = _invert_symmetric(pivot)
            negative_count += negative
            self.inverse.append(inverse)
            if k + 1 < n:
                off_diagonal = parts.off_diagonal[:, :, k]
                self.factors.append(_multiply_blocks(inverse, off_diagonal))
                pivot = raised[:, :, k + 1] - _multiply_transposed(off_diagonal, self.factors[k])
        slope_t = np.moveaxis(parts.end_jacobian, 0, 1)  # (3 rows of a block, 3 conditions, N, T)
        self.end_response = self.solve_blocks(slope_t)
        schur = np.einsum("ijkt,jlkt->ilt", parts.end_jacobian, self.end_response)
        self.schur_inverse, negative = _invert_symmetric(0.5 * (schur + schur.transpose(1, 0, 2)))
        # inertia: negatives of H plus those of -S, S = C H^-1 C^T, minus the three of the conditions
        self.negatives = negative_count + (3 - negative) - 3

    def solve_blocks(self, right: FloatArray) -> FloatArray:
        """Return Hessian^-1 times m right-hand sides (3, m, N, T), by forward and back substitution."""
        result = np.empty_like(right)
        carry = right[:, :, 0]
        result[:, :, 0] = carry
        for k in range(1, self.n):
            carry = right[:, :, k] - _multiply_transposed(self.factors[k - 1], carry)
            result[:, :, k] = carry
        carry = _multiply_blocks(self.inverse[-1], result[:, :, -1])
        result[:, :, -1] = carry
        for k in range(self.n - 2, -1, -1):
            carry = _multiply_blocks(self.inverse[k], result[:, :, k]) - _multiply_blocks(
                self.factors[k], carry
            )
            result[:, :, k] = carry
        return result

    def solve(self, right: FloatArray, gap: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Solve H r - C^T f = right, -C r = gap for rotations r (3, N, T) and forces f (3, T)."""
        # f = -S^-1 (gap + C H^-1 right), r = H^-1 (right + C^T f)
        free = self.solve_blocks(right[:, None])[:, 0]
        miss = gap + np.einsum("ijkt,jkt->it", self.slope, free)
        force = -np.einsum("ijt,jt->it", self.schur_inverse, miss)
        return free + np.einsum("ijkt,jt->ikt", self.end_response, force), force


def solve_newton_many(stiffness: FloatArray, state: RodState, ends: RodEnds, rounds: int = 8) -> NewtonResult:
    """Run Newton for T instants at once, each from its own state.

    Args:
        stiffness: Torsion and bending stiffnesses (3,).
        state: Initial states.
        ends: The clamps.
        rounds: Maximum number of iterations.
    """
    converged = np.zeros(ends.position.shape[1], dtype=bool)
    negatives = np.zeros(ends.position.shape[1], dtype=np.intp)
    attitudes, forces = state.attitudes.copy(), state.force.copy()
    active = np.arange(len(converged))
    first_step = np.zeros(len(active))
    is_continuation = np.ones(len(active), dtype=bool)
    for iteration in range(rounds):
        if len(active) == 0:
            break
        active_state = RodState(attitudes[:, :, active], forces[:, active])
        active_ends = ends.at(active)
        parts = rod_derivatives(stiffness, active_state.attitudes, active_state.force, active_ends)
        with np.errstate(all="ignore"):
            elimination = BlockElimination(parts)
            rotation, force = elimination.solve(-parts.gradient, parts.end_error)
        is_finite = np.isfinite(rotation).all(axis=(0, 1)) & np.isfinite(force).all(axis=0)
        rotation, force = np.where(is_finite, rotation, 0.0), np.where(is_finite, force, 0.0)
        largest = np.abs(rotation).max(axis=(0, 1))
        if iteration == 0:
            first_step[active] = largest
        if iteration == 1:
            is_continuation[active] = largest <= np.maximum(
                _MAX_SECOND_STEP_RATIO * first_step[active], _MAX_STEADY_ROTATION_RAD
            )
        step_factor = np.minimum(1.0, _MAX_ROTATION_RAD / np.maximum(largest, 1e-300))
        active_state = apply_step(active_state, step_factor * rotation, step_factor * force)
        attitudes[:, :, active], forces[:, active] = active_state.attitudes, active_state.force
        done = is_finite & (largest < ROTATION_TOLERANCE_RAD)
        converged[active[done]] = True
        negatives[active[done]] = elimination.negatives[done]
        active = active[is_finite & ~done]
    return NewtonResult(RodState(attitudes, forces), converged, negatives, is_continuation)


def weakest_eigenvalues(
    stiffness: FloatArray, state: RodState, ends: RodEnds, rounds: int = 12
) -> FloatArray:
    """Return the eigenvalue nearest to 0 (T,) of the second variation, by inverse iteration.

    For a stable shape it is the smallest one, from which the stability margin follows. See `weakest_mode` for
    its normalisation.

    Args:
        stiffness: Torsion and bending stiffnesses (3,).
        state: States of T instants.
        ends: The clamps.
        rounds: Number of iterations.
    """
    parts = rod_derivatives(stiffness, state.attitudes, state.force, ends)
    elimination = BlockElimination(parts)
    n, instants = state.attitudes.shape[1], state.attitudes.shape[2]
    s = (np.arange(n) + 0.5) / n
    # an arbitrary smooth start that is orthogonal to no mode
    mode = np.stack([np.sin(3.0 * s + i) + s * (1.0 + i) for i in range(3)])[..., None] * np.ones(instants)
    value = np.zeros(instants)
    for _ in range(rounds):
        mode /= np.sqrt((mode * mode).sum(axis=(0, 1)) / n)
        next_mode, _ = elimination.solve(mode / n, np.zeros((3, instants)))
        # H next_mode = mode / n, so 1 / (mode.next_mode / n) tends to the eigenvalue nearest to 0
        value = 1.0 / ((mode * next_mode).sum(axis=(0, 1)) / n)
        mode = next_mode
    return value - EIGENVALUE_LIFT


def _multiply_blocks(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a b for (3, 3, T) and (3, m, T)."""
    result: FloatArray = a[:, 0, None] * b[None, 0] + a[:, 1, None] * b[None, 1] + a[:, 2, None] * b[None, 2]
    return result


def _multiply_transposed(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a^T b for (3, 3, T) and (3, m, T)."""
    result: FloatArray = a[0, :, None] * b[None, 0] + a[1, :, None] * b[None, 1] + a[2, :, None] * b[None, 2]
    return result


def _invert_symmetric(a: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Return the inverse of symmetric matrices (3, 3, T) and the number of their negative eigenvalues (T,).

    The inverse follows from cofactors, the number from the sign changes of the leading minors.
    """
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    second = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    c11 = a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]
    c12 = a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
    result = np.empty_like(a)
    result[0, 0], result[1, 1], result[2, 2] = c00, c11, second
    result[0, 1] = result[1, 0] = c01
    result[0, 2] = result[2, 0] = c02
    result[1, 2] = result[2, 1] = c12
    result /= determinant
    signs = [a[0, 0] < 0, (second < 0) != (a[0, 0] < 0), (determinant < 0) != (second < 0)]
    return result, np.sum(signs, axis=0)
