"""Path of a tool through all slots of an operation: down to the start of each, along it, and up again.

Points of a slot are thinned to targets whose spacing keeps the chord error of straight moves. A tool that
goes through the sheet is at its depth before it is near the curve.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, hull_points, transform
from planner.geometry.polylines import stop_flags, thin_rows
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, has_errors, issue_error
from planner.problem import Setup
from planner.processes.trim.plan import check
from planner.processes.trim.plan.cutting import CuttingTool
from planner.processes.trim.plan.face import FaceCurve, SheetFace, curve_distance
from planner.processes.trim.plan.operation import KnifeCut, Trim
from planner.processes.trim.plan.slots import Slot, SlotPlan
from planner.processes.trim.plan.stretches import heading_vectors, rotate_in_air

TRIM: Final = "trim"
"""Kind of the segments in which a tool cuts, leads in and leads out."""
CHORD_FRACTION: Final = 0.1
"""Fraction of the tolerance that straight moves between targets may use."""
AXIS_LEVER_M: Final = 0.03
"""Distance behind the TCP [m] of a second point of the tool's axis that also keeps the chord error."""
TILT_FRACTION: Final = 0.85
"""Fraction of the cone that motion planning may use at targets. The rest is for the motion between them."""
HEADING_FRACTION: Final = 0.4
"""Fraction of the allowed angle between blade and curve that motion planning may use at targets."""
CHORD_ROTATION_FRACTION: Final = 0.2
"""Fraction of the allowed angle between blade and curve that straight moves between targets may use."""
SIDE_FRACTION: Final = 0.2
"""Fraction of the tolerance by which front and back of a blade may deviate when motion planning spins it."""


@dataclasses.dataclass(frozen=True)
class TrimRoute:
    """Path of an operation with N targets.

    Attributes:
        tip: Tips (N, 3) [m].
        axis: Axes from the TCP into the tool (N, 3).
        feed: Speed of the move to each target (N,) [m/s].
        max_tilt: Maximum tilt of the tool, or spin of a knife, by motion planning (N,) [rad].
        segment: Segment of each target.
        stop: Whether the tool stops at each target (N,).
        height: Height of the TCP above the face in slots (N,) [m], NaN elsewhere.
        start_rows: Index of the first target of each slot, the pierce point.
        end_rows: Index of the last target of each slot.
        heading: Heading of a knife's edge (N,) [rad], NaN for other tools.
    """

    tip: FloatArray
    axis: FloatArray
    feed: FloatArray
    max_tilt: FloatArray
    segment: tuple[Segment, ...]
    stop: BoolArray
    height: FloatArray
    start_rows: tuple[int, ...]
    end_rows: tuple[int, ...]
    heading: FloatArray


