"""Output of a divided element: problem files, table, drawing, and ``element.json`` with all data."""

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
from planner.element import dowels, unchanged
from planner.element.assembly import (
    FREE_INTERFERENCE_M,
    NEIGHBOUR_OFFSET_M,
    ElementAssembly,
    PanelBody,
    supporting_panels,
)
from planner.element.block_nesting import PanelBlock
from planner.element.elastic_panel import JOINT_PERCENTILE, ElasticJoint, ElasticPanel, find_joints
from planner.element.element_file import MIN_TOLERANCE_MM, ElasticElement, Element
from planner.element.jobs import block_mm, block_pose, choose_templates, cut_figures, elastic_ids, panel_files
from planner.element.nested_output import REPLACEMENT_FOLDER, nested_folder, panels_in_rows
from planner.element.surface import RIM_INSET_M
from planner.geometry.arrays import FloatArray, IntArray, transform
from planner.geometry.assembly import NONE, Slab, assemble, bodies_beyond
from planner.geometry.mesh import face_areas
from planner.geometry.rulings import boundary_rings
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity

OWNED_ENTRIES: Final = (
    "element.json",
    "element.3dm",
    "element.html",
    "element.obj",
    "labels.pdf",
    "labels.svg",
    "panels",
    "panels.csv",
    "panels.svg",
    REPLACEMENT_FOLDER,
    "blocks",
    "blocks.csv",
    "blocks.svg",
    dowels.DOWELS_FILE,
    "stock.csv",
    unchanged.MADE_FROM_FILE,
)
"""Entries of an element's folder that the command replaces. Anything else is left alone."""
GRID_STEP_M: Final = 0.0617
"""Maximum distance [m] of points of panel bodies for drawing and assembly.

Chosen: an odd number, so that no size is a multiple of it and the points move no more than the surface does.
"""
INSIDE_OFFSET_M: Final = 1e-7
"""Distance [m] inside the rim at which points on the rim are evaluated."""
_PAGE: Final = 1200.0  # width of the drawing [px]


