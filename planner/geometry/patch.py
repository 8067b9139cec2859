"""Surfaces over the unit square: a region of a loft, or a mesh with four corners laid out flat.

A mesh is laid out by mean value coordinates (M. S. Floater, Mean value coordinates, CAGD 20, 2003): its
boundary goes round the square by arc length, every inner vertex is the weighted mean of its neighbours, and
no facet folds over.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import spsolve

from planner.geometry.curves import Loft
from planner.geometry.edges import boundaries
from planner.geometry.guides import along, arc_length, turns
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, TandemError
from planner.units import DEG

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


_NEAR = 1e-5
"""Parameters that differ by less are one place."""


@dataclasses.dataclass(frozen=True)
class Patch:
    """A surface: ``points`` gives (..., 3) at u and v (...,) in [0, 1]; ``mesh`` is the same surface with
    normals away from the part. ``right``: dS/du x dS/dv points away from the part. ``edges`` (E, 2, 2): u and
    v of both ends of the edges between its facets, where it has such.
    """

    points: Callable[[FloatArray, FloatArray], FloatArray]
    mesh: TriangleMesh
    right: bool
    edges: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 2, 2)))

    def folds(self, across: int, at: float) -> tuple[FloatArray, FloatArray]:
        """Where (K,), ascending in the other parameter, the line of the value ``at`` of parameter ``across``
        (0 or 1) passes edges, and by which angles (K,) [rad] it turns there."""
        a, b = self.edges[..., across], self.edges[..., 1 - across]
        over = (a[:, 0] - at) * (a[:, 1] - at) <= 0.0
        over &= np.abs(a[:, 1] - a[:, 0]) > _NEAR
        a, b = a[over], b[over]
        place = np.sort(b[:, 0] + (at - a[:, 0]) / (a[:, 1] - a[:, 0]) * (b[:, 1] - b[:, 0]))
        place = place[(place > 2.0 * _NEAR) & (place < 1.0 - 2.0 * _NEAR)]
        place = place[np.diff(place, prepend=-1.0) > 2.0 * _NEAR]
        own = np.full((len(place), 3), at)
        other = place[:, None] + _NEAR * np.array([-1.0, 0.0, 1.0])
        sight = self.points(own, other) if across == 0 else self.points(other, own)
        way = np.diff(sight, axis=1)
        cross = np.linalg.norm(np.cross(way[:, 0], way[:, 1]), axis=1)
        return place, np.arctan2(cross, np.sum(way[:, 0] * way[:, 1], axis=1))


def of_loft(
    loft: Loft, u: tuple[float, float], v: tuple[float, float], mesh: TriangleMesh, flip: bool
) -> Patch:
    """The region of a loft, with its tessellation."""

    def points(a: FloatArray, b: FloatArray) -> FloatArray:
        a, b = np.broadcast_arrays(a, b)
        return loft.points(u[0] + a * (u[1] - u[0]), v[0] + b * (v[1] - v[0]))

    return Patch(points, mesh, not flip)


def of_mesh(mesh: TriangleMesh, field: str) -> Patch:
    """A mesh with one boundary and four corners, those where the boundary turns most, by 20 degrees at least.

    u = 0 is the longer pair's first side; raises ``TandemError`` with ``part.patch``.
    """
    rings = boundaries(mesh)
    if len(rings) != 1:
        raise _refuse(field, f"the mesh has {len(rings)} boundaries, a patch has 1; close its holes")
    ring = rings[0]
    turn = turns(mesh.vertices[ring], True)
    order = np.argsort(-turn, kind="stable")
    count = int((turn >= 20.0 * DEG).sum())
    what = f"the boundary has {count} corners of 20 degrees or more, a patch has 4"
    if len(ring) < 4 or count < 4:
        raise _refuse(field, f"{what}; cut it so that it has four sides")
    if len(ring) > 4 and turn[order[4]] > 0.7 * turn[order[3]] and turn[order[4]] > 20.0 * DEG:
        raise _refuse(field, f"{what}; smooth the others, or cut it so that it has four sides")
    corner = np.sort(order[:4])
    ring = np.roll(ring, -int(corner[0]))
    corner = np.append(corner - corner[0], len(ring))
    flat = _rim(mesh, ring, corner)
    uv = _inner(mesh, ring, flat)
    inside = _facets(mesh, uv)
    sides = []
    for a, b in itertools.pairwise(corner):
        own = mesh.vertices[ring[np.arange(a, b + 1) % len(ring)]]
        way = arc_length(own)
        sides.append((own, way / way[-1]))

    def points(u: FloatArray, v: FloatArray) -> FloatArray:
        u, v = (np.asarray(w, dtype=np.float64) for w in np.broadcast_arrays(u, v))
        out = inside(np.stack([u, v], axis=-1))
        # the square is run round counterclockwise: v = 0, u = 1, v = 1, u = 0
        rims = ((v <= 1e-9, u), (u >= 1 - 1e-9, v), (v >= 1 - 1e-9, 1 - u), (u <= 1e-9, 1 - v))
        for (at, share), (own, place) in zip(rims, sides, strict=True):
            if at.any():
                out[at] = along(own, place, share[at])
        return out

    pairs = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    once, used = np.unique(pairs, axis=0, return_counts=True)
    return Patch(points, mesh, True, uv[once[used > 1]])


def _facets(mesh: TriangleMesh, uv: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Points (..., 3) of the mesh's own facets at places (..., 2) of the flat layout ``uv`` (V, 2). Another
    triangulation of the same vertices would be another surface.
    """
    flat = uv[mesh.faces]
    tree = shapely.STRtree(shapely.polygons(flat))
    side = flat[:, 1:] - flat[:, :1]
    area = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]

    def at(places: FloatArray) -> FloatArray:
        rows = places.reshape(-1, 2)
        facet = tree.nearest(shapely.points(rows))
        off = rows - flat[facet, 0]
        one, two = side[facet, 0], side[facet, 1]
        size = np.where(np.abs(area[facet]) > 1e-300, area[facet], 1e-300)
        b = (off[:, 0] * two[:, 1] - off[:, 1] * two[:, 0]) / size
        c = (one[:, 0] * off[:, 1] - one[:, 1] * off[:, 0]) / size
        weight = np.stack([1.0 - b - c, b, c], axis=1)[..., None]
        out = np.sum(weight * mesh.vertices[mesh.faces[facet]], axis=1)
        return np.asarray(out.reshape(*places.shape[:-1], 3))

    return at


