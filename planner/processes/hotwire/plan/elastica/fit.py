"""Least-squares fit of elasticas, with or without weight, to planar curves: all curves at once.

The unknowns are the six numbers of the state abreast of the target's middle; sliding along the
curve is fixed by one condition there. Residuals are distances along the curve's normal at the feet
of the target's points (orthogonal distance regression), so only the shape counts and not the pace
of the points.

First guess: the curvature of an elastica is affine in position (Brander, Gravesen and Norbjerg,
arXiv 1509.00703), with a known term from weight; integrated once, it is linear in what is sought.
Then Levenberg-Marquardt.

Lengths are measured in target lengths inside.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.hotwire.plan.elastica.equations import Flow, flow, legendre, node_counts, nodes

_FINER = 4
"""Steps between two points of a target."""
_EVEN_RATIO = (
    3.0  # largest ratio of neighbouring steps up to which a spline over the points' numbers is trusted
)


def first_guess(points: FloatArray, share: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """States (B, 6) abreast of the middles of curves (B, m, 2) and the arc lengths (B, m) of the points
    from there.

    share (B, m): weights of the points; weight q (B, 2). Units of the points; best when curves are about
    1 long."""
    fine = _refine(points)
    delta = np.diff(fine, axis=1)
    steps = np.hypot(delta[..., 0], delta[..., 1])
    total = np.concatenate([np.zeros((steps.shape[0], 1)), np.cumsum(steps, axis=1)], axis=1)
    place = total - 0.5 * total[:, -1:]
    theta = np.unwrap(np.arctan2(delta[..., 1], delta[..., 0]), axis=1)
    centre = _at_zero(place, fine)
    from_centre = fine - centre[:, None, :]

    def integral(values: FloatArray) -> FloatArray:
        """From the centre to the middles of the chords, by trapezoids; values (B, m, c)."""
        parts = 0.5 * (values[:, 1:] + values[:, :-1]) * steps[..., None]
        whole = np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(parts, axis=1)], axis=1)
        middle = 0.5 * (whole[:, 1:] + whole[:, :-1])
        out: FloatArray = middle - _at_zero(place, whole)[:, None, :]
        return out

    # k = kc + Fx (y - yc) - Fy (x - xc) - int (qx s sin theta - qy s cos theta) and theta = theta_c + int k
    s = 0.5 * (place[:, 1:] + place[:, :-1])
    load = (weight[:, :1] * s * np.sin(theta) - weight[:, 1:] * s * np.cos(theta)) * steps
    bent = np.concatenate([np.zeros_like(load[:, :1]), np.cumsum(load, axis=1)], axis=1)
    bent -= _at_zero(place, bent[..., None])
    force = integral(np.stack([from_centre[..., 1], -from_centre[..., 0], bent], axis=-1))
    columns = np.stack([np.ones_like(s), s, force[..., 0], force[..., 1]], axis=-1)
    trust = np.repeat(np.minimum(share[:, 1:], share[:, :-1]), _FINER, axis=1) / np.mean(share)
    left = np.swapaxes(columns, 1, 2) * (steps * trust)[:, None, :]
    ridge = np.diag([1e-12, 1e-9, 1e-8, 1e-8])
    law = np.linalg.solve(left @ columns + ridge, left @ (theta + force[..., 2])[..., None])
    return np.concatenate([centre, law[..., 0]], axis=1), place[:, ::_FINER]


def _refine(points: FloatArray) -> FloatArray:
    """Curves with more points (B, n, 2): a cubic spline over the points' numbers, or lines where the
    steps are uneven."""
    count = points.shape[1]
    number = np.arange(count, dtype=np.float64)
    fine = np.linspace(0.0, count - 1.0, (count - 1) * _FINER + 1)
    smooth: FloatArray = np.asarray(CubicSpline(number, points, axis=1)(fine))
    cell = np.minimum(fine.astype(np.int64), count - 2)
    u = (fine - cell)[:, None]
    lines = points[:, cell] * (1.0 - u) + points[:, cell + 1] * u
    steps = np.hypot(*np.moveaxis(np.diff(points, axis=1), -1, 0))
    ratio = np.maximum(steps[:, 1:], steps[:, :-1]) / np.maximum(
        np.minimum(steps[:, 1:], steps[:, :-1]), 1e-300
    )
    even = ratio.max(axis=1) < _EVEN_RATIO
    return np.where(even[:, None, None], smooth, lines)


def _at_zero(place: FloatArray, values: FloatArray) -> FloatArray:
    """Values (B, c) at place 0 from (B, m, c) at the increasing places (B, m), linear in between."""
    rows = np.arange(place.shape[0])
    right = np.clip(np.sum(place < 0.0, axis=1), 1, place.shape[1] - 1)
    a, b = place[rows, right - 1], place[rows, right]
    u = (-a / np.where(b > a, b - a, 1.0))[:, None]
    out: FloatArray = values[rows, right - 1] * (1.0 - u) + values[rows, right] * u
    return out


TAIL_WEIGHT = 2e-4
"""Default price of bent wire ends: the cost is mean squared distance + (TAIL_WEIGHT l)^2 l int k^2 ds
over the ends beyond the target, l being the target's length. An end that bends like the target over one
target length (k l = 1) then weighs as much as an rms distance of 2e-4 l: 0.03 mm on a target of 160
mm."""

_SEARCH_ROUNDS = 30
"""Levenberg-Marquardt steps at most."""
_STAGE_ROUNDS = 6
"""As many for each part of a target where the fit grows with it."""
_FAR_RMS = 1e-2  # rms over the target's length beyond which another way in is tried
_SETTLED = 1e-5  # relative fall of the cost that ends the search


@dataclass(frozen=True)
class CurveFit:
    """middle (B, 6): state at the wire's middle; length (B,); residual (B, m): signed distances of the
    points from the wire along its normal [m]; foot (B, m): arc length of their feet from the wire's
    start; rms, largest (B,) over the points that count; worst (B,): index of the farthest point; rounds
    (B,): iterations taken."""

    middle: FloatArray
    length: FloatArray
    residual: FloatArray
    foot: FloatArray
    rms: FloatArray
    largest: FloatArray
    worst: IntArray
    rounds: IntArray


@dataclass(frozen=True)
class _Task:
    points: FloatArray  # (B, m, 2) over l
    share: FloatArray  # (B, m) weights of the squared distances, sum 1
    weight: FloatArray  # (B, 2) q l^3
    reach: FloatArray  # (B,) half of the modelled wire, over l
    tail: FloatArray  # (B,)

    def pick(self, i: IntArray) -> "_Task":
        return _Task(self.points[i], self.share[i], self.weight[i], self.reach[i], self.tail[i])


def fit_curves(
    targets: FloatArray,
    length: FloatArray | None = None,
    weight: FloatArray | None = None,
    window: FloatArray | None = None,
    split: FloatArray | float = 0.5,
    tail_weight: FloatArray | float = TAIL_WEIGHT,
) -> CurveFit:
    """Fit to targets (B, m, 2) [m].

    length (B,): the wire's, at least the target's; without it the wire ends at the feet of the outer
    points. weight q (B, 2) [1/m^3]. window (B, m): weights >= 0 of the points. split: part of the free
    length that lies before the target. Raises ValueError for inputs that no wire can meet."""
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
    share = np.ones((batch, count)) if window is None else np.asarray(window, dtype=np.float64)
    total = share.sum(axis=1)
    if not ((share >= 0.0).all() and (total > 0.0).all()):
        raise ValueError("window: got weights below 0 or all 0; give at least some points a positive weight")
    sides = np.broadcast_to(np.asarray(split, dtype=np.float64), (batch,))
    if not ((sides >= 0.0).all() and (sides <= 1.0).all()):
        raise ValueError(
            "split: got a value outside [0, 1]; give the part of the free length before the target"
        )
    if length is None:
        reach = np.full(batch, 0.55)
    else:
        if not (length > size * (1.0 - 1e-3)).all():
            i = int(np.argmin(length / size))
            raise ValueError(
                f"length: wire {i} has {length[i]:.6f} m, allowed at least its target's {size[i]:.6f} m"
            )
        free = np.maximum(length / size - 1.0, 0.0)
        reach = 0.55 + np.maximum(sides, 1.0 - sides) * free * 1.02
    tail = np.broadcast_to(np.asarray(tail_weight, dtype=np.float64), (batch,)) * (
        0.0 if length is None else 1.0
    )
    task = _Task(
        targets / size[:, None, None],
        share / total[:, None],
        q * (size**3)[:, None],
        reach,
        np.ascontiguousarray(tail),
    )
    state, foot = first_guess(task.points, task.share, task.weight)
    state, foot, rounds = _search_all(task, state, foot, _SEARCH_ROUNDS)
    far = np.flatnonzero(~(_spread(task, state, foot) < _FAR_RMS))
    if far.size:
        again = task.pick(far)
        other, other_foot, turns = _grow(again)
        better = _spread(again, other, other_foot) < _spread(again, state[far], foot[far])
        state[far[better]], foot[far[better]] = other[better], other_foot[better]
        rounds[far] += turns
    return _finish(task, state, foot, size, length, sides, share > 0.0, rounds)


@dataclass(frozen=True)
class _Trial:
    theta: FloatArray  # on the flow's nodes
    foot: FloatArray
    residual: FloatArray  # (B, r)
    jacobian: FloatArray  # (B, r, 6)
    cost: FloatArray


def _feet(wire: Flow, task: _Task, foot: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Feet of the points (B, m), values x, y, theta, k there and the table that interpolates to them."""
    values = np.stack([wire.x, wire.y, wire.theta, wire.curvature], axis=-1)
    reach = task.reach[:, None]
    series = nodes(wire.count).series @ values
    for turn in range(2):
        table = legendre(foot / (2.0 * reach) + 0.5, wire.count)
        here = table @ series
        if turn == 1:
            break
        gap = task.points - here[..., :2]
        cos, sin = np.cos(here[..., 2]), np.sin(here[..., 2])
        along = gap[..., 0] * cos + gap[..., 1] * sin
        across = gap[..., 1] * cos - gap[..., 0] * sin
        bend = np.maximum(1.0 - here[..., 3] * across, 0.3)
        foot = np.clip(foot + np.clip(along / bend, -0.2, 0.2), -reach, reach)
    return foot, here, table


