"""Wall angle and thickness of a formed sheet, by the sine law, as maps over its mesh.

A place that is moved along z only keeps its area in plan, so its sheet of constant volume becomes as thick
along the normal as t = t0 cos(a) at a wall of angle a: the sine law t = t0 sin(90 deg - a).
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from planner.forming.contact import CREASE
from planner.forming.values import FloatArray, IntArray, Pass
from planner.geometry.closest import corner_normals
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals

STEEP_SHARE: Final = 0.005
"""Share of a wall's area that may be steeper than what counts as its angle: facets of noise and slivers."""


@dataclasses.dataclass(frozen=True)
class Thinnest:
    """The thinnest place: ``thickness`` [m] along the normal, ``point`` (3,) [m], wall ``angle`` [rad]."""

    thickness: float
    point: FloatArray
    angle: float


def wall_angle_map(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Wall angles (V,) [rad] at the vertices, that of the steepest wall where several meet in a crease; 0 for
    vertices of no face."""
    return np.asarray(np.arccos(_least_up(vertices, faces)))


def thickness_map(vertices: FloatArray, faces: IntArray, thickness: float) -> FloatArray:
    """Thicknesses (V,) [m] along the normal of a sheet of ``thickness`` [m] formed in one pass, at a crease
    that of the steepest wall."""
    return np.asarray(thickness * _least_up(vertices, faces))


def thinnest(vertices: FloatArray, faces: IntArray, thickness: float) -> Thinnest:
    """The thinnest place of a sheet of ``thickness`` [m] formed in one pass."""
    up = _least_up(vertices, faces)
    at = int(np.argmin(up))
    return Thinnest(thickness * float(up[at]), vertices[at], float(np.arccos(up[at])))


def steepest(vertices: FloatArray, faces: IntArray) -> float:
    """Wall angle [rad] that all but ``STEEP_SHARE`` of the walls' area (what is not level) stays below."""
    mesh = TriangleMesh(vertices, faces)
    angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
    area = np.where(angle > np.radians(0.5), face_areas(mesh), 0.0)
    if not area.any():
        return 0.0
    order = np.argsort(angle)
    total = np.cumsum(area[order])
    return float(angle[order[int(np.searchsorted(total, (1.0 - STEEP_SHARE) * total[-1]))]])


def by_corner(surface: Pass, thickness: float) -> tuple[FloatArray, IntArray, FloatArray]:
    """The face of a pass with corners of its own for each facet, and its thickness there: vertices (3 F, 3)
    [m], faces (F, 3), thickness (3 F,) [m].

    Across a crease thickness jumps, which values at shared vertices cannot; over smooth faces it is as smooth
    as their normals. ``thickness`` [m] of the flat sheet.
    """
    mesh = TriangleMesh(surface.vertices, surface.faces)
    up = np.clip(corner_normals(mesh, CREASE)[:, :, 2], 0.0, 1.0)
    single = thickness * _least_up(surface.vertices, surface.faces)
    earlier = np.where(single > 0.0, surface.thickness / np.maximum(single, 1e-12), 1.0)
    value = thickness * up * np.minimum(earlier, 1.0)[surface.faces]
    corners = surface.vertices[surface.faces].reshape(-1, 3)
    return corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3), value.reshape(-1)


def _least_up(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """The least z (V,) of the unit normals about each vertex, smooth but over creases, within [0, 1]."""
    up = np.clip(corner_normals(TriangleMesh(vertices, faces), CREASE)[:, :, 2], 0.0, 1.0)
    least = np.ones(len(vertices))
    np.minimum.at(least, faces.reshape(-1), up.reshape(-1))
    return least