def _rim(mesh: TriangleMesh, ring: IntArray, corner: IntArray) -> FloatArray:
    """Places (n, 2) of the boundary's vertices on the square, counterclockwise from (0, 0)."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    out = np.empty((len(ring), 2))
    for k in range(4):
        index = np.arange(corner[k], corner[k + 1] + 1)
        way = arc_length(mesh.vertices[ring[index % len(ring)]])
        share = (way / way[-1])[:-1, None]
        out[index[:-1]] = (1.0 - share) * square[k] + share * square[k + 1]
    return out


def _inner(mesh: TriangleMesh, ring: IntArray, flat: FloatArray) -> FloatArray:
    """Places (V, 2) of all vertices, by mean value weights."""
    count = len(mesh.vertices)
    corner = mesh.vertices[mesh.faces]
    edge = np.roll(corner, -1, axis=1) - corner
    length = np.maximum(np.linalg.norm(edge, axis=2), 1e-300)
    unit = edge / length[..., None]
    cosine = np.clip(-np.sum(unit * np.roll(unit, 1, axis=1), axis=2), -1.0, 1.0)
    half = np.tan(0.5 * np.arccos(cosine))  # tangent of half the angle at every corner
    here = mesh.faces
    ahead, behind = np.roll(here, -1, axis=1), np.roll(here, 1, axis=1)
    row = np.concatenate([here.ravel(), here.ravel()])
    column = np.concatenate([ahead.ravel(), behind.ravel()])
    weight = np.concatenate([(half / length).ravel(), (half / np.roll(length, 1, axis=1)).ravel()])
    matrix = csr_array(coo_array((weight, (row, column)), shape=(count, count)))
    total = np.asarray(matrix.sum(axis=1)).ravel()
    free = np.setdiff1d(np.arange(count), ring)
    uv = np.zeros((count, 2))
    uv[ring] = flat
    if len(free):
        own = matrix[free]
        place = np.arange(len(free))
        left = coo_array((total[free], (place, place))).tocsc() - own[:, free].tocsc()
        uv[free] = np.stack([spsolve(left, own[:, ring] @ flat[:, k]) for k in range(2)], axis=1)
    return uv


def _refuse(field: str, what: str) -> TandemError:
    return TandemError(Issue("part.patch", what, field=field))
