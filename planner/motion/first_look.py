"""A first look at reach and clearance: some targets one by one, while somebody edits a problem.

A target is passed where any posture of it keeps margins and clearance. Samples and postures are those of the
search of a path, coarse ones first; a target that none of them passes is a fault where the search of a path,
asked for this target alone, finds none either, and is told in its words. What lies between targets, and
whether one configuration goes through all of them, only a whole check knows.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IndexArray, spread_rows
from planner.issues import Issue
from planner.motion import diagnosis
from planner.motion.planning_scene import Scene
from planner.motion.search.ladder_search import Blocked
from planner.motion.search.path_search import find_path
from planner.motion.search.reach import Grid, Reach, reach
from planner.motion.search.subsampling import few_samples, subset
from planner.targets import Targets

LEAST_TARGETS: Final = 2
"""Targets of an operation that are looked at at least: both its ends."""
FIRST_POSTURES: Final = 8
"""Postures of a target that are looked at first, those with most room to limits; then ever twice as many."""


class FirstLook:
    """Some of the ``counts`` targets of each operation, evenly spread with both ends, about ``most`` in all;
    ``looked`` {operation: number} counts those that were looked at; ``placed``: whether the block's place is
    stated, or one of the few that are tried will do."""

    def __init__(self, counts: tuple[int, ...], most: int) -> None:
        self._counts, self._most = counts, most
        self.looked: dict[int, int] = {}
        self.placed = True

    def rows(self, operation: int) -> IndexArray:
        """The targets (K,) of an operation that are looked at."""
        count, total = self._counts[operation], sum(self._counts)
        return spread_rows(count, max(LEAST_TARGETS, round(self._most * count / total)))

    def faults(self, scene: Scene, targets: Targets, operation: int) -> list[Issue]:
        """What is in the way at the first of these targets that has no posture; nothing where all have."""
        for number, row in enumerate(self.rows(operation).tolist(), start=1):
            self.looked[operation] = max(number, self.looked.get(operation, 0))
            if found := _fault(scene, targets, row):
                return found
        return []

    def passes(self, scene: Scene, targets: Targets, operation: int) -> bool:
        """Whether all of these targets have a posture."""
        rows = self.rows(operation).tolist()
        return all(_passed(scene, subset(targets, np.array([row]))) is not None for row in rows)


def _fault(scene: Scene, targets: Targets, row: int) -> list[Issue]:
    found = posture(scene, targets, row)
    return found if isinstance(found, list) else []


def posture(
    scene: Scene, targets: Targets, row: int, thorough: bool = True
) -> dict[str, FloatArray] | list[Issue]:
    """Joints {arm: (6,)} [rad] at target ``row`` that keep margins and clearance, or why there are none; if
    not ``thorough``, nothing where coarse samples have none."""
    one = subset(targets, np.array([row]))
    coarse = _passed(scene, one)
    if coarse is not None:
        return coarse
    if not thorough:
        return []
    grid, found = find_path(scene, one)
    if not isinstance(found, Blocked):
        return {arm: q[0] for arm, q in found.q.items()}
    if found.few is None:
        found = dataclasses.replace(found, few=(one, np.array([row])))
    return diagnosis.no_path(scene, targets, grid, found)


def _passed(scene: Scene, one: Targets) -> dict[str, FloatArray] | None:
    """A posture {arm: (6,)} with all margins that is free, among coarse samples of a single target."""
    values = few_samples(one)
    grid = Grid(values, np.zeros((0, values.shape[1]), dtype=np.intp))
    table = reach(scene, one, grid)
    if not all(found.branches for found in table.values()):
        return None
    cost, branches = _costs(table)
    order = np.argsort(cost, axis=None, kind="stable")
    order = order[np.isfinite(cost.reshape(-1)[order])]
    first, many = 0, FIRST_POSTURES
    while first < len(order):
        choice, at = np.unravel_index(order[first : first + many], cost.shape)
        q = {}
        for arm, of_arm in zip(table, branches.T, strict=True):
            rungs = table[arm].branches
            q[arm] = np.stack([rungs[b].q[0, s] for b, s in zip(of_arm[choice].tolist(), at, strict=True)])
        free = scene.free(one, q, np.zeros(len(at), dtype=np.intp))
        if free.any():
            return {arm: own[np.argmax(free)] for arm, own in q.items()}
        first, many = first + many, 2 * many
    return None


def _costs(table: dict[str, Reach]) -> tuple[FloatArray, IndexArray]:
    """What the samples of a single target cost with each choice of branches (C, S), inf where an arm has no
    allowed state, and the branch of each arm in each choice (C, arms)."""
    branches = np.array(list(itertools.product(*(found.branches for found in table.values()))))
    cost = [
        sum(table[arm].branches[b].penalty[0].min(axis=-1) for arm, b in zip(table, choice, strict=True))
        for choice in branches.tolist()
    ]
    return np.stack(cost), branches
