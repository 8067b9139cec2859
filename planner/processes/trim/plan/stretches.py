"""From closed curves to the stretches that a knife cuts between entering and leaving the sheet.

The blade is in the plane of its curve. It is lifted out of the sheet, rotated and put in again at corners
that are sharper than it can pass, at micro-joints, and where its heading has rotated by the maximum. The
blade has a straight end behind its tip, and its edge rises from the tip forward. So the tip enters and leaves
the sheet at a distance from the ends of a stretch, and the blade cuts past a corner only at the near face.
"""

import dataclasses
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, dots, unit
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, issue_error
from planner.processes.trim.claims import MAX_STRETCHES
from planner.processes.trim.plan.cutting import CuttingTool
from planner.processes.trim.plan.face import FaceCurve, SheetFace, curve_distance
from planner.processes.trim.plan.operation import KnifeCut, Trim
from planner.processes.trim.plan.slots import PlannedOutline, Slot
from planner.tooling import Blade

OVERLAP_M: Final = 0.1 * MM
"""Length by which a stretch is cut past a corner, so that it meets the next one there [m]."""
OVERLAP_FRACTION: Final = 0.3
"""Upper bound of the overlap at a corner, as a fraction of the tolerance."""
CLOSING_OVERLAP_M: Final = 0.5 * MM
"""Length by which a stretch is cut past a point where a smooth curve closes or is divided [m]."""
MIN_STROKE_M: Final = 0.2 * MM
"""Minimum length of a stretch that is shorter than the blade [m]."""
MIN_PLAN_CORNER_RAD: Final = 1.0 * DEG
"""Minimum angle of a corner, seen from above [rad]."""
HEADING_REACH_M: Final = (0.3 * MM, 1.5 * MM)
"""Bounds of half the length of the chords that define a blade's heading [m].

The blade's own half width is used in between.
"""
NORMAL_REACH_M: Final = 2.0 * MM
"""Length of the curve on either side over which the normal of a blade is averaged [m]."""
NORMAL_SAMPLES: Final = 17
"""Number of points over which a normal is averaged."""
TILT_FRACTION: Final = 0.5
"""Maximum tilt of the averaged normal from the local one, as a fraction of the cone."""
FAR_FACE_FRACTION: Final = 0.4
"""Maximum deviation at the far face due to that tilt, as a fraction of the tolerance."""
BLADE_DEVIATION_FRACTION: Final = 0.5
"""Maximum deviation of front and back of a blade from a bent curve, as a fraction of the tolerance."""
BLADE_SAMPLES: Final = 9
"""Number of points along a blade that are compared with its curve."""
JOINT_TRIALS: Final = 48
"""Number of positions that are tried for micro-joints, so that they are away from all corners."""
MAX_ROTATION_STEP_RAD: Final = 80.0 * DEG
"""Maximum rotation of a knife in one move in the air [rad]."""

StretchEnd = Literal["corner", "joint", "piece"]
"""End of a stretch: a corner, a micro-joint, or a point where the curve continues smoothly."""


@dataclasses.dataclass(frozen=True)
class _CurveSpan:
    """A stretch of a curve from ``low`` to ``high`` [m] along it, with the kinds of its ends."""

    low: float
    high: float
    start_kind: StretchEnd
    end_kind: StretchEnd


def heading_vectors(axis: FloatArray, heading: FloatArray) -> FloatArray:
    """Return unit vectors (N, 3) normal to ``axis`` that have a given heading, seen from above.

    Args:
        axis: Unit axes (N, 3).
        heading: Headings (N,) [rad], from the x axis in plan.
    """
    flat = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    rise = np.copysign(np.maximum(np.abs(axis[:, 2]), 0.02), axis[:, 2])
    return unit(np.column_stack([flat, -dots(flat, axis[:, :2]) / rise]))


def find_corners(curve: FaceCurve, min_angle: float) -> FloatArray:
    """Return the lengths (C,) [m] along a curve at which it has a corner.

    The angle of a corner is that in the tangent plane of the face.

    Args:
        curve: Curve on the face.
        min_angle: Minimum angle of a corner [rad].
    """
    flat = curve.point[:, :2]
    following = unit(np.roll(flat, -1, axis=0) - flat)
    previous = np.roll(following, 1, axis=0)
    plan_angle = np.abs(
        np.arctan2(
            previous[:, 0] * following[:, 1] - previous[:, 1] * following[:, 0], dots(previous, following)
        )
    )
    incoming, outgoing = (
        heading_vectors(curve.normal, np.arctan2(direction[:, 1], direction[:, 0]))
        for direction in (previous, following)
    )
    angle = np.arctan2(np.linalg.norm(np.cross(incoming, outgoing), axis=1), dots(incoming, outgoing))
    return np.asarray(curve.along[:-1][(plan_angle > MIN_PLAN_CORNER_RAD) & (angle > min_angle)])


