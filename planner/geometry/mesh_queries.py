"""Queries on triangle meshes: distances of many points, sections by many planes, a surrounding convex hull.

Distances are those for deviations. Sections are ordered polylines. The hull has few corners, so that it is a
fast collision shape of parts with many facets.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.spatial import HalfspaceIntersection, KDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, unique_rows
from planner.geometry.mesh import TriangleMesh, face_normals

_NEAREST_PIECES: Final = 8
"""Number of pieces with the nearest centres to a point whose triangles are compared with it."""
_MAX_PIECES: Final = 400_000
"""Maximum number of pieces into which triangles are divided."""


class MeshDistance:
    """Distance queries on a mesh.

    Args:
        mesh: The mesh.
        spacing: Distance [m] of the samples that find the candidate faces. It should be near the distances
            that matter.
    """

    def __init__(self, mesh: TriangleMesh, spacing: float) -> None:
        self.mesh = mesh
        self.normals = face_normals(mesh)
        corners = mesh.vertices[mesh.faces]
        face = np.arange(len(corners))
        samples, owner = [], []
        while len(corners):
            edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
            is_fine = (edge <= spacing) | (4 * len(corners) > _MAX_PIECES)
            samples.append(corners[is_fine].mean(axis=1))
            owner.append(face[is_fine])
            corners, face = _quarter_triangles(corners[~is_fine]), np.repeat(face[~is_fine], 4)
        self._owner = np.concatenate(owner)
        self._tree = KDTree(np.concatenate(samples))

    def distance(self, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return distances (M,) [m] of points (M, 3), and the nearest faces (M,)."""
        count = min(_NEAREST_PIECES, len(self._owner))
        _, nearest = self._tree.query(points, k=count)
        faces = self._owner[np.reshape(nearest, (len(points), count))]
        a, b, c = (self.mesh.vertices[self.mesh.faces[faces, i]] for i in range(3))
        distances = _triangle_distances(points[:, None], a, b, c)
        best = np.argmin(distances, axis=1)
        rows = np.arange(len(points))
        return distances[rows, best], faces[rows, best]


