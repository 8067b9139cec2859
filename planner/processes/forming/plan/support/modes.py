"""Positions of both tools along the path of the contact, for each forming mode.

Opposite each other (``dsif``, ``dpif_l``), with the wall angle a, the forming ball of radius R1 and the other
of R2: the gap is g = squeeze t0 cos(a), and the centres are R1 + g + R2 apart. In dsif the line between them
is the face's normal. In dpif_l it is rotated from there toward the vertical by the shift angle, at most by a.

Near the flat around a feature there is no space for a ball opposite a steep wall: it would cut into the flat.
There the line is rotated toward the vertical as far as necessary, at the same distance, so that the support
rolls around the forming ball as that sinks into the sheet. For a ball of R2 this ends at a depth of about R2
(1 - cos a).

**Along the border** of a feature (``dpif_p``): the position of the other tool while the forming one goes
round. The ray from the middle of the last contour through the contact meets the border, which is offset
outward by the support's radius so that a ball, or a disk by its rim, is beside the wall. Rays meet a border
that is not star-shaped several times; there the fraction of the loop that is done is the fraction of the
border that is done.

**Heat** (``heat``): the point that the heat source opposite the forming ball heats, and the pose of its
nozzle.
"""

import dataclasses
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError
from planner.processes.forming.plan.contact import (
    MIRROR,
    ContactPath,
    FormingPass,
    FormingToolPath,
    PassContact,
)
from planner.processes.forming.plan.operation import Forming
from planner.processes.forming.plan.support.clearance import (
    ClampBars,
    ToolLine,
    clamp_clear_tilt,
    support_radius_issue,
)
from planner.processes.forming.plan.support.directions import (
    insert_targets,
    interpolate,
    max_nozzle_tilt,
    smooth_directions,
    smooth_lower_envelope,
    tilt_from_vertical,
    tool_axes,
)
from planner.processes.forming.plan.support.opposite import (
    CHORD_GAP_FRACTION,
    DEFAULT_REFINEMENT,
    MAX_MIDWAY_ANGLE_RAD,
    MAX_TARGET_ANGLE_RAD,
    TARGET_TOLERANCE_M,
    BallContactFace,
    OppositePath,
    TargetRefinement,
    add_dwells,
    make_opposite_path,
    split_moves,
    without_dwells,
)
from planner.tooling import FormingHead, head_outline

MAX_NOZZLE_ROTATION_RAD: Final = 1.0 * DEG
"""Maximum rotation [rad] of a nozzle in one move: it is long, and its arm moves with it."""
_MAX_SPLIT_ROUNDS: Final = 8
"""Maximum number of times that moves are split where the nozzle rotates."""
_SHORT_MOVE_M: Final = 5e-5
"""Moves of the heated point up to this length [m] are split for rotations only."""


@dataclasses.dataclass(frozen=True)
class MountedSheet:
    """Flat sheet and what holds it.

    Attributes:
        thickness: Thickness [m] of the sheet.
        clamp: Clamp from which a heat source tilts away, or None.
    """

    thickness: float
    clamp: ClampBars | None = None