def elastic_folder(
    element: ElasticElement, panels: tuple[ElasticPanel, ...]
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """Return all output files of an element of elastic panels as texts by name, and its issues.

    Issues are ``element.held`` for panels in whose shapes no wire is held safely, ``element.joint`` for
    joints beyond the allowed step, ``element.assembly`` for panels without an insertion path, ``element.cut``
    for cuts that no bow reaches.

    Raises:
        TandemError: ``element.jobs`` if not exactly one template matches a panel; ``element.raw_block`` if a
            block fits no raw block.
    """
    names = elastic_ids(panels)
    joints = find_joints(panels)
    files = panel_files(element, panels, names)
    panel_blocks = _panel_blocks(element, panels, names)
    element_assembly = elastic_assembly(element, panels, names)
    templates = choose_templates(element, panels, names)
    rows = [
        {**_row(element, panel, block), "job": template.file, **columns}
        for panel, block, template, columns in zip(
            panels, panel_blocks, templates, element_assembly.columns(), strict=True
        )
    ]
    files["panels.csv"] = table(rows)
    files["panels.svg"] = draw_elastic(element, panels, names)
    files["element.obj"] = element_assembly.obj()
    data = _data(element, panels, names, joints, rows, element_assembly)
    issues = (
        *_unheld_issues(element, panels, names),
        *_joint_issues(element, names, joints),
        *element_assembly.issues(FREE_INTERFERENCE_M),
    )
    return complete_output(element, files, data, panel_blocks, element_assembly, issues)


def complete_output(
    element: Element,
    files: dict[str, str],
    data: dict[str, Any],
    panels: Sequence[PanelBlock],
    up: ElementAssembly,
    issues: Sequence[Issue] = (),
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """Add raw blocks, dowels and ``element.json`` to the files of an element.

    Problems of panels that a row cuts are moved to the folder of replacements, and their entries in ``data``
    are modified. ``panels`` are the blocks of all panels, ``up`` is their assembly, ``issues`` those of the
    division.

    Returns:
        All files as texts by name, and all issues.

    Raises:
        TandemError: ``element.raw_block`` if a block fits no raw block.
    """
    block_files, block_issues, block_data = nested_folder(element, panels)
    files = {**files}
    dowel_data: dict[str, Any] = {}
    cut_in = panels_in_rows(block_data)
    for panel in data["panels"]:
        name = str(panel["id"])
        if name in cut_in:
            files[f"{REPLACEMENT_FOLDER}/{name}.yaml"] = files.pop(f"panels/{name}.yaml")
            panel |= {"cut_in": cut_in[name], "cut_min": {}, "cut_m": 0.0, "stops": 0}
    if element.file.dowels is not None:
        element_dowels = dowels.place_dowels(element.file.dowels, up)
        poses = {panel["id"]: block_pose(panel) for panel in data["panels"]}
        files[dowels.DOWELS_FILE] = table(element_dowels.rows(poses))
        dowel_data = {"dowels": element_dowels.data()}
        issues = (*issues, *element_dowels.issues())
    all_issues = (*element.notes, *issues, *block_issues)
    element_data = {**data, **block_data, **dowel_data, "issues": [issue.to_dict() for issue in all_issues]}
    return {**files, "element.json": json.dumps(element_data, indent=1) + "\n", **block_files}, all_issues


def elastic_assembly(
    element: ElasticElement, panels: tuple[ElasticPanel, ...], names: Sequence[str]
) -> ElementAssembly:
    """Return the assembly of an element of elastic panels, from the bottom of the drawing upward.

    A panel rests on the panels that end at the grid line where it starts.
    """
    bounds = np.array([np.concatenate(_bounds(element, panel)) for panel in panels]) * MM
    x, y = np.unique(bounds[:, :2]), np.unique(bounds[:, 2:])
    grids = [
        _grid_slab(panel, panel_bounds, x, y) for panel, panel_bounds in zip(panels, bounds, strict=True)
    ]
    beyond = bodies_beyond([grid.front[grid.rim, :2] for grid in grids], NEIGHBOUR_OFFSET_M)
    slabs = [
        dataclasses.replace(grid, beyond=neighbours) for grid, neighbours in zip(grids, beyond, strict=True)
    ]
    start_rank = np.unique(bounds[:, 2], return_inverse=True)[1]
    rests = [
        neighbours[bounds[neighbours, 3] < bounds[k, 2] + NEIGHBOUR_OFFSET_M]
        for k, neighbours in enumerate(supporting_panels(beyond, start_rank))
    ]
    up = np.array([0.0, 1.0, 0.0])
    steps = assemble(
        slabs, np.arange(len(panels)), rests, up, FREE_INTERFERENCE_M, dowels.max_dowel_tilt(element)
    )
    bodies = (
        PanelBody(name, _full_slab(panel), slab)
        for name, panel, slab in zip(names, panels, slabs, strict=True)
    )
    return ElementAssembly(tuple(bodies), steps, up)


def _interpolate(flat: FloatArray, faces: IntArray, values: FloatArray, positions: FloatArray) -> FloatArray:
    """Interpolate values (V, K) of a mesh linearly in its triangles at positions (N, 2) [m] in plan.

    The mesh has the vertices ``flat`` (V, 2) [m] in plan. Its own triangles ``faces`` (F, 3) are used,
    because they stay the same if the mesh moves a little. Raises ``ValueError`` if a position is outside of
    all triangles.
    """
    corners = flat[faces]
    tree, points = shapely.STRtree(shapely.polygons(corners)), shapely.points(positions)
    position_index, face = tree.query(points, predicate="intersects")
    order = np.lexsort((face, position_index))
    position_index, first = np.unique(position_index[order], return_index=True)
    face_of_position = np.full(len(positions), NONE)
    face_of_position[position_index] = face[order][first]
    uncovered = np.flatnonzero(face_of_position == NONE)
    covered, nearest = tree.query_nearest(
        points[uncovered], max_distance=2.0 * RIM_INSET_M, all_matches=False
    )
    if len(covered) < len(uncovered):
        raise ValueError("a panel does not lie over its rectangle")
    face_of_position[uncovered[covered]] = nearest
    first_corner, second_corner, third_corner = corners[face_of_position].transpose(1, 0, 2)
    sides = np.stack([second_corner - first_corner, third_corner - first_corner], axis=-1)
    weights = np.linalg.solve(sides, (positions - first_corner)[..., None])
    a, b, c = values[faces[face_of_position]].transpose(1, 0, 2)
    return np.asarray(a + weights[:, 0] * (b - a) + weights[:, 1] * (c - a))


def _full_slab(panel: ElasticPanel) -> Slab:
    """Return the body of a panel as its wire leaves it, in the element frame, without its neighbours."""
    front, back = (transform(panel.pose, face.vertices) for face in (panel.front, panel.back))
    rim = boundary_rings(panel.front)[0]
    return Slab(front, back, panel.front.faces, rim, np.full(len(rim), NONE))


def _grid_slab(panel: ElasticPanel, bounds: FloatArray, x: FloatArray, y: FloatArray) -> Slab:
    """Return the body of a panel with faces that are sampled on a grid, in the element frame.

    ``bounds`` is its rectangle x0, x1, y0, y1 [m]. The grid has lines at ``x`` and ``y`` [m], where other
    panels start or end. The bodies beyond its sides are not set.
    """
    lines = []
    for (low, high), cuts in zip(bounds.reshape(2, 2).tolist(), (x, y), strict=True):
        even = np.linspace(low, high, int(np.ceil((high - low) / GRID_STEP_M)) + 1)
        cuts = cuts[(cuts > low + NEIGHBOUR_OFFSET_M) & (cuts < high - NEIGHBOUR_OFFSET_M)]
        # drop even lines that nearly coincide with a cut
        even = even[np.abs(even[:, None] - cuts).min(axis=1, initial=np.inf) > 0.1 * GRID_STEP_M]
        lines.append(np.union1d(even, cuts))
    positions = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    front, back = (transform(panel.pose, face.vertices) for face in (panel.front, panel.back))
    inside = np.clip(positions, bounds[::2] + INSIDE_OFFSET_M, bounds[1::2] - INSIDE_OFFSET_M)
    points = _interpolate(
        front[:, :2], panel.front.faces, np.concatenate([front[:, 2:], back], axis=1), inside
    )
    number = np.arange(len(positions)).reshape([len(line) for line in lines])
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]).reshape(-1, 3)
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    return Slab(np.concatenate([positions, points[:, :1]], axis=1), points[:, 1:], faces, rim, rim)


