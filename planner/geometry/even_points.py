"""Points spread evenly over a surface, and the cells of the surface that belong to them.

Farthest points first (T. F. Gonzalez, Clustering to minimize the maximum intercluster distance, 1985),
then Lloyd's rounds: each point goes to the middle of its cell. A cell is a set of vertices of the mesh
cut fine, and hangs together. Ties of symmetric surfaces are broken by a fixed number of each vertex, so
that rounding of the mesh decides nothing.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, distinct_rows, dots
from planner.geometry.mesh import TriangleMesh, face_areas, vertex_normals

CUT: Final = 5.0
"""Edges of the fine mesh in one distance between points, at least."""
_FITTED: Final = 2.5
"""Cells around a point whose vertices a quadric is fitted to."""
_ONE_SIDE: Final = 0.1
"""Ratio of principal curvatures from which on panels are to be convex."""
_ROUNDS: Final = 40
"""Lloyd's rounds."""
_FIRST: Final = 50
"""Farthest points that are held against all vertices: few are farther from later ones than they reach."""
_JITTER: Final = 0.02
"""Share by which distances of farthest points are changed to break ties."""


@dataclasses.dataclass(frozen=True)
class FineSurface:
    """A surface cut fine: ``mesh``, ``normal`` (V, 3) unit, ``area`` (V,) [m^2] that belongs to each
    vertex; ``spacing`` [m] is the side of a square that is one cell."""

    mesh: TriangleMesh
    normal: FloatArray
    area: FloatArray
    spacing: float


def cut_fine(mesh: TriangleMesh, count: int, cut: float = CUT) -> FineSurface:
    """The surface with at least ``cut`` edges along each side of ``count`` cells of it: some fifty vertices
    each where that is 5."""
    spacing = float(np.sqrt(face_areas(mesh).sum() / count))
    fine = mesh
    while True:
        finer = _halved(fine, spacing / cut)
        if len(finer.faces) == len(fine.faces):
            break
        fine = finer
    area = np.zeros(len(fine.vertices))
    np.add.at(area, fine.faces.reshape(-1), np.repeat(face_areas(fine) / 3.0, 3))
    return FineSurface(fine, vertex_normals(fine), area, spacing)


