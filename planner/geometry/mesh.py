"""Triangle meshes: checks, normals, offsets, and closest points of triangles.

A required surface has to be finite, open, connected and oriented. Closest points on a faceted face need small
pieces, and normals that are smooth except over creases.
"""

import dataclasses
import functools
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, unique_rows
from planner.geometry.units import measurement
from planner.issue_codes import format_message
from planner.issues import Issue, issue_error


@dataclasses.dataclass(frozen=True)
class TriangleMesh:
    """A triangle mesh.

    Attributes:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3).
    """

    vertices: FloatArray
    faces: IntArray


def merge_vertices(mesh: TriangleMesh) -> TriangleMesh:
    """Return the same surface with equal vertices merged (to 1e-9 of its extent), without degenerate faces.

    Args:
        mesh: The mesh.
    """
    is_used = np.zeros(len(mesh.vertices), dtype=np.bool_)
    is_used[mesh.faces] = True
    used = np.flatnonzero(is_used)
    vertices = mesh.vertices[used]
    step = max(float(np.ptp(vertices, axis=0).max()) * 1e-9, 1e-15)
    key = np.round((vertices - vertices.min(axis=0)) / step).astype(np.int64)
    _, first, inverse = unique_rows(key)
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
    """Check a mesh that has to be the face of a part, and return its issues.

    It has to be open, connected and oriented, with at most two faces per edge. If an edge has more than two
    faces, only that is checked.

    Args:
        mesh: The mesh.
        name: Field of the issues.
        file: Name of its file.
    """
    directed = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    low, high = np.sort(directed, axis=1).T
    vertex_count = len(mesh.vertices)
    key, inverse, count = np.unique(low * vertex_count + high, return_inverse=True, return_counts=True)
    edges = np.stack(np.divmod(key, vertex_count), axis=1)
    issue = functools.partial(Issue, file=file, field=name)
    if (count > 2).any():
        position_mm = 1e3 * mesh.vertices[edges[count > 2][0]].mean(axis=0)
        text = (
            f"{int((count > 2).sum())} edges join more than two faces, the first at ({position_mm[0]:.1f}, "
            f"{position_mm[1]:.1f}, {position_mm[2]:.1f}) mm; a face of a part has at most two at an edge, "
            "so delete the extra ones"
        )
        return [issue("mesh.non_manifold", text)]
    forward = directed[:, 0] < directed[:, 1]
    issues: list[Issue] = []
    forward_count = np.bincount(np.reshape(inverse, -1), weights=forward, minlength=len(edges))
    if ((count == 2) & (forward_count != 1)).any():
        opposite_count = int(((count == 2) & (forward_count != 1)).sum())
        text = f"neighbouring faces have opposite normals at {opposite_count} edges; unify the normals"
        issues.append(issue("mesh.orientation", text))
    if (count == 2).all():
        text = "the mesh is closed, but one open face of the part is required; export only that face"
        issues.append(issue("mesh.closed", text))
    pieces = _count_pieces(mesh)
    if pieces > 1:
        text = f"the mesh has {pieces} separate pieces, 1 is required; join them or export one"
        issues.append(issue("mesh.pieces", text))
    return issues


def vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """Return unit normals (V, 3) at the vertices: face normals weighted by the angles there."""
    corner = mesh.vertices[mesh.faces]
    edge = np.roll(corner, -1, axis=1) - corner
    edge = edge / np.maximum(np.linalg.norm(edge, axis=2, keepdims=True), 1e-300)
    angle = np.arccos(np.clip(-dots(edge, np.roll(edge, 1, axis=1)), -1.0, 1.0))
    weighted = angle[..., None] * face_normals(mesh)[:, None, :]
    total = np.zeros_like(mesh.vertices)
    np.add.at(total, mesh.faces.reshape(-1), weighted.reshape(-1, 3))
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300))


