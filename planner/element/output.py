"""What a divided element leaves in a folder: problems, a table and a drawing of its panels, and all of it as
data."""

import csv
import dataclasses
import functools
import io
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import shapely

from planner.catalogue.materials import foam
from planner.element import dowels, kept
from planner.element.assembly import BESIDE, GIVE, Assembly, Body, rests_on
from planner.element.elastic_panel import JOINT_SHARE, ElasticPanel, Joint, joints
from planner.element.element_file import LEAST_TOLERANCE_MM, ElasticElement, Element
from planner.element.jobs import block_mm, block_pose, chosen_templates, cut_figures, ids, panel_files
from planner.element.nest import PanelBlock
from planner.element.nested_output import AGAIN, nested_folder, rows_in
from planner.element.surface import RIM
from planner.geometry.arrays import FloatArray, IntArray, transform
from planner.geometry.assembly import NONE, Slab, bodies_beyond, put_up
from planner.geometry.mesh import face_areas
from planner.geometry.rulings import boundaries
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity

OWNED: Final = (
    "element.json",
    "element.3dm",
    "element.html",
    "element.obj",
    "labels.pdf",
    "labels.svg",
    "panels",
    "panels.csv",
    "panels.svg",
    AGAIN,
    "blocks",
    "blocks.csv",
    "blocks.svg",
    dowels.FILE,
    "stock.csv",
    kept.FILE,
)
"""What the folder of an element holds; anything else in it is left alone."""
GRID: Final = 0.0617
"""Largest distance [m] of points by which the bodies of panels are drawn and put up; an odd number on
purpose: no size is a multiple of it, so these points move no more than the surface does."""
INSIDE: Final = 1e-7
"""Points on the rim are looked for this far [m] inside of it."""
_PAGE: Final = 1200.0  # width of the drawing [px]