def heat_path(
    pass_contact: PassContact,
    forming_head: FormingHead,
    nozzle: FormingHead,
    sheet: MountedSheet,
    slack: float,
    refine: bool = True,
) -> tuple[ContactPath, FloatArray, FloatArray]:
    """Return the path of mode heat with added targets, the heated points and the axes of the nozzle.

    The forming tool is above the sheet. The heated point is across the sheet from the ball. The nozzle tilts
    as the wall does, as far as it stays under the flat and clear of the clamp. Both follow the smooth face
    that the ball touches, not its facets. Targets are added where the nozzle rotates too far in one move, or
    where the heated point would not be opposite the ball at mid-move.

    Args:
        pass_contact: Pass with the path of the contact.
        forming_head: Working end of the forming tool.
        nozzle: Working end of the heat source.
        sheet: Sheet and its clamp.
        slack: Distance [m] from the face within which the ball counts as touching it.
        refine: Whether targets are added.

    Returns:
        The path, the heated points (N, 3) [m] and the axes (N, 3) of the nozzle.
    """
    forming_pass, contact = pass_contact.forming_pass, pass_contact.contact
    thickness, clamp = sheet.thickness, sheet.clamp
    touched_face = BallContactFace(forming_pass, forming_head.radius, 1.0, thickness)
    opposite = (
        add_dwells(contact, touched_face, slack, TARGET_TOLERANCE_M)
        if refine
        else without_dwells(contact, touched_face, slack)
    )
    for rounds_left in range(_MAX_SPLIT_ROUNDS if refine else 0, -1, -1):
        contact = opposite.contact
        # the heated point moves on while the ball dwells, so directions are smoothed along its path
        heated_about = contact.centre - forming_head.radius * opposite.touched.normal
        normal = opposite.touched.limit_normal(
            smooth_directions(opposite.touched.normal, heated_about), MAX_TARGET_ANGLE_RAD
        )
        through = forming_head.radius + thickness * np.clip(normal[:, 2], 0.0, 1.0)
        heated_point = contact.centre - through[:, None] * normal
        level = forming_pass.start - thickness
        max_tilt = max_nozzle_tilt(heated_point[:, 2], level, nozzle.standoff, nozzle.radius)
        tilt = np.minimum(np.arccos(np.clip(normal[:, 2], -1.0, 1.0)), max_tilt)
        if clamp is not None:
            tilt = clamp_clear_tilt(clamp, heated_point, normal, tilt, head_outline(nozzle))
        axis = tilt_from_vertical(normal, smooth_lower_envelope(tilt, heated_about))
        rotation = np.arccos(np.clip(dots(axis[1:], axis[:-1]), -1.0, 1.0))
        piece_count = np.append(1, np.ceil(rotation / MAX_NOZZLE_ROTATION_RAD)).astype(np.int64)
        piece_count = np.maximum(piece_count, _nozzle_pieces(opposite, contact.centre - heated_point))
        if rounds_left == 0 or piece_count.max() <= 1:
            break
        opposite = split_moves(opposite, piece_count, touched_face)
    return contact, heated_point, axis


def _nozzle_pieces(opposite: OppositePath, across: FloatArray) -> IntArray:
    """Return the number (N,) of pieces that the line from the heated point to the ball demands of each move.

    ``count[i]`` is that of the move to target i, at least 1. A move is halved if at its middle the line
    deviates by more than MAX_MIDWAY_ANGLE_RAD from the normals that the ball touches there, unless the move
    is short. A move on which the ball dwells has as many pieces as the rotation of the line requires.
    ``across`` (N, 3) [m] points from the heated point to the ball.
    """
    direction = across / np.linalg.norm(across, axis=1, keepdims=True)
    line = interpolate(direction[:-1], direction[1:], np.full(len(direction) - 1, 0.5))
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    middle = opposite.middle[np.arange(1, len(direction))]
    deviation = np.arccos(np.clip(dots(middle.limit_normal(line, 0.0), line), -1.0, 1.0))
    rotation = np.arccos(np.clip(dots(direction[1:], direction[:-1]), -1.0, 1.0))
    heated_point = opposite.contact.centre - across
    move_length = np.linalg.norm(np.diff(opposite.contact.centre, axis=0), axis=1)
    move_length = np.maximum(move_length, np.linalg.norm(np.diff(heated_point, axis=0), axis=1))
    halves = np.where((deviation > MAX_MIDWAY_ANGLE_RAD) & (move_length > _SHORT_MOVE_M), 2.0, 1.0)
    count = np.where(opposite.dwells[1:], np.ceil(rotation / (2.0 * MAX_NOZZLE_ROTATION_RAD)), halves)
    return np.append(1, np.maximum(count, 1.0)).astype(np.int64)


