"""Windows of a long path: the parts that a program over the freedoms may improve most.

A program over tens of thousands of targets would take longer than everything else. A few windows are left
free instead. They lie where joints that freedoms move have the highest peaks of acceleration or jerk on the
clock of the path, then where these joints cost most. Between windows, and at a few targets at their ends, the
path and its slopes stay.
"""

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.motion.planning_scene import Scene
from planner.motion.search.subsampling import select_targets
from planner.motion.trajectory.differences import DifferenceBand, difference_bands
from planner.motion.trajectory.hinge_costs import margin_residuals, preference_residuals
from planner.motion.trajectory.trajopt import CostWeights, OptimisedPath, PathProblem, cost_weights
from planner.targets import Targets

MAX_WINDOWS: Final = 8
"""Maximum number of windows of a path."""
WINDOW_TARGETS: Final = 300
"""Number of targets of a window."""
HELD_TARGETS: Final = 3
"""Number of fixed targets at both ends of a window: as many as a jerk needs beside a free one."""
MIN_PEAK_DISTANCE: Final = 12
"""Distance in targets from the end of a window from which a peak counts as one that the window may lower."""
SAMPLED_TARGETS: Final = 256
"""Approximate number of targets at which the joints that freedoms move are determined."""
MIN_JOINT_RATE: Final = 1e-9
"""Rate [rad per rad or m] below which a freedom does not move a joint."""
MIN_PEAK_REDUCTION: Final = 0.02
"""Relative reduction below which peaks are ignored."""
MIN_COST_FRACTION: Final = 1e-5
"""Fraction of the cost that freedoms can change below which there are no windows, unless they can lower a
peak.
"""


@dataclasses.dataclass(frozen=True)
class Windows:
    """Windows of a path.

    Attributes:
        rows: (K,) their targets, in order.
        held: (K,) which of these stay fixed.
        weights: Weights of their cost.
        bands: Accelerations and jerks on the clock of the path.
        tops: (J,) peaks of each of the two on the whole path, by joint.
        goals: Peak of the worst joint outside of windows, to which windows may lower it.
        moved: (J,) whether freedoms move a joint.
        fraction: Fraction of the cost of these joints and all hinges, an upper bound of the gain.
    """

    rows: IndexArray
    held: BoolArray
    weights: CostWeights
    bands: tuple[DifferenceBand, ...]
    tops: tuple[FloatArray, ...]
    goals: tuple[float, ...]
    moved: BoolArray
    fraction: float

    @property
    def count(self) -> int:
        """Number of windows. Adjacent ones count as one."""
        return int((np.diff(self.rows) > 1).sum()) + 1

    def insert(self, path: OptimisedPath, part: OptimisedPath, previous: FloatArray) -> OptimisedPath:
        """Insert an improved path of the windows' targets into a path of all targets.

        Args:
            path: Path of all targets.
            part: Improved path of the windows' targets.
            previous: (K, F) freedoms from which ``part`` started.
        """
        values, q = path.values.copy(), {arm: angles.copy() for arm, angles in path.q.items()}
        values[self.rows] += part.values - previous
        for arm, angles in q.items():
            angles[self.rows] = part.q[arm]
        return dataclasses.replace(path, values=values, q=q)

    def peak_levels(self, joints: FloatArray) -> tuple[float, ...]:
        """Relative excess of the peaks of joints (K, J) over the goals: 1 at the peaks of the path itself."""
        out = []
        for band, (goal, top) in zip(self.bands, self.peak_bounds, strict=True):
            peak = float(np.abs(band.differences(joints)).max(initial=0.0))
            out.append(max(peak - goal, 0.0) / (top - goal) if top > goal else 0.0)
        return tuple(out)

    @property
    def peak_bounds(self) -> list[tuple[float, float]]:
        """Goal and top of the worst joint, for each band."""
        return [(goal, float(top.max(initial=0.0))) for goal, top in zip(self.goals, self.tops, strict=True)]


