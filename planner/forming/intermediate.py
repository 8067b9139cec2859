"""Shapes between the flat sheet and a steep feature, whose walls are no steeper than a given angle.

The shape is the deepest one that is nowhere deeper than the feature and nowhere steeper than the angle: its
depth at p is the least of depth(q) + tan(a) |p - q| over all q. So each pass only moves the sheet onward.
What is deeper than z + dz is what is deeper than z, shrunk by dz / tan(a), as far as the feature is that
deep: that builds it contour by contour, for any outline, with as many floors as there are.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.forming.feature_surface import joined, plan_areas, polygons, triangulated, with_ring
from planner.forming.slicing import slice_levels
from planner.forming.surface import SheetSurface
from planner.forming.values import FloatArray, IntArray
from planner.problem import Mesh

BoolArray = NDArray[np.bool_]

LEVELS: Final = 80
STEP: Final = (0.2e-3, 1e-3)
"""Contours over the depth, and bounds [m] of their distance."""
PLAIN: Final = 5e-3
"""Contours of the mesh are at most so far apart [m] in height where only the angle limits the shape."""
_SAME: Final = 1e-7
_SLIGHT: Final = 1e-6
_ROUND: Final = 5e-7
_LAST: Final = (0.5, 0.2, 0.05)


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
    step = float(np.clip(total / LEVELS, *STEP))
    between = np.arange(step, total - 0.5 * step, step)
    last = total - step * np.array(_LAST)
    slight = min(_SLIGHT, 1e-3 * total)
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
        plain.append(shrunk.area - both.area <= _SAME * shrunk.area)
        kept.append(both.simplify(_ROUND))
    pieces = [len(polygons(area)) for area in kept]
    ring, last = np.ones(len(depth), dtype=np.bool_), 0
    for k in range(1, len(depth) - 1):
        same = plain[k] and plain[k + 1] and pieces[last] == pieces[k] == pieces[k + 1]
        ring[k] = not same or depth[k + 1] - depth[last] > PLAIN
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
    keep = np.abs(plan_areas(mesh.vertices, mesh.faces)) > 1e-16
    return with_ring(Mesh(mesh.vertices, mesh.faces[keep]), start)


def _among(points: FloatArray, others: FloatArray) -> BoolArray:
    """Which points (N, 2) are exactly one of ``others``."""
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
