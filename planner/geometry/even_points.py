"""Points distributed evenly over a surface, and the cells of the surface that belong to them.

Farthest points come first, then Lloyd's iterations: each point moves to the centroid of its cell. A cell is a
connected set of vertices of the refined mesh. Ties of symmetric surfaces are broken by a fixed number of each
vertex, so that rounding of the mesh has no influence.

Source: T. F. Gonzalez, Clustering to minimize the maximum intercluster distance, 1985.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, unique_rows
from planner.geometry.mesh import TriangleMesh, face_areas, vertex_normals

MIN_EDGES_PER_CELL: Final = 5.0
"""Minimum number of edges of the fine mesh per distance of points."""
_FIT_CELLS: Final = 2.5
"""Number of cells around a point to whose vertices a quadric is fitted."""
_MIN_CURVATURE_RATIO: Final = 0.1
"""Ratio of principal curvatures from which on panels are convex."""
_LLOYD_ITERATIONS: Final = 40
"""Number of Lloyd's iterations."""
_FULL_UPDATES: Final = 50
"""Number of farthest points that are compared with all vertices. Later points only affect a neighbourhood."""
_JITTER_FRACTION: Final = 0.02
"""Fraction by which distances of farthest points are varied to break ties."""


@dataclasses.dataclass(frozen=True)
class FineSurface:
    """A refined surface.

    Attributes:
        mesh: The mesh.
        normal: Unit normals of the vertices (V, 3).
        area: Area of each vertex (V,) [m^2].
        spacing: Side of a square with the area of one cell [m].
    """

    mesh: TriangleMesh
    normal: FloatArray
    area: FloatArray
    spacing: float


def refine_surface(mesh: TriangleMesh, count: int, cut: float = MIN_EDGES_PER_CELL) -> FineSurface:
    """Halve the edges of a mesh until they are short compared to its cells.

    With 5 edges per side a cell has about fifty vertices.

    Args:
        mesh: The mesh.
        count: Number of cells.
        cut: Minimum number of edges along a side of a cell.
    """
    spacing = float(np.sqrt(face_areas(mesh).sum() / count))
    fine = mesh
    while True:
        finer = _halve_edges(fine, spacing / cut)
        if len(finer.faces) == len(fine.faces):
            break
        fine = finer
    area = np.zeros(len(fine.vertices))
    np.add.at(area, fine.faces.reshape(-1), np.repeat(face_areas(fine) / 3.0, 3))
    return FineSurface(fine, vertex_normals(fine), area, spacing)


