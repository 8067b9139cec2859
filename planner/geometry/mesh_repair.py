"""Meshes as exporters and scanners write them: repair of flaws, estimate of noise, and smoothing.

Flaws are duplicate triangles, cracks between them, and rims that differ from the flat by micrometres.

Noise is the deviation of the vertices from the intended face. It is estimated from the mesh itself, from
hinges (two triangles at an edge) and from small neighbourhoods. A smooth face bends its hinges but leaves
quadrics no residual. A mesh of few large facets has folds that no quadric fits, but flat hinges next to them.
The smaller of both estimates is the noise of the vertices.

The smooth intended face is a weak plate: of all faces the one with the smallest sum of squared distances from
the vertices and bending energy. Hinges with a larger angle than a smooth face would have lose weight from
iteration to iteration, so that folds are preserved.

Source: weak plate, Blake and Zisserman, Visual reconstruction, MIT Press, 1987; bending energy of hinges,
Bergou et al., A quadratic bending model for inextensible surfaces, SGP 2006.
"""

import dataclasses
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import aslinearoperator, cg
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, unique_rows
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals, merge_vertices, vertex_normals

CRACK_WIDTH_M: Final = 1e-5
"""Distance at which edges are one in a mesh with cracks [m]."""
RIM_OFFSET_M: Final = 2e-5
"""Distance from the flat at which corners of a sharp rim are on it [m]."""
SHARP_RIM_COSINE: Final = float(np.cos(np.radians(20.0)))
"""Cosine of the slope (20 degrees) from which on a rim is sharp."""
_MAX_SEWING_ITERATIONS: Final = 8
"""Maximum number of iterations in which open rims are joined. Each closes what the previous one left."""


def sew_cracks(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh without duplicate faces and with closed cracks.

    Vertices and edges of borders within `CRACK_WIDTH_M` of each other become one. A mesh without such flaws
    is returned unchanged.

    Args:
        mesh: The mesh.
    """
    _, first, _ = unique_rows(np.sort(mesh.faces, axis=1))
    if len(first) < len(mesh.faces):
        mesh = TriangleMesh(mesh.vertices, mesh.faces[np.sort(first)])
    for _ in range(_MAX_SEWING_ITERATIONS):
        rim = border_edges(mesh.faces)
        if not len(rim) or _count_loops(rim) == 1:
            return mesh
        rim_count = len(rim)
        mesh = _divide_at_vertices(_weld_borders(mesh, rim))
        if len(border_edges(mesh.faces)) == rim_count:
            return mesh
    return mesh


def border_edges(faces: IntArray) -> IntArray:
    """Return the edges (E, 2) that belong to one face only, in the direction of that face."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first, which = unique_rows(np.sort(edges, axis=1))
    return np.asarray(edges[first[np.bincount(which, minlength=len(first)) == 1]])


def level_rims(mesh: TriangleMesh, level: float, within: float) -> TriangleMesh:
    """Return the mesh with corners of sharp rims, and low bumps, moved onto the flat beside them.

    Args:
        mesh: The mesh.
        level: Height of the flat [m].
        within: Maximum height above or below the flat of a vertex that is moved [m].
    """
    heights = np.abs(mesh.vertices[:, 2] - level)
    doubtful = (heights > 0.0) & (heights <= within)
    if not doubtful.any():
        return mesh
    is_sharp = np.zeros(len(heights), dtype=bool)
    is_sharp[mesh.faces[np.abs(face_normals(mesh)[:, 2]) < SHARP_RIM_COSINE]] = True
    # a connected group that is off the flat and nowhere higher than the limit is a bump
    raised = heights > 0.0
    edges = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = edges[raised[edges].all(axis=1)]
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(heights), len(heights)))
    _, label = connected_components(graph, directed=False)
    max_height = np.zeros(int(label.max()) + 1)
    np.maximum.at(max_height, label, heights)
    is_moved = doubtful & (is_sharp | (max_height[label] <= within))
    vertices = mesh.vertices.copy()
    vertices[is_moved, 2] = level
    return TriangleMesh(vertices, mesh.faces)


def _count_loops(rim: IntArray) -> int:
    """Return the number of connected groups of border edges (E, 2)."""
    used, index = np.unique(rim, return_inverse=True)
    ends = index.reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(used), len(used)))
    return int(connected_components(graph, directed=False)[0])