def _try(task: _Task, state: FloatArray, foot: FloatArray, theta: FloatArray | None, count: int) -> _Trial:
    wire = flow(state, 2.0 * task.reach, task.weight, 0.5, guess=theta, derivatives=True, count=count)
    foot, here, table = _feet(wire, task, foot)
    cos, sin = np.cos(here[..., 2]), np.sin(here[..., 2])
    gap = task.points - here[..., :2]
    root = np.sqrt(task.share)
    distance = root * (gap[..., 1] * cos - gap[..., 0] * sin)
    inner = nodes(count).series @ np.concatenate([wire.d_x, wire.d_y], axis=-1)
    d = table @ inner
    slope = np.empty((*distance.shape, 6))
    slope[..., 0] = root * sin
    slope[..., 1] = -root * cos
    slope[..., 2:] = root[..., None] * (sin[..., None] * d[..., :4] - cos[..., None] * d[..., 4:])

    batch = state.shape[0]
    middle = 0.5 * (
        task.points[:, (task.points.shape[1] - 1) // 2] + task.points[:, task.points.shape[1] // 2]
    )
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    pin = ((middle[:, 0] - state[:, 0]) * c + (middle[:, 1] - state[:, 1]) * s)[:, None]
    pin_slope = np.zeros((batch, 1, 6))
    pin_slope[:, 0, 0], pin_slope[:, 0, 1] = -c, -s

    grid = nodes(count)
    place = 2.0 * task.reach[:, None] * (grid.sigma - 0.5)
    price = task.tail[:, None] * np.sqrt(2.0 * task.reach[:, None] * grid.weight) * (np.abs(place) > 0.5)
    tail_slope = np.zeros((batch, count, 6))
    tail_slope[..., 2:] = price[..., None] * wire.d_curvature
    residual = np.concatenate([distance, pin, price * wire.curvature], axis=1)
    jacobian = np.concatenate([slope, pin_slope, tail_slope], axis=1)
    cost = np.sum(residual**2, axis=1)
    cost = np.where(np.isfinite(cost), cost, np.inf)
    return _Trial(wire.theta, foot, residual, jacobian, cost)


def _spread(task: _Task, state: FloatArray, foot: FloatArray) -> FloatArray:
    """Root mean square distance (B,) of the points, in target lengths."""
    wire = flow(state, 2.0 * task.reach, task.weight, 0.5, count=_most(task, state))
    _, here, _ = _feet(wire, task, foot)
    gap = np.sum((task.points - here[..., :2]) ** 2, axis=2)
    return np.asarray(np.sqrt(np.sum(task.share * gap, axis=1)))


def _grow(task: _Task) -> tuple[FloatArray, FloatArray, IntArray]:
    """Fit the middle of the target first and then more and more of it: for curves with many waves, where
    the errors of the first guess have grown too large at the ends."""
    _, place = first_guess(task.points, task.share, task.weight)
    state = foot = np.empty(0)
    rounds = np.zeros(task.reach.size, dtype=np.int64)
    for part in (0.4, 0.6, 0.8, 1.0):
        near = np.abs(place) <= 0.5 * part + 1e-12
        share = task.share * np.where(near, 1.0, 1e-9)
        share /= share.sum(axis=1, keepdims=True)
        stage = replace(task, share=share)
        if part == 0.4:
            state, _ = first_guess(stage.points, stage.share, stage.weight)
        state, foot, turns = _search_all(
            stage, state, place, _SEARCH_ROUNDS if part == 1.0 else _STAGE_ROUNDS
        )
        rounds += turns
    return state, foot, rounds


def _need(task: _Task, state: FloatArray) -> IntArray:
    return node_counts(state, 2.0 * task.reach, task.weight, base=14.0, per_wave=3.6)


def _most(task: _Task, state: FloatArray) -> int:
    return int(np.max(_need(task, state)))


def _search_all(
    task: _Task, state: FloatArray, foot: FloatArray, limit: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """The search with as many nodes as each wire needs; wires that grow more waves are searched on with
    more nodes."""
    state, foot = state.copy(), foot.copy()
    used = np.zeros(state.shape[0], dtype=np.int64)
    rounds = np.zeros(state.shape[0], dtype=np.int64)
    while True:
        need = _need(task, state)
        open_rows = np.flatnonzero(need > used)
        if open_rows.size == 0:
            return state, foot, rounds
        count = int(need[open_rows].min())
        rows = open_rows[need[open_rows] == count]
        state[rows], foot[rows], turns = _search(task.pick(rows), state[rows], foot[rows], count, limit)
        used[rows] = count
        rounds[rows] += turns


def _search(
    task: _Task, state: FloatArray, foot: FloatArray, count: int, limit: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Levenberg-Marquardt on all items that still move; returns states, feet and the rounds of each."""
    state, foot = state.copy(), foot.copy()
    now = _try(task, state, foot, None, count)
    theta, foot, residual, jacobian, cost = now.theta, now.foot, now.residual, now.jacobian, now.cost
    damp = np.full(state.shape[0], 1e-6)
    rounds = np.zeros(state.shape[0], dtype=np.int64)
    active = np.arange(state.shape[0])
    for _ in range(limit):
        if active.size == 0:
            break
        i = active
        rounds[i] += 1
        j = jacobian[i]
        normal = np.swapaxes(j, 1, 2) @ j
        slope = (np.swapaxes(j, 1, 2) @ residual[i][..., None])[..., 0]
        scale = np.einsum("bii->bi", normal)
        normal += np.eye(6) * (damp[i, None] * scale + 1e-14 * scale.max(axis=1, keepdims=True))[:, None, :]
        step = -np.linalg.solve(normal, slope[..., None])[..., 0]
        trial = _try(task.pick(i), state[i] + step, foot[i], theta[i], count)
        better = trial.cost <= cost[i]
        fall = (cost[i] - trial.cost) / np.maximum(cost[i], 1e-300)
        small = np.abs(step).max(axis=1) < 1e-11
        g = i[better]
        state[g] += step[better]
        theta[g], foot[g], residual[g] = trial.theta[better], trial.foot[better], trial.residual[better]
        jacobian[g], cost[g] = trial.jacobian[better], trial.cost[better]
        damp[i] = np.where(better, np.maximum(damp[i] * 0.1, 1e-12), np.maximum(damp[i] * 8.0, 1e-6))
        done = (better & (fall < _SETTLED)) | small | (cost[i] < 1e-24) | (damp[i] > 1e8)
        active = i[~done]
    return state, foot, rounds


def _finish(
    task: _Task,
    state: FloatArray,
    foot: FloatArray,
    size: FloatArray,
    length: FloatArray | None,
    split: FloatArray,
    counts: BoolArray,
    rounds: IntArray,
) -> CurveFit:
    wire = flow(state, 2.0 * task.reach, task.weight, 0.5, count=_most(task, state))
    for _ in range(2):
        foot, here, _ = _feet(wire, task, foot)
    first, last = foot[:, 0], foot[:, -1]
    long = last - first if length is None else length / size
    begin = first - split * (long - (last - first)) if length is not None else first
    sigma = (begin + 0.5 * long) / (2.0 * task.reach) + 0.5
    middle = wire.at(sigma[:, None])[:, 0]
    unit = np.stack([size, size, np.ones_like(size), 1.0 / size, size**-2, size**-2], axis=1)
    gap = task.points - here[..., :2]
    residual = (gap[..., 1] * np.cos(here[..., 2]) - gap[..., 0] * np.sin(here[..., 2])) * size[:, None]
    away = np.hypot(gap[..., 0], gap[..., 1]) * size[:, None] * counts
    rms = np.sqrt(np.sum(away**2, axis=1) / counts.sum(axis=1))
    return CurveFit(
        middle * unit,
        long * size,
        residual,
        (foot - begin[:, None]) * size[:, None],
        rms,
        away.max(axis=1),
        np.argmax(away, axis=1).astype(np.int64),
        rounds,
    )
