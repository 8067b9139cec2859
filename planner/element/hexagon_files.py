"""What a shell of hexagons leaves in a folder: problems, a table and a drawing of its panels, and all as
data."""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from planner.element.assembly import Assembly, Body, rests_on, ring_slab
from planner.element.dowels import square
from planner.element.element_file import HexagonElement, Template
from planner.element.hexagons import HexagonPanel
from planner.element.jobs import (
    block_mm,
    chosen_templates,
    cut_figures,
    pose_mm,
    problem,
    problem_text,
    ruled,
)
from planner.element.nest import PanelBlock
from planner.element.output import finished, table, weight_kg
from planner.element.panel_drawing import DrawnPanel, panels_drawing
from planner.element.rows import Shape
from planner.geometry.arrays import FloatArray, transform, unit
from planner.geometry.assembly import CLEAR, NONE, put_up
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity

LEVEL: Final = 5.0 * DEG
"""Panels that lean by less than this [rad] have no side that is up."""
SAME_CORNER: Final = 1e-6
"""Corners of fronts that are nearer than this [m] are one."""
RING_DIGITS: Final = 6
"""Decimals of outlines in mm in ``element.json``: those in the files of panels have more."""


def folder(
    element: HexagonElement, panels: tuple[HexagonPanel, ...]
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """All files by their names, and what is to be said: ``element.count`` for a count not as asked,
    ``element.concave`` for panels with inner corners, ``element.assembly`` for panels without a way in,
    ``element.cut`` for cuts of raw blocks that no bow reaches.

    Raises ``TandemError``: ``element.jobs``, ``element.raw_block``.
    """
    names = [panel.name for panel in panels]
    templates = chosen_templates(element, panels, names)
    own = [_panel_block(element, panel) for panel in panels]
    up = assembly(panels, square(element))
    rows = [
        {**row(element, panel, block, one.file), "backs_apart_mm": round(apart / MM, 3) + 0.0, **columns}
        for panel, block, one, apart, columns in zip(
            panels, own, templates, backs_apart(panels).tolist(), up.columns(), strict=True
        )
    ]
    files = {}
    for panel, template in zip(panels, templates, strict=True):
        made = problem(element, panel, panel.name, template, _part(panel))
        files[f"panels/{panel.name}.yaml"] = problem_text(element, panel.name, made)
    files["panels.csv"] = table(rows)
    files["panels.svg"] = drawing(element, panels)
    files["element.obj"] = up.obj()
    data = _data(element, panels, rows, templates, up)
    issues = (*_count(element, panels), *_concave(element, panels), *up.issues(CLEAR))
    return finished(element, files, data, own, up, issues)


def backs_apart(panels: Sequence[HexagonPanel]) -> FloatArray:
    """How far apart (P,) [m] the back of each panel and those of others end at most, at corners that are not
    on the rim. Three planes moved by one have a point in common; where four panels meet, their backs end at
    different heights of the line that goes through the corner."""
    number, fronts, backs = [], [], []
    for k, panel in enumerate(panels):
        inner = [i for i, name in enumerate(panel.beyond) if name and panel.beyond[i - 1]]
        number += [k] * len(inner)
        fronts.append(transform(panel.pose, panel.top[inner]))
        backs.append(transform(panel.pose, panel.bottom[inner]))
    here, back = np.array(number, dtype=np.intp), np.concatenate(backs)
    one, other = cKDTree(np.concatenate(fronts)).query_pairs(SAME_CORNER, output_type="ndarray").T
    way = np.linalg.norm(back[one] - back[other], axis=1)
    out = np.zeros(len(panels))
    for side in (one, other):
        np.maximum.at(out, here[side], way)
    return out


def assembly(panels: tuple[HexagonPanel, ...], square: float | None = None) -> Assembly:
    """How a shell is put up: by rows, whatever its groups are. Sides are planes, so nothing may be in the
    way. ``square`` as in :func:`put_up`."""
    number = {panel.name: k for k, panel in enumerate(panels)}
    bodies = []
    for panel in panels:
        front, back = (transform(panel.pose, ring) for ring in (panel.top, panel.bottom))
        beyond = np.array([number.get(name, NONE) for name in panel.beyond])
        slab = ring_slab(front, back, panel.top[:, :2], beyond)
        bodies.append(Body(panel.name, slab, slab))
    row = np.array([panel.row for panel in panels])
    slabs = [body.whole for body in bodies]
    rests = rests_on([slab.beyond for slab in slabs], row)
    up = np.array([0.0, 0.0, 1.0])
    return Assembly(tuple(bodies), put_up(slabs, row, rests, up, CLEAR, square), up)


def _panel_block(element: HexagonElement, panel: HexagonPanel) -> PanelBlock:
    length, width, high = (v * MM for v in block_mm(panel))
    foam = element.file.blocks[panel.block].foam
    shape = Shape(np.stack([panel.bottom, panel.top]))
    return PanelBlock(panel.name, length, width, high, panel.volume, foam, shape)


def _part(panel: HexagonPanel) -> dict[str, Any]:
    """The sides between both outlines, as the part of a problem file."""
    return {"ruled": [ruled("sides", panel.bottom, panel.top, closed=True)]}


def row(element: HexagonElement, panel: HexagonPanel, own: PanelBlock, template: str) -> dict[str, Any]:
    """A panel's row in the table. Lists have a value for each side in turn: the lengths of its edges in front
    and at the back, the angle at the corner where it begins, how far it leans out from back to front, and the
    panel beyond."""
    block = element.file.blocks[panel.block]
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
        "weight_kg": weight_kg(own),
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
    element: HexagonElement,
    panels: tuple[HexagonPanel, ...],
    rows: Sequence[dict[str, Any]],
    templates: Sequence[Template],
    up: Assembly,
) -> dict[str, Any]:
    """The element as data: panels with the poses of their blocks in the frame of the surface's file (4, 4)
    [mm]; its totals."""

    def way(panel: HexagonPanel, operation: Mapping[str, Any]) -> float:
        """How far the wire goes round a panel [mm], half-way up."""
        round_it = float(_edges(0.5 * (panel.bottom + panel.top)).sum()) / MM
        return round_it if operation.get("process") == "straight_wire" else 0.0

    return {
        "element": 1,
        "name": element.file.name,
        "pose": np.eye(4).tolist(),
        "thickness_mm": element.file.thickness_mm,
        "up": up.up.tolist(),
        "grouped": element.file.groups is not None,
        "volume_l": round(1e3 * sum(panel.volume for panel in panels), 3),
        "panels": [
            {
                **one,
                **stands,
                "neighbours": [name or None for name in panel.beyond],
                "on_ground": panel.level.tolist(),
                "outline_mm": np.round(outline, 2).tolist(),
                "front_mm": np.round(panel.top[:, :2] / MM, RING_DIGITS).tolist(),
                "back_mm": np.round(panel.bottom[:, :2] / MM, RING_DIGITS).tolist(),
                "up": _up(element, panel).tolist(),
                **cut_figures(template, functools.partial(way, panel)),
                "block_pose": pose_mm(panel.pose),
            }
            for one, panel, outline, template, stands in zip(
                rows, panels, _outlines(element, panels), templates, up.data(), strict=True
            )
        ],
        "joints": list(_joints(panels)),
    }


