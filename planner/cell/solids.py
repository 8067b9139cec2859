"""Our shapes as Drake's."""

from __future__ import annotations

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    InMemoryMesh,
    Mesh,
    Sphere,
)
from pydrake.geometry import Shape as DrakeShape

from planner.geometry.shapes import Shape


def drake_shape(shape: Shape, solid: bool) -> DrakeShape:
    """Drake's shape; a mesh becomes its convex hull when ``solid`` (for collision), else the mesh itself
    (to be seen).

    Raises ``ValueError`` for a mesh without vertices.
    """
    if shape.kind == "box":
        return Box(*shape.size)
    if shape.kind == "cylinder":
        return Cylinder(*shape.size)
    if shape.kind == "capsule":
        return Capsule(*shape.size)
    if shape.kind == "sphere":
        return Sphere(*shape.size)
    if shape.vertices is None or shape.faces is None:
        raise ValueError("a mesh shape needs vertices and faces")
    text = _obj(shape.vertices, shape.faces)
    memory = InMemoryMesh(mesh_file=MemoryFile(text, ".obj", "mesh.obj"))
    return Convex(memory) if solid else Mesh(memory)


def _obj(vertices: np.ndarray, faces: np.ndarray) -> str:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces.tolist()]
    return "\n".join(lines) + "\n"
