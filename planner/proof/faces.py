"""Areas and normals of triangles, and subdivision of triangles."""

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.mesh import bisect_triangles
from planner.geometry.units import MM
from planner.issues import issue_error

MAX_PIECES = 4_000_000
"""Maximum number of pieces of a face that is examined completely."""


def triangle_areas(corners: FloatArray) -> FloatArray:
    """Return the areas (T,) [m^2] of triangles (T, 3, 3) [m]."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(cross, axis=1))


def vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return unit normals (V, 3) at a mesh's vertices: means of its triangles' normals, weighted by area."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], cross)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def quarter_triangles(corners: FloatArray) -> FloatArray:
    """Divide triangles (T, 3, 3) into four each, at the middles of the edges.

    Returns:
        Triangles (4 T, 3, 3): the three at the corners in turn, then those in the middle.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def subdivide(corners: FloatArray, size: float) -> tuple[FloatArray, IntArray]:
    """Divide triangles (T, 3, 3) into pieces without an edge longer than ``size`` [m].

    Returns:
        Pieces (P, 3, 3), and the index (P,) of the triangle of each piece.

    Raises:
        TandemError: There are too many pieces (``verify.duration``). A face that is examined only in parts
            proves nothing.
    """
    parts, owner = bisect_triangles(corners, size, MAX_PIECES)
    # One edge of all pieces at a time, because the pieces of a face take a lot of memory.
    edges = (parts[:, k] - parts[:, k - 1] for k in range(3))
    longest = max(float(np.linalg.norm(edge, axis=1).max(initial=0.0)) for edge in edges)
    if longest > size * (1.0 + 1e-9):
        message = f"a face has too many long, thin facets (over {MAX_PIECES} pieces of {size / MM:.2f} mm); "
        message += "export it with facets of even shape"
        raise issue_error("verify.duration", message, value=float(len(parts)), limit=float(MAX_PIECES))
    return parts, owner
