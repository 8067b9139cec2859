"""Meshes with fewer triangles, for pictures: neighbouring vertices become one."""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, Mesh, distinct_rows

CELLS: Final = (400, 200, 100, 50)
"""Vertices within the same cell become one; so many cells along the longest side, until it is few enough."""


def thinned(mesh: Mesh, most: int) -> Mesh:
    """The mesh with neighbouring vertices joined until at most ``most`` triangles are left, if that is
    possible with a grid of 50 cells."""
    size = float(np.ptp(mesh.vertices, axis=0).max()) if len(mesh.vertices) else 0.0
    thin = mesh
    for cells in CELLS:
        if len(thin.faces) <= most or size <= 0.0:
            break
        thin = joined(mesh, size / cells)
    return thin


def joined(mesh: Mesh, cell: float) -> Mesh:
    """Vertices of the same cell of a grid, of that edge [m], become their mean; triangles that collapse are
    left out. No vertex is farther than the cell's diagonal from the one that stands for it."""
    grid = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64)
    _, first, which = distinct_rows(grid)
    count = np.bincount(which, minlength=len(first))
    means = [np.bincount(which, axis, minlength=len(first)) / count for axis in mesh.vertices.T]
    faces = which[mesh.faces]
    a, b, c = faces.T
    return Mesh(np.stack(means, axis=1), faces[(a != b) & (b != c) & (c != a)])


def creased(mesh: Mesh, crease: float) -> Mesh:
    """The same triangles, with vertices of their own on edges that are to be seen: at a vertex from whose
    mean normal a face is turned by more than ``crease`` [rad], faces share a vertex by the axis that they
    look along most."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    mean = np.stack([_summed(mesh.faces, axis, len(mesh.vertices)) for axis in normal.T], axis=1)
    along = np.einsum("fkj,fj->fk", _unit(mean)[mesh.faces], _unit(normal))
    sharp = along < np.cos(crease)
    axis = np.argmax(np.abs(normal), axis=1)
    side = 1 + 2 * axis + (normal[np.arange(len(axis)), axis] < 0.0)
    key = np.stack([mesh.faces, np.where(sharp, side[:, None], 0)], axis=-1).reshape(-1, 2)
    rows, _, which = distinct_rows(key)
    return Mesh(mesh.vertices[rows[:, 0]], which.reshape(-1, 3))


def _summed(faces: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Of each of ``count`` vertices the sum of the values (F,) of its faces."""
    return np.asarray(np.bincount(faces.ravel(), np.repeat(values, 3), minlength=count))


def _unit(rows: FloatArray) -> FloatArray:
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=-1, keepdims=True), 1e-300))
