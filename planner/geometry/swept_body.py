"""Distances of points from a body of revolution along its path: the least over all of its poses.

A pose is a tip and an axis. Bounds over groups of poses, and over cells of points, exclude where the least
distance cannot be. All other pairs are evaluated, so that nothing is missed.

The bound of a group, for a point p: poses k have pivots q_k and axes a_k, which are near m + t h and u + t g
for some t from -1 to 1, by d and e at most. u is of unit length. Seen along u, the axis at the depth b = (p -
m) u slides along a segment, and p is beside it by at least r. If p is in sight of the body at k, at most w
beside the axis and at most l along it, the depth of p there is b to within f = |(q_k - m) u| + w c + l c c /
2, with c = |a_k - u|, and p is beside that axis by at least r - f |g| - d - l e.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, column_dots, dots
from planner.geometry.mesh import bisect_triangles

GROUP_POSES: Final = 4
"""Number of poses in a group of the lowest level."""
GROUPS_JOINED: Final = 2
"""Number of groups of one level in a group of the next one."""
MAX_TOP_GROUPS: Final = 12
"""Maximum number of groups of the highest level."""


@dataclasses.dataclass(frozen=True)
class RoundBody:
    """A convex body of revolution.

    Attributes:
        start: Start along its axis [m].
        end: End along its axis [m].
        max_radius: Largest radius [m].
        distance: Signed distance [m] of points at a depth from the origin along the axis and a distance
            beside it [m], in the shape of both arguments. It changes by no more than its arguments do, and
            does not fall with the distance beside the axis.
        is_cylinder: Whether the body is a cylinder with sharp edges.
    """

    start: float
    end: float
    max_radius: float
    distance: Callable[[FloatArray, FloatArray], FloatArray]
    is_cylinder: bool = False

    @property
    def middle(self) -> float:
        """Position of the pivot along the axis [m]."""
        return 0.5 * (self.start + self.end)

    @property
    def half_length(self) -> float:
        """Half the length [m]."""
        return 0.5 * (self.end - self.start)

    def lower_bound(self, depth: FloatArray, radial: FloatArray, depth_uncertainty: FloatArray) -> FloatArray:
        """Return a lower bound of the distances of points: that of the cylinder around the body.

        Args:
            depth: Depth of the points from the pivot along the axis [m].
            radial: Minimum distance of the points beside the axis [m].
            depth_uncertainty: Uncertainty of the depth [m].
        """
        ends = np.maximum(np.abs(depth) - depth_uncertainty, 0.0) - self.half_length
        aside = radial - self.max_radius
        out = np.maximum(ends, aside)
        edge = np.nonzero((ends > 0.0) & (aside > 0.0))
        out[edge] = np.hypot(ends[edge], aside[edge])
        return np.asarray(out)


@dataclasses.dataclass(frozen=True, eq=False)
class SweptBody:
    """A body of revolution at all poses of its path.

    Attributes:
        tip: Tips of the body's poses (N, 3) [m].
        axis: Its axes (N, 3), of unit length.
        body: The body.
    """

    tip: FloatArray
    axis: FloatArray
    body: RoundBody

    def part(self, rows: slice) -> "SweptBody":
        """Return the body at some of the poses."""
        return SweptBody(self.tip[rows], self.axis[rows], self.body)


@dataclasses.dataclass(frozen=True)
class GroupLevel:
    """G groups of consecutive poses.

    Attributes:
        size: Number of poses in a group.
        rows: Numbers of each group (14, G): m, u, the part of h normal to u, g, f, and the loss
            d + l e + f |g| of the distance beside the axis, with the module docstring's symbols.
    """

    size: int
    rows: FloatArray

    @property
    def count(self) -> int:
        """Number of groups."""
        return len(self.rows[0])

    def bound(self, points: FloatArray, group: IntArray, body: RoundBody) -> tuple[FloatArray, FloatArray]:
        """Return lower bounds (M,) [m] of distances from the body at all poses of groups.

        The bounds apply where the points are in sight of the body.

        Args:
            points: Points (3, M) [m].
            group: Group of each point (M,).
            body: The body.

        Returns:
            The bounds, and the position (M,) from -1 to 1 in the group at which the body is about nearest.
        """
        g = self.rows.take(group, axis=1)
        offset = points - g[:3]
        depth = column_dots(offset, g[3:6])
        segment = depth * g[9:12]
        segment += g[6:9]
        projection, square = column_dots(offset, segment), column_dots(segment, segment)
        position = projection / np.maximum(square, 1e-300)
        np.clip(position, -1.0, 1.0, out=position)
        # squared remainder beside the segment: |rest - fraction * segment|^2
        square *= position
        square -= 2.0 * projection
        square *= position
        square += column_dots(offset, offset)
        square -= depth * depth
        radial = np.sqrt(np.maximum(square, 0.0))
        radial -= g[13]
        low = body.lower_bound(depth, radial, g[12])
        if not body.is_cylinder:
            body_bound = body.distance(depth + body.middle, np.maximum(radial, 0.0)) - g[12]
            np.maximum(low, body_bound, out=low)
        return low, position


def group_levels(swept: SweptBody, sight: float) -> list[GroupLevel]:
    """Return groups of ``GROUP_POSES`` poses, of ``GROUPS_JOINED`` times as many and so on.

    Args:
        swept: The body along its path.
        sight: Distance within which points are in sight of the body [m].
    """
    tip, axis, body = swept.tip, swept.axis, swept.body
    pivot = tip + body.middle * axis
    radial_reach, axial_reach = body.max_radius + sight, body.half_length + sight
    out: list[GroupLevel] = []
    size = GROUP_POSES
    while not out or out[-1].count > MAX_TOP_GROUPS:
        count = -(-len(tip) // size)
        rows = np.minimum(np.arange(count * size).reshape(count, size), len(tip) - 1)
        mean = axis[rows[:, 0]] + axis[rows[:, -1]]
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        unit = np.where(length > 1e-3, mean / np.maximum(length, 1e-3), axis[rows[:, 0]])
        middle = 0.5 * (pivot[rows[:, 0]] + pivot[rows[:, -1]])
        half, tilt = (0.5 * (vectors[rows[:, -1]] - vectors[rows[:, 0]]) for vectors in (pivot, axis))
        tilt -= dots(tilt, unit)[:, None] * unit
        pivot_offsets, axis_offsets = pivot[rows] - middle[:, None], axis[rows] - unit[:, None]
        chord = np.sqrt(dots(axis_offsets, axis_offsets).max(axis=1))
        depth = np.abs(np.einsum("gkd,gd->gk", pivot_offsets, unit)).max(axis=1)
        depth += radial_reach * chord + 0.5 * axial_reach * chord * chord
        position = np.einsum("gkd,gd->gk", pivot_offsets, half) + axial_reach**2 * np.einsum(
            "gkd,gd->gk", axis_offsets, tilt
        )
        position /= np.maximum(dots(half, half) + axial_reach**2 * dots(tilt, tilt), 1e-300)[:, None]
        np.clip(position, -1.0, 1.0, out=position)
        pivot_offsets -= position[..., None] * half[:, None]
        axis_offsets -= position[..., None] * tilt[:, None]
        loss = np.sqrt(dots(pivot_offsets, pivot_offsets).max(axis=1))
        loss += axial_reach * np.sqrt(dots(axis_offsets, axis_offsets).max(axis=1))
        loss += depth * np.linalg.norm(tilt, axis=1)
        half -= dots(half, unit)[:, None] * unit
        out.append(GroupLevel(size, np.vstack([middle.T, unit.T, half.T, tilt.T, depth, loss])))
        size *= GROUPS_JOINED
    return out


POSES_AT_ONCE: Final = 1 << 19
"""Number of poses that are searched at once."""
POINTS_PER_CELL: Final = 24
"""Approximate number of points of a cell."""
SPLIT_POSES: Final = 8
"""Maximum size of groups of poses at which cells are split into their points."""
PAIRS_AT_ONCE: Final = 20_000
"""Number of pairs of a point and a group that are evaluated at once."""
COARSE_PIECE_M: Final = 4e-3
"""Size of coarse pieces of a face [m]. Those far from a body's path are left out."""
PIECES_AT_ONCE: Final = 20_000
"""Number of pieces that are divided at once."""
SAMPLED_TRIANGLES: Final = 200
"""Number of triangles from which the number of fine pieces is estimated."""
CLOSER_FRACTION: Final = 0.25
"""Fine size per coarse size below which coarse pieces are first tested against the body itself."""
COUNT_FRACTION: Final = 0.25
"""Fraction of the maximum number of pieces beyond which pieces are counted exactly."""
UNLIMITED: Final = np.iinfo(np.int64).max
"""No limit of the number of pieces."""
DISTANCE_TOLERANCE_M: Final = 1e-10
"""Maximum difference of distances at which poses are equivalent [m]."""


