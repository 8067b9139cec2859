"""Meshes as exporters and scanners leave them: their flaws mended, their noise found and smoothed.

Flaws that no face has: triangles that are given twice, cracks between them, rims that are off the
flat by micrometres.

Noise is how far the vertices are off the face that is meant, found from the mesh itself: what
hinges (two triangles at an edge) and small neighbourhoods have in common. A smooth face bends its
hinges but leaves a quadric nothing over, a mesh of few large facets has folds that no quadric fits
but flat hinges beside them. The least of both is noise of the vertices.

The smooth face that is meant within the noise is a weak plate (Blake and Zisserman, Visual
reconstruction, MIT Press, 1987): of all faces the one with the least sum of squared distances from
the vertices and of bending energy, in which hinges that turn by more than a smooth face would are
counted less and less, so that folds stay folds. The bending energy of hinges is that of Bergou et
al., A quadratic bending model for inextensible surfaces, SGP 2006.
"""

import dataclasses
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import aslinearoperator, cg
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, distinct_rows, dots
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals, merge, vertex_normals

CRACK_WIDTH: Final = 1e-5
"""Edges so near to each other [m] are one, where a mesh has cracks."""
RIM_OFFSET: Final = 2e-5
"""Corners of a sharp rim so near to the flat [m] are on it."""
SHARP_RIM_COSINE: Final = float(np.cos(np.radians(20.0)))
"""Cosine of the slope (20 degrees) from which on a rim is sharp."""
_SEWING_ROUNDS: Final = 8
"""Rounds in which open rims are joined at most; each one closes what the one before left."""


def sewn(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh without faces that are given twice, its cracks closed: vertices and edges of borders that are
    within `CRACK_WIDTH` of each other become one. A mesh without such flaws comes back as it is."""
    _, first, _ = distinct_rows(np.sort(mesh.faces, axis=1))
    if len(first) < len(mesh.faces):
        mesh = TriangleMesh(mesh.vertices, mesh.faces[np.sort(first)])
    for _ in range(_SEWING_ROUNDS):
        rim = border(mesh.faces)
        if not len(rim) or _loops(rim) == 1:
            return mesh
        before = len(rim)
        mesh = _zipped(_welded(mesh, rim))
        if len(border(mesh.faces)) == before:
            return mesh
    return mesh


def border(faces: IntArray) -> IntArray:
    """Edges (E, 2) that belong to one face only, in the direction of that face."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first, which = distinct_rows(np.sort(edges, axis=1))
    return np.asarray(edges[first[np.bincount(which, minlength=len(first)) == 1]])


def rims_levelled(mesh: TriangleMesh, level: float, within: float) -> TriangleMesh:
    """The mesh with the corners of sharp rims that are ``within`` [m] of the flat at ``level`` [m] put onto
    it, and with them bumps of the flat that are no higher than that."""
    off = np.abs(mesh.vertices[:, 2] - level)
    doubtful = (off > 0.0) & (off <= within)
    if not doubtful.any():
        return mesh
    sharp = np.zeros(len(off), dtype=bool)
    sharp[mesh.faces[np.abs(face_normals(mesh)[:, 2]) < SHARP_RIM_COSINE]] = True
    # what hangs together off the flat and is nowhere higher than that is a bump
    raised = off > 0.0
    edges = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = edges[raised[edges].all(axis=1)]
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(off), len(off)))
    _, label = connected_components(graph, directed=False)
    high = np.zeros(int(label.max()) + 1)
    np.maximum.at(high, label, off)
    chosen = doubtful & (sharp | (high[label] <= within))
    vertices = mesh.vertices.copy()
    vertices[chosen, 2] = level
    return TriangleMesh(vertices, mesh.faces)


def _loops(rim: IntArray) -> int:
    used, index = np.unique(rim, return_inverse=True)
    ends = index.reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(used), len(used)))
    return int(connected_components(graph, directed=False)[0])


def _welded(mesh: TriangleMesh, rim: IntArray) -> TriangleMesh:
    """Vertices of borders at one place made one."""
    used = np.unique(rim)
    pairs = cKDTree(mesh.vertices[used]).query_pairs(CRACK_WIDTH, output_type="ndarray")
    if not len(pairs):
        return mesh
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(used), len(used)))
    _, label = connected_components(graph, directed=False)
    first = np.full(int(label.max()) + 1, len(mesh.vertices))
    np.minimum.at(first, label, used)
    onto = np.arange(len(mesh.vertices))
    onto[used] = first[label]
    faces = onto[mesh.faces]
    whole = (faces != np.roll(faces, -1, axis=1)).all(axis=1)
    return merge(TriangleMesh(mesh.vertices, faces[whole]))