class _ClosedCurve:
    """A closed curve parametrised by length, with the lengths (C,) [m] of the corners at which stretches end.

    Lengths may be negative or beyond the length of the curve, which is periodic.
    """

    def __init__(self, curve: FaceCurve, face: SheetFace, corners: FloatArray) -> None:
        self.curve, self.face, self.corners, self.length = curve, face, corners, curve.length
        self._points = np.concatenate([curve.point, curve.point[:1]])

    def points(self, along: FloatArray, span: _CurveSpan) -> FloatArray:
        """Return points (N, 3) [m] on the face at lengths ``along`` (N,) [m] of a stretch.

        Past corners and joints the stretch is extended straight.
        """
        low = -np.inf if span.start_kind == "piece" else span.low
        high = np.inf if span.end_kind == "piece" else span.high
        out = self._points_on(np.clip(along, low, high))
        for end, excess, inner in (
            (low, np.minimum(along - low, 0.0), 1e-5),
            (high, np.maximum(along - high, 0.0), -1e-5),
        ):
            if np.isfinite(end) and np.any(excess):
                direction = (
                    self._points_on(np.array([end + inner])) - self._points_on(np.array([end]))
                ) / inner
                out = out + excess[:, None] * unit(direction)
        return self.face.at(out[:, :2])[0]

    def _points_on(self, along: FloatArray) -> FloatArray:
        """Return the points (N, 3) [m] of the curve itself at lengths (N,) [m]."""
        positions = along % self.length
        return np.stack(
            [np.interp(positions, self.curve.along, self._points[:, k]) for k in range(3)], axis=1
        )

    def headings(self, along: FloatArray, span: _CurveSpan, reach: float) -> FloatArray:
        """Return headings (N,) [rad], seen from above and without jumps, at lengths (N,) [m] of a stretch.

        They are those of chords that extend by ``reach`` [m] to either side, but not past corners and joints.
        """
        low = along - reach if span.start_kind == "piece" else np.clip(along - reach, span.low, span.high)
        high = along + reach if span.end_kind == "piece" else np.clip(along + reach, span.low, span.high)
        is_short = high - low < reach  # at the ends of a stretch chords are at least ``reach`` long
        low, high = np.where(is_short & (along > span.high - reach), high - reach, low), high
        high = np.where(is_short & (along < span.low + reach), low + reach, high)
        chords = self.points(high, span) - self.points(low, span)
        return np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))

    def normals(self, along: FloatArray, span: _CurveSpan, max_tilt: float) -> FloatArray:
        """Return normals (N, 3) of the face, averaged over its neighbourhood with linear weights.

        The neighbourhood is at most ``NORMAL_REACH_M`` on either side. The averages therefore change evenly
        where the face starts to bend. They differ by at most ``max_tilt`` [rad] from the local normals.
        """
        local_normals = self.face.at(self.points(along, span)[:, :2])[1]
        offsets = np.linspace(-1.0, 1.0, NORMAL_SAMPLES)
        for reach in NORMAL_REACH_M * 0.5 ** np.arange(4):
            points = self.points((along[:, None] + reach * offsets).ravel(), span)
            near_normals = self.face.at(points[:, :2])[1].reshape(len(along), NORMAL_SAMPLES, 3)
            mean = unit(np.einsum("k,nkd->nd", 1.0 - np.abs(offsets) + 1e-3, near_normals))
            if float(dots(mean, local_normals).min()) >= np.cos(max_tilt):
                return mean
        return local_normals

    def far_face_extension(self, along: float, end: float, span: _CurveSpan, thickness: float) -> float:
        """Return by how much [m] a stretch has to be longer to reach its corner at the far face as well.

        Between its end at ``along`` and the corner at ``end`` the normals rotate by an angle. So at the far
        face, ``thickness`` [m] behind the near one, the corner may be farther by the thickness times that
        angle. A margin of one half is added.
        """
        start_normal, end_normal = self.face.at(self.points(np.array([along, end]), span)[:, :2])[1]
        angle = float(np.arccos(np.clip(start_normal @ end_normal, -1.0, 1.0)))
        return 1.5 * thickness * min(angle, 0.5 * np.pi)

    def lengths_between(self, low: float, high: float) -> FloatArray:
        """Return the lengths (K,) [m] of the curve's own points from ``low`` to ``high``, both included."""
        revolutions = np.arange(np.floor(low / self.length), np.floor(high / self.length) + 1.0)
        vertices = (self.curve.along[:-1] + self.length * revolutions[:, None]).ravel()
        inner = vertices[(vertices > low + 1e-6) & (vertices < high - 1e-6)]
        return np.concatenate([[low], inner, [high]])


