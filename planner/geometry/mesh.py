"""Triangle meshes: checked; the closest places of triangles to points.

A wanted surface must be finite, open, one piece and oriented. What a faceted face needs to be asked
for closest places: small pieces, normals that are smooth except over creases.
"""

import dataclasses
import functools
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, distinct_rows, dots
from planner.geometry.units import measurement
from planner.issues import Issue, refusal


@dataclasses.dataclass(frozen=True)
class TriangleMesh:
    """Triangles: ``vertices`` (V, 3) [m], ``faces`` (F, 3)."""

    vertices: FloatArray
    faces: IntArray


def merge(mesh: TriangleMesh) -> TriangleMesh:
    """The same surface with equal vertices merged (to 1e-9 of its extent), without faces of no area."""
    named = np.zeros(len(mesh.vertices), dtype=np.bool_)
    named[mesh.faces] = True
    used = np.flatnonzero(named)
    vertices = mesh.vertices[used]
    step = max(float(np.ptp(vertices, axis=0).max()) * 1e-9, 1e-15)
    key = np.round((vertices - vertices.min(axis=0)) / step).astype(np.int64)
    _, first, inverse = distinct_rows(key)
    lookup = np.zeros(len(mesh.vertices), dtype=np.int64)
    order = np.argsort(first)  # keeps the order of the file
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    lookup[used] = rank[inverse]
    vertices = vertices[first[order]]
    faces = lookup[mesh.faces]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return TriangleMesh(vertices, faces[area > step * step])


def check_surface(mesh: TriangleMesh, name: str, file: str | None = None) -> list[Issue]:
    """Issues of a mesh that is to be a wanted face: open, one piece, oriented, two faces an edge at most."""
    directed = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    low, high = np.sort(directed, axis=1).T
    vertices = len(mesh.vertices)
    key, inverse, count = np.unique(low * vertices + high, return_inverse=True, return_counts=True)
    edges = np.stack(np.divmod(key, vertices), axis=1)
    issue = functools.partial(Issue, file=file, field=name)
    if (count > 2).any():
        at = 1e3 * mesh.vertices[edges[count > 2][0]].mean(axis=0)
        what = f"{int((count > 2).sum())} edges join more than two faces, the first at ({at[0]:.1f}, "
        what += f"{at[1]:.1f}, {at[2]:.1f}) mm; a face of a part has at most two at an edge, so delete the "
        return [issue("mesh.non_manifold", f"{what}extra ones")]
    forward = directed[:, 0] < directed[:, 1]
    issues: list[Issue] = []
    same = np.bincount(np.reshape(inverse, -1), weights=forward, minlength=len(edges))
    if ((count == 2) & (same != 1)).any():
        many = int(((count == 2) & (same != 1)).sum())
        what = f"neighbouring faces have opposite normals at {many} edges; unify the normals"
        issues.append(issue("mesh.orientation", what))
    if (count == 2).all():
        what = "the mesh is closed, one open face of the part is wanted; export that face alone"
        issues.append(issue("mesh.closed", what))
    pieces = _pieces(mesh)
    if pieces > 1:
        what = f"the mesh has {pieces} separate pieces, 1 is wanted; join them or export one"
        issues.append(issue("mesh.pieces", what))
    return issues


def vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """Unit normals (V, 3) at the vertices, the faces' normals weighted by their angles there."""
    corner = mesh.vertices[mesh.faces]
    edge = np.roll(corner, -1, axis=1) - corner
    edge = edge / np.maximum(np.linalg.norm(edge, axis=2, keepdims=True), 1e-300)
    angle = np.arccos(np.clip(-dots(edge, np.roll(edge, 1, axis=1)), -1.0, 1.0))
    weighted = angle[..., None] * face_normals(mesh)[:, None, :]
    total = np.zeros_like(mesh.vertices)
    np.add.at(total, mesh.faces.reshape(-1), weighted.reshape(-1, 3))
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300))


