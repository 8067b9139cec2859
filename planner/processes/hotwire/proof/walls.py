"""Nominal surfaces of a part as triangulated walls, and how deep the slot of a wire cuts into them.

The module finds the distance of points to the nearest wall, and on which side they are. A slot may remove
material from surfaces other than the one next to which it cuts. To find the deepest point of a straight slot
in another surface, the surface is divided until its pieces are small, or so far from the wires that no point
of them can be in the slot. The order of the cuts does not matter.
"""

import dataclasses
import functools
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.processes.hotwire.claims import CutsSurface, KerfCurve
from planner.processes.hotwire.proof.cut_surface import (
    MAX_SAMPLE_EDGE_M,
    WireSweep,
    closest_on_triangle,
    sample_face,
)

MAX_WALL_EDGE_M = 0.004
"""Longest edge [m] of the triangles that walls are divided into, within ``MAX_WALL_TRIANGLES``."""
MAX_WALL_TRIANGLES = 40_000
"""Maximum number of triangles of a wall."""
_PAIR_BATCH_SIZE = 400_000
"""Number of pairs of a point and a triangle that are processed in one batch."""
_MIN_TRIANGLE_SIZE_M = 1e-7
"""Tolerance [m] of searches, and the size that smaller triangles count as."""
_MEETING_TOLERANCE_M = 1e-9
"""Triangles meet in points that are no farther apart than this [m]."""


