"""Wires between two clamps: least energy of bending and weight under a given chord, for many wires at once.

theta = straight line between the end angles + sum a_j phi_j. In units of the wire the bending energy is
|a|^2 / 2 plus a constant, the constraint int (cos theta, sin theta) = chord, and its multiplier is the
force F at the start. The second derivative of the Lagrangian is the very form of in-plane stability, so
Newton's method with this form made positive finds minima and never comes to rest on a saddle by choice.
"""

from dataclasses import dataclass

import numpy as np

from planner.hotwire.basis import Array, Bumps, bump_values, bumps, legendre
from planner.hotwire.stability import constrained_smallest, project

MODES = 36
FINE_MODES = 64
_STEPS = 10  # of the homotopy from the first guess's chord to the wanted one
_LIMIT = 0.6  # rad: largest change of theta in one step


@dataclass(frozen=True)
class Clamped:
    """Solutions in units of the wire: bump amplitudes (B, j), force at the start (B, 2) times L^2, margin
    of in-plane stability (B,), residual of force balance and chord (B,)."""

    amplitude: Array
    force: Array
    margin: Array
    residual: Array


def clamped_theta(first: Array, last: Array, amplitude: Array, sigma: Array) -> Array:
    """theta (B, m) at sigma (m,) for end angles (B,) and amplitudes (B, j)."""
    line = first[:, None] + (last - first)[:, None] * sigma
    out: Array = line + amplitude @ bump_values(sigma, amplitude.shape[1]).T
    return out


def start_curvature(first: Array, last: Array, amplitude: Array) -> Array:
    """d theta / d sigma (B,) at the start."""
    slopes = _base(amplitude.shape[1]).slope_start
    out: Array = last - first + amplitude @ slopes
    return out


def _base(modes: int) -> Bumps:
    return bumps(modes, 2 * modes + 8)


@dataclass(frozen=True)
class _Terms:
    gradient: Array
    chord: Array
    normal: Array
    form: Array


def _terms(first: Array, last: Array, weight: Array, amplitude: Array, force: Array) -> _Terms:
    base = _base(amplitude.shape[1])
    theta = first[:, None] + (last - first)[:, None] * base.sigma + amplitude @ base.value.T
    sin, cos = np.sin(theta), np.cos(theta)
    fx = force[:, :1] - weight[:, :1] * base.sigma
    fy = force[:, 1:] - weight[:, 1:] * base.sigma
    gradient = amplitude + ((fx * sin - fy * cos) * base.weight) @ base.value
    chord = np.stack([cos @ base.weight, sin @ base.weight], axis=1)
    normal = (np.stack([-sin, cos], axis=1) * base.weight) @ base.value
    pull = (fx * cos + fy * sin) * base.weight
    form = np.eye(amplitude.shape[1]) + base.value.T @ (pull[:, :, None] * base.value)
    return _Terms(gradient, chord, normal, form)


def _saddle_step(form: Array, normal: Array, gradient: Array, miss: Array) -> tuple[Array, Array]:
    """Solve the equality-constrained Newton step; returns changes of amplitude and force."""
    batch, size = gradient.shape
    system = np.zeros((batch, size + 2, size + 2))
    system[:, :size, :size] = form
    system[:, :size, size:] = -np.swapaxes(normal, 1, 2)
    system[:, size:, :size] = normal
    tiny = 1e-13 * np.maximum(1.0, np.sum(normal**2, axis=(1, 2)))
    system[:, size, size] += tiny
    system[:, size + 1, size + 1] += tiny
    right = np.concatenate([-gradient, miss], axis=1)
    step = np.linalg.solve(system, right[..., None])[..., 0]
    return step[:, :size], step[:, size:]


