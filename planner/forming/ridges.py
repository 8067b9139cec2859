"""What constant steps of a ball leave standing, place by place: ridges that grow where a wall is flat."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.forming.spacing import scallop_height
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
from planner.units import DEG

FloatArray = NDArray[np.float64]

FLATTEST: Final = 2.0 * DEG
"""Walls flatter than this count as flat: no finite steps leave them without ridges."""
_NEIGHBOURS: Final = 32


def heights(mesh: TriangleMesh, radius: float, step: float, share: float) -> FloatArray:
    """Height (F,) [m] of the ridges between ways of a ball of ``radius`` [m] that are ``step`` [m] apart in
    z, on the triangles of a face.

    On a wall at angle a ways are dz / sin a apart; where the wall bends, the flattest place within that
    distance counts, for the ways on both sides of a ridge lie about there. Where it is nearly flat no step is
    small enough: there the height is that at the angle that most of ``share`` of the walls stay above.
    """
    angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
    area = np.where(angle > FLATTEST, face_areas(mesh), 0.0)
    order = np.argsort(angle)
    passed = np.cumsum(area[order]) / max(float(area.sum()), 1e-12)
    least = max(float(angle[order[int(np.searchsorted(passed, 0.5 * (1.0 - share)))]]), FLATTEST)
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    near = _least_within(
        middle, np.maximum(angle, least), step / np.sin(np.maximum(angle, least)), 0.5 * step
    )
    return scallop_height(radius, np.minimum(step / np.sin(near), 2.0 * radius))


def _least_within(places: FloatArray, value: FloatArray, reach: FloatArray, cell: float) -> FloatArray:
    """The least value (N,) of all places (N, 3) that are no farther than ``reach`` (N,) [m]: of those in one
    cell of size ``cell`` [m] the least stands for all, so that fine meshes take no longer."""
    _, which = np.unique(np.floor(places / cell).astype(np.int64), axis=0, return_inverse=True)
    order = np.lexsort((value, which.ravel()))
    first = order[np.diff(which.ravel()[order], prepend=-1) != 0]
    count = min(_NEIGHBOURS, len(first))
    apart, other = cKDTree(places[first]).query(places, k=[*range(1, count + 1)])
    found = np.where(apart <= reach[:, None], value[first[other]], np.inf).min(axis=1)
    return np.asarray(np.minimum(value, found))