def least_distances(
    points: FloatArray, swept: SweptBody, sight: float, exact_below: float = np.inf
) -> tuple[FloatArray, IntArray]:
    """Return least signed distances (P,) [m] of points from a body at any pose, and pose indices (P,).

    A distance is ``sight`` [m] and its index 0 if it is not less than ``sight``. Distances from
    ``exact_below`` on are not less than ``exact_below`` and the least distance of all, but may be too large.

    Args:
        points: Points (P, 3) [m].
        swept: The body along its path.
        sight: Distance within which points are in sight of the body [m].
        exact_below: Distance below which all distances are exact, besides the least one of all [m].
    """
    nearest = _NearestPoses(np.full(len(points), sight), np.zeros(len(points), dtype=np.int64))
    points = np.ascontiguousarray(points.T)
    for first in range(0, len(swept.tip), POSES_AT_ONCE):
        part = swept.part(slice(first, first + POSES_AT_ONCE))
        chosen = _in_box(points, part, sight)
        if len(chosen):
            query = _DistanceQuery(sight, exact_below, float(nearest.distance.min()))
            _DistanceSearch(points, chosen, part, query, nearest, first).run()
    return nearest.distance, nearest.pose


def _in_box(points: FloatArray, swept: SweptBody, sight: float) -> IntArray:
    """Return which of the points (3, P) are in the box around the body along its path."""
    tip, axis, body = swept.tip, swept.axis, swept.body
    ends = np.stack([tip + body.start * axis, tip + body.end * axis])
    margin = body.max_radius + sight
    low, high = ends.min(axis=(0, 1)) - margin, ends.max(axis=(0, 1)) + margin
    return np.flatnonzero(((points >= low[:, None]) & (points <= high[:, None])).all(axis=0))


