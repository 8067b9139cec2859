"""Sections of an element's page that tell what became of it in a batch: robot hours, how far what is cut is
off, and the joints. `element_page.py` has the page."""

import dataclasses
from typing import Final

import numpy as np

from planner.element.run_report import MOST, MOST_AT_95, ElementRun
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.hotwire.report import WIRE_FACE
from planner.report import charts
from planner.report.markup import (
    Drawing,
    Facts,
    Figure,
    Folded,
    Grid,
    Paragraph,
    Phrase,
    Tag,
    Tile,
    fixed,
    table,
)

HOUR: Final = 3600.0
"""[s]"""
_BINS: Final = 24
_MOST_NAMED: Final = 8  # panels in a table of the worst
_FIRST_JOINTS: Final = 12  # that are seen at once, the worst first, and all that are over the limit


def run_tiles(found: ElementRun) -> tuple[Tile, ...]:
    """The figures that matter of a batch."""
    proven = sum(panel.proven for panel in found.panels)
    over = sum(joint.over for joint in found.joints)
    tiles = [Tile("panels proven", f"{proven} / {len(found.panels)}", bad=proven < len(found.panels))]
    if found.saw:
        cut = sum(one.proven for one in found.saw)
        tiles.append(Tile("jobs of raw blocks proven", f"{cut} / {len(found.saw)}", bad=cut < len(found.saw)))
    for arm, seconds in found.all_seconds().items():
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
    """Steps and gaps [mm] of all points that are measured."""
    cuts = [joint.cut for joint in found.measured if joint.cut is not None]
    return np.concatenate([v for cut in cuts for v in (cut.steps, cut.gaps)] or [np.zeros(0)]) / MM


def hours(found: ElementRun) -> tuple[Facts | Paragraph, ...]:
    """Before foam is ordered: what the robots are busy with all panels."""
    own = [panel for panel in found.panels if panel.own_job]
    proven = sum(panel.proven for panel in own)
    if not found.all_seconds():
        return (Paragraph("No panel is proven, so there are no robot hours to tell."),)
    items: list[tuple[Phrase, Phrase]] = []
    for arm, seconds in found.arm_seconds().items():
        said = f"{seconds / HOUR:.2f} h of motion for {proven} proven panels"
        if proven < len(own):
            share = seconds * len(own) / proven / HOUR
            said += f"; about {share:.1f} h for all {len(own)} if the others take as long"
        items.append((f"arm {arm}", said))
    cut = sum(one.proven for one in found.saw)
    for arm, seconds in found.saw_seconds().items():
        said = f"{seconds / HOUR:.2f} h of motion for {cut} of {len(found.saw)} jobs of raw blocks"
        items.append((f"arm {arm}, raw blocks", said))
    note = "Motion of the programs alone: loading, mounting and heating of wires come on top."
    return Facts(tuple(items)), Paragraph(note, "soft")


def cut_section(found: ElementRun) -> tuple[Grid | Paragraph, ...]:
    """How far what is cut is off the panels as written."""
    cut = [panel for panel in found.panels if panel.faces]
    if not cut:
        return (Paragraph("No panel is proven, so nothing is cut."),)
    tolerance = float(found.data.get("tolerance_mm", 1.0)) * MM
    if any(panel.sides for panel in cut):
        return _sides(found)
    blocks: list[Figure] = []
    for number, side in enumerate(("Fronts", "Backs")):
        faces = [panel.faces[number] for panel in cut if len(panel.faces) > number]
        if not faces:
            continue
        points = np.concatenate([face.place for face in faces])
        off = np.concatenate([face.deviation for face in faces])
        seen = charts.deviation_map(points, off, tolerance, f"{side}: off the panels as written", WIRE_FACE)
        blocks.append(dataclasses.replace(seen, note="in the frame of the element; mm"))
        blocks.append(Figure(f"{side}: share of vertices", charts.histogram(off, tolerance)))
    note = "Simulated by the proof from the programs, against the faces as they were written, which are off "
    note += f"the surface by up to {_worst_written(found):.2f} mm themselves. Before foam effects."
    return Grid(tuple(blocks), "two"), Paragraph(note, "soft")


def _sides(found: ElementRun) -> tuple[Grid | Paragraph, ...]:
    """The same of planar panels, whose faces are those of their blocks."""
    off = np.concatenate([side.deviation for panel in found.panels for side in panel.sides])
    worst = sorted(
        (
            (float(np.abs(np.concatenate([s.deviation for s in p.sides])).max()), p.name)
            for p in found.panels
            if p.sides
        ),
        reverse=True,
    )
    rows = [(name, round(far / MM, 3)) for far, name in worst[:_MOST_NAMED]]
    spread = Figure("Sides: share of vertices", charts.histogram(off, MOST_AT_95))
    note = "Simulated by the proof from the programs, against the sides as they were written; the band is "
    note += f"what joints may have, {MOST_AT_95 / MM:g} mm. Before foam effects."
    return Grid((spread, table(("panel, the worst first", "farthest off mm"), rows)), "two"), Paragraph(
        note, "soft"
    )


def _worst_written(found: ElementRun) -> float:
    return max(float(panel.panel["off_surface_mm"]) for panel in found.panels)


def joints_section(found: ElementRun) -> tuple[Paragraph | Grid | Folded, ...]:
    """Steps and gaps of the joints that are measured."""
    if not found.measured:
        return (Paragraph("No two neighbours are proven, so no joint is measured."),)
    limit = found.joints[0].limit / MM
    words = f"Step across the surface and gap in the joint of the simulated parts; allowed are {limit:g} mm "
    words += f"at 95 % of a joint's points and {MOST / MM:g} mm at each. {len(found.measured)} of "
    words += f"{len(found.joints)} joints have both panels proven."
    if not any(panel.sides for panel in found.panels):
        words += " Sides are not in it where another operation cuts them."
    rows = [
        (
            f"{joint.panels[0]} – {joint.panels[1]}",
            round(joint.length / MM, 1),
            round(joint.at_95 / MM, 3),
            round(joint.largest / MM, 3),
            Tag("bad", "over") if joint.over else Tag("ok", "within"),
        )
        for joint in sorted(found.measured, key=lambda joint: (not joint.over, -joint.at_95))
    ]
    heads = ("joint", "length mm", "at 95 % mm", "largest mm", "limit")
    spread = Figure("Points of all joints", bars(_all_steps(found), "step or gap [mm]"))
    shown = max(_FIRST_JOINTS, sum(joint.over for joint in found.measured))
    more = (Folded(f"{len(rows) - shown} more joints", table(heads, rows[shown:])),) if rows[shown:] else ()
    return Paragraph(words), Grid((table(heads, rows[:shown]), spread), "two"), *more


def bars(values: FloatArray, label: str) -> Drawing | Paragraph:
    """How many values lie where, as a chart."""
    low, high = float(values.min()), float(values.max())
    alike = high - low < 1e-6 * max(abs(high), 1e-12)
    counts, edges = np.histogram(values, bins=_BINS, range=charts.padded(low, high) if alike else (low, high))
    x, y = np.repeat(edges, 2)[1:-1], np.repeat(counts.astype(np.float64), 2)
    line = charts.Line("count", x, y)
    top = float(counts.max()) * 1.08 + 0.1
    return charts.chart([line], x_label=label, y_label="count", y_range=(0.0, top))
