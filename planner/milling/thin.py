"""Few targets: rows of a path between which straight moves stay within a chord of it; more on long moves."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.vectors import dots
from planner.units import DEG

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEAN: Final = 6.0 * DEG
"""Longest turn of an axis between targets: a tool that spins as well takes its axis off the shortest turn, by
a quarter where moves are half as long."""


def thinned(points: FloatArray, chord: float, step: float) -> IntArray:
    """Rows (K,) of ``points`` (N, P, 3) [m], P points of a tool, such that moves between them that are
    straight for each point leave no row by more than ``chord`` [m], nor go farther than ``step`` [m] where
    rows are nearer than that; both ends are kept."""
    count = len(points)
    way = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1, initial=0.0)
    along = np.concatenate([[0.0], np.cumsum(way)])
    kept = [0]
    while kept[-1] < count - 1:
        start = kept[-1]
        far = int(np.searchsorted(along, along[start] + step * (1.0 + 1e-9), side="right")) - 1
        stop = min(max(far, start + 1), count - 1)
        while stop > start + 1 and _off(points[start : stop + 1], along[start : stop + 1]) > chord:
            stop = start + max((stop - start) * 3 // 4, 1)
        kept.append(stop)
    return np.array(kept, dtype=np.int64)


def filled(tip: FloatArray, axis: FloatArray, step: float) -> tuple[IntArray, FloatArray, FloatArray]:
    """Tips and axes (M, 3) with evenly laid places between those of ``tip``, ``axis`` (N, 3) that are farther
    apart than ``step`` [m] or :data:`LEAN`, and the row (M,) that each of them leads to. Axes turn evenly,
    the shorter way.
    """
    way = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    lean = np.linalg.norm(np.diff(axis, axis=0), axis=1)
    count = np.maximum(np.ceil(np.maximum(way / step, lean / LEAN) - 1e-9).astype(np.int64), 1)
    to = np.repeat(np.arange(1, len(tip)), count)
    share = (np.arange(len(to)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[to - 1]
    return _placed(tip, axis, to, share)


def parted(
    tip: FloatArray, axis: FloatArray, change: NDArray[np.bool_], near: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """As :func:`filled`, with places ``near`` [m] before and behind those of ``change`` (N,), or half-way
    where the way is short; none on ways that are not much longer than that.

    Speeds change over half of the shorter move at a place: so they do within ``near`` of these places.
    """
    way = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    first, last, long = change[:-1], change[1:], way > 1.5 * near
    short = first & last & (way < 2.5 * near)
    part = near / np.maximum(way, 1e-9)
    early, late = np.where(short, 0.5, part), 1.0 - part
    shares = np.stack([np.where(long & first, early, 1.0), np.where(long & last & ~short, late, 1.0)], axis=1)
    shares = np.concatenate([shares, np.ones((len(way), 1))], axis=1)
    kept = np.concatenate([shares[:, :2] < 1.0, np.ones((len(way), 1), dtype=bool)], axis=1)
    to = np.repeat(np.arange(1, len(tip)), kept.sum(axis=1))
    return _placed(tip, axis, to, shares[kept])


def _placed(
    tip: FloatArray, axis: FloatArray, to: IntArray, share: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Places at ``share`` (M - 1,) of the moves to rows ``to`` (M - 1,), behind the first place."""
    between = np.flatnonzero(share < 1.0)
    tips, axes = tip[to], axis[to]
    end, part = to[between], share[between, None]
    before, after = axis[end - 1], axis[end]
    tips[between] = tip[end - 1] + part * (tip[end] - tip[end - 1])
    # the part of the later axis that is square to the earlier one, and the angle from the one to the other
    square = after - dots(before, after)[:, None] * before
    size = np.linalg.norm(square, axis=1, keepdims=True)
    turn = np.arctan2(size, dots(before, after)[:, None])
    square = square / np.maximum(size, 1e-15)
    axes[between] = np.cos(part * turn) * before + np.sin(part * turn) * square
    return np.append(0, to), np.concatenate([tip[:1], tips]), np.concatenate([axis[:1], axes])


def _off(rows: FloatArray, along: FloatArray) -> float:
    """How far [m] rows (K, P, 3) are off the straight move from the first to the last of them, on which all
    points of the tool are as far on their ways at a time."""
    start, way = rows[0], rows[-1] - rows[0]
    rest = rows - start
    square = max(float((way * way).sum()), 1e-18)
    share = np.clip((rest * way).sum(axis=(1, 2)) / square, 0.0, 1.0)
    return float(np.linalg.norm(rest - share[:, None, None] * way, axis=2).max())
