"""The kerf along a bent wire: where it moves slower its slot is wider, and half of that is the offset."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.claims import KerfCurve
from planner.hotwire.elastic_path import Face
from planner.hotwire.elastic_wires import box_distance

FloatArray = NDArray[np.float64]

PLACES = 160
"""Places along the sweep at which speeds along the wire are worked out."""


def is_constant(curve: KerfCurve) -> bool:
    """Whether the slot has one width at every speed."""
    return bool(np.ptp(curve.width) == 0.0)


def speed_shares(face: Face, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (P, S, 3) [m] of a face's wires over its sweep, and how fast (P, S) each moves across the wire,
    as a share of the fastest point inside the block ``box`` (2, 3); of the fastest of all outside."""
    p = np.linspace(face.family.lower, face.family.upper, PLACES)
    wires = face.wires(p)
    points = wires.points(wires.shapes())
    way = np.gradient(points, p, axis=0)
    along = np.gradient(points, axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    across = np.linalg.norm(way - np.sum(way * along, axis=2, keepdims=True) * along, axis=2)
    inside = box_distance(points, box) < 0.0
    inside |= ~inside.any(axis=1, keepdims=True)
    fastest = np.max(np.where(inside, across, 0.0), axis=1, keepdims=True)
    return points, across / np.maximum(fastest, 1e-12)


def widths(face: Face, vertices: FloatArray, curve: KerfCurve, feed: float, box: FloatArray) -> FloatArray:
    """Width (V,) [m] of the slot at the vertices (V, 3) of a face whose fastest point moves at ``feed``
    [m/s]."""
    points, share = speed_shares(face, box)
    distance, nearest = cKDTree(points.reshape(-1, 3)).query(vertices, k=4)
    weight = 1.0 / np.maximum(distance, 1e-9)
    local = np.sum(weight * share.reshape(-1)[nearest], axis=1) / weight.sum(axis=1)
    return curve.at(feed * local)
