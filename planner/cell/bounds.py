"""Smallest distances of a cell's solids: cheap bounds, which decide most configurations, and true distances.

Every moving solid has a capsule around it and one inside it, with the same axis. The distance of the outer
capsules is a lower bound of the true one, that of the inner capsules an upper bound. Fixed boxes (stock,
table, bases) stay boxes. Pairs that no bound decides are measured (:mod:`planner.cell.distance`).
"""

import dataclasses
import functools
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

import numpy as np

from planner.cell.bodies import (
    ClearanceEasing,
    Solid,
    bounding_size,
    hull_points,
    link_chains,
    signed_distance,
)
from planner.cell.bodies import is_fixed as is_fixed
from planner.cell.distance import (
    DISTANCE_TOLERANCE_M,
    Cores,
    make_cores,
    measure_distances,
    nearest_position_to_box,
    segment_vectors,
)
from planner.cell.projection_bounds import separation, support_sizes
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IndexArray,
    dots,
    from_parts,
    inverse,
    lengths,
    transform,
)

AXIS_SAMPLES: Final = 5
"""Number of points on a capsule's axis whose distances to a box bound that of the whole axis."""
BALL_MARGIN_M: Final = 1e-9
"""Amount [m] by which balls around bodies are enlarged. It exceeds rounding errors."""
ROW_GROUP_SIZE: Final = 32
"""Number of consecutive configurations that are compared with a box as a group first."""
FIRST_LIMIT_M: Final = 0.08
"""Distance [m] up to which lower bounds are computed first, if they are requested up to a larger distance."""
MAX_NEAR_DISTANCE_M: Final = 0.012
"""Distance [m] of solids of one arm that counts as close.

Solids that are within it in nearly all postures give no information when they are close.
"""
MIN_NEAR_FRACTION: Final = 0.95
"""Solids that are close to each other in more than this fraction of postures count as always close."""
MAX_KEPT_DISTANCE_M: Final = 0.03
"""Distance [m] of solids of one arm that the arm's build keeps apart.

Such solids are within it in nearly all postures and touch in none, such as the round end of a wrist and what
rotates about it. A larger clearance is impossible there.
"""


SolidPair = tuple[int, int]
"""Indices of two solids in ``ClearanceBounds.all_solids``, ascending."""