def _panel_blocks(
    element: ElasticElement, panels: tuple[ElasticPanel, ...], names: tuple[str, ...]
) -> list[PanelBlock]:
    """Return the block of each panel.

    The volume of a panel is its thickness times the mean area of its faces. By Steiner's formula (J. Steiner,
    1840) the error is a term of the third power of the thickness.
    """
    out = []
    for panel, name in zip(panels, names, strict=True):
        faces = [float(face_areas(mesh).sum()) for mesh in (panel.front, panel.back)]
        length, width, height = (v * MM for v in block_mm(panel))
        volume = element.surface.thickness * 0.5 * sum(faces)
        out.append(PanelBlock(name, length, width, height, volume, element.file.blocks[panel.block].foam))
    return out


def _row(element: ElasticElement, panel: ElasticPanel, panel_block: PanelBlock) -> dict[str, Any]:
    """Return the row of a panel in ``panels.csv``, by columns."""
    x, y = _bounds(element, panel)
    wire = element.wires[panel.wire]
    block = element.file.blocks[panel.block]
    return {
        "id": panel_block.name,
        "from_x_mm": round(x[0], 3),
        "to_x_mm": round(x[1], 3),
        "from_y_mm": round(y[0], 3),
        "to_y_mm": round(y[1], 3),
        "wire_along": "xy"[panel.along],
        "wire": str(wire),
        **{f"block_{axis}_mm": v for axis, v in zip("xyz", block_mm(panel), strict=True)},
        "raw_block_mm": " x ".join(f"{v:g}" for v in block.size_mm),
        "wire_held": "yes" if panel.held else "no",
        "check": _check_result(element, panel),
        "off_surface_mm": round(panel.misfit / MM, 3),
        "volume_l": round(1e3 * panel_block.volume, 4),
        "weight_kg": weight_kg(panel_block),
    }


