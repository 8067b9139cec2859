"""How much a clamped wire moves when its clamps, its length or its weight are not as planned (in its
plane)."""

from dataclasses import dataclass

import numpy as np

from planner.hotwire.basis import Array, bumps, nodes
from planner.hotwire.heavy import HeavyShape, integrate, solve
from planner.hotwire.stability import STABLE, constrained_smallest

_MODES = 32
_QUADRATURE = 80


@dataclass(frozen=True)
class EndSensitivity:
    """Largest normal displacement of the wire inside the window, per unit of error; infinite for wires at
    or beyond buckling.

    position (B,) [m/m]: both ends off by one unit, each in its worst direction in the plane; ends (B,)
    [m/m]: both ends off by one unit each way in the plane, as errors that are independent, so that squares
    add; angle (B,)
    [m/rad]: both clamp angles off by one unit, in the worst senses; length (B,) [m/m]: the wire one unit
    too long. profile (B, n, 7): normal displacement at sigma (n,) by xA, yA, thetaA, xB, yB, thetaB, L.
    """

    position: Array
    ends: Array
    angle: Array
    length: Array
    sigma: Array
    profile: Array


def end_sensitivity(shape: HeavyShape, window: Array | None = None) -> EndSensitivity:
    """Linearised clamped problem at each wire; window (B, 2): arc lengths [m] between which the wire
    counts (default: all)."""
    base = bumps(_MODES, _QUADRATURE)
    sigma, w = base.sigma, base.weight
    at = shape.flow().at(sigma)
    length = shape.length[:, None]
    sin, cos = np.sin(at[..., 2]), np.cos(at[..., 2])
    pull = length**2 * (at[..., 4] * cos + at[..., 5] * sin)
    normal = np.stack([-sin, cos], axis=1)
    batch = shape.length.size
    form = np.eye(_MODES) + base.value.T @ ((pull * w)[:, :, None] * base.value)
    rows = (normal * w) @ base.value

    # inputs: xA, yA, thetaA, xB, yB, thetaB, L; a lift is the change of theta that an end angle brings along
    lift = np.zeros((7, sigma.size))
    lift[2], lift[5] = 1.0 - sigma, sigma
    chord = np.zeros((batch, 2, 7))
    chord[:, 0, 0] = chord[:, 1, 1] = -1.0 / shape.length
    chord[:, 0, 3] = chord[:, 1, 4] = 1.0 / shape.length
    inner = np.stack([cos, sin], axis=1)
    chord[:, :, 6] = -(inner @ w) / length
    chord -= (normal * w) @ lift.T
    gradient = -np.swapaxes(((pull * w)[:, None, :] * lift) @ base.value, 1, 2)
    # a longer wire is heavier in its own units: d(q L^3) = 3 q L^2 dL lowers F by that times sigma
    load = 3.0 * shape.weight * (shape.length**2)[:, None]
    heavier = (load[:, :1] * sin - load[:, 1:] * cos) * sigma * w
    gradient[:, :, 6] += heavier @ base.value

    size = _MODES
    system = np.zeros((batch, size + 2, size + 2))
    system[:, :size, :size] = form
    system[:, :size, size:] = -np.swapaxes(rows, 1, 2)
    system[:, size:, :size] = rows
    right = np.concatenate([gradient, chord], axis=1)
    gram = rows @ np.swapaxes(rows, 1, 2)
    determinant = gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2  # 0 where the wire is straight
    singular = ~(determinant > 1e-16 * (gram[:, 0, 0] + gram[:, 1, 1]))
    bad = singular | (constrained_smallest(form, rows) <= STABLE)
    system[bad] = np.eye(size + 2)
    right[bad] = 0.0
    change = np.linalg.solve(system, right)[:, :size]
    d_theta = base.value @ change + lift.T
    path = nodes(_QUADRATURE).start
    dx = length[..., None] * (path @ (-sin[..., None] * d_theta))
    dy = length[..., None] * (path @ (cos[..., None] * d_theta))
    dx[..., 0] += 1.0
    dy[..., 1] += 1.0
    dx[..., 6] += cos @ path.T
    dy[..., 6] += sin @ path.T
    profile = -sin[..., None] * dx + cos[..., None] * dy
    profile[bad] = np.inf
    s = sigma * length
    inside = (
        np.ones_like(s, dtype=np.bool_) if window is None else (s >= window[:, :1]) & (s <= window[:, 1:])
    )
    if not inside.any(axis=1).all():
        raise ValueError(
            "window: got an arc window without any node of the wire; give one at least 3 % of the length wide"
        )
    first, last = np.hypot(profile[..., 0], profile[..., 1]), np.hypot(profile[..., 3], profile[..., 4])
    angle = np.abs(profile[..., 2]) + np.abs(profile[..., 5])
    return EndSensitivity(
        np.max(first + last, axis=1, where=inside, initial=0.0),
        np.max(np.hypot(first, last), axis=1, where=inside, initial=0.0),
        np.max(angle, axis=1, where=inside, initial=0.0),
        np.max(np.abs(profile[..., 6]), axis=1, where=inside, initial=0.0),
        sigma,
        profile,
    )


def weight_deviation(shape: HeavyShape, n: int = 101, steps: int = 4) -> tuple[Array, Array]:
    """How far weight moves the wire in its plane between the same clamps: largest (B,) [m] and profile
    (B, n) along the normal.

    The weight is taken off in steps, each solved from the last. Infinite where the wire without weight
    has no shape on this branch (it would snap)."""
    start, end = shape.start, shape.end
    params = shape.params.copy()
    alive = np.arange(shape.length.size)
    for i in range(1, steps + 1):
        weight = (1.0 - i / steps) * shape.weight[alive]
        now = solve(shape.length[alive], start[alive], end[alive], weight, params[alive], n=2, strict=False)
        ok = np.isfinite(now.params[:, 0])
        alive = alive[ok]
        params[alive] = now.params[ok]
    profile = np.full((shape.length.size, n), np.inf)
    if alive.size:
        light = integrate(params[alive], shape.length[alive], np.zeros((alive.size, 2)), n)
        full = integrate(shape.params[alive], shape.length[alive], shape.weight[alive], n)
        gap = full.points - light.points
        profile[alive] = gap[..., 1] * np.cos(full.theta) - gap[..., 0] * np.sin(full.theta)
    return np.abs(profile).max(axis=1), profile


def straight_bow(length: Array, error: Array) -> Array:
    """Bow [m] of a straight wire whose clamps come closer by error [m]: (2/pi) sqrt(L d), from the first
    buckled shape."""
    out: Array = 2.0 / np.pi * np.sqrt(length * error)
    return out
