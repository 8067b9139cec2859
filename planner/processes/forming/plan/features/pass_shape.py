"""The surface that a pass forms: of one feature alone, or between the flat sheet and a steep feature.

A feature alone has its own wall, is flat inside its children, and has flat sheet around it.

**Intermediate shapes** have walls no steeper than a given angle a. The shape is the deepest one that is
nowhere deeper than the feature and nowhere steeper than the angle: its depth at p is min over q of depth(q) +
tan(a) |p - q|. So each pass only moves the sheet onward. The area deeper than z + dz is the area deeper than
z, shrunk by dz / tan(a) and intersected with the area where the feature is that deep. This builds the shape
contour by contour, for any outline and any number of floors.
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

RIM_WIDTH_M: Final = 0.03
"""Width [m] of the flat that is kept around a feature."""
MIN_LEVEL_COSINE: Final = float(np.cos(np.radians(1.0)))
"""Faces of a floor are level if the cosine of their normal to z is larger than this (1 degree)."""
_MIN_DISPLACEMENT_M: Final = 1e-9
"""Displacement [m] of a vertex by a feature up to which the vertex counts as not moved."""


def feature_face(mesh: Mesh, tree: FeatureTree, feature: int, shift: float) -> Mesh:
    """Return the face of one feature alone, with normals up.

    Inside its children the face is flat at the level where they start. Around it is a ring of flat sheet at
    its own start.

    Args:
        mesh: Mesh from which the tree was built, its normals all up or all down.
        tree: Features of the part.
        feature: Id of the feature.
        shift: Distance [m] along z by which the face is displaced from its position in the part.
    """
    displacement = _level_floor(mesh, tree, feature)
    start = tree.feature(feature).start + shift
    kept = (np.abs(displacement) > _MIN_DISPLACEMENT_M)[mesh.faces].any(axis=1)
    used, index = np.unique(mesh.faces[kept], return_inverse=True)
    faces = np.asarray(index).reshape(-1, 3).astype(np.int64)
    vertices = np.column_stack([mesh.vertices[used, :2], start + displacement[used]])
    if signed_plan_areas(vertices, faces).sum() < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    return add_flat_ring(Mesh(vertices, faces), start)


def _level_floor(mesh: Mesh, tree: FeatureTree, feature: int) -> FloatArray:
    """Return the displacement (V,) [m] of the vertices by a feature, with its floor made level.

    The measured heights of a floor differ by less than the tree's noise if features leave it on both sides,
    or if its mesh is noisy.
    """
    displacement = tree.displacement[feature - 1]
    total = tree.feature(feature).end - tree.feature(feature).start
    floor_faces = mesh.faces[(np.abs(displacement[mesh.faces] - total) < tree.noise).all(axis=1)]
    normals = face_normals(TriangleMesh(np.column_stack([mesh.vertices[:, :2], displacement]), floor_faces))
    out: FloatArray = displacement.copy()
    out[floor_faces[np.abs(normals[:, 2]) > MIN_LEVEL_COSINE]] = total
    return out


def add_flat_ring(mesh: Mesh, level: float, width: float = RIM_WIDTH_M) -> Mesh:
    """Return a mesh whose holes are filled by flat sheet and which a ring of flat sheet surrounds.

    Args:
        mesh: Mesh whose rims, outside and around holes, are at the level.
        level: Level z [m] of the flat.
        width: Width [m] of the ring of flat.
    """
    outer: list[shapely.Polygon] = []
    holes: list[shapely.Polygon] = []
    for loop in rim_loops(mesh.faces):
        ring = mesh.vertices[loop, :2]
        polygon = shapely.Polygon(ring)
        (outer if _ring_area(ring) > 0.0 else holes).append(
            polygon if polygon.is_valid else polygon.buffer(0.0)
        )
    covered = shapely.union_all(outer)
    outline = covered.buffer(width, quad_segs=16).simplify(1e-5)
    points, faces = triangulate([*polygons(outline.difference(covered)), *holes])
    return merge_meshes(mesh, Mesh(np.column_stack([points, np.full(len(points), level)]), faces))


def rim_loops(faces: IntArray) -> list[list[int]]:
    """Return the closed lines of vertices along edges that have one face only.

    The mesh is on their left. A line that passes a vertex twice is split there. Each line is a list of
    indices of vertices. The first vertex is not repeated at the end.
    """
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    count = int(faces.max()) + 1
    key = directed[:, 0] * count + directed[:, 1]
    rim = directed[~np.isin(key, directed[:, 1] * count + directed[:, 0])]
    successors: dict[int, list[int]] = {}
    for a, b in rim.tolist():
        successors.setdefault(a, []).append(b)
    loops = []
    while successors:
        path, position = [next(iter(successors))], {}  # vertices so far, and where each is among them
        position[path[0]] = 0
        while path and (next_vertices := successors.get(path[-1])):
            next_vertex = next_vertices.pop()
            if not next_vertices:
                del successors[path[-1]]
            if next_vertex in position:
                loop = path[position[next_vertex] :]
                loops.append(loop)
                for vertex in loop[1:]:
                    del position[vertex]
                path = path[: position[next_vertex] + 1]
            else:
                position[next_vertex] = len(path)
                path.append(next_vertex)
    return [loop for loop in loops if len(loop) > 2]


def polygons(shape: shapely.Geometry) -> list[shapely.Polygon]:
    """Return the polygons that a geometry consists of, without its points and lines."""
    return [part for part in shapely.get_parts(shape).tolist() if part.geom_type == "Polygon"]


def triangulate(areas: Iterable[shapely.Polygon]) -> tuple[FloatArray, IntArray]:
    """Return points (P, 2) [m] and anticlockwise triangles (T, 3) of polygons, without additional points."""
    parts = [shapely.get_parts(shapely.constrained_delaunay_triangles(area)) for area in areas]
    if not parts or not sum(map(len, parts)):
        return np.zeros((0, 2)), np.zeros((0, 3), dtype=np.int64)
    corners = shapely.get_coordinates(np.concatenate(parts)).reshape(-1, 4, 2)[:, :3]
    points, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    faces = np.asarray(index).reshape(-1, 3).astype(np.int64)
    area = signed_plan_areas(points, faces)
    faces[area < 0.0] = faces[area < 0.0, ::-1]
    return points, faces[area != 0.0]


def merge_meshes(first: Mesh, second: Mesh) -> Mesh:
    """Return both meshes as one.

    Vertices of the second mesh at exactly the position of a vertex of the first become that vertex.
    """
    vertices = np.concatenate([first.vertices, second.vertices])
    faces = np.concatenate([first.faces, second.faces + len(first.vertices)])
    _, first_index, index = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    kept, compact = np.unique(first_index[np.reshape(index, -1)][faces], return_inverse=True)
    return Mesh(vertices[kept], np.asarray(compact).reshape(-1, 3).astype(np.int64))


def _ring_area(ring: FloatArray) -> float:
    """Return the area [m^2] of an open ring (K, 2) of points, positive if counter-clockwise."""
    x, y = (ring - ring[0]).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


CONTOURS_PER_DEPTH: Final = 80
"""Number of contours over the depth of a feature, within the bounds of `CONTOUR_STEP_BOUNDS_M`."""
CONTOUR_STEP_BOUNDS_M: Final = (0.2e-3, 1e-3)
"""Minimum and maximum spacing [m] of contours in depth."""
MAX_PLAIN_STEP_M: Final = 5e-3
"""Maximum spacing [m] in height of contours of the mesh where only the angle limits the shape."""
_AREA_TOLERANCE_FRACTION: Final = 1e-7
"""Difference, as a fraction of its area, of a contour from the one that the angle alone produces."""
_FIRST_DEPTH_M: Final = 1e-6
"""Depth [m] of the first contour, just below the flat, where the contour is not defined."""
_OUTLINE_TOLERANCE_M: Final = 5e-7
"""Tolerance [m] of the simplification of contours."""
_LAST_STEP_FRACTIONS: Final = (0.5, 0.2, 0.05)
"""Distances of the last contours from the bottom, as fractions of the step between contours."""


@dataclasses.dataclass(frozen=True, eq=False)
class AngleLimitedShape:
    """A shape whose walls have at most a given angle.

    Attributes:
        angle: Maximum wall angle [rad].
        depth: Depths (L,) [m], ascending from 0.
        area: Areas deeper than each depth, L shapely geometries in plan [m].
        ring: Whether (L,) the mesh needs the outline at each depth; between two outlines it is straight.
    """

    angle: float
    depth: FloatArray
    area: tuple[Any, ...]
    ring: BoolArray

    def limits_depth(self, points: FloatArray, depth: FloatArray) -> BoolArray:
        """Return whether (N,) the shape, limited by its own walls, is less deep than a depth at each point.

        Args:
            points: Points (N, 2) [m] in plan.
            depth: Depths (N,) [m].
        """
        # contours leave the depth uncertain by half a step
        step = float(np.median(np.diff(self.depth)))
        level = np.searchsorted(self.depth, depth - 0.5 * step, side="right") - 1
        out = np.zeros(len(points), dtype=np.bool_)
        for number in np.unique(level[level > 0]):
            indices = np.flatnonzero(level == number)
            out[indices] = ~shapely.contains_xy(self.area[number], points[indices, 0], points[indices, 1])
        return out


def depth_areas(face: Mesh, side: int, start: float, end: float) -> tuple[FloatArray, tuple[Any, ...]]:
    """Return depths from 0 to the total depth of a feature, and the areas of its face that are deeper.

    The contours at both ends are not defined. The first and the last area are those just below the flat and
    just above the bottom.

    Args:
        face: Face of the feature.
        side: +1 for depths below ``start``, -1 for above.
        start: Level [m] at depth 0.
        end: Level [m] of the deepest point.

    Returns:
        Depths (L,) [m] and L areas.
    """
    total = abs(end - start)
    step = float(np.clip(total / CONTOURS_PER_DEPTH, *CONTOUR_STEP_BOUNDS_M))
    between = np.arange(step, total - 0.5 * step, step)
    last = total - step * np.array(_LAST_STEP_FRACTIONS)
    first_depth = min(_FIRST_DEPTH_M, 1e-3 * total)
    depth = np.unique(
        np.concatenate([[first_depth], between, last[last > first_depth], [total - first_depth]])
    )
    height = side * (start - face.vertices[:, 2])
    surface = _sliceable_surface(face, height)
    lines = slice_levels(surface, height, depth)
    areas = tuple(_even_odd_area([line[:, :2] for line in group]) for group in lines)
    depth[0], depth[-1] = 0.0, total
    return depth, areas


def limit_wall_angle(depth: FloatArray, areas: tuple[Any, ...], angle: float) -> AngleLimitedShape:
    """Return the intermediate shape of a feature whose walls are at most as steep as ``angle``.

    Steep features are formed through such shapes, which are never deeper than the feature itself.

    Args:
        depth: Depths (L,) [m].
        areas: Areas of the feature deeper than each depth.
        angle: Maximum wall angle [rad].
    """
    limited_areas, limited_by_angle = [areas[0]], [False]
    for upper, lower, area in zip(depth[:-1], depth[1:], areas[1:], strict=True):
        # A(z + dz) = shrink(A(z), dz / tan a), intersected with the feature's area at z + dz
        shrunk = limited_areas[-1].buffer(-(lower - upper) / np.tan(angle), join_style="round", quad_segs=8)
        clipped = shrunk.intersection(area)
        limited_by_angle.append(shrunk.area - clipped.area <= _AREA_TOLERANCE_FRACTION * shrunk.area)
        limited_areas.append(clipped.simplify(_OUTLINE_TOLERANCE_M))
    piece_counts = [len(polygons(area)) for area in limited_areas]
    # an outline is left out where the angle alone shapes the walls and no part splits, merges or vanishes
    ring = np.ones(len(depth), dtype=np.bool_)
    last_ring = 0
    for k in range(1, len(depth) - 1):
        is_plain = (
            limited_by_angle[k]
            and limited_by_angle[k + 1]
            and piece_counts[last_ring] == piece_counts[k] == piece_counts[k + 1]
        )
        ring[k] = not is_plain or depth[k + 1] - depth[last_ring] > MAX_PLAIN_STEP_M
        last_ring = k if ring[k] else last_ring
    return AngleLimitedShape(angle, depth, tuple(limited_areas), ring)


def shape_face(shape: AngleLimitedShape, side: int, start: float) -> Mesh:
    """Return the face of a shape, with normals up and a ring of flat sheet around it.

    Args:
        shape: Shape.
        side: +1 for depths below ``start``, -1 for above.
        start: Level z [m] of the flat.

    Raises:
        ValueError: The shape has no area.
    """
    mesh: Mesh | None = None
    rings = np.flatnonzero(shape.ring).tolist()
    for k, next_level in zip(rings, [*rings[1:], None], strict=True):
        area = shape.area[k]  # its outline and the next one bound a strip of wall; the last one is a floor
        if area.is_empty:
            break
        next_area = shapely.Polygon() if next_level is None else shape.area[next_level]
        points, faces = triangulate(polygons(area.difference(next_area)))
        deeper = _is_among(points, shapely.get_coordinates(next_area))
        depth = np.where(deeper, shape.depth[-1 if next_level is None else next_level], shape.depth[k])
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
        raise ValueError("a feature without an area has no intermediate shapes")
    mesh = merge_meshes(mesh, Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)))
    keep = np.abs(signed_plan_areas(mesh.vertices, mesh.faces)) > 1e-16
    return add_flat_ring(Mesh(mesh.vertices, mesh.faces[keep]), start)


def _is_among(points: FloatArray, others: FloatArray) -> BoolArray:
    """Return whether (N,) each point (N, 2) is exactly equal to one of ``others`` (M, 2)."""
    other_points = set(map(tuple, others.tolist()))
    return np.array([tuple(point) in other_points for point in points.tolist()], dtype=np.bool_)


def _even_odd_area(rings: list[FloatArray]) -> Any:
    """Return the area that is inside an odd number of rings (K, 2)."""
    area = shapely.Polygon()
    for ring in rings:
        polygon = shapely.Polygon(ring)
        area = area.symmetric_difference(polygon if polygon.is_valid else polygon.buffer(0.0))
    return area


def _sliceable_surface(face: Mesh, height: FloatArray) -> SheetSurface:
    """Return a face with ``height`` (V,) [m] as z, as `slice_levels` needs it; level and border are unset."""
    directed = np.stack([face.faces, np.roll(face.faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, inverse = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    vertices = np.column_stack([face.vertices[:, :2], height])
    no_indices: IntArray = np.zeros(0, dtype=np.int64)
    face_edges = np.reshape(inverse, (-1, 3)).astype(np.int64)
    return SheetSurface(vertices, face.faces, edges, face_edges, no_indices, 0.0, no_indices)
