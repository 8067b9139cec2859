"""Drawings of all panels of an element with their ids, for its page: front, rear, and flat layout."""

import html
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.panel_drawing import BOLD_LETTER_WIDTH, fit_text
from planner.element.run_report import MINUTE_S, ElementRun, PanelRun, SawRun
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.report.markup import Drawing

_WIDTH: Final = 1000.0  # of drawings [px]
_FILL: Final = {"proven": "var(--ok-bg)", "refused": "var(--bad-bg)", "open": "var(--note-bg)"}
_WIDE: Final = 0.62  # mean width of a letter in sizes of type
_MIN_FONT_PX: Final = 4.0  # px: smaller text is omitted, it is in the title
_MAX_FONT_PX: Final = 22.0  # px: type of ids
_SMALL_PERCENTILE: Final = 15.0  # percent of the panels that may be too small for the type of ids
_COLOURS: Final = 8  # of the page's palette
_GAP: Final = 26.0  # px between panels that are laid flat


def group_colour(name: str) -> str:
    """Return the colour of a group, by the letter that ids start with."""
    return f"--c{(ord(name[0]) - ord('A')) % _COLOURS}"


def state_of(panel: PanelRun | SawRun) -> str:
    """Return the state of a panel or job: proven, refused or open."""
    if panel.proven:
        return "proven"
    return "open" if panel.state == "not planned" else "refused"


def _ring(panel: Mapping[str, Any], key: str = "outline_mm") -> FloatArray:
    return np.array(panel[key], dtype=np.float64)


def front_of(panel: Mapping[str, Any]) -> FloatArray:
    """Return the front (C, 2) [mm] of a panel; if not stated separately, its outline in the drawing."""
    return _ring(panel, "front_mm" if "front_mm" in panel else "outline_mm")


def draw_rear(run: ElementRun) -> Drawing:
    """Draw all panels with their ids as seen from behind."""
    drawn = {name: ring * [-1.0, 1.0] + [_WIDTH, 0.0] for name, ring in _outlines(run).items()}
    size = _type_size(drawn)
    out = [_svg(_height(drawn), "panels from behind")]
    for panel in run.panels:
        ring = drawn[panel.name]
        out += [_polygon(ring, _FILL[state_of(panel)]), *_draw_text(ring, panel.name, size)]
    return Drawing("".join(out) + "</svg>")


def _outlines(run: ElementRun) -> dict[str, FloatArray]:
    """Return outlines (C, 2) [px] by id, as seen from the front, y down."""
    rings = {panel.name: _ring(panel.panel) for panel in run.panels}
    size = np.concatenate(list(rings.values())).max(axis=0)
    scale = _WIDTH / float(size[0])
    high = float(size[1]) * scale
    return {name: ring * [scale, -scale] + [0.0, high] for name, ring in rings.items()}


def _height(drawn: Mapping[str, FloatArray]) -> float:
    return max(float(ring[:, 1].max()) for ring in drawn.values())


def draw_front(run: ElementRun) -> Drawing:
    """Draw all panels as seen from the front, in the colours of the page."""
    drawn = _outlines(run)
    size_of_type = _type_size(drawn)
    out = [_svg(_height(drawn), "panels")]
    for panel in run.panels:
        panel_data = panel.panel
        ring = drawn[panel.name]
        minutes = max(panel.seconds.values(), default=0.0) / MINUTE_S
        below = ""
        if run.planned:
            below = f"{minutes:.1f} min" if panel.proven else panel.code.partition(".")[2]
        title = f"{panel.name}: {panel.state} {panel.code}".strip()
        dashed = ' stroke-dasharray="5 3"' if panel_data.get("concave") == "yes" else ""
        fill = _FILL[state_of(panel)]
        if run.data.get("grouped") and not run.planned:
            fill = f"var({group_colour(panel.name)})"
            dashed += ' fill-opacity="0.3"'
        out.append(f"<g><title>{html.escape(title)}</title>{_polygon(ring, fill, dashed)}")
        if "wire_along" in panel_data:
            (left, top), (right, bottom) = ring.min(axis=0) + 8.0, ring.max(axis=0) - 8.0
            ends = (left, top, right, top) if panel_data["wire_along"] == "x" else (left, top, left, bottom)
            out.append(_line(ends, 'stroke="var(--soft)" stroke-width="1"'))
        out += [*_draw_text(ring, panel.name, size_of_type, below), "</g>"]
    for joint in sorted(run.measured, key=lambda joint: joint.is_over_limit):
        first, second = joint.panels
        panel_data = next(panel.panel for panel in run.panels if panel.name == first)
        ring = drawn[first]
        style = (
            'stroke="var(--bad)" stroke-width="6"'
            if joint.is_over_limit
            else 'stroke="var(--ink)" stroke-width="2"'
        )
        words = f"<title>{first} to {second}: {joint.at_95 / MM:.3f} mm at 95 %</title>"
        for i in (i for i, beyond in enumerate(panel_data["neighbours"]) if beyond == second):
            ends = (*ring[i].tolist(), *ring[(i + 1) % len(ring)].tolist())
            out.append(_line(ends, style, words))
    return Drawing("".join(out) + "</svg>")


