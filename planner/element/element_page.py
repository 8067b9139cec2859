"""``element.html``: an element and its panels as one offline page, with what became of them where a batch of
them is known (`run_page.py` has those sections).

Drawings of all panels with ids, blocks and how they are cut, totals with an estimate of robot hours, sizes,
and what was said of the element. The page is made of the data in ``element.json`` alone, whatever the kind of
panels.
"""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.assembly_page import assembly_section
from planner.element.panel_drawing import BOLD, words_at
from planner.element.run_page import bars, cut_section, hours, joints_section, run_tiles
from planner.element.run_report import MINUTE, ElementRun, PanelRun, SawRun
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.report.markup import (
    Block,
    Code,
    Drawing,
    Facts,
    Figure,
    Folded,
    Grid,
    Lines,
    Page,
    Paragraph,
    Photo,
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

_WIDTH: Final = 1000.0  # of drawings [px]
_FILL: Final = {"proven": "var(--ok-bg)", "refused": "var(--bad-bg)", "open": "var(--note-bg)"}
_WIDE: Final = 0.62  # mean width of a letter in sizes of type
_LEAST: Final = 4.0  # px: type that is smaller is left out, the words are in the title
_LARGEST: Final = 22.0  # px: type of ids
_SMALL_SHARE: Final = 15.0  # percent of the panels that may be too small for the type of ids
_COLOURS: Final = 8  # of the page's palette
_GAP: Final = 26.0  # px between panels that are laid flat


def element_page(found: ElementRun, blocks: str | None = None) -> str:
    """The page as HTML; ``blocks``: the cut drawings of raw blocks, an SVG."""
    data = found.data
    name, count = str(data["name"]), len(found.panels)
    verdicts: list[tuple[str, str]] = []
    if found.planned:
        proven = sum(panel.proven for panel in found.panels)
        over = sum(joint.over for joint in found.joints)
        verdicts.append(("ok" if proven == count else "bad", f"{proven} of {count} panels proven"))
        if found.measured:
            words = f"{over} of {len(found.measured)} measured joints over the limit"
            verdicts.append(("bad" if over else "ok", words))
    else:
        verdicts.append(("", f"{count} panels, none planned yet"))
    sections = [Section("drawing", "Panels", (Wide(_drawing(found)), Paragraph(_key(found), "soft")))]
    if any("front_mm" in panel.panel for panel in found.panels):
        by = "groups" if data.get("grouped") else "rows"
        words = f"Fronts at one scale, by {by}; up is up in the element where they lean."
        flat = Folded(f"{count} panels, by {by}", Drawing(_flat(found)))
        sections.append(Section("flat", "Panels laid flat", (Paragraph(words, "soft"), flat)))
    sections.append(Section("assembly", "How it is put up", assembly_section(data, _colours(found))))
    sections.append(Section("told", "What was said of it", _told(found)))
    sections.append(Section("totals", "Totals", (Facts(tuple(_totals(found))), Paragraph(_BASIS, "soft"))))
    if found.planned:
        sections.append(Section("hours", "Robot hours", hours(found)))
        sections.append(Section("cut", "What is cut, against what is wanted", cut_section(found)))
        sections.append(Section("joints", "Joints", joints_section(found)))
    sections.append(Section("sizes", "Sizes", _sizes(found)))
    sections.append(Section("blocks", "Raw blocks", _blocks(found, blocks)))
    sections.append(Section("panels", "List of panels", (Wide(_list(found)),)))
    about = f"Element in {count} panels, " + (
        "as its programs cut it." if found.planned else "as it is divided, before anything is planned."
    )
    tiles = (*_tiles(found), *(run_tiles(found) if found.planned else ()))
    return page(
        Page(f"{name} – element", name, tuple(verdicts), Paragraph(about, "soft"), tiles, tuple(sections))
    )


_BASIS: Final = (
    "Hours to cut are the lengths of the cuts at the feeds of the jobs, for each arm that takes part. Ways "
    "in and out, loading and mounting come on top."
)


def _colours(found: ElementRun) -> Callable[[Mapping[str, Any]], str]:
    """The colours of panels that stand: by their states where a batch is known, else by groups, if any."""
    states = {panel.name: _state(panel) for panel in found.panels}

    def fill(panel: Mapping[str, Any]) -> str:
        if found.planned:
            return {"proven": "--ok", "refused": "--bad", "open": "--c7"}[states[str(panel["id"])]]
        return _group_colour(str(panel["id"])) if found.data.get("grouped") else "--c0"

    return fill


def _group_colour(name: str) -> str:
    return f"--c{(ord(name[0]) - ord('A')) % _COLOURS}"


def _key(found: ElementRun) -> str:
    words = "Seen from the front."
    if found.data.get("grouped"):
        words += " Letters are groups" + (".", ", as are colours.")[not found.planned]
    if any("wire_along" in panel.panel for panel in found.panels):
        words += " A thin line in a panel lies as its wire does."
    if any(panel.panel.get("concave") == "yes" for panel in found.panels):
        words += " Dashed: concave."
    if found.planned:
        words += (
            " Green: proven; red: refused or not proven; grey: not planned. Joints over the limit are drawn "
            "thick and red, measured ones dark."
        )
    return words


def _tiles(found: ElementRun) -> Iterator[Tile]:
    data = found.data
    nest = data.get("blocks")
    if nest:
        yield Tile("raw blocks", str(len(nest["blocks"])))
        yield Tile("least by areas", str(nest["least"]))
        yield Tile("of the foam is panels", fixed(100.0 * nest["yield_volume"], 0), "%")
    if not found.planned:
        yield from (
            Tile(f"hours to cut, {arm}, estimate", fixed(minutes / 60.0, 1), "h")
            for arm, minutes in _estimate([*_panels(found), *(one.job for one in found.saw)]).items()
        )


def _panels(found: ElementRun) -> list[Mapping[str, Any]]:
    return [panel.panel for panel in found.panels]


def _estimate(jobs: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Minutes that each arm cuts, over panels or jobs of raw blocks."""
    out: dict[str, float] = {}
    for job in jobs:
        for arm, minutes in job.get("cut_min", {}).items():
            out[arm] = out.get(arm, 0.0) + float(minutes)
    return out


def _state(panel: PanelRun | SawRun) -> str:
    if panel.proven:
        return "proven"
    return "open" if panel.state == "not planned" else "refused"


def _ring(panel: Mapping[str, Any], key: str = "outline_mm") -> FloatArray:
    return np.array(panel[key], dtype=np.float64)


def _front(panel: Mapping[str, Any]) -> FloatArray:
    """A panel's front (C, 2) [mm]; where it is not told by itself, as it is drawn with the others."""
    return _ring(panel, "front_mm" if "front_mm" in panel else "outline_mm")


def _drawing(found: ElementRun) -> Drawing:
    """All panels as seen from the front, in the page's own colours."""
    rings = {panel.name: _ring(panel.panel) for panel in found.panels}
    size = np.concatenate(list(rings.values())).max(axis=0)
    scale = _WIDTH / float(size[0])
    high = float(size[1]) * scale
    drawn = {name: ring * [scale, -scale] + [0.0, high] for name, ring in rings.items()}
    size_of_type = _type_size(drawn)
    out = [_svg(high, "panels")]
    for panel in found.panels:
        own = panel.panel
        ring = drawn[panel.name]
        minutes = max(panel.seconds.values(), default=0.0) / MINUTE
        below = ""
        if found.planned:
            below = f"{minutes:.1f} min" if panel.proven else panel.code.partition(".")[2]
        said = f"{panel.name}: {panel.state} {panel.code}".strip()
        dashed = ' stroke-dasharray="5 3"' if own.get("concave") == "yes" else ""
        fill = _FILL[_state(panel)]
        if found.data.get("grouped") and not found.planned:
            fill = f"var({_group_colour(panel.name)})"
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
    for line, high, at, weight in (
        (name, own, 0.0 if below else 0.35, 600),
        (below, small, 0.9, 400),
    ):
        if line and high >= _LEAST:
            out.append(
                f'<text x="{x:.1f}" y="{y + at * own:.1f}" text-anchor="middle" style="fill:var(--ink);'
                f'font-size:{high:.1f}px;font-weight:{weight}">{html.escape(line)}</text>'
            )
    return out


def turned_up(panel: Mapping[str, Any]) -> FloatArray:
    """The front (C, 2) [mm] of a panel laid flat with its up upwards, about the middle of its box."""
    ring = _front(panel)
    x, y = panel.get("up", (0.0, 1.0))
    ring = ring @ np.array([[y, x], [-x, y]])
    return np.asarray(ring - 0.5 * (ring.min(axis=0) + ring.max(axis=0)))


def row_of(name: str) -> str:
    """The letters that a panel's id begins with."""
    found = re.match(r"[A-Za-z]+", name)
    return found[0] if found else ""


def _flat(found: ElementRun) -> str:
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
        out += [_polygon(moved, _FILL[_state(panel)]), *_words(moved, panel.name, _LARGEST)]
        x += wide + _GAP
    return _svg(y + tall, "panels laid flat") + "".join(out) + "</svg>"


def _told(run: ElementRun) -> tuple[Block, ...]:
    """What was said of the element as it was divided, and as it is cut."""
    cut = run.issues() if run.planned else ()
    found = [*run.data.get("issues", ()), *(issue.to_dict() for issue in cut)]
    if not found:
        return (Paragraph("Nothing: no panel was refused, and none is out of what was asked."),)
    kinds = {"warning": "warning", "note": "note"}
    rows = [
        (
            Tag(kinds.get(one.get("severity", ""), "error"), one.get("severity", "error")),
            Lines((one["message"], Soft(one["hint"]))) if one.get("hint") else one["message"],
            Code(one["code"]),
        )
        for one in found
    ]
    return (table(("", "what", "code"), rows),)


def _totals(found: ElementRun) -> Iterator[tuple[Phrase, Phrase]]:
    data = found.data
    own = _panels(found)
    volume = sum(float(one.get("volume_l") or 0.0) for one in own)
    weights = [float(one["weight_kg"]) for one in own if one.get("weight_kg")]
    yield "panels", f"{len(own)}, {1e-3 * volume:.2f} m³"
    if data.get("grouped"):
        groups: dict[str, list[Mapping[str, Any]]] = {}
        for one in own:
            groups.setdefault(row_of(str(one["id"])), []).append(one)
        for letter, members in groups.items():
            heavy = sum(float(one["weight_kg"] or 0.0) for one in members)
            yield f"group {letter}", f"{len(members)} panels" + (f", {heavy:.1f} kg" if heavy else "")
    if strips := data.get("strips"):
        widths, across = strips["widths_mm"], strips["across"]
        tried = (f"across {p}: {n['panels']} in {n['strips']} strips" for p, n in strips["tried"].items())
        size = f"{min(widths):.0f} to {max(widths):.0f} mm wide"
        yield "ruled strips", f"{len(widths)} across {across}, {size}; panels {', '.join(tried)}"
    if weights:
        yield "weight", f"{sum(weights):.1f} kg, the heaviest {max(weights):.2f} kg"
    if found.joints:
        yield "joints", f"{len(found.joints)}, {1e-3 * sum(j.length for j in found.joints) / MM:.1f} m"
    if held := data.get("dowels"):
        size = f"{held['diameter_mm']:g} x {2.0 * held['depth_mm']:g} mm"
        words = f"{len(held['dowels'])} of {size}; places and directions in dowels.csv"
        without = len(held["without"])
        yield "dowels", words + (f"; {without} joints have none" if without else "")
    if nest := data.get("blocks"):
        sizes: dict[str, int] = {}
        for block in nest["blocks"]:
            size = " x ".join(f"{v:g}" for v in block["size_mm"])
            kind = f"{size}, left over" if block["left_over"] else size
            sizes[kind] = sizes.get(kind, 0) + 1
        yield "raw blocks", "; ".join(f"{count} of {size} mm" for size, count in sizes.items())
        why = {"bound": "the least there is", "two-stage": "no nest of strips takes fewer"}
        because = why.get(nest["least_because"] or "", "")
        yield "least by areas of boxes", f"{nest['least']}" + (f"; {because}" if because else "")
        shares = 100.0 * nest["yield_volume"], 100.0 * nest["yield_boxes"]
        yield "of the foam", f"{shares[0]:.0f} % are panels, {shares[1]:.0f} % the blocks they are cut from"
    wires: dict[str, int] = {}
    for one in own:
        if "wire" in one:
            wires[str(one["wire"])] = wires.get(str(one["wire"]), 0) + 1
    for wire, count in wires.items():
        yield f"wire {wire}", f"for {count} panels"
    for arm, minutes in _estimate(own).items():
        each = minutes / len(own)
        yield f"to cut, arm {arm}", f"about {minutes / 60.0:.1f} h, {each:.1f} min a panel: an estimate"
    for arm, minutes in _estimate([one.job for one in found.saw]).items():
        words = f"about {minutes / 60.0:.1f} h in {len(found.saw)} jobs: an estimate"
        yield f"to cut raw blocks, arm {arm}", words


def _sizes(found: ElementRun) -> tuple[Grid, ...]:
    rings = [_front(panel.panel) for panel in found.panels]
    areas, edges = [], []
    for ring in rings:
        after = np.roll(ring, -1, axis=0)
        areas.append(0.5 * abs(float((ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]).sum())))
        edges.append(np.linalg.norm(after - ring, axis=1))
    blocks = np.array([[float(p.panel[f"block_{axis}_mm"]) for axis in "xyz"] for p in found.panels])
    figures = [
        Figure("Panels, in front", bars(np.array(areas) * 1e-6, "area [m²]")),
        Figure("Their edges", bars(np.concatenate(edges), "edge [mm]")),
        Figure("Blocks that they are cut from", bars(blocks.prod(axis=1) * 1e-9, "volume [m³]")),
    ]
    angles = [float(j["angle_deg"]) for j in found.data.get("joints", ()) if "angle_deg" in j]
    for own in (panel.panel for panel in found.panels):
        kinks = zip(own.get("kinks_deg", ()), own["neighbours"], strict=False)
        angles += [float(kink) for kink, beyond in kinks if beyond is not None and beyond > own["id"]]
    if angles:
        figures.append(Figure("Angle between neighbours", bars(np.array(angles), "angle [deg]")))
    off = [float(panel.panel["off_surface_mm"]) for panel in found.panels if "off_surface_mm" in panel.panel]
    if off:
        figures.append(Figure("Off the surface", bars(np.array(off), "farthest of a panel [mm]")))
    if _backs_apart(found):
        apart = np.array([float(panel.panel["backs_apart_mm"]) for panel in found.panels])
        figures.append(Figure("Backs of neighbours apart", bars(apart, "at a corner of a panel [mm]")))
    return (Grid(tuple(figures), "three"),)


def _backs_apart(found: ElementRun) -> bool:
    """Whether backs of neighbours end apart at corners, as those of quads do."""
    return any(float(panel.panel.get("backs_apart_mm", 0.0)) > 0.0 for panel in found.panels)


def _blocks(found: ElementRun, drawing: str | None) -> tuple[Block, ...]:
    nest = found.data.get("blocks")
    if not nest:
        return (Paragraph("The element states no raw blocks (raw_blocks), so none are nested."),)
    rows = [
        (
            block["id"],
            _size(block["size_mm"]) + (f", {block['left_over']}" * bool(block["left_over"])),
            len(block["panels"]),
            " ".join(one["id"] for one in block["panels"]),
            len(block["cuts"]) + sum(one["level_cut"] for one in block["panels"]),
            round(100.0 * block["yield_volume"]),
            round(100.0 * block["yield_boxes"]),
        )
        for block in nest["blocks"]
    ]
    heads = (
        "block",
        "size mm",
        "panels",
        "in the order in which they come free",
        "cuts",
        "panels %",
        "boxes %",
    )
    shown: list[Block] = [Wide(table(heads, rows))]
    shown += _by_themselves(nest["blocks"])
    if found.saw:
        shown.append(Folded(_saw_words(found), Wide(_saw_list(found))))
    if drawing is not None:
        address = "data:image/svg+xml;base64," + base64.b64encode(drawing.encode()).decode()
        shown.append(Folded("How each block is cut", Photo(address, "cut drawings of all blocks")))
    return tuple(shown)


def _by_themselves(blocks: Sequence[Mapping[str, Any]]) -> Iterator[Block]:
    """Which panels are cut together, and why the others are not."""
    whole = sum(len(job.get("panels", ())) for block in blocks for job in block.get("jobs", ()))
    why: dict[str, list[str]] = {}
    for one in (panel for block in blocks for panel in block["panels"] if "alone" in panel):
        why.setdefault(str(one["alone"]), []).append(str(one["id"]))
    if not whole and not why:
        return
    rows = sum(bool(job.get("panels")) for block in blocks for job in block.get("jobs", ()))
    yield Paragraph(
        f"{whole} panels are cut together with others, in {rows} jobs: faces on one way, then the operator "
        "stands the block on edge, and the wire goes round each panel, the uppermost first."
    )
    if why:
        found = tuple((" ".join(names), reason) for reason, names in why.items())
        yield Wide(table(("cut by themselves", "why"), found))


def _saw_words(found: ElementRun) -> str:
    count = len(found.saw)
    if not found.planned:
        return f"{count} jobs that cut them"
    return f"{count} jobs that cut them, {sum(one.proven for one in found.saw)} of these proven"


def _saw_list(found: ElementRun) -> Table:
    """The jobs of raw blocks: what each cuts, and what became of it."""
    arms = tuple(found.saw_seconds())
    heads = ["job", "block", "what it cuts"]
    heads += ["state", *(f"{arm} min" for arm in arms), "why not"] if found.planned else ["to cut min"]
    rows = []
    for one in found.saw:
        row: list[Phrase] = [one.name, one.block, str(one.job["said"])]
        if found.planned:
            row += _became(one, arms)
        else:
            row.append(round(max(one.job["cut_min"].values(), default=0.0), 1) or None)
        rows.append(tuple(row))
    return table(tuple(heads), rows)


def _became(job: PanelRun | SawRun, arms: Sequence[str]) -> list[Phrase]:
    """State, minutes of each arm, and why it is not proven."""
    kind = {"proven": "ok", "refused": "bad", "open": "off"}[_state(job)]
    minutes = [round(job.seconds[a] / MINUTE, 2) if a in job.seconds else None for a in arms]
    why = "" if job.proven else Soft(f"{job.code} {job.message}".strip())
    return [Tag(kind, "proven" if job.proven else job.state), *minutes, why]


def _size(sides: Sequence[float]) -> str:
    """Sides [mm] in one line."""
    return "\u00a0x\u00a0".join(f"{float(v):g}" for v in sides)


def _list(found: ElementRun) -> Table:
    cut_from = {
        one["id"]: block["id"]
        for block in (found.data.get("blocks") or {}).get("blocks", ())
        for one in block["panels"]
    }
    arms = tuple(found.arm_seconds())
    wired = any("wire" in panel.panel for panel in found.panels)
    heads = ["panel", "size mm", "edges", "weight kg", "block mm", "raw block", "off surface mm"]
    apart = _backs_apart(found)
    heads += ["backs apart mm"] * apart + ["wire"] * wired
    heads += ["state", *(f"{arm} min" for arm in arms), "why not"] if found.planned else ["to cut min"]
    rows = []
    for panel in found.panels:
        own = panel.panel
        wide, tall = np.ptp(turned_up(own), axis=0).tolist()
        row: list[Phrase] = [
            panel.name,
            _size([round(wide), round(tall)]),
            len(own["outline_mm"]),
            round(float(own["weight_kg"]), 2) if own.get("weight_kg") else None,
            _size([own[f"block_{axis}_mm"] for axis in "xyz"]),
            cut_from.get(panel.name, ""),
            round(float(own["off_surface_mm"]), 2) if "off_surface_mm" in own else None,
        ]
        if apart:
            row.append(round(float(own["backs_apart_mm"]), 2))
        if wired:
            row.append(f"{own['wire']}, along {own['wire_along']}")
        if found.planned:
            row += _became(panel, arms)
        else:
            row.append(round(max(own.get("cut_min", {}).values(), default=0.0), 1) or None)
        rows.append(tuple(row))
    return table(tuple(heads), rows)