def face_normals(mesh: TriangleMesh) -> FloatArray:
    """Unit normals (F, 3) of the faces."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300))


def face_areas(mesh: TriangleMesh) -> FloatArray:
    """Areas (F,) [m^2]."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def offset(
    mesh: TriangleMesh, distance: float | FloatArray, normals: FloatArray | None = None
) -> TriangleMesh:
    """The surface moved by ``distance`` [m], one for all vertices or (V,), along its normals (V, 3), or along
    those of its facets averaged.

    Raises ``TandemError`` with ``part.offset`` where the surface is bent more tightly than the distance, so
    that the moved one would fold over itself.
    """
    direction = vertex_normals(mesh) if normals is None else normals
    shift = np.broadcast_to(np.asarray(distance, dtype=np.float64), len(mesh.vertices))
    moved = TriangleMesh(mesh.vertices + shift[:, None] * direction, mesh.faces)
    turned = (dots(face_normals(mesh), face_normals(moved)) <= 0.0) & ~_slivers(mesh)
    if turned.any():
        most = 1e3 * float(np.abs(shift).max())
        at = 1e3 * mesh.vertices[mesh.faces[turned][0]].mean(axis=0)
        what = f"moved by {most:.2f} mm the face folds over itself at {int(turned.sum())} of {len(turned)} "
        what += f"facets, the first at ({at[0]:.1f}, {at[1]:.1f}, {at[2]:.1f}) mm; its radius must be larger "
        what += "than that, so use a thinner part, a smaller kerf or a smoother face"
        raise refusal("part.offset", what, field="part", **measurement(most, None, "mm"))
    return moved


def _slivers(mesh: TriangleMesh) -> BoolArray:
    """Facets (F,) lower than a tenth of their longest edge and than a fifth of what facets of the mesh are,
    as a cut through it leaves them: whether they turn round says nothing about the surface. Long facets of a
    loft are all low, and do say something."""
    corners = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    height = 2.0 * face_areas(mesh) / np.maximum(longest, 1e-12)
    return np.asarray((height < 0.1 * longest) & (height < 0.2 * np.median(height)))


def _pieces(mesh: TriangleMesh) -> int:
    a = np.concatenate([mesh.faces[:, 0], mesh.faces[:, 1]])
    b = np.concatenate([mesh.faces[:, 1], mesh.faces[:, 2]])
    count = len(mesh.vertices)
    _, label = connected_components(
        coo_array((np.ones(len(a)), (a, b)), shape=(count, count)), directed=False
    )
    return len(np.unique(label[np.unique(mesh.faces)]))


_VALENCE: Final = 48
"""Corners of a vertex with more faces than this take the normal of their own face."""