def _weld_borders(mesh: TriangleMesh, rim: IntArray) -> TriangleMesh:
    """Merge vertices of the border edges ``rim`` (E, 2) that are within `CRACK_WIDTH_M` of each other."""
    used = np.unique(rim)
    pairs = cKDTree(mesh.vertices[used]).query_pairs(CRACK_WIDTH_M, output_type="ndarray")
    if not len(pairs):
        return mesh
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(used), len(used)))
    _, label = connected_components(graph, directed=False)
    first = np.full(int(label.max()) + 1, len(mesh.vertices))
    np.minimum.at(first, label, used)
    merged_index = np.arange(len(mesh.vertices))
    merged_index[used] = first[label]
    faces = merged_index[mesh.faces]
    is_kept = (faces != np.roll(faces, -1, axis=1)).all(axis=1)
    return merge_vertices(TriangleMesh(mesh.vertices, faces[is_kept]))


def _divide_at_vertices(mesh: TriangleMesh) -> TriangleMesh:
    """Divide faces at vertices of other faces that are on their border edges.

    Each face is divided at one edge only, the one with most vertices. Further edges follow in the next call.
    """
    rim = border_edges(mesh.faces)
    used = np.unique(rim)
    start, edge_vector = mesh.vertices[rim[:, 0]], mesh.vertices[rim[:, 1]] - mesh.vertices[rim[:, 0]]
    length = np.linalg.norm(edge_vector, axis=1)
    near_vertices = cKDTree(mesh.vertices[used]).query_ball_point(
        start + 0.5 * edge_vector, 0.5 * length + CRACK_WIDTH_M
    )
    divided: dict[tuple[int, int], list[int]] = {}
    for row, candidates in enumerate(near_vertices):
        others = used[np.array(candidates, dtype=np.int64)]
        others = others[~np.isin(others, rim[row])]
        offsets = mesh.vertices[others] - start[row]
        fraction = offsets @ edge_vector[row] / max(length[row] ** 2, 1e-30)
        distance = np.linalg.norm(offsets - fraction[:, None] * edge_vector[row], axis=1)
        is_on_edge = (
            (distance <= CRACK_WIDTH_M)
            & (fraction * length[row] > CRACK_WIDTH_M)
            & ((1.0 - fraction) * length[row] > CRACK_WIDTH_M)
        )
        if is_on_edge.any():
            order = np.argsort(fraction[is_on_edge])
            divided[(int(rim[row, 0]), int(rim[row, 1]))] = others[is_on_edge][order].tolist()
    if not divided:
        return mesh
    faces = []
    for face in mesh.faces.tolist():
        sides = list(zip(face, face[1:] + face[:1], face[2:] + face[:2], strict=True))
        edge_vertices, (a, b, apex) = max(
            ((divided.get((a, b), []), (a, b, c)) for a, b, c in sides), key=lambda item: len(item[0])
        )
        line = [a, *(v for v in edge_vertices if v != apex), b]
        faces += [[start_vertex, end_vertex, apex] for start_vertex, end_vertex in pairwise(line)]
    return TriangleMesh(mesh.vertices, np.array(faces, dtype=np.int64))