def folder(
    element: ElasticElement, panels: tuple[ElasticPanel, ...]
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """All files by their names, and what is to be said: ``element.held`` for panels in whose shapes no wire
    is safe, ``element.joint`` for joints beyond the step asked, ``element.assembly`` for panels without a way
    in, ``element.cut`` for cuts that no bow reaches.

    Raises ``TandemError``: ``element.jobs``, ``element.raw_block``.
    """
    names = ids(panels)
    met = joints(panels)
    files = panel_files(element, panels, names)
    own = _panel_blocks(element, panels, names)
    up = assembly(element, panels, names)
    templates = chosen_templates(element, panels, names)
    rows = [
        {**_row(element, panel, block), "job": template.file, **columns}
        for panel, block, template, columns in zip(panels, own, templates, up.columns(), strict=True)
    ]
    files["panels.csv"] = table(rows)
    files["panels.svg"] = drawing(element, panels, names)
    files["element.obj"] = up.obj()
    data = _data(element, panels, names, met, rows, up)
    issues = (*_unsteady(element, panels, names), *_told(element, names, met), *up.issues(GIVE))
    return finished(element, files, data, own, up, issues)


def finished(
    element: Element,
    files: dict[str, str],
    data: dict[str, Any],
    panels: Sequence[PanelBlock],
    up: Assembly,
    issues: Sequence[Issue] = (),
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """An element's ``files``, those of its nest and of its dowels, and ``element.json`` with its ``data``,
    nest, dowels and issues; and all that is to be said. Raises ``TandemError``: ``element.raw_block``."""
    of_blocks, said, blocks = nested_folder(element, panels)
    files, more = {**files}, {}
    cut_in = rows_in(blocks)
    for panel in data["panels"]:
        name = str(panel["id"])
        if name in cut_in:
            files[f"{AGAIN}/{name}.yaml"] = files.pop(f"panels/{name}.yaml")
            panel |= {"cut_in": cut_in[name], "cut_min": {}, "cut_m": 0.0, "stops": 0}
    if element.file.dowels is not None:
        held = dowels.placed(element.file.dowels, up)
        poses = {panel["id"]: block_pose(panel) for panel in data["panels"]}
        files[dowels.FILE] = table(held.rows(poses))
        more = {"dowels": held.data()}
        issues = (*issues, *held.issues())
    told = (*element.notes, *issues, *said)
    whole = {**data, **blocks, **more, "issues": [issue.to_dict() for issue in told]}
    return {**files, "element.json": json.dumps(whole, indent=1) + "\n", **of_blocks}, told


def assembly(element: ElasticElement, panels: tuple[ElasticPanel, ...], names: Sequence[str]) -> Assembly:
    """How a free-form element is put up: by its lines, from below in the drawing; a panel rests on those on
    the line where it begins."""
    bounds = np.array([np.concatenate(_bounds(element, panel)) for panel in panels]) * MM
    x, y = np.unique(bounds[:, :2]), np.unique(bounds[:, 2:])
    grids = [_grid(panel, own, x, y) for panel, own in zip(panels, bounds, strict=True)]
    beyond = bodies_beyond([grid.front[grid.rim, :2] for grid in grids], BESIDE)
    slabs = [dataclasses.replace(grid, beyond=one) for grid, one in zip(grids, beyond, strict=True)]
    begins = np.unique(bounds[:, 2], return_inverse=True)[1]
    rests = [one[bounds[one, 3] < bounds[k, 2] + BESIDE] for k, one in enumerate(rests_on(beyond, begins))]
    up = np.array([0.0, 1.0, 0.0])
    steps = put_up(slabs, np.arange(len(panels)), rests, up, GIVE, dowels.square(element))
    bodies = (Body(n, _whole(p), s) for n, p, s in zip(names, panels, slabs, strict=True))
    return Assembly(tuple(bodies), steps, up)


def _over(flat: FloatArray, faces: IntArray, values: FloatArray, places: FloatArray) -> FloatArray:
    """Values (V, K) of a mesh over the plane, with vertices ``flat`` (V, 2), at places (N, 2) in it: by its
    own triangles, which stay the same where it moves a little."""
    corners = flat[faces]
    tree, points = shapely.STRtree(shapely.polygons(corners)), shapely.points(places)
    at, face = tree.query(points, predicate="intersects")
    order = np.lexsort((face, at))
    at, first = np.unique(at[order], return_index=True)
    own = np.full(len(places), NONE)
    own[at] = face[order][first]
    bare = np.flatnonzero(own == NONE)
    found, near = tree.query_nearest(points[bare], max_distance=2.0 * RIM, all_matches=False)
    if len(found) < len(bare):
        raise ValueError("a panel does not lie over its rectangle")
    own[bare[found]] = near
    first_corner, one, two = corners[own].transpose(1, 0, 2)
    sides = np.stack([one - first_corner, two - first_corner], axis=-1)
    share = np.linalg.solve(sides, (places - first_corner)[..., None])
    a, b, c = values[faces[own]].transpose(1, 0, 2)
    return np.asarray(a + share[:, 0] * (b - a) + share[:, 1] * (c - a))


def _whole(panel: ElasticPanel) -> Slab:
    """A panel with the faces that its wire leaves."""
    front, back = (transform(panel.pose, face.vertices) for face in (panel.front, panel.back))
    rim = boundaries(panel.front)[0]
    return Slab(front, back, panel.front.faces, rim, np.full(len(rim), NONE))


def _grid(panel: ElasticPanel, bounds: FloatArray, x: FloatArray, y: FloatArray) -> Slab:
    """A panel over x0, x1, y0, y1 of the element's plane [m], its faces between points on a grid, with lines
    at those of ``x`` and ``y`` on which others begin or end."""
    lines = []
    for (low, high), cuts in zip(bounds.reshape(2, 2).tolist(), (x, y), strict=True):
        even = np.linspace(low, high, int(np.ceil((high - low) / GRID)) + 1)
        cuts = cuts[(cuts > low + BESIDE) & (cuts < high - BESIDE)]
        even = even[np.abs(even[:, None] - cuts).min(axis=1, initial=np.inf) > 0.1 * GRID]
        lines.append(np.union1d(even, cuts))
    places = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    front, back = (transform(panel.pose, face.vertices) for face in (panel.front, panel.back))
    inside = np.clip(places, bounds[::2] + INSIDE, bounds[1::2] - INSIDE)
    points = _over(front[:, :2], panel.front.faces, np.concatenate([front[:, 2:], back], axis=1), inside)
    number = np.arange(len(places)).reshape([len(one) for one in lines])
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]).reshape(-1, 3)
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    return Slab(np.concatenate([places, points[:, :1]], axis=1), points[:, 1:], faces, rim, rim)


