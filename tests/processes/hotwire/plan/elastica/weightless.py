"""The planar elastica without weight, of given length, between two clamps: its stable shape of least energy.

    shape = solve(length, start, end)     # poses (..., 3) = x [m], y [m], theta [rad], unwrapped
    shape.points(101), shape.energy, shape.stable_out_of_plane(round(0.3))
    fitted, rms = fit(points)

Shapes are evaluated in closed form, which the product's integration is held against as well; weight is in
`elastica.heavy`.

**In closed form**, by Jacobi's elliptic functions.

With w^2 = |F|, phi = atan2(Fy, Fx) + pi and psi = theta - phi the equation of balance k' = Fx sin theta - Fy
cos theta becomes the pendulum psi'' = -w^2 sin psi, whose solution is classical (Love ch. 19;
Levien, The elastica: a mathematical history, 2009). Near the separatrix (m = 1), for small forces
and for lines and arcs the formulas lose digits; there the initial value problem is solved on Gauss
nodes instead (`flow`), so that the error stays about 1e-12 of the length everywhere.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ellipeinc, ellipj, ellipkinc

from planner.geometry.arrays import BoolArray, FloatArray
from planner.issues import Issue, TandemError
from planner.processes.hotwire.plan.elastica import clamped
from planner.processes.hotwire.plan.elastica.clamped import (
    StiffnessRatios,
    middle_state,
    refine_state,
    round_section,
    strip_section,
)
from planner.processes.hotwire.plan.elastica.equations import gauss_nodes, integrate_wire
from planner.processes.hotwire.plan.elastica.fit import fit_curves

__all__ = [
    "Shape",
    "StiffnessRatios",
    "fit",
    "from_params",
    "round",
    "round_section",
    "solve",
    "strip_section",
]

round = round_section  # noqa: A001  the word of the trade: elastica.round(nu) beside elastica.strip(ratio, nu)

_ACCEPT = 1e-9  # of the length: largest miss of the end pose
_TAUTEST = 44.0  # largest w L: beyond it rounding at the middle reaches 1e-7 L at the ends
_ENERGY_POINTS = 72
"""Gauss points of the energy's integral."""


FINE_MODES = 64
"""Functions by which a wire's angle is expanded where a shape is sharp."""
_HOMOTOPY_STEPS = 10  # of the homotopy from the first guess's chord to the wanted one


_NEAR_SEPARATRIX = 1e-5
"""Distance of the elliptic parameter from 1 within which the closed form loses its digits."""
_LARGEST_PARAMETER = 1e3  # beyond it 1/m cancels digits: almost an arc


def _wrap(angle: FloatArray) -> FloatArray:
    out: FloatArray = np.pi - np.mod(np.pi - angle, 2.0 * np.pi)
    return out