@dataclasses.dataclass(frozen=True)
class SurfaceWalls:
    """Triangles of nominal surfaces.

    Attributes:
        corners: Corners (F, 3, 3) [m].
        normal: Unit normals away from the part (F, 3).
        owner: Index of the surface of each triangle (F,).
        border: Whether the edge from each corner to the next one belongs to no other triangle (F, 3).
    """

    corners: FloatArray
    normal: FloatArray
    owner: IntArray
    border: BoolArray

    def signed_distance(self, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return signed distances (N,) [m] of points (N, 3) to the nearest wall, and its surface (N,).

        Distances are negative on the part's side. They are NaN where the nearest point is on the border of a
        surface, because the sides beyond its end are unknown.
        """
        # upper bound: distance to the triangle with the nearest centroid, in groups of similar size
        best = np.full(len(points), np.inf)
        for group, tree, _ in self._size_groups:
            best = np.minimum(
                best, _triangle_distance(points, self.corners[group[tree.query(points, k=1)[1]]])
            )
        # the nearest triangle need not have the nearest centroid
        found_lists = [tree.query_ball_point(points, best + reach) for _, tree, reach in self._size_groups]
        lists = [
            [group[np.asarray(indices, dtype=np.int64)] for indices in rows]
            for (group, _, _), rows in zip(self._size_groups, found_lists, strict=True)
        ]
        candidates = [np.concatenate(indices) for indices in zip(*lists, strict=True)]
        distance, owner = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
        counts = np.array([len(indices) for indices in candidates], dtype=np.int64)
        parts = np.cumsum(counts) // _PAIR_BATCH_SIZE
        for number in np.unique(parts):
            rows = np.flatnonzero(parts == number)
            row = np.repeat(np.arange(len(rows)), counts[rows])
            tri = np.concatenate([candidates[k] for k in rows])
            close_pairs = self._close_pairs(points[rows], best[rows], row, tri)
            distance[rows], owner[rows] = self._nearest_of_pairs(
                points[rows], row[close_pairs], tri[close_pairs]
            )
        return distance, owner

    def _close_pairs(self, points: FloatArray, reach: FloatArray, row: IntArray, tri: IntArray) -> IntArray:
        """Return the indices of pairs whose point may be within its ``reach`` (N,) [m] of the triangle's box.

        Exact distances are only computed for these. Pairs consist of an index ``row`` (K,) of points (N, 3)
        and an index ``tri`` (K,) of triangles.
        """
        squared_distance = np.zeros(len(row))
        for at, low, high in zip(points.T, *self._boxes, strict=True):
            coordinate = at[row]
            gap = np.maximum(low[tri] - coordinate, coordinate - high[tri])
            squared_distance += np.maximum(gap, 0.0, out=gap) ** 2
        return np.flatnonzero(squared_distance <= ((reach + 2.0 * _MIN_TRIANGLE_SIZE_M) ** 2)[row])

    @functools.cached_property
    def _boxes(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper coordinates (3, F) [m] of each triangle."""
        low, high = self.corners.min(axis=1), self.corners.max(axis=1)
        return np.ascontiguousarray(low.T), np.ascontiguousarray(high.T)

    @functools.cached_property
    def _size_groups(self) -> list[tuple[IntArray, cKDTree, float]]:
        """Triangles grouped by size: their indices, a tree of their centroids, and their largest radius [m].

        The radius is the distance of a corner from its centroid.
        """
        middle = self.corners.mean(axis=1)
        radius = np.linalg.norm(self.corners - middle[:, None], axis=2).max(axis=1)
        # each group spans a factor of 4 in radius
        size = np.ceil(np.log2(np.maximum(radius, _MIN_TRIANGLE_SIZE_M)) / 2.0).astype(np.int64)
        groups = [np.flatnonzero(size == size_class) for size_class in np.unique(size)]
        return [
            (group, cKDTree(middle[group]), float(radius[group].max()) + _MIN_TRIANGLE_SIZE_M)
            for group in groups
        ]

    def _nearest_of_pairs(
        self, points: FloatArray, row: IntArray, tri: IntArray
    ) -> tuple[FloatArray, IntArray]:
        """Return the result of :meth:`signed_distance` from candidate pairs of points and triangles.

        Indices ``row`` (K,) of points (N, 3) ascend and include each point. ``tri`` (K,) are the triangles.
        """
        points_on_wall, barycentric = closest_on_triangle(points[row], *np.moveaxis(self.corners[tri], 1, 0))
        vector = points[row] - points_on_wall
        distance = np.linalg.norm(vector, axis=1)
        best = np.minimum.reduceat(distance, np.searchsorted(row, np.arange(len(points))))
        is_nearest = distance <= best[row] + _MIN_TRIANGLE_SIZE_M
        row, tri, points_on_wall, barycentric, vector, distance = (
            array[is_nearest] for array in (row, tri, points_on_wall, barycentric, vector, distance)
        )
        starts = np.searchsorted(row, np.arange(len(points)))
        # a point is on an edge if the opposite corner has no weight; at a corner of the border also triangles
        # without an edge on it meet, so all that are equally near count
        # (edge k, from corner k to k + 1, is opposite corner k + 2, hence the shift by 2)
        edge = (np.roll(barycentric < 1e-9, -2, axis=1) & self.border[tri]).any(axis=1)
        order = np.lexsort((tri, distance, row))[starts]
        # at an edge as sharp as a wing's almost equally near points are on both sides: the same point counts
        is_same_point = (
            np.linalg.norm(points_on_wall - points_on_wall[order][row], axis=1) <= _MEETING_TOLERANCE_M
        )
        weight = np.where(is_same_point, self._pseudonormal_angle(barycentric, tri), 0.0)
        normal = np.add.reduceat(weight[:, None] * self.normal[tri], starts)
        outward = dots(vector[order], normal) >= 0.0
        signed = np.where(outward, best, -best)
        return np.where(np.logical_or.reduceat(edge, starts), np.nan, signed), self.owner[tri[order]]

    def _pseudonormal_angle(self, barycentric: FloatArray, tri: IntArray) -> FloatArray:
        """Return the angle (K,) [rad] that triangles cover around points with barycentric weights (K, 3).

        It is 2 pi inside a triangle, pi on an edge, and the corner's angle at a corner.
        The sum of normals weighted by this angle separates the sides of edges and corners, however sharp.

        Source: Baerentzen and Aanaes, Signed distance computation using the angle weighted pseudonormal
        (2005).
        """
        is_off_corner = barycentric < 1e-9
        at = np.argmax(barycentric, axis=1)
        corner, next_corner, last_corner = (self.corners[tri, (at + k) % 3] for k in range(3))
        a, b = next_corner - corner, last_corner - corner
        cosine = dots(a, b) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-30)
        tip = np.arccos(np.clip(cosine, -1.0, 1.0))
        return np.asarray(np.choose(np.minimum(is_off_corner.sum(axis=1), 2), [2.0 * np.pi, np.pi, tip]))