def plan_route(
    op: Trim, setup: Setup, face: SheetFace, tool: CuttingTool, slot_plan: SlotPlan, surface_error: float
) -> tuple[TrimRoute, list[Issue]]:
    """Plan the path of the tool through all slots, from which the targets of the operation are built.

    At each slot the tool goes down along its axis, along the slot, and up again to the safe plane. Each slot
    is checked for clearance of the tool from walls, gouging and walls too steep to rise from.

    Args:
        op: Operation.
        setup: Cell and stock as the operation finds them.
        face: Face of the sheet.
        tool: How the tool cuts.
        slot_plan: Outlines on the face, and their slots in order.
        surface_error: Possible deviation of the face [m].

    Returns:
        The route, which is empty if there are errors, and issues.
    """
    # level: height of the safe plane
    level, issues = _safe_level(op, setup, face), list[Issue]()
    size = setup.stock.size[:2]
    face_points = check.face_points(face, size)
    tips: list[FloatArray] = []
    axes: list[FloatArray] = []
    feeds: list[FloatArray] = []
    tilts: list[FloatArray] = []
    heights: list[FloatArray] = []
    headings: list[FloatArray] = []
    segments: list[Segment] = []
    start_rows: list[int] = []
    end_rows: list[int] = []
    tilt_limit = _max_tilt(op, tool)
    for number, slot in enumerate(slot_plan.slots):
        outline_of_slot = next(o for o in slot_plan.outlines if o.spec.name == slot.outline)
        try:
            # targets of the slot, and points of the sheet that the cutter may gouge
            rows, lifts = _target_rows(slot, op, tool, (outline_of_slot.curve, surface_error))
            slot_path = _slot_path(slot, face, tool, rows, lifts)
            gouge_points = check.part_points(face, setup.stock.size, tool, slot_path)
        except TandemError as error:
            issues += error.issues
            continue
        point, axis = slot.point[rows], face.side * slot.normal[rows]
        # poses at the targets: normal to the face, and tilted to the edge of the cone. The normal ones
        # (column 0 of the clearances) must be free.
        heading = slot.heading[rows] if tool.blade is not None else np.full(len(rows), np.nan)
        pivot = point + lifts[:, None] * axis
        tip = pivot - tool.depth * axis
        tilted_axes = check.tilted_axes(axis, op.cone_deg * DEG) if tool.blade is None else []
        tilted = np.stack([axis, *tilted_axes], axis=1)
        low_tips = pivot[:, None] - tool.depth * tilted
        clearances = check.body_clearance(tool.clear_body, face_points, low_tips, tilted, op.clear_mm * MM)
        issues += [
            *check.wall_issue(slot, tip, clearances[:, 0], op, tool),
            *check.rise_issue(slot, axis, face.side),
        ]
        cut = (outline_of_slot, tool, gouge_points, float(setup.stock.size[2]), face.side)
        issues += check.gouge_issue(slot, *check.gouge_depths(*cut, slot_path), op)
        if has_errors(issues):
            continue
        # motion planning may tilt at a target if all tilted poses there and at its neighbours are free
        may_tilt: BoolArray = np.asarray((clearances[:, 1:] >= op.clear_mm * MM).all(axis=1))
        for k in range(1, tilted.shape[1]):
            may_tilt &= check.gouge_depths(*cut, (low_tips[:, k], tilted[:, k]))[0] <= op.shape_tol_mm * MM
        max_tilt = np.where(
            may_tilt & np.append(may_tilt[1:], True) & np.append(True, may_tilt[:-1]), tilt_limit, 0.0
        )
        if tool.goes_through:  # no tilt at targets before and after a move down, and at the last one
            max_tilt[(lifts > 0.0) | np.append(True, lifts[:-1] > 0.0)] = 0.0
            max_tilt[-1] = 0.0
        # points above the first and last target, on the axis, at the safe plane or at least 2 mm away
        above = [tip[k] + max((level - tip[k, 2]) / axis[k, 2], 2.0 * MM) * axis[k] for k in (0, -1)]
        # sine law: on a wall of the angle a the sheet is thinner by cos a = |axis_z|, so the feed is higher;
        # at most ten times as high
        feed = op.feed_mm_s * MM / np.maximum(np.abs(axis[:, 2]), 0.1)
        if op.feed_most_mm_s is not None:
            feed = np.minimum(feed, op.feed_most_mm_s * MM)
        # the wall may be flatter along a move than at its target
        feed[1:] = np.minimum(feed[1:], feed[:-1])
        feed = _tip_feed(feed, tool, point, tip, lifts)
        segment = Segment(TRIM, slot.name)
        if tool.blade is not None and number:  # from the second stretch on: rotate to it in the air
            rotation = rotate_in_air(
                (tips[-1][-1], axes[-1][-1], float(headings[-1][-1])), (above[0], axis[0], float(heading[0]))
            )
            count = len(rotation.heading)
            tips.append(rotation.tip)
            axes.append(rotation.axis)
            headings.append(rotation.heading)
            feeds.append(np.full(count, op.rapid_mm_s * MM))
            tilts.append(np.zeros(count))
            heights.append(np.full(count, np.nan))
            segments += [Segment("link")] * count
        # above the start, down, along the slot, up above the end
        start_rows.append(sum(map(len, tips)) + 1)
        end_rows.append(start_rows[-1] + len(tip) - 1)
        tips += [above[0][None], tip, above[1][None]]
        axes += [axis[:1], axis, axis[-1:]]
        headings += [heading[:1], heading, heading[-1:]]
        feeds += [
            np.array([op.rapid_mm_s * MM, op.plunge_mm_s * MM]),
            feed[1:],
            np.array([op.rapid_mm_s * MM]),
        ]
        tilts += [max_tilt[:1], max_tilt, max_tilt[-1:]]
        heights += [np.full(1, np.nan), lifts - tool.depth, np.full(1, np.nan)]
        segments += [Segment("approach" if number == 0 else "link"), segment.at("in")]
        segments += [segment] * (len(tip) - 1) + [segment.at("out")]
    if has_errors(issues):
        return _empty_route(), issues
    tip, axis = np.concatenate(tips), np.concatenate(axes)
    # The tool stops above both ends of a slot and at its corners. A last target, farther up, follows.
    stop = np.zeros(len(tip), dtype=bool)
    for first, last in zip(start_rows, end_rows, strict=True):
        stop[[first - 1, last + 1]] = True
        stop[first : last + 1] = stop_flags(tip[first : last + 1])
    rise = tip[-1] + op.safe_mm * MM * axis[-1]
    heading = np.concatenate(headings)
    return TrimRoute(
        np.concatenate([tip, rise[None]]),
        np.concatenate([axis, axis[-1:]]),
        np.append(np.concatenate(feeds), op.rapid_mm_s * MM),
        np.append(np.concatenate(tilts), tilts[-1][-1]),
        (*segments, Segment("retreat")),
        np.append(stop, True),
        np.append(np.concatenate(heights), np.nan),
        tuple(start_rows),
        tuple(end_rows),
        np.append(heading, heading[-1]),
    ), issues