def _svg(high: float, label: str) -> str:
    return (
        f'<svg viewBox="-4 -4 {_WIDTH + 8:.0f} {high + 8:.0f}" role="img" aria-label="{label}" '
        'style="width:100%;font-family:inherit">'
    )


def _polygon(ring: FloatArray, fill: str, more: str = "") -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in ring.tolist())
    return f'<polygon points="{points}" fill="{fill}" stroke="var(--soft)"{more}/>'


def _line(ends: Sequence[float], style: str, inside: str = "") -> str:
    coordinates = " ".join(f'{k}="{v:.1f}"' for k, v in zip(("x1", "y1", "x2", "y2"), ends, strict=True))
    return f"<line {coordinates} {style}>{inside}</line>"


def _type_size(rings: Mapping[str, FloatArray]) -> float:
    """Return the font size [px] of ids that fits most outlines."""
    room = [
        min(0.56 * float(np.ptp(ring[:, 0])) / (_WIDE * len(name)), 0.4 * float(np.ptp(ring[:, 1])))
        for name, ring in rings.items()
    ]
    return min(_MAX_FONT_PX, float(np.percentile(room, _SMALL_PERCENTILE)))


def _draw_text(ring: FloatArray, name: str, size: float, below: str = "") -> list[str]:
    """Write the id of a panel in the centre of its outline, at most of ``size``, and a smaller line below."""
    wide, tall = np.ptp(ring, axis=0).tolist()
    font_size = min(size, 0.7 * wide / (_WIDE * len(name)), 0.5 * tall)
    x, y, factor = fit_text(
        ring, BOLD_LETTER_WIDTH * len(name) * font_size, (1.8 if below else 1.0) * font_size
    )
    font_size *= factor
    small = min(0.7 * font_size, 0.8 * wide / (_WIDE * max(len(below), 1)))
    out = []
    for line, high, at, weight in ((name, font_size, 0.0 if below else 0.35, 600), (below, small, 0.9, 400)):
        if line and high >= _MIN_FONT_PX:
            out.append(
                f'<text x="{x:.1f}" y="{y + at * font_size:.1f}" text-anchor="middle" style="fill:var(--ink);'
                f'font-size:{high:.1f}px;font-weight:{weight}">{html.escape(line)}</text>'
            )
    return out


def upright_front(panel: Mapping[str, Any]) -> FloatArray:
    """Return the front (C, 2) [mm] of a panel laid flat with its up direction upward, centred on its box."""
    ring = front_of(panel)
    x, y = panel.get("up", (0.0, 1.0))
    ring = ring @ np.array([[y, x], [-x, y]])
    return np.asarray(ring - 0.5 * (ring.min(axis=0) + ring.max(axis=0)))


def id_letters(name: str) -> str:
    """Return the letters that the id of a panel starts with."""
    match = re.match(r"[A-Za-z]+", name)
    return match[0] if match else ""


def draw_flat(run: ElementRun) -> str:
    """Draw all fronts at one scale, a new line for each row of ids."""
    rings = {panel.name: upright_front(panel.panel) for panel in run.panels}
    largest = max(float(np.ptp(ring, axis=0).max()) for ring in rings.values())
    scale = 0.11 * _WIDTH / largest
    x, y, tall, row = 0.0, 0.0, 0.0, ""
    out = []
    for panel in run.panels:
        ring = rings[panel.name] * [scale, -scale]
        width, height = np.ptp(ring, axis=0).tolist()
        new = id_letters(panel.name)
        if (row and new != row) or x + width > _WIDTH:
            x, y, tall = 0.0, y + tall + (2.0 if new != row else 1.0) * _GAP, 0.0
        row, tall = new, max(tall, height)
        moved = ring + np.array([x + 0.5 * width, y + 0.5 * height])
        out += [_polygon(moved, _FILL[state_of(panel)]), *_draw_text(moved, panel.name, _MAX_FONT_PX)]
        x += width + _GAP
    return _svg(y + tall, "panels laid flat") + "".join(out) + "</svg>"
