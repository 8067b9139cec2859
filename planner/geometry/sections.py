"""Sections of a triangle mesh by many planes at once, as ordered polylines."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.geometry.mesh import TriangleMesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_CHUNK = 32  # planes at a time, to bound memory


@dataclasses.dataclass(frozen=True)
class Sections:
    """Polylines in which planes meet a mesh.

    ``points`` (M, 3) [m] are all polylines one after another; polyline i is ``points[start[i]:start[i +
    1]]`` and lies in plane ``plane[i]``; they are sorted by plane. ``closed`` marks rings; their first point
    is not repeated.
    """

    points: FloatArray
    start: IntArray
    plane: IntArray
    closed: NDArray[np.bool_]

    def polyline(self, index: int) -> FloatArray:
        """Points (m, 3) of polyline ``index``."""
        return self.points[self.start[index] : self.start[index + 1]]


def slice_mesh(mesh: TriangleMesh, origin: FloatArray, normal: FloatArray) -> Sections:
    """Cut an oriented manifold mesh by planes through ``origin`` (K, 3) with ``normal`` (K, 3).

    A vertex that lies in a plane counts as above it. Polylines run along plane normal x mesh normal.
    """
    directed = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    edges, inverse = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    edge_of = np.reshape(inverse, -1).reshape(3, -1).T.astype(np.int64)
    parts = [
        _slice(mesh, edges, edge_of, origin[i : i + _CHUNK], normal[i : i + _CHUNK], i)
        for i in range(0, len(origin), _CHUNK)
    ]
    lengths = np.concatenate([np.diff(p.start) for p in parts])
    return Sections(
        np.concatenate([p.points for p in parts]),
        np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
        np.concatenate([p.plane for p in parts]),
        np.concatenate([p.closed for p in parts]),
    )


def _slice(
    mesh: TriangleMesh, edges: IntArray, edge_of: IntArray, origin: FloatArray, normal: FloatArray, first: int
) -> Sections:
    above = normal @ mesh.vertices.T >= np.sum(origin * normal, axis=1)[:, None]
    a, b, c = (above[:, mesh.faces[:, i]] for i in range(3))
    plane, face = np.nonzero((a != b) | (b != c))
    corner = above[plane[:, None], mesh.faces[face]]
    following = np.roll(corner, -1, axis=1)  # edge i of a face goes from corner i to corner i + 1
    enter = edge_of[face, np.argmax(~corner & following, axis=1)]
    leave = edge_of[face, np.argmax(corner & ~following, axis=1)]
    count = len(edges)
    key, node = np.unique(np.concatenate([plane * count + leave, plane * count + enter]), return_inverse=True)
    source, target = np.split(np.reshape(node, -1), 2)
    label, position, closed = _rank(source, target, len(key))
    order = np.lexsort((position, label, key // count))
    row = key // count
    first_end, last_end = (mesh.vertices[edges[key % count, i]] for i in range(2))
    low = np.sum((first_end - origin[row]) * normal[row], axis=1)
    high = np.sum((last_end - origin[row]) * normal[row], axis=1)
    span = np.where(low == high, 1.0, low - high)
    t = np.clip(low / span, 0.0, 1.0)[:, None]
    points = (first_end * (1.0 - t) + last_end * t)[order]
    change = np.nonzero(np.diff(label[order], prepend=-1))[0]
    return Sections(
        points,
        np.append(change, len(order)).astype(np.int64),
        row[order][change] + first,
        closed[order][change],
    )


def _rank(source: IntArray, target: IntArray, count: int) -> tuple[IntArray, IntArray, NDArray[np.bool_]]:
    """Chain of every node, its place in it, and whether it is a ring: list ranking by pointer jumping."""
    rounds = max(1, int(np.ceil(np.log2(max(2, count)))) + 1)
    follow = np.arange(count)
    follow[source] = target
    ring = _in_ring(follow.copy(), rounds)
    if ring.any():  # open each ring at its smallest node
        smallest, jump = np.where(ring, np.arange(count), count), follow.copy()
        for _ in range(rounds):
            smallest = np.minimum(smallest, smallest[jump])
            jump = jump[jump]
        cut = ring & (smallest[follow] == follow)
        follow = np.where(cut, np.arange(count), follow)
    steps = (follow != np.arange(count)).astype(np.int64)
    for _ in range(rounds):
        steps = steps + steps[follow]
        follow = follow[follow]
    return follow.astype(np.int64), -steps, ring


def _in_ring(follow: IntArray, rounds: int) -> NDArray[np.bool_]:
    step = follow.copy()
    for _ in range(rounds):
        follow = follow[follow]
    return np.asarray(step[follow] != follow)
