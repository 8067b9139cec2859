"""A formed face: nearest places, sides, how near straight ways come, and what a ball can reach of it.

All distances are exact for the triangles. The face goes on flat beyond its border, as the sheet
does. Which triangles may be nearest to points or straight ways is told by groups of triangles as
flat disks, in levels.

What a ball can reach: how near to a place any ball of its size comes that cuts in nowhere. A ball
above a hollow stays beyond the plane of every place of it, by its radius. So the nearest place that
is left for its centre is that of the planes which are in the way: they are found one by one, each
where the best centre so far still cuts in, and the centre is put to the nearest place that is
beyond the last of them. In a hollow no centre is ever too far off thus, and one that cuts in
nowhere is the nearest there is. In a sharp corner between two planes at the angle a to each other a
ball of radius R stays R (1 / cos(a / 2) - 1) off, in the tip of a cone whose wall has the angle a,
R (1 / cos a - 1).
"""

import dataclasses
import itertools
from collections.abc import Callable
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, lengths
from planner.geometry.mesh import TriangleMesh, closest_on_triangles, corner_normals, small_pieces

TREE_BRANCHES: Final = 4
"""Branches of each node of the tree of triangles."""


@dataclasses.dataclass(frozen=True)
class Level:
    """Groups as disks that hold their triangles: ``centre``, ``normal`` (K, 3), ``radius`` and half the
    thickness ``half`` (K,) [m]; a level's children of group k are 4 k to 4 k + 3 of the next."""

    centre: FloatArray
    normal: FloatArray
    radius: FloatArray
    half: FloatArray


class Tree:
    """Triangles (F, 3, 3) in groups of four, these in groups of four, and so on."""

    def __init__(self, corners: FloatArray) -> None:
        count = len(corners)
        depth = max(int(np.ceil(np.log(max(count, 1)) / np.log(TREE_BRANCHES))), 0)
        full = TREE_BRANCHES**depth
        middle = corners.mean(axis=1)
        order = np.arange(count)
        slots = np.full(full, -1, dtype=np.int64)
        # equal shares along the widest way of each group, so that the order of the slots is the tree
        place = np.zeros(count, dtype=np.int64)
        size = full
        while size > 1:
            half = size // 2
            group = place // size
            low = np.full((full // size, 3), np.inf)
            high = -low
            np.minimum.at(low, group, middle[order])
            np.maximum.at(high, group, middle[order])
            widest = np.argmax(high - low, axis=1)
            value = middle[order, widest[group]]
            turn = np.lexsort((value, group))
            order, group = order[turn], group[turn]
            first = np.searchsorted(group, group)
            rank = np.arange(count) - first
            number = np.bincount(group, minlength=full // size)[group]
            cut = np.minimum((number + 1) // 2, half)
            place = group * size + np.where(rank < cut, rank, half + rank - cut)
            size = half
        slots[place] = order
        self.triangle = slots
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.levels = tuple(
            _level(corners, cross, slots.reshape(TREE_BRANCHES**k, -1)) for k in range(depth + 1)
        )

    def near_points(self, points: FloatArray, limit: FloatArray) -> tuple[IntArray, IntArray]:
        """Pairs of points (N, 3) and triangles that may be nearer than ``limit`` (N,) [m]."""
        return self._near(limit, lambda level, node, which: _off_points(level, node, points[which]))

    def near_ways(self, start: FloatArray, end: FloatArray, limit: FloatArray) -> tuple[IntArray, IntArray]:
        """Pairs of straight ways from ``start`` to ``end`` (N, 3) and triangles that may be nearer than
        ``limit`` (N,) [m]."""
        return self._near(limit, lambda level, node, which: _off_ways(level, node, start[which], end[which]))

    def _near(
        self, limit: FloatArray, off: Callable[[Level, IntArray, IntArray], FloatArray]
    ) -> tuple[IntArray, IntArray]:
        which = np.arange(len(limit))
        node = np.zeros(len(limit), dtype=np.int64)
        for k, level in enumerate(self.levels):
            if k:
                which = np.repeat(which, TREE_BRANCHES)
                node = (TREE_BRANCHES * node[:, None] + np.arange(TREE_BRANCHES)).ravel()
            near = off(level, node, which) < limit[which]
            which, node = which[near], node[near]
        return which, self.triangle[node]


def _level(corners: FloatArray, cross: FloatArray, slots: IntArray) -> Level:
    used = slots >= 0
    group, column = np.nonzero(used)
    triangle = slots[group, column]
    count = len(slots)
    points = corners[triangle]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, group, points.min(axis=1))
    np.maximum.at(high, group, points.max(axis=1))
    held = np.isfinite(low)
    centre = 0.5 * (np.where(held, low, 0.0) + np.where(held, high, 0.0))
    normal = np.zeros((count, 3))
    np.add.at(normal, group, cross[triangle])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-30, normal / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0]))
    rest = points - centre[group][:, None]
    height = np.einsum("nkd,nd->nk", rest, normal[group])
    flat = np.sqrt(np.maximum((rest * rest).sum(axis=2) - height**2, 0.0))
    radius, half = np.full(count, -np.inf), np.zeros(count)
    np.maximum.at(radius, group, flat.max(axis=1))
    np.maximum.at(half, group, np.abs(height).max(axis=1))
    return Level(centre, normal, radius + 1e-12, half + 1e-12)


