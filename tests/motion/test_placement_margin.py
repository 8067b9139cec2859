"""The number of targets that are free at a placement, found with as few queries as possible."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from planner.motion.placement_margin import max_free_targets

TARGETS, SAMPLES, CHOICES = 12, 9, 6


class _PostureOracle:
    """Answers which postures are free, by their number, and counts the queries."""

    def __init__(self, free: np.ndarray) -> None:
        self._free, self.queries = free, 0

    def keeps_clearance(self, targets: Any, q: dict[str, np.ndarray], index: np.ndarray) -> np.ndarray:
        """Whether (B,) postures are free, at targets (B,) that are theirs."""
        number = q["arm"].astype(np.int64)
        assert np.array_equal(number % (TARGETS * SAMPLES) // SAMPLES, index)
        self.queries += len(index)
        return np.asarray(self._free[number])


def test_the_most_free_targets_are_those_that_all_postures_on_all_branches_tell() -> None:
    """Of 300 places drawn, with what has failed at those before; at most of them a few targets are never
    free, and others not on each choice."""
    rng = np.random.default_rng(4)
    index = np.repeat(np.arange(TARGETS), SAMPLES)
    few: Any = SimpleNamespace(targets=SimpleNamespace(count=TARGETS), index=index)
    failed, asked, whole = np.zeros(TARGETS, dtype=np.int64), 0, 0
    hopeless = np.arange(TARGETS) < 3
    for number in range(300):
        numbers = np.arange(CHOICES * len(index)).reshape(CHOICES, -1)
        margin = rng.uniform(-0.3, 1.0, numbers.shape)
        fraction = rng.uniform(0.0, 0.4, (CHOICES, TARGETS)) * ~(hopeless & (number % 4 > 0))
        free = rng.uniform(size=numbers.shape) < fraction[:, index]
        good = free & (margin > 0.0)
        counts = [len(np.unique(index[some])) for some in good]
        room: Any = _PostureOracle(free.ravel())
        choices = [({"arm": own.astype(float)}, m) for own, m in zip(numbers, margin, strict=True)]
        assert max_free_targets(room, few, choices, failed) == max(counts)
        asked, whole = asked + room.queries, whole + int((margin > 0.0).sum())
    assert np.all(np.argsort(-failed, kind="stable")[:3] < 3)  # those are asked first
    assert asked < 0.85 * whole