def _quarter_triangles(corners: FloatArray) -> FloatArray:
    """Return the four quarters (4 T, 3, 3) of each triangle (T, 3, 3), next to each other."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.stack([np.stack(p, axis=1) for p in parts], axis=1).reshape(-1, 3, 3)


def _triangle_distances(p: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return distances (...) of points p from triangles a, b, c (..., 3).

    It is the distance from the plane if the foot is inside the triangle, else that from the nearest edge.
    """
    normal = np.cross(b - a, c - a)
    square = np.maximum(np.sum(normal * normal, axis=-1), 1e-300)
    inside = np.ones(square.shape, dtype=np.bool_)
    edge_distance = np.full(square.shape, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge_vector, offset = end - start, p - start
        inside &= np.sum(np.cross(edge_vector, offset) * normal, axis=-1) >= 0.0
        fraction = np.sum(offset * edge_vector, axis=-1) / np.maximum(
            np.sum(edge_vector * edge_vector, axis=-1), 1e-300
        )
        foot = offset - np.clip(fraction, 0.0, 1.0)[..., None] * edge_vector
        edge_distance = np.minimum(edge_distance, np.linalg.norm(foot, axis=-1))
    plane_distance = np.abs(np.sum((p - a) * normal, axis=-1)) / np.sqrt(square)
    return np.asarray(np.where(inside, plane_distance, edge_distance))


_MAX_PLANES = 32  # maximum number of planes at a time, to bound memory


@dataclasses.dataclass(frozen=True)
class MeshSections:
    """Polylines in which planes intersect a mesh, sorted by plane.

    Attributes:
        points: Points of all polylines one after the other (M, 3) [m].
        start: Polyline i is ``points[start[i]:start[i + 1]]``.
        plane: Plane of each polyline.
        closed: Whether each polyline is a ring; its first point is not repeated.
    """

    points: FloatArray
    start: IntArray
    plane: IntArray
    closed: BoolArray

    def polyline(self, index: int) -> FloatArray:
        """Return points (m, 3) of polyline ``index``."""
        return self.points[self.start[index] : self.start[index + 1]]


def slice_mesh(mesh: TriangleMesh, origin: FloatArray, normal: FloatArray) -> MeshSections:
    """Intersect an oriented manifold mesh with planes.

    A vertex in a plane counts as above it. Polylines run along plane normal x mesh normal.

    Args:
        mesh: The mesh.
        origin: Points of the planes (K, 3) [m].
        normal: Normals of the planes (K, 3).
    """
    directed = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    edges, _, inverse = unique_rows(np.sort(directed, axis=1))
    edge_of = inverse.reshape(3, -1).T.astype(np.int64)
    parts = [
        _slice(mesh, edges, edge_of, origin[i : i + _MAX_PLANES], normal[i : i + _MAX_PLANES], i)
        for i in range(0, len(origin), _MAX_PLANES)
    ]
    lengths = np.concatenate([np.diff(p.start) for p in parts])
    return MeshSections(
        np.concatenate([p.points for p in parts]),
        np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
        np.concatenate([p.plane for p in parts]),
        np.concatenate([p.closed for p in parts]),
    )


def _slice(
    mesh: TriangleMesh, edges: IntArray, edge_of: IntArray, origin: FloatArray, normal: FloatArray, first: int
) -> MeshSections:
    """Return the sections by a few planes, of which ``first`` is the number of the first one.

    Each face that a plane crosses leads from the edge where the section enters it to the edge where it leaves
    it. These steps are joined to chains. ``edges`` (E, 2) has vertices, ``edge_of`` (F, 3) the faces' edges.
    """
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
    label, position, closed = _rank_chains(source, target, len(key))
    order = np.lexsort((position, label, key // count))
    row = key // count
    first_end, last_end = (mesh.vertices[edges[key % count, i]] for i in range(2))
    low = np.sum((first_end - origin[row]) * normal[row], axis=1)
    high = np.sum((last_end - origin[row]) * normal[row], axis=1)
    span = np.where(low == high, 1.0, low - high)
    t = np.clip(low / span, 0.0, 1.0)[:, None]
    points = (first_end * (1.0 - t) + last_end * t)[order]
    change = np.nonzero(np.diff(label[order], prepend=-1))[0]
    return MeshSections(
        points,
        np.append(change, len(order)).astype(np.int64),
        row[order][change] + first,
        closed[order][change],
    )


def _rank_chains(source: IntArray, target: IntArray, count: int) -> tuple[IntArray, IntArray, BoolArray]:
    """Return the chain of every node, its position in it, and whether it is a ring, by pointer jumping."""
    rounds = max(1, int(np.ceil(np.log2(max(2, count)))) + 1)
    follow = np.arange(count)
    follow[source] = target
    ring = _in_ring(follow.copy(), rounds)
    if ring.any():  # open each ring at its smallest node
        smallest, jump = np.where(ring, np.arange(count), count), follow.copy()
        for _ in range(rounds):
            smallest = np.minimum(smallest, smallest[jump])
            jump = jump[jump]
        is_last = ring & (smallest[follow] == follow)
        follow = np.where(is_last, np.arange(count), follow)
    steps = (follow != np.arange(count)).astype(np.int64)
    for _ in range(rounds):
        steps = steps + steps[follow]
        follow = follow[follow]
    return follow.astype(np.int64), -steps, ring


def _in_ring(follow: IntArray, rounds: int) -> BoolArray:
    """Return which nodes (N,) are in a ring: those from which no number of steps reaches an end."""
    step = follow.copy()
    for _ in range(rounds):
        follow = follow[follow]
    return np.asarray(step[follow] != follow)


PLANE_RINGS: Final = ((0.0, 24), (30.0, 16), (60.0, 8))
"""Elevations [deg] above and below the x-y plane, and number of planes at each of them."""
MAX_HULL_CORNERS: Final = 80
"""A hull with at most this many corners is used as it is."""
FLAT_FRACTION: Final = 1e-9
"""Relative thickness below which points are coplanar."""


def outer_hull(points: FloatArray) -> TriangleMesh:
    """Return a convex polyhedron that contains points.

    It is their convex hull. If that has many corners, it is the intersection of half spaces of fixed
    directions, which exceeds the hull by about 2 % of its size.

    Args:
        points: Points (P, 3) [m].

    Raises:
        ValueError: The points are coplanar.
    """
    import trimesh  # slow to import

    # trimesh perturbs flat points until they have a hull if some optional packages are installed
    size = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(size) < 3 or size[-1] <= FLAT_FRACTION * size[0]:
        raise ValueError("the points lie in one plane, so no solid contains them tightly")
    hull = trimesh.convex.convex_hull(points)
    if len(hull.vertices) <= MAX_HULL_CORNERS:
        return TriangleMesh(np.asarray(hull.vertices), np.asarray(hull.faces, dtype=np.int64))
    directions = _directions()
    corners = np.asarray(hull.vertices, dtype=np.float64)
    inner_point = corners.mean(axis=0)
    reach = (corners @ directions.T).max(axis=0)
    vertices = HalfspaceIntersection(np.column_stack([directions, -reach]), inner_point).intersections
    outer = trimesh.convex.convex_hull(vertices)
    return TriangleMesh(np.asarray(outer.vertices), np.asarray(outer.faces, dtype=np.int64))


def _directions() -> FloatArray:
    """Return unit vectors (K, 3) in all directions, including the six axes."""
    out = [np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])]
    for degrees, count in PLANE_RINGS:
        azimuth = 2.0 * np.pi * np.arange(count) / count
        for sign in (1.0, -1.0) if degrees else (1.0,):
            elevation = sign * np.deg2rad(degrees)
            flat = np.cos(elevation) * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
            out.append(np.column_stack([flat, np.full(count, np.sin(elevation))]))
    return np.concatenate(out)
