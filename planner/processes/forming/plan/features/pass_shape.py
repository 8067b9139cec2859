"""The surface that a pass forms: of one feature alone, or between the flat sheet and a steep one.

A feature alone has its own wall, flat inside its children and flat around it.

**Intermediate shapes** have walls no steeper than a given angle. The shape is the deepest one that
is nowhere deeper than the feature and nowhere steeper than the angle: its depth at p is the least
of depth(q) + tan(a) |p - q| over all q. So each pass only moves the sheet onward. What is deeper
than z + dz is what is deeper than z, shrunk by dz / tan(a), as far as the feature is that deep:
that builds it contour by contour, for any outline, with as many floors as there are.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.processes.forming.plan.features.surface import SheetSurface, signed_plan_areas, slice_levels
from planner.processes.forming.plan.features.tree import FeatureTree

RIM_WIDTH: Final = 0.03
"""Width [m] of the flat that is kept around a feature."""
LEVEL_COSINE: Final = float(np.cos(np.radians(1.0)))
"""Faces of a floor whose normal is nearer to z than this cosine (1 degree) are level."""
_MOVED_SHARE: Final = 1e-9
"""A vertex whose share of a feature is no larger has not been moved by it."""


def alone(mesh: Mesh, tree: FeatureTree, feature: int, shift: float) -> Mesh:
    """The face of ``feature`` (its id) moved by ``shift`` [m] along z, with normals up.

    Inside its children it is flat at the level where they start; around it there is a ring of flat sheet at
    its own start. ``mesh`` is what the tree was built of, its normals all up or all down.
    """
    share, start = _levelled(mesh, tree, feature), tree.feature(feature).start + shift
    kept = (np.abs(share) > _MOVED_SHARE)[mesh.faces].any(axis=1)
    used, index = np.unique(mesh.faces[kept], return_inverse=True)
    faces = np.asarray(index).reshape(-1, 3).astype(np.int64)
    vertices = np.column_stack([mesh.vertices[used, :2], start + share[used]])
    if signed_plan_areas(vertices, faces).sum() < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    return with_ring(Mesh(vertices, faces), start)


def _levelled(mesh: Mesh, tree: FeatureTree, feature: int) -> FloatArray:
    """How far (V,) [m] a feature moves the vertices, with its floor made level: where features leave a floor
    on both sides, or its mesh is noisy, heights there differ by less than the tree's noise."""
    share, total = tree.share[feature - 1], tree.feature(feature).end - tree.feature(feature).start
    near = mesh.faces[(np.abs(share[mesh.faces] - total) < tree.noise).all(axis=1)]
    normals = face_normals(TriangleMesh(np.column_stack([mesh.vertices[:, :2], share]), near))
    out: FloatArray = share.copy()
    out[near[np.abs(normals[:, 2]) > LEVEL_COSINE]] = total
    return out


def with_ring(mesh: Mesh, level: float, width: float = RIM_WIDTH) -> Mesh:
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
    area = signed_plan_areas(points, faces)
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


CONTOURS_PER_DEPTH: Final = 80
"""Contours over the depth of a feature, within the bounds of `CONTOUR_STEP`."""
CONTOUR_STEP: Final = (0.2e-3, 1e-3)
"""Least and largest distance [m] of contours in depth."""
PLAIN_STEP: Final = 5e-3
"""Contours of the mesh are at most so far apart [m] in height where only the angle limits the shape."""
_SAME_AREA: Final = 1e-7
"""Share of its area by which a contour may differ from the one that the angle alone makes of it."""
_FIRST_DEPTH: Final = 1e-6
"""Depth [m] of the first contour, just below the flat, whose own contour is not defined."""
_OUTLINE_TOLERANCE: Final = 5e-7
"""Contours lose points that are off them by less than this [m]."""
_LAST_STEPS: Final = (0.5, 0.2, 0.05)
"""Places of the last contours above the bottom, over the step between contours."""


@dataclasses.dataclass(frozen=True, eq=False)
class Limited:
    """A shape with walls of at most ``angle`` [rad]: what is deeper than ``depth`` (L,) [m], ascending from
    0, is ``area``, L polygons in plan [m]. ``ring`` (L,): levels whose outlines the mesh needs; between them
    the shape is plane across."""

    angle: float
    depth: FloatArray
    area: tuple[Any, ...]
    ring: BoolArray

    def holds_back(self, points: FloatArray, depth: FloatArray) -> BoolArray:
        """Where (N,) the shape at ``points`` (N, 2) [m] is not as deep as ``depth`` (N,) [m]: on its own
        walls, of its own angle."""
        # half a level is what the contours leave open
        step = float(np.median(np.diff(self.depth)))
        level = np.searchsorted(self.depth, depth - 0.5 * step, side="right") - 1
        out = np.zeros(len(points), dtype=np.bool_)
        for one in np.unique(level[level > 0]):
            rows = np.flatnonzero(level == one)
            out[rows] = ~shapely.contains_xy(self.area[one], points[rows, 0], points[rows, 1])
        return out