BORDER_MARGIN_M: Final = 3e-4
"""Distance [m] of the support outside the border."""
MAX_BEND_DEVIATION_M: Final = 1e-4
"""Maximum deviation [m] of straight moves from bends of the border, inward or outward."""
FLAT_NOISE_M: Final = 5e-5
"""Sheet within this distance [m] of the flat may be noise of its mesh, and is not formed."""
_ARC_PIECES: Final = 64
"""Number of pieces of a quarter of an arc about the border."""


def border_curve(
    forming_pass: FormingPass, support: FormingHead, thickness: float, margin: float = 0.0
) -> FloatArray:
    """Return the closed curve (K, 3) [m] of a support's TCP around a pass, the first point repeated.

    It is anticlockwise seen from above. The border encloses the feature's outermost level line and all
    triangles of the face with a corner off the flat: in a fillet at the rim, that line is millimetres inside
    of them if the mesh is noisy.

    Args:
        forming_pass: Pass.
        support: Working end of the support.
        thickness: Thickness [m] of the sheet.
        margin: Additional distance [m] outward.
    """
    grown = shapely.Polygon(
        _moved_region(forming_pass).buffer(support.radius + margin, quad_segs=_ARC_PIECES).exterior
    )
    ring = shapely.get_coordinates(shapely.orient_polygons(grown).exterior)
    offset = thickness + (support.radius if support.kind == "ball" else 0.0)
    return np.column_stack([ring, np.full(len(ring), forming_pass.start - forming_pass.side * offset)])


def _moved_region(forming_pass: FormingPass) -> shapely.Polygon:
    """Return the largest piece of the region that a pass moves off the flat, seen from above."""
    corners = forming_pass.vertices[forming_pass.faces]
    moved_corners = corners[(np.abs(corners[:, :, 2] - forming_pass.start) > FLAT_NOISE_M).any(axis=1)]
    region = shapely.Polygon(forming_pass.region[:, :2]).buffer(0.0)
    triangles = shapely.polygons(moved_corners[:, [0, 1, 2, 0], :2])
    shapely.prepare(region)
    union = shapely.union_all([region, *triangles[~shapely.covers(region, triangles)]])
    pieces = shapely.get_parts(union)
    return pieces[int(np.argmax(shapely.area(pieces)))]


def border_path(
    forming_pass: FormingPass,
    contact: ContactPath,
    radius: float,
    support: FormingHead,
    thickness: float,
    refine: bool = True,
) -> tuple[ContactPath, FloatArray]:
    """Return the path with added targets, and the support's TCP (N, 3) [m] at its targets.

    Targets are added where the border bends between two of them.

    Args:
        forming_pass: Pass.
        contact: Path of the contact.
        radius: Radius [m] of the forming ball.
        support: Working end of the support.
        thickness: Thickness [m] of the sheet.
        refine: Whether targets are added.
    """
    ring = border_curve(forming_pass, support, thickness, BORDER_MARGIN_M)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ring[:, :2], axis=0), axis=1))])
    loop_centre = _last_loop_centre(contact)
    border_arc = _arc_by_ray(ring, arc, loop_centre, contact.point)
    if border_arc is None:
        border_arc = _arc_by_fraction(ring, arc, contact)
    path = contact
    if refine:
        target, fraction, position = _border_corners(ring, arc, border_arc)
        path = insert_targets(contact, radius, forming_pass.side, target, fraction)
        border_arc = np.insert(border_arc, target, position)
    centre = np.column_stack(
        [np.interp(np.mod(border_arc, arc[-1]), arc, ring[:, axis]) for axis in range(3)]
    )
    return path, centre


def _last_loop_centre(contact: ContactPath) -> FloatArray:
    """Return the centroid (2,) [m] in plan of the last loop that forms; of a mere point, the point itself."""
    last_points = contact.point[(contact.loop == contact.loop.max()) & contact.working][:, :2]
    if len(last_points) < 3 or np.ptp(last_points, axis=0).max() < 1e-6:
        return np.asarray(contact.point[-1, :2])
    polygon = shapely.Polygon(last_points).buffer(0.0)
    centre = polygon.centroid if polygon.area > 0.0 else shapely.MultiPoint(last_points).convex_hull.centroid
    return np.asarray(centre.coords[0])