def _max_tilt(op: Trim, tool: CuttingTool) -> float:
    """Return the maximum tilt [rad] of the tool by motion planning.

    A knife stays normal to the face, so for it this is the maximum rotation about its axis.
    """
    if tool.blade is None or not isinstance(op.by, KnifeCut):
        return TILT_FRACTION * op.cone_deg * DEG
    blade_reach = max(tool.blade.end, float(tool.blade.front(tool.depth)))
    side_angle = float(np.arctan2(SIDE_FRACTION * op.shape_tol_mm * MM, blade_reach))
    return min(HEADING_FRACTION * op.by.heading_deg * DEG, side_angle)


def _slot_path(
    slot: Slot, face: SheetFace, tool: CuttingTool, rows: IntArray, lifts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return tips and axes (N, 3) at all points of a slot; ``lifts`` (R,) [m] are those at ``rows`` (R,)."""
    axis = face.side * slot.normal
    all_lifts = np.interp(np.arange(len(axis)), rows, lifts)
    return slot.point + (all_lifts - tool.depth)[:, None] * axis, axis


PLUNGE_FRACTION: Final = 0.8
"""Fraction of its plunge feed at which a cutter goes down. On a bent face the descent is not uniform."""
MIN_FEED_FRACTION: Final = 0.05
"""Lower bound of a tip's speed as a fraction of the feed along the face."""


def _tip_feed(
    feed: FloatArray, tool: CuttingTool, point: FloatArray, tip: FloatArray, lifts: FloatArray
) -> FloatArray:
    """Return the feed (N,) [m/s] of the tip of a tool, which is behind the face for a mill or knife.

    Index k is the move to target k. In a bend the path of the tip may be shorter than that on the face. The
    tip is then slower, so that the point on the face moves at ``feed`` (N,) [m/s]. A tip that goes down stays
    below the plunge feed. ``point`` (N, 3) [m] are the points on the face, ``lifts`` (N,) [m] the lifts of
    the TCP.
    """
    if not tool.goes_through:
        return feed
    out = feed.copy()
    along = np.linalg.norm(np.diff(point, axis=0), axis=1)
    lengths = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    down = -np.diff(lifts)
    fraction = np.maximum(lengths / np.maximum(along, 1e-9), MIN_FEED_FRACTION)
    out[1:] *= np.where(along > 1e-9, np.minimum(fraction, 1.0), 1.0)
    goes_down = down > 1e-9
    max_feed = PLUNGE_FRACTION * tool.plunge * lengths / np.maximum(down, 1e-9)
    out[1:][goes_down] = np.minimum(out[1:], max_feed)[goes_down]
    return out


def _empty_route() -> TrimRoute:
    """Return a route without targets, for slots with errors."""
    no_vectors = np.zeros((0, 3))
    no_values = no_vectors[:, 0]
    return TrimRoute(
        no_vectors, no_vectors, no_values, no_values, (), no_values > 0.0, no_values, (), (), no_values
    )


DEPTH_TOLERANCE_FACTOR: Final = 2.0
"""Distance of a slot's edge from the curve, in tolerances, at which the tool has to be at its depth."""
DEPTH_MARGIN_M: Final = 0.05 * MM
"""Margin added to the distance at which the tool has to be at its depth [m]. The proof requires the depth at
all points near a curve.
"""


def _lift_fractions(
    slot: Slot, op: Trim, tool: CuttingTool, curve_and_error: tuple[FaceCurve, float]
) -> FloatArray:
    """Return the fraction (N,) of its initial lift that the tool still has at each point of a slot.

    It falls from 1 at the start of the lead-in to 0 where the tool has to be at its depth. There the edge of
    the slot is still outside twice the tolerance of the curve. ``curve_and_error`` is the curve of the slot
    and the possible deviation of the face [m].

    Raises:
        TandemError: ``trim.lead`` if the lead-in is too short for a tool that goes down along it.
    """
    curve, surface_error = curve_and_error
    depth_distance = DEPTH_TOLERANCE_FACTOR * op.shape_tol_mm * MM + DEPTH_MARGIN_M + surface_error
    edge_distances = curve_distance(slot.point[: slot.first + 1], curve.point) - 0.5 * tool.kerf
    # last point of the lead-in at which the tool may still be lifted
    last = int(np.argmax(edge_distances < depth_distance)) - 1
    if last < 1 and tool.lift != 0.0 and tool.is_ramp:
        message = (
            f"{slot.outline}: the lead-in of {op.lead.length_mm:g} mm is too short for the tool to reach "
        )
        message += f"its depth {depth_distance / MM:.2f} mm before the curve"
        hint = (
            f"use a longer lead.length_mm (about {1.3 * depth_distance / MM:.1f}), or a smaller shape_tol_mm"
        )
        value, limit = op.lead.length_mm, depth_distance / MM
        raise issue_error("trim.lead", message, value=value, limit=limit, unit="mm", hint=hint)
    step = np.linalg.norm(np.diff(slot.point[: max(last, 1) + 1], axis=0), axis=1)
    # length from each point to that point, 0 after it
    remaining = np.append(np.cumsum(step[::-1])[::-1], np.zeros(len(slot.point) - len(step)))
    return np.asarray(remaining / float(remaining[0]))


def _target_rows(
    slot: Slot, op: Trim, tool: CuttingTool, curve_and_error: tuple[FaceCurve, float]
) -> tuple[IntArray, FloatArray]:
    """Return the indices (R,) of a slot's points that become targets, and the lift (R,) [m] of the TCP there.

    Points are thinned as far as straight moves keep the chord error: at the face, at the tip, at a second
    point of the tool's axis, and for a knife also at the front and back of its blade. The first and last
    point of the slot and of its leads are always targets. A tool that goes straight down has its first point
    twice: lifted and down. ``curve_and_error`` is the curve of the slot and the possible deviation of the
    face [m].
    """
    chord = CHORD_FRACTION * min(op.shape_tol_mm, op.height_tol_mm) * MM
    chord = min(chord, CHORD_FRACTION * tool.depth) if tool.goes_through else chord
    # distances along the axis of the points that keep the chord error; a torch has no tip behind the face
    lever = np.array([0.0, AXIS_LEVER_M, -tool.depth])[: 3 if tool.goes_through else 2]
    points = slot.point[:, None] + lever[:, None] * slot.normal[:, None]
    if tool.blade is not None and isinstance(op.by, KnifeCut):  # also its front, its back and its heading
        # at this reach the chord error limits the heading to its allowed deviation
        min_reach = chord / (CHORD_ROTATION_FRACTION * op.by.heading_deg * DEG)
        ends = np.array(
            [-max(tool.blade.end, min_reach), max(float(tool.blade.front(tool.depth)), min_reach)]
        )
        directions = heading_vectors(slot.normal, slot.heading)
        points = np.concatenate([points, slot.point[:, None] + ends[:, None] * directions[:, None]], axis=1)
    lift = _lift_fractions(slot, op, tool, curve_and_error)
    at_depth = int(np.argmax(lift == 0.0))
    # points that are targets in any case
    marks = [0, slot.first, slot.last, len(slot.point) - 1]
    breaks = np.unique(marks if tool.blade is not None else [*marks, at_depth])
    kept = [np.zeros(1, dtype=np.int64)]
    for first, last in zip(breaks[:-1].tolist(), breaks[1:].tolist(), strict=True):
        kept.append(first + thin_rows(points[first : last + 1], chord, op.step_mm * MM)[1:])
    rows = np.concatenate(kept)
    if tool.blade is not None:
        rows = _even_last_moves(rows, slot.point)
    if tool.is_ramp:
        return rows, tool.lift * lift[rows]
    return np.append(0, rows), tool.lift * np.append(1.0, np.zeros(len(rows)))


EVENED_MOVES: Final = 5
"""Number of moves at the end of a knife's stretch over which the remainder of thinning is distributed."""
MAX_LENGTH_RATIO: Final = 1.3
"""Maximum ratio of the lengths of these moves. Beyond it only the last two share the remainder."""


def _even_last_moves(rows: IntArray, point: FloatArray) -> IntArray:
    """Return ``rows`` (K,) with the last ones moved, so that the last moves are about equally long.

    Thinning leaves a short remainder as the last move. ``rows`` are indices of ``point`` (N, 3) [m]. Nothing
    changes if the last move is no shorter than the one before it.
    """
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(point, axis=0), axis=1)))
    count = min(EVENED_MOVES, len(rows) - 1)
    move_lengths = np.diff(lengths[rows[-count - 1 :]])
    if count > 2 and move_lengths[:-1].max() > MAX_LENGTH_RATIO * move_lengths[:-1].min():
        count = 2
    if count < 2 or move_lengths[-1] >= move_lengths[-2]:
        return rows
    first = rows[-count - 1]
    positions = np.linspace(lengths[first], lengths[rows[-1]], count + 1)[1:-1]
    inner = np.unique(np.clip(np.searchsorted(lengths, positions), first + 1, rows[-1] - 1))
    return np.concatenate([rows[:-count], inner, rows[-1:]])


def _safe_level(op: Trim, setup: Setup, face: SheetFace) -> float:
    """Return the height [m] of the safe plane above clamp and sheet, on the tool's side."""
    heights = [face.side * face.mesh.vertices[:, 2], np.array([face.side * face.rise])]
    heights += [face.side * transform(shape.pose, hull_points(shape))[:, 2] for shape in setup.stock.support]
    return face.side * (float(np.concatenate(heights).max()) + op.safe_mm * MM)
