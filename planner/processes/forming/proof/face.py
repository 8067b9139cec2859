"""A formed face: nearest points, sides, distances of straight lines, and what a ball can reach of it.

All distances are exact for the triangles. The face continues flat beyond its border, as the sheet does.
Groups of triangles, as flat disks in a hierarchy, tell which triangles may be nearest to points or straight
lines.

The reach of a ball: the minimum distance from a point of any ball of its size that does not cut into the
face. A ball above a hollow stays beyond the plane of every point of it, by its radius. So the nearest
possible centre is that of the active planes. They are found one by one, each where the best centre so far
still cuts in, and the centre is moved to the nearest point beyond the last of them. In a hollow no centre is
ever too far away thus, and one that does not cut in is the nearest possible. In a sharp corner between two
planes at the angle a to each other a ball of radius R stays R (1 / cos(a / 2) - 1) away, in the tip of a cone
whose wall has the angle a, R (1 / cos a - 1).
"""

import dataclasses
import itertools
from collections.abc import Callable
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, lengths
from planner.geometry.mesh import TriangleMesh, bisect_triangles, closest_weights, corner_normals

TREE_BRANCHES: Final = 4
"""Branches of each node of the tree of triangles."""


@dataclasses.dataclass(frozen=True)
class DiskLevel:
    """Groups of triangles at one level of a tree, each as a flat disk that contains its triangles.

    The children of group k are groups 4 k to 4 k + 3 of the next level. Empty groups have a negative radius.

    Attributes:
        centre: Centres (K, 3) [m].
        normal: Unit normals (K, 3).
        radius: Radii (K,) [m].
        half: Half thicknesses (K,) [m].
    """

    centre: FloatArray
    normal: FloatArray
    radius: FloatArray
    half: FloatArray