def _arc_by_ray(
    ring: FloatArray, arc: FloatArray, middle: FloatArray, points: FloatArray
) -> FloatArray | None:
    """Return the arc lengths (N,) [m] of the border at which the support is opposite the ball.

    There the rays from ``middle`` (2,) [m] through the contact ``points`` (N, 3) [m] meet the border. The
    arc length continues beyond the length of the border when the contact goes around more than once. At
    ``middle`` itself the ray is that of the previous point. ``ring`` (K, 3) [m] is the closed border, and
    ``arc`` (K,) [m] are its arc lengths.

    Returns:
        Arc lengths, or None if some ray meets the border more than once.
    """
    offset = ring[:, :2] - middle
    bearing = np.unwrap(np.arctan2(offset[:, 1], offset[:, 0]))
    if not (np.all(np.diff(bearing) > 0.0) and abs(bearing[-1] - bearing[0] - 2.0 * np.pi) < 1e-6):
        return None
    direction = points[:, :2] - middle
    is_off_centre = np.linalg.norm(direction, axis=1) > 1e-6
    heading = np.arctan2(direction[:, 1], direction[:, 0])
    if not is_off_centre.all():  # at the middle the direction is undefined: use that of the previous target
        defined = np.flatnonzero(is_off_centre)
        if not len(defined):
            return np.full(len(points), arc[0])
        nearest = defined[np.maximum(np.searchsorted(defined, np.arange(len(points)), side="right") - 1, 0)]
        heading = heading[nearest]
    heading = bearing[0] + np.mod(heading - bearing[0], 2.0 * np.pi)
    edge_index = np.clip(np.searchsorted(bearing, heading, side="right") - 1, 0, len(bearing) - 2)
    edge_start, edge = offset[edge_index], offset[edge_index + 1] - offset[edge_index]
    ray = np.column_stack([np.cos(heading), np.sin(heading)])
    fraction = (edge_start[:, 1] * ray[:, 0] - edge_start[:, 0] * ray[:, 1]) / (
        edge[:, 0] * ray[:, 1] - edge[:, 1] * ray[:, 0]
    )
    position = arc[edge_index] + np.clip(fraction, 0.0, 1.0) * (arc[edge_index + 1] - arc[edge_index])
    return np.asarray(np.unwrap(position, period=arc[-1]))


def _arc_by_fraction(ring: FloatArray, arc: FloatArray, contact: ContactPath) -> FloatArray:
    """Return the arc lengths (N,) [m] of the border at each target, if rays do not determine them.

    The support goes around the border once for each loop of the contact, in the same direction. It has
    covered the same fraction of the border as the ball has of its loop. It starts at the point of the border
    nearest to the start of the first loop. ``ring`` (K, 3) [m] is the closed border, and ``arc`` (K,) [m] are
    its arc lengths.
    """
    border = shapely.LineString(ring[:, :2])
    origin = float(border.project(shapely.Point(contact.point[0, :2])))
    done, total = np.zeros(len(contact.point)), 0.0
    for number in np.unique(contact.loop):
        targets = np.flatnonzero((contact.loop == number) & contact.working)
        if len(targets) < 2:
            done[targets] = total
            continue
        first = max(targets[0] - 1, 0)
        line = contact.point[np.concatenate([[first], targets]), :2]
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        x, y = (line - line[0]).T
        direction = 1.0 if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) >= 0.0 else -1.0
        done[targets] = total + direction * length[1:] / max(length[-1], 1e-12)
        total += direction
    working = np.flatnonzero(contact.working)
    if len(working):
        done = np.interp(np.arange(len(done)), working, done[working], left=0.0)
    return np.asarray(origin + arc[-1] * done)


