"""What a ball can reach of a face: how near to a place any ball of its size comes that cuts in nowhere.

A ball above a hollow stays beyond the plane of every place of it, by its radius. So the nearest place that is
left for its centre is that of the planes which are in the way: they are found one by one, each where the best
centre so far still cuts in, and the centre is put to the nearest place that is beyond the last of them. In a
hollow no centre is ever too far off thus, and one that cuts in nowhere is the nearest there is. In a sharp
corner between two planes at the angle a to each other a ball of radius R stays R (1 / cos(a / 2) - 1) off, in
the tip of a cone whose wall has the angle a, R (1 / cos a - 1).
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.geometry.closest import small_pieces
from planner.geometry.vectors import dots
from planner.verify.forming_face import Face

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

TOUCH = 2e-6
"""A ball may cut in by so much [m]."""
LEAST = 3e-5
"""What a ball comes nearer to than this [m] it reaches."""
GRAIN = 0.15
"""Triangles that a ball does not reach are parted into pieces of this share of its radius."""
_ROUNDS = 24
_PLANES = 3
_MOST = 100_000
"""Pieces at most: where there would be more, what a ball does not reach is looked for less closely, and
what is not looked at closely counts as reached."""


def short(face: Face, points: FloatArray, normals: FloatArray, radius: float, side: int) -> FloatArray:
    """How far (N,) [m] balls of ``radius`` [m] on ``side`` of a face stay off ``points`` (N, 3) on it at
    least, whose ``normals`` (N, 3) point up; 0 where they reach them."""
    return np.asarray(
        np.maximum(
            np.linalg.norm(centres(face, points, normals, radius, side) - points, axis=1) - radius, 0.0
        )
    )


def centres(face: Face, points: FloatArray, normals: FloatArray, radius: float, side: int) -> FloatArray:
    """The nearest centres (N, 3) [m] to ``points`` (N, 3) of balls that cut into a face nowhere."""
    found = points + side * radius * normals
    rows = np.arange(len(points))
    # each plane as its unit normal, and how far along it a centre is at least
    normal = np.zeros((len(points), 0, 3))
    level = np.zeros((len(points), 0))
    for _ in range(_ROUNDS):
        near = face.nearest(found[rows])
        room = side * near.signed
        rows_in = room < radius - TOUCH
        rows, near_place, room = rows[rows_in], near.place[rows_in], room[rows_in]
        if not len(rows):
            break
        normal, level = normal[rows_in], level[rows_in]
        way = found[rows] - near_place
        way *= np.sign(room)[:, None]
        length = np.linalg.norm(way, axis=1, keepdims=True)
        up = np.array([0.0, 0.0, float(side)])
        way = np.where(length > 1e-9, way / np.maximum(length, 1e-12), up)
        normal = np.concatenate([normal, way[:, None]], axis=1)
        level = np.concatenate([level, (dots(way, near_place) + radius)[:, None]], axis=1)
        found[rows], kept = _beyond(points[rows], normal, level)
        if normal.shape[1] > _PLANES:  # one that does not hold the centre back goes
            use = np.sort(np.argsort(kept, axis=1, kind="stable")[:, 1:], axis=1)
            normal = np.take_along_axis(normal, use[:, :, None], axis=1)
            level = np.take_along_axis(level, use, axis=1)
    return found


def _beyond(points: FloatArray, normal: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The places (N, 3) nearest to ``points`` (N, 3) that are beyond all of K planes (N, K, 3), (N, K), and
    how much (N, K) each holds them back; where nothing is beyond all, beyond as many as can be."""
    count = normal.shape[1]
    best = points.copy()
    hold = np.zeros(level.shape)
    least = np.full(len(points), np.inf)
    for size in range(1, min(count, 3) + 1):
        for some in itertools.combinations(range(count), size):
            n, d = normal[:, some], level[:, some]
            square = np.einsum("nik,njk->nij", n, n)
            square = square + 1e-12 * np.eye(size)
            push = np.linalg.solve(square, (d - np.einsum("nik,nk->ni", n, points))[..., None])[..., 0]
            place = points + np.einsum("ni,nik->nk", push, n)
            rest = np.maximum(level - np.einsum("nik,nk->ni", normal, place), 0.0).max(axis=1)
            apart = np.linalg.norm(place - points, axis=1)
            cost = np.where((push >= -1e-12).all(axis=1), apart, np.inf) + 1e3 * np.maximum(rest - 1e-9, 0.0)
            better = cost < least
            least = np.where(better, cost, least)
            best[better] = place[better]
            hold[better] = 0.0
            for k, column in enumerate(some):
                hold[better, column] = np.maximum(push[better, k], 1e-15)
    return best, hold


