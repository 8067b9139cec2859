"""``labels.svg``: a label for each panel, to be printed at 1:1 and put on its front.

A label has the panel's id, its outline with up upwards, and at each edge the id of the panel beyond. Eight
labels fill a sheet of A4. Capitals are at least 5 mm high; what would overlap is moved apart, or the outline
is drawn smaller.
"""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any, Final

import numpy as np
import shapely

from planner.element.element_drawings import turned_up
from planner.element.panel_drawing import inner
from planner.geometry.arrays import FloatArray

SHEET: Final = (210.0, 297.0)
"""A sheet [mm]."""
LABELS: Final = (2, 4)
"""Labels side by side and below one another on a sheet."""
TYPE: Final = 7.0
"""Size of type [mm] whose capitals are 5 mm high."""
_ID: Final = 13.0  # mm: size of type of the id
_WIDE: Final = 0.68  # largest mean width of a letter in sizes of type
_EDGE: Final = 4.0  # mm: free along the edges of a label, for printers
_AIR: Final = 1.2  # mm between words, and from words to the outline
_OUTLINES: Final = (36.0, 30.0, 24.0, 18.0, 13.0, 9.0)  # mm: sizes that are tried
_OFF: Final = (0.0, 2.0, 4.0, 6.0, 9.0, 12.0, 16.0, 20.0)  # mm: how far words are moved outwards
_ASIDE: Final = (0.0, 3.0, -3.0, 6.0, -6.0, 10.0, -10.0, 15.0, -15.0)  # mm: and along their edge
_LEADER: Final = 1.0  # mm: words that were moved farther get a line to their edge

_Box = tuple[float, float, float, float]
"""Left, top, right, bottom [mm]."""


def label_sheets(data: Mapping[str, Any]) -> str:
    """The labels of all panels of an element (``element.json``), in the order of their ids."""
    panels = data["panels"]
    wide, tall = SHEET[0] / LABELS[0], SHEET[1] / LABELS[1]
    a_sheet = LABELS[0] * LABELS[1]
    high = SHEET[1] * -(-len(panels) // a_sheet)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SHEET[0]:g}mm" height="{high:g}mm" '
        f'viewBox="0 0 {SHEET[0]:g} {high:g}" font-family="sans-serif" fill="#000000">',
        f"<title>{escape(str(data['name']))}: labels, 1:1, sheets of A4</title>",
        f'<rect width="{SHEET[0]:g}" height="{high:g}" fill="#ffffff"/>',
    ]
    for k, panel in enumerate(panels):
        row, column = divmod(k, LABELS[0])
        out.append(
            f'<g id="{escape(str(panel["id"]))}" transform="translate({column * wide:g} {row * tall:g})">'
        )
        out.append(
            f'<rect width="{wide:g}" height="{tall:g}" fill="none" stroke="#999999" stroke-width="0.2"/>'
        )
        out += [*_label(panel, wide, tall), "</g>"]
    return "\n".join([*out, "</svg>"]) + "\n"


def _label(panel: Mapping[str, Any], wide: float, tall: float) -> Iterator[str]:
    name = str(panel["id"])
    size = min(_ID, 0.5 * wide / (_WIDE * len(name)))
    taken = [_box(_EDGE + 0.5 * _WIDE * len(name) * size, _EDGE + 0.5 * size, len(name), size)]
    taken.append(_box(_EDGE + 0.5 * _WIDE * 5 * TYPE, tall - _EDGE - 0.5 * TYPE, 5, TYPE))
    inside = (_EDGE, _EDGE, wide - _EDGE, tall - _EDGE)
    ring, placed = _laid(panel, taken, inside)
    yield _text(taken[0], name, size, ' font-weight="700"')
    yield _text(taken[1], "front", TYPE)
    points = " ".join(f"{x:.2f},{y:.2f}" for x, y in ring.tolist())
    yield f'<polygon points="{points}" fill="#eeeeee" stroke="#000000" stroke-width="0.5"/>'
    for i, beyond in enumerate(panel["neighbours"]):
        a, b = ring[i], ring[(i + 1) % len(ring)]
        yield f'<circle cx="{a[0]:.2f}" cy="{a[1]:.2f}" r="0.8"/>'
        if beyond is None:  # the rim
            yield _line(a, b, 1.4)
        else:
            middle, box = 0.5 * (a + b), placed[i]
            near = np.clip(middle, box[:2], box[2:])
            if np.linalg.norm(near - middle) > _AIR + _LEADER:
                yield _line(middle, near, 0.25)
            yield _text(box, beyond, TYPE)
    x, y = inner(ring)
    long = min(7.0, 0.22 * float(np.ptp(ring[:, 1])))
    yield (
        f'<path d="M{x:.2f} {y + long:.2f}V{y - long:.2f}M{x - 0.5 * long:.2f} {y - 0.4 * long:.2f}L{x:.2f} '
        f'{y - long:.2f}L{x + 0.5 * long:.2f} {y - 0.4 * long:.2f}" fill="none" stroke="#000000" '
        'stroke-width="0.9"/>'
    )


