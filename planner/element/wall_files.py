"""What a ruled wall in boxes or puzzle pieces leaves in a folder: problems, a table and a drawing of its
panels, and all as data."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import shapely

from planner.element.assembly import GIVE, SHOWN, Assembly, Body, rests_on, ring_slab, thinned
from planner.element.element_file import WallElement
from planner.element.hexagons import LOW
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
from planner.element.wall_panels import outline as outline_of
from planner.geometry.assembly import NONE, Step, bodies_beyond, put_up, rows_up
from planner.geometry.units import MM
from planner.issues import Issue

TURN: Final = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Places (u, t) of a wall as seen from the front: its rulings from right to left, u up."""
SHADED: Final = 1.0
"""A back that is so far off [mm] is drawn darkest."""
NEAR: Final = 2e-4
"""How far outlines may be off [m] as the way in is looked for."""
BESIDE: Final = 1e-5
"""How far [m] outside of a side the panel beyond is looked for."""


def folder(element: WallElement, panels: tuple[WallPanel, ...]) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """All files by their names, and what is to be said: ``element.assembly`` for panels without a way in,
    ``element.cut`` for cuts of raw blocks that no bow reaches.

    Raises ``TandemError``: ``element.jobs``, ``element.raw_block``.
    """
    names = numbers(panels)
    templates = chosen_templates(element, panels, names)
    places = _places(panels)
    flat = [(1.0 - p.piece.across[1], 1.0 - p.piece.across[0], *p.piece.along) for p in panels]
    scale = np.array([float(element.wall.widths.max()), 1.0]) / MM
    files, rows, data, blocks = {}, [], [], []
    up = assembly(element, panels, names)
    columns, stands = up.columns(), up.data()
    for k, (panel, name, place, template) in enumerate(zip(panels, names, places, templates, strict=True)):
        made = problem(element, panel, name, template, _part(panel))
        files[f"panels/{name}.yaml"] = problem_text(element, name, made)
        ring, beyond = outline(flat, names, k)
        blocks.append(panel_block(element, panel, name))
        row = {**_row(element, panel, blocks[-1], place, template.file), **columns[k]}
        rows.append({**row, "neighbours": " ".join(dict.fromkeys(one for one in beyond if one))})
        laid = {"neighbours": beyond, "outline_mm": np.round(np.array(ring) * scale, 2).tolist()}
        data.append({**row, **laid, **stands[k], "block_pose": pose_mm(panel.pose)})
    files["panels.csv"] = table(rows)
    files["panels.svg"] = _drawing(element, panels, names)
    files["element.obj"] = up.obj()
    whole = {
        "element": 1,
        "name": element.file.name,
        "pose": np.eye(4).tolist(),
        "up": up.up.tolist(),
        "thickness_mm": element.file.thickness_mm,
        "volume_l": round(1e3 * sum(panel.volume for panel in panels), 3),
        "panels": data,
    }
    told = () if any(panel.piece.way_in is not None for panel in panels) else up.issues(GIVE)
    return finished(element, files, whole, blocks, told)


def assembly(element: WallElement, panels: Sequence[WallPanel], names: Sequence[str]) -> Assembly:
    """How a wall is put up. Puzzle pieces follow their places, as their sides are made for; others go up in
    rows from what of the rim is low."""
    wall, thickness = element.wall, element.file.thickness_mm * MM
    cuts = np.unique([panel.piece.along for panel in panels])
    rings, plans = [], []
    for panel in panels:
        piece = panel.piece
        if piece.way_in is None:  # with the corners of panels beside it
            part = piece.outline[piece.outline[:, 1] == piece.across[0], 0]
            part = np.union1d(part, cuts[(cuts > part[0]) & (cuts < part[-1])])
            sides = [np.stack([part, np.full(len(part), t)], axis=1) for t in piece.across]
            places = np.concatenate([sides[0], sides[1][::-1]])
            piece = dataclasses.replace(piece, outline=places, leads=wall.normals(*places.T))
        plan = piece.outline * [1.0, float(wall.widths.mean())]
        way = 1 if shapely.is_ccw(shapely.LinearRing(plan)) else -1
        rings.append([ring[::way] for ring in outline_of(wall, piece, thickness)])
        plans.append(plan[::way])
    beyond = bodies_beyond(plans, BESIDE)
    bodies = []
    for name, (front, back), plan, one in zip(names, rings, plans, beyond, strict=True):
        slab = ring_slab(front, back, plan, one)
        bodies.append(Body(name, slab, thinned(slab, plan, SHOWN)))
    pieces, up = [panel.piece for panel in panels], np.array([0.0, 0.0, 1.0])
    order = sorted(range(len(panels)), key=lambda k: pieces[k].place)
    ways = [(k, pieces[k].way_in) for k in order]
    given = tuple(Step(k, -way, pieces[k].jam) for k, way in ways if way is not None)
    if len(given) == len(panels):
        return Assembly(tuple(bodies), given, up)
    slabs = [thinned(body.whole, plan, NEAR) for body, plan in zip(bodies, plans, strict=True)]
    low = np.array([slab.mesh[0][:, 2].min() for slab in slabs])
    rim = np.array([(one == NONE).any() for one in beyond])
    size = np.mean([float(np.sqrt(panel.box[:2].prod())) for panel in panels])
    row = rows_up(beyond, rim & (low < low.min() + LOW * size), low)
    rank = np.empty(len(panels), dtype=np.int64)
    rank[sorted(range(len(panels)), key=lambda k: (int(row[k]), pieces[k].place))] = range(len(panels))
    return Assembly(tuple(bodies), put_up(slabs, rank, rests_on(beyond, row), up, GIVE), up)


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
