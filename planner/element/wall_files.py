"""What a ruled wall in boxes or puzzle pieces leaves in a folder: problems, a table and a drawing of its
panels, and all as data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from planner.element.element_file import WallElement
from planner.element.jobs import (
    block_mm,
    chosen_templates,
    pose_mm,
    problem,
    problem_text,
    row_names,
    ruled,
)
from planner.element.nest import PanelBlock
from planner.element.nested_output import finished
from planner.element.output import outline, table, weight_kg
from planner.element.panel_drawing import DrawnPanel, panels_drawing
from planner.element.wall_panels import SIDES, WallPanel, numbers
from planner.geometry.units import MM
from planner.issues import Issue

TURN: Final = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Places (u, t) of a wall as seen from the front: its rulings from right to left, u up."""
SHADED: Final = 1.0
"""A back that is so far off [mm] is drawn darkest."""


def folder(element: WallElement, panels: tuple[WallPanel, ...]) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """All files by their names, and what is to be said: ``element.cut`` for cuts of raw blocks that no bow
    reaches.

    Raises ``TandemError``: ``element.jobs``, ``element.raw_block``.
    """
    names = numbers(panels)
    templates = chosen_templates(element, panels, names)
    places = _places(panels)
    flat = [(1.0 - p.piece.across[1], 1.0 - p.piece.across[0], *p.piece.along) for p in panels]
    scale = np.array([float(element.wall.widths.max()), 1.0]) / MM
    files, rows, data, blocks = {}, [], [], []
    for k, (panel, name, place, template) in enumerate(zip(panels, names, places, templates, strict=True)):
        made = problem(element, panel, name, template, _part(panel))
        files[f"panels/{name}.yaml"] = problem_text(element, name, made)
        ring, beyond = outline(flat, names, k)
        blocks.append(panel_block(element, panel, name))
        row = _row(element, panel, blocks[-1], place, template.file)
        rows.append({**row, "neighbours": " ".join(dict.fromkeys(one for one in beyond if one))})
        way = panel.piece.way_in
        came = {} if way is None else {"way_in": [round(v, 9) + 0.0 for v in (-way).tolist()]}
        laid = {"neighbours": beyond, "outline_mm": np.round(np.array(ring) * scale, 2).tolist()}
        data.append({**row, **laid, **came, "block_pose": pose_mm(panel.pose)})
    files["panels.csv"] = table(rows)
    files["panels.svg"] = _drawing(element, panels, names)
    whole = {
        "element": 1,
        "name": element.file.name,
        "pose": np.eye(4).tolist(),
        "thickness_mm": element.file.thickness_mm,
        "volume_l": round(1e3 * sum(panel.volume for panel in panels), 3),
        "panels": data,
    }
    return finished(element, files, whole, blocks)


def panel_block(element: WallElement, panel: WallPanel, name: str) -> PanelBlock:
    """What is nested into raw blocks for a panel."""
    length, width, high = (v * MM for v in block_mm(panel))
    own = element.file.blocks[panel.block].foam
    return PanelBlock(name, length, width, high, panel.volume, own)


def _places(panels: Sequence[WallPanel]) -> tuple[str, ...]:
    """Where panels belong: a letter for each strip or row, and a number in it."""
    order = sorted(range(len(panels)), key=lambda k: panels[k].piece.place)
    named = row_names([panels[k].piece.place[0] for k in order])
    return tuple(name for _, name in sorted(zip(order, named, strict=True)))


def _part(panel: WallPanel) -> dict[str, Any]:
    """Front, back and sides as the part of a problem file; each goes on beyond the others."""
    return {
        "ruled": [
            ruled("front", *panel.front),
            ruled("back", *panel.back, flip=True),
            *(ruled(name, *side) for name, side in zip(SIDES, panel.sides, strict=True)),
        ]
    }


def _row(
    element: WallElement, panel: WallPanel, own: PanelBlock, place: str, template: str
) -> dict[str, Any]:
    """A panel's row in the table."""
    block, piece = element.file.blocks[panel.block], panel.piece
    box = zip(("width", "height", "depth"), panel.box.tolist(), strict=True)
    return {
        "id": own.name,
        "place": place,
        "from_mm": round(piece.along[0] / MM, 3),
        "to_mm": round(piece.along[1] / MM, 3),
        "from_share": round(piece.across[0], 6),
        "to_share": round(piece.across[1], 6),
        **{f"box_{side}_mm": round(v / MM, 3) for side, v in box},
        **{f"block_{axis}_mm": v for axis, v in zip("xyz", block_mm(panel), strict=True)},
        "raw_block_mm": " x ".join(f"{v:g}" for v in block.size_mm),
        "volume_l": round(1e3 * panel.volume, 4),
        "weight_kg": weight_kg(own),
        "off_surface_mm": round(panel.off / MM, 3),
        "jam_mm": "" if piece.way_in is None else round(piece.jam / MM, 3),
        "job": template,
    }


def _drawing(element: WallElement, panels: Sequence[WallPanel], names: Sequence[str]) -> str:
    """The wall laid flat as seen from the front, its rulings level and as long as the longest."""
    wide = float(element.wall.widths.max())
    worst = max(panel.off for panel in panels) / MM
    title = f"{element.file.name}: {len(panels)} panels, {element.file.thickness_mm:g} mm thick"
    legend = "laid flat, seen from the front; numbers grow with the height of the panel's box; darker: the "
    legend += f"straight back is farther off one thickness behind the front, at most {worst:.2f} mm"
    drawn = [
        DrawnPanel(
            name, (panel.piece.outline @ TURN + [1.0, 0.0]) * [wide, 1.0] / MM, panel.off / MM / SHADED
        )
        for panel, name in zip(panels, names, strict=True)
    ]
    return panels_drawing(title, legend, drawn)