def _panel_blocks(
    element: ElasticElement, panels: tuple[ElasticPanel, ...], names: tuple[str, ...]
) -> list[PanelBlock]:
    """The blocks that panels are cut from; a panel's volume is its thickness times the mean of its faces'
    areas (J. Steiner, 1840, but for a term of the third power of the thickness)."""
    out = []
    for panel, name in zip(panels, names, strict=True):
        faces = [float(face_areas(mesh).sum()) for mesh in (panel.front, panel.back)]
        length, width, high = (v * MM for v in block_mm(panel))
        volume = element.surface.thickness * 0.5 * sum(faces)
        out.append(PanelBlock(name, length, width, high, volume, element.file.blocks[panel.block].foam))
    return out


def _row(element: ElasticElement, panel: ElasticPanel, own: PanelBlock) -> dict[str, Any]:
    x, y = _bounds(element, panel)
    wire = element.wires[panel.wire]
    block = element.file.blocks[panel.block]
    return {
        "id": own.name,
        "from_x_mm": round(x[0], 3),
        "to_x_mm": round(x[1], 3),
        "from_y_mm": round(y[0], 3),
        "to_y_mm": round(y[1], 3),
        "wire_along": "xy"[panel.along],
        "wire": str(wire),
        **{f"block_{axis}_mm": v for axis, v in zip("xyz", block_mm(panel), strict=True)},
        "raw_block_mm": " x ".join(f"{v:g}" for v in block.size_mm),
        "wire_held": "yes" if panel.held else "no",
        "check": _checked(element, panel),
        "off_surface_mm": round(panel.misfit / MM, 3),
        "volume_l": round(1e3 * own.volume, 4),
        "weight_kg": weight_kg(own),
    }


def weight_kg(own: PanelBlock) -> float | str:
    """What a panel weighs, nothing where its foam is not named."""
    return "" if own.foam is None else round(foam(own.foam).density * own.volume, 4)


def outline(
    rectangles: Sequence[tuple[float, float, float, float]], names: Sequence[str], k: int
) -> tuple[list[tuple[float, float]], list[str | None]]:
    """The corners of one of the rectangles (x0, x1, y0, y1), counterclockwise, with those of its neighbours
    on its sides, and the name beyond each edge from corner i to i + 1."""
    x0, x1, y0, y1 = rectangles[k]
    corners: list[tuple[float, float]] = []
    beyond: list[str | None] = []
    for axis, at, first, last in ((1, y0, x0, x1), (0, x1, y0, y1), (1, y1, x1, x0), (0, x0, y1, y0)):
        beside = []
        for name, one in zip(names, rectangles, strict=True):
            low, high = one[2 - 2 * axis : 4 - 2 * axis]
            low, high = max(low, min(first, last)), min(high, max(first, last))
            facing = one[2 * axis + int(at == (x0, y0)[axis])]  # where the other one ends, or begins
            if low < high and facing == at:
                beside.append((low, high, name))
        stops = sorted({first, last, *(v for b in beside for v in b[:2])}, reverse=first > last)
        for a, b in itertools.pairwise(stops):
            corners.append((a, at) if axis else (at, a))
            beyond.append(next((name for low, high, name in beside if low <= min(a, b) < high), None))
    return corners, beyond


def _checked(element: ElasticElement, panel: ElasticPanel) -> str:
    """What the check of a panel's problem said: ok, a code, or nothing where it was not asked."""
    if panel.refused is not None:
        return panel.refused.code
    return "ok" if element.judged else ""


