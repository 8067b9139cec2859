"""A first look at reach and clearance: some targets each for itself, while somebody edits a problem.

A target is passed where any posture of it keeps margins and clearance. Samples and postures are those of the
search of a path, coarse ones first, the best few of all targets at once; a target that none of them passes is
a fault where the search of a path, asked for this target alone, finds none either, and is told in its words.
What lies between targets, and whether one configuration goes through all of them, only a whole check knows.
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
from planner.motion.search.ladder_search import Blocked
from planner.motion.search.path_search import find_path
from planner.motion.search.reach import Grid, Rungs, apart
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
        rows = self.rows(operation)
        for number, found in enumerate(_postures(scene, subset(targets, rows))):
            self.looked[operation] = max(number + 1, self.looked.get(operation, 0))
            if found is None and isinstance(fault := _searched(scene, targets, int(rows[number])), list):
                return fault
        return []

    def passes(self, scene: Scene, targets: Targets, operation: int) -> bool:
        """Whether all of these targets have a posture."""
        found = _postures(scene, subset(targets, self.rows(operation)))
        return all(one is not None for one in found)


def posture(
    scene: Scene, targets: Targets, row: int, thorough: bool = True
) -> dict[str, FloatArray] | list[Issue]:
    """Joints {arm: (6,)} [rad] at target ``row`` that keep margins and clearance, or why there are none; if
    not ``thorough``, nothing where coarse samples have none."""
    coarse = next(_postures(scene, subset(targets, np.array([row]))))
    if coarse is not None:
        return coarse
    return _searched(scene, targets, row) if thorough else []


def _searched(scene: Scene, targets: Targets, row: int) -> dict[str, FloatArray] | list[Issue]:
    one = subset(targets, np.array([row]))
    grid, found = find_path(scene, one)
    if not isinstance(found, Blocked):
        return {arm: q[0] for arm, q in found.q.items()}
    if found.few is None:
        found = dataclasses.replace(found, few=(one, np.array([row])))
    return diagnosis.no_path(scene, targets, grid, found)


def _postures(scene: Scene, few: Targets) -> Iterator[dict[str, FloatArray] | None]:
    """Of each target in turn a posture {arm: (6,)} with all margins that is free, None where coarse samples
    have none. The best of all are looked at together before the first is told, the others of a target
    when its turn comes."""
    values = few_samples(few)
    table = apart(scene, few, Grid(values, np.zeros((0, values.shape[1]), dtype=np.intp)))
    orders = [_order(table, row) for row in range(few.count)]
    best = [order[:FIRST_POSTURES] for order in orders]
    index = np.repeat(np.arange(few.count), [len(some) for some in best])
    q = _joints(table, index, np.concatenate(best))
    free = scene.free(few, q, index)
    for row, order in enumerate(orders):
        mine = np.flatnonzero(free & (index == row))
        found = {arm: own[mine[0]] for arm, own in q.items()} if len(mine) else None
        first, many = FIRST_POSTURES, 2 * FIRST_POSTURES
        while found is None and first < len(order):
            some = np.full(len(order[first : first + many]), row)
            more = _joints(table, some, order[first : first + many])
            good = np.flatnonzero(scene.free(few, more, some))
            found = {arm: own[good[0]] for arm, own in more.items()} if len(good) else None
            first, many = first + many, 2 * many
        yield found


def _order(table: dict[str, list[Rungs]], row: int) -> IndexArray:
    """Numbers (P,) of the allowed states of all arms at target ``row``, in (branch, ..., sample), those with
    most margin first."""
    each = [np.stack([one.penalty[row].min(axis=-1) for one in rungs]) for rungs in table.values()]
    cost = functools.reduce(lambda a, b: a[..., None, :] + b, each).reshape(-1)
    order = np.argsort(cost, kind="stable")
    return np.asarray(order[: np.isfinite(cost).sum()])


def _joints(table: dict[str, list[Rungs]], index: IndexArray, states: IndexArray) -> dict[str, FloatArray]:
    """Joints {arm: (P, 6)} of states by their numbers (P,) at targets ``index`` (P,)."""
    samples = next(iter(table.values()))[0].q.shape[1]
    shape = (*(len(rungs) for rungs in table.values()), samples)
    *branches, at = np.unravel_index(states, shape)
    return {
        arm: _taken(rungs, branch, index, at)
        for (arm, rungs), branch in zip(table.items(), branches, strict=True)
    }


def _taken(rungs: Sequence[Rungs], branch: IndexArray, index: IndexArray, at: IndexArray) -> FloatArray:
    out = np.empty((len(at), rungs[0].q.shape[-1]))
    for number in np.unique(branch):
        mine = branch == number
        out[mine] = rungs[number].q[index[mine], at[mine]]
    return out
