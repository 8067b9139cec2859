"""Faces as meshes of vertices: from files and lofts, moved inwards, and what joins their edges."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.verify.files.faults import UnreadError
from planner.verify.files.guides import Ruled, joined, through
from planner.verify.files.meshes import read_facets
from planner.verify.files.splines import bezier, blended, bspline
from planner.verify.files.values import UNITS, Said, file_of, metres, radians, row

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CELLS: Final = (40, 400)
"""Fewest and most cells of a loft along each of its parameters."""
SAG: Final = 1e-5
"""How far cells may be off the loft [m], where the most of them are enough."""
_NEAR: Final = 1e-5
"""Step of a loft's parameters by which its normals are found."""
_ALIKE: Final = 1e-9
"""Vertices so near, of the mesh's extent, are one."""
_CORNER: Final = 20.0 * np.pi / 180.0


@dataclasses.dataclass(frozen=True)
class Face:
    """``vertices`` (V, 3) [m] with unit normals ``up`` (V, 3), ``faces`` (F, 3), ``number`` (F,) of each in
    its file, from 1."""

    vertices: FloatArray
    up: FloatArray
    faces: IntArray
    number: IntArray

    @property
    def corners(self) -> FloatArray:
        """Corners (F, 3, 3) of the triangles."""
        return self.vertices[self.faces]


def mesh_face(said: Said) -> Face:
    """The face of a mesh file in its stated unit, scaled, turned over where that is wanted. Raises
    `UnreadError`."""
    found = read_facets(file_of(said))
    corners = found.corners * UNITS[str(said["unit"])] * float(said.get("scale") or 1.0)
    corners = corners[:, ::-1] if said.get("flip") else corners
    low = corners.reshape(-1, 3).min(axis=0)
    step = max(float((corners.reshape(-1, 3).max(axis=0) - low).max()) * _ALIKE, 1e-15)
    grid = np.rint((corners.reshape(-1, 3) - low) / step).astype(np.int64)
    _, first, index = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    vertices, faces = corners.reshape(-1, 3)[first], index.reshape(-1, 3).astype(np.int64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    kept = np.linalg.norm(cross, axis=1) > step * step
    faces, number = faces[kept], found.row[kept]
    if not len(faces):
        raise UnreadError("all its faces have no area")
    return Face(vertices, _normals(vertices, faces), faces, number)


def loft_face(said: Said) -> Face:
    """The face of a loft on a grid of exact places with exact normals."""
    region = said.get("region") or {}
    u0, u1 = (float(v) for v in region.get("u") or (0.0, 1.0))
    v0, v1 = (float(v) for v in region.get("v") or (0.0, 1.0))
    cells = _cells(said, (u0, u1), (v0, v1))
    u, v = _grid((u0, u1), (v0, v1), cells)
    points = loft_points(said, u, v)
    along = loft_points(said, u + _NEAR, v) - loft_points(said, u - _NEAR, v)
    across = loft_points(said, u, v + _NEAR) - loft_points(said, u, v - _NEAR)
    up = np.cross(along, across)
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-300)
    index = np.arange(len(u)).reshape(cells + 1, cells + 1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    if said.get("flip"):
        up, faces = -up, faces[:, ::-1]
    return Face(points, up, faces, np.arange(1, len(faces) + 1))


def _grid(u: tuple[float, float], v: tuple[float, float], cells: int) -> tuple[FloatArray, FloatArray]:
    grid = np.meshgrid(np.linspace(*u, cells + 1), np.linspace(*v, cells + 1), indexing="ij")
    return grid[0].reshape(-1), grid[1].reshape(-1)


def _cells(said: Said, u: tuple[float, float], v: tuple[float, float]) -> int:
    """How many cells keep within `SAG`: what they are off falls with the square of their size."""
    least, most = CELLS
    at = loft_points(said, *_grid(u, v, least)).reshape(least + 1, least + 1, 3)
    off = [at[1:-1:2] - 0.5 * (at[:-1:2] + at[2::2]), at[:, 1:-1:2] - 0.5 * (at[:, :-1:2] + at[:, 2::2])]
    off.append(at[1:-1:2, 1:-1:2] - 0.5 * (at[:-1:2, :-1:2] + at[2::2, 2::2]))
    far = max(float(np.linalg.norm(one, axis=2).max()) for one in off)
    return int(np.clip(0.5 * least * np.sqrt(far / SAG), least, most))


def loft_points(said: Said, u: FloatArray, v: FloatArray) -> FloatArray:
    """Places (N, 3) [m] of a loft at u along its row of curves and v along each curve (N,)."""
    rail = said.get("rail")
    curves = said.get("sections") if rail is None else said.get("profiles")
    kind = "bezier_mm" if curves[0].get("bezier_mm") is not None else "bspline_mm"  # type: ignore[index]
    at = np.array([float(curve["at"]) for curve in curves])  # type: ignore[union-attr]
    control = blended(at, np.stack([row(curve[kind]) for curve in curves]), u)  # type: ignore[union-attr]
    points = (bezier if kind == "bezier_mm" else bspline)(control, v)
    if rail is None:
        return points
    angle = radians(rail["start_deg"]) + u * (radians(rail["end_deg"]) - radians(rail["start_deg"]))
    out = metres(rail["radius_mm"]) + points[:, 0]
    centre = [metres(value) for value in rail.get("centre_mm") or (0.0, 0.0, 0.0)]
    return np.column_stack([out * np.cos(angle), out * np.sin(angle), points[:, 1]]) + centre


def behind(front: Face, depth: float) -> Face:
    """The front moved inwards by ``depth`` [m], facing the other way."""
    return Face(front.vertices - depth * front.up, -front.up, front.faces[:, ::-1], front.number)


def rims(face: Face) -> IntArray:
    """Edges (E, 2) of one triangle only, with the face on their left."""
    edges = np.concatenate([face.faces[:, [i, (i + 1) % 3]] for i in range(3)])
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(edges[np.sort(first[count == 1])])


def edges_of(front: Face, back: Face, moved: bool) -> list[Ruled]:
    """The ruled edges between the rims of both faces, point to point where the back is the front ``moved``,
    else by the way along both; empty where a face has not one rim."""
    loops = [_loop(rims(face)) for face in (front, back)]
    if loops[0] is None or loops[1] is None:
        return []
    first = loops[0][::-1]  # against the front's sense, x the way to the back, points away from the part
    start = front.vertices[first]
    if moved:
        ring = np.append(first, first[0])
        return [Ruled(front.vertices[ring], back.vertices[ring])]
    one, other = through(start, True, _CORNER), through(back.vertices[loops[1]], True, _CORNER)
    return joined(one, other, "arc_length")


def _loop(edges: IntArray) -> IntArray | None:
    """The vertices of one closed line of edges in their order, None where there are several."""
    onward = dict(edges.tolist())
    if not len(edges) or len(onward) != len(edges):
        return None
    out = [int(edges[0, 0])]
    while (follow := onward.get(out[-1])) is not None and follow != out[0] and len(out) <= len(edges):
        out.append(follow)
    return np.array(out, dtype=np.int64) if len(out) == len(edges) else None


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals (V, 3), each triangle's weighted by its angle at the vertex."""
    out = np.zeros_like(vertices)
    for k in range(3):
        here, after, before = (vertices[faces[:, (k + i) % 3]] for i in range(3))
        one, other = after - here, before - here
        normal = np.cross(one, other)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        angle = np.arctan2(size[:, 0], np.einsum("ij,ij->i", one, other))
        np.add.at(out, faces[:, k], angle[:, None] * normal / np.maximum(size, 1e-300))
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300))
