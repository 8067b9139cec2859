"""Map of what the arms can do at each target and value of one freedom, with the path of the plan."""

import dataclasses
import html
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import FloatArray
from planner.report.markup import Drawing, FigureBlock

WIDTH, HEIGHT, LEFT, TOP, GAP = 640.0, 120.0, 64.0, 18.0, 26.0
"""Sizes of a strip and of what is around it [px]."""
STATE_COLOURS: Final = ("--ok-bg", "--soft", "--c4", "--c3", "--c1")
"""Colours by state of an arm, in the order of `FreedomMapData.causes`."""
CONTINUOUS_ROTATION_DEG: Final = 330.0
"""Range of a freedom [deg] above which it may rotate without end."""
TEXT_STYLE: Final = 'style="font-size:11px;fill:var(--soft)"'
DISTANCE_COLOURS: Final = (("--warn", 2.0), ("--c2", 3.0), ("--ok-bg", np.inf))
"""Colours of distances below these multiples of the clearance. Below 1 nothing is free."""
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
        states: Index into ``causes`` {arm: (K, V)}.
        causes: Causes why an arm is not free. The first is none.
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
    """Draw the map with its legend: a strip for each arm, and one for distances between bodies."""
    fills = np.array(STATE_COLOURS, dtype=object)
    strips = [(arm, fills[state]) for arm, state in shown.states.items()]
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
    k = int(np.argmin(shown.free_fraction))
    note = f"Smallest range at {shown.names[k]}: {100.0 * shown.free_fraction[k]:.0f} % of the values."
    unit = f" [{shown.unit}]" if shown.unit else ""
    title = f"{shown.operation}: {shown.freedom}{unit} over {len(shown.names)} targets"
    return FigureBlock(title, Drawing(f"{svg}{''.join(parts)}</svg>{_legend(shown)}"), note)


def _description(shown: FreedomMapData) -> str:
    free = 100.0 * float(np.isfinite(shown.distance).mean())
    return f"{shown.freedom} of {shown.operation}: all arms are free at {free:.0f} % of the points"


def _legend(shown: FreedomMapData) -> str:
    arms = [(fill, text or "free") for text, fill in zip(shown.causes, STATE_COLOURS, strict=True)]
    (first, twice), (second, thrice), (remaining, _) = DISTANCE_COLOURS
    distance_keys = [
        (first, f"bodies under {twice * shown.clearance:g} mm apart"),
        (second, f"under {thrice * shown.clearance:g} mm"),
        (remaining, "farther"),
    ]
    keys = [
        f'<span style="white-space:nowrap"><i style="display:inline-block;width:.9em;height:.9em;'
        f'border:1px solid var(--line);background:var({fill})"></i> {html.escape(text)}</span>'
        for fill, text in (*arms, *distance_keys)
    ]
    return f'<div class="legend">{" ".join(keys)} <span>line: the plan</span></div>'


def _distance_colours(shown: FreedomMapData) -> NDArray[np.object_]:
    ratio = shown.distance / max(shown.clearance, 1e-9)
    out = np.full(ratio.shape, NOT_FREE_COLOUR, dtype=object)
    for fill, below in reversed(DISTANCE_COLOURS):
        out[ratio < below] = fill  # comparisons with NaN are false
    return out


def _cells(fills: NDArray[np.object_], top: float) -> Iterator[str]:
    """Yield rectangles, adjacent ones of one colour merged. The largest value is uppermost."""
    count, values = fills.shape
    wide, high = WIDTH / count, HEIGHT / values
    for v in range(values):
        row = fills[:, v]
        starts = np.flatnonzero(np.append(True, row[1:] != row[:-1]))
        for start, end in zip(starts, np.append(starts[1:], count), strict=True):
            yield (
                f'<rect x="{LEFT + start * wide:.1f}" y="{top + HEIGHT - (v + 1) * high:.1f}" '
                f'width="{(end - start) * wide + 0.3:.1f}" height="{high + 0.3:.1f}" '
                f'style="fill:var({row[start]})"/>'
            )


def _path_lines(shown: FreedomMapData, top: float) -> str:
    """Draw the values of the plan. A continuous rotation starts a new line where it wraps around."""
    count, values = shown.values.shape
    wide, high = WIDTH / count, HEIGHT / values
    low, step = shown.values[:, 0], np.diff(shown.values[:, [0, -1]], axis=1)[:, 0] / (values - 1)
    row_position = (shown.path - low) / np.where(step > 0.0, step, 1.0)
    x = LEFT + (np.arange(count) + 0.5) * wide
    y = top + HEIGHT - (row_position + 0.5) * high
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
