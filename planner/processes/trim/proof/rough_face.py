"""Smoothed face of a mesh with noise, to which the normals of tools are compared.

Because of noise, facets of a scan are tilted by several degrees from the real face. So each vertex is moved
to the height of the second-order surface that is fitted to its neighbourhood. Meshes without noise are not
smoothed.
"""

from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray

NEIGHBOUR_COUNT: Final = 30
"""Number of neighbours in plan whose distance determines the radius of the neighbourhood of a vertex."""
NEIGHBOUR_RADIUS_M: Final = (2.5e-3, 6e-3)
"""Bounds of the radius of the neighbourhood [m]. All vertices within the radius count."""
NOISE_LENGTH_M: Final = 1.5e-3
"""Length over which a smoothed face may still rise or fall by its noise [m]."""
MAX_ROTATION_RAD: Final = np.deg2rad(5.0)
"""Maximum rotation of normals because of noise [rad]."""
MIN_NEIGHBOURS: Final = 12
"""Minimum number of neighbours. A vertex with fewer is not moved."""
MAX_VERTICES: Final = 500
"""Number of vertices that are processed at once, to bound memory."""
REGULARISATION_FRACTION: Final = 1e-9
"""Regularisation of the fit, as a fraction of the largest eigenvalue."""


def noise_rotation(noise: float) -> float:
    """Return the possible rotation of normals of a smoothed face [rad].

    Args:
        noise: Deviation of vertices from the face [m].
    """
    return float(min(np.arctan2(noise, NOISE_LENGTH_M), MAX_ROTATION_RAD))


def smooth_heights(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the vertices (V, 3) [m] of a mesh with noise, with smoothed heights.

    Each height is that of a second-order surface fitted to the neighbours in plan. A third of the area of a
    triangle counts for each of its vertices.

    Args:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3).
    """
    corners = vertices[faces, :2]
    first_edge, second_edge = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    corner_areas = np.abs(first_edge[:, 0] * second_edge[:, 1] - first_edge[:, 1] * second_edge[:, 0]) / 6.0
    area = np.asarray(np.bincount(faces.ravel(), np.repeat(corner_areas, 3), len(vertices)), dtype=np.float64)
    tree = cKDTree(vertices[:, :2])
    neighbour_distance = np.asarray(tree.query(vertices[:, :2], k=min(NEIGHBOUR_COUNT, len(vertices)))[0])[
        :, -1
    ]
    radius = np.clip(neighbour_distance, *NEIGHBOUR_RADIUS_M)
    out = vertices.copy()
    for first in range(0, len(vertices), MAX_VERTICES):
        rows = slice(first, first + MAX_VERTICES)
        neighbours = list(tree.query_ball_point(vertices[rows, :2], radius[rows]))
        out[rows, 2] = _heights(vertices, area, vertices[rows], radius[rows], neighbours)
    return out


def _heights(
    vertices: FloatArray,
    area: FloatArray,
    points: FloatArray,
    radius: FloatArray,
    neighbours: list[list[int]],
) -> FloatArray:
    """Return smoothed heights (K,) [m] at points (K, 3) [m] of a mesh with noise.

    Each height is that of a second-order surface fitted to the point's neighbours, which are given as indices
    of vertices (V, 3) for each point. The weighted least squares fit is z = c0 + c1 x + c2 y + c3 x^2 +
    c4 x y + c5 y^2, with coordinates relative to the point. The weight is the vertex's ``area`` (V,) [m^2]
    times (1 - r^2)^2, with the distance r as a fraction of the ``radius`` (K,) [m] of the point. Points with
    fewer than ``MIN_NEIGHBOURS`` neighbours keep their height.
    """
    counts = np.array([len(indices) for indices in neighbours])
    row = np.repeat(np.arange(len(points)), counts)
    vertex = np.concatenate([np.asarray(indices) for indices in neighbours])
    x, y = ((vertices[vertex, k] - points[row, k]) / radius[row] for k in range(2))
    weight = area[vertex] * np.clip(1.0 - x * x - y * y, 0.0, 1.0) ** 2
    terms = np.stack([np.ones(len(row)), x, y, x * x, x * y, y * y])
    rest = vertices[vertex, 2] - points[row, 2]
    count, size = len(points), len(terms)
    matrix, right_side = np.empty((count, size, size)), np.empty((count, size))
    for a in range(size):
        right_side[:, a] = np.bincount(row, weight * terms[a] * rest, count)
        for b in range(size):
            matrix[:, a, b] = np.bincount(row, weight * terms[a] * terms[b], count)
    largest = np.trace(matrix, axis1=1, axis2=2)
    matrix += (REGULARISATION_FRACTION * largest + 1e-30)[:, None, None] * np.eye(size)
    # coefficient c0 is the height of the surface at the point, relative to the point
    offsets = np.linalg.solve(matrix, right_side[..., None])[:, 0, 0]
    return np.asarray(points[:, 2] + np.where(counts >= MIN_NEIGHBOURS, offsets, 0.0))
