"""Checks of a trim job before motion planning: curves that cross or leave the sheet, tools inside a wall."""

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, unit
from planner.geometry.mesh import bisect_triangles
from planner.geometry.swept_body import RoundBody, SweptBody, points_near
from planner.geometry.units import DEG, MM
from planner.issues import Issue, issue_error
from planner.processes.trim.plan.cutting import CuttingTool, flute_body
from planner.processes.trim.plan.face import SheetFace, curve_distance
from planner.processes.trim.plan.operation import Trim
from planner.processes.trim.plan.slots import PlannedOutline, Slot

ROUNDING_MARGIN_M: Final = 1e-6
"""Margin for rounding where points that are too far away are left out [m]."""
FACE_SPACING_M: Final = 2.0 * MM
"""Maximum distance of face points at which the clearance of a tool is checked [m]."""
MAX_FACE_POINTS: Final = 200_000
"""Maximum number of these points."""
PART_SPACING_M: Final = 0.5 * MM
"""Distance of face points at which a cutter is checked against the part [m]."""
MAX_PART_POINTS: Final = 1_000_000
"""Maximum number of these points."""
TILT_DIRECTIONS: Final = 6
"""Number of directions in which a torch is tried to be tilted."""
MIN_RISE_RAD: Final = 15.0 * DEG
"""Minimum angle [rad] at which a torch rises from the flat sheet.

Otherwise it never reaches the safe plane.
"""


def curve_issues(
    outlines: Sequence[PlannedOutline], opening: FloatArray, reach: float, tolerance: float
) -> Iterator[Issue]:
    """Yield issues of outlines that cannot be cut.

    An outline must not cross itself, and it must stay inside the opening of the clamp with its slot and
    leads. Two outlines must not cross or meet, lie in each other's waste, or be nearer to each other than
    twice the tolerance, because nothing is then sure to remain between them.

    Args:
        outlines: Outlines on the face.
        opening: Opening of the clamp (K, 2) [m].
        reach: Width of the slot and its leads beside an outline, in the waste [m].
        tolerance: Allowed deviation of the cut edges [m].
    """
    opening_area = shapely.Polygon(opening)
    for outline in outlines:
        name = outline.spec.name
        if not outline.area.is_valid:
            message = (
                f"{name}: the curve crosses itself{_fault_position(shapely.is_valid_reason(outline.area))}"
            )
            yield Issue(
                "trim.crosses", message, hint="redraw it as one closed curve that does not cross itself"
            )
            continue
        # slot and leads are outside the outline only if the waste is there
        side = 0.0 if outline.drops_inside else reach
        distances = shapely.distance(opening_area, shapely.points(outline.curve.point[:, :2]))
        gap = float(shapely.distance(opening_area.exterior, outline.area.exterior)) - side
        if distances.max() > 0.0 or gap < 0.0:
            k = int(np.argmax(distances)) if distances.max() > 0.0 else _nearest_point(outline, opening_area)
            x, y, _ = outline.curve.point[k] / MM
            beyond = float(distances.max()) + side if distances.max() > 0.0 else -gap
            message = (
                f"{name}: at ({x:.1f}, {y:.1f}) mm the curve, with slot and leads, is {beyond / MM:.1f} "
            )
            message += "mm beyond the opening of the clamp"
            hint = "move the curve inwards, or use a larger opening"
            yield Issue("trim.off_part", message, value=beyond / MM, limit=0.0, unit="mm", hint=hint)
    for outline, other in itertools.combinations([valid for valid in outlines if valid.area.is_valid], 2):
        names = f"{outline.spec.name} and {other.spec.name}"
        if shapely.intersects(outline.area.exterior, other.area.exterior):
            crossing = (
                shapely.get_coordinates(shapely.intersection(outline.area.exterior, other.area.exterior))[0]
                / MM
            )
            message = f"{names} cross or meet, at ({crossing[0]:.1f}, {crossing[1]:.1f}) mm"
            yield Issue("trim.crosses", message, hint="move one of them, or join them to one curve")
            continue
        between = float(shapely.distance(outline.area.exterior, other.area.exterior))
        if between < 2.0 * tolerance:
            gap_ends = shapely.get_coordinates(
                shapely.shortest_line(outline.area.exterior, other.area.exterior)
            )
            x, y = gap_ends.mean(axis=0) / MM
            message = (
                f"{names} come within {between / MM:.2f} mm of each other, at ({x:.1f}, {y:.1f}) mm; as "
            )
            message += f"both edges may deviate by shape_tol_mm, allowed {2.0 * tolerance / MM:g} mm or more"
            hint = "move them apart, join them to one curve, or use a smaller shape_tol_mm"
            value, limit = between / MM, 2.0 * tolerance / MM
            yield Issue("trim.crosses", message, value=value, limit=limit, unit="mm", hint=hint)
            continue
        for a, b in ((outline, other), (other, outline)):
            # they do not cross, so one point of b decides
            if bool(a.in_waste(b.curve.point[:1, :2])[0]):
                message = f"{b.spec.name} lies in the waste of {a.spec.name}, so that nothing is cut there"
                yield Issue("trim.in_waste", message, hint="leave it out, or swap drops of one of them")


