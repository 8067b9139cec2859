"""A formed face as the proof looks at it: nearest places, sides, and how near straight ways come to it.

All distances are exact for the triangles. The face goes on flat beyond its border, as the sheet does.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.geometry.closest import closest_on_triangles, corner_normals, small_pieces
from planner.geometry.mesh import TriangleMesh
from planner.geometry.vectors import dots, lengths
from planner.verify.forming_tree import Tree

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

SAME = 1e-7
"""Places whose distances differ by less [m] are equally near."""
CREASE = np.deg2rad(20.0)
"""Triangles that turn by more than this over an edge meet in a crease."""
_SMALLEST = 0.003
_MOST = 150_000
_CHUNK = 10_000


@dataclasses.dataclass(frozen=True)
class Nearest:
    """Of N points: ``place`` (N, 3) nearest on the face, ``apart`` (N,) [m] its distance, ``signed`` (N,) the
    same, negative below the face (its normals point up), beyond the border the height over the flat there.

    All places that are as near, but for what was asked: ``row`` (M,) of the points, ``triangle`` (M,) they
    are on, ``share`` (M, 3) barycentric and ``tied`` (M, 3) themselves.
    """

    place: FloatArray
    apart: FloatArray
    signed: FloatArray
    row: IntArray
    triangle: IntArray
    share: FloatArray
    tied: FloatArray

    def at(self, chosen: IntArray) -> Nearest:
        """Of some of the points, ``chosen`` (K,), in their order."""
        new = np.full(len(self.apart), -1)
        new[chosen] = np.arange(len(chosen))
        row = new[self.row]
        use = np.flatnonzero(row >= 0)
        use = use[np.argsort(row[use], kind="stable")]
        points = self.place[chosen], self.apart[chosen], self.signed[chosen]
        return Nearest(*points, row[use], self.triangle[use], self.share[use], self.tied[use])

    def followed_by(self, other: Nearest) -> Nearest:
        """Of these points and then of the ``other`` ones."""
        return Nearest(
            np.concatenate([self.place, other.place]),
            np.concatenate([self.apart, other.apart]),
            np.concatenate([self.signed, other.signed]),
            np.concatenate([self.row, other.row + len(self.apart)]),
            np.concatenate([self.triangle, other.triangle]),
            np.concatenate([self.share, other.share]),
            np.concatenate([self.tied, other.tied]),
        )


class Face:
    """The triangles of a face ``vertices`` (V, 3) [m], ``faces`` (F, 3) with normals up, however vertices are
    numbered. ``given`` (F, 3, 3) are the corners of all, ``rows`` those of them that have an area."""

    def __init__(self, vertices: FloatArray, faces: IntArray, scale: float) -> None:
        corners = vertices[faces]
        self.given = corners
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(cross, axis=1)
        kept = size > 1e-16
        self.vertices, self.faces = vertices, faces[kept]
        self.rows = np.flatnonzero(kept)
        self.corners = corners[kept]
        self.area = 0.5 * size[kept]
        self.normal = cross[kept] / size[kept, None]
        self.border = _border(vertices, self.faces)
        pieces, self._owner = small_pieces(self.corners, max(_SMALLEST, 0.25 * scale), _MOST)
        self._seeds = cKDTree(pieces.mean(axis=1))
        self._tree = Tree(self.corners)

    @cached_property
    def smooth(self) -> FloatArray:
        """Normals (F, 3, 3) at the corners of the triangles, smooth but over creases. ``faces`` may part at
        creases: places count, not numbers."""
        _, one = np.unique(self.vertices.round(9), axis=0, return_inverse=True)
        first = np.zeros(int(one.max()) + 1, dtype=np.int64)
        first[one.ravel()] = np.arange(len(self.vertices))
        return corner_normals(TriangleMesh(self.vertices, first[one.ravel()[self.faces]]), CREASE)

    def nearest(self, points: FloatArray, within: float = SAME) -> Nearest:
        """The nearest places of the face to points (N, 3) [m], and those that are farther by ``within`` [m]
        at most."""
        apart = np.full(len(points), np.inf)
        kept: list[tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]] = []
        for rows in np.array_split(np.arange(len(points)), max(1, len(points) // _CHUNK)):
            if not len(rows):
                continue
            first = self._owner[np.asarray(self._seeds.query(points[rows])[1])]
            apart[rows] = self._foot(points[rows], first)[2]
            i, owner = self._tree.near_points(points[rows], apart[rows] + within + SAME)
            i = rows[i]
            weights, foot, far = self._foot(points[i], owner)
            np.minimum.at(apart, i, far)
            use = far <= apart[i] + within
            kept.append((i[use], owner[use], weights[use], foot[use], far[use]))
        if not kept:
            none = np.zeros(0, dtype=np.int64)
            return Nearest(points, apart, apart, none, none, np.zeros((0, 3)), np.zeros((0, 3)))
        i, owner, weights, foot, far = (np.concatenate(part) for part in zip(*kept, strict=True))
        order = np.lexsort((far, i))
        i, owner, weights, foot, far = i[order], owner[order], weights[order], foot[order], far[order]
        first = np.flatnonzero(np.diff(i, prepend=-1) != 0)
        same = far <= apart[i] + SAME
        outward = np.zeros((len(points), 3))
        np.add.at(outward, i[same], self.normal[owner[same]])
        back = points - foot[first]
        signed = np.where(dots(back, outward) >= 0.0, apart, -apart)
        signed = np.where(self._beyond(back, owner[first], weights[first]), back[:, 2], signed)
        return Nearest(foot[first], apart, signed, i, owner, weights, foot)

    def value(self, found: Nearest, at_corners: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Least and largest value (N,) of what is known at the corners (F, 3) of the given triangles, over
        the nearest places."""
        values = dots(found.share, at_corners[self.rows[found.triangle]])
        low, high = np.full(len(found.apart), np.inf), np.full(len(found.apart), -np.inf)
        np.minimum.at(low, found.row, values)
        np.maximum.at(high, found.row, values)
        return low, high

    def least(self, start: FloatArray, end: FloatArray, need: FloatArray) -> FloatArray:
        """How near (K,) [m] straight ways from ``start`` to ``end`` (K, 3) come to the face between their
        ends; infinite where it is ``need`` (K,) or more."""
        out = np.full(len(start), np.inf)
        for rows in np.array_split(np.arange(len(start)), max(1, len(start) // _CHUNK)):
            if len(rows):
                which, triangle = self._tree.near_ways(start[rows], end[rows], need[rows])
                which = rows[which]
                near = apart(start[which], end[which], self.corners[triangle])
                np.minimum.at(out, which, near)
        return np.where(out < need, out, np.inf)

    def near_ways(self, start: FloatArray, end: FloatArray, need: FloatArray) -> tuple[IntArray, IntArray]:
        """Pairs of straight ways from ``start`` to ``end`` (K, 3) and triangles that may be nearer than
        ``need`` (K,) [m]."""
        return self._tree.near_ways(start, end, need)

    def _foot(self, points: FloatArray, triangle: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Barycentric weights (M, 3) and places (M, 3) of triangles (M,) nearest to points (M, 3), and how
        far (M,) [m] they are."""
        weights = closest_on_triangles(points, *np.moveaxis(self.corners[triangle], 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, self.corners[triangle])
        return weights, foot, np.linalg.norm(points - foot, axis=1)

    def _beyond(self, back: FloatArray, triangle: IntArray, share: FloatArray) -> BoolArray:
        """Which points (N,), ``back`` (N, 3) off their nearest places, are beyond the face's border."""
        out = np.zeros(len(back), dtype=np.bool_)
        for k in range(3):  # the edge from corner k is met where the corner across it has no weight
            on = (share[:, (k + 2) % 3] < 1e-9) & self.border[triangle, k]
            corner = self.corners[triangle]
            edge = corner[:, (k + 1) % 3] - corner[:, k]
            away = np.stack([edge[:, 1], -edge[:, 0]], axis=1)  # right of the edge, for normals up
            out |= on & ((away * back[:, :2]).sum(axis=1) > 1e-9 * np.linalg.norm(away, axis=1))
        return out


def _border(vertices: FloatArray, faces: IntArray) -> BoolArray:
    """Edges (F, 3), each from a corner to the next, of one triangle alone; vertices at one place are one."""
    _, one = np.unique(vertices.round(9), axis=0, return_inverse=True)
    same = one.ravel()[faces]
    low, high = np.minimum(same, np.roll(same, -1, axis=1)), np.maximum(same, np.roll(same, -1, axis=1))
    _, which, count = np.unique(low * len(vertices) + high, return_inverse=True, return_counts=True)
    return np.asarray((count[which.ravel()] == 1).reshape(-1, 3))


def apart(start: FloatArray, end: FloatArray, triangle: FloatArray) -> FloatArray:
    """How near (M,) [m] the straight ways (M, 3) come to triangles (M, 3, 3): to their edges, or through
    them. What their ends are off is not asked."""
    out = np.full(len(start), np.inf)
    for k in range(3):
        a, b = triangle[:, k], triangle[:, (k + 1) % 3]
        out = np.minimum(out, between_segments(start, end, a, b))
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    one, two = dots(start - triangle[:, 0], normal), dots(end - triangle[:, 0], normal)
    cross = np.flatnonzero(one * two < 0.0)
    if len(cross):
        at = start[cross] + (one[cross] / (one - two)[cross])[:, None] * (end - start)[cross]
        weights = closest_on_triangles(at, *np.moveaxis(triangle[cross], 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, triangle[cross])
        out[cross] = np.minimum(out[cross], np.linalg.norm(at - foot, axis=1))
    return out


def between_segments(p: FloatArray, q: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Distances (M,) [m] of straight ways p q and a b (M, 3)."""
    u, v, w = q - p, b - a, p - a
    uu, uv, vv, uw, vw = dots(u, u), dots(u, v), dots(v, v), dots(u, w), dots(v, w)
    down = uu * vv - uv * uv
    s = np.where(down > 1e-14 * uu * vv, (uv * vw - vv * uw) / np.maximum(down, 1e-300), 0.0)
    s = np.clip(s, 0.0, 1.0)
    t = np.clip((uv * s + vw) / np.maximum(vv, 1e-300), 0.0, 1.0)
    s = np.clip((uv * t - uw) / np.maximum(uu, 1e-300), 0.0, 1.0)
    return lengths(w + s[:, None] * u - t[:, None] * v)
