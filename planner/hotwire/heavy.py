"""The planar elastica with weight: what a real wire does in a plane that is not level.

Signs (see `flow`): weight q (B, 2) [1/m^3] is the wire's weight per length over EI as a vector in the
plane, pointing where it pulls (straight down in a vertical plane: (0, -w/EI)). F is the force of the part
beyond s on the part before it over EI, so F(s) = F0 - q s. Parameters of a wire are its state at s = 0:
(x0, y0, theta0, k0, Fx, Fy)."""

from dataclasses import dataclass

import numpy as np

from planner.hotwire import clamped, stability
from planner.hotwire.basis import Array, IntArray, Mask, nodes
from planner.hotwire.fit import TAIL_WEIGHT, fit_curves
from planner.hotwire.flow import Flow, flow, interpolate
from planner.hotwire.shooting import middle_state, polish
from planner.hotwire.stability import Section
from planner.issues import Issue, TandemError

_ACCEPT = 1e-9  # of the length
_STEPS = 12  # from a guess to clamps that Newton does not reach at once


@dataclass(frozen=True)
class HeavyShape:
    """Wires sampled at n places, uniform in arc length.

    points (B, n, 2) [m], theta, curvature (B, n), params (B, 6) at s = 0, length (B,), weight q (B, 2),
    middle (B, 6): the state at s = L/2, which all further work starts from because rounding grows least
    from there."""

    points: Array
    theta: Array
    curvature: Array
    params: Array
    length: Array
    weight: Array
    middle: Array

    @property
    def start(self) -> Array:
        """Poses (B, 3) at s = 0."""
        return np.concatenate([self.points[:, 0], self.theta[:, :1]], axis=1)

    @property
    def end(self) -> Array:
        """Poses (B, 3) at s = L."""
        return np.concatenate([self.points[:, -1], self.theta[:, -1:]], axis=1)

    @property
    def margin_in_plane(self) -> Array:
        """(B,): above `stability.STABLE` the wire is stable in its plane; 1 without force, 0 at buckling."""
        at = self._quadrature()
        return stability.in_plane(at[..., 2], at[..., 4:], self.length)

    def margin_out_of_plane(self, section: Section) -> Array:
        """(B,): the same against leaving the plane."""
        at = self._quadrature()
        return stability.out_of_plane(at[..., 2], at[..., 3], at[..., 4:], self.length, section)

    @property
    def stable_in_plane(self) -> Mask:
        return self.margin_in_plane > stability.STABLE

    def stable_out_of_plane(self, section: Section) -> Mask:
        return self.margin_out_of_plane(section) > stability.STABLE

    def flow(self, count: int | None = None) -> Flow:
        """The wires on Gauss nodes."""
        return flow(self.middle, self.length, self.weight, anchor=0.5, count=count)

    def at(self, s: Array) -> Array:
        """States (B, m, 6) at arc lengths s (B, m), also beyond the ends, as if the wire went on."""
        reach = np.maximum(np.abs(s - 0.5 * self.length[:, None]).max(axis=1), 0.5 * self.length)
        wire = flow(self.middle, 2.0 * reach, self.weight, anchor=0.5)
        return wire.at((s - 0.5 * self.length[:, None]) / (2.0 * reach)[:, None] + 0.5)

    def _quadrature(self) -> Array:
        return self.flow().at(stability.quadrature())


@dataclass(frozen=True)
class HeavyFit:
    """shape: the placed wires; residual (B, m): signed distances of the target's points from the wire
    along its normal [m]; foot (B, m): their arc lengths on it; rms, largest (B,) [m] over the points that
    count; worst (B,): index of the farthest."""

    shape: HeavyShape
    residual: Array
    foot: Array
    rms: Array
    largest: Array
    worst: IntArray


def from_middle(middle: Array, length: Array, weight: Array, n: int = 101) -> HeavyShape:
    """Wires (B,) from their states at s = L/2."""
    wire = flow(middle, length, weight, anchor=0.5)
    at = wire.at(np.linspace(0.0, 1.0, n))
    return HeavyShape(at[..., :2], at[..., 2], at[..., 3], at[:, 0].copy(), length, weight, middle)


