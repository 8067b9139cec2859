"""Drawing of the panels of an element by their outlines, with ids; darker panels deviate more."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray

_PAGE: Final = 1400.0  # width of the drawing [px]
_WIDE: Final = 0.62  # mean width of a letter in sizes of type
BOLD_LETTER_WIDTH: Final = 0.72
"""Width of a bold letter in font sizes."""
_SHARES: Final = np.linspace(1.0, 0.5, 11)  # of the size asked, to which words are made smaller


@dataclasses.dataclass(frozen=True)
class DrawnPanel:
    """A panel to draw.

    Attributes:
        name: Id.
        outline: Outline (C, 2) [mm], x to the right and y up.
        fraction: Deviation as a fraction of what is allowed.
        dashed: Whether the outline is dashed.
    """

    name: str
    outline: FloatArray
    fraction: float
    dashed: bool = False


def inner_point(outline: FloatArray) -> tuple[float, float]:
    """Return a point well inside an outline (C, 2): its centroid if that is inside."""
    shape = shapely.Polygon(outline).buffer(0.0)
    point = shape.centroid if shape.contains(shape.centroid) else shape.representative_point()
    return float(point.x), float(point.y)


def fit_text(outline: FloatArray, width: float, height: float) -> tuple[float, float, float]:
    """Return the centre (x, y) of text in an outline (C, 2), and the factor by which it fits there.

    The factor on ``width`` and ``height`` is 1 to 0.5, even if that does not fit.
    """
    shape = shapely.Polygon(outline).buffer(0.0)
    x, y = inner_point(outline)
    half = 0.5 * _SHARES[:, None] * [width, height]
    boxes = shapely.box(x - half[:, 0], y - half[:, 1], x + half[:, 0], y + half[:, 1])
    fit = np.append(shapely.contains(shape, boxes), True)
    return x, y, float(_SHARES[min(int(np.argmax(fit)), len(_SHARES) - 1)])


def draw_panels(title: str, legend: str, panels: Sequence[DrawnPanel]) -> str:
    """Draw all panels as an SVG."""
    points_of_all = np.concatenate([panel.outline for panel in panels])
    low, size = points_of_all.min(axis=0), np.ptp(points_of_all, axis=0)
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
        shade = ",".join(str(round(255 + min(panel.fraction, 1.0) * (c - 255))) for c in (122, 170, 214))
        dashed = ' stroke-dasharray="6 4"' if panel.dashed else ""
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in flat.tolist())
        out.append(
            f'<polygon points="{points}" fill="rgb({shade})" stroke="#1a1a1a" stroke-width="1.5"{dashed}/>'
        )
        text = min(
            22.0,
            0.72 * float(np.ptp(flat[:, 0])) / (_WIDE * len(panel.name)),
            0.5 * float(np.ptp(flat[:, 1])),
        )
        x, y, factor = fit_text(flat, BOLD_LETTER_WIDTH * len(panel.name) * text, text)
        text *= factor
        out.append(
            f'<text x="{x:.1f}" y="{y + 0.35 * text:.1f}" font-size="{text:.1f}" font-weight="600" '
            f'text-anchor="middle">{panel.name}</text>'
        )
    ends = f"{size[0]:.0f} x {size[1]:.0f} mm"
    out += [f'<text x="0" y="{high + 40:.0f}" font-size="18">{ends}</text>', "</svg>"]
    return "\n".join(out) + "\n"
