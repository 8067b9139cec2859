"""Two families of lines over a surface along which it can be laid out in planar quads.

Directions a and b at a point are conjugate where II(a, b) = 0, II the second fundamental form: quads along
them are planar up to third order (Y. Liu and others, General planar quadrilateral mesh design using conjugate
direction field, ACM TOG 30, 2011). Principal directions are conjugate and square to each other, but turn
about umbilics; other conjugate ones go on, so the field here is smooth, conjugate, and as square as that
allows. Its angles are plain numbers over the whole surface, so it has no singularities.

Coordinates u and v then follow the field: lines of v run along a, those of u along b.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse import block_array, coo_array, csc_array, csr_array, diags_array
from scipy.spatial import KDTree

from planner.geometry.arrays import FloatArray, IntArray, dots, unit
from planner.geometry.even_points import FineSurface, bending
from planner.geometry.guided_projection import symmetric_factor
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals

_ASKED: Final = 3
"""Places in each cell, one way, where the surface's bending is fitted."""
_ODD: Final = 0.3819
"""Where those places are taken begins so much of a cell before the first vertex, as meshes are regular."""
_ROUNDS: Final = 12
"""Rounds of Gauss-Newton for the field."""
_STILL: Final = 1e-4
"""Angles [rad] that change by less are found."""
_SQUARE: Final = 0.2
"""How much it counts that directions are square to each other; that they are conjugate counts 1."""
_OPEN: Final = 0.766
"""Sine of the angle between directions, of 50 degrees, under which it counts more."""
_FIRM: Final = 3.0
"""How much it counts then."""
_REACH: Final = 2.0
"""Over how many spacings the field is smooth."""
_ALONG: Final = 6.0
"""How much more it counts that coordinates follow the field than that their steps are even."""


@dataclasses.dataclass(frozen=True)
class Layout:
    """A surface laid out flat: ``at`` (V, 2) [m], the coordinates of its vertices, near to lengths."""

    surface: FineSurface
    at: FloatArray

    def folded(self) -> IntArray:
        """Faces that come out turned over."""
        a, b, c = (self.at[self.surface.mesh.faces[:, i]] for i in range(3))
        one, two = b - a, c - a
        return np.flatnonzero(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0] <= 0.0)


def layout(surface: FineSurface) -> Layout:
    """Coordinates of a surface along conjugate directions; faces that fold over stay in the result."""
    normal, form, frame = _bent(surface)
    a, b = _directions(surface, normal, form, frame)
    faces = surface.mesh.faces
    up = face_normals(surface.mesh)
    at = []
    for along, still in ((a, b), (b, a)):
        way, line = (unit(v[faces].mean(axis=1)) for v in (along, still))
        line = unit(line - dots(line, up)[:, None] * up)
        across = np.cross(up, line)
        across *= np.sign(dots(across, way))[:, None]
        at.append(_coordinate(surface.mesh, line, across))
    return Layout(surface, np.stack(at, axis=1))