def integrate(params: Array, length: Array, weight: Array, n: int = 101) -> HeavyShape:
    """Wires from their states (B, 6) at s = 0; length (B,), weight q (B, 2). Error below 1e-8 L, in
    practice near 1e-11 L."""
    wire = flow(params, length, weight, anchor=0.0)
    at = wire.at(np.linspace(0.0, 1.0, n))
    middle = wire.at(np.array([0.5]))[:, 0]
    return HeavyShape(at[..., :2], at[..., 2], at[..., 3], params, length, weight, middle)


def sensitivities(params: Array, length: Array, weight: Array, n: int = 101) -> Array:
    """Derivatives (B, n, 4, 6) of x, y, theta, k at n places, uniform in arc length, by the six
    parameters."""
    wire = flow(params, length, weight, anchor=0.0, derivatives=True)
    parts = np.concatenate([wire.d_x, wire.d_y, wire.d_theta, wire.d_curvature], axis=-1)
    out = np.zeros((params.shape[0], n, 4, 6))
    out[..., 2:] = interpolate(parts, np.linspace(0.0, 1.0, n)).reshape(-1, n, 4, 4)
    out[..., 0, 0] = out[..., 1, 1] = 1.0
    return out


def fit(
    targets: Array,
    length: Array,
    weight: Array,
    window: Array | None = None,
    split: Array | float = 0.5,
    tail_weight: Array | float = TAIL_WEIGHT,
    n: int = 101,
) -> HeavyFit:
    """Place wires of exactly these lengths (B,) so that a part of each meets its target (B, m, 2) best.

    window (B, m): weights >= 0 of the target's points, all 1 by default. split: the part of the wire's
    free length that lies before the target. tail_weight: price of curvature beyond the target, in target
    lengths (`fit.TAIL_WEIGHT`). Stability is the caller's question to the shape. Raises ValueError for
    targets longer than their wire and for bad numbers."""
    got = fit_curves(targets, length, weight, window, split, tail_weight)
    shape = from_middle(got.middle, got.length, weight, n)
    return HeavyFit(shape, got.residual, got.foot, got.rms, got.largest, got.worst)


def solve(
    length: Array,
    start: Array,
    end: Array,
    weight: Array,
    guess_params: Array,
    n: int = 101,
    strict: bool = True,
) -> HeavyShape:
    """The equilibrium between clamps start, end (B, 3) next to a guess (B, 6): Newton, on the guess's
    branch, stable or not.

    Raises `TandemError` with code wire.no_equilibrium where Newton fails; with strict=False these rows
    are NaN."""
    middle = _follow(length, start, end, weight, guess_params, steps=1)
    late = np.flatnonzero(np.isnan(middle[:, 0]))
    if late.size:
        middle[late] = _follow(length[late], start[late], end[late], weight[late], guess_params[late], _STEPS)
    ok = np.isfinite(middle[:, 0])
    shape = _with_gaps(middle, length, weight, n, ok)
    if strict and not ok.all():
        raise TandemError(
            [_no_equilibrium(int(i), float(length[i])) for i in np.flatnonzero(~ok)], partial=shape
        )
    return shape