MIN_NOISE_M: Final = 4e-6
"""Noise [m] below which a mesh is considered exact: rounding of coordinates, and chords of curves."""
NOISE_BOUND_DEVIATIONS: Final = 3.0
"""Number of standard deviations within which 99.7 % of vertices are from their face (normal noise)."""
_SMOOTH_HINGE_FRACTION: Final = 0.2
"""Fraction of the hinges that are certainly not folds."""
_NORMAL_QUANTILE: Final = 0.2533
"""Quantile of the absolute value of a standard normal variable at `_SMOOTH_HINGE_FRACTION` (0.2)."""
_QUADRIC_NEIGHBOURS: Final = 20
"""Number of vertices to which one quadric is fitted."""
_MAX_QUADRICS: Final = 4000
"""Maximum number of quadrics, at vertices evenly spread over the list."""
_UNIT_RESIDUAL_QUARTILE: Final = 0.86
"""Lower quartile of the residual of quadrics for unit noise."""
_SLOPE_NOISE: Final = 0.005
"""Remaining noise of the smoothed face's slope [rad], and of its curvature [1/mm]."""
_MIN_SMOOTH_RADIUS_M: Final = 2.5e-3
"""Minimum radius of curvature of smooth faces [m]. What is bent more may be a fold."""
_FOLD_FACTORS: Final = (8.0, 4.0, 2.0, 1.0, 1.0, 1.0)
"""Factors of the angle from which on hinges lose weight, one per iteration."""
_MAX_COTANGENT: Final = 20.0
"""Maximum cotangent of a triangle's angle, so that slivers are not stiffer."""
_MEAN_RINGS: Final = 6
"""Number of rings of neighbours in the mean that detects a plate that is too stiff."""
_BIAS_FACTOR: Final = 4.0
"""Ratio of mean deviations to their median beyond which the plate is too stiff."""
_BIAS_FRACTION: Final = 0.6
"""Maximum mean deviation of the face, as a fraction of the noise."""
_MIN_STIFFNESS_FRACTION: Final = 1e-6
"""Minimum fraction of its stiffness that a plate keeps."""
_FLAT_COSINE: Final = float(np.cos(np.radians(2.5)))
"""Cosine of the slope (2.5 degrees) up to which a vertex may be part of a flat."""
_MIN_FLAT_AREA_M2: Final = 5e-5
"""Minimum area of a flat [m^2]: 8 mm across."""
_MAX_ROTATION_COSINE: Final = 0.5
"""Cosine of the angle by which noise may rotate a triangle before its corners are moved."""
_SLIVER_RATIO: Final = 0.05
"""Ratio of height to longest edge below which a triangle is a sliver."""
_MAX_UNTANGLING_ITERATIONS: Final = 20
"""Maximum number of iterations that move corners of folded triangles to their neighbours' mean."""


@dataclasses.dataclass(frozen=True)
class _MeshHinges:
    """Inner edges.

    Attributes:
        ends: Vertices (E, 4): those of the edge, then the corners across.
        faces: Both faces (E, 2).
    """

    ends: IntArray
    faces: IntArray


def vertex_noise(mesh: TriangleMesh) -> float:
    """Return the standard deviation [m] of the vertices from the intended face; 0 for a mesh of few facets.

    Args:
        mesh: The mesh.
    """
    hinges = _find_hinges(mesh)
    if len(hinges.ends) < 8:
        return 0.0
    i, j, k, m = (mesh.vertices[hinges.ends[:, n]] for n in range(4))
    a, b, c = j - i, k - i, m - i
    volume = np.abs(dots(np.cross(a, b), c))
    slopes = (np.cross(b, c), np.cross(c, a), np.cross(a, b))
    slope_square = sum(dots(s, s) for s in slopes)
    slope_sum = slopes[0] + slopes[1] + slopes[2]
    # least squares distance of the four vertices from a plane, to first order
    distances = volume / np.sqrt(np.maximum(slope_square + dots(slope_sum, slope_sum), 1e-300))
    order = np.argsort(distances)
    # slivers that divide an edge are exactly flat and carry no information
    area_sum = np.cumsum(face_areas(mesh)[hinges.faces].min(axis=1)[order])
    quantile_row = int(np.searchsorted(area_sum, _SMOOTH_HINGE_FRACTION * area_sum[-1]))
    by_hinge = float(distances[order[min(quantile_row, len(order) - 1)]]) / _NORMAL_QUANTILE
    if by_hinge < MIN_NOISE_M:
        return 0.0
    noise = min(by_hinge, _quadric_noise(mesh))
    return noise if noise >= MIN_NOISE_M else 0.0


def _quadric_noise(mesh: TriangleMesh) -> float:
    """Return the noise [m] by the residuals of quadrics that fit neighbourhoods of vertices."""
    points = mesh.vertices
    if len(points) <= _QUADRIC_NEIGHBOURS:
        return 0.0
    rows = np.unique(np.linspace(0, len(points) - 1, _MAX_QUADRICS).astype(np.int64))
    _, neighbours = cKDTree(points).query(points[rows], k=_QUADRIC_NEIGHBOURS)
    normal = _smooth_normals(mesh, vertex_normals(mesh), 3)[rows]
    u, v = _tangent_vectors(normal)
    offsets = points[neighbours] - points[rows][:, None]
    size = np.linalg.norm(offsets, axis=2).max(axis=1)[:, None]
    x, y = (np.einsum("nkd,nd->nk", offsets, axis) / size for axis in (u, v))
    z = np.einsum("nkd,nd->nk", offsets, normal)
    q, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1))
    residual = z - np.einsum("nkc,nc->nk", q, np.einsum("nkc,nk->nc", q, z))
    sigma = np.sqrt((residual**2).sum(axis=1) / (_QUADRIC_NEIGHBOURS - 6))
    return float(np.quantile(sigma, 0.25)) / _UNIT_RESIDUAL_QUARTILE


