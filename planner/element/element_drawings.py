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
_LETTER_WIDTH: Final = 0.62  # mean width of a letter as a fraction of the font size
_MIN_FONT_PX: Final = 4.0  # px: smaller text is omitted; the tooltip still shows it
_MAX_FONT_PX: Final = 22.0  # px: of ids
_SMALL_PERCENTILE: Final = 15.0  # percentage of the panels that may be too small for the common font size
_COLOURS: Final = 8  # number of colours in the page's palette
_GAP: Final = 26.0  # px between panels that are laid flat


def group_colour(name: str) -> str:
    """Return the CSS variable of a group's colour, which follows from the first letter of its ids."""
    return f"--c{(ord(name[0]) - ord('A')) % _COLOURS}"


def state_of(panel: PanelRun | SawRun) -> str:
    """Return the state of a panel or job: proven, refused or open."""
    if panel.proven:
        return "proven"
    return "open" if panel.state == "not planned" else "refused"


def _ring(panel: Mapping[str, Any], key: str = "outline_mm") -> FloatArray:
    """Return a polygon (C, 2) [mm] of a panel of ``element.json``."""
    return np.array(panel[key], dtype=np.float64)


def front_of(panel: Mapping[str, Any]) -> FloatArray:
    """Return the front (C, 2) [mm] of a panel: ``front_mm`` of ``element.json``, else ``outline_mm``."""
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
    """Return the outlines (C, 2) [px] of all panels by id, as seen from the front, y down."""
    rings = {panel.name: _ring(panel.panel) for panel in run.panels}
    size = np.concatenate(list(rings.values())).max(axis=0)
    scale = _WIDTH / float(size[0])
    height = float(size[1]) * scale
    return {name: ring * [scale, -scale] + [0.0, height] for name, ring in rings.items()}


def _height(drawn: Mapping[str, FloatArray]) -> float:
    return max(float(ring[:, 1].max()) for ring in drawn.values())


def draw_front(run: ElementRun) -> Drawing:
    """Draw all panels as seen from the front: state, time, direction of the wire, and measured joints."""
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


def _svg(height: float, label: str) -> str:
    return (
        f'<svg viewBox="-4 -4 {_WIDTH + 8:.0f} {height + 8:.0f}" role="img" aria-label="{label}" '
        'style="width:100%;font-family:inherit">'
    )


def _polygon(ring: FloatArray, fill: str, attributes: str = "") -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in ring.tolist())
    return f'<polygon points="{points}" fill="{fill}" stroke="var(--soft)"{attributes}/>'


def _line(ends: Sequence[float], style: str, content: str = "") -> str:
    coordinates = " ".join(f'{key}="{v:.1f}"' for key, v in zip(("x1", "y1", "x2", "y2"), ends, strict=True))
    return f"<line {coordinates} {style}>{content}</line>"


def _type_size(rings: Mapping[str, FloatArray]) -> float:
    """Return the font size [px] at which the ids of all but `_SMALL_PERCENTILE` percent fit their outlines.

    ``rings`` are outlines (C, 2) [px] by id.
    """
    sizes = [
        min(0.56 * float(np.ptp(ring[:, 0])) / (_LETTER_WIDTH * len(name)), 0.4 * float(np.ptp(ring[:, 1])))
        for name, ring in rings.items()
    ]
    return min(_MAX_FONT_PX, float(np.percentile(sizes, _SMALL_PERCENTILE)))


def _draw_text(ring: FloatArray, name: str, size: float, below: str = "") -> list[str]:
    """Write an id, at most of ``size`` [px], inside an outline (C, 2) [px], and a smaller line below it."""
    width, height = np.ptp(ring, axis=0).tolist()
    font_size = min(size, 0.7 * width / (_LETTER_WIDTH * len(name)), 0.5 * height)
    x, y, factor = fit_text(
        ring, BOLD_LETTER_WIDTH * len(name) * font_size, (1.8 if below else 1.0) * font_size
    )
    font_size *= factor
    small_size = min(0.7 * font_size, 0.8 * width / (_LETTER_WIDTH * max(len(below), 1)))
    out = []
    for line, line_size, dy, weight in (
        (name, font_size, 0.0 if below else 0.35, 600),
        (below, small_size, 0.9, 400),
    ):
        if line and line_size >= _MIN_FONT_PX:
            out.append(
                f'<text x="{x:.1f}" y="{y + dy * font_size:.1f}" text-anchor="middle" style="fill:var(--ink);'
                f'font-size:{line_size:.1f}px;font-weight:{weight}">{html.escape(line)}</text>'
            )
    return out


def upright_front(panel: Mapping[str, Any]) -> FloatArray:
    """Return the front (C, 2) [mm] of a panel laid flat with its up direction along +y, centred on (0, 0)."""
    ring = front_of(panel)
    x, y = panel.get("up", (0.0, 1.0))
    ring = ring @ np.array([[y, x], [-x, y]])
    return np.asarray(ring - 0.5 * (ring.min(axis=0) + ring.max(axis=0)))


def id_letters(name: str) -> str:
    """Return the letters that the id of a panel starts with."""
    match = re.match(r"[A-Za-z]+", name)
    return match[0] if match else ""


def draw_flat(run: ElementRun) -> str:
    """Draw the fronts of all panels laid flat, at one scale, and start a new line for each letter of ids."""
    rings = {panel.name: upright_front(panel.panel) for panel in run.panels}
    largest = max(float(np.ptp(ring, axis=0).max()) for ring in rings.values())
    scale = 0.11 * _WIDTH / largest
    x, y, row_height, row_letters = 0.0, 0.0, 0.0, ""
    out = []
    for panel in run.panels:
        ring = rings[panel.name] * [scale, -scale]
        width, height = np.ptp(ring, axis=0).tolist()
        letters = id_letters(panel.name)
        if (row_letters and letters != row_letters) or x + width > _WIDTH:
            x, y, row_height = 0.0, y + row_height + (2.0 if letters != row_letters else 1.0) * _GAP, 0.0
        row_letters, row_height = letters, max(row_height, height)
        placed = ring + np.array([x + 0.5 * width, y + 0.5 * height])
        out += [_polygon(placed, _FILL[state_of(panel)]), *_draw_text(placed, panel.name, _MAX_FONT_PX)]
        x += width + _GAP
    return _svg(y + row_height, "panels laid flat") + "".join(out) + "</svg>"
