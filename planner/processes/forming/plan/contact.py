"""A ball on a face, and the values that forming's modules hand on: passes, contact paths, tool paths.

Where a ball's centre is when it touches at a wanted place and cuts in nowhere: asked of a `Face`,
for a ball above a face whose normals point up. For a ball below, mirror the face in z first.

`Pass` is the surface of a pass, `ContactPath` the path of the contact on it, `ToolPath` where both
tools are.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.mesh import (
    TriangleMesh,
    closest_on_triangles,
    corner_normals,
    face_normals,
    small_pieces,
)
from planner.runtime.memoize import memoized

MIRROR: Final = np.array([1.0, 1.0, -1.0])
"""What turns points and directions of a face below the sheet over: times this, they are above."""
CREASE_ANGLE: Final = math.radians(20.0)
"""Faces that turn by more than this [rad] over an edge meet in a crease; by less, they stand for a smooth
face."""
CONTACT_TOLERANCE: Final = 1e-6
"""The ball may cut in by so much [m]; places so near to the nearest one are touched as well."""
ON_FACE: Final = 3e-6
"""A place of contact so near [m] to the mesh counts as on it: facets are chords of a smooth face."""
_CLEARING_ROUNDS: Final = 30
"""Rounds in which a ball is pushed out of the face at most."""
_PAIRS_AT_ONCE: Final = 200_000
"""Pairs of a ball and a piece of the face that are worked on at once."""
_MOST_PAIRS: Final = 3_000_000
"""Balls are looked at in two halves where there would be more pairs than this, to bound memory."""
_COUNTED_STRIDE: Final = 16
"""Every so many of the points are looked at first to see how many pairs there may be."""
_FEW_SHARE: Final = 0.5
"""Pairs are not counted where that says that they are fewer than this share of what is allowed."""
_MOST_PIECES: Final = 150_000
"""Pieces at most into which triangles of about one size are divided."""


@memoized
def smooth_normals(mesh: TriangleMesh) -> FloatArray:
    """Unit normals (F, 3, 3) at the corners of each face, smooth but over creases."""
    return corner_normals(mesh, CREASE_ANGLE)


@dataclasses.dataclass(frozen=True)
class Contact:
    """Of N wanted places: ``centre`` (N, 3) [m] of the ball, ``point`` (N, 3) where it touches, ``normal``
    (N, 3) from there to the centre, ``pushed`` (N,) [m] how far the centre had to go aside, ``gap`` (N,) [m]
    from the ball to the wanted place, ``clear`` (N,) whether the ball then cuts in nowhere."""

    centre: FloatArray
    point: FloatArray
    normal: FloatArray
    pushed: FloatArray
    gap: FloatArray
    clear: BoolArray


class Face:
    """A face that balls of one ``radius`` [m] touch from above; only what lies within ``box`` ((2, 2), lower
    and upper x, y [m]) and a ball's width around it is looked at."""

    def __init__(self, mesh: TriangleMesh, radius: float, box: FloatArray | None = None) -> None:
        if box is not None:
            flat = mesh.vertices[mesh.faces][:, :, :2]
            low, high = box[0] - 2.5 * radius, box[1] + 2.5 * radius
            near = ((flat.max(axis=1) >= low) & (flat.min(axis=1) <= high)).all(axis=1)
            mesh = TriangleMesh(mesh.vertices, mesh.faces[near])
        self.mesh, self.radius = mesh, radius
        self.normals = face_normals(mesh)
        self.smooth = smooth_normals(mesh)
        self._corners = mesh.vertices[mesh.faces]
        self._offset = dots(self._corners[:, 0], self.normals)
        edge = np.linalg.norm(np.roll(self._corners, -1, axis=1) - self._corners, axis=2).max(axis=1)
        # small and large faces apart, so that the large ones do not widen the search among the small ones
        self._trees: list[tuple[cKDTree, IntArray, FloatArray]] = []
        rank = np.clip(np.ceil(np.log2(np.maximum(edge / (0.05 * radius), 1e-9))), 0, 4).astype(np.int64)
        for one in np.unique(rank):
            members = np.flatnonzero(rank == one)
            pieces, owner = small_pieces(self._corners[members], 0.05 * radius * 2.0**one, _MOST_PIECES)
            if box is not None:
                low, high = pieces[:, :, :2].min(axis=1), pieces[:, :, :2].max(axis=1)
                kept = ((high >= box[0] - 2.5 * radius) & (low <= box[1] + 2.5 * radius)).all(axis=1)
                pieces, owner = pieces[kept], owner[kept]
            if not len(pieces):
                continue
            middle = pieces.mean(axis=1)
            size = np.linalg.norm(pieces - middle[:, None], axis=2).max(axis=1)
            self._trees.append((cKDTree(middle), members[owner], size))

    def normal_at(self, face: IntArray, weights: FloatArray) -> FloatArray:
        """Unit normals (N, 3), smooth over the facets, at places of ``face`` (N,) by their barycentric
        ``weights`` (N, 3)."""
        mixed = np.einsum("nk,nkd->nd", weights, self.smooth[face])
        return np.asarray(mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-300))

    def nearest(self, points: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """The places (N, 3) of the face that are nearest to ``points`` (N, 3), the faces (N,) they are on and
        their barycentric weights (N, 3)."""
        row, face, weights, place, _ = self.touched(points, 0.0)
        first = np.searchsorted(row, np.arange(len(points)))
        return place[first], face[first], weights[first]

    def touched(
        self, points: FloatArray, within: float
    ) -> tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
        """The faces that come as near to ``points`` (N, 3) as the nearest one does, or ``within`` [m] of
        that: M pairs by point, the nearest first, each the point (M,), the face (M,), its nearest place by
        barycentric weights (M, 3) and as a point (M, 3), and how far it is (M,) [m]."""
        bound = np.full(len(points), np.inf)
        for tree, owner, _ in self._trees:
            f = owner[tree.query(points)[1]]
            foot = np.einsum("nk,nkd->nd", closest_on_triangles(points, *self._ends(f)), self._corners[f])
            bound = np.minimum(bound, np.linalg.norm(points - foot, axis=1))
        bound += within + 1e-9
        order = np.argsort(bound, kind="stable")  # so that each chunk asks no wider than it needs
        nearest = bound.copy()
        kept = [(np.zeros(0, np.int64), np.zeros(0, np.int64), *np.zeros((2, 0, 3)), np.zeros(0))]
        for start in range(0, len(points), 4000):
            rows = order[start : start + 4000]
            some = points[rows]
            for i, f in self._pairs(some, bound[rows]):
                # no face is nearer than its plane, which a touch more than rounding is allowed for
                beyond = np.abs(dots(some[i], self.normals[f]) - self._offset[f]) > bound[rows[i]] + 1e-9
                i, f = i[~beyond], f[~beyond]
                weights = closest_on_triangles(some[i], *self._ends(f))
                foot = np.einsum("nk,nkd->nd", weights, self._corners[f])
                apart = np.linalg.norm(some[i] - foot, axis=1)
                i = rows[i]
                np.minimum.at(nearest, i, apart)
                use = apart <= np.minimum(nearest[i] + within, bound[i])
                kept.append((i[use], f[use], weights[use], foot[use], apart[use]))
        i, f, weights, foot, apart = (np.concatenate(part) for part in zip(*kept, strict=True))
        use = np.flatnonzero(apart <= nearest[i] + within)
        # pieces of one face are found one by one
        use = use[np.unique(i[use] * np.int64(len(self.mesh.faces)) + f[use], return_index=True)[1]]
        use = use[np.lexsort((apart[use], i[use]))]
        return i[use], f[use], weights[use], foot[use], apart[use]

    def clearance(self, centres: FloatArray) -> FloatArray:
        """Distances (N,) [m] of ``centres`` (N, 3) from the face, negative below it; those beyond the radius
        and a little may be given as infinite."""
        return self._deepest(centres, None)[0]

    def pushed(self, wanted: FloatArray, normal: FloatArray, beyond: float = 0.0) -> FloatArray:
        """How far (N,) [m] a ball put to the ``wanted`` places (N, 3) is pushed aside at once; less than
        1 um is nothing. Only what pushes at more than ``beyond`` [rad] to the ``normal`` (N, 3) counts."""
        distance, _, away = self._deepest(wanted + self.radius * normal, None)
        counts = dots(away, normal) <= np.cos(beyond)
        return np.where(counts | (beyond == 0.0), np.maximum(self.radius - distance, 0.0), 0.0)

    def deepest(self, centres: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Signed distances (N,) [m] of the face from ``centres`` (N, 3), infinite beyond the radius, the
        nearest places (N, 3), and the unit ways (N, 3) from there to the centre."""
        return self._deepest(centres, None)

    def clear(self, wanted: FloatArray, normal: FloatArray, rounds: int = _CLEARING_ROUNDS) -> Contact:
        """Put the ball to the ``wanted`` places (N, 3) along ``normal`` (N, 3) and push it aside until it
        cuts in nowhere, up to so many ``rounds``."""
        radius = self.radius
        first = wanted + radius * normal
        centre = first.copy()
        active, clear = np.arange(len(centre)), np.ones(len(centre), dtype=np.bool_)
        for _ in range(rounds):
            distance, _, away = self._deepest(centre[active], None)
            deep = distance < radius - CONTACT_TOLERANCE
            active = active[deep]
            if not len(active):
                break
            centre[active] += (radius - distance[deep] + 0.2 * CONTACT_TOLERANCE)[:, None] * away[deep]
            lost = np.linalg.norm(centre[active] - first[active], axis=1) > 2.0 * radius
            clear[active[lost]] = False
            active = active[~lost]
        clear[active] = False
        offset = centre - wanted
        apart = np.linalg.norm(offset, axis=1)
        clear &= dots(offset, normal) > 0.0
        along = np.where(apart[:, None] > 0.0, offset / np.maximum(apart, 1e-300)[:, None], normal)
        point = wanted.copy()
        moved = np.flatnonzero((centre != first).any(axis=1))
        if len(moved):
            _, place, _ = self._deepest(centre[moved], along[moved])
            # facets are chords: the ball touches the smooth face at the foot of the smooth normal, if that
            # is on the mesh within what contact means; a foot on the facets themselves would flicker from
            # one to the next
            foot = centre[moved] - radius * along[moved]
            good = np.linalg.norm(self.nearest(foot)[0] - foot, axis=1) <= ON_FACE
            point[moved] = np.where(good[:, None], foot, place)
        back = centre - point
        length = np.linalg.norm(back, axis=1, keepdims=True)
        return Contact(
            centre,
            point,
            np.asarray(back / np.maximum(length, 1e-300)),
            np.linalg.norm(centre - first, axis=1),
            np.maximum(apart - radius, 0.0),
            clear,
        )

    def _deepest(
        self, centres: FloatArray, like: FloatArray | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Signed distances (N,) of the face, infinite beyond the radius, the nearest places (N, 3) and the
        unit ways (N, 3) from there to the centre; of places that are equally near the one whose way is most
        ``like`` (N, 3) the given one."""
        reach = self.radius + 20.0 * CONTACT_TOLERANCE
        best = np.full(len(centres), np.inf)
        place, away = centres.copy(), np.tile([0.0, 0.0, 1.0], (len(centres), 1))
        for start in range(0, len(centres), 4000):
            some = centres[start : start + 4000]
            kept = []
            for i, f in self._pairs(some, np.full(len(some), reach)):
                height = dots(some[i], self.normals[f]) - self._offset[f]
                near = np.abs(height) < reach  # the plane is as far off as that at least
                i, f, height = i[near], f[near], height[near]
                weights = closest_on_triangles(some[i], *self._ends(f))
                foot = np.einsum("nk,nkd->nd", weights, self._corners[f])
                back = some[i] - foot
                apart = np.linalg.norm(back, axis=1)
                behind = (height < 0.0) & (weights.min(axis=1) > 0.0)
                apart = np.where(behind, -apart, apart)
                use = apart < reach
                kept.append((i[use], apart[use], foot[use], back[use], f[use]))
            if not kept:
                continue
            i, apart, foot, back, f = (np.concatenate(part) for part in zip(*kept, strict=True))
            near_zero = np.abs(apart) < 1e-9
            way = np.where(
                near_zero[:, None], self.normals[f], back / np.where(near_zero, 1.0, apart)[:, None]
            )
            first = _first_least(i, apart)
            best[start + i[first]] = apart[first]
            if like is not None:
                tie = apart <= best[start + i] + CONTACT_TOLERANCE
                i, apart, foot, way = i[tie], apart[tie], foot[tie], way[tie]
                first = _first_least(i, -dots(way, like[start + i]))
            place[start + i[first]], away[start + i[first]] = foot[first], way[first]
        return best, place, away

    def _ends(self, face: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        corners = self._corners[face]
        return corners[:, 0], corners[:, 1], corners[:, 2]

    def _pairs(self, points: FloatArray, reach: FloatArray) -> Iterator[tuple[IntArray, IntArray]]:
        """Indices of points and of faces that may be as near as ``reach`` (N,) to each other, in chunks."""
        most = [float(reach.max()) + float(size.max()) for _, _, size in self._trees]
        mine = cKDTree(points)
        if self._many(points, mine, most) and len(points) > 1:  # a large ball on a fine mesh
            half = len(points) // 2
            for first, part in ((0, slice(None, half)), (half, slice(half, None))):
                for i, f in self._pairs(points[part], reach[part]):
                    yield i + first, f
            return
        for (tree, owner, size), far in zip(self._trees, most, strict=True):
            found = mine.sparse_distance_matrix(tree, far, output_type="ndarray")
            found = found[found["v"] <= reach[found["i"]] + size[found["j"]]]
            for start in range(0, len(found), _PAIRS_AT_ONCE):
                part = found[start : start + _PAIRS_AT_ONCE]
                yield part["i"], owner[part["j"]]

    def _many(self, points: FloatArray, mine: cKDTree, most: list[float]) -> bool:
        """Whether points (N, 3), the tree ``mine``, and pieces nearer than ``most`` [m], one a tree, are more
        than ``_MOST_PAIRS`` pairs: they are counted where a few of the points say that they may be."""
        some = cKDTree(points[::_COUNTED_STRIDE])
        each = tuple((tree, far) for (tree, _, _), far in zip(self._trees, most, strict=True))
        if _COUNTED_STRIDE * sum(int(some.count_neighbors(*one)) for one in each) < _FEW_SHARE * _MOST_PAIRS:
            return False
        return sum(int(mine.count_neighbors(*one)) for one in each) > _MOST_PAIRS


def _first_least(group: IntArray, value: FloatArray) -> IntArray:
    """Index of the least ``value`` of each group."""
    order = np.lexsort((value, group))
    ordered = group[order]
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = ordered[1:] != ordered[:-1]
    return np.asarray(order[first])


@dataclasses.dataclass(frozen=True)
class Pass:
    """One pass over one feature: the surface that the forming tool touches, as it is to be at the end of the
    pass, in the sheet's frame where the pass forms it (translated, if its strategy says so).

    ``vertices`` (V, 3) [m], ``faces`` (F, 3) with normals up (+z), whichever side forms. ``side``: +1 where
    the tool above the sheet forms (downwards), -1 where the one below forms (upwards). ``thickness`` (V,) [m]
    of the sheet along the normal after the pass. ``start``, ``end`` [m]: levels z of the flat around the
    feature and of its farthest place, on that face. ``region`` (K, 2) [m]: closed outline at the start.
    """

    name: str
    feature: int
    number: int
    side: int
    vertices: FloatArray
    faces: IntArray
    thickness: FloatArray
    start: float
    end: float
    region: FloatArray


def heights(one: Pass, step: float, number: int) -> tuple[float, float]:
    """How far [m] below the flat around it a level begins and ends, at steps of ``step`` [m]."""
    deep = abs(one.end - one.start)
    return min(number * step, deep), min((number + 1) * step, deep)


@dataclasses.dataclass(frozen=True)
class ContactPath:
    """The path of the contact on the face of a pass, N points in the order of forming.

    ``point`` (N, 3) [m] on the face; ``normal`` (N, 3), unit, up (+z) whichever side forms; ``centre`` (N, 3)
    [m] of the forming ball, clear of the whole face and in contact with it at ``point``; ``angle`` (N,) [rad]
    of the wall; ``loop`` (N,) number of the loop, from 0; ``working`` (N,): the move TO the point forms,
    which a step over to the next loop in the air does not.
    """

    point: FloatArray
    normal: FloatArray
    centre: FloatArray
    angle: FloatArray
    loop: IntArray
    working: BoolArray


@dataclasses.dataclass(frozen=True)
class ToolPath:
    """Where both tools are at N targets of one pass.

    ``former`` (N, 3) [m] centre of the forming ball. ``support`` (N, 3) [m]: centre of the other tool's ball
    or disk, or None where one tool works alone. ``gap`` (N,) [m] wanted between both tools' surfaces, NaN
    where none is stated. ``axis`` and ``support_axis`` (N, 3): unit vectors from the tools to the sheet.
    ``contact`` is the contact's path at the same targets. ``loose`` (N,): more targets were wanted on the way
    to this one, but did not help; None where nothing is.
    """

    former: FloatArray
    axis: FloatArray
    support: FloatArray | None
    support_axis: FloatArray | None
    gap: FloatArray
    contact: ContactPath
    loose: BoolArray | None = None