def _off_points(level: Level, node: IntArray, points: FloatArray) -> FloatArray:
    """A lower bound (M,) [m] of the distance of points from what groups hold; infinite for groups that hold
    nothing."""
    rest = points - level.centre[node]
    height = dots(rest, level.normal[node])
    flat = np.sqrt(np.maximum(dots(rest, rest) - height * height, 0.0))
    return _off(level, node, flat, np.abs(height))


def _off_ways(level: Level, node: IntArray, start: FloatArray, end: FloatArray) -> FloatArray:
    normal, centre = level.normal[node], level.centre[node]
    one, two = start - centre, end - centre
    low, high = dots(one, normal), dots(two, normal)
    height = np.where(low * high > 0.0, np.minimum(np.abs(low), np.abs(high)), 0.0)
    middle = 0.5 * (one + two)
    up = 0.5 * (low + high)
    flat = np.sqrt(np.maximum(dots(middle, middle) - up * up, 0.0)) - 0.5 * lengths(end - start)
    return _off(level, node, flat, height)


def _off(level: Level, node: IntArray, flat: FloatArray, height: FloatArray) -> FloatArray:
    """Distance (M,) [m] from disks, of what is ``flat`` along them from their middle and ``height`` over."""
    radius = level.radius[node]
    beside = np.maximum(flat - radius, 0.0)
    above = np.maximum(height - level.half[node], 0.0)
    return np.where(radius < 0.0, np.inf, np.hypot(above, beside))