def plan_stretches(op: Trim, outline: PlannedOutline, face: SheetFace, tool: CuttingTool) -> list[Slot]:
    """Plan the stretches of an outline that a knife cuts without being lifted, each as a slot without leads.

    Stretches end at sharp corners, at micro-joints, and where the blade would rotate too far in one piece.

    Args:
        op: Operation.
        outline: Outline.
        face: Face of the sheet.
        tool: How the tool cuts.

    Raises:
        TandemError: ``trim.corner`` or ``trim.joints``.
    """
    by, blade = op.by, tool.blade
    if not isinstance(by, KnifeCut) or blade is None:
        raise ValueError("stretches are those of a knife")
    ring = _ClosedCurve(outline.curve, face, find_corners(outline.curve, by.turns_deg * DEG))
    blade_width = blade.end + float(blade.front(tool.depth))
    reach = float(np.clip(0.5 * blade_width, *HEADING_REACH_M))
    spans = _divide_spans(ring, _find_spans(outline, ring), by.most_turn_deg * DEG, reach)
    if len(spans) > MAX_STRETCHES:
        message = (
            f"{outline.spec.name}: the blade would be lifted {len(spans)} times, allowed {MAX_STRETCHES}"
        )
        hint = "draw round shapes as arcs or splines, not as corners, or allow a larger turns_deg"
        value, limit = float(len(spans)), float(MAX_STRETCHES)
        raise issue_error("trim.corner", message, value=value, limit=limit, hint=hint)
    knife = _BladeInSheet(by, blade, tool.depth, reach)
    out, issues = [], list[Issue]()
    for number, span in enumerate(spans, 1):
        name = outline.spec.name if len(spans) == 1 else f"{outline.spec.name}_p{number}"
        try:
            out.append(_build_stretch(op, outline, ring, span, knife, name))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    return out


def _find_spans(outline: PlannedOutline, ring: _ClosedCurve) -> list[_CurveSpan]:
    """Return the stretches of an outline between its corners and micro-joints.

    A curve without either is one stretch that starts where its heading is nearest to -x. All round curves
    then start alike, and the blade rotates by half a revolution either way from the x axis.
    """
    half_joint, joints = 0.5 * outline.spec.joint_mm * MM, _joint_centres(outline, ring)
    # length along the curve, half of the gap that is not cut there, kind
    marks: list[tuple[float, float, StretchEnd]] = [(float(at), 0.0, "corner") for at in ring.corners]
    marks = sorted([*marks, *((at, half_joint, "joint") for at in joints)])
    if not marks:
        whole = _CurveSpan(0.0, ring.length, "piece", "piece")
        lengths = ring.curve.along[:-1]
        heading = ring.headings(lengths, whole, HEADING_REACH_M[0])
        start = float(lengths[int(np.argmin(np.cos(heading)))])
        return [_CurveSpan(start, start + ring.length, "piece", "piece")]
    out = []
    for (at, half_gap, kind), (next_at, next_half_gap, next_kind) in zip(
        marks, [*marks[1:], marks[0]], strict=True
    ):
        next_mark = next_at if next_at > at else next_at + ring.length
        out.append(_CurveSpan(at + half_gap, next_mark - next_half_gap, kind, next_kind))
    return out


