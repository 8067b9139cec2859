"""Wires between two clamps: shapes of least energy under a given chord, and their stability.

For many wires at once, with bending and weight. theta = straight line between the end angles + sum a_j phi_j.
In units of the wire the bending energy is |a|^2 / 2 plus a constant, the constraint is int (cos theta, sin
theta) = chord, and its multiplier is the force F at the start. The second derivative of the Lagrangian is the
form of in-plane stability.

Newton on the state at the middle of the wire leads from this Galerkin solution to the exact one
(`refine_state`).

**Stability** of planar wire shapes between clamps, in and out of their plane, with weight.

A shape is stable if the second variation of its energy is positive for every motion that the clamps allow.
Both forms are set up in functions with orthonormal slopes, so the result is a pure number: the smallest value
of second variation / int |w'|^2. It is 1 for a straight wire without force, falls under compression and is 0
at buckling.

In plane (eta: change of theta; Sachkov, arXiv 0705.1003): int eta'^2 + (F.t) eta^2 with int eta n = 0.

Out of plane (w: rotation about tangent and normal, B = 1 the stiffness in the plane, C = GJ/EI, B2 =
stiff/soft bending): int C (wt' - k wn)^2 + B2 (wn' + k wt)^2 - k^2 (wt^2 + wn^2) - k (wt wn' - wn wt') + Ft
wn^2 - Fn wt wn with int wn = 0. It is the second order of the energy of a rod whose frame is rotated by
exp(w). Weight enters by F(s) alone, because the load's energy is -int F(s).t ds.
"""

from dataclasses import dataclass

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.hotwire.plan.elastica.equations import (
    BumpBasis,
    bump_basis,
    bump_values,
    gauss_nodes,
    integrate_wire,
    interpolate,
    legendre,
)

MIN_STABLE_MARGIN = 1e-6  # smallest second variation that counts as stable
_IN_PLANE_MODES = 32
"""Number of functions that represent motions of a wire in its plane."""
_OUT_OF_PLANE_MODES = 28
"""Number of functions for each of twist and bending out of the plane."""
_QUADRATURE_POINTS = 72
"""Number of Gauss points along the wire for stability."""


@dataclass(frozen=True)
class StiffnessRatios:
    """Stiffness ratios of a wire's cross-section, over the bending stiffness EI in the plane of the shape.

    Attributes:
        torsion: Torsional stiffness GJ/EI.
        stiff_bending: Stiff bending EI2/EI.
    """

    torsion: float
    stiff_bending: float


def round_section(nu: float) -> StiffnessRatios:
    """Return the ratios of a round wire of Poisson's ratio nu: GJ/EI = 1/(1 + nu).

    Raises:
        ValueError: If nu is outside (-1, 0.5].
    """
    if not -1.0 < nu <= 0.5:
        raise ValueError(
            f"nu: got {nu}, allowed more than -1 and at most 0.5; give Poisson's ratio of the wire"
        )
    return StiffnessRatios(torsion=1.0 / (1.0 + nu), stiff_bending=1.0)


def strip_section(ratio: float, nu: float) -> StiffnessRatios:
    """Return the ratios of a rectangular strip that bends about its soft axis in the plane.

    Torsion constant J = w t^3/3 (1 - 0.630 t/w + 0.052 (t/w)^5).

    Args:
        ratio: Width / thickness, at least 1.
        nu: Poisson's ratio.

    Raises:
        ValueError: If an argument is out of range.

    Source: Timoshenko and Goodier, Theory of Elasticity, art. 109.
    """
    if not ratio >= 1.0:
        raise ValueError(f"ratio: got {ratio}, allowed 1 or more; give width / thickness")
    if not -1.0 < nu <= 0.5:
        raise ValueError(
            f"nu: got {nu}, allowed more than -1 and at most 0.5; give Poisson's ratio of the strip"
        )
    shape = 4.0 * (1.0 - 0.630 / ratio + 0.052 / ratio**5)
    return StiffnessRatios(torsion=shape / (2.0 * (1.0 + nu)), stiff_bending=ratio**2)


def quadrature_nodes() -> FloatArray:
    """Return the nodes sigma = s / L at which the functions below expect theta, curvature and force."""
    return bump_basis(_OUT_OF_PLANE_MODES, _QUADRATURE_POINTS).sigma


