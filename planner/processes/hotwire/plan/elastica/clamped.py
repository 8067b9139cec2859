"""Wires between two clamps: shapes of least energy under a given chord, and their stability.

For many wires at once, with bending and weight. theta = straight line between the end angles + sum
a_j phi_j. In units of the wire the bending energy is |a|^2 / 2 plus a constant, the constraint int
(cos theta, sin theta) = chord, and its multiplier is the force F at the start. The second
derivative of the Lagrangian is the very form of in-plane stability.

From this Galerkin solution to the exact one: Newton on the state at the wire's middle (`polish`).

**Stability** of planar wire shapes between clamps, in and out of their plane, with weight.

A shape is stable where the second variation of its energy is positive for every motion that the
clamps allow. Both forms are set up in functions with orthonormal slopes, so that the result is a
pure number: the smallest value of second variation / int |w'|^2. It is 1 for a straight wire
without force, falls under compression and is 0 at buckling.

In plane (eta: change of theta; Sachkov, arXiv 0705.1003): int eta'^2 + (F.t) eta^2 with int eta n =
0.

Out of plane (w: rotation about tangent and normal, B = 1 the stiffness in the plane, C = GJ/EI, B2
= stiff/soft bending): int C (wt' - k wn)^2 + B2 (wn' + k wt)^2 - k^2 (wt^2 + wn^2) - k (wt wn' - wn
wt') + Ft wn^2 - Fn wt wn with int wn = 0. It is the second order of the energy of a rod whose frame
is turned by exp(w); weight enters by F(s) alone, because the load's energy is -int F(s).t ds.
"""

from dataclasses import dataclass

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.processes.hotwire.plan.elastica.equations import (
    Bumps,
    bump_values,
    bumps,
    flow,
    interpolate,
    legendre,
    nodes,
)

STABLE = 1e-6  # smallest second variation that counts as stable
_MODES_IN = 32
"""Functions that stand for a wire's movements in its plane."""
_MODES_OUT = 28
"""Functions that stand for each of twist and bending out of its plane."""
_QUADRATURE = 72
"""Gauss points along the wire for stability."""


@dataclass(frozen=True)
class Section:
    """Stiffness ratios of a wire's cross-section: torsion GJ/EI and stiff bending EI2/EI over the bending
    stiffness EI in the plane of the shape."""

    torsion: float
    stiff: float


def round_section(nu: float) -> Section:
    """A round wire of Poisson's ratio nu: GJ/EI = 1/(1 + nu)."""
    if not -1.0 < nu <= 0.5:
        raise ValueError(
            f"nu: got {nu}, allowed more than -1 and at most 0.5; give Poisson's ratio of the wire"
        )
    return Section(torsion=1.0 / (1.0 + nu), stiff=1.0)


def strip(ratio: float, nu: float) -> Section:
    """A rectangular strip of ratio = width / thickness >= 1 that bends the soft way in the plane.

    Torsion constant J = w t^3/3 (1 - 0.630 t/w + 0.052 (t/w)^5) (Timoshenko and Goodier, Theory of
    Elasticity, art. 109)."""
    if not ratio >= 1.0:
        raise ValueError(f"ratio: got {ratio}, allowed 1 or more; give width / thickness")
    if not -1.0 < nu <= 0.5:
        raise ValueError(
            f"nu: got {nu}, allowed more than -1 and at most 0.5; give Poisson's ratio of the strip"
        )
    shape = 4.0 * (1.0 - 0.630 / ratio + 0.052 / ratio**5)
    return Section(torsion=shape / (2.0 * (1.0 + nu)), stiff=ratio**2)


def quadrature() -> FloatArray:
    """The places sigma = s / L at which the functions below want theta, curvature and force."""
    return bumps(_MODES_OUT, _QUADRATURE).sigma


def constrained_smallest(form: FloatArray, constraints: FloatArray, barrier: float = 2.0) -> FloatArray:
    """Smallest eigenvalue (B,) of forms (B, n, n) on the space orthogonal to constraints (B, c, n), c <= 2.

    A constraint that vanishes (the second one of a straight wire) is left out. Forms that are not finite,
    those of wires that do not exist, give -inf."""
    good = np.isfinite(form).all(axis=(1, 2)) & np.isfinite(constraints).all(axis=(1, 2))
    projected, basis = project(form[good], constraints[good])
    fill = barrier * (np.swapaxes(basis, 1, 2) @ basis)
    out = np.full(form.shape[0], -np.inf)
    out[good] = np.linalg.eigvalsh(projected + fill)[:, 0]
    return out


