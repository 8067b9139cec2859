"""What the arms can do over the targets at each value of one freedom, as a picture, with the plan's own way
through it."""

import dataclasses
import html
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import FloatArray
from planner.report.markup import Drawing, Figure

WIDTH, HEIGHT, LEFT, TOP, GAP = 640.0, 120.0, 64.0, 18.0, 26.0
"""Sizes of a strip and of what is around it [px]."""
FILLS: Final = ("--ok-bg", "--soft", "--c4", "--c3", "--c1")
"""Colours by what an arm can do there, in the order of `FreedomMap.causes`."""
LARGE_TURN_DEG: Final = 330.0
"""A freedom that turns over more [deg] may turn without end."""
TEXT: Final = 'style="font-size:11px;fill:var(--soft)"'
NEAR_FILLS: Final = (("--warn", 2.0), ("--c2", 3.0), ("--ok-bg", np.inf))
"""Colours of distances below so many times the clearance; below once nothing is free."""
NOT_FREE: Final = "--c1"
"""Colour of places at which bodies are not held apart, since an arm is not free there."""


@dataclasses.dataclass(frozen=True)
class FreedomMap:
    """K targets of an ``operation``, by their ``names``, with V ``values`` (K, V) of a ``freedom`` each, in
    ``unit``. ``states`` {arm: (K, V)}: which of ``causes`` stands in an arm's way, the first of which is
    nothing. ``apart`` (K, V) [mm] between bodies where all is free, else NaN; ``clearance`` [mm] is asked.
    ``path`` (K,): where the plan goes."""

    operation: str
    freedom: str
    unit: str
    names: tuple[str, ...]
    values: FloatArray
    states: Mapping[str, NDArray[np.int8]]
    causes: tuple[str, ...]
    apart: FloatArray
    clearance: float
    path: FloatArray

    @property
    def room(self) -> FloatArray:
        """The share (K,) of values at which all arms can be."""
        return np.asarray(np.isfinite(self.apart).mean(axis=1))


def figure(shown: FreedomMap) -> Figure:
    """The map with its legend; a strip for each arm, and one for distances between bodies."""
    fills = np.array(FILLS, dtype=object)
    strips = [(arm, fills[state]) for arm, state in shown.states.items()]
    strips.append(("bodies apart", _near(shown)))
    height = len(strips) * (HEIGHT + GAP) + TOP
    low, high = float(shown.values.min()), float(shown.values.max())
    parts = []
    for number, (title, fills) in enumerate(strips):
        top = TOP + number * (HEIGHT + GAP)
        parts += [
            f'<text x="{LEFT:g}" y="{top - 5:g}" {TEXT}>{html.escape(title)}</text>',
            f'<text x="{LEFT - 6:g}" y="{top + 10:g}" {TEXT} text-anchor="end">{high:.4g}</text>',
            f'<text x="{LEFT - 6:g}" y="{top + HEIGHT:g}" {TEXT} text-anchor="end">{low:.4g}</text>',
            *_cells(fills, top),
            _way(shown, top),
        ]
    svg = (
        f'<svg viewBox="0 0 {LEFT + WIDTH:g} {height:g}" role="img" aria-label="{html.escape(_told(shown))}">'
    )
    k = int(np.argmin(shown.room))
    note = f"Least room at {shown.names[k]}: {100.0 * shown.room[k]:.0f} % of the values."
    unit = f" [{shown.unit}]" if shown.unit else ""
    title = f"{shown.operation}: {shown.freedom}{unit} over {len(shown.names)} targets"
    return Figure(title, Drawing(f"{svg}{''.join(parts)}</svg>{_legend(shown)}"), note)


def _told(shown: FreedomMap) -> str:
    free = 100.0 * float(np.isfinite(shown.apart).mean())
    return f"{shown.freedom} of {shown.operation}: all arms are free at {free:.0f} % of the places"


def _legend(shown: FreedomMap) -> str:
    arms = [(fill, text or "free") for text, fill in zip(shown.causes, FILLS, strict=True)]
    (first, twice), (second, thrice), (far, _) = NEAR_FILLS
    near = [
        (first, f"bodies under {twice * shown.clearance:g} mm apart"),
        (second, f"under {thrice * shown.clearance:g} mm"),
        (far, "farther"),
    ]
    keys = [
        f'<span style="white-space:nowrap"><i style="display:inline-block;width:.9em;height:.9em;'
        f'border:1px solid var(--line);background:var({fill})"></i> {html.escape(text)}</span>'
        for fill, text in (*arms, *near)
    ]
    return f'<div class="legend">{" ".join(keys)} <span>line: the plan</span></div>'


def _near(shown: FreedomMap) -> NDArray[np.object_]:
    times = shown.apart / max(shown.clearance, 1e-9)
    out = np.full(times.shape, NOT_FREE, dtype=object)
    for fill, below in reversed(NEAR_FILLS):
        out[times < below] = fill  # NaN is not below anything
    return out


def _cells(fills: NDArray[np.object_], top: float) -> Iterator[str]:
    """Rectangles, those of one colour beside each other as one; the largest value is uppermost."""
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


def _way(shown: FreedomMap, top: float) -> str:
    """The plan's values; where what turns without end comes round, a new line begins."""
    count, values = shown.values.shape
    wide, high = WIDTH / count, HEIGHT / values
    low, step = shown.values[:, 0], np.diff(shown.values[:, [0, -1]], axis=1)[:, 0] / (values - 1)
    place = (shown.path - low) / np.where(step > 0.0, step, 1.0)
    x = LEFT + (np.arange(count) + 0.5) * wide
    y = top + HEIGHT - (place + 0.5) * high
    round_ = shown.unit == "deg" and float(np.ptp(shown.values)) > LARGE_TURN_DEG
    jumps = np.flatnonzero(round_ & (np.abs(np.diff(place)) > 0.5 * values)) + 1
    lines = zip(np.split(x, jumps), np.split(y, jumps), strict=True)
    points = [" ".join(f"{a:.1f},{b:.1f}" for a, b in zip(*one, strict=True)) for one in lines]
    return "".join(
        f'<polyline points="{one}" style="fill:none;stroke:var(--ink);stroke-width:2"/>' for one in points
    )