def left_by(face: Face, radius: float, side: int, start: float) -> Face:
    """The face as a ball of ``radius`` [m] on ``side`` leaves it at best, with fillets where it does not
    reach; the face itself where it reaches all of it. What is flat at the level ``start`` [m] it reaches."""
    corners = face.corners
    moved = np.flatnonzero((side * corners[:, :, 2]).min(axis=1) < side * start - TOUCH)
    parts, owner = small_pieces(corners[moved], GRAIN * radius, _MOST)
    owner = moved[owner]
    off = short(face, parts.mean(axis=1), face.normal[owner], radius, side)
    wrong = np.zeros(len(corners), dtype=np.bool_)
    wrong[owner[off > LEAST]] = True
    if not wrong.any():
        return face
    _spread(face, wrong, moved, radius, side)
    parts, owner = _fine(face, np.flatnonzero(wrong), radius, side)
    places = parts.reshape(-1, 3)
    up = np.repeat(face.normal[owner], 3, axis=0)
    back = centres(face, places, up, radius, side) - places
    far = np.linalg.norm(back, axis=1, keepdims=True)
    moved = places + np.maximum(far - radius, 0.0) * back / np.maximum(far, 1e-12)
    # between corners far apart nothing is known: a piece that is too large stays as it is wanted
    longest = np.linalg.norm(parts - np.roll(parts, 1, axis=1), axis=2).max(axis=1)
    small = (longest <= GRAIN * radius * (1.0 + 1e-9))[:, None, None]
    moved = np.where(small, moved.reshape(-1, 3, 3), parts)
    made = np.concatenate([corners[~wrong], moved]).reshape(-1, 3)
    found = Face(made, np.arange(len(made)).reshape(-1, 3), radius)
    # pieces meet without sharing corners, and end nowhere
    edge = np.concatenate([face.border[~wrong], np.zeros((len(parts), 3), dtype=np.bool_)])
    found.border = edge[found.rows]
    return found


def _fine(face: Face, rows: IntArray, radius: float, side: int) -> tuple[FloatArray, IntArray]:
    """Triangles ``rows`` (K,) of a face in pieces (P, 3, 3), small where a ball does not reach them, and the
    triangle (P,) that each belongs to; a long one is reached at its corners and in its middle."""
    size, many = GRAIN * radius, 0
    open_, owner = face.corners[rows], rows
    done: list[FloatArray] = []
    owners: list[IntArray] = []
    while len(open_):
        long = np.linalg.norm(open_ - np.roll(open_, 1, axis=1), axis=2).max(axis=1) > size
        long &= many + 2 * len(open_) <= _MOST
        split = np.flatnonzero(long)
        looks = np.concatenate([open_[split], open_[split].mean(axis=1, keepdims=True)], axis=1)
        up = np.repeat(face.normal[owner[split]], 4, axis=0)
        off = short(face, looks.reshape(-1, 3), up, radius, side).reshape(-1, 4)
        split = split[(off > LEAST).any(axis=1)]
        kept = np.setdiff1d(np.arange(len(open_)), split)
        done.append(open_[kept])
        owners.append(owner[kept])
        many += len(kept)
        if not len(split):
            break
        open_, half = small_pieces(open_[split], size, 2 * len(split))
        owner = owner[split[half]]
    return np.concatenate(done), np.concatenate(owners)


def _spread(face: Face, wrong: BoolArray, moved: IntArray, radius: float, side: int) -> None:
    """Adds to the triangles that a ball does not reach, ``wrong`` (F,), those of ``moved`` (M,) that have a
    corner in common with them, which it does not reach either: a long triangle's pieces are looked at in
    their middles, and one at its far corner is none of them."""
    while True:
        rows = moved[~wrong[moved]]
        corner, up = face.corners[rows].reshape(-1, 3), np.repeat(face.normal[rows], 3, axis=0)
        known = cKDTree(face.corners[wrong].reshape(-1, 3))
        met = np.flatnonzero(np.isfinite(known.query(corner, distance_upper_bound=TOUCH)[0]))
        fresh = met[short(face, corner[met], up[met], radius, side) > LEAST]
        if not len(fresh):
            return
        wrong[rows[fresh // 3]] = True
