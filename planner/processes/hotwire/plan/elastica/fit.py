"""Least-squares fit of elasticas, with or without weight, to planar curves: all curves at once.

The unknowns are the six numbers of the wire's state beside the middle of the target. An additional residual
keeps this state beside the middle, because it could otherwise slide along the wire. Residuals are distances
along the wire's normal from its points nearest to the target's points (orthogonal distance regression), so
only the shape counts and not the spacing of the points.

First guess: the curvature of an elastica is affine in position (Brander, Gravesen and Norbjerg, arXiv
1509.00703), with a known term from weight. Its integral, the angle, is linear in the unknowns, which a linear
least-squares fit of the angle gives. Levenberg-Marquardt iterations improve it.

Inside this module the unit of length is the length of each target.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.hotwire.plan.elastica.equations import (
    PicardStart,
    WireSolution,
    gauss_nodes,
    integrate_wire,
    legendre,
    node_counts,
)

_REFINEMENT = 4
"""Steps between two points of a target."""
_MAX_STEP_RATIO = 3.0  # largest ratio of neighbouring steps for which a spline over the point index is used


def first_guess(
    points: FloatArray, point_weight: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Guess the state at the middle of each curve by a linear least-squares fit of its angle.

    The result is the first guess of the fit. Lengths have the unit of the points. The guess is most accurate
    if the curves are about 1 long.

    Args:
        points: Curves (B, m, 2).
        point_weight: Weights of the points (B, m).
        weight: Weight q of the wires (B, 2).

    Returns:
        States (x, y, theta, k, Fx, Fy) (B, 6) at the middles of the curves, and arc lengths (B, m) of the
        points from the middle of their curve, negative before it.
    """
    fine = _refine(points)
    delta = np.diff(fine, axis=1)
    steps = np.hypot(delta[..., 0], delta[..., 1])
    cumulative = np.concatenate([np.zeros((steps.shape[0], 1)), np.cumsum(steps, axis=1)], axis=1)
    arc_length = cumulative - 0.5 * cumulative[:, -1:]
    theta = np.unwrap(np.arctan2(delta[..., 1], delta[..., 0]), axis=1)
    centre = _interpolate_at_zero(arc_length, fine)
    from_centre = fine - centre[:, None, :]

    def integral(values: FloatArray) -> FloatArray:
        """Integrate values (B, m, c) from the centre to the middles of the chords by the trapezoidal rule."""
        parts = 0.5 * (values[:, 1:] + values[:, :-1]) * steps[..., None]
        whole = np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(parts, axis=1)], axis=1)
        middle = 0.5 * (whole[:, 1:] + whole[:, :-1])
        out: FloatArray = middle - _interpolate_at_zero(arc_length, whole)[:, None, :]
        return out

    # k = kc + Fx (y - yc) - Fy (x - xc) - int (qx s sin theta - qy s cos theta) and theta = theta_c + int k
    s = 0.5 * (arc_length[:, 1:] + arc_length[:, :-1])
    load = (weight[:, :1] * s * np.sin(theta) - weight[:, 1:] * s * np.cos(theta)) * steps
    weight_curvature = np.concatenate([np.zeros_like(load[:, :1]), np.cumsum(load, axis=1)], axis=1)
    weight_curvature -= _interpolate_at_zero(arc_length, weight_curvature[..., None])
    force = integral(np.stack([from_centre[..., 1], -from_centre[..., 0], weight_curvature], axis=-1))
    columns = np.stack([np.ones_like(s), s, force[..., 0], force[..., 1]], axis=-1)
    chord_weight = np.repeat(
        np.minimum(point_weight[:, 1:], point_weight[:, :-1]), _REFINEMENT, axis=1
    ) / np.mean(point_weight)
    # weighted normal equations for (theta_c, kc, Fx, Fy), with a ridge for unknowns that are not determined
    weighted_columns = np.swapaxes(columns, 1, 2) * (steps * chord_weight)[:, None, :]
    ridge = np.diag([1e-12, 1e-9, 1e-8, 1e-8])
    coefficients = np.linalg.solve(
        weighted_columns @ columns + ridge, weighted_columns @ (theta + force[..., 2])[..., None]
    )
    return np.concatenate([centre, coefficients[..., 0]], axis=1), arc_length[:, ::_REFINEMENT]


