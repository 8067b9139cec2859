"""A face without the strip along its edge that a cut leaves out, as seen from above."""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.geometry.closest import small_pieces
from planner.geometry.edges import boundaries
from planner.geometry.mesh import TriangleMesh
from planner.problem import Mesh
from planner.units import MM

FloatArray = NDArray[np.float64]

FINE: Final = 0.5 * MM
"""Triangles across the strip's inner edge are parted until they are so small; those not all inside are left
out."""
MOST: Final = 400_000


def inner(front: Mesh, margin: float) -> shapely.Geometry:
    """What is farther than ``margin`` [m] inside the edge of the face ``front``, whose normals look up, in
    plan [m]; empty where nothing is."""
    rings = boundaries(TriangleMesh(front.vertices, front.faces))
    flat = [front.vertices[ring][:, :2] for ring in rings if len(ring) > 2]
    if not flat:
        return shapely.Polygon()
    whole = shapely.make_valid(shapely.Polygon(flat[0], flat[1:]))
    return shapely.buffer(whole, -margin, join_style="mitre")


def within(area: shapely.Geometry, xy: FloatArray) -> NDArray[np.bool_]:
    """Whether places (N, 2) [m] are in the area, seen from above."""
    shapely.prepare(area)
    return np.asarray(shapely.contains_xy(area, xy[:, 0], xy[:, 1]))


def clipped(front: Mesh, area: shapely.Geometry) -> Mesh:
    """The triangles of a face over the area, each with vertices of its own."""
    corners = front.vertices[front.faces]
    shapely.prepare(area)
    whole = _inside(area, corners)
    rest = corners[~whole]
    across = rest[shapely.intersects(area, shapely.polygons(rest[..., :2]))]
    parts = [corners[whole]]
    if len(across):
        pieces, _ = small_pieces(across, FINE, MOST)
        parts.append(pieces[_inside(area, pieces)])
    kept = np.concatenate(parts)
    return Mesh(kept.reshape(-1, 3), np.arange(3 * len(kept), dtype=np.int64).reshape(-1, 3))


def _inside(area: shapely.Geometry, corners: FloatArray) -> NDArray[np.bool_]:
    """Whether triangles (T, 3, 3) are in the area as a whole."""
    return np.asarray(shapely.contains(area, shapely.polygons(corners[..., :2])))
