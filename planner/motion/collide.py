"""Collision checks of freedom samples, each made once."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.motion.reach import Grid, Rungs
from planner.motion.scene import Scene
from planner.targets import Targets

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

COARSE: Final = 12
"""Once a path has collided, all samples of every 12th target are checked before the next path is chosen."""

SUSPECT: Final = 0.05
"""Cost [s] of a sample between two of these targets one of which collides with it."""


class Checker:
    """What is known of the samples of one choice of branches: ``known``, ``collided`` (N, S)."""

    def __init__(self, scene: Scene, targets: Targets, grid: Grid, rungs: Mapping[str, Rungs]) -> None:
        self._scene, self._targets, self._rungs = scene, targets, rungs
        shape = grid.values.shape[:2]
        self._rungs_shape = (int(shape[0]), int(shape[1]))
        self.collided = np.zeros(shape, dtype=bool)
        self.known = np.zeros(shape, dtype=bool)
        self.checks = 0

    def check(self, index: IndexArray, sample: IndexArray) -> None:
        """Checks states (B,), (B,) that are not known yet."""
        new = ~self.known[index, sample]
        index, sample = index[new], sample[new]
        if len(index) == 0:
            return
        q = {arm: r.q[index, sample] for arm, r in self._rungs.items()}
        self.collided[index, sample] = ~self._scene.free(self._targets, q, index)
        self.known[index, sample] = True
        self.checks += len(index)

    def coarse(self) -> FloatArray:
        """Checks all samples of every 12th target; cost (N, S) of samples between that are suspect."""
        rows, samples = self._rungs_shape
        at = np.unique(np.append(np.arange(0, rows, COARSE), rows - 1))
        possible = np.stack([np.asarray(r.ok.any(axis=-1)) for r in self._rungs.values()]).all(axis=0)
        where = np.argwhere(np.asarray(possible)[at])
        self.check(at[where[:, 0]], where[:, 1])
        suspect = np.zeros((rows, samples))
        for a, b in itertools.pairwise(at):
            suspect[a : b + 1, self.collided[a] | self.collided[b]] = SUSPECT
        return suspect
