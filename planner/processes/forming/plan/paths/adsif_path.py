"""Paths of both tools in ADSIF: at the sheet's level from the inside out, while the formed part sinks.

The path of the forming tool in single point forming is projected on a plane: its tip goes the projection
distance below the flat sheet's face. The area inside a contour moves on as one rigid piece, so a contour
needs no depth, only the wall angle there, from which the response table gives position angle and gap. Loops
are one pitch apart: they are the level lines of the face at steps of pitch tan(a), where a is the mean wall
angle about the level. Source: the dissertation named in `adsif_response`, section 3.2.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.catalogue.materials import SheetMetal
from planner.geometry.arrays import FloatArray
from planner.geometry.mesh import TriangleMesh, corner_normals
from planner.geometry.units import DEG, MM
from planner.issues import issue_error
from planner.processes.forming.plan.contact import (
    CREASE_ANGLE_RAD,
    MIRROR,
    ContactPath,
    FormingPass,
    FormingToolPath,
)
from planner.processes.forming.plan.operation import Adsif, Forming
from planner.processes.forming.plan.paths.adsif_response import (
    ResponseConditions,
    ResponseTable,
    built_in_table,
    centre_distances,
    checked_gap_to_command,
    gap_to_command,
    invert_response,
    read_table,
    require_conditions,
    tool_deflection,
)
from planner.processes.forming.plan.paths.level_lines import LevelLoop, closed_loops, cut_levels
from planner.tooling import FormingHead

EDGE_MARGIN_M: Final = 1e-5
"""Distance [m] of the first and the last loop from the ends of the wall."""
ANGLE_CELL_M: Final = 1e-4
"""Height [m] over which the mean wall angle of a level is calculated."""
MAX_LOOPS: Final = 5000
"""Maximum number of loops of one pass."""
WALL_ANGLE_STEP_RAD: Final = 0.01 * DEG
"""Maximum spacing [rad] of the wall angles at which a table is evaluated."""


def adsif_tool_path(
    forming_pass: FormingPass,
    operation: Forming,
    forming_head: FormingHead,
    support_head: FormingHead,
    thickness: float,
    metal: SheetMetal,
) -> FormingToolPath:
    """Return the paths of both tools over a feature in mode adsif, in which a response table places them.

    The forming ball stays at one level and goes outward loop by loop. The table gives the position of the
    support for the wall angle that is to result. The gap [m] is as commanded: the required one minus the
    deflection of the tools. The contact points are those of the final part, not of the sheet at that instant.

    Args:
        forming_pass: Pass.
        operation: Operation.
        forming_head: Working end of the forming tool.
        support_head: Working end of the other tool.
        thickness: Thickness [m] of the sheet.
        metal: Sheet metal.

    Raises:
        TandemError: ``forming.adsif_*`` where the table does not reach; ``forming.support_tool`` for tools
            that differ or are not balls.
    """
    are_balls = forming_head.kind == support_head.kind == "ball"
    if not are_balls or abs(forming_head.radius - support_head.radius) > 1e-5:
        tools_text = " and ".join(
            f"a {head.kind} of {head.radius / MM:g} mm" for head in (forming_head, support_head)
        )
        message = (
            f"mode adsif needs two balls of equal radius, got {tools_text}; mount a ball of "
            f"{forming_head.radius / MM:g} mm on both arms"
        )
        raise issue_error("forming.support_tool", message, field="mode")
    response = _response_table(operation)
    adsif = operation.adsif
    conditions = ResponseConditions(
        metal.name, thickness, forming_head.radius, adsif.pitch_mm * MM, adsif.projection_mm * MM
    )
    require_conditions(response, conditions)
    if forming_pass.side < 0:
        vertices, start, end = forming_pass.vertices * MIRROR, -forming_pass.start, -forming_pass.end
        forming_pass = dataclasses.replace(forming_pass, side=1, vertices=vertices, start=start, end=end)
        return _mirror_tool_path(
            adsif_tool_path(forming_pass, operation, forming_head, support_head, thickness, metal)
        )
    contact = _contact_path(forming_pass, forming_head.radius, operation)
    position, gap = _commanded_gap(response, contact.angle, adsif, thickness)
    across, down = centre_distances(position, gap, forming_head.radius, support_head.radius)
    outward = -contact.normal[:, :2] / np.linalg.norm(contact.normal[:, :2], axis=1, keepdims=True)
    level = forming_pass.start - adsif.projection_mm * MM + forming_head.radius
    centre = np.column_stack([contact.centre[:, :2], np.full(len(across), level)])
    support_centre = centre + np.column_stack([across[:, None] * outward, -down])
    axis = np.tile([0.0, 0.0, -1.0], (len(centre), 1))
    return FormingToolPath(
        centre, axis, support_centre, -axis, gap, dataclasses.replace(contact, centre=centre)
    )


def support_press_depth(operation: Forming, radii: float, thickness: float) -> float:
    """Return the maximum depth [m] to which the support presses the surrounding flat sheet.

    The maximum is over all walls of the response table, by the geometry of `centre_distances`. The support
    presses while it forms, because the tip of the forming ball stays at the projection distance.

    Args:
        operation: Operation.
        radii: Sum [m] of the radii of both balls.
        thickness: Thickness [m] of the sheet.
    """
    response = _response_table(operation)
    adsif = operation.adsif
    low, high = response.range
    wall = np.append(np.arange(low, high, WALL_ANGLE_STEP_RAD), high)
    position, gap = invert_response(response, wall, adsif.prefer)
    gap = gap_to_command(gap * thickness, position, _tool_deflection(adsif))
    has_gap = gap > 0.0  # the path reports other walls, which leave no gap to command
    if not has_gap.any():
        return 0.0
    _, down = centre_distances(position[has_gap], gap[has_gap], radii, 0.0)
    return float(thickness - adsif.projection_mm * MM + radii - down.min())


def _tool_deflection(adsif: Adsif) -> float:
    """Return the deflection [m] of both tools in the sheet's plane, by the stated force and stiffness."""
    if adsif.force_n <= 0.0 or adsif.stiffness_n_mm is None:
        return 0.0
    return float(tool_deflection(adsif.force_n, adsif.stiffness_n_mm / MM))


