"""Triangles of the shapes that a cell is made of, with normals, for the report's pictures."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Solid:
    """Triangles to draw: ``vertices`` (V, 3) [m], unit ``normals`` (V, 3), ``faces`` (F, 3)."""

    vertices: FloatArray
    normals: FloatArray
    faces: IntArray

    def moved(self, pose: FloatArray) -> Solid:
        """The solid moved by a pose (4, 4)."""
        return Solid(self.vertices @ pose[:3, :3].T + pose[:3, 3], self.normals @ pose[:3, :3].T, self.faces)


def box(x: float, y: float, z: float) -> Solid:
    """A box of edges x, y, z [m] about its centre."""
    corners: list[FloatArray] = []
    normals: list[FloatArray] = []
    faces: list[list[int]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            face = np.zeros((4, 3))
            face[:, axis] = sign
            face[:, u] = np.array([-1.0, 1.0, 1.0, -1.0]) * sign
            face[:, v] = [-1.0, -1.0, 1.0, 1.0]
            base = 4 * len(corners)
            corners.append(face)
            normals.append(np.tile(np.eye(3)[axis] * sign, (4, 1)))
            faces += [[base, base + 1, base + 2], [base, base + 2, base + 3]]
    half = 0.5 * np.array([x, y, z])
    return Solid(np.concatenate(corners) * half, np.concatenate(normals), np.array(faces, dtype=np.int64))


def cylinder(radius: float, length: float, sides: int = 32) -> Solid:
    """A cylinder about z, centred, with flat ends."""
    profile = [(0.0, -1.0, 0.0, -1.0), (1.0, -1.0, 0.0, -1.0), (1.0, -1.0, 1.0, 0.0)]
    profile += [(1.0, 1.0, 1.0, 0.0), (1.0, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)]
    rows = np.array(profile) * [radius, 0.5 * length, 1.0, 1.0]
    return _turned(rows, sides)


def capsule(radius: float, length: float, sides: int = 24, rings: int = 6) -> Solid:
    """A capsule about z, centred; ``length`` without the caps."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * rings)
    shift = np.where(angle < 0.0, -0.5, 0.5) * length
    rows = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle) + shift, np.cos(angle), np.sin(angle)], axis=1
    )
    return _turned(rows, sides)


def sphere(radius: float, sides: int = 24) -> Solid:
    """A sphere about the origin."""
    return capsule(radius, 0.0, sides)


def mesh(vertices: FloatArray, faces: IntArray, smooth: bool = False) -> Solid:
    """A mesh; faceted, or ``smooth`` with area-weighted vertex normals."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if smooth:
        normals = np.zeros_like(vertices)
        for k in range(3):
            np.add.at(normals, faces[:, k], normal)
        return Solid(vertices, _unit(normals), faces)
    flat = np.arange(3 * len(faces), dtype=np.int64).reshape(-1, 3)
    return Solid(corners.reshape(-1, 3), np.repeat(_unit(normal), 3, axis=0), flat)


def tube(points: FloatArray, radius: float, sides: int = 10) -> Solid:
    """A tube about a polyline (P, 3), with frames carried along it without turning."""
    tangent = _unit(np.gradient(points, axis=0))
    side = np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))])
    rings = np.empty((len(points), 3))
    for i, t in enumerate(tangent):
        side = side - t * (side @ t)
        side /= np.linalg.norm(side)
        rings[i] = side
    other = np.cross(tangent, rings)
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    normals = np.cos(angle)[:, None] * rings[:, None] + np.sin(angle)[:, None] * other[:, None]
    vertices = points[:, None] + radius * normals
    return Solid(vertices.reshape(-1, 3), normals.reshape(-1, 3), _grid(len(points), sides))


def merge(solids: list[Solid]) -> Solid:
    """All solids as one."""
    starts = np.cumsum([0, *(len(s.vertices) for s in solids[:-1])])
    return Solid(
        np.concatenate([s.vertices for s in solids]),
        np.concatenate([s.normals for s in solids]),
        np.concatenate([s.faces + start for s, start in zip(solids, starts, strict=True)]),
    )


def _turned(rows: FloatArray, sides: int) -> Solid:
    """A body of revolution about z of rows (radius, z, normal's radius, normal's z), from below upward."""
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    c, s = np.cos(angle), np.sin(angle)

    def spin(radius: FloatArray, z: FloatArray) -> FloatArray:
        ones = np.ones(sides)
        return np.stack([np.outer(radius, c), np.outer(radius, s), np.outer(z, ones)], axis=-1).reshape(-1, 3)

    return Solid(spin(rows[:, 0], rows[:, 1]), spin(rows[:, 2], rows[:, 3]), _grid(len(rows), sides))


def _grid(rows: int, sides: int) -> IntArray:
    """Faces (2 (rows - 1) sides, 3) of rings of vertices, each ring closed."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(sides), indexing="ij")
    a, b = i * sides + j, i * sides + (j + 1) % sides
    c, d = a + sides, b + sides
    return np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30))