@dataclasses.dataclass(frozen=True, eq=False)
class ClearanceBounds:
    """Solids of a cell in the forms from which bounds and distances are computed.

    S moving solids have capsules in their body, K boxes belong to fixed bodies. B configurations (rows) are
    evaluated together.

    Attributes:
        solids: Moving solids, meshes as boxes (S,).
        bodies: Moving bodies (P,).
        body_index: Index in ``bodies`` of each solid (S,).
        centre: Centres of the capsules in their body (S, 3) [m].
        axis: Unit axes of the capsules in their body (S, 3).
        outer: Half lengths and radii of the outer capsules (S,) [m].
        inner: Half lengths and radii of the inner capsules (S,) [m].
        frame: Axes of the shapes in their body (S, 3, 3).
        support: Result of :func:`support_sizes` (S, 5).
        boxes: Boxes of fixed bodies (K,).
        half_sizes: Half sizes of the boxes (K, 3) [m].
        is_exact: Whether a box is the solid itself, or contains a mesh (K,).
        pairs: Pairs of capsules that are checked (M, 2).
        box_pairs: Pairs of a capsule and a box that are checked (N, 2).
        all_solids: The solids themselves, moving ones, then fixed ones (S + K,).
        poses_in_body: Poses of ``all_solids`` in their bodies (S + K, 4, 4).
        cores: Cores of ``all_solids``.
        ease: Distance [m] that is added to the distance of two of ``all_solids`` in all results (S + K, S +
            K). It is 0 unless :meth:`with_easing` sets it.
    """

    solids: tuple[Solid, ...]
    bodies: tuple[str, ...]
    body_index: IndexArray
    centre: FloatArray
    axis: FloatArray
    outer: tuple[FloatArray, FloatArray]
    inner: tuple[FloatArray, FloatArray]
    frame: FloatArray
    support: FloatArray
    boxes: tuple[Solid, ...]
    half_sizes: FloatArray
    is_exact: BoolArray
    pairs: IndexArray
    box_pairs: IndexArray
    all_solids: tuple[Solid, ...]
    poses_in_body: FloatArray
    cores: Cores
    ease: FloatArray

    def with_easing(self, easing: ClearanceEasing) -> "ClearanceBounds":
        """Return bounds in which pairs of bodies count as farther apart than they are."""
        bodies = [solid.body for solid in self.all_solids]
        ease = np.array([[easing.added_distance(first, other) for other in bodies] for first in bodies])
        return dataclasses.replace(self, ease=ease.reshape(len(bodies), len(bodies)))

    def without_bodies(self, ignore: frozenset[frozenset[str]]) -> "ClearanceBounds":
        """Return bounds without the pairs of bodies in ``ignore``. Results are kept for later calls."""
        if not ignore:
            return self
        if ignore not in self._without_bodies_cache:
            bodies = [solid.body for solid in self.all_solids]
            self._without_bodies_cache[ignore] = self._filter_pairs(
                lambda a, b: frozenset((bodies[a], bodies[b])) not in ignore
            )
        return self._without_bodies_cache[ignore]

    @functools.cached_property
    def _without_bodies_cache(self) -> "dict[frozenset[frozenset[str]], ClearanceBounds]":
        return {}

    def always_near_pairs(self, poses: Mapping[str, FloatArray]) -> tuple[SolidPair, ...]:
        """Return pairs of solids of one arm that its build keeps close to each other.

        They are removed from the checks, because their distance says nothing about a posture. There are two
        kinds. Pairs of the first kind are within :data:`MAX_KEPT_DISTANCE_M` in more than
        :data:`MIN_NEAR_FRACTION` of the poses and never touch. Pairs of the second kind are often within
        :data:`MAX_NEAR_DISTANCE_M`. Of these, only as many are returned as needed so that the remaining pairs
        of the same two bodies are close in at most :data:`MIN_NEAR_FRACTION` of the poses.

        Args:
            poses: Random body poses (B | 1, 4, 4), by body.

        Returns:
            Pairs of indices in ``all_solids``.
        """
        same_arm = self._same_arm_pairs()
        row, solids, gap, *_ = same_arm.measure_all(poses, MAX_KEPT_DISTANCE_M)
        count = same_arm._make_placement(poses).rows
        gaps_by_bodies: dict[frozenset[str], dict[SolidPair, FloatArray]] = {}
        for pose_index, (a, b), gap_value in zip(row.tolist(), solids.tolist(), gap.tolist(), strict=True):
            gaps_by_pair = gaps_by_bodies.setdefault(
                frozenset((self.all_solids[a].body, self.all_solids[b].body)), {}
            )
            gaps_by_pair.setdefault((min(a, b), max(a, b)), np.full(count, np.inf))[pose_index] = gap_value
        out: list[SolidPair] = []
        for gaps_by_pair in gaps_by_bodies.values():
            fractions = {pair: np.isfinite(gaps).mean() for pair, gaps in gaps_by_pair.items()}
            kept_apart = [
                pair
                for pair, gaps in gaps_by_pair.items()
                if fractions[pair] > MIN_NEAR_FRACTION and gaps.min() > 0.0
            ]
            out += kept_apart
            remaining = {
                pair: gaps < MAX_NEAR_DISTANCE_M
                for pair, gaps in gaps_by_pair.items()
                if pair not in kept_apart
            }
            while remaining and np.logical_or.reduce(list(remaining.values())).mean() > MIN_NEAR_FRACTION:
                most_frequent = max(sorted(remaining), key=lambda pair: int(remaining[pair].sum()))
                del remaining[most_frequent]
                out.append(most_frequent)
        return tuple(sorted(out))

    def flange_part_pairs(self, poses: Mapping[str, FloatArray]) -> tuple[SolidPair, ...]:
        """Return pairs of a solid of the link before the last two and a part of the tool close to the flange.

        A part of the tool is close if it is nowhere farther than :data:`MAX_NEAR_DISTANCE_M` from the flange,
        such as the plate by which the tool is mounted. The arm's build keeps it apart from that link as it
        does the flange itself, often by only a few millimetres.

        Args:
            poses: Body poses (1, 4, 4), by body.
        """
        out: list[SolidPair] = []
        chains = link_chains(solid.body for solid in self.all_solids)
        for k, solid in enumerate(self.all_solids):
            arm, _, link = solid.body.partition("/")
            if link != "tool" or arm not in chains:
                continue
            *_, wrist_link, _, last_link, _ = chains[arm]
            flange_solids = [other for other in self.all_solids if other.body == f"{arm}/{last_link}"]
            if not flange_solids:
                continue
            points = transform(poses[solid.body][0] @ solid.shape.pose, hull_points(solid))
            with_inverse_poses = [
                (other, inverse(poses[other.body][0] @ other.shape.pose)) for other in flange_solids
            ]
            distance = np.min(
                [
                    signed_distance(other, transform(inverse_pose, points))
                    for other, inverse_pose in with_inverse_poses
                ],
                axis=0,
            )
            if distance.max() <= MAX_NEAR_DISTANCE_M:
                wrist_indices = [
                    i for i, other in enumerate(self.all_solids) if other.body == f"{arm}/{wrist_link}"
                ]
                out += [(min(i, k), max(i, k)) for i in wrist_indices]
        return tuple(out)

    def without_pairs(self, solids: Collection[SolidPair]) -> "ClearanceBounds":
        """Return bounds without pairs of solids, by their indices in ``all_solids``."""
        return self._filter_pairs(lambda a, b: (min(a, b), max(a, b)) not in solids)

    def pairs_of_bodies(self, first_body: str, other: str) -> tuple[SolidPair, ...]:
        """Return the pairs of solids of two bodies that are checked, by indices in ``all_solids``."""
        bodies = {first_body, other}
        selected = self._filter_pairs(
            lambda a, b: {self.all_solids[a].body, self.all_solids[b].body} == bodies
        )
        capsule_pairs = [(a, b) for a, b in selected.pairs.tolist()]
        box_pairs = [(a, b + len(self.solids)) for a, b in selected.box_pairs.tolist()]
        return tuple(capsule_pairs + box_pairs)

    def _same_arm_pairs(self) -> "ClearanceBounds":
        """Return bounds with only the pairs of solids that belong to the same arm."""
        names = [solid.body.partition("/") for solid in self.all_solids]
        return self._filter_pairs(
            lambda a, b: names[a][0] == names[b][0] and bool(names[a][1]) and bool(names[b][1])
        )

    def _filter_pairs(self, keep: Callable[[int, int], bool]) -> "ClearanceBounds":
        """Return bounds with only those pairs of indices in ``all_solids`` that ``keep`` accepts."""
        count = len(self.solids)
        keeps_pair = np.array([keep(a, b) for a, b in self.pairs.tolist()], dtype=bool)
        keeps_box_pair = np.array([keep(a, b + count) for a, b in self.box_pairs.tolist()], dtype=bool)
        return dataclasses.replace(
            self,
            pairs=self.pairs[keeps_pair.reshape(-1)],
            box_pairs=self.box_pairs[keeps_box_pair.reshape(-1)],
        )

    def min_distance_bounds(
        self, poses: Mapping[str, FloatArray], limit: float, both: bool = True
    ) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds (B,) [m] of the smallest distance of any checked pair.

        If bodies overlap, the bounds have the true sign but are not depths. Distances above ``limit`` are not
        computed: both bounds are then infinite or above it.

        Args:
            poses: Body poses (B | 1, 4, 4), by body.
            limit: Distance up to which bounds are computed [m].
            both: Whether upper bounds are requested. Otherwise they are infinite.
        """
        placement = self._make_placement(poses)
        lower, upper = np.full(placement.rows, np.inf), np.full(placement.rows, np.inf)
        undecided = np.arange(placement.rows)
        if not both and limit > FIRST_LIMIT_M:  # rows with a small distance need no search up to the limit
            lower = self._min_lower_bounds(placement, FIRST_LIMIT_M)
            undecided = np.flatnonzero(~(lower < FIRST_LIMIT_M))
        if len(undecided):
            remaining = placement if len(undecided) == placement.rows else placement.select(undecided)
            lower[undecided] = self._min_lower_bounds(remaining, limit, upper if both else None)
        return lower, upper

    def _min_lower_bounds(
        self, placement: "_Placement", limit: float, upper: FloatArray | None = None
    ) -> FloatArray:
        """Return the lower bounds (B,) [m] of :meth:`min_distance_bounds`.

        If ``upper`` (B,) is given, its values are lowered in place to the upper bounds.
        """
        # The inner capsule is inside its solid, the outer one around it: d(outer) <= d <= d(inner).
        lower = np.full(placement.rows, np.inf)
        boxes = self._close_boxes(placement, limit)
        pairs = self._close_capsules(placement, limit, np.ones(placement.rows, dtype=np.bool_))
        if upper is not None:
            np.minimum.at(upper, boxes.row, self._box_upper_bounds(boxes) + self._box_ease(boxes))
            np.minimum.at(
                upper,
                pairs.row,
                self._capsule_distances(placement, pairs, self.inner)[1]
                + self.ease[pairs.first, pairs.other],
            )
        self._merge_capsule_bounds(lower, placement, limit, pairs)
        self._merge_box_bounds(lower, placement, boxes, limit)
        return lower

    def measure_nearest(
        self, poses: Mapping[str, FloatArray], limit: float
    ) -> tuple[FloatArray, IndexArray, BoolArray]:
        """Measure the smallest distance in each configuration of finite body poses.

        Without the added :attr:`ease` it is at most 1e-7 m below the truth and never above it.

        Args:
            poses: Body poses (B | 1, 4, 4), by body.
            limit: Distance up to which solids are measured [m].

        Returns:
            Distances (B,) [m], ``limit`` if none is below it.
            Indices in ``all_solids`` of the two solids (B, 2), -1 if there are none.
            Whether their cores overlap (B,), so that the depth is only bounded.
        """
        placement, row, first, second, low = self._close_pairs(poses, limit)
        best = np.full(placement.rows, limit)
        pair = np.full((placement.rows, 2), -1, dtype=np.intp)
        is_overlap = np.zeros(placement.rows, dtype=np.bool_)
        leading = np.flatnonzero(np.diff(row, prepend=-1))  # first pair of each row: smallest lower bound
        is_remaining = np.ones(len(row), dtype=np.bool_)
        is_remaining[leading] = False
        # first the pair of each row that is probably closest, which rules out most others; then the others
        for stage in (leading, None):
            selected = np.flatnonzero(is_remaining & (low < best[row])) if stage is None else stage
            if not len(selected):
                continue
            rows, first_solid, second_solid = row[selected], first[selected], second[selected]
            gap, direction, _ = self._measure(placement, rows, first_solid, second_solid)
            gap = gap + self.ease[first_solid, second_solid]
            # of each row the pair with the smallest distance, if it is below the smallest so far
            closest = np.lexsort((gap, rows))
            closest = closest[np.diff(rows[closest], prepend=-1) != 0]
            closest = closest[gap[closest] < best[rows[closest]]]
            best[rows[closest]] = gap[closest]
            pair[rows[closest]] = np.stack([first_solid, second_solid], axis=1)[closest]
            is_overlap[rows[closest]] = ~direction[closest].any(axis=1)
        return best, pair, is_overlap

    def is_apart(self, poses: Mapping[str, FloatArray], padding: float) -> BoolArray:
        """Return for each of B rows whether all solids are farther apart than ``padding`` [m].

        The poses must be finite.
        """
        placement = self._make_placement(poses)
        boxes = self._close_boxes(placement, padding + DISTANCE_TOLERANCE_M)
        out = np.ones(placement.rows, dtype=np.bool_)
        out[boxes.row[self._box_upper_bounds(boxes) + self._box_ease(boxes) <= padding]] = False
        row, first, second, _ = self._pairs_within(placement, boxes, padding + DISTANCE_TOLERANCE_M, out)
        return out & self._all_apart(placement, row, first, second, padding - self.ease[first, second])

    def stays_apart(
        self, poses: Mapping[str, FloatArray], padding: float, change: FloatArray, lever: FloatArray
    ) -> BoolArray:
        """Return for each of B rows whether all solids certainly stay apart while joints change.

        Apart means farther than ``padding``. False means that it is not certain. A joint that moves both
        solids of a pair does not change their distance, so each pair has its own required distance.

        Args:
            poses: Finite body poses (B | 1, 4, 4), by body.
            padding: Required distance [m].
            change: Change of the joints in both directions (B, D) [rad].
            lever: Largest displacement of any point of each of ``all_solids`` per change of each joint
                (S + K, D) [m/rad]; 0 if the joint does not move the solid.
        """
        # required distance of a pair: padding + sum_j change_j (lever_1j + lever_2j), without common joints
        placement, count = self._make_placement(poses), len(self.pairs)
        pairs = np.concatenate([self.pairs, self.box_pairs + np.array([0, len(self.solids)])])
        first_lever, second_lever = lever[pairs[:, 0]], lever[pairs[:, 1]]
        required = padding - self.ease[tuple(pairs.T)]
        required = (
            required
            + change @ np.where((first_lever > 0.0) & (second_lever > 0.0), 0.0, first_lever + second_lever).T
        )
        a, b = self.pairs.T
        centre_distance = lengths(placement.centre[:, a] - placement.centre[:, b])
        # d <= |c1 - c2| - r1 - r2 of the balls inside: rows where this is too small are not certain
        over = centre_distance - self.inner[1][a] - self.inner[1][b]
        is_certain = np.asarray((over > required[:, :count]).all(axis=1))
        rows = np.flatnonzero(is_certain)
        if not len(rows):
            return is_certain
        placement, required, reach = placement.select(rows), required[rows], self.outer[0] + self.outer[1]
        # d >= |c1 - c2| - reach1 - reach2: only pairs within that are left to check
        row, pair = np.nonzero(centre_distance[rows] < reach[a] + reach[b] + required[:, :count])
        boxes = self._close_boxes(placement, float(required[:, count:].max(initial=padding)))
        column = np.zeros((len(self.solids), len(self.boxes)), dtype=np.intp)
        column[tuple(self.box_pairs.T)] = np.arange(count, len(pairs))
        box_column = column[boxes.solid, boxes.box]
        close_boxes = np.flatnonzero(boxes.distance < reach[boxes.solid] + required[boxes.row, box_column])
        boxes, box_column = boxes.select(close_boxes), box_column[close_boxes]
        low = self._capsule_lower_bounds(placement, required[row, pair], _PlacedPairs(row, a[pair], b[pair]))
        low = np.concatenate([low, self._sampled_box_bounds(boxes)[0]])
        row, pair = np.append(row, boxes.row), np.append(pair, box_column)
        beyond = low - required[row, pair]
        order = np.flatnonzero(beyond < DISTANCE_TOLERANCE_M)
        order = order[np.lexsort((beyond[order], row[order]))]
        row, pair = row[order], pair[order]
        first, second = pairs[pair].T
        is_certain[rows] = self._all_apart(placement, row, first, second, required[row, pair])
        return is_certain

    def _all_apart(
        self,
        placement: "_Placement",
        row: IndexArray,
        first: IndexArray,
        second: IndexArray,
        required: FloatArray,
    ) -> BoolArray:
        """Return for each of B rows whether all of its pairs are farther apart than required.

        The M pairs and their required distances (M,) [m] are sorted by row, with the probably closest pair of
        each row first.
        """
        out = np.ones(placement.rows, dtype=np.bool_)
        leading = np.diff(row, prepend=-1) != 0
        for stage in (np.flatnonzero(leading), None):
            selected = np.flatnonzero(~leading & out[row]) if stage is None else stage
            if len(selected):
                rows, first_solid, second_solid = row[selected], first[selected], second[selected]
                gap = self._measure(placement, rows, first_solid, second_solid, required[selected])[0]
                out[rows[gap <= required[selected]]] = False
        return out

    def measure_all(
        self, poses: Mapping[str, FloatArray], limit: float
    ) -> tuple[IndexArray, IndexArray, FloatArray, FloatArray, FloatArray]:
        """Measure all pairs of solids that are closer than ``limit`` [m] at body poses (B | 1, 4, 4).

        Returns:
            Configuration (M,), indices in ``all_solids`` of both solids (M, 2), distance (M,) as in
            :meth:`measure_nearest`, and direction (M, 3) and a point (M, 3) of the line of the distance, as
            in :func:`measure_distances`.
        """
        placement, row, first, second, _ = self._close_pairs(poses, limit)
        gap, direction, point = self._measure(placement, row, first, second)
        gap = gap + self.ease[first, second]
        is_close = np.flatnonzero(gap < limit)
        return (
            row[is_close],
            np.stack([first, second], axis=1)[is_close],
            gap[is_close],
            direction[is_close],
            point[is_close],
        )

    def _close_pairs(
        self, poses: Mapping[str, FloatArray], limit: float
    ) -> "tuple[_Placement, IndexArray, IndexArray, IndexArray, FloatArray]":
        """Return the placed solids, and the pairs of solids that may be closer than ``limit`` [m].

        The pairs are four arrays (M,): row, both solids and lower bound. They are sorted by row, with the
        smallest bound of each row first.
        """
        placement = self._make_placement(poses)
        boxes = self._close_boxes(placement, limit)
        return placement, *self._pairs_within(
            placement, boxes, limit, np.ones(placement.rows, dtype=np.bool_)
        )

    def _pairs_within(
        self, placement: "_Placement", boxes: "_CloseBoxes", limit: float, rows: BoolArray
    ) -> tuple[IndexArray, IndexArray, IndexArray, FloatArray]:
        """Return the pairs of :meth:`_close_pairs` in the rows for which ``rows`` (B,) is true.

        ``boxes`` are the close boxes of all rows, for the same ``limit``.
        """
        capsules = self._close_capsules(placement, limit, rows)
        boxes = boxes if rows.all() else boxes.select(np.flatnonzero(rows[boxes.row]))
        box_low = self._sampled_box_bounds(boxes)[0]
        is_low = np.flatnonzero(box_low < limit)
        box_low[is_low] = np.maximum(
            box_low[is_low], self._projected_box_bounds(placement, boxes.select(is_low))
        )
        low = np.concatenate([self._capsule_lower_bounds(placement, limit, capsules), box_low])
        row, first = np.concatenate([capsules.row, boxes.row]), np.concatenate([capsules.first, boxes.solid])
        second = np.concatenate([capsules.other, boxes.box + len(self.solids)])
        order = np.flatnonzero(low < limit)
        order = order[np.lexsort((low[order], row[order]))]
        return row[order], first[order], second[order], low[order]

    def _measure(
        self,
        placement: "_Placement",
        row: IndexArray,
        first_solid: IndexArray,
        other: IndexArray,
        settled: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Measure M pairs of solids, each in one row; the result is that of :func:`measure_distances`.

        Args:
            placement: Placed solids.
            row: (M,) rows.
            first_solid: (M,) first solids, as indices in ``all_solids``.
            other: (M,) second solids.
            settled: (M,) [m] threshold of that function.
        """
        first, second = (self._solid_poses(placement, row, which) for which in (first_solid, other))
        return measure_distances(self.cores, first_solid, other, first, second, settled)

    def _make_placement(self, poses: Mapping[str, FloatArray]) -> "_Placement":
        """Place all solids at body poses (B | 1, 4, 4) with one matrix product for all capsules and balls.

        A body whose pose is not finite gets NaN in that row, and other bodies are not affected.
        """
        rows = max(len(pose) for pose in poses.values())
        body_poses = np.empty((rows, 3, len(self.bodies), 4))
        for k, body in enumerate(self.bodies):
            body_poses[:, :, k] = poses[body][:, :3]
        transformed = (body_poses.reshape(3 * rows, -1) @ self._pose_matrix).reshape(rows, 3, -1)
        if not np.isfinite(transformed).all():  # a pose that is not finite only invalidates its own body
            is_invalid: BoolArray = np.asarray(~np.isfinite(body_poses).all(axis=(1, 3)))
            finite_poses = np.where(is_invalid[:, None, :, None], 0.0, body_poses)
            transformed = (finite_poses.reshape(3 * rows, -1) @ self._pose_matrix).reshape(rows, 3, -1)
            # body of each column: centres of capsules, axes of capsules, centres of balls
            column_body = np.concatenate([self.body_index, self.body_index, np.arange(len(self.bodies))])
            np.copyto(transformed, np.nan, where=is_invalid[:, None, column_body])
        ends = [len(self.solids), 2 * len(self.solids)]
        parts = np.split(np.swapaxes(transformed, 1, 2), ends, axis=1)
        centre, axis, ball = map(np.ascontiguousarray, parts)
        fixed = np.array([poses[box.body][0] for box in self.boxes]).reshape(-1, 4, 4)
        rotations, positions = np.moveaxis(body_poses[..., :3], 1, 2), np.moveaxis(body_poses[..., 3], 1, 2)
        return _Placement(rotations, positions, centre, axis, ball, fixed)

    @functools.cached_property
    def _pose_matrix(self) -> FloatArray:
        """Matrix (4 P, 2 S + P) from body poses to centres and axes of capsules and centres of balls.

        It is multiplied by rows of the poses of all bodies, side by side.
        """
        solids, bodies = len(self.solids), len(self.bodies)
        out = np.zeros((bodies, 4, 2 * solids + bodies))
        at = np.arange(solids)
        out[self.body_index, :3, at], out[self.body_index, 3, at] = self.centre, 1.0
        out[self.body_index, :3, solids + at] = self.axis
        at = np.arange(bodies)
        out[at, :3, 2 * solids + at], out[at, 3, 2 * solids + at] = self._bounding_balls[0], 1.0
        return out.reshape(4 * bodies, -1)

    def _solid_poses(self, placement: "_Placement", row: IndexArray, which: IndexArray) -> FloatArray:
        """Return the world poses (M, 4, 4) of the solids ``which`` (M,) in rows (M,)."""
        body = np.zeros((len(row), 4, 4))
        body[:, 3, 3] = 1.0
        moving = which < len(self.solids)
        at = row[moving], self.body_index[which[moving]]
        body[moving, :3, :3], body[moving, :3, 3] = placement.rotations[at], placement.positions[at]
        body[~moving] = placement.fixed[which[~moving] - len(self.solids)]
        return np.asarray(body @ self.poses_in_body[which])

    def _capsule_distances(
        self, placement: "_Placement", pairs: "_PlacedPairs", size: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Return vectors (M, 3) between the axes of capsules, and the distances (M,) of the capsules.

        ``size`` are the half lengths and radii.
        """
        row, a, b = pairs.row, pairs.first, pairs.other
        w = placement.centre[row, a] - placement.centre[row, b]
        # distance of capsules: that of their axes, minus both radii
        vector, _ = segment_vectors(w, placement.axis[row, a], placement.axis[row, b], size[0][a], size[0][b])
        return vector, lengths(vector) - size[1][a] - size[1][b]

    def _capsule_lower_bounds(
        self, placement: "_Placement", limit: float | FloatArray, pairs: "_PlacedPairs"
    ) -> FloatArray:
        """Return lower bounds (M,) of the distances of moving solids.

        These are the distances of their outer capsules. If they are below ``limit``, projections may raise
        them. ``limit`` is one value or (M,).
        """
        vector, gap = self._capsule_distances(placement, pairs, self.outer)
        touch = np.flatnonzero(gap < limit)
        gap[touch] = self._projected_bounds(placement, pairs.select(touch), vector[touch], gap[touch])
        return gap

    def _projected_bounds(
        self, placement: "_Placement", pairs: "_PlacedPairs", vector: FloatArray, gap: FloatArray
    ) -> FloatArray:
        """Return lower bounds (M,) of pairs from their capsules' distances and projections.

        ``vector`` (M, 3) and ``gap`` (M,) are the result of :meth:`_capsule_distances`.
        """
        at, first, second = pairs.row, pairs.first, pairs.other
        first_solid, second_solid = (
            (placement.rotations[at, self.body_index[k]] @ self.frame[k], self.support[k])
            for k in (first, second)
        )
        w = placement.centre[at, first] - placement.centre[at, second]
        return np.maximum(gap, separation(w, vector, first_solid, second_solid))

    def _merge_capsule_bounds(
        self, lower: FloatArray, placement: "_Placement", limit: float, pairs: "_PlacedPairs"
    ) -> None:
        """Lower the bounds ``lower`` (B,) in place to those of pairs of capsules, with :attr:`ease` added.

        The bounds are those of :meth:`_capsule_lower_bounds`. Projections, which take longer, only raise
        them. The smallest bound of each row is raised first, then only those that are still below it.
        """
        row = pairs.row
        vector, gap = self._capsule_distances(placement, pairs, self.outer)
        ease = self.ease[pairs.first, pairs.other]
        value, is_open = gap + ease, gap < limit
        order = np.lexsort((value, row))
        leading = order[np.diff(row[order], prepend=-1) != 0]
        for stage in (leading, None):
            selected = leading if stage is not None else np.flatnonzero(is_open & (value < lower[row]))
            selected = selected[is_open[selected]]
            if len(selected):
                bounds = self._projected_bounds(
                    placement, pairs.select(selected), vector[selected], gap[selected]
                )
                value[selected] = bounds + ease[selected]
            is_open[selected] = False
            settled = leading if stage is not None else np.arange(len(row))
            np.minimum.at(lower, row[settled], value[settled])

    def _close_capsules(self, placement: "_Placement", limit: float, rows: BoolArray) -> "_PlacedPairs":
        """Return the pairs of capsules whose bounding balls come within ``limit`` [m], in selected rows (B,).

        Balls around whole bodies are tested first.
        """
        selected_rows = np.flatnonzero(rows)
        body_pairs = self._body_pairs
        ball, centre = placement.ball[selected_rows], placement.centre[selected_rows]
        offset = ball[:, body_pairs.first] - ball[:, body_pairs.other]
        # balls: d >= |c1 - c2| - R1 - R2, first of whole bodies, then of capsules
        row, body_pair = np.nonzero(dots(offset, offset) < (body_pairs.reach + limit) ** 2)
        # each pair of bodies expands to all pairs of their capsules, which are consecutive in body_pairs.pair
        count = body_pairs.count[body_pair]
        row = np.repeat(row, count)
        pair = np.arange(len(row)) + np.repeat(body_pairs.start[body_pair] - np.cumsum(count) + count, count)
        pair = body_pairs.pair[pair]
        reach = self.outer[0] + self.outer[1]
        first, second = self.pairs[pair, 0], self.pairs[pair, 1]
        offset = centre[row, first] - centre[row, second]
        selected = np.flatnonzero(dots(offset, offset) < (reach[first] + reach[second] + limit) ** 2)
        selected = selected[np.argsort(row[selected] * len(self.pairs) + pair[selected])]
        return _PlacedPairs(selected_rows[row[selected]], first[selected], second[selected])

    @functools.cached_property
    def _bounding_balls(self) -> tuple[FloatArray, FloatArray]:
        """Balls around the solids of each of ``bodies``: centres (P, 3) in the body and radii (P,) [m].

        They rule out most pairs of bodies before any capsule is compared.
        """
        middle, radius = np.zeros((len(self.bodies), 3)), np.zeros(len(self.bodies))
        for k in range(len(self.bodies)):
            solids = np.flatnonzero(self.body_index == k)
            reach = (self.outer[0] + self.outer[1])[solids]
            # a capsule lies within its reach, half length + radius, of its centre
            low = (self.centre[solids] - reach[:, None]).min(axis=0)
            high = (self.centre[solids] + reach[:, None]).max(axis=0)
            middle[k] = 0.5 * (low + high)
            radius[k] = (lengths(self.centre[solids] - middle[k]) + reach).max()
        return middle, radius

    @functools.cached_property
    def _body_pairs(self) -> "_BodyPairs":
        """Pairs of moving bodies, each with the pairs of its capsules."""
        body = self.body_index[self.pairs]
        code = body[:, 0] * len(self.bodies) + body[:, 1]
        order = np.argsort(code, kind="stable")
        codes, start, count = np.unique(code[order], return_index=True, return_counts=True)
        first_body, other = np.divmod(codes, max(len(self.bodies), 1))
        radius = self._bounding_balls[1] + BALL_MARGIN_M
        return _BodyPairs(first_body, other, radius[first_body] + radius[other], start, count, order)

    def _close_boxes(self, placement: "_Placement", limit: float) -> "_CloseBoxes":
        """Return the pairs of a box and a capsule whose bounding ball comes within ``limit`` [m] of it.

        Consecutive rows are mostly close to each other. Groups of them are tested first, then single rows.
        """
        count = len(self.boxes)
        if not count or not len(self.box_pairs):
            no_indices, no_vectors = np.zeros(0, dtype=np.intp), np.zeros((0, 3))
            return _CloseBoxes(
                no_indices, no_indices, no_indices, no_vectors, no_vectors, no_vectors, np.zeros(0)
            )
        centre, axis = placement.centre, placement.axis
        pose = placement.fixed @ np.array([box.shape.pose for box in self.boxes])
        position, rotation = pose[:, :3, 3], pose[:, :3, :3]
        reach = self.outer[0] + self.outer[1]
        is_checked = np.zeros((len(reach), count), dtype=bool)
        is_checked[self.box_pairs[:, 0], self.box_pairs[:, 1]] = True
        first = np.arange(0, len(centre), ROW_GROUP_SIZE)
        low, high = (end.reduceat(centre, first, axis=0) for end in (np.minimum, np.maximum))
        middle = (0.5 * (low + high)).reshape(-1, 3)
        distance = _box_distance((middle - position[:, None]) @ rotation, self.half_sizes[:, None]).T.reshape(
            *low.shape[:2], count
        )
        # centres of a group are within half a diagonal of its middle m: d(c) >= d(m) - |high - low| / 2
        max_distance = reach + 0.5 * np.linalg.norm(high - low, axis=2) + limit
        # a group with a row that is not finite has no distances and may be close to everything
        group, solid, box = np.nonzero(is_checked & ~(distance >= max_distance[..., None]))
        row = (first[group][:, None] + np.arange(ROW_GROUP_SIZE)).ravel()
        solid, box = np.repeat(solid, ROW_GROUP_SIZE), np.repeat(box, ROW_GROUP_SIZE)
        exists = row < len(centre)
        row, solid, box = row[exists], solid[exists], box[exists]
        local = np.einsum("mc,mcd->md", centre[row, solid] - position[box], rotation[box])
        distance = _box_distance(local, self.half_sizes[box])
        kept = np.flatnonzero(distance < reach[solid] + limit)
        row, solid, box = row[kept], solid[kept], box[kept]
        along = np.einsum("mc,mcd->md", axis[row, solid], rotation[box])
        return _CloseBoxes(row, solid, box, local[kept], along, self.half_sizes[box], distance[kept])

    def _projected_box_bounds(self, placement: "_Placement", close_boxes: "_CloseBoxes") -> FloatArray:
        """Return lower bounds (M,) of distances of solids to boxes, as :func:`separation`.

        They help for a flat disc above a floor, whose capsule is a ball that reaches far into it.
        """
        pose = placement.fixed @ np.array([box.shape.pose for box in self.boxes]).reshape(-1, 4, 4)
        box_axes = pose[close_boxes.box][:, :3, :3]
        solid_axes = (
            placement.rotations[close_boxes.row, self.body_index[close_boxes.solid]]
            @ self.frame[close_boxes.solid]
        )
        half = np.concatenate([close_boxes.half, np.zeros((len(close_boxes.half), 2))], axis=1)
        offset = close_boxes.position - np.clip(close_boxes.position, -close_boxes.half, close_boxes.half)
        w, gap = (np.einsum("mab,mb->ma", box_axes, v) for v in (close_boxes.position, offset))
        return separation(w, gap, (solid_axes, self.support[close_boxes.solid]), (box_axes, half))

    def _merge_box_bounds(
        self, lower: FloatArray, placement: "_Placement", close_boxes: "_CloseBoxes", limit: float
    ) -> None:
        """Lower the bounds ``lower`` (B,) in place to those of solids and boxes, with :attr:`ease` added.

        Exact bounds are computed only as far as needed to find the smallest one of each row below ``limit``.
        The first stage computes that of the capsule whose ball is closest to a box. The second stage bounds
        the others by a few points of their axes and computes the probably closest. The third computes those
        that may still be closer.
        """
        ease = self._box_ease(close_boxes)
        # d >= d(centre) - half length - radius, then tighter bounds for the rest
        low = (
            close_boxes.distance - self.outer[0][close_boxes.solid] - self.outer[1][close_boxes.solid] + ease
        )
        for stage in range(3):
            close_boxes, low, ease = self._still_open(lower, close_boxes, low, ease, limit)
            if stage == 1:
                low = self._sampled_box_bounds(close_boxes)[0] + ease
                close_boxes, low, ease = self._still_open(lower, close_boxes, low, ease, limit)
            if not len(low):
                return
            row_min = np.full(len(lower), np.inf)
            np.minimum.at(row_min, close_boxes.row, low)
            is_computed = low == row_min[close_boxes.row] if stage < 2 else np.ones(len(low), dtype=np.bool_)
            selected, selected_ease = close_boxes.select(np.flatnonzero(is_computed)), ease[is_computed]
            value = self._capsule_box_distances(selected) + selected_ease
            # projections only raise a bound, so they are needed only where it would be the smallest
            is_low = np.flatnonzero(value < np.minimum(lower, limit)[selected.row])
            value[is_low] = np.maximum(
                value[is_low],
                self._projected_box_bounds(placement, selected.select(is_low)) + selected_ease[is_low],
            )
            np.minimum.at(lower, selected.row, value)
            close_boxes = close_boxes.select(np.flatnonzero(~is_computed))
            low, ease = low[~is_computed], ease[~is_computed]

    @staticmethod
    def _still_open(
        lower: FloatArray, close_boxes: "_CloseBoxes", low: FloatArray, ease: FloatArray, limit: float
    ) -> "tuple[_CloseBoxes, FloatArray, FloatArray]":
        """Return the pairs that may still be the smallest of their row, with their bounds and ease (M,)."""
        selected = np.flatnonzero(low < np.minimum(lower, limit)[close_boxes.row])
        return close_boxes.select(selected), low[selected], ease[selected]

    def _box_ease(self, close_boxes: "_CloseBoxes") -> FloatArray:
        """Return the distance (M,) [m] that is added to that of solids from their boxes."""
        return self.ease[close_boxes.solid, close_boxes.box + len(self.solids)]

    def _box_upper_bounds(self, close_boxes: "_CloseBoxes") -> FloatArray:
        """Return upper bounds (M,) of distances of inner capsules to boxes.

        They are infinite for boxes that contain a mesh.
        """
        out = np.full(len(close_boxes.row), np.inf)
        exact = np.flatnonzero(self.is_exact[close_boxes.box])
        selected = close_boxes.select(exact)
        out[exact] = (
            self._axis_sample_distances(selected, self.inner[0]).min(axis=1) - self.inner[1][selected.solid]
        )
        return out

    def _capsule_box_distances(self, close_boxes: "_CloseBoxes") -> FloatArray:
        """Return distances (M,) of outer capsules to boxes. Only the sign is valid if they overlap."""
        nearest = nearest_position_to_box(
            close_boxes.position, close_boxes.along, self.outer[0][close_boxes.solid], close_boxes.half
        )
        value = _box_distance(close_boxes.position + nearest[:, None] * close_boxes.along, close_boxes.half)
        return np.asarray(value - self.outer[1][close_boxes.solid])

    def _sampled_box_bounds(self, close_boxes: "_CloseBoxes") -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds (M,) [m] of the distances of outer capsules to boxes.

        They follow from the distances of a few points of the axes. Between two points the distance changes by
        at most the length between them.
        """
        # |d(s) - d(t)| <= |s - t|, so between two samples d >= (d1 + d2 - step) / 2
        value = self._axis_sample_distances(close_boxes, self.outer[0])
        step = 2.0 * self.outer[0][close_boxes.solid] / (AXIS_SAMPLES - 1)
        between = 0.5 * (value[:, 1:] + value[:, :-1] - step[:, None])
        radius = self.outer[1][close_boxes.solid]
        return between.min(axis=1) - radius, value.min(axis=1) - radius

    def _axis_sample_distances(self, close_boxes: "_CloseBoxes", length: FloatArray) -> FloatArray:
        """Return the distances (M, AXIS_SAMPLES) [m] of points on the axes of capsules to their boxes.

        ``length`` (S,) [m] are the half lengths of the axes.
        """
        t = length[close_boxes.solid][:, None] * np.linspace(-1.0, 1.0, AXIS_SAMPLES)
        return _box_distance(
            close_boxes.position[:, None] + t[..., None] * close_boxes.along[:, None],
            close_boxes.half[:, None],
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _Placement:
    """Solids placed in B configurations (rows).

    Attributes:
        rotations: Rotations of moving bodies (B, P, 3, 3).
        positions: Positions of moving bodies (B, P, 3).
        centre: Centres of the capsules (B, S, 3).
        axis: Axes of the capsules (B, S, 3).
        ball: Centres of the balls around bodies (B, P, 3).
        fixed: Poses of the bodies of fixed boxes (K, 4, 4).
    """

    rotations: FloatArray
    positions: FloatArray
    centre: FloatArray
    axis: FloatArray
    ball: FloatArray
    fixed: FloatArray

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.rotations)

    def select(self, rows: IndexArray) -> "_Placement":
        """Return a subset of the rows."""
        rotations, positions, centre, axis, ball = (
            array[rows] for array in (self.rotations, self.positions, self.centre, self.axis, self.ball)
        )
        return _Placement(rotations, positions, centre, axis, ball, self.fixed)


@dataclasses.dataclass(frozen=True, eq=False)
class _BodyPairs:
    """N pairs of moving bodies, with all M pairs of their capsules.

    Attributes:
        first: First bodies (N,).
        other: Second bodies (N,).
        reach: Sum of the radii of their balls (N,) [m].
        start: Position in ``pair`` of the first pair of capsules of these bodies (N,).
        count: Number of their pairs of capsules, which are consecutive in ``pair`` (N,).
        pair: Indices in ``ClearanceBounds.pairs``, sorted by bodies (M,).
    """

    first: IndexArray
    other: IndexArray
    reach: FloatArray
    start: IndexArray
    count: IndexArray
    pair: IndexArray


@dataclasses.dataclass(frozen=True, eq=False)
class _PlacedPairs:
    """Pairs of moving solids, each in one row of a placement.

    Attributes:
        row: Row (M,).
        first: First solid (M,).
        other: Second solid (M,).
    """

    row: IndexArray
    first: IndexArray
    other: IndexArray

    def select(self, selected: IndexArray) -> "_PlacedPairs":
        """Return a subset."""
        return _PlacedPairs(self.row[selected], self.first[selected], self.other[selected])


@dataclasses.dataclass(frozen=True, eq=False)
class _CloseBoxes:
    """M pairs of a capsule and a box that may be close, each in one row of a placement.

    Attributes:
        row: Row (M,).
        solid: Index of the capsule's solid (M,).
        box: Index of the box (M,).
        position: Centre of the capsule in the box's frame (M, 3) [m].
        along: Axis of the capsule in the box's frame (M, 3).
        half: Half size of the box (M, 3) [m].
        distance: Distance of the centre of the capsule from the box (M,) [m].
    """

    row: IndexArray
    solid: IndexArray
    box: IndexArray
    position: FloatArray
    along: FloatArray
    half: FloatArray
    distance: FloatArray

    def select(self, selected: IndexArray) -> "_CloseBoxes":
        """Return a subset."""
        return _CloseBoxes(*(getattr(self, field.name)[selected] for field in dataclasses.fields(self)))


def make_bounds(
    solids: Sequence[Solid],
    filtered: Sequence[tuple[str, str, str]],
    holder: str | None = None,
    moving_bases: Collection[str] = (),
) -> ClearanceBounds:
    """Return the bounds of a cell's solids.

    Boxes and meshes of bodies that stand still are compared as boxes, all other solids as capsules. Pairs of
    solids of one body and pairs of two such boxes are not compared.

    Args:
        solids: All collision solids.
        filtered: Pairs of bodies that are not checked, with reasons.
        holder: Arm that holds the stock, if any.
        moving_bases: Bodies whose pose differs from row to row.
    """
    skip = {frozenset(pair[:2]) for pair in filtered}
    is_stationary = [is_fixed(s.body, holder) and s.body not in moving_bases for s in solids]
    is_box = [
        stationary and s.shape.kind in ("box", "mesh")
        for stationary, s in zip(is_stationary, solids, strict=True)
    ]
    boxes = [s for s, boxed in zip(solids, is_box, strict=True) if boxed]
    capsule_sizes = [_enclosing_capsules(s) for s, boxed in zip(solids, is_box, strict=True) if not boxed]
    capsules = tuple(_as_box(s) for s, boxed in zip(solids, is_box, strict=True) if not boxed)
    pairs = [
        (a, b)
        for a, capsule in enumerate(capsules)
        for b, other in enumerate(capsules[a + 1 :], start=a + 1)
        if capsule.body != other.body and frozenset((capsule.body, other.body)) not in skip
    ]
    box_pairs = [
        (a, b)
        for a, capsule in enumerate(capsules)
        for b, other in enumerate(boxes)
        if capsule.body != other.body and frozenset((capsule.body, other.body)) not in skip
    ]
    bodies = tuple(dict.fromkeys(s.body for s in capsules))
    boxes_without_meshes = [_as_box(s) for s in boxes]
    all_solids = [s for s, boxed in zip(solids, is_box, strict=True) if not boxed] + boxes
    return ClearanceBounds(
        all_solids=tuple(all_solids),
        poses_in_body=np.array([solid.shape.pose for solid in all_solids]).reshape(-1, 4, 4),
        cores=make_cores(all_solids),
        ease=np.zeros((len(all_solids), len(all_solids))),
        solids=capsules,
        bodies=bodies,
        body_index=np.array([bodies.index(s.body) for s in capsules], dtype=np.intp),
        centre=np.array([s.shape.pose[:3, 3] for s in capsules]),
        axis=np.array(
            [s.shape.pose[:3, :3] @ size[0] for s, size in zip(capsules, capsule_sizes, strict=True)]
        ),
        outer=(np.array([size[1] for size in capsule_sizes]), np.array([size[2] for size in capsule_sizes])),
        inner=(np.array([size[3] for size in capsule_sizes]), np.array([size[4] for size in capsule_sizes])),
        frame=np.array([s.shape.pose[:3, :3] for s in capsules]),
        support=np.array([support_sizes(s) for s in capsules]),
        boxes=tuple(boxes_without_meshes),
        is_exact=np.array([s.shape.kind == "box" for s in boxes], dtype=bool),
        half_sizes=np.array([0.5 * np.asarray(s.shape.size) for s in boxes_without_meshes]).reshape(-1, 3),
        pairs=np.array(pairs, dtype=np.intp).reshape(-1, 2),
        box_pairs=np.array(box_pairs, dtype=np.intp).reshape(-1, 2),
    )


def _as_box(solid: Solid) -> Solid:
    """Return a mesh as the box around it, in the axes of its own frame; other solids unchanged."""
    if solid.shape.vertices is None:
        return solid
    low, high = solid.shape.vertices.min(axis=0), solid.shape.vertices.max(axis=0)
    pose = solid.shape.pose @ from_parts(np.eye(3), 0.5 * (low + high))
    size = (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2]))
    return Solid(
        solid.body, dataclasses.replace(solid.shape, kind="box", size=size, pose=pose, vertices=None)
    )


