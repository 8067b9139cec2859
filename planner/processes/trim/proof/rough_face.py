"""The face that is meant by a mesh with noise, as a tool that goes square to it sees it.

Facets of a scan lean by several degrees where the face does not. Each vertex goes to the height of the second
order surface through those about it. Of a mesh without noise nothing of that is asked.
"""

from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray

ABOUT: Final = 30
"""Vertices about one, seen along z, that make its face; those of one that has more near by count, too,"""
NEAR: Final = (2.5e-3, 6e-3)
"""as they are no less and no more than so far off [m]."""
TURN_LENGTH: Final = 1.5e-3
"""The way [m] on which a levelled face rises and falls by its noise at most:"""
MOST_TURN: Final = np.deg2rad(5.0)
"""but no farther than this [rad] counts."""
FEWEST: Final = 12
"""Where there are fewer about a vertex it stays where it is."""
VERTICES_AT_ONCE: Final = 500
"""Vertices that are worked on at once."""
STEADY: Final = 1e-9
"""Of the largest eigenvalue, what is added so that a fit has one answer."""


def noise_turn(noise: float) -> float:
    """How far [rad] normals of a levelled face may be turned by what vertices are off it [m]."""
    return float(min(np.arctan2(noise, TURN_LENGTH), MOST_TURN))


def levelled(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Vertices (V, 3) [m] of a mesh ``faces`` (F, 3), each at the height of the face about it."""
    corners = vertices[faces, :2]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    share = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 6.0
    area = np.asarray(np.bincount(faces.ravel(), np.repeat(share, 3), len(vertices)), dtype=np.float64)
    tree = cKDTree(vertices[:, :2])
    far = np.asarray(tree.query(vertices[:, :2], k=min(ABOUT, len(vertices)))[0])[:, -1]
    reach = np.clip(far, *NEAR)
    out = vertices.copy()
    for first in range(0, len(vertices), VERTICES_AT_ONCE):
        rows = slice(first, first + VERTICES_AT_ONCE)
        about = list(tree.query_ball_point(vertices[rows, :2], reach[rows]))
        out[rows, 2] = _heights(vertices, area, vertices[rows], reach[rows], about)
    return out


def _heights(
    vertices: FloatArray, area: FloatArray, own: FloatArray, reach: FloatArray, about: list[list[int]]
) -> FloatArray:
    """Heights (K,) [m] at places ``own`` (K, 3) of the surfaces through the vertices ``about`` each, which
    count by the ``area`` (V,) [m^2] that is theirs, and less the farther off they are within its ``reach``
    (K,) [m]."""
    many = np.array([len(one) for one in about])
    row, column = np.repeat(np.arange(len(own)), many), np.concatenate([np.asarray(one) for one in about])
    x, y = ((vertices[column, k] - own[row, k]) / reach[row] for k in range(2))
    weight = area[column] * np.clip(1.0 - x * x - y * y, 0.0, 1.0) ** 2
    terms = np.stack([np.ones(len(row)), x, y, x * x, x * y, y * y])
    rest = vertices[column, 2] - own[row, 2]
    count, size = len(own), len(terms)
    matrix, right = np.empty((count, size, size)), np.empty((count, size))
    for a in range(size):
        right[:, a] = np.bincount(row, weight * terms[a] * rest, count)
        for b in range(size):
            matrix[:, a, b] = np.bincount(row, weight * terms[a] * terms[b], count)
    largest = np.trace(matrix, axis1=1, axis2=2)
    matrix += (STEADY * largest + 1e-30)[:, None, None] * np.eye(size)
    found = np.linalg.solve(matrix, right[..., None])[:, 0, 0]
    return np.asarray(own[:, 2] + np.where(many >= FEWEST, found, 0.0))
