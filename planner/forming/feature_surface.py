"""The surface of one feature alone: its own wall, flat inside its children and flat around it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
import shapely

from planner.forming.feature_tree import FeatureTree
from planner.forming.values import FloatArray, IntArray
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.problem import Mesh

RING: Final = 0.03
"""Width [m] of the flat that is kept around a feature."""
LEVEL: Final = float(np.cos(np.radians(1.0)))
"""Faces of a floor whose normal is so near to z are level."""
_EXACT: Final = 1e-9


def alone(mesh: Mesh, tree: FeatureTree, feature: int, shift: float) -> Mesh:
    """The face of ``feature`` (its id) moved by ``shift`` [m] along z, with normals up.

    Inside its children it is flat at the level where they start; around it there is a ring of flat sheet at
    its own start. ``mesh`` is what the tree was built of, its normals all up or all down.
    """
    share, start = _levelled(mesh, tree, feature), tree.feature(feature).start + shift
    kept = (np.abs(share) > _EXACT)[mesh.faces].any(axis=1)
    used, index = np.unique(mesh.faces[kept], return_inverse=True)
    faces = np.asarray(index).reshape(-1, 3).astype(np.int64)
    vertices = np.column_stack([mesh.vertices[used, :2], start + share[used]])
    if plan_areas(vertices, faces).sum() < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    return with_ring(Mesh(vertices, faces), start)


def _levelled(mesh: Mesh, tree: FeatureTree, feature: int) -> FloatArray:
    """How far (V,) [m] a feature moves the vertices, with its floor made level: where features leave a floor
    on both sides, or its mesh is noisy, heights there differ by less than the tree's noise."""
    share, total = tree.share[feature - 1], tree.feature(feature).end - tree.feature(feature).start
    near = mesh.faces[(np.abs(share[mesh.faces] - total) < tree.noise).all(axis=1)]
    normals = face_normals(TriangleMesh(np.column_stack([mesh.vertices[:, :2], share]), near))
    out: FloatArray = share.copy()
    out[near[np.abs(normals[:, 2]) > LEVEL]] = total
    return out


def with_ring(mesh: Mesh, level: float, width: float = RING) -> Mesh:
    """A mesh whose rim is at ``level`` [m] together with the flat in its holes and around it."""
    outer: list[shapely.Polygon] = []
    holes: list[shapely.Polygon] = []
    for loop in rim_loops(mesh.faces):
        ring = mesh.vertices[loop, :2]
        polygon = shapely.Polygon(ring)
        (outer if _area(ring) > 0.0 else holes).append(polygon if polygon.is_valid else polygon.buffer(0.0))
    covered = shapely.union_all(outer)
    outline = covered.buffer(width, quad_segs=16).simplify(1e-5)
    points, faces = triangulated([*polygons(outline.difference(covered)), *holes])
    return joined(mesh, Mesh(np.column_stack([points, np.full(len(points), level)]), faces))


def plan_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Signed areas (F,) [m^2] seen from above."""
    a, b, c = (vertices[faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    return np.asarray(0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))


def rim_loops(faces: IntArray) -> list[list[int]]:
    """Closed lines of vertices along edges of one face only, the mesh on their left, parted where one passes
    a vertex twice."""
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    count = int(faces.max()) + 1
    key = directed[:, 0] * count + directed[:, 1]
    rim = directed[~np.isin(key, directed[:, 1] * count + directed[:, 0])]
    onward: dict[int, list[int]] = {}
    for a, b in rim.tolist():
        onward.setdefault(a, []).append(b)
    loops = []
    while onward:
        path, place = [next(iter(onward))], {}
        place[path[0]] = 0
        while path and (follow := onward.get(path[-1])):
            after = follow.pop()
            if not follow:
                del onward[path[-1]]
            if after in place:
                loop = path[place[after] :]
                loops.append(loop)
                for vertex in loop[1:]:
                    del place[vertex]
                path = path[: place[after] + 1]
            else:
                place[after] = len(path)
                path.append(after)
    return [loop for loop in loops if len(loop) > 2]


def polygons(shape: shapely.Geometry) -> list[shapely.Polygon]:
    """The polygons of any shape."""
    return [part for part in shapely.get_parts(shape).tolist() if part.geom_type == "Polygon"]


def triangulated(areas: Iterable[shapely.Polygon]) -> tuple[FloatArray, IntArray]:
    """Points (P, 2) [m] and anticlockwise triangles (T, 3) of polygons, with no points besides theirs."""
    parts = [shapely.get_parts(shapely.constrained_delaunay_triangles(area)) for area in areas]
    if not parts or not sum(map(len, parts)):
        return np.zeros((0, 2)), np.zeros((0, 3), dtype=np.int64)
    corners = shapely.get_coordinates(np.concatenate(parts)).reshape(-1, 4, 2)[:, :3]
    points, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    faces = np.asarray(index).reshape(-1, 3).astype(np.int64)
    area = plan_areas(points, faces)
    faces[area < 0.0] = faces[area < 0.0, ::-1]
    return points, faces[area != 0.0]


def joined(first: Mesh, second: Mesh) -> Mesh:
    """Both meshes as one; vertices of the second at the very place of one of the first become that one."""
    vertices = np.concatenate([first.vertices, second.vertices])
    faces = np.concatenate([first.faces, second.faces + len(first.vertices)])
    _, place, index = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    kept, compact = np.unique(place[np.reshape(index, -1)][faces], return_inverse=True)
    return Mesh(vertices[kept], np.asarray(compact).reshape(-1, 3).astype(np.int64))


def _area(ring: FloatArray) -> float:
    x, y = (ring - ring[0]).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
