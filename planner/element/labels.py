"""``labels.svg``: a label for each panel, to be printed at 1:1 and put on its front.

A label has the id of the panel, its outline with up upward, and at each edge the id of the panel beyond.
Eight labels fill a sheet of A4. Capitals are at least 5 mm high; overlapping texts are moved apart, or the
outline is drawn smaller.
"""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any, Final

import numpy as np
import shapely

from planner.element.element_drawings import upright_front
from planner.element.panel_drawing import inner_point
from planner.geometry.arrays import FloatArray

SHEET_MM: Final = (210.0, 297.0)
"""Size of a sheet [mm]."""
LABEL_GRID: Final = (2, 4)
"""Number of columns and rows of labels on a sheet."""
FONT_SIZE_MM: Final = 7.0
"""Font size [mm] whose capitals are 5 mm high."""
_ID_SIZE: Final = 13.0  # mm: maximum font size of the id
_LETTER_WIDTH: Final = 0.68  # largest mean width of a letter as a fraction of the font size
_MARGIN: Final = 4.0  # mm: free along the edges of a label, for printers
_GAP: Final = 1.2  # mm between texts, and from texts to the outline
_OUTLINE_SIZES: Final = (36.0, 30.0, 24.0, 18.0, 13.0, 9.0)  # mm: tried lengths of the longer side
_OUTWARD_OFFSETS_MM: Final = (0.0, 2.0, 4.0, 6.0, 9.0, 12.0, 16.0, 20.0)  # mm: tried outward offsets of texts
_SIDEWAYS_OFFSETS_MM: Final = (
    0.0,
    3.0,
    -3.0,
    6.0,
    -6.0,
    10.0,
    -10.0,
    15.0,
    -15.0,
)  # mm: tried offsets along their edge
_MAX_WITHOUT_LEADER: Final = 1.0  # mm: texts moved farther get a leader line to their edge

_Box = tuple[float, float, float, float]
"""Left, top, right, bottom [mm]."""


def label_sheets(data: Mapping[str, Any]) -> str:
    """Draw the labels of all panels of an element (``element.json``), in the order of their ids."""
    panels = data["panels"]
    width, height = SHEET_MM[0] / LABEL_GRID[0], SHEET_MM[1] / LABEL_GRID[1]
    labels_per_sheet = LABEL_GRID[0] * LABEL_GRID[1]
    total_height = SHEET_MM[1] * -(-len(panels) // labels_per_sheet)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SHEET_MM[0]:g}mm" height="{total_height:g}mm" '
        f'viewBox="0 0 {SHEET_MM[0]:g} {total_height:g}" font-family="sans-serif" fill="#000000">',
        f"<title>{escape(str(data['name']))}: labels, 1:1, sheets of A4</title>",
        f'<rect width="{SHEET_MM[0]:g}" height="{total_height:g}" fill="#ffffff"/>',
    ]
    for k, panel in enumerate(panels):
        row, column = divmod(k, LABEL_GRID[0])
        out.append(
            f'<g id="{escape(str(panel["id"]))}" transform="translate({column * width:g} {row * height:g})">'
        )
        out.append(
            f'<rect width="{width:g}" height="{height:g}" fill="none" stroke="#999999" stroke-width="0.2"/>'
        )
        out += [*_draw_label(panel, width, height), "</g>"]
    return "\n".join([*out, "</svg>"]) + "\n"


def _draw_label(panel: Mapping[str, Any], wide: float, tall: float) -> Iterator[str]:
    """Yield the SVG elements of a label of wide x tall [mm]: id, outline, ids beyond, and an arrow up."""
    name = str(panel["id"])
    size = min(_ID_SIZE, 0.5 * wide / (_LETTER_WIDTH * len(name)))
    taken = [_box(_MARGIN + 0.5 * _LETTER_WIDTH * len(name) * size, _MARGIN + 0.5 * size, len(name), size)]
    taken.append(
        _box(
            _MARGIN + 0.5 * _LETTER_WIDTH * 5 * FONT_SIZE_MM,
            tall - _MARGIN - 0.5 * FONT_SIZE_MM,
            5,
            FONT_SIZE_MM,
        )
    )
    inside = (_MARGIN, _MARGIN, wide - _MARGIN, tall - _MARGIN)
    ring, placed = _layout(panel, taken, inside)
    yield _text(taken[0], name, size, ' font-weight="700"')
    yield _text(taken[1], "front", FONT_SIZE_MM)
    points = " ".join(f"{x:.2f},{y:.2f}" for x, y in ring.tolist())
    yield f'<polygon points="{points}" fill="#eeeeee" stroke="#000000" stroke-width="0.5"/>'
    for i, beyond in enumerate(panel["neighbours"]):
        a, b = ring[i], ring[(i + 1) % len(ring)]
        yield f'<circle cx="{a[0]:.2f}" cy="{a[1]:.2f}" r="0.8"/>'
        if beyond is None:  # the rim
            yield _line(a, b, 1.4)
        else:
            middle, box = 0.5 * (a + b), placed[i]
            nearest = np.clip(middle, box[:2], box[2:])
            if np.linalg.norm(nearest - middle) > _GAP + _MAX_WITHOUT_LEADER:
                yield _line(middle, nearest, 0.25)
            yield _text(box, beyond, FONT_SIZE_MM)
    x, y = inner_point(ring)
    half = min(7.0, 0.22 * float(np.ptp(ring[:, 1])))
    yield (
        f'<path d="M{x:.2f} {y + half:.2f}V{y - half:.2f}M{x - 0.5 * half:.2f} {y - 0.4 * half:.2f}L{x:.2f} '
        f'{y - half:.2f}L{x + 0.5 * half:.2f} {y - 0.4 * half:.2f}" fill="none" stroke="#000000" '
        'stroke-width="0.9"/>'
    )