def weight_kg(panel_block: PanelBlock) -> float | str:
    """Return the weight of a panel [kg]; an empty text if its foam is not stated."""
    return "" if panel_block.foam is None else round(foam(panel_block.foam).density * panel_block.volume, 4)


def rectangle_outline(
    rectangles: Sequence[tuple[float, float, float, float]], names: Sequence[str], k: int
) -> tuple[list[tuple[float, float]], list[str | None]]:
    """Return the outline of the rectangle ``k``, with the corners of its neighbours that lie on its sides.

    ``rectangles`` (x0, x1, y0, y1) with ``names`` tile a plane.

    Returns:
        Corners, counterclockwise, and the name of the panel beyond each edge from corner i to i + 1.
    """
    x0, x1, y0, y1 = rectangles[k]
    corners: list[tuple[float, float]] = []
    beyond: list[str | None] = []
    for axis, at, first, last in ((1, y0, x0, x1), (0, x1, y0, y1), (1, y1, x1, x0), (0, x0, y1, y0)):
        neighbours = []
        for name, other in zip(names, rectangles, strict=True):
            low, high = other[2 - 2 * axis : 4 - 2 * axis]
            low, high = max(low, min(first, last)), min(high, max(first, last))
            # the other one is beyond a lower side if it ends there, beyond an upper side if it begins there
            facing = other[2 * axis + int(at == (x0, y0)[axis])]
            if low < high and facing == at:
                neighbours.append((low, high, name))
        stops = sorted(
            {first, last, *(end for neighbour in neighbours for end in neighbour[:2])}, reverse=first > last
        )
        for a, b in itertools.pairwise(stops):
            corners.append((a, at) if axis else (at, a))
            beyond.append(next((name for low, high, name in neighbours if low <= min(a, b) < high), None))
    return corners, beyond


def _check_result(element: ElasticElement, panel: ElasticPanel) -> str:
    """Return the result of the check of a panel's problem: ok, a code, or empty if it was not run."""
    if panel.refused is not None:
        return panel.refused.code
    return "ok" if element.are_panels_checked else ""


def _bounds(element: ElasticElement, panel: ElasticPanel) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ranges [mm] of a panel along the element's x and y."""
    step = element.surface.size / np.array(element.cells) / MM
    x0, x1, y0, y1 = panel.rectangle
    return (x0 * float(step[0]), x1 * float(step[0])), (y0 * float(step[1]), y1 * float(step[1]))


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return rows as CSV, with the keys of the first row as header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _step_mm(joint: ElasticJoint) -> float:
    """Return the step [mm] that `JOINT_PERCENTILE` percent of a joint's points do not exceed."""
    return joint.step / MM


