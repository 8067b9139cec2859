"""From the Galerkin solution of a clamped wire to the exact one: Newton on the state at the wire's middle."""

import numpy as np

from planner.hotwire import clamped
from planner.hotwire.basis import Array, legendre, nodes
from planner.hotwire.flow import flow, interpolate


def middle_state(
    start: Array, end: Array, length: Array, weight: Array, amplitude: Array, force: Array
) -> Array:
    """State (B, 6) at s = L/2 of bump amplitudes (B, j) and force at the start (B, 2) in units of the
    wire (F L^2).

    start, end: poses (B, 3); weight q (B, 2) [1/m^3].
    """
    modes = amplitude.shape[1]
    grid = nodes(64)
    theta = clamped.clamped_theta(start[:, 2], end[:, 2], amplitude, 0.5 * grid.sigma)
    half = np.array([0.5])
    slope = legendre(half, modes + 1)[0, 1:] * np.sqrt(2.0 * np.arange(modes) + 3.0)
    x = start[:, 0] + 0.5 * length * (np.cos(theta) @ grid.weight)
    y = start[:, 1] + 0.5 * length * (np.sin(theta) @ grid.weight)
    angle = clamped.clamped_theta(start[:, 2], end[:, 2], amplitude, half)[:, 0]
    k = (end[:, 2] - start[:, 2] + amplitude @ slope) / length
    at_middle = force / (length**2)[:, None] - 0.5 * length[:, None] * weight
    return np.concatenate([np.stack([x, y, angle, k], axis=1), at_middle], axis=1)


def polish(state: Array, start: Array, end: Array, length: Array, weight: Array) -> tuple[Array, Array]:
    """Newton on the middle state (B, 6) with both end poses as conditions; returns states and the largest
    miss over L."""
    unit = np.stack([length, length, np.ones_like(length), 1 / length, length**-2, length**-2], axis=1)
    scale = np.concatenate([unit[:, :3], unit[:, :3]], axis=1)
    want = np.concatenate([start, end], axis=1)
    best, least = state.copy(), np.full(length.size, np.inf)
    state = state.copy()
    ends_at = np.array([0.0, 1.0])
    for turn in range(5):
        wire = flow(state, length, weight, anchor=0.5, derivatives=turn < 4)
        ends = wire.at(ends_at)[..., :3].reshape(-1, 6)
        miss = (want - ends) / scale
        size = np.abs(miss).max(axis=1)
        better = size < least
        best[better], least[better] = state[better], size[better]
        if turn == 4 or not float(np.max(size, initial=0.0)) > 1e-13:
            break
        d = interpolate(np.concatenate([wire.d_x, wire.d_y, wire.d_theta], axis=-1), ends_at)
        jacobian = np.zeros((length.size, 6, 6))
        jacobian[:, :, 2:] = d.reshape(-1, 6, 4)
        jacobian[:, (0, 3), 0] = 1.0
        jacobian[:, (1, 4), 1] = 1.0
        jacobian *= unit[:, None, :] / scale[:, :, None]
        good = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(miss).all(axis=1)
        step = np.einsum("bij,bj->bi", np.linalg.pinv(jacobian[good], rcond=1e-13), miss[good])
        state[good] += step * unit[good]
    return best, least