def _halve_edges(mesh: TriangleMesh, longest: float) -> TriangleMesh:
    """Halve edges longer than ``longest`` [m]; each face is divided into two, three or four."""
    faces = mesh.faces
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
    key = np.sort(sides, axis=2).reshape(-1, 2)
    edges, _, inverse = unique_rows(key)
    ends = mesh.vertices[edges]
    long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > longest
    if not long.any():
        return mesh
    middle = np.full(len(edges), -1, dtype=np.int64)
    middle[long] = len(mesh.vertices) + np.arange(int(long.sum()))
    vertices = np.concatenate([mesh.vertices, ends[long].mean(axis=1)])
    middle_of_side = middle[np.reshape(inverse, (-1, 3))]
    cut_count = (middle_of_side >= 0).sum(axis=1)
    new_faces = [faces[cut_count == 0]]
    for cuts in (1, 2, 3):
        face_rows = np.flatnonzero(cut_count == cuts)
        # rotated until the cut side is the first (one cut), or the uncut side is the last (two cuts)
        shift = (
            np.argmax(middle_of_side[face_rows] >= 0, axis=1)
            if cuts < 2
            else (np.argmax(middle_of_side[face_rows] < 0, axis=1) + 1) % 3
        )
        order = (shift[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(faces[face_rows], order, axis=1).T
        p, q, r = np.take_along_axis(middle_of_side[face_rows], order, axis=1).T
        if cuts == 1:
            parts = [(a, p, c), (p, b, c)]
        elif cuts == 2:
            parts = [(p, b, q), (a, p, q), (a, q, c)]
        else:
            parts = [(a, p, r), (p, b, q), (r, q, c), (p, q, r)]
        new_faces += [np.stack(part, axis=1) for part in parts]
    return TriangleMesh(vertices, np.concatenate(new_faces))


def distribute_points(surface: FineSurface, count: int) -> FloatArray:
    """Return points (count, 3) [m] near the surface, each in the centroid of the cell that is nearest to it.

    Args:
        surface: The surface.
        count: Number of points.
    """
    vertices = surface.mesh.vertices
    # a fixed number of each vertex in [0, 1): fractional part of a multiple of the golden ratio
    vertex_number = np.modf(np.arange(1, len(vertices) + 1) * 0.6180339887498949)[0]
    weight = 1.0 + _JITTER_FRACTION * (vertex_number - 0.5)
    tree = KDTree(vertices)
    square_distance = np.full(len(vertices), np.inf)
    varied_distance = square_distance.copy()
    selected = [vertices[int(np.argmax(weight * np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)))]]
    affected: IntArray = np.arange(len(vertices))
    while True:
        offset = vertices[affected] - selected[-1]
        square_distance[affected] = np.minimum(square_distance[affected], dots(offset, offset))
        varied_distance[affected] = weight[affected] * square_distance[affected]
        if len(selected) == count:
            break
        farthest = int(np.argmax(varied_distance))
        selected.append(vertices[farthest])
        # the new point changes no vertex beyond the largest remaining distance
        if len(selected) > _FULL_UPDATES:
            reach = np.sqrt(varied_distance[farthest] / (1.0 - 0.5 * _JITTER_FRACTION)) * (1.0 + 1e-9)
            affected = np.array(tree.query_ball_point(selected[-1], reach), dtype=np.int64)
    points = np.array(selected)
    for _ in range(_LLOYD_ITERATIONS):
        points = cell_centroids(surface, np.asarray(KDTree(points).query(vertices)[1]), points)
    return points


def cell_centroids(surface: FineSurface, label: IntArray, points: FloatArray) -> FloatArray:
    """Return the centroids (N, 3) [m] of cells; a point without a cell stays.

    Args:
        surface: The surface.
        label: Cell of each vertex (V,).
        points: Points (N, 3) [m].
    """
    total = np.bincount(label, weights=surface.area, minlength=len(points))
    sums = [
        np.bincount(label, weights=surface.area * surface.mesh.vertices[:, i], minlength=len(points))
        for i in range(3)
    ]
    mean = np.stack(sums, axis=1) / np.maximum(total, 1e-300)[:, None]
    return np.asarray(np.where(total[:, None] > 0.0, mean, points))


def assign_cells(surface: FineSurface, points: FloatArray) -> IntArray:
    """Return the index of the point to which each vertex (V,) belongs: the nearest one.

    Each cell is connected: parts without contact to the cell's largest part are assigned to neighbours.

    Args:
        surface: The surface.
        points: Points (N, 3) [m].
    """
    return _connect_cells(surface, np.asarray(KDTree(points).query(surface.mesh.vertices)[1], dtype=np.int64))


def _connect_cells(surface: FineSurface, label: IntArray) -> IntArray:
    """Return labels (V,) with connected cells. Parts outside of the largest one join their neighbours."""
    faces = surface.mesh.faces
    edges = unique_rows(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1))[0]
    label = label.copy()
    for _ in range(3):
        inner_edges = edges[label[edges[:, 0]] == label[edges[:, 1]]]
        graph = coo_array(
            (np.ones(len(inner_edges)), (inner_edges[:, 0], inner_edges[:, 1])),
            shape=(len(label), len(label)),
        )
        _, part = connected_components(graph, directed=False)
        size = np.bincount(part)
        order = np.lexsort((-size[part], label))
        is_first = np.ones(len(order), dtype=np.bool_)
        is_first[1:] = label[order][1:] != label[order][:-1]
        is_main_part = np.zeros(len(size), dtype=np.bool_)
        is_main_part[part[order[is_first]]] = True
        is_loose = ~is_main_part[part]
        if not is_loose.any():
            break
        while is_loose.any():
            directed = np.concatenate([edges, edges[:, ::-1]])
            borders = directed[is_loose[directed[:, 0]] & ~is_loose[directed[:, 1]]]
            if not len(borders):
                break
            label[borders[::-1, 0]] = label[borders[::-1, 1]]
            is_loose[borders[:, 0]] = False
    return label