def _data(
    element: ElasticElement,
    panels: tuple[ElasticPanel, ...],
    names: tuple[str, ...],
    joints: tuple[ElasticJoint, ...],
    rows: list[dict[str, Any]],
    element_assembly: ElementAssembly,
) -> dict[str, Any]:
    """Return the data of ``element.json``.

    Poses are (4, 4) in mm: that of the element in the frame of the surface's file, and those of blocks in the
    element frame.
    """

    def pose(value: Any) -> list[list[float]]:
        out = np.array(value)
        out[:3, 3] /= MM
        return [[round(float(v), 9) + 0.0 for v in row] for row in out]

    step = element.surface.size / np.array(element.cells) / MM
    rectangles = [panel.rectangle for panel in panels]
    templates = choose_templates(element, panels, names)
    outlines = [rectangle_outline(rectangles, names, k) for k in range(len(panels))]

    def cut_length(panel: ElasticPanel, operation: Mapping[str, Any]) -> float:
        """Return the cut length [mm] of an operation: the length of the sweep, once for each face."""
        is_elastic = operation.get("process") == "elastic_wire"
        return block_mm(panel)[1] * len(operation.get("faces") or ("front", "back")) if is_elastic else 0.0

    steps = [
        {
            "panels": [names[joint.panels[0]], names[joint.panels[1]]],
            "length_mm": round(joint.length / MM, 3),
            "step_95_mm": round(_step_mm(joint), 4),
            "step_largest_mm": round(float(joint.steps.max()) / MM, 4),
            "at_wire_ends": joint.wire_ends,
        }
        for joint in joints
    ]
    return {
        "element": 1,
        "name": element.file.name,
        "pose": pose(element.surface.pose),
        "size_mm": [round(float(v) / MM, 3) for v in element.surface.size],
        "up": element_assembly.up.tolist(),
        "cells": list(element.cells),
        "tolerance_mm": element.options.tolerance_mm,
        "joint_mm": element.options.joint_mm,
        "panels": [
            {
                **row,
                **body_data,
                "cells": list(panel.rectangle),
                "neighbours": beyond,
                "outline_mm": np.round(np.array(ring) * step, 2).tolist(),
                **cut_figures(template, functools.partial(cut_length, panel)),
                "block_pose": pose(panel.pose),
            }
            for row, panel, template, (ring, beyond), body_data in zip(
                rows, panels, templates, outlines, element_assembly.data(), strict=True
            )
        ],
        "joints": steps,
    }


def _joint_issues(
    element: ElasticElement, names: tuple[str, ...], joints: tuple[ElasticJoint, ...]
) -> Iterator[Issue]:
    """Yield one ``element.joint`` that lists the joints whose step exceeds the limit, if any."""
    limit = element.options.joint_mm
    over = [joint for joint in joints if _step_mm(joint) > limit]
    if not over:
        return
    worst = max(over, key=_step_mm)
    a, b = (names[i] for i in worst.panels)
    text = (
        f"{len(over)} of {len(joints)} joints have a step above {limit:g} mm at {JOINT_PERCENTILE:g} % of "
        f"their points, the worst is {a} to {b} with {_step_mm(worst):.2f} mm; the others: "
        + (
            ", ".join(
                f"{names[joint.panels[0]]} to {names[joint.panels[1]]}"
                for joint in over
                if joint is not worst
            )
            or "none"
        )
    )
    hint = f"allow joint_mm: {np.ceil(_step_mm(worst) * 100.0) / 100.0:.2f}"
    if 0.5 * limit >= MIN_TOLERANCE_MM:  # a step is no larger than both panels are off the surface
        hint += f", or set tolerance_mm: {0.5 * limit:g}, which needs more panels and may need more cells"
    yield Issue(
        "element.joint",
        text,
        Severity.WARNING,
        field="panels.elastic.joint_mm",
        **measurement(_step_mm(worst), limit, "mm"),
        hint=hint,
    )


def _unheld_issues(
    element: ElasticElement, panels: tuple[ElasticPanel, ...], names: tuple[str, ...]
) -> Iterator[Issue]:
    """Yield one ``element.held`` that lists the panels that probably cannot be cut, if any.

    These are panels that the check refuses but no division avoids. Without a check, they are those in whose
    shapes no wire is held safely.
    """
    named_panels = tuple(zip(panels, names, strict=True))
    if element.are_panels_checked:
        names_found = [
            f"{name} ({panel.refused.code})" for panel, name in named_panels if panel.refused is not None
        ]
        problem = "are refused by the check of their problems, and no division avoids them"
    else:
        names_found = [name for panel, name in named_panels if not panel.held]
        problem = "have shapes in which no wire is held safely (it may snap, or errors of its ends may "
        problem += "displace it too far)"
    if not names_found:
        return
    hint = "give wires of more lengths or thinner ones, or smaller blocks; check these panels first"
    message = format_message(
        "element.held",
        affected_count=len(names_found),
        panel_count=len(panels),
        problem=problem,
        panels=", ".join(names_found),
    )
    yield Issue("element.held", message, Severity.WARNING, field="wires", hint=hint)


