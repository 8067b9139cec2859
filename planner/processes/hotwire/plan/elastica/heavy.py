"""The planar elastica with weight, and its sensitivity to errors of clamps, length and weight.

This is the behaviour of a real wire in a plane that is not level. Signs (see `equations`): weight q (B, 2)
[1/m^3] is the wire's weight per length over EI as a vector in the plane, in the direction of the pull
(straight down in a vertical plane: (0, -w/EI)). F is the force of the part beyond s on the part before it
over EI, so F(s) = F0 - q s. The parameters of a wire are its state at s = 0: (x0, y0, theta0, k0, Fx, Fy).

`end_sensitivity` and `weight_deviation` state how much a clamped wire moves in its plane if its clamps, its
length or its weight differ from the plan.
"""

from dataclasses import dataclass

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError
from planner.processes.hotwire.plan.elastica import clamped
from planner.processes.hotwire.plan.elastica.clamped import (
    MIN_STABLE_MARGIN,
    ClampedWires,
    QuadratureShape,
    StiffnessRatios,
    middle_state,
    min_constrained_eigenvalue,
    refine_state,
)
from planner.processes.hotwire.plan.elastica.equations import (
    PicardStart,
    WireSolution,
    bump_basis,
    gauss_nodes,
    integrate_wire,
)
from planner.processes.hotwire.plan.elastica.fit import TAIL_WEIGHT, fit_curves

_POSE_TOLERANCE_FRACTION = 1e-9  # largest deviation of the end poses, as a fraction of the length
_HOMOTOPY_STEPS = 12  # steps from a guess to clamps that Newton does not reach directly


@dataclass(frozen=True)
class HeavyShape:
    """Shapes of B wires with weight, sampled at n points with equal steps of arc length.

    Attributes:
        points: Points (B, n, 2) [m].
        theta: Angles (B, n) [rad].
        curvature: Curvatures (B, n) [1/m].
        params: States at s = 0 (B, 6).
        length: Lengths (B,) [m].
        weight: Weight q (B, 2) [1/m^3].
        middle: States at s = L/2 (B, 6). All computations start from the middle, because rounding errors grow
            least from there.
    """

    points: FloatArray
    theta: FloatArray
    curvature: FloatArray
    params: FloatArray
    length: FloatArray
    weight: FloatArray
    middle: FloatArray

    @property
    def start(self) -> FloatArray:
        """Poses x, y, theta (B, 3) at s = 0."""
        return np.concatenate([self.points[:, 0], self.theta[:, :1]], axis=1)

    @property
    def end(self) -> FloatArray:
        """Poses x, y, theta (B, 3) at s = L."""
        return np.concatenate([self.points[:, -1], self.theta[:, -1:]], axis=1)

    @property
    def margin_in_plane(self) -> FloatArray:
        """Stability margin (B,) in the plane.

        The wire is stable above `MIN_STABLE_MARGIN`. The margin is 1 without force and 0 at buckling.
        """
        return clamped.in_plane_margin(self.quadrature_shape())

    def margin_out_of_plane(self, section: StiffnessRatios) -> FloatArray:
        """Return the stability margin (B,) against leaving the plane: 1 without force, 0 at buckling."""
        return clamped.out_of_plane_margin(self.quadrature_shape(), section)

    @property
    def stable_in_plane(self) -> BoolArray:
        """Whether each wire (B,) is stable in its plane."""
        return self.margin_in_plane > clamped.MIN_STABLE_MARGIN

    def stable_out_of_plane(self, section: StiffnessRatios) -> BoolArray:
        """Return whether each wire (B,) of a ``section`` is stable out of its plane."""
        return self.margin_out_of_plane(section) > clamped.MIN_STABLE_MARGIN

    def flow(self, count: int | None = None) -> WireSolution:
        """Return the wires on Gauss nodes, ``count`` of them if given."""
        start = PicardStart(count=count)
        return integrate_wire(self.middle, self.length, self.weight, anchor=0.5, start=start)

    def at(self, s: FloatArray) -> FloatArray:
        """Return states (B, m, 6) at arc lengths s (B, m) [m].

        Arc lengths beyond the ends are extrapolated as if the wire continued.
        """
        half_length = np.maximum(np.abs(s - 0.5 * self.length[:, None]).max(axis=1), 0.5 * self.length)
        wire = integrate_wire(self.middle, 2.0 * half_length, self.weight, anchor=0.5)
        return wire.at((s - 0.5 * self.length[:, None]) / (2.0 * half_length)[:, None] + 0.5)

    def quadrature_shape(self) -> QuadratureShape:
        """Return the shapes at the nodes at which stability is computed."""
        at = self.flow().at(clamped.quadrature_nodes())
        return QuadratureShape(theta=at[..., 2], curvature=at[..., 3], force=at[..., 4:], length=self.length)


