"""Drawings of all panels of an element with their ids, as parts of its page: from the front, from behind, and
laid flat."""

import html
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.panel_drawing import BOLD, words_at
from planner.element.run_report import MINUTE, ElementRun, PanelRun, SawRun
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.report.markup import Drawing

_WIDTH: Final = 1000.0  # of drawings [px]
_FILL: Final = {"proven": "var(--ok-bg)", "refused": "var(--bad-bg)", "open": "var(--note-bg)"}
_WIDE: Final = 0.62  # mean width of a letter in sizes of type
_LEAST: Final = 4.0  # px: type that is smaller is left out, the words are in the title
_LARGEST: Final = 22.0  # px: type of ids
_SMALL_SHARE: Final = 15.0  # percent of the panels that may be too small for the type of ids
_COLOURS: Final = 8  # of the page's palette
_GAP: Final = 26.0  # px between panels that are laid flat


def group_colour(name: str) -> str:
    """The colour of a group, by the letter that ids begin with."""
    return f"--c{(ord(name[0]) - ord('A')) % _COLOURS}"


def state_of(panel: PanelRun | SawRun) -> str:
    """What became of a panel or job: proven, refused or open."""
    if panel.proven:
        return "proven"
    return "open" if panel.state == "not planned" else "refused"


def _ring(panel: Mapping[str, Any], key: str = "outline_mm") -> FloatArray:
    return np.array(panel[key], dtype=np.float64)


def front_of(panel: Mapping[str, Any]) -> FloatArray:
    """A panel's front (C, 2) [mm]; where it is not told by itself, as it is drawn with the others."""
    return _ring(panel, "front_mm" if "front_mm" in panel else "outline_mm")


def behind(found: ElementRun) -> Drawing:
    """All panels with their ids as one sees them who stands behind."""
    drawn = {name: ring * [-1.0, 1.0] + [_WIDTH, 0.0] for name, ring in _drawn(found).items()}
    size = _type_size(drawn)
    out = [_svg(_high(drawn), "panels from behind")]
    for panel in found.panels:
        ring = drawn[panel.name]
        out += [_polygon(ring, _FILL[state_of(panel)]), *_words(ring, panel.name, size)]
    return Drawing("".join(out) + "</svg>")


def _drawn(found: ElementRun) -> dict[str, FloatArray]:
    """Outlines (C, 2) [px] by ids, as seen from the front, y down."""
    rings = {panel.name: _ring(panel.panel) for panel in found.panels}
    size = np.concatenate(list(rings.values())).max(axis=0)
    scale = _WIDTH / float(size[0])
    high = float(size[1]) * scale
    return {name: ring * [scale, -scale] + [0.0, high] for name, ring in rings.items()}


def _high(drawn: Mapping[str, FloatArray]) -> float:
    return max(float(ring[:, 1].max()) for ring in drawn.values())


def drawing(found: ElementRun) -> Drawing:
    """All panels as seen from the front, in the page's own colours."""
    drawn = _drawn(found)
    size_of_type = _type_size(drawn)
    out = [_svg(_high(drawn), "panels")]
    for panel in found.panels:
        own = panel.panel
        ring = drawn[panel.name]
        minutes = max(panel.seconds.values(), default=0.0) / MINUTE
        below = ""
        if found.planned:
            below = f"{minutes:.1f} min" if panel.proven else panel.code.partition(".")[2]
        said = f"{panel.name}: {panel.state} {panel.code}".strip()
        dashed = ' stroke-dasharray="5 3"' if own.get("concave") == "yes" else ""
        fill = _FILL[state_of(panel)]
        if found.data.get("grouped") and not found.planned:
            fill = f"var({group_colour(panel.name)})"
            dashed += ' fill-opacity="0.3"'
        out.append(f"<g><title>{html.escape(said)}</title>{_polygon(ring, fill, dashed)}")
        if "wire_along" in own:
            (left, top), (right, bottom) = ring.min(axis=0) + 8.0, ring.max(axis=0) - 8.0
            ends = (left, top, right, top) if own["wire_along"] == "x" else (left, top, left, bottom)
            out.append(_line(ends, 'stroke="var(--soft)" stroke-width="1"'))
        out += [*_words(ring, panel.name, size_of_type, below), "</g>"]
    for joint in sorted(found.measured, key=lambda joint: joint.over):
        one, other = joint.panels
        own = next(panel.panel for panel in found.panels if panel.name == one)
        ring = drawn[one]
        style = (
            'stroke="var(--bad)" stroke-width="6"' if joint.over else 'stroke="var(--ink)" stroke-width="2"'
        )
        words = f"<title>{one} to {other}: {joint.at_95 / MM:.3f} mm at 95 %</title>"
        for i in (i for i, beyond in enumerate(own["neighbours"]) if beyond == other):
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
    places = " ".join(f'{k}="{v:.1f}"' for k, v in zip(("x1", "y1", "x2", "y2"), ends, strict=True))
    return f"<line {places} {style}>{inside}</line>"