def _joint_centres(outline: PlannedOutline, ring: _ClosedCurve) -> list[float]:
    """Return the centres of micro-joints, as lengths [m] along a curve.

    The joints are evenly spaced, and as far from the corners of the curve as possible.

    Raises:
        TandemError: ``trim.joints`` if they do not fit.
    """
    count, width = outline.spec.joints, outline.spec.joint_mm * MM
    if not count:
        return []
    first_centres = ring.length * np.arange(count) / count
    shifts = ring.length / count * np.arange(JOINT_TRIALS) / JOINT_TRIALS
    best_shift, margin = shifts[0], np.inf
    if len(ring.corners):
        distances = np.abs(first_centres[:, None, None] + shifts[:, None] - ring.corners) % ring.length
        min_distances = np.minimum(distances, ring.length - distances).min(axis=(0, 2))
        best_shift, margin = float(shifts[int(np.argmax(min_distances))]), float(min_distances.max())
    if ring.length / count <= 2.0 * width or margin <= width:
        max_joints = int(ring.length / (2.0 * width))
        message = (
            f"{outline.spec.name}: {count} micro-joints of {width / MM:g} mm do not fit between its corners, "
        )
        message += "each at a distance of its width"
        hint = f"use fewer joints (at most {max_joints}), or a smaller joint_mm"
        raise issue_error("trim.joints", message, value=count, limit=max_joints, hint=hint)
    return [float(at) for at in (first_centres + best_shift) % ring.length]


def _divide_spans(
    ring: _ClosedCurve, spans: list[_CurveSpan], max_rotation: float, reach: float
) -> list[_CurveSpan]:
    """Divide stretches so that the heading of none rotates by more than ``max_rotation`` [rad].

    New ends are of the kind "piece", at which the curve continues. ``reach`` [m] is that of the chords that
    define headings.
    """
    out = []
    for span in spans:
        lengths = ring.lengths_between(span.low, span.high)
        heading = ring.headings(lengths, span, reach)
        cuts = _division_rows(heading, max_rotation)
        # the smallest rotation that needs no more pieces makes them of similar length
        for fraction in np.linspace(1.0, 0.5, 26)[1:]:  # 0.98 down to 0.5 of the maximum
            even_cuts = _division_rows(heading, fraction * max_rotation)
            if len(even_cuts) > len(cuts):
                break
            cuts = even_cuts
        ends = [span.low, *(float(lengths[k]) for k in cuts), span.high]
        kinds: list[StretchEnd] = [span.start_kind, *["piece" for _ in cuts], span.end_kind]  # type: ignore[list-item]
        out += [_CurveSpan(ends[k], ends[k + 1], kinds[k], kinds[k + 1]) for k in range(len(ends) - 1)]
    return out


def _division_rows(heading: FloatArray, max_rotation: float) -> list[int]:
    """Return the indices at which headings (N,) [rad] are divided, so that no piece rotates too far."""
    out, first = list[int](), 0
    for k in range(1, len(heading)):
        piece = heading[first : k + 1]
        if float(np.ptp(piece)) > max_rotation and k > first + 1:
            first = k - 1
            out.append(first)
    return out


@dataclasses.dataclass(frozen=True)
class _BladeInSheet:
    """Blade of a knife as it cuts a sheet.

    Attributes:
        by: How the operation cuts with it.
        blade: The blade.
        depth: Depth of its tip behind the face [m].
        reach: Reach of the chords that define its heading, on either side [m].
    """

    by: KnifeCut
    blade: Blade
    depth: float
    reach: float