def _zipped(mesh: TriangleMesh) -> TriangleMesh:
    """Faces at whose free edge corners of others lie divided there, at one edge of each."""
    rim = border(mesh.faces)
    used = np.unique(rim)
    start, way = mesh.vertices[rim[:, 0]], mesh.vertices[rim[:, 1]] - mesh.vertices[rim[:, 0]]
    length = np.linalg.norm(way, axis=1)
    near = cKDTree(mesh.vertices[used]).query_ball_point(start + 0.5 * way, 0.5 * length + CRACK_WIDTH)
    divided: dict[tuple[int, int], list[int]] = {}
    for row, found in enumerate(near):
        others = used[np.array(found, dtype=np.int64)]
        others = others[~np.isin(others, rim[row])]
        rest = mesh.vertices[others] - start[row]
        share = rest @ way[row] / max(length[row] ** 2, 1e-30)
        off = np.linalg.norm(rest - share[:, None] * way[row], axis=1)
        on = (
            (off <= CRACK_WIDTH)
            & (share * length[row] > CRACK_WIDTH)
            & ((1.0 - share) * length[row] > CRACK_WIDTH)
        )
        if on.any():
            order = np.argsort(share[on])
            divided[(int(rim[row, 0]), int(rim[row, 1]))] = others[on][order].tolist()
    if not divided:
        return mesh
    faces = []
    for face in mesh.faces.tolist():
        sides = list(zip(face, face[1:] + face[:1], face[2:] + face[:2], strict=True))
        between, (a, b, apex) = max(
            ((divided.get((a, b), []), (a, b, c)) for a, b, c in sides), key=lambda item: len(item[0])
        )
        line = [a, *(v for v in between if v != apex), b]
        faces += [[one, two, apex] for one, two in pairwise(line)]
    return TriangleMesh(mesh.vertices, np.array(faces, dtype=np.int64))


LEAST_NOISE: Final = 4e-6
"""Noise [m] below which a mesh is what its maker meant: rounding of coordinates and chords of curves."""
NOISE_BOUND_DEVIATIONS: Final = 3.0
"""Vertices are within so many standard deviations of their face, but for 0.3 % of them (normal noise)."""
_SMOOTH_HINGE_SHARE: Final = 0.2
"""Share of the hinges that are surely no folds."""
_NORMAL_QUANTILE: Final = 0.2533
"""This share of normal values of unit deviation (`_SMOOTH_HINGE_SHARE`, 0.2) is smaller in size."""
_QUADRIC_NEIGHBOURS: Final = 20
"""Vertices that one quadric is fitted to."""
_MOST_QUADRICS: Final = 4000
"""Quadrics that are fitted at most, at vertices evenly spread over the list."""
_UNIT_RESIDUAL_QUARTILE: Final = 0.86
"""Lower quartile of the residual of quadrics for unit noise."""
_SLOPE: Final = 0.005
"""Noise [rad] of the slope that the smoothed face may have left, and [1/mm] of its curvature."""
_FOLD_RADIUS: Final = 2.5e-3
"""Smooth faces are bent less than a ball of this radius [m]; what is bent more may be a fold."""
_FOLD_FACTORS: Final = (8.0, 4.0, 2.0, 1.0, 1.0, 1.0)
"""Hinges that turn by more than a smooth face's, times these, count less, in one round after the other."""
_MOST_COTANGENT: Final = 20.0
"""Largest cotangent of a triangle's angle that counts: slivers are not stiffer."""
_MEAN_RINGS: Final = 6
"""Rings of neighbours over which the mean is taken by which a plate is too stiff."""
_BIAS_FACTOR: Final = 4.0
"""Means of deviations beyond so many times their median are no chance: the plate is too stiff there."""
_BIAS_SHARE: Final = 0.6
"""Share of the noise by which the face may be off in the mean."""
_SOFTEST: Final = 1e-6
"""Least share of its stiffness that a plate keeps."""
_FLAT_COSINE: Final = float(np.cos(np.radians(2.5)))
"""Cosine of the slope (2.5 degrees) up to which a place may be part of a flat."""
_FLAT_AREA: Final = 5e-5
"""Area [m^2] from which on a flat is one: 8 mm across."""
_ASIDE_COSINE: Final = 0.5
"""Cosine of the angle by which noise may turn a triangle aside before its corners are moved."""
_SLIVER_RATIO: Final = 0.05
"""Height over longest edge below which a triangle is a sliver."""
_UNTANGLING_ROUNDS: Final = 20
"""Rounds at most in which corners of folded triangles and slivers are moved to their neighbours' mean."""


