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
"""Number of points of each line of a joint, in front and at the back, in ``element.json``."""
JOINT_DIGITS: Final = 6
"""Decimals of the points of joints in mm."""
DARKEST_DEVIATION_MM: Final = 1.0
"""Deviation [mm] of a back that is drawn darkest."""


@dataclasses.dataclass(frozen=True)
class PanelOutput:
    """Properties of a panel that depend on its kind.

    Attributes:
        ring: Corners [mm], with those of neighbours, in the flat layout as seen from the front.
        beyond: Id of the panel beyond each edge of ``ring``; None on the rim.
        outline: Outline (C, 2) [mm] for the drawing.
        across: Range of the panel across the surface, as fractions.
        fraction: Deviation as a fraction of the allowed one, or of the darkest one in the drawing.
        row: Columns of the table for this kind.
        data: Data of ``element.json`` for this kind.
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
    """Return all output files of a ruled wall as texts by name, and its issues.

    Issues are ``element.assembly`` for panels without an insertion path, ``element.cut`` for cuts of raw
    blocks that no bow reaches.

    Raises:
        TandemError: ``element.jobs`` if not exactly one template matches a panel; ``element.raw_block`` if a
            block fits no raw block.
    """
    width = float(element.wall.widths.max()) / MM
    names = panel_ids(panels)
    pieces = [panel.piece for panel in panels]
    parts = [
        (
            width * (1.0 - piece.across[1]),
            width * (1.0 - piece.across[0]),
            piece.along[0] / MM,
            piece.along[1] / MM,
        )
        for piece in pieces
    ]
    outputs = []
    for k, (panel, piece) in enumerate(zip(panels, pieces, strict=True)):
        drawn_outline = (piece.outline @ FRONT_VIEW_ROTATION + [1.0, 0.0]) * [width, 1.0 / MM]
        row = {"off_surface_mm": round(panel.deviation / MM, 3)}
        ring = rectangle_outline(parts, names, k)
        outputs.append(
            PanelOutput(
                *ring, drawn_outline, piece.across, panel.deviation / MM / DARKEST_DEVIATION_MM, row, {}
            )
        )
    max_deviation = max(panel.deviation for panel in panels) / MM
    legend = f"larger deviation of the straight back from the offset front, at most {max_deviation:.2f} mm"
    wall = element.wall
    layout = PanelLayout(wall, wall.nodes, np.array([0.0, wall.widths.mean()]))
    return _write_folder(element, panels, outputs, [layout] * len(panels), ("", legend), {})


def strips_folder(
    element: StripsElement, division: StripDivision
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """Return all output files and issues of ruled strips as `wall_folder`, with deviations and kinks."""
    panels, limit, names = division.panels, element.options.tolerance_mm, panel_ids(division.panels)
    positions = division.lines.distances_across[division.cuts]
    fractions = division.lines.parameters[division.cuts]
    steps_by_name = {name: division.steps(k) for k, name in enumerate(names)}
    parts = []
    for strip, first, last in steps_by_name.values():
        x = (positions[-1] - positions[[strip + 1, strip]]) / MM
        y = division.lines.distances_along[[first, last]] / MM
        parts.append((float(x[0]), float(x[1]), float(y[0]), float(y[1])))
    outputs = []
    for k, panel_steps in enumerate(steps_by_name.values()):
        ring, beyond = rectangle_outline(parts, names, k)
        kinks = [
            None
            if neighbour is None
            else round(division.kink(panel_steps, steps_by_name[neighbour]) / DEG, 3)
            for neighbour in beyond
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
    max_deviation = float(division.deviation.max()) / MM
    texts = (
        f" in {len(fractions) - 1} strips across {division.across}",
        f"larger deviation of the front from the surface, at most {max_deviation:.2f} of {limit:g} mm",
    )
    strips_data = {
        "across": division.across,
        "breaks": np.round(fractions, 9).tolist(),
        "widths_mm": np.round(np.diff(positions) / MM, 3).tolist(),
        "tolerance_mm": limit,
        "tried": {
            across: {"strips": strip_count, "panels": panel_count}
            for across, (strip_count, panel_count) in division.tried.items()
        },
    }
    strips = [panel.piece.grid_position[0] for panel in panels]
    layouts = [
        PanelLayout(division.walls[k], division.lines.distances_along, positions[[k, k + 1]]) for k in strips
    ]
    return _write_folder(element, panels, outputs, layouts, texts, {"strips": strips_data})


def _write_folder(
    element: Element,
    panels: Sequence[WallPanel],
    outputs: Sequence[PanelOutput],
    layouts: Sequence[PanelLayout],
    texts: tuple[str, str],
    kind_data: dict[str, Any],
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """Return all output files and issues of a wall or of strips.

    ``outputs`` and ``layouts`` have one entry for each panel. ``texts`` are those of `_draw_panels`,
    ``kind_data`` is data of ``element.json`` for this kind.
    """
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
        drawing_data = {
            "neighbours": list(output.beyond),
            "outline_mm": np.round(np.array(output.ring), 2).tolist(),
        }
        effort = jobs.cut_figures(template, functools.partial(jobs.ruled_cut_length, panel_problem))
        data.append(
            {
                **row,
                **drawing_data,
                **output.data,
                **bodies[k],
                **effort,
                "block_pose": jobs.pose_to_mm(panel.pose),
            }
        )
    files["panels.csv"] = table(rows)
    files["panels.svg"] = _draw_panels(element, outputs, names, texts)
    files["element.obj"] = element_assembly.obj()
    element_data = {
        "element": 1,
        "name": element.file.name,
        "pose": np.eye(4).tolist(),
        "up": element_assembly.up.tolist(),
        "thickness_mm": element.file.thickness_mm,
        "volume_l": round(1e3 * sum(panel.volume for panel in panels), 3),
        **kind_data,
        "panels": data,
    }
    if any(panel.piece.way_in is not None for panel in panels):  # lobes are not joints between two lines
        return complete_output(element, files, element_data, blocks, element_assembly)
    element_data["joints"] = list(_joints(panels, outputs, layouts, names, element.file.thickness_mm * MM))
    return complete_output(
        element,
        files,
        element_data,
        blocks,
        element_assembly,
        tuple(element_assembly.issues(FREE_INTERFERENCE_M)),
    )


def _joints(
    panels: Sequence[WallPanel],
    outputs: Sequence[PanelOutput],
    layouts: Sequence[PanelLayout],
    names: Sequence[str],
    thickness: float,
) -> Iterator[dict[str, Any]]:
    """Yield the data of each joint: panels, sides, length, and paired points in front and at the back."""
    for panel, output, layout, name in zip(panels, outputs, layouts, names, strict=True):
        piece, wall = panel.piece, layout.wall
        low, high = np.min(output.ring, axis=0), np.max(output.ring, axis=0)
        ends = zip(output.ring, (*output.ring[1:], output.ring[0]), output.beyond, strict=True)
        for (x, y), (x_end, y_end), beyond in ends:
            if beyond is None or beyond < name:
                continue
            if x == x_end:
                side, other = ("right", "left") if x == high[0] else ("left", "right")
                first, last = layout.wall_positions(np.array([min(y, y_end), max(y, y_end)]) * MM).tolist()
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
    length, width, height = (v * MM for v in jobs.block_mm(panel))
    foam = element.file.blocks[panel.block].foam
    return PanelBlock(
        name, length, width, height, panel.volume, foam, PanelShape(panel.ring, (panel.back, panel.front))
    )


def _grid_names(panels: Sequence[WallPanel]) -> tuple[str, ...]:
    """Return the grid position of each panel: a letter for its strip or row, and its number in that."""
    order = sorted(range(len(panels)), key=lambda k: panels[k].piece.grid_position)
    named = jobs.row_names([panels[k].piece.grid_position[0] for k in order])
    return tuple(name for _, name in sorted(zip(order, named, strict=True)))


def _part(panel: WallPanel) -> dict[str, Any]:
    """Return the part of a problem file: front, back and sides, which extend beyond one another."""
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
    """Return the row of a panel in ``panels.csv``, by columns, but for its neighbours."""
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

    The rulings of a wall are level and as long as the longest one. ``texts`` follow the number of panels in
    the title, and state in the legend what darker panels mean.
    """
    title = f"{element.file.name}: {len(names)} panels{texts[0]}, {element.file.thickness_mm:g} mm thick"
    legend = "flat layout, seen from the front; numbers increase with the height of the panel's box; darker: "
    drawn = [
        DrawnPanel(name, output.outline, output.fraction) for name, output in zip(names, outputs, strict=True)
    ]
    return draw_panels(title, legend + texts[1], drawn)
