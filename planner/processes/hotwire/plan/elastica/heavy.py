"""The planar elastica with weight, and how it answers to errors of clamps, length and weight.

What a real wire does in a plane that is not level. Signs (see `equations`): weight q (B, 2) [1/m^3]
is the wire's weight per length over EI as a vector in the plane, pointing where it pulls (straight
down in a vertical plane: (0, -w/EI)). F is the force of the part beyond s on the part before it
over EI, so F(s) = F0 - q s. Parameters of a wire are its state at s = 0: (x0, y0, theta0, k0, Fx,
Fy).

`end_sensitivity` and `weight_deviation`: how much a clamped wire moves, in its plane, when its
clamps, its length or its weight are not as planned.
"""

from dataclasses import dataclass

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import Issue, TandemError
from planner.processes.hotwire.plan.elastica import clamped
from planner.processes.hotwire.plan.elastica.clamped import (
    STABLE,
    Section,
    constrained_smallest,
    middle_state,
    polish,
)
from planner.processes.hotwire.plan.elastica.equations import Flow, bumps, flow, nodes
from planner.processes.hotwire.plan.elastica.fit import TAIL_WEIGHT, fit_curves

_ACCEPT = 1e-9  # of the length
_HOMOTOPY_STEPS = 12  # from a guess to clamps that Newton does not reach at once


@dataclass(frozen=True)
class HeavyShape:
    """Wires sampled at n places, uniform in arc length.

    points (B, n, 2) [m], theta, curvature (B, n), params (B, 6) at s = 0, length (B,), weight q (B, 2),
    middle (B, 6): the state at s = L/2, which all further work starts from because rounding grows least
    from there."""

    points: FloatArray
    theta: FloatArray
    curvature: FloatArray
    params: FloatArray
    length: FloatArray
    weight: FloatArray
    middle: FloatArray

    @property
    def start(self) -> FloatArray:
        """Poses (B, 3) at s = 0."""
        return np.concatenate([self.points[:, 0], self.theta[:, :1]], axis=1)

    @property
    def end(self) -> FloatArray:
        """Poses (B, 3) at s = L."""
        return np.concatenate([self.points[:, -1], self.theta[:, -1:]], axis=1)

    @property
    def margin_in_plane(self) -> FloatArray:
        """(B,): above `STABLE` the wire is stable in its plane; 1 without force, 0 at buckling."""
        at = self._quadrature()
        return clamped.in_plane(at[..., 2], at[..., 4:], self.length)

    def margin_out_of_plane(self, section: Section) -> FloatArray:
        """(B,): the same against leaving the plane."""
        at = self._quadrature()
        return clamped.out_of_plane(at[..., 2], at[..., 3], at[..., 4:], self.length, section)

    @property
    def stable_in_plane(self) -> BoolArray:
        """Whether (B,) wires keep their shape in its plane."""
        return self.margin_in_plane > clamped.STABLE

    def stable_out_of_plane(self, section: Section) -> BoolArray:
        """Whether (B,) wires of a ``section`` stay in their plane."""
        return self.margin_out_of_plane(section) > clamped.STABLE

    def flow(self, count: int | None = None) -> Flow:
        """The wires on Gauss nodes."""
        return flow(self.middle, self.length, self.weight, anchor=0.5, count=count)

    def at(self, s: FloatArray) -> FloatArray:
        """States (B, m, 6) at arc lengths s (B, m), also beyond the ends, as if the wire went on."""
        reach = np.maximum(np.abs(s - 0.5 * self.length[:, None]).max(axis=1), 0.5 * self.length)
        wire = flow(self.middle, 2.0 * reach, self.weight, anchor=0.5)
        return wire.at((s - 0.5 * self.length[:, None]) / (2.0 * reach)[:, None] + 0.5)

    def _quadrature(self) -> FloatArray:
        return self.flow().at(clamped.quadrature())


@dataclass(frozen=True)
class HeavyFit:
    """shape: the placed wires; residual (B, m): signed distances of the target's points from the wire
    along its normal [m]; foot (B, m): their arc lengths on it; rms, largest (B,) [m] over the points that
    count; worst (B,): index of the farthest."""

    shape: HeavyShape
    residual: FloatArray
    foot: FloatArray
    rms: FloatArray
    largest: FloatArray
    worst: IntArray


def from_middle(middle: FloatArray, length: FloatArray, weight: FloatArray, n: int = 101) -> HeavyShape:
    """Wires (B,) from their states at s = L/2."""
    wire = flow(middle, length, weight, anchor=0.5)
    at = wire.at(np.linspace(0.0, 1.0, n))
    return HeavyShape(at[..., :2], at[..., 2], at[..., 3], at[:, 0].copy(), length, weight, middle)


