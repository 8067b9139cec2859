"""``element.html``: what became of an element, as one offline page.

All panels with ids and states and the joints over their limit, robot hours, how far what is cut is off, and
lists of panels and joints.
"""

from __future__ import annotations

import dataclasses
import html
from typing import Final

import numpy as np

from planner.element.run_report import MINUTE, MOST, ElementRun, PanelRun
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.report import charts
from planner.report.markup import (
    Drawing,
    Facts,
    Figure,
    Grid,
    Page,
    Paragraph,
    Phrase,
    Section,
    Soft,
    Table,
    Tag,
    Tile,
    Wide,
    fixed,
    page,
    table,
)

HOUR: Final = 3600.0
"""[s]"""
_WIDTH: Final = 1000.0  # of the drawing [px]
_FILL: Final = {"proven": "var(--ok-bg)", "refused": "var(--bad-bg)", "open": "var(--note-bg)"}
_BINS: Final = 24


def element_page(found: ElementRun) -> str:
    """The page as HTML."""
    name = str(found.data["name"])
    proven = sum(panel.proven for panel in found.panels)
    whole = proven == len(found.panels)
    over = sum(joint.over for joint in found.joints)
    verdicts = [("ok" if whole else "bad", f"{proven} of {len(found.panels)} panels proven")]
    if found.measured:
        words = f"{over} of {len(found.measured)} measured joints over the limit"
        verdicts.append(("bad" if over else "ok", words))
    x, y = found.data["size_mm"]
    about = f"Element of {x:g} x {y:g} mm in {len(found.panels)} panels, as its programs cut it."
    return page(
        Page(
            f"{name} – element",
            name,
            tuple(verdicts),
            Paragraph(about, "soft"),
            _tiles(found, proven, over),
            (
                Section("drawing", "Panels", (Wide(_drawing(found)), Paragraph(_KEY, "soft"))),
                Section("hours", "Robot hours", _hours(found, proven)),
                Section("cut", "What is cut, against what is wanted", _cut(found)),
                Section("joints", "Joints", _joints(found)),
                Section("sizes", "Sizes", _sizes(found)),
                Section("panels", "List of panels", (Wide(_list(found)),)),
            ),
        )
    )


_KEY: Final = (
    "Seen from the front; a thin line in a panel lies as its wire does. Green: proven; red: refused or not "
    "proven; grey: not planned. Joints over the limit are drawn thick and red, measured ones dark."
)


def _tiles(found: ElementRun, proven: int, over: int) -> tuple[Tile, ...]:
    tiles = [Tile("panels proven", f"{proven} / {len(found.panels)}", bad=proven < len(found.panels))]
    for arm, seconds in found.arm_seconds().items():
        tiles.append(Tile(f"robot hours, {arm}", fixed(seconds / HOUR, 2), "h"))
    if found.measured:
        steps = _all_steps(found)
        worst = max(joint.largest for joint in found.measured)
        tiles.append(Tile("joints measured", f"{len(found.measured)} / {len(found.joints)}"))
        tiles.append(Tile("step and gap, 95 % of all points", fixed(np.percentile(steps, 95.0), 2), "mm"))
        tiles.append(Tile("step and gap, worst", fixed(worst / MM, 2), "mm", worst > MOST))
        tiles.append(Tile("joints over the limit", str(over), bad=over > 0))
    return tuple(tiles)


def _all_steps(found: ElementRun) -> FloatArray:
    """Steps and gaps [mm] of all points that are measured: the larger one of both."""
    cuts = [joint.cut for joint in found.measured if joint.cut is not None]
    return np.concatenate([np.maximum(cut.steps, cut.gaps) for cut in cuts] or [np.zeros(0)]) / MM


def _state(panel: PanelRun) -> str:
    if panel.proven:
        return "proven"
    return "open" if panel.state == "not planned" else "refused"


