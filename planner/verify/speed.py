"""Speeds of a wire across itself, from its shapes at stations and the replay's clock; segments' stations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MELTED = 1e-3
"""[m] heat reaches ahead of the wire, to its sides and behind it by about half a slot: what the wire does on
less of its way either way is melted together, so that a slot cannot grow wide and narrow again within it."""
_STILL = 1e-12
"""[m] least way between stations: a wire that stands takes time and goes nowhere."""


def steps_across(points: FloatArray) -> FloatArray:
    """Ways (T - 1, P) [m] of the points (T, P, 3) of a wire across it, from one station to the next."""
    way = np.diff(points, axis=0)
    along = np.gradient(points[:-1] + points[1:], axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    return np.asarray(np.linalg.norm(way - (way * along).sum(axis=2, keepdims=True) * along, axis=2))


def local(points: FloatArray, time: FloatArray, inside: BoolArray) -> FloatArray:
    """Speed (T, P) [m/s] across the wire of its points (T, P, 3) at each of the times (T,): the way over the
    time, from the station before to the one behind, or from farther off, until the fastest point ``inside``
    (T, P) the foam, or in the air of all, has moved ``MELTED`` either way; at the ends what there is.
    """
    if len(points) < 2:
        return np.zeros(points.shape[:2])
    step = steps_across(points)
    both = inside[1:] & inside[:-1]
    lead = np.where(both | ~both.any(axis=1, keepdims=True), step, 0.0).max(axis=1)
    gone = np.concatenate([[0.0], np.cumsum(np.maximum(lead, _STILL))])
    way = np.concatenate([np.zeros((1, points.shape[1])), np.cumsum(step, axis=0)])
    low = np.minimum(np.concatenate([gone[:1], gone[:-1]]), gone - MELTED).clip(gone[0])
    high = np.maximum(np.concatenate([gone[1:], gone[-1:]]), gone + MELTED).clip(None, gone[-1])
    span = np.interp(high, gone, time) - np.interp(low, gone, time)
    return np.asarray((_at(high, gone, way) - _at(low, gone, way)) / np.maximum(span, 1e-9)[:, None])


def _at(wanted: FloatArray, places: FloatArray, rows: FloatArray) -> FloatArray:
    """Rows (K, P) at ``wanted`` (K,) of the ascending ``places`` (T,) of ``rows`` (T, P)."""
    k = np.clip(np.searchsorted(places, wanted) - 1, 0, len(places) - 2)
    share = (wanted - places[k]) / (places[k + 1] - places[k])
    return np.asarray(rows[k] + share[:, None] * (rows[k + 1] - rows[k]))


def during(chosen: BoolArray) -> BoolArray:
    """Chosen stations and the one before each run of them, where the segment begins."""
    out = chosen.copy()
    out[:-1] |= chosen[1:]
    return out