def _commanded_gap(
    response: ResponseTable, wall: FloatArray, adsif: Adsif, thickness: float
) -> tuple[FloatArray, FloatArray]:
    """Return position angles (N,) [rad] and gaps (N,) [m] to command for wall angles (N,) [rad]."""
    position, gap = invert_response(response, wall, adsif.prefer)
    gap = gap * thickness
    deflection = _tool_deflection(adsif)
    return position, checked_gap_to_command(gap, position, deflection) if deflection > 0.0 else gap


def _response_table(operation: Forming) -> ResponseTable:
    """Return the response table that an operation names, or the built-in one."""
    return built_in_table() if operation.adsif.file is None else read_table(operation.adsif.file)


def _contact_path(forming_pass: FormingPass, radius: float, operation: Forming) -> ContactPath:
    """Return the path of the contact, loop by loop from the feature's end, its innermost level, to its start.

    Each level has one loop. If its level line has several, the one with the largest area is taken. A helical
    path blends each loop into the next one.
    """
    mesh = TriangleMesh(forming_pass.vertices, forming_pass.faces)
    levels = _loop_levels(forming_pass, operation.adsif.pitch_mm * MM)
    smooth = corner_normals(mesh, CREASE_ANGLE_RAD)
    level_loops = closed_loops(cut_levels(mesh.vertices, mesh.faces, smooth, levels), None, forming_pass.name)
    by_level: dict[int, LevelLoop] = {}
    for loop in level_loops:
        largest = by_level.get(loop.level)
        if largest is None or abs(loop.area()) > abs(largest.area()):
            by_level[loop.level] = loop
    orientation = 1.0 if operation.direction == "ccw" else -1.0
    rings = [by_level[k] for k in sorted(by_level, key=lambda k: levels[k])]
    rings = [ring if ring.area() * orientation > 0.0 else ring.reversed() for ring in rings]
    seam = np.array([np.cos(operation.seam_deg * DEG), np.sin(operation.seam_deg * DEG)])
    sampled_loops = [_sample_loop(ring, seam, radius, operation) for ring in rings]
    if operation.path == "helical":
        sampled_loops = _spiral_rings(sampled_loops)
    point, normal = (np.concatenate([sample[k] for sample in sampled_loops]) for k in range(2))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    loop_number = np.repeat(np.arange(len(sampled_loops)), [len(sample[0]) for sample in sampled_loops])
    return ContactPath(
        point=point,
        normal=normal,
        centre=point + radius * normal,
        angle=np.arccos(np.clip(normal[:, 2], -1.0, 1.0)),
        loop=loop_number,
        working=np.arange(len(point)) > 0,
    )


