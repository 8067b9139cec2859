"""The face of a sheet that is formed, from its mesh file, in the sheet's frame (x, y across, z up)."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.verify.files.faults import UnreadError
from planner.verify.files.meshed import Face, mesh_face, rims
from planner.verify.files.samples import Samples, on_triangles
from planner.verify.files.values import Said, file_of, pose
from planner.verify.mesh_noise import tolerance_of

FloatArray = NDArray[np.float64]

FLAT: Final = np.cos(np.deg2rad(3.0))
"""Facets whose normals are so near to z may be flats or floors, which tools do not form."""
SPREAD: Final = 1.2
"""Noise of a mesh as found twice, by different means, may differ by this factor."""
NOISY_FLAT: Final = np.cos(np.deg2rad(8.0))
"""The same of the mean of facets about a place, where the mesh has noise."""
ABOUT: Final = 2e-3
"""How far about a place [m] that mean is taken."""
_ACROSS: Final = 0.9
COUNT: Final = 800


@dataclasses.dataclass(frozen=True)
class SheetFace:
    """The face with normals up; ``walls`` are places of what is neither flat nor nearly so. Its vertices may
    be off the face that is meant by the ``tolerance`` [m], as stated or as found here."""

    face: Face
    walls: Samples
    file: str
    tolerance: float = 0.0


def sheet_face(part: Said, claimed: float = 0.0) -> SheetFace:
    """The face of ``sheet_mesh`` where the problem puts it; ``claimed`` [m]: the most that its vertices are
    said to be off the face that is meant. Raises `UnreadError`, which names the file."""
    said = part["sheet_mesh"]
    name = file_of(said).name
    try:
        face = mesh_face({**said, "scale": None, "flip": False})
    except (UnreadError, OSError) as error:
        raise UnreadError(f"{name} cannot be read a second time: {error}") from error
    corners, place = face.corners, part.get("in_stock") or "auto"
    if said.get("frame", "sheet") == "find":
        corners = _levelled(face, corners, bool(said.get("down", True)))
    tolerance = _tolerance(said, face, corners, claimed)
    corners = _up(corners)
    if isinstance(place, str):
        seen = corners.reshape(-1, 3)[:, :2]
        shift = np.append(-0.5 * (seen.min(axis=0) + seen.max(axis=0)), 0.0)
        corners = corners + shift
    else:
        at: Any = pose(place)
        corners = corners @ at[:3, :3].T + at[:3, 3]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if tolerance > 0.0:
        normal = _in_the_mean(corners, normal)
    flat = FLAT if tolerance == 0.0 else NOISY_FLAT
    steep = normal[:, 2] < flat * np.linalg.norm(normal, axis=1)
    if not steep.any():
        raise UnreadError(f"{name} is flat where it was read a second time")
    placed = dataclasses.replace(
        face, vertices=corners.reshape(-1, 3), faces=np.arange(3 * len(corners)).reshape(-1, 3)
    )
    return SheetFace(placed, on_triangles(corners[steep], face.number[steep], COUNT), name, tolerance)


def _tolerance(said: Said, face: Face, corners: FloatArray, claimed: float) -> float:
    """How far [m] the vertices may be off the face that is meant: the user's number, or as they are, if that
    much is claimed."""
    value = said.get("tolerance_mm", "auto")
    if value != "auto":
        return float(value) / 1000.0
    if claimed == 0.0:
        return 0.0
    vertices = np.zeros((len(face.vertices), 3))
    vertices[face.faces] = corners
    return min(claimed, SPREAD * tolerance_of(vertices, face.faces))


def _in_the_mean(corners: FloatArray, normal: FloatArray) -> FloatArray:
    """Of each facet (F, 3, 3) the sum (F, 3) of the ``normal`` (F, 3) of those about it."""
    middle = corners.mean(axis=1)
    edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    tree = cKDTree(middle)
    near = tree.sparse_distance_matrix(tree, max(ABOUT, 1.5 * float(np.median(edge))), output_type="ndarray")
    out = normal.copy()
    for axis in range(3):
        out[:, axis] += np.bincount(near["i"], weights=normal[near["j"], axis], minlength=len(normal))
    return out


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
