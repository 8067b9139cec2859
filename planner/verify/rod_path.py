"""What the shapes found say in the world: points, frames, curvature, twist, tension, margins of stability.

The discrete rod is of second order in h = L / N. The same shapes are found once more with half the
segments, and both results are combined (Richardson: (4 fine - coarse) / 3), which leaves errors of the
order h^4 and tells the size of the error that was taken out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from planner.verify.rod_energy import Array, Ends, joints, matrix, spacing
from planner.verify.rod_model import Drive, Rod, RodPath, RodShape, apart_many
from planner.verify.rod_solve import State, newton_many, weakest, weakest_many

_BATCH = 512  # instants at once, for bounded memory
_SAME = 0.2  # most by which the coarser rod's shape may differ from the finer one's [rad]


class _Measures(NamedTuple):
    """In the start frame and in units of the rod: `nodes` (3, N+1, T), `rate` (3, N+1, T), `tension` (N+1,
    T).
    """

    nodes: Array
    rate: Array
    tension: Array


def measured(
    rod: Rod, drive: Drive, state: State, good: NDArray[np.bool_], jump: NDArray[np.bool_], moved: Array
) -> RodPath:
    """The path of the shapes `state` at all instants of `drive`."""
    ends, length, count = drive.ends, rod.length, state.q.shape[2]
    parts, least, errors = [], [], []
    for at in range(0, count, _BATCH):
        some = slice(at, at + _BATCH)
        here, place = State(state.q[..., some], state.force[:, some]), ends.at(some)
        least.append(weakest_many(rod.stiffness, here, place))
        part, error = _refined(rod.stiffness, here, place)
        parts.append(part)
        errors.append(error)
    nodes, rate, tension = (np.concatenate(items, axis=-1) for items in zip(*parts, strict=True))
    eigenvalue = np.concatenate(least)
    for k in np.flatnonzero(~good):
        one = slice(k, k + 1)
        eigenvalue[k] = weakest(rod.stiffness, State(state.q[..., one], state.force[:, one]), ends.at(one))[0]
    frame = matrix(drive.q[0])
    last = matrix(state.q)[:, 0].mean(axis=1) - ends.place
    return RodPath(
        points=length * np.einsum("ijt,jkt->tki", frame, nodes) + drive.start[:, None, :3, 3],
        frames=np.einsum("ijt,jlkt->tkil", frame, matrix(_at_nodes(state.q, ends))),
        curvature=np.moveaxis(rate[1:], (0, 1, 2), (2, 1, 0)) / length,
        twist=rate[0].T / length,
        tension=tension.T * rod.soft / length**2,
        residual=length * np.sqrt((last * last).sum(axis=0)),
        error=length * np.concatenate(errors),
        stable=good,
        min_eig=eigenvalue / (4.0 * math.pi**2),
        jump=jump,
        moved=moved,
        shapes=tuple(RodShape(state.q[..., k], state.force[:, k]) for k in range(count)),
    )


def _refined(stiffness: Array, state: State, ends: Ends) -> tuple[_Measures, Array]:
    fine = _measures(state, ends)
    left, right = state.q[:, ::2], state.q[:, 1::2]
    half = left + np.where((left * right).sum(axis=0) < 0.0, -right, right)
    half /= np.sqrt((half * half).sum(axis=0))
    outcome = newton_many(stiffness, State(half, state.force), ends)
    same = outcome.good & outcome.steady & (apart_many(half, outcome.state.q) < _SAME)
    coarse = _measures(outcome.state, ends)
    n = state.q.shape[1]
    even, every = np.linspace(0.0, 1.0, n // 2 + 1), np.linspace(0.0, 1.0, n + 1)
    better = []
    for a, b in zip(fine, coarse, strict=True):
        change = np.where(same, (a[..., ::2, :] - b) / 3.0, 0.0)
        better.append(a + CubicSpline(even, change, axis=-2)(every))
    shift = better[0] - fine.nodes
    return _Measures(*better), np.where(same, np.sqrt((shift * shift).sum(axis=0)).max(axis=0), np.inf)


def _at_nodes(q: Array, ends: Ends) -> Array:
    """Attitudes (4, N + 1, T) at the points: the clamps' own, and half-way between neighbouring segments."""
    left, right = q[:, :-1], q[:, 1:]
    inner = left + np.where((left * right).sum(axis=0) < 0.0, -right, right)
    inner = inner / np.sqrt((inner * inner).sum(axis=0))
    start = np.zeros_like(q[:, :1])
    start[0] = 1.0
    return np.concatenate([start, inner, ends.turn[:, None]], axis=1)


def _measures(state: State, ends: Ends) -> _Measures:
    n = state.q.shape[1]
    steps = matrix(state.q)[:, 0] / n
    nodes = np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)
    p = joints(state.q, ends.turn)
    rate = p[1:] * ((8.0 - 2.0 * p[0]) / 3.0) / spacing(n)[:, None]
    # the outer joints belong to the clamps' half segments; a cubic through the inner ones is as smooth as
    # they are
    rate[:, 0] = 4.0 * rate[:, 1] - 6.0 * rate[:, 2] + 4.0 * rate[:, 3] - rate[:, 4]
    rate[:, -1] = 4.0 * rate[:, -2] - 6.0 * rate[:, -3] + 4.0 * rate[:, -4] - rate[:, -5]
    tangent = matrix(_at_nodes(state.q, ends))[:, 0]
    force = state.force[:, None] + ends.weight[:, None] * np.linspace(1.0, 0.0, n + 1)[:, None]
    return _Measures(nodes, rate, (tangent * force).sum(axis=0))
