"""Equations of the planar elastica as an initial value problem.

Legendre tools on [0, 1] that all wire solvers share: Gauss nodes, integration matrices, and a basis that
vanishes at the ends. The unit of arc length there is the wire: sigma = s / L.

Balance of a wire of bending stiffness EI, everything divided by EI:

    r' = (cos theta, sin theta),  theta' = k,  k' = Fx sin theta - Fy cos theta,  F' = -q,

where F [1/m^2] is the force that the part beyond s exerts on the part before it (positive along the tangent
is tension) and q [1/m^3] is the weight of the wire per length as a vector in the plane (it points down).
Hence F(s) = F(0) - q s. These are the Euler-Lagrange equations of int k^2/2 - q.r ds with given end poses
(Love, Mathematical Theory of Elasticity, ch. 19; Levien 2009 for q = 0).

A state is (x, y, theta, k, Fx, Fy) at one point of the wire. Theta is computed on Gauss-Legendre nodes as the
fixed point of theta = theta_a + k_a s + double integral of k'. The linearised equation gives the derivatives
with respect to the state.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class GaussNodes:
    """Gauss-Legendre nodes on [0, 1] with the matrices that act on values at them.

    Attributes:
        sigma: Nodes (n,).
        weight: Quadrature weights (n,).
        to_coefficients: Matrix (n, n) from values to Legendre coefficients.
        integral_from_start: Matrix (n, n) from values to the integral from 0 to each node.
        integral_from_middle: Matrix (n, n) from values to the integral from 1/2 to each node.
    """

    sigma: FloatArray
    weight: FloatArray
    to_coefficients: FloatArray
    integral_from_start: FloatArray
    integral_from_middle: FloatArray


@dataclass(frozen=True)
class BumpBasis:
    """Functions phi_j that vanish at 0 and 1, with int phi_i' phi_j' = delta_ij, at Gauss nodes.

    This is Shen's basis, scaled.

    Attributes:
        sigma: Nodes (n,).
        weight: Quadrature weights (n,).
        value: phi_j at the nodes (n, j).
        slope: phi_j' at the nodes (n, j).
    """

    sigma: FloatArray
    weight: FloatArray
    value: FloatArray
    slope: FloatArray


def legendre(sigma: FloatArray, count: int) -> FloatArray:
    """Return P_0 ... P_(count-1) at 2 sigma - 1, shape (..., count).

    (j + 1) P_(j+1) = (2 j + 1) x P_j - j P_(j-1).
    """
    x = 2.0 * np.asarray(sigma, dtype=np.float64) - 1.0
    table = np.empty((count, *x.shape))
    table[0] = 1.0
    if count > 1:
        table[1] = x
    for j in range(1, count - 1):
        table[j + 1] = ((2 * j + 1) * x * table[j] - j * table[j - 1]) / (j + 1)
    return np.ascontiguousarray(np.moveaxis(table, 0, -1))


def _legendre_integrals(sigma: FloatArray, count: int) -> FloatArray:
    """Return int_0^sigma P_j for j < count, shape (..., count): (P_(j+1) - P_(j-1)) / (2 (2 j + 1))."""
    p = legendre(sigma, count + 1)
    out = np.empty((*np.shape(sigma), count))
    out[..., 0] = np.asarray(sigma)
    j = np.arange(1, count)
    out[..., 1:] = (p[..., 2:] - p[..., :-2]) / (2.0 * (2 * j + 1))
    return out


@lru_cache(maxsize=32)
def gauss_nodes(count: int) -> GaussNodes:
    """Return ``count`` Gauss nodes on [0, 1] with their integration and interpolation matrices."""
    x, w = np.polynomial.legendre.leggauss(count)
    sigma = 0.5 * (x + 1.0)
    weight = 0.5 * w
    series = (legendre(sigma, count) * weight[:, None]).T * (2.0 * np.arange(count)[:, None] + 1.0)
    start = _legendre_integrals(sigma, count) @ series
    half = _legendre_integrals(np.array([0.5]), count) @ series
    return GaussNodes(sigma, weight, series, start, start - half)


def bump_values(sigma: FloatArray, count: int) -> FloatArray:
    """Return phi_j at sigma, shape (..., count)."""
    p = legendre(sigma, count + 2)
    out: FloatArray = (p[..., 2:] - p[..., :-2]) / (2.0 * np.sqrt(2.0 * np.arange(count) + 3.0))
    return out


def bump_slopes(sigma: FloatArray, count: int) -> FloatArray:
    """Return phi_j' with respect to sigma, shape (..., count)."""
    out: FloatArray = legendre(sigma, count + 1)[..., 1:] * np.sqrt(2.0 * np.arange(count) + 3.0)
    return out