def _layout(panel: Mapping[str, Any], taken: list[_Box], inside: _Box) -> tuple[FloatArray, dict[int, _Box]]:
    """Return the outline (C, 2) [mm] on a label, and the boxes of the texts at its edges by their indices.

    The largest outline whose texts do not overlap is chosen. ``taken`` are the boxes of other texts,
    ``inside`` is the area for all.
    """
    front = upright_front(panel) * [1.0, -1.0]
    middle = np.array([0.5 * (inside[0] + inside[2]) + 6.0, 0.5 * (inside[1] + inside[3])])
    for size in _OUTLINE_SIZES:
        ring = front * (size / float(np.ptp(front, axis=0).max())) + middle
        boxes = _place_texts(panel, ring, taken, inside)
        if len(boxes) == sum(beyond is not None for beyond in panel["neighbours"]):
            break
    else:
        raise ValueError(f"a label has no space for the ids around panel {panel['id']}")
    return ring, boxes


def _place_texts(
    panel: Mapping[str, Any], ring: FloatArray, taken: list[_Box], inside: _Box
) -> dict[int, _Box]:
    """Return the box of the text at each edge with a neighbour, by edge; edges without space are left out.

    Texts start outside the middle of their edge and are moved outward and along it until they are free.
    """
    shape = shapely.Polygon(ring).buffer(0.0)
    shapely.prepare(shape)
    used = list(taken)
    placed = {}
    for i, beyond in enumerate(panel["neighbours"]):
        if beyond is None:
            continue
        a, b = ring[i], ring[(i + 1) % len(ring)]
        direction = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
        normal = np.array([-direction[1], direction[0]])  # counterclockwise seen with y up, so clockwise here
        half = 0.5 * _LETTER_WIDTH * len(beyond) * FONT_SIZE_MM, 0.5 * FONT_SIZE_MM
        centre = 0.5 * (a + b) + normal * (_GAP + abs(normal[0]) * half[0] + abs(normal[1]) * half[1])
        for offset in _OUTWARD_OFFSETS_MM:
            positions = [
                (centre + offset * normal + along * direction).tolist() for along in _SIDEWAYS_OFFSETS_MM
            ]
            boxes = [_box(x, y, len(beyond), FONT_SIZE_MM) for x, y in positions]
            free = (
                box
                for box in boxes
                if _is_free(box, used, inside) and not shape.intersects(shapely.box(*box))
            )
            if (free_box := next(free, None)) is not None:
                used.append(free_box)
                placed[i] = free_box
                break
    return placed


def _box(x: float, y: float, letters: int, size: float) -> _Box:
    """Return the box of a text around its centre, for a number of letters and a font size [mm]."""
    half_width = 0.5 * _LETTER_WIDTH * letters * size
    return x - half_width, y - 0.5 * size, x + half_width, y + 0.5 * size


def _is_free(box: _Box, used: list[_Box], inside: _Box) -> bool:
    """Whether a box is inside the area and overlaps no used box."""
    left, top, right, bottom = box
    if left < inside[0] or top < inside[1] or right > inside[2] or bottom > inside[3]:
        return False
    return all(
        left > other[2] + _GAP or right < other[0] - _GAP or top > other[3] or bottom < other[1]
        for other in used
    )


def _text(box: _Box, text: str, size: float, style: str = "") -> str:
    x, y = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3]) + 0.36 * size
    attributes = f'x="{x:.2f}" y="{y:.2f}" font-size="{size:.2f}"'
    return f'<text {attributes} text-anchor="middle"{style}>{escape(text)}</text>'


def _line(a: FloatArray, b: FloatArray, width: float) -> str:
    ends = f'x1="{a[0]:.2f}" y1="{a[1]:.2f}" x2="{b[0]:.2f}" y2="{b[1]:.2f}"'
    return f'<line {ends} stroke="#000000" stroke-width="{width:g}"/>'
