"""A face of the part seen from above: points on it, and curves projected onto it."""

import dataclasses

import numpy as np
import shapely
from scipy.sparse import csr_array

from planner.geometry.arrays import FloatArray, IntArray

CREASE_COSINE = np.cos(np.deg2rad(20.0))
"""Cosine of 20 degrees. If the normals of two triangles are farther apart, the edge between them is a crease,
across which normals are not smoothed.
"""
PLAN_TOLERANCE_M = 1e-6
"""Distance [m] in plan up to which a point counts as on a triangle."""


@dataclasses.dataclass(frozen=True)
class PlanFacePoints:
    """N points on a face.

    Attributes:
        point: Points (N, 3) [m], NaN where there is no face.
        normal: Unit normals (N, 3), NaN where there is no face.
    """

    point: FloatArray
    normal: FloatArray


class PlanFace:
    """A face with normals up, as vertices (V, 3) [m] and triangles (F, 3).

    Where triangles lie above each other, the highest point counts.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self.corners = vertices[faces]
        self._normals = smooth_normals(self.corners, faces)
        rings = np.concatenate([self.corners, self.corners[:, :1]], axis=1)[..., :2]
        self._tree = shapely.STRtree(shapely.polygons(rings))
        edge_a, edge_b = (self.corners[:, k, :2] - self.corners[:, 0, :2] for k in (1, 2))
        twice = edge_a[:, 0] * edge_b[:, 1] - edge_a[:, 1] * edge_b[:, 0]
        flat = np.abs(twice) < 1e-18
        # Triangles that are vertical, so flat in plan, get an infinite area and thus constant weights.
        self._edges = edge_a, edge_b
        self._twice = np.where(flat, np.inf, twice)

    def points_over(self, xy: FloatArray) -> PlanFacePoints:
        """Return the points of the face, with smooth normals, at positions ``xy`` (N, 2) [m] in plan."""
        point, normal = np.full((len(xy), 3), np.nan), np.full((len(xy), 3), np.nan)
        query, triangle = self._tree.query(shapely.points(xy), predicate="dwithin", distance=PLAN_TOLERANCE_M)
        offset = xy[query] - self.corners[triangle, 0, :2]
        a, b = self._edges[0][triangle], self._edges[1][triangle]
        second = (offset[:, 0] * b[:, 1] - offset[:, 1] * b[:, 0]) / self._twice[triangle]
        third = (a[:, 0] * offset[:, 1] - a[:, 1] * offset[:, 0]) / self._twice[triangle]
        weight = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
        weight /= weight.sum(axis=1, keepdims=True)
        height = np.einsum("nk,nk->n", weight, self.corners[triangle, :, 2])
        order = np.argsort(height, kind="stable")  # the highest is written last
        query, triangle, weight = query[order], triangle[order], weight[order]
        point[query] = np.column_stack([xy[query], height[order]])
        mixed = np.einsum("nk,nkd->nd", weight, self._normals[triangle])
        normal[query] = mixed / np.linalg.norm(mixed, axis=1, keepdims=True)
        return PlanFacePoints(point, normal)


def smooth_normals(corners: FloatArray, faces: IntArray) -> FloatArray:
    """Return smooth unit normals (F, 3, 3) at the corners of triangles.

    Each is the mean of the normals of the triangles around the vertex, weighted by their angles there.
    Triangles whose normals differ from that of the corner's own triangle by 20 degrees or more are left out.

    Args:
        corners: Corners (F, 3, 3) of the triangles.
        faces: Vertex index (F, 3) of each corner.
    """
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit_normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    angles = np.empty(faces.shape)
    for k in range(3):
        edge_a, edge_b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        sine = np.linalg.norm(np.cross(edge_a, edge_b), axis=1)
        angles[:, k] = np.arctan2(sine, (edge_a * edge_b).sum(axis=1))
    count = faces.size
    incidence = csr_array(
        (np.ones(count), (np.arange(count), faces.ravel())), shape=(count, int(faces.max()) + 1)
    )
    # Pairs of corners at one vertex. Corners are numbered 3 f + k, so corner // 3 is the triangle.
    pair = (incidence @ incidence.T).tocoo()
    corner, other = pair.row, pair.col
    is_smooth = (unit_normals[corner // 3] * unit_normals[other // 3]).sum(axis=1) > CREASE_COSINE
    is_smooth |= corner == other
    corner, other = corner[is_smooth], other[is_smooth]
    weights = csr_array((angles.ravel()[other], (corner, other // 3)), shape=(count, len(faces)))
    out = weights @ unit_normals
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)
    return np.asarray(out.reshape(-1, 3, 3))
