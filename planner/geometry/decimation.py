"""Meshes with fewer triangles for pictures: neighbouring vertices are merged."""

from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, Mesh, unique_rows

CELL_COUNTS: Final = (400, 200, 100, 50)
"""Numbers of cells along the longest side that are tried until the mesh is small enough.

Vertices in one cell are merged.
"""
MIN_EIGENVALUE_RATIO: Final = 0.03
"""Minimum eigenvalue of the planes about a vertex, relative to the largest: edges of about 20 degrees."""


def decimate(mesh: Mesh, max_triangles: int) -> Mesh:
    """Return the mesh with merged vertices, so that it has at most ``max_triangles`` triangles.

    The grid is coarsened in the steps of `CELL_COUNTS`. With the coarsest one there may be more triangles.
    """
    size = float(np.ptp(mesh.vertices, axis=0).max()) if len(mesh.vertices) else 0.0
    decimated = mesh
    for cells in CELL_COUNTS:
        if len(decimated.faces) <= max_triangles or size <= 0.0:
            break
        decimated = merge_cells(mesh, size / cells)
    return decimated


def merge_cells(mesh: Mesh, cell: float, edges: bool = False) -> Mesh:
    """Merge vertices in the same cell of a grid, and drop triangles that collapse.

    No vertex moves farther than the cell's diagonal.

    Args:
        mesh: The mesh.
        cell: Size of the cells [m].
        edges: Whether edges are kept: merged vertices are moved to the planes of their faces, within the
            cell. Otherwise they are the means of the vertices in it.
    """
    low = mesh.vertices.min(axis=0)
    grid, first, cell_index = unique_rows(np.floor((mesh.vertices - low) / cell).astype(np.int64))
    count = np.bincount(cell_index, minlength=len(first))
    points = np.stack(
        [np.bincount(cell_index, axis, minlength=len(first)) / count for axis in mesh.vertices.T], axis=1
    )
    faces = cell_index[mesh.faces]
    if edges:
        points = points + _plane_steps(mesh.vertices[mesh.faces], faces, points)
        points = np.clip(points, low + grid * cell, low + (grid + 1) * cell)
    a, b, c = faces.T
    return Mesh(points, faces[(a != b) & (b != c) & (c != a)])


def _plane_steps(corners: FloatArray, faces: IntArray, points: FloatArray) -> FloatArray:
    """Return steps (K, 3) [m] from points to the least squares point of adjacent triangles' planes."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    matrix, right_side = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    for k in range(3):
        at = faces[:, k]
        plane_offset = np.einsum("fi,fi->f", normal, corners[:, k] - points[at])
        for i in range(3):
            right_side[:, i] += np.bincount(at, normal[:, i] * plane_offset, minlength=len(points))
            for j in range(i, 3):
                matrix[:, i, j] += np.bincount(at, normal[:, i] * normal[:, j], minlength=len(points))
    values, axes = np.linalg.eigh(matrix, UPLO="U")
    is_significant = values > MIN_EIGENVALUE_RATIO * values[:, -1:]
    along = np.einsum("kji,kj->ki", axes, right_side) / np.where(is_significant, values, np.inf)
    return np.asarray(np.einsum("kij,kj->ki", axes, along))


def split_creases(mesh: Mesh, crease: float) -> Mesh:
    """Return the same triangles with separate vertices on visible edges.

    At a vertex whose mean normal differs from a face's normal by more than ``crease``, faces share a vertex
    by their dominant axis.

    Args:
        mesh: The mesh.
        crease: Angle [rad].
    """
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    mean = np.stack([_sum_at_vertices(mesh.faces, axis, len(mesh.vertices)) for axis in normal.T], axis=1)
    along = np.einsum("fkj,fj->fk", _unit(mean)[mesh.faces], _unit(normal))
    sharp = along < np.cos(crease)
    axis = np.argmax(np.abs(normal), axis=1)
    # 1 to 6: the axis and sign of the largest component of a face's normal
    direction_code = 1 + 2 * axis + (normal[np.arange(len(axis)), axis] < 0.0)
    key = np.stack([mesh.faces, np.where(sharp, direction_code[:, None], 0)], axis=-1).reshape(-1, 2)
    vertex_keys, _, vertex_index = unique_rows(key)
    return Mesh(mesh.vertices[vertex_keys[:, 0]], vertex_index.reshape(-1, 3))


def _sum_at_vertices(faces: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Return for each of ``count`` vertices the sum of the values (F,) of its faces."""
    return np.asarray(np.bincount(faces.ravel(), np.repeat(values, 3), minlength=count))


def _unit(rows: FloatArray) -> FloatArray:
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=-1, keepdims=True), 1e-300))