def _drawing(found: ElementRun) -> Drawing:
    """All panels in the element's plane, seen from the front, in the page's own colours."""
    size = found.data["size_mm"]
    scale = _WIDTH / size[0]
    high = size[1] * scale
    boxes = {panel.name: _box(panel, scale, high) for panel in found.panels}
    out = [
        f'<svg viewBox="-4 -4 {_WIDTH + 8:.0f} {high + 8:.0f}" role="img" aria-label="panels" '
        'style="width:100%;font-family:inherit" fill="var(--ink)">'
    ]
    for panel in found.panels:
        left, right, top, bottom = boxes[panel.name]
        said = f"{panel.name}: {panel.state} {panel.code}"
        out.append(
            f'<g><title>{html.escape(said)}</title><rect x="{left:.1f}" y="{top:.1f}" '
            f'width="{right - left:.1f}" height="{bottom - top:.1f}" fill="{_FILL[_state(panel)]}" '
            'stroke="var(--soft)" stroke-width="1"/>'
        )
        level, middle = 0.5 * (top + bottom), 0.5 * (left + right)
        along = str(panel.panel["wire_along"]) == "x"
        ends = (left + 8, top + 8, right - 8, top + 8) if along else (left + 8, top + 8, left + 8, bottom - 8)
        places = " ".join(f'{k}="{v:.1f}"' for k, v in zip(("x1", "y1", "x2", "y2"), ends, strict=True))
        out.append(f'<line {places} stroke="var(--soft)" stroke-width="1"/>')
        minutes = max(panel.seconds.values(), default=0.0) / MINUTE
        below = f"{minutes:.1f} min" if panel.proven else panel.code.partition(".")[2] or panel.state
        text = min(22.0, 2.6 * (right - left) / max(len(below), 6), 0.28 * (bottom - top))
        out.append(
            f'<text x="{middle:.1f}" y="{level:.1f}" font-size="{text:.1f}" font-weight="600" '
            f'text-anchor="middle">{panel.name}</text><text x="{middle:.1f}" y="{level + 0.9 * text:.1f}" '
            f'font-size="{0.6 * text:.1f}" text-anchor="middle">{html.escape(below)}</text></g>'
        )
    for joint in sorted(found.measured, key=lambda joint: joint.over):
        one, other = (boxes[name] for name in joint.panels)
        left, right = max(one[0], other[0]), min(one[1], other[1])
        top, bottom = max(one[2], other[2]), min(one[3], other[3])
        style = (
            'stroke="var(--bad)" stroke-width="6"' if joint.over else 'stroke="var(--ink)" stroke-width="2"'
        )
        words = f"{joint.panels[0]} to {joint.panels[1]}: {joint.at_95 / MM:.3f} mm at 95 %"
        out.append(
            f'<line x1="{left:.1f}" y1="{top:.1f}" x2="{right:.1f}" y2="{bottom:.1f}" {style}>'
            f"<title>{words}</title></line>"
        )
    return Drawing("".join(out) + "</svg>")


