"""Placement search: stock and base poses at which the whole job is reachable with the best margin.

It finds a stock pose, and poses of movable bases. The search is seeded and goes from coarse to fine over few
targets and few samples, batched over candidates. It starts from random and heuristic candidates, followed by
generations of shrinking steps around the best. Candidates with round coordinates, at which people can clamp
the stock, are refined from the best ones and preferred if their margin is almost as large. Collisions are
checked last, on the best candidates.

A candidate is searched as a point (P,) of coordinates: x, y, z [m] and yaw [rad] of the stock, a rotation
vector (3,) [rad] if the attitude of the stock is free, and for each movable base its shift x, y [m] and its
yaw [rad].
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.cell import clearance, support
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, IndexArray, IntArray, exp_rotation, from_parts, log_rotation
from planner.geometry.units import DEG
from planner.motion.placement_margin import branch_margins, choice_scores, max_free_targets, placement_margin
from planner.motion.planning_scene import Chain, Scene
from planner.motion.search.subsampling import SampledTargets, are_long_slides, sample_coarsely, sample_finely
from planner.problem import Cell, Settings, Stock
from planner.targets import Targets

INITIAL_CANDIDATES: Final = 384
"""Number of candidates in the first generation, drawn from a fixed seed."""
SEARCH_GENERATIONS: Final = 7
"""Number of generations, each drawn closer to the best candidates."""
PARENTS_PER_GENERATION: Final = 8
"""Number of best candidates from which the next generation starts."""
CHILDREN_PER_PARENT: Final = 10
"""Number of candidates drawn around each parent."""
MAX_CHECKED_CANDIDATES: Final = 60
"""Number of distinct candidates per group. Twice as many at most are checked for collisions."""

MAX_FREE_CANDIDATES: Final = 6
"""Number of collision-free candidates at which the search ends."""
MAX_QUICK_CANDIDATES: Final = 12
"""Maximum number of candidates of the first generation that the quick check tries."""
QUICK_FREE_CANDIDATES: Final = 2
"""Number of collision-free candidates at which the quick check ends."""
MAX_FREEST_CANDIDATES: Final = 3
"""Number of candidates that are kept if none is free at all sampled targets."""
MIN_RETRY_FRACTION: Final = 0.5
"""Minimum fraction of free targets of a candidate for the retry, which runs if no candidate is free.