class TriangleTree:
    """Triangles (F, 3, 3) [m] in groups of four, these in groups of four, and so on, for fast queries.

    Attributes:
        triangle: The triangle in each of the 4^depth places of the lowest level, -1 for none.
        levels: The groups of each level, from the single one of all triangles down.
    """

    def __init__(self, corners: FloatArray) -> None:
        count = len(corners)
        depth = max(int(np.ceil(np.log(max(count, 1)) / np.log(TREE_BRANCHES))), 0)
        slot_count = TREE_BRANCHES**depth
        middle = corners.mean(axis=1)
        order = np.arange(count)
        slots = np.full(slot_count, -1, dtype=np.int64)
        # halve each group along its widest axis, so that the order of the slots is the tree
        slot = np.zeros(count, dtype=np.int64)
        size = slot_count
        while size > 1:
            half = size // 2
            group = slot // size
            low = np.full((slot_count // size, 3), np.inf)
            high = -low
            np.minimum.at(low, group, middle[order])
            np.maximum.at(high, group, middle[order])
            widest = np.argmax(high - low, axis=1)
            value = middle[order, widest[group]]
            sorting = np.lexsort((value, group))
            order, group = order[sorting], group[sorting]
            first = np.searchsorted(group, group)
            rank = np.arange(count) - first
            number = np.bincount(group, minlength=slot_count // size)[group]
            cut = np.minimum((number + 1) // 2, half)
            slot = group * size + np.where(rank < cut, rank, half + rank - cut)
            size = half
        slots[slot] = order
        self.triangle = slots
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.levels = tuple(
            _disk_level(corners, cross, slots.reshape(TREE_BRANCHES**k, -1)) for k in range(depth + 1)
        )

    def near_points(self, points: FloatArray, limit: FloatArray) -> tuple[IntArray, IntArray]:
        """Return all pairs (M,) of points (N, 3) and triangles that may be nearer than ``limit`` (N,) [m]."""
        return self._near_pairs(limit, lambda level, node, query: _point_distance(level, node, points[query]))

    def near_lines(self, start: FloatArray, end: FloatArray, limit: FloatArray) -> tuple[IntArray, IntArray]:
        """Return all pairs of straight lines and triangles that may be nearer to each other than a limit.

        Args:
            start: Starts (N, 3) [m].
            end: Ends (N, 3) [m].
            limit: Distances (N,) [m] below which pairs are returned.

        Returns:
            Indices (M,) of the lines and of their triangles.
        """
        return self._near_pairs(
            limit, lambda level, node, query: _line_distance(level, node, start[query], end[query])
        )

    def _near_pairs(
        self, limit: FloatArray, distance: Callable[[DiskLevel, IntArray, IntArray], FloatArray]
    ) -> tuple[IntArray, IntArray]:
        """Descend the tree, at each level only into groups nearer to the query than its limit.

        ``distance`` gets a level, and for each of M pairs its group and the index of its query.
        """
        query = np.arange(len(limit))
        node = np.zeros(len(limit), dtype=np.int64)
        for k, level in enumerate(self.levels):
            if k:
                query = np.repeat(query, TREE_BRANCHES)
                node = (TREE_BRANCHES * node[:, None] + np.arange(TREE_BRANCHES)).ravel()
            is_near = distance(level, node, query) < limit[query]
            query, node = query[is_near], node[is_near]
        return query, self.triangle[node]


def _disk_level(corners: FloatArray, cross: FloatArray, slots: IntArray) -> DiskLevel:
    """Enclose groups of triangles in disks, normal to the sum of the triangles' normals.

    ``cross`` (F, 3) are the cross products of the triangles' edges, ``slots`` (K, S) the triangles of each
    group, -1 for none.
    """
    used = slots >= 0
    group, column = np.nonzero(used)
    triangle = slots[group, column]
    count = len(slots)
    points = corners[triangle]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, group, points.min(axis=1))
    np.maximum.at(high, group, points.max(axis=1))
    is_used = np.isfinite(low)
    centre = 0.5 * (np.where(is_used, low, 0.0) + np.where(is_used, high, 0.0))
    normal = np.zeros((count, 3))
    np.add.at(normal, group, cross[triangle])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-30, normal / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0]))
    rest = points - centre[group][:, None]
    height = np.einsum("nkd,nd->nk", rest, normal[group])
    radial = np.sqrt(np.maximum((rest * rest).sum(axis=2) - height**2, 0.0))
    radius, half = np.full(count, -np.inf), np.zeros(count)
    np.maximum.at(radius, group, radial.max(axis=1))
    np.maximum.at(half, group, np.abs(height).max(axis=1))
    return DiskLevel(centre, normal, radius + 1e-12, half + 1e-12)


def _point_distance(level: DiskLevel, node: IntArray, points: FloatArray) -> FloatArray:
    """Return a lower bound (M,) [m] of the distance of points from groups of triangles.

    It is infinite for empty groups.
    """
    rest = points - level.centre[node]
    height = dots(rest, level.normal[node])
    radial = np.sqrt(np.maximum(dots(rest, rest) - height * height, 0.0))
    return _disk_distance(level, node, radial, np.abs(height))


