"""Small pieces of HTML: escaped text, numbers, tables, lists of facts, figures, pictures."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

FloatArray = NDArray[np.float64]


class Raw(str):
    """Text that is HTML already."""

    __slots__ = ()


def text(value: Any) -> str:
    """A value as escaped HTML: numbers to four digits, None as a dash, :class:`Raw` as it is."""
    if isinstance(value, Raw):
        return str(value)
    if value is None:
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return number(float(value))
    return html.escape(str(value))


def number(value: float, digits: int = 4) -> str:
    """A number to so many significant digits, with a true minus sign."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    size = f"{value:.{digits}g}"
    if "e" in size and 1e-4 < abs(value) < 1e7:
        size = f"{value:.0f}"
    return size.replace("-", "−")


def fixed(value: float, places: int) -> str:
    """A number with so many decimals, with a true minus sign and no minus zero."""
    out = f"{value:.{places}f}"
    return out.lstrip("-") if float(out) == 0.0 else out.replace("-", "−")


def table(columns: Sequence[Any], rows: Iterable[Sequence[Any]], kind: str = "") -> Raw:
    """A table; cells that are numbers are set right."""
    body = []
    right: set[int] = set()
    for row in rows:
        right |= {i for i, cell in enumerate(row) if _number_class(cell)}
        cells = "".join(f"<td{_number_class(cell)}>{text(cell)}</td>" for cell in row)
        body.append(f"<tr>{cells}</tr>")
    head = "".join(f"<th{' class=n' if i in right else ''}>{text(c)}</th>" for i, c in enumerate(columns))
    style = f' class="{kind}"' if kind else ""
    inner = f"<thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody>"
    return Raw(f'<div class="scroll"><table{style}>{inner}</table></div>')


def _number_class(cell: Any) -> str:
    return ' class="n"' if isinstance(cell, int | float | np.number) and not isinstance(cell, bool) else ""


def facts(items: Iterable[tuple[Any, Any]]) -> Raw:
    """Names and values in two columns."""
    rows = "".join(f"<div><dt>{text(name)}</dt><dd>{text(value)}</dd></div>" for name, value in items)
    return Raw(f'<dl class="facts">{rows}</dl>')


def figure(title: Any, content: str, note: Any = "") -> Raw:
    """A picture or chart with a title above and a note below."""
    foot = f'<p class="note">{text(note)}</p>' if note else ""
    return Raw(f"<figure><figcaption>{text(title)}</figcaption>{content}{foot}</figure>")


def section(anchor: str, title: str, *content: str) -> Raw:
    """A section of the page; nothing when it has no content."""
    inner = "".join(content)
    return Raw(f'<section id="{anchor}"><h2>{html.escape(title)}</h2>{inner}</section>') if inner else Raw("")


def grid(items: Iterable[str], kind: str = "two") -> Raw:
    """Items side by side where there is room."""
    inner = "".join(items)
    return Raw(f'<div class="grid {kind}">{inner}</div>') if inner else Raw("")


def png(pixels: FloatArray, alpha: FloatArray | None = None, premultiplied: bool = False) -> str:
    """A data address of a PNG of pixels (h, w, 3) and alpha (h, w), both in 0..1."""
    color = pixels
    if alpha is not None and premultiplied:
        color = pixels / np.maximum(alpha, 1e-6)[..., None]
    layers = [color] if alpha is None else [color, alpha[..., None]]
    data = (np.clip(np.concatenate(layers, axis=-1), 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(data).save(stream, "PNG", compress_level=6)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