def _fault_position(reason: str) -> str:
    """Return the position of a fault from GEOS's reason [m], in words; empty if it states none."""
    match = re.search(r"\[(\S+) (\S+)\]", reason)
    if match is None:
        return ""
    x, y = (round(float(number) / MM, 1) + 0.0 for number in match.groups())  # no -0.0
    return f", at ({x:.1f}, {y:.1f}) mm"


def _nearest_point(outline: PlannedOutline, opening: shapely.Polygon) -> int:
    """Return the index of the point of an outline that is nearest to the edge of the opening."""
    return int(np.argmin(shapely.distance(opening.exterior, shapely.points(outline.curve.point[:, :2]))))


def body_clearance(
    body: RoundBody, points: FloatArray, tips: FloatArray, axes: FloatArray, max_distance: float
) -> FloatArray:
    """Return the distance (N, L) [m] of a tool's body from points, at N positions with L tilts each.

    The result is negative if a point is inside the body. It shows where the tool would touch the sheet.

    Args:
        body: Body of the tool.
        points: Points (P, 3) [m].
        tips: Tips (N, L, 3) [m]. The L tilts of one position are about one point.
        axes: Axes into the tool (N, L, 3).
        max_distance: Upper bound of the reported distance [m].
    """
    out = np.empty(tips.shape[:2])
    max_radius, max_axial = body.max_radius + max_distance, max(abs(body.start), abs(body.end)) + max_distance
    # points near the tool at any tilt are near the first one, plus the displacement of the others
    displacement = np.linalg.norm(tips - tips[:, :1], axis=2) + max_axial * np.linalg.norm(
        axes - axes[:, :1], axis=2
    )
    squared_norm = np.einsum("ij,ij->i", points, points)
    for k, (position_tips, position_axes) in enumerate(zip(tips, axes, strict=True)):
        axial = points @ position_axes[0] - position_tips[0] @ position_axes[0]
        radial_square = (
            squared_norm
            - 2.0 * (points @ position_tips[0])
            + position_tips[0] @ position_tips[0]
            - axial * axial
        )
        max_radial = max_radius + float(displacement[k].max()) + ROUNDING_MARGIN_M
        nearby = points[(radial_square < max_radial * max_radial) & (np.abs(axial) < max_axial + max_radial)]
        for tilt_index, (tip, axis) in enumerate(zip(position_tips, position_axes, strict=True)):
            rest = nearby - tip
            axial = rest @ axis
            radial = np.sqrt(np.maximum(np.einsum("ij,ij->i", rest, rest) - axial * axial, 0.0))
            out[k, tilt_index] = body.distance(axial, radial).min(initial=max_distance)
    return out


