"""Areas and normals of triangles, and triangles divided into smaller ones."""

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.mesh import small_pieces
from planner.geometry.units import MM
from planner.issues import refusal

MOST_PIECES = 4_000_000
"""Pieces of a face at most, where it has to be looked at all over."""


def areas(corners: FloatArray) -> FloatArray:
    """Areas (T,) [m^2] of triangles (T, 3, 3) [m]."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(cross, axis=1))


def vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals (V, 3) at the vertices of a mesh, weighted by area."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], cross)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def quarter_triangles(corners: FloatArray) -> FloatArray:
    """Four triangles of each, by the middles of its edges."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def divided(corners: FloatArray, size: float) -> tuple[FloatArray, IntArray]:
    """Triangles (T, 3, 3) in pieces (P, 3, 3) none of which has an edge longer than ``size`` [m], and the
    triangle (P,) of each. Raises ``TandemError`` where that is more than can be looked at: nothing is proven
    of a face that is looked at here and there."""
    parts, owner = small_pieces(corners, size, MOST_PIECES)
    # edge by edge: pieces of a face are a lot of memory
    edges = (parts[:, k] - parts[:, k - 1] for k in range(3))
    longest = max(float(np.linalg.norm(edge, axis=1).max(initial=0.0)) for edge in edges)
    if longest > size * (1.0 + 1e-9):
        what = (
            f"a face has so many long, thin facets that pieces of {size / MM:.2f} mm are over {MOST_PIECES}; "
        )
        what += "export it with facets of even shape"
        raise refusal("verify.duration", what, value=float(len(parts)), limit=float(MOST_PIECES))
    return parts, owner
