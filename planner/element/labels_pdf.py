"""``labels.pdf``: the labels of `labels.svg` as A4 pages that print at 1:1.

The file follows ISO 32000-1. It uses Helvetica, which every reader has, and no compression.
"""

import math
import re
from collections.abc import Iterator
from typing import Final
from xml.etree import ElementTree as ET

from planner.element.labels import SHEET_MM

POINTS_PER_MM: Final = 72.0 / 25.4
"""PDF points per millimetre."""
# widths of A to M, and of N to Z, which are equal in bold
_CAPITALS: Final = (667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833)
_CAPITALS_BOLD: Final = (722, 722, 722, 722, 667, 611, 778, 722, 278, 556, 722, 611, 833)
_FROM_N: Final = (722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611)
_LETTERS: Final = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZfront"
LETTER_WIDTHS: Final = tuple(
    dict(zip(_LETTERS, (*[556] * 10, *capitals, *_FROM_N, *small), strict=True))
    for capitals, small in (
        (_CAPITALS, (278, 333, 556, 556, 278)),
        (_CAPITALS_BOLD, (333, 389, 611, 611, 333)),
    )
)
"""Widths of letters of Helvetica and Helvetica-Bold in thousandths of the font size (Adobe's font metrics).

Letters that are not listed count as `_AVERAGE`.
"""
_AVERAGE: Final = 600
_KAPPA: Final = 4.0 / 3.0 * (math.sqrt(2.0) - 1.0)  # length of Bezier handles of a quarter circle of radius 1
_NUMBER: Final = re.compile(r"-?[\d.]+")


def labels_pdf(sheets: str) -> str:
    """Convert the SVG of :func:`planner.element.labels.label_sheets` to a PDF document, as ASCII text."""
    root = ET.fromstring(sheets)
    count = round(float(root.attrib["viewBox"].split()[3]) / SHEET_MM[1])
    pages: list[list[str]] = [[] for _ in range(count)]
    for group in root.iterfind("{*}g"):
        x, y = map(float, _NUMBER.findall(group.attrib["transform"]))
        page = int((y + 1e-6) // SHEET_MM[1])
        # millimetres to the right and down from the label's corner
        pages[page].append(f"q 1 0 0 1 {x:.4f} {y - page * SHEET_MM[1]:.4f} cm")
        for mark in group:
            pages[page] += _draw_element(mark)
        pages[page].append("Q")
    size = " ".join(f"{v * POINTS_PER_MM:.4f}" for v in SHEET_MM)
    page_setup = (
        f"{POINTS_PER_MM:.8f} 0 0 {-POINTS_PER_MM:.8f} 0 {SHEET_MM[1] * POINTS_PER_MM:.4f} cm 1 J 1 j"
    )
    page_references = " ".join(f"{5 + 2 * k} 0 R" for k in range(count))
    objects = [
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{page_references}] /Count {count} /MediaBox [0 0 {size}] "
        "/Resources << /Font << /F0 3 0 R /F1 4 0 R >> >> >>",
        *(
            f"<< /Type /Font /Subtype /Type1 /BaseFont /{font} /Encoding /WinAnsiEncoding >>"
            for font in ("Helvetica", "Helvetica-Bold")
        ),
    ]
    for k, page_marks in enumerate(pages):
        content = "\n".join([page_setup, *page_marks]) + "\n"
        objects.append(f"<< /Type /Page /Parent 2 0 R /Contents {6 + 2 * k} 0 R >>")
        objects.append(f"<< /Length {len(content)} >>\nstream\n{content}endstream")
    return _document(objects)


