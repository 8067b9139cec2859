"""Windows of a long path: the parts that a program over the freedoms may improve most.

A program over tens of thousands of targets would take longer than the rest of planning. Therefore only the
targets of a few windows may change. Windows lie where joints that freedoms move have the highest peaks of
acceleration or jerk on the clock of the path, then where the motion of these joints costs most. The path
stays the same between windows and at a few targets at their ends, so that it continues smoothly there.
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
"""Number of fixed targets at both ends of a window: as many as a jerk covers in addition to a free one."""
MIN_PEAK_DISTANCE: Final = 12
"""Minimum number of targets between a peak and the ends of a window for the window to lower that peak."""
SAMPLED_TARGETS: Final = 256
"""Approximate number of targets at which the joints that freedoms move are determined."""
MIN_JOINT_RATE: Final = 1e-9
"""Rate [rad per rad or m] below which a freedom does not move a joint."""
MIN_PEAK_REDUCTION: Final = 0.02
"""Fraction of the highest peak by which freedoms must be able to lower a peak for it to count."""
MIN_COST_FRACTION: Final = 1e-5
"""Fraction of the cost that freedoms can change below which there are no windows, unless they can lower a
peak.
"""


@dataclasses.dataclass(frozen=True)
class Windows:
    """Windows of a path.

    Attributes:
        rows: (K,) indices of the targets of all windows, ascending.
        held: (K,) whether such a target stays fixed.
        weights: Weights of the cost of these targets.
        bands: Accelerations and jerks over these targets, on the clock of the path.
        tops: Peaks (J,) of the accelerations and of the jerks of each joint on the whole path.
        goals: For accelerations and jerks the value to which windows may lower the highest peak of any joint.
            Lower is useless, because peaks outside of the windows stay.
        moved: (J,) whether freedoms move a joint.
        fraction: Part of the cost of the path, 0 to 1, that is due to joints that freedoms move, to margins
            and to preferred values. It is an upper bound of the relative gain.
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
        """Return for accelerations and jerks how far the peaks of joints (K, J) are above the goals.

        The value is 0 at the goal and 1 at the peak of the path itself.
        """
        out = []
        for band, (goal, top) in zip(self.bands, self.peak_bounds, strict=True):
            peak = float(np.abs(band.differences(joints)).max(initial=0.0))
            out.append(max(peak - goal, 0.0) / (top - goal) if top > goal else 0.0)
        return tuple(out)

    @property
    def peak_bounds(self) -> list[tuple[float, float]]:
        """For accelerations and jerks the goal, and the highest peak of any joint on the whole path."""
        return [(goal, float(top.max(initial=0.0))) for goal, top in zip(self.goals, self.tops, strict=True)]


