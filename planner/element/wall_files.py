"""Output of a ruled wall or of a surface in ruled strips: problems, table and drawing of panels, and data."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from planner.element import jobs
from planner.element.assembly import FREE_INTERFERENCE_M
from planner.element.block_nesting import PanelBlock
from planner.element.dowels import max_dowel_tilt
from planner.element.element_file import Element, StripsElement, WallElement
from planner.element.output import complete_output, rectangle_outline, table, weight_kg
from planner.element.panel_drawing import DrawnPanel, draw_panels
from planner.element.rows import PanelShape
from planner.element.strips import StripDivision
from planner.element.wall_assembly import PanelLayout, wall_assembly
from planner.element.wall_panels import SIDES, WallPanel, face_rulings, panel_ids
from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import DEG, MM
from planner.issues import Issue

FRONT_VIEW_ROTATION: Final = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Rotation of wall parameters (u, t) to the front view: rulings from right to left, u up."""
JOINT_POINTS: Final = 13
"""Number of points of each line of a joint in ``element.json``."""
JOINT_DIGITS: Final = 6
"""Decimals in mm of these points."""
DARKEST_DEVIATION_MM: Final = 1.0
"""Deviation [mm] of a back that is drawn darkest."""


@dataclasses.dataclass(frozen=True)
class PanelOutput:
    """Properties of a panel that depend on its kind.

    Attributes:
        ring: Corners [mm], with those of neighbours, in the flat layout seen from the front.
        beyond: Panel beyond each edge.
        outline: Outline (C, 2) [mm] for the drawing.
        across: Range of the surface across, as fractions.
        fraction: Deviation as a fraction of what is allowed.
        row: Columns of the table.
        data: Further data.
    """

    ring: Sequence[tuple[float, float]]
    beyond: Sequence[str | None]
    outline: FloatArray
    across: tuple[float, float]
    fraction: float
    row: dict[str, Any]
    data: dict[str, Any]