def face_normals(mesh: TriangleMesh) -> FloatArray:
    """Return unit normals (F, 3) of the faces."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300))


def face_areas(mesh: TriangleMesh) -> FloatArray:
    """Return areas (F,) [m^2]."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def offset_mesh(
    mesh: TriangleMesh, distance: float | FloatArray, normals: FloatArray | None = None
) -> TriangleMesh:
    """Offset a surface along its normals.

    Args:
        mesh: The mesh.
        distance: Distance [m], one for all vertices or (V,).
        normals: Normals (V, 3), None for averaged facet normals.

    Raises:
        TandemError: ``part.offset`` if the surface has a smaller radius of curvature, so that the offset one
            would fold.
    """
    direction = vertex_normals(mesh) if normals is None else normals
    shift = np.broadcast_to(np.asarray(distance, dtype=np.float64), len(mesh.vertices))
    moved = TriangleMesh(mesh.vertices + shift[:, None] * direction, mesh.faces)
    is_inverted = (dots(face_normals(mesh), face_normals(moved)) <= 0.0) & ~_is_sliver(mesh)
    if is_inverted.any():
        max_shift_mm = 1e3 * float(np.abs(shift).max())
        position_mm = 1e3 * mesh.vertices[mesh.faces[is_inverted][0]].mean(axis=0)
        message = format_message(
            "part.offset",
            offset_mm=max_shift_mm,
            folded=int(is_inverted.sum()),
            facets=len(is_inverted),
            position_mm=position_mm,
        )
        raise issue_error("part.offset", message, field="part", **measurement(max_shift_mm, None, "mm"))
    return moved


def _is_sliver(mesh: TriangleMesh) -> BoolArray:
    """Return the facets (F,) that are slivers, as a cut through the mesh leaves them.

    Their height is below a tenth of their longest edge and below a fifth of the median height. Their
    orientation says nothing about the surface. Long facets of a loft are all low, but their orientation does
    matter.
    """
    corners = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    height = 2.0 * face_areas(mesh) / np.maximum(longest, 1e-12)
    return np.asarray((height < 0.1 * longest) & (height < 0.2 * np.median(height)))


def _count_pieces(mesh: TriangleMesh) -> int:
    """Return the number of connected pieces. Vertices without a face do not count."""
    a = np.concatenate([mesh.faces[:, 0], mesh.faces[:, 1]])
    b = np.concatenate([mesh.faces[:, 1], mesh.faces[:, 2]])
    count = len(mesh.vertices)
    _, label = connected_components(
        coo_array((np.ones(len(a)), (a, b)), shape=(count, count)), directed=False
    )
    return len(np.unique(label[np.unique(mesh.faces)]))


_MAX_VALENCE: Final = 48
"""Number of faces of a vertex above which its corners use the normal of their own face."""


