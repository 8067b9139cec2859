"""The wanted surfaces of a part as walls: how far points are off the nearest one, and on which side."""

from __future__ import annotations

import dataclasses

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
_NEIGHBOURS = 12
_SAME = 1e-7


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
        surface (N,) it belongs to. NaN where the nearest place is on the border of a surface: what is beyond
        it is not known."""
        middle = self.corners.mean(axis=1)
        count = min(_NEIGHBOURS, len(middle))
        _, near = cKDTree(middle).query(points, k=count)
        near = near.reshape(len(points), count)
        best = np.full(len(points), np.inf)
        found = np.empty((len(points), count))
        places, weights = np.empty((*found.shape, 3)), np.empty((*found.shape, 3))
        for i in range(count):
            places[:, i], weights[:, i] = closest(points, *np.moveaxis(self.corners[near[:, i]], 1, 0))
            found[:, i] = np.linalg.norm(points - places[:, i], axis=1)
            best = np.minimum(best, found[:, i])
        # at an edge or a corner all its triangles count
        same = found <= best[:, None] + _SAME
        normal = np.einsum("nk,nki->ni", same, self.normal[near])
        row = np.arange(len(points))
        first = np.argmin(found, axis=1)
        outward = dots(points - places[row, first], normal) >= 0.0
        tri, share = near[row, first], weights[row, first]
        # an edge is met where the corner across it has no weight
        edge = np.roll(share < 1e-9, -2, axis=1) & self.border[tri]
        off = np.where(outward, best, -best)
        return np.where(edge.any(axis=1), np.nan, off), self.owner[tri]


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
