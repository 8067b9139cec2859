"""A few targets of a job with a few samples of their freedoms, by which places are judged."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.motion.reach import full_turn, sample, slides_only
from planner.motion.scene import holders
from planner.motion.subset import subset
from planner.problem import Cell
from planner.targets import Targets

FloatArray = NDArray[np.float64]

SPIN_STEP: Final = np.deg2rad(30.0)
LONG: Final = 0.2
"""[m] range of a slide from which on the way that it shifts something counts in the search,"""

SHARE: Final = 0.75
"""with samples at this share of the way to either end."""

RING: Final = 6
"""Samples of each full turn where there are two."""


@dataclasses.dataclass(frozen=True)
class Few:
    """Some targets with samples of their freedoms, one after the other, and the cell with their tools."""

    cell: Cell
    targets: Targets
    index: NDArray[np.intp]
    poses: dict[str, FloatArray]

    @functools.cached_property
    def same(self) -> dict[str, tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """{arm: (rows with different poses, which of them each row has)} of arms whose frames stand: a holder
        has few poses."""
        out = {}
        for arm, holder in holders(self.targets):
            if holder is None:
                flat = self.poses[arm].reshape(len(self.index), 16).round(9)
                _, first, back = np.unique(flat, axis=0, return_index=True, return_inverse=True)
                out[arm] = first, back.reshape(-1)
        return out


def few_of(cell: Cell, targets: Targets, count: int, shifted: bool) -> Few:
    """About ``count`` targets of a job, with samples of long shifts as well where ``shifted``."""
    rows = np.unique(np.linspace(0, targets.count - 1, min(count, targets.count)).round().astype(np.intp))
    few = subset(targets, rows)
    values = _samples(few)
    if shifted:
        values = _shifted(few, values)
    index = np.repeat(np.arange(few.count), values.shape[1])
    return Few(cell, few, index, few.poses(values.reshape(len(index), -1), index))


def _samples(targets: Targets) -> FloatArray:
    """Values (N, S, F): what turns at every 30 degrees, slides in their middle; of many freedoms those
    that turn without end, at every 60 degrees."""
    rings = np.array([full_turn(f) for f in targets.freedoms], dtype=bool)
    if rings.sum() < 2:
        return sample(targets, SPIN_STEP, slides=1).values
    ring = -np.pi + 2.0 * np.pi * np.arange(RING) / RING
    grid = np.array(list(itertools.product(ring, repeat=int(rings.sum()))))
    values = np.repeat(targets.neutral()[:, None], len(grid), axis=1)
    values[..., rings] = grid
    return values


def shifts(targets: Targets) -> NDArray[np.bool_]:
    """(F,) which freedoms shift something by more than a little."""
    return np.array(
        [slides_only(f) and float(np.max(f.upper - f.lower)) > LONG for f in targets.freedoms], dtype=bool
    )


def _shifted(targets: Targets, values: FloatArray) -> FloatArray:
    """Values (N, S, F) again with each long shift at SHARE of the way to either end."""
    out = [values]
    for j in np.flatnonzero(shifts(targets)):
        freedom = targets.freedoms[j]
        middle, half = 0.5 * (freedom.upper + freedom.lower), 0.5 * (freedom.upper - freedom.lower)
        for sign in (-SHARE, SHARE):
            moved = values.copy()
            moved[..., j] = (middle + sign * half)[:, None]
            out.append(moved)
    return np.concatenate(out, axis=1)