def _box(panel: PanelRun, scale: float, high: float) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of a panel in the drawing [px]."""
    x0, x1, y0, y1 = (float(panel.panel[key]) * scale for key in _SIDES)
    return x0, x1, high - y1, high - y0


_SIDES: Final = ("from_x_mm", "to_x_mm", "from_y_mm", "to_y_mm")


def _hours(found: ElementRun, proven: int) -> tuple[Facts | Paragraph, ...]:
    """Before foam is ordered: what the robots are busy with all panels."""
    if not proven:
        return (Paragraph("No panel is proven, so there are no robot hours to tell."),)
    items: list[tuple[Phrase, Phrase]] = []
    for arm, seconds in found.arm_seconds().items():
        said = f"{seconds / HOUR:.2f} h of motion for {proven} proven panels"
        if proven < len(found.panels):
            share = seconds * len(found.panels) / proven / HOUR
            said += f"; about {share:.1f} h for all {len(found.panels)} if the others take as long"
        items.append((f"arm {arm}", said))
    note = "Motion of the programs alone: loading, mounting and heating of wires come on top."
    return Facts(tuple(items)), Paragraph(note, "soft")


def _cut(found: ElementRun) -> tuple[Grid | Paragraph, ...]:
    cut = [panel for panel in found.panels if panel.faces]
    if not cut:
        return (Paragraph("No panel is proven, so nothing is cut."),)
    tolerance = float(found.data.get("tolerance_mm", 1.0)) * MM
    blocks: list[Figure] = []
    for number, side in enumerate(("Fronts", "Backs")):
        faces = [panel.faces[number] for panel in cut if len(panel.faces) > number]
        if not faces:
            continue
        points = np.concatenate([face.place for face in faces])
        off = np.concatenate([face.deviation for face in faces])
        seen = charts.deviation_map(points, off, tolerance, f"{side}: off the panels as written")
        blocks.append(dataclasses.replace(seen, note="in the frame of the element; mm"))
        blocks.append(Figure(f"{side}: share of vertices", charts.histogram(off, tolerance)))
    note = (
        "Simulated by the proof from the programs, against the faces as they were written, which are off the "
    )
    note += f"surface by up to {_worst_written(found):.2f} mm themselves. Before foam effects."
    return Grid(tuple(blocks), "two"), Paragraph(note, "soft")


def _worst_written(found: ElementRun) -> float:
    return max(float(panel.panel["off_surface_mm"]) for panel in found.panels)


def _joints(found: ElementRun) -> tuple[Paragraph | Grid, ...]:
    if not found.measured:
        return (Paragraph("No two neighbours are proven, so no joint is measured."),)
    limit = found.joints[0].limit / MM
    words = (
        f"Step across the surface and gap along it of the simulated parts; allowed are {limit:g} mm at 95 % "
    )
    words += (
        f"of a joint's points and {MOST / MM:g} mm at each. {len(found.measured)} of {len(found.joints)} "
    )
    words += "joints have both panels proven. Sides are not in it where another operation cuts them."
    rows = [
        (
            f"{joint.panels[0]} – {joint.panels[1]}",
            round(joint.length / MM, 1),
            round(joint.at_95 / MM, 3),
            round(joint.largest / MM, 3),
            Tag("bad", "over") if joint.over else Tag("ok", "within"),
        )
        for joint in sorted(found.measured, key=lambda joint: -joint.at_95)
    ]
    heads = ("joint", "length mm", "at 95 % mm", "largest mm", "limit")
    spread = Figure("Points of all joints", _bars(_all_steps(found), "step or gap [mm]"))
    return Paragraph(words), Grid((table(heads, rows), spread), "two")


def _bars(values: FloatArray, label: str) -> Drawing | Paragraph:
    """How many values lie where."""
    counts, edges = np.histogram(values, bins=_BINS)
    x, y = np.repeat(edges, 2)[1:-1], np.repeat(counts.astype(np.float64), 2)
    line = charts.Line("count", x, y)
    top = float(counts.max()) * 1.08 + 0.1
    return charts.chart([line], x_label=label, y_label="count", y_range=(0.0, top))


def _sizes(found: ElementRun) -> tuple[Grid, ...]:
    x0, x1, y0, y1 = (np.array([float(p.panel[key]) for p in found.panels]) for key in _SIDES)
    edges = np.concatenate([x1 - x0, y1 - y0])
    blocks = np.array([[float(p.panel[f"block_{axis}_mm"]) for axis in "xyz"] for p in found.panels])
    return (
        Grid(
            (
                Figure("Panels in the element's plane", _bars((x1 - x0) * (y1 - y0) * 1e-6, "area [m²]")),
                Figure("Their edges", _bars(edges, "edge [mm]")),
                Figure("Volume of blocks", _bars(blocks.prod(axis=1) * 1e-9, "volume [m³]")),
            ),
            "three",
        ),
    )


def _list(found: ElementRun) -> Table:
    arms = tuple(found.arm_seconds())
    heads = ("panel", "state", "size mm", "wire", "block mm", *(f"{arm} min" for arm in arms), "why not")
    rows = []
    for panel in found.panels:
        own = panel.panel
        x0, x1, y0, y1 = (float(own[key]) for key in _SIDES)
        kind = {"proven": "ok", "refused": "bad", "open": "off"}[_state(panel)]
        block = " x ".join(f"{float(own[f'block_{axis}_mm']):g}" for axis in "xyz")
        minutes = [round(panel.seconds[a] / MINUTE, 2) if a in panel.seconds else None for a in arms]
        why = "" if panel.proven else Soft(f"{panel.code} {panel.message}".strip())
        tag = Tag(kind, "proven" if panel.proven else panel.state)
        wire = f"{own['wire']}, along {own['wire_along']}"
        rows.append((panel.name, tag, f"{x1 - x0:.0f} x {y1 - y0:.0f}", wire, block, *minutes, why))
    return table(heads, rows)