@dataclasses.dataclass(frozen=True)
class _Hinges:
    """Inner edges: ``ends`` (E, 4) vertices, those of the edge, then the corners across; ``faces`` (E, 2)."""

    ends: IntArray
    faces: IntArray


def vertex_noise(mesh: TriangleMesh) -> float:
    """Standard deviation [m] of the vertices from the face that is meant; 0 for a mesh of few facets."""
    hinges = _hinges(mesh)
    if len(hinges.ends) < 8:
        return 0.0
    i, j, k, m = (mesh.vertices[hinges.ends[:, n]] for n in range(4))
    a, b, c = j - i, k - i, m - i
    volume = np.abs(dots(np.cross(a, b), c))
    slopes = (np.cross(b, c), np.cross(c, a), np.cross(a, b))
    own = sum(dots(s, s) for s in slopes)
    rest = slopes[0] + slopes[1] + slopes[2]
    size = volume / np.sqrt(np.maximum(own + dots(rest, rest), 1e-300))
    order = np.argsort(size)
    # slivers that divide an edge are as flat as can be and say nothing
    passed = np.cumsum(face_areas(mesh)[hinges.faces].min(axis=1)[order])
    place = int(np.searchsorted(passed, _SMOOTH_HINGE_SHARE * passed[-1]))
    by_hinge = float(size[order[min(place, len(order) - 1)]]) / _NORMAL_QUANTILE
    if by_hinge < LEAST_NOISE:
        return 0.0
    found = min(by_hinge, _by_quadric(mesh))
    return found if found >= LEAST_NOISE else 0.0


def _by_quadric(mesh: TriangleMesh) -> float:
    points = mesh.vertices
    if len(points) <= _QUADRIC_NEIGHBOURS:
        return 0.0
    rows = np.unique(np.linspace(0, len(points) - 1, _MOST_QUADRICS).astype(np.int64))
    _, near = cKDTree(points).query(points[rows], k=_QUADRIC_NEIGHBOURS)
    normal = _smoothed(mesh, vertex_normals(mesh), 3)[rows]
    u, v = _tangents(normal)
    rest = points[near] - points[rows][:, None]
    size = np.linalg.norm(rest, axis=2).max(axis=1)[:, None]
    x, y = (np.einsum("nkd,nd->nk", rest, way) / size for way in (u, v))
    z = np.einsum("nkd,nd->nk", rest, normal)
    q, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1))
    left = z - np.einsum("nkc,nc->nk", q, np.einsum("nkc,nk->nc", q, z))
    sigma = np.sqrt((left**2).sum(axis=1) / (_QUADRIC_NEIGHBOURS - 6))
    return float(np.quantile(sigma, 0.25)) / _UNIT_RESIDUAL_QUARTILE


def fitted_face(mesh: TriangleMesh, sigma: float, level: float) -> TriangleMesh:
    """The face that is meant by a mesh whose vertices are off it by ``sigma`` [m] (standard deviation): the
    same triangles, each vertex moved along the face's normal; the edge of the mesh is flat at the height
    ``level`` [m] along z."""
    hinges, graph = _hinges(mesh), _neighbours(mesh)
    count = len(mesh.vertices)
    area = np.bincount(mesh.faces.reshape(-1), weights=np.repeat(face_areas(mesh) / 3.0, 3), minlength=count)
    area = np.maximum(area, 1e-3 * float(np.median(area)))
    rim = np.unique(border(mesh.faces))
    steps = max(2, round((_length(sigma, np.sqrt(np.median(area))) / np.sqrt(np.median(area))) ** 2))
    way = _smoothed(mesh, vertex_normals(mesh), min(steps, 40))
    way[rim] = [0.0, 0.0, 1.0]
    mesh = TriangleMesh(_untangled(mesh, way, rim), mesh.faces)
    weight = np.where(np.isin(np.arange(count), rim), 1e3, 1.0) * area
    target = np.zeros(count)
    target[rim] = level - mesh.vertices[rim, 2]
    vertices, moved, share = mesh.vertices, np.zeros(count), np.ones(count)
    for wide in _FOLD_FACTORS:
        bend, stiff, angle, spacing = _bending(TriangleMesh(vertices, mesh.faces), hinges, sigma)
        limit = wide * np.maximum(spacing / _FOLD_RADIUS, np.deg2rad(3.0))
        held = stiff * share[hinges.ends[:, :2]].mean(axis=1) / (1.0 + (angle / limit) ** 2)
        middle = _middle(vertices, mesh.faces, hinges)
        values = bend * np.einsum("nkd,nd->nk", way[hinges.ends], middle)
        rows = np.arange(0, 4 * len(middle) + 1, 4)
        matrix = csr_array((values.ravel(), hinges.ends.ravel(), rows), shape=(len(middle), count))
        first = (bend[:, :, None] * mesh.vertices[hinges.ends]).sum(axis=1)
        off = dots(first, middle)
        whole = aslinearoperator((matrix.T @ diags_array(held) @ matrix + diags_array(weight)).tocsr())
        right = weight * target - matrix.T @ (held * off)
        scale = aslinearoperator(diags_array(1.0 / ((matrix * matrix).T @ held + weight)))
        moved, _ = cg(whole, right, x0=moved, M=scale, rtol=1e-5, maxiter=400)
        vertices = mesh.vertices + moved[:, None] * way
        # where the plate is off in the mean it is too stiff for the face
        biased = np.abs(_spread(graph, moved, _MEAN_RINGS))
        share /= 1.0 + (biased / max(_BIAS_FACTOR * float(np.median(biased)), _BIAS_SHARE * sigma)) ** 2
        share = np.exp(_spread(graph, np.log(np.maximum(share, _SOFTEST)), 1))
    face = TriangleMesh(vertices, mesh.faces)
    return TriangleMesh(_untangled(face, _smoothed(face, vertex_normals(face), 2), rim), mesh.faces)


