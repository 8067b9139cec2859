"""``labels.pdf``: the labels of `labels.svg` as a document of A4 pages, which prints at 1:1 as it is.

Written as ISO 32000-1 has it, with Helvetica, which every reader has, and no compression.
"""

import math
import re
from collections.abc import Iterator
from typing import Final
from xml.etree import ElementTree as ET

from planner.element.labels import SHEET

POINTS: Final = 72.0 / 25.4
"""Points of a document in a millimetre."""
_CAPITALS: Final = (667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833)
_CAPITALS_BOLD: Final = (722, 722, 722, 722, 667, 611, 778, 722, 278, 556, 722, 611, 833)
_FROM_N: Final = (722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611)  # bold or not
_LETTERS: Final = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZfront"
WIDTHS: Final = tuple(
    dict(zip(_LETTERS, (*[556] * 10, *capitals, *_FROM_N, *small), strict=True))
    for capitals, small in (
        (_CAPITALS, (278, 333, 556, 556, 278)),
        (_CAPITALS_BOLD, (333, 389, 611, 611, 333)),
    )
)
"""Widths of letters in thousandths of the size of type, of Helvetica and Helvetica-Bold (Adobe's font
metrics); others count as an average one."""
_AVERAGE: Final = 600
_KAPPA: Final = 4.0 / 3.0 * (math.sqrt(2.0) - 1.0)  # handles of a quarter of a circle, in radii
_NUMBER: Final = re.compile(r"-?[\d.]+")


def label_document(sheets: str) -> str:
    """The document, in ASCII, of what :func:`planner.element.labels.label_sheets` gives."""
    root = ET.fromstring(sheets)
    count = round(float(root.attrib["viewBox"].split()[3]) / SHEET[1])
    pages: list[list[str]] = [[] for _ in range(count)]
    for group in root.iterfind("{*}g"):
        x, y = map(float, _NUMBER.findall(group.attrib["transform"]))
        page = int((y + 1e-6) // SHEET[1])
        # millimetres to the right and down from the label's corner
        pages[page].append(f"q 1 0 0 1 {x:.4f} {y - page * SHEET[1]:.4f} cm")
        for mark in group:
            pages[page] += _drawn(mark)
        pages[page].append("Q")
    size = " ".join(f"{v * POINTS:.4f}" for v in SHEET)
    first = f"{POINTS:.8f} 0 0 {-POINTS:.8f} 0 {SHEET[1] * POINTS:.4f} cm 1 J 1 j"
    kids = " ".join(f"{5 + 2 * k} 0 R" for k in range(count))
    bodies = [
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {count} /MediaBox [0 0 {size}] "
        "/Resources << /Font << /F0 3 0 R /F1 4 0 R >> >> >>",
        *(
            f"<< /Type /Font /Subtype /Type1 /BaseFont /{font} /Encoding /WinAnsiEncoding >>"
            for font in ("Helvetica", "Helvetica-Bold")
        ),
    ]
    for k, page_marks in enumerate(pages):
        content = "\n".join([first, *page_marks]) + "\n"
        bodies.append(f"<< /Type /Page /Parent 2 0 R /Contents {6 + 2 * k} 0 R >>")
        bodies.append(f"<< /Length {len(content)} >>\nstream\n{content}endstream")
    return _document(bodies)


def _document(bodies: list[str]) -> str:
    """Objects, numbered from 1, the first of them the catalogue, with the table of where each begins."""
    parts, starts = ["%PDF-1.6\n"], []
    length = len(parts[0])
    for number, body in enumerate(bodies, 1):
        starts.append(length)
        parts.append(f"{number} 0 obj\n{body}\nendobj\n")
        length += len(parts[-1])
    rows = "".join(f"{start:010d} 00000 n \n" for start in starts)
    parts.append(f"xref\n0 {len(bodies) + 1}\n0000000000 65535 f \n{rows}")
    parts.append(f"trailer\n<< /Size {len(bodies) + 1} /Root 1 0 R >>\nstartxref\n{length}\n%%EOF\n")
    return "".join(parts)


def _drawn(mark: ET.Element) -> Iterator[str]:
    """What draws an element of a label; raises ``ValueError`` for one that labels do not have."""
    own, kind = mark.attrib, mark.tag.rpartition("}")[2]
    if kind == "text":
        yield _words(mark)
        return
    yield f"{own.get('stroke-width', '0')} w {_grey(own.get('stroke', '#000000'))} G"
    yield f"{_grey(own.get('fill', '#000000'))} g"
    stroked, filled = "stroke" in own, own.get("fill") != "none" and kind != "line"
    if kind == "rect":
        yield f"0 0 {own['width']} {own['height']} re"
    elif kind == "polygon":
        yield _way(own["points"].replace(",", " ").split()) + " h"
    elif kind == "line":
        yield _way([own[name] for name in ("x1", "y1", "x2", "y2")])
    elif kind == "circle":
        yield _circle(*(float(own[name]) for name in ("cx", "cy", "r")))
    elif kind == "path":
        yield from _path(own["d"])
    else:
        raise ValueError(f"labels have no <{kind}>")
    yield {(True, True): "B", (True, False): "S", (False, True): "f"}[stroked, filled]


def _grey(colour: str) -> str:
    """A grey of SVG, #rrggbb with three equal parts, as a share of white."""
    return "0" if colour == "none" else f"{int(colour[1:3], 16) / 255.0:.3f}"


def _way(numbers: list[str]) -> str:
    """Straight lines through points x, y, x, y ..."""
    points = [f"{x} {y}" for x, y in zip(numbers[::2], numbers[1::2], strict=True)]
    return " ".join(f"{point} {'l' if k else 'm'}" for k, point in enumerate(points))


def _circle(x: float, y: float, r: float) -> str:
    k = _KAPPA * r
    arcs = ((r, k, k, r, 0.0, r), (-k, r, -r, k, -r, 0.0), (-r, -k, -k, -r, 0.0, -r), (k, -r, r, -k, r, 0.0))
    curves = (" ".join(f"{v + (x, y)[i % 2]:.3f}" for i, v in enumerate(arc)) + " c" for arc in arcs)
    return f"{x + r:.3f} {y:.3f} m " + " ".join(curves)


def _path(way: str) -> Iterator[str]:
    x = ""
    for letter, numbers in re.findall(r"([A-Za-z])([^A-Za-z]*)", way):
        places = _NUMBER.findall(numbers)
        if letter == "V":
            places = [x, *places]
        elif letter not in "ML":
            raise ValueError(f"labels have no {letter} in paths")
        x = places[0]
        yield f"{' '.join(places)} {'m' if letter == 'M' else 'l'}"


def _words(mark: ET.Element) -> str:
    """Words about their middle; type stands upright, so its axis down is turned up again."""
    own, words = mark.attrib, mark.text or ""
    bold, size = int("font-weight" in own), float(own["font-size"])
    width = sum(WIDTHS[bold].get(letter, _AVERAGE) for letter in words) / 1000.0 * size
    x, y = float(own["x"]) - 0.5 * width, float(own["y"])
    safe = re.sub(r"([()\\])", r"\\\1", words.encode("ascii", "replace").decode())
    return f"BT 0 g /F{bold} {size:.3f} Tf 1 0 0 -1 {x:.3f} {y:.3f} Tm ({safe}) Tj ET"