def depth_areas(face: Mesh, side: int, start: float, end: float) -> tuple[FloatArray, tuple[Any, ...]]:
    """Depths (L,) [m] from 0 to nearly all, and the areas of a face that are deeper, for ``side`` +1 below
    ``start`` [m], for -1 above it."""
    total = abs(end - start)
    step = float(np.clip(total / CONTOURS_PER_DEPTH, *CONTOUR_STEP))
    between = np.arange(step, total - 0.5 * step, step)
    last = total - step * np.array(_LAST_STEPS)
    slight = min(_FIRST_DEPTH, 1e-3 * total)
    depth = np.unique(np.concatenate([[slight], between, last[last > slight], [total - slight]]))
    height = side * (start - face.vertices[:, 2])
    surface = _sliceable(face, height)
    lines = slice_levels(surface, height, depth)
    areas = tuple(_even_odd([line[:, :2] for line in group]) for group in lines)
    depth[0], depth[-1] = 0.0, total
    return depth, areas


def limited(depth: FloatArray, areas: tuple[Any, ...], angle: float) -> Limited:
    """The shape between for a feature of ``areas`` deeper than ``depth`` (L,) [m]."""
    kept, plain = [areas[0]], [False]
    for one, two, area in zip(depth[:-1], depth[1:], areas[1:], strict=True):
        shrunk = kept[-1].buffer(-(two - one) / np.tan(angle), join_style="round", quad_segs=8)
        both = shrunk.intersection(area)
        plain.append(shrunk.area - both.area <= _SAME_AREA * shrunk.area)
        kept.append(both.simplify(_OUTLINE_TOLERANCE))
    pieces = [len(polygons(area)) for area in kept]
    ring, last = np.ones(len(depth), dtype=np.bool_), 0
    for k in range(1, len(depth) - 1):
        same = plain[k] and plain[k + 1] and pieces[last] == pieces[k] == pieces[k + 1]
        ring[k] = not same or depth[k + 1] - depth[last] > PLAIN_STEP
        last = k if ring[k] else last
    return Limited(angle, depth, tuple(kept), ring)


def face_of(shape: Limited, side: int, start: float) -> Mesh:
    """The face of a shape, with normals up and a ring of flat at ``start`` [m] around it."""
    mesh: Mesh | None = None
    rings = np.flatnonzero(shape.ring).tolist()
    for k, then in zip(rings, [*rings[1:], None], strict=True):
        area = shape.area[k]
        if area.is_empty:
            break
        after = shapely.Polygon() if then is None else shape.area[then]
        points, faces = triangulated(polygons(area.difference(after)))
        deeper = _among(points, shapely.get_coordinates(after))
        depth = np.where(deeper, shape.depth[-1 if then is None else then], shape.depth[k])
        strip = Mesh(np.column_stack([points, start - side * depth]), faces)
        mesh = (
            strip
            if mesh is None
            else Mesh(
                np.concatenate([mesh.vertices, strip.vertices]),
                np.concatenate([mesh.faces, strip.faces + len(mesh.vertices)]),
            )
        )
    if mesh is None:
        raise ValueError("a feature without an area has no shapes between")
    mesh = joined(mesh, Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)))
    keep = np.abs(signed_plan_areas(mesh.vertices, mesh.faces)) > 1e-16
    return with_ring(Mesh(mesh.vertices, mesh.faces[keep]), start)


def _among(points: FloatArray, others: FloatArray) -> BoolArray:
    """Return which points (N, 2) are exactly equal to one of ``others``."""
    known = set(map(tuple, others.tolist()))
    return np.array([tuple(point) in known for point in points.tolist()], dtype=np.bool_)


def _even_odd(rings: list[FloatArray]) -> Any:
    """The area inside an odd number of rings."""
    area = shapely.Polygon()
    for ring in rings:
        polygon = shapely.Polygon(ring)
        area = area.symmetric_difference(polygon if polygon.is_valid else polygon.buffer(0.0))
    return area


def _sliceable(face: Mesh, height: FloatArray) -> SheetSurface:
    directed = np.stack([face.faces, np.roll(face.faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, inverse = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    vertices = np.column_stack([face.vertices[:, :2], height])
    none: IntArray = np.zeros(0, dtype=np.int64)
    face_edges = np.reshape(inverse, (-1, 3)).astype(np.int64)
    return SheetSurface(vertices, face.faces, edges, face_edges, none, 0.0, none)
