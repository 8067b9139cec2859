"""How far sections of a surface are off the nearest shape of a bent wire: a table over all intervals between
cut lines that a wire reaches.

Sections lie on the cut lines and half-way between them. Each interval of each section is fitted for itself,
with the wire's weight and the ends of the interval weighted, so that panels meet where their wires end; all
fits of a wire are one batch.
"""

from collections.abc import Callable

import numpy as np

from planner.element.surface import Profile
from planner.geometry.arrays import BoolArray, FloatArray
from planner.processes.hotwire.plan.elastica.fit import CurveFit, fit_curves

SECTION_POINTS = 21
"""Points of an interval that a fit sees."""
SECTIONS_PER_CELL = 2
"""Sections for each cell: on its line and in its middle."""
MISFIT_STEP = 1e-5
"""Misfits are rounded to this [m], so that a surface moved by less than nothing is divided the same way."""
_FITS_AT_ONCE = 2000


def section_places(lines: FloatArray, parts: int = SECTIONS_PER_CELL) -> FloatArray:
    """Places of the lines (n + 1,) and of ``parts`` - 1 between each two of them."""
    count = len(lines) - 1
    return np.asarray(np.interp(np.arange(parts * count + 1) / parts, np.arange(count + 1), lines))


def ends_weighted(count: int, points: int, weight: float) -> FloatArray:
    """Weights (count, points) of a fit, the ends ``weight`` times the others."""
    share = np.ones((count, points))
    share[:, [0, -1]] = weight
    return share


def misfits(
    profile: Profile,
    lines: FloatArray,
    wanted: BoolArray,
    length: float,
    outside: float,
    load: float,
    end_weight: float,
    holds: Callable[[CurveFit], BoolArray] | None = None,
) -> FloatArray:
    """Misfits (n, K, n) [m]: [w - 1, k, i] is that of section k from line i to line i + w, infinite where
    that is longer than a wire of ``length`` [m] with ``outside`` of it free, not ``wanted`` (n, K, n), or
    beyond the last line.
    Where ``holds`` (B,) is asked of the fits, also infinite where it does not.

    ``load``: the wire's weight over its stiffness [1/m^3]. The element lies with z up.
    """
    cells, count = len(lines) - 1, len(profile.at)
    table = np.full((cells, count, cells), np.inf)
    asked: list[tuple[int, int, int]] = []
    curves: list[FloatArray] = []
    share = np.linspace(0.0, 1.0, SECTION_POINTS)
    for k in range(count):
        place, height, arc = profile.place[k], profile.height[k], profile.length[k]
        at = np.interp(lines, place, arc)
        for i in range(cells):
            last = int(np.searchsorted(at, at[i] + length - outside + 1e-9, side="right")) - 1
            ends = np.arange(i + 1, last + 1)
            ends = ends[wanted[ends - i - 1, k, i]]
            if not len(ends):
                continue
            inside = at[i] + (at[ends] - at[i])[:, None] * share
            x = np.interp(inside, arc, place)
            curves.append(np.stack([x, np.interp(x, place, height)], axis=-1))
            asked += [(int(end) - i - 1, k, i) for end in ends]
    if not asked:
        return table
    targets = np.concatenate(curves)
    found = []
    for start in range(0, len(targets), _FITS_AT_ONCE):
        some = targets[start : start + _FITS_AT_ONCE]
        batch = len(some)
        fit = fit_curves(
            some,
            np.full(batch, length),
            np.tile([0.0, -load], (batch, 1)),
            ends_weighted(batch, SECTION_POINTS, end_weight),
        )
        good = np.isfinite(fit.largest)
        if holds is not None:
            good &= holds(fit)
        found.append(np.where(good, fit.largest, np.inf))
    largest = np.concatenate(found)
    rounded = np.where(np.isfinite(largest), np.round(largest / MISFIT_STEP) * MISFIT_STEP, np.inf)
    table[tuple(np.array(asked).T)] = rounded
    return table


def worst_over(table: FloatArray, across: int) -> FloatArray:
    """Largest misfits (n, m, n, m) of rectangles: [w - 1, h - 1, i, j] over the sections of cells j to j + h
    of the ``across`` = m cells on the other axis, from a table (n, 2 m + 1, n); infinite beyond the grid."""
    cells = table.shape[0]
    out = np.full((cells, across, cells, across), np.inf)
    first = np.arange(across) * SECTIONS_PER_CELL
    so_far = table[:, first, :]  # (n, m, n): by w, j, i
    for h in range(1, across + 1):
        fits = across - h + 1
        so_far = so_far[:, :fits]
        for step in range(SECTIONS_PER_CELL):
            row = first[:fits] + (h - 1) * SECTIONS_PER_CELL + step + 1
            so_far = np.maximum(so_far, table[:, row, :])
        out[:, h - 1, :, :fits] = so_far.transpose(0, 2, 1)
    return out


def sections_of(rectangles: BoolArray) -> BoolArray:
    """Which intervals (n, 2 m + 1, n) of sections rectangles (n, m, n, m) need: `worst_over` the other
    way."""
    cells, across = rectangles.shape[:2]
    out = np.zeros((cells, SECTIONS_PER_CELL * across + 1, cells), dtype=np.bool_)
    for h in range(1, across + 1):
        for j in range(across - h + 1):
            rows = slice(SECTIONS_PER_CELL * j, SECTIONS_PER_CELL * (j + h) + 1)
            out[:, rows] |= rectangles[:, h - 1, :, j][:, None]
    return out