def _halved(mesh: TriangleMesh, longest: float) -> TriangleMesh:
    """Edges longer than ``longest`` [m] halved, each face in two, three or four."""
    faces = mesh.faces
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
    key = np.sort(sides, axis=2).reshape(-1, 2)
    edges, _, inverse = distinct_rows(key)
    ends = mesh.vertices[edges]
    long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > longest
    if not long.any():
        return mesh
    middle = np.full(len(edges), -1, dtype=np.int64)
    middle[long] = len(mesh.vertices) + np.arange(int(long.sum()))
    vertices = np.concatenate([mesh.vertices, ends[long].mean(axis=1)])
    at = middle[np.reshape(inverse, (-1, 3))]
    many = (at >= 0).sum(axis=1)
    done = [faces[many == 0]]
    for number in (1, 2, 3):
        some = np.flatnonzero(many == number)
        # turned until the cut side is the first (one), or the whole side is the last (two)
        turn = np.argmax(at[some] >= 0, axis=1) if number < 2 else (np.argmax(at[some] < 0, axis=1) + 1) % 3
        order = (turn[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(faces[some], order, axis=1).T
        p, q, r = np.take_along_axis(at[some], order, axis=1).T
        if number == 1:
            parts = [(a, p, c), (p, b, c)]
        elif number == 2:
            parts = [(p, b, q), (a, p, q), (a, q, c)]
        else:
            parts = [(a, p, r), (p, b, q), (r, q, c), (p, q, r)]
        done += [np.stack(part, axis=1) for part in parts]
    return TriangleMesh(vertices, np.concatenate(done))


def spread(surface: FineSurface, count: int) -> FloatArray:
    """Points (count, 3) [m] near the surface, each in the middle of the cell that is nearest to it."""
    at = surface.mesh.vertices
    # a fixed number of each vertex in [0, 1): fractional parts of multiples of the golden section
    chance = np.modf(np.arange(1, len(at) + 1) * 0.6180339887498949)[0]
    weight = 1.0 + _JITTER * (chance - 0.5)
    tree = KDTree(at)
    apart = np.full(len(at), np.inf)
    ranked = apart.copy()
    found = [at[int(np.argmax(weight * np.linalg.norm(at - at.mean(axis=0), axis=1)))]]
    near: IntArray = np.arange(len(at))
    while True:
        off = at[near] - found[-1]
        apart[near] = np.minimum(apart[near], dots(off, off))
        ranked[near] = weight[near] * apart[near]
        if len(found) == count:
            break
        last = int(np.argmax(ranked))
        found.append(at[last])
        if len(found) > _FIRST:  # beyond the farthest way that is left the new point takes nothing
            reach = np.sqrt(ranked[last] / (1.0 - 0.5 * _JITTER)) * (1.0 + 1e-9)
            near = np.array(tree.query_ball_point(found[-1], reach), dtype=np.int64)
    points = np.array(found)
    for _ in range(_ROUNDS):
        points = middles(surface, np.asarray(KDTree(points).query(at)[1]), points)
    return points


def middles(surface: FineSurface, label: IntArray, points: FloatArray) -> FloatArray:
    """Middles (N, 3) [m] of the cells that ``label`` (V,) says; a point without a cell stays."""
    total = np.bincount(label, weights=surface.area, minlength=len(points))
    sums = [
        np.bincount(label, weights=surface.area * surface.mesh.vertices[:, i], minlength=len(points))
        for i in range(3)
    ]
    mean = np.stack(sums, axis=1) / np.maximum(total, 1e-300)[:, None]
    return np.asarray(np.where(total[:, None] > 0.0, mean, points))


def cells(surface: FineSurface, points: FloatArray) -> IntArray:
    """Which point each vertex (V,) belongs to: the nearest. Each cell hangs together: parts that the cell's
    largest part does not touch go to neighbours."""
    return _whole(surface, np.asarray(KDTree(points).query(surface.mesh.vertices)[1], dtype=np.int64))


def _whole(surface: FineSurface, label: IntArray) -> IntArray:
    faces = surface.mesh.faces
    edges = distinct_rows(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1))[0]
    label = label.copy()
    for _ in range(3):
        same = edges[label[edges[:, 0]] == label[edges[:, 1]]]
        graph = coo_array((np.ones(len(same)), (same[:, 0], same[:, 1])), shape=(len(label), len(label)))
        _, part = connected_components(graph, directed=False)
        size = np.bincount(part)
        order = np.lexsort((-size[part], label))
        head = np.ones(len(order), dtype=np.bool_)
        head[1:] = label[order][1:] != label[order][:-1]
        main = np.zeros(len(size), dtype=np.bool_)
        main[part[order[head]]] = True
        loose = ~main[part]
        if not loose.any():
            break
        while loose.any():
            both = np.concatenate([edges, edges[:, ::-1]])
            take = both[loose[both[:, 0]] & ~loose[both[:, 1]]]
            if not len(take):
                break
            label[take[::-1, 0]] = label[take[::-1, 1]]
            loose[take[:, 0]] = False
    return label


def bending(
    surface: FineSurface, points: FloatArray, cells: int | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normals (N, 3), principal curvatures (N, 2) [1/m], the larger first, and directions (N, 2, 3).

    From the quadric that fits the surface best around each point, over some of the ``cells`` that there are
    on it (none: as many as points). Positive: the surface bends away from
    its normal, as a dome's does whose normals point outwards.
    """
    vertices = surface.mesh.vertices
    count = min(max(int(_FITTED * len(vertices) / (cells or len(points))), 12), len(vertices))
    asked = KDTree(vertices).query(points, k=count)
    reach, near = np.asarray(asked[0]), np.asarray(asked[1])
    reach, near = reach[:, :: 1 + count // 300], near[:, :: 1 + count // 300]
    place = vertices[near]
    normal = surface.normal[near[:, :8]].sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    for _ in range(2):
        one = np.cross(normal, axis)
        one /= np.linalg.norm(one, axis=1, keepdims=True)
        two = np.cross(normal, one)
        rest = place - points[:, None]
        u, v, w = (np.einsum("nki,ni->nk", rest, way) for way in (one, two, normal))
        # sheets that lie behind are no neighbours
        mine = np.einsum("nki,ni->nk", surface.normal[near], normal) > 0.3
        gain = surface.area[near] * np.exp(-2.0 * (reach / reach[:, -1:]) ** 2) * mine
        terms = np.stack([np.ones_like(u), u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=2)
        square = np.einsum("nka,nk,nkb->nab", terms, gain, terms)
        scale = np.sqrt(np.maximum(np.einsum("naa->na", square), 1e-300))
        square = square / scale[:, :, None] / scale[:, None, :] + 1e-12 * np.eye(6)
        right = np.einsum("nka,nk,nk->na", terms, gain, w) / scale
        found = np.linalg.solve(square, right[..., None])[..., 0] / scale
        normal = normal - found[:, 1:2] * one - found[:, 2:3] * two
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shape = -np.stack([found[:, [3, 4]], found[:, [4, 5]]], axis=1)
    value, way = np.linalg.eigh(shape)
    direction = np.einsum("nij,nix->njx", way, np.stack([one, two], axis=1))
    return normal, value[:, ::-1], direction[:, ::-1]


def synclastic(curvature: FloatArray) -> BoolArray:
    """Which places (N,) of principal curvatures (N, 2) [1/m] bend to one side, and not nearly in one way."""
    product = curvature[:, 0] * curvature[:, 1]
    return np.asarray(product > _ONE_SIDE * np.abs(curvature).max(axis=1) ** 2)
