"""How a controller runs through a row of straight moves: which piece of the path at which time.

Model. Each move takes its programmed time at constant speed; a corner inside a zone is rounded by the cubic
that joins the two straight pieces with equal speeds on both sides, which is the quadratic Bezier curve of
the corner when the speeds are constant; moves from and to a stop follow a cubic ramp that ends with the
speed of the neighbouring move. The zone bounds how far from the corner the rounding starts, and it never
starts before the middle of a move. Both arms of a synchronised pair round over the same time. A real
controller has its own filters: within a zone it may be off by a part of the rounding, which for dense
targets is micrometres; outside zones the path is the straight line, as the manual says.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class TimeLaw:
    """``times`` (N + 1,) [s] of the nodes, ``rate_in``, ``rate_out`` (N,) end speeds of the moves' progress
    in units of 1 / duration, ``window`` (N + 1,) [s] half width of the rounding at each node, 0 at stops."""

    times: FloatArray
    rate_in: FloatArray
    rate_out: FloatArray
    window: FloatArray


def make(
    duration: FloatArray, length: FloatArray, stop: BoolArray, reach: FloatArray, room: FloatArray
) -> TimeLaw:
    """The law for N moves.

    ``duration`` (N,) [s]; ``length`` (N,) of the moves in any one measure, to match speeds at ramps;
    ``stop`` (N + 1,) at nodes; ``reach`` (N + 1, 2): the largest fraction of the move before and of the move
    after each node that the zone lets the rounding take; ``room`` (N + 1,) [s]: a half width that is allowed
    at each node whatever the zone.
    """
    count = len(duration)
    times = np.concatenate([[0.0], np.cumsum(duration)])
    speed = length / duration
    rate_in, rate_out = np.ones(count), np.ones(count)
    first, last = stop[:-1], stop[1:]
    ahead = np.concatenate([speed[1:], speed[-1:]]) / np.maximum(speed, 1e-12)
    behind = np.concatenate([speed[:1], speed[:-1]]) / np.maximum(speed, 1e-12)
    rate_in[first] = 0.0
    rate_out[last] = 0.0
    starts, ends = first & ~last, last & ~first
    rate_out[starts] = np.clip(ahead[starts], 1.0, 2.0)
    rate_in[ends] = np.clip(behind[ends], 1.0, 2.0)
    window = np.zeros(count + 1)
    inner = np.minimum(reach[1:-1, 0] * duration[:-1], reach[1:-1, 1] * duration[1:])
    inner = np.maximum(inner, room[1:-1])
    window[1:-1] = np.where(stop[1:-1], 0.0, np.minimum(inner, 0.5 * np.minimum(duration[:-1], duration[1:])))
    return TimeLaw(times, rate_in, rate_out, window)


def offsets(law: TimeLaw, delta: FloatArray, at: FloatArray) -> tuple[IntArray, FloatArray]:
    """Nodes (S,) and offsets (S, D) from them at times ``at`` (S,), for moves that step by ``delta`` (N,
    D)."""
    count = len(delta)
    move = np.clip(np.searchsorted(law.times, at, side="right") - 1, 0, count - 1)
    progress, _ = _progress(law, move, at - law.times[move])
    node = move + 1
    xi = (progress - 1.0)[:, None] * delta[move]
    nearest = np.where(law.times[node] - at < at - law.times[move], node, move)
    inside = np.abs(at - law.times[nearest]) < law.window[nearest]
    if np.any(inside):
        corner = nearest[inside]
        xi[inside] = _rounded(law, delta, corner, at[inside])
        node[inside] = corner
    return node, xi


def _rounded(law: TimeLaw, delta: FloatArray, corner: IntArray, at: FloatArray) -> FloatArray:
    half = law.window[corner]
    before, rate_before = _progress(law, corner - 1, law.times[corner] - half - law.times[corner - 1])
    after, rate_after = _progress(law, corner, half)
    a, b = (before - 1.0)[:, None] * delta[corner - 1], after[:, None] * delta[corner]
    va, vb = rate_before[:, None] * delta[corner - 1], rate_after[:, None] * delta[corner]
    span = 2.0 * half
    s = ((at - law.times[corner] + half) / span)[:, None]
    one = 1.0 - s
    span = span[:, None]
    return np.asarray(
        one * one * (1.0 + 2.0 * s) * a + s * s * (3.0 - 2.0 * s) * b + s * one * span * (one * va - s * vb)
    )


def _progress(law: TimeLaw, move: IntArray, elapsed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Progress 0..1 of moves and its rate [1/s]: the cubic with the moves' end rates."""
    duration = law.times[move + 1] - law.times[move]
    x = np.clip(elapsed / duration, 0.0, 1.0)
    a, b = law.rate_in[move], law.rate_out[move]
    c2, c3 = 3.0 - 2.0 * a - b, a + b - 2.0
    return x * (a + x * (c2 + x * c3)), (a + x * (2.0 * c2 + 3.0 * c3 * x)) / duration
