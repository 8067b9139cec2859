"""Section of an element's page that shows its assembly: in 3D, panel by panel, and as a list.

Its only input is ``element.json``.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.element.assembly import panels_in_order
from planner.geometry.arrays import FloatArray, unit
from planner.geometry.units import MM
from planner.report import view3d
from planner.report.markup import Block, Drawing, Folded, MutedPhrase, Paragraph, make_table

SCRIPT: Final = Path(__file__).resolve().with_name("assembly.js")
"""JavaScript file that draws the 3D view."""
MIN_DIRECTION_COMPONENT: Final = 0.4
"""Minimum component of a unit insertion direction that its description mentions."""

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
 aria-label="assembly of the element, in 3D"></canvas><span class="name" hidden></span></div>
<div class="bar"><button class="back" title="one panel less">&#8249;</button><button class="play"
 title="play or pause">&#9654;</button><button class="next" title="one panel more">&#8250;</button>
<input class="line" type="range" min="0" max="%d" step="1" value="%d" aria-label="panels that stand">
<label><input class="all" type="checkbox"> all insertion paths</label></div>
<p class="said" aria-live="polite"></p></div>"""


def assembly_section(data: Mapping[str, Any], fill: Callable[[Mapping[str, Any]], str]) -> tuple[Block, ...]:
    """Return the blocks of the section; ``fill`` returns the CSS colour of a panel of ``element.json``."""
    if not all("solid" in panel for panel in data["panels"]):
        return (Paragraph("This element was written without an assembly order; divide it again to get one."),)
    panels = panels_in_order(data)
    position_by_id = {str(panel["id"]): k for k, panel in enumerate(panels)}
    up = np.array(data["up"], dtype=np.float64)
    shown, rows = [], []
    for k, panel in enumerate(panels):
        neighbours = dict.fromkeys(
            str(neighbour) for neighbour in panel["neighbours"] if neighbour is not None
        )
        previous_neighbours = [name for name in neighbours if position_by_id[name] < k]
        interference = float(panel["jam_mm"])
        words = describe_direction(panel, up)
        rows.append(
            (
                k + 1,
                panel["id"],
                words,
                " ".join(previous_neighbours),
                round(interference, 2) if interference else None,
            )
        )
        if previous_neighbours:
            words += f"; next to {', '.join(previous_neighbours)}"
        if interference:
            words += f"; interference {interference:.1f} mm"
        solid = panel["solid"]
        body = {key: solid[f"{key}_mm"] for key in ("front", "back")}
        body |= {key: solid[key] for key in ("faces", "rim")}
        direction = [round(float(v), 4) for v in panel["way_in"]]
        shown.append({"id": panel["id"], "words": words, "way": direction, "fill": fill(panel), **body})
    payload = json.dumps({"axes": _axes(up).tolist(), "panels": shown}, separators=(",", ":"))
    payload = payload.replace("<", "\\u003c")
    view = (
        _STYLE
        + _VIEW % (len(panels), len(panels))
        + f'<script type="application/json" id="put-up-data">{payload}</script>'
        + f"<script>{view3d.bundle_script(SCRIPT.read_text('utf-8'))}</script>"
    )
    heads = ("step", "panel", "inserted from", "next to", "interference mm")
    return (
        Paragraph(
            "Drag to rotate; shift-drag or use two fingers to pan. The wheel zooms once you click the view.",
            "soft",
        ),
        Drawing(view),
        Folded(
            "The order as a list",
            make_table(
                heads,
                [
                    (step, panel_id, words, MutedPhrase(adjacent), interference)
                    for step, panel_id, words, adjacent, interference in rows
                ],
            ),
        ),
    )


def _axes(up: FloatArray) -> FloatArray:
    """Return the axes of the view as rows (3, 3): x level and along the element's x (or y), z up."""
    x = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
    x = unit(x - (x @ up) * up)
    return np.stack([x, np.cross(up, x), up]) + 0.0


def describe_direction(panel: Mapping[str, Any], up: FloatArray) -> str:
    """Return where a panel is inserted from, as a viewer in front sees it: "from above and the left"."""
    solid = panel["solid"]
    front = np.array(solid["front_mm"].split(), dtype=np.float64).reshape(-1, 3) * MM
    faces = np.array(solid["faces"].split(), dtype=np.int64).reshape(-1, 3)
    a, b, c = front[faces].transpose(1, 0, 2)
    normal = unit(np.cross(b - a, c - a).sum(axis=0))
    right = unit(np.cross(up, normal))
    origin_direction = -np.array(panel["way_in"], dtype=np.float64)
    components = [
        # the second word of a pair is that of the negative direction
        (abs(float(origin_direction @ axis)), word_pair[float(origin_direction @ axis) < 0.0])
        for axis, word_pair in (
            (up, ("above", "below")),
            (normal, ("the front", "behind")),
            (right, ("the right", "the left")),
        )
    ]
    words_used = [
        word for component, word in sorted(components, reverse=True) if component >= MIN_DIRECTION_COMPONENT
    ]
    return "from " + " and ".join(words_used)
