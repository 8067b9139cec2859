"""The wanted surfaces of a part as walls: how far points are off the nearest one, and on which side."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.claims import CutsSurface
from planner.geometry.vectors import dots
from planner.verify.surface import closest

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

EDGE = 0.004
"""Longest edge of the triangles that walls are divided into [m], within ``MOST``."""
MOST = 40_000
_PAIRS = 400_000
_SAME = 1e-7
_MET = 1e-9
"""Triangles meet in places that are no farther apart [m]."""


@dataclasses.dataclass(frozen=True)
class Walls:
    """Triangles ``corners`` (F, 3, 3) [m] with unit ``normal`` (F, 3) away from the part, ``owner`` (F,) the
    surface that each belongs to, and ``border`` (F, 3) which of the edges, each behind a corner, nothing
    joins."""

    corners: FloatArray
    normal: FloatArray
    owner: IntArray
    border: NDArray[np.bool_]

    def off(self, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """Distance (N,) [m] of points (N, 3) to the nearest wall, negative on the part's side, and the
        surface (N,) it belongs to. NaN where the nearest place is on the border of a surface: there it ends,
        and what is beyond it is not known."""
        best = np.full(len(points), np.inf)
        for own, tree, _ in self._near:
            best = np.minimum(best, _apart(points, self.corners[own[tree.query(points, k=1)[1]]]))
        # a triangle may be the nearest whose middle is not
        found = [tree.query_ball_point(points, best + reach) for _, tree, reach in self._near]
        lists = [
            [own[np.asarray(one, dtype=np.int64)] for one in rows]
            for (own, _, _), rows in zip(self._near, found, strict=True)
        ]
        near = [np.concatenate(one) for one in zip(*lists, strict=True)]
        off, owner = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
        counts = np.array([len(one) for one in near], dtype=np.int64)
        parts = np.cumsum(counts) // _PAIRS
        for number in np.unique(parts):
            rows = np.flatnonzero(parts == number)
            row = np.repeat(np.arange(len(rows)), counts[rows])
            tri = np.concatenate([near[k] for k in rows])
            off[rows], owner[rows] = self._nearest(points[rows], row, tri)
        return off, owner

    @functools.cached_property
    def _near(self) -> list[tuple[IntArray, cKDTree, float]]:
        """The triangles, those of about one size together, by their middles, and how far [m] corners are
        from these at most."""
        middle = self.corners.mean(axis=1)
        far = np.linalg.norm(self.corners - middle[:, None], axis=2).max(axis=1)
        size = np.ceil(np.log2(np.maximum(far, _SAME)) / 2.0).astype(np.int64)
        groups = [np.flatnonzero(size == one) for one in np.unique(size)]
        return [(own, cKDTree(middle[own]), float(far[own].max()) + _SAME) for own in groups]

    def _nearest(self, points: FloatArray, row: IntArray, tri: IntArray) -> tuple[FloatArray, IntArray]:
        """As :meth:`off`, where triangles ``tri`` (K,) may be nearest to points ``row`` (K,), in ascending
        order and none of the N left out."""
        place, share = closest(points[row], *np.moveaxis(self.corners[tri], 1, 0))
        way = points[row] - place
        found = np.linalg.norm(way, axis=1)
        begin = np.searchsorted(row, np.arange(len(points)))
        best = np.minimum.reduceat(found, begin)
        same = found <= best[row] + _SAME
        # an edge is met where the corner across it has no weight; at a corner of the border triangles meet
        # that have no edge on it, and all that are as near count
        edge = same & (np.roll(share < 1e-9, -2, axis=1) & self.border[tri]).any(axis=1)
        order = np.lexsort((tri, found, row))[begin]
        # at an edge as sharp as a wing's what is nearly as near lies on the other side of it: the same place
        met = np.linalg.norm(place - place[order][row], axis=1) <= _MET
        weight = np.where(met, self._angle(share, tri), 0.0)
        normal = np.add.reduceat(weight[:, None] * self.normal[tri], begin)
        outward = dots(way[order], normal) >= 0.0
        off = np.where(outward, best, -best)
        return np.where(np.logical_or.reduceat(edge, begin), np.nan, off), self.owner[tri[order]]

    def _angle(self, share: FloatArray, tri: IntArray) -> FloatArray:
        """How much (K,) [rad] triangles lie around places with barycentric weights (K, 3) in them.

        The normals so weighted tell the side of edges and corners, however sharp: Baerentzen and Aanaes,
        Signed distance computation using the angle weighted pseudonormal (2005).
        """
        apart = share < 1e-9
        at = np.argmax(share, axis=1)
        here, one, two = (self.corners[tri, (at + k) % 3] for k in range(3))
        a, b = one - here, two - here
        cosine = dots(a, b) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-30)
        tip = np.arccos(np.clip(cosine, -1.0, 1.0))
        return np.asarray(np.choose(np.minimum(apart.sum(axis=1), 2), [2.0 * np.pi, np.pi, tip]))


def _apart(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Distance (N,) [m] of points (N, 3) to one triangle (N, 3, 3) each."""
    place, _ = closest(points, *np.moveaxis(corners, 1, 0))
    return np.asarray(np.linalg.norm(points - place, axis=1))


def walls(claims: tuple[CutsSurface, ...]) -> Walls:
    """The wanted surfaces in triangles small enough to be found by their middles."""
    corners, border, owner = [], [], []
    for number, claim in enumerate(claims):
        triangles = claim.vertices[claim.faces]
        size = np.linalg.norm(
            np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
        )
        triangles, free = _halved(triangles[size > 0.0], _open(claim)[size > 0.0])
        corners.append(triangles)
        border.append(free)
        owner.append(np.full(len(triangles), number))
    all_corners = np.concatenate(corners)
    normal = np.cross(all_corners[:, 1] - all_corners[:, 0], all_corners[:, 2] - all_corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    return Walls(all_corners, normal, np.concatenate(owner), np.concatenate(border))


def _open(claim: CutsSurface) -> NDArray[np.bool_]:
    """Which edges (F, 3), each from a corner to the next, belong to one triangle alone; vertices at one place
    are one."""
    _, one = np.unique(claim.vertices.round(8), axis=0, return_inverse=True)
    faces = one.ravel()[claim.faces]
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, which, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    return np.asarray((count[which.ravel()] == 1).reshape(-1, 3))


def _halved(corners: FloatArray, border: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Triangles (F, 3, 3) halved across their longest edges until these are short, with their borders
    (F, 3)."""
    for _ in range(40):
        edge = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        long = edge.max(axis=1) > EDGE
        if not long.any() or len(corners) + int(long.sum()) > MOST:
            break
        turn = (np.argmax(edge[long], axis=1)[:, None] + np.arange(3)) % 3
        row = np.arange(len(turn))[:, None]
        (a, b, c), free = np.moveaxis(corners[long][row, turn], 1, 0), border[long][row, turn]
        middle = 0.5 * (a + b)
        none = np.zeros(len(a), dtype=np.bool_)
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        corners = np.concatenate([corners[~long], *halves])
        ends = (
            np.stack([free[:, 0], none, free[:, 2]], axis=1),
            np.stack([free[:, 0], free[:, 1], none], axis=1),
        )
        border = np.concatenate([border[~long], *ends])
    return corners, border