def closest_on_triangles(points: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Barycentric weights (M, 3) of the closest places of triangles ``a``, ``b``, ``c`` (M, 3) to ``points``
    (M, 3): the foot in the plane where it lies inside, else the best of the feet on the three edges."""
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = dots(ab, ab), dots(ab, ac), dots(ac, ac)
    d20, d21 = dots(ap, ab), dots(ap, ac)
    scale = np.maximum(d00 * d11 - d01 * d01, 1e-300)
    v = (d11 * d20 - d01 * d21) / scale
    w = (d00 * d21 - d01 * d20) / scale
    weights = np.stack([1.0 - v - w, v, w], axis=1)
    out = np.flatnonzero(weights.min(axis=1) < 0.0)
    if len(out):
        corners = (a[out], b[out], c[out])
        p = points[out]
        best = np.full(len(out), np.inf)
        found = np.zeros((len(out), 3))
        for k in range(3):
            one, two = corners[k], corners[(k + 1) % 3]
            way, rest = two - one, p - one
            share = np.clip(dots(rest, way) / np.maximum(dots(way, way), 1e-300), 0.0, 1.0)
            off = rest - share[:, None] * way
            square = dots(off, off)
            better = square < best
            best[better] = square[better]
            edge = np.zeros((int(better.sum()), 3))
            edge[:, k], edge[:, (k + 1) % 3] = 1.0 - share[better], share[better]
            found[better] = edge
        weights[out] = found
    return weights


_CORNERS_AT_ONCE = 16_384
"""Corners of faces that are worked on at once."""


def corner_normals(mesh: TriangleMesh, crease: float) -> FloatArray:
    """Unit normals (F, 3, 3) at the corners of each face: those of the faces around the vertex averaged by
    their angles there, without the faces that turn from this one by more than ``crease`` [rad]."""
    normals = face_normals(mesh)
    corner = mesh.vertices[mesh.faces]
    edge = np.roll(corner, -1, axis=1) - corner
    edge = edge / np.maximum(np.linalg.norm(edge, axis=2, keepdims=True), 1e-300)
    angle = np.arccos(np.clip(-dots(edge, np.roll(edge, 1, axis=1)), -1.0, 1.0)).ravel()
    vertex = mesh.faces.ravel()
    order = np.argsort(vertex, kind="stable")
    count = np.bincount(vertex, minlength=len(mesh.vertices))
    first = np.cumsum(count) - count
    total = np.repeat(normals, 3, axis=0) * angle[:, None]
    used = np.flatnonzero(count[vertex] <= _VALENCE)
    for begin in range(0, len(used), _CORNERS_AT_ONCE):
        some = used[begin : begin + _CORNERS_AT_ONCE]
        many = count[vertex[some]]
        row = np.repeat(np.arange(len(some)), many)
        mine = some[row]
        place = np.arange(len(mine)) - np.repeat(np.cumsum(many) - many, many)
        other = order[first[vertex[mine]] + place]
        near = (dots(normals[mine // 3], normals[other // 3]) > np.cos(crease)) & (other != mine)
        row, other = row[near], other[near]
        for axis in range(3):
            weights = normals[other // 3, axis] * angle[other]
            total[some, axis] += np.bincount(row, weights=weights, minlength=len(some))
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    return np.asarray(total.reshape(-1, 3, 3))


def small_pieces(corners: FloatArray, size: float, most: int) -> tuple[FloatArray, IntArray]:
    """Triangles (T, 3, 3) halved across their longest edges until none is longer than ``size`` (or ``most``
    pieces are reached): pieces (P, 3, 3) and the triangle (P,) that each belongs to."""
    given, owner = corners, np.arange(len(corners))
    done: list[FloatArray] = []
    owners: list[IntArray] = []
    finished = 0
    while len(corners):
        # edge by edge: all of them would take as much memory as the pieces
        ways = (corners[:, end] - corners[:, start] for start, end in ((0, 1), (1, 2), (2, 0)))
        one, two, three = (dots(way, way) for way in ways)
        most_of_two = np.maximum(one, two)
        # the first one of equals
        longest = np.where(three > most_of_two, 2, (two > one).astype(np.int64))
        fine = np.sqrt(np.maximum(most_of_two, three)) <= size
        fine |= finished + 2 * len(corners) > most
        kept, rows = np.flatnonzero(fine), np.flatnonzero(~fine)
        if len(kept):
            done.append(corners.take(kept, axis=0) if len(rows) or corners is given else corners)
            owners.append(owner.take(kept))
        finished += len(kept)
        vertices, first, longest = corners.reshape(-1, 3), 3 * rows, longest.take(rows)
        corners = np.empty((2 * len(rows), 3, 3))
        near, far = corners[: len(rows)], corners[len(rows) :]
        near[:, 0] = start = vertices.take(first + longest, axis=0)
        far[:, 1] = end = vertices.take(first + (longest + 1) % 3, axis=0)
        near[:, 2] = far[:, 2] = vertices.take(first + (longest + 2) % 3, axis=0)
        near[:, 1] = far[:, 0] = 0.5 * (start + end)
        owner = np.tile(owner.take(rows), 2)
        del vertices, start, end
    return (done[0], owners[0]) if len(done) == 1 else (np.concatenate(done), np.concatenate(owners))