def elliptic_modulus(state: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(w, m^2, psi) of states (B, 6); m^2 is inf where F = 0. Inflections exist for m^2 < 1 only."""
    w = np.sqrt(np.hypot(state[:, 4], state[:, 5]))
    psi = _wrap(state[:, 2] - np.arctan2(state[:, 5], state[:, 4]) - np.pi)
    with np.errstate(divide="ignore", invalid="ignore"):
        m2 = np.sin(0.5 * psi) ** 2 + (state[:, 3] / (2.0 * w)) ** 2
    return w, np.where(w > 0.0, m2, np.inf), psi


def elliptic(state: FloatArray, length: FloatArray) -> BoolArray:
    """Return where the closed form is used. Elsewhere the initial value problem is solved."""
    w, m2, _ = elliptic_modulus(state)
    near = (
        (np.abs(m2 - 1.0) < _NEAR_SEPARATRIX) | (m2 > _LARGEST_PARAMETER) | (w * length < 1e-3) | (m2 < 1e-12)
    )
    return ~near


def evaluate(state: FloatArray, offset: FloatArray, reach: FloatArray) -> FloatArray:
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
        wire = integrate_wire(state[other], span, np.zeros((span.size, 2)), anchor=0.5)
        out[other] = wire.at(offset[other] / span[:, None] + 0.5)[..., :4]
    return out


def _to_world(
    state: FloatArray,
    w: FloatArray,
    psi0: FloatArray,
    along: FloatArray,
    across: FloatArray,
    psi: FloatArray,
    k: FloatArray,
) -> FloatArray:
    """Rotate the pendulum frame by phi and set it on the state."""
    phi = (state[:, 2] - psi0)[:, None]
    x = state[:, 0, None] + along * np.cos(phi) - across * np.sin(phi)
    y = state[:, 1, None] + along * np.sin(phi) + across * np.cos(phi)
    return np.stack([x, y, phi + psi, k], axis=-1)


def _inflected(
    state: FloatArray, s: FloatArray, w: FloatArray, m2: FloatArray, psi0: FloatArray
) -> FloatArray:
    m = np.sqrt(m2)
    u0 = ellipkinc(np.arctan2(np.sin(0.5 * psi0) / m, state[:, 3] / (2.0 * w * m)), m2)[:, None]
    wc, mc, m2c = w[:, None], m[:, None], m2[:, None]
    sn, cn, _, am = ellipj(u0 + wc * s, m2c)
    _, cn0, _, am0 = ellipj(u0, m2c)
    psi = 2.0 * np.arcsin(np.clip(mc * sn, -1.0, 1.0))
    along = 2.0 / wc * (ellipeinc(am, m2c) - ellipeinc(am0, m2c)) - s
    across = 2.0 * mc / wc * (cn0 - cn)
    return _to_world(state, w, psi0, along, across, psi, 2.0 * mc * wc * cn)


def _uninflected(
    state: FloatArray, s: FloatArray, w: FloatArray, m2: FloatArray, psi0: FloatArray
) -> FloatArray:
    m = np.sqrt(m2)[:, None]
    n = 1.0 / m2[:, None]
    sign = np.where(state[:, 3] < 0.0, -1.0, 1.0)[:, None]
    wc = w[:, None]
    v0 = ellipkinc(sign * 0.5 * psi0[:, None], n)
    _, _, dn, am = ellipj(v0 + m * wc * s, n)
    _, _, dn0, am0 = ellipj(v0, n)
    along = s - 2.0 / (m * wc * n) * (m * wc * s - (ellipeinc(am, n) - ellipeinc(am0, n)))
    across = sign * 2.0 / (m * wc * n) * (dn0 - dn)
    return _to_world(state, w, psi0, along, across, 2.0 * sign * am, sign * 2.0 * m * wc * dn)


def minimise(
    first: FloatArray,
    last: FloatArray,
    chord: FloatArray,
    weight: FloatArray,
    amplitude: FloatArray,
    rounds: int = 60,
    limit: float = clamped._MAX_ROTATION_STEP_RAD,
    tolerance: float = 1e-11,
) -> clamped.ClampedSolution:
    """Local minima of the energy near the guessed amplitudes (B, j): by Newton with the form of in-plane
    stability made positive, which never comes to rest on a saddle by choice.

    first, last: end angles (B,) [rad]; chord (B, 2) over L; weight q L^3 (B, 2). Items that do not settle
    keep a residual above the tolerance; the caller judges by `residual` and `margin`."""
    a = amplitude.copy()
    batch, size = a.shape
    force = np.zeros((batch, 2))
    residual = np.full(batch, np.inf)
    begin = clamped._lagrangian_terms(first, last, weight, a, force).chord
    active = np.arange(batch)
    for turn in range(rounds):
        i = active
        t = min(1.0, (turn + 1.0) / _HOMOTOPY_STEPS)
        expected = begin[i] + t * (chord[i] - begin[i])
        terms = clamped._lagrangian_terms(first[i], last[i], weight[i], a[i], force[i])
        miss = expected - terms.chord
        error = np.maximum(np.abs(terms.gradient).max(axis=1), np.abs(miss).max(axis=1))
        if t == 1.0:
            residual[i] = error
        projected, basis = clamped.project_form(terms.form, terms.normal)
        filled = projected + 2.0 * (np.swapaxes(basis, 1, 2) @ basis)
        lift = np.zeros(i.size)
        far = error > 1e-4  # near a solution its own margin decides, at the end
        lowest = np.linalg.eigvalsh(filled[far])[:, 0]
        lift[far] = np.where(lowest > 1e-5, 0.0, 0.03 - lowest)
        form = terms.form + lift[:, None, None] * np.eye(size)
        da, df = clamped._saddle_step(form, terms.normal, terms.gradient, miss)
        moved = np.abs(da @ clamped._bump_basis(size).value.T).max(axis=1)
        fraction = np.minimum(1.0, limit / np.maximum(moved, 1e-300))
        a[i] += fraction[:, None] * da
        force[i] += fraction[:, None] * df
        if t == 1.0:
            active = i[(error > tolerance) & np.isfinite(error) & (np.abs(force[i]).max(axis=1) < 1e6)]
            if active.size == 0:
                break
    return clamped._make_solution(first, last, chord, weight, a, force)


@dataclass(frozen=True)
class Shape:
    """Elasticas over leading axes (...,).

    length (...,) [m]; middle (..., 6): state x, y, theta, k, Fx, Fy at s = L/2, from which both halves
    are evaluated (this keeps digits in taut wires); ok (...,): False where no stable shape was found (its
    numbers are NaN)."""

    length: FloatArray
    middle: FloatArray
    ok: BoolArray

    @property
    def start(self) -> FloatArray:
        """Pose (..., 3) at s = 0."""
        return self._sample(np.array([0.0]))[..., 0, :3]

    @property
    def end(self) -> FloatArray:
        """Pose (..., 3) at s = L."""
        return self._sample(np.array([1.0]))[..., 0, :3]

    @property
    def params(self) -> FloatArray:
        """State (..., 6) = x, y, theta, k, Fx, Fy at s = 0; F = force / EI [1/m^2], positive along the
        tangent is tension."""
        return np.concatenate([self._sample(np.array([0.0]))[..., 0, :], self.middle[..., 4:]], axis=-1)

    def points(self, n: int) -> FloatArray:
        """(..., n, 2) [m], uniform in arc length."""
        return self._sample(np.linspace(0.0, 1.0, n))[..., :2]

    def theta(self, n: int) -> FloatArray:
        """(..., n) [rad], unwrapped."""
        return self._sample(np.linspace(0.0, 1.0, n))[..., 2]

    def curvature(self, n: int) -> FloatArray:
        """(..., n) [1/m]."""
        return self._sample(np.linspace(0.0, 1.0, n))[..., 3]

    @property
    def energy(self) -> FloatArray:
        """1/2 int k^2 ds (...,) [1/m], by Gauss quadrature of the closed form."""
        grid = gauss_nodes(_ENERGY_POINTS)
        k = self._sample(grid.sigma)[..., 3]
        out: FloatArray = 0.5 * self.length * (k**2 @ grid.weight)
        return out

    @property
    def inflections(self) -> FloatArray:
        """Sign changes of the curvature inside the wire (...,), as floats; NaN if the shape is not ok."""
        k = self.curvature(401)
        floor = 1e-9 * np.max(np.abs(k), axis=-1, keepdims=True)
        sign = np.sign(np.where(np.abs(k) <= floor, 0.0, k))
        for i in range(1, sign.shape[-1]):  # a zero sample takes the sign before it
            sign[..., i] = np.where(sign[..., i] == 0.0, sign[..., i - 1], sign[..., i])
        changes = (sign[..., 1:] * sign[..., :-1] < 0.0).sum(axis=-1).astype(np.float64)
        return np.where(self.ok, changes, np.nan)

    @property
    def margin_in_plane(self) -> FloatArray:
        """Stability margin in the plane (...,): 1 without force, 0 at buckling (see `stability`)."""
        return np.asarray(clamped.in_plane_margin(self.quadrature_shape()).reshape(self.length.shape))

    @property
    def stable_in_plane(self) -> BoolArray:
        """Whether (...,) wires keep their shape in its plane."""
        return self.ok & (np.nan_to_num(self.margin_in_plane, nan=-1.0) > clamped.MIN_STABLE_MARGIN)

    def margin_out_of_plane(self, section: StiffnessRatios) -> FloatArray:
        """Stability margin against leaving the plane (...,) for a cross-section."""
        margin = clamped.out_of_plane_margin(self.quadrature_shape(), section)
        return np.asarray(margin.reshape(self.length.shape))

    def stable_out_of_plane(self, section: StiffnessRatios) -> BoolArray:
        """Whether (...,) wires of a ``section`` stay in their plane."""
        return self.ok & (
            np.nan_to_num(self.margin_out_of_plane(section), nan=-1.0) > clamped.MIN_STABLE_MARGIN
        )

    def quadrature_shape(self) -> clamped.QuadratureShape:
        """The shapes, over one leading axis, at the nodes at which stability is computed."""
        at = self._sample(clamped.quadrature_nodes()).reshape(-1, clamped.quadrature_nodes().size, 4)
        at = np.nan_to_num(at)
        force = np.nan_to_num(self.middle.reshape(-1, 1, 6)[..., 4:])
        return clamped.QuadratureShape(
            theta=at[..., 2],
            curvature=at[..., 3],
            force=np.broadcast_to(force, (*at.shape[:2], 2)),
            length=self.length.reshape(-1),
        )

    def _sample(self, sigma: FloatArray) -> FloatArray:
        """x, y, theta, k (..., m, 4) at sigma (m,)."""
        length = self.length.reshape(-1)
        middle = self.middle.reshape(-1, 6)
        out = np.full((length.size, sigma.size, 4), np.nan)
        good = np.isfinite(middle).all(axis=1)
        if good.any():
            offset = (sigma - 0.5) * length[good, None]
            out[good] = evaluate(middle[good], offset, 0.5 * length[good])
        return out.reshape(*self.length.shape, sigma.size, 4)


def from_params(params: ArrayLike, length: ArrayLike) -> Shape:
    """The shape that starts in the states params (..., 6); stable or not: ask it."""
    p, lengths = np.asarray(params, dtype=np.float64), np.asarray(length, dtype=np.float64)
    lengths = np.broadcast_to(lengths, p.shape[:-1]).copy()
    flat, span = p.reshape(-1, 6), lengths.reshape(-1)
    half = evaluate(flat, 0.5 * span[:, None], span)[:, 0, :]
    middle = np.concatenate([half, flat[:, 4:]], axis=1).reshape(p.shape)
    return Shape(lengths, middle, np.isfinite(middle).all(axis=-1))


def solve(length: ArrayLike, start: ArrayLike, end: ArrayLike, strict: bool = True) -> Shape:
    """The stable shape of least energy found from several starts, for wires of length (...,) between
    poses (..., 3).

    The turning end theta - start theta is part of the question (unwrapped). Raises `TandemError` with
    code wire.too_short or wire.unstable, one per item; with strict=False these items come back
    with ok False and NaN instead."""
    a, b = np.broadcast_arrays(np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64))
    batch = np.broadcast_shapes(a.shape[:-1], np.shape(length))
    a, b = np.broadcast_to(a, (*batch, 3)).reshape(-1, 3), np.broadcast_to(b, (*batch, 3)).reshape(-1, 3)
    lengths = np.broadcast_to(np.asarray(length, dtype=np.float64), batch).reshape(-1).copy()
    if not (
        np.isfinite(a).all() and np.isfinite(b).all() and np.isfinite(lengths).all() and (lengths > 0).all()
    ):
        raise ValueError(
            "length, start, end: got a number that is not finite or a length <= 0; "
            "give finite poses in m and rad"
        )
    chord = (b[:, :2] - a[:, :2]) / lengths[:, None]
    middle = _straight(a, b, chord, lengths)
    todo = np.flatnonzero(np.isnan(middle[:, 0]) & (np.hypot(chord[:, 0], chord[:, 1]) < 1.0))
    if todo.size:
        middle[todo] = _least_energy(a[todo], b[todo], chord[todo], lengths[todo])
        todo = todo[np.isnan(middle[todo, 0])]
    if todo.size:  # again with more starts and smaller steps
        middle[todo] = _least_energy(a[todo], b[todo], chord[todo], lengths[todo], fine=True)
    ok = np.isfinite(middle[:, 0])
    shape = Shape(lengths.reshape(batch), middle.reshape(*batch, 6), ok.reshape(batch))
    if strict and not ok.all():
        raise TandemError(_issues(ok, chord, lengths), partial=shape)
    return shape


def _issues(ok: BoolArray, chord: FloatArray, lengths: FloatArray) -> list[Issue]:
    out = []
    for i in np.flatnonzero(~ok):
        gap = float(np.hypot(chord[i, 0], chord[i, 1]) * lengths[i]) * 1e3
        have = float(lengths[i]) * 1e3
        if gap >= have:
            text = (
                f"wire {i} spans {gap:.4f} mm between its clamps, allowed less than its length {have:.4f} mm"
            )
            hint = "take a longer wire or bring its ends together; a straight wire needs aligned ends"
            out.append(
                Issue("wire.too_short", text, index=int(i), value=gap, limit=have, unit="mm", hint=hint)
            )
        else:
            text = f"wire {i} of {have:.4f} mm has no stable shape between its clamps {gap:.4f} mm apart"
            hint = (
                "slacken the wire or turn its ends less: its bends would be tighter than 1/80 of its length"
            )
            out.append(Issue("wire.unstable", text, index=int(i), hint=hint))
    return out


def _straight(a: FloatArray, b: FloatArray, chord: FloatArray, lengths: FloatArray) -> FloatArray:
    """Middle states of exactly straight taut wires; NaN for all others."""
    along = np.stack([np.cos(a[:, 2]), np.sin(a[:, 2])], axis=1)
    line = (np.abs(chord - along).max(axis=1) < 1e-13) & (np.abs(b[:, 2] - a[:, 2]) < 1e-13)
    middle = np.full((a.shape[0], 6), np.nan)
    middle[line, :2] = a[line, :2] + 0.5 * lengths[line, None] * along[line]
    middle[line, 2] = a[line, 2]
    middle[line, 3:] = 0.0
    return middle


def _starts(a: FloatArray, b: FloatArray, chord: FloatArray, kinds: int, modes: int) -> FloatArray:
    """First guesses (B, g, modes): the arc, and arc + bumps of the first kinds with about that chord."""
    sizes = np.concatenate([np.geomspace(1e-6, 0.1, 11), np.linspace(0.2, 9.0, 36)])
    want = np.hypot(chord[:, 0], chord[:, 1])
    guesses = np.zeros((a.shape[0], 1 + 2 * kinds, modes))
    guesses[:, 0, 1] = 1e-3
    grid = gauss_nodes(32)
    slot = 1
    for mode in range(kinds):
        for sign in (1.0, -1.0):
            trial = np.zeros((a.shape[0], sizes.size, modes))
            trial[:, :, mode] = sign * sizes
            flat = trial.reshape(-1, modes)
            first, last = np.repeat(a[:, 2], sizes.size), np.repeat(b[:, 2], sizes.size)
            theta = clamped.clamped_theta(first, last, flat, grid.sigma)
            got = np.hypot(np.cos(theta) @ grid.weight, np.sin(theta) @ grid.weight).reshape(-1, sizes.size)
            best = np.argmin(np.abs(got - want[:, None]), axis=1)
            guesses[:, slot, mode] = sign * sizes[best]
            slot += 1
    return guesses


def _least_energy(
    a: FloatArray, b: FloatArray, chord: FloatArray, lengths: FloatArray, fine: bool = False
) -> FloatArray:
    """Middle states (B, 6) of the best stable solution of each; NaN rows where there is none."""
    kinds, modes, rounds, limit = (4, FINE_MODES, 200, 0.2) if fine else (2, clamped.CLAMPED_MODES, 60, 0.6)
    guesses = _starts(a, b, chord, kinds, modes)
    count = guesses.shape[1]
    first, last = np.repeat(a[:, 2], count), np.repeat(b[:, 2], count)
    nothing = np.zeros((first.size, 2))
    chords = np.repeat(chord, count, axis=0)
    found = minimise(first, last, chords, nothing, guesses.reshape(first.size, -1), rounds, limit)
    energy = 0.5 * np.sum(found.amplitude**2, axis=1)
    taut = np.hypot(found.force[:, 0], found.force[:, 1]) > _TAUTEST**2
    energy[(found.residual > 1e-6) | (found.margin < clamped.MIN_STABLE_MARGIN) | taut] = np.inf
    table = energy.reshape(-1, count)
    middle = np.full((a.shape[0], 6), np.nan)
    rows = np.arange(a.shape[0])
    for _ in range(count):  # the next best where the best does not stand the closed form's check
        open_rows = rows[np.isnan(middle[:, 0]) & np.isfinite(table.min(axis=1))]
        if open_rows.size == 0:
            break
        pick = np.argmin(table[open_rows], axis=1)
        which = open_rows * count + pick
        span, zero = lengths[open_rows], np.zeros((open_rows.size, 2))
        from_, to = a[open_rows], b[open_rows]
        state = middle_state(from_, to, span, zero, found.amplitude[which], found.force[which])
        state, miss = refine_state(state, from_, to, span, zero)
        shape = Shape(lengths[open_rows], state, np.ones(open_rows.size, dtype=np.bool_))
        good = (miss < _ACCEPT) & shape.stable_in_plane
        middle[open_rows[good]] = state[good]
        table[open_rows, pick] = np.inf
    return middle


def fit(points: ArrayLike, length: ArrayLike | None = None) -> tuple[Shape, FloatArray]:
    """The elastica that meets target curves best: points (..., m, 2) in order along the curve.

    Without length the wire ends at the feet of the first and the last point; with length (...,) it has
    exactly that length, its middle at the middle of the target. Returns the shapes and the rms (...,) [m]
    of the distances of the points to the curve. Whether a fitted shape is stable is a question to the
    shape: a fit does not refuse."""
    p = np.asarray(points, dtype=np.float64)
    batch = p.shape[:-2]
    flat = p.reshape(-1, *p.shape[-2:])
    lengths = (
        None if length is None else np.broadcast_to(np.asarray(length, dtype=np.float64), batch).reshape(-1)
    )
    result = fit_curves(flat, lengths)
    shape = Shape(
        result.length.reshape(batch), result.middle.reshape(*batch, 6), np.ones(batch, dtype=np.bool_)
    )
    return shape, result.rms.reshape(batch)