def _bounds(element: ElasticElement, panel: ElasticPanel) -> tuple[tuple[float, float], tuple[float, float]]:
    """From and to along the element's x and y [mm]."""
    step = element.surface.size / np.array(element.cells) / MM
    x0, x1, y0, y1 = panel.rectangle
    return (x0 * float(step[0]), x1 * float(step[0])), (y0 * float(step[1]), y1 * float(step[1]))


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows as CSV, their names first."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _step(joint: Joint) -> float:
    """The step [mm] that most of a joint's points keep."""
    return joint.step / MM


def _data(
    element: ElasticElement,
    panels: tuple[ElasticPanel, ...],
    names: tuple[str, ...],
    met: tuple[Joint, ...],
    rows: list[dict[str, Any]],
    up: Assembly,
) -> dict[str, Any]:
    """The element as data; poses are (4, 4) in mm, of the element in the surface's file and of blocks in the
    element."""

    def pose(value: Any) -> list[list[float]]:
        out = np.array(value)
        out[:3, 3] /= MM
        return [[round(float(v), 9) + 0.0 for v in row] for row in out]

    step = element.surface.size / np.array(element.cells) / MM
    rectangles = [panel.rectangle for panel in panels]
    templates = chosen_templates(element, panels, names)
    around = [outline(rectangles, names, k) for k in range(len(panels))]

    def way(panel: ElasticPanel, operation: Mapping[str, Any]) -> float:
        """How far the wire goes [mm]: along the block, once for each face."""
        of_wire = operation.get("process") == "elastic_wire"
        return block_mm(panel)[1] * len(operation.get("faces") or ("front", "back")) if of_wire else 0.0

    steps = [
        {
            "panels": [names[joint.panels[0]], names[joint.panels[1]]],
            "length_mm": round(joint.length / MM, 3),
            "step_95_mm": round(_step(joint), 4),
            "step_largest_mm": round(float(joint.steps.max()) / MM, 4),
            "at_wire_ends": joint.wire_ends,
        }
        for joint in met
    ]
    return {
        "element": 1,
        "name": element.file.name,
        "pose": pose(element.surface.pose),
        "size_mm": [round(float(v) / MM, 3) for v in element.surface.size],
        "up": up.up.tolist(),
        "cells": list(element.cells),
        "tolerance_mm": element.wanted.tolerance_mm,
        "joint_mm": element.wanted.joint_mm,
        "panels": [
            {
                **row,
                **stands,
                "cells": list(panel.rectangle),
                "neighbours": beyond,
                "outline_mm": np.round(np.array(ring) * step, 2).tolist(),
                **cut_figures(template, functools.partial(way, panel)),
                "block_pose": pose(panel.pose),
            }
            for row, panel, template, (ring, beyond), stands in zip(
                rows, panels, templates, around, up.data(), strict=True
            )
        ],
        "joints": steps,
    }


def _told(element: ElasticElement, names: tuple[str, ...], met: tuple[Joint, ...]) -> Iterator[Issue]:
    limit = element.wanted.joint_mm
    over = [joint for joint in met if _step(joint) > limit]
    if not over:
        return
    worst = max(over, key=_step)
    a, b = (names[i] for i in worst.panels)
    what = (
        f"{len(over)} of {len(met)} joints have a step above {limit:g} mm at {JOINT_SHARE:g} % of their "
        f"points, the worst is {a} to {b} with {_step(worst):.2f} mm; the others: "
        + (
            ", ".join(f"{names[j.panels[0]]} to {names[j.panels[1]]}" for j in over if j is not worst)
            or "none"
        )
    )
    hint = f"allow joint_mm: {np.ceil(_step(worst) * 100.0) / 100.0:.2f}"
    if 0.5 * limit >= LEAST_TOLERANCE_MM:  # a step is no larger than both panels are off the surface
        hint += f", or ask for tolerance_mm: {0.5 * limit:g}, which takes more panels and may take more cells"
    yield Issue(
        "element.joint",
        what,
        Severity.WARNING,
        field="panels.elastic.joint_mm",
        **measurement(_step(worst), limit, "mm"),
        hint=hint,
    )