def _build_stretch(
    op: Trim, outline: PlannedOutline, ring: _ClosedCurve, span: _CurveSpan, knife: _BladeInSheet, name: str
) -> Slot:
    """Plan one stretch of a knife: where its tip enters and leaves the sheet, and the points and headings.

    The blade extends to both sides of its tip along the curve. Next to a corner or a micro-joint the tip
    therefore enters late and leaves early, so that the blade ends there. At a corner it goes on by a short
    overlap, so that the cuts of both stretches meet at both faces.

    Raises:
        TandemError: ``trim.corner`` if the blade cuts too far past a corner or deviates too far from the
            curve, ``trim.joints`` if the stretch is shorter than the blade.
    """
    by, blade, depth, reach = knife.by, knife.blade, knife.depth, knife.reach
    # length of the blade before its tip at the far and at the near face
    far_front, near_front = float(blade.front(by.below_mm * MM)), float(blade.front(depth))
    overlap = min(OVERLAP_M, OVERLAP_FRACTION * op.shape_tol_mm * MM)
    # path of the tip; where a curve continues, the tip cuts all of it
    low, high = span.low, span.high + CLOSING_OVERLAP_M
    if span.start_kind != "piece":
        low = span.low + blade.end
        low -= (
            overlap + ring.far_face_extension(low, span.low, span, depth - by.below_mm * MM)
            if span.start_kind == "corner"
            else 0.0
        )
    if span.end_kind != "piece":
        high = span.high - (near_front if span.end_kind == "joint" else far_front)
        high += (
            overlap + ring.far_face_extension(high, span.high, span, depth - by.below_mm * MM)
            if span.end_kind == "corner"
            else 0.0
        )
    if high - low < MIN_STROKE_M:
        if "joint" in (span.start_kind, span.end_kind):
            message = f"{name}: the stretch of {(span.high - span.low) / MM:.1f} mm next to a micro-joint is "
            message += f"shorter than the blade, {(blade.end + near_front) / MM:.1f} mm"
            hint = "use fewer joints, or a narrower blade"
            raise issue_error("trim.joints", message, hint=hint)
        # between corners a short stretch is cut with a minimal motion about its middle
        middle = 0.5 * (low + high)
        low, high = middle - 0.5 * MIN_STROKE_M, middle + 0.5 * MIN_STROKE_M
    along = ring.lengths_between(low, high)
    point = ring.points(along, span)
    max_far_tilt = float(np.arctan2(FAR_FACE_FRACTION * op.shape_tol_mm * MM, depth - by.below_mm * MM))
    normal = ring.normals(along, span, min(TILT_FRACTION * op.cone_deg * DEG, max_far_tilt))
    heading = ring.headings(along, span, reach)
    # whole revolutions are removed, so that the middle heading of each stretch is within half a revolution
    middle_heading = 0.5 * (heading.max() + heading.min())
    heading = heading - 2.0 * np.pi * np.round(middle_heading / (2.0 * np.pi))
    overcut = _corner_overcut(
        outline, ring, span, (span.low - (low - blade.end), high + near_front - span.high)
    )
    if overcut > by.overcut_mm * MM + overlap + 1e-9:  # 1e-9: rounding
        end = ring.points(np.array([span.high]), span)[0] / MM
        message = f"{name}: the blade cuts {overcut / MM:.2f} mm past a corner into the part, about "
        message += f"({end[0]:.1f}, {end[1]:.1f}) mm, allowed {by.overcut_mm:g} mm"
        hint = f"allow overcut_mm: {np.ceil(10.0 * overcut / MM) / 10.0:g}, or use a narrower blade, "
        hint += f"or a below_mm of its ground_mm ({blade.ground / MM:g}), where both faces see its full width"
        value, limit = overcut / MM, by.overcut_mm
        raise issue_error("trim.corner", message, value=value, limit=limit, unit="mm", hint=hint)
    slot = Slot(name, outline.spec.name, point, normal, 0, len(point) - 1, heading, overcut)
    _check_blade_deviation(
        op, outline, slot, along, span, (blade, near_front, ring.face, depth - by.below_mm * MM)
    )
    return slot


def _corner_overcut(
    outline: PlannedOutline, ring: _ClosedCurve, span: _CurveSpan, past: tuple[float, float]
) -> float:
    """Return how far [m] a blade cuts past the corners of a stretch into the part.

    At both ends it goes on by the lengths ``past`` [m]. Only ends at corners count, and only points of the
    blade where it would harm the part.
    """
    out = 0.0
    for kind, end, sign, distance in (
        (span.start_kind, span.low, -1.0, past[0]),
        (span.end_kind, span.high, 1.0, past[1]),
    ):
        if kind != "corner" or distance <= 0.0:
            continue
        beyond = distance * np.linspace(0.0, 1.0, BLADE_SAMPLES)[1:]
        points = ring.points(end + sign * beyond, span)
        out = max(out, float(np.max(beyond, initial=0.0, where=~_is_harmless(outline, points))))
    return out


def _is_harmless(outline: PlannedOutline, points: FloatArray) -> BoolArray:
    """Return whether (N,) points are in the waste or on the curve."""
    return np.asarray(outline.in_waste(points[:, :2]) | (curve_distance(points, outline.curve.point) < 1e-6))


