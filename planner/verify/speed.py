"""Speeds of a wire across itself, from its shapes at stations and the replay's clock; segments' stations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def steps_across(points: FloatArray) -> FloatArray:
    """Ways (T - 1, P) [m] of the points (T, P, 3) of a wire across it, from one station to the next."""
    way = np.diff(points, axis=0)
    along = np.gradient(points[:-1] + points[1:], axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    return np.asarray(np.linalg.norm(way - (way * along).sum(axis=2, keepdims=True) * along, axis=2))


def local(points: FloatArray, time: FloatArray) -> FloatArray:
    """Speed (T, P) [m/s] across the wire of its points (T, P, 3) at each of the times (T,): the way to the
    station and the way on over the time of both; at the ends of the one there is."""
    step, span = steps_across(points), np.diff(time)[:, None]
    way, during = np.zeros(points.shape[:2]), np.zeros((len(points), 1))
    way[1:] += step
    way[:-1] += step
    during[1:] += span
    during[:-1] += span
    return np.asarray(way / np.maximum(during, 1e-9))


def during(chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Chosen stations and the one before each run of them, where the segment begins."""
    out = chosen.copy()
    out[:-1] |= chosen[1:]
    return out