@lru_cache(maxsize=32)
def bump_basis(count: int, quadrature: int) -> BumpBasis:
    """Return ``count`` bump functions at ``quadrature`` Gauss nodes."""
    x, w = np.polynomial.legendre.leggauss(quadrature)
    sigma = 0.5 * (x + 1.0)
    return BumpBasis(sigma, 0.5 * w, bump_values(sigma, count), bump_slopes(sigma, count))


_MAX_PICARD_ITERATIONS = 90
"""Maximum number of Picard iterations for the angle of a wire."""
_PICARD_TOLERANCE_RAD = 2e-12  # rad: change of theta at which the Picard iteration has converged


@dataclass(frozen=True)
class WireSolution:
    """Wires on n Gauss nodes of sigma = s / L in [0, 1].

    The derivatives are with respect to theta, k, Fx, Fy of the anchor state. Those by x and y of the anchor
    are 1 and 0. They are empty unless requested.

    Attributes:
        theta: Angles (B, n) [rad].
        curvature: Curvatures (B, n) [1/m].
        x: Positions (B, n) [m].
        y: Positions (B, n) [m].
        force: Forces over EI (B, n, 2) [1/m^2].
        length: Lengths (B,) [m].
        d_theta: Derivatives of theta (B, n, 4).
        d_curvature: Derivatives of the curvature (B, n, 4).
        d_x: Derivatives of x (B, n, 4).
        d_y: Derivatives of y (B, n, 4).
    """

    theta: FloatArray
    curvature: FloatArray
    x: FloatArray
    y: FloatArray
    force: FloatArray
    length: FloatArray
    d_theta: FloatArray
    d_curvature: FloatArray
    d_x: FloatArray
    d_y: FloatArray

    @property
    def count(self) -> int:
        """Number of nodes along each wire."""
        return int(self.theta.shape[1])

    def at(self, sigma: FloatArray) -> FloatArray:
        """Return states (B, m, 6) at sigma (m,) or (B, m), from the Legendre series."""
        values = np.stack(
            [self.x, self.y, self.theta, self.curvature, self.force[..., 0], self.force[..., 1]], axis=-1
        )
        return interpolate(values, sigma)


def interpolate(values: FloatArray, sigma: FloatArray) -> FloatArray:
    """Interpolate values (B, n, c) on Gauss nodes to (B, m, c) at sigma (m,) or (B, m)."""
    n = values.shape[1]
    table = legendre(sigma, n)
    out: FloatArray = table @ (gauss_nodes(n).to_coefficients @ values)
    return out


def node_counts(
    state: FloatArray, length: FloatArray, weight: FloatArray, base: float = 22.0, per_wave: float = 4.5
) -> IntArray:
    """Return the number of nodes (B,) that resolves each wire.

    The poles of an elastica lie 1/w or more from the real axis, with the wave number w = sqrt(|F| + k^2 / 4).
    The defaults give an error of about 1e-11 L. A base of 14 and per_wave of 3.6 give about 1e-8 L.

    Args:
        state: States at one point of each wire (B, 6).
        length: Lengths (B,) [m].
        weight: Weight q (B, 2) [1/m^3].
        base: Nodes of a wire without waves.
        per_wave: Additional nodes for each wave number w L.
    """
    force = np.hypot(state[:, 4], state[:, 5]) + 0.5 * np.hypot(weight[:, 0], weight[:, 1]) * length
    waves = np.sqrt(force + 0.25 * state[:, 3] ** 2) * length
    waves = np.nan_to_num(np.minimum(waves, 100.0))
    # in multiples of 16, so that few sizes occur and their matrices stay cached
    need = 16 * np.ceil((base + per_wave * waves) / 16.0)
    return np.asarray(np.clip(need, 32, 192), dtype=np.int64)


def _solve_theta(
    theta: FloatArray,
    linear: FloatArray,
    length_squared: FloatArray,
    force: tuple[FloatArray, FloatArray],
    double_integral: FloatArray,
) -> FloatArray:
    """Solve for theta by Picard iteration, then by Newton for the wires that have not converged.

    After j Picard iterations the error is of the order of (w L)^(2j) / (2j)!, and none needs a linear solve.

    Args:
        theta: First guess of the angles at the nodes (B, n) [rad].
        linear: Linear part theta_a + k_a s of the angles (B, n) [rad].
        length_squared: L^2 of each wire (B, 1) [m^2].
        force: Fx and Fy at the nodes, (B, n) each [1/m^2].
        double_integral: Matrix (n, n) from values at the nodes to their double integrals from the anchor.
    """
    fx, fy = force
    change = np.zeros(theta.shape[0])
    for _ in range(_MAX_PICARD_ITERATIONS):
        previous = theta
        theta = linear + length_squared * ((fx * np.sin(theta) - fy * np.cos(theta)) @ double_integral.T)
        change = np.max(np.abs(theta - previous), axis=1, initial=0.0)
        # wires that are NaN stay NaN and do not prevent convergence
        if not (change > _PICARD_TOLERANCE_RAD).any():
            return theta
    unconverged = change > _PICARD_TOLERANCE_RAD
    fx, fy = fx[unconverged], fy[unconverged]
    linear, length_squared = linear[unconverged], length_squared[unconverged]
    theta_rest = theta[unconverged]
    # Newton: (I - L^2 II diag(Fx cos + Fy sin)) step = residual of the fixed point
    for _ in range(10):
        sin, cos = np.sin(theta_rest), np.cos(theta_rest)
        residual = linear + length_squared * ((fx * sin - fy * cos) @ double_integral.T) - theta_rest
        matrix = (
            np.eye(double_integral.shape[0])
            - double_integral * (length_squared * (fx * cos + fy * sin))[:, None, :]
        )
        step = np.linalg.solve(matrix, residual[..., None])[..., 0]
        theta_rest = theta_rest + np.clip(step, -1.0, 1.0)
        if float(np.max(np.abs(step), initial=0.0)) < 1e-9:
            break
    theta[unconverged] = theta_rest
    return theta