def _laid(panel: Mapping[str, Any], taken: list[_Box], inside: _Box) -> tuple[FloatArray, dict[int, _Box]]:
    """The outline (C, 2) [mm] on a label, and where the words at its edges are; the largest outline whose
    words do not overlap."""
    own = turned_up(panel) * [1.0, -1.0]
    middle = np.array([0.5 * (inside[0] + inside[2]) + 6.0, 0.5 * (inside[1] + inside[3])])
    for size in _OUTLINES:
        ring = own * (size / float(np.ptp(own, axis=0).max())) + middle
        placed = _placed(panel, ring, taken, inside)
        if len(placed) == sum(beyond is not None for beyond in panel["neighbours"]):
            break
    else:
        raise ValueError(f"a label has no room for the ids round panel {panel['id']}")
    return ring, placed


def _placed(panel: Mapping[str, Any], ring: FloatArray, taken: list[_Box], inside: _Box) -> dict[int, _Box]:
    """Where the words at edges find room; edges without room are left out."""
    shape = shapely.Polygon(ring).buffer(0.0)
    shapely.prepare(shape)
    used = list(taken)
    placed = {}
    for i, beyond in enumerate(panel["neighbours"]):
        if beyond is None:
            continue
        a, b = ring[i], ring[(i + 1) % len(ring)]
        way = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
        out = np.array([-way[1], way[0]])  # counterclockwise seen with y up, so clockwise here
        half = 0.5 * _WIDE * len(beyond) * TYPE, 0.5 * TYPE
        first = 0.5 * (a + b) + out * (_AIR + abs(out[0]) * half[0] + abs(out[1]) * half[1])
        for off in _OFF:
            places = [(first + off * out + side * way).tolist() for side in _ASIDE]
            boxes = [_box(x, y, len(beyond), TYPE) for x, y in places]
            free = (
                box for box in boxes if _free(box, used, inside) and not shape.intersects(shapely.box(*box))
            )
            if (found := next(free, None)) is not None:
                used.append(found)
                placed[i] = found
                break
    return placed


def _box(x: float, y: float, letters: int, size: float) -> _Box:
    half = 0.5 * _WIDE * letters * size
    return x - half, y - 0.5 * size, x + half, y + 0.5 * size


def _free(box: _Box, used: list[_Box], inside: _Box) -> bool:
    left, top, right, bottom = box
    if left < inside[0] or top < inside[1] or right > inside[2] or bottom > inside[3]:
        return False
    return all(
        left > one[2] + _AIR or right < one[0] - _AIR or top > one[3] or bottom < one[1] for one in used
    )


def _text(box: _Box, words: str, size: float, more: str = "") -> str:
    x, y = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3]) + 0.36 * size
    place = f'x="{x:.2f}" y="{y:.2f}" font-size="{size:.2f}"'
    return f'<text {place} text-anchor="middle"{more}>{escape(words)}</text>'


def _line(a: FloatArray, b: FloatArray, width: float) -> str:
    ends = f'x1="{a[0]:.2f}" y1="{a[1]:.2f}" x2="{b[0]:.2f}" y2="{b[1]:.2f}"'
    return f'<line {ends} stroke="#000000" stroke-width="{width:g}"/>'