def _line_distance(level: DiskLevel, node: IntArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the lower bound (M,) [m] of the distance of straight lines from groups of triangles."""
    normal, centre = level.normal[node], level.centre[node]
    start_offset, end_offset = start - centre, end - centre
    low, high = dots(start_offset, normal), dots(end_offset, normal)
    height = np.where(low * high > 0.0, np.minimum(np.abs(low), np.abs(high)), 0.0)
    middle = 0.5 * (start_offset + end_offset)
    middle_height = 0.5 * (low + high)
    # no point of the line is nearer to the disk's axis than its middle minus half its length
    radial = np.sqrt(np.maximum(dots(middle, middle) - middle_height * middle_height, 0.0)) - 0.5 * lengths(
        end - start
    )
    return _disk_distance(level, node, radial, height)


def _disk_distance(level: DiskLevel, node: IntArray, radial: FloatArray, height: FloatArray) -> FloatArray:
    """Return the distance (M,) [m] from disks of points at a radius and a height in the disk's own frame."""
    radius = level.radius[node]
    # d >= hypot(height - half, radial - radius), each at least 0: the contents lie in this cylinder
    lateral = np.maximum(radial - radius, 0.0)
    above = np.maximum(height - level.half[node], 0.0)
    return np.where(radius < 0.0, np.inf, np.hypot(above, lateral))


EQUAL_DISTANCE_TOLERANCE_M = 1e-7
"""Points whose distances differ by less [m] are equally near."""
CREASE_ANGLE_RAD = np.deg2rad(20.0)
"""Triangles that meet at more than this angle [rad] form a crease."""
_MIN_SEED_SIZE_M = 0.003
"""Minimum size [m] of the pieces of triangles for the search of the nearest ones."""
_MAX_SEEDS = 150_000
"""Maximum number of such pieces."""
_POINTS_AT_ONCE = 1_000
"""Points, or lines, that are compared with the face at once, to bound memory."""


@dataclasses.dataclass(frozen=True)
class NearestPoints:
    """Nearest points of a face for N points.

    The last four attributes list all M points of the face that are equally near within the requested
    tolerance.

    Attributes:
        point: Nearest points (N, 3) [m] on the face.
        distance: Distances (N,) [m].
        signed: Distances (N,) [m], negative below the face (its normals point up); beyond the border the
            height above the flat.
        row: Index (M,) among the N points, ascending.
        triangle: Triangle (M,) of the face.
        weight: Barycentric weights (M, 3) in that triangle.
        tied: Points (M, 3) [m] on the face.
    """

    point: FloatArray
    distance: FloatArray
    signed: FloatArray
    row: IntArray
    triangle: IntArray
    weight: FloatArray
    tied: FloatArray

    def subset(self, chosen: IntArray) -> "NearestPoints":
        """Return the values of the points ``chosen`` (K,), in their order."""
        new_index = np.full(len(self.distance), -1)
        new_index[chosen] = np.arange(len(chosen))
        row = new_index[self.row]
        use = np.flatnonzero(row >= 0)
        use = use[np.argsort(row[use], kind="stable")]
        points = self.point[chosen], self.distance[chosen], self.signed[chosen]
        return NearestPoints(*points, row[use], self.triangle[use], self.weight[use], self.tied[use])

    def concatenate(self, other: "NearestPoints") -> "NearestPoints":
        """Return the values of these points and then of the ``other`` ones."""
        return NearestPoints(
            np.concatenate([self.point, other.point]),
            np.concatenate([self.distance, other.distance]),
            np.concatenate([self.signed, other.signed]),
            np.concatenate([self.row, other.row + len(self.distance)]),
            np.concatenate([self.triangle, other.triangle]),
            np.concatenate([self.weight, other.weight]),
            np.concatenate([self.tied, other.tied]),
        )


class ProofFace:
    """The triangles of a face with normals up, however vertices are numbered.

    Attributes:
        given: Corners (F, 3, 3) [m] of all triangles.
        rows: Indices of the triangles that have an area. All other attributes and queries refer to these.
        corners: Their corners [m].
        area: Their areas [m^2].
        normal: Their unit normals.
        border: Which of their edges, each from a corner to the next, are on the border of the face.

    Args:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3) with normals up.
        scale: Radius [m] of the ball, which determines the size of the pieces for searches.
    """

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
        self.border = _border_edges(vertices, self.faces)
        pieces, self._owner = bisect_triangles(self.corners, max(_MIN_SEED_SIZE_M, 0.25 * scale), _MAX_SEEDS)
        self._seeds = cKDTree(pieces.mean(axis=1))
        self._tree = TriangleTree(self.corners)
        self.remaining_faces: dict[tuple[float, int, float], ProofFace | None] = {}
        """Cached results of :func:`remaining_face`, by its other arguments; None for the face itself."""

    @cached_property
    def smooth_normals(self) -> FloatArray:
        """Normals (F, 3, 3) at the corners of the triangles, smooth except over creases.

        Vertices at one position count as one, even if they have several numbers, as along creases.
        """
        _, vertex_index = np.unique(self.vertices.round(9), axis=0, return_inverse=True)
        representative = np.zeros(int(vertex_index.max()) + 1, dtype=np.int64)
        representative[vertex_index.ravel()] = np.arange(len(self.vertices))
        return corner_normals(
            TriangleMesh(self.vertices, representative[vertex_index.ravel()[self.faces]]), CREASE_ANGLE_RAD
        )

    def nearest(self, points: FloatArray, within: float = EQUAL_DISTANCE_TOLERANCE_M) -> NearestPoints:
        """Return the nearest point of the face for each point, and all others that are equally near.

        Args:
            points: Points (N, 3) [m].
            within: Points of the face that are farther than the nearest one by at most this [m] are equally
                near.
        """
        distance = np.full(len(points), np.inf)
        kept: list[tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]] = []
        for rows in np.array_split(np.arange(len(points)), max(1, len(points) // _POINTS_AT_ONCE)):
            if not len(rows):
                continue
            # upper bound: the triangle of the nearest seed; then all triangles that may be nearer than that
            first = self._owner[np.asarray(self._seeds.query(points[rows])[1])]
            distance[rows] = self._foot(points[rows], first)[2]
            row, owner = self._tree.near_points(
                points[rows], distance[rows] + within + EQUAL_DISTANCE_TOLERANCE_M
            )
            row = rows[row]
            weights, foot, foot_distance = self._foot(points[row], owner)
            np.minimum.at(distance, row, foot_distance)
            use = np.flatnonzero(foot_distance <= distance[row] + within)
            use = use[np.lexsort((foot_distance[use], row[use]))]
            kept.append((row[use], owner[use], weights[use], foot[use], foot_distance[use]))
        if not kept:
            none = np.zeros(0, dtype=np.int64)
            return NearestPoints(points, distance, distance, none, none, np.zeros((0, 3)), np.zeros((0, 3)))
        parts = list(zip(*kept, strict=True))[::-1]  # reversed, so that pop() returns them in order
        kept.clear()  # parts are freed as they are joined: for a long pass they are tens of MB
        row, owner, weights, foot, foot_distance = (np.concatenate(parts.pop()) for _ in range(len(parts)))
        # sign: the side of the sum of the normals of all triangles that are equally near
        first = np.flatnonzero(np.diff(row, prepend=-1) != 0)
        same = foot_distance <= distance[row] + EQUAL_DISTANCE_TOLERANCE_M
        outward = np.zeros((len(points), 3))
        np.add.at(outward, row[same], self.normal[owner[same]])
        offset = points - foot[first]
        signed = np.where(dots(offset, outward) >= 0.0, distance, -distance)
        signed = np.where(self._is_beyond_border(offset, owner[first], weights[first]), offset[:, 2], signed)
        return NearestPoints(foot[first], distance, signed, row, owner, weights, foot)

    def value_range(self, nearest: NearestPoints, at_corners: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the minimum and maximum (N,) of a value over the equally near points of each of N points.

        Within a triangle the value is linear.

        Args:
            nearest: Nearest points of the N points.
            at_corners: Values (F, 3) at the corners of all given triangles.
        """
        values = dots(nearest.weight, at_corners[self.rows[nearest.triangle]])
        low, high = np.full(len(nearest.distance), np.inf), np.full(len(nearest.distance), -np.inf)
        np.minimum.at(low, nearest.row, values)
        np.maximum.at(high, nearest.row, values)
        return low, high

    def line_distance(self, start: FloatArray, end: FloatArray, need: FloatArray) -> FloatArray:
        """Return the distance (K,) [m] of straight lines from the face, as `line_triangle_distance` does.

        It is infinite where it is ``need`` or more.

        Args:
            start: Starts (K, 3) [m].
            end: Ends (K, 3) [m].
            need: Distances (K,) [m] up to which the result is needed.
        """
        out = np.full(len(start), np.inf)
        for rows in np.array_split(np.arange(len(start)), max(1, len(start) // _POINTS_AT_ONCE)):
            if len(rows):
                which, triangle = self._tree.near_lines(start[rows], end[rows], need[rows])
                which = rows[which]
                distance = line_triangle_distance(start[which], end[which], self.corners[triangle])
                np.minimum.at(out, which, distance)
        return np.where(out < need, out, np.inf)

    def near_lines(self, start: FloatArray, end: FloatArray, need: FloatArray) -> tuple[IntArray, IntArray]:
        """Return pairs of straight lines and triangles as :meth:`TriangleTree.near_lines` does.

        Args:
            start: Starts (K, 3) [m].
            end: Ends (K, 3) [m].
            need: Distances (K,) [m] below which pairs are returned.
        """
        return self._tree.near_lines(start, end, need)

    def _foot(self, points: FloatArray, triangle: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the nearest points of triangles (M,) to points (M, 3), one of each pair.

        Returns:
            Barycentric weights (M, 3) of the nearest points, these points (M, 3) [m], and distances (M,) [m].
        """
        weights = closest_weights(points, *np.moveaxis(self.corners[triangle], 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, self.corners[triangle])
        return weights, foot, np.linalg.norm(points - foot, axis=1)

    def _is_beyond_border(self, offset: FloatArray, triangle: IntArray, weight: FloatArray) -> BoolArray:
        """Return which of N points are beyond the face's border.

        ``offset`` (N, 3) [m] are the vectors to them from their nearest points, which have the barycentric
        weights ``weight`` (N, 3) in the triangles ``triangle`` (N,).
        """
        out = np.zeros(len(offset), dtype=np.bool_)
        for k in range(3):  # the point is on the edge from corner k if the opposite corner has no weight
            on_edge = (weight[:, (k + 2) % 3] < 1e-9) & self.border[triangle, k]
            corner = self.corners[triangle]
            edge = corner[:, (k + 1) % 3] - corner[:, k]
            away = np.stack([edge[:, 1], -edge[:, 0]], axis=1)  # right of the edge, for normals up
            out |= on_edge & ((away * offset[:, :2]).sum(axis=1) > 1e-9 * np.linalg.norm(away, axis=1))
        return out


def _border_edges(vertices: FloatArray, faces: IntArray) -> BoolArray:
    """Return which edges (F, 3), each from a corner to the next, belong to only one triangle.

    Vertices at one position count as one.
    """
    _, vertex_index = np.unique(vertices.round(9), axis=0, return_inverse=True)
    same = vertex_index.ravel()[faces]
    low, high = np.minimum(same, np.roll(same, -1, axis=1)), np.maximum(same, np.roll(same, -1, axis=1))
    _, which, count = np.unique(low * len(vertices) + high, return_inverse=True, return_counts=True)
    return np.asarray((count[which.ravel()] == 1).reshape(-1, 3))


def line_triangle_distance(start: FloatArray, end: FloatArray, triangle: FloatArray) -> FloatArray:
    """Return the distances (M,) [m] of straight lines (M, 3) from triangles (M, 3, 3).

    They are the distances from the edges of the triangles, or 0 for lines through them. An end of a line may
    be nearer to the inside of a triangle than to its edges. The result does not include this case, because
    callers check the ends themselves.
    """
    out = np.full(len(start), np.inf)
    for k in range(3):
        a, b = triangle[:, k], triangle[:, (k + 1) % 3]
        out = np.minimum(out, segment_distance(start, end, a, b))
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    start_height, end_height = dots(start - triangle[:, 0], normal), dots(end - triangle[:, 0], normal)
    crossed = np.flatnonzero(start_height * end_height < 0.0)
    if len(crossed):
        crossing = (
            start[crossed]
            + (start_height[crossed] / (start_height - end_height)[crossed])[:, None] * (end - start)[crossed]
        )
        weights = closest_weights(crossing, *np.moveaxis(triangle[crossed], 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, triangle[crossed])
        out[crossed] = np.minimum(out[crossed], np.linalg.norm(crossing - foot, axis=1))
    return out


def segment_distance(p: FloatArray, q: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the distances (M,) [m] between the line segments from p to q and from a to b (M, 3) [m]."""
    # least |w + s u - t v|^2: s = (uv vw - vv uw) / (uu vv - uv^2), then t = (uv s + vw) / vv and
    # s = (uv t - uw) / uu, each clipped to [0, 1] (Ericson, Real-Time Collision Detection, 2005, 5.1.9)
    u, v, w = q - p, b - a, p - a
    uu, uv, vv, uw, vw = dots(u, u), dots(u, v), dots(v, v), dots(u, w), dots(v, w)
    determinant = uu * vv - uv * uv
    s = np.where(determinant > 1e-14 * uu * vv, (uv * vw - vv * uw) / np.maximum(determinant, 1e-300), 0.0)
    s = np.clip(s, 0.0, 1.0)
    t = np.clip((uv * s + vw) / np.maximum(vv, 1e-300), 0.0, 1.0)
    s = np.clip((uv * t - uw) / np.maximum(uu, 1e-300), 0.0, 1.0)
    return lengths(w + s[:, None] * u - t[:, None] * v)


MAX_PENETRATION_M = 2e-6
"""Depth [m] to which a ball may cut in."""
REACHED_TOLERANCE_M = 3e-5
"""A ball reaches what it comes nearer to than this [m]."""
PIECE_SIZE_FRACTION = 0.15
"""Size of the pieces of triangles that a ball does not reach, as a fraction of its radius."""
_MAX_CENTRE_ROUNDS = 24
"""Maximum number of rounds in which the nearest centre of a ball beyond the planes of the face is found."""
_MAX_PLANES = 3
"""Maximum number of planes that hold a centre back at once: three make a corner."""
_MAX_PIECES = 100_000
"""Upper bound on subdivision.

Beyond it the search for what a ball does not reach is coarser, and unresolved areas count as reached.
"""


def min_ball_distance(
    face: ProofFace, points: FloatArray, normals: FloatArray, radius: float, side: int
) -> FloatArray:
    """Return how near (N,) [m] a ball that does not cut into a face can come to points of it, 0 for contact.

    Args:
        face: Face.
        points: Points (N, 3) [m] on it.
        normals: Upward normals (N, 3) at the points.
        radius: Radius [m] of the ball.
        side: +1 if the ball is above the face, -1 below.
    """
    return np.asarray(
        np.maximum(
            np.linalg.norm(nearest_ball_centres(face, points, normals, radius, side) - points, axis=1)
            - radius,
            0.0,
        )
    )


def nearest_ball_centres(
    face: ProofFace, points: FloatArray, normals: FloatArray, radius: float, side: int
) -> FloatArray:
    """Return the centres (N, 3) [m] nearest to ``points`` (N, 3) of balls that do not cut into a face."""
    out = np.empty((len(points), 3))
    for start in range(0, len(points), _POINTS_AT_ONCE):
        chunk = slice(start, start + _POINTS_AT_ONCE)
        out[chunk] = _nearest_ball_centres_chunk(face, points[chunk], normals[chunk], radius, side)
    return out


def _nearest_ball_centres_chunk(
    face: ProofFace, points: FloatArray, normals: FloatArray, radius: float, side: int
) -> FloatArray:
    """Return the result of `nearest_ball_centres` for points that are processed at once.

    In each round the plane at the deepest contact is added for every ball that still cuts in. The ball then
    moves to the nearest position beyond all planes of its point. Of more than `_MAX_PLANES` planes the one
    that holds it back least is dropped.
    """
    centre = points + side * radius * normals
    rows = np.arange(len(points))  # points whose ball still cuts in
    # each plane as its unit normal, and the minimum coordinate of a centre along it
    normal = np.zeros((len(points), 0, 3))
    level = np.zeros((len(points), 0))
    for _ in range(_MAX_CENTRE_ROUNDS):
        nearest = face.nearest(centre[rows])
        ball_distance = side * nearest.signed
        cuts_in = ball_distance < radius - MAX_PENETRATION_M
        rows, contact, ball_distance = rows[cuts_in], nearest.point[cuts_in], ball_distance[cuts_in]
        if not len(rows):
            break
        normal, level = normal[cuts_in], level[cuts_in]
        direction = centre[rows] - contact
        direction *= np.sign(ball_distance)[:, None]
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        up = np.array([0.0, 0.0, float(side)])
        direction = np.where(length > 1e-9, direction / np.maximum(length, 1e-12), up)
        # new plane at the deepest contact x with the normal n: the centre c has to satisfy n.c >= n.x +
        # radius
        normal = np.concatenate([normal, direction[:, None]], axis=1)
        level = np.concatenate([level, (dots(direction, contact) + radius)[:, None]], axis=1)
        centre[rows], hold = _project_beyond_planes(points[rows], normal, level)
        if normal.shape[1] > _MAX_PLANES:  # drop a plane that does not hold the centre back
            use = np.sort(np.argsort(hold, axis=1, kind="stable")[:, 1:], axis=1)
            normal = np.take_along_axis(normal, use[:, :, None], axis=1)
            level = np.take_along_axis(level, use, axis=1)
    return centre


def _project_beyond_planes(
    points: FloatArray, normal: FloatArray, level: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the positions (N, 3) [m] nearest to ``points`` (N, 3) that are beyond K planes each.

    If no position is beyond all planes, the largest violation is minimised instead. Active sets of up to
    three planes are enumerated. For each set, the projection solves (n n^T) push = d - n . p. The feasible
    result with the smallest distance is taken.

    Args:
        points: Points (N, 3) [m].
        normal: Unit normals (N, K, 3) of the planes.
        level: Minimum coordinates (N, K) [m] along the normals.

    Returns:
        Nearest points (N, 3) [m], and the push (N, K) [m] of each plane along its normal.
    """
    count = normal.shape[1]
    best = points.copy()
    hold = np.zeros(level.shape)
    lowest_cost = np.full(len(points), np.inf)
    for size in range(1, min(count, 3) + 1):
        for active in itertools.combinations(range(count), size):
            # c = p + n^T push with n c = d; push >= 0 and no violated plane make it the nearest point
            n, d = normal[:, active], level[:, active]
            square = np.einsum("nik,njk->nij", n, n)
            square = square + 1e-12 * np.eye(size)
            push = np.linalg.solve(square, (d - np.einsum("nik,nk->ni", n, points))[..., None])[..., 0]
            position = points + np.einsum("ni,nik->nk", push, n)
            violation = np.maximum(level - np.einsum("nik,nk->ni", normal, position), 0.0).max(axis=1)
            distance = np.linalg.norm(position - points, axis=1)
            cost = np.where((push >= -1e-12).all(axis=1), distance, np.inf) + 1e3 * np.maximum(
                violation - 1e-9, 0.0
            )
            better = cost < lowest_cost
            lowest_cost = np.where(better, cost, lowest_cost)
            best[better] = position[better]
            hold[better] = 0.0
            for k, column in enumerate(active):
                hold[better, column] = np.maximum(push[better, k], 1e-15)
    return best, hold


def remaining_face(face: ProofFace, radius: float, side: int, start: float) -> ProofFace:
    """Return the face as a ball can form it at best, with fillets where the ball does not reach.

    The result is the face itself if the ball reaches all of it.

    Args:
        face: Required face.
        radius: Radius [m] of the ball.
        side: +1 if the ball is above the face, -1 below.
        start: Level z [m] of the flat, which the ball reaches.
    """
    key = radius, side, start
    if key not in face.remaining_faces:
        remaining = _calculate_remaining_face(face, *key)
        # the face does not refer to itself: faces in such a cycle would outlive the proof
        face.remaining_faces[key] = None if remaining is face else remaining
    return face.remaining_faces[key] or face


def _calculate_remaining_face(face: ProofFace, radius: float, side: int, start: float) -> ProofFace:
    """Calculate the result of :func:`remaining_face`.

    Triangles that the ball does not reach are divided into small pieces, whose corners are moved to the
    surface of the nearest ball. So they become fillets.
    """
    # Triangles that the ball does not reach, found at the middles of their pieces, then at their corners.
    corners = face.corners
    moved = np.flatnonzero((side * corners[:, :, 2]).min(axis=1) < side * start - MAX_PENETRATION_M)
    parts, owner = bisect_triangles(corners[moved], PIECE_SIZE_FRACTION * radius, _MAX_PIECES)
    owner = moved[owner]
    distance = min_ball_distance(face, parts.mean(axis=1), face.normal[owner], radius, side)
    is_unreached = np.zeros(len(corners), dtype=np.bool_)
    is_unreached[owner[distance > REACHED_TOLERANCE_M]] = True
    if not is_unreached.any():
        return face
    _spread_unreached(face, is_unreached, moved, radius, side)
    # Their pieces move to the surface of the nearest ball: by |c - p| - radius toward its centre c.
    parts, owner = _fine_pieces(face, np.flatnonzero(is_unreached), radius, side)
    points = parts.reshape(-1, 3)
    up = np.repeat(face.normal[owner], 3, axis=0)
    to_centre = nearest_ball_centres(face, points, up, radius, side) - points
    centre_distance = np.linalg.norm(to_centre, axis=1, keepdims=True)
    on_ball = points + np.maximum(centre_distance - radius, 0.0) * to_centre / np.maximum(
        centre_distance, 1e-12
    )
    # between distant corners nothing is known, so a piece that is too large stays as required
    longest = np.linalg.norm(parts - np.roll(parts, 1, axis=1), axis=2).max(axis=1)
    small = (longest <= PIECE_SIZE_FRACTION * radius * (1.0 + 1e-9))[:, None, None]
    fillets = np.where(small, on_ball.reshape(-1, 3, 3), parts)
    remaining_corners = np.concatenate([corners[~is_unreached], fillets]).reshape(-1, 3)
    remaining = ProofFace(remaining_corners, np.arange(len(remaining_corners)).reshape(-1, 3), radius)
    # pieces meet without shared corners and have no border of their own
    edge = np.concatenate([face.border[~is_unreached], np.zeros((len(parts), 3), dtype=np.bool_)])
    remaining.border = edge[remaining.rows]
    return remaining


def _fine_pieces(face: ProofFace, rows: IntArray, radius: float, side: int) -> tuple[FloatArray, IntArray]:
    """Split triangles ``rows`` (K,) of a face into pieces (P, 3, 3), small where a ball does not reach.

    A long piece counts as reached, and is not split, if its corners and its middle are reached. The second
    result is the triangle (P,) of each piece.
    """
    size, count = PIECE_SIZE_FRACTION * radius, 0
    pending, owner = face.corners[rows], rows
    done: list[FloatArray] = []
    owners: list[IntArray] = []
    while len(pending):
        is_long = np.linalg.norm(pending - np.roll(pending, 1, axis=1), axis=2).max(axis=1) > size
        is_long &= count + 2 * len(pending) <= _MAX_PIECES
        split = np.flatnonzero(is_long)
        samples = np.concatenate([pending[split], pending[split].mean(axis=1, keepdims=True)], axis=1)
        up = np.repeat(face.normal[owner[split]], 4, axis=0)
        distance = min_ball_distance(face, samples.reshape(-1, 3), up, radius, side).reshape(-1, 4)
        split = split[(distance > REACHED_TOLERANCE_M).any(axis=1)]
        kept = np.setdiff1d(np.arange(len(pending)), split)
        done.append(pending[kept])
        owners.append(owner[kept])
        count += len(kept)
        if not len(split):
            break
        pending, half = bisect_triangles(pending[split], size, 2 * len(split))
        owner = owner[split[half]]
    return np.concatenate(done), np.concatenate(owners)


def _spread_unreached(
    face: ProofFace, is_unreached: BoolArray, moved: IntArray, radius: float, side: int
) -> None:
    """Add neighbours to the triangles that a ball does not reach: ``is_unreached`` (F,) is changed in place.

    A triangle of ``moved`` (M,) is added if it shares a corner that the ball does not reach with one of them,
    and so on until there are no more. This is needed because a long triangle is checked only at the middles
    of its pieces, where an unreached far corner is missed.
    """
    while True:
        rows = moved[~is_unreached[moved]]
        corner, up = face.corners[rows].reshape(-1, 3), np.repeat(face.normal[rows], 3, axis=0)
        unreached_corners = cKDTree(face.corners[is_unreached].reshape(-1, 3))
        shared = np.flatnonzero(
            np.isfinite(unreached_corners.query(corner, distance_upper_bound=MAX_PENETRATION_M)[0])
        )
        newly_unreached = shared[
            min_ball_distance(face, corner[shared], up[shared], radius, side) > REACHED_TOLERANCE_M
        ]
        if not len(newly_unreached):
            return
        is_unreached[rows[newly_unreached // 3]] = True