def integrate(params: FloatArray, length: FloatArray, weight: FloatArray, n: int = 101) -> HeavyShape:
    """Wires from their states (B, 6) at s = 0; length (B,), weight q (B, 2). Error below 1e-8 L, in
    practice near 1e-11 L."""
    wire = flow(params, length, weight, anchor=0.0)
    at = wire.at(np.linspace(0.0, 1.0, n))
    middle = wire.at(np.array([0.5]))[:, 0]
    return HeavyShape(at[..., :2], at[..., 2], at[..., 3], params, length, weight, middle)


def fit(
    targets: FloatArray,
    length: FloatArray,
    weight: FloatArray,
    window: FloatArray | None = None,
    split: FloatArray | float = 0.5,
    tail_weight: FloatArray | float = TAIL_WEIGHT,
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
    length: FloatArray,
    start: FloatArray,
    end: FloatArray,
    weight: FloatArray,
    guess_params: FloatArray,
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
        middle[late] = _follow(
            length[late], start[late], end[late], weight[late], guess_params[late], _HOMOTOPY_STEPS
        )
    ok = np.isfinite(middle[:, 0])
    shape = _with_gaps(middle, length, weight, n, ok)
    if strict and not ok.all():
        raise TandemError(
            [_no_equilibrium(int(i), float(length[i])) for i in np.flatnonzero(~ok)], partial=shape
        )
    return shape


def _follow(
    length: FloatArray, start: FloatArray, end: FloatArray, weight: FloatArray, params: FloatArray, steps: int
) -> FloatArray:
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


def _with_gaps(
    middle: FloatArray, length: FloatArray, weight: FloatArray, n: int, ok: BoolArray
) -> HeavyShape:
    good = from_middle(middle[ok], length[ok], weight[ok], n)
    whole = []
    for values in (good.points, good.theta, good.curvature, good.params):
        full = np.full((length.size, *values.shape[1:]), np.nan)
        full[ok] = values
        whole.append(full)
    return HeavyShape(whole[0], whole[1], whole[2], whole[3], length, weight, middle)


def _no_equilibrium(index: int, length: float) -> Issue:
    what = f"wire {index} of {length * 1e3:.4f} mm has no equilibrium between its clamps near the guess"
    hint = "guess closer to these clamps, or move them in smaller steps"
    return Issue("wire.no_equilibrium", what, index=index, hint=hint)


def extend(shape: HeavyShape, a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slide wires along their own curves by a (B, K) [m]: poses (B, K, 3) of both ends; the middle stays
    where it is.

    Start at s = a, end at s = a + L. This is the freedom of splitting the slack otherwise.
    """
    k = a.shape[1]
    states = shape.at(np.concatenate([a, a + shape.length[:, None]], axis=1))
    return states[:, :k, :3], states[:, k:, :3]


def slide(shape: HeavyShape, a: FloatArray, n: int = 101) -> HeavyShape:
    """The wires that `extend` describes, for one a (B,) each."""
    middle = shape.at((a + 0.5 * shape.length)[:, None])[:, 0]
    return from_middle(middle, shape.length, shape.weight, n)


def sag_out_of_plane(
    shape: HeavyShape, weight_normal: FloatArray, section: Section, n: int = 101
) -> tuple[FloatArray, FloatArray]:
    """Deflection by the weight across the plane: largest (B,) [m] and profile (B, n) along z = x cross y.

    weight_normal (B,) [1/m^3]: weight per length along z over EI in the plane. Linear: trust it while it
    is small beside the shape. Infinite where the wire is not stable out of its plane."""
    at = shape.flow().at(clamped.quadrature())
    profile = clamped.out_of_plane_sag(
        at[..., 2], at[..., 3], at[..., 4:], shape.length, section, weight_normal, np.linspace(0.0, 1.0, n)
    )
    return np.abs(profile).max(axis=1), profile


_MODES = 32
"""Functions that stand for changes of the angle in the linearised problem."""
_QUADRATURE = 80
"""Gauss points along the wire for it."""


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

    position: FloatArray
    ends: FloatArray
    angle: FloatArray
    length: FloatArray
    sigma: FloatArray
    profile: FloatArray


def end_sensitivity(shape: HeavyShape, window: FloatArray | None = None) -> EndSensitivity:
    """Linearised clamped problem at each wire; window (B, 2): arc lengths [m] between which the wire
    counts (default: all). Looked at is each node inside; of a window between two nodes, the nearest one."""
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
    inside = np.ones_like(s, dtype=np.bool_)
    if window is not None:
        beyond = np.maximum(np.maximum(window[:, :1] - s, s - window[:, 1:]), 0.0)
        inside = beyond <= beyond.min(axis=1, keepdims=True)
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


def weight_deviation(shape: HeavyShape, n: int = 101, steps: int = 4) -> tuple[FloatArray, FloatArray]:
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