def _enclosing_capsules(solid: Solid) -> tuple[FloatArray, float, float, float, float]:
    """Return the capsule that contains a solid and the capsule inside it, which have the same axis.

    Returns:
        Axis (3,) in the shape's frame, half length and radius [m] of the outer capsule, half length and
        radius [m] of the inner one. The inner radius is -inf for a mesh, whose inside is unknown.
    """
    kind = solid.shape.kind
    if kind in ("sphere", "capsule"):
        half = 0.5 * solid.shape.size[1] if kind == "capsule" else 0.0
        return np.array([0.0, 0.0, 1.0]), half, solid.shape.size[0], half, solid.shape.size[0]
    if kind == "cylinder":
        radius, half = solid.shape.size[0], 0.5 * solid.shape.size[1]
        axis, thin = np.array([0.0, 0.0, 1.0]), min(radius, half)
    else:
        size = 0.5 * bounding_size(_as_box(solid))
        order = np.argsort(size)
        axis = np.eye(3)[order[2]]
        half, radius = float(size[order[2]]), float(np.hypot(size[order[0]], size[order[1]]))
        thin = float(size[order[0]]) if kind == "box" else -np.inf
    # Around: the rim of a body of half length h and radius r is hypot(r, h - a) from the end of an axis of
    # half length a. The axis ends 0.4 r before the end of the body. Inside: a capsule of the smallest half
    # size, as long as the body.
    around = max(0.0, half - 0.4 * radius)
    return axis, around, float(np.hypot(radius, half - around)), max(0.0, half - max(thin, 0.0)), thin


def _box_distance(points: FloatArray, half: FloatArray) -> FloatArray:
    """Return signed distances (...,) of points (..., 3) to boxes about the origin of half sizes (..., 3)."""
    x, y, z = (np.abs(points[..., i]) - half[..., i] for i in range(3))
    inside = np.minimum(np.maximum(np.maximum(x, y), z), 0.0)
    x, y, z = np.maximum(x, 0.0), np.maximum(y, 0.0), np.maximum(z, 0.0)
    return np.asarray(np.sqrt(x * x + y * y + z * z) + inside)
