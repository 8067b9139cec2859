"""The face of a sheet that is formed, from its mesh file, in the sheet's frame (x, y across, z up)."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.verify.files.faults import UnreadError
from planner.verify.files.meshed import Face, mesh_face, rims
from planner.verify.files.samples import Samples, on_triangles
from planner.verify.files.values import Said, file_of, pose

FloatArray = NDArray[np.float64]

FLAT: Final = np.cos(np.deg2rad(3.0))
"""Facets whose normals are so near to z may be flats or floors, which tools do not form."""
_ACROSS: Final = 0.9
COUNT: Final = 800


@dataclasses.dataclass(frozen=True)
class SheetFace:
    """The face with normals up; ``walls`` are places of what is neither flat nor nearly so."""

    face: Face
    walls: Samples
    file: str


def sheet_face(part: Said) -> SheetFace:
    """The face of ``sheet_mesh`` where the problem puts it. Raises `UnreadError`, which names the file."""
    said = part["sheet_mesh"]
    name = file_of(said).name
    try:
        face = mesh_face({**said, "scale": None, "flip": False})
    except (UnreadError, OSError) as error:
        raise UnreadError(f"{name} cannot be read a second time: {error}") from error
    corners, place = face.corners, part.get("in_stock") or "auto"
    if said.get("frame", "sheet") == "find":
        corners = _levelled(face, corners, bool(said.get("down", True)))
    corners = _up(corners)
    if isinstance(place, str):
        seen = corners.reshape(-1, 3)[:, :2]
        shift = np.append(-0.5 * (seen.min(axis=0) + seen.max(axis=0)), 0.0)
        corners = corners + shift
    else:
        at: Any = pose(place)
        corners = corners @ at[:3, :3].T + at[:3, 3]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    steep = normal[:, 2] < FLAT * np.linalg.norm(normal, axis=1)
    if not steep.any():
        raise UnreadError(f"{name} is flat where it was read a second time")
    placed = dataclasses.replace(
        face, vertices=corners.reshape(-1, 3), faces=np.arange(3 * len(corners)).reshape(-1, 3)
    )
    return SheetFace(placed, on_triangles(corners[steep], face.number[steep], COUNT), name)


def _levelled(face: Face, corners: FloatArray, down: bool) -> FloatArray:
    """The triangles seen from the plane of their rim: its middle the origin, the part below it or above."""
    rim = face.vertices[np.unique(rims(face))]
    middle = rim.mean(axis=0)
    up = np.linalg.eigh((rim - middle).T @ (rim - middle))[1][:, 0]
    height = (corners.reshape(-1, 3) - middle) @ up
    if (height[np.abs(height).argmax()] > 0.0) == down:
        up = -up
    along = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < _ACROSS else np.array([0.0, 1.0, 0.0])
    along = along - (along @ up) * up
    along = along / np.linalg.norm(along)
    return np.asarray((corners - middle) @ np.column_stack([along, np.cross(up, along), up]))


def _up(corners: FloatArray) -> FloatArray:
    """The triangles with their normals up."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    over = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    size = np.linalg.norm(np.cross(a, b), axis=1)
    return corners if size[over > 0.0].sum() >= 0.5 * size.sum() else corners[:, ::-1]