The retry uses more samples and all branches.
"""
RETRY_TARGETS: Final = 60
"""Number of targets of an operation in the retry. In confined cells a few targets are not representative."""
RETRY_PARENTS: Final = 4
"""Number of candidates with the most free targets from which a generation of the retry starts."""
RETRY_CHILDREN: Final = 5
"""Number of candidates drawn around each parent in the retry."""
RETRY_GENERATIONS: Final = 2
"""Number of generations of the retry, each drawn closer to the parents."""
RETRY_FREE_CANDIDATES: Final = 3
"""Number of free candidates at which the retry ends."""
COARSE_TARGETS: Final = 10
"""Number of targets of an operation for the first comparison of candidates."""
FINE_TARGETS: Final = 20
"""Number of targets of an operation for the comparison of the best candidates."""
QUARTER_TURN_RAD: Final = 0.5 * np.pi
"""A quarter of a turn [rad]."""
SIDE_UP_ROTATIONS: Final = np.array(
    [
        [0, 0, 0],
        [QUARTER_TURN_RAD, 0, 0],
        [-QUARTER_TURN_RAD, 0, 0],
        [0, QUARTER_TURN_RAD, 0],
        [0, -QUARTER_TURN_RAD, 0],
        [np.pi, 0, 0],
    ],
    dtype=np.float64,
)
"""Rotation vectors [rad] that bring each of the six sides of a held stock to the top."""

POSITION_INCREMENT_M: Final = 0.005
"""Increment [m] of round positions."""

ROTATION_INCREMENT_RAD: Final = np.deg2rad(15.0)
"""Increment [rad] of round rotations. Quarter turns relative to a base are preferred."""

ROTATION_INCREMENT_WORTH: Final = ((QUARTER_TURN_RAD, 0.98), (ROTATION_INCREMENT_RAD, 0.985))
"""Increments [rad] of rotations, each with a fraction of the best margin. A candidate with such a rotation is
preferred if its margin is at least this fraction of that of other candidates.
"""

SNAPPED_GENERATIONS: Final = 3
"""Number of generations of candidates with round coordinates."""
SNAPPED_CHILDREN: Final = 6
"""Number of candidates with round coordinates drawn around each parent."""

POSE_TOLERANCE: Final = 1e-6
"""Maximum difference [-, m] of the entries of two poses that count as equal."""

MIN_CANDIDATE_DISTANCE_M: Final = 0.08
"""Minimum distance [m, or rad of yaw times 0.3 m] between candidates that are tried one after the other."""


@dataclasses.dataclass(frozen=True)
class PlacementCandidate:
    """A candidate of the placement search.

    Attributes:
        stock: (4, 4) stock pose in the world.
        bases: {arm: (4, 4)} base poses in the world.
        score: Smallest margin [rad].
        number: Index of the candidate in the trace.
    """

    stock: FloatArray
    bases: dict[str, FloatArray]
    score: float
    number: int


def _select_freest(
    scored: Sequence[tuple[float, PlacementCandidate]],
) -> tuple[tuple[float, PlacementCandidate], ...]:
    """Select the candidates with the largest fraction of free targets, at most :data:`MAX_FREEST_CANDIDATES`.

    They are tried, or explained to the user, if no candidate is free at all sampled targets. ``scored`` are
    candidates with this fraction. Candidates without any free target are left out. Of those with equal
    fractions, earlier ones come first.
    """
    return tuple(
        sorted((item for item in scored if item[0]), key=lambda item: -item[0])[:MAX_FREEST_CANDIDATES]
    )


@dataclasses.dataclass(frozen=True)
class PlacementTrace:
    """All candidates of a search.

    Attributes:
        positions: (K, 3) [m] stock positions.
        score: (K,) [rad] smallest margins.
        freest: Candidates with the largest fraction of targets with a free posture, largest first, each with
            this fraction. It is empty if candidates were not checked for collisions.
    """

    positions: FloatArray
    score: FloatArray
    freest: tuple[tuple[float, PlacementCandidate], ...] = ()

    def extended(self, other: "PlacementTrace") -> "PlacementTrace":
        """Return this trace followed by the candidates of another one."""
        positions = np.concatenate([self.positions, other.positions])
        score = np.concatenate([self.score, other.score])
        return PlacementTrace(positions, score, _select_freest([*self.freest, *other.freest]))

    def metrics(self, chosen: int | None) -> dict[str, Any]:
        """Return the search as data for the report, with scores in degrees.

        Args:
            chosen: Index of the candidate that the plan uses; None if it uses none.

        Returns:
            Report data. The score of an infeasible candidate is NaN.
        """
        score = np.where(self.score > 0.0, self.score / DEG, np.nan)
        return {
            "positions": self.positions,
            "score": score,
            "chosen": chosen,
            "unit": "deg",
            "name": "smallest margin to limits and singularities",
        }


@dataclasses.dataclass(frozen=True)
class PlacementJob:
    """An operation on the stock that is placed.

    Attributes:
        cell: Cell with the tools of the operation.
        targets: Targets of the operation.
    """

    cell: Cell
    targets: Targets


class PlacementSearch:
    """Placement search for one cell and the targets of all operations on one stock."""

    def __init__(
        self,
        stock: Stock,
        jobs: Sequence[PlacementJob],
        settings: Settings,
        start: FloatArray | None = None,
        in_air: bool = False,
    ) -> None:
        """Prepare the search.

        Args:
            stock: Stock to place.
            jobs: Operations on the stock. Their cells differ in tools only.
            settings: Margins and seed.
            start: (4,) first guess x, y, z [m] and yaw [rad], around which some candidates lie.
            in_air: Whether a support, or a stock without one, may end above the floor.
        """
        cell = jobs[0].cell
        self._cell, self._stock, self._jobs, self._settings = cell, stock, jobs, settings
        self._movable = tuple(arm for arm in cell.arms if arm.base_auto)
        self._rng = np.random.default_rng(settings.seed)
        self._stock_fixed = stock.place is not None
        self._stock_tilts = stock.is_attitude_free
        self._stock_columns = 7 if self._stock_tilts else 4
        self._start = start
        has_free_height = not self._stock_fixed and stock.held_by is None and stock.sheet is None
        self._levels = support.stock_heights(cell, stock) if has_free_height else np.zeros(0)
        self._needs_support = has_free_height and bool(stock.support) and not in_air
        self._ground = support.SupportGround.of(cell)
        # no support is stated: the stock rests on what is below it, if that is more than the floor
        rests_freely = has_free_height and not stock.support and stock.pedestal is None and not in_air
        self._rests_on_ground = rests_freely and self._ground.has_bearing_bodies
        self._excluded_quarters: set[int] = set()
        self._checked: list[tuple[float, FloatArray]] = []
        self._failure_counts: dict[int, IntArray] = {}
        self._sample_targets(with_slides=False)

    def _sample_targets(self, with_slides: bool) -> None:
        """Choose the sampled targets with which all candidates are scored.

        Few targets of each operation serve for the first comparison, more for that of the best candidates.
        ``with_slides`` says whether long slides are sampled, not only kept at their middle.
        """
        self._coarse = [sample_coarsely(j.cell, j.targets, COARSE_TARGETS, with_slides) for j in self._jobs]
        self._fine = [sample_coarsely(j.cell, j.targets, FINE_TARGETS, with_slides) for j in self._jobs]

    @functools.cached_property
    def _retry_sample(self) -> list[SampledTargets]:
        return [sample_finely(job.cell, job.targets, RETRY_TARGETS) for job in self._jobs]

    @property
    def _has_long_slides(self) -> bool:
        """Whether any operation has long slides, which are sampled only if nothing else is reachable."""
        return any(are_long_slides(job.targets).any() for job in self._jobs)

    def run(self, models: Sequence[CellModel] = ()) -> tuple[list[PlacementCandidate], PlacementTrace]:
        """Search for stock poses.

        If no pose is reachable with sliding freedoms at their middle, these are sampled as well, which is
        slower. If all of the best candidates collide, the search continues among the other quarters of yaw,
        because the best candidates often lie in the same quarter.

        Args:
            models: Collision models of the operations. Without them collisions are not checked.

        Returns:
            Candidates in the order in which to try them, empty if none is reachable; and the trace.
        """
        candidates, trace, quarters = self._search_generations(models)
        if not candidates and not trace.score.max() > 0.0 and self._has_long_slides:
            self._sample_targets(with_slides=True)
            candidates, trace, quarters = self._search_generations(models)
        while not candidates and not self._stock_fixed and quarters - self._excluded_quarters:
            self._excluded_quarters |= quarters
            candidates, more_trace, quarters = self._search_generations(models)
            candidates = [dataclasses.replace(p, number=p.number + len(trace.score)) for p in candidates]
            trace = trace.extended(more_trace)
        if not candidates and models:
            self._excluded_quarters = set()
            candidates, trace = self._retry_freest(models, trace)
        return candidates, trace

    def _retry_freest(
        self, models: Sequence[CellModel], trace: PlacementTrace
    ) -> tuple[list[PlacementCandidate], PlacementTrace]:
        """Search around the candidates with most free targets, with all branches and more samples.

        Poses with the largest joint margins often leave little space between bodies, so candidates that are
        nearly free are worth another search.

        Returns:
            Free candidates, largest margin first, and the trace extended by all candidates that were checked.
        """
        nearly_free = sorted(
            (scored_point for scored_point in self._checked if scored_point[0] >= MIN_RETRY_FRACTION),
            key=lambda scored_point: -scored_point[0],
        )
        if not nearly_free:
            return [], trace
        points = self._snap_if_clamped(np.stack([point for _, point in nearly_free]))
        points = points[self._select_distinct(points, RETRY_PARENTS)]
        spread = self._step_sizes()
        # points that were checked, with their scores and their fractions of free targets
        all_points, scores, fractions = points[:0], np.zeros(0), np.zeros(0)
        # generation 0 are the nearly free points themselves, later ones take smaller and smaller steps
        for generation in range(RETRY_GENERATIONS + 1):
            if generation:
                parents = all_points[np.argsort(-fractions, kind="stable")[:RETRY_PARENTS]]
                steps = self._rng.normal(size=(len(parents), RETRY_CHILDREN, all_points.shape[1])) * spread
                points = self._snap_if_clamped(
                    (parents[:, None] + steps * 0.7**generation).reshape(-1, steps.shape[2])
                )
            for point, score in zip(points, self._score(points, self._fine), strict=True):
                if score > 0.0 and (fractions == 1.0).sum() < RETRY_FREE_CANDIDATES:
                    fraction = self._free_fraction(
                        models, self._candidate(point, score, 0), self._retry_sample
                    )
                    all_points, scores = np.concatenate([all_points, point[None]]), np.append(scores, score)
                    fractions = np.append(fractions, fraction)
            if not len(all_points) or (fractions == 1.0).sum() >= RETRY_FREE_CANDIDATES:
                break
        first_number = len(trace.score)
        if not len(all_points):
            return [], trace
        checked = [
            (fraction, self._candidate(all_points[k], float(scores[k]), first_number + k))
            for k, fraction in enumerate(fractions.tolist())
        ]
        positions = np.stack([candidate.stock[:3, 3] for _, candidate in checked])
        free_candidates = sorted(
            (candidate for fraction, candidate in checked if fraction == 1.0),
            key=lambda candidate: -candidate.score,
        )
        extended_trace = trace.extended(PlacementTrace(positions, scores))
        return free_candidates, dataclasses.replace(
            extended_trace, freest=_select_freest(checked) or trace.freest
        )

    def quick_candidates(self, models: Sequence[CellModel]) -> Iterator[PlacementCandidate]:
        """Yield candidates of the first generation with free postures at a few targets, best first.

        There may be none although :meth:`run` finds some.
        """
        points = self._initial_points()
        scores = self._score(points, self._coarse)
        free_count = 0
        for k in self._best_distinct(points, scores)[:MAX_QUICK_CANDIDATES]:
            candidate = self._candidate(points[k], float(scores[k]), k)
            if self._free_fraction(models, candidate) == 1.0:
                yield candidate
                free_count += 1
            if free_count == QUICK_FREE_CANDIDATES:
                return

    def evaluate(
        self, stock: FloatArray, bases: Mapping[str, FloatArray], models: Sequence[CellModel]
    ) -> PlacementCandidate | str:
        """Evaluate a known stock pose as this search does: on its support, with its margin.

        Args:
            stock: (4, 4) stock pose.
            bases: {arm: (4, 4)} poses of movable bases.
            models: Collision models of the operations.

        Returns:
            The candidate, or the reason why it is not feasible.
        """
        point = self._point_of(stock, bases)
        if point is None:
            return "the stock has a different orientation there"
        score = float(self._score(point[None], self._fine)[0])
        if score <= 0.0 and self._has_long_slides:
            self._sample_targets(with_slides=True)
            score = float(self._score(point[None], self._fine)[0])
        if score <= 0.0:
            return "not all targets are reachable there with all margins"
        candidate = self._candidate(point, score, 0)
        is_free = any(
            self._free_fraction(models, candidate, sampled) == 1.0
            for sampled in (self._coarse, self._retry_sample)
        )
        return candidate if is_free else "bodies are too close to each other there"

    def _search_generations(
        self, models: Sequence[CellModel]
    ) -> tuple[list[PlacementCandidate], PlacementTrace, set[int]]:
        """Run all generations of the search, outside the yaw quarters that are excluded.

        Returns:
            Candidates in the order in which to try them (only free ones if there are models), the trace, and
            the yaw quarters 0 to 3 of the best candidates.
        """
        # Generations of shrinking steps around the best candidates, scored at few targets.
        points = self._initial_points()
        scores = self._score(points, self._coarse)
        point_parts, score_parts = [points], [scores]
        spread = self._step_sizes()
        for generation in range(SEARCH_GENERATIONS):  # each with 0.55 times the steps of the previous one
            best = np.argsort(-scores, kind="stable")[:PARENTS_PER_GENERATION]
            points, scores = points[best], scores[best]
            step_sizes = spread * 0.55**generation
            steps = self._rng.normal(size=(len(points), CHILDREN_PER_PARENT, points.shape[1])) * step_sizes
            children = (points[:, None] + steps).reshape(-1, points.shape[1])
            child_scores = self._score(children, self._coarse)
            point_parts.append(children)
            score_parts.append(child_scores)
            points, scores = np.concatenate([points, children]), np.concatenate([scores, child_scores])
        # groups of points, scores and the fraction of the best score at which a point of the group wins
        groups = [(np.concatenate(point_parts), np.concatenate(score_parts), 1.0)]
        if not self._stock_fixed and self._stock.held_by is None:
            groups += [
                (*self._search_snapped(*groups[0][:2], step), worth)
                for step, worth in ROTATION_INCREMENT_WORTH
            ]
        # Score the finalists of each group at more targets. Round coordinates win at a slightly lower score.
        all_points = np.concatenate([g[0] for g in groups])
        all_scores = np.concatenate([g[1] for g in groups])
        ranked: list[tuple[float, PlacementCandidate]] = []
        quarters: set[int] = set()
        first_number = 0
        for points, scores, worth in groups:
            finalists = self._best_distinct(points, scores)
            quarters |= set(_yaw_quarters(points[finalists]).tolist())
            fine_scores = self._score(points[finalists], self._fine)
            ranked += [
                (-s / worth, self._candidate(points[k], float(s), first_number + k))
                for k, s in zip(finalists, fine_scores.tolist(), strict=True)
                if s > 0.0
            ]
            first_number += len(points)
        ranked.sort(key=lambda item: item[0])
        ordered = [candidate for _, candidate in ranked]
        trace = PlacementTrace(self._stock_poses(all_points)[:, :3, 3], all_scores)
        # Check collisions in that order until enough candidates are free.
        if models:
            to_check, ordered = ordered[: 2 * MAX_CHECKED_CANDIDATES], []
            fractions: list[tuple[float, PlacementCandidate]] = []
            for candidate in to_check:
                fraction = self._free_fraction(models, candidate)
                fractions.append((fraction, candidate))
                if fraction == 1.0:
                    ordered.append(candidate)
                if len(ordered) == MAX_FREE_CANDIDATES:
                    break
            trace = dataclasses.replace(trace, freest=_select_freest(fractions))
            self._checked += [(fraction, all_points[candidate.number]) for fraction, candidate in fractions]
        return ordered, trace, quarters

    def _search_snapped(
        self, points: FloatArray, scores: FloatArray, step: float
    ) -> tuple[FloatArray, FloatArray]:
        """Search points with round coordinates, starting from the best of given points.

        Args:
            points: (K, P) points.
            scores: (K,) [rad] scores of the points.
            step: Increment [rad] of rotations.

        Returns:
            All points that were evaluated, and their scores [rad].
        """
        points = self._snap(points[np.argsort(-scores, kind="stable")[:PARENTS_PER_GENERATION]], step)
        scores = self._score(points, self._coarse)
        point_parts, score_parts = [points], [scores]
        for generation in range(SNAPPED_GENERATIONS):
            best = np.argsort(-scores, kind="stable")[:PARENTS_PER_GENERATION]
            # smaller steps than those of the first search, because the parents are good already
            step_sizes = 0.3 * self._step_sizes() * 0.5**generation
            steps = self._rng.normal(size=(len(best), SNAPPED_CHILDREN, points.shape[1])) * step_sizes
            children = (points[best][:, None] + steps).reshape(-1, points.shape[1])
            children = np.unique(self._snap(children, step), axis=0)
            child_scores = self._score(children, self._coarse)
            point_parts.append(children)
            score_parts.append(child_scores)
            points = np.concatenate([points[best], children])
            scores = np.concatenate([scores[best], child_scores])
        return np.concatenate(point_parts), np.concatenate(score_parts)

    def _snap_if_clamped(self, points: FloatArray) -> FloatArray:
        """Snap points (K, P) to round coordinates if a person clamps the stock; else return them."""
        is_clamped_by_hand = not self._stock_fixed and self._stock.held_by is None
        return self._snap(points, ROTATION_INCREMENT_RAD) if is_clamped_by_hand else points

    def _snap(self, points: FloatArray, step: float) -> FloatArray:
        """Snap points (K, P) to round coordinates.

        The stock's yaw relative to the first arm's base becomes a multiple of ``step``. One corner gets a
        round x and y from that base, and the underside a round height above the floor. Bases are snapped in
        the same way.
        """
        base = self._cell.arms[0].base
        heading = float(np.arctan2(base[1, 0], base[0, 0]))
        axes = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        out = points.copy()
        out[:, 3] = heading + np.round((points[:, 3] - heading) / step) * step
        for k in range(len(self._movable)):
            column = self._stock_columns + 3 * k
            out[:, column : column + 2] = (
                np.round(points[:, column : column + 2] / POSITION_INCREMENT_M) * POSITION_INCREMENT_M
            )
            out[:, column + 2] = np.round(points[:, column + 2] / step) * step
        # Move each stock so that its corner is round in the axes of the base, and its underside in height. On
        # a pedestal or on bodies below it, the height is not free and stays.
        for row in out:
            pose = self._stock_pose(row)
            corner = (pose @ np.append(self._stock.lower, 1.0))[:3]
            in_base_axes = axes.T @ (corner[:2] - base[:2, 3])
            row[:2] += axes @ (
                np.round(in_base_axes / POSITION_INCREMENT_M) * POSITION_INCREMENT_M - in_base_axes
            )
            underside_height = float(support.underside(self._stock, pose[None])[0]) - self._ground.floor
            row[2] = pose[2, 3] + (
                0.0
                if len(self._levels) or self._rests_on_ground
                else np.round(underside_height / POSITION_INCREMENT_M) * POSITION_INCREMENT_M
                - underside_height
            )
        return out

    def _initial_points(self) -> FloatArray:
        """Draw the random points (K, P) of the first generation within the arms' reach.

        The edges of the stock are parallel to the world axes for half of them. A third lies close to the
        middle of the bases, and another third around the first guess if there is one. Movable bases are
        shifted and rotated at random, except in the first sixth of the points, where they stay as stated. A
        stock whose pose is stated does not move.
        """
        centre = np.mean([arm.base[:3, 3] for arm in self._cell.arms], axis=0)
        reach = max(Chain.of(arm).robot.reach for arm in self._cell.arms)
        count = INITIAL_CANDIDATES
        if self._stock_fixed:
            columns = [np.zeros((count, 4))]
        else:
            positions = centre + self._rng.uniform(
                [-reach, -reach, -0.3 * reach], [reach, reach, 1.2 * reach], (count, 3)
            )
            # a third of the points moves to a quarter of its horizontal distance from the middle of the bases
            positions[: count // 3, :2] = centre[:2] + 0.25 * (positions[: count // 3, :2] - centre[:2])
            yaw = self._rng.uniform(-np.pi, np.pi, count)
            yaw[::2] = np.round(yaw[::2] / (np.pi / 2.0)) * (np.pi / 2.0)
            if self._start is not None:
                rows_near_start = slice(2 * count // 3, count)
                positions[rows_near_start] = self._start[:3] + 0.1 * self._rng.normal(
                    size=positions[rows_near_start].shape
                )
                yaw[rows_near_start] = self._start[3]
            columns = [np.column_stack([positions, yaw])]
            if self._stock_tilts:
                tilts = self._rng.uniform(-np.pi, np.pi, (count, 3))
                tilts[::2] = self._rng.choice(SIDE_UP_ROTATIONS, len(tilts[::2]))
                columns.append(tilts)
        for _ in self._movable:
            shift = self._rng.uniform(-0.5 * reach, 0.5 * reach, (count, 2))
            # whole quarter turns, no rotation twice as often, with some scatter
            base_yaw = self._rng.choice([-np.pi / 2.0, 0.0, 0.0, np.pi / 2.0, np.pi], count)
            columns.append(np.column_stack([shift, base_yaw + 0.2 * self._rng.normal(size=count)]))
            columns[-1][: count // 6] = 0.0
        return np.concatenate(columns, axis=1)

    def _step_sizes(self) -> FloatArray:
        """Return the standard deviations (P,) [m, rad] of the steps of the first generation."""
        stock = [0.0] * 4 if self._stock_fixed else [0.2, 0.2, 0.15, 0.4]
        tilt = [0.3] * 3 if self._stock_tilts else []
        return np.array(stock + tilt + [0.2, 0.2, 0.3] * len(self._movable))

    def _stock_pose(self, point: FloatArray) -> FloatArray:
        return np.asarray(self._stock_poses(point[None])[0])

    def _stock_poses(self, points: FloatArray) -> FloatArray:
        """Return the stock poses (K, 4, 4) in the world of points (K, P).

        The height is that of the nearest available pedestal if one is made. Without a support the stock is
        lowered or raised to what is below it, unless only the floor is.
        """
        if self._stock.place is not None:
            return np.repeat(self._stock.place[None], len(points), axis=0)
        yaw_vectors = np.zeros((len(points), 3))
        yaw_vectors[:, 2] = points[:, 3]
        rotations = exp_rotation(yaw_vectors)
        rotations = rotations @ (exp_rotation(points[:, 4:7]) if self._stock_tilts else self._stock.attitude)
        poses = from_parts(rotations, points[:, :3])
        if len(self._levels):
            poses[:, 2, 3] = self._levels[np.abs(self._levels - points[:, 2:3]).argmin(axis=1)]
        if self._rests_on_ground:
            poses[:, 2, 3] -= support.support_gap(self._ground, self._stock, poses)
        return poses

    def _candidate(self, point: FloatArray, score: float, number: int) -> PlacementCandidate:
        return PlacementCandidate(self._stock_pose(point), self._bases(point), score, number)

    def _bases(self, point: FloatArray) -> dict[str, FloatArray]:
        """Return the base poses {arm: (4, 4)} in the world of a point (P,).

        Bases are translated along world x and y, and rotated about a vertical axis through their origin.
        """
        out = {}
        for k, arm in enumerate(self._movable):
            dx, dy, yaw = point[self._stock_columns + 3 * k : self._stock_columns + 3 * k + 3]
            pose = arm.base.copy()
            pose[:3, :3] = exp_rotation(np.array([0.0, 0.0, yaw])) @ pose[:3, :3]
            pose[:2, 3] += (dx, dy)
            out[arm.name] = pose
        return out

    def _point_of(self, stock: FloatArray, bases: Mapping[str, FloatArray]) -> FloatArray | None:
        """Return the point (P,) for which :meth:`_stock_pose` and :meth:`_bases` return these poses.

        Returns None if the rotation of the stock is not one that this search can produce.
        """
        columns = [np.zeros(4)]
        if not self._stock_fixed:
            rotation = stock[:3, :3] @ self._stock.attitude.T
            yaw = 0.0 if self._stock_tilts else float(np.arctan2(rotation[1, 0], rotation[0, 0]))
            columns = [np.append(stock[:3, 3], yaw)]
            if self._stock_tilts:
                columns.append(log_rotation(stock[:3, :3]))
            elif np.abs(rotation - exp_rotation(np.array([0.0, 0.0, yaw]))).max() > POSE_TOLERANCE:
                return None
        for arm in self._movable:
            rotation = bases[arm.name][:3, :3] @ arm.base[:3, :3].T
            offset = bases[arm.name][:2, 3] - arm.base[:2, 3]
            columns.append(np.append(offset, np.arctan2(rotation[1, 0], rotation[0, 0])))
        return np.concatenate(columns)

    def _score(self, points: FloatArray, sampled: Sequence[SampledTargets]) -> FloatArray:
        """Score points (K, P) by the smallest margin (K,) [rad] of all sampled targets on the best branches.

        The job with the smallest margin counts. A score of at most 0 means that a target is out of reach or
        violates a margin, or that a required support does not reach the ground. The score is -inf in an
        excluded yaw quarter.
        """
        out = np.full(len(points), -np.inf)
        queried = np.flatnonzero(~np.isin(_yaw_quarters(points), list(self._excluded_quarters)))
        for first in range(0, len(queried), 64):  # batches bound the memory
            rows = queried[first : first + 64]
            batch = points[rows]
            stock = self._stock_poses(batch)[:, None]
            base_poses = [self._bases(point) for point in batch]
            bases = {
                a.name: np.array([poses[a.name] for poses in base_poses])[:, None] for a in self._movable
            }
            scores = [placement_margin(targets, stock, bases, self._settings) for targets in sampled]
            out[rows] = np.min(scores, axis=0)
            if self._needs_support:  # a support that does not reach the ground carries nothing
                air_gap = (
                    support.support_gap(self._ground, self._stock, stock[:, 0]) - support.MAX_FOOT_HEIGHT_M
                )
                out[rows] = np.where(air_gap > 1e-9, np.minimum(out[rows], -1.0 - air_gap), out[rows])
        return out

    def _best_distinct(self, points: FloatArray, scores: FloatArray) -> list[int]:
        """Return indices of reachable candidates that differ sufficiently, best first.

        There are at most :data:`MAX_CHECKED_CANDIDATES`.
        """
        order = np.argsort(-scores, kind="stable")
        order = order[scores[order] > 0.0]
        return [int(order[k]) for k in self._select_distinct(points[order], MAX_CHECKED_CANDIDATES)]

    def _select_distinct(self, points: FloatArray, max_count: int) -> list[int]:
        """Return up to ``max_count`` indices of points (K, P) that differ sufficiently, lowest first.

        A point is left out if all its coordinates are close to those of an earlier point. Angles count with
        a lever of 0.3 m.
        """
        out: list[int] = []
        tilt_weights = [0.3] * (self._stock_columns - 4)
        weight = np.array([1.0, 1.0, 1.0, 0.3] + tilt_weights + [1.0, 1.0, 0.3] * len(self._movable))
        for k in range(len(points)):
            if len(out) == max_count:
                break
            if all(np.abs((points[k] - points[j]) * weight).max() > MIN_CANDIDATE_DISTANCE_M for j in out):
                out.append(k)
        return out

    def _free_fraction(
        self,
        models: Sequence[CellModel],
        candidate: PlacementCandidate,
        sampled: Sequence[SampledTargets] | None = None,
    ) -> float:
        """Return the fraction of sampled targets with a free posture, of the job in which it is smallest.

        It is 0 if bodies that do not move overlap, or if the pedestal that is made for the stock would be
        inside an obstacle.

        Args:
            models: Collision models of the jobs.
            candidate: Stock and base poses.
            sampled: Sampled targets of the jobs; None for the coarse samples.
        """
        jobs = list(zip(models, sampled or self._coarse, strict=True))
        placed = {id(m): m.with_stock(candidate.stock).with_bases(candidate.bases) for m, _ in jobs}
        if any(clearance.find_overlaps(m) for m in placed.values()):
            return 0.0
        if any(
            support.pedestal_overlap(m.cell, m.stock, candidate.stock)[1] > support.MAX_FOOT_HEIGHT_M
            for m in placed.values()
        ):
            return 0.0
        return min(
            self._free_target_fraction(placed[id(model)], candidate, job_sample) for model, job_sample in jobs
        )

    def _free_target_fraction(
        self, model: CellModel, candidate: PlacementCandidate, sampled: SampledTargets
    ) -> float:
        """Return the fraction of the sampled targets with a free posture on the best combination of branches.

        If the sample is meant for every branch, all combinations that reach all targets are tried, else only
        that with the largest margin. Failures are counted for each target over all calls, so that the targets
        that fail most often are checked first.
        """
        scene = Scene.of(
            sampled.cell, sampled.targets.arms, candidate.stock, self._settings, model, candidate.bases
        )
        margins, q = branch_margins(scene, sampled, candidate.stock[None, None], self._settings)
        scores = choice_scores(margins, sampled.index)[0]
        combinations = np.argsort(-scores, kind="stable")
        combinations = combinations[scores[combinations] > 0.0] if sampled.every_branch else combinations[:1]
        branch_choices = []
        for combination in combinations:
            branches = np.unravel_index(combination, [margins[arm].shape[-1] for arm in sampled.targets.arms])
            margin = np.min(
                [margins[a][0, :, b] for a, b in zip(sampled.targets.arms, branches, strict=True)], axis=0
            )
            joints = {a: q[a][0, :, b] for a, b in zip(sampled.targets.arms, branches, strict=True)}
            branch_choices.append((joints, margin))
        failure_counts = self._failure_counts.setdefault(
            id(sampled), np.zeros(sampled.targets.count, dtype=np.int64)
        )
        return max_free_targets(scene, sampled, branch_choices, failure_counts) / sampled.targets.count


def _yaw_quarters(points: FloatArray) -> IndexArray:
    """Return the number (K,) of quarter turns, 0 to 3, that is nearest to the yaw of points (K, P)."""
    return np.round(points[:, 3] / QUARTER_TURN_RAD).astype(np.int64) % 4
