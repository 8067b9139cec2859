"""Map of whether the arms reach each target at each value of one freedom, with the path of the plan."""

import dataclasses
import html
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import FloatArray
from planner.report.markup import Drawing, FigureBlock

WIDTH, HEIGHT, LEFT, TOP, GAP = 640.0, 120.0, 64.0, 18.0, 26.0
"""Width and height of a strip, space left of and above the strips, and between two of them [px]."""
STATE_COLOURS: Final = ("--ok-bg", "--soft", "--c4", "--c3", "--c1")
"""Colours by state of an arm, in the order of `FreedomMapData.causes`."""
CONTINUOUS_ROTATION_DEG: Final = 330.0
"""Range of a freedom [deg] above which it is considered a continuous rotation."""
TEXT_STYLE: Final = 'style="font-size:11px;fill:var(--soft)"'
DISTANCE_COLOURS: Final = (("--warn", 2.0), ("--c2", 3.0), ("--ok-bg", np.inf))
"""Colours of distances below these multiples of the clearance. Points below the clearance are not free."""
NOT_FREE_COLOUR: Final = "--c1"
"""Colour where collisions were not tested, because an arm is not free."""


@dataclasses.dataclass(frozen=True)
class FreedomMapData:
    """Map of one freedom over K targets and V values.

    Attributes:
        operation: Name of the operation.
        freedom: Name of the freedom.
        unit: Unit of its values.
        names: Names of the targets.
        values: Values of the freedom (K, V).
        states: Indices into ``causes`` {arm: (K, V)}.
        causes: Causes why an arm is not free. The first one is empty: the arm is free.
        distance: Distance between bodies (K, V) [mm] where all arms are free, else NaN.
        clearance: Required clearance [mm].
        path: Values of the plan (K,).
    """

    operation: str
    freedom: str
    unit: str
    names: tuple[str, ...]
    values: FloatArray
    states: Mapping[str, NDArray[np.int8]]
    causes: tuple[str, ...]
    distance: FloatArray
    clearance: float
    path: FloatArray

    @property
    def free_fraction(self) -> FloatArray:
        """Fraction (K,) of values at which all arms are free."""
        return np.asarray(np.isfinite(self.distance).mean(axis=1))


def figure(shown: FreedomMapData) -> FigureBlock:
    """Draw the map of a freedom with its legend: a strip for each arm, and one for distances of bodies.

    In each strip the targets are along x and the values of the freedom along y. The path that the plan takes
    is drawn over it.
    """
    colours = np.array(STATE_COLOURS, dtype=object)
    strips = [(arm, colours[state]) for arm, state in shown.states.items()]
    strips.append(("distance between bodies", _distance_colours(shown)))
    height = len(strips) * (HEIGHT + GAP) + TOP
    low, high = float(shown.values.min()), float(shown.values.max())
    parts = []
    for number, (title, fills) in enumerate(strips):
        top = TOP + number * (HEIGHT + GAP)
        parts += [
            f'<text x="{LEFT:g}" y="{top - 5:g}" {TEXT_STYLE}>{html.escape(title)}</text>',
            f'<text x="{LEFT - 6:g}" y="{top + 10:g}" {TEXT_STYLE} text-anchor="end">{high:.4g}</text>',
            f'<text x="{LEFT - 6:g}" y="{top + HEIGHT:g}" {TEXT_STYLE} text-anchor="end">{low:.4g}</text>',
            *_cells(fills, top),
            _path_lines(shown, top),
        ]
    svg = (
        f'<svg viewBox="0 0 {LEFT + WIDTH:g} {height:g}" role="img" '
        f'aria-label="{html.escape(_description(shown))}">'
    )
    worst_index = int(np.argmin(shown.free_fraction))
    worst_fraction = shown.free_fraction[worst_index]
    note = f"Smallest range at {shown.names[worst_index]}: {100.0 * worst_fraction:.0f} % of the values."
    unit = f" [{shown.unit}]" if shown.unit else ""
    title = f"{shown.operation}: {shown.freedom}{unit} over {len(shown.names)} targets"
    return FigureBlock(title, Drawing(f"{svg}{''.join(parts)}</svg>{_legend(shown)}"), note)


