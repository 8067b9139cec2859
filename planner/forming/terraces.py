"""Terraces: where a wall pauses on a flat, a feature ends and the next one begins.

A wall that goes on after a flat in the same direction (a stepped dish, a dimple alone in a floor) has level
lines that nest in one another throughout; the flat shows only in the plan area that they enclose, which
changes at once. Between the levels ``noise`` apart the mean width of the surface in plan is the change over
the length of the line.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from planner.forming.values import FloatArray

WIDTH: Final = 1e-3
"""Mean width [m] in plan, within a height of ``noise``, from which on a flat may be a terrace: 3 degrees."""
SHARE: Final = 0.1
"""The same as a share of the radius of a circle as large as the feature there, where that is less."""
LEAST: Final = 0.4e-3
"""Mean width [m] below which nothing is a terrace."""
CONTRAST: Final = 3.0
"""How many times wider a terrace is than the wall is somewhere before it and somewhere after it."""
WALL: Final = 2.0
"""Height of those walls at least, in units of ``noise``."""


@dataclasses.dataclass(frozen=True)
class Terrace:
    """``level`` [m] at which one feature ends and the next one begins; level lines are clean before ``first``
    and after ``last`` [m], in the direction of the wall."""

    level: float
    first: float
    last: float


class _Passed:
    """Plan area that lies before a depth, each face's spread evenly over its depths."""

    def __init__(self, near: FloatArray, far: FloatArray, area: FloatArray) -> None:
        rate = area / (far - near)
        order_near, order_far = np.argsort(near), np.argsort(far)
        self.near, self.far = near[order_near], far[order_far]
        self.sums = tuple(
            np.concatenate([[0.0], np.cumsum(values)])
            for values in (
                rate[order_near],
                (rate * near)[order_near],
                rate[order_far],
                (rate * far)[order_far],
            )
        )

    def __call__(self, depth: FloatArray) -> FloatArray:
        i, j = np.searchsorted(self.near, depth), np.searchsorted(self.far, depth)
        begun, begun_at, ended, ended_at = self.sums
        return np.asarray(depth * begun[i] - begun_at[i] - depth * ended[j] + ended_at[j])


def find(
    low: FloatArray, high: FloatArray, area: FloatArray, inside: float, start: float, end: float, noise: float
) -> list[Terrace]:
    """Terraces of a wall from level ``start`` to ``end`` [m], in its order.

    ``low``, ``high`` and ``area`` (F,): between which levels [m] each face lies, and its plan area [m^2].
    ``inside`` [m^2]: plan area that the wall's first level line encloses.
    """
    total = abs(end - start)
    if total < 2.0 * WALL * noise or len(area) == 0:
        return []
    sign = 1.0 if end > start else -1.0
    near = np.clip(np.where(sign > 0, low - start, start - high), 0.0, total)
    far = np.clip(np.where(sign > 0, high - start, start - low), 0.0, total)
    cell = noise / 5.0
    at = np.arange(0.5 * cell, total, cell)
    passed = _Passed(near, np.maximum(far, near + 0.01 * cell), area)
    change = passed(at + 0.5 * noise) - passed(at - 0.5 * noise)
    radius = np.sqrt(np.maximum(inside - passed(at - 0.5 * noise), 1e-12) / np.pi)
    width = change / (2.0 * np.pi * radius)
    flat = width >= np.maximum(np.clip(SHARE * radius, LEAST, WIDTH), CONTRAST * _walled(width, noise / cell))
    bounds = np.nonzero(np.diff(np.concatenate([[0], flat.astype(np.int8), [0]])))[0].reshape(-1, 2)
    return [_terrace(begin * cell, stop * cell, passed, start, sign, noise) for begin, stop in bounds]


def _walled(width: FloatArray, cells: float) -> FloatArray:
    """For each cell of height the width of the steepest wall before it, or after it if that is wider; where
    there is no wall on a side, infinite."""
    tall = round(WALL * cells)
    before = np.full(len(width), np.inf)
    after = before.copy()
    if len(width) > tall:
        widest = sliding_window_view(width, tall).max(axis=1)
        before[tall:] = np.minimum.accumulate(widest)[:-1]
        after[:-tall] = np.minimum.accumulate(widest[::-1])[::-1][1:]
    return np.asarray(np.maximum(before, after))


def _terrace(begin: float, stop: float, passed: _Passed, start: float, sign: float, noise: float) -> Terrace:
    # the window of heights makes a flat seem half of it higher on both sides
    begin, stop = sorted((begin + 0.5 * noise, stop - 0.5 * noise))
    cell = noise / 5.0
    if stop - begin > noise:  # it slopes: its own level lines belong to the wall before it
        levels = (stop, stop - cell, stop + cell)
        return Terrace(*(start + sign * level for level in levels))
    depths = np.linspace(begin - cell, stop + cell, 201)
    areas = passed(depths)
    middle = float(np.interp(0.5 * (areas[0] + areas[-1]), areas, depths))
    return Terrace(
        start + sign * middle,
        start + sign * min(begin - cell, middle - 0.1 * cell),
        start + sign * max(stop + cell, middle + 0.1 * cell),
    )
