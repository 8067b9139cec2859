"""The planar elastica with weight as an initial value problem, for many wires at once.

Balance of a wire of bending stiffness EI, everything divided by EI:

    r' = (cos theta, sin theta),  theta' = k,  k' = Fx sin theta - Fy cos theta,  F' = -q,

where F [1/m^2] is the force that the part beyond s exerts on the part before it (positive along the tangent is tension) and
q [1/m^3] is the weight of the wire per length as a vector in the plane (it points down). Hence F(s) = F(0) - q s.
These are the Euler-Lagrange equations of int k^2/2 - q.r ds with given end poses (Love, Mathematical Theory of
Elasticity, ch. 19; Levien 2009 for q = 0).

A state is (x, y, theta, k, Fx, Fy) at one place of the wire. Theta is found on Gauss-Legendre nodes by Newton's method on
theta = theta_a + k_a s + double integral of k'; the same matrix gives the derivatives by the state.
"""

from dataclasses import dataclass

import numpy as np

from planner.hotwire.basis import Array, legendre, nodes

STATE = 6  # x, y, theta, k, Fx, Fy


@dataclass(frozen=True)
class Flow:
    """Wires on n Gauss nodes of sigma = s / L in [0, 1].

    theta, curvature, x, y (B, n); force (B, n, 2); length (B,). `d_theta`, `d_curvature` (B, n, 4): derivatives by theta,
    k, Fx, Fy of the anchor state; `d_x`, `d_y` likewise (those by x and y of the anchor are 1 and 0). Empty unless asked for.
    """

    theta: Array
    curvature: Array
    x: Array
    y: Array
    force: Array
    length: Array
    d_theta: Array
    d_curvature: Array
    d_x: Array
    d_y: Array

    @property
    def count(self) -> int:
        return int(self.theta.shape[1])

    def at(self, sigma: Array) -> Array:
        """States (B, m, 6) at sigma (m,) or (B, m), from the Legendre series."""
        values = np.stack(
            [self.x, self.y, self.theta, self.curvature, self.force[..., 0], self.force[..., 1]], axis=-1
        )
        return interpolate(values, sigma)


def interpolate(values: Array, sigma: Array) -> Array:
    """Values (B, n, c) on Gauss nodes -> (B, m, c) at sigma (m,) or (B, m)."""
    n = values.shape[1]
    table = legendre(sigma, n)
    out: Array = table @ (nodes(n).series @ values)
    return out


def node_count(state: Array, length: Array, weight: Array) -> int:
    """Nodes that resolve theta to about 1e-12: the poles of an elastica lie 1/w or more from the real axis."""
    force = np.hypot(state[:, 4], state[:, 5]) + 0.5 * np.hypot(weight[:, 0], weight[:, 1]) * length
    waves = np.sqrt(force + 0.25 * state[:, 3] ** 2) * length
    largest = float(np.max(waves, initial=0.0))
    return int(np.clip(16 * np.ceil((22.0 + 4.5 * largest) / 16.0), 32, 192))


def _coarse(state: Array, length: Array, weight: Array, anchor: float, sigma: Array) -> Array:
    """First guess of theta at sigma: classic Runge-Kutta from the anchor to both ends, Hermite in between."""
    theta = np.empty((state.shape[0], sigma.size))
    for side in ((sigma >= anchor), (sigma < anchor)):
        if not side.any():
            continue
        far = 1.0 if sigma[side][0] >= anchor else 0.0
        span = (far - anchor) * length
        steps = max(32, sigma.size)
        h = span / steps
        t, k = state[:, 2].copy(), state[:, 3].copy()
        fx, fy = state[:, 4].copy(), state[:, 5].copy()
        grid_t, grid_k = np.empty((2, steps + 1, state.shape[0]))
        grid_t[0], grid_k[0] = t, k
        dx, dy = -weight[:, 0] * h, -weight[:, 1] * h
        for i in range(steps):
            mx, my = fx + 0.5 * dx, fy + 0.5 * dy
            a1 = fx * np.sin(t) - fy * np.cos(t)
            t2 = t + 0.5 * h * k + 0.125 * h * h * a1
            a2 = mx * np.sin(t2) - my * np.cos(t2)
            t3 = t + h * k + 0.5 * h * h * a2
            fx, fy = fx + dx, fy + dy
            a3 = fx * np.sin(t3) - fy * np.cos(t3)
            t = t + h * k + h * h / 6.0 * (a1 + 2.0 * a2)
            k = k + h / 6.0 * (a1 + 4.0 * a2 + a3)
            grid_t[i + 1], grid_k[i + 1] = t, k
        place = (sigma[side] - anchor) / (far - anchor) * steps
        cell = np.minimum(place.astype(np.int64), steps - 1)
        u = (place - cell)[:, None]
        t0, t1, k0, k1 = grid_t[cell], grid_t[cell + 1], grid_k[cell] * h, grid_k[cell + 1] * h
        cubic = t0 + u * (k0 + u * (3 * (t1 - t0) - 2 * k0 - k1 + u * (2 * (t0 - t1) + k0 + k1)))
        theta[:, side] = cubic.T
    return theta


def flow(
    state: Array,
    length: Array,
    weight: Array,
    anchor: float = 0.0,
    guess: Array | None = None,
    derivatives: bool = False,
    count: int | None = None,
) -> Flow:
    """Integrate from the state (B, 6) at sigma = anchor (0 or 0.5) over the whole wire.

    length (B,), weight q (B, 2) [1/m^3]; guess: theta (B, n) at the n nodes. Error about 1e-12 L while the shape is not so
    taut that rounding grows by exp(w L (1 - anchor)).
    """
    if anchor not in (0.0, 0.5):
        raise ValueError(f"anchor: got {anchor}, allowed 0 or 0.5")
    if guess is not None:
        count = guess.shape[1]
    if count is None:
        count = node_count(state, length, weight)
    grid = nodes(count)
    integral = grid.start if anchor == 0.0 else grid.middle
    twice = integral @ integral
    s = (grid.sigma - anchor) * length[:, None]
    fx = state[:, 4, None] - weight[:, 0, None] * s
    fy = state[:, 5, None] - weight[:, 1, None] * s
    line = state[:, 2, None] + state[:, 3, None] * s
    square = (length**2)[:, None]
    theta = _coarse(state, length, weight, anchor, grid.sigma) if guess is None else guess
    eye = np.eye(count)
    for _ in range(8):
        sin, cos = np.sin(theta), np.cos(theta)
        pull = fx * cos + fy * sin
        rest = line + square * ((fx * sin - fy * cos) @ twice.T) - theta
        matrix = eye - twice * (square * pull)[:, None, :]
        step = np.linalg.solve(matrix, rest[..., None])[..., 0]
        theta = theta + np.clip(step, -1.0, 1.0)
        if float(np.max(np.abs(step), initial=0.0)) < 1e-9:
            break
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
        matrix = eye - twice * (square * pull)[:, None, :]
        d_theta = np.linalg.solve(matrix, right)
        source = pull[..., None] * d_theta
        source[..., 2] += sin
        source[..., 3] -= cos
        d_curvature = scale[..., None] * (integral @ source)
        d_curvature[..., 1] += 1.0
        d_x = -scale[..., None] * (integral @ (sin[..., None] * d_theta))
        d_y = scale[..., None] * (integral @ (cos[..., None] * d_theta))
    return Flow(theta, curvature, x, y, np.stack([fx, fy], axis=-1), length, d_theta, d_curvature, d_x, d_y)
