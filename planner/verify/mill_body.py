"""A milling tool as solids of revolution, as the proof sees it: how far points are off it along a track."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.geometry.round_body import Round
from planner.geometry.swept import least
from planner.tooling import Cutter

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIGHT = 3e-3
"""Points farther off than this [m] are not told apart."""


@dataclasses.dataclass(frozen=True)
class Solid:
    """One piece of a tool: a cylinder of ``radius`` [m] from ``start`` to ``end`` [m] behind the tip, the
    edge of its front rounded by ``corner`` [m]; ``name`` as a person calls it."""

    name: str
    start: float
    end: float
    radius: float
    corner: float = 0.0


def solids(cutter: Cutter) -> tuple[Solid, ...]:
    """Cutting part, shank, and the pieces of holder and spindle."""
    out = [Solid("cutter", 0.0, cutter.flute, cutter.radius, cutter.corner)]
    if cutter.overhang > cutter.flute:
        out.append(Solid("shank", cutter.flute, cutter.overhang, cutter.shank))
    count = len(cutter.behind) // 2
    for k in range(count):
        a, b = cutter.behind[2 * k], cutter.behind[2 * k + 1]
        name = "spindle" if k == count - 1 else "holder"
        out.append(Solid(name, float(a[0]), float(b[0]), float(a[1])))
    return tuple(out)


def signed(solid: Solid, back: FloatArray, beside: FloatArray) -> FloatArray:
    """Distance [m] of points ``back`` behind the tip and ``beside`` the axis from a solid, below zero inside,
    in the shape of both: that from its half section, a rectangle, and where one of its corners is round, from
    the arc there."""
    aside = beside - solid.radius
    ends = np.maximum(solid.start - back, back - solid.end)
    out = np.maximum(aside, ends)
    edge = np.nonzero((aside > 0.0) & (ends > 0.0))
    out[edge] = np.hypot(aside[edge], ends[edge])
    if solid.corner > 0.0:
        before, over = solid.start + solid.corner - back, aside + solid.corner
        arc = np.nonzero((before > 0.0) & (over > 0.0))
        out[arc] = np.hypot(before[arc], over[arc]) - solid.corner
    return np.asarray(out)


def comes_near(vertices: FloatArray, tip: FloatArray, axis: FloatArray, solid: Solid) -> bool:
    """Whether a solid at places (M, 3) of a track may come within ``SIGHT`` of a face with ``vertices``
    (V, 3), by the boxes around both."""
    ends = np.concatenate([tip + solid.start * axis, tip + solid.end * axis])
    room = solid.radius + SIGHT
    apart = (ends.min(axis=0) - room > vertices.max(axis=0)) | (
        ends.max(axis=0) + room < vertices.min(axis=0)
    )
    return not bool(apart.any())


def sweep(
    points: FloatArray, tip: FloatArray, axis: FloatArray, solid: Solid, below: float = np.inf
) -> tuple[FloatArray, IntArray]:
    """Least distance (P,) [m] of points (P, 3) from a solid at any of the places (M, 3) of a track, below
    zero inside, and the index (P,) of that place; at most ``SIGHT`` is told. All places count. With ``below``
    [m] what is not less may be told too large, but for the least of all."""

    def distance(back: FloatArray, beside: FloatArray) -> FloatArray:
        return signed(solid, back, beside)

    body = Round(solid.start, solid.end, solid.radius, distance, solid.corner == 0.0)
    return least(points, tip, axis, body, SIGHT, below)
