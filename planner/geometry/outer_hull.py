"""A convex solid with few corners around points: parts with many facets are held apart by it."""

from __future__ import annotations

from typing import Final

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import HalfspaceIntersection

from planner.geometry.mesh import TriangleMesh

FloatArray = NDArray[np.float64]

RINGS: Final = ((0.0, 24), (30.0, 16), (60.0, 8))
"""Elevations [deg] above and below the x-y plane, and how many planes each has around."""
SIMPLE: Final = 80
"""A hull with so few corners is taken as it is."""


def outer_hull(points: FloatArray) -> TriangleMesh:
    """A convex polyhedron that holds points (P, 3) [m]: their hull, or where that has many corners the solid
    between the planes of fixed directions that touch it, which stands out of it by about 2 % of its size.

    Raises ``ValueError`` for points in one plane.
    """
    try:
        hull = trimesh.convex.convex_hull(points)
    except Exception as error:  # qhull tells flat points by an error of its own
        raise ValueError("the points lie in one plane, and no solid holds them tightly") from error
    if len(hull.vertices) <= SIMPLE:
        return TriangleMesh(np.asarray(hull.vertices), np.asarray(hull.faces, dtype=np.int64))
    ways = _directions()
    corners = np.asarray(hull.vertices, dtype=np.float64)
    middle = corners.mean(axis=0)
    reach = (corners @ ways.T).max(axis=0)
    found = HalfspaceIntersection(np.column_stack([ways, -reach]), middle).intersections
    around = trimesh.convex.convex_hull(found)
    return TriangleMesh(np.asarray(around.vertices), np.asarray(around.faces, dtype=np.int64))


def _directions() -> FloatArray:
    """Unit vectors (K, 3) all around, among them the six axes."""
    out = [np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])]
    for degrees, count in RINGS:
        turn = 2.0 * np.pi * np.arange(count) / count
        for sign in (1.0, -1.0) if degrees else (1.0,):
            up = sign * np.deg2rad(degrees)
            flat = np.cos(up) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            out.append(np.column_stack([flat, np.full(count, np.sin(up))]))
    return np.concatenate(out)