def choose_windows(
    scene: Scene,
    targets: Targets,
    branch: Mapping[str, int],
    path: OptimisedPath,
    duration: FloatArray,
    stop: BoolArray,
) -> Windows | str:
    """Choose the windows of a path.

    Args:
        scene: Cell with the arms.
        targets: N targets.
        branch: {arm: branch}.
        path: The path.
        duration: (N - 1,) [s] durations of the moves.
        stop: (N,) whether the arms stop at a target.

    Returns:
        The windows, or the reason why there are none.
    """
    if not targets.freedoms:
        return "no target has a freedom"
    problem = PathProblem(scene, targets, branch, None)
    values, joints = problem.unwrap(path.values), problem.stack(path.q)
    moved = _moved_joints(scene, targets, branch, values, joints)
    # Score targets by peaks that the freedoms could lower, and by the cost of the joints that they move.
    own = difference_bands(duration, stop)
    magnitudes = [np.abs(band.differences(joints)) for band in own]
    tops = tuple(part.max(axis=0, initial=0.0) for part in magnitudes)
    floors = [float(top[~moved].max(initial=0.0)) for top in tops]
    highest_peaks = [float(top.max(initial=0.0)) for top in tops]
    excess = np.zeros(targets.count)
    for band, part, floor, top in zip(own, magnitudes, floors, highest_peaks, strict=True):
        above = (part[:, moved].max(axis=1, initial=0.0) - floor) / max(top, 1e-12)
        np.maximum.at(
            excess, band.first + band.weight.shape[1] // 2, np.where(above > MIN_PEAK_REDUCTION, above, 0.0)
        )
    scaled = (joints / problem.speed)[:, moved]
    cost = _cost_by_target(CostWeights(problem.stencil, problem.count), scaled)
    hinges = [
        *margin_residuals(scene, targets.arms, joints, problem.count, slopes=False),
        *preference_residuals(targets, values, problem.is_full_turn, problem.count),
    ]
    total_cost = problem.cost(values, joints)
    fraction = min(float(cost.sum() + sum(hinge.cost for hinge in hinges)) / max(total_cost, 1e-12), 1.0)
    if not excess.any() and fraction < MIN_COST_FRACTION:
        return f"its freedoms can change only {100.0 * max(fraction, 0.0):.1g} % of its cost and no peak"
    free, held = _place_windows(excess, cost)
    rows = np.flatnonzero(free)
    goals = [
        max(floor, float(part[_rows_outside(band, free & ~held)][:, moved].max(initial=0.0)))
        for band, part, floor in zip(own, magnitudes, floors, strict=True)
    ]
    kept = tuple(_rows_within(band, free) for band in own)
    weights = cost_weights(targets, rows)
    return Windows(rows, held[rows], weights, kept, tops, tuple(goals), moved, fraction)


def _moved_joints(
    scene: Scene, targets: Targets, branch: Mapping[str, int], values: FloatArray, joints: FloatArray
) -> BoolArray:
    """Whether (J,) any freedom moves a joint, determined at some targets."""
    rows = np.arange(0, targets.count, max(targets.count // SAMPLED_TARGETS, 1))
    subset_problem = PathProblem(scene, select_targets(targets, rows), branch, None)
    return np.asarray(
        np.abs(subset_problem.rates(values[rows], joints[rows])).max(axis=(0, 2)) > MIN_JOINT_RATE
    )


def _cost_by_target(weights: CostWeights, x: FloatArray) -> FloatArray:
    """Contribution (N,) of each target to x' K x.

    K has rows that sum to 0, so it is a sum of squared differences.
    """
    out = np.zeros(len(x))
    for d in (1, 2):
        gap = x[d:] - x[:-d]
        out[d:] -= weights.stencil[d] * np.sum(gap * gap, axis=1)
    return out


def _place_windows(excess: FloatArray, cost: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Targets (N,) of the windows, and those of them that are fixed.

    Windows lie around the targets with the largest ``excess`` (N,), the rest where the ``cost`` (N,) is
    largest.
    """
    count = len(excess)
    free, inner = np.zeros((2, count), dtype=np.bool_)
    open_peaks = excess.copy()
    open_peaks[:MIN_PEAK_DISTANCE] = open_peaks[count - MIN_PEAK_DISTANCE :] = (
        0.0  # the ends of the path are fixed
    )
    width = min(WINDOW_TARGETS, count)
    for _ in range(MAX_WINDOWS):
        if open_peaks.any():
            first = int(np.argmax(open_peaks)) - width // 2
        else:
            sums = np.concatenate([[0.0], np.cumsum(np.where(free, 0.0, cost))])
            first = int(np.argmax(sums[width:] - sums[:-width]))
        first = min(max(first, 0), count - width)
        free[first : first + width] = True
        inner[first + HELD_TARGETS : first + width - HELD_TARGETS] = True
        open_peaks[first + MIN_PEAK_DISTANCE : first + width - MIN_PEAK_DISTANCE] = 0.0
    return free, free & ~inner


def _rows_outside(band: DifferenceBand, free: BoolArray) -> BoolArray:
    """Rows (M,) of a band without any free target."""
    at = band.first[:, None] + np.arange(band.weight.shape[1])
    return np.asarray(~free[at].any(axis=1))


def _rows_within(band: DifferenceBand, free: BoolArray) -> DifferenceBand:
    """Rows of a band whose targets all lie in windows, renumbered to the targets of windows."""
    at = band.first[:, None] + np.arange(band.weight.shape[1])
    kept = free[at].all(axis=1)
    new_index = np.cumsum(free) - 1
    return DifferenceBand(new_index[band.first[kept]], band.weight[kept])
