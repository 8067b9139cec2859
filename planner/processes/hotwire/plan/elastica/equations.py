"""Equations of the planar elastica as an initial value problem.

Legendre tools on [0, 1] that all wire solvers share: Gauss nodes, integration matrices, a basis
that vanishes at the ends. The unit of arc length there is the wire: sigma = s / L.

Balance of a wire of bending stiffness EI, everything divided by EI:

    r' = (cos theta, sin theta),  theta' = k,  k' = Fx sin theta - Fy cos theta,  F' = -q,

where F [1/m^2] is the force that the part beyond s exerts on the part before it (positive along the
tangent is tension) and q [1/m^3] is the weight of the wire per length as a vector in the plane (it
points down). Hence F(s) = F(0) - q s. These are the Euler-Lagrange equations of int k^2/2 - q.r ds
with given end poses (Love, Mathematical Theory of Elasticity, ch. 19; Levien 2009 for q = 0).

A state is (x, y, theta, k, Fx, Fy) at one place of the wire. Theta is found on Gauss-Legendre nodes
as the fixed point of theta = theta_a + k_a s + double integral of k'; the linearised equation gives
the derivatives by the state.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Nodes:
    """Gauss-Legendre nodes on [0, 1] with the matrices that act on values at them.

    sigma (n,), weight (n,): quadrature; series (n, n): values -> Legendre coefficients; start, middle (n,
    n): values -> integral from 0 or from 1/2 to each node."""

    sigma: FloatArray
    weight: FloatArray
    series: FloatArray
    start: FloatArray
    middle: FloatArray


@dataclass(frozen=True)
class Bumps:
    """Functions phi_j that vanish at 0 and 1, with int phi_i' phi_j' = delta_ij (Shen's basis, scaled),
    at Gauss nodes.

    sigma, weight (n,): nodes; value, slope (n, j).
    """

    sigma: FloatArray
    weight: FloatArray
    value: FloatArray
    slope: FloatArray


def legendre(sigma: FloatArray, count: int) -> FloatArray:
    """P_0 ... P_(count-1) at 2 sigma - 1; shape (..., count)."""
    x = 2.0 * np.asarray(sigma, dtype=np.float64) - 1.0
    table = np.empty((count, *x.shape))
    table[0] = 1.0
    if count > 1:
        table[1] = x
    for j in range(1, count - 1):
        table[j + 1] = ((2 * j + 1) * x * table[j] - j * table[j - 1]) / (j + 1)
    return np.ascontiguousarray(np.moveaxis(table, 0, -1))


def _integrals(sigma: FloatArray, count: int) -> FloatArray:
    """int_0^sigma P_j for j < count; shape (..., count)."""
    p = legendre(sigma, count + 1)
    out = np.empty((*np.shape(sigma), count))
    out[..., 0] = np.asarray(sigma)
    j = np.arange(1, count)
    out[..., 1:] = (p[..., 2:] - p[..., :-2]) / (2.0 * (2 * j + 1))
    return out


@lru_cache(maxsize=32)
def nodes(count: int) -> Nodes:
    """``count`` Gauss nodes on [0, 1] with what integrates and interpolates between them."""
    x, w = np.polynomial.legendre.leggauss(count)
    sigma = 0.5 * (x + 1.0)
    weight = 0.5 * w
    series = (legendre(sigma, count) * weight[:, None]).T * (2.0 * np.arange(count)[:, None] + 1.0)
    start = _integrals(sigma, count) @ series
    half = _integrals(np.array([0.5]), count) @ series
    return Nodes(sigma, weight, series, start, start - half)


def bump_values(sigma: FloatArray, count: int) -> FloatArray:
    """phi_j at sigma; shape (..., count)."""
    p = legendre(sigma, count + 2)
    out: FloatArray = (p[..., 2:] - p[..., :-2]) / (2.0 * np.sqrt(2.0 * np.arange(count) + 3.0))
    return out


def bump_slopes(sigma: FloatArray, count: int) -> FloatArray:
    """phi_j' (with respect to sigma) at sigma; shape (..., count)."""
    out: FloatArray = legendre(sigma, count + 1)[..., 1:] * np.sqrt(2.0 * np.arange(count) + 3.0)
    return out


@lru_cache(maxsize=32)
def bumps(count: int, quadrature: int) -> Bumps:
    """``count`` bumps at ``quadrature`` Gauss nodes."""
    x, w = np.polynomial.legendre.leggauss(quadrature)
    sigma = 0.5 * (x + 1.0)
    return Bumps(sigma, 0.5 * w, bump_values(sigma, count), bump_slopes(sigma, count))


_PICARD_ROUNDS = 90
"""Picard iterations at most for the angle of a heavy or weightless wire."""
_SETTLED = 2e-12  # rad


@dataclass(frozen=True)
class Flow:
    """Wires on n Gauss nodes of sigma = s / L in [0, 1].

    theta, curvature, x, y (B, n); force (B, n, 2); length (B,). `d_theta`, `d_curvature` (B, n, 4):
    derivatives by theta, k, Fx, Fy of the anchor state; `d_x`, `d_y` likewise (those by x and y of the
    anchor are 1 and 0). Empty unless asked for."""

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
        """Nodes along each wire."""
        return int(self.theta.shape[1])

    def at(self, sigma: FloatArray) -> FloatArray:
        """States (B, m, 6) at sigma (m,) or (B, m), from the Legendre series."""
        values = np.stack(
            [self.x, self.y, self.theta, self.curvature, self.force[..., 0], self.force[..., 1]], axis=-1
        )
        return interpolate(values, sigma)


def interpolate(values: FloatArray, sigma: FloatArray) -> FloatArray:
    """Values (B, n, c) on Gauss nodes -> (B, m, c) at sigma (m,) or (B, m)."""
    n = values.shape[1]
    table = legendre(sigma, n)
    out: FloatArray = table @ (nodes(n).series @ values)
    return out


def node_counts(
    state: FloatArray, length: FloatArray, weight: FloatArray, base: float = 22.0, per_wave: float = 4.5
) -> IntArray:
    """Nodes (B,) that resolve each wire: the poles of an elastica lie 1/w or more from the real axis.

    The defaults give an error of about 1e-11 L; base 14 and per_wave 3.6 about 1e-8 L.
    """
    force = np.hypot(state[:, 4], state[:, 5]) + 0.5 * np.hypot(weight[:, 0], weight[:, 1]) * length
    waves = np.sqrt(force + 0.25 * state[:, 3] ** 2) * length
    waves = np.nan_to_num(np.minimum(waves, 100.0))
    need = 16 * np.ceil((base + per_wave * waves) / 16.0)
    return np.asarray(np.clip(need, 32, 192), dtype=np.int64)


def _settle(
    theta: FloatArray,
    line: FloatArray,
    square: FloatArray,
    force: tuple[FloatArray, FloatArray],
    twice: FloatArray,
) -> FloatArray:
    """Picard's iteration: its error falls like (w L)^(2j) / (2j)! and it costs no linear solve; Newton
    for the rest."""
    fx, fy = force
    change = np.zeros(theta.shape[0])
    for _ in range(_PICARD_ROUNDS):
        last = theta
        theta = line + square * ((fx * np.sin(theta) - fy * np.cos(theta)) @ twice.T)
        change = np.max(np.abs(theta - last), axis=1, initial=0.0)
        if not (change > _SETTLED).any():  # rows that are not numbers stay so and hold nobody up
            return theta
    late = change > _SETTLED
    fx, fy, line, square, part = fx[late], fy[late], line[late], square[late], theta[late]
    for _ in range(10):
        sin, cos = np.sin(part), np.cos(part)
        rest = line + square * ((fx * sin - fy * cos) @ twice.T) - part
        matrix = np.eye(twice.shape[0]) - twice * (square * (fx * cos + fy * sin))[:, None, :]
        step = np.linalg.solve(matrix, rest[..., None])[..., 0]
        part = part + np.clip(step, -1.0, 1.0)
        if float(np.max(np.abs(step), initial=0.0)) < 1e-9:
            break
    theta[late] = part
    return theta


def flow(
    state: FloatArray,
    length: FloatArray,
    weight: FloatArray,
    anchor: float = 0.0,
    guess: FloatArray | None = None,
    derivatives: bool = False,
    count: int | None = None,
) -> Flow:
    """Integrate from the state (B, 6) at sigma = anchor (0 or 0.5) over the whole wire.

    length (B,), weight q (B, 2) [1/m^3]; guess: theta (B, n) at the n nodes. Error about 1e-12 L while
    the shape is not so taut that rounding grows by exp(w L (1 - anchor))."""
    if anchor not in (0.0, 0.5):
        raise ValueError(f"anchor: got {anchor}, allowed 0 or 0.5")
    if guess is not None:
        count = guess.shape[1]
    if count is None:
        count = int(np.max(node_counts(state, length, weight), initial=32))
    grid = nodes(count)
    integral = grid.start if anchor == 0.0 else grid.middle
    twice = integral @ integral
    s = (grid.sigma - anchor) * length[:, None]
    fx = state[:, 4, None] - weight[:, 0, None] * s
    fy = state[:, 5, None] - weight[:, 1, None] * s
    line = state[:, 2, None] + state[:, 3, None] * s
    square = (length**2)[:, None]
    theta = _settle(line if guess is None else guess, line, square, (fx, fy), twice)
    sin, cos = np.sin(theta), np.cos(theta)
    scale = length[:, None]
    curvature = state[:, 3, None] + scale * ((fx * sin - fy * cos) @ integral.T)
    x = state[:, 0, None] + scale * (cos @ integral.T)
    y = state[:, 1, None] + scale * (sin @ integral.T)
    empty = np.empty((state.shape[0], 0, 4))
    d_theta = d_curvature = d_x = d_y = empty
    if derivatives:
        pull = fx * cos + fy * sin
        right = np.stack([np.ones_like(s), s, square * (sin @ twice.T), -square * (cos @ twice.T)], axis=-1)
        matrix = np.eye(count) - twice * (square * pull)[:, None, :]
        d_theta = np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
        source = pull[..., None] * d_theta
        source[..., 2] += sin
        source[..., 3] -= cos
        d_curvature = scale[..., None] * (integral @ source)
        d_curvature[..., 1] += 1.0
        d_x = -scale[..., None] * (integral @ (sin[..., None] * d_theta))
        d_y = scale[..., None] * (integral @ (cos[..., None] * d_theta))
    return Flow(theta, curvature, x, y, np.stack([fx, fy], axis=-1), length, d_theta, d_curvature, d_x, d_y)
