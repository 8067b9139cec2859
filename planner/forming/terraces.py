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

from planner.forming.values import FloatArray

WIDTH: Final = 2e-3
"""Mean width [m] in plan, within a height of ``noise``, from which on a flat is a terrace."""
SHARE: Final = 0.1
"""The same as a share of the radius of a circle as large as the feature there, where that is less."""
LEAST: Final = 0.5e-3
"""Mean width [m] below which nothing is a terrace."""
WALL: Final = 2.0
"""Height of the walls before and after a terrace, in units of ``noise``, from which on they are walls."""


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
    flat = change / (2.0 * np.pi * radius) >= np.clip(SHARE * radius, LEAST, WIDTH)
    bounds = np.nonzero(np.diff(np.concatenate([[0], flat.astype(np.int8), [0]])))[0].reshape(-1, 2)
    found: list[Terrace] = []
    walls = np.concatenate([[0.0], np.cumsum(~flat) * cell])
    since = 0.0
    for begin, stop in bounds:
        if walls[begin] - since < WALL * noise or walls[-1] - walls[stop] < WALL * noise:
            continue
        since = float(walls[begin])
        found.append(_terrace(begin * cell, stop * cell, passed, start, sign, noise))
    return found


def _terrace(begin: float, stop: float, passed: _Passed, start: float, sign: float, noise: float) -> Terrace:
    # the window of heights makes a flat seem half of it higher on both sides
    begin, stop = begin + 0.5 * noise, stop - 0.5 * noise
    cell = noise / 5.0
    if stop - begin > noise:  # it slopes: its own level lines belong to the wall before it
        return Terrace(start + sign * stop, start + sign * stop, start + sign * (stop + cell))
    depths = np.linspace(begin - cell, stop + cell, 201)
    areas = passed(depths)
    middle = float(np.interp(0.5 * (areas[0] + areas[-1]), areas, depths))
    return Terrace(
        start + sign * middle,
        start + sign * min(begin - cell, middle),
        start + sign * max(stop + cell, middle),
    )
