"""Output of a shell of hexagons: problems, table and drawing of its panels, and all as data."""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from planner.element.assembly import ElementAssembly, PanelBody, ring_slab, supporting_panels
from planner.element.block_nesting import PanelBlock
from planner.element.dowels import max_dowel_tilt
from planner.element.element_file import HexagonElement, JobTemplate
from planner.element.hexagons import HexagonPanel
from planner.element.jobs import (
    block_mm,
    choose_templates,
    cut_figures,
    panel_problem,
    pose_to_mm,
    problem_text,
    ruled_surface,
)
from planner.element.output import complete_output, table, weight_kg
from planner.element.panel_drawing import DrawnPanel, draw_panels
from planner.element.rows import PanelShape
from planner.geometry.arrays import FloatArray, transform, unit
from planner.geometry.assembly import CONTACT_TOLERANCE_M, NONE, assemble
from planner.geometry.units import DEG, MM
from planner.issue_codes import format_message
from planner.issues import Issue, Severity

MIN_TILT_RAD: Final = 5.0 * DEG
"""Minimum tilt [rad] of panels whose up direction follows from their pose; others use that of the drawing."""
CORNER_TOLERANCE_M: Final = 1e-6
"""Maximum distance [m] of corners of fronts that count as the same corner."""
RING_DIGITS: Final = 6
"""Decimals of outlines in mm in ``element.json``; the files of panels have more."""


def hexagon_folder(
    element: HexagonElement, panels: tuple[HexagonPanel, ...]
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """Return all output files of a shell as texts by name, and its issues.

    Issues are ``element.count`` for a count that differs from the requested one, ``element.concave`` for
    panels with inner corners, ``element.assembly`` for panels without an insertion path, ``element.cut`` for
    cuts of raw blocks that no bow reaches.

    Raises:
        TandemError: ``element.jobs`` if not exactly one template matches a panel; ``element.raw_block`` if a
            block fits no raw block.
    """
    names = [panel.name for panel in panels]
    templates = choose_templates(element, panels, names)
    panel_blocks = [_panel_block(element, panel) for panel in panels]
    element_assembly = assembly(panels, max_dowel_tilt(element))
    rows = [
        {
            **table_row(element, panel, block, panel_template.file),
            "backs_apart_mm": round(back_gap / MM, 3) + 0.0,
            **columns,
        }
        for panel, block, panel_template, back_gap, columns in zip(
            panels,
            panel_blocks,
            templates,
            back_gaps(panels).tolist(),
            element_assembly.columns(),
            strict=True,
        )
    ]
    files = {}
    for panel, template in zip(panels, templates, strict=True):
        problem_data = panel_problem(element, panel, panel.name, template, _part(panel))
        files[f"panels/{panel.name}.yaml"] = problem_text(element, panel.name, problem_data)
    files["panels.csv"] = table(rows)
    files["panels.svg"] = draw_hexagons(element, panels)
    files["element.obj"] = element_assembly.obj()
    data = _data(element, panels, rows, templates, element_assembly)
    issues = (
        *_count_issues(element, panels),
        *_concave_issues(element, panels),
        *element_assembly.issues(CONTACT_TOLERANCE_M),
    )
    return complete_output(element, files, data, panel_blocks, element_assembly, issues)


def back_gaps(panels: Sequence[HexagonPanel]) -> FloatArray:
    """Return the maximum gap (P,) [m] between the back of each panel and those of its neighbours, at corners.

    Only inner corners count, which are those that are not on the rim.

    Three planes offset by one thickness have a common point. Where four panels meet, their backs end at
    different heights of the line through the corner.
    """
    owners, fronts, backs = [], [], []
    for k, panel in enumerate(panels):
        inner_corners = [i for i, name in enumerate(panel.beyond) if name and panel.beyond[i - 1]]
        owners += [k] * len(inner_corners)
        fronts.append(transform(panel.pose, panel.top[inner_corners]))
        backs.append(transform(panel.pose, panel.bottom[inner_corners]))
    owner, back = np.array(owners, dtype=np.intp), np.concatenate(backs)
    first, second = cKDTree(np.concatenate(fronts)).query_pairs(CORNER_TOLERANCE_M, output_type="ndarray").T
    gaps = np.linalg.norm(back[first] - back[second], axis=1)
    max_gaps = np.zeros(len(panels))
    for side in (first, second):
        np.maximum.at(max_gaps, owner[side], gaps)
    return max_gaps


def assembly(panels: tuple[HexagonPanel, ...], square: float | None = None) -> ElementAssembly:
    """Return the assembly of a shell, row by row, whatever its groups are.

    Sides are planes, so no interference is allowed. ``square`` is the ``max_square_angle`` [rad] of
    :func:`planner.geometry.assembly.assemble`; None without dowels.
    """
    number = {panel.name: k for k, panel in enumerate(panels)}
    bodies = []
    for panel in panels:
        front, back = (transform(panel.pose, ring) for ring in (panel.top, panel.bottom))
        beyond = np.array([number.get(name, NONE) for name in panel.beyond])
        slab = ring_slab(front, back, panel.top[:, :2], beyond)
        bodies.append(PanelBody(panel.name, slab, slab))
    row = np.array([panel.row for panel in panels])
    slabs = [body.whole for body in bodies]
    rests = supporting_panels([slab.beyond for slab in slabs], row)
    up = np.array([0.0, 0.0, 1.0])
    return ElementAssembly(tuple(bodies), assemble(slabs, row, rests, up, CONTACT_TOLERANCE_M, square), up)


def _panel_block(element: HexagonElement, panel: HexagonPanel) -> PanelBlock:
    length, width, height = (v * MM for v in block_mm(panel))
    foam = element.file.blocks[panel.block].foam
    shape = PanelShape(np.stack([panel.bottom, panel.top]))
    return PanelBlock(panel.name, length, width, height, panel.volume, foam, shape)


def _part(panel: HexagonPanel) -> dict[str, Any]:
    """Return the part of the problem file: a ruled surface between the outlines of back and front."""
    return {"ruled": [ruled_surface("sides", panel.bottom, panel.top, closed=True)]}


def table_row(
    element: HexagonElement, panel: HexagonPanel, panel_block: PanelBlock, template: str
) -> dict[str, Any]:
    """Return the row of a panel in ``panels.csv``, by columns.

    Texts with several values have one for each side, in order: the lengths of its edges in front and at the
    back, the angle at its first corner, its outward tilt from back to front, and the panel beyond.
    """
    block = element.file.blocks[panel.block]
    return {
        "id": panel.name,
        "sides": len(panel.top),
        "front_edges_mm": _format_values(_edges(panel.top) / MM, 3),
        "back_edges_mm": _format_values(_edges(panel.bottom) / MM, 3),
        "corners_deg": _format_values(_corner_angles(panel.top) / DEG, 3),
        "leans_deg": _format_values(side_tilts(panel) / DEG, 3),
        "neighbours": " ".join(neighbour or "-" for neighbour in panel.beyond),
        **{f"block_{axis}_mm": v for axis, v in zip("xyz", block_mm(panel), strict=True)},
        "raw_block_mm": " x ".join(f"{v:g}" for v in block.size_mm),
        "volume_l": round(1e3 * panel.volume, 4),
        "weight_kg": weight_kg(panel_block),
        "off_surface_mm": round(panel.deviation / MM, 3),
        "concave": "yes" if panel.concave else "no",
        "job": template,
    }


def _format_values(values: FloatArray, digits: int) -> str:
    return " ".join(f"{v:.{digits}f}" for v in values.tolist())


def _edges(ring: FloatArray) -> FloatArray:
    """Return the lengths (C,) of the edges of a closed outline (C, D), from each corner to the next one."""
    return np.asarray(np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1))