def minimise(
    first: Array,
    last: Array,
    chord: Array,
    weight: Array,
    amplitude: Array,
    rounds: int = 60,
    limit: float = _LIMIT,
    tolerance: float = 1e-11,
) -> Clamped:
    """Local minima of the energy near the guessed amplitudes (B, j).

    first, last: end angles (B,) [rad]; chord (B, 2) over L; weight q L^3 (B, 2). Items that do not settle
    keep a residual above the tolerance; the caller judges by `residual` and `margin`."""
    a = amplitude.copy()
    batch, size = a.shape
    force = np.zeros((batch, 2))
    residual = np.full(batch, np.inf)
    begin = _terms(first, last, weight, a, force).chord
    active = np.arange(batch)
    for turn in range(rounds):
        i = active
        t = min(1.0, (turn + 1.0) / _STEPS)
        wanted = begin[i] + t * (chord[i] - begin[i])
        terms = _terms(first[i], last[i], weight[i], a[i], force[i])
        miss = wanted - terms.chord
        error = np.maximum(np.abs(terms.gradient).max(axis=1), np.abs(miss).max(axis=1))
        if t == 1.0:
            residual[i] = error
        projected, basis = project(terms.form, terms.normal)
        filled = projected + 2.0 * (np.swapaxes(basis, 1, 2) @ basis)
        lift = np.zeros(i.size)
        far = error > 1e-4  # near a solution its own margin decides, at the end
        lowest = np.linalg.eigvalsh(filled[far])[:, 0]
        lift[far] = np.where(lowest > 1e-5, 0.0, 0.03 - lowest)
        form = terms.form + lift[:, None, None] * np.eye(size)
        da, df = _saddle_step(form, terms.normal, terms.gradient, miss)
        moved = np.abs(da @ _base(size).value.T).max(axis=1)
        share = np.minimum(1.0, limit / np.maximum(moved, 1e-300))
        a[i] += share[:, None] * da
        force[i] += share[:, None] * df
        if t == 1.0:
            active = i[(error > tolerance) & np.isfinite(error) & (np.abs(force[i]).max(axis=1) < 1e6)]
            if active.size == 0:
                break
    return _judge(first, last, chord, weight, a, force)


def newton(
    first: Array, last: Array, chord: Array, weight: Array, amplitude: Array, force: Array, rounds: int = 12
) -> Clamped:
    """The equilibrium next to a guess, stable or not: plain Newton from amplitudes (B, j) and force (B,
    2)."""
    a, f = amplitude.copy(), force.copy()
    for _ in range(rounds):
        terms = _terms(first, last, weight, a, f)
        miss = chord - terms.chord
        if float(max(np.abs(terms.gradient).max(initial=0.0), np.abs(miss).max(initial=0.0))) < 1e-13:
            break
        da, df = _saddle_step(terms.form, terms.normal, terms.gradient, miss)
        moved = np.abs(da @ _base(a.shape[1]).value.T).max(axis=1)
        share = np.minimum(1.0, _LIMIT / np.maximum(moved, 1e-300))
        a += share[:, None] * da
        f += share[:, None] * df
    return _judge(first, last, chord, weight, a, f)


def _judge(first: Array, last: Array, chord: Array, weight: Array, a: Array, f: Array) -> Clamped:
    """Margins and residuals; items that ran away get -inf and inf."""
    terms = _terms(first, last, weight, a, f)
    residual = np.maximum(np.abs(terms.gradient).max(axis=1), np.abs(chord - terms.chord).max(axis=1))
    residual = np.where(np.isfinite(residual), residual, np.inf)
    return Clamped(a, f, constrained_smallest(terms.form, terms.normal), residual)


def amplitudes_of(sigma_theta: Array, sigma: Array, weight: Array, modes: int = MODES) -> Array:
    """Bump amplitudes (B, modes) of theta (B, n) at Gauss nodes: projection of the slope, by partial
    integration."""
    first = sigma_theta @ _edge(sigma.size, sigma, weight, 0.0)
    last = sigma_theta @ _edge(sigma.size, sigma, weight, 1.0)
    slopes = np.sqrt(2.0 * np.arange(modes) + 3.0)
    # int theta' psi = [theta psi] - int theta psi', psi_j = sqrt(2j+3) P_(j+1)
    ends = last[:, None] * slopes - first[:, None] * slopes * (-1.0) ** (np.arange(modes) + 1)
    p = legendre(sigma, modes + 1)
    slope = np.zeros_like(p)
    for j in range(1, modes + 1):
        slope[:, j] = (2.0 * (2 * j - 1)) * p[:, j - 1] + (slope[:, j - 2] if j >= 2 else 0.0)
    out: Array = ends - (sigma_theta * weight) @ (slope[:, 1:] * slopes)
    return out


def _edge(count: int, sigma: Array, weight: Array, where: float) -> Array:
    """Row that extrapolates values at Gauss nodes to an end."""
    p = legendre(sigma, count)
    series = (p * weight[:, None]).T * (2.0 * np.arange(count)[:, None] + 1.0)
    out: Array = legendre(np.array([where]), count)[0] @ series
    return out
