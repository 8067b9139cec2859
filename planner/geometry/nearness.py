"""Distances of many points from a triangle mesh, to measure deviations by."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planner.geometry.mesh import TriangleMesh, face_normals

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_NEAR: Final = 8
_MOST: Final = 400_000


class Nearness:
    """A mesh that is asked for its distance. ``spacing`` [m] is that of its samples, which find the faces
    that may be nearest; it should be near the distances that are to be told apart.
    """

    def __init__(self, mesh: TriangleMesh, spacing: float) -> None:
        self.mesh = mesh
        self.normals = face_normals(mesh)
        corners = mesh.vertices[mesh.faces]
        face = np.arange(len(corners))
        done, owner = [], []
        while len(corners):
            edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
            fine = (edge <= spacing) | (4 * len(corners) > _MOST)
            done.append(corners[fine].mean(axis=1))
            owner.append(face[fine])
            corners, face = _quartered(corners[~fine]), np.repeat(face[~fine], 4)
        self._owner = np.concatenate(owner)
        self._tree = KDTree(np.concatenate(done))

    def distance(self, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """Distances (M,) [m] of points (M, 3) and the faces (M,) that are nearest."""
        count = min(_NEAR, len(self._owner))
        _, near = self._tree.query(points, k=count)
        faces = self._owner[np.reshape(near, (len(points), count))]
        a, b, c = (self.mesh.vertices[self.mesh.faces[faces, i]] for i in range(3))
        apart = _apart(points[:, None], a, b, c)
        best = np.argmin(apart, axis=1)
        rows = np.arange(len(points))
        return apart[rows, best], faces[rows, best]


def _quartered(corners: FloatArray) -> FloatArray:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.stack([np.stack(p, axis=1) for p in parts], axis=1).reshape(-1, 3, 3)


def _apart(p: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Distances of points from triangles (..., 3): from the plane where the foot is inside, else the
    edges.
    """
    normal = np.cross(b - a, c - a)
    square = np.maximum(np.sum(normal * normal, axis=-1), 1e-300)
    inside = np.ones(square.shape, dtype=np.bool_)
    edge = np.full(square.shape, np.inf)
    for one, two in ((a, b), (b, c), (c, a)):
        way, rest = two - one, p - one
        inside &= np.sum(np.cross(way, rest) * normal, axis=-1) >= 0.0
        share = np.sum(rest * way, axis=-1) / np.maximum(np.sum(way * way, axis=-1), 1e-300)
        foot = rest - np.clip(share, 0.0, 1.0)[..., None] * way
        edge = np.minimum(edge, np.linalg.norm(foot, axis=-1))
    plane = np.abs(np.sum((p - a) * normal, axis=-1)) / np.sqrt(square)
    return np.asarray(np.where(inside, plane, edge))