def draw_elastic(element: ElasticElement, panels: tuple[ElasticPanel, ...], names: tuple[str, ...]) -> str:
    """Draw all panels in the element plane, seen from the front, and return the text of the SVG file."""
    size = element.surface.size / MM
    scale = _PAGE / float(size[0])
    height = float(size[1]) * scale
    limit = element.options.tolerance_mm
    max_misfit = max(panel.misfit for panel in panels) / MM
    title = f"{element.file.name}: {len(panels)} panels"
    legend = "seen from the front; lines show the direction of the wire; numbers are the deviation from the "
    legend += f"surface, at most {max_misfit:.2f} of {limit:g} mm"
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-70 -90 {_PAGE + 110:.0f} {height + 170:.0f}" '
        'font-family="sans-serif" fill="#1a1a1a">',
        f'<rect x="-70" y="-90" width="{_PAGE + 110:.0f}" height="{height + 170:.0f}" fill="#ffffff"/>',
        f'<text x="0" y="-52" font-size="28" font-weight="600">{title}</text>',
        f'<text x="0" y="-20" font-size="18">{legend}</text>',
    ]
    for panel, name in zip(panels, names, strict=True):
        (x0, x1), (y0, y1) = _bounds(element, panel)
        left, right, top, bottom = x0 * scale, x1 * scale, height - y1 * scale, height - y0 * scale
        fraction = min(panel.misfit / MM / limit, 1.0)
        shade = [round(255 + fraction * (channel - 255)) for channel in (122, 170, 214)]
        centre_x, centre_y = 0.5 * (left + right), 0.5 * (top + bottom)
        out.append(
            f'<rect x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{bottom - top:.1f}" '
            f'fill="rgb({shade[0]},{shade[1]},{shade[2]})" stroke="#1a1a1a" stroke-width="1.5"/>'
        )
        for position in (0.12, 0.88):
            x, y = left + position * (right - left), top + position * (bottom - top)
            ends = (left + 8, y, right - 8, y) if panel.along == 0 else (x, top + 8, x, bottom - 8)
            points = " ".join(
                f'{key}="{v:.1f}"' for key, v in zip(("x1", "y1", "x2", "y2"), ends, strict=True)
            )
            out.append(f'<line {points} stroke="#5a6b7a" stroke-width="1"/>')
        font = min(26.0, 0.3 * (right - left), 0.3 * (bottom - top))
        out.append(
            f'<text x="{centre_x:.1f}" y="{centre_y:.1f}" font-size="{font:.1f}" font-weight="600" '
            f'text-anchor="middle">{name}</text>'
            f'<text x="{centre_x:.1f}" y="{centre_y + 0.85 * font:.1f}" font-size="{0.6 * font:.1f}" '
            f'text-anchor="middle">{panel.misfit / MM:.2f}</text>'
        )
    below, extent = f"{height + 34:.0f}", f"x {size[0]:.0f} mm"
    out += [
        f'<text x="0" y="{below}" font-size="18">x 0</text>',
        f'<text x="{_PAGE:.0f}" y="{below}" font-size="18" text-anchor="end">{extent}</text>',
        f'<text x="-12" y="{height:.0f}" font-size="18" text-anchor="end">y 0</text>',
        f'<text x="-12" y="18" font-size="18" text-anchor="end">{size[1]:.0f}</text>',
        "</svg>",
    ]
    return "\n".join(out) + "\n"