def choose_windows(
    scene: Scene,
    targets: Targets,
    branch: Mapping[str, int],
    path: OptimisedPath,
    duration: FloatArray,
    stop: BoolArray,
) -> Windows | str:
    """Choose the windows of a path, in which the program may change it.

    Windows lie where the freedoms can lower the highest peaks of acceleration and jerk, then where they can
    lower most of the cost.

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
    problem = PathProblem(scene, targets, branch, obstacles=None)
    values, joints = problem.unwrap(path.values), problem.stack(path.q)
    moved = _moved_joints(scene, targets, branch, values, joints)
    # Score targets by peaks that the freedoms could lower, and by the cost of the joints that they move.
    bands = difference_bands(duration, stop)
    magnitudes = [np.abs(band.differences(joints)) for band in bands]
    tops = tuple(magnitude.max(axis=0, initial=0.0) for magnitude in magnitudes)
    # peaks of joints that no freedom moves, below which it is useless to lower others
    floors = [float(top[~moved].max(initial=0.0)) for top in tops]
    highest_peaks = [float(top.max(initial=0.0)) for top in tops]
    excess = np.zeros(targets.count)
    for band, magnitude, floor, top in zip(bands, magnitudes, floors, highest_peaks, strict=True):
        reduction = (magnitude[:, moved].max(axis=1, initial=0.0) - floor) / max(top, 1e-12)
        middle_target = band.first + band.weight.shape[1] // 2
        np.maximum.at(excess, middle_target, np.where(reduction > MIN_PEAK_REDUCTION, reduction, 0.0))
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
    in_window, held = _place_windows(excess, cost)
    rows = np.flatnonzero(in_window)
    # a peak need not be lower than those that stay: of joints that no freedom moves, and outside of windows
    goals = [
        max(floor, float(magnitude[_rows_outside(band, in_window & ~held)][:, moved].max(initial=0.0)))
        for band, magnitude, floor in zip(bands, magnitudes, floors, strict=True)
    ]
    window_bands = tuple(_rows_within(band, in_window) for band in bands)
    weights = cost_weights(targets, rows)
    return Windows(rows, held[rows], weights, window_bands, tops, tuple(goals), moved, fraction)


def _moved_joints(
    scene: Scene, targets: Targets, branch: Mapping[str, int], values: FloatArray, joints: FloatArray
) -> BoolArray:
    """Return for each of J joints whether any freedom moves it.

    This is determined at about :data:`SAMPLED_TARGETS` evenly spaced targets.
    """
    rows = np.arange(0, targets.count, max(targets.count // SAMPLED_TARGETS, 1))
    subset_problem = PathProblem(scene, select_targets(targets, rows), branch, obstacles=None)
    return np.asarray(
        np.abs(subset_problem.rates(values[rows], joints[rows])).max(axis=(0, 2)) > MIN_JOINT_RATE
    )


def _cost_by_target(weights: CostWeights, x: FloatArray) -> FloatArray:
    """Return the contribution (N,) of each target to the cost x' K x of scaled joints x (N, J).

    The rows of K sum to 0, so the cost is a weighted sum of squared differences of targets. Each difference
    counts at its later target.
    """
    out = np.zeros(len(x))
    for d in (1, 2):
        gap = x[d:] - x[:-d]
        out[d:] -= weights.stencil[d] * np.sum(gap * gap, axis=1)
    return out


def _place_windows(excess: FloatArray, cost: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Place the windows around the highest peaks first, then where the cost is largest.

    Args:
        excess: (N,) peaks that the freedoms could lower, 0 elsewhere.
        cost: (N,) cost of each target.

    Returns:
        Whether (N,) a target lies in a window, and whether (N,) it lies in a window but stays fixed.
    """
    count = len(excess)
    in_window, inner = np.zeros((2, count), dtype=np.bool_)
    open_peaks = excess.copy()
    # the ends of the path are fixed, so peaks close to them cannot be lowered
    open_peaks[:MIN_PEAK_DISTANCE] = open_peaks[count - MIN_PEAK_DISTANCE :] = 0.0
    width = min(WINDOW_TARGETS, count)
    for _ in range(MAX_WINDOWS):
        if open_peaks.any():
            first = int(np.argmax(open_peaks)) - width // 2
        else:
            sums = np.concatenate([[0.0], np.cumsum(np.where(in_window, 0.0, cost))])
            first = int(np.argmax(sums[width:] - sums[:-width]))
        first = min(max(first, 0), count - width)
        in_window[first : first + width] = True
        inner[first + HELD_TARGETS : first + width - HELD_TARGETS] = True
        open_peaks[first + MIN_PEAK_DISTANCE : first + width - MIN_PEAK_DISTANCE] = 0.0
    return in_window, in_window & ~inner


def _rows_outside(band: DifferenceBand, free: BoolArray) -> BoolArray:
    """Return for each of the M differences of a band whether it covers only targets that stay as they are.

    ``free`` (N,) says which targets may change.
    """
    covered = band.first[:, None] + np.arange(band.weight.shape[1])
    return np.asarray(~free[covered].any(axis=1))


def _rows_within(band: DifferenceBand, in_window: BoolArray) -> DifferenceBand:
    """Return the differences of a band over targets in windows only, with indices among these targets."""
    covered = band.first[:, None] + np.arange(band.weight.shape[1])
    kept = in_window[covered].all(axis=1)
    new_index = np.cumsum(in_window) - 1
    return DifferenceBand(new_index[band.first[kept]], band.weight[kept])
