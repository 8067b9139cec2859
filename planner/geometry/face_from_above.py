"""Points on a face seen from above."""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.mesh import TriangleMesh, corner_normals

CREASE_ANGLE_RAD: Final = float(np.deg2rad(20.0))
"""Angle between triangles [rad] above which their edge is a crease."""
MIN_INSIDE_WEIGHT: Final = -1e-9
"""Minimum barycentric weight of a point inside a triangle."""


@dataclasses.dataclass(frozen=True)
class ProjectedPoints:
    """N points on a face, NaN where the face does not exist.

    Attributes:
        point: Points (N, 3) [m].
        normal: Normals (N, 3).
        on: Whether the face exists there (N,).
    """

    point: FloatArray
    normal: FloatArray
    on: BoolArray


class FaceFromAbove:
    """A face with upward normals. Where it overlaps itself, its highest point counts.

    Args:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3).
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self._corners = vertices[faces]
        self._normals = corner_normals(TriangleMesh(vertices, faces), CREASE_ANGLE_RAD)
        flat = self._corners[..., :2]
        self.low, self.high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
        area = float(np.prod(np.maximum(self.high - self.low, 1e-9)))
        self._cell = max(float(np.sqrt(area / max(len(faces), 1))), 1e-6)
        self._columns = int((self.high[0] - self.low[0]) / self._cell) + 1
        first_cell = ((flat.min(axis=1) - self.low) / self._cell).astype(np.int64)
        cell_spans = ((flat.max(axis=1) - self.low) / self._cell).astype(np.int64) - first_cell + 1
        # sorted pairs of a grid cell and a triangle whose bounding rectangle overlaps it
        cell_counts = cell_spans.prod(axis=1)
        owner = np.repeat(np.arange(len(faces)), cell_counts)
        cell_index = np.arange(len(owner)) - np.repeat(np.cumsum(cell_counts) - cell_counts, cell_counts)
        column, row = cell_index % cell_spans[owner, 0], cell_index // cell_spans[owner, 0]
        key = (first_cell[owner, 1] + row) * self._columns + first_cell[owner, 0] + column
        order = np.argsort(key, kind="stable")
        self._key, self._owner = key[order], owner[order]

    def at(self, xy: FloatArray) -> ProjectedPoints:
        """Return the points over ``xy`` (N, 2) [m]."""
        point, normal = np.full((len(xy), 3), np.nan), np.full((len(xy), 3), np.nan)
        inside = ((xy >= self.low - 1e-9) & (xy <= self.high + 1e-9)).all(axis=1)
        cell = (np.clip(xy, self.low, self.high) - self.low) / self._cell
        key = cell[:, 1].astype(np.int64) * self._columns + cell[:, 0].astype(np.int64)
        start, end = np.searchsorted(self._key, key), np.searchsorted(self._key, key, side="right")
        candidate_counts = np.where(inside, end - start, 0)
        row = np.repeat(np.arange(len(xy)), candidate_counts)
        triangle = self._owner[
            np.repeat(start, candidate_counts)
            + np.arange(len(row))
            - np.repeat(np.cumsum(candidate_counts) - candidate_counts, candidate_counts)
        ]
        weights = _barycentric_weights(xy[row], self._corners[triangle][..., :2])
        hit = np.flatnonzero(weights.min(axis=1) >= MIN_INSIDE_WEIGHT)
        row, triangle, weights = row[hit], triangle[hit], weights[hit]
        hit_points = np.einsum("nk,nkd->nd", weights, self._corners[triangle])
        order = np.argsort(hit_points[:, 2], kind="stable")  # the highest point is written last and wins
        row, triangle, weights, hit_points = row[order], triangle[order], weights[order], hit_points[order]
        point[row] = hit_points
        hit_normals = np.einsum("nk,nkd->nd", weights, self._normals[triangle])
        normal[row] = hit_normals / np.linalg.norm(hit_normals, axis=1, keepdims=True)
        return ProjectedPoints(point, normal, np.isfinite(point[:, 2]))


def _barycentric_weights(xy: FloatArray, corners: FloatArray) -> FloatArray:
    """Return barycentric weights (M, 3) of points (M, 2) in triangles (M, 3, 2); -1 in vertical triangles."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, xy - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    good = np.abs(area) > 1e-18
    safe = np.where(good, area, 1.0)
    v = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / safe
    w = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / safe
    return np.where(good[:, None], np.stack([1.0 - v - w, v, w], axis=1), -1.0)
