"""Few targets: rows of a path between which straight moves stay within a chord of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
    """How far [m] rows (K, P, 3) are off the straight moves from the first to the last of them."""
    start, way = rows[0], rows[-1] - rows[0]
    rest = rows - start
    square = np.maximum((way * way).sum(axis=1), 1e-18)
    share = np.clip((rest * way).sum(axis=2) / square, 0.0, 1.0)
    return float(np.linalg.norm(rest - share[..., None] * way, axis=2).max())
