"""Flaws that exporters and scanners leave in meshes and that no face has: faces given twice, cracks between
facets, rims that are off the flat by micrometres."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.geometry.mesh import TriangleMesh, face_normals, merge

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CRACK: Final = 1e-5
"""Edges so near to each other [m] are one, where a mesh has cracks."""
OFF_RIM: Final = 2e-5
"""Corners of a sharp rim so near to the flat [m] are on it."""
SHARP: Final = float(np.cos(np.radians(20.0)))
"""Cosine of the slope from which on a rim is sharp."""
_ROUNDS: Final = 8


def sewn(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh without faces that are given twice, its cracks closed: vertices and edges of borders that are
    within `CRACK` of each other become one. A mesh without such flaws comes back as it is."""
    key = np.sort(mesh.faces, axis=1)
    _, first = np.unique(key, axis=0, return_index=True)
    if len(first) < len(mesh.faces):
        mesh = TriangleMesh(mesh.vertices, mesh.faces[np.sort(first)])
    for _ in range(_ROUNDS):
        rim = border(mesh.faces)
        if not len(rim) or _loops(rim) == 1:
            return mesh
        before = len(rim)
        mesh = _zipped(_welded(mesh, rim))
        if len(border(mesh.faces)) == before:
            return mesh
    return mesh


def border(faces: IntArray) -> IntArray:
    """Edges (E, 2) that belong to one face only, in the direction of that face."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(edges[first[count == 1]])


def rims_levelled(mesh: TriangleMesh, level: float, within: float) -> TriangleMesh:
    """The mesh with the corners of sharp rims that are ``within`` [m] of the flat at ``level`` [m] put onto
    it, and with them bumps of the flat that are no higher than that."""
    off = np.abs(mesh.vertices[:, 2] - level)
    doubtful = (off > 0.0) & (off <= within)
    if not doubtful.any():
        return mesh
    sharp = np.zeros(len(off), dtype=bool)
    sharp[mesh.faces[np.abs(face_normals(mesh)[:, 2]) < SHARP]] = True
    # what hangs together off the flat and is nowhere higher than that is a bump
    raised = off > 0.0
    edges = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = edges[raised[edges].all(axis=1)]
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(off), len(off)))
    _, label = connected_components(graph, directed=False)
    high = np.zeros(int(label.max()) + 1)
    np.maximum.at(high, label, off)
    chosen = doubtful & (sharp | (high[label] <= within))
    vertices = mesh.vertices.copy()
    vertices[chosen, 2] = level
    return TriangleMesh(vertices, mesh.faces)


def _loops(rim: IntArray) -> int:
    used, index = np.unique(rim, return_inverse=True)
    ends = index.reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(used), len(used)))
    return int(connected_components(graph, directed=False)[0])


def _welded(mesh: TriangleMesh, rim: IntArray) -> TriangleMesh:
    """Vertices of borders at one place made one."""
    used = np.unique(rim)
    pairs = cKDTree(mesh.vertices[used]).query_pairs(CRACK, output_type="ndarray")
    if not len(pairs):
        return mesh
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(used), len(used)))
    _, label = connected_components(graph, directed=False)
    first = np.full(int(label.max()) + 1, len(mesh.vertices))
    np.minimum.at(first, label, used)
    onto = np.arange(len(mesh.vertices))
    onto[used] = first[label]
    faces = onto[mesh.faces]
    whole = (faces != np.roll(faces, -1, axis=1)).all(axis=1)
    return merge(TriangleMesh(mesh.vertices, faces[whole]))


def _zipped(mesh: TriangleMesh) -> TriangleMesh:
    """Faces at whose free edge corners of others lie divided there, at one edge of each."""
    rim = border(mesh.faces)
    used = np.unique(rim)
    start, way = mesh.vertices[rim[:, 0]], mesh.vertices[rim[:, 1]] - mesh.vertices[rim[:, 0]]
    length = np.linalg.norm(way, axis=1)
    near = cKDTree(mesh.vertices[used]).query_ball_point(start + 0.5 * way, 0.5 * length + CRACK)
    divided: dict[tuple[int, int], list[int]] = {}
    for row, found in enumerate(near):
        others = used[np.array(found, dtype=np.int64)]
        others = others[~np.isin(others, rim[row])]
        rest = mesh.vertices[others] - start[row]
        share = rest @ way[row] / max(length[row] ** 2, 1e-30)
        off = np.linalg.norm(rest - share[:, None] * way[row], axis=1)
        on = (off <= CRACK) & (share * length[row] > CRACK) & ((1.0 - share) * length[row] > CRACK)
        if on.any():
            order = np.argsort(share[on])
            divided[(int(rim[row, 0]), int(rim[row, 1]))] = others[on][order].tolist()
    if not divided:
        return mesh
    faces = []
    for face in mesh.faces.tolist():
        sides = list(zip(face, face[1:] + face[:1], face[2:] + face[:2], strict=True))
        between, (a, b, apex) = max(
            ((divided.get((a, b), []), (a, b, c)) for a, b, c in sides), key=lambda item: len(item[0])
        )
        line = [a, *(v for v in between if v != apex), b]
        faces += [[one, two, apex] for one, two in pairwise(line)]
    return TriangleMesh(mesh.vertices, np.array(faces, dtype=np.int64))