def _check_blade_deviation(
    op: Trim,
    outline: PlannedOutline,
    slot: Slot,
    along: FloatArray,
    span: _CurveSpan,
    blade: tuple[Blade, float, SheetFace, float],
) -> None:
    """Check that all of the blade stays near the curve where it is bent, at both faces.

    Points of the blade in the waste do not count, except where it enters and leaves the sheet. Parts of the
    blade past a corner or a micro-joint do not count either. ``along`` (N,) [m] are the lengths of the slot's
    points along the curve. ``blade`` is the blade, its length before the tip at the near face [m], the face,
    and the sheet's thickness [m].

    Raises:
        TandemError: ``trim.corner``.
    """
    blade_shape, near_front, face, thickness = blade
    blade_offsets = np.linspace(-blade_shape.end, near_front, BLADE_SAMPLES)
    lengths = along[:, None] + blade_offsets
    directions = heading_vectors(slot.normal, slot.heading)
    points = slot.point[:, None] + blade_offsets[:, None] * directions[:, None]
    inside = ((lengths >= span.low) | (span.start_kind == "piece")) & (
        (lengths <= span.high) | (span.end_kind == "piece")
    )
    points = points[inside]
    if not len(points):
        return
    # far face relative to the near one: the blade is normal to the sheet only at its tip
    normal_change = face.at(points[:, :2])[1] - np.repeat(slot.normal, BLADE_SAMPLES, axis=0)[inside.ravel()]
    points = np.concatenate([points, points + face.side * thickness * normal_change])
    deviations = np.where(outline.in_waste(points[:, :2]), 0.0, curve_distance(points, outline.curve.point))
    # where it enters and leaves, the whole blade has to be on the curve, also in the waste; row is the index
    # of the slot's point to which each point of the blade belongs, for both faces
    row = np.tile(np.repeat(np.arange(len(along)), BLADE_SAMPLES)[inside.ravel()], 2)
    ends = [0] * (span.start_kind != "piece") + [len(along) - 1] * (span.end_kind != "piece")
    is_end = np.isin(row, ends)
    deviations[is_end] = (
        curve_distance(points[is_end], outline.curve.point) if is_end.any() else deviations[is_end]
    )
    k, limit = int(np.argmax(deviations)), BLADE_DEVIATION_FRACTION * op.shape_tol_mm * MM
    if deviations[k] > limit:
        x, y, _ = points[k] / MM
        message = (
            f"{slot.name}: at ({x:.1f}, {y:.1f}) mm the blade, {(blade_shape.end + near_front) / MM:.1f} mm "
            "wide in the "
        )
        message += f"sheet, is {deviations[k] / MM:.2f} mm off its curve, allowed {limit / MM:.2f} mm"
        hint = "use a narrower blade, or less below_mm, draw a wider bend, or a sharp corner, at which it "
        hint += f"is lifted, or use shape_tol_mm: {np.ceil(200.0 * deviations[k] / MM) / 100.0:g}"
        value, limit_mm = float(deviations[k]) / MM, limit / MM
        raise issue_error("trim.corner", message, value=value, limit=limit_mm, unit="mm", hint=hint)


@dataclasses.dataclass(frozen=True)
class KnifeRotation:
    """M positions of a knife in the air between two stretches, over which it rotates.

    Attributes:
        tip: Tips (M, 3) [m].
        axis: Axes (M, 3).
        heading: Headings (M,) [rad].
    """

    tip: FloatArray
    axis: FloatArray
    heading: FloatArray


def rotate_in_air(
    start: tuple[FloatArray, FloatArray, float], end: tuple[FloatArray, FloatArray, float]
) -> KnifeRotation:
    """Rotate a knife in the air from the end of a stretch to the start of the next one.

    Headings have no jumps, so a knife rotates back what it has rotated in the sheet. Start and end themselves
    are not included in the result.

    Args:
        start: Tip (3,) [m], axis (3,) and heading [rad] above the end of a stretch.
        end: Tip (3,) [m], axis (3,) and heading [rad] above the start of the next stretch.
    """
    rotation = end[2] - start[2]
    count = max(int(np.ceil(abs(rotation) / MAX_ROTATION_STEP_RAD - 1e-9)) - 1, 0)
    fraction = (np.arange(count) + 1.0) / (count + 1.0)
    tip = start[0] + fraction[:, None] * (end[0] - start[0])
    axis = start[1] + fraction[:, None] * (end[1] - start[1])
    return KnifeRotation(np.asarray(tip), unit(np.asarray(axis)), np.asarray(start[2] + fraction * rotation))
