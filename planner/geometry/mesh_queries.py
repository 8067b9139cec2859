"""Triangle meshes asked: distances of many points, sections by many planes, a convex hull around.

Distances are those that deviations are measured by; sections are ordered polylines; the hull has
few corners, so that parts with many facets are held apart by it.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.spatial import HalfspaceIntersection, KDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, distinct_rows
from planner.geometry.mesh import TriangleMesh, face_normals

_NEAREST_PIECES: Final = 8
"""Pieces with the nearest middles to a point whose triangles are held against it."""
_MOST_PIECES: Final = 400_000
"""Triangles are divided no further where that might make more pieces than this."""


class Nearness:
    """A mesh that is asked for its distance. ``spacing`` [m] is that of its samples, which find the faces
    that may be nearest; it should be near the distances that are to be told apart.
    """

    def __init__(self, mesh: TriangleMesh, spacing: float) -> None:
        self.mesh = mesh
        self.normals = face_normals(mesh)
        corners = mesh.vertices[mesh.faces]
        face = np.arange(len(corners))
        done, owner = [], []
        while len(corners):
            edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
            fine = (edge <= spacing) | (4 * len(corners) > _MOST_PIECES)
            done.append(corners[fine].mean(axis=1))
            owner.append(face[fine])
            corners, face = _quartered(corners[~fine]), np.repeat(face[~fine], 4)
        self._owner = np.concatenate(owner)
        self._tree = KDTree(np.concatenate(done))

    def distance(self, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """Distances (M,) [m] of points (M, 3) and the faces (M,) that are nearest."""
        count = min(_NEAREST_PIECES, len(self._owner))
        _, near = self._tree.query(points, k=count)
        faces = self._owner[np.reshape(near, (len(points), count))]
        a, b, c = (self.mesh.vertices[self.mesh.faces[faces, i]] for i in range(3))
        apart = _apart(points[:, None], a, b, c)
        best = np.argmin(apart, axis=1)
        rows = np.arange(len(points))
        return apart[rows, best], faces[rows, best]


def _quartered(corners: FloatArray) -> FloatArray:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.stack([np.stack(p, axis=1) for p in parts], axis=1).reshape(-1, 3, 3)


def _apart(p: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Distances of points from triangles (..., 3): from the plane where the foot is inside, else the
    edges.
    """
    normal = np.cross(b - a, c - a)
    square = np.maximum(np.sum(normal * normal, axis=-1), 1e-300)
    inside = np.ones(square.shape, dtype=np.bool_)
    edge = np.full(square.shape, np.inf)
    for one, two in ((a, b), (b, c), (c, a)):
        way, rest = two - one, p - one
        inside &= np.sum(np.cross(way, rest) * normal, axis=-1) >= 0.0
        share = np.sum(rest * way, axis=-1) / np.maximum(np.sum(way * way, axis=-1), 1e-300)
        foot = rest - np.clip(share, 0.0, 1.0)[..., None] * way
        edge = np.minimum(edge, np.linalg.norm(foot, axis=-1))
    plane = np.abs(np.sum((p - a) * normal, axis=-1)) / np.sqrt(square)
    return np.asarray(np.where(inside, plane, edge))


_PLANES_AT_ONCE = 32  # planes at a time, to bound memory


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
    closed: BoolArray

    def polyline(self, index: int) -> FloatArray:
        """Points (m, 3) of polyline ``index``."""
        return self.points[self.start[index] : self.start[index + 1]]


def slice_mesh(mesh: TriangleMesh, origin: FloatArray, normal: FloatArray) -> Sections:
    """Cut an oriented manifold mesh by planes through ``origin`` (K, 3) with ``normal`` (K, 3).

    A vertex that lies in a plane counts as above it. Polylines run along plane normal x mesh normal.
    """
    directed = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    edges, _, inverse = distinct_rows(np.sort(directed, axis=1))
    edge_of = inverse.reshape(3, -1).T.astype(np.int64)
    parts = [
        _slice(mesh, edges, edge_of, origin[i : i + _PLANES_AT_ONCE], normal[i : i + _PLANES_AT_ONCE], i)
        for i in range(0, len(origin), _PLANES_AT_ONCE)
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


def _rank(source: IntArray, target: IntArray, count: int) -> tuple[IntArray, IntArray, BoolArray]:
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


def _in_ring(follow: IntArray, rounds: int) -> BoolArray:
    step = follow.copy()
    for _ in range(rounds):
        follow = follow[follow]
    return np.asarray(step[follow] != follow)


PLANE_RINGS: Final = ((0.0, 24), (30.0, 16), (60.0, 8))
"""Elevations [deg] above and below the x-y plane, and how many planes each has around."""
FEW_CORNERS: Final = 80
"""A hull with so few corners is taken as it is."""
FLAT_SHARE: Final = 1e-9
"""Points that are thinner than this share of their size lie in one plane."""


def outer_hull(points: FloatArray) -> TriangleMesh:
    """A convex polyhedron that holds points (P, 3) [m]: their hull, or where that has many corners the solid
    between the planes of fixed directions that touch it, which stands out of it by about 2 % of its size.

    Raises ``ValueError`` for points in one plane.
    """
    import trimesh  # slow to import

    # trimesh jogs flat points until they have a hull, where packages that it may do without are at hand
    size = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(size) < 3 or size[-1] <= FLAT_SHARE * size[0]:
        raise ValueError("the points lie in one plane, and no solid holds them tightly")
    hull = trimesh.convex.convex_hull(points)
    if len(hull.vertices) <= FEW_CORNERS:
        return TriangleMesh(np.asarray(hull.vertices), np.asarray(hull.faces, dtype=np.int64))
    ways = _directions()
    corners = np.asarray(hull.vertices, dtype=np.float64)
    middle = corners.mean(axis=0)
    reach = (corners @ ways.T).max(axis=0)
    found = HalfspaceIntersection(np.column_stack([ways, -reach]), middle).intersections
    around = trimesh.convex.convex_hull(found)
    return TriangleMesh(np.asarray(around.vertices), np.asarray(around.faces, dtype=np.int64))


def _directions() -> FloatArray:
    """Unit vectors (K, 3) all around, among them the six axes."""
    out = [np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])]
    for degrees, count in PLANE_RINGS:
        turn = 2.0 * np.pi * np.arange(count) / count
        for sign in (1.0, -1.0) if degrees else (1.0,):
            up = sign * np.deg2rad(degrees)
            flat = np.cos(up) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            out.append(np.column_stack([flat, np.full(count, np.sin(up))]))
    return np.concatenate(out)
