"""Flank cuts: from a ruled surface of the part to roughing passes and the finishing pass.

Lead-in and lead-out continue the surface until the cutter has left the block. At convex corners the cutter is
rotated about the corner.
"""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, RuledSurface, unit
from planner.geometry.polylines import thin_rows
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, Severity, TandemError, has_errors, issue_error
from planner.problem import Part
from planner.processes.milling.plan import cutter_contact
from planner.processes.milling.plan.cutter_contact import RulingStrip, smooth_strips
from planner.processes.milling.plan.operation import FlankCut, Milling
from planner.processes.milling.plan.tool_path import CutterPass, plain_path
from planner.tooling import Cutter

CORNER_STEP_RAD: Final = np.deg2rad(5.0)
"""Rotation of the cutter about a corner from target to target [rad]."""
LEAD_TARGETS: Final = 6
"""Number of targets of a lead on which the tool still rotates."""
MAX_LEAD_ROTATION_RAD: Final = np.deg2rad(10.0)
"""Maximum rotation of a tool along a lead [rad]."""
MAX_LEAD_EXTENSIONS: Final = 8
"""Maximum number of extensions of a lead until the cutter is outside the block at its end."""
LEAD_SAMPLES: Final = 257
"""Number of points on the axis of a cutter that are compared with the block."""
LEAD_MARGIN_M: Final = 1e-4
"""Clearance [m] between cutter and block at the end of a lead, because programs are rounded."""
MAX_LEAD_M: Final = 5.0
"""Maximum length of a lead [m]. A lead that is still inside the block after this length never leaves it."""


def exit_distance(ends: FloatArray, direction: FloatArray, box: FloatArray, clearance: float) -> float:
    """Return the distance [m] that a cutter has to move to be beyond one side of the block.

    The length of a lead follows from it. All points of the axis are then clear of this side. The distance is
    at most ``MAX_LEAD_M``.

    Args:
        ends: Points (K, 3) [m] of the cutter's axis.
        direction: Direction, a unit vector (3,).
        box: Block (2, 3) [m].
        clearance: Required distance beyond the side [m].
    """
    best = MAX_LEAD_M
    for axis in range(3):
        if direction[axis] > 1e-6:
            best = min(best, (box[1, axis] + clearance - float(ends[:, axis].min())) / direction[axis])
        elif direction[axis] < -1e-6:
            best = min(best, (float(ends[:, axis].max()) - box[0, axis] + clearance) / -direction[axis])
    return max(best, 0.0)


def extend_axis(
    low: FloatArray, high: FloatArray, low_step: FloatArray, high_step: FloatArray, length: float
) -> tuple[FloatArray, FloatArray]:
    """Extend the motion of an axis, first as the surface would continue, then with decreasing rotation.

    The tool therefore does not stop rotating abruptly.

    Args:
        low: Lower point of the axis (3,) [m].
        high: Upper point of the axis (3,) [m].
        low_step: Displacement of the lower point (3,) [m] in a step of the motion.
        high_step: Displacement of the upper point (3,) [m] in the same step.
        length: Length of the extension [m].

    Returns:
        Lower and upper points (K, 3) [m].
    """
    scale = max(float(np.linalg.norm(low_step)), float(np.linalg.norm(high_step)), 1e-12)
    straight = 0.5 * (low_step + high_step) / scale
    half_rotation = 0.5 * (high_step - low_step) / scale
    # positions count the path of the faster end; the middle moves less, but 0.1 bounds a rotation in place
    path_length = length / max(float(np.linalg.norm(straight)), 0.1)
    rate = float(np.linalg.norm(half_rotation)) * 2.0 / max(float(np.linalg.norm(high - low)), 1e-9)
    rotating_length = min(path_length, 2.0 * MAX_LEAD_ROTATION_RAD / max(rate, 1e-9))
    positions = np.unique(np.append(np.linspace(0.0, rotating_length, LEAD_TARGETS + 1), path_length))[
        :, None
    ]
    # The rate of rotation falls linearly to 0 over the rotating length.
    rotation_length = np.where(
        positions < rotating_length,
        positions - positions * positions / (2.0 * rotating_length),
        0.5 * rotating_length,
    )
    return (
        low + positions * straight - rotation_length * half_rotation,
        high + positions * straight + rotation_length * half_rotation,
    )