def min_constrained_eigenvalue(form: FloatArray, constraints: FloatArray, barrier: float = 2.0) -> FloatArray:
    """Return the smallest eigenvalue (B,) of each quadratic form on the space orthogonal to its constraints.

    A constraint that vanishes (the second one of a straight wire) is left out. Forms that are not finite
    belong to wires that do not exist and give -inf.

    Args:
        form: Symmetric matrices of the quadratic forms (B, n, n).
        constraints: Vectors to which the space is orthogonal (B, c, n), c <= 2.
        barrier: Eigenvalue given to the constrained directions, so that they are never the smallest.
    """
    is_finite = np.isfinite(form).all(axis=(1, 2)) & np.isfinite(constraints).all(axis=(1, 2))
    projected, basis = project_form(form[is_finite], constraints[is_finite])
    shift = barrier * (np.swapaxes(basis, 1, 2) @ basis)
    out = np.full(form.shape[0], -np.inf)
    out[is_finite] = np.linalg.eigvalsh(projected + shift)[:, 0]
    return out


def project_form(form: FloatArray, constraints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project quadratic forms H on the spaces orthogonal to their constraints, by the projector P.

    Stability counts only motions that the clamps allow.

    Args:
        form: Symmetric matrices H of the quadratic forms (B, n, n).
        constraints: Vectors to which the spaces are orthogonal (B, c, n).

    Returns:
        P H P (B, n, n), and an orthonormal basis U (B, c, n) of the constraints with zero rows for those that
        vanish.
    """
    gram = constraints @ np.swapaxes(constraints, 1, 2)
    value, vector = np.linalg.eigh(gram)
    keep = value > 1e-18 * np.maximum(value[:, -1:], 1.0)
    scale = np.where(keep, 1.0 / np.sqrt(np.where(keep, value, 1.0)), 0.0)
    basis = scale[:, :, None] * (np.swapaxes(vector, 1, 2) @ constraints)
    # P = 1 - U^T U: first H P, then P (H P)
    right_projected = form - (form @ np.swapaxes(basis, 1, 2)) @ basis
    projected = right_projected - np.swapaxes(basis, 1, 2) @ (basis @ right_projected)
    return projected, basis


@dataclass(frozen=True)
class QuadratureShape:
    """Planar shapes of B wires at `quadrature_nodes()`.

    Attributes:
        theta: Angles (B, n) [rad].
        curvature: Curvatures (B, n) [1/m].
        force: Force F (B, n, 2) [1/m^2].
        length: Lengths of the wires (B,) [m].
    """

    theta: FloatArray
    curvature: FloatArray
    force: FloatArray
    length: FloatArray


def in_plane_margin(shape: QuadratureShape) -> FloatArray:
    """Return the stability margin (B,) of shapes in their plane, as the module docstring defines it."""
    theta, force, length = shape.theta, shape.force, shape.length
    base = bump_basis(_IN_PLANE_MODES, _QUADRATURE_POINTS)
    sin, cos = np.sin(theta), np.cos(theta)
    tangential_force = (length**2)[:, None] * (force[..., 0] * cos + force[..., 1] * sin) * base.weight
    form = np.eye(_IN_PLANE_MODES) + base.value.T @ (tangential_force[:, :, None] * base.value)
    normal = np.stack([-sin, cos], axis=1) * base.weight
    return min_constrained_eigenvalue(form, normal @ base.value)


def out_of_plane_form(shape: QuadratureShape, section: StiffnessRatios) -> FloatArray:
    """Return the second variation of the energy out of the plane as matrices (B, 2m, 2m), in units of EI/L.

    Its smallest eigenvalue decides stability, and its inverse gives the sag.

    The module docstring has the formula. The unknowns are the m bump amplitudes of wt, then those of wn.
    """
    theta, force, length = shape.theta, shape.force, shape.length
    base = bump_basis(_OUT_OF_PLANE_MODES, _QUADRATURE_POINTS)
    k = shape.curvature * length[:, None]
    length_squared = (length**2)[:, None]
    ft = length_squared * (force[..., 0] * np.cos(theta) + force[..., 1] * np.sin(theta))
    fn = length_squared * (force[..., 1] * np.cos(theta) - force[..., 0] * np.sin(theta))
    c, b = section.torsion, section.stiff_bending
    value, slope, weight = base.value, base.slope, base.weight

    def product(left: FloatArray, factor: FloatArray, right: FloatArray) -> FloatArray:
        out: FloatArray = left.T @ ((factor * weight)[:, :, None] * right)
        return out

    eye = np.eye(_OUT_OF_PLANE_MODES)
    # Form of the module docstring. The mixed block has half of the terms in wt wn, wt wn' and wt' wn.
    tangent = c * eye + product(value, (b - 1.0) * k**2, value)
    normal = b * eye + product(value, (c - 1.0) * k**2 + ft, value)
    mixed = (
        product(value, (b - 0.5) * k, slope)
        - product(slope, (c - 0.5) * k, value)
        - product(value, 0.5 * fn, value)
    )
    return np.block([[tangent, mixed], [np.swapaxes(mixed, 1, 2), normal]])


def out_of_plane_margin(shape: QuadratureShape, section: StiffnessRatios) -> FloatArray:
    """Return the margin (B,) of stability out of the plane: 1 without force, 0 at buckling."""
    form = out_of_plane_form(shape, section)
    return min_constrained_eigenvalue(form, out_of_plane_constraint(form.shape[0]))


def out_of_plane_constraint(batch: int) -> FloatArray:
    """Return the constraint int wn = 0 on the bump amplitudes of wt and wn, as (batch, 1, 2m)."""
    base = bump_basis(_OUT_OF_PLANE_MODES, _QUADRATURE_POINTS)
    row = np.concatenate([np.zeros(_OUT_OF_PLANE_MODES), base.weight @ base.value])
    return np.tile(row, (batch, 1, 1))


def out_of_plane_sag(
    shape: QuadratureShape, section: StiffnessRatios, load: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Return the deflections (B, m) [m] along z = x cross y under a load across the plane, linearised.

    The energy of the load is int (L - s) load wn ds. The result is infinite if the shape is not stable out of
    its plane.

    Args:
        shape: Shapes of the wires.
        section: Stiffness ratios.
        load: Force per length along z over EI in the plane (B,) [1/m^3].
        sigma: Positions of the result (m,).
    """
    base = bump_basis(_OUT_OF_PLANE_MODES, _QUADRATURE_POINTS)
    length = shape.length
    batch = shape.theta.shape[0]
    form = out_of_plane_form(shape, section)
    constraint = out_of_plane_constraint(batch)
    size = form.shape[1]
    # stationary w' form w / 2 + int load L^3 (1 - sigma) wn with int wn = 0, in units of the wire
    system = np.zeros((batch, size + 1, size + 1))
    system[:, :size, :size] = form
    system[:, :size, size] = constraint[:, 0]
    system[:, size, :size] = constraint[:, 0]
    right_side = np.zeros((batch, size + 1))
    arm = base.weight * (1.0 - base.sigma)
    right_side[:, _OUT_OF_PLANE_MODES:size] = -(load * length**3)[:, None] * (arm @ base.value)
    stable = min_constrained_eigenvalue(form, constraint) > MIN_STABLE_MARGIN
    system[~stable] = np.eye(size + 1)
    right_side[~stable] = 0.0
    wn = np.linalg.solve(system, right_side[..., None])[:, _OUT_OF_PLANE_MODES:size, 0]
    # deflection z(s) = -int_0^s wn
    x, w = np.polynomial.legendre.leggauss(_OUT_OF_PLANE_MODES + 2)
    part = 0.5 * (x + 1.0) * sigma[:, None]
    from_start = np.einsum("mq,mqj->mj", 0.5 * w * sigma[:, None], bump_values(part, _OUT_OF_PLANE_MODES))
    out: FloatArray = -length[:, None] * (wn @ from_start.T)
    out[~stable] = np.inf
    return out


CLAMPED_MODES = 36
"""Number of functions that expand a wire's angle between its clamps."""
_MAX_ROTATION_STEP_RAD = 0.6  # rad: largest change of theta in one step


@dataclass(frozen=True)
class ClampedWires:
    """Wires between two clamps.

    Attributes:
        length: Lengths (B,) [m].
        start: Poses x, y, theta of the start clamps (B, 3) [m, rad].
        end: Poses x, y, theta of the end clamps (B, 3) [m, rad].
        weight: Weight q (B, 2) [1/m^3].
    """

    length: FloatArray
    start: FloatArray
    end: FloatArray
    weight: FloatArray

    @property
    def chord(self) -> FloatArray:
        """Vectors from start to end over L (B, 2)."""
        return np.asarray((self.end[:, :2] - self.start[:, :2]) / self.length[:, None])

    @property
    def unit_weight(self) -> FloatArray:
        """Weight in units of the wire, q L^3 (B, 2)."""
        return np.asarray(self.weight * (self.length**3)[:, None])

    def select(self, rows: IntArray) -> "ClampedWires":
        """Return a subset of the wires in the same order."""
        return ClampedWires(self.length[rows], self.start[rows], self.end[rows], self.weight[rows])


@dataclass(frozen=True)
class ClampedSolution:
    """Equilibria of B wires between clamps. The unit of length is the length of each wire.

    Attributes:
        amplitude: Bump amplitudes (B, j).
        force: Force at the start times L^2 (B, 2).
        margin: Margin of in-plane stability (B,).
        residual: Largest residual of force balance and chord (B,), infinite if the iteration diverged.
    """

    amplitude: FloatArray
    force: FloatArray
    margin: FloatArray
    residual: FloatArray


def clamped_theta(
    first: FloatArray, last: FloatArray, amplitude: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Return theta (B, m) at sigma (m,) for end angles (B,) and amplitudes (B, j)."""
    line = first[:, None] + (last - first)[:, None] * sigma
    out: FloatArray = line + amplitude @ bump_values(sigma, amplitude.shape[1]).T
    return out


def _bump_basis(modes: int) -> BumpBasis:
    return bump_basis(modes, 2 * modes + 8)


@dataclass(frozen=True)
class _LagrangianTerms:
    """Lagrangian of the clamped wires, expanded at given amplitudes and forces."""

    gradient: FloatArray  # (B, j) of the Lagrangian with respect to the amplitudes
    chord: FloatArray  # (B, 2) vector from start to end over L
    normal: FloatArray  # (B, 2, j) derivative of the chord with respect to the amplitudes
    form: FloatArray  # (B, j, j) second derivative of the Lagrangian


def _lagrangian_terms(
    first: FloatArray, last: FloatArray, weight: FloatArray, amplitude: FloatArray, force: FloatArray
) -> _LagrangianTerms:
    """Return the derivatives of E = int theta'^2 / 2 - F.t with F = F0 - q sigma, and the chord."""
    base = _bump_basis(amplitude.shape[1])
    theta = first[:, None] + (last - first)[:, None] * base.sigma + amplitude @ base.value.T
    sin, cos = np.sin(theta), np.cos(theta)
    fx = force[:, :1] - weight[:, :1] * base.sigma
    fy = force[:, 1:] - weight[:, 1:] * base.sigma
    gradient = amplitude + ((fx * sin - fy * cos) * base.weight) @ base.value
    chord = np.stack([cos @ base.weight, sin @ base.weight], axis=1)
    normal = (np.stack([-sin, cos], axis=1) * base.weight) @ base.value
    tangential_force = (fx * cos + fy * sin) * base.weight
    form = np.eye(amplitude.shape[1]) + base.value.T @ (tangential_force[:, :, None] * base.value)
    return _LagrangianTerms(gradient, chord, normal, form)


def _saddle_step(
    form: FloatArray, normal: FloatArray, gradient: FloatArray, miss: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solve the equality-constrained Newton step for the changes of the amplitudes (B, j) and forces (B, 2).

    Args:
        form: Second derivative of the Lagrangian (B, j, j).
        normal: Derivative of the chord with respect to the amplitudes (B, 2, j).
        gradient: Gradient of the Lagrangian (B, j).
        miss: Required chord minus current chord (B, 2).
    """
    batch, size = gradient.shape
    # (form, -N^T; N, 0) (da, dF) = (-gradient, miss), N = int n phi
    system = np.zeros((batch, size + 2, size + 2))
    system[:, :size, :size] = form
    system[:, :size, size:] = -np.swapaxes(normal, 1, 2)
    system[:, size:, :size] = normal
    # regularised, because a straight wire leaves one constraint without gradient
    regularisation = 1e-13 * np.maximum(1.0, np.sum(normal**2, axis=(1, 2)))
    system[:, size, size] += regularisation
    system[:, size + 1, size + 1] += regularisation
    right_side = np.concatenate([-gradient, miss], axis=1)
    step = np.linalg.solve(system, right_side[..., None])[..., 0]
    return step[:, :size], step[:, size:]


def solve_newton(
    wires: ClampedWires, amplitude: FloatArray, force: FloatArray, rounds: int = 12
) -> ClampedSolution:
    """Return the equilibrium next to a guess, stable or not, by Newton's method with bounded steps.

    Args:
        wires: Wires between their clamps.
        amplitude: Guess of the bump amplitudes (B, j).
        force: Guess of the force at the start times L^2 (B, 2).
        rounds: Maximum number of iterations.
    """
    first, last, chord, weight = wires.start[:, 2], wires.end[:, 2], wires.chord, wires.unit_weight
    amplitudes, forces = amplitude.copy(), force.copy()
    for _ in range(rounds):
        terms = _lagrangian_terms(first, last, weight, amplitudes, forces)
        miss = chord - terms.chord
        if float(max(np.abs(terms.gradient).max(initial=0.0), np.abs(miss).max(initial=0.0))) < 1e-13:
            break
        da, df = _saddle_step(terms.form, terms.normal, terms.gradient, miss)
        rotation = np.abs(da @ _bump_basis(amplitudes.shape[1]).value.T).max(axis=1)
        step_fraction = np.minimum(1.0, _MAX_ROTATION_STEP_RAD / np.maximum(rotation, 1e-300))
        amplitudes += step_fraction[:, None] * da
        forces += step_fraction[:, None] * df
    return _make_solution(first, last, chord, weight, amplitudes, forces)


def _make_solution(
    first: FloatArray,
    last: FloatArray,
    chord: FloatArray,
    weight: FloatArray,
    amplitudes: FloatArray,
    forces: FloatArray,
) -> ClampedSolution:
    """Add margins and residuals to amplitudes and forces. Wires that diverged get -inf and inf."""
    terms = _lagrangian_terms(first, last, weight, amplitudes, forces)
    residual = np.maximum(np.abs(terms.gradient).max(axis=1), np.abs(chord - terms.chord).max(axis=1))
    residual = np.where(np.isfinite(residual), residual, np.inf)
    return ClampedSolution(amplitudes, forces, min_constrained_eigenvalue(terms.form, terms.normal), residual)


def amplitudes_of(
    node_theta: FloatArray, sigma: FloatArray, weight: FloatArray, modes: int = CLAMPED_MODES
) -> FloatArray:
    """Return the bump amplitudes (B, modes) of wires whose angles are given at Gauss nodes.

    They convert a guess to the form that `solve_newton` expects. The slope of theta is projected on the
    slopes psi_j of the basis by partial integration.

    Args:
        node_theta: Angles at the nodes (B, n).
        sigma: Gauss nodes (n,).
        weight: Quadrature weights (n,).
        modes: Number of amplitudes.
    """
    first = node_theta @ _extrapolation_row(sigma.size, sigma, weight, 0.0)
    last = node_theta @ _extrapolation_row(sigma.size, sigma, weight, 1.0)
    slopes = np.sqrt(2.0 * np.arange(modes) + 3.0)
    # int theta' psi = [theta psi] - int theta psi', psi_j = sqrt(2j+3) P_(j+1)
    ends = last[:, None] * slopes - first[:, None] * slopes * (-1.0) ** (np.arange(modes) + 1)
    # on [0, 1]: P_j' = 2 (2 j - 1) P_(j-1) + P_(j-2)'
    p = legendre(sigma, modes + 1)
    slope = np.zeros_like(p)
    for j in range(1, modes + 1):
        slope[:, j] = (2.0 * (2 * j - 1)) * p[:, j - 1] + (slope[:, j - 2] if j >= 2 else 0.0)
    out: FloatArray = ends - (node_theta * weight) @ (slope[:, 1:] * slopes)
    return out


def _extrapolation_row(count: int, sigma: FloatArray, weight: FloatArray, end: float) -> FloatArray:
    """Return the factors (n,) with which values at Gauss nodes are extrapolated to sigma = ``end``."""
    p = legendre(sigma, count)
    series = (p * weight[:, None]).T * (2.0 * np.arange(count)[:, None] + 1.0)
    out: FloatArray = legendre(np.array([end]), count)[0] @ series
    return out


def middle_state(
    start: FloatArray,
    end: FloatArray,
    length: FloatArray,
    weight: FloatArray,
    amplitude: FloatArray,
    force: FloatArray,
) -> FloatArray:
    """Return the state (B, 6) at s = L/2 of wires in the bump basis.

    Args:
        start: Poses x, y, theta of the start (B, 3) [m, rad].
        end: Poses x, y, theta of the end (B, 3) [m, rad].
        length: Lengths (B,) [m].
        weight: Weight q (B, 2) [1/m^3].
        amplitude: Bump amplitudes (B, j).
        force: Force at the start in units of the wire, F L^2 (B, 2).
    """
    modes = amplitude.shape[1]
    grid = gauss_nodes(64)
    theta = clamped_theta(start[:, 2], end[:, 2], amplitude, 0.5 * grid.sigma)
    half = np.array([0.5])
    slope = legendre(half, modes + 1)[0, 1:] * np.sqrt(2.0 * np.arange(modes) + 3.0)
    x = start[:, 0] + 0.5 * length * (np.cos(theta) @ grid.weight)
    y = start[:, 1] + 0.5 * length * (np.sin(theta) @ grid.weight)
    angle = clamped_theta(start[:, 2], end[:, 2], amplitude, half)[:, 0]
    k = (end[:, 2] - start[:, 2] + amplitude @ slope) / length
    middle_force = force / (length**2)[:, None] - 0.5 * length[:, None] * weight
    return np.concatenate([np.stack([x, y, angle, k], axis=1), middle_force], axis=1)


def refine_state(
    state: FloatArray, start: FloatArray, end: FloatArray, length: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Refine the states at the middles of wires by Newton's method, so that both ends take given poses.

    At most 4 steps are taken, and of all states the one with the least deviation is returned for each wire.

    Args:
        state: States at s = L/2 (B, 6).
        start: Required poses of the start (B, 3).
        end: Required poses of the end (B, 3).
        length: Lengths (B,) [m].
        weight: Weight q (B, 2) [1/m^3].

    Returns:
        States (B, 6) and the largest deviation from the end poses over L (B,).
    """
    unit = np.stack([length, length, np.ones_like(length), 1 / length, length**-2, length**-2], axis=1)
    scale = np.concatenate([unit[:, :3], unit[:, :3]], axis=1)
    required_ends = np.concatenate([start, end], axis=1)
    best_state, best_error = state.copy(), np.full(length.size, np.inf)
    state = state.copy()
    ends_at = np.array([0.0, 1.0])
    for iteration in range(5):
        wire = integrate_wire(state, length, weight, anchor=0.5, derivatives=iteration < 4)
        ends = wire.at(ends_at)[..., :3].reshape(-1, 6)
        miss = (required_ends - ends) / scale
        deviation = np.abs(miss).max(axis=1)
        improved = deviation < best_error
        best_state[improved], best_error[improved] = state[improved], deviation[improved]
        if iteration == 4 or not float(np.max(deviation, initial=0.0)) > 1e-13:
            break
        # Newton, rows (x, y, theta) of both ends, all scaled by powers of L; dx/dx0 = dy/dy0 = 1
        end_derivatives = interpolate(np.concatenate([wire.d_x, wire.d_y, wire.d_theta], axis=-1), ends_at)
        jacobian = np.zeros((length.size, 6, 6))
        jacobian[:, :, 2:] = end_derivatives.reshape(-1, 6, 4)
        jacobian[:, (0, 3), 0] = 1.0
        jacobian[:, (1, 4), 1] = 1.0
        jacobian *= unit[:, None, :] / scale[:, :, None]
        is_finite = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(miss).all(axis=1)
        step = np.einsum("bij,bj->bi", np.linalg.pinv(jacobian[is_finite], rcond=1e-13), miss[is_finite])
        state[is_finite] += step * unit[is_finite]
    return best_state, best_error