def fit_face(mesh: TriangleMesh, sigma: float, level: float) -> TriangleMesh:
    """Return the intended face of a noisy mesh: the same triangles, moved along the face's normal.

    Args:
        mesh: The mesh.
        sigma: Standard deviation of the noise [m].
        level: Height of the flat, to which the rim is moved [m].
    """
    hinges, graph = _find_hinges(mesh), _adjacency(mesh)
    count = len(mesh.vertices)
    area = np.bincount(mesh.faces.reshape(-1), weights=np.repeat(face_areas(mesh) / 3.0, 3), minlength=count)
    area = np.maximum(area, 1e-3 * float(np.median(area)))
    rim = np.unique(border_edges(mesh.faces))
    steps = max(
        2, round((_stiffness_length(sigma, np.sqrt(np.median(area))) / np.sqrt(np.median(area))) ** 2)
    )
    directions = _smooth_normals(mesh, vertex_normals(mesh), min(steps, 40))
    directions[rim] = [0.0, 0.0, 1.0]
    mesh = TriangleMesh(_untangle(mesh, directions, rim), mesh.faces)
    weight = np.where(np.isin(np.arange(count), rim), 1e3, 1.0) * area
    target = np.zeros(count)
    target[rim] = level - mesh.vertices[rim, 2]
    vertices, moved, stiffness_fraction = mesh.vertices, np.zeros(count), np.ones(count)
    for factor in _FOLD_FACTORS:
        bend_weights, stiffness, angle, spacing = _hinge_bending(
            TriangleMesh(vertices, mesh.faces), hinges, sigma
        )
        limit = factor * np.maximum(spacing / _MIN_SMOOTH_RADIUS_M, np.deg2rad(3.0))
        hinge_weight = (
            stiffness * stiffness_fraction[hinges.ends[:, :2]].mean(axis=1) / (1.0 + (angle / limit) ** 2)
        )
        hinge_normals = _hinge_normals(vertices, mesh.faces, hinges)
        values = bend_weights * np.einsum("nkd,nd->nk", directions[hinges.ends], hinge_normals)
        row_starts = np.arange(0, 4 * len(hinge_normals) + 1, 4)
        matrix = csr_array(
            (values.ravel(), hinges.ends.ravel(), row_starts), shape=(len(hinge_normals), count)
        )
        bend_vectors = (bend_weights[:, :, None] * mesh.vertices[hinges.ends]).sum(axis=1)
        initial_bend = dots(bend_vectors, hinge_normals)
        operator = aslinearoperator(
            (matrix.T @ diags_array(hinge_weight) @ matrix + diags_array(weight)).tocsr()
        )
        right_side = weight * target - matrix.T @ (hinge_weight * initial_bend)
        preconditioner = aslinearoperator(diags_array(1.0 / ((matrix * matrix).T @ hinge_weight + weight)))
        moved, _ = cg(operator, right_side, x0=moved, M=preconditioner, rtol=1e-5, maxiter=400)
        vertices = mesh.vertices + moved[:, None] * directions
        # a mean deviation shows that the plate is too stiff for the face
        mean_deviation = np.abs(_average_neighbours(graph, moved, _MEAN_RINGS))
        stiffness_fraction /= (
            1.0
            + (mean_deviation / max(_BIAS_FACTOR * float(np.median(mean_deviation)), _BIAS_FRACTION * sigma))
            ** 2
        )
        stiffness_fraction = np.exp(
            _average_neighbours(graph, np.log(np.maximum(stiffness_fraction, _MIN_STIFFNESS_FRACTION)), 1)
        )
    face = TriangleMesh(vertices, mesh.faces)
    return TriangleMesh(_untangle(face, _smooth_normals(face, vertex_normals(face), 2), rim), mesh.faces)