def points_near(
    corners: FloatArray, swept: SweptBody, sight: float, size: float, max_pieces: int
) -> tuple[FloatArray, IntArray, int]:
    """Return points (P, 3) of triangles near a body at some of its poses, their triangle (P,) and count.

    The points are the centroids of all small pieces of triangles there.

    Args:
        corners: Corners of the triangles (T, 3, 3) [m].
        swept: The body along its path.
        sight: Maximum distance from the body [m].
        size: Maximum edge of a piece [m].
        max_pieces: Maximum number of pieces. If the approximate count exceeds it, there are no points.
    """
    coarse_pieces, owner, count = _pieces_near(corners, swept, sight, size, max_pieces)
    if count > max_pieces or not len(coarse_pieces):
        return corners[:0, 0], owner[:0], count
    centres, owners = [corners[:0, 0]], [owner[:0]]
    for rows in np.array_split(np.arange(len(coarse_pieces)), len(coarse_pieces) // PIECES_AT_ONCE + 1):
        pieces, rows_of_pieces = bisect_triangles(coarse_pieces[rows], size, UNLIMITED)
        centres.append(pieces.mean(axis=1))
        owners.append(owner[rows][rows_of_pieces])
    points = np.concatenate(centres)
    return points, np.concatenate(owners), len(points)


def count_near(corners: FloatArray, swept: SweptBody, sight: float, size: float, max_pieces: int) -> int:
    """Return the number of points that :func:`points_near` finds.

    It is approximate if it is far below ``max_pieces``.
    """
    coarse_pieces, _, count = _pieces_near(corners, swept, sight, size, max_pieces)
    if COUNT_FRACTION * max_pieces < count <= max_pieces and len(coarse_pieces):
        return points_near(corners, swept, sight, size, max_pieces)[2]
    return count


def _pieces_near(
    corners: FloatArray, swept: SweptBody, sight: float, size: float, max_pieces: int
) -> tuple[FloatArray, IntArray, int]:
    """Return coarse pieces (P, 3, 3) that may be near, their triangles (P,) and a count of fine pieces.

    The count is approximate. Parameters are those of :func:`points_near`.
    """
    centre, reach = _path_centres(swept, sight)
    owner = np.arange(len(corners))
    kept = _within(corners, centre, reach)
    pieces, owner = corners[kept], owner[kept]
    longest = float(np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=2).max(initial=0.0))
    while len(pieces) and longest > max(size, COARSE_PIECE_M):
        longest = max(0.5 * longest, size, COARSE_PIECE_M)
        pieces, parents = bisect_triangles(pieces, longest, UNLIMITED)
        kept = _within(pieces, centre, reach)
        pieces, owner = pieces[kept], owner[parents][kept]
        if len(pieces) > max_pieces:
            break
    if len(pieces) and size < CLOSER_FRACTION * COARSE_PIECE_M:
        kept = _near_body(pieces, swept, sight)
        pieces, owner = pieces[kept], owner[kept]
    return pieces, owner, _estimated_count(pieces, size)