def closest_weights(points: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return barycentric weights (M, 3) of the closest points of triangles.

    They are those of the foot in the plane if it is inside, else of the best foot on the three edges.

    Args:
        points: Points (M, 3).
        a: First corners of the triangles (M, 3).
        b: Second corners (M, 3).
        c: Third corners (M, 3).
    """
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = dots(ab, ab), dots(ab, ac), dots(ac, ac)
    d20, d21 = dots(ap, ab), dots(ap, ac)
    scale = np.maximum(d00 * d11 - d01 * d01, 1e-300)
    v = (d11 * d20 - d01 * d21) / scale
    w = (d00 * d21 - d01 * d20) / scale
    weights = np.stack([1.0 - v - w, v, w], axis=1)
    outside = np.flatnonzero(weights.min(axis=1) < 0.0)
    if len(outside):
        corners = (a[outside], b[outside], c[outside])
        p = points[outside]
        min_square = np.full(len(outside), np.inf)
        edge_weights = np.zeros((len(outside), 3))
        for k in range(3):
            start, end = corners[k], corners[(k + 1) % 3]
            edge_vector, offset = end - start, p - start
            fraction = np.clip(
                dots(offset, edge_vector) / np.maximum(dots(edge_vector, edge_vector), 1e-300), 0.0, 1.0
            )
            offset_vectors = offset - fraction[:, None] * edge_vector
            square = dots(offset_vectors, offset_vectors)
            better = square < min_square
            min_square[better] = square[better]
            edge = np.zeros((int(better.sum()), 3))
            edge[:, k], edge[:, (k + 1) % 3] = 1.0 - fraction[better], fraction[better]
            edge_weights[better] = edge
        weights[outside] = edge_weights
    return weights


_MAX_CORNERS = 16_384
"""Number of face corners that are processed at once."""


def corner_normals(mesh: TriangleMesh, crease: float) -> FloatArray:
    """Return unit normals (F, 3, 3) at the corners of each face.

    They are averages over the faces around the vertex, weighted by the angles there, without faces across a
    crease.

    Args:
        mesh: The mesh.
        crease: Maximum angle between averaged face normals [rad].
    """
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
    used = np.flatnonzero(count[vertex] <= _MAX_VALENCE)
    for start in range(0, len(used), _MAX_CORNERS):
        batch = used[start : start + _MAX_CORNERS]
        valences = count[vertex[batch]]
        # all pairs of a corner of the batch and a corner at the same vertex
        row = np.repeat(np.arange(len(batch)), valences)
        corners_repeated = batch[row]
        ranks = np.arange(len(corners_repeated)) - np.repeat(np.cumsum(valences) - valences, valences)
        other = order[first[vertex[corners_repeated]] + ranks]
        is_smooth = (dots(normals[corners_repeated // 3], normals[other // 3]) > np.cos(crease)) & (
            other != corners_repeated
        )
        row, other = row[is_smooth], other[is_smooth]
        for axis in range(3):
            weights = normals[other // 3, axis] * angle[other]
            total[batch, axis] += np.bincount(row, weights=weights, minlength=len(batch))
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    return np.asarray(total.reshape(-1, 3, 3))


def bisect_triangles(corners: FloatArray, size: float, max_pieces: int) -> tuple[FloatArray, IntArray]:
    """Bisect triangles across their longest edges until all edges are short.

    Args:
        corners: Triangles (T, 3, 3).
        size: Maximum edge length.
        max_pieces: Maximum number of pieces, at which the bisection stops.

    Returns:
        Pieces (P, 3, 3), and the triangle (P,) to which each belongs.
    """
    original, owner = corners, np.arange(len(corners))
    pieces: list[FloatArray] = []
    owners: list[IntArray] = []
    finished = 0
    while len(corners):
        # edge by edge, because all of them would need as much memory as the pieces
        edge_vectors = (corners[:, end] - corners[:, start] for start, end in ((0, 1), (1, 2), (2, 0)))
        first_edge, second_edge, third_edge = (dots(edge_vector, edge_vector) for edge_vector in edge_vectors)
        larger_of_two = np.maximum(first_edge, second_edge)
        # ties: the first one
        longest = np.where(third_edge > larger_of_two, 2, (second_edge > first_edge).astype(np.int64))
        is_fine = np.sqrt(np.maximum(larger_of_two, third_edge)) <= size
        is_fine |= finished + 2 * len(corners) > max_pieces
        fine_rows, divided_rows = np.flatnonzero(is_fine), np.flatnonzero(~is_fine)
        if len(fine_rows):
            pieces.append(
                corners.take(fine_rows, axis=0) if len(divided_rows) or corners is original else corners
            )
            owners.append(owner.take(fine_rows))
        finished += len(fine_rows)
        vertices, first, longest = corners.reshape(-1, 3), 3 * divided_rows, longest.take(divided_rows)
        corners = np.empty((2 * len(divided_rows), 3, 3))
        first_half, second_half = corners[: len(divided_rows)], corners[len(divided_rows) :]
        first_half[:, 0] = start = vertices.take(first + longest, axis=0)
        second_half[:, 1] = end = vertices.take(first + (longest + 1) % 3, axis=0)
        first_half[:, 2] = second_half[:, 2] = vertices.take(first + (longest + 2) % 3, axis=0)
        first_half[:, 1] = second_half[:, 0] = 0.5 * (start + end)
        owner = np.tile(owner.take(divided_rows), 2)
        del vertices, start, end
    return (pieces[0], owners[0]) if len(pieces) == 1 else (np.concatenate(pieces), np.concatenate(owners))