def _triangle_distance(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the distance (N,) [m] of each point (N, 3) to its triangle (N, 3, 3)."""
    closest_point, _ = closest_on_triangle(points, *np.moveaxis(corners, 1, 0))
    return np.asarray(np.linalg.norm(points - closest_point, axis=1))


def make_walls(claims: tuple[CutsSurface, ...]) -> SurfaceWalls:
    """Return the nominal surfaces as triangles that are small enough to be searched by their centroids."""
    corners, border, owner = [], [], []
    for number, claim in enumerate(claims):
        triangles = claim.vertices[claim.faces]
        size = np.linalg.norm(
            np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
        )
        triangles, free = _subdivide(triangles[size > 0.0], _border_edges(claim)[size > 0.0])
        corners.append(triangles)
        border.append(free)
        owner.append(np.full(len(triangles), number))
    all_corners = np.concatenate(corners)
    normal = np.cross(all_corners[:, 1] - all_corners[:, 0], all_corners[:, 2] - all_corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    return SurfaceWalls(all_corners, normal, np.concatenate(owner), np.concatenate(border))


def _border_edges(claim: CutsSurface) -> BoolArray:
    """Return whether the edge from each corner to the next one (F, 3) belongs to one triangle only.

    Vertices at the same position count as one.
    """
    _, merged = np.unique(claim.vertices.round(8), axis=0, return_inverse=True)
    faces = merged.ravel()[claim.faces]
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, which, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    return np.asarray((count[which.ravel()] == 1).reshape(-1, 3))


def _subdivide(corners: FloatArray, border: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Halve triangles (F, 3, 3) across their longest edges until no edge is longer than `MAX_WALL_EDGE_M`.

    The division ends early at `MAX_WALL_TRIANGLES`.

    Returns:
        The triangles with their border edges (F, 3), as `SurfaceWalls` has them.
    """
    for _ in range(40):
        edge = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        is_long = edge.max(axis=1) > MAX_WALL_EDGE_M
        if not is_long.any() or len(corners) + int(is_long.sum()) > MAX_WALL_TRIANGLES:
            break
        corner_order = (np.argmax(edge[is_long], axis=1)[:, None] + np.arange(3)) % 3
        row = np.arange(len(corner_order))[:, None]
        a, b, c = np.moveaxis(corners[is_long][row, corner_order], 1, 0)
        is_border = border[is_long][row, corner_order]
        middle = 0.5 * (a + b)
        not_border = np.zeros(len(a), dtype=np.bool_)
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        corners = np.concatenate([corners[~is_long], *halves])
        border_of_halves = (
            np.stack([is_border[:, 0], not_border, is_border[:, 2]], axis=1),
            np.stack([is_border[:, 0], is_border[:, 1], not_border], axis=1),
        )
        border = np.concatenate([border[~is_long], *border_of_halves])
    return corners, border


SMALL_PIECE_M: Final = 5e-4
"""Pieces of a surface with corners within this distance [m] of their centroid are not divided further."""
PIECE_BATCH_SIZE: Final = 20_000
"""Number of pieces that are processed in one batch."""
WIRE_POINT_SPACING_M: Final = 0.003
"""Largest spacing along the wire [m] of the points by which nearby wires are found."""
MIN_BENEATH_COSINE: Final = 0.7
"""Minimum cosine between a surface's normal and the direction from a wire for a surface above the wire.

Other wires are beside the rim of the surface.
"""
MIN_CROSSING_DEPTH_M: Final = 1e-5
"""A surface crosses another if it is on both sides of it by more than this [m]."""
MEETING_ROUNDING_M: Final = 1e-7
"""Tolerance for rounding errors [m] where surfaces meet."""
CROSSING_SAMPLES: Final = 600
"""Number of points of a surface that decide whether it crosses another."""
_POINT_BATCH_SIZE: Final = 500
"""Number of points that are compared with wires in one batch."""


@dataclasses.dataclass(frozen=True)
class SlotOverlap:
    """Deepest point at which the slot of one cut removes material of another surface.

    Attributes:
        depth: Largest depth [m].
        point: Point of the largest depth (3,) [m].
        row: Index of the wire's station in its sweep.
        half: Half the slot there [m].
    """

    depth: float
    point: FloatArray
    row: int
    half: float


class PartWalls:
    """Nominal surfaces of a part, each as a separate wall, and which of them cross.

    Results are computed once, on demand.

    Args:
        claims: Claims on the surfaces.
        block: Lower and upper corner of the block (2, 3) [m].
    """

    def __init__(self, claims: tuple[CutsSurface, ...], block: FloatArray) -> None:
        self.claims, self.block = claims, block
        self._walls: dict[int, tuple[CutsSurface, SurfaceWalls]] = {}
        self._crossed: dict[int, tuple[CutsSurface, tuple[CutsSurface, ...]]] = {}

    def wall(self, claim: CutsSurface) -> SurfaceWalls:
        """Return the wall of a surface, one of ``claims`` or any other."""
        if id(claim) not in self._walls:  # stored with its claim, so that its id is not reused
            self._walls[id(claim)] = (claim, make_walls((claim,)))
        return self._walls[id(claim)][1]

    def crossing_surfaces(self, claim: CutsSurface) -> tuple[CutsSurface, ...]:
        """Return those of ``claims`` whose surface has points of the given surface on both sides."""
        if id(claim) not in self._crossed:
            others = (other for other in self.claims if other is not claim)
            crossing = tuple(other for other in others if crosses(claim, self.wall(other), self.block))
            self._crossed[id(claim)] = (claim, crossing)
        return self._crossed[id(claim)][1]


def straight_slot_overlap(
    claim: CutsSurface, sweep: WireSweep, other: CutsSurface, part: PartWalls
) -> SlotOverlap | None:
    """Return where the slot of a straight wire cuts most deeply into another surface, or None if nowhere.

    The other surface is divided into ever smaller triangles until each is too deep at its centroid, small, or
    out of the slot's reach. Only points inside the block with depths beyond that surface's tolerance count.
    Where the surface continues outside another one that it crosses, it does not bound the part and may be
    cut.

    Args:
        claim: Claim on the cut.
        sweep: Sweep of the wire.
        other: Claim on the other surface.
        part: Walls of the part.
    """
    block = part.block
    sheet = _StraightSheet(sweep, claim.kerf, block)
    corners = other.vertices[other.faces]
    corners = corners[np.linalg.norm(_triangle_cross(corners), axis=1) > 0.0]
    wall = part.wall(claim)
    too_deep: list[tuple[FloatArray, FloatArray, FloatArray, IntArray]] = []
    pending = [corners]
    while pending:
        corners = pending.pop()
        if len(corners) > PIECE_BATCH_SIZE:
            pending.append(corners[PIECE_BATCH_SIZE:])
            corners = corners[:PIECE_BATCH_SIZE]
        middle = corners.mean(axis=1)
        size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        is_candidate = sheet.may_reach(middle, size)
        corners, middle, size = corners[is_candidate], middle[is_candidate], size[is_candidate]
        if not len(corners):
            continue
        distance, foot, half, row = sheet.nearest(middle)
        normal = _triangle_cross(corners)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normal_distance = dots(foot - middle, normal)
        inside = ((middle > block[0]) & (middle < block[1])).all(axis=1)
        # At points outside the cut's own surface, a wire beneath the other surface has removed all foam above
        # it: the depth is half the slot plus the distance beneath. Elsewhere a slot removes what it reaches.
        is_beyond = (
            inside
            & (normal_distance <= -MIN_BENEATH_COSINE * distance)
            & (distance < half + MIN_CROSSING_DEPTH_M)
        )
        is_beyond[is_beyond] = wall.signed_distance(middle[is_beyond])[0] > -MEETING_ROUNDING_M
        depth = half - np.where(is_beyond, normal_distance, distance)
        is_too_deep = inside & (depth > other.tolerance)
        if is_too_deep.any():
            too_deep.append((depth[is_too_deep], middle[is_too_deep], half[is_too_deep], row[is_too_deep]))
        needs_division = ~is_too_deep & (size > SMALL_PIECE_M) & (distance - size < half - other.tolerance)
        if needs_division.any():
            pending.append(_quarter(corners[needs_division]))
    if not too_deep:
        return None
    depth, points, half, row = (np.concatenate([batch[k] for batch in too_deep]) for k in range(4))
    bounds_part = _bounds_the_part(points, other, part)
    if not bounds_part.any():
        return None
    k = int(np.argmax(np.where(bounds_part, depth, -np.inf)))
    return SlotOverlap(float(depth[k]), points[k], int(row[k]), float(half[k]))


def bent_slot_overlap(
    claim: CutsSurface, sweep: WireSweep, other: CutsSurface, part: PartWalls
) -> SlotOverlap | None:
    """Return where the slot of a bent wire cuts most deeply into another surface, or None if nowhere.

    It finds points of the wire that come closer to the other surface than half their slot, or pass through it
    between stations. Points on the outer side of the surface that the wire cuts do not count: their slot only
    reaches foam outside the part, or next to that surface. Points beyond its rim or on the part's side count.

    Args:
        claim: Claim on the cut.
        sweep: Sweep of the wire.
        other: Claim on the other surface.
        part: Walls of the part.
    """
    block = part.block
    points, half = sweep.points, 0.5 * claim.kerf.at(sweep.speed)
    flat = points.reshape(-1, 3)
    inside = ((flat > block[0]) & (flat < block[1])).all(axis=1).reshape(half.shape)
    step = np.linalg.norm(np.diff(points, axis=0), axis=2)
    joined = sweep.joined[:, None] & inside[1:] & inside[:-1]
    samples, _, area = sample_face(other.vertices, other.faces)
    sample_distance = 2.0 * max(MAX_SAMPLE_EDGE_M, float(np.sqrt(area.max())))
    max_distance = (
        float(half.max(initial=0.0)) + float(np.where(joined, step, 0.0).max(initial=0.0)) + sample_distance
    )
    distance, _ = cKDTree(samples).query(flat, distance_upper_bound=max_distance)
    candidates = np.flatnonzero(np.isfinite(distance) & inside.reshape(-1))
    signed, own_distance = np.full((2, len(flat)), np.nan)
    if not len(candidates):
        return None
    signed[candidates] = part.wall(other).signed_distance(flat[candidates])[0]
    signed = signed.reshape(half.shape)
    changes_side = joined & (signed[1:] * signed[:-1] < 0.0)  # NaN does not count as a crossing
    passes_through = np.zeros(half.shape, dtype=np.bool_)
    passes_through[1:] |= changes_side
    passes_through[:-1] |= changes_side
    # a wire that passes through the surface removes half its slot at least there
    depth = np.where(passes_through, half, half - np.abs(signed))
    is_too_deep = depth > other.tolerance
    too_deep = np.flatnonzero(is_too_deep)
    if not len(too_deep):
        return None
    own_distance[too_deep] = part.wall(claim).signed_distance(flat[too_deep])[0]
    depth = np.where(is_too_deep & ~(own_distance.reshape(half.shape) > 0.0), depth, -np.inf)
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    if not np.isfinite(depth[row, column]):
        return None
    return SlotOverlap(float(depth[row, column]), points[row, column], int(row), float(half[row, column]))


class _StraightSheet:
    """The sheet that a straight wire sweeps, as lines at stations and straight moves between them."""

    def __init__(self, sweep: WireSweep, kerf: KerfCurve, block: FloatArray) -> None:
        self.start, self.end = sweep.points[:, 0], sweep.points[:, -1]
        self.half = 0.5 * kerf.at(sweep.speed)
        self.joined = sweep.joined
        self.length = np.linalg.norm(self.end - self.start, axis=1)
        self.direction = (self.end - self.start) / self.length[:, None]
        self.max_half = float(self.half.max(initial=0.0))
        count = max(int(np.ceil(float(self.length.max(initial=0.0)) / WIRE_POINT_SPACING_M)), 1)
        fraction = np.linspace(0.0, 1.0, count + 1)[None, :, None]
        points = self.start[:, None] + fraction * (self.end - self.start)[:, None]
        low, high = block[0] - self.max_half, block[1] + self.max_half
        row, column = np.nonzero(((points > low) & (points < high)).all(axis=2))
        self.points, self.row = points[row, column], row
        step = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1, initial=0.0)
        self.gap = 0.5 * float(
            np.hypot(WIRE_POINT_SPACING_M, np.where(self.joined, step, 0.0).max(initial=0.0))
        )
        self.tree = cKDTree(self.points) if len(self.points) else None

    def may_reach(self, points: FloatArray, size: FloatArray) -> BoolArray:
        """Return whether the slot might reach something within ``size`` (N,) [m] of each point (N, 3).

        It is a quick bound from points along the wires. ``gap`` is the largest distance of any point of the
        sheet from these.
        """
        if self.tree is None:
            return np.zeros(len(points), dtype=np.bool_)
        reach = size + self.max_half + self.gap
        distance, _ = self.tree.query(points, distance_upper_bound=1.001 * float(reach.max(initial=0.0)))
        return np.asarray(distance <= reach)  # the distance is infinite beyond the upper bound

    def nearest(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Return the nearest point of the sheet for each point (N, 3) that may be near it.

        Returns:
            Distance (N,) [m], infinite if nothing is near; nearest point (N, 3) [m]; half the slot there (N,)
            [m]; and index of the station from which the nearest move starts (N,).
        """
        distance, half = np.full(len(points), np.inf), np.zeros(len(points))
        foot, row = np.zeros((len(points), 3)), np.zeros(len(points), dtype=np.int64)
        if self.tree is None:
            return distance, foot, half, row
        # batches of points with neighbouring stations, so that few moves have to be compared
        order = np.argsort(self.row[self.tree.query(points)[1]], kind="stable")
        for first in range(0, len(points), _POINT_BATCH_SIZE):
            batch = order[first : first + _POINT_BATCH_SIZE]
            low, high = points[batch].min(axis=0), points[batch].max(axis=0)
            reach = self.max_half + 4.0 * self.gap
            is_close = ((self.points > low - reach) & (self.points < high + reach)).all(axis=1)
            stations = np.unique(self.row[is_close])
            stations = np.unique(np.concatenate([stations - 1, stations]))
            stations = stations[(stations >= 0) & (stations < len(self.start) - 1)]
            stations = stations[self.joined[stations]]
            if len(stations):
                nearest = self._nearest_on_moves(points[batch], stations)
                distance[batch], foot[batch], half[batch], row[batch] = nearest
        return distance, foot, half, row

    def _nearest_on_moves(
        self, points: FloatArray, stations: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Return the result of :meth:`nearest` for the moves from each of ``stations`` (T,) to the next."""
        (a, first), (b, last) = (self._nearest_on_lines(points, stations + k) for k in (0, 1))
        move = b - a
        fraction = dots(points[:, None] - a, move) / np.maximum(dots(move, move), 1e-30)
        fraction = np.clip(fraction, 0.0, 1.0)
        points_on_moves = a + fraction[..., None] * move
        distance = np.linalg.norm(points[:, None] - points_on_moves, axis=2)
        row = np.arange(len(points))
        k = np.argmin(distance, axis=1)
        nearest_fraction = fraction[row, k]
        half = (1.0 - nearest_fraction) * first[row, k] + nearest_fraction * last[row, k]
        return distance[row, k], points_on_moves[row, k], half, stations[k]

    def _nearest_on_lines(self, points: FloatArray, stations: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the points (N, T, 3) of wires nearest to points (N, 3), and half their slots (N, T)."""
        start, directions, length = self.start[stations], self.direction[stations], self.length[stations]
        along = points @ directions.T - dots(start, directions)
        along = np.clip(along, 0.0, length)
        position = along / length * (self.half.shape[1] - 1)
        left = np.minimum(position.astype(np.int64), self.half.shape[1] - 2)
        left_half = self.half[stations[None], left]
        half = left_half + (position - left) * (self.half[stations[None], left + 1] - left_half)
        return start + along[..., None] * directions, half


def _bounds_the_part(points: FloatArray, surface: CutsSurface, part: PartWalls) -> BoolArray:
    """Return whether each point (N, 3) of a surface belongs to the boundary of the part.

    A point does not if it is outside another surface that crosses this one in the block.
    """
    bounds_part = np.ones(len(points), dtype=np.bool_)
    for other in part.crossing_surfaces(surface):
        remaining = np.flatnonzero(bounds_part)
        bounds_part[remaining] &= ~(
            part.wall(other).signed_distance(points[remaining])[0] > -MEETING_ROUNDING_M
        )
    return bounds_part


def crosses(surface: CutsSurface, wall: SurfaceWalls, block: FloatArray) -> bool:
    """Return whether a surface is on both sides of a wall in the block (2, 3)."""
    # sample all of each facet: facets of a ruled surface have all corners in faces of the block, and a
    # surface may extend only slightly beyond another
    barycentric = np.array([(i, j, 10 - i - j) for i in range(11) for j in range(11 - i)]) / 10.0
    barycentric = 0.97 * barycentric + 0.01
    points = np.einsum("wk,fkd->fwd", barycentric, surface.vertices[surface.faces]).reshape(-1, 3)
    points = points[((points > block[0]) & (points < block[1])).all(axis=1)]
    points = np.random.default_rng(0).permutation(points)[: 2 * CROSSING_SAMPLES]
    above = below = False
    for batch in np.split(points, [CROSSING_SAMPLES // 10, CROSSING_SAMPLES // 2]):  # few often suffice
        distance, _ = wall.signed_distance(batch)
        above |= bool((distance > MIN_CROSSING_DEPTH_M).any())
        below |= bool((distance < -MIN_CROSSING_DEPTH_M).any())
        if above and below:
            return True
    return False


def _triangle_cross(corners: FloatArray) -> FloatArray:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _quarter(corners: FloatArray) -> FloatArray:
    """Halve triangles (F, 3, 3) across their longest edges, twice."""
    for _ in range(2):
        edge = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        corner_order = (np.argmax(edge, axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(corners[np.arange(len(corners))[:, None], corner_order], 1, 0)
        middle = 0.5 * (a + b)
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        corners = np.concatenate(halves)
    return corners
