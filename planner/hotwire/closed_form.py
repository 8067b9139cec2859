"""The elastica without weight in closed form, by Jacobi's elliptic functions.

With w^2 = |F|, phi = atan2(Fy, Fx) + pi and psi = theta - phi the equation k' = Fx sin theta - Fy cos
theta becomes the pendulum psi'' = -w^2 sin psi, whose solution is classical (Love ch. 19; Levien, The
elastica: a mathematical history, 2009). Near the separatrix (m = 1), for small forces and for lines and
arcs the formulas lose digits; there the initial value problem is solved on Gauss nodes instead (`flow`),
so that the error stays about 1e-12 of the length everywhere."""

import numpy as np
from scipy.special import ellipeinc, ellipj, ellipkinc

from planner.hotwire.basis import Array, Mask
from planner.hotwire.flow import flow

_NEAR_SEPARATRIX = 1e-5
_LARGEST_PARAMETER = 1e3  # beyond it 1/m cancels digits: almost an arc


def _wrap(angle: Array) -> Array:
    out: Array = np.pi - np.mod(np.pi - angle, 2.0 * np.pi)
    return out


def elliptic_modulus(state: Array) -> tuple[Array, Array, Array]:
    """(w, m^2, psi) of states (B, 6); m^2 is inf where F = 0. Inflections exist for m^2 < 1 only."""
    w = np.sqrt(np.hypot(state[:, 4], state[:, 5]))
    psi = _wrap(state[:, 2] - np.arctan2(state[:, 5], state[:, 4]) - np.pi)
    with np.errstate(divide="ignore", invalid="ignore"):
        m2 = np.sin(0.5 * psi) ** 2 + (state[:, 3] / (2.0 * w)) ** 2
    return w, np.where(w > 0.0, m2, np.inf), psi


def elliptic(state: Array, length: Array) -> Mask:
    """Where the closed form is used; elsewhere the initial value problem."""
    w, m2, _ = elliptic_modulus(state)
    near = (
        (np.abs(m2 - 1.0) < _NEAR_SEPARATRIX) | (m2 > _LARGEST_PARAMETER) | (w * length < 1e-3) | (m2 < 1e-12)
    )
    return ~near


def evaluate(state: Array, offset: Array, reach: Array) -> Array:
    """Points (B, m, 4) = x, y, theta, k at arc offsets (B, m) from the states (B, 6), |offset| <= reach
    (B,)."""
    out = np.empty((*offset.shape, 4))
    closed = elliptic(state, 2.0 * reach)
    w, m2, psi = elliptic_modulus(state)
    inflected = closed & (m2 < 1.0)
    if inflected.any():
        out[inflected] = _inflected(
            state[inflected], offset[inflected], w[inflected], m2[inflected], psi[inflected]
        )
    free = closed & (m2 > 1.0)
    if free.any():
        out[free] = _uninflected(state[free], offset[free], w[free], m2[free], psi[free])
    other = ~closed
    if other.any():
        span = 2.0 * reach[other]
        wire = flow(state[other], span, np.zeros((span.size, 2)), anchor=0.5)
        out[other] = wire.at(offset[other] / span[:, None] + 0.5)[..., :4]
    return out


def _place(state: Array, w: Array, psi0: Array, along: Array, across: Array, psi: Array, k: Array) -> Array:
    """Rotate the pendulum frame by phi and set it on the state."""
    phi = (state[:, 2] - psi0)[:, None]
    x = state[:, 0, None] + along * np.cos(phi) - across * np.sin(phi)
    y = state[:, 1, None] + along * np.sin(phi) + across * np.cos(phi)
    return np.stack([x, y, phi + psi, k], axis=-1)


def _inflected(state: Array, s: Array, w: Array, m2: Array, psi0: Array) -> Array:
    m = np.sqrt(m2)
    u0 = ellipkinc(np.arctan2(np.sin(0.5 * psi0) / m, state[:, 3] / (2.0 * w * m)), m2)[:, None]
    wc, mc, m2c = w[:, None], m[:, None], m2[:, None]
    sn, cn, _, am = ellipj(u0 + wc * s, m2c)
    _, cn0, _, am0 = ellipj(u0, m2c)
    psi = 2.0 * np.arcsin(np.clip(mc * sn, -1.0, 1.0))
    along = 2.0 / wc * (ellipeinc(am, m2c) - ellipeinc(am0, m2c)) - s
    across = 2.0 * mc / wc * (cn0 - cn)
    return _place(state, w, psi0, along, across, psi, 2.0 * mc * wc * cn)


def _uninflected(state: Array, s: Array, w: Array, m2: Array, psi0: Array) -> Array:
    m = np.sqrt(m2)[:, None]
    n = 1.0 / m2[:, None]
    sign = np.where(state[:, 3] < 0.0, -1.0, 1.0)[:, None]
    wc = w[:, None]
    v0 = ellipkinc(sign * 0.5 * psi0[:, None], n)
    _, _, dn, am = ellipj(v0 + m * wc * s, n)
    _, _, dn0, am0 = ellipj(v0, n)
    along = s - 2.0 / (m * wc * n) * (m * wc * s - (ellipeinc(am, n) - ellipeinc(am0, n)))
    across = sign * 2.0 / (m * wc * n) * (dn0 - dn)
    return _place(state, w, psi0, along, across, 2.0 * sign * am, sign * 2.0 * m * wc * dn)