def _type_size(rings: Mapping[str, FloatArray]) -> float:
    """The size [px] of ids that most outlines have room for."""
    room = [
        min(0.56 * float(np.ptp(ring[:, 0])) / (_WIDE * len(name)), 0.4 * float(np.ptp(ring[:, 1])))
        for name, ring in rings.items()
    ]
    return min(_LARGEST, float(np.percentile(room, _SMALL_SHARE)))


def _words(ring: FloatArray, name: str, size: float, below: str = "") -> list[str]:
    """A panel's id in the middle of its outline, at most of that size, and a smaller line below it."""
    wide, tall = np.ptp(ring, axis=0).tolist()
    own = min(size, 0.7 * wide / (_WIDE * len(name)), 0.5 * tall)
    x, y, share = words_at(ring, BOLD * len(name) * own, (1.8 if below else 1.0) * own)
    own *= share
    small = min(0.7 * own, 0.8 * wide / (_WIDE * max(len(below), 1)))
    out = []
    for line, high, at, weight in ((name, own, 0.0 if below else 0.35, 600), (below, small, 0.9, 400)):
        if line and high >= _LEAST:
            out.append(
                f'<text x="{x:.1f}" y="{y + at * own:.1f}" text-anchor="middle" style="fill:var(--ink);'
                f'font-size:{high:.1f}px;font-weight:{weight}">{html.escape(line)}</text>'
            )
    return out


def turned_up(panel: Mapping[str, Any]) -> FloatArray:
    """The front (C, 2) [mm] of a panel laid flat with its up upwards, about the middle of its box."""
    ring = front_of(panel)
    x, y = panel.get("up", (0.0, 1.0))
    ring = ring @ np.array([[y, x], [-x, y]])
    return np.asarray(ring - 0.5 * (ring.min(axis=0) + ring.max(axis=0)))


def row_of(name: str) -> str:
    """The letters that a panel's id begins with."""
    found = re.match(r"[A-Za-z]+", name)
    return found[0] if found else ""


def flat(found: ElementRun) -> str:
    """All fronts at one scale, a new line for each row of ids."""
    rings = {panel.name: turned_up(panel.panel) for panel in found.panels}
    largest = max(float(np.ptp(ring, axis=0).max()) for ring in rings.values())
    scale = 0.11 * _WIDTH / largest
    x, y, tall, row = 0.0, 0.0, 0.0, ""
    out = []
    for panel in found.panels:
        ring = rings[panel.name] * [scale, -scale]
        wide, own = np.ptp(ring, axis=0).tolist()
        new = row_of(panel.name)
        if (row and new != row) or x + wide > _WIDTH:
            x, y, tall = 0.0, y + tall + (2.0 if new != row else 1.0) * _GAP, 0.0
        row, tall = new, max(tall, own)
        moved = ring + np.array([x + 0.5 * wide, y + 0.5 * own])
        out += [_polygon(moved, _FILL[state_of(panel)]), *_words(moved, panel.name, _LARGEST)]
        x += wide + _GAP
    return _svg(y + tall, "panels laid flat") + "".join(out) + "</svg>"
