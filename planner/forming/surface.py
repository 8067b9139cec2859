"""What a mesh must be before features are looked for: one open surface over the sheet plane, level at its
edge."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.forming.values import FloatArray, IntArray
from planner.geometry.mesh import TriangleMesh, check_surface
from planner.geometry.outlines import sides
from planner.issues import Issue, TandemError
from planner.units import MM

OVERHANG: Final = 25e-6
"""Depth [m] by which faces may turn over: what noise of the vertices does to a vertical wall."""


@dataclasses.dataclass(frozen=True)
class SheetSurface:
    """A checked surface: ``vertices`` (V, 3) [m], all of them used, ``faces`` (F, 3) with normals up,
    ``edges`` (E, 2) with the lower index first, ``face_edges`` (F, 3) the edges from corner 0 to 1, 1 to 2, 2
    to 0, ``border`` (B,) vertices along the edge of the part, ``level`` [m] of the flat sheet, ``used`` (V,)
    indices of the vertices in the mesh that was given.
    """

    vertices: FloatArray
    faces: IntArray
    edges: IntArray
    face_edges: IntArray
    border: IntArray
    level: float
    used: IntArray


def check(vertices: FloatArray, faces: IntArray, noise: float) -> SheetSurface:
    """The surface of a part, checked. ``noise`` [m]: departure from the flat that its edge may have.

    Normals may all point up or all down. Raises ``TandemError``: ``mesh.*`` for what is no open oriented
    surface in one piece, ``forming.touching`` where parts of it meet in a single vertex, ``forming.hole``,
    ``forming.border`` where its edge leaves the sheet plane, ``forming.undercut`` where it turns over.
    """
    used, compact = np.unique(faces, return_inverse=True)
    faces = np.asarray(compact).reshape(-1, 3).astype(np.int64)
    vertices = np.ascontiguousarray(vertices[used], dtype=np.float64)
    if len(faces) == 0:
        raise TandemError(Issue("mesh.empty", "the part has no faces; export its surface", field="part"))
    found = check_surface(TriangleMesh(vertices, faces), "part")
    if found:
        raise TandemError(found)
    if np.sum(_plan_areas(vertices, faces)) < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    low, high = np.sort(directed, axis=1).T
    key, inverse, count = np.unique(low * len(vertices) + high, return_inverse=True, return_counts=True)
    edges, inverse = np.stack(np.divmod(key, len(vertices)), axis=1), np.reshape(inverse, -1)
    outer = _outer_border(vertices, faces, directed[count[inverse] == 1])
    level = float(np.median(vertices[outer, 2]))
    off = np.abs(vertices[outer, 2] - level)
    if off.max() >= noise:
        raise TandemError(_border(vertices[outer[int(np.argmax(off))]], level, noise))
    turned = _undercut(vertices, faces, edges, inverse.reshape(-1, 3))
    if turned is not None:
        raise TandemError(turned)
    return SheetSurface(vertices, faces, edges, inverse.reshape(-1, 3), outer, level, used)


def plan_areas(surface: SheetSurface) -> FloatArray:
    """Areas (F,) [m^2] of the faces seen from above, not negative."""
    return np.maximum(_plan_areas(surface.vertices, surface.faces), 0.0)


class Beyond:
    """Asked for the plan area [m^2] of what of the faces around some vertices lies beyond a level [m], on the
    side on which the first of them is."""

    def __init__(self, surface: SheetSurface) -> None:
        self.surface, self.area = surface, plan_areas(surface)
        corners = surface.faces.reshape(-1)
        self.order = np.argsort(corners, kind="stable") // 3
        self.begin = np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=len(surface.vertices)))])

    def __call__(self, members: list[int], level: float) -> float:
        """``members``: indices of vertices; one past the last, which closes the surface, has no faces."""
        height, count = self.surface.vertices[:, 2], len(self.surface.vertices)
        own = [member for member in members if member < count]
        if not own:
            return 0.0
        faces = np.unique(np.concatenate([self.order[self.begin[m] : self.begin[m + 1]] for m in own]))
        sign = 1.0 if height[own[0]] >= level else -1.0
        low, middle, high = np.sort(sign * (height[self.surface.faces[faces]] - level), axis=1).T
        tip = high**2 / np.maximum((high - low) * (high - middle), 1e-300)
        base = 1.0 - low**2 / np.maximum((high - low) * (middle - low), 1e-300)
        share = np.where(low >= 0.0, 1.0, np.where(middle >= 0.0, base, np.where(high > 0.0, tip, 0.0)))
        return float(np.sum(share * self.area[faces]))


def where(point: FloatArray) -> str:
    """A place (2 or 3,) [m] as a person reads it."""
    return "(" + ", ".join(f"{value / MM:.2f}" for value in point) + ") mm"


def _plan_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    a, b, c = (vertices[faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    return np.asarray(0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))


def _joined(faces: IntArray, vertex: int) -> bool:
    """Whether all faces around a vertex belong to one piece that hangs together by edges."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    owner = np.repeat(np.arange(len(faces)), 3)
    graph = coo_array((np.ones(len(owner)), (owner, np.reshape(edge, -1)))).tocsr()
    _, piece = connected_components(graph @ graph.T, directed=False)
    return len(np.unique(piece[(faces == vertex).any(axis=1)])) == 1