def beside(mesh: TriangleMesh, off: FloatArray, limit: float) -> IntArray:
    """The vertices of the largest connected group of those that are ``off`` (V,) [m] by more than ``limit``
    [m] to one side: noise is off at random, a ridge or groove is not."""
    best, graph = np.zeros(0, dtype=np.int64), _neighbours(mesh)
    for side in (off, -off):
        best = max([best, *_pieces(graph, side > limit)], key=len)
    return best


def levelled(mesh: TriangleMesh, within: float, sheet: float) -> TriangleMesh:
    """The mesh with its flats level, those across z, that of the sheet at the height ``sheet`` [m].

    Where it is ``within`` [m] of the height of a flat it is that high, and where it is three times as far off
    it is as it was; in between one goes over into the other smoothly.
    """
    graph = _neighbours(mesh)
    normal = _spread(graph, vertex_normals(mesh), 2)
    lying = normal[:, 2] > _FLAT_COSINE * np.linalg.norm(normal, axis=1)
    area = np.bincount(
        mesh.faces.reshape(-1), weights=np.repeat(face_areas(mesh) / 3.0, 3), minlength=len(normal)
    )
    height, known = mesh.vertices[:, 2].copy(), [sheet]
    for flat in _pieces(graph, lying):
        if area[flat].sum() < _FLAT_AREA:
            continue
        order = flat[np.argsort(height[flat])]
        passed = np.cumsum(area[order]) / area[order].sum()
        level = float(height[order[int(np.searchsorted(passed, 0.5))]])
        if float(area[flat[np.abs(height[flat] - level) <= 3.0 * within]].sum()) < 0.9 * area[flat].sum():
            continue
        level = next((one for one in known if abs(level - one) <= within), level)
        known.append(level)
        near = np.abs(height - level) < 3.0 * within
        inner = np.zeros(len(near), dtype=bool)
        inner[flat] = True
        for piece in _pieces(graph, near):
            if inner[piece].any():
                off = height[piece] - level
                share = np.clip((np.abs(off) - within) / (2.0 * within), 0.0, 1.0)
                height[piece] = level + off * share * share * (3.0 - 2.0 * share)
    return TriangleMesh(np.column_stack([mesh.vertices[:, :2], height]), mesh.faces)


def _pieces(graph: csr_array, chosen: BoolArray) -> list[IntArray]:
    """The connected groups of the vertices that are ``chosen`` (V,)."""
    rows = np.flatnonzero(chosen)
    if not len(rows):
        return []
    _, label = connected_components(graph[rows][:, rows], directed=False)
    order = np.argsort(label, kind="stable")
    return np.split(rows[order], np.flatnonzero(np.diff(label[order])) + 1)