def _border_corners(
    ring: FloatArray, arc: FloatArray, along: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the corners of the border that moves of the support would cut, so that targets are added there.

    Only moves that deviate from a corner by more than MAX_BEND_DEVIATION_M count. Corners that are nearer
    than that to a target are left out.

    Args:
        ring: Closed border (K, 3) [m].
        arc: Its arc lengths (K,) [m].
        along: Arc length (N,) [m] at each target. It continues beyond the border's length on further rounds,
            and may decrease.

    Returns:
        For each of M corners: index (M,) of the target at which its move ends, fraction (M,) of the move at
        which the corner is, and arc length (M,) [m] of the corner.
    """
    line = shapely.LineString(ring[:, :2])
    kept_coordinates = shapely.get_coordinates(line.simplify(0.5 * MAX_BEND_DEVIATION_M))[:-1]
    kept_points = set(map(tuple, kept_coordinates.tolist()))
    corner = arc[:-1][[tuple(point) in kept_points for point in ring[:-1, :2].tolist()]]
    low, high = np.minimum(along[1:], along[:-1]), np.maximum(along[1:], along[:-1])
    length = arc[-1]

    def corners_before(value: FloatArray) -> IntArray:
        """Return the number (N,) of corners before arc lengths (N,) [m], over all rounds."""
        rounds = np.floor(value / length)
        inner = np.searchsorted(corner, value - rounds * length, side="right")
        return np.asarray((rounds * len(corner) + inner).astype(np.int64))

    first, stop = corners_before(low), corners_before(np.nextafter(high, -np.inf))
    corner_count = np.maximum(stop - first, 0)
    move = np.repeat(np.arange(len(corner_count)), corner_count)
    step = np.arange(len(move)) - np.repeat(np.cumsum(corner_count) - corner_count, corner_count)
    is_backward = (along[1:] < along[:-1])[move]
    index = np.where(is_backward, stop[move] - 1 - step, first[move] + step)
    corner_arc = corner[np.mod(index, len(corner))] + np.floor_divide(index, len(corner)) * length
    fraction = (corner_arc - along[move]) / (along[move + 1] - along[move])
    move_length = np.abs(along[move + 1] - along[move])
    # corners nearer to a target would give moves of almost no length
    is_inside = np.minimum(fraction, 1.0 - fraction) * move_length > MAX_BEND_DEVIATION_M
    move, corner_arc, fraction = move[is_inside], corner_arc[is_inside], fraction[is_inside]

    def border_points(value: FloatArray) -> FloatArray:
        """Return the points (M, 2) [m] of the border at arc lengths (M,) [m]."""
        return np.column_stack([np.interp(np.mod(value, length), arc, ring[:, axis]) for axis in range(2)])

    move_start = border_points(along[move])
    move_end = border_points(along[move + 1])
    corner_point = border_points(corner_arc)
    chord = move_end - move_start
    offset = corner_point - move_start
    projection = np.clip(dots(offset, chord) / np.maximum((chord**2).sum(axis=1), 1e-18), 0.0, 1.0)
    deviation = np.linalg.norm(offset - projection[:, None] * chord, axis=1)
    max_deviation = np.zeros(len(corner_count))
    np.maximum.at(max_deviation, move, deviation)
    is_needed = max_deviation[move] > MAX_BEND_DEVIATION_M
    return (move + 1)[is_needed], fraction[is_needed], corner_arc[is_needed]


def make_mode_path(
    pass_contact: PassContact,
    operation: Forming,
    forming_head: FormingHead,
    support: FormingHead | None,
    sheet: MountedSheet,
    refinement: TargetRefinement = DEFAULT_REFINEMENT,
) -> FormingToolPath:
    """Return the paths of both tools in all modes except adsif, which has `adsif_path.adsif_tool_path`.

    In spif and tpif one tool works alone. In dpif_p the support goes along the border, in heat a nozzle is
    opposite the ball, and in the other modes a second ball is. Targets are added where the second tool would
    deviate too much on a straight move.

    Args:
        pass_contact: Pass with the path of the contact.
        operation: Operation.
        forming_head: Working end of the forming tool.
        support: Working end of the other tool, or None.
        sheet: Sheet and its clamp.
        refinement: How targets are added.

    Raises:
        TandemError: forming.support_tool if the support does not suit the mode.
    """
    _require_tools(operation, forming_head, support)
    mode = operation.mode
    forming_pass, contact = pass_contact.forming_pass, pass_contact.contact
    if forming_pass.side < 0:  # the modes below are computed for a forming tool above the sheet
        mirrored_path = make_mode_path(
            _mirror_pass_contact(pass_contact),
            operation,
            forming_head,
            support,
            _mirror_sheet(sheet),
            refinement,
        )
        return _mirror_tool_path(mirrored_path)
    if support is None or mode in ("spif", "tpif"):
        no_gap = np.full(len(contact.point), np.nan)
        return FormingToolPath(
            contact.centre, tool_axes(contact.normal, _tilt(operation)), None, None, no_gap, contact
        )
    if mode == "dpif_p":
        path, support_centre = border_path(
            forming_pass, contact, forming_head.radius, support, sheet.thickness, refinement.enabled
        )
        up = np.tile([0.0, 0.0, 1.0], (len(support_centre), 1))
        no_gap = np.full(len(support_centre), np.nan)
        return FormingToolPath(
            path.centre, tool_axes(path.normal, _tilt(operation)), support_centre, up, no_gap, path
        )
    if mode == "heat":
        path, support_centre, nozzle_axis = heat_path(
            pass_contact, forming_head, support, sheet, operation.gouge_tol_mm * MM, refinement.enabled
        )
        no_gap = np.full(len(support_centre), np.nan)
        return FormingToolPath(
            path.centre, tool_axes(path.normal, _tilt(operation)), support_centre, nozzle_axis, no_gap, path
        )
    return make_opposite_path(pass_contact, operation, forming_head, support, sheet.thickness, refinement)


def support_issues(
    forming_pass: FormingPass,
    path: FormingToolPath,
    operation: Forming,
    forming_head: FormingHead,
    support: FormingHead | None,
    thickness: float,
) -> tuple[Issue, ...]:
    """Return warnings about a path of two tools opposite each other.

    forming.support_radius: the support is too large to be opposite and is rotated aside. forming.gap:
    straight moves do not keep the gap.
    """
    if path.support_centre is None or support is None or operation.mode not in ("dsif", "dpif_l"):
        return ()
    pass_contact = PassContact(forming_pass, path.contact)
    across = path.forming_centre - path.support_centre
    if forming_pass.side < 0:
        pass_contact, across = _mirror_pass_contact(pass_contact), across * MIRROR
    shift = operation.shift_deg * DEG if operation.mode == "dpif_l" else 0.0
    tilt = np.arccos(np.clip(across[:, 2] / np.linalg.norm(across, axis=1), -1.0, 1.0))
    required = np.maximum(pass_contact.contact.angle - shift, 0.0)
    deviation = np.where(np.isnan(path.gap), 0.0, required - tilt)
    radii = np.array([forming_head.radius, support.radius])
    tolerance = operation.gouge_tol_mm * MM
    tool_line = ToolLine(required=required, deviation=deviation, gap=np.nan_to_num(path.gap))
    radius_issue = support_radius_issue(pass_contact, thickness, tool_line, radii, tolerance)
    gap_issue = _gap_issue(pass_contact.forming_pass, path, operation)
    return tuple(candidate for candidate in (radius_issue, gap_issue) if candidate is not None)


def _gap_issue(forming_pass: FormingPass, path: FormingToolPath, operation: Forming) -> Issue | None:
    """Return a warning (forming.gap) about moves whose gap more targets do not improve, or None."""
    if path.unresolved is None or path.support_centre is None or not path.unresolved.any():
        return None
    moves = np.flatnonzero(path.unresolved)
    first_text = ", ".join(f"{value:.1f}" for value in path.forming_centre[moves[0]] / MM)
    across = path.forming_centre - path.support_centre
    length = np.linalg.norm(across, axis=1)
    middle = np.linalg.norm(0.5 * (across[moves] + across[moves - 1]), axis=1)
    deviation_mm = float((0.5 * (length[moves] + length[moves - 1]) - middle).max()) / MM
    message = f"pass {forming_pass.name}: on {len(moves)} moves between targets, first at ({first_text}) mm, "
    if deviation_mm > CHORD_GAP_FRACTION * operation.gap_tol_mm:
        message += (
            f"the gap of the tools deviates by up to {deviation_mm:.3f} mm, allowed is "
            f"{CHORD_GAP_FRACTION:.0%} of gap_tol_mm"
        )
        hint = (
            f"allow a gap_tol_mm of {deviation_mm / CHORD_GAP_FRACTION + 5e-4:.3f}, or round the part there"
        )
    else:
        message += "the wall turns abruptly, and the line of the tools does not follow within its tolerance"
        hint = "round the part there"
    message += ", however dense the targets are; the proof decides whether this is acceptable"
    return Issue("forming.gap", message, Severity.WARNING, value=float(len(moves)), limit=0.0, hint=hint)


def _tilt(operation: Forming) -> float:
    """Return the stated tilt [rad] of the tools from the sheet's normal."""
    return operation.lean_deg * DEG


def _mirror_pass_contact(pass_contact: PassContact) -> PassContact:
    """Return a pass and the path of its contact, mirrored in z."""
    return PassContact(_mirror_pass(pass_contact.forming_pass), _mirror_contact(pass_contact.contact))


def _mirror_sheet(sheet: MountedSheet) -> MountedSheet:
    """Return a sheet whose clamp is mirrored in z."""
    clamp = sheet.clamp
    if clamp is None:
        return sheet
    return dataclasses.replace(sheet, clamp=dataclasses.replace(clamp, low=-clamp.high, high=-clamp.low))


def _mirror_pass(forming_pass: FormingPass) -> FormingPass:
    """Return a pass mirrored in z. Its faces keep their orientation in plan, so normals point up again."""
    return dataclasses.replace(
        forming_pass,
        side=-forming_pass.side,
        vertices=forming_pass.vertices * MIRROR,
        start=-forming_pass.start,
        end=-forming_pass.end,
    )


def _mirror_contact(contact: ContactPath) -> ContactPath:
    """Return the path of a contact mirrored in z, with its normals still up."""
    return dataclasses.replace(
        contact, point=contact.point * MIRROR, centre=contact.centre * MIRROR, normal=contact.normal * -MIRROR
    )


def _mirror_tool_path(tool_path: FormingToolPath) -> FormingToolPath:
    """Return the path of both tools mirrored in z."""
    return dataclasses.replace(
        tool_path,
        forming_centre=tool_path.forming_centre * MIRROR,
        axis=tool_path.axis * MIRROR,
        support_centre=None if tool_path.support_centre is None else tool_path.support_centre * MIRROR,
        support_axis=None if tool_path.support_axis is None else tool_path.support_axis * MIRROR,
        contact=_mirror_contact(tool_path.contact),
    )


def _require_tools(operation: Forming, forming_head: FormingHead, support: FormingHead | None) -> None:
    """Raise ``TandemError`` (forming.support_tool) if a tool does not suit the mode."""
    mode = operation.mode
    allowed_kinds = {
        "dsif": "ball",
        "dpif_l": "ball",
        "adsif": "ball",
        "dpif_p": "ball or disk",
        "heat": "heat",
    }
    issues: list[tuple[str, str, str]] = []
    if forming_head.kind != "ball":
        issues.append(("forming", forming_head.kind, "ball"))
    if mode in allowed_kinds and (support is None or support.kind not in allowed_kinds[mode]):
        issues.append(("supporting", "none" if support is None else support.kind, allowed_kinds[mode]))
    if issues:
        raise TandemError(
            [
                Issue(
                    "forming.support_tool",
                    f"mode {mode}: the {role} tool is {got}, allowed is {allowed}; mount another tool, or "
                    "use another mode",
                    field="mode",
                )
                for role, got, allowed in issues
            ]
        )