def _joints(panels: tuple[HexagonPanel, ...]) -> Iterator[dict[str, Any]]:
    """Where two panels meet: their sides there, how long it is, and the angle between their faces."""
    middle = {panel.name: transform(panel.pose, _middles(panel)).tolist() for panel in panels}
    known = {panel.name: panel for panel in panels}
    for panel in panels:
        edges = np.minimum(_edges(panel.top), _edges(panel.bottom))
        for i, name in enumerate(panel.beyond):
            if name <= panel.name:
                continue
            beyond = known[name]
            # two panels may have two sides in common
            k = min(
                (k for k, back in enumerate(beyond.beyond) if back == panel.name),
                key=lambda k: math.dist(middle[name][k], middle[panel.name][i]),
            )
            angle = float(np.arccos(np.clip(panel.pose[:3, 2] @ beyond.pose[:3, 2], -1.0, 1.0)))
            yield {
                "panels": [panel.name, name],
                "sides": [i, k],
                "length_mm": round(float(edges[i]) / MM, 3),
                "angle_deg": round(angle / DEG, 3),
            }


def _up(element: HexagonElement, panel: HexagonPanel) -> FloatArray:
    """The direction (2,) in the front, in its block's frame, that is up where the panel stands; where it lies
    nearly level, up in the drawing."""
    steep = np.hypot(*panel.pose[2, :2]) > np.sin(LEVEL)
    up = panel.pose[2, :2] if steep else panel.pose[:3, :2].T @ element.view[:, 1]
    return np.asarray(np.round(unit(up), 4) + 0.0)


def _middles(panel: HexagonPanel) -> FloatArray:
    """The middle (C, 3) of each side."""
    both = 0.5 * (panel.bottom + panel.top)
    return np.asarray(0.5 * (both + np.roll(both, -1, axis=0)))


def _outlines(element: HexagonElement, panels: tuple[HexagonPanel, ...]) -> list[FloatArray]:
    """Fronts (C, 2) [mm] as seen from the front, from the lower left corner of all."""
    rings = [(transform(panel.pose, panel.top) @ element.view)[:, :2] / MM for panel in panels]
    low = np.concatenate(rings).min(axis=0)
    return [ring - low for ring in rings]


def _count(element: HexagonElement, panels: tuple[HexagonPanel, ...]) -> tuple[Issue, ...]:
    got, asked = len(panels), element.wanted.count
    if got == asked:
        return ()
    least = element.wanted.least_width_mm
    what = f"{got} panels are as near to the {asked} asked as rows of quads over {least:g} mm wide come"
    hint = "nothing needs to be done; a smaller least_width_mm leaves more choice"
    field = "panels.hexagons.count"
    return (Issue("element.count", what, Severity.NOTE, field=field, value=got, limit=asked, hint=hint),)


def _concave(element: HexagonElement, panels: tuple[HexagonPanel, ...]) -> tuple[Issue, ...]:
    found = [panel.name for panel in panels if panel.concave]
    if not found:
        return ()
    quads = element.wanted.shape == "quad"
    why = "" if quads else ", as planar ones come out where a surface bends both ways or nearly in one"
    what = f"{len(found)} of {len(panels)} panels are concave{why}: {', '.join(found)}"
    hint = "a wire leaves their inner corners round: check these panels before foam is cut"
    if not quads:
        hint += ", or try shape: quad"
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
        DrawnPanel(panel.name, ring, panel.off / MM / limit, panel.concave)
        for panel, ring in zip(panels, _outlines(element, panels), strict=True)
    ]
    return panels_drawing(title, legend, drawn)