def largest_one_sided_group(mesh: TriangleMesh, deviation: FloatArray, limit: float) -> IntArray:
    """Return the vertices of the largest connected group that deviates to one side.

    Noise is random, a ridge or groove is not.

    Args:
        mesh: The mesh.
        deviation: Deviations of the vertices (V,) [m].
        limit: Minimum deviation of the group [m].
    """
    largest, graph = np.zeros(0, dtype=np.int64), _adjacency(mesh)
    for side in (deviation, -deviation):
        largest = max([largest, *_connected_groups(graph, side > limit)], key=len)
    return largest


def level_flats(mesh: TriangleMesh, within: float, sheet: float) -> TriangleMesh:
    """Return the mesh with its horizontal flats at exact heights.

    Vertices within a distance of a flat get its height. Those at three times that distance keep theirs. In
    between the change is smooth.

    Args:
        mesh: The mesh.
        within: Distance [m].
        sheet: Height of the flat of the sheet [m].
    """
    graph = _adjacency(mesh)
    normal = _average_neighbours(graph, vertex_normals(mesh), 2)
    is_horizontal = normal[:, 2] > _FLAT_COSINE * np.linalg.norm(normal, axis=1)
    area = np.bincount(
        mesh.faces.reshape(-1), weights=np.repeat(face_areas(mesh) / 3.0, 3), minlength=len(normal)
    )
    height, levels = mesh.vertices[:, 2].copy(), [sheet]
    for flat in _connected_groups(graph, is_horizontal):
        if area[flat].sum() < _MIN_FLAT_AREA_M2:
            continue
        order = flat[np.argsort(height[flat])]
        area_fraction = np.cumsum(area[order]) / area[order].sum()
        level = float(height[order[int(np.searchsorted(area_fraction, 0.5))]])
        if float(area[flat[np.abs(height[flat] - level) <= 3.0 * within]].sum()) < 0.9 * area[flat].sum():
            continue
        level = next((other_level for other_level in levels if abs(level - other_level) <= within), level)
        levels.append(level)
        near_flat = np.abs(height - level) < 3.0 * within
        is_in_flat = np.zeros(len(near_flat), dtype=bool)
        is_in_flat[flat] = True
        for piece in _connected_groups(graph, near_flat):
            if is_in_flat[piece].any():
                height_offset = height[piece] - level
                blend = np.clip((np.abs(height_offset) - within) / (2.0 * within), 0.0, 1.0)
                height[piece] = level + height_offset * blend * blend * (3.0 - 2.0 * blend)
    return TriangleMesh(np.column_stack([mesh.vertices[:, :2], height]), mesh.faces)


def _connected_groups(graph: csr_array, is_chosen: BoolArray) -> list[IntArray]:
    """Return the connected groups of the vertices that ``is_chosen`` (V,) marks."""
    rows = np.flatnonzero(is_chosen)
    if not len(rows):
        return []
    _, label = connected_components(graph[rows][:, rows], directed=False)
    order = np.argsort(label, kind="stable")
    return np.split(rows[order], np.flatnonzero(np.diff(label[order])) + 1)


def _untangle(mesh: TriangleMesh, directions: FloatArray, rim: IntArray) -> FloatArray:
    """Return the vertices (V, 3) [m] without slivers and triangles that noise has inverted or rotated.

    Their corners are moved normal to ``directions`` (V, 3), between their neighbours.
    """
    vertices, graph = mesh.vertices.copy(), _adjacency(mesh)
    degree = np.maximum(graph.sum(axis=1), 1.0)[:, None]
    for _ in range(_MAX_UNTANGLING_ITERATIONS):
        up = directions[mesh.faces].sum(axis=1)
        current = TriangleMesh(vertices, mesh.faces)
        cosine = dots(face_normals(current), up) / np.maximum(np.linalg.norm(up, axis=1), 1e-300)
        corner = vertices[mesh.faces]
        longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1)
        is_sliver = 2.0 * face_areas(current) < _SLIVER_RATIO * longest**2
        moved = np.setdiff1d(mesh.faces[(cosine < _MAX_ROTATION_COSINE) | is_sliver], rim)
        if not len(moved):
            break
        shift = (graph[moved] @ vertices) / degree[moved] - vertices[moved]
        vertices[moved] += shift - dots(shift, directions[moved])[:, None] * directions[moved]
    return np.asarray(vertices)