def _loop_levels(forming_pass: FormingPass, pitch: float) -> FloatArray:
    """Return levels (L,) [m] from the feature's end up to its start, on average one pitch apart in plan.

    Raises ``TandemError`` (forming.adsif_conditions) if there are none, or more than `MAX_LOOPS`.
    """
    corner = forming_pass.vertices[forming_pass.faces]
    low, high = corner[:, :, 2].min(axis=1), corner[:, :, 2].max(axis=1)
    a, b, c = corner[:, 0, :2], corner[:, 1, :2], corner[:, 2, :2]
    plan_area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    is_not_level = high - low > 1e-9
    low, high, plan_area, area = (
        low[is_not_level],
        high[is_not_level],
        plan_area[is_not_level],
        area[is_not_level],
    )
    heights = np.linspace(
        forming_pass.end,
        forming_pass.start,
        max(int(np.ceil((forming_pass.start - forming_pass.end) / ANGLE_CELL_M)), 1) + 1,
    )
    middle_heights = 0.5 * (heights[1:] + heights[:-1])
    by_low, by_high = np.argsort(low), np.argsort(high)

    # mean wall angle a at each height from the facets there: cos a = plan area / area;
    # a step dz is dz / tan a wide in plan, and levels are equidistant in that width

    def sum_at_heights(density: FloatArray) -> FloatArray:
        """Return the sum (C,) of a density (F,) over the facets that reach across each middle height."""
        started = np.concatenate([[0.0], np.cumsum(density[by_low])])
        ended = np.concatenate([[0.0], np.cumsum(density[by_high])])
        return np.asarray(
            started[np.searchsorted(low[by_low], middle_heights)]
            - ended[np.searchsorted(high[by_high], middle_heights)]
        )

    plan_density = sum_at_heights(plan_area / (high - low))
    full_density = sum_at_heights(area / (high - low))
    cosine = np.clip(plan_density / np.maximum(full_density, 1e-300), 1e-3, 1.0)
    slope = np.sqrt(1.0 - cosine**2) / cosine
    width = np.concatenate([[0.0], np.cumsum(np.diff(heights) / np.maximum(slope, 1e-6))])
    count = int(width[-1] / pitch)
    if not 1 <= count <= MAX_LOOPS:
        message = (
            f"pass {forming_pass.name}: {count} loops at a pitch of {pitch / MM:g} mm, allowed are 1 to "
            f"{MAX_LOOPS}"
        )
        raise issue_error("forming.adsif_conditions", message + "; change the pitch", field="adsif")
    levels = np.interp(pitch * np.arange(count + 1), width, heights)
    return np.asarray(np.clip(levels, forming_pass.end + EDGE_MARGIN_M, forming_pass.start - EDGE_MARGIN_M))


