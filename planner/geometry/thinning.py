"""Meshes with fewer triangles, for pictures: neighbouring vertices become one."""

from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, Mesh, distinct_rows

CELLS: Final = (400, 200, 100, 50)
"""Vertices within the same cell become one; so many cells along the longest side, until it is few enough."""
SAID: Final = 0.03
"""Of the planes about a vertex, directions count whose share is at least this of that of the first one:
edges of about 20 degrees."""


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


def joined(mesh: Mesh, cell: float, edges: bool = False) -> Mesh:
    """Vertices of the same cell of a grid, of that edge [m], become one; triangles that collapse are left
    out. It is their mean or, with ``edges``, nearest to the planes of the faces there. No vertex is farther
    than the cell's diagonal from the one that stands for it."""
    low = mesh.vertices.min(axis=0)
    grid, first, which = distinct_rows(np.floor((mesh.vertices - low) / cell).astype(np.int64))
    count = np.bincount(which, minlength=len(first))
    points = np.stack(
        [np.bincount(which, axis, minlength=len(first)) / count for axis in mesh.vertices.T], axis=1
    )
    faces = which[mesh.faces]
    if edges:
        points = points + _to_planes(mesh.vertices[mesh.faces], faces, points)
        points = np.clip(points, low + grid * cell, low + (grid + 1) * cell)
    a, b, c = faces.T
    return Mesh(points, faces[(a != b) & (b != c) & (c != a)])


def _to_planes(corners: FloatArray, faces: IntArray, points: FloatArray) -> FloatArray:
    """The steps (K, 3) [m] from points to the least sum of squared distances, by squared area, to the planes
    of the triangles ``corners`` (F, 3, 3) with a corner at them (Lindstrom, Out-of-core simplification of
    large polygonal models, 2000); none along directions in which the planes say little."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    matrix, side = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    for k in range(3):
        at = faces[:, k]
        off = np.einsum("fi,fi->f", normal, corners[:, k] - points[at])
        for i in range(3):
            side[:, i] += np.bincount(at, normal[:, i] * off, minlength=len(points))
            for j in range(i, 3):
                matrix[:, i, j] += np.bincount(at, normal[:, i] * normal[:, j], minlength=len(points))
    values, axes = np.linalg.eigh(matrix, UPLO="U")
    said = values > SAID * values[:, -1:]
    along = np.einsum("kji,kj->ki", axes, side) / np.where(said, values, np.inf)
    return np.asarray(np.einsum("kij,kj->ki", axes, along))


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
