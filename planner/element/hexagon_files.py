"""What a shell of hexagons leaves in a folder: problems, a table and a drawing of its panels, and all as
data."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from planner.catalogue.materials import foam
from planner.element.element_file import HexagonElement
from planner.element.hexagons import HexagonPanel
from planner.element.jobs import block_mm, chosen_templates, pose_mm, problem, problem_text, ruled
from planner.element.nest import PanelBlock
from planner.element.nested_output import nested_folder
from planner.element.output import table
from planner.element.panel_drawing import DrawnPanel, panels_drawing
from planner.geometry.arrays import FloatArray, transform
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity


def folder(
    element: HexagonElement, panels: tuple[HexagonPanel, ...]
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """All files by their names, and what is to be said: ``element.concave`` for panels with inner corners,
    ``element.cut`` for cuts of raw blocks that no bow reaches.

    Raises ``TandemError``: ``element.jobs``, ``element.raw_block``.
    """
    names = [panel.name for panel in panels]
    templates = chosen_templates(element, panels, names)
    rows = [row(element, panel, one.file) for panel, one in zip(panels, templates, strict=True)]
    files = {}
    for panel, template in zip(panels, templates, strict=True):
        made = problem(element, panel, panel.name, template, _part(panel))
        files[f"panels/{panel.name}.yaml"] = problem_text(element, panel.name, made)
    files["panels.csv"] = table(rows)
    files["panels.svg"] = drawing(element, panels)
    data = _data(element, panels, rows)
    of_blocks, said, blocks = nested_folder(element, [_panel_block(element, panel) for panel in panels])
    files["element.json"] = json.dumps({**data, **blocks}, indent=1) + "\n"
    return {**files, **of_blocks}, (*_concave(panels), *said)


def _panel_block(element: HexagonElement, panel: HexagonPanel) -> PanelBlock:
    length, width, high = (v * MM for v in block_mm(panel))
    return PanelBlock(panel.name, length, width, high, panel.volume, element.file.blocks[panel.block].foam)


def _part(panel: HexagonPanel) -> dict[str, Any]:
    """The sides between both outlines, as the part of a problem file."""
    return {"ruled": [ruled("sides", panel.bottom, panel.top, closed=True)]}


def row(element: HexagonElement, panel: HexagonPanel, template: str) -> dict[str, Any]:
    """A panel's row in the table. Lists have a value for each side in turn: the lengths of its edges in front
    and at the back, the angle at the corner where it begins, how far it leans out from back to front, and the
    panel beyond."""
    block = element.file.blocks[panel.block]
    weight = "" if block.foam is None else round(foam(block.foam).density * panel.volume, 4)
    return {
        "id": panel.name,
        "sides": len(panel.top),
        "front_edges_mm": _list(_edges(panel.top) / MM, 3),
        "back_edges_mm": _list(_edges(panel.bottom) / MM, 3),
        "corners_deg": _list(_corners(panel.top) / DEG, 3),
        "leans_deg": _list(leans(panel) / DEG, 3),
        "neighbours": " ".join(one or "-" for one in panel.beyond),
        **{f"block_{axis}_mm": v for axis, v in zip("xyz", block_mm(panel), strict=True)},
        "raw_block_mm": " x ".join(f"{v:g}" for v in block.size_mm),
        "volume_l": round(1e3 * panel.volume, 4),
        "weight_kg": weight,
        "off_surface_mm": round(panel.off / MM, 3),
        "concave": "yes" if panel.concave else "no",
        "job": template,
    }


def _list(values: FloatArray, digits: int) -> str:
    return " ".join(f"{v:.{digits}f}" for v in values.tolist())


def _edges(ring: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1))


def _corners(ring: FloatArray) -> FloatArray:
    """Inner angles (C,) [rad] of an outline that is counterclockwise."""
    after, before = np.roll(ring, -1, axis=0) - ring, np.roll(ring, 1, axis=0) - ring
    turn = np.arctan2(before[:, 1], before[:, 0]) - np.arctan2(after[:, 1], after[:, 0])
    return np.asarray(turn % (2.0 * np.pi))


def leans(panel: HexagonPanel) -> FloatArray:
    """How far the sides (C,) lean outwards from back to front [rad]."""
    along = np.roll(panel.bottom, -1, axis=0) - panel.bottom
    out = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    rise = panel.top - panel.bottom
    return np.asarray(np.arctan2((rise[:, :2] * out).sum(axis=1), rise[:, 2]))


def _data(
    element: HexagonElement, panels: tuple[HexagonPanel, ...], rows: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """The element as data: panels with the poses of their blocks in the frame of the surface's file (4, 4)
    [mm]; its totals."""

    return {
        "element": 1,
        "name": element.file.name,
        "pose": np.eye(4).tolist(),
        "thickness_mm": element.file.thickness_mm,
        "volume_l": round(1e3 * sum(panel.volume for panel in panels), 3),
        "panels": [
            {
                **one,
                "neighbours": [name or None for name in panel.beyond],
                "on_ground": panel.level.tolist(),
                "block_pose": pose_mm(panel.pose),
            }
            for one, panel in zip(rows, panels, strict=True)
        ],
    }


def _concave(panels: tuple[HexagonPanel, ...]) -> tuple[Issue, ...]:
    found = [panel.name for panel in panels if panel.concave]
    if not found:
        return ()
    what = (
        f"{len(found)} of {len(panels)} panels are concave, as planar ones come out where a surface bends "
        f"both ways or nearly in one: {', '.join(found)}"
    )
    hint = "a wire leaves their inner corners round: check these panels before foam is cut"
    return (Issue("element.concave", what, Severity.WARNING, field="panels.hexagons", hint=hint),)


def drawing(element: HexagonElement, panels: tuple[HexagonPanel, ...]) -> str:
    """All fronts with their ids, seen from the front: the darker, the farther off the surface; dashed where
    concave."""
    limit, worst = element.wanted.off_surface_mm, max(panel.off for panel in panels) / MM
    title = f"{element.file.name}: {len(panels)} panels, {element.file.thickness_mm:g} mm thick"
    legend = f"seen from the front; darker: farther off the surface, at most {worst:.1f} of {limit:g} mm"
    if any(panel.concave for panel in panels):
        legend += "; dashed: concave"
    drawn = [
        DrawnPanel(
            panel.name,
            (transform(panel.pose, panel.top) @ element.view)[:, :2] / MM,
            panel.off / MM / limit,
            panel.concave,
        )
        for panel in panels
    ]
    return panels_drawing(title, legend, drawn)