def _bent(surface: FineSurface) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normals (V, 3), the second fundamental form (V, 2, 2) [1/m] and its axes (V, 2, 3)."""
    vertices = surface.mesh.vertices
    cell = surface.spacing / _ASKED
    # one vertex in each cube that has some: enough places, and the same ones wherever the mesh is cut finer
    _, some = np.unique(np.floor((vertices - vertices.min(axis=0)) / cell + _ODD), axis=0, return_index=True)
    some = np.sort(some)
    cells = max(1, round(float(surface.area.sum()) / surface.spacing**2))
    found = [
        bending(surface, part, cells) for part in np.array_split(vertices[some], max(1, len(some) // 1000))
    ]
    known, curvature, way = (np.concatenate(rows) for rows in zip(*found, strict=True))
    near = np.asarray(KDTree(vertices[some]).query(vertices, k=min(4, len(some)))[1]).reshape(
        len(vertices), -1
    )
    tensor = np.einsum("nk,nki,nkj->nij", curvature, way, way)[near].mean(axis=1)
    normal = unit(known[near].sum(axis=1))
    # the axis that normals are farthest from: frames turn least
    axis = np.linalg.eigh(normal.T @ normal)[1][:, 0]
    one = axis - (normal @ axis)[:, None] * normal
    poor = np.linalg.norm(one, axis=1) < 1e-3
    one[poor] = np.cross(normal[poor], np.roll(normal[poor], 1, axis=1))
    one = unit(one)
    frame = np.stack([one, np.cross(normal, one)], axis=1)
    return normal, np.einsum("nai,nij,nbj->nab", frame, tensor, frame), frame


def _directions(
    surface: FineSurface, normal: FloatArray, form: FloatArray, frame: FloatArray
) -> list[FloatArray]:
    """Both directions, each (V, 3), at the vertices: their angles by Gauss-Newton."""
    count = len(normal)
    edge, hold = _edges(surface.mesh)
    i, j = edge.T
    # each frame, turned as the normal turns, against its neighbour's
    mean = unit(normal[i] + normal[j])
    first = frame[i, 0] - 2.0 * dots(frame[i, 0], mean)[:, None] * mean
    first = first - 2.0 * dots(first, normal[j])[:, None] * normal[j]
    turn = np.arctan2(dots(first, frame[j, 1]), dots(first, frame[j, 0]))
    rows = np.tile(np.arange(len(edge)), 2)
    change = csr_array(
        (np.concatenate([hold, -hold]), (rows, np.concatenate([j, i]))), shape=(len(edge), count)
    )
    both = block_array([[change, None], [None, change]], format="csr")
    smooth, right = both.T @ both, both.T @ np.tile(hold * turn, 2)
    scale = float(np.sqrt(np.average((form**2).sum(axis=(1, 2)), weights=surface.area)))
    form = form / max(scale, 1e-9)
    weight = np.sqrt(surface.area) / (_REACH * surface.spacing)
    angle = np.repeat(_steady(form, surface.area), count)
    every = np.arange(2 * count).reshape(2, count)
    where = (np.repeat(every, 2, axis=0).reshape(-1), np.tile(every, (2, 1)).reshape(-1))
    for _ in range(_ROUNDS):
        rest, slope = _wishes(form, angle[:count], angle[count:])
        own = np.einsum("rkn,rln->kln", weight * slope, weight * slope)
        square = csc_array(smooth + coo_array((own.reshape(-1), where), shape=smooth.shape))
        down = np.einsum("rkn,rn->kn", weight * slope, weight * rest).reshape(-1) + smooth @ angle - right
        step = symmetric_factor(csc_array(square + 1e-6 * diags_array(np.ones(2 * count)))).solve(down)
        angle = angle - step
        if float(np.abs(step).max()) < _STILL:
            break
    return [
        np.cos(v)[:, None] * frame[:, 0] + np.sin(v)[:, None] * frame[:, 1]
        for v in (angle[:count], angle[count:])
    ]


def _wishes(form: FloatArray, alpha: FloatArray, beta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What is left (3, V) of wishes for two directions by their angles, and its slopes (3, 2, V): conjugate,
    square to each other, and not too near to each other."""
    a, b = (np.stack([np.cos(v), np.sin(v)], axis=1) for v in (alpha, beta))
    da, db = (np.stack([-np.sin(v), np.cos(v)], axis=1) for v in (alpha, beta))
    off, by_a, by_b = (np.einsum("na,nab,nb->n", p, form, q) for p, q in ((a, b), (da, b), (a, db)))
    sine, cosine = np.sin(beta - alpha), np.cos(beta - alpha)
    low = _FIRM * (sine < _OPEN)
    rest = np.stack([off, _SQUARE * cosine, low * (_OPEN - sine)])
    grow = np.stack([_SQUARE * sine, low * cosine])
    return rest, np.stack([np.stack([by_a, *grow]), np.stack([by_b, *-grow])], axis=1)


def _steady(form: FloatArray, area: FloatArray) -> FloatArray:
    """The pair of angles (2,) that is best where all of the surface has the same."""
    angle = np.deg2rad(np.arange(0.0, 180.0, 7.5))
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # the mean of II(a, b)^2, from that of its products
    square = np.einsum("n,nab,ncd->abcd", area / area.sum(), form, form)
    cost = np.einsum("pa,qb,abcd,pc,qd->pq", way, way, square, way, way)
    apart = angle[None, :] - angle[:, None]
    low = _FIRM * (np.sin(apart) < _OPEN)
    cost = cost + (_SQUARE * np.cos(apart)) ** 2 + (low * (_OPEN - np.sin(apart))) ** 2
    p, q = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return np.array([angle[p], angle[q]])


def _edges(mesh: TriangleMesh) -> tuple[IntArray, FloatArray]:
    """Edges (E, 2), and the root of how much each counts in a sum that stands for an integral of slopes."""
    faces = mesh.faces
    sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edge, back = np.unique(sides, axis=0, return_inverse=True)
    beside = np.bincount(np.reshape(back, -1), np.repeat(face_areas(mesh), 3))
    length = np.linalg.norm(mesh.vertices[edge[:, 1]] - mesh.vertices[edge[:, 0]], axis=1)
    return edge, np.sqrt(2.0 / 3.0 * beside) / np.maximum(length, 1e-9)


def _coordinate(mesh: TriangleMesh, line: FloatArray, across: FloatArray) -> FloatArray:
    """Values (V,) that are even along ``line`` (F, 3) and grow with the length along ``across`` (F, 3)."""
    faces, corner = mesh.faces, mesh.vertices[mesh.faces]
    area = face_areas(mesh)
    up = face_normals(mesh)
    slope = np.cross(up[:, None], np.roll(corner, 1, axis=1) - np.roll(corner, -1, axis=1))
    slope = slope / np.maximum(2.0 * area, 1e-300)[:, None, None]
    count, every = len(mesh.vertices), np.arange(len(faces))
    square, right = csc_array((count, count)), np.zeros(count)
    for way, gain, wanted in ((line, _ALONG, 0.0), (across, 1.0, 1.0)):
        value = gain * np.sqrt(area)[:, None] * np.einsum("fki,fi->fk", slope, way)
        rows = csr_array(
            (value.reshape(-1), (np.repeat(every, 3), faces.reshape(-1))), shape=(len(faces), count)
        )
        square = square + csc_array(rows.T @ rows)
        right = right + rows.T @ (wanted * gain * np.sqrt(area))
    matrix = csc_array(square + 1e-9 * diags_array(square.diagonal()))
    return np.asarray(symmetric_factor(matrix).solve(right))
