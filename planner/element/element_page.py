"""``element.html``: an element and its panels as one offline page, with results of a batch if there is one.

`run_page.py` has the sections of results. The page shows drawings of all panels with ids, blocks and their
cuts, totals with an estimate of robot hours, sizes, and the issues of the element. Its only input is
``element.json``, whatever the kind of panels.
"""

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.assembly_page import assembly_section
from planner.element.element_drawings import (
    draw_flat,
    draw_front,
    draw_rear,
    front_of,
    group_colour,
    id_letters,
    state_of,
    upright_front,
)
from planner.element.run_page import cut_section, histogram, hours_section, joints_section, run_tiles
from planner.element.run_report import MINUTE_S, ElementRun, PanelRun, SawRun
from planner.geometry.units import MM
from planner.report.markup import (
    Block,
    CodePhrase,
    Drawing,
    FactsBlock,
    FigureBlock,
    Folded,
    GridBlock,
    MutedPhrase,
    Page,
    PageSection,
    Paragraph,
    Photo,
    Phrase,
    StackedPhrases,
    TableBlock,
    TagPhrase,
    Tile,
    Wide,
    fixed_decimals,
    make_table,
    page_html,
)


def element_page(run: ElementRun, blocks: str | None = None) -> str:
    """Return the page as HTML; ``blocks`` is the text of the SVG with the cut drawings of raw blocks."""
    data = run.data
    name, count = str(data["name"]), len(run.panels)
    verdicts: list[tuple[str, str]] = []
    if run.planned:
        proven = sum(panel.proven for panel in run.panels)
        over = sum(joint.is_over_limit for joint in run.joints)
        verdicts.append(("ok" if proven == count else "bad", f"{proven} of {count} panels proven"))
        if run.measured:
            text = f"{over} of {len(run.measured)} measured joints over the limit"
            verdicts.append(("bad" if over else "ok", text))
    else:
        verdicts.append(("", f"{count} panels, none planned yet"))
    seen = (
        Wide(draw_front(run)),
        Paragraph(_legend(run), "soft"),
        Folded("Seen from behind", draw_rear(run)),
    )
    sections = [PageSection("drawing", "Panels", seen)]
    if any("front_mm" in panel.panel for panel in run.panels):
        grouping = "groups" if data.get("grouped") else "rows"
        text = f"Fronts at one scale, by {grouping}. Up is up in the element, for tilted panels."
        flat_drawing = Folded(f"{count} panels, by {grouping}", Drawing(draw_flat(run)))
        sections.append(PageSection("flat", "Panels laid flat", (Paragraph(text, "soft"), flat_drawing)))
    sections.append(PageSection("assembly", "Assembly", assembly_section(data, _colours(run))))
    sections.append(PageSection("told", "Issues", _issues_section(run)))
    sections.append(
        PageSection("totals", "Totals", (FactsBlock(tuple(_totals(run))), Paragraph(_BASIS, "soft")))
    )
    if run.planned:
        sections.append(PageSection("hours", "Robot hours", hours_section(run)))
        sections.append(PageSection("cut", "Deviation of cuts", cut_section(run)))
        sections.append(PageSection("joints", "Joints", joints_section(run)))
    sections.append(PageSection("sizes", "Sizes", _sizes_section(run)))
    sections.append(PageSection("blocks", "Raw blocks", _blocks_section(run, blocks)))
    sections.append(PageSection("panels", "List of panels", (Wide(_panel_table(run)),)))
    about = f"Element in {count} panels, " + (
        "as cut by its programs." if run.planned else "as divided, before planning."
    )
    tiles = (*_tiles(run), *(run_tiles(run) if run.planned else ()))
    return page_html(
        Page(f"{name} – element", name, tuple(verdicts), Paragraph(about, "soft"), tiles, tuple(sections))
    )


_IDS_PER_LINE: Final = 4
_BASIS: Final = (
    "Hours to cut are the cut lengths at the feeds of the jobs, for each arm. Approaches, "
    "retreats, loading and mounting are additional."
)