def _follow(length: Array, start: Array, end: Array, weight: Array, params: Array, steps: int) -> Array:
    """Middle states (B, 6), NaN where there is none, on the way from the guess's own end poses to the
    wanted ones.

    A guess that meets the wanted end better without weight is taken for a wire without weight, and its
    weight grows on the way."""
    nothing = np.zeros_like(weight)
    wires = [flow(params, length, load, anchor=0.0) for load in (weight, nothing)]
    gaps = [np.hypot(*(wire.at(np.array([1.0]))[:, 0, :2] - end[:, :2]).T) for wire in wires]
    light = gaps[1] < gaps[0]
    pick = light[:, None]
    states = []
    for wire in wires:
        grid = nodes(wire.count)
        states.append(clamped.amplitudes_of(wire.theta, grid.sigma, grid.weight))
    amplitude = np.where(pick, states[1], states[0])
    force = params[:, 4:] * (length**2)[:, None]
    own = np.where(pick, *(wire.at(np.array([1.0]))[:, 0, :3] for wire in reversed(wires)))
    begin = np.where(pick, nothing, weight)
    found = None
    for i in range(1, steps + 1):
        t = i / steps
        a, b = params[:, :3] + t * (start - params[:, :3]), own + t * (end - own)
        chord = (b[:, :2] - a[:, :2]) / length[:, None]
        load = (begin + t * (weight - begin)) * (length**3)[:, None]
        found = clamped.newton(a[:, 2], b[:, 2], chord, load, amplitude, force)
        settled = found.residual < 1e-6
        amplitude = np.where(settled[:, None], found.amplitude, amplitude)
        force = np.where(settled[:, None], found.force, force)
    middle = np.full((length.size, 6), np.nan)
    r = np.flatnonzero(found.residual < 1e-6) if found is not None else np.empty(0, dtype=np.int64)
    if r.size:
        state = middle_state(start[r], end[r], length[r], weight[r], amplitude[r], force[r])
        state, miss = polish(state, start[r], end[r], length[r], weight[r])
        middle[r[miss < _ACCEPT]] = state[miss < _ACCEPT]
    return middle


def _with_gaps(middle: Array, length: Array, weight: Array, n: int, ok: Mask) -> HeavyShape:
    good = from_middle(middle[ok], length[ok], weight[ok], n)
    whole = []
    for values in (good.points, good.theta, good.curvature, good.params):
        full = np.full((length.size, *values.shape[1:]), np.nan)
        full[ok] = values
        whole.append(full)
    return HeavyShape(whole[0], whole[1], whole[2], whole[3], length, weight, middle)


def _no_equilibrium(index: int, length: float) -> Issue:
    return Issue(
        "wire.no_equilibrium",
        f"wire {index} of {length * 1e3:.4f} mm has no equilibrium between its clamps near the guess",
        index=index,
        hint="guess closer to these clamps, or move them in smaller steps",
    )


def extend(shape: HeavyShape, a: Array) -> tuple[Array, Array]:
    """Slide wires along their own curves by a (B, K) [m]: poses (B, K, 3) of both ends; the middle stays
    where it is.

    Start at s = a, end at s = a + L. This is the freedom of splitting the slack otherwise.
    """
    k = a.shape[1]
    states = shape.at(np.concatenate([a, a + shape.length[:, None]], axis=1))
    return states[:, :k, :3], states[:, k:, :3]


def slide(shape: HeavyShape, a: Array, n: int = 101) -> HeavyShape:
    """The wires that `extend` describes, for one a (B,) each."""
    middle = shape.at((a + 0.5 * shape.length)[:, None])[:, 0]
    return from_middle(middle, shape.length, shape.weight, n)


def blend(params_a: Array, params_b: Array, t: Array | float) -> Array:
    """Parameters between two wires: (B, 6) for a number t, (T, B, 6) for t (T,). Each is an equilibrium;
    ask if it is stable."""
    u = np.asarray(t, dtype=np.float64)
    u = u.reshape(*u.shape, *([1] * params_a.ndim))
    out: Array = (1.0 - u) * params_a + u * params_b
    return out


def sag_out_of_plane(
    shape: HeavyShape, weight_normal: Array, section: Section, n: int = 101
) -> tuple[Array, Array]:
    """Deflection by the weight across the plane: largest (B,) [m] and profile (B, n) along z = x cross y.

    weight_normal (B,) [1/m^3]: weight per length along z over EI in the plane. Linear: trust it while it
    is small beside the shape. Infinite where the wire is not stable out of its plane."""
    at = shape.flow().at(stability.quadrature())
    profile = stability.out_of_plane_sag(
        at[..., 2], at[..., 3], at[..., 4:], shape.length, section, weight_normal, np.linspace(0.0, 1.0, n)
    )
    return np.abs(profile).max(axis=1), profile
