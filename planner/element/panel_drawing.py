"""Drawing of the panels of an element by their outlines, with ids; darker panels deviate more."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray

_PAGE: Final = 1400.0  # width of the drawing [px]
_LETTER_WIDTH: Final = 0.62  # mean width of a letter as a fraction of the font size
BOLD_LETTER_WIDTH: Final = 0.72
"""Width of a bold letter as a fraction of the font size."""
_FONT_FACTORS: Final = np.linspace(1.0, 0.5, 11)  # tried factors on the requested font size


@dataclasses.dataclass(frozen=True)
class DrawnPanel:
    """A panel to draw.

    Attributes:
        name: Id.
        outline: Outline (C, 2) [mm], x to the right and y up.
        fraction: Deviation as a fraction of the allowed one; darker if larger.
        dashed: Whether the outline is dashed.
    """

    name: str
    outline: FloatArray
    fraction: float
    dashed: bool = False


def inner_point(outline: FloatArray) -> tuple[float, float]:
    """Return a point inside an outline (C, 2): its centroid if that is inside, else another inner point."""
    shape = shapely.Polygon(outline).buffer(0.0)
    point = shape.centroid if shape.contains(shape.centroid) else shape.representative_point()
    return float(point.x), float(point.y)


def fit_text(outline: FloatArray, width: float, height: float) -> tuple[float, float, float]:
    """Return where and how large a text of ``width`` x ``height`` fits in an outline (C, 2).

    Returns:
        Centre x and y, and the largest of `_FONT_FACTORS` with which the text fits; the smallest if none
            fits.
    """
    shape = shapely.Polygon(outline).buffer(0.0)
    x, y = inner_point(outline)
    half = 0.5 * _FONT_FACTORS[:, None] * [width, height]
    boxes = shapely.box(x - half[:, 0], y - half[:, 1], x + half[:, 0], y + half[:, 1])
    # the last entry ends the search if no factor fits
    fit = np.append(shapely.contains(shape, boxes), True)
    return x, y, float(_FONT_FACTORS[min(int(np.argmax(fit)), len(_FONT_FACTORS) - 1)])


def draw_panels(title: str, legend: str, panels: Sequence[DrawnPanel]) -> str:
    """Draw all panels with a title and a legend above, and return the text of the SVG file."""
    points_of_all = np.concatenate([panel.outline for panel in panels])
    low, size = points_of_all.min(axis=0), np.ptp(points_of_all, axis=0)
    scale = _PAGE / float(size[0])
    height = float(size[1]) * scale
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-40 -90 {_PAGE + 80:.0f} {height + 160:.0f}" '
        'font-family="sans-serif" fill="#1a1a1a">',
        f'<rect x="-40" y="-90" width="{_PAGE + 80:.0f}" height="{height + 160:.0f}" fill="#ffffff"/>',
        f'<text x="0" y="-52" font-size="28" font-weight="600">{title}</text>',
        f'<text x="0" y="-20" font-size="18">{legend}</text>',
    ]
    for panel in panels:
        outline = (panel.outline - low) * scale
        outline[:, 1] = height - outline[:, 1]
        shade = ",".join(str(round(255 + min(panel.fraction, 1.0) * (c - 255))) for c in (122, 170, 214))
        dashed = ' stroke-dasharray="6 4"' if panel.dashed else ""
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in outline.tolist())
        out.append(
            f'<polygon points="{points}" fill="rgb({shade})" stroke="#1a1a1a" stroke-width="1.5"{dashed}/>'
        )
        font_size = min(
            22.0,
            0.72 * float(np.ptp(outline[:, 0])) / (_LETTER_WIDTH * len(panel.name)),
            0.5 * float(np.ptp(outline[:, 1])),
        )
        x, y, factor = fit_text(outline, BOLD_LETTER_WIDTH * len(panel.name) * font_size, font_size)
        font_size *= factor
        out.append(
            f'<text x="{x:.1f}" y="{y + 0.35 * font_size:.1f}" font-size="{font_size:.1f}" font-weight="600" '
            f'text-anchor="middle">{panel.name}</text>'
        )
    size_text = f"{size[0]:.0f} x {size[1]:.0f} mm"
    out += [f'<text x="0" y="{height + 40:.0f}" font-size="18">{size_text}</text>', "</svg>"]
    return "\n".join(out) + "\n"