def _unsteady(
    element: ElasticElement, panels: tuple[ElasticPanel, ...], names: tuple[str, ...]
) -> Iterator[Issue]:
    """Panels that cannot be cut as they are, named before any foam is: those that the check refuses although
    nothing else covers their place; where it was not asked, those in whose shapes no wire is held safely."""
    own = tuple(zip(panels, names, strict=True))
    if element.judged:
        found = [f"{name} ({panel.refused.code})" for panel, name in own if panel.refused is not None]
        what = "are refused by the check of their problems, and no other division avoids them"
    else:
        found = [name for panel, name in own if not panel.held]
        what = "have shapes in which none of the wires is held safely (it may snap, or errors of its ends "
        what += "move it too far)"
    if not found:
        return
    hint = "give wires of more lengths or thinner ones, or smaller blocks; check these panels first"
    message = f"{len(found)} of {len(panels)} panels {what}: {', '.join(found)}"
    yield Issue("element.held", message, Severity.WARNING, field="wires", hint=hint)


def drawing(element: ElasticElement, panels: tuple[ElasticPanel, ...], names: tuple[str, ...]) -> str:
    """All panels in the element's plane, seen from the front: ids, the wire's direction, how far off."""
    size = element.surface.size / MM
    scale = _PAGE / float(size[0])
    high = float(size[1]) * scale
    limit = element.wanted.tolerance_mm
    worst = max(panel.misfit for panel in panels) / MM
    title = f"{element.file.name}: {len(panels)} panels"
    legend = "seen from the front; lines in a panel lie as its wire does; numbers are how far it is off the "
    legend += f"surface, at most {worst:.2f} of {limit:g} mm"
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-70 -90 {_PAGE + 110:.0f} {high + 170:.0f}" '
        'font-family="sans-serif" fill="#1a1a1a">',
        f'<rect x="-70" y="-90" width="{_PAGE + 110:.0f}" height="{high + 170:.0f}" fill="#ffffff"/>',
        f'<text x="0" y="-52" font-size="28" font-weight="600">{title}</text>',
        f'<text x="0" y="-20" font-size="18">{legend}</text>',
    ]
    for panel, name in zip(panels, names, strict=True):
        (x0, x1), (y0, y1) = _bounds(element, panel)
        left, right, top, bottom = x0 * scale, x1 * scale, high - y1 * scale, high - y0 * scale
        share = min(panel.misfit / MM / limit, 1.0)
        shade = [round(255 + share * (c - 255)) for c in (122, 170, 214)]
        middle, level = 0.5 * (left + right), 0.5 * (top + bottom)
        out.append(
            f'<rect x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{bottom - top:.1f}" '
            f'fill="rgb({shade[0]},{shade[1]},{shade[2]})" stroke="#1a1a1a" stroke-width="1.5"/>'
        )
        for part in (0.12, 0.88):
            x, y = left + part * (right - left), top + part * (bottom - top)
            a = (left + 8, y, right - 8, y) if panel.along == 0 else (x, top + 8, x, bottom - 8)
            ends = " ".join(f'{k}="{v:.1f}"' for k, v in zip(("x1", "y1", "x2", "y2"), a, strict=True))
            out.append(f'<line {ends} stroke="#5a6b7a" stroke-width="1"/>')
        text = min(26.0, 0.3 * (right - left), 0.3 * (bottom - top))
        out.append(
            f'<text x="{middle:.1f}" y="{level:.1f}" font-size="{text:.1f}" font-weight="600" '
            f'text-anchor="middle">{name}</text>'
            f'<text x="{middle:.1f}" y="{level + 0.85 * text:.1f}" font-size="{0.6 * text:.1f}" '
            f'text-anchor="middle">{panel.misfit / MM:.2f}</text>'
        )
    below, extent = f"{high + 34:.0f}", f"x {size[0]:.0f} mm"
    out += [
        f'<text x="0" y="{below}" font-size="18">x 0</text>',
        f'<text x="{_PAGE:.0f}" y="{below}" font-size="18" text-anchor="end">{extent}</text>',
        f'<text x="-12" y="{high:.0f}" font-size="18" text-anchor="end">y 0</text>',
        f'<text x="-12" y="18" font-size="18" text-anchor="end">{size[1]:.0f}</text>',
        "</svg>",
    ]
    return "\n".join(out) + "\n"
