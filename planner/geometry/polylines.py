"""Polylines: sharp corners, and fewer points within a tolerance."""

from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.units import DEG


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


def _off(rows: FloatArray, along: FloatArray) -> float:
    """How far [m] rows (K, P, 3) are off the straight move from the first to the last of them, on which all
    points of the tool are as far on their ways at a time."""
    start, way = rows[0], rows[-1] - rows[0]
    rest = rows - start
    square = max(float((way * way).sum()), 1e-18)
    share = np.clip((rest * way).sum(axis=(1, 2)) / square, 0.0, 1.0)
    return float(np.linalg.norm(rest - share[:, None, None] * way, axis=2).max())


SHARP_TURN: Final = 31.0 * DEG
"""The tool stops where its way turns by more than this [rad]."""
LEAST_MOVE: Final = 1e-6
"""Moves that are shorter than this [m] have no direction."""


def sharp(tip: FloatArray) -> BoolArray:
    """(N,) where a tool stops whatever its job: at both ends, at sharp corners, at turns in place."""
    out = np.zeros(len(tip), dtype=bool)
    out[[0, -1]] = True
    step = np.diff(tip, axis=0)
    length = np.linalg.norm(step, axis=1)
    long = np.flatnonzero(length > LEAST_MOVE)
    if len(long) > 1:
        way = step[long] / length[long, None]
        cosine = dots(way[1:], way[:-1])
        out[long[1:][cosine < np.cos(SHARP_TURN)]] = True
    moving = length > LEAST_MOVE
    out[1:-1] |= moving[1:] != moving[:-1]  # before and after turns in place
    return out