def _corner_angles(ring: FloatArray) -> FloatArray:
    """Return the inner angles (C,) [rad] at the corners of a counterclockwise outline (C, 2 or 3)."""
    to_next = np.roll(ring, -1, axis=0) - ring
    to_previous = np.roll(ring, 1, axis=0) - ring
    angle = np.arctan2(to_previous[:, 1], to_previous[:, 0]) - np.arctan2(to_next[:, 1], to_next[:, 0])
    return np.asarray(angle % (2.0 * np.pi))


def side_tilts(panel: HexagonPanel) -> FloatArray:
    """Return the tilt (C,) [rad] of each side from the panel's normal, positive if the front is larger."""
    along = np.roll(panel.bottom, -1, axis=0) - panel.bottom
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    rise = panel.top - panel.bottom
    return np.asarray(np.arctan2((rise[:, :2] * outward).sum(axis=1), rise[:, 2]))


def _data(
    element: HexagonElement,
    panels: tuple[HexagonPanel, ...],
    rows: Sequence[dict[str, Any]],
    templates: Sequence[JobTemplate],
    element_assembly: ElementAssembly,
) -> dict[str, Any]:
    """Return the data of ``element.json``; poses (4, 4) [mm] of blocks are in the file frame."""

    def cut_length(panel: HexagonPanel, operation: Mapping[str, Any]) -> float:
        """Return the length [mm] of the cut around a panel, at half its height."""
        perimeter = float(_edges(0.5 * (panel.bottom + panel.top)).sum()) / MM
        return perimeter if operation.get("process") == "straight_wire" else 0.0

    return {
        "element": 1,
        "name": element.file.name,
        "pose": np.eye(4).tolist(),
        "thickness_mm": element.file.thickness_mm,
        "up": element_assembly.up.tolist(),
        "grouped": element.file.groups is not None,
        "volume_l": round(1e3 * sum(panel.volume for panel in panels), 3),
        "panels": [
            {
                **row,
                **body_data,
                "neighbours": [name or None for name in panel.beyond],
                "on_ground": panel.level.tolist(),
                "outline_mm": np.round(outline, 2).tolist(),
                "front_mm": np.round(panel.top[:, :2] / MM, RING_DIGITS).tolist(),
                "back_mm": np.round(panel.bottom[:, :2] / MM, RING_DIGITS).tolist(),
                "up": _up(element, panel).tolist(),
                **cut_figures(template, functools.partial(cut_length, panel)),
                "block_pose": pose_to_mm(panel.pose),
            }
            for row, panel, outline, template, body_data in zip(
                rows, panels, _outlines(element, panels), templates, element_assembly.data(), strict=True
            )
        ],
        "joints": list(_joints(panels)),
    }


