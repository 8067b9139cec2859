"""Collision checks of freedom samples, each made once."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.cell.clearance import Pairs
from planner.motion.reach import Grid, Rungs
from planner.motion.scene import Scene
from planner.targets import Targets

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

COARSE: Final = 12
"""Once a path has collided, all samples of every 12th target are checked before the next path is chosen."""

SUSPECT: Final = 0.05
"""Cost [s] of a sample between two of these targets one of which collides with it."""


@dataclasses.dataclass(frozen=True)
class Others:
    """Arms that a search leaves alone: the joints ``standing`` {arm: (N, 6)} at every target, and arms that
    are ``absent``, as if they were not there."""

    standing: Mapping[str, FloatArray]
    absent: frozenset[str]

    def ignored(self, scene: Scene) -> Pairs:
        """Pairs of bodies that absent arms are part of."""
        if scene.model is None:
            return frozenset()
        bodies = {solid.body for solid in scene.model.solids}
        gone = {body for body in bodies if body.partition("/")[0] in self.absent}
        return frozenset(frozenset((a, b)) for a in gone for b in bodies if a != b)


class Checker:
    """What is known of the samples of one choice of branches: ``known``, ``collided`` (N, S)."""

    def __init__(
        self,
        scene: Scene,
        targets: Targets,
        grid: Grid,
        rungs: Mapping[str, Rungs],
        others: Others | None = None,
    ) -> None:
        self._standing = others.standing if others else {}
        self._ignored: Pairs = others.ignored(scene) if others else frozenset()
        self._scene, self._targets, self._rungs = scene, targets, rungs
        shape = grid.values.shape[:2]
        self._rungs_shape = (int(shape[0]), int(shape[1]))
        self.collided = np.zeros(shape, dtype=bool)
        self.known = np.zeros(shape, dtype=bool)
        self.checks = self.rounds = 0
        self.suspect: FloatArray | None = None
        able = np.stack([np.asarray(r.ok.any(axis=-1)) for r in rungs.values()])
        self.possible = np.asarray(np.logical_and.reduce(able, axis=0))

    def whole(self, rows: IndexArray) -> None:
        """Checks all samples of targets ``rows`` (K,) that every arm can take."""
        where = np.argwhere(self.possible[rows] & ~self.known[rows])
        self.check(rows[where[:, 0]], where[:, 1])

    def free(self, row: int) -> NDArray[np.bool_]:
        """(S,) samples of one target that every arm can take and that collide with nothing."""
        self.whole(np.array([row]))
        return np.asarray(self.possible[row] & ~self.collided[row])

    def check(self, index: IndexArray, sample: IndexArray) -> None:
        """Checks states (B,), (B,) that are not known yet."""
        new = ~self.known[index, sample]
        index, sample = index[new], sample[new]
        if len(index) == 0:
            return
        q = {arm: r.q[index, sample] for arm, r in self._rungs.items()}
        q |= {arm: angles[index] for arm, angles in self._standing.items()}
        self.collided[index, sample] = ~self._scene.free(self._targets, q, index, ignored=self._ignored)
        self.known[index, sample] = True
        self.checks += len(index)

    def cost(self) -> FloatArray | None:
        """What samples (N, S) cost for what is known of collisions [s], inf where they collide; None as long
        as no path has."""
        return None if self.suspect is None else np.where(self.collided, np.inf, self.suspect)

    def coarse(self) -> None:
        """Checks all samples of every 12th target; samples between that are suspect cost something."""
        rows, samples = self._rungs_shape
        at = np.unique(np.append(np.arange(0, rows, COARSE), rows - 1))
        self.whole(at)
        suspect = np.zeros((rows, samples))
        for a, b in itertools.pairwise(at):
            suspect[a : b + 1, self.collided[a] | self.collided[b]] = SUSPECT
        self.suspect = suspect
