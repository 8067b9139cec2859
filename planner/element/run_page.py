"""Sections of an element's page with the results of a batch: robot hours, deviations of cuts, and joints.

`element_page.py` assembles the page.
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
"""Duration of an hour [s]."""
_BINS: Final = 24  # of a histogram
_MAX_NAMED_PANELS: Final = 8  # rows of the table of the panels that deviate most
_SHOWN_JOINTS: Final = 12  # joints that are not folded; more if more are over the limit


def run_tiles(run: ElementRun) -> tuple[Tile, ...]:
    """Return the tiles with the key values of a batch."""
    proven = sum(panel.proven for panel in run.panels)
    over_limit_count = sum(joint.is_over_limit for joint in run.joints)
    tiles = [Tile("panels proven", f"{proven} / {len(run.panels)}", bad=proven < len(run.panels))]
    if run.saw:
        proven_saw = sum(job.proven for job in run.saw)
        tiles.append(
            Tile("jobs of raw blocks proven", f"{proven_saw} / {len(run.saw)}", bad=proven_saw < len(run.saw))
        )
    for arm, seconds in run.all_seconds().items():
        tiles.append(Tile(f"robot hours, {arm}", fixed_decimals(seconds / HOUR_S, 2), "h"))
    if run.measured:
        steps = _all_steps(run)
        largest = max(joint.largest for joint in run.measured)
        tiles.append(Tile("joints measured", f"{len(run.measured)} / {len(run.joints)}"))
        tiles.append(
            Tile("step and gap, 95 % of all points", fixed_decimals(np.percentile(steps, 95.0), 2), "mm")
        )
        tiles.append(Tile("step and gap, worst", fixed_decimals(largest / MM, 2), "mm", largest > MAX_STEP_M))
        tiles.append(Tile("joints over the limit", str(over_limit_count), bad=over_limit_count > 0))
    return tuple(tiles)


def _all_steps(run: ElementRun) -> FloatArray:
    """Return the steps and gaps [mm] at all measured points of all joints, in one array."""
    cuts = [joint.cut for joint in run.measured if joint.cut is not None]
    return np.concatenate([v for cut in cuts for v in (cut.steps, cut.gaps)] or [np.zeros(0)]) / MM


def hours_section(run: ElementRun) -> tuple[FactsBlock | Paragraph, ...]:
    """Return the section on robot hours, with an estimate for all panels if only some are proven."""
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
    proven_jobs = sum(job.proven for job in run.saw)
    for arm, seconds in run.saw_seconds().items():
        text = f"{seconds / HOUR_S:.2f} h of motion for {proven_jobs} of {len(run.saw)} jobs of raw blocks"
        items.append((f"arm {arm}, raw blocks", text))
    note = "Only motion of the programs: loading, mounting and heating of wires are additional."
    return FactsBlock(tuple(items)), Paragraph(note, "soft")


def cut_section(run: ElementRun) -> tuple[GridBlock | Paragraph, ...]:
    """Return the section on deviations of the cut faces from the faces as written."""
    cut_panels = [panel for panel in run.panels if panel.faces]
    if not cut_panels:
        return (Paragraph("No panel is proven, so nothing is cut."),)
    tolerance = float(run.data.get("tolerance_mm", 1.0)) * MM
    if any(panel.sides for panel in cut_panels):
        return _sides_section(run)
    blocks: list[FigureBlock] = []
    for number, side in enumerate(("Fronts", "Backs")):
        faces = [panel.faces[number] for panel in cut_panels if len(panel.faces) > number]
        if not faces:
            continue
        points = np.concatenate([face.nominal for face in faces])
        deviations = np.concatenate([face.deviation for face in faces])
        deviation_map = charts.deviation_map(
            points, deviations, tolerance, f"{side}: off the panels as written", WIRE_FACE
        )
        blocks.append(dataclasses.replace(deviation_map, note="in the frame of the element; mm"))
        blocks.append(FigureBlock(f"{side}: fraction of vertices", charts.histogram(deviations, tolerance)))
    note = "Simulated by the proof from the programs, relative to the faces as written, which deviate from "
    note += f"the surface by up to {_worst_written(run):.2f} mm themselves. Without foam effects."
    return GridBlock(tuple(blocks), "two"), Paragraph(note, "soft")


def _sides_section(run: ElementRun) -> tuple[GridBlock | Paragraph, ...]:
    """Return the section for planar panels, of which only the sides are measured."""
    deviations = np.concatenate([side.deviation for panel in run.panels for side in panel.sides])
    by_deviation = sorted(
        (
            (float(np.abs(np.concatenate([side.deviation for side in panel.sides])).max()), panel.name)
            for panel in run.panels
            if panel.sides
        ),
        reverse=True,
    )
    rows = [(name, round(max_deviation / MM, 3)) for max_deviation, name in by_deviation[:_MAX_NAMED_PANELS]]
    spread = FigureBlock("Sides: fraction of vertices", charts.histogram(deviations, MAX_STEP_95_M))
    note = "Simulated by the proof from the programs, relative to the sides as written; the band is "
    note += f"the limit of joints, {MAX_STEP_95_M / MM:g} mm. Without foam effects."
    return GridBlock(
        (spread, make_table(("panel, the worst first", "maximum deviation mm"), rows)), "two"
    ), Paragraph(note, "soft")


def _worst_written(run: ElementRun) -> float:
    """Return the largest deviation [mm] of a written panel from the surface of the element."""
    return max(float(panel.panel["off_surface_mm"]) for panel in run.panels)


def joints_section(run: ElementRun) -> tuple[Paragraph | GridBlock | Folded, ...]:
    """Return the section on steps and gaps of the measured joints, those over the limit first."""
    if not run.measured:
        return (Paragraph("No two neighbours are proven, so no joint is measured."),)
    limit = run.joints[0].limit / MM
    text = f"Step across the surface and gap in the joint of the simulated parts; allowed: {limit:g} mm "
    text += f"at 95 % of a joint's points and {MAX_STEP_M / MM:g} mm at each. {len(run.measured)} of "
    text += f"{len(run.joints)} joints have both panels proven."
    if not any(panel.sides for panel in run.panels):
        text += " Sides that another operation cuts are not included."
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
    folded = (
        (Folded(f"{len(rows) - shown} more joints", make_table(heads, rows[shown:])),) if rows[shown:] else ()
    )
    return Paragraph(text), GridBlock((make_table(heads, rows[:shown]), spread), "two"), *folded


def histogram(values: FloatArray, label: str) -> Drawing | Paragraph:
    """Return a histogram of values in `_BINS` bins; equal values get a range of their own."""
    low, high = float(values.min()), float(values.max())
    is_constant = high - low < 1e-6 * max(abs(high), 1e-12)
    counts, edges = np.histogram(
        values, bins=_BINS, range=charts.padded_range(low, high) if is_constant else (low, high)
    )
    x, y = np.repeat(edges, 2)[1:-1], np.repeat(counts.astype(np.float64), 2)
    line = charts.ChartLine("count", x, y)
    top = float(counts.max()) * 1.08 + 0.1
    return charts.chart([line], charts.ChartAxes(label, "count", (0.0, top)))