def _stiffness_length(sigma: float, spacing: FloatArray | float) -> FloatArray:
    """Return the length [m] of the plate's stiffness that leaves slopes and curvatures the intended noise."""
    h, s = np.asarray(spacing) * 1e3, sigma * 1e3
    return np.asarray(
        np.maximum(np.sqrt(0.2 * s * h / _SLOPE_NOISE), np.cbrt(0.22 * s * h / _SLOPE_NOISE)) * 1e-3
    )


def _hinge_bending(
    mesh: TriangleMesh, hinges: _MeshHinges, sigma: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return quantities of each hinge for a noise of ``sigma`` [m].

    Returns:
        Weights (E, 4) of its vertices in its bending, stiffness (E,), angle (E,) [rad] and spacing of
        vertices (E,) [m].
    """
    i, j, k, m = (mesh.vertices[hinges.ends[:, n]] for n in range(4))
    cot_ik, cot_im = _cotangent(j - i, k - i), _cotangent(j - i, m - i)
    cot_jk, cot_jm = _cotangent(i - j, k - j), _cotangent(i - j, m - j)
    bend = np.stack([cot_jk + cot_jm, cot_ik + cot_im, -cot_ik - cot_jk, -cot_im - cot_jm], axis=1)
    area = face_areas(mesh)[hinges.faces].sum(axis=1)
    area = np.maximum(area, 0.1 * float(np.median(area)))
    spacing = np.sqrt(area)
    normals = face_normals(mesh)
    angle = np.arccos(np.clip(dots(normals[hinges.faces[:, 0]], normals[hinges.faces[:, 1]]), -1.0, 1.0))
    return bend, _stiffness_length(sigma, spacing) ** 4 * 3.0 / area, angle, spacing


def _cotangent(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return limited cotangents (E,) of the angles between vectors (E, 3)."""
    cross = np.linalg.norm(np.cross(first, second), axis=1)
    return np.asarray(
        np.clip(dots(first, second) / np.maximum(cross, 1e-300), -_MAX_COTANGENT, _MAX_COTANGENT)
    )


def _hinge_normals(vertices: FloatArray, faces: IntArray, hinges: _MeshHinges) -> FloatArray:
    """Return the mean unit normals (E, 3) of both faces of each hinge, weighted by area."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal_sum = cross[hinges.faces].sum(axis=1)
    return np.asarray(normal_sum / np.maximum(np.linalg.norm(normal_sum, axis=1, keepdims=True), 1e-300))


def _find_hinges(mesh: TriangleMesh) -> _MeshHinges:
    """Return the edges that two faces share."""
    faces, count = mesh.faces, len(mesh.vertices)
    directed = np.concatenate([faces[:, [0, 1, 2]], faces[:, [1, 2, 0]], faces[:, [2, 0, 1]]])
    owner = np.tile(np.arange(len(faces)), 3)
    key = directed[:, :2].min(axis=1) * count + directed[:, :2].max(axis=1)
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order][1:] == key[order][:-1])
    first, second = order[twin], order[twin + 1]
    ends = np.column_stack([directed[first], directed[second, 2]])
    return _MeshHinges(ends, np.column_stack([owner[first], owner[second]]))


def _adjacency(mesh: TriangleMesh) -> csr_array:
    """Return the adjacency matrix (V, V) of the vertices."""
    count = len(mesh.vertices)
    pairs = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    return csr_array(((graph + graph.T) > 0).astype(np.float64))


def _average_neighbours(graph: csr_array, values: FloatArray, steps: int) -> FloatArray:
    """Return values (V,) or (V, 3) averaged with those of neighbours, in so many ``steps``."""
    degree = 1.0 + graph.sum(axis=1)
    degree = degree[:, None] if values.ndim == 2 else degree
    for _ in range(steps):
        values = (values + graph @ values) / degree
    return np.asarray(values)


def _smooth_normals(mesh: TriangleMesh, normals: FloatArray, steps: int) -> FloatArray:
    """Return unit normals (V, 3) averaged with those of neighbours, in so many ``steps``."""
    averaged = _average_neighbours(_adjacency(mesh), normals, steps)
    return np.asarray(averaged / np.maximum(np.linalg.norm(averaged, axis=1, keepdims=True), 1e-300))


def _tangent_vectors(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (N, 3) each, normal to unit normals (N, 3) and to each other."""
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    u = np.cross(normal, axis)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(normal, u)
