"""The drawing of an element's panels by their outlines, with ids, the darker the farther they are off."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray

_PAGE: Final = 1400.0  # width of the drawing [px]
_WIDE: Final = 0.62  # mean width of a letter in sizes of type


@dataclasses.dataclass(frozen=True)
class DrawnPanel:
    """A panel's id and ``outline`` (C, 2) [mm], x to the right and y up; ``share`` of what is allowed that it
    is off."""

    name: str
    outline: FloatArray
    share: float
    dashed: bool = False


def panels_drawing(title: str, legend: str, panels: Sequence[DrawnPanel]) -> str:
    """All panels as a picture."""
    every = np.concatenate([panel.outline for panel in panels])
    low, size = every.min(axis=0), np.ptp(every, axis=0)
    scale = _PAGE / float(size[0])
    high = float(size[1]) * scale
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-40 -90 {_PAGE + 80:.0f} {high + 160:.0f}" '
        'font-family="sans-serif" fill="#1a1a1a">',
        f'<rect x="-40" y="-90" width="{_PAGE + 80:.0f}" height="{high + 160:.0f}" fill="#ffffff"/>',
        f'<text x="0" y="-52" font-size="28" font-weight="600">{title}</text>',
        f'<text x="0" y="-20" font-size="18">{legend}</text>',
    ]
    for panel in panels:
        flat = (panel.outline - low) * scale
        flat[:, 1] = high - flat[:, 1]
        shade = ",".join(str(round(255 + min(panel.share, 1.0) * (c - 255))) for c in (122, 170, 214))
        dashed = ' stroke-dasharray="6 4"' if panel.dashed else ""
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in flat.tolist())
        out.append(
            f'<polygon points="{points}" fill="rgb({shade})" stroke="#1a1a1a" stroke-width="1.5"{dashed}/>'
        )
        x, y = flat.mean(axis=0).tolist()
        text = min(
            22.0,
            0.72 * float(np.ptp(flat[:, 0])) / (_WIDE * len(panel.name)),
            0.5 * float(np.ptp(flat[:, 1])),
        )
        out.append(
            f'<text x="{x:.1f}" y="{y + 0.35 * text:.1f}" font-size="{text:.1f}" font-weight="600" '
            f'text-anchor="middle">{panel.name}</text>'
        )
    ends = f"{size[0]:.0f} x {size[1]:.0f} mm"
    out += [f'<text x="0" y="{high + 40:.0f}" font-size="18">{ends}</text>', "</svg>"]
    return "\n".join(out) + "\n"
