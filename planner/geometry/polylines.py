"""Polylines: sharp corners, and thinning within a tolerance."""

from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.units import DEG


def thin_rows(points: FloatArray, chord: float, step: float) -> IntArray:
    """Select rows so that straight moves between them keep a chord error.

    Both ends are kept.

    Args:
        points: Rows (N, P, 3) [m] with P points of a tool each.
        chord: Maximum distance of left-out rows from the straight moves, for each point [m].
        step: Maximum length of a move [m], unless rows are farther apart.

    Returns:
        Indices of the rows (K,).
    """
    count = len(points)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1, initial=0.0)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    kept = [0]
    while kept[-1] < count - 1:
        start = kept[-1]
        last_reachable = int(np.searchsorted(along, along[start] + step * (1.0 + 1e-9), side="right")) - 1
        stop = min(max(last_reachable, start + 1), count - 1)
        while stop > start + 1 and _chord_error(points[start : stop + 1], along[start : stop + 1]) > chord:
            stop = start + max((stop - start) * 3 // 4, 1)
        kept.append(stop)
    return np.array(kept, dtype=np.int64)


def _chord_error(rows: FloatArray, along: FloatArray) -> float:
    """Return the distance [m] of rows (K, P, 3) from the straight move between both ends.

    All points of the tool have the same fraction of their paths at a time.
    """
    start, chord = rows[0], rows[-1] - rows[0]
    rest = rows - start
    square = max(float((chord * chord).sum()), 1e-18)
    fraction = np.clip((rest * chord).sum(axis=(1, 2)) / square, 0.0, 1.0)
    return float(np.linalg.norm(rest - fraction[:, None, None] * chord, axis=2).max())


SHARP_ANGLE_RAD: Final = 31.0 * DEG
"""Angle of a path [rad] above which the tool stops."""
MIN_MOVE_M: Final = 1e-6
"""Moves shorter than this [m] have no direction."""


def stop_flags(tip: FloatArray) -> BoolArray:
    """Return where a tool stops (N,) in any job: at both ends, at sharp corners, and at rotations in place.

    Args:
        tip: Positions of the tip (N, 3) [m].
    """
    out = np.zeros(len(tip), dtype=bool)
    out[[0, -1]] = True
    step = np.diff(tip, axis=0)
    length = np.linalg.norm(step, axis=1)
    long_rows = np.flatnonzero(length > MIN_MOVE_M)
    if len(long_rows) > 1:
        direction = step[long_rows] / length[long_rows, None]
        cosine = dots(direction[1:], direction[:-1])
        out[long_rows[1:][cosine < np.cos(SHARP_ANGLE_RAD)]] = True
    moving = length > MIN_MOVE_M
    out[1:-1] |= moving[1:] != moving[:-1]  # before and after rotations in place
    return out
