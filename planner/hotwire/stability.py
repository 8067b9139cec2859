"""Stability of planar wire shapes between clamps, in and out of their plane, with weight.

A shape is stable where the second variation of its energy is positive for every motion that the clamps
allow. Both forms are set up in functions with orthonormal slopes, so that the result is a pure number:
the smallest value of second variation / int |w'|^2. It is 1 for a straight wire without force, falls
under compression and is 0 at buckling.

In plane (eta: change of theta; Sachkov, arXiv 0705.1003): int eta'^2 + (F.t) eta^2 with int eta n = 0.

Out of plane (w: rotation about tangent and normal, B = 1 the stiffness in the plane, C = GJ/EI, B2 =
stiff/soft bending): int C (wt' - k wn)^2 + B2 (wn' + k wt)^2 - k^2 (wt^2 + wn^2) - k (wt wn' - wn wt') +
Ft wn^2 - Fn wt wn with int wn = 0. It is the second order of the energy of a rod whose frame is turned by
exp(w); weight enters by F(s) alone, because the load's energy is -int F(s).t ds."""

from dataclasses import dataclass

import numpy as np

from planner.hotwire.basis import Array, bump_values, bumps

STABLE = 1e-6  # smallest second variation that counts as stable
_MODES_IN = 32
_MODES_OUT = 28
_QUADRATURE = 72


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


def quadrature() -> Array:
    """The places sigma = s / L at which the functions below want theta, curvature and force."""
    return bumps(_MODES_OUT, _QUADRATURE).sigma


def constrained_smallest(form: Array, constraints: Array, barrier: float = 2.0) -> Array:
    """Smallest eigenvalue (B,) of forms (B, n, n) on the space orthogonal to constraints (B, c, n), c <= 2.

    A constraint that vanishes (the second one of a straight wire) is left out. Forms that are not finite,
    those of wires that do not exist, give -inf."""
    good = np.isfinite(form).all(axis=(1, 2)) & np.isfinite(constraints).all(axis=(1, 2))
    projected, basis = project(form[good], constraints[good])
    fill = barrier * (np.swapaxes(basis, 1, 2) @ basis)
    out = np.full(form.shape[0], -np.inf)
    out[good] = np.linalg.eigvalsh(projected + fill)[:, 0]
    return out


def project(form: Array, constraints: Array) -> tuple[Array, Array]:
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


def in_plane(theta: Array, force: Array, length: Array) -> Array:
    """Margin (B,) of theta (B, n) [rad] and force F (B, n, 2) [1/m^2] at `quadrature()`; length (B,) [m]."""
    base = bumps(_MODES_IN, _QUADRATURE)
    sin, cos = np.sin(theta), np.cos(theta)
    pull = (length**2)[:, None] * (force[..., 0] * cos + force[..., 1] * sin) * base.weight
    form = np.eye(_MODES_IN) + base.value.T @ (pull[:, :, None] * base.value)
    normal = np.stack([-sin, cos], axis=1) * base.weight
    return constrained_smallest(form, normal @ base.value)


def out_of_plane_form(theta: Array, curvature: Array, force: Array, length: Array, section: Section) -> Array:
    """The form (B, 2m, 2m) in units of 1/L over bumps for wt, then wn; arguments as `out_of_plane`."""
    base = bumps(_MODES_OUT, _QUADRATURE)
    k = curvature * length[:, None]
    square = (length**2)[:, None]
    ft = square * (force[..., 0] * np.cos(theta) + force[..., 1] * np.sin(theta))
    fn = square * (force[..., 1] * np.cos(theta) - force[..., 0] * np.sin(theta))
    c, b = section.torsion, section.stiff
    value, slope, weight = base.value, base.slope, base.weight

    def pair(left: Array, factor: Array, right: Array) -> Array:
        out: Array = left.T @ ((factor * weight)[:, :, None] * right)
        return out

    eye = np.eye(_MODES_OUT)
    tangent = c * eye + pair(value, (b - 1.0) * k**2, value)
    normal = b * eye + pair(value, (c - 1.0) * k**2 + ft, value)
    mixed = (
        pair(value, (b - 0.5) * k, slope) - pair(slope, (c - 0.5) * k, value) - pair(value, 0.5 * fn, value)
    )
    return np.block([[tangent, mixed], [np.swapaxes(mixed, 1, 2), normal]])


def out_of_plane(theta: Array, curvature: Array, force: Array, length: Array, section: Section) -> Array:
    """Margin (B,) against leaving the plane; theta, curvature (B, n), force (B, n, 2) at `quadrature()`."""
    form = out_of_plane_form(theta, curvature, force, length, section)
    return constrained_smallest(form, out_of_plane_constraint(form.shape[0]))


def out_of_plane_constraint(batch: int) -> Array:
    """int wn = 0 as (batch, 1, 2m)."""
    base = bumps(_MODES_OUT, _QUADRATURE)
    row = np.concatenate([np.zeros(_MODES_OUT), base.weight @ base.value])
    return np.tile(row, (batch, 1, 1))


def out_of_plane_sag(
    theta: Array, curvature: Array, force: Array, length: Array, section: Section, load: Array, sigma: Array
) -> Array:
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
    out: Array = -length[:, None] * (wn @ from_start.T)
    out[~stable] = np.inf
    return out