@dataclass(frozen=True)
class PicardStart:
    """Start of the Picard iteration for the angles of wires.

    Attributes:
        count: Number of nodes. None: that of ``theta``, or as `node_counts` gives.
        theta: First guess of theta at the n nodes (B, n). None: the linear part of theta.
    """

    count: int | None = None
    theta: FloatArray | None = None


def integrate_wire(
    state: FloatArray,
    length: FloatArray,
    weight: FloatArray,
    anchor: float = 0.0,
    derivatives: bool = False,
    start: PicardStart | None = None,
) -> WireSolution:
    """Integrate from a state over the whole wire.

    The error is about 1e-12 L unless the shape is so taut that rounding grows by exp(w L (1 - anchor)).

    Args:
        state: States at the anchor (B, 6).
        length: Lengths (B,) [m].
        weight: Weight q (B, 2) [1/m^3].
        anchor: Position sigma of the state, 0 or 0.5.
        derivatives: Whether to compute derivatives with respect to the state.
        start: Nodes and first guess of theta, by default those of `PicardStart`.

    Raises:
        ValueError: If the anchor is neither 0 nor 0.5.
    """
    if anchor not in (0.0, 0.5):
        raise ValueError(f"anchor: got {anchor}, allowed 0 or 0.5")
    start = PicardStart() if start is None else start
    guess, count = start.theta, start.count
    if guess is not None:
        count = guess.shape[1]
    if count is None:
        count = int(np.max(node_counts(state, length, weight), initial=32))
    grid = gauss_nodes(count)
    integral = grid.integral_from_start if anchor == 0.0 else grid.integral_from_middle
    double_integral = integral @ integral
    # F(s) = F_a - q s; theta = theta_a + k_a s + L^2 II (Fx sin theta - Fy cos theta)
    s = (grid.sigma - anchor) * length[:, None]
    fx = state[:, 4, None] - weight[:, 0, None] * s
    fy = state[:, 5, None] - weight[:, 1, None] * s
    linear = state[:, 2, None] + state[:, 3, None] * s
    length_squared = (length**2)[:, None]
    theta = _solve_theta(
        linear if guess is None else guess, linear, length_squared, (fx, fy), double_integral
    )
    sin, cos = np.sin(theta), np.cos(theta)
    scale = length[:, None]
    curvature = state[:, 3, None] + scale * ((fx * sin - fy * cos) @ integral.T)
    x = state[:, 0, None] + scale * (cos @ integral.T)
    y = state[:, 1, None] + scale * (sin @ integral.T)
    empty = np.empty((state.shape[0], 0, 4))
    d_theta = d_curvature = d_x = d_y = empty
    if derivatives:
        # (I - L^2 II diag(F.t)) d_theta = d(theta_a + k_a s) + L^2 II (dFx sin theta - dFy cos theta)
        tangential_force = fx * cos + fy * sin
        right = np.stack(
            [
                np.ones_like(s),
                s,
                length_squared * (sin @ double_integral.T),
                -length_squared * (cos @ double_integral.T),
            ],
            axis=-1,
        )
        matrix = np.eye(count) - double_integral * (length_squared * tangential_force)[:, None, :]
        d_theta = np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
        source = tangential_force[..., None] * d_theta
        source[..., 2] += sin
        source[..., 3] -= cos
        d_curvature = scale[..., None] * (integral @ source)
        d_curvature[..., 1] += 1.0
        d_x = -scale[..., None] * (integral @ (sin[..., None] * d_theta))
        d_y = scale[..., None] * (integral @ (cos[..., None] * d_theta))
    return WireSolution(
        theta, curvature, x, y, np.stack([fx, fy], axis=-1), length, d_theta, d_curvature, d_x, d_y
    )
