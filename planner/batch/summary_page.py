"""The summary of a batch as one HTML file: all jobs' figures, a thumbnail and a link to each report."""

from __future__ import annotations

import base64
import html
import io
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from PIL import Image

from planner.batch.run import Row
from planner.batch.summary import FIGURES, STATES, counted, value_text, varied, worst
from planner.report import markup
from planner.report.markup import Raw
from planner.report.style import CSS

THUMBNAIL: Final = (200, 120)
"""Largest width and height of a thumbnail [pixels]."""
MAX_REPORT: Final = 50_000_000
MAX_PIXELS: Final = 40_000_000
_PICTURE = re.compile(r'<img alt="the cell" src="data:image/png;base64,([A-Za-z0-9+/=]+)"')
KIND: Final = {"verified": "ok", "unproven": "bad", "infeasible": "warning", "bad_input": "warning"}
OWN: Final = (
    "main{max-width:1500px}td img{display:block;width:128px;border-radius:6px;background:#fff}"
    "td a{color:var(--accent)}td:first-child{width:140px}td .soft{font-size:12px;overflow-wrap:anywhere}"
    "tr.has>td{border-bottom:0}tr.said>td{padding-top:0}"
)


def page(title: str, rows: Sequence[Row], out: Path, seconds: float) -> str:
    """The page; ``out`` is the folder of the results, which links and thumbnails come from, and ``seconds``
    [s] what the whole batch took this time."""
    paths = varied(rows)
    known = [name for name in FIGURES if any(name in row.done.metrics for row in rows)]
    varied_heads = [Raw(html.escape(path).replace(".", ".<wbr>")) for path in paths]
    figure_heads = [FIGURES[name] for name in known]
    heads = ["", "name", "status", *varied_heads, *figure_heads, "planned in s"]
    body = "".join(_lines(row, paths, known, out, len(heads)) for row in rows)
    counts: Counter[str] = Counter(row.done.state for row in rows)
    tiles = "".join(
        _tile(str(counts[state]), name, state != "verified")
        for state, name in STATES.items()
        if counts[state]
    )
    kept = sum(row.kept for row in rows)
    told = f"{len(rows)} problems in {seconds:.0f} s" + (f", {kept} kept from earlier runs" if kept else "")
    head = f"<header><h1>{html.escape(title)}</h1></header><p class='soft'>{told}</p>"
    inner = f'{head}<div class="tiles">{tiles}</div>{markup.section("jobs", "Results", _table(heads, body))}'
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width,initial-scale=1"><style>{CSS}{OWN}</style></head>'
        f"<body><main>{inner}</main></body></html>\n"
    )


def thumbnail(report: Path) -> bytes | None:
    """The cell's picture in a report as a small PNG; None where it has none that can be read."""
    try:
        if report.stat().st_size > MAX_REPORT:
            return None
        found = _PICTURE.search(report.read_text("utf-8"))
        if found is None:
            return None
        with Image.open(io.BytesIO(base64.b64decode(found[1])), formats=["PNG"]) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                return None
            small = picture.convert("RGBA")
            small.thumbnail(THUMBNAIL)
    except (OSError, ValueError):
        return None
    stream = io.BytesIO()
    small.save(stream, "PNG", optimize=True)
    return stream.getvalue()


def _lines(row: Row, paths: Sequence[str], known: Sequence[str], out: Path, width: int) -> str:
    """A job's row of the table, and one more for its issues where it has any."""
    report = f"{row.item.name}/report.html"
    small = thumbnail(out / report)
    shown = ""
    if small is not None:
        data = base64.b64encode(small).decode()
        shown = f'<a href="{report}"><img alt="" src="data:image/png;base64,{data}"></a>'
    state = row.done.state
    tag = f'<span class="tag {KIND.get(state, "bad")}">{STATES[state]}</span>'
    linked = (out / report).is_file()
    name = f'<a href="{report}">{row.item.name}</a>' if linked else row.item.name
    name += f'<br><span class="soft">{html.escape(row.item.origin)}</span>'
    values = [value_text(row.item.varied[path]) if path in row.item.varied else "" for path in paths]
    figures = [_figure(figure, row.done.metrics.get(figure)) for figure in known]
    cells = [Raw(shown), Raw(name), Raw(tag), *values, *figures, row.done.seconds]
    kind = ' class="has"' if row.done.issues else ""
    line = f"<tr{kind}>{''.join(_cell(cell) for cell in cells)}</tr>"
    said = worst(row.done)
    if not row.done.issues:
        return line
    text = html.escape(counted(row))
    if said is not None:
        text += f": <code>{said.code}</code> {html.escape(said.message)}"
    return f'{line}<tr class="said"><td></td><td colspan="{width - 1}">{text}</td></tr>'


def _figure(name: str, value: float | None) -> object:
    return "" if value is None else int(value) if name == "targets" else value


def _cell(cell: object) -> str:
    kind = ' class="n"' if isinstance(cell, int | float) else ""
    return f"<td{kind}>{markup.text(cell)}</td>"


def _table(heads: Sequence[str], body: str) -> Raw:
    head = "".join(f"<th>{markup.text(name)}</th>" for name in heads)
    inner = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return Raw(f'<div class="scroll"><table>{inner}</table></div>')


def _tile(figure: str, name: str, bad: bool) -> str:
    return f'<div class="tile{" bad" if bad else ""}"><b>{figure}</b><span>{name}</span></div>'
