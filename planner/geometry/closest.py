"""Closest places of triangles to points, and what a faceted face needs to be asked for them: small pieces,
normals that are smooth except over creases."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.mesh import TriangleMesh, face_normals
from planner.geometry.vectors import dots

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_VALENCE: Final = 48
"""Corners of a vertex with more faces than this take the normal of their own face."""


def closest_on_triangles(points: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Barycentric weights (M, 3) of the closest places of triangles ``a``, ``b``, ``c`` (M, 3) to ``points``
    (M, 3): the foot in the plane where it lies inside, else the best of the feet on the three edges."""
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = dots(ab, ab), dots(ab, ac), dots(ac, ac)
    d20, d21 = dots(ap, ab), dots(ap, ac)
    scale = np.maximum(d00 * d11 - d01 * d01, 1e-300)
    v = (d11 * d20 - d01 * d21) / scale
    w = (d00 * d21 - d01 * d20) / scale
    weights = np.stack([1.0 - v - w, v, w], axis=1)
    out = np.flatnonzero(weights.min(axis=1) < 0.0)
    if len(out):
        corners = (a[out], b[out], c[out])
        p = points[out]
        best = np.full(len(out), np.inf)
        found = np.zeros((len(out), 3))
        for k in range(3):
            one, two = corners[k], corners[(k + 1) % 3]
            way, rest = two - one, p - one
            share = np.clip(dots(rest, way) / np.maximum(dots(way, way), 1e-300), 0.0, 1.0)
            off = rest - share[:, None] * way
            square = dots(off, off)
            better = square < best
            best[better] = square[better]
            edge = np.zeros((int(better.sum()), 3))
            edge[:, k], edge[:, (k + 1) % 3] = 1.0 - share[better], share[better]
            found[better] = edge
        weights[out] = found
    return weights


def corner_normals(mesh: TriangleMesh, crease: float) -> FloatArray:
    """Unit normals (F, 3, 3) at the corners of each face: those of the faces around the vertex averaged by
    their angles there, without the faces that turn from this one by more than ``crease`` [rad]."""
    normals = face_normals(mesh)
    corner = mesh.vertices[mesh.faces]
    edge = np.roll(corner, -1, axis=1) - corner
    edge = edge / np.maximum(np.linalg.norm(edge, axis=2, keepdims=True), 1e-300)
    angle = np.arccos(np.clip(-dots(edge, np.roll(edge, 1, axis=1)), -1.0, 1.0)).ravel()
    vertex = mesh.faces.ravel()
    order = np.argsort(vertex, kind="stable")
    count = np.bincount(vertex, minlength=len(mesh.vertices))
    first = np.cumsum(count) - count
    total = np.repeat(normals, 3, axis=0) * angle[:, None]
    used = np.flatnonzero(count[vertex] <= _VALENCE)
    many = count[vertex[used]]
    mine = np.repeat(used, many)
    place = np.arange(len(mine)) - np.repeat(np.cumsum(many) - many, many)
    other = order[first[vertex[mine]] + place]
    near = (dots(normals[mine // 3], normals[other // 3]) > np.cos(crease)) & (other != mine)
    mine, other = mine[near], other[near]
    for axis in range(3):
        total[:, axis] += np.bincount(
            mine, weights=normals[other // 3, axis] * angle[other], minlength=len(total)
        )
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    return np.asarray(total.reshape(-1, 3, 3))


def small_pieces(corners: FloatArray, size: float, most: int) -> tuple[FloatArray, IntArray]:
    """Triangles (T, 3, 3) halved across their longest edges until none is longer than ``size`` (or ``most``
    pieces are reached): pieces (P, 3, 3) and the triangle (P,) that each belongs to."""
    owner = np.arange(len(corners))
    done: list[FloatArray] = []
    owners: list[IntArray] = []
    finished = 0
    while len(corners):
        edges = np.empty_like(corners)
        np.subtract(corners[:, 1:], corners[:, :2], out=edges[:, :2])
        np.subtract(corners[:, 0], corners[:, 2], out=edges[:, 2])
        one, two, three = np.ascontiguousarray(dots(edges, edges).T)
        most_of_two = np.maximum(one, two)
        # the first one of equals
        longest = np.where(three > most_of_two, 2, (two > one).astype(np.int64))
        fine = np.sqrt(np.maximum(most_of_two, three)) <= size
        fine |= finished + 2 * len(corners) > most
        kept, rows = np.flatnonzero(fine), np.flatnonzero(~fine)
        done.append(corners.take(kept, axis=0))
        owners.append(owner.take(kept))
        finished += len(kept)
        vertices, first, longest = corners.reshape(-1, 3), 3 * rows, longest.take(rows)
        corners = np.empty((2 * len(rows), 3, 3))
        near, far = corners[: len(rows)], corners[len(rows) :]
        near[:, 0] = start = vertices.take(first + longest, axis=0)
        far[:, 1] = end = vertices.take(first + (longest + 1) % 3, axis=0)
        near[:, 2] = far[:, 2] = vertices.take(first + (longest + 2) % 3, axis=0)
        near[:, 1] = far[:, 0] = 0.5 * (start + end)
        owner = np.tile(owner.take(rows), 2)
    return np.concatenate(done), np.concatenate(owners)
