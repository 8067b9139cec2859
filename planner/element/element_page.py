"""``element.html``: an element and its panels as one offline page, with what became of them where a batch of
them is known (`run_page.py` has those sections).

Drawings of all panels with ids, blocks and how they are cut, totals with an estimate of robot hours, sizes,
and what was said of the element. The page is made of the data in ``element.json`` alone, whatever the kind of
panels.
"""

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.assembly_page import assembly_section
from planner.element.element_drawings import (
    behind,
    drawing,
    flat,
    front_of,
    group_colour,
    row_of,
    state_of,
    turned_up,
)
from planner.element.run_page import bars, cut_section, hours, joints_section, run_tiles
from planner.element.run_report import MINUTE, ElementRun, PanelRun, SawRun
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
    seen = (Wide(drawing(found)), Paragraph(_key(found), "soft"), Folded("Seen from behind", behind(found)))
    sections = [Section("drawing", "Panels", seen)]
    if any("front_mm" in panel.panel for panel in found.panels):
        by = "groups" if data.get("grouped") else "rows"
        words = f"Fronts at one scale, by {by}; up is up in the element where they lean."
        laid = Folded(f"{count} panels, by {by}", Drawing(flat(found)))
        sections.append(Section("flat", "Panels laid flat", (Paragraph(words, "soft"), laid)))
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


_IN_LINE: Final = 4  # ids
_BASIS: Final = (
    "Hours to cut are the lengths of the cuts at the feeds of the jobs, for each arm that takes part. Ways "
    "in and out, loading and mounting come on top."
)


def _colours(found: ElementRun) -> Callable[[Mapping[str, Any]], str]:
    """The colours of panels that stand: by their states where a batch is known, else by groups, if any."""
    states = {panel.name: state_of(panel) for panel in found.panels}

    def fill(panel: Mapping[str, Any]) -> str:
        if found.planned:
            return {"proven": "--ok", "refused": "--bad", "open": "--c7"}[states[str(panel["id"])]]
        return group_colour(str(panel["id"])) if found.data.get("grouped") else "--c0"

    return fill


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
    return (table(("kind", "what", "code"), rows),)


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
    jobs = [one for one in (*own, *(saw.job for saw in found.saw)) if one.get("stops")]
    if metres := sum(float(one["cut_m"]) for one in jobs):
        yield "wire through foam", f"{metres:.0f} m"
    if jobs:
        stops = sum(int(one["stops"]) for one in jobs)
        said = f"{stops} in {len(jobs)} jobs: to bring foam, turn it or change tools"
        mounted = f"; {len(wires)} to put in a wire, where all panels of one wire follow one another"
        yield "stops of the operator", said + (mounted if wires else "")
    for arm, minutes in _estimate([one.job for one in found.saw]).items():
        words = f"about {minutes / 60.0:.1f} h in {len(found.saw)} jobs: an estimate"
        yield f"to cut raw blocks, arm {arm}", words


def _sizes(found: ElementRun) -> tuple[Grid, ...]:
    rings = [front_of(panel.panel) for panel in found.panels]
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
            _few([one["id"] for one in block["panels"]]),
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
    kind = {"proven": "ok", "refused": "bad", "open": "off"}[state_of(job)]
    minutes = [round(job.seconds[a] / MINUTE, 2) if a in job.seconds else None for a in arms]
    why = "" if job.proven else Soft(f"{job.code} {job.message}".strip())
    return [Tag(kind, "proven" if job.proven else job.state), *minutes, why]


def _few(names: Sequence[str]) -> str:
    """Ids in lines of four at least, however narrow the column."""
    return " ".join("\u00a0".join(names[k : k + _IN_LINE]) for k in range(0, len(names), _IN_LINE))


def _size(sides: Sequence[float]) -> str:
    return "\u00a0x\u00a0".join(f"{float(v):g}" for v in sides)


def _list(found: ElementRun) -> Table:
    cut_from = {
        one["id"]: block["id"]
        for block in (found.data.get("blocks") or {}).get("blocks", ())
        for one in block["panels"]
    }
    arms = tuple(found.arm_seconds())
    wired = any("wire" in panel.panel for panel in found.panels)
    grouped, timed = bool(found.data.get("grouped")), any(one.get("cut_min") for one in _panels(found))
    heads = ["panel", *["group"] * grouped, "size mm", "edges", "weight kg", "block mm", "raw block", "job"]
    heads += ["off surface mm"]
    apart = _backs_apart(found)
    heads += ["backs apart mm"] * apart + ["wire"] * wired
    heads += (
        ["state", *(f"{arm} min" for arm in arms), "why not"] if found.planned else ["to cut min"] * timed
    )
    rows = []
    for panel in found.panels:
        own = panel.panel
        wide, tall = np.ptp(turned_up(own), axis=0).tolist()
        row: list[Phrase] = [
            panel.name,
            *[row_of(panel.name)] * grouped,
            _size([round(wide), round(tall)]),
            len(own["outline_mm"]),
            round(float(own["weight_kg"]), 2) if own.get("weight_kg") else None,
            _size([own[f"block_{axis}_mm"] for axis in "xyz"]),
            cut_from.get(panel.name, ""),
            str(own.get("cut_in", own).get("job", "")),
            round(float(own["off_surface_mm"]), 2) if "off_surface_mm" in own else None,
        ]
        if apart:
            row.append(round(float(own["backs_apart_mm"]), 2))
        if wired:
            row.append(f"{own['wire']}, along {own['wire_along']}")
        if found.planned:
            row += _became(panel, arms)
        elif timed:
            row.append(round(max(own.get("cut_min", {}).values(), default=0.0), 1) or None)
        rows.append(tuple(row))
    return table(tuple(heads), rows)