def surface_curvature(
    surface: FineSurface, points: FloatArray, cells: int | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return normals, principal curvatures and directions at points.

    They follow from the quadric that fits the surface best around each point.

    Args:
        surface: The surface.
        points: Points (N, 3) [m].
        cells: Number of cells of the surface, None for the number of points. It defines the size of the
            neighbourhood.

    Returns:
        Normals (N, 3), principal curvatures (N, 2) [1/m], the larger one first, and directions (N, 2, 3). A
        curvature is positive if the surface bends away from its normal, like a dome with outward normals.
    """
    vertices = surface.mesh.vertices
    count = min(max(int(_FIT_CELLS * len(vertices) / (cells or len(points))), 12), len(vertices))
    query = KDTree(vertices).query(points, k=count)
    reach, neighbours = np.asarray(query[0]), np.asarray(query[1])
    reach, neighbours = reach[:, :: 1 + count // 300], neighbours[:, :: 1 + count // 300]
    positions = vertices[neighbours]
    normal = surface.normal[neighbours[:, :8]].sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    for _ in range(2):
        first_axis = np.cross(normal, axis)
        first_axis /= np.linalg.norm(first_axis, axis=1, keepdims=True)
        second_axis = np.cross(normal, first_axis)
        offsets = positions - points[:, None]
        u, v, w = (np.einsum("nki,ni->nk", offsets, vectors) for vectors in (first_axis, second_axis, normal))
        # vertices with an opposite normal belong to another sheet
        same_sheet = np.einsum("nki,ni->nk", surface.normal[neighbours], normal) > 0.3
        weights = surface.area[neighbours] * np.exp(-2.0 * (reach / reach[:, -1:]) ** 2) * same_sheet
        terms = np.stack([np.ones_like(u), u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=2)
        square = np.einsum("nka,nk,nkb->nab", terms, weights, terms)
        scale = np.sqrt(np.maximum(np.einsum("naa->na", square), 1e-300))
        square = square / scale[:, :, None] / scale[:, None, :] + 1e-12 * np.eye(6)
        right = np.einsum("nka,nk,nk->na", terms, weights, w) / scale
        coefficients = np.linalg.solve(square, right[..., None])[..., 0] / scale
        normal = normal - coefficients[:, 1:2] * first_axis - coefficients[:, 2:3] * second_axis
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shape_operator = -np.stack([coefficients[:, [3, 4]], coefficients[:, [4, 5]]], axis=1)
    value, vectors = np.linalg.eigh(shape_operator)
    direction = np.einsum("nij,nix->njx", vectors, np.stack([first_axis, second_axis], axis=1))
    return normal, value[:, ::-1], direction[:, ::-1]


def is_synclastic(curvature: FloatArray) -> BoolArray:
    """Return at which points (N,) both curvatures have the same sign, and none is nearly zero.

    Args:
        curvature: Principal curvatures (N, 2) [1/m].
    """
    product = curvature[:, 0] * curvature[:, 1]
    return np.asarray(product > _MIN_CURVATURE_RATIO * np.abs(curvature).max(axis=1) ** 2)