EQUALLY_NEAR = 1e-7
"""Places whose distances differ by less [m] are equally near."""
CREASE_ANGLE = np.deg2rad(20.0)
"""Triangles that turn by more than this [rad] over an edge meet in a crease."""
_SEED_SIZE = 0.003
"""Triangles are divided into pieces no smaller than this [m] to find the nearest ones."""
_MOST_SEEDS = 150_000
"""Such pieces at most."""
_POINTS_AT_ONCE = 1_000
"""Points, or segments, that are held against the face at once."""


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

    def at(self, chosen: IntArray) -> "Nearest":
        """Of some of the points, ``chosen`` (K,), in their order."""
        new = np.full(len(self.apart), -1)
        new[chosen] = np.arange(len(chosen))
        row = new[self.row]
        use = np.flatnonzero(row >= 0)
        use = use[np.argsort(row[use], kind="stable")]
        points = self.place[chosen], self.apart[chosen], self.signed[chosen]
        return Nearest(*points, row[use], self.triangle[use], self.share[use], self.tied[use])

    def followed_by(self, other: "Nearest") -> "Nearest":
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
        pieces, self._owner = small_pieces(self.corners, max(_SEED_SIZE, 0.25 * scale), _MOST_SEEDS)
        self._seeds = cKDTree(pieces.mean(axis=1))
        self._tree = Tree(self.corners)
        self.left: dict[tuple[float, int, float], Face | None] = {}
        """What :func:`left_by` found so far, by its other arguments; None for the face itself."""

    @cached_property
    def smooth(self) -> FloatArray:
        """Normals (F, 3, 3) at the corners of the triangles, smooth but over creases. ``faces`` may part at
        creases: places count, not numbers."""
        _, one = np.unique(self.vertices.round(9), axis=0, return_inverse=True)
        first = np.zeros(int(one.max()) + 1, dtype=np.int64)
        first[one.ravel()] = np.arange(len(self.vertices))
        return corner_normals(TriangleMesh(self.vertices, first[one.ravel()[self.faces]]), CREASE_ANGLE)

    def nearest(self, points: FloatArray, within: float = EQUALLY_NEAR) -> Nearest:
        """The nearest places of the face to points (N, 3) [m], and those that are farther by ``within`` [m]
        at most."""
        apart = np.full(len(points), np.inf)
        kept: list[tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]] = []
        for rows in np.array_split(np.arange(len(points)), max(1, len(points) // _POINTS_AT_ONCE)):
            if not len(rows):
                continue
            first = self._owner[np.asarray(self._seeds.query(points[rows])[1])]
            apart[rows] = self._foot(points[rows], first)[2]
            i, owner = self._tree.near_points(points[rows], apart[rows] + within + EQUALLY_NEAR)
            i = rows[i]
            weights, foot, far = self._foot(points[i], owner)
            np.minimum.at(apart, i, far)
            use = np.flatnonzero(far <= apart[i] + within)
            use = use[np.lexsort((far[use], i[use]))]
            kept.append((i[use], owner[use], weights[use], foot[use], far[use]))
        if not kept:
            none = np.zeros(0, dtype=np.int64)
            return Nearest(points, apart, apart, none, none, np.zeros((0, 3)), np.zeros((0, 3)))
        parts = list(zip(*kept, strict=True))[::-1]
        kept.clear()  # and each part as it is joined: of a long pass they are tens of MB
        i, owner, weights, foot, far = (np.concatenate(parts.pop()) for _ in range(len(parts)))
        first = np.flatnonzero(np.diff(i, prepend=-1) != 0)
        same = far <= apart[i] + EQUALLY_NEAR
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
        for rows in np.array_split(np.arange(len(start)), max(1, len(start) // _POINTS_AT_ONCE)):
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


CUT_IN = 2e-6
"""A ball may cut in by so much [m]."""
REACHED_WITHIN = 3e-5
"""What a ball comes nearer to than this [m] it reaches."""
PIECE_SHARE = 0.15
"""Triangles that a ball does not reach are parted into pieces of this share of its radius."""
_CENTRE_ROUNDS = 24
"""Rounds at most in which the nearest centre of a ball is found beyond the planes of the face."""
_MOST_PLANES = 3
"""Planes that may hold a centre back at once: three make a corner."""
_MOST_PIECES = 100_000
"""Pieces at most: where there would be more, what a ball does not reach is looked for less closely, and
what is not looked at closely counts as reached."""


def least_gap(face: Face, points: FloatArray, normals: FloatArray, radius: float, side: int) -> FloatArray:
    """How far (N,) [m] balls of ``radius`` [m] on ``side`` of a face stay off ``points`` (N, 3) on it at
    least, whose ``normals`` (N, 3) point up; 0 where they reach them."""
    return np.asarray(
        np.maximum(
            np.linalg.norm(centres(face, points, normals, radius, side) - points, axis=1) - radius, 0.0
        )
    )


def centres(face: Face, points: FloatArray, normals: FloatArray, radius: float, side: int) -> FloatArray:
    """The nearest centres (N, 3) [m] to ``points`` (N, 3) of balls that cut into a face nowhere."""
    out = np.empty((len(points), 3))
    for begin in range(0, len(points), _POINTS_AT_ONCE):
        some = slice(begin, begin + _POINTS_AT_ONCE)
        out[some] = _centres(face, points[some], normals[some], radius, side)
    return out


def _centres(face: Face, points: FloatArray, normals: FloatArray, radius: float, side: int) -> FloatArray:
    found = points + side * radius * normals
    rows = np.arange(len(points))
    # each plane as its unit normal, and how far along it a centre is at least
    normal = np.zeros((len(points), 0, 3))
    level = np.zeros((len(points), 0))
    for _ in range(_CENTRE_ROUNDS):
        near = face.nearest(found[rows])
        room = side * near.signed
        rows_in = room < radius - CUT_IN
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
        if normal.shape[1] > _MOST_PLANES:  # one that does not hold the centre back goes
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
    key = radius, side, start
    if key not in face.left:
        made = _left_by(face, *key)
        face.left[key] = None if made is face else made  # a face that holds itself would outlive its proof
    return face.left[key] or face


def _left_by(face: Face, radius: float, side: int, start: float) -> Face:
    corners = face.corners
    moved = np.flatnonzero((side * corners[:, :, 2]).min(axis=1) < side * start - CUT_IN)
    parts, owner = small_pieces(corners[moved], PIECE_SHARE * radius, _MOST_PIECES)
    owner = moved[owner]
    off = least_gap(face, parts.mean(axis=1), face.normal[owner], radius, side)
    wrong = np.zeros(len(corners), dtype=np.bool_)
    wrong[owner[off > REACHED_WITHIN]] = True
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
    small = (longest <= PIECE_SHARE * radius * (1.0 + 1e-9))[:, None, None]
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
    size, many = PIECE_SHARE * radius, 0
    open_, owner = face.corners[rows], rows
    done: list[FloatArray] = []
    owners: list[IntArray] = []
    while len(open_):
        long = np.linalg.norm(open_ - np.roll(open_, 1, axis=1), axis=2).max(axis=1) > size
        long &= many + 2 * len(open_) <= _MOST_PIECES
        split = np.flatnonzero(long)
        looks = np.concatenate([open_[split], open_[split].mean(axis=1, keepdims=True)], axis=1)
        up = np.repeat(face.normal[owner[split]], 4, axis=0)
        off = least_gap(face, looks.reshape(-1, 3), up, radius, side).reshape(-1, 4)
        split = split[(off > REACHED_WITHIN).any(axis=1)]
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
        met = np.flatnonzero(np.isfinite(known.query(corner, distance_upper_bound=CUT_IN)[0]))
        fresh = met[least_gap(face, corner[met], up[met], radius, side) > REACHED_WITHIN]
        if not len(fresh):
            return
        wrong[rows[fresh // 3]] = True
