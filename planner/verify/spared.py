"""What the slot of a wire takes from other surfaces of the part than the one beside which it cuts.

For a straight wire each surface is divided until its pieces are small or too far from the wires to matter:
distances change by no more than the places do. What the sheets of wires leave of it does not depend on the
order of the cuts. Bent wires are looked at point by point, and from look to look.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.claims import CutsSurface, KerfCurve
from planner.geometry.vectors import dots
from planner.verify.surface import SAMPLE, Sweep, sample_face
from planner.verify.walls import walls

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

SMALL: Final = 5e-4
"""[m] pieces of a surface whose middle is no farther from their corners are looked at there alone."""
BATCH: Final = 20_000
"""So many pieces are looked at together."""
APART: Final = 0.003
"""[m] points of the wires by which near ones are found are no farther apart along the wire."""
BEHIND: Final = 0.7
"""A wire is beneath a surface, not beside its rim, where the way to it has more than this cosine to the
normal."""
THROUGH: Final = 1e-5
"""[m] a surface crosses another where it is on both sides of it by more than this."""
MEETS: Final = 1e-7
"""[m] of rounding, where surfaces meet."""
SOME: Final = 600
"""So many places of a surface tell whether it crosses another."""
_CHUNK: Final = 500


@dataclasses.dataclass(frozen=True)
class Taken:
    """What one cut takes from another surface: ``depth`` [m] at most, at ``place`` (3,), by the wire at
    ``row`` of its sweep; ``half`` [m] half its slot there."""

    depth: float
    place: FloatArray
    row: int
    half: float


def taken(
    claim: CutsSurface, sweep: Sweep, other: CutsSurface, part: tuple[CutsSurface, ...], block: FloatArray
) -> Taken | None:
    """What the slot of a cut takes from another surface of the part inside the block (2, 3), beyond that
    surface's tolerance; None for nothing.

    Where a surface goes on outside of one that it crosses, it bounds nothing: both bound the part together.
    """
    sheet = _Sheet(sweep, claim.kerf, block)
    corners = other.vertices[other.faces]
    corners = corners[np.linalg.norm(_cross(corners), axis=1) > 0.0]
    wall = walls((claim,))
    worst: list[tuple[FloatArray, FloatArray, FloatArray, IntArray]] = []
    left = [corners]
    while left:
        corners = left.pop()
        if len(corners) > BATCH:
            left.append(corners[BATCH:])
            corners = corners[:BATCH]
        middle = corners.mean(axis=1)
        size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        near = sheet.maybe(middle, size)
        corners, middle, size = corners[near], middle[near], size[near]
        if not len(corners):
            continue
        distance, foot, half, row = sheet.nearest(middle)
        normal = _cross(corners)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        along = dots(foot - middle, normal)
        inside = ((middle > block[0]) & (middle < block[1])).all(axis=1)
        # from within the part a slot takes what it reaches; from the foam beyond its own surface it takes all
        beyond = inside & (along <= -BEHIND * distance) & (distance < half + THROUGH)
        beyond[beyond] = wall.off(middle[beyond])[0] > -MEETS
        depth = half - np.where(beyond, along, distance)
        bad = inside & (depth > other.tolerance)
        if bad.any():
            worst.append((depth[bad], middle[bad], half[bad], row[bad]))
        open_ = ~bad & (size > SMALL) & (distance - size < half - other.tolerance)
        if open_.any():
            left.append(_halved(corners[open_]))
    if not worst:
        return None
    depth, place, half, row = (np.concatenate([one[k] for one in worst]) for k in range(4))
    real = _bounds_the_part(place, other, part, block)
    if not real.any():
        return None
    k = int(np.argmax(np.where(real, depth, -np.inf)))
    return Taken(float(depth[k]), place[k], int(row[k]), float(half[k]))


def taken_by_bent(
    claim: CutsSurface, sweep: Sweep, other: CutsSurface, part: tuple[CutsSurface, ...], block: FloatArray
) -> Taken | None:
    """As :func:`taken`, by a bent wire: where its points come nearer to the other surface than half their
    slot, or pass through it from one look to the next.

    Where a point is outside of the surface that it cuts, what the slot reaches is outside of the part, or on
    this side of that surface; so what counts is beyond the rim of that surface, or deep below it.
    """
    del part
    points, half = sweep.points, 0.5 * claim.kerf.at(sweep.speed)
    flat = points.reshape(-1, 3)
    inside = ((flat > block[0]) & (flat < block[1])).all(axis=1).reshape(half.shape)
    step = np.linalg.norm(np.diff(points, axis=0), axis=2)
    joined = sweep.joined[:, None] & inside[1:] & inside[:-1]
    places, _, area = sample_face(other.vertices, other.faces)
    apart = 2.0 * max(SAMPLE, float(np.sqrt(area.max())))
    most = float(half.max(initial=0.0)) + float(np.where(joined, step, 0.0).max(initial=0.0)) + apart
    far, _ = cKDTree(places).query(flat, distance_upper_bound=most)
    near = np.flatnonzero(np.isfinite(far) & inside.reshape(-1))
    off, own = np.full((2, len(flat)), np.nan)
    if not len(near):
        return None
    off[near] = walls((other,)).off(flat[near])[0]
    off = off.reshape(half.shape)
    signs = joined & (off[1:] * off[:-1] < 0.0)  # NaN is no crossing
    through = np.zeros(half.shape, dtype=np.bool_)
    through[1:] |= signs
    through[:-1] |= signs
    depth = np.where(through, half, half - np.abs(off))
    bad = depth > other.tolerance
    some = np.flatnonzero(bad)
    if not len(some):
        return None
    own[some] = walls((claim,)).off(flat[some])[0]
    depth = np.where(bad & ~(own.reshape(half.shape) > 0.0), depth, -np.inf)
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    if not np.isfinite(depth[row, column]):
        return None
    return Taken(float(depth[row, column]), points[row, column], int(row), float(half[row, column]))


class _Sheet:
    """The sheet that a straight wire sweeps, as lines at stations and straight ways between them."""

    def __init__(self, sweep: Sweep, kerf: KerfCurve, block: FloatArray) -> None:
        self.start, self.end = sweep.points[:, 0], sweep.points[:, -1]
        self.half = 0.5 * kerf.at(sweep.speed)
        self.joined = sweep.joined
        self.length = np.linalg.norm(self.end - self.start, axis=1)
        self.way = (self.end - self.start) / self.length[:, None]
        self.most = float(self.half.max(initial=0.0))
        count = max(int(np.ceil(float(self.length.max(initial=0.0)) / APART)), 1)
        share = np.linspace(0.0, 1.0, count + 1)[None, :, None]
        points = self.start[:, None] + share * (self.end - self.start)[:, None]
        low, high = block[0] - self.most, block[1] + self.most
        row, column = np.nonzero(((points > low) & (points < high)).all(axis=2))
        self.points, self.row = points[row, column], row
        step = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1, initial=0.0)
        self.gap = 0.5 * float(np.hypot(APART, np.where(self.joined, step, 0.0).max(initial=0.0)))
        self.tree = cKDTree(self.points) if len(self.points) else None

    def maybe(self, points: FloatArray, size: FloatArray) -> BoolArray:
        """Which places (N, 3) have something within ``size`` (N,) [m] that the slot might reach."""
        if self.tree is None:
            return np.zeros(len(points), dtype=np.bool_)
        distance, _ = self.tree.query(points)
        return np.asarray(distance <= size + self.most + self.gap)

    def nearest(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Of each of points (N, 3) that may be near: the distance (N,) [m] to the sheet, the nearest place
        (N, 3) of it, half the slot (N,) [m] there, the station (N,)."""
        distance, half = np.full(len(points), np.inf), np.zeros(len(points))
        foot, row = np.zeros((len(points), 3)), np.zeros(len(points), dtype=np.int64)
        if self.tree is None:
            return distance, foot, half, row
        order = np.argsort(self.row[self.tree.query(points)[1]], kind="stable")
        for begin in range(0, len(points), _CHUNK):
            some = order[begin : begin + _CHUNK]
            low, high = points[some].min(axis=0), points[some].max(axis=0)
            reach = self.most + 4.0 * self.gap
            close = ((self.points > low - reach) & (self.points < high + reach)).all(axis=1)
            stations = np.unique(self.row[close])
            stations = np.unique(np.concatenate([stations - 1, stations]))
            stations = stations[(stations >= 0) & (stations < len(self.start) - 1)]
            stations = stations[self.joined[stations]]
            if len(stations):
                found = self._between(points[some], stations)
                distance[some], foot[some], half[some], row[some] = found
        return distance, foot, half, row

    def _between(
        self, points: FloatArray, stations: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """As :meth:`nearest`, from each of ``stations`` (T,) to the next."""
        (a, first), (b, last) = (self._abreast(points, stations + k) for k in (0, 1))
        move = b - a
        share = dots(points[:, None] - a, move) / np.maximum(dots(move, move), 1e-30)
        share = np.clip(share, 0.0, 1.0)
        place = a + share[..., None] * move
        far = np.linalg.norm(points[:, None] - place, axis=2)
        row = np.arange(len(points))
        k = np.argmin(far, axis=1)
        part = share[row, k]
        half = (1.0 - part) * first[row, k] + part * last[row, k]
        return far[row, k], place[row, k], half, stations[k]

    def _abreast(self, points: FloatArray, stations: IntArray) -> tuple[FloatArray, FloatArray]:
        """Places (N, T, 3) of wires nearest to points (N, 3), and half their slots (N, T) there."""
        start, way, length = self.start[stations], self.way[stations], self.length[stations]
        along = points @ way.T - dots(start, way)
        along = np.clip(along, 0.0, length)
        at = along / length * (self.half.shape[1] - 1)
        left = np.minimum(at.astype(np.int64), self.half.shape[1] - 2)
        here = self.half[stations[None], left]
        half = here + (at - left) * (self.half[stations[None], left + 1] - here)
        return start + along[..., None] * way, half


def _bounds_the_part(
    places: FloatArray, own: CutsSurface, part: tuple[CutsSurface, ...], block: FloatArray
) -> BoolArray:
    """Which places (N, 3) of a surface bound the part: those not outside of another one that it crosses in
    the block."""
    # all over each facet: those of a ruled surface have all corners in faces of the block
    inner = np.array([(i, j, 10 - i - j) for i in range(1, 9) for j in range(1, 10 - i)]) / 10.0
    points = np.einsum("wk,fkd->fwd", inner, own.vertices[own.faces]).reshape(-1, 3)
    points = points[((points > block[0]) & (points < block[1])).all(axis=1)]
    points = np.random.default_rng(0).permutation(points)[: 2 * SOME]
    real = np.ones(len(places), dtype=np.bool_)
    for other in part:
        if other is own:
            continue
        wall = walls((other,))
        off, _ = wall.off(points)
        if (off > THROUGH).any() and (off < -THROUGH).any():
            rows = np.flatnonzero(real)
            real[rows] &= ~(wall.off(places[rows])[0] > -MEETS)
    return real


def _cross(corners: FloatArray) -> FloatArray:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _halved(corners: FloatArray) -> FloatArray:
    """Triangles (F, 3, 3) halved across their longest edges, twice."""
    for _ in range(2):
        edge = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        turn = (np.argmax(edge, axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(corners[np.arange(len(corners))[:, None], turn], 1, 0)
        middle = 0.5 * (a + b)
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        corners = np.concatenate(halves)
    return corners