def _sample_loop(
    ring: LevelLoop, seam: FloatArray, radius: float, operation: Forming
) -> tuple[FloatArray, FloatArray]:
    """Return points (M, 3) [m] and normals (M, 3) of a loop from the seam on, the last equal to the first.

    There are as many as the chord and the tangent of the forming ball's path require, closer together where
    the normal rotates.
    """
    offset = ring.point[:-1, :2] - ring.point[:-1, :2].mean(axis=0)
    start = int(np.argmax((offset @ seam) / np.linalg.norm(offset, axis=1)))
    point = np.concatenate([ring.point[:-1][start:], ring.point[: start + 1]])
    normal = np.concatenate([ring.normal[:-1][start:], ring.normal[: start + 1]])
    centre = point + radius * normal
    step = np.linalg.norm(np.diff(centre, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(step)])
    is_distinct = np.concatenate([[True], step > 1e-9])
    heading = np.unwrap(np.arctan2(normal[:, 1], normal[:, 0]))
    rotation = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(heading)))])
    # samples are equidistant in the sum of relative length and relative rotation of the normal
    progress = arc / arc[-1] + rotation / max(rotation[-1], 1e-9)
    mean_radius = arc[-1] / (2.0 * np.pi)
    angle_step = min(
        operation.tangent_deg * DEG, 2.0 * np.arccos(max(1.0 - operation.chord_mm * MM / mean_radius, 0.0))
    )
    count = max(int(np.ceil(max(rotation[-1], 2.0 * np.pi) / angle_step)), 16)
    samples = np.linspace(0.0, progress[-1], 2 * count + 1)
    progress, point, normal = progress[is_distinct], point[is_distinct], normal[is_distinct]
    return (
        np.column_stack([np.interp(samples, progress, point[:, k]) for k in range(3)]),
        np.column_stack([np.interp(samples, progress, normal[:, k]) for k in range(3)]),
    )


def _spiral_rings(rings: list[tuple[FloatArray, FloatArray]]) -> list[tuple[FloatArray, FloatArray]]:
    """Return rings that form one outward spiral, preceded by the first loop and followed by the last one.

    Each ring is a pair of points (M, 3) [m] and normals (M, 3). A ring of the spiral blends linearly from one
    loop to the next. Its first point is left out, because it is the last one of the ring before.
    """
    out = [rings[0]]
    for inner, outer in itertools.pairwise(rings):
        count = max(len(inner[0]), len(outer[0]))
        fraction = np.linspace(0.0, 1.0, count)
        blended = []
        for inner_values, outer_values in zip(inner, outer, strict=True):
            a, b = _resample(inner_values, count), _resample(outer_values, count)
            blended.append((a + fraction[:, None] * (b - a))[1:])
        out.append((blended[0], blended[1]))
    out.append((rings[-1][0][1:], rings[-1][1][1:]))
    return out


def _resample(values: FloatArray, count: int) -> FloatArray:
    """Return values (K, 3) interpolated at ``count`` equidistant positions from the first to the last."""
    fractions, new_fractions = np.linspace(0.0, 1.0, len(values)), np.linspace(0.0, 1.0, count)
    return np.column_stack([np.interp(new_fractions, fractions, values[:, axis]) for axis in range(3)])


def _mirror_tool_path(tool_path: FormingToolPath) -> FormingToolPath:
    """Return a tool path mirrored in z, for a pass that is formed from below; face normals stay upward."""
    contact = dataclasses.replace(
        tool_path.contact,
        point=tool_path.contact.point * MIRROR,
        centre=tool_path.contact.centre * MIRROR,
        normal=tool_path.contact.normal * -MIRROR,
    )
    support = None if tool_path.support_centre is None else tool_path.support_centre * MIRROR
    axis = None if tool_path.support_axis is None else tool_path.support_axis * MIRROR
    return FormingToolPath(
        tool_path.forming_centre * MIRROR, tool_path.axis * MIRROR, support, axis, tool_path.gap, contact
    )
