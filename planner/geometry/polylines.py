"""Polylines: sharp corners, and thinning within a tolerance."""

from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.units import DEG


def thin_rows(points: FloatArray, chord: float, step: float) -> IntArray:
    """Select poses of a tool so that straight moves between them keep a chord error.

    The first and the last pose are kept.

    Args:
        points: P points of the tool at each pose (N, P, 3) [m].
        chord: Maximum distance of left-out poses from the straight moves, for each point [m].
        step: Maximum length of a move [m], unless poses are farther apart.

    Returns:
        Indices of the selected poses (K,).
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


def _chord_error(poses: FloatArray, along: FloatArray) -> float:
    """Return the largest distance [m] of poses (K, P, 3) from the straight move between both ends.

    All points of the tool have the same fraction of their paths at a time.
    """
    start, chord = poses[0], poses[-1] - poses[0]
    offsets = poses - start
    square = max(float((chord * chord).sum()), 1e-18)
    fraction = np.clip((offsets * chord).sum(axis=(1, 2)) / square, 0.0, 1.0)
    return float(np.linalg.norm(offsets - fraction[:, None, None] * chord, axis=2).max())


SHARP_ANGLE_RAD: Final = 31.0 * DEG
"""Angle of a path [rad] above which the tool stops."""
MIN_MOVE_M: Final = 1e-6
"""Moves shorter than this [m] have no direction."""


def stop_flags(tip: FloatArray) -> BoolArray:
    """Return whether a tool stops at each point (N,): at both ends, sharp corners, and rotations in place.

    Args:
        tip: Positions of the tip (N, 3) [m].
    """
    stops = np.zeros(len(tip), dtype=bool)
    stops[[0, -1]] = True
    step = np.diff(tip, axis=0)
    length = np.linalg.norm(step, axis=1)
    moves = np.flatnonzero(length > MIN_MOVE_M)
    if len(moves) > 1:
        direction = step[moves] / length[moves, None]
        cosine = dots(direction[1:], direction[:-1])
        stops[moves[1:][cosine < np.cos(SHARP_ANGLE_RAD)]] = True
    moving = length > MIN_MOVE_M
    stops[1:-1] |= moving[1:] != moving[:-1]  # before and after rotations in place
    return stops