def gouge_depths(
    outline: PlannedOutline,
    tool: CuttingTool,
    points: FloatArray,
    thickness: float,
    side: int,
    path: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return how far a mill's cutter goes over the outline into the part, at each position of a path.

    It does so where the sheet is bent, because the cutter is normal to the face only on its axis. The result
    is 0 for other tools, and where the cutter is not in the part.

    Args:
        outline: Outline of the slot.
        tool: How the tool cuts.
        points: Points of the face (P, 3) [m]. The other face is moved along z by the thickness.
        thickness: Thickness of the sheet [m]. On the other face the cut may be off the outline by as much.
        side: +1 for the upper face, -1 for the lower one.
        path: Tips (N, 3) [m] and axes (N, 3) of the path.

    Returns:
        Maximum distance (N,) [m] from the outline of points of the part that are in the cutter, and these
        points (N, 3) [m], at each position.
    """
    depth, where = np.zeros(len(path[0])), np.zeros((len(path[0]), 3))
    if tool.cutter is None or not len(points):
        return depth, where
    cutter = tool.cutter
    part = points[~outline.in_waste(points[:, :2])]
    if not len(part):
        return depth, where
    distances = curve_distance(part, outline.curve.point)
    both_faces = np.concatenate([part, part - np.array([0.0, 0.0, side * thickness])])
    distances = np.concatenate([distances, distances - thickness])
    tree = cKDTree(both_faces)
    for k, (tip, axis) in enumerate(zip(*path, strict=True)):
        nearby = tree.query_ball_point(tip + 0.5 * cutter.flute * axis, 0.5 * cutter.flute + cutter.radius)
        if not nearby:
            continue
        rest = both_faces[nearby] - tip
        axial = rest @ axis
        radial = np.linalg.norm(rest - axial[:, None] * axis, axis=1)
        inside = (radial < cutter.radius) & (axial > 0.0) & (axial < cutter.flute)
        depths = np.where(inside, distances[nearby], 0.0)
        deepest = int(np.argmax(depths))
        depth[k], where[k] = depths[deepest], both_faces[nearby[deepest]]
    return depth, where


def gouge_issue(slot: Slot, depth: FloatArray, where: FloatArray, op: Trim) -> Iterator[Issue]:
    """Yield an issue if the cutter enters the part beyond the tolerance, where the part is bent.

    Args:
        slot: Slot.
        depth: Depths along it (N,) [m], the first result of :func:`gouge_depths`.
        where: Points at which they occur (N, 3) [m].
        op: Operation.
    """
    k = int(np.argmax(depth))
    if depth[k] <= op.shape_tol_mm * MM:
        return
    x, y, z = where[k] / MM
    message = f"{slot.outline}: the cutter goes {depth[k] / MM:.2f} mm over the curve into the part, at "
    message += f"({x:.1f}, {y:.1f}, {z:.1f}) mm, allowed {op.shape_tol_mm:g} mm"
    hint = "move the curve away from the wall there, use a thinner cutter, or less below_mm"
    value, limit = float(depth[k]) / MM, op.shape_tol_mm
    yield Issue("trim.wall", message, value=value, limit=limit, unit="mm", hint=hint)


def part_points(
    face: SheetFace, size: FloatArray, tool: CuttingTool, path: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return points of the sheet's face near a mill's flute, at which it may cut one of both faces.

    There are none for other tools.

    Args:
        face: Face of the sheet.
        size: Size of the sheet (3,) [m].
        tool: How the tool cuts.
        path: Tips (N, 3) [m] and axes (N, 3) of the path.

    Returns:
        Points (P, 3) [m], at most ``PART_SPACING_M`` apart.

    Raises:
        TandemError: ``trim.wall`` if there are too many points.
    """
    if tool.cutter is None:
        return np.zeros((0, 3))
    vertices, faces = face.sheet_triangles(size[:2])
    flute = SweptBody(*path, flute_body(tool.cutter))
    points, _, count = points_near(vertices[faces], flute, float(size[2]), PART_SPACING_M, MAX_PART_POINTS)
    if count > MAX_PART_POINTS:
        message = f"the slot needs {count} points to be checked, allowed {MAX_PART_POINTS}"
        hint = "cut it in several pieces (joints), or use a thinner cutter"
        raise issue_error("trim.wall", message, value=count, limit=MAX_PART_POINTS, hint=hint)
    return points


def face_points(face: SheetFace, size: FloatArray) -> FloatArray:
    """Return points (P, 3) of the sheet, at most ``FACE_SPACING_M`` apart.

    Args:
        face: Face of the sheet.
        size: Size of the sheet (2,) [m].
    """
    vertices, faces = face.sheet_triangles(size)
    return np.concatenate(
        [vertices, bisect_triangles(vertices[faces], FACE_SPACING_M, MAX_FACE_POINTS)[0].mean(axis=1)]
    )


def wall_issue(
    slot: Slot, tips: FloatArray, distances: FloatArray, op: Trim, tool: CuttingTool
) -> Iterator[Issue]:
    """Yield an issue if a tool that is normal to the face is too near to the sheet.

    Args:
        slot: Slot.
        tips: Tips along it (N, 3) [m].
        distances: Distances of the tool from the sheet (N,) [m].
        op: Operation.
        tool: How the tool cuts.
    """
    k = int(np.argmin(distances))
    if distances[k] >= op.clear_mm * MM:
        return
    x, y, z = tips[k] / MM
    message = (
        f"{slot.outline}: at ({x:.1f}, {y:.1f}, {z:.1f}) mm the {_clear_part_name(tool)}, square to the "
        "sheet, "
    )
    message += (
        f"{'enters it by' if distances[k] < 0.0 else 'is away from its wall by'} "
        f"{abs(distances[k]) / MM:.2f} mm, "
    )
    message += f"required {op.clear_mm:g} mm"
    hint = "move the curve away from the wall, use a longer flute or a slimmer holder"
    if tool.blade is not None:
        hint = "move the curve away from the wall, use a longer blade_mm or a slimmer body"
    elif tool.cutter is None:
        hint = "move the curve away from the wall, use a slimmer nozzle, or a larger standoff_mm"
    yield Issue("trim.wall", message, value=float(distances[k]) / MM, limit=op.clear_mm, unit="mm", hint=hint)


def _clear_part_name(tool: CuttingTool) -> str:
    """Return the name of the part of the tool that has to keep its clearance from the sheet."""
    if tool.blade is not None:
        return f"{tool.label}'s body"
    return tool.label if tool.cutter is None else f"{tool.label}'s shank or holder"


def rise_issue(slot: Slot, axes: FloatArray, side: int) -> Iterator[Issue]:
    """Yield an issue if the tool is too flat at the ends of a slot to rise along its axis to the safe plane.

    Args:
        slot: Slot.
        axes: Axes along it (N, 3).
        side: +1 for the upper face, -1 for the lower one.
    """
    up = float((side * axes[[0, -1], 2]).min())
    if up < np.sin(MIN_RISE_RAD):
        wall_deg = float(np.rad2deg(np.arccos(np.clip(up, -1.0, 1.0))))
        max_deg = 90.0 - MIN_RISE_RAD / DEG
        message = f"{slot.outline}: at an end of its slot the wall is {wall_deg:.0f} deg steep, and a tool "
        message += f"normal to it cannot come down to it from the safe plane, allowed {max_deg:g} deg"
        yield Issue(
            "trim.wall",
            message,
            value=wall_deg,
            limit=max_deg,
            unit="deg",
            hint="start it where the sheet is flatter",
        )


def tilted_axes(axes: FloatArray, angle: float) -> list[FloatArray]:
    """Return the axes (N, 3) tilted in each of ``TILT_DIRECTIONS`` directions.

    Args:
        axes: Unit axes (N, 3).
        angle: Tilt [rad].
    """
    first = unit(np.cross(axes, np.eye(3)[int(np.abs(axes).max(axis=0).argmin())]))
    second = np.cross(axes, first)
    directions = 2.0 * np.pi * np.arange(TILT_DIRECTIONS) / TILT_DIRECTIONS
    return [
        np.asarray(
            np.cos(angle) * axes + np.sin(angle) * (np.cos(direction) * first + np.sin(direction) * second)
        )
        for direction in directions
    ]