def _joints(panels: tuple[HexagonPanel, ...]) -> Iterator[dict[str, Any]]:
    """Yield the data of each joint: panels, their sides, length [mm], and angle [deg] between fronts."""
    side_centres = {panel.name: transform(panel.pose, _side_centres(panel)).tolist() for panel in panels}
    panels_by_name = {panel.name: panel for panel in panels}
    for panel in panels:
        edges = np.minimum(_edges(panel.top), _edges(panel.bottom))
        for i, name in enumerate(panel.beyond):
            if name <= panel.name:  # the rim, or a joint that the panel with the lower id yields
                continue
            beyond = panels_by_name[name]
            # two panels may share two sides: the joint is where their midpoints coincide
            k = min(
                (k for k, back_id in enumerate(beyond.beyond) if back_id == panel.name),
                key=lambda k: math.dist(side_centres[name][k], side_centres[panel.name][i]),
            )
            angle = float(np.arccos(np.clip(panel.pose[:3, 2] @ beyond.pose[:3, 2], -1.0, 1.0)))
            yield {
                "panels": [panel.name, name],
                "sides": [i, k],
                "length_mm": round(float(edges[i]) / MM, 3),
                "angle_deg": round(angle / DEG, 3),
            }


def _up(element: HexagonElement, panel: HexagonPanel) -> FloatArray:
    """Return the direction (2,) in the plane of the front, in the block frame, that points up in the element.

    For a nearly level panel it is the direction that points up in the drawing.
    """
    steep = np.hypot(*panel.pose[2, :2]) > np.sin(MIN_TILT_RAD)
    up = panel.pose[2, :2] if steep else panel.pose[:3, :2].T @ element.view[:, 1]
    return np.asarray(np.round(unit(up), 4) + 0.0)


def _side_centres(panel: HexagonPanel) -> FloatArray:
    """Return the centre (C, 3) [m] of each side in the block frame."""
    middle_ring = 0.5 * (panel.bottom + panel.top)
    return np.asarray(0.5 * (middle_ring + np.roll(middle_ring, -1, axis=0)))


def _outlines(element: HexagonElement, panels: tuple[HexagonPanel, ...]) -> list[FloatArray]:
    """Return the fronts (C, 2) [mm] as seen from the front, relative to the lower left corner of all."""
    rings = [(transform(panel.pose, panel.top) @ element.view)[:, :2] / MM for panel in panels]
    low = np.concatenate(rings).min(axis=0)
    return [ring - low for ring in rings]


def _count_issues(element: HexagonElement, panels: tuple[HexagonPanel, ...]) -> tuple[Issue, ...]:
    """Return a note ``element.count`` if the shell has another number of panels than requested."""
    got, requested = len(panels), element.options.count
    if got == requested:
        return ()
    min_width = element.options.least_width_mm
    text = format_message("element.count", panel_count=got, min_width_mm=min_width, requested_count=requested)
    hint = "nothing needs to be done; a smaller least_width_mm allows more counts"
    field = "panels.hexagons.count"
    return (Issue("element.count", text, Severity.NOTE, field=field, value=got, limit=requested, hint=hint),)


def _concave_issues(element: HexagonElement, panels: tuple[HexagonPanel, ...]) -> tuple[Issue, ...]:
    """Return one ``element.concave`` that lists the panels with inner corners, if any."""
    names = [panel.name for panel in panels if panel.concave]
    if not names:
        return ()
    quads = element.options.shape == "quad"
    reason = (
        "" if quads else ", as planar panels are on surfaces that bend both ways or hardly in one direction"
    )
    text = format_message(
        "element.concave",
        concave_count=len(names),
        panel_count=len(panels),
        reason_clause=reason,
        panels=", ".join(names),
    )
    hint = "a wire rounds their inner corners: check these panels before foam is cut"
    if not quads:
        hint += ", or try shape: quad"
    return (Issue("element.concave", text, Severity.WARNING, field="panels.hexagons", hint=hint),)


def draw_hexagons(element: HexagonElement, panels: tuple[HexagonPanel, ...]) -> str:
    """Draw all fronts with their ids, as seen from the front, and return the text of the SVG file.

    Darker panels are farther from the surface; concave ones are dashed.
    """
    limit, max_deviation = element.options.off_surface_mm, max(panel.deviation for panel in panels) / MM
    title = f"{element.file.name}: {len(panels)} panels, {element.file.thickness_mm:g} mm thick"
    legend = f"seen from the front; darker: larger deviation, at most {max_deviation:.1f} of {limit:g} mm"
    if any(panel.concave for panel in panels):
        legend += "; dashed: concave"
    drawn = [
        DrawnPanel(panel.name, ring, panel.deviation / MM / limit, panel.concave)
        for panel, ring in zip(panels, _outlines(element, panels), strict=True)
    ]
    return draw_panels(title, legend, drawn)