def _document(objects: list[str]) -> str:
    """Return a PDF file of objects with their offset table. The first object is the catalogue."""
    parts, offsets = ["%PDF-1.6\n"], []
    length = len(parts[0])
    for number, body in enumerate(objects, 1):
        offsets.append(length)
        parts.append(f"{number} 0 obj\n{body}\nendobj\n")
        length += len(parts[-1])
    table_lines = "".join(f"{start:010d} 00000 n \n" for start in offsets)
    parts.append(f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n{table_lines}")
    parts.append(f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{length}\n%%EOF\n")
    return "".join(parts)


def _draw_element(mark: ET.Element) -> Iterator[str]:
    """Yield PDF operators that draw an SVG element of a label; raise ``ValueError`` if it is unknown."""
    attributes, kind = mark.attrib, mark.tag.rpartition("}")[2]
    if kind == "text":
        yield _draw_text(mark)
        return
    yield f"{attributes.get('stroke-width', '0')} w {_grey(attributes.get('stroke', '#000000'))} G"
    yield f"{_grey(attributes.get('fill', '#000000'))} g"
    stroked, filled = "stroke" in attributes, attributes.get("fill") != "none" and kind != "line"
    if kind == "rect":
        yield f"0 0 {attributes['width']} {attributes['height']} re"
    elif kind == "polygon":
        yield _polyline(attributes["points"].replace(",", " ").split()) + " h"
    elif kind == "line":
        yield _polyline([attributes[name] for name in ("x1", "y1", "x2", "y2")])
    elif kind == "circle":
        yield _circle(*(float(attributes[name]) for name in ("cx", "cy", "r")))
    elif kind == "path":
        yield from _path(attributes["d"])
    else:
        raise ValueError(f"labels have no <{kind}>")
    yield {(True, True): "B", (True, False): "S", (False, True): "f"}[stroked, filled]


def _grey(colour: str) -> str:
    """Convert an SVG grey, #rrggbb with three equal parts, to a fraction of white; "none" is 0."""
    return "0" if colour == "none" else f"{int(colour[1:3], 16) / 255.0:.3f}"


def _polyline(numbers: list[str]) -> str:
    """Return the operators of a polyline through points that are listed as x, y, x, y ..."""
    points = [f"{x} {y}" for x, y in zip(numbers[::2], numbers[1::2], strict=True)]
    return " ".join(f"{point} {'l' if k else 'm'}" for k, point in enumerate(points))


def _circle(x: float, y: float, r: float) -> str:
    """Return the operators of a circle: four cubic Bezier curves, each as two handles and an end."""
    k = _KAPPA * r
    quarters = (
        (r, k, k, r, 0.0, r),
        (-k, r, -r, k, -r, 0.0),
        (-r, -k, -k, -r, 0.0, -r),
        (k, -r, r, -k, r, 0.0),
    )
    curves = (" ".join(f"{v + (x, y)[i % 2]:.3f}" for i, v in enumerate(arc)) + " c" for arc in quarters)
    return f"{x + r:.3f} {y:.3f} m " + " ".join(curves)


def _path(data: str) -> Iterator[str]:
    """Yield the operators of an SVG path of absolute commands M, L and V; raise ``ValueError`` for others."""
    x = ""
    for letter, numbers in re.findall(r"([A-Za-z])([^A-Za-z]*)", data):
        coordinates = _NUMBER.findall(numbers)
        if letter == "V":
            coordinates = [x, *coordinates]
        elif letter not in "ML":
            raise ValueError(f"labels have no {letter} in paths")
        x = coordinates[0]
        yield f"{' '.join(coordinates)} {'m' if letter == 'M' else 'l'}"


def _draw_text(mark: ET.Element) -> str:
    """Return the operators of a text centred on its position. Its matrix flips y, since pages have y down."""
    attributes, text = mark.attrib, mark.text or ""
    is_bold, size = int("font-weight" in attributes), float(attributes["font-size"])
    width = sum(LETTER_WIDTHS[is_bold].get(letter, _AVERAGE) for letter in text) / 1000.0 * size
    x, y = float(attributes["x"]) - 0.5 * width, float(attributes["y"])
    escaped = re.sub(r"([()\\])", r"\\\1", text.encode("ascii", "replace").decode())
    return f"BT 0 g /F{is_bold} {size:.3f} Tf 1 0 0 -1 {x:.3f} {y:.3f} Tm ({escaped}) Tj ET"
