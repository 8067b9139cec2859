"""How far the curve of a spline block may be off straight moves, as the writer of blocks counts it.

docs/krl.md says which curves are meant; the proof has its own count (``verify/spline_curve.py``), which
blocks are written to hold. Slopes and curvatures of a move are counted in its own length.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import from_quaternion, log_rotation

FloatArray = NDArray[np.float64]
_Terms = tuple[FloatArray, FloatArray, FloatArray]

LEVER: Final = 100.0
"""What a turn counts as [mm/rad]."""
TURN: Final = 0.1
"""Most that a move of a block may turn [rad]."""
_OUTER: Final = 0.125
_BENDS: Final = 2.0
_ENDS: Final = 0.5
_U: Final = np.linspace(0.0, 1.0, 129)
_HERMITE: Final = np.array(
    [[0, 1, 0, -6, 8, -3], [0, 0, 0, -4, 7, -3], [0, 0, 0.5, -1.5, 1.5, -0.5], [0, 0, 0, 0.5, -1, 0.5]]
)
"""Coefficients of what slopes and curvatures at the two ends of a move add to it."""
_POWERS: Final = _U ** np.arange(6)[:, None]
_VALUE: Final = _HERMITE @ _POWERS
_RATE: Final = (_HERMITE[:, 1:] * np.arange(1, 6)) @ _POWERS[:5]
_MORE: Final = 1.004
"""What is between grid points, and a little: what is written is to hold."""


class Curve(NamedTuple):
    """Of M moves of a block, for all curves that are meant: ``off`` (M,) [mm, turns by LEVER] the straight
    way, ``way`` (M,) [mm] and ``turn`` (M,) [rad] alone of it, and ``speed`` (M,) [mm/s] of the TCP."""

    off: FloatArray
    way: FloatArray
    turn: FloatArray
    speed: FloatArray


def curve(position: FloatArray, quaternion: FloatArray, duration: FloatArray) -> Curve:
    """Of a block through positions (M + 1, 3) [mm] and quaternions (M + 1, 4), of moves that take
    ``duration`` (M,) [s]."""
    off, way_, turned, speed = np.empty((4, len(duration)))
    rotation = from_quaternion(quaternion)
    last = len(duration)
    for i in range(last):
        ends = np.clip(np.arange(i - 2, i + 4), 0, last)
        turn = log_rotation(rotation[i].T @ rotation[ends])
        step = np.diff(np.concatenate([position[ends], LEVER * turn], axis=1), axis=0)
        there = (np.arange(i - 2, i + 3) >= 0) & (np.arange(i - 2, i + 3) < last)
        took = np.ones(5)
        took[there] = duration[np.arange(i - 2, i + 3)[there]] / duration[i]
        long = np.linalg.norm(step, axis=1)
        way = np.where(there, long / max(long[2], 1e-12), 1.0)
        gaps = np.stack([np.ones(5), np.maximum(way, 1e-9)])
        open_ends = [k for k in (0, 1) if not there[1 + 2 * k]]
        rests = [[], *([k] for k in open_ends), open_ends]
        for some, out in ((slice(0, 6), off), (slice(0, 3), way_), (slice(3, 6), turned)):
            wide = _terms(step, 1.0 / gaps.max(axis=0), 1.0 / gaps.min(axis=0), there, some)
            out[i] = max(_off(*_resting(wide, ends), step, some) for ends in rests)
        if np.linalg.norm(turn[3] - turn[2]) > TURN and there.sum() > 1:
            off[i] = np.inf
        tcp = step[:, :3]
        terms = _resting(_terms(tcp, 1.0 / took, 1.0 / took, there), open_ends)
        speed[i] = _rate(*terms, float(np.linalg.norm(tcp[2]))) / duration[i]
    return Curve(off, way_, turned / LEVER, speed)


def _terms(
    step: FloatArray,
    least: FloatArray,
    most: FloatArray,
    there: NDArray[np.bool_],
    some: slice = slice(None),
) -> _Terms:
    """The largest parts (4,) across the middle one of five steps (5, D), and the least and largest along it
    in its own length, of both ends' slopes, less the move's own, and curvatures; across in the numbers
    ``some`` of D."""
    size = float(np.linalg.norm(step[2]))
    way = step[2] / max(size, 1e-12)
    along = step @ way
    side = (step - along[:, None] * way)[:, some]
    share = along / max(size, 1e-12)
    corners = np.stack([least, most])
    apart = (most * np.linalg.norm(side, axis=1)).tolist()
    lean = np.sort(corners * share, axis=0)
    bend, push, whole = np.zeros(4), np.zeros(4), np.zeros(4)
    for k in np.flatnonzero(there[1:] & there[:-1]).tolist():
        pairs = [(a, b) for a in corners[:, k] for b in corners[:, k + 1]]
        bend[k] = max(float(np.linalg.norm(b * side[k + 1] - a * side[k])) for a, b in pairs)
        push[k] = max(abs(b * share[k + 1] - a * share[k]) for a, b in pairs)
        whole[k] = 2.0 / (1.0 / most[k] + 1.0 / most[k + 1])
    across, low, high = [], [], []
    for k in (1, 2):
        weight = np.array([_OUTER if there[k + 1] else _ENDS, _OUTER if there[k] else _ENDS])
        slack = float(weight @ push[[k - 1, k + 1]])
        across.append(max(apart[k], apart[k + 1]) + float(weight @ bend[[k - 1, k + 1]]))
        beside = [j for j in (k, k + 1) if there[j]]
        low.append(lean[0, beside].min() - slack - 1.0)
        high.append(lean[1, beside].max() + slack - 1.0)
    for k in (0, 1):
        bends = _BENDS if there[1 + 2 * k] else 1.0
        across.append(bends * float((whole * bend)[k : k + 3].max()))
        high.append(bends * float((whole * push)[k : k + 3].max()))
        low.append(-high[-1])
    return np.array(across), np.array(low), np.array(high)


def _resting(terms: _Terms, ends: list[int]) -> _Terms:
    """The same where the arm stands, at the first (0) or last (1) end of the move."""
    across, low, high = (value.copy() for value in terms)
    for k in ends:
        across[[k, k + 2]] = 0.0
        low[[k, k + 2]] = high[[k, k + 2]] = [-1.0, 0.0]
    return across, low, high


def _off(across: FloatArray, low: FloatArray, high: FloatArray, step: FloatArray, some: slice) -> float:
    """How far [mm] off the straight ways, of five steps (5, D), a curve of the middle one may be."""
    up, down = np.maximum(_VALUE, 0.0), np.minimum(_VALUE, 0.0)
    over = float((_U + high @ up + low @ down - 1.0).max())
    under = float((-_U - low @ up - high @ down).max())
    between = float(np.maximum(np.abs(low), np.abs(high)) @ [4.0, 4.0, 1.0, 1.0]) * _U[1] ** 2 / 8.0
    long = np.linalg.norm(step, axis=1)
    unit = step / np.maximum(long, 1e-12)[:, None]
    off = 0.0
    for k, past in ((1, under), (3, over)):
        beyond = (max(past, 0.0) + between) * long[2]
        lies = unit[2] - unit[k] if beyond <= long[k] else unit[2]
        off = max(off, beyond * float(np.linalg.norm(lies[some])))
    return off + float(_MORE * (across @ np.abs(_VALUE)).max())


def _rate(across: FloatArray, low: FloatArray, high: FloatArray, size: float) -> float:
    """How much way [mm] a move may go at its fastest in its own time."""
    up, down = np.maximum(_RATE, 0.0), np.minimum(_RATE, 0.0)
    fast = np.maximum(np.abs(1.0 + high @ up + low @ down), np.abs(1.0 + low @ up + high @ down)) * size
    return _MORE * float(np.hypot(fast, across @ np.abs(_RATE)).max())