def _near_body(corners: FloatArray, swept: SweptBody, sight: float) -> BoolArray:
    """Return which triangles (T, 3, 3) may come within ``sight`` [m] of the body itself.

    The middles of the others are farther from the body than ``sight`` and the distance of their corners.
    """
    middle = corners.mean(axis=1)
    size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    reach = sight + float(size.max())
    distances, _ = least_distances(middle, swept, reach, reach)
    return np.asarray(distances - size < sight)


def _estimated_count(corners: FloatArray, size: float) -> int:
    """Return an estimate of the number of pieces of triangles (T, 3, 3) with edges up to ``size`` [m]."""
    if not len(corners):
        return 0
    sample = corners[:: max(1, len(corners) // SAMPLED_TRIANGLES)]
    longest = np.linalg.norm(sample - np.roll(sample, 1, axis=1), axis=2).max(axis=1)
    # large triangles are divided only to 16 sizes: each further halving makes four times as many pieces
    halves = np.maximum(np.ceil(np.log2(longest / size / 16.0)), 0.0)
    piece_counts = [
        len(bisect_triangles(sample[halves == half], size * 2.0**half, UNLIMITED)[0]) * 4.0**half
        for half in np.unique(halves)
    ]
    return int(np.ceil(np.sum(piece_counts) * len(corners) / len(sample)))


def _path_centres(swept: SweptBody, sight: float) -> tuple[cKDTree, float]:
    """Return centres and a radius [m] around them.

    Whatever is within ``sight`` of the body at some pose is within the radius of a centre.
    """
    tip, axis, body = swept.tip, swept.axis, swept.body
    count = max(int(np.ceil((body.end - body.start) / max(body.max_radius, COARSE_PIECE_M))), 1)
    depths = body.start + (body.end - body.start) * (np.arange(count) + 0.5) / count
    cells = [
        np.unique(np.floor((tip + depth * axis) / COARSE_PIECE_M).astype(np.int64), axis=0)
        for depth in depths
    ]
    occupied = np.unique(np.concatenate(cells), axis=0)
    half = 0.5 * (body.end - body.start) / count
    return cKDTree((occupied + 0.5) * COARSE_PIECE_M), float(
        np.hypot(body.max_radius, half)
    ) + sight + COARSE_PIECE_M


def _within(corners: FloatArray, centre: cKDTree, reach: float) -> BoolArray:
    """Return which triangles (T, 3, 3) may come within ``reach`` [m] of some centre."""
    middle = corners.mean(axis=1)
    size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    distances, _ = centre.query(middle, distance_upper_bound=reach + float(size.max(initial=0.0)))
    return np.asarray(distances - size <= reach)


@dataclasses.dataclass
class _DistanceQuery:
    """Which distances a search has to find.

    Attributes:
        sight: Distance within which points are in sight of the body [m].
        below: Distance from which on only the least of all is needed [m].
        lowest: Least distance known so far [m].
    """

    sight: float
    below: float
    lowest: float

    @property
    def limit(self) -> float:
        """Distance from which on others do not matter [m]."""
        return max(self.below, self.lowest)


@dataclasses.dataclass(frozen=True, eq=False)
class _NearestPoses:
    """Nearest poses of P points that are known so far. A search updates the arrays.

    Attributes:
        distance: Least distances (P,) [m].
        pose: Indices of the poses (P,).
    """

    distance: FloatArray
    pose: IntArray


class _DistanceSearch:
    """The search of one block of poses, the first of which has the index ``first``.

    Subjects are cells of points at first, then points. Points, tips and axes have x, y and z in rows, for
    speed.
    """

    def __init__(
        self,
        points: FloatArray,
        chosen: IntArray,
        swept: SweptBody,
        query: _DistanceQuery,
        nearest: _NearestPoses,
        first: int,
    ) -> None:
        self.body, self.query, self.pose_count = swept.body, query, len(swept.tip)
        self.tip, self.axis = np.ascontiguousarray(swept.tip.T), np.ascontiguousarray(swept.axis.T)
        self.best, self.nearest_pose, self.first = nearest.distance, nearest.pose, first
        points = points.take(chosen, axis=1)
        order, start = _cells(points)
        self.point_ids, self.points = chosen[order], points.take(order, axis=1)
        self.start = np.append(start, len(chosen))
        low, high = (op.reduceat(self.points, start, axis=1) for op in (np.minimum, np.maximum))
        self.middle = 0.5 * (low + high)
        offsets = self.points - np.repeat(self.middle, np.diff(self.start), axis=1)
        self.size = np.sqrt(np.maximum.reduceat(column_dots(offsets, offsets), start))
        # if a point of a cell is in sight, the cell's middle is farther by its size at most
        self.levels = group_levels(swept, query.sight + float(self.size.max()))
        self.cell_bounds = np.maximum.reduceat(self.best[self.point_ids], start)
        self.point_distances = self.best[self.point_ids]

    def run(self) -> None:
        """Split groups and cells until no pair is left."""
        top = len(self.levels) - 1
        count = self.levels[top].count
        cells = np.arange(len(self.size))
        stack = [
            (True, top, np.repeat(part, count), np.tile(np.arange(count), len(part)))
            for part in np.array_split(cells, -(-len(cells) // 512))
        ]
        # an entry has pairs of a subject and a group of one level; below level 0 groups are poses
        while stack:
            is_cell, level, subjects, group = stack.pop()
            if len(subjects) > PAIRS_AT_ONCE and subjects[0] != subjects[-1]:
                middle = int(np.searchsorted(subjects, subjects[len(subjects) // 2], side="left"))
                middle = middle or int(np.searchsorted(subjects, subjects[0], side="right"))
                stack += [
                    (is_cell, level, subjects[:middle], group[:middle]),
                    (is_cell, level, subjects[middle:], group[middle:]),
                ]
                continue
            if level < 0:
                self._evaluate_all(subjects, group)
                continue
            keep = self._open_groups(is_cell, level, subjects, group)
            subjects, group = subjects[keep], group[keep]
            if not len(subjects):
                continue
            if is_cell and self.levels[level].size <= SPLIT_POSES:
                stack.append((False, level, *self._split_cells(subjects, group)))
                continue
            below = self.levels[level - 1].count if level else self.pose_count
            parts = GROUPS_JOINED if level else GROUP_POSES
            subjects, group = (
                np.repeat(subjects, parts),
                (parts * group[:, None] + np.arange(parts)).ravel(),
            )
            exists = group < below
            stack.append((is_cell, level - 1, subjects[exists], group[exists]))

    def _split_cells(self, cell_rows: IntArray, group: IntArray) -> tuple[IntArray, IntArray]:
        """Return the points of cells, each with the groups of its cell, ordered by point."""
        first = np.flatnonzero(np.diff(cell_rows, prepend=-1))
        groups = np.diff(np.append(first, len(cell_rows)))
        cells = cell_rows[first]
        sizes = self.start[cells + 1] - self.start[cells]
        point = np.repeat(self.start[cells] - (np.cumsum(sizes) - sizes), sizes) + np.arange(int(sizes.sum()))
        counts = np.repeat(groups, sizes)
        base = np.repeat(np.repeat(first, sizes) - (np.cumsum(counts) - counts), counts)
        return np.repeat(point, counts), group[base + np.arange(int(counts.sum()))]

    def _open_groups(self, is_cell: bool, level: int, subjects: IntArray, group: IntArray) -> BoolArray:
        """Return which pairs may have a nearer pose than is known.

        To lower the known distances, the body is evaluated at the most promising pose of each subject.
        """
        points = (self.middle if is_cell else self.points).take(subjects, axis=1)
        low, positions = self.levels[level].bound(points, group, self.body)
        if is_cell:
            low -= self.size[subjects]
        first = np.flatnonzero(np.diff(subjects, prepend=-1))
        best = np.repeat(np.minimum.reduceat(low, first), np.diff(np.append(first, len(subjects))))
        hit = np.flatnonzero(low == best)
        known_distance = self.cell_bounds if is_cell else self.point_distances
        hit = hit[low[hit] < known_distance[subjects[hit]]]
        size = self.levels[level].size
        poses = size * group[hit] + np.rint((positions[hit] + 1.0) * 0.5 * (size - 1)).astype(np.int64)
        np.minimum(poses, self.pose_count - 1, out=poses)
        if is_cell:
            upper_bound = (
                self._distances(self.middle.take(subjects[hit], axis=1), poses) + self.size[subjects[hit]]
            )
            np.minimum.at(self.cell_bounds, subjects[hit], upper_bound)
            # the bound of a cell is not yet recorded for its points
            return np.asarray(
                low < np.minimum(self.cell_bounds[subjects], self.query.limit) + DISTANCE_TOLERANCE_M
            )
        self._evaluate(subjects[hit], poses)
        return np.asarray(
            low < np.minimum(self.point_distances[subjects], self.query.limit) - DISTANCE_TOLERANCE_M
        )

    def _evaluate_all(self, subjects: IntArray, poses: IntArray) -> None:
        """Evaluate all pairs of a point and a pose, and record the nearest pose of each point."""
        distances = self._distances(self.points.take(subjects, axis=1), poses)
        first = np.flatnonzero(np.diff(subjects, prepend=-1))
        best = np.repeat(np.minimum.reduceat(distances, first), np.diff(np.append(first, len(subjects))))
        hit = np.flatnonzero(distances == best)
        self._record(subjects[hit], poses[hit], distances[hit])

    def _evaluate(self, subjects: IntArray, poses: IntArray) -> None:
        self._record(subjects, poses, self._distances(self.points.take(subjects, axis=1), poses))

    def _record(self, subjects: IntArray, poses: IntArray, distances: FloatArray) -> None:
        """Record distances that are less than the known ones."""
        nearer = distances < self.point_distances[subjects]
        subjects, poses, distances = subjects[nearer], poses[nearer], distances[nearer]
        self.point_distances[subjects] = distances
        rows = self.point_ids[subjects]
        self.best[rows], self.nearest_pose[rows] = distances, poses + self.first
        # a point that occurs twice has one of its poses recorded, not always the nearer one
        self.query.lowest = min(self.query.lowest, float(self.point_distances[subjects].min(initial=np.inf)))

    def _distances(self, points: FloatArray, poses: IntArray) -> FloatArray:
        """Return distances (M,) [m] of points (3, M) from the body at poses (M,)."""
        offset, axis = points - self.tip.take(poses, axis=1), self.axis.take(poses, axis=1)
        depth = column_dots(offset, axis)
        square = column_dots(offset, offset) - depth * depth
        return self.body.distance(depth, np.sqrt(np.maximum(square, 0.0)))


def _cells(points: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the order of points (3, P) by cells of a grid, and where in it each cell begins."""
    low = points.min(axis=1)[:, None]
    offsets = points - low
    side = max(float(offsets.max()) / 64.0, 1e-9)
    key, cell_count = _cell_numbers(offsets, side)
    is_occupied = np.zeros(cell_count, dtype=bool)
    is_occupied[key] = True
    # the points are on faces, so the number of cells falls with the square of their sides
    key, _ = _cell_numbers(offsets, side * float(np.sqrt(is_occupied.sum() * POINTS_PER_CELL / len(key))))
    order = np.argsort(key)
    return order, np.flatnonzero(np.diff(key[order], prepend=-1))


def _cell_numbers(offsets: FloatArray, side: float) -> tuple[IntArray, int]:
    """Return numbers (P,) of the grid cells of points ``offsets`` (3, P) from its corner, and their count."""
    x, y, z = (offsets / side).astype(np.int64)
    cell_counts = [int(row.max()) + 1 for row in (x, y, z)]
    return x + cell_counts[0] * (y + cell_counts[1] * z), cell_counts[0] * cell_counts[1] * cell_counts[2]