def _refine(points: FloatArray) -> FloatArray:
    """Return curves (B, n, 2) with `_REFINEMENT` steps between two given points (B, m, 2).

    The new points lie on a cubic spline over the point index, or on the chords if the points are too unevenly
    spaced for such a spline.
    """
    count = points.shape[1]
    index = np.arange(count, dtype=np.float64)
    fine = np.linspace(0.0, count - 1.0, (count - 1) * _REFINEMENT + 1)
    smooth: FloatArray = np.asarray(CubicSpline(index, points, axis=1)(fine))
    interval = np.minimum(fine.astype(np.int64), count - 2)
    u = (fine - interval)[:, None]
    linear = points[:, interval] * (1.0 - u) + points[:, interval + 1] * u
    steps = np.hypot(*np.moveaxis(np.diff(points, axis=1), -1, 0))
    ratio = np.maximum(steps[:, 1:], steps[:, :-1]) / np.maximum(
        np.minimum(steps[:, 1:], steps[:, :-1]), 1e-300
    )
    even = ratio.max(axis=1) < _MAX_STEP_RATIO
    return np.where(even[:, None, None], smooth, linear)


def _interpolate_at_zero(arc_length: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate values (B, m, c), given at the increasing arc lengths (B, m), linearly to arc length 0.

    Returns:
        Values (B, c) at the middle of each curve.
    """
    wires = np.arange(arc_length.shape[0])
    right = np.clip(np.sum(arc_length < 0.0, axis=1), 1, arc_length.shape[1] - 1)
    a, b = arc_length[wires, right - 1], arc_length[wires, right]
    u = (-a / np.where(b > a, b - a, 1.0))[:, None]
    out: FloatArray = values[wires, right - 1] * (1.0 - u) + values[wires, right] * u
    return out


TAIL_WEIGHT = 2e-4
"""Default penalty on bent wire ends.

The cost is mean squared distance + (TAIL_WEIGHT l)^2 l int k^2 ds over the ends beyond the target, l being
the target's length. An end that bends like the target over one target length (k l = 1) then weighs as much as
an RMS distance of 2e-4 l: 0.03 mm on a target of 160 mm.
"""

_MAX_ITERATIONS = 30
"""Maximum number of Levenberg-Marquardt steps."""
_MAX_STAGE_ITERATIONS = 6
"""Maximum number of steps for each part of a target if the fit grows with it."""
_MAX_FIRST_RMS = 1e-2  # RMS over the target's length beyond which another first guess is tried
_COST_TOLERANCE = 1e-5  # relative decrease of the cost that ends the search


@dataclass(frozen=True)
class CurveFit:
    """Fit of B wires to curves of m points.

    Attributes:
        middle: State at the middle of the wire (B, 6).
        length: Lengths of the wires (B,) [m].
        residual: Signed distances of the points from the wire along its normal (B, m) [m].
        foot: Arc lengths of the nearest points from the start of the wire (B, m) [m].
        rms: RMS distance over the points with positive weight (B,) [m].
        largest: Largest distance over the points with positive weight (B,) [m].
        worst: Index of the farthest point (B,).
        rounds: Number of iterations (B,).
    """

    middle: FloatArray
    length: FloatArray
    residual: FloatArray
    foot: FloatArray
    rms: FloatArray
    largest: FloatArray
    worst: IntArray
    rounds: IntArray


@dataclass(frozen=True)
class _CurveFitTask:
    """Targets and wires of a fit, in units of each target's length l."""

    points: FloatArray  # (B, m, 2) over the target's length l
    point_weight: FloatArray  # (B, m) weights of the squared distances, sum 1
    weight: FloatArray  # (B, 2) q l^3
    reach: FloatArray  # (B,) half of the modelled wire, over l
    tail: FloatArray  # (B,) penalty on bent ends

    def select(self, i: IntArray) -> "_CurveFitTask":
        """Return the task of the wires with indices ``i``."""
        return _CurveFitTask(
            self.points[i], self.point_weight[i], self.weight[i], self.reach[i], self.tail[i]
        )


def fit_curves(
    targets: FloatArray,
    length: FloatArray | None = None,
    weight: FloatArray | None = None,
    window: FloatArray | None = None,
    split: FloatArray | float = 0.5,
    tail_weight: FloatArray | float = TAIL_WEIGHT,
) -> CurveFit:
    """Fit one elastica to each curve.

    Args:
        targets: Curves (B, m, 2) [m].
        length: Lengths of the wires (B,) [m], at least those of the targets. None: each wire ends beside the
            first and the last point of its target.
        weight: Weight q (B, 2) [1/m^3]. None: no weight.
        window: Weights >= 0 of the points (B, m). None: all 1.
        split: Fraction of the wire's free length that lies before the target.
        tail_weight: Penalty on curvature beyond the target (`TAIL_WEIGHT`). Not used without ``length``.

    Returns:
        The wires with the least cost that the search found. The caller judges the distances.

    Raises:
        ValueError: If a curve has fewer than 4 points, points that are not finite, or length 0; if weights of
            points are negative or all 0; if ``split`` is outside [0, 1]; or if a wire is shorter than its
            target.
    """
    batch, count = targets.shape[:2]
    if count < 4 or not np.isfinite(targets).all():
        raise ValueError(
            f"points: got {count} points per curve, or some not finite; give at least 4 finite points"
        )
    steps = np.hypot(*np.moveaxis(np.diff(targets, axis=1), -1, 0))
    size = steps.sum(axis=1)
    if not (size > 0.0).all():
        raise ValueError("points: got a curve of length 0; give distinct points along the curve")
    q = np.zeros((batch, 2)) if weight is None else np.asarray(weight, dtype=np.float64)
    point_weight = np.ones((batch, count)) if window is None else np.asarray(window, dtype=np.float64)
    total = point_weight.sum(axis=1)
    if not ((point_weight >= 0.0).all() and (total > 0.0).all()):
        raise ValueError("window: got weights below 0 or all 0; give at least some points a positive weight")
    split_fraction = np.broadcast_to(np.asarray(split, dtype=np.float64), (batch,))
    if not ((split_fraction >= 0.0).all() and (split_fraction <= 1.0).all()):
        raise ValueError(
            "split: got a value outside [0, 1]; give the fraction of the free length before the target"
        )
    # Half of the modelled wire, in target lengths: half of the target (0.5) with a margin of 10 %, and the
    # longer free end with a margin of 2 %.
    if length is None:
        reach = np.full(batch, 0.55)
    else:
        if not (length > size * (1.0 - 1e-3)).all():
            i = int(np.argmin(length / size))
            raise ValueError(
                f"length: got {length[i]:.6f} m for wire {i}, allowed at least its target's {size[i]:.6f} m"
            )
        free = np.maximum(length / size - 1.0, 0.0)
        reach = 0.55 + np.maximum(split_fraction, 1.0 - split_fraction) * free * 1.02
    tail = np.broadcast_to(np.asarray(tail_weight, dtype=np.float64), (batch,)) * (
        0.0 if length is None else 1.0
    )
    # Units of the target length l: positions over l, curvatures times l, F l^2, q l^3.
    task = _CurveFitTask(
        targets / size[:, None, None],
        point_weight / total[:, None],
        q * (size**3)[:, None],
        reach,
        np.ascontiguousarray(tail),
    )
    state, foot = first_guess(task.points, task.point_weight, task.weight)
    state, foot, rounds = _search_all(task, state, foot, _MAX_ITERATIONS)
    # A poor fit is repeated from the middle part of its target outwards, and the better result is kept.
    poor = np.flatnonzero(~(_rms_distance(task, state, foot) < _MAX_FIRST_RMS))
    if poor.size:
        poor_task = task.select(poor)
        other_state, other_foot, iterations = _fit_growing_part(poor_task)
        improved = _rms_distance(poor_task, other_state, other_foot) < _rms_distance(
            poor_task, state[poor], foot[poor]
        )
        state[poor[improved]], foot[poor[improved]] = other_state[improved], other_foot[improved]
        rounds[poor] += iterations
    lengths = _WireLengths(target=size, wire=length, split=split_fraction)
    return _make_fit(task, state, foot, lengths, point_weight > 0.0, rounds)


@dataclass(frozen=True)
class _FitState:
    """Residuals and their derivatives at one state of each wire, in target lengths."""

    theta: FloatArray  # (B, n) at the wire's Gauss nodes
    foot: FloatArray  # (B, m) arc lengths of the nearest points, from the state
    residual: FloatArray  # (B, r)
    jacobian: FloatArray  # (B, r, 6)
    cost: FloatArray  # (B,) sum of squared residuals


def _nearest_points(
    wire: WireSolution, task: _CurveFitTask, foot: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Improve the points of each wire that are nearest to its target's points, by one Newton step.

    The fit measures its residuals at these points. The caller repeats the step as the fit proceeds. All
    lengths are in target lengths. A nearest point is given by its arc length from the middle of its wire
    ("foot").

    Args:
        wire: The wires, solved on n Gauss nodes.
        task: The targets, with m points each.
        foot: Guess of the arc lengths of the nearest points (B, m).

    Returns:
        ``foot``, the improved arc lengths (B, m); ``at_foot``, the states (x, y, theta, k) of the wire there
        (B, m, 4); and ``table`` (B, m, n), the values of the n Legendre polynomials there. The product of
        ``table`` with the Legendre coefficients of a function of arc length interpolates this function to the
        nearest points.
    """
    values = np.stack([wire.x, wire.y, wire.theta, wire.curvature], axis=-1)
    reach = task.reach[:, None]
    series = gauss_nodes(wire.count).to_coefficients @ values
    for iteration in range(2):
        # the wire covers arc lengths -reach to reach, the polynomials 0 to 1
        table = legendre(foot / (2.0 * reach) + 0.5, wire.count)
        at_foot = table @ series
        if iteration == 1:  # only evaluates the improved points
            break
        gap = task.points - at_foot[..., :2]
        cos, sin = np.cos(at_foot[..., 2]), np.sin(at_foot[..., 2])
        along = gap[..., 0] * cos + gap[..., 1] * sin
        across = gap[..., 1] * cos - gap[..., 0] * sin
        # Newton for the nearest point: along = 0 with d(along)/ds = -(1 - k across). Near the centre of
        # curvature the derivative vanishes or changes its sign, so 1 - k across is limited to 0.3 or more,
        # and the step to 0.2 target lengths (both chosen).
        bend = np.maximum(1.0 - at_foot[..., 3] * across, 0.3)
        foot = np.clip(foot + np.clip(along / bend, -0.2, 0.2), -reach, reach)
    return foot, at_foot, table


def _evaluate(
    task: _CurveFitTask, state: FloatArray, foot: FloatArray, theta: FloatArray | None, count: int
) -> _FitState:
    """Compute the residuals at given states, and their derivatives with respect to the states.

    One iteration of the fit uses the result. The residuals of a wire are its weighted distances from the m
    points, the displacement of its state along the wire from the middle of the target, and its weighted
    curvature at the Gauss nodes (0 within the target). These are r = m + 1 + count residuals.

    Args:
        task: Targets and wires.
        state: States (B, 6).
        foot: Guess of the arc lengths of the nearest points (B, m).
        theta: Guess of the angles at the Gauss nodes (B, count), or None.
        count: Number of Gauss nodes.
    """
    wire = integrate_wire(
        state,
        2.0 * task.reach,
        task.weight,
        anchor=0.5,
        derivatives=True,
        start=PicardStart(count=count, theta=theta),
    )
    foot, at_foot, table = _nearest_points(wire, task, foot)
    # residuals of the distances, sqrt(weight) n.(p - r), and their derivatives with respect to the state
    cos, sin = np.cos(at_foot[..., 2]), np.sin(at_foot[..., 2])
    gap = task.points - at_foot[..., :2]
    root = np.sqrt(task.point_weight)
    distance = root * (gap[..., 1] * cos - gap[..., 0] * sin)
    inner = gauss_nodes(count).to_coefficients @ np.concatenate([wire.d_x, wire.d_y], axis=-1)
    d = table @ inner
    # p - r is normal to the wire there, so d(n.(p - r)) = -n.dr = sin(theta) dx - cos(theta) dy
    slope = np.empty((*distance.shape, 6))
    slope[..., 0] = root * sin
    slope[..., 1] = -root * cos
    slope[..., 2:] = root[..., None] * (sin[..., None] * d[..., :4] - cos[..., None] * d[..., 4:])

    # the state stays beside the middle of the target and does not slide along the wire
    batch = state.shape[0]
    middle = 0.5 * (
        task.points[:, (task.points.shape[1] - 1) // 2] + task.points[:, task.points.shape[1] // 2]
    )
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    slide_residual = ((middle[:, 0] - state[:, 0]) * c + (middle[:, 1] - state[:, 1]) * s)[:, None]
    # t.(m - r); its small derivative n.(m - r) by theta is left out
    slide_slope = np.zeros((batch, 1, 6))
    slide_slope[:, 0, 0], slide_slope[:, 0, 1] = -c, -s

    # penalty tail^2 int k^2 ds over the ends |s| > 1/2 beyond the target
    grid = gauss_nodes(count)
    arc_length = 2.0 * task.reach[:, None] * (grid.sigma - 0.5)
    penalty = (
        task.tail[:, None] * np.sqrt(2.0 * task.reach[:, None] * grid.weight) * (np.abs(arc_length) > 0.5)
    )
    tail_slope = np.zeros((batch, count, 6))
    tail_slope[..., 2:] = penalty[..., None] * wire.d_curvature
    residual = np.concatenate([distance, slide_residual, penalty * wire.curvature], axis=1)
    jacobian = np.concatenate([slope, slide_slope, tail_slope], axis=1)
    cost = np.sum(residual**2, axis=1)
    cost = np.where(np.isfinite(cost), cost, np.inf)
    return _FitState(wire.theta, foot, residual, jacobian, cost)


def _rms_distance(task: _CurveFitTask, state: FloatArray, foot: FloatArray) -> FloatArray:
    """Return the weighted RMS distance (B,) of the target's points from each wire, in target lengths.

    It decides whether a fit is repeated from another first guess, and which of both is kept.
    """
    start = PicardStart(count=_max_node_count(task, state))
    wire = integrate_wire(state, 2.0 * task.reach, task.weight, anchor=0.5, start=start)
    _, at_foot, _ = _nearest_points(wire, task, foot)
    gap = np.sum((task.points - at_foot[..., :2]) ** 2, axis=2)
    return np.asarray(np.sqrt(np.sum(task.point_weight * gap, axis=1)))


def _fit_growing_part(task: _CurveFitTask) -> tuple[FloatArray, FloatArray, IntArray]:
    """Fit the middle of the target first and then more and more of it.

    This is for curves with many waves, where the errors of the first guess have grown too large at the ends.

    Returns:
        States (B, 6), arc lengths of the nearest points (B, m), and numbers of iterations (B,).
    """
    _, arc_length = first_guess(task.points, task.point_weight, task.weight)
    state = foot = np.empty(0)
    rounds = np.zeros(task.reach.size, dtype=np.int64)
    for part in (0.4, 0.6, 0.8, 1.0):
        # points beyond the part keep a tiny weight, so that the problem stays determined
        is_active = np.abs(arc_length) <= 0.5 * part + 1e-12
        point_weight = task.point_weight * np.where(is_active, 1.0, 1e-9)
        point_weight /= point_weight.sum(axis=1, keepdims=True)
        stage = replace(task, point_weight=point_weight)
        if part == 0.4:
            state, _ = first_guess(stage.points, stage.point_weight, stage.weight)
        state, foot, iterations = _search_all(
            stage, state, arc_length, _MAX_ITERATIONS if part == 1.0 else _MAX_STAGE_ITERATIONS
        )
        rounds += iterations
    return state, foot, rounds


def _node_counts(task: _CurveFitTask, state: FloatArray) -> IntArray:
    # base and per_wave: an error of about 1e-8 of the wire's length
    return node_counts(state, 2.0 * task.reach, task.weight, base=14.0, per_wave=3.6)


def _max_node_count(task: _CurveFitTask, state: FloatArray) -> int:
    return int(np.max(_node_counts(task, state)))


def _search_all(
    task: _CurveFitTask, state: FloatArray, foot: FloatArray, limit: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Run the Levenberg-Marquardt search with as many Gauss nodes as each wire needs.

    Wires that develop more waves during the search continue with more nodes.

    Args:
        task: Targets and wires.
        state: First guess of the states (B, 6).
        foot: First guess of the arc lengths of the nearest points (B, m).
        limit: Maximum number of iterations for each number of nodes.

    Returns:
        States (B, 6), arc lengths of the nearest points (B, m), and numbers of iterations (B,).
    """
    state, foot = state.copy(), foot.copy()
    used = np.zeros(state.shape[0], dtype=np.int64)
    rounds = np.zeros(state.shape[0], dtype=np.int64)
    while True:
        required = _node_counts(task, state)
        unresolved = np.flatnonzero(required > used)
        if unresolved.size == 0:
            return state, foot, rounds
        count = int(required[unresolved].min())
        selected = unresolved[required[unresolved] == count]
        state[selected], foot[selected], iterations = _levenberg_marquardt(
            task.select(selected), state[selected], foot[selected], count, limit
        )
        used[selected] = count
        rounds[selected] += iterations


def _levenberg_marquardt(
    task: _CurveFitTask, state: FloatArray, foot: FloatArray, count: int, limit: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Minimise the cost of all wires at once.

    A wire leaves the iteration if an accepted step decreases its cost by a fraction below `_COST_TOLERANCE`,
    its step or cost is negligible, or its damping has grown beyond 1e8 because no step improves it.

    Args:
        task: Targets and wires.
        state: First guess of the states (B, 6).
        foot: First guess of the arc lengths of the nearest points (B, m).
        count: Number of Gauss nodes.
        limit: Maximum number of iterations.

    Returns:
        States (B, 6), arc lengths of the nearest points (B, m), and numbers of iterations (B,).
    """
    state, foot = state.copy(), foot.copy()
    initial = _evaluate(task, state, foot, theta=None, count=count)
    theta, foot = initial.theta, initial.foot
    residual, jacobian, cost = initial.residual, initial.jacobian, initial.cost
    damp = np.full(state.shape[0], 1e-6)
    rounds = np.zeros(state.shape[0], dtype=np.int64)
    active = np.arange(state.shape[0])
    for _ in range(limit):
        if active.size == 0:
            break
        i = active
        rounds[i] += 1
        # (J'J + damp diag(J'J)) step = -J'r
        j = jacobian[i]
        normal = np.swapaxes(j, 1, 2) @ j
        slope = (np.swapaxes(j, 1, 2) @ residual[i][..., None])[..., 0]
        scale = np.einsum("bii->bi", normal)
        normal += np.eye(6) * (damp[i, None] * scale + 1e-14 * scale.max(axis=1, keepdims=True))[:, None, :]
        step = -np.linalg.solve(normal, slope[..., None])[..., 0]
        trial = _evaluate(task.select(i), state[i] + step, foot[i], theta[i], count)
        improved = trial.cost <= cost[i]
        decrease = (cost[i] - trial.cost) / np.maximum(cost[i], 1e-300)
        small = np.abs(step).max(axis=1) < 1e-11
        accepted = i[improved]
        state[accepted] += step[improved]
        theta[accepted], foot[accepted] = trial.theta[improved], trial.foot[improved]
        residual[accepted], jacobian[accepted] = trial.residual[improved], trial.jacobian[improved]
        cost[accepted] = trial.cost[improved]
        damp[i] = np.where(improved, np.maximum(damp[i] * 0.1, 1e-12), np.maximum(damp[i] * 8.0, 1e-6))
        done = (improved & (decrease < _COST_TOLERANCE)) | small | (cost[i] < 1e-24) | (damp[i] > 1e8)
        active = i[~done]
    return state, foot, rounds


@dataclass(frozen=True)
class _WireLengths:
    """Lengths of B targets and of their wires."""

    target: FloatArray  # (B,) [m]
    wire: FloatArray | None  # (B,) [m], None: each wire ends beside the outer points of its target
    split: FloatArray  # (B,) fraction of the wire's free length that lies before its target


def _make_fit(
    task: _CurveFitTask,
    state: FloatArray,
    foot: FloatArray,
    lengths: _WireLengths,
    has_weight: BoolArray,
    rounds: IntArray,
) -> CurveFit:
    """Cut the fitted curves to the lengths of the wires and return the fit in metres.

    RMS and largest distance count only the points that ``has_weight`` (B, m) selects.
    """
    size, length = lengths.target, lengths.wire
    start = PicardStart(count=_max_node_count(task, state))
    wire = integrate_wire(state, 2.0 * task.reach, task.weight, anchor=0.5, start=start)
    for _ in range(2):  # two more Newton steps, because the last step of the fit has moved the wires
        foot, at_foot, _ = _nearest_points(wire, task, foot)
    # the wire starts ``split`` of its free length before the point nearest to the start of the target
    first, last = foot[:, 0], foot[:, -1]
    wire_length = last - first if length is None else length / size
    wire_start = first - lengths.split * (wire_length - (last - first)) if length is not None else first
    sigma = (wire_start + 0.5 * wire_length) / (2.0 * task.reach) + 0.5
    middle = wire.at(sigma[:, None])[:, 0]
    # from target lengths to metres, for x, y, theta, k, Fx, Fy
    unit = np.stack([size, size, np.ones_like(size), 1.0 / size, size**-2, size**-2], axis=1)
    gap = task.points - at_foot[..., :2]
    residual = (gap[..., 1] * np.cos(at_foot[..., 2]) - gap[..., 0] * np.sin(at_foot[..., 2])) * size[:, None]
    distance = np.hypot(gap[..., 0], gap[..., 1]) * size[:, None] * has_weight
    rms = np.sqrt(np.sum(distance**2, axis=1) / has_weight.sum(axis=1))
    return CurveFit(
        middle * unit,
        wire_length * size,
        residual,
        (foot - wire_start[:, None]) * size[:, None],
        rms,
        distance.max(axis=1),
        np.argmax(distance, axis=1).astype(np.int64),
        rounds,
    )
