"""Sharp edges of a tool against a face: where they go in they are narrow, and are looked for more closely
than what is round."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.claims_milling import SparesPart
from planner.geometry.closest import small_pieces
from planner.geometry.vectors import lengths
from planner.verify.mill_body import SIGHT, Solid
from planner.verify.mill_track import FINEST, MOST

FloatArray = NDArray[np.float64]

SLICE = 5e-3
"""How long slices of a tool at its edges are [m]: what goes in by more than half of that is seen without."""
RIM_STEP = 2.0
"""Way between places over the tolerance: an edge at 45 degrees that goes in by the tolerance is so wide, and
leaves stairs half as deep as the step between two places."""
LEAST_STEP = 0.1e-3
"""The same at least [m]."""
COARSE = 4e-3
"""Size of pieces [m] of which those far from the edge are left out."""


def rim_step(tolerance: float) -> float:
    """Way between places [m] at which edges are looked at."""
    return max(RIM_STEP * tolerance, LEAST_STEP)


def edges(pieces: tuple[Solid, ...]) -> tuple[Solid, ...]:
    """Slices of a tool's pieces at their sharp edges: at the front where a piece is wider than what is before
    it, and behind where it is wider than what follows."""
    out: list[Solid] = []
    for k, own in enumerate(pieces):
        before = pieces[k - 1].radius if k else 0.0
        behind = pieces[k + 1].radius if k + 1 < len(pieces) else 0.0
        if own.corner == 0.0 and own.radius > before:
            out.append(dataclasses.replace(own, end=min(own.end, own.start + SLICE)))
        if own.radius > behind:
            out.append(dataclasses.replace(own, start=max(own.start, own.end - SLICE), corner=0.0))
    return tuple(out)


def rim_places(claim: SparesPart, edge: Solid, tip: FloatArray, axis: FloatArray) -> FloatArray:
    """Places (P, 3) of a face near an edge on its way ``tip``, ``axis`` (M, 3), as near to one another as the
    edge is wide where it goes in by the tolerance; one vertex where none is near."""
    stride = max(int(COARSE / rim_step(claim.tolerance)), 1)
    some = np.append(np.arange(0, len(tip), stride), len(tip) - 1)
    centre = cKDTree(tip[some] + 0.5 * (edge.start + edge.end) * axis[some])
    reach = float(np.hypot(edge.radius, 0.5 * (edge.end - edge.start))) + SIGHT + COARSE
    near = _near(claim.vertices[claim.faces], centre, reach)
    if len(near):
        near = _near(small_pieces(near, COARSE, MOST)[0], centre, reach)
    if not len(near):
        return claim.vertices[:1]
    pieces, _ = small_pieces(near, max(RIM_STEP * claim.tolerance, FINEST), MOST)
    return np.asarray(pieces.mean(axis=1))


def _near(corners: FloatArray, centre: cKDTree, reach: float) -> FloatArray:
    """The triangles (T, 3, 3) that may come within ``reach`` [m] of some centre."""
    middle = corners.mean(axis=1)
    size = lengths(corners - middle[:, None]).max(axis=1)
    away, _ = centre.query(middle, distance_upper_bound=reach + float(size.max()))
    return np.asarray(corners[away - size <= reach])
