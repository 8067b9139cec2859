"""Signed distances of points to convex solids, batched; exact inside and outside."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from planner.geometry.shapes import Shape

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class LeastClearance:
    """Least distances ``distance`` (B,) [m], negative inside, and the ``pair`` of bodies of each.

    Where nothing is within the reach that was asked for, the distance is that reach and the pair is ("", "").
    """

    distance: FloatArray
    pair: tuple[tuple[str, str], ...]

    def worst(self) -> int:
        """Index of the least distance."""
        return int(np.argmin(self.distance))


@dataclasses.dataclass(frozen=True, eq=False)
class Solid:
    """A collision solid of a body: ``shape.pose`` is in the body's frame; a mesh stands for its convex
    hull."""

    body: str
    shape: Shape

    @functools.cached_property
    def hull(self) -> tuple[FloatArray, FloatArray]:
        """Half spaces (F, 4), normal and offset, and triangles (F, 3, 3) of a mesh's hull in the shape's
        frame."""
        if self.shape.vertices is None:
            raise ValueError(f"a {self.shape.kind} has no hull")
        hull = ConvexHull(self.shape.vertices)
        return hull.equations, hull.points[hull.simplices]


def extent(solid: Solid) -> FloatArray:
    """Edge lengths (3,) [m] of a box about the origin of the shape's frame that holds the solid."""
    shape = solid.shape
    if shape.vertices is not None:
        return np.asarray(2.0 * np.abs(shape.vertices).max(axis=0))
    if shape.kind == "box":
        return np.asarray(shape.size)
    long = shape.size[1] if len(shape.size) > 1 else 0.0
    caps = 0.0 if shape.kind == "cylinder" else 2.0 * shape.size[0]
    return np.array([2.0 * shape.size[0], 2.0 * shape.size[0], long + caps])


def signed_distance(solid: Solid, points: FloatArray) -> FloatArray:
    """Distances (...,) [m] of points (..., 3) in the shape's frame to its surface, negative inside."""
    kind, size = solid.shape.kind, solid.shape.size
    if kind == "sphere":
        return np.asarray(np.linalg.norm(points, axis=-1) - size[0])
    if kind == "capsule":
        rest = np.maximum(np.abs(points[..., 2]) - 0.5 * size[1], 0.0)
        return np.asarray(np.sqrt(points[..., 0] ** 2 + points[..., 1] ** 2 + rest**2) - size[0])
    if kind == "cylinder":
        side = np.hypot(points[..., 0], points[..., 1]) - size[0]
        cap = np.abs(points[..., 2]) - 0.5 * size[1]
        outside = np.hypot(np.maximum(side, 0.0), np.maximum(cap, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(side, cap), 0.0))
    if kind == "box":
        over = np.abs(points) - 0.5 * np.asarray(size)
        outside = np.linalg.norm(np.maximum(over, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(over.max(axis=-1), 0.0))
    return _hull_distance(solid, points)


def _hull_distance(solid: Solid, points: FloatArray) -> FloatArray:
    planes, triangles = solid.hull
    flat = points.reshape(-1, 3)
    out = (flat @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    outside = np.flatnonzero(out > 0.0)
    for part in np.array_split(outside, max(1, len(outside) * len(triangles) // 200_000)):
        out[part] = _triangle_distance(flat[part, None], triangles[None]).min(axis=1)
    return np.asarray(out.reshape(points.shape[:-1]))


def _triangle_distance(p: FloatArray, triangle: FloatArray) -> FloatArray:
    """Distances of points (..., 3) to triangles (..., 3, 3): to the plane where the foot is inside, else to
    the edges."""
    a, b, c = triangle[..., 0, :], triangle[..., 1, :], triangle[..., 2, :]
    normal = np.cross(b - a, c - a)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    height = np.sum((p - a) * normal, axis=-1)
    inside = np.ones(height.shape, dtype=bool)
    edges = np.full(height.shape, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, ray = end - start, p - start
        inside &= np.sum(np.cross(edge, ray) * normal, axis=-1) >= 0.0
        t = np.clip(np.sum(ray * edge, axis=-1) / np.sum(edge * edge, axis=-1), 0.0, 1.0)
        edges = np.minimum(edges, np.linalg.norm(ray - t[..., None] * edge, axis=-1))
    return np.asarray(np.where(inside, np.abs(height), edges))
