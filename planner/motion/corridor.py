"""Freedoms narrowed to a corridor around a path, where a smoother path came too near to something."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.motion.reach import full_turn, slides_only
from planner.targets import Freedom, ScrewFreedom, Targets

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

WIDE = 1e3
"""[rad] bounds of a full turn that is narrowed at some targets only."""


def unwrapped(targets: Targets, values: FloatArray) -> FloatArray:
    """Values (N, F) with full turns counted on from target to target instead of jumping at half a turn."""
    out = values.copy()
    for j, freedom in enumerate(targets.freedoms):
        if full_turn(freedom):
            out[:, j] = np.unwrap(values[:, j])
    return out


def narrowed(targets: Targets, values: FloatArray, rows: BoolArray, width: float) -> Targets:
    """The targets with freedoms kept near ``values`` (N, F), unwrapped, at ``rows`` (N,).

    ``width`` [rad] either way for what turns; slides and tables keep the same share of their range that
    ``width`` is of half a turn.
    """
    freedoms: list[Freedom] = []
    for j, freedom in enumerate(targets.freedoms):
        lower, upper = freedom.lower, freedom.upper
        if full_turn(freedom):
            lower, upper = np.full_like(lower, -WIDE), np.full_like(upper, WIDE)
        share = width / np.pi
        away = 0.5 * share * (freedom.upper - freedom.lower) if slides_only(freedom) else width
        low = np.where(rows, np.maximum(lower, values[:, j] - away), lower)
        high = np.where(rows, np.minimum(upper, values[:, j] + away), upper)
        if isinstance(freedom, ScrewFreedom):
            freedom = dataclasses.replace(freedom, periodic=False)
        freedoms.append(dataclasses.replace(freedom, lower=low, upper=high))
    return dataclasses.replace(targets, freedoms=tuple(freedoms))


def around(count: int, moves: NDArray[np.intp], reach: int) -> BoolArray:
    """(count,) the targets at most ``reach`` away from either end of the moves to targets ``moves`` (M,)."""
    hit = np.zeros(count, dtype=np.bool_)
    hit[moves] = True
    hit[np.maximum(moves - 1, 0)] = True
    near = np.zeros(count + 1, dtype=np.intp)
    at = np.flatnonzero(hit)
    np.add.at(near, np.maximum(at - reach, 0), 1)
    np.add.at(near, np.minimum(at + reach + 1, count), -1)
    return np.asarray(np.cumsum(near)[:-1] > 0)
