"""The part of an element's page that shows how it is put up: in 3D, panel by panel along the ways in, and as
a list. It is made of ``element.json`` alone."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.element.assembly import in_order
from planner.geometry.arrays import FloatArray, unit
from planner.geometry.units import MM
from planner.report import view3d
from planner.report.markup import Block, Drawing, Folded, Paragraph, Soft, table

SCRIPT: Final = Path(__file__).resolve().with_name("assembly.js")
"""What draws it."""
ALONG: Final = 0.4
"""A way in is told by the directions that it has at least this much of."""

_STYLE: Final = """<style>
#put-up{position:relative}#put-up canvas{display:block;width:100%;height:min(68vh,560px,100vw);
touch-action:none;background:var(--bg);border-radius:10px;cursor:grab}#put-up .stage{position:relative}
#put-up .name{position:absolute;transform:translate(-50%,-220%);pointer-events:none;font-weight:650;
font-size:13px;padding:0 6px;border-radius:6px;background:var(--card);color:var(--ink);
border:1px solid var(--line)}
#put-up .bar{display:flex;flex-wrap:wrap;gap:8px 10px;align-items:center;margin-top:10px}
#put-up .line{flex:1 1 160px;min-width:120px;accent-color:var(--accent)}
#put-up button{font:inherit;border:1px solid var(--line);background:var(--bg);color:inherit;border-radius:8px;
min-width:40px;height:34px;cursor:pointer}#put-up .said{font-size:13.5px;margin:8px 0 0;min-height:1.5em}
#put-up label{font-size:13px;color:var(--soft)}@media print{#put-up{display:none}}
</style>"""
_VIEW: Final = """<div id="put-up"><div class="stage"><canvas tabindex="0" role="img"
 aria-label="the element as it is put up, in 3D"></canvas><span class="name" hidden></span></div>
<div class="bar"><button class="back" title="one panel less">&#8249;</button><button class="play"
 title="play or pause">&#9654;</button><button class="next" title="one panel more">&#8250;</button>
<input class="line" type="range" min="0" max="%d" step="1" value="%d" aria-label="panels that stand">
<label><input class="all" type="checkbox"> all ways in</label></div>
<p class="said" aria-live="polite"></p></div>"""


def assembly_section(data: Mapping[str, Any], fill: Callable[[Mapping[str, Any]], str]) -> tuple[Block, ...]:
    """What the section holds; ``fill``: the colour of a panel, as the style sheet names it."""
    if not all("solid" in panel for panel in data["panels"]):
        return (Paragraph("This element was written without an order; divide it again for one."),)
    panels = in_order(data)
    at = {str(panel["id"]): k for k, panel in enumerate(panels)}
    up = np.array(data["up"], dtype=np.float64)
    shown, rows = [], []
    for k, panel in enumerate(panels):
        near = dict.fromkeys(str(one) for one in panel["neighbours"] if one is not None)
        beside = [name for name in near if at[name] < k]
        jam = float(panel["jam_mm"])
        words = comes_from(panel, up)
        rows.append((k + 1, panel["id"], words, " ".join(beside), round(jam, 2) if jam else None))
        if beside:
            words += f"; beside {', '.join(beside)}"
        if jam:
            words += f"; {jam:.1f} mm are in its way"
        solid = panel["solid"]
        body = {key: solid[f"{key}_mm"] for key in ("front", "back")}
        body |= {key: solid[key] for key in ("faces", "rim")}
        way = [round(float(v), 4) for v in panel["way_in"]]
        shown.append({"id": panel["id"], "words": words, "way": way, "fill": fill(panel), **body})
    packed = json.dumps({"axes": _axes(up).tolist(), "panels": shown}, separators=(",", ":"))
    packed = packed.replace("<", "\\u003c")
    view = (
        _STYLE
        + _VIEW % (len(panels), len(panels))
        + f'<script type="application/json" id="put-up-data">{packed}</script>'
        + f"<script>{view3d.script(SCRIPT.read_text('utf-8'))}</script>"
    )
    heads = ("step", "panel", "comes from", "beside", "in its way mm")
    return (
        Paragraph(
            "Drag to turn, shift and drag or two fingers to move; the wheel zooms once the view was clicked.",
            "soft",
        ),
        Drawing(view),
        Folded("The order as a list", table(heads, [(n, i, w, Soft(b), j) for n, i, w, b, j in rows])),
    )


def _axes(up: FloatArray) -> FloatArray:
    """Axes (3, 3), as rows, of the view: x as in the element, z up."""
    x = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
    x = unit(x - (x @ up) * up)
    return np.stack([x, np.cross(up, x), up]) + 0.0


def comes_from(panel: Mapping[str, Any], up: FloatArray) -> str:
    """Whence a panel comes, in words, as one who stands before its front would say."""
    solid = panel["solid"]
    front = np.array(solid["front_mm"].split(), dtype=np.float64).reshape(-1, 3) * MM
    faces = np.array(solid["faces"].split(), dtype=np.int64).reshape(-1, 3)
    a, b, c = front[faces].transpose(1, 0, 2)
    normal = unit(np.cross(b - a, c - a).sum(axis=0))
    right = unit(np.cross(up, normal))
    out = -np.array(panel["way_in"], dtype=np.float64)
    parts = [
        (abs(float(out @ way)), words[float(out @ way) < 0.0])
        for way, words in (
            (up, ("above", "below")),
            (normal, ("the front", "behind")),
            (right, ("the right", "the left")),
        )
    ]
    told = [word for much, word in sorted(parts, reverse=True) if much >= ALONG]
    return "from " + " and ".join(told)