def project(form: FloatArray, constraints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(P H P, U): forms on the space orthogonal to the constraints, and an orthonormal basis U (B, c, n)
    of these, with zero rows for those that vanish."""
    gram = constraints @ np.swapaxes(constraints, 1, 2)
    value, vector = np.linalg.eigh(gram)
    keep = value > 1e-18 * np.maximum(value[:, -1:], 1.0)
    scale = np.where(keep, 1.0 / np.sqrt(np.where(keep, value, 1.0)), 0.0)
    basis = scale[:, :, None] * (np.swapaxes(vector, 1, 2) @ constraints)
    half = form - (form @ np.swapaxes(basis, 1, 2)) @ basis
    full = half - np.swapaxes(basis, 1, 2) @ (basis @ half)
    return full, basis


def in_plane(theta: FloatArray, force: FloatArray, length: FloatArray) -> FloatArray:
    """Margin (B,) of theta (B, n) [rad] and force F (B, n, 2) [1/m^2] at `quadrature()`; length (B,) [m]."""
    base = bumps(_MODES_IN, _QUADRATURE)
    sin, cos = np.sin(theta), np.cos(theta)
    pull = (length**2)[:, None] * (force[..., 0] * cos + force[..., 1] * sin) * base.weight
    form = np.eye(_MODES_IN) + base.value.T @ (pull[:, :, None] * base.value)
    normal = np.stack([-sin, cos], axis=1) * base.weight
    return constrained_smallest(form, normal @ base.value)


def out_of_plane_form(
    theta: FloatArray, curvature: FloatArray, force: FloatArray, length: FloatArray, section: Section
) -> FloatArray:
    """The form (B, 2m, 2m) in units of 1/L over bumps for wt, then wn; arguments as `out_of_plane`."""
    base = bumps(_MODES_OUT, _QUADRATURE)
    k = curvature * length[:, None]
    square = (length**2)[:, None]
    ft = square * (force[..., 0] * np.cos(theta) + force[..., 1] * np.sin(theta))
    fn = square * (force[..., 1] * np.cos(theta) - force[..., 0] * np.sin(theta))
    c, b = section.torsion, section.stiff
    value, slope, weight = base.value, base.slope, base.weight

    def pair(left: FloatArray, factor: FloatArray, right: FloatArray) -> FloatArray:
        out: FloatArray = left.T @ ((factor * weight)[:, :, None] * right)
        return out

    eye = np.eye(_MODES_OUT)
    tangent = c * eye + pair(value, (b - 1.0) * k**2, value)
    normal = b * eye + pair(value, (c - 1.0) * k**2 + ft, value)
    mixed = (
        pair(value, (b - 0.5) * k, slope) - pair(slope, (c - 0.5) * k, value) - pair(value, 0.5 * fn, value)
    )
    return np.block([[tangent, mixed], [np.swapaxes(mixed, 1, 2), normal]])


def out_of_plane(
    theta: FloatArray, curvature: FloatArray, force: FloatArray, length: FloatArray, section: Section
) -> FloatArray:
    """Margin (B,) against leaving the plane; theta, curvature (B, n), force (B, n, 2) at `quadrature()`."""
    form = out_of_plane_form(theta, curvature, force, length, section)
    return constrained_smallest(form, out_of_plane_constraint(form.shape[0]))


def out_of_plane_constraint(batch: int) -> FloatArray:
    """int wn = 0 as (batch, 1, 2m)."""
    base = bumps(_MODES_OUT, _QUADRATURE)
    row = np.concatenate([np.zeros(_MODES_OUT), base.weight @ base.value])
    return np.tile(row, (batch, 1, 1))


def out_of_plane_sag(
    theta: FloatArray,
    curvature: FloatArray,
    force: FloatArray,
    length: FloatArray,
    section: Section,
    load: FloatArray,
    sigma: FloatArray,
) -> FloatArray:
    """Linear response to a load across the plane: deflection (B, m) [m] along z = x cross y at sigma (m,).

    load (B,) [1/m^3]: force per length along z over EI in the plane. The energy of the load is int (L -
    s) load wn ds. Infinite where the shape is not stable out of its plane."""
    base = bumps(_MODES_OUT, _QUADRATURE)
    batch = theta.shape[0]
    form = out_of_plane_form(theta, curvature, force, length, section)
    rows = out_of_plane_constraint(batch)
    size = form.shape[1]
    system = np.zeros((batch, size + 1, size + 1))
    system[:, :size, :size] = form
    system[:, :size, size] = rows[:, 0]
    system[:, size, :size] = rows[:, 0]
    right = np.zeros((batch, size + 1))
    arm = base.weight * (1.0 - base.sigma)
    right[:, _MODES_OUT:size] = -(load * length**3)[:, None] * (arm @ base.value)
    stable = constrained_smallest(form, rows) > STABLE
    system[~stable] = np.eye(size + 1)
    right[~stable] = 0.0
    wn = np.linalg.solve(system, right[..., None])[:, _MODES_OUT:size, 0]
    x, w = np.polynomial.legendre.leggauss(_MODES_OUT + 2)
    part = 0.5 * (x + 1.0) * sigma[:, None]
    from_start = np.einsum("mq,mqj->mj", 0.5 * w * sigma[:, None], bump_values(part, _MODES_OUT))
    out: FloatArray = -length[:, None] * (wn @ from_start.T)
    out[~stable] = np.inf
    return out


MODES = 36
"""Functions by which a wire's angle is expanded between its clamps."""
_MOST_ROTATION = 0.6  # rad: largest change of theta in one step


@dataclass(frozen=True)
class Clamped:
    """Solutions in units of the wire: bump amplitudes (B, j), force at the start (B, 2) times L^2, margin
    of in-plane stability (B,), residual of force balance and chord (B,)."""

    amplitude: FloatArray
    force: FloatArray
    margin: FloatArray
    residual: FloatArray


def clamped_theta(
    first: FloatArray, last: FloatArray, amplitude: FloatArray, sigma: FloatArray
) -> FloatArray:
    """theta (B, m) at sigma (m,) for end angles (B,) and amplitudes (B, j)."""
    line = first[:, None] + (last - first)[:, None] * sigma
    out: FloatArray = line + amplitude @ bump_values(sigma, amplitude.shape[1]).T
    return out


def _base(modes: int) -> Bumps:
    return bumps(modes, 2 * modes + 8)


@dataclass(frozen=True)
class _Terms:
    gradient: FloatArray
    chord: FloatArray
    normal: FloatArray
    form: FloatArray


def _terms(
    first: FloatArray, last: FloatArray, weight: FloatArray, amplitude: FloatArray, force: FloatArray
) -> _Terms:
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


def _saddle_step(
    form: FloatArray, normal: FloatArray, gradient: FloatArray, miss: FloatArray
) -> tuple[FloatArray, FloatArray]:
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


def newton(
    first: FloatArray,
    last: FloatArray,
    chord: FloatArray,
    weight: FloatArray,
    amplitude: FloatArray,
    force: FloatArray,
    rounds: int = 12,
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
        share = np.minimum(1.0, _MOST_ROTATION / np.maximum(moved, 1e-300))
        a += share[:, None] * da
        f += share[:, None] * df
    return _judge(first, last, chord, weight, a, f)


def _judge(
    first: FloatArray, last: FloatArray, chord: FloatArray, weight: FloatArray, a: FloatArray, f: FloatArray
) -> Clamped:
    """Margins and residuals; items that ran away get -inf and inf."""
    terms = _terms(first, last, weight, a, f)
    residual = np.maximum(np.abs(terms.gradient).max(axis=1), np.abs(chord - terms.chord).max(axis=1))
    residual = np.where(np.isfinite(residual), residual, np.inf)
    return Clamped(a, f, constrained_smallest(terms.form, terms.normal), residual)


def amplitudes_of(
    sigma_theta: FloatArray, sigma: FloatArray, weight: FloatArray, modes: int = MODES
) -> FloatArray:
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
    out: FloatArray = ends - (sigma_theta * weight) @ (slope[:, 1:] * slopes)
    return out


def _edge(count: int, sigma: FloatArray, weight: FloatArray, where: float) -> FloatArray:
    """Row that extrapolates values at Gauss nodes to an end."""
    p = legendre(sigma, count)
    series = (p * weight[:, None]).T * (2.0 * np.arange(count)[:, None] + 1.0)
    out: FloatArray = legendre(np.array([where]), count)[0] @ series
    return out


def middle_state(
    start: FloatArray,
    end: FloatArray,
    length: FloatArray,
    weight: FloatArray,
    amplitude: FloatArray,
    force: FloatArray,
) -> FloatArray:
    """State (B, 6) at s = L/2 of bump amplitudes (B, j) and force at the start (B, 2) in units of the
    wire (F L^2).

    start, end: poses (B, 3); weight q (B, 2) [1/m^3].
    """
    modes = amplitude.shape[1]
    grid = nodes(64)
    theta = clamped_theta(start[:, 2], end[:, 2], amplitude, 0.5 * grid.sigma)
    half = np.array([0.5])
    slope = legendre(half, modes + 1)[0, 1:] * np.sqrt(2.0 * np.arange(modes) + 3.0)
    x = start[:, 0] + 0.5 * length * (np.cos(theta) @ grid.weight)
    y = start[:, 1] + 0.5 * length * (np.sin(theta) @ grid.weight)
    angle = clamped_theta(start[:, 2], end[:, 2], amplitude, half)[:, 0]
    k = (end[:, 2] - start[:, 2] + amplitude @ slope) / length
    at_middle = force / (length**2)[:, None] - 0.5 * length[:, None] * weight
    return np.concatenate([np.stack([x, y, angle, k], axis=1), at_middle], axis=1)


def polish(
    state: FloatArray, start: FloatArray, end: FloatArray, length: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
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