def _colours(run: ElementRun) -> Callable[[Mapping[str, Any]], str]:
    """Return a function from a panel of ``element.json`` to the CSS variable of its colour.

    Colours are states if there are results of a batch, else groups, if any.
    """
    states = {panel.name: state_of(panel) for panel in run.panels}

    def fill(panel: Mapping[str, Any]) -> str:
        if run.planned:
            return {"proven": "--ok", "refused": "--bad", "open": "--c7"}[states[str(panel["id"])]]
        return group_colour(str(panel["id"])) if run.data.get("grouped") else "--c0"

    return fill


def _legend(run: ElementRun) -> str:
    """Return what the marks and colours of the drawing mean, as far as they occur in it."""
    text = "Seen from the front."
    if run.data.get("grouped"):
        text += " Letters are groups" + ("." if run.planned else ", as are colours.")
    if any("wire_along" in panel.panel for panel in run.panels):
        text += " A thin line in a panel shows the direction of its wire."
    if any(panel.panel.get("concave") == "yes" for panel in run.panels):
        text += " Dashed: concave."
    if run.planned:
        text += (
            " Green: proven; red: refused or not proven; grey: not planned. Joints over the limit are drawn "
            "thick and red, measured ones dark."
        )
    return text


def _tiles(run: ElementRun) -> Iterator[Tile]:
    """Yield the tiles at the top of the page: raw blocks, and before planning the estimated cutting time."""
    data = run.data
    nest = data.get("blocks")
    if nest:
        yield Tile("raw blocks", str(len(nest["blocks"])))
        yield Tile("minimum by areas", str(nest["least"]))
        yield Tile("foam in panels", fixed_decimals(100.0 * nest["yield_volume"], 0), "%")
    if not run.planned:
        yield from (
            Tile(f"hours to cut, {arm}, estimate", fixed_decimals(minutes / 60.0, 1), "h")
            for arm, minutes in _cutting_minutes([*_panel_data(run), *(job.job for job in run.saw)]).items()
        )


def _panel_data(run: ElementRun) -> list[Mapping[str, Any]]:
    return [panel.panel for panel in run.panels]


