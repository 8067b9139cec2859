"""Sections of an element's page with the results of a batch: robot hours, deviations of cuts, and joints.

`element_page.py` has the page.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.element.run_report import MAX_STEP_95_M, MAX_STEP_M, ElementRun
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.hotwire.report import WIRE_FACE
from planner.report import charts
from planner.report.markup import (
    Drawing,
    FactsBlock,
    FigureBlock,
    Folded,
    GridBlock,
    Paragraph,
    Phrase,
    TagPhrase,
    Tile,
    fixed_decimals,
    make_table,
)

HOUR_S: Final = 3600.0
"""[s]"""
_BINS: Final = 24
_MAX_NAMED_PANELS: Final = 8  # panels in a table of the worst
_SHOWN_JOINTS: Final = 12  # shown unfolded, the worst first, plus all over the limit


def run_tiles(run: ElementRun) -> tuple[Tile, ...]:
    """Return the key figures of a batch."""
    proven = sum(panel.proven for panel in run.panels)
    over = sum(joint.is_over_limit for joint in run.joints)
    tiles = [Tile("panels proven", f"{proven} / {len(run.panels)}", bad=proven < len(run.panels))]
    if run.saw:
        cut = sum(job.proven for job in run.saw)
        tiles.append(Tile("jobs of raw blocks proven", f"{cut} / {len(run.saw)}", bad=cut < len(run.saw)))
    for arm, seconds in run.all_seconds().items():
        tiles.append(Tile(f"robot hours, {arm}", fixed_decimals(seconds / HOUR_S, 2), "h"))
    if run.measured:
        steps = _all_steps(run)
        worst = max(joint.largest for joint in run.measured)
        tiles.append(Tile("joints measured", f"{len(run.measured)} / {len(run.joints)}"))
        tiles.append(
            Tile("step and gap, 95 % of all points", fixed_decimals(np.percentile(steps, 95.0), 2), "mm")
        )
        tiles.append(Tile("step and gap, worst", fixed_decimals(worst / MM, 2), "mm", worst > MAX_STEP_M))
        tiles.append(Tile("joints over the limit", str(over), bad=over > 0))
    return tuple(tiles)


def _all_steps(run: ElementRun) -> FloatArray:
    """Return steps and gaps [mm] of all measured points."""
    cuts = [joint.cut for joint in run.measured if joint.cut is not None]
    return np.concatenate([v for cut in cuts for v in (cut.steps, cut.gaps)] or [np.zeros(0)]) / MM


def hours_section(run: ElementRun) -> tuple[FactsBlock | Paragraph, ...]:
    """Return the robot hours for all panels, to know before foam is ordered."""
    own_panels = [panel for panel in run.panels if panel.own_job]
    proven = sum(panel.proven for panel in own_panels)
    if not run.all_seconds():
        return (Paragraph("No panel is proven, so there are no robot hours."),)
    items: list[tuple[Phrase, Phrase]] = []
    for arm, seconds in run.arm_seconds().items():
        text = f"{seconds / HOUR_S:.2f} h of motion for {proven} proven panels"
        if proven < len(own_panels):
            total_hours = seconds * len(own_panels) / proven / HOUR_S
            text += f"; about {total_hours:.1f} h for all {len(own_panels)} if the others take as long"
        items.append((f"arm {arm}", text))
    cut = sum(job.proven for job in run.saw)
    for arm, seconds in run.saw_seconds().items():
        text = f"{seconds / HOUR_S:.2f} h of motion for {cut} of {len(run.saw)} jobs of raw blocks"
        items.append((f"arm {arm}, raw blocks", text))
    note = "Only motion of the programs: loading, mounting and heating of wires are additional."
    return FactsBlock(tuple(items)), Paragraph(note, "soft")


def cut_section(run: ElementRun) -> tuple[GridBlock | Paragraph, ...]:
    """Return the deviations of cuts from the panels as written."""
    cut = [panel for panel in run.panels if panel.faces]
    if not cut:
        return (Paragraph("No panel is proven, so nothing is cut."),)
    tolerance = float(run.data.get("tolerance_mm", 1.0)) * MM
    if any(panel.sides for panel in cut):
        return _sides_section(run)
    blocks: list[FigureBlock] = []
    for number, side in enumerate(("Fronts", "Backs")):
        faces = [panel.faces[number] for panel in cut if len(panel.faces) > number]
        if not faces:
            continue
        points = np.concatenate([face.nominal for face in faces])
        deviations = np.concatenate([face.deviation for face in faces])
        seen = charts.deviation_map(
            points, deviations, tolerance, f"{side}: off the panels as written", WIRE_FACE
        )
        blocks.append(dataclasses.replace(seen, note="in the frame of the element; mm"))
        blocks.append(FigureBlock(f"{side}: fraction of vertices", charts.histogram(deviations, tolerance)))
    note = "Simulated by the proof from the programs, relative to the faces as written, which deviate from "
    note += f"the surface by up to {_worst_written(run):.2f} mm themselves. Without foam effects."
    return GridBlock(tuple(blocks), "two"), Paragraph(note, "soft")


def _sides_section(run: ElementRun) -> tuple[GridBlock | Paragraph, ...]:
    """Return the deviations of planar panels, whose faces are those of their blocks."""
    deviations = np.concatenate([side.deviation for panel in run.panels for side in panel.sides])
    worst = sorted(
        (
            (float(np.abs(np.concatenate([s.deviation for s in p.sides])).max()), p.name)
            for p in run.panels
            if p.sides
        ),
        reverse=True,
    )
    rows = [(name, round(max_deviation / MM, 3)) for max_deviation, name in worst[:_MAX_NAMED_PANELS]]
    spread = FigureBlock("Sides: fraction of vertices", charts.histogram(deviations, MAX_STEP_95_M))
    note = "Simulated by the proof from the programs, relative to the sides as written; the band is "
    note += f"the limit of joints, {MAX_STEP_95_M / MM:g} mm. Without foam effects."
    return GridBlock(
        (spread, make_table(("panel, the worst first", "maximum deviation mm"), rows)), "two"
    ), Paragraph(note, "soft")


def _worst_written(run: ElementRun) -> float:
    return max(float(panel.panel["off_surface_mm"]) for panel in run.panels)


def joints_section(run: ElementRun) -> tuple[Paragraph | GridBlock | Folded, ...]:
    """Return steps and gaps of the measured joints."""
    if not run.measured:
        return (Paragraph("No two neighbours are proven, so no joint is measured."),)
    limit = run.joints[0].limit / MM
    words = f"Step across the surface and gap in the joint of the simulated parts; allowed: {limit:g} mm "
    words += f"at 95 % of a joint's points and {MAX_STEP_M / MM:g} mm at each. {len(run.measured)} of "
    words += f"{len(run.joints)} joints have both panels proven."
    if not any(panel.sides for panel in run.panels):
        words += " Sides that another operation cuts are not included."
    rows = [
        (
            f"{joint.panels[0]} – {joint.panels[1]}",
            round(joint.length / MM, 1),
            round(joint.at_95 / MM, 3),
            round(joint.largest / MM, 3),
            TagPhrase("bad", "over") if joint.is_over_limit else TagPhrase("ok", "within"),
        )
        for joint in sorted(run.measured, key=lambda joint: (not joint.is_over_limit, -joint.at_95))
    ]
    heads = ("joint", "length mm", "at 95 % mm", "largest mm", "limit")
    spread = FigureBlock("Points of all joints", histogram(_all_steps(run), "step or gap [mm]"))
    shown = max(_SHOWN_JOINTS, sum(joint.is_over_limit for joint in run.measured))
    more = (
        (Folded(f"{len(rows) - shown} more joints", make_table(heads, rows[shown:])),) if rows[shown:] else ()
    )
    return Paragraph(words), GridBlock((make_table(heads, rows[:shown]), spread), "two"), *more


def histogram(values: FloatArray, label: str) -> Drawing | Paragraph:
    """Return a histogram."""
    low, high = float(values.min()), float(values.max())
    alike = high - low < 1e-6 * max(abs(high), 1e-12)
    counts, edges = np.histogram(
        values, bins=_BINS, range=charts.padded_range(low, high) if alike else (low, high)
    )
    x, y = np.repeat(edges, 2)[1:-1], np.repeat(counts.astype(np.float64), 2)
    line = charts.ChartLine("count", x, y)
    top = float(counts.max()) * 1.08 + 0.1
    return charts.chart([line], charts.ChartAxes(label, "count", (0.0, top)))