def round_corner(
    corner_ruling: tuple[FloatArray, FloatArray],
    previous_axis: tuple[FloatArray, FloatArray],
    next_axis: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Rotate the axis about the ruling of a convex corner, at constant distances from its ends.

    Args:
        corner_ruling: Ends of the corner's ruling, (3,) each [m].
        previous_axis: Ends of the axis before the corner, (3,) each [m].
        next_axis: Ends of the axis after the corner, (3,) each [m].

    Returns:
        Lower and upper points (K, 3) [m] of the axis between both, ends excluded.
    """
    sides = []
    angles = []
    for corner, start, end in zip(corner_ruling, previous_axis, next_axis, strict=True):
        a, b = start - corner, end - corner
        angles.append(
            float(
                np.arccos(
                    np.clip(a @ b / max(float(np.linalg.norm(a)) * float(np.linalg.norm(b)), 1e-18), -1, 1)
                )
            )
        )
    count = max(int(np.ceil(max(angles) / CORNER_STEP_RAD)), 1)
    fraction = np.arange(1, count)[:, None] / count
    for corner, start, end, angle in zip(corner_ruling, previous_axis, next_axis, angles, strict=True):
        a, b = start - corner, end - corner
        if angle < 1e-9:
            sides.append(corner + (1.0 - fraction) * a + fraction * b)
        else:  # spherical interpolation
            sides.append(
                corner + (np.sin((1.0 - fraction) * angle) * a + np.sin(fraction * angle) * b) / np.sin(angle)
            )
    return sides[0], sides[1]


RULING_SPACING_FACTOR: Final = 1.0 / 10.0
"""Distance between the rulings at which the cutter is placed, as a factor of its radius."""
MAX_RULINGS: Final = 6000
"""Approximate maximum number of rulings at which the cutter is placed."""
CHORD_FRACTION: Final = 0.1
"""Fraction of the tolerance that straight moves between targets may use."""
BLOCK_CLEARANCE_M: Final = 2.0 * MM
"""Distance [m] of the cutter from the block at the ends of its leads."""
MAX_INNER_CORNER_RAD: Final = 3.0 * DEG
"""Maximum angle [rad] of an inner corner that a round cutter can mill."""
ROUNDING_FACTOR: Final = 1.05
"""Advised corner radius as a factor of the cutter's radius. In a corner of its own radius the cutter would
rub.
"""
SLIMMER_TRIALS: Final = 4
"""Maximum number of thinner cutters that are tried along twisted rulings."""
TOLERANCE_FRACTION: Final = 0.97
"""Fraction of the tolerance within which an advised thinner cutter must stay, so that the advice is safe."""
MIN_ADVISED_RADIUS_M: Final = 0.5 * MM
"""Minimum radius of a cutter that is advised [m]."""
MAX_LENGTH_RATIO: Final = 2.0
"""Ratio of guide lengths above which a warning is issued. One end of the flank moves faster by this ratio."""


@dataclasses.dataclass(frozen=True)
class FlankPlacement:
    """Positions of a cutter along a ruled surface.

    Attributes:
        low: Lower points of the axis (N, 3) [m], opposite the tip guide.
        high: Upper points of the axis (N, 3) [m], opposite the other guide.
        deviation: Largest deviation of the cutter from the surface [m].
    """

    low: FloatArray
    high: FloatArray
    deviation: float


def find_ruled_surface(part: Part | None, name: str) -> RuledSurface:
    """Return the ruled surface ``name`` of a part.

    Raises:
        TandemError: ``milling.no_surface`` if the part has no ruled surface of this name.
    """
    surfaces = {} if part is None else {ruled.name: ruled for ruled in part.ruled}
    if name not in surfaces:
        surface_names = ", ".join(surfaces) or "none"
        message = (
            f"cuts: the part has no ruled surface {name}; it has {surface_names}. Name one of them, or add "
            "it "
        )
        message += "under part.ruled"
        raise issue_error("milling.no_surface", message, field="operations.cuts")
    return surfaces[name]


@dataclasses.dataclass(frozen=True)
class FlankPasses:
    """Passes of a flank cut.

    Attributes:
        passes: Roughing passes, then the finishing pass.
        deviation: Largest deviation of the cutter from the surface in the finishing pass [m].
        notes: Warnings for the user.
        fitting_radius: Radius [m] of a cutter that fits if the deviation is too large, None if it is not too
            large or if no cutter fits.
    """

    passes: tuple[CutterPass, ...]
    deviation: float
    notes: tuple[Issue, ...]
    fitting_radius: float | None = None


def plan_passes(
    op: Milling, cut: FlankCut, ruled: RuledSurface, cutter: Cutter, box: FloatArray
) -> FlankPasses:
    """Plan roughing passes and the finishing pass.

    Args:
        op: Operation.
        cut: Flank cut.
        ruled: Its ruled surface.
        cutter: Cutter of the arm.
        box: Block (2, 3) [m].

    Raises:
        TandemError: Codes ``milling.*``.
    """
    issues = tuple(check_flank(op, cut, ruled, cutter))
    if has_errors(issues):
        raise TandemError(issues)
    overrun, in_block = tip_overrun(cut, cutter), CutterAndBlock(cutter, box)
    finishing = place_cutter(op, cut, ruled, cutter.radius)
    depth = float(np.linalg.norm(finishing.high - finishing.low, axis=1).max()) + overrun
    out = []
    if cut.stepdown_mm is not None and cut.guides == "surface":
        roughing = place_cutter(op, cut, ruled, cutter.radius + cut.leave_mm * MM)
        count = max(int(np.ceil(depth / (cut.stepdown_mm * MM) - 1e-9)), 1)
        for k in range(1, count + 1):
            lift = depth * (1.0 - k / count) - overrun
            out.append(_build_pass(op, cut, f"{cut.flank}_r{k}", roughing, lift, in_block))
    out.append(_build_pass(op, cut, cut.flank, finishing, -overrun, in_block))
    return FlankPasses(
        tuple(out),
        finishing.deviation,
        tuple(issues),
        _fitting_radius(op, cut, ruled, cutter.radius, finishing.deviation),
    )


def _fitting_radius(
    op: Milling, cut: FlankCut, ruled: RuledSurface, radius: float, deviation: float
) -> float | None:
    """Return the radius [m] of a thinner cutter that fits twisted rulings.

    It is None if the ``deviation`` of the cutter with ``radius`` is within the tolerance, or if no trial
    succeeds. Several radii are tried, because the deviation is only roughly proportional to the radius.
    """
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    for _ in range(SLIMMER_TRIALS):
        if deviation <= tolerance:
            return None
        radius *= TOLERANCE_FRACTION * tolerance / deviation
        if radius < MIN_ADVISED_RADIUS_M:
            return None
        deviation = place_cutter(op, cut, ruled, radius).deviation
        if deviation <= TOLERANCE_FRACTION * tolerance:
            return radius
    return None


def tip_overrun(cut: FlankCut, cutter: Cutter) -> float:
    """Return the distance [m] of the tip beyond the tip guide.

    It includes the rounded end of the cutter, which does not reach the wall.
    """
    return cut.overrun_mm * MM + (cutter.corner if cut.guides == "surface" else 0.0)


def place_cutter(op: Milling, cut: FlankCut, ruled: RuledSurface, radius: float) -> FlankPlacement:
    """Place a cutter of ``radius`` [m] along the surface, in the direction that the cut requires.

    With ``guides: surface`` its flank touches both guides, and it is rotated about the ruling between smooth
    pieces. With ``guides: tool`` the guides lead the axis itself, and the deviation is 0.
    """
    pieces = _oriented_strips(op, cut, ruled, radius)
    contact_radius = radius if cut.guides == "surface" else 0.0
    lows: list[FloatArray] = []
    highs: list[FloatArray] = []
    max_deviation = 0.0
    last: RulingStrip | None = None
    for strip in pieces:
        low, high = cutter_contact.cutter_axes(strip, contact_radius)
        if contact_radius:
            deviations = np.abs(cutter_contact.flank_deviation(strip, contact_radius, low, high))
            max_deviation = max(max_deviation, float(deviations.max()))
        if last is not None and contact_radius:
            corner_ruling = strip.low[0], strip.high[0]
            corner_axes = round_corner(corner_ruling, (lows[-1][-1], highs[-1][-1]), (low[0], high[0]))
            lows.append(corner_axes[0])
            highs.append(corner_axes[1])
        lows.append(low)
        highs.append(high)
        last = strip
    return FlankPlacement(np.concatenate(lows), np.concatenate(highs), max_deviation)


def check_flank(op: Milling, cut: FlankCut, ruled: RuledSurface, cutter: Cutter) -> Iterator[Issue]:
    """Yield issues about the lengths of the guides, the flute and overhang, and inner corners."""
    field = f"operations.cuts.{cut.flank}"
    pieces = _oriented_strips(op, cut, ruled, cutter.radius)
    lengths = [
        sum(_polyline_length(side) for side in sides)
        for sides in zip(*((s.low, s.high) for s in pieces), strict=True)
    ]
    ratio = max(lengths) / max(min(lengths), 1e-9)
    if ratio > MAX_LENGTH_RATIO:
        longer_guide = int(lengths[1] > lengths[0])
        names = ("start", "end") if cut.tip == "start" else ("end", "start")
        message = (
            f"flank {cut.flank}: its guides are {lengths[0] / MM:.0f} and {lengths[1] / MM:.0f} mm long, "
        )
        message += f"so one end of the flank moves {ratio:.1f} times as fast as the other. The feed applies "
        message += (
            f"to the faster end. If the slower end burns or rubs, shorten the guide {names[longer_guide]} to "
        )
        message += (
            f"{np.floor(MAX_LENGTH_RATIO * min(lengths) / MM * 10.0) / 10.0:.1f} mm or less, or divide the "
        )
        message += "surface"
        yield Issue(
            "milling.guide_lengths",
            message,
            Severity.WARNING,
            field=field,
            value=ratio,
            limit=MAX_LENGTH_RATIO,
        )
    wall_height = max(float(np.linalg.norm(strip.high - strip.low, axis=1).max()) for strip in pieces)
    required = wall_height + tip_overrun(cut, cutter)
    if cut.guides == "surface" and required > cutter.flute + 1e-9:
        message = (
            f"flank {cut.flank} needs {_ceil_mm(required):.2f} mm of flute (wall {wall_height / MM:.1f}, "
            "beyond its guide "
        )
        message += (
            f"{tip_overrun(cut, cutter) / MM:.1f}), the cutter has {cutter.flute / MM:.1f}; use a longer "
            "flute"
        )
        if required > cutter.overhang:
            message += " and overhang"
        message += ", or divide the wall into surfaces one above the other"
        yield Issue(
            "milling.flute", message, field=field, value=required / MM, limit=cutter.flute / MM, unit="mm"
        )
    if required > cutter.overhang:
        message = (
            f"flank {cut.flank}: the tip is {required / MM:.1f} mm below the wall's top, and the holder "
        )
        message += (
            f"starts {cutter.overhang / MM:.1f} mm behind it; use an overhang of {_ceil_mm(required):.2f} mm "
            "or "
        )
        message += "more"
        yield Issue(
            "milling.holder", message, field=field, value=required / MM, limit=cutter.overhang / MM, unit="mm"
        )
    if cut.guides == "surface":
        yield from _corner_issues(cut, pieces, ruled.closed, cutter.radius, field)


def _corner_issues(
    cut: FlankCut, pieces: list[RulingStrip], closed: bool, radius: float, field: str
) -> Iterator[Issue]:
    """Yield ``milling.corner`` for each inner corner between pieces, where a cutter leaves a fillet."""
    loop = [*pieces, pieces[0]] if closed and not pieces[0].is_closed else pieces
    for previous, following in itertools.pairwise(loop):
        corner_angle = float(
            np.arcsin(np.clip(following.tangents()[0][0] @ previous.normals()[0][-1], -1.0, 1.0))
        )
        if corner_angle > MAX_INNER_CORNER_RAD:
            point_text = ", ".join(f"{v / MM:.1f}" for v in following.low[0])
            message = (
                f"flank {cut.flank} has an inner corner of {corner_angle / DEG:.0f} degrees at {point_text} "
                "mm, "
            )
            # Distance of an inscribed circle from the corner of two walls: r (1 / cos(angle / 2) - 1).
            residual = radius * (1.0 / np.cos(0.5 * corner_angle) - 1.0)
            message += f"where a cutter of {radius / MM:g} mm radius leaves a fillet, "
            message += f"{residual / MM:.2f} mm from the corner; round both guides there by "
            message += f"{_ceil_mm(ROUNDING_FACTOR * radius):.2f} mm or more"
            yield Issue(
                "milling.corner",
                message,
                field=field,
                **measurement(corner_angle / DEG, MAX_INNER_CORNER_RAD / DEG, "deg"),
            )


def _oriented_strips(op: Milling, cut: FlankCut, ruled: RuledSurface, radius: float) -> list[RulingStrip]:
    """Return the smooth pieces of the surface in the direction and order in which a cutter passes them.

    Rulings are close together relative to the cutter's ``radius`` [m].
    """
    total_length = sum(
        float(np.linalg.norm(np.diff(side, axis=0), axis=1).sum()) for side in (ruled.start, ruled.end)
    )
    step = max(radius * RULING_SPACING_FACTOR, 0.5 * total_length / MAX_RULINGS)
    # chord error of the guides: 2 % of the tolerance, so that it does not count
    pieces = smooth_strips(ruled, cut.tip == "start", 0.02 * op.shape_tol_mm * MM, step)
    if cut.direction == "against" or (
        cut.direction in ("climb", "conventional") and cut.direction != _milling_direction(pieces[0])
    ):
        return [strip.reverse() for strip in pieces[::-1]]
    return pieces


def _milling_direction(strip: RulingStrip) -> str:
    """Return ``climb`` or ``conventional``, whichever a cut in the direction of a strip is.

    A cutter that turns clockwise, seen from the spindle, climbs if it is on the left of the surface, seen
    along the feed with the spindle up.
    """
    left = np.cross(strip.high[0] - strip.low[0], strip.tangents()[0][0])
    return "climb" if float(left @ strip.normals()[0][0]) > 0.0 else "conventional"


@dataclasses.dataclass(frozen=True)
class CutterAndBlock:
    """Cutter and the block that it mills.

    Attributes:
        cutter: Cutter of the arm.
        box: Block (2, 3) [m], lower and upper corner.
    """

    cutter: Cutter
    box: FloatArray


def _build_pass(
    op: Milling, cut: FlankCut, name: str, placement: FlankPlacement, lift: float, in_block: CutterAndBlock
) -> CutterPass:
    """Return one pass with its leads.

    Args:
        op: Operation.
        cut: Flank cut.
        name: Name of the pass.
        placement: Positions of the cutter along the surface.
        lift: Height of the tip above the tip guide [m], negative if the tip overruns it.
        in_block: Cutter and block.
    """
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    rows = thin_rows(
        np.stack([placement.low, placement.high], axis=1), CHORD_FRACTION * tolerance, op.step_mm * MM
    )
    low, high = placement.low[rows], placement.high[rows]
    lead_in = _extend_lead(cut, low, high, (0, 1), lift, in_block)
    lead_out = _extend_lead(cut, low, high, (-1, -2), lift, in_block)
    base = np.concatenate([lead_in[0][::-1], low, lead_out[0]])
    top = np.concatenate([lead_in[1][::-1], high, lead_out[1]])
    axis = unit(top - base)
    first = len(lead_in[0])
    path = plain_path(base + lift * axis, axis, (cut.feed_mm_s or op.feed_mm_s) * MM)
    reach = float(np.linalg.norm(placement.high - placement.low, axis=1).max()) - lift
    return CutterPass(name, path, first, first + len(rows) - 1, max(reach, 0.0))


def _extend_lead(
    cut: FlankCut,
    low: FloatArray,
    high: FloatArray,
    rows: tuple[int, int],
    lift: float,
    in_block: CutterAndBlock,
) -> tuple[FloatArray, FloatArray]:
    """Return the axes of a lead, which continues the motion of the cutter beyond one end of a pass.

    Args:
        cut: Flank cut.
        low: Lower points of the axes of the pass (N, 3) [m].
        high: Upper points of the axes of the pass (N, 3) [m].
        rows: Index of the end of the pass, and of the axis next to it.
        lift: Height of the tip above the tip guide [m].
        in_block: Cutter and block.

    Returns:
        Lower and upper points (K, 3) [m], from the pass outwards.
    """
    k, next_row = rows
    low_step, high_step = low[k] - low[next_row], high[k] - high[next_row]
    direction = low_step + high_step
    direction /= max(float(np.linalg.norm(direction)), 1e-12)
    if cut.lead_mm is None:
        end_points = np.stack([low[k] + min(lift, 0.0) * unit(high[k] - low[k]), high[k]])
        clearance = in_block.cutter.radius + BLOCK_CLEARANCE_M
        length = exit_distance(end_points, direction, in_block.box, clearance)
    else:
        length = cut.lead_mm * MM
    if length < 1e-6:
        return low[:0], high[:0]
    low_points, high_points = extend_axis(low[k], high[k], low_step, high_step, length)
    for _ in range(MAX_LEAD_EXTENSIONS if cut.lead_mm is None else 0):
        extra = _remaining_exit(low_points[-1], high_points[-1], direction, lift, in_block)
        if extra <= 0.0 or length >= MAX_LEAD_M:
            break
        # A tool that rotates along the lead lags at one end and tilts over the block above the surface.
        length += extra
        low_points, high_points = extend_axis(low[k], high[k], low_step, high_step, length)
    return low_points[1:], high_points[1:]


def _remaining_exit(
    low: FloatArray, high: FloatArray, direction: FloatArray, lift: float, in_block: CutterAndBlock
) -> float:
    """Return how far [m] a cutter still has to move along ``direction`` (3,) to be off the block, 0 if it is.

    The cutter is retracted along the axis from ``low`` to ``high`` (3,), so its whole overhang counts.
    """
    cutter, box = in_block.cutter, in_block.box
    axis = unit(high - low)
    positions = np.linspace(lift, lift + cutter.overhang, LEAD_SAMPLES)
    axis_points = low + positions[:, None] * axis
    gap = np.linalg.norm(np.maximum(np.maximum(box[0] - axis_points, axis_points - box[1]), 0.0), axis=1)
    inside = gap < cutter.radius + LEAD_MARGIN_M
    return (
        exit_distance(axis_points[inside], direction, box, cutter.radius + BLOCK_CLEARANCE_M)
        if inside.any()
        else 0.0
    )


def _ceil_mm(length: float) -> float:
    """Convert a length [m] to mm, rounded up so that following the advice is sufficient."""
    return float(np.ceil(length / MM * 100.0 - 1e-6) / 100.0)


def _polyline_length(side: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(side, axis=0), axis=1).sum())