@dataclass(frozen=True)
class HeavyFit:
    """Wires fitted to targets of m points.

    Attributes:
        shape: The placed wires.
        residual: Signed distances of the target's points from the wire along its normal (B, m) [m].
        foot: Arc lengths of the nearest points on the wire (B, m) [m].
        rms: RMS distance over the points with positive weight (B,) [m].
        largest: Largest distance over the points with positive weight (B,) [m].
        worst: Index of the farthest point (B,).
    """

    shape: HeavyShape
    residual: FloatArray
    foot: FloatArray
    rms: FloatArray
    largest: FloatArray
    worst: IntArray


def from_middle(middle: FloatArray, length: FloatArray, weight: FloatArray, n: int = 101) -> HeavyShape:
    """Create wires (B,) from their states at s = L/2.

    Args:
        middle: States (B, 6).
        length: Lengths (B,) [m].
        weight: Weight q (B, 2) [1/m^3].
        n: Number of points along each wire.
    """
    wire = integrate_wire(middle, length, weight, anchor=0.5)
    at = wire.at(np.linspace(0.0, 1.0, n))
    return HeavyShape(at[..., :2], at[..., 2], at[..., 3], at[:, 0].copy(), length, weight, middle)


def integrate(params: FloatArray, length: FloatArray, weight: FloatArray, n: int = 101) -> HeavyShape:
    """Create wires from their states at s = 0. The error is below 1e-8 L, in practice near 1e-11 L.

    Args:
        params: States (B, 6).
        length: Lengths (B,) [m].
        weight: Weight q (B, 2) [1/m^3].
        n: Number of points along each wire.
    """
    wire = integrate_wire(params, length, weight, anchor=0.0)
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
) -> HeavyFit:
    """Place wires of exactly given lengths so that a part of each meets its target best.

    The caller checks the stability of the shape.

    Args:
        targets: Curves (B, m, 2) [m].
        length: Lengths (B,) [m].
        weight: Weight q (B, 2) [1/m^3].
        window: Weights >= 0 of the target's points (B, m), all 1 by default.
        split: Fraction of the wire's free length that lies before the target.
        tail_weight: Penalty on curvature beyond the target, in target lengths (`fit.TAIL_WEIGHT`).

    Raises:
        ValueError: For targets longer than their wire and for invalid numbers.
    """
    fitted = fit_curves(targets, length, weight, window, split, tail_weight)
    shape = from_middle(fitted.middle, fitted.length, weight)
    return HeavyFit(shape, fitted.residual, fitted.foot, fitted.rms, fitted.largest, fitted.worst)


def solve(wires: ClampedWires, guess_params: FloatArray, n: int = 101, strict: bool = True) -> HeavyShape:
    """Solve for the equilibrium between clamps next to a guess, stable or not, by Newton's method.

    Where Newton's method fails directly, the clamps are moved from those of the guess in `_HOMOTOPY_STEPS`
    steps.

    Args:
        wires: Wires between their clamps.
        guess_params: Guess of the states at s = 0 (B, 6).
        n: Number of points along each wire.
        strict: Whether failure raises. Otherwise the shapes of the wires that fail are NaN.

    Raises:
        TandemError: ``wire.no_equilibrium`` if Newton's method fails for a wire. Its ``partial`` has the
            shapes of all wires.
    """
    middle = _solve_by_homotopy(wires, guess_params, steps=1)
    failed = np.flatnonzero(np.isnan(middle[:, 0]))
    if failed.size:
        middle[failed] = _solve_by_homotopy(wires.select(failed), guess_params[failed], _HOMOTOPY_STEPS)
    ok = np.isfinite(middle[:, 0])
    shape = _with_nan_rows(middle, wires.length, wires.weight, n, ok)
    if strict and not ok.all():
        raise TandemError(
            [_no_equilibrium(int(i), float(wires.length[i])) for i in np.flatnonzero(~ok)], partial=shape
        )
    return shape


