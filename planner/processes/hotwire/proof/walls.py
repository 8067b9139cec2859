"""The wanted surfaces of a part as walls, and what the slot of a straight wire takes from them.

How far points are off the nearest wall, and on which side. What a slot takes is from other surfaces
than the one beside which it cuts: each surface is divided until its pieces are small or too far
from the wires to matter, as distances change by no more than the places do. What the sheets of
wires leave of it does not depend on the order of the cuts.
"""

import dataclasses
import functools
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.processes.hotwire.claims import CutsSurface, KerfCurve
from planner.processes.hotwire.proof.cut_surface import SAMPLE_EDGE, Sweep, closest, sample_face

WALL_EDGE = 0.004
"""Longest edge of the triangles that walls are divided into [m], within ``MOST_TRIANGLES``."""
MOST_TRIANGLES = 40_000
"""Triangles of a wall at most."""
_PAIRS_AT_ONCE = 400_000
"""Pairs of triangles that are worked on at once."""
_LEAST_SIZE = 1e-7
"""Triangles count as no smaller than this [m] in searches."""
_MEETING_DISTANCE = 1e-9
"""Triangles meet in places that are no farther apart [m]."""


@dataclasses.dataclass(frozen=True)
class Walls:
    """Triangles ``corners`` (F, 3, 3) [m] with unit ``normal`` (F, 3) away from the part, ``owner`` (F,) the
    surface that each belongs to, and ``border`` (F, 3) which of the edges, each behind a corner, nothing
    joins."""

    corners: FloatArray
    normal: FloatArray
    owner: IntArray
    border: BoolArray

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
        parts = np.cumsum(counts) // _PAIRS_AT_ONCE
        for number in np.unique(parts):
            rows = np.flatnonzero(parts == number)
            row = np.repeat(np.arange(len(rows)), counts[rows])
            tri = np.concatenate([near[k] for k in rows])
            maybe = self._within(points[rows], best[rows], row, tri)
            off[rows], owner[rows] = self._nearest(points[rows], row[maybe], tri[maybe])
        return off, owner

    def _within(self, points: FloatArray, reach: FloatArray, row: IntArray, tri: IntArray) -> IntArray:
        """Which pairs (K,) of points ``row`` and triangles ``tri`` may be within ``reach`` (N,) [m] of points
        (N, 3), by the boxes of the triangles."""
        far = np.zeros(len(row))
        for at, low, high in zip(points.T, *self._boxes, strict=True):
            here = at[row]
            gap = np.maximum(low[tri] - here, here - high[tri])
            far += np.maximum(gap, 0.0, out=gap) ** 2
        return np.flatnonzero(far <= ((reach + 2.0 * _LEAST_SIZE) ** 2)[row])

    @functools.cached_property
    def _boxes(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest coordinates (3, F) [m] of each triangle."""
        low, high = self.corners.min(axis=1), self.corners.max(axis=1)
        return np.ascontiguousarray(low.T), np.ascontiguousarray(high.T)

    @functools.cached_property
    def _near(self) -> list[tuple[IntArray, cKDTree, float]]:
        """The triangles, those of about one size together, by their middles, and how far [m] corners are
        from these at most."""
        middle = self.corners.mean(axis=1)
        far = np.linalg.norm(self.corners - middle[:, None], axis=2).max(axis=1)
        size = np.ceil(np.log2(np.maximum(far, _LEAST_SIZE)) / 2.0).astype(np.int64)
        groups = [np.flatnonzero(size == one) for one in np.unique(size)]
        return [(own, cKDTree(middle[own]), float(far[own].max()) + _LEAST_SIZE) for own in groups]

    def _nearest(self, points: FloatArray, row: IntArray, tri: IntArray) -> tuple[FloatArray, IntArray]:
        """As :meth:`off`, where triangles ``tri`` (K,) may be nearest to points ``row`` (K,), in ascending
        order and none of the N left out."""
        place, share = closest(points[row], *np.moveaxis(self.corners[tri], 1, 0))
        way = points[row] - place
        found = np.linalg.norm(way, axis=1)
        best = np.minimum.reduceat(found, np.searchsorted(row, np.arange(len(points))))
        same = found <= best[row] + _LEAST_SIZE
        row, tri, place, share, way, found = (one[same] for one in (row, tri, place, share, way, found))
        begin = np.searchsorted(row, np.arange(len(points)))
        # an edge is met where the corner across it has no weight; at a corner of the border triangles meet
        # that have no edge on it, and all that are as near count
        edge = (np.roll(share < 1e-9, -2, axis=1) & self.border[tri]).any(axis=1)
        order = np.lexsort((tri, found, row))[begin]
        # at an edge as sharp as a wing's what is nearly as near lies on the other side of it: the same place
        met = np.linalg.norm(place - place[order][row], axis=1) <= _MEETING_DISTANCE
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
        triangles, free = _divided_to_edge(triangles[size > 0.0], _open(claim)[size > 0.0])
        corners.append(triangles)
        border.append(free)
        owner.append(np.full(len(triangles), number))
    all_corners = np.concatenate(corners)
    normal = np.cross(all_corners[:, 1] - all_corners[:, 0], all_corners[:, 2] - all_corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    return Walls(all_corners, normal, np.concatenate(owner), np.concatenate(border))


def _open(claim: CutsSurface) -> BoolArray:
    """Which edges (F, 3), each from a corner to the next, belong to one triangle alone; vertices at one place
    are one."""
    _, one = np.unique(claim.vertices.round(8), axis=0, return_inverse=True)
    faces = one.ravel()[claim.faces]
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, which, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    return np.asarray((count[which.ravel()] == 1).reshape(-1, 3))


def _divided_to_edge(corners: FloatArray, border: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Triangles (F, 3, 3) halved across their longest edges until these are short, with their borders
    (F, 3)."""
    for _ in range(40):
        edge = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        long = edge.max(axis=1) > WALL_EDGE
        if not long.any() or len(corners) + int(long.sum()) > MOST_TRIANGLES:
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


SMALL_PIECE: Final = 5e-4
"""[m] pieces of a surface whose middle is no farther from their corners are looked at there alone."""
PIECES_AT_ONCE: Final = 20_000
"""So many pieces are looked at together."""
WIRE_POINT_STEP: Final = 0.003
"""[m] points of the wires by which near ones are found are no farther apart along the wire."""
BEHIND_COSINE: Final = 0.7
"""A wire is beneath a surface, not beside its rim, where the way to it has more than this cosine to the
normal."""
CROSSING_DEPTH: Final = 1e-5
"""[m] a surface crosses another where it is on both sides of it by more than this."""
MEETING_ROUNDING: Final = 1e-7
"""[m] of rounding, where surfaces meet."""
CROSSING_SAMPLES: Final = 600
"""So many places of a surface tell whether it crosses another."""
_POINTS_AT_ONCE: Final = 500
"""Points that are held against wires at once."""


@dataclasses.dataclass(frozen=True)
class Taken:
    """What one cut takes from another surface: ``depth`` [m] at most, at ``place`` (3,), by the wire at
    ``row`` of its sweep; ``half`` [m] half its slot there."""

    depth: float
    place: FloatArray
    row: int
    half: float


class PartWalls:
    """The wanted surfaces of a part, ``claims``, in the block (2, 3) [m]: each as a wall of its own, and
    which cross one another. Worked out once, when first asked for."""

    def __init__(self, claims: tuple[CutsSurface, ...], block: FloatArray) -> None:
        self.claims, self.block = claims, block
        self._walls: dict[int, tuple[CutsSurface, Walls]] = {}
        self._crossed: dict[int, tuple[CutsSurface, tuple[CutsSurface, ...]]] = {}

    def wall(self, claim: CutsSurface) -> Walls:
        """The wall of a surface, one of ``claims`` or any other."""
        if id(claim) not in self._walls:  # kept with its claim, so no other one gets its id
            self._walls[id(claim)] = (claim, walls((claim,)))
        return self._walls[id(claim)][1]

    def crossed(self, claim: CutsSurface) -> tuple[CutsSurface, ...]:
        """Those of ``claims`` that a surface is on both sides of."""
        if id(claim) not in self._crossed:
            others = (other for other in self.claims if other is not claim)
            found = tuple(other for other in others if crosses(claim, self.wall(other), self.block))
            self._crossed[id(claim)] = (claim, found)
        return self._crossed[id(claim)][1]


def taken_depth(claim: CutsSurface, sweep: Sweep, other: CutsSurface, part: PartWalls) -> Taken | None:
    """What the slot of a cut takes from another surface of the part inside the block, beyond that surface's
    tolerance; None for nothing.

    Where a surface goes on outside of one that it crosses, it bounds nothing: both bound the part together.
    """
    block = part.block
    sheet = _Sheet(sweep, claim.kerf, block)
    corners = other.vertices[other.faces]
    corners = corners[np.linalg.norm(_cross(corners), axis=1) > 0.0]
    wall = part.wall(claim)
    worst: list[tuple[FloatArray, FloatArray, FloatArray, IntArray]] = []
    left = [corners]
    while left:
        corners = left.pop()
        if len(corners) > PIECES_AT_ONCE:
            left.append(corners[PIECES_AT_ONCE:])
            corners = corners[:PIECES_AT_ONCE]
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
        beyond = inside & (along <= -BEHIND_COSINE * distance) & (distance < half + CROSSING_DEPTH)
        beyond[beyond] = wall.off(middle[beyond])[0] > -MEETING_ROUNDING
        depth = half - np.where(beyond, along, distance)
        bad = inside & (depth > other.tolerance)
        if bad.any():
            worst.append((depth[bad], middle[bad], half[bad], row[bad]))
        open_ = ~bad & (size > SMALL_PIECE) & (distance - size < half - other.tolerance)
        if open_.any():
            left.append(_quartered(corners[open_]))
    if not worst:
        return None
    depth, place, half, row = (np.concatenate([one[k] for one in worst]) for k in range(4))
    real = _bounds_the_part(place, other, part)
    if not real.any():
        return None
    k = int(np.argmax(np.where(real, depth, -np.inf)))
    return Taken(float(depth[k]), place[k], int(row[k]), float(half[k]))


def taken_by_bent(claim: CutsSurface, sweep: Sweep, other: CutsSurface, part: PartWalls) -> Taken | None:
    """As :func:`taken_depth`, by a bent wire: where its points come nearer to the other surface than half
    their slot, or pass through it from one look to the next.

    Where a point is outside of the surface that it cuts, what the slot reaches is outside of the part, or on
    this side of that surface; so what counts is beyond the rim of that surface, or deep below it.
    """
    block = part.block
    points, half = sweep.points, 0.5 * claim.kerf.at(sweep.speed)
    flat = points.reshape(-1, 3)
    inside = ((flat > block[0]) & (flat < block[1])).all(axis=1).reshape(half.shape)
    step = np.linalg.norm(np.diff(points, axis=0), axis=2)
    joined = sweep.joined[:, None] & inside[1:] & inside[:-1]
    places, _, area = sample_face(other.vertices, other.faces)
    apart = 2.0 * max(SAMPLE_EDGE, float(np.sqrt(area.max())))
    most = float(half.max(initial=0.0)) + float(np.where(joined, step, 0.0).max(initial=0.0)) + apart
    far, _ = cKDTree(places).query(flat, distance_upper_bound=most)
    near = np.flatnonzero(np.isfinite(far) & inside.reshape(-1))
    off, own = np.full((2, len(flat)), np.nan)
    if not len(near):
        return None
    off[near] = part.wall(other).off(flat[near])[0]
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
    own[some] = part.wall(claim).off(flat[some])[0]
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
        count = max(int(np.ceil(float(self.length.max(initial=0.0)) / WIRE_POINT_STEP)), 1)
        share = np.linspace(0.0, 1.0, count + 1)[None, :, None]
        points = self.start[:, None] + share * (self.end - self.start)[:, None]
        low, high = block[0] - self.most, block[1] + self.most
        row, column = np.nonzero(((points > low) & (points < high)).all(axis=2))
        self.points, self.row = points[row, column], row
        step = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1, initial=0.0)
        self.gap = 0.5 * float(np.hypot(WIRE_POINT_STEP, np.where(self.joined, step, 0.0).max(initial=0.0)))
        self.tree = cKDTree(self.points) if len(self.points) else None

    def maybe(self, points: FloatArray, size: FloatArray) -> BoolArray:
        """Which places (N, 3) have something within ``size`` (N,) [m] that the slot might reach."""
        if self.tree is None:
            return np.zeros(len(points), dtype=np.bool_)
        reach = size + self.most + self.gap
        distance, _ = self.tree.query(points, distance_upper_bound=1.001 * float(reach.max(initial=0.0)))
        return np.asarray(distance <= reach)  # infinite where farther than any of them

    def nearest(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Of each of points (N, 3) that may be near: the distance (N,) [m] to the sheet, the nearest place
        (N, 3) of it, half the slot (N,) [m] there, the station (N,)."""
        distance, half = np.full(len(points), np.inf), np.zeros(len(points))
        foot, row = np.zeros((len(points), 3)), np.zeros(len(points), dtype=np.int64)
        if self.tree is None:
            return distance, foot, half, row
        order = np.argsort(self.row[self.tree.query(points)[1]], kind="stable")
        for begin in range(0, len(points), _POINTS_AT_ONCE):
            some = order[begin : begin + _POINTS_AT_ONCE]
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


def _bounds_the_part(places: FloatArray, own: CutsSurface, part: PartWalls) -> BoolArray:
    """Which places (N, 3) of a surface bound the part: those not outside of another one that it crosses in
    the block."""
    real = np.ones(len(places), dtype=np.bool_)
    for other in part.crossed(own):
        rows = np.flatnonzero(real)
        real[rows] &= ~(part.wall(other).off(places[rows])[0] > -MEETING_ROUNDING)
    return real


def crosses(own: CutsSurface, wall: Walls, block: FloatArray) -> bool:
    """Whether a surface is on both sides of another one, the ``wall``, in the block (2, 3)."""
    # all over each facet: those of a ruled surface have all corners in faces of the block, and a surface may
    # go on little beyond another
    inner = np.array([(i, j, 10 - i - j) for i in range(11) for j in range(11 - i)]) / 10.0
    inner = 0.97 * inner + 0.01
    points = np.einsum("wk,fkd->fwd", inner, own.vertices[own.faces]).reshape(-1, 3)
    points = points[((points > block[0]) & (points < block[1])).all(axis=1)]
    points = np.random.default_rng(0).permutation(points)[: 2 * CROSSING_SAMPLES]
    above = below = False
    for some in np.split(points, [CROSSING_SAMPLES // 10, CROSSING_SAMPLES // 2]):  # a few mostly tell
        off, _ = wall.off(some)
        above |= bool((off > CROSSING_DEPTH).any())
        below |= bool((off < -CROSSING_DEPTH).any())
        if above and below:
            return True
    return False


def _cross(corners: FloatArray) -> FloatArray:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _quartered(corners: FloatArray) -> FloatArray:
    """Triangles (F, 3, 3) halved across their longest edges, twice."""
    for _ in range(2):
        edge = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        turn = (np.argmax(edge, axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(corners[np.arange(len(corners))[:, None], turn], 1, 0)
        middle = 0.5 * (a + b)
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        corners = np.concatenate(halves)
    return corners
