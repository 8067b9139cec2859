"""Rigid shapes: boxes, round bodies and meshes, of which tools, obstacles and fixtures are made."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ShapeKind = Literal["box", "cylinder", "capsule", "sphere", "mesh"]


@dataclasses.dataclass(frozen=True)
class Shape:
    """A rigid shape at ``pose`` (4, 4) in the frame of the thing that it belongs to.

    ``size`` [m]: box (x, y, z); cylinder and capsule (radius, length along z, a capsule's without its caps);
    sphere (radius,); mesh () with ``vertices`` (V, 3) and ``faces`` (F, 3), its collision shape being the
    convex hull.
    """

    kind: ShapeKind
    size: tuple[float, ...]
    pose: FloatArray
    vertices: FloatArray | None = None
    faces: NDArray[np.int64] | None = None


def corners(shape: Shape) -> FloatArray:
    """Points (K, 3) [m] whose hull holds a shape, in its own frame."""
    if shape.vertices is not None:
        return shape.vertices
    if shape.kind == "box":
        half = 0.5 * np.array(shape.size)
    else:
        radius = shape.size[0]
        length = shape.size[1] if len(shape.size) > 1 else 0.0
        cap = radius if shape.kind in ("capsule", "sphere") else 0.0
        half = np.array([radius, radius, 0.5 * length + cap])
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return np.asarray(signs * half)


def axis_ends(shape: Shape) -> FloatArray:
    """Both ends (2, 3) [m] of the axis of a cylinder, or of a capsule without its caps, in the frame of the
    thing that it belongs to."""
    local = np.array([[0.0, 0.0, -0.5 * shape.size[1]], [0.0, 0.0, 0.5 * shape.size[1]]])
    return np.asarray(local @ shape.pose[:3, :3].T + shape.pose[:3, 3])