def _solve_by_homotopy(clamped_wires: ClampedWires, params: FloatArray, steps: int) -> FloatArray:
    """Solve for the states at the middles of wires, by homotopy from the guess's end poses.

    In equal steps the end poses move from those of the guess to the required ones, and each step starts from
    the solution of the previous one. A guess whose end meets the required one better without weight counts as
    a wire without weight, and its weight grows along the homotopy.

    Args:
        clamped_wires: Wires between their clamps.
        params: Guess of the states at s = 0 (B, 6).
        steps: Number of steps of the homotopy.

    Returns:
        States at s = L/2 (B, 6), NaN for wires without a solution.
    """
    length, start = clamped_wires.length, clamped_wires.start
    end, weight = clamped_wires.end, clamped_wires.weight
    # Guess as a clamped wire, with or without weight: amplitudes, force and end pose.
    zero_weight = np.zeros_like(weight)
    wires = [integrate_wire(params, length, load, anchor=0.0) for load in (weight, zero_weight)]
    end_errors = [np.hypot(*(wire.at(np.array([1.0]))[:, 0, :2] - end[:, :2]).T) for wire in wires]
    is_weightless = end_errors[1] < end_errors[0]
    pick_weightless = is_weightless[:, None]
    states = []
    for wire in wires:
        grid = gauss_nodes(wire.count)
        states.append(clamped.amplitudes_of(wire.theta, grid.sigma, grid.weight))
    amplitude = np.where(pick_weightless, states[1], states[0])
    force = params[:, 4:] * (length**2)[:, None]
    # reversed: np.where expects the wire without weight first
    guess_end = np.where(pick_weightless, *(wire.at(np.array([1.0]))[:, 0, :3] for wire in reversed(wires)))
    initial_weight = np.where(pick_weightless, zero_weight, weight)
    # Homotopy of clamps and weight. A step that fails keeps the previous shape.
    solution = None
    for i in range(1, steps + 1):
        t = i / steps
        current_start = params[:, :3] + t * (start - params[:, :3])
        current_end = guess_end + t * (end - guess_end)
        current_weight = initial_weight + t * (weight - initial_weight)
        current = ClampedWires(length=length, start=current_start, end=current_end, weight=current_weight)
        solution = clamped.solve_newton(current, amplitude, force)
        converged = solution.residual < 1e-6
        amplitude = np.where(converged[:, None], solution.amplitude, amplitude)
        force = np.where(converged[:, None], solution.force, force)
    # Exact state at the middle from the Galerkin solution, by Newton on both end poses.
    middle = np.full((length.size, 6), np.nan)
    solved = np.flatnonzero(solution.residual < 1e-6) if solution is not None else np.empty(0, dtype=np.int64)
    if solved.size:
        state = middle_state(
            start[solved], end[solved], length[solved], weight[solved], amplitude[solved], force[solved]
        )
        state, miss = refine_state(state, start[solved], end[solved], length[solved], weight[solved])
        middle[solved[miss < _POSE_TOLERANCE_FRACTION]] = state[miss < _POSE_TOLERANCE_FRACTION]
    return middle


def _with_nan_rows(
    middle: FloatArray, length: FloatArray, weight: FloatArray, n: int, ok: BoolArray
) -> HeavyShape:
    """Create wires from their middle states where ``ok`` (B,) is set. The others are NaN."""
    solved = from_middle(middle[ok], length[ok], weight[ok], n)
    padded = []
    for values in (solved.points, solved.theta, solved.curvature, solved.params):
        full = np.full((length.size, *values.shape[1:]), np.nan)
        full[ok] = values
        padded.append(full)
    return HeavyShape(padded[0], padded[1], padded[2], padded[3], length, weight, middle)


def _no_equilibrium(index: int, length: float) -> Issue:
    what = format_message("wire.no_equilibrium", index=index, length_mm=length * 1e3)
    hint = "start from a guess closer to these clamps, or move them in smaller steps"
    return Issue("wire.no_equilibrium", what, index=index, hint=hint)


