"""Quick check of reach and clearance: some targets, each on its own, while the user edits a problem.

A target passes if any of its postures keeps margins and clearance. Samples and postures are those of the path
search. Coarse samples come first, and the best few of all targets are checked together. Where a target has no
free coarse sample, the path search runs for this target alone; if it finds nothing either, its diagnosis is
reported. Only the full check covers the motion between targets and whether one configuration passes through
all targets.
"""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IndexArray, spread_rows
from planner.issues import Issue
from planner.motion import diagnosis
from planner.motion.planning_scene import Scene
from planner.motion.search.layered_graph_search import BlockedSearch
from planner.motion.search.path_search import find_path
from planner.motion.search.reach import BranchStates, SampleGrid, independent_states
from planner.motion.search.subsampling import coarse_samples, select_targets
from planner.targets import Targets

MIN_TARGETS: Final = 2
"""Minimum number of targets of an operation that are checked: its first and its last."""
FIRST_BATCH: Final = 8
"""Number of postures of a target in the first batch, largest margin to limits first. Each further batch
doubles.
"""


class QuickCheck:
    """Checks evenly spread targets of each operation, always including the first and the last.

    Args:
        counts: Number of targets of each operation.
        max_targets: Approximate number of checked targets of all operations together.

    Attributes:
        checked: {index of the operation: number of its targets that were checked}.
        is_stock_placed: Whether the stock pose is stated, or one of the few candidate poses is feasible.
    """

    def __init__(self, counts: tuple[int, ...], max_targets: int) -> None:
        self._counts, self._max_targets = counts, max_targets
        self.checked: dict[int, int] = {}
        self.is_stock_placed = True

    def target_rows(self, operation: int) -> IndexArray:
        """Return the indices (K,) of the checked targets of an operation.

        The number of targets is shared among the operations in proportion to their targets.
        """
        count, total = self._counts[operation], sum(self._counts)
        return spread_rows(count, max(MIN_TARGETS, round(self._max_targets * count / total)))

    def first_issues(self, scene: Scene, targets: Targets, operation: int) -> list[Issue]:
        """Return the issues of the first checked target that has no posture; empty if all have one."""
        rows = self.target_rows(operation)
        for number, posture in enumerate(_coarse_postures(scene, select_targets(targets, rows))):
            self.checked[operation] = max(number + 1, self.checked.get(operation, 0))
            if posture is None:
                result = _search_target(scene, targets, int(rows[number]))
                if isinstance(result, list):
                    return result
        return []

    def all_reachable(self, scene: Scene, targets: Targets, operation: int) -> bool:
        """Whether all checked targets have a free posture among the coarse samples."""
        postures = _coarse_postures(scene, select_targets(targets, self.target_rows(operation)))
        return all(posture is not None for posture in postures)


def find_posture(
    scene: Scene, targets: Targets, row: int, thorough: bool = True
) -> dict[str, FloatArray] | list[Issue]:
    """Find joints at one target that keep margins and clearance.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        row: Index of the target.
        thorough: Whether the path search runs if no coarse sample is free.

    Returns:
        Joints {arm: (6,)} [rad], or the issues that explain why there are none (empty unless ``thorough``).
    """
    coarse = next(_coarse_postures(scene, select_targets(targets, np.array([row]))))
    if coarse is not None:
        return coarse
    return _search_target(scene, targets, row) if thorough else []


def _search_target(scene: Scene, targets: Targets, row: int) -> dict[str, FloatArray] | list[Issue]:
    """Search a posture {arm: (6,)} [rad] of one target with the path search, or diagnose why it has none."""
    single = select_targets(targets, np.array([row]))
    grid, result = find_path(scene, single)
    if not isinstance(result, BlockedSearch):
        return {arm: q[0] for arm, q in result.q.items()}
    if result.subset is None:
        result = dataclasses.replace(result, subset=(single, np.array([row])))
    return diagnosis.no_path_issues(scene, targets, grid, result)


def _coarse_postures(scene: Scene, targets: Targets) -> Iterator[dict[str, FloatArray] | None]:
    """Yield for each target a free posture {arm: (6,)} with all margins, or None if no coarse sample has one.

    The :data:`FIRST_BATCH` best postures of all targets are checked together, before the first result.
    Further postures of a target are checked when the caller asks for its result.
    """
    values = coarse_samples(targets)
    table = independent_states(
        scene, targets, SampleGrid(values, np.zeros((0, values.shape[1]), dtype=np.intp))
    )
    ranked_states = [_ranked_states(table, row) for row in range(targets.count)]
    first_batches = [states[:FIRST_BATCH] for states in ranked_states]
    index = np.repeat(np.arange(targets.count), [len(states) for states in first_batches])
    q = _state_joints(table, index, np.concatenate(first_batches))
    free = scene.keeps_clearance(targets, q, index)
    for row, states in enumerate(ranked_states):
        free_rows = np.flatnonzero(free & (index == row))
        posture = {arm: joints[free_rows[0]] for arm, joints in q.items()} if len(free_rows) else None
        start, size = FIRST_BATCH, 2 * FIRST_BATCH
        while posture is None and start < len(states):
            batch_index = np.full(len(states[start : start + size]), row)
            batch_joints = _state_joints(table, batch_index, states[start : start + size])
            free_rows = np.flatnonzero(scene.keeps_clearance(targets, batch_joints, batch_index))
            posture = (
                {arm: joints[free_rows[0]] for arm, joints in batch_joints.items()}
                if len(free_rows)
                else None
            )
            start, size = start + size, 2 * size
        yield posture


def _ranked_states(table: dict[str, list[BranchStates]], row: int) -> IndexArray:
    """Return the numbers (P,) of the allowed states of all arms at target ``row``, smallest penalty first.

    A state is one branch for each arm and a sample of the freedoms. States are numbered in C order of the
    shape (branches of the first arm, ..., branches of the last arm, samples).
    """
    penalties = [
        np.stack([branch.penalty[row].min(axis=-1) for branch in branches]) for branches in table.values()
    ]
    cost = functools.reduce(lambda a, b: a[..., None, :] + b, penalties).reshape(-1)
    order = np.argsort(cost, kind="stable")
    return np.asarray(order[: np.isfinite(cost).sum()])


def _state_joints(
    table: dict[str, list[BranchStates]], index: IndexArray, states: IndexArray
) -> dict[str, FloatArray]:
    """Return the joints {arm: (P, 6)} of states at targets ``index`` (P,).

    ``states`` (P,) are numbered as in :func:`_ranked_states`.
    """
    sample_count = next(iter(table.values()))[0].q.shape[1]
    shape = (*(len(arm_branches) for arm_branches in table.values()), sample_count)
    *branches, sample = np.unravel_index(states, shape)
    return {
        arm: _pick_joints(arm_branches, branch, index, sample)
        for (arm, arm_branches), branch in zip(table.items(), branches, strict=True)
    }


def _pick_joints(
    arm_branches: Sequence[BranchStates], branch: IndexArray, index: IndexArray, sample: IndexArray
) -> FloatArray:
    """Return the joints (P, J) of an arm on branches (P,) at targets ``index`` (P,) and samples (P,)."""
    out = np.empty((len(sample), arm_branches[0].q.shape[-1]))
    for number in np.unique(branch):
        selected = branch == number
        out[selected] = arm_branches[number].q[index[selected], sample[selected]]
    return out