def _description(shown: FreedomMapData) -> str:
    """Return the text alternative of the map: at which percentage of its points all arms are free."""
    free_percent = 100.0 * float(np.isfinite(shown.distance).mean())
    return f"{shown.freedom} of {shown.operation}: all arms are free at {free_percent:.0f} % of the points"


def _legend(shown: FreedomMapData) -> str:
    """Return the HTML of the legend: causes why arms are not free, distances, and the path."""
    state_keys = [(fill, text or "free") for text, fill in zip(shown.causes, STATE_COLOURS, strict=True)]
    (near_colour, near_factor), (middle_colour, middle_factor), (far_colour, _) = DISTANCE_COLOURS
    distance_keys = [
        (near_colour, f"bodies under {near_factor * shown.clearance:g} mm apart"),
        (middle_colour, f"under {middle_factor * shown.clearance:g} mm"),
        (far_colour, "farther"),
    ]
    keys = [
        f'<span style="white-space:nowrap"><i style="display:inline-block;width:.9em;height:.9em;'
        f'border:1px solid var(--line);background:var({fill})"></i> {html.escape(text)}</span>'
        for fill, text in (*state_keys, *distance_keys)
    ]
    return f'<div class="legend">{" ".join(keys)} <span>line: the plan</span></div>'


def _distance_colours(shown: FreedomMapData) -> NDArray[np.object_]:
    """Return the colours (K, V) of the distances between bodies."""
    ratio = shown.distance / max(shown.clearance, 1e-9)
    out = np.full(ratio.shape, NOT_FREE_COLOUR, dtype=object)
    # Smaller limits overwrite greater ones. Comparisons with NaN are false: such points are not free.
    for fill, limit in reversed(DISTANCE_COLOURS):
        out[ratio < limit] = fill
    return out


def _cells(fills: NDArray[np.object_], top: float) -> Iterator[str]:
    """Yield rectangles of colours (K, V), equal neighbours in a row merged, the largest value uppermost."""
    count, values = fills.shape
    cell_width, cell_height = WIDTH / count, HEIGHT / values
    for v in range(values):
        row = fills[:, v]
        starts = np.flatnonzero(np.append(True, row[1:] != row[:-1]))
        for start, end in zip(starts, np.append(starts[1:], count), strict=True):
            yield (
                f'<rect x="{LEFT + start * cell_width:.1f}" y="{top + HEIGHT - (v + 1) * cell_height:.1f}" '
                f'width="{(end - start) * cell_width + 0.3:.1f}" height="{cell_height + 0.3:.1f}" '
                f'style="fill:var({row[start]})"/>'
            )


def _path_lines(shown: FreedomMapData, top: float) -> str:
    """Draw the values of the plan over the strip with the upper edge ``top`` [px].

    A continuous rotation starts a new line where it wraps around.
    """
    count, values = shown.values.shape
    cell_width, cell_height = WIDTH / count, HEIGHT / values
    low = shown.values[:, 0]
    step = np.diff(shown.values[:, [0, -1]], axis=1)[:, 0] / (values - 1)
    row_position = (shown.path - low) / np.where(step > 0.0, step, 1.0)
    x = LEFT + (np.arange(count) + 0.5) * cell_width
    y = top + HEIGHT - (row_position + 0.5) * cell_height
    is_continuous = shown.unit == "deg" and float(np.ptp(shown.values)) > CONTINUOUS_ROTATION_DEG
    jumps = np.flatnonzero(is_continuous & (np.abs(np.diff(row_position)) > 0.5 * values)) + 1
    lines = zip(np.split(x, jumps), np.split(y, jumps), strict=True)
    points = [
        " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(*line_points, strict=True)) for line_points in lines
    ]
    return "".join(
        f'<polyline points="{line_points}" style="fill:none;stroke:var(--ink);stroke-width:2"/>'
        for line_points in points
    )