def slide_ends(shape: HeavyShape, start_arc_length: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slide wires along their own curves.

    This is the freedom to distribute the slack between the ends. The curve keeps its place.

    Args:
        shape: The wires.
        start_arc_length: Arc lengths a of the new starts (B, K) [m]. The new ends are at a + L.

    Returns:
        Poses (B, K, 3) of both ends.
    """
    k = start_arc_length.shape[1]
    states = shape.at(np.concatenate([start_arc_length, start_arc_length + shape.length[:, None]], axis=1))
    return states[:, :k, :3], states[:, k:, :3]


def slide(shape: HeavyShape, start_arc_length: FloatArray, n: int = 101) -> HeavyShape:
    """Return the wires after a slide along their own curves, as `slide_ends` describes it.

    Args:
        shape: The wires.
        start_arc_length: Arc length of the new start of each wire (B,) [m].
        n: Number of points along each wire.
    """
    middle = shape.at((start_arc_length + 0.5 * shape.length)[:, None])[:, 0]
    return from_middle(middle, shape.length, shape.weight, n)


def sag_out_of_plane(
    shape: HeavyShape, weight_normal: FloatArray, section: StiffnessRatios, n: int = 101
) -> tuple[FloatArray, FloatArray]:
    """Return the deflections of wires along z = x cross y under the weight across their planes.

    The model is linear: it holds while the deflection is small compared with the shape. The result is
    infinite if the wire is not stable out of its plane.

    Args:
        shape: The wires.
        weight_normal: Weight per length along z over EI in the plane (B,) [1/m^3].
        section: Stiffness ratios.
        n: Number of points along each wire.

    Returns:
        Largest deflection (B,) [m] and profile (B, n) [m].
    """
    profile = clamped.out_of_plane_sag(
        shape.quadrature_shape(), section, weight_normal, np.linspace(0.0, 1.0, n)
    )
    return np.abs(profile).max(axis=1), profile


_LINEAR_MODES = 32
"""Number of functions that represent changes of the angle in the linearised problem."""
_QUADRATURE_POINTS = 80
"""Number of Gauss points along the wire in the linearised problem."""


@dataclass(frozen=True)
class EndSensitivity:
    """Largest normal displacement of the wire inside the window, per unit of error.

    It is infinite for wires at or beyond buckling.

    Attributes:
        position: Both ends displaced by one unit, each in its worst direction in the plane (B,) [m/m].
        ends: Both ends displaced by one unit in the plane, as independent errors whose squares add (B,)
            [m/m].
        angle: Both clamp angles wrong by one unit, in the worst senses (B,) [m/rad].
        length: The wire one unit too long (B,) [m/m].
        sigma: Nodes (n,).
        profile: Normal displacement at the nodes by xA, yA, thetaA, xB, yB, thetaB, L (B, n, 7).
    """

    position: FloatArray
    ends: FloatArray
    angle: FloatArray
    length: FloatArray
    sigma: FloatArray
    profile: FloatArray


def end_sensitivity(shape: HeavyShape, window: FloatArray | None = None) -> EndSensitivity:
    """Compute how far wires move in their planes if clamps or length have unit errors, linearised.

    Multiplied by the stated end errors, the result tells how far the cut surface deviates. It is the maximum
    over all nodes inside the window. For a window between two nodes it is the value at the nearest node.

    Args:
        shape: The wires.
        window: Arc lengths (B, 2) [m] between which the wire counts, by default all of it.
    """
    # For each of 7 unit errors: stationary energy, form a = gradient + C' f, and required chord, C a = chord.
    # C (chord_slope) is the derivative of the chord by the amplitudes a, and f the change of the force.
    base = bump_basis(_LINEAR_MODES, _QUADRATURE_POINTS)
    sigma, w = base.sigma, base.weight
    at = shape.flow().at(sigma)
    length = shape.length[:, None]
    sin, cos = np.sin(at[..., 2]), np.cos(at[..., 2])
    tangential_force = length**2 * (at[..., 4] * cos + at[..., 5] * sin)
    normal = np.stack([-sin, cos], axis=1)
    batch = shape.length.size
    form = np.eye(_LINEAR_MODES) + base.value.T @ ((tangential_force * w)[:, :, None] * base.value)
    chord_slope = (normal * w) @ base.value

    # inputs: xA, yA, thetaA, xB, yB, thetaB, L; lift: change of theta that an end angle causes
    lift = np.zeros((7, sigma.size))
    lift[2], lift[5] = 1.0 - sigma, sigma
    chord = np.zeros((batch, 2, 7))
    chord[:, 0, 0] = chord[:, 1, 1] = -1.0 / shape.length
    chord[:, 0, 3] = chord[:, 1, 4] = 1.0 / shape.length
    inner = np.stack([cos, sin], axis=1)
    chord[:, :, 6] = -(inner @ w) / length
    chord -= (normal * w) @ lift.T
    gradient = -np.swapaxes(((tangential_force * w)[:, None, :] * lift) @ base.value, 1, 2)
    # a longer wire is heavier in its own units: d(q L^3) = 3 q L^2 dL lowers F by that times sigma
    load = 3.0 * shape.weight * (shape.length**2)[:, None]
    weight_change = (load[:, :1] * sin - load[:, 1:] * cos) * sigma * w
    gradient[:, :, 6] += weight_change @ base.value

    # saddle point system; wires at or beyond buckling get the identity here and infinite sensitivity below
    size = _LINEAR_MODES
    system = np.zeros((batch, size + 2, size + 2))
    system[:, :size, :size] = form
    system[:, :size, size:] = -np.swapaxes(chord_slope, 1, 2)
    system[:, size:, :size] = chord_slope
    right_side = np.concatenate([gradient, chord], axis=1)
    gram = chord_slope @ np.swapaxes(chord_slope, 1, 2)
    determinant = gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2  # 0 for a straight wire
    singular = ~(determinant > 1e-16 * (gram[:, 0, 0] + gram[:, 1, 1]))
    is_unstable = singular | (min_constrained_eigenvalue(form, chord_slope) <= MIN_STABLE_MARGIN)
    system[is_unstable] = np.eye(size + 2)
    right_side[is_unstable] = 0.0
    # displacement of the points from the change of theta, projected on the normal
    change = np.linalg.solve(system, right_side)[:, :size]
    d_theta = base.value @ change + lift.T
    integral = gauss_nodes(_QUADRATURE_POINTS).integral_from_start
    dx = length[..., None] * (integral @ (-sin[..., None] * d_theta))
    dy = length[..., None] * (integral @ (cos[..., None] * d_theta))
    dx[..., 0] += 1.0
    dy[..., 1] += 1.0
    dx[..., 6] += cos @ integral.T
    dy[..., 6] += sin @ integral.T
    profile = -sin[..., None] * dx + cos[..., None] * dy
    profile[is_unstable] = np.inf
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
    """Return how far its weight moves each wire in its plane between the same clamps.

    The weight is removed in steps, each solved from the previous one. The result is infinite if the wire
    without weight has no shape on this branch (it would snap).

    Args:
        shape: The wires.
        n: Number of points along each wire.
        steps: Number of steps.

    Returns:
        Largest displacement (B,) [m] and profile (B, n) along the normal.
    """
    start, end = shape.start, shape.end
    params = shape.params.copy()
    solved = np.arange(shape.length.size)
    for i in range(1, steps + 1):
        weight = (1.0 - i / steps) * shape.weight[solved]
        wires = ClampedWires(length=shape.length[solved], start=start[solved], end=end[solved], weight=weight)
        current = solve(wires, params[solved], n=2, strict=False)
        ok = np.isfinite(current.params[:, 0])
        solved = solved[ok]
        params[solved] = current.params[ok]
    profile = np.full((shape.length.size, n), np.inf)
    if solved.size:
        weightless = integrate(params[solved], shape.length[solved], np.zeros((solved.size, 2)), n)
        weighted = integrate(shape.params[solved], shape.length[solved], shape.weight[solved], n)
        gap = weighted.points - weightless.points
        # displacement by weight along the normal of the wire with weight
        profile[solved] = gap[..., 1] * np.cos(weighted.theta) - gap[..., 0] * np.sin(weighted.theta)
    return np.abs(profile).max(axis=1), profile
