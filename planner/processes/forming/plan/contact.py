"""A ball on a face, and the values that the forming modules exchange: passes, contact paths, tool paths.

`ContactFace` finds the centre of a ball that touches the face at a required point without cutting into it,
for a ball above a face whose normals point up. For a ball below, mirror the face in z first.

`FormingPass` is the surface of a pass, `ContactPath` the path of the contact on it, `PassContact` both of
them, `FormingToolPath` the path of both tools.
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
    bisect_triangles,
    closest_weights,
    corner_normals,
    face_normals,
)
from planner.runtime.memoize import memoized

MIRROR: Final = np.array([1.0, 1.0, -1.0])
"""Factors that mirror points and directions in z, so that a face that is formed from below can be treated as
from above.
"""
CREASE_ANGLE_RAD: Final = math.radians(20.0)
"""Faces that meet at more than this angle [rad] form a crease; at less, they approximate a smooth face."""
CONTACT_TOLERANCE_M: Final = 1e-6
"""Allowed penetration [m] of the ball. Points this near to the nearest one are touched as well."""
ON_FACE_TOLERANCE_M: Final = 3e-6
"""Contact points this near [m] to the mesh count as on it, because facets are chords of a smooth face."""
_MAX_CLEARING_ROUNDS: Final = 30
"""Maximum number of rounds in which a ball is pushed out of the face."""
_PAIRS_AT_ONCE: Final = 200_000
"""Pairs of a ball and a piece of the face that are processed at once, to bound memory."""
_MAX_PAIRS: Final = 3_000_000
"""Maximum number of pairs of a search. Larger sets of balls are halved, to bound memory."""
_PAIR_SAMPLE_STRIDE: Final = 16
"""Stride of the points from which the number of pairs is estimated."""
_PAIR_ESTIMATE_FRACTION: Final = 0.5
"""Pairs are not counted if the estimate is below this fraction of the maximum."""
_MAX_PIECES: Final = 150_000
"""Maximum number of pieces into which triangles of about one size are divided."""


@memoized
def smooth_normals(mesh: TriangleMesh) -> FloatArray:
    """Return unit normals (F, 3, 3) at the corners of each face, smooth except over creases."""
    return corner_normals(mesh, CREASE_ANGLE_RAD)


@dataclasses.dataclass(frozen=True)
class Contact:
    """Ball positions for N required points.

    Attributes:
        centre: Centres (N, 3) [m] of the ball.
        point: Points (N, 3) [m] where it touches.
        normal: Unit vectors (N, 3) from there to the centre.
        pushed: Distances (N,) [m] by which the centre was pushed aside so that the ball does not cut in.
        gap: Distances (N,) [m] from the ball to the required point.
        clear: Whether (N,) the ball at its centre does not cut into the face.
    """

    centre: FloatArray
    point: FloatArray
    normal: FloatArray
    pushed: FloatArray
    gap: FloatArray
    clear: BoolArray


class ContactFace:
    """A face that balls of one radius touch from above.

    Args:
        mesh: Face with normals up.
        radius: Radius [m] of the balls.
        box: Lower and upper x, y (2, 2) [m]; only the face inside it, and within a ball's diameter around, is
            used.
    """

    def __init__(self, mesh: TriangleMesh, radius: float, box: FloatArray | None = None) -> None:
        if box is not None:
            plan_corners = mesh.vertices[mesh.faces][:, :, :2]
            low, high = box[0] - 2.5 * radius, box[1] + 2.5 * radius
            face_in_box = ((plan_corners.max(axis=1) >= low) & (plan_corners.min(axis=1) <= high)).all(axis=1)
            mesh = TriangleMesh(mesh.vertices, mesh.faces[face_in_box])
        self.mesh, self.radius = mesh, radius
        self.normals = face_normals(mesh)
        self.smooth = smooth_normals(mesh)
        self._corners = mesh.vertices[mesh.faces]
        self._offset = dots(self._corners[:, 0], self.normals)
        edge = np.linalg.norm(np.roll(self._corners, -1, axis=1) - self._corners, axis=2).max(axis=1)
        # separate trees of face pieces for small and large faces, so that large ones do not widen the search
        # for small ones
        self._trees: list[tuple[cKDTree, IntArray, FloatArray]] = []
        # size classes 0 to 4: the longest edge is up to 0.05, 0.1, 0.2, 0.4 radii, or longer
        rank = np.clip(np.ceil(np.log2(np.maximum(edge / (0.05 * radius), 1e-9))), 0, 4).astype(np.int64)
        for size_class in np.unique(rank):
            members = np.flatnonzero(rank == size_class)
            pieces, owner = bisect_triangles(
                self._corners[members], 0.05 * radius * 2.0**size_class, _MAX_PIECES
            )
            if box is not None:
                low, high = pieces[:, :, :2].min(axis=1), pieces[:, :, :2].max(axis=1)
                in_box = ((high >= box[0] - 2.5 * radius) & (low <= box[1] + 2.5 * radius)).all(axis=1)
                pieces, owner = pieces[in_box], owner[in_box]
            if not len(pieces):
                continue
            centroid = pieces.mean(axis=1)
            piece_radius = np.linalg.norm(pieces - centroid[:, None], axis=2).max(axis=1)
            self._trees.append((cKDTree(centroid), members[owner], piece_radius))

    def normal_at(self, face: IntArray, weights: FloatArray) -> FloatArray:
        """Return unit normals (N, 3) at points of the face, interpolated so that they are smooth over facets.

        Args:
            face: Face of each point (N,).
            weights: Barycentric weights (N, 3) of the points.
        """
        mixed = np.einsum("nk,nkd->nd", weights, self.smooth[face])
        return np.asarray(mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-300))

    def nearest(self, points: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return the nearest points of the face.

        Args:
            points: Points (N, 3) [m].

        Returns:
            Nearest points (N, 3) [m], their faces (N,) and their barycentric weights (N, 3).
        """
        index, face, weights, foot, _ = self.touched(points, 0.0)
        first = np.searchsorted(index, np.arange(len(points)))
        return foot[first], face[first], weights[first]

    def touched(
        self, points: FloatArray, within: float
    ) -> tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
        """Return, for each point, all faces that are at most ``within`` farther from it than the nearest one.

        Args:
            points: Points (N, 3) [m].
            within: Additional distance [m] beyond that of the nearest face.

        Returns:
            M pairs, ordered by point and then by distance: point (M,), face (M,), barycentric weights (M, 3)
            and position (M, 3) [m] of the nearest point of that face, and distance (M,) [m].
        """
        # upper bound of the distances that count: that of the face of the nearest piece, plus ``within``
        bound = np.full(len(points), np.inf)
        for tree, owner, _ in self._trees:
            f = owner[tree.query(points)[1]]
            foot = np.einsum("nk,nkd->nd", closest_weights(points, *self._face_corners(f)), self._corners[f])
            bound = np.minimum(bound, np.linalg.norm(points - foot, axis=1))
        bound += within + 1e-9
        order = np.argsort(bound, kind="stable")  # so that each chunk limits its search radius
        nearest = bound.copy()
        kept = [(np.zeros(0, np.int64), np.zeros(0, np.int64), *np.zeros((2, 0, 3)), np.zeros(0))]
        for start in range(0, len(points), 4000):
            indices = order[start : start + 4000]
            chunk = points[indices]
            for i, f in self._pairs(chunk, bound[indices]):
                # a face is never nearer than its plane: |n . p - d| <= distance (1e-9 covers rounding)
                beyond = np.abs(dots(chunk[i], self.normals[f]) - self._offset[f]) > bound[indices[i]] + 1e-9
                i, f = i[~beyond], f[~beyond]
                weights = closest_weights(chunk[i], *self._face_corners(f))
                foot = np.einsum("nk,nkd->nd", weights, self._corners[f])
                distance = np.linalg.norm(chunk[i] - foot, axis=1)
                i = indices[i]
                np.minimum.at(nearest, i, distance)
                use = distance <= np.minimum(nearest[i] + within, bound[i])
                kept.append((i[use], f[use], weights[use], foot[use], distance[use]))
        i, f, weights, foot, distance = (np.concatenate(part) for part in zip(*kept, strict=True))
        use = np.flatnonzero(distance <= nearest[i] + within)
        # several pieces of one face may be found: keep one pair for each point and face
        use = use[np.unique(i[use] * np.int64(len(self.mesh.faces)) + f[use], return_index=True)[1]]
        use = use[np.lexsort((distance[use], i[use]))]
        return i[use], f[use], weights[use], foot[use], distance[use]

    def clearance(self, centres: FloatArray) -> FloatArray:
        """Return distances (N,) [m] of ``centres`` (N, 3) from the face, negative below it.

        Distances beyond the radius plus a small margin may be infinite.
        """
        return self._deepest(centres, None)[0]

    def pushed(self, required: FloatArray, normal: FloatArray, beyond: float = 0.0) -> FloatArray:
        """Return by how much a ball that is placed at a required point cuts into the face.

        That is the distance by which it would first be pushed aside.

        Args:
            required: Required contact points (N, 3) [m].
            normal: Unit normals (N, 3) along which the ball is placed.
            beyond: Only pushes at more than this angle [rad] to the normal count; 0 for all.

        Returns:
            Distances (N,) [m], 0 where the push does not count; values below 1 um are within the tolerance.
        """
        distance, _, away = self._deepest(required + self.radius * normal, None)
        is_counted = dots(away, normal) <= np.cos(beyond)
        return np.where(is_counted | (beyond == 0.0), np.maximum(self.radius - distance, 0.0), 0.0)

    def deepest(self, centres: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the nearest points of the face for ball centres.

        Args:
            centres: Centres (N, 3) [m].

        Returns:
            Signed distances (N,) [m], infinite beyond the radius; nearest points (N, 3); unit vectors (N, 3)
            from there to the centre.
        """
        return self._deepest(centres, None)

    def clear(self, required: FloatArray, normal: FloatArray, rounds: int = _MAX_CLEARING_ROUNDS) -> Contact:
        """Place the ball at required points and push it aside until it does not cut into the face.

        In each round every ball that cuts in moves away from its deepest point until it only touches there.

        Args:
            required: Required contact points (N, 3) [m].
            normal: Unit normals (N, 3) along which the ball is placed.
            rounds: Maximum number of rounds.

        Returns:
            Ball positions. ``clear`` is False for balls that still cut in after the last round, were pushed
            farther than their diameter, or ended up on the wrong side of the required point.
        """
        radius = self.radius
        initial = required + radius * normal
        centre = initial.copy()
        active = np.arange(len(centre))
        clear = np.ones(len(centre), dtype=np.bool_)
        for _ in range(rounds):
            distance, _, away = self._deepest(centre[active], None)
            deep = distance < radius - CONTACT_TOLERANCE_M
            active = active[deep]
            if not len(active):
                break
            centre[active] += (radius - distance[deep] + 0.2 * CONTACT_TOLERANCE_M)[:, None] * away[deep]
            runaway = np.linalg.norm(centre[active] - initial[active], axis=1) > 2.0 * radius
            clear[active[runaway]] = False
            active = active[~runaway]
        clear[active] = False
        offset = centre - required
        offset_length = np.linalg.norm(offset, axis=1)
        clear &= dots(offset, normal) > 0.0
        direction = np.where(
            offset_length[:, None] > 0.0, offset / np.maximum(offset_length, 1e-300)[:, None], normal
        )
        point = required.copy()
        moved = np.flatnonzero((centre != initial).any(axis=1))
        if len(moved):
            _, nearest, _ = self._deepest(centre[moved], direction[moved])
            # Facets are chords: the ball touches the smooth face at the foot of the smooth normal,
            # c - R n, if that is on the mesh within ON_FACE_TOLERANCE_M. A foot on the facets themselves
            # would jump from one to the next.
            foot = centre[moved] - radius * direction[moved]
            is_on_mesh = np.linalg.norm(self.nearest(foot)[0] - foot, axis=1) <= ON_FACE_TOLERANCE_M
            point[moved] = np.where(is_on_mesh[:, None], foot, nearest)
        to_centre = centre - point
        length = np.linalg.norm(to_centre, axis=1, keepdims=True)
        return Contact(
            centre,
            point,
            np.asarray(to_centre / np.maximum(length, 1e-300)),
            np.linalg.norm(centre - initial, axis=1),
            np.maximum(offset_length - radius, 0.0),
            clear,
        )

    def _deepest(
        self, centres: FloatArray, reference: FloatArray | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return signed distances, nearest points and directions for ball centres as `deepest` does.

        A distance is negative if the centre is below the inside of the nearest triangle. If several points
        are equally near, the one whose direction is closest to ``reference`` (N, 3) is taken, or any of them
        if ``reference`` is None.
        """
        reach = self.radius + 20.0 * CONTACT_TOLERANCE_M
        best = np.full(len(centres), np.inf)
        nearest, away = centres.copy(), np.tile([0.0, 0.0, 1.0], (len(centres), 1))
        for start in range(0, len(centres), 4000):
            chunk = centres[start : start + 4000]
            kept = []
            for i, f in self._pairs(chunk, np.full(len(chunk), reach)):  # indices of points and of faces
                height = dots(chunk[i], self.normals[f]) - self._offset[f]
                in_reach = np.abs(height) < reach  # the plane is a lower bound of the distance
                i, f, height = i[in_reach], f[in_reach], height[in_reach]
                weights = closest_weights(chunk[i], *self._face_corners(f))
                foot = np.einsum("nk,nkd->nd", weights, self._corners[f])
                to_centre = chunk[i] - foot
                distance = np.linalg.norm(to_centre, axis=1)
                is_below = (height < 0.0) & (weights.min(axis=1) > 0.0)
                distance = np.where(is_below, -distance, distance)
                near = distance < reach
                kept.append((i[near], distance[near], foot[near], to_centre[near], f[near]))
            if not kept:
                continue
            i, distance, foot, to_centre, f = (np.concatenate(part) for part in zip(*kept, strict=True))
            near_zero = np.abs(distance) < 1e-9
            direction = np.where(
                near_zero[:, None], self.normals[f], to_centre / np.where(near_zero, 1.0, distance)[:, None]
            )
            best_pair = _first_minimum(i, distance)
            best[start + i[best_pair]] = distance[best_pair]
            if reference is not None:
                tie = distance <= best[start + i] + CONTACT_TOLERANCE_M
                i, distance, foot, direction = (i[tie], distance[tie], foot[tie], direction[tie])
                best_pair = _first_minimum(i, -dots(direction, reference[start + i]))
            nearest[start + i[best_pair]], away[start + i[best_pair]] = foot[best_pair], direction[best_pair]
        return best, nearest, away

    def _face_corners(self, face: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        corners = self._corners[face]
        return corners[:, 0], corners[:, 1], corners[:, 2]

    def _pairs(self, points: FloatArray, reach: FloatArray) -> Iterator[tuple[IntArray, IntArray]]:
        """Yield chunks of pairs: indices of points and of faces that may be within ``reach`` (N,) [m]."""
        max_distances = [float(reach.max()) + float(size.max()) for _, _, size in self._trees]
        own_tree = cKDTree(points)
        if self._has_too_many_pairs(points, own_tree, max_distances) and len(points) > 1:  # bounds memory
            half = len(points) // 2
            for first, part in ((0, slice(None, half)), (half, slice(half, None))):
                for i, f in self._pairs(points[part], reach[part]):
                    yield i + first, f
            return
        for (tree, owner, size), max_distance in zip(self._trees, max_distances, strict=True):
            pairs = own_tree.sparse_distance_matrix(tree, max_distance, output_type="ndarray")
            pairs = pairs[pairs["v"] <= reach[pairs["i"]] + size[pairs["j"]]]
            for start in range(0, len(pairs), _PAIRS_AT_ONCE):
                part = pairs[start : start + _PAIRS_AT_ONCE]
                yield part["i"], owner[part["j"]]

    def _has_too_many_pairs(self, points: FloatArray, own_tree: cKDTree, max_distances: list[float]) -> bool:
        """Return whether points (N, 3) and the pieces of the face near them form too many pairs.

        Pieces are near within ``max_distances`` [m], one for each tree. The limit is ``_MAX_PAIRS``.
        ``own_tree`` is the tree of the points. Pairs are counted only if a sample of the points indicates
        that there may be too many.
        """
        sample = cKDTree(points[::_PAIR_SAMPLE_STRIDE])
        queries = tuple(
            (tree, max_distance)
            for (tree, _, _), max_distance in zip(self._trees, max_distances, strict=True)
        )
        if (
            _PAIR_SAMPLE_STRIDE * sum(int(sample.count_neighbors(*query)) for query in queries)
            < _PAIR_ESTIMATE_FRACTION * _MAX_PAIRS
        ):
            return False
        return sum(int(own_tree.count_neighbors(*query)) for query in queries) > _MAX_PAIRS


def _first_minimum(group: IntArray, value: FloatArray) -> IntArray:
    """Return the index of the minimum ``value`` (N,) among elements of equal ``group`` (N,), by group."""
    order = np.lexsort((value, group))
    ordered = group[order]
    is_first = np.ones(len(order), dtype=np.bool_)
    is_first[1:] = ordered[1:] != ordered[:-1]
    return np.asarray(order[is_first])


@dataclasses.dataclass(frozen=True)
class FormingPass:
    """One pass over one feature: the surface that the forming tool touches, as it is at the end of the pass.

    Coordinates are in the sheet's frame, where the pass forms the surface (translated, if the strategy
    requires it).

    Attributes:
        name: Name of the pass.
        feature: Id of its feature.
        number: Number of the pass over the feature.
        side: +1 if the tool above the sheet forms (downwards), -1 if the one below forms (upwards).
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3) with normals up (+z), whichever side forms.
        thickness: Thickness (V,) [m] of the sheet along the normal after the pass.
        start: Level z [m] of the flat around the feature, on that face.
        end: Level z [m] of the feature's farthest point, on that face.
        region: Closed outline (K, 2) [m] at the start.
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


def level_depths(forming_pass: FormingPass, step: float, number: int) -> tuple[float, float]:
    """Return the depths [m] at which a level starts and ends, from the flat around the feature.

    Args:
        forming_pass: Pass.
        step: Step-down [m].
        number: Number of the level, from 0.
    """
    depth = abs(forming_pass.end - forming_pass.start)
    return min(number * step, depth), min((number + 1) * step, depth)


@dataclasses.dataclass(frozen=True)
class ContactPath:
    """Path of the contact on the face of a pass, N points in the order of forming.

    Attributes:
        point: Contact points (N, 3) [m] on the face.
        normal: Unit normals (N, 3), up (+z) whichever side forms.
        centre: Centres (N, 3) [m] of the forming ball, which touches the face at ``point`` and does not cut
            into it.
        angle: Wall angles (N,) [rad].
        loop: Number (N,) of the loop, from 0.
        working: Whether (N,) the move TO the point forms; a step through the air to the next loop does not.
    """

    point: FloatArray
    normal: FloatArray
    centre: FloatArray
    angle: FloatArray
    loop: IntArray
    working: BoolArray


@dataclasses.dataclass(frozen=True)
class PassContact:
    """Pass with the path of the contact on its face.

    Attributes:
        forming_pass: Pass.
        contact: Path of the contact.
    """

    forming_pass: FormingPass
    contact: ContactPath


@dataclasses.dataclass(frozen=True)
class FormingToolPath:
    """Positions of both tools at N targets of one pass.

    Attributes:
        forming_centre: Centres (N, 3) [m] of the forming ball.
        axis: Unit vectors (N, 3) from the forming tool to the sheet.
        support_centre: Centres (N, 3) [m] of the other tool's ball or disk, or None if one tool works alone.
        support_axis: Unit vectors (N, 3) from the other tool to the sheet.
        gap: Required gap (N,) [m] between the tools' surfaces, NaN where none is stated.
        contact: Path of the contact at the same targets.
        unresolved: Whether (N,) further targets between this one and the previous one were needed but did
            not help; None if there is no such target.
    """

    forming_centre: FloatArray
    axis: FloatArray
    support_centre: FloatArray | None
    support_axis: FloatArray | None
    gap: FloatArray
    contact: ContactPath
    unresolved: BoolArray | None = None