def wall_folder(
    element: WallElement, panels: tuple[WallPanel, ...]
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """Return all files of a ruled wall by name, and issues.

    Issues are ``element.assembly`` for panels without an insertion path, ``element.cut`` for cuts of raw
    blocks that no bow reaches.

    Raises:
        TandemError: ``element.jobs``, ``element.raw_block``.
    """
    wide, names = float(element.wall.widths.max()) / MM, panel_ids(panels)
    pieces = [panel.piece for panel in panels]
    parts = [
        (wide * (1.0 - p.across[1]), wide * (1.0 - p.across[0]), p.along[0] / MM, p.along[1] / MM)
        for p in pieces
    ]
    outputs = []
    for k, (panel, piece) in enumerate(zip(panels, pieces, strict=True)):
        drawn_outline = (piece.outline @ FRONT_VIEW_ROTATION + [1.0, 0.0]) * [wide, 1.0 / MM]
        row = {"off_surface_mm": round(panel.deviation / MM, 3)}
        ring = rectangle_outline(parts, names, k)
        outputs.append(
            PanelOutput(
                *ring, drawn_outline, piece.across, panel.deviation / MM / DARKEST_DEVIATION_MM, row, {}
            )
        )
    worst = max(panel.deviation for panel in panels) / MM
    legend = f"larger deviation of the straight back from the offset front, at most {worst:.2f} mm"
    wall = element.wall
    stand = PanelLayout(wall, wall.nodes, np.array([0.0, wall.widths.mean()]))
    return _write_folder(element, panels, outputs, [stand] * len(panels), ("", legend), {})


def strips_folder(
    element: StripsElement, division: StripDivision
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """Return all files of a surface in ruled strips as `wall_folder`, with deviations and kinks."""
    panels, limit, names = division.panels, element.options.tolerance_mm, panel_ids(division.panels)
    positions, fractions = (
        division.lines.distances_across[division.cuts],
        division.lines.parameters[division.cuts],
    )
    known = {name: division.steps(k) for k, name in enumerate(names)}
    parts = []
    for strip, first, last in known.values():
        x, y = (
            (positions[-1] - positions[[strip + 1, strip]]) / MM,
            division.lines.distances_along[[first, last]] / MM,
        )
        parts.append((float(x[0]), float(x[1]), float(y[0]), float(y[1])))
    outputs = []
    for k, panel_steps in enumerate(known.values()):
        ring, beyond = rectangle_outline(parts, names, k)
        kinks = [
            None if item is None else round(division.kink(panel_steps, known[item]) / DEG, 3)
            for item in beyond
        ]
        row = {
            "off_surface_mm": round(float(division.deviation[k]) / MM, 3),
            "kink_deg": max((kink for kink in kinks if kink is not None), default=0.0),
            "back_off_mm": round(panels[k].deviation / MM, 3),
        }
        across = float(fractions[panel_steps[0]]), float(fractions[panel_steps[0] + 1])
        drawn = np.array(parts[k])[[[0, 2], [1, 2], [1, 3], [0, 3]]]
        data = {"kinks_deg": kinks}
        outputs.append(
            PanelOutput(ring, beyond, drawn, across, float(division.deviation[k]) / MM / limit, row, data)
        )
    worst = float(division.deviation.max()) / MM
    texts = (
        f" in {len(fractions) - 1} strips across {division.across}",
        f"larger deviation of the front from the surface, at most {worst:.2f} of {limit:g} mm",
    )
    whole = {
        "across": division.across,
        "breaks": np.round(fractions, 9).tolist(),
        "widths_mm": np.round(np.diff(positions) / MM, 3).tolist(),
        "tolerance_mm": limit,
        "tried": {item: {"strips": s, "panels": p} for item, (s, p) in division.tried.items()},
    }
    strips = [panel.piece.grid_position[0] for panel in panels]
    layouts = [
        PanelLayout(division.walls[k], division.lines.distances_along, positions[[k, k + 1]]) for k in strips
    ]
    return _write_folder(element, panels, outputs, layouts, texts, {"strips": whole})


def _write_folder(
    element: Element,
    panels: Sequence[WallPanel],
    outputs: Sequence[PanelOutput],
    layouts: Sequence[PanelLayout],
    texts: tuple[str, str],
    more: dict[str, Any],
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    names = panel_ids(panels)
    templates = jobs.choose_templates(element, panels, names)
    files, rows, data, blocks = {}, [], [], []
    element_assembly = wall_assembly(
        panels, names, layouts, element.file.thickness_mm * MM, max_dowel_tilt(element)
    )
    columns, bodies = element_assembly.columns(), element_assembly.data()
    for k, (panel, output, name, grid_name, template) in enumerate(
        zip(panels, outputs, names, _grid_names(panels), templates, strict=True)
    ):
        panel_problem = jobs.panel_problem(element, panel, name, template, _part(panel))
        files[f"panels/{name}.yaml"] = jobs.problem_text(element, name, panel_problem)
        blocks.append(panel_block(element, panel, name))
        row = {**_row(element, panel, output, blocks[-1], grid_name, template.file), **columns[k]}
        rows.append(
            {
                **row,
                "neighbours": " ".join(dict.fromkeys(neighbour for neighbour in output.beyond if neighbour)),
            }
        )
        drawn = {"neighbours": list(output.beyond), "outline_mm": np.round(np.array(output.ring), 2).tolist()}
        takes = jobs.cut_figures(template, functools.partial(jobs.ruled_cut_length, panel_problem))
        data.append(
            {**row, **drawn, **output.data, **bodies[k], **takes, "block_pose": jobs.pose_to_mm(panel.pose)}
        )
    files["panels.csv"] = table(rows)
    files["panels.svg"] = _draw_panels(element, outputs, names, texts)
    files["element.obj"] = element_assembly.obj()
    whole = {
        "element": 1,
        "name": element.file.name,
        "pose": np.eye(4).tolist(),
        "up": element_assembly.up.tolist(),
        "thickness_mm": element.file.thickness_mm,
        "volume_l": round(1e3 * sum(panel.volume for panel in panels), 3),
        **more,
        "panels": data,
    }
    if any(panel.piece.way_in is not None for panel in panels):  # lobes are not joints between two lines
        return complete_output(element, files, whole, blocks, element_assembly)
    whole["joints"] = list(_joints(panels, outputs, layouts, names, element.file.thickness_mm * MM))
    return complete_output(
        element, files, whole, blocks, element_assembly, tuple(element_assembly.issues(FREE_INTERFERENCE_M))
    )


def _joints(
    panels: Sequence[WallPanel],
    outputs: Sequence[PanelOutput],
    layouts: Sequence[PanelLayout],
    names: Sequence[str],
    thickness: float,
) -> Iterator[dict[str, Any]]:
    """Yield the joints: sides, length, and paired points of the front and back lines."""
    for panel, output, stand, name in zip(panels, outputs, layouts, names, strict=True):
        piece, wall = panel.piece, stand.wall
        low, high = np.min(output.ring, axis=0), np.max(output.ring, axis=0)
        ends = zip(output.ring, (*output.ring[1:], output.ring[0]), output.beyond, strict=True)
        for (x, y), (x_end, y_end), beyond in ends:
            if beyond is None or beyond < name:
                continue
            if x == x_end:
                side, other = ("right", "left") if x == high[0] else ("left", "right")
                first, last = stand.wall_positions(np.array([min(y, y_end), max(y, y_end)]) * MM).tolist()
                positions = np.linspace(first, last, JOINT_POINTS)
                lines = face_rulings(wall, thickness, positions, piece.across)
                front, back = (line[int(side == "left")] for line in lines)
            else:
                side, other = ("bottom", "top") if y == low[1] else ("top", "bottom")
                positions = np.array([piece.along[int(side == "top")]])
                fractions = np.linspace(0.0, 1.0, JOINT_POINTS)[:, None]
                lines = face_rulings(wall, thickness, positions, piece.across)
                front, back = (a + fractions * (b - a) for (a,), (b,) in lines)
            yield {
                "panels": [name, beyond],
                "sides": [side, other],
                "length_mm": round(float(lengths(np.diff(front, axis=0)).sum()) / MM, 3),
                "front_mm": np.round(front / MM, JOINT_DIGITS).tolist(),
                "back_mm": np.round(back / MM, JOINT_DIGITS).tolist(),
            }


def panel_block(element: Element, panel: WallPanel, name: str) -> PanelBlock:
    """Return the block of a panel for nesting in raw blocks."""
    length, width, high = (v * MM for v in jobs.block_mm(panel))
    foam = element.file.blocks[panel.block].foam
    return PanelBlock(
        name, length, width, high, panel.volume, foam, PanelShape(panel.ring, (panel.back, panel.front))
    )


def _grid_names(panels: Sequence[WallPanel]) -> tuple[str, ...]:
    """Return the positions of panels: a letter for each strip or row, and a number in it."""
    order = sorted(range(len(panels)), key=lambda k: panels[k].piece.grid_position)
    named = jobs.row_names([panels[k].piece.grid_position[0] for k in order])
    return tuple(name for _, name in sorted(zip(order, named, strict=True)))


def _part(panel: WallPanel) -> dict[str, Any]:
    """Return front, back and sides as the part of a problem file; each extends beyond the others."""
    return {
        "ruled": [
            jobs.ruled_surface("front", *panel.front),
            jobs.ruled_surface("back", *panel.back, flip=True),
            *(jobs.ruled_surface(name, *side) for name, side in zip(SIDES, panel.sides, strict=True)),
        ]
    }


def _row(
    element: Element,
    panel: WallPanel,
    output: PanelOutput,
    block_of_panel: PanelBlock,
    grid_name: str,
    template: str,
) -> dict[str, Any]:
    block, piece = element.file.blocks[panel.block], panel.piece
    box = zip(("width", "height", "depth"), panel.box.tolist(), strict=True)
    return {
        "id": block_of_panel.name,
        "place": grid_name,
        "from_mm": round(piece.along[0] / MM, 3),
        "to_mm": round(piece.along[1] / MM, 3),
        "from_share": round(output.across[0], 6),
        "to_share": round(output.across[1], 6),
        **{f"box_{side}_mm": round(v / MM, 3) for side, v in box},
        **{f"block_{axis}_mm": v for axis, v in zip("xyz", jobs.block_mm(panel), strict=True)},
        "raw_block_mm": " x ".join(f"{v:g}" for v in block.size_mm),
        "volume_l": round(1e3 * panel.volume, 4),
        "weight_kg": weight_kg(block_of_panel),
        **output.row,
        "job": template,
    }


def _draw_panels(
    element: Element, outputs: Sequence[PanelOutput], names: Sequence[str], texts: tuple[str, str]
) -> str:
    """Draw the panels in a flat layout seen from the front.

    The rulings of a wall are level and as long as the longest one. ``texts``: on the number of panels, and on
    the meaning of darker ones.
    """
    title = f"{element.file.name}: {len(names)} panels{texts[0]}, {element.file.thickness_mm:g} mm thick"
    legend = "flat layout, seen from the front; numbers increase with the height of the panel's box; darker: "
    drawn = [
        DrawnPanel(name, output.outline, output.fraction) for name, output in zip(names, outputs, strict=True)
    ]
    return draw_panels(title, legend + texts[1], drawn)
