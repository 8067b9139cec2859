"""Places of faces at which tools are looked for: those near to a tool's way, as near to one another as what
is looked for is wide. Sharp edges are narrow where they go in, and are looked for more closely."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from planner.geometry.round_body import Round
from planner.geometry.swept import places_near
from planner.verify.mill_body import SIGHT, Solid, signed

FloatArray = NDArray[np.float64]

SLICE = 5e-3
"""How long slices of a tool at its edges are [m]: what goes in by more than half of that is seen without."""
RIM_STEP = 2.0
"""Way between places over the tolerance: an edge at 45 degrees that goes in by the tolerance is so wide, and
leaves stairs half as deep as the step between two places."""
LEAST_STEP = 0.1e-3
"""The same at least [m]."""
FINEST = 0.4e-3
"""Places of a face are no nearer to one another than this [m],"""
MOST = 4_000_000
"""and there are at most so many by one piece of a tool."""


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


def rim_size(tolerance: float) -> float:
    """How near [m] to one another places of a face are by an edge: as it is wide where it goes in by the
    tolerance."""
    return max(RIM_STEP * tolerance, FINEST)


def round_size(radius: float, tolerance: float) -> float:
    """The same for what is round, of ``radius`` [m]: between them it is in the face by half of the tolerance
    at most, s^2 / 6 r."""
    return max(float(np.sqrt(3.0 * radius * tolerance)), FINEST)


def near_places(
    corners: FloatArray, solid: Solid, tip: FloatArray, axis: FloatArray, size: float
) -> tuple[FloatArray, int]:
    """Places (P, 3) of triangles (T, 3, 3) within sight of a solid somewhere on its way ``tip``, ``axis``
    (M, 3), as near to one another as pieces of edges of ``size`` [m] are, and how many these are: above
    ``MOST`` that is too many, and there are none."""
    body = Round(solid.start, solid.end, solid.radius, functools.partial(signed, solid))
    places, _, count = places_near(corners, tip, axis, body, SIGHT, size, MOST)
    return places, count