def _outer_border(vertices: FloatArray, faces: IntArray, rim: IntArray) -> IntArray:
    """Vertices of the outer one of the closed lines of edges (R, 2) with one face. Any other is a hole."""
    count = len(vertices)
    starts = np.bincount(rim[:, 0], minlength=count)
    if (starts > 1).any():
        vertex = int(np.argmax(starts > 1))
        at = vertices[vertex]
        if _joined(faces, vertex):
            what = (
                f"holes of the part, or one and its edge, meet in a point at {where(at)}; a sheet is formed "
            )
            what += "whole, so close them and cut them afterwards"
            raise TandemError(Issue("forming.hole", what, field="part"))
        raise TandemError(
            Issue(
                "forming.touching",
                f"two pieces of the part meet in a single point at {where(at)} with no sheet between them, "
                "so they cannot be told apart; move them apart, or join them by a strip of flat sheet",
                field="part",
            )
        )
    graph = coo_array((np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    a, b = vertices[rim[:, 0], :2], vertices[rim[:, 1], :2]
    doubled = np.bincount(label[rim[:, 0]], weights=a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    loops = np.unique(label[rim[:, 0]])
    # the outer line has the part on its left and so a positive area; so that a fold cannot mislead, the
    # largest
    outer = loops[np.argmax(np.abs(doubled[loops]))]
    holes = loops[loops != outer]
    if len(holes):
        raise TandemError([_hole(vertices[rim[label[rim[:, 0]] == hole, 0]]) for hole in holes[:10]])
    return np.asarray(np.unique(rim[label[rim[:, 0]] == outer]))


def _hole(points: FloatArray) -> Issue:
    middle, size = points.mean(axis=0), max(sides(points[:, :2])[0], float(np.ptp(points[:, 2])))
    return Issue(
        "forming.hole",
        f"the part has a hole, {size / MM:.3g} mm across, at {where(middle)}; a sheet is formed whole, so "
        "close it (or, where it is a crack between facets, sew the mesh) and cut it afterwards",
        field="part",
        value=size / MM,
        unit="mm",
    )


def _border(point: FloatArray, level: float, noise: float) -> Issue:
    off = abs(float(point[2]) - level) / MM
    return Issue(
        "forming.border",
        f"the edge of the part is {off:.3f} mm off the flat sheet at {where(point)}, at most "
        f"{noise / MM:.3f} mm is allowed, so that its contours would end there; extend the part by a surface "
        "that runs out into the sheet plane",
        field="part",
        value=off,
        limit=noise / MM,
        unit="mm",
    )


def _undercut(vertices: FloatArray, faces: IntArray, edges: IntArray, face_edges: IntArray) -> Issue | None:
    """The worst group of joined faces that turn over. Its overhang is its plan area over the root of its
    area: a wall of length and height L that leans over by the angle a has L sin(a).
    """
    plan = _plan_areas(vertices, faces)
    turned = np.nonzero(plan < 0.0)[0]
    if len(turned) == 0:
        return None
    a, b, c = (vertices[faces[turned, i]] for i in range(3))
    normal = 0.5 * np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    owner = np.repeat(np.arange(len(turned)), 3)
    incidence = coo_array(
        (np.ones(len(owner)), (owner, face_edges[turned].reshape(-1))), shape=(len(turned), len(edges))
    ).tocsr()
    _, label = connected_components(incidence @ incidence.T, directed=False)
    flat, full = np.bincount(label, weights=-plan[turned]), np.bincount(label, weights=area)
    overhang = flat / np.sqrt(np.maximum(full, 1e-300))
    worst = int(np.argmax(overhang))
    if overhang[worst] <= OVERHANG:
        return None
    mine = label == worst
    most = np.nonzero(mine)[0][int(np.argmin((normal[:, 2] / np.maximum(area, 1e-300))[mine]))]
    angle = math.degrees(math.acos(np.clip(normal[most, 2] / area[most], -1.0, 1.0)))
    at = vertices[faces[turned[most]]].mean(axis=0)
    groups = int((overhang > OVERHANG).sum())
    return Issue(
        "forming.undercut",
        f"the part turns over in {groups} place{'s' if groups > 1 else ''}: a wall of {angle:.1f} deg at "
        f"{where(at)}, walls up to 90 deg can be formed; take the undercut out of the part, or turn the part",
        field="part",
        value=angle,
        limit=90.0,
        unit="deg",
        count=groups,
    )