def _untangled(mesh: TriangleMesh, way: FloatArray, rim: IntArray) -> FloatArray:
    """The vertices (V, 3) [m], those of slivers and of triangles that noise has turned over or aside moved
    square to ``way`` (V, 3) between their neighbours."""
    vertices, graph = mesh.vertices.copy(), _neighbours(mesh)
    degree = np.maximum(graph.sum(axis=1), 1.0)[:, None]
    for _ in range(_UNTANGLING_ROUNDS):
        up = way[mesh.faces].sum(axis=1)
        now = TriangleMesh(vertices, mesh.faces)
        lean = dots(face_normals(now), up) / np.maximum(np.linalg.norm(up, axis=1), 1e-300)
        corner = vertices[mesh.faces]
        longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1)
        thin = 2.0 * face_areas(now) < _SLIVER_RATIO * longest**2
        bad = np.setdiff1d(mesh.faces[(lean < _ASIDE_COSINE) | thin], rim)
        if not len(bad):
            break
        off = (graph[bad] @ vertices) / degree[bad] - vertices[bad]
        vertices[bad] += off - dots(off, way[bad])[:, None] * way[bad]
    return np.asarray(vertices)


def _length(sigma: float, spacing: FloatArray | float) -> FloatArray:
    """Length [m] of the plate's stiffness that leaves slopes and curvatures as little noise as wanted."""
    h, s = np.asarray(spacing) * 1e3, sigma * 1e3
    return np.asarray(np.maximum(np.sqrt(0.2 * s * h / _SLOPE), np.cbrt(0.22 * s * h / _SLOPE)) * 1e-3)


def _bending(
    mesh: TriangleMesh, hinges: _Hinges, sigma: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of hinges the shares (E, 4) of their corners in how they bend, stiffness (E,), angle (E,) [rad] and the
    mesh's spacing (E,) [m] there."""
    i, j, k, m = (mesh.vertices[hinges.ends[:, n]] for n in range(4))
    one, two = _cotangent(j - i, k - i), _cotangent(j - i, m - i)
    three, four = _cotangent(i - j, k - j), _cotangent(i - j, m - j)
    bend = np.stack([three + four, one + two, -one - three, -two - four], axis=1)
    area = face_areas(mesh)[hinges.faces].sum(axis=1)
    area = np.maximum(area, 0.1 * float(np.median(area)))
    spacing = np.sqrt(area)
    normals = face_normals(mesh)
    angle = np.arccos(np.clip(dots(normals[hinges.faces[:, 0]], normals[hinges.faces[:, 1]]), -1.0, 1.0))
    return bend, _length(sigma, spacing) ** 4 * 3.0 / area, angle, spacing


def _cotangent(one: FloatArray, two: FloatArray) -> FloatArray:
    cross = np.linalg.norm(np.cross(one, two), axis=1)
    return np.asarray(np.clip(dots(one, two) / np.maximum(cross, 1e-300), -_MOST_COTANGENT, _MOST_COTANGENT))


def _middle(vertices: FloatArray, faces: IntArray, hinges: _Hinges) -> FloatArray:
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    both = cross[hinges.faces].sum(axis=1)
    return np.asarray(both / np.maximum(np.linalg.norm(both, axis=1, keepdims=True), 1e-300))


def _hinges(mesh: TriangleMesh) -> _Hinges:
    faces, count = mesh.faces, len(mesh.vertices)
    directed = np.concatenate([faces[:, [0, 1, 2]], faces[:, [1, 2, 0]], faces[:, [2, 0, 1]]])
    owner = np.tile(np.arange(len(faces)), 3)
    key = directed[:, :2].min(axis=1) * count + directed[:, :2].max(axis=1)
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order][1:] == key[order][:-1])
    first, second = order[twin], order[twin + 1]
    ends = np.column_stack([directed[first], directed[second, 2]])
    return _Hinges(ends, np.column_stack([owner[first], owner[second]]))


def _neighbours(mesh: TriangleMesh) -> csr_array:
    """(V, V): 1 where an edge joins two vertices."""
    count = len(mesh.vertices)
    pairs = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    return csr_array(((graph + graph.T) > 0).astype(np.float64))


def _spread(graph: csr_array, values: FloatArray, steps: int) -> FloatArray:
    """Values (V,) or (V, 3) averaged with those of neighbours, so many ``steps`` far."""
    degree = 1.0 + graph.sum(axis=1)
    degree = degree[:, None] if values.ndim == 2 else degree
    for _ in range(steps):
        values = (values + graph @ values) / degree
    return np.asarray(values)


def _smoothed(mesh: TriangleMesh, normals: FloatArray, steps: int) -> FloatArray:
    """Unit normals (V, 3) averaged with those of neighbours, so many ``steps`` far."""
    found = _spread(_neighbours(mesh), normals, steps)
    return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300))


def _tangents(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (N, 3) each square to unit normals (N, 3) and to each other."""
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    u = np.cross(normal, axis)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(normal, u)