def _cutting_minutes(jobs: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return the cutting time [min] of each arm, summed over panels or jobs of raw blocks."""
    out: dict[str, float] = {}
    for job in jobs:
        for arm, minutes in job.get("cut_min", {}).items():
            out[arm] = out.get(arm, 0.0) + float(minutes)
    return out


def _issues_section(run: ElementRun) -> tuple[Block, ...]:
    """Return the section with the issues of the division and of the planned element."""
    cut = run.issues() if run.planned else ()
    issues = [*run.data.get("issues", ()), *(issue.to_dict() for issue in cut)]
    if not issues:
        return (Paragraph("None: no panel is refused, and none exceeds its limits."),)
    kinds = {"warning": "warning", "note": "note"}
    rows = [
        (
            TagPhrase(kinds.get(item.get("severity", ""), "error"), item.get("severity", "error")),
            StackedPhrases((item["message"], MutedPhrase(item["hint"])))
            if item.get("hint")
            else item["message"],
            CodePhrase(item["code"]),
        )
        for item in issues
    ]
    return (make_table(("kind", "what", "code"), rows),)


def _totals(run: ElementRun) -> Iterator[tuple[Phrase, Phrase]]:
    """Yield the name and value of each total, as far as the data of the element state it."""
    data = run.data
    panels = _panel_data(run)
    volume = sum(float(panel.get("volume_l") or 0.0) for panel in panels)
    weights = [float(panel["weight_kg"]) for panel in panels if panel.get("weight_kg")]
    yield "panels", f"{len(panels)}, {1e-3 * volume:.2f} m³"
    if data.get("grouped"):
        groups: dict[str, list[Mapping[str, Any]]] = {}
        for panel in panels:
            groups.setdefault(id_letters(str(panel["id"])), []).append(panel)
        for letter, members in groups.items():
            weight = sum(float(panel["weight_kg"] or 0.0) for panel in members)
            yield f"group {letter}", f"{len(members)} panels" + (f", {weight:.1f} kg" if weight else "")
    if strips := data.get("strips"):
        widths, across = strips["widths_mm"], strips["across"]
        tried = (
            f"across {axis}: {counts['panels']} in {counts['strips']} strips"
            for axis, counts in strips["tried"].items()
        )
        size = f"{min(widths):.0f} to {max(widths):.0f} mm wide"
        yield "ruled strips", f"{len(widths)} across {across}, {size}; panels {', '.join(tried)}"
    if weights:
        yield "weight", f"{sum(weights):.1f} kg, the heaviest {max(weights):.2f} kg"
    if run.joints:
        yield "joints", f"{len(run.joints)}, {1e-3 * sum(joint.length for joint in run.joints) / MM:.1f} m"
    if dowels := data.get("dowels"):
        size = f"{dowels['diameter_mm']:g} x {2.0 * dowels['depth_mm']:g} mm"
        words = f"{len(dowels['dowels'])} of {size}; positions and directions in dowels.csv"
        without = len(dowels["without"])
        yield "dowels", words + (f"; {without} joints have none" if without else "")
    if nest := data.get("blocks"):
        sizes: dict[str, int] = {}
        for block in nest["blocks"]:
            size = " x ".join(f"{v:g}" for v in block["size_mm"])
            kind = f"{size}, offcut" if block["left_over"] else size
            sizes[kind] = sizes.get(kind, 0) + 1
        yield "raw blocks", "; ".join(f"{count} of {size} mm" for size, count in sizes.items())
        proof_texts = {"bound": "the minimum", "two-stage": "the minimum for strips"}
        proof_text = proof_texts.get(nest["least_because"] or "", "")
        yield "minimum by areas of boxes", f"{nest['least']}" + (f"; {proof_text}" if proof_text else "")
        percentages = 100.0 * nest["yield_volume"], 100.0 * nest["yield_boxes"]
        yield "foam", f"{percentages[0]:.0f} % are panels, {percentages[1]:.0f} % their blocks"
    wires: dict[str, int] = {}
    for panel in panels:
        if "wire" in panel:
            wires[str(panel["wire"])] = wires.get(str(panel["wire"]), 0) + 1
    for wire, count in wires.items():
        yield f"wire {wire}", f"for {count} panels"
    for arm, minutes in _cutting_minutes(panels).items():
        mean_minutes = minutes / len(panels)
        yield (
            f"to cut, arm {arm}",
            f"about {minutes / 60.0:.1f} h, {mean_minutes:.1f} min a panel: an estimate",
        )
    jobs = [panel for panel in (*panels, *(saw.job for saw in run.saw)) if panel.get("stops")]
    if metres := sum(float(panel["cut_m"]) for panel in jobs):
        yield "wire through foam", f"{metres:.0f} m"
    if jobs:
        stops = sum(int(panel["stops"]) for panel in jobs)
        text = f"{stops} in {len(jobs)} jobs: to bring foam, turn it or change tools"
        mounting_text = f"; {len(wires)} to mount a wire, if all panels of one wire follow one another"
        yield "stops of the operator", text + (mounting_text if wires else "")
    for arm, minutes in _cutting_minutes([panel.job for panel in run.saw]).items():
        words = f"about {minutes / 60.0:.1f} h in {len(run.saw)} jobs: an estimate"
        yield f"to cut raw blocks, arm {arm}", words


def _sizes_section(run: ElementRun) -> tuple[GridBlock, ...]:
    """Return histograms of areas, edges, blocks, angles and deviations of all panels."""
    rings = [front_of(panel.panel) for panel in run.panels]
    areas, edges = [], []
    for ring in rings:
        following = np.roll(ring, -1, axis=0)
        # shoelace formula
        areas.append(0.5 * abs(float((ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0]).sum())))
        edges.append(np.linalg.norm(following - ring, axis=1))
    blocks = np.array([[float(panel.panel[f"block_{axis}_mm"]) for axis in "xyz"] for panel in run.panels])
    figures = [
        FigureBlock("Panels, in front", histogram(np.array(areas) * 1e-6, "area [m²]")),
        FigureBlock("Their edges", histogram(np.concatenate(edges), "edge [mm]")),
        FigureBlock("Their blocks", histogram(blocks.prod(axis=1) * 1e-9, "volume [m³]")),
    ]
    angles = [float(joint["angle_deg"]) for joint in run.data.get("joints", ()) if "angle_deg" in joint]
    for panel_data in (panel.panel for panel in run.panels):
        kinks = zip(panel_data.get("kinks_deg", ()), panel_data["neighbours"], strict=False)
        angles += [float(kink) for kink, beyond in kinks if beyond is not None and beyond > panel_data["id"]]
    if angles:
        figures.append(FigureBlock("Angle between neighbours", histogram(np.array(angles), "angle [deg]")))
    deviations = [
        float(panel.panel["off_surface_mm"]) for panel in run.panels if "off_surface_mm" in panel.panel
    ]
    if deviations:
        figures.append(
            FigureBlock(
                "Deviation from the surface", histogram(np.array(deviations), "maximum of a panel [mm]")
            )
        )
    if _has_back_gaps(run):
        gaps = np.array([float(panel.panel["backs_apart_mm"]) for panel in run.panels])
        figures.append(FigureBlock("Gaps between backs", histogram(gaps, "at a corner of a panel [mm]")))
    return (GridBlock(tuple(figures), "three"),)


def _has_back_gaps(run: ElementRun) -> bool:
    """Whether any panel has a gap to the backs of its neighbours at a corner, as quads do."""
    return any(float(panel.panel.get("backs_apart_mm", 0.0)) > 0.0 for panel in run.panels)


def _blocks_section(run: ElementRun, drawing: str | None) -> tuple[Block, ...]:
    """Return the section on raw blocks: table, panels that are cut alone, jobs, and ``drawing`` (an SVG)."""
    nest = run.data.get("blocks")
    if not nest:
        return (Paragraph("The element states no raw blocks (raw_blocks), so nothing is nested."),)
    rows = [
        (
            block["id"],
            _size(block["size_mm"]) + (f", {block['left_over']}" if block["left_over"] else ""),
            len(block["panels"]),
            _wrap_ids([panel["id"] for panel in block["panels"]]),
            len(block["cuts"]) + sum(panel["level_cut"] for panel in block["panels"]),
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
    shown: list[Block] = [Wide(make_table(heads, rows))]
    shown += _cut_alone(nest["blocks"])
    if run.saw:
        shown.append(Folded(_saw_summary(run), Wide(_saw_table(run))))
    if drawing is not None:
        address = "data:image/svg+xml;base64," + base64.b64encode(drawing.encode()).decode()
        shown.append(Folded("How each block is cut", Photo(address, "cut drawings of all blocks")))
    return tuple(shown)


def _cut_alone(blocks: Sequence[Mapping[str, Any]]) -> Iterator[Block]:
    """Yield how many panels are cut together with others, and a table of those cut alone with the reasons.

    ``blocks`` are those of ``element.json``. Nothing is yielded if it states neither.
    """
    count = sum(len(job.get("panels", ())) for block in blocks for job in block.get("jobs", ()))
    names_by_reason: dict[str, list[str]] = {}
    for panel_data in (panel for block in blocks for panel in block["panels"] if "alone" in panel):
        names_by_reason.setdefault(str(panel_data["alone"]), []).append(str(panel_data["id"]))
    if not count and not names_by_reason:
        return
    jobs = sum(bool(job.get("panels")) for block in blocks for job in block.get("jobs", ()))
    yield Paragraph(
        f"{count} panels are cut together with others, in {jobs} jobs: faces in one pass, then the operator "
        "puts the block on edge, and the wire goes around each panel, the uppermost first."
    )
    if names_by_reason:
        rows_by_reason = tuple((" ".join(names), reason) for reason, names in names_by_reason.items())
        yield Wide(make_table(("cut alone", "why"), rows_by_reason))


def _saw_summary(run: ElementRun) -> str:
    count = len(run.saw)
    if not run.planned:
        return f"{count} jobs that cut them"
    return f"{count} jobs that cut them, {sum(job.proven for job in run.saw)} of these proven"


def _saw_table(run: ElementRun) -> TableBlock:
    """Return the table of the jobs of raw blocks: what each cuts, and its results."""
    arms = tuple(run.saw_seconds())
    heads = ["job", "block", "what it cuts"]
    heads += ["state", *(f"{arm} min" for arm in arms), "why not"] if run.planned else ["to cut min"]
    rows = []
    for job in run.saw:
        row: list[Phrase] = [job.name, job.block, str(job.job["said"])]
        if run.planned:
            row += _result_cells(job, arms)
        else:
            row.append(round(max(job.job["cut_min"].values(), default=0.0), 1) or None)
        rows.append(tuple(row))
    return make_table(tuple(heads), rows)


def _result_cells(job: PanelRun | SawRun, arms: Sequence[str]) -> list[Phrase]:
    """Return the cells of a job's row: its state, minutes of each arm, and why it is not proven."""
    kind = {"proven": "ok", "refused": "bad", "open": "off"}[state_of(job)]
    minutes = [round(job.seconds[arm] / MINUTE_S, 2) if arm in job.seconds else None for arm in arms]
    reason = "" if job.proven else MutedPhrase(f"{job.code} {job.message}".strip())
    return [TagPhrase(kind, "proven" if job.proven else job.state), *minutes, reason]


def _wrap_ids(names: Sequence[str]) -> str:
    """Join ids so that the browser breaks lines only after every `_IDS_PER_LINE` ids."""
    return " ".join("\u00a0".join(names[k : k + _IDS_PER_LINE]) for k in range(0, len(names), _IDS_PER_LINE))


def _size(sides: Sequence[float]) -> str:
    return "\u00a0x\u00a0".join(f"{float(v):g}" for v in sides)


def _panel_table(run: ElementRun) -> TableBlock:
    """Return the table of all panels. Columns that the kind of panels does not state are left out."""
    cut_from = {
        item["id"]: block["id"]
        for block in (run.data.get("blocks") or {}).get("blocks", ())
        for item in block["panels"]
    }
    arms = tuple(run.arm_seconds())
    has_wires = any("wire" in panel.panel for panel in run.panels)
    grouped = bool(run.data.get("grouped"))
    timed = any(item.get("cut_min") for item in _panel_data(run))
    heads = ["panel", *["group"] * grouped, "size mm", "edges", "weight kg", "block mm", "raw block", "job"]
    heads += ["deviation mm"]
    has_back_gaps = _has_back_gaps(run)
    heads += ["gap of backs mm"] * has_back_gaps + ["wire"] * has_wires
    heads += ["state", *(f"{arm} min" for arm in arms), "why not"] if run.planned else ["to cut min"] * timed
    rows = []
    for panel in run.panels:
        panel_data = panel.panel
        width, height = np.ptp(upright_front(panel_data), axis=0).tolist()
        row: list[Phrase] = [
            panel.name,
            *[id_letters(panel.name)] * grouped,
            _size([round(width), round(height)]),
            len(panel_data["outline_mm"]),
            round(float(panel_data["weight_kg"]), 2) if panel_data.get("weight_kg") else None,
            _size([panel_data[f"block_{axis}_mm"] for axis in "xyz"]),
            cut_from.get(panel.name, ""),
            str(panel_data.get("cut_in", panel_data).get("job", "")),
            round(float(panel_data["off_surface_mm"]), 2) if "off_surface_mm" in panel_data else None,
        ]
        if has_back_gaps:
            row.append(round(float(panel_data["backs_apart_mm"]), 2))
        if has_wires:
            row.append(f"{panel_data['wire']}, along {panel_data['wire_along']}")
        if run.planned:
            row += _result_cells(panel, arms)
        elif timed:
            row.append(round(max(panel_data.get("cut_min", {}).values(), default=0.0), 1) or None)
        rows.append(tuple(row))
    return make_table(tuple(heads), rows)
