"""Misfit of sections of a surface: distance from the closest bent wire, for all intervals between cut lines.

Sections lie on the cut lines and halfway between them. Each interval of each section that a wire reaches is
fitted separately, with the weight of the wire, and with weighted ends so that panels meet where their wires
end. All fits of a wire are one batch.
"""

from collections.abc import Callable

import numpy as np

from planner.element.panel_faces import CutWire
from planner.element.surface import SectionProfiles
from planner.geometry.arrays import BoolArray, FloatArray
from planner.processes.hotwire.plan.elastica.fit import CurveFit, fit_curves

SECTION_POINTS = 21
"""Number of points of an interval in a fit."""
SECTIONS_PER_CELL = 2
"""Number of sections per cell: on its lower cut line and in its middle."""
MISFIT_STEP_M = 1e-5
"""Step [m] to which misfits are rounded, so that tiny motions of the surface do not change the division."""
_FITS_AT_ONCE = 2000  # in one batch


def section_positions(lines: FloatArray, parts: int = SECTIONS_PER_CELL) -> FloatArray:
    """Return the lines (n + 1,) [m] with ``parts`` - 1 even positions between two lines: (parts n + 1,)."""
    count = len(lines) - 1
    return np.asarray(np.interp(np.arange(parts * count + 1) / parts, np.arange(count + 1), lines))


def end_weights(count: int, points: int, weight: float) -> FloatArray:
    """Return the weights (count, points) of points in fits: ``weight`` for both ends, 1 for the others."""
    weights = np.ones((count, points))
    weights[:, [0, -1]] = weight
    return weights


def compute_misfits(
    profile: SectionProfiles,
    lines: FloatArray,
    required: BoolArray,
    cut: CutWire,
    end_weight: float,
    holds: Callable[[CurveFit], BoolArray] | None = None,
) -> FloatArray:
    """Compute the misfits of all intervals of sections. Gravity acts along -z of the element.

    Args:
        profile: Sections (K).
        lines: Cut lines (n + 1,) [m].
        required: Intervals (n, K, n) to compute.
        cut: Wire.
        end_weight: Weight of the ends of an interval, relative to its other points.
        holds: Returns whether the wire is held in each fit (B,); None to skip that check.

    Returns:
        Misfits (n, K, n) [m]: [w - 1, k, i] is that of section k from line i to line i + w. Infinite if the
            interval is too long for the wire, not required, beyond the last line, or not held.
    """
    length, outside, load = cut.length, cut.outside, cut.wire.load_over_stiffness
    cells, count = len(lines) - 1, len(profile.at)
    table = np.full((cells, count, cells), np.inf)
    indices: list[tuple[int, int, int]] = []
    curves: list[FloatArray] = []
    fractions = np.linspace(0.0, 1.0, SECTION_POINTS)
    for k in range(count):
        position, height, arc = profile.position[k], profile.height[k], profile.length[k]
        line_arc = np.interp(lines, position, arc)
        for i in range(cells):
            last = int(np.searchsorted(line_arc, line_arc[i] + length - outside + 1e-9, side="right")) - 1
            ends = np.arange(i + 1, last + 1)
            ends = ends[required[ends - i - 1, k, i]]
            if not len(ends):
                continue
            arc_positions = line_arc[i] + (line_arc[ends] - line_arc[i])[:, None] * fractions
            x = np.interp(arc_positions, arc, position)
            curves.append(np.stack([x, np.interp(x, position, height)], axis=-1))
            indices += [(int(end) - i - 1, k, i) for end in ends]
    if not indices:
        return table
    targets = np.concatenate(curves)
    batches = []
    for start in range(0, len(targets), _FITS_AT_ONCE):
        batch_targets = targets[start : start + _FITS_AT_ONCE]
        batch_size = len(batch_targets)
        fit = fit_curves(
            batch_targets,
            np.full(batch_size, length),
            np.tile([0.0, -load], (batch_size, 1)),
            end_weights(batch_size, SECTION_POINTS, end_weight),
        )
        is_feasible = np.isfinite(fit.largest)
        if holds is not None:
            is_feasible &= holds(fit)
        batches.append(np.where(is_feasible, fit.largest, np.inf))
    misfits = np.concatenate(batches)
    rounded = np.where(np.isfinite(misfits), np.round(misfits / MISFIT_STEP_M) * MISFIT_STEP_M, np.inf)
    table[tuple(np.array(indices).T)] = rounded
    return table


def worst_misfits(table: FloatArray, across: int) -> FloatArray:
    """Return the largest misfits (n, m, n, m) [m] of rectangles from a table (n, 2 m + 1, n) of sections.

    [w - 1, h - 1, i, j] is the maximum over the sections of cells j to j + h - 1 of the ``across`` = m cells
    on the other axis, edges included. It is infinite beyond the grid.
    """
    cells = table.shape[0]
    out = np.full((cells, across, cells, across), np.inf)
    first_sections = np.arange(across) * SECTIONS_PER_CELL
    # running maximum over the height h: each step adds the sections of one more cell
    running_max = table[:, first_sections, :]  # (n, m, n): by w, j, i
    for h in range(1, across + 1):
        count = across - h + 1
        running_max = running_max[:, :count]
        for step in range(SECTIONS_PER_CELL):
            sections = first_sections[:count] + (h - 1) * SECTIONS_PER_CELL + step + 1
            running_max = np.maximum(running_max, table[:, sections, :])
        out[:, h - 1, :, :count] = running_max.transpose(0, 2, 1)
    return out


def required_sections(rectangles: BoolArray) -> BoolArray:
    """Return which intervals (n, 2 m + 1, n) of sections are in any of the given rectangles (n, m, n, m).

    `worst_misfits` of these rectangles needs only these intervals; the indices are the same.
    """
    cells, across = rectangles.shape[:2]
    out = np.zeros((cells, SECTIONS_PER_CELL * across + 1, cells), dtype=np.bool_)
    for h in range(1, across + 1):
        for j in range(across - h + 1):
            sections = slice(SECTIONS_PER_CELL * j, SECTIONS_PER_CELL * (j + h) + 1)
            out[:, sections] |= rectangles[:, h - 1, :, j][:, None]
    return out
