"""Point milling: a face in parallel lines, and patterns of curves engraved on it.

Points on a surface become tips and axes of a cutter whose end touches the surface there. Lines are spaced by
a stepover or by the height of the ridges between them. A pattern of curves is projected along z onto the
part's front.
"""

import dataclasses
from pathlib import Path
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, dots, unit
from planner.geometry.face_from_above import FaceFromAbove, ProjectedPoints
from planner.geometry.polylines import thin_rows
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, TandemError, issue_error
from planner.processes.milling.plan.cutter_contact import contains_points
from planner.processes.milling.plan.operation import EngraveCut, LinesCut, Milling
from planner.processes.milling.plan.tool_path import CutterPass, plain_path
from planner.reading.part_ruled import build_guide
from planner.tooling import Cutter

UPRIGHT_ANGLE_RAD: Final = 1e-3
"""Angle between axis and normal [rad] below which a flat end touches with its centre."""


def tilted_axes(normal: FloatArray, feed: FloatArray, lead: float, tilt: float) -> FloatArray:
    """Return axes (N, 3): normals tilted forward along the feed by ``lead`` and to its left by ``tilt``.

    Args:
        normal: Unit normals (N, 3).
        feed: Feed directions (N, 3), of any length.
        lead: Forward tilt [rad].
        tilt: Tilt to the left [rad].
    """
    along = unit(feed - dots(feed, normal)[:, None] * normal)
    left = np.cross(normal, along)
    return unit(normal + np.tan(lead) * along + np.tan(tilt) * left)


def tool_tips(contact: FloatArray, normal: FloatArray, axis: FloatArray, cutter: Cutter) -> FloatArray:
    """Return tips (N, 3) [m] of cutters that touch planes.

    The end of every cutter is a torus of tube radius r (its corner) about a circle of radius R - r. For a
    ball the circle is a point, for a cylinder the tube has no thickness. The centre of the tube is r above
    the contact along the normal. From there the centre of the circle is R - r away, in the direction in which
    the normal is tilted from the axis.

    Args:
        contact: Contact points (N, 3) [m].
        normal: Unit normals of the planes (N, 3).
        axis: Axes of the cutters (N, 3).
        cutter: Cutter.
    """
    lateral = normal - dots(normal, axis)[:, None] * axis
    sine = np.linalg.norm(lateral, axis=1, keepdims=True)
    direction = np.where(sine > UPRIGHT_ANGLE_RAD, lateral / np.maximum(sine, 1e-15), 0.0)
    circle = cutter.radius - cutter.corner
    return np.asarray(contact + cutter.corner * (normal - axis) + circle * direction)


def ridge_step(height: float, radius: float, curvature: FloatArray) -> FloatArray:
    """Return the distance (N,) [m] between lines of a ball that leave scallops (ridges) of a given height.

    With the step s, the radius R and the curvature k, the height is h = s^2 / 8 (1 / R + k), the difference
    of two parabolas. In hollows the step is at most twice that of a flat face, because a hollow is small and
    the face around it has another curvature.

    Args:
        height: Height of the ridges [m].
        radius: Radius of the ball [m].
        curvature: Curvature of the surface across the lines (N,) [1/m], positive where it is convex.
    """
    return np.asarray(np.sqrt(8.0 * height / np.maximum(1.0 / radius + curvature, 0.25 / radius)))


def ridge_height(step: float, radius: float, curvature: FloatArray) -> FloatArray:
    """Return the height (N,) [m] of the ridges between lines, by the formula of :func:`ridge_step`.

    Args:
        step: Distance of the lines [m].
        radius: Radius of the ball [m]; 0 for a flat end, which leaves no ridges.
        curvature: Curvature of the surface across the lines (N,) [1/m].
    """
    if radius == 0.0:
        return np.zeros(len(curvature))
    return np.asarray(step**2 / 8.0 * np.maximum(1.0 / radius + curvature, 0.0))


EDGE_MARGIN_M: Final = 1e-6
"""Distance [m] of lines from the edge of the face. A point on the edge is neither inside nor outside."""
LINE_SPACING_M: Final = 0.5 * MM
"""Distance [m] of the points at which a line is projected onto the face."""
AXIS_LEVER_M: Final = 0.05
"""Distance behind the tip [m] of a second point that also keeps the chord error between targets."""
CHORD_FRACTION: Final = 0.1
"""Fraction of the tolerance that straight moves between targets may use."""
MAX_LINES: Final = 5000
"""Maximum number of lines of one cut."""
CURVATURE_SPAN_M: Final = 2.0 * MM
"""Distance [m] over which the curvature of the face across a line is measured."""
ADVISED_RIDGE_FRACTION: Final = 0.85
"""Advised height of ridges as a fraction of the maximum height, so that the tolerance holds."""
MAX_RIDGE_FACTOR: Final = 1.1
"""Factor on the allowed height of ridges above which lines are refused. The proof decides about lower
ridges.
"""


def plan_lines(
    op: Milling, cut: LinesCut, face: FaceFromAbove, cutter: Cutter, area: shapely.Geometry | None = None
) -> list[CutterPass]:
    """Plan the passes of point milling over a face: lines in order, adjacent lines of a zigzag joined.

    Args:
        op: Operation.
        cut: Cut by lines.
        face: Face seen from above.
        cutter: Cutter of the arm.
        area: Part of the plane [m] to which lines are restricted, None for all of it.

    Raises:
        TandemError: Codes ``milling.*``.
    """
    angle = cut.angle_deg * DEG
    direction, side = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    corners = np.array([[x, y] for x in (face.low[0], face.high[0]) for y in (face.low[1], face.high[1])])
    if area is not None:
        corners = shapely.get_coordinates(area)
    # Extent of the area along the lines, and across them.
    lows = [(corners @ axis).min() + EDGE_MARGIN_M if len(corners) else 0.0 for axis in (direction, side)]
    highs = [(corners @ axis).max() - EDGE_MARGIN_M if len(corners) else 0.0 for axis in (direction, side)]
    if min(highs[0] - lows[0], highs[1] - lows[1]) <= 0.0:
        limit = 0.25 * float((face.high - face.low).min()) / MM
        message = f"lines: a margin of {cut.margin_mm:g} mm leaves nothing of the face. {limit:.1f} mm would "
        message += "leave half of its width"
        raise issue_error("milling.pattern", message, field="operations.cuts.margin_mm", value=cut.margin_mm)
    count = int(np.ceil((highs[0] - lows[0]) / LINE_SPACING_M)) + 1
    line_points = np.linspace(lows[0], highs[0], count)[:, None] * direction
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    # The fraction sqrt(tolerance / height) of a round ridge is within the tolerance.
    # At least op.share of the face has to be within it.
    max_ridge = MAX_RIDGE_FACTOR * tolerance / op.share**2
    parallel_lines = ParallelLines(line_points, side, first=lows[1], last=highs[1])
    offsets = _line_offsets(cut, face, parallel_lines, cutter, max_ridge)
    pieces: list[list[tuple[FloatArray, FloatArray]]] = []
    for number, offset in enumerate(offsets):
        projected = face.at(line_points + offset * side)
        if area is not None:
            projected = dataclasses.replace(
                projected, on=projected.on & contains_points(area, line_points + offset * side)
            )
        for first, last in _stretches_on_face(projected):
            rows = np.arange(first, last + 1)
            reverse = cut.zigzag and number % 2 == 1
            line = _line_tool_path(
                cut, projected.point[rows], projected.normal[rows], direction, reverse, cutter
            )
            is_adjacent = (
                pieces
                and np.linalg.norm(pieces[-1][-1][0][-1] - line[0][0])
                < 3.0 * _max_spacing(offsets) + LINE_SPACING_M
            )
            if cut.zigzag and is_adjacent:
                pieces[-1].append(line)
            else:
                pieces.append([line])
    name, feed = f"{cut.lines}_lines", (cut.feed_mm_s or op.feed_mm_s) * MM
    passes = []
    for number, piece in enumerate(pieces, 1):
        target_rows = [
            thin_rows(
                np.stack([tips, tips + AXIS_LEVER_M * axes], axis=1),
                CHORD_FRACTION * tolerance,
                op.step_mm * MM,
            )
            for tips, axes in piece
        ]
        tip = np.concatenate([tips[rows] for (tips, _), rows in zip(piece, target_rows, strict=True)])
        axis = np.concatenate([axes[rows] for (_, axes), rows in zip(piece, target_rows, strict=True)])
        label = name if len(pieces) == 1 else f"{name}_p{number}"
        passes.append(CutterPass(label, plain_path(tip, axis, feed), 0, len(tip) - 1, 0.0))
    return passes


def _max_spacing(offsets: FloatArray) -> float:
    return float(np.diff(offsets).max(initial=0.0))


@dataclasses.dataclass(frozen=True)
class ParallelLines:
    """Parallel lines in plan.

    Attributes:
        points: Points (P, 2) [m] of the line at offset 0.
        side: Unit vector (2,) across the lines.
        first: Offset [m] of the first line along ``side``.
        last: Offset [m] of the last line.
    """

    points: FloatArray
    side: FloatArray
    first: float
    last: float


def _line_offsets(
    cut: LinesCut, face: FaceFromAbove, lines: ParallelLines, cutter: Cutter, max_ridge: float
) -> FloatArray:
    """Return the offsets (L,) [m] of the lines across the face. Ridges are at most ``max_ridge`` [m] high.

    The step to the next line is the smallest one that any point of the line requires. All steps are then
    reduced by one factor so that the last line is on the edge.
    """
    if cut.scallop_mm is not None and cutter.corner == 0.0:
        message = "lines: a cylinder's end leaves no round ridges, so scallop_mm has no meaning. Use "
        message += "stepover_mm, or a ball or bull nose"
        raise issue_error("milling.pattern", message, field="operations.cuts.scallop_mm")
    offsets, lowest_ridge = [lines.first], np.inf
    while offsets[-1] < lines.last:
        step, ridge = _next_step(cut, face, lines, offsets[-1], cutter)
        lowest_ridge = min(lowest_ridge, ridge)
        offsets.append(offsets[-1] + step)
        if len(offsets) > MAX_LINES:
            raise issue_error(
                "milling.pattern",
                f"lines: more than {MAX_LINES} lines; give {_spacing_remedy(cut, offsets, lines)}",
                field="operations.cuts",
                value=float(len(offsets)),
                limit=float(MAX_LINES),
            )
    out = np.array(offsets)
    scale = (lines.last - lines.first) / (out[-1] - lines.first)
    if cutter.kind == "ball":  # the flat of a bull nose leaves lower ridges
        _check_ridges(cut, float(lowest_ridge * scale**2), max_ridge)
    return np.asarray(lines.first + (out - lines.first) * scale)


def _spacing_remedy(cut: LinesCut, offsets: list[float], lines: ParallelLines) -> str:
    """Return the setting with which there are half as many lines as the maximum.

    It follows from the offsets [m] of the first lines, of which there are as many as the maximum.
    """
    factor = 2.0 * (lines.last - lines.first) / max(offsets[-1] - offsets[0], 1e-9)
    if cut.stepover_mm is not None:
        return f"a stepover_mm of {np.ceil(factor * cut.stepover_mm * 100.0) / 100.0:.2f}"
    return f"a scallop_mm of {np.ceil(factor**2 * (cut.scallop_mm or 0.0) * 1000.0) / 1000.0:.3f}"


def _check_ridges(cut: LinesCut, lowest: float, max_ridge: float) -> None:
    """Raise ``milling.pattern`` if even the ``lowest`` ridge [m] of the lines is above ``max_ridge`` [m]."""
    if lowest > max_ridge:
        # The height of ridges is proportional to the square of the step.
        factor = ADVISED_RIDGE_FRACTION * max_ridge / lowest
        if cut.stepover_mm is not None:
            remedy = f"a stepover_mm of {np.floor(np.sqrt(factor) * cut.stepover_mm * 100.0) / 100.0:.2f}"
        else:
            remedy = f"a scallop_mm of {np.floor(factor * (cut.scallop_mm or 0.0) * 1000.0) / 1000.0:.3f}"
        message = (
            f"lines: ridges of {lowest / MM:.3f} mm or more leave too little of it within shape_tol_mm; "
        )
        message += f"allowed: {max_ridge / MM:.3f} mm; give {remedy} or less, or more tolerance"
        raise issue_error(
            "milling.pattern",
            message,
            field="operations.cuts",
            **measurement(lowest / MM, max_ridge / MM, "mm"),
        )


def _next_step(
    cut: LinesCut, face: FaceFromAbove, lines: ParallelLines, offset: float, cutter: Cutter
) -> tuple[float, float]:
    """Return the plan distance [m] to the next line, and the height [m] of the lowest ridge between them.

    The surface is examined along the line at ``offset`` [m] and about where the next line is expected. The
    step is at least 0.02 mm.
    """
    side_vector = np.append(lines.side, 0.0)
    stepover = cut.stepover_mm * MM if cut.stepover_mm is not None else None
    steps, ridges = [], []
    guess = (
        stepover
        if stepover is not None
        else float(ridge_step((cut.scallop_mm or 0.0) * MM, cutter.corner, np.zeros(1))[0])
    )
    for at in (offset, min(offset + guess, lines.last)):
        shifted_lines = [
            face.at(lines.points + (at + shift) * lines.side)
            for shift in (-CURVATURE_SPAN_M, 0.0, CURVATURE_SPAN_M)
        ]
        on_face = shifted_lines[0].on & shifted_lines[1].on & shifted_lines[2].on
        if not on_face.any():
            on_face = shifted_lines[1].on
            if not on_face.any():
                continue
            slope = np.abs(shifted_lines[1].normal[on_face] @ side_vector)
            curvature = np.zeros(len(slope))
        else:
            slope = np.abs(shifted_lines[1].normal[on_face] @ side_vector)
            normal_change = (
                shifted_lines[2].normal[on_face] - shifted_lines[0].normal[on_face]
            ) @ side_vector
            curvature = normal_change / (2.0 * CURVATURE_SPAN_M)
        # steps on the surface are shorter in plan by the cosine of the slope across the lines
        cosine = np.sqrt(np.maximum(1.0 - slope**2, 1e-4))
        if stepover is not None:
            steps.append(float((stepover * cosine).min()))
            ridges.append(float(ridge_height(stepover, cutter.corner, curvature).min()))
        else:
            steps.append(
                float((ridge_step((cut.scallop_mm or 0.0) * MM, cutter.corner, curvature) * cosine).min())
            )
    ridge = min(ridges, default=0.0) if stepover is not None else (cut.scallop_mm or 0.0) * MM
    return max(min(steps, default=guess), 0.02 * MM), ridge


def _stretches_on_face(projected: ProjectedPoints) -> list[tuple[int, int]]:
    """Return first and last index of each stretch of a line on the face that has at least two points."""
    on = np.concatenate([[False], projected.on, [False]])
    changes = np.flatnonzero(on[1:] != on[:-1])
    return [(int(a), int(b) - 1) for a, b in zip(changes[::2], changes[1::2], strict=True) if b - a >= 2]


def _line_tool_path(
    cut: LinesCut, point: FloatArray, normal: FloatArray, direction: FloatArray, reverse: bool, cutter: Cutter
) -> tuple[FloatArray, FloatArray]:
    """Return tips (N, 3) [m] and axes (N, 3) of the cutter along a line.

    Args:
        cut: Cut by lines.
        point: Contact points (N, 3) [m].
        normal: Normals of the face there (N, 3).
        direction: Direction of the lines in plan (2,). Not used.
        reverse: Whether the line is milled in reverse order.
        cutter: Cutter of the arm.
    """
    if reverse:
        point, normal = point[::-1], normal[::-1]
    feed = np.gradient(point, axis=0)
    if cut.axis == "upright":
        axis = np.broadcast_to([0.0, 0.0, 1.0], point.shape).copy()
    else:
        axis = tilted_axes(normal, feed, cut.lead_deg * DEG, cut.tilt_deg * DEG)
    return tool_tips(point, normal, axis, cutter), axis


CURVE_SPACING_M: Final = 0.25 * MM
"""Distance [m] of the points at which a curve is projected onto the face."""


def plan_engraving(
    op: Milling, cut: EngraveCut, face: FaceFromAbove, cutter: Cutter
) -> tuple[list[CutterPass], list[Issue]]:
    """Plan one pass for each curve.

    Args:
        op: Operation.
        cut: Engraving.
        face: Face seen from above.
        cutter: Cutter of the arm.

    Returns:
        The passes, and notes about the files.

    Raises:
        TandemError: Codes ``milling.*`` and ``part.guide``.
    """
    out = []
    faults: list[Issue] = []
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    curves, notes = _engraved_curves(cut, "engrave")
    axis_curves, axis_notes = _engraved_curves(cut, "axis_curves")
    if axis_curves and len(axis_curves) != len(curves):
        message = (
            f"{cut.name}: axis_curves are {len(axis_curves)} for {len(curves)} curves; give one for each"
        )
        raise issue_error("milling.guides", message, field=f"operations.cuts.{cut.name}.axis_curves")
    for number, curve in enumerate(curves):
        axis_curve = axis_curves[number] if axis_curves else None
        try:
            tip, axis = _engraving_tool_path(cut, number, curve, axis_curve, face, cutter)
        except TandemError as error:
            faults += error.issues
            continue
        rows = thin_rows(
            np.stack([tip, tip + AXIS_LEVER_M * axis], axis=1), CHORD_FRACTION * tolerance, op.step_mm * MM
        )
        feed = (cut.feed_mm_s or op.feed_mm_s) * MM
        out.append(
            CutterPass(
                f"{cut.name}_c{number + 1}", plain_path(tip[rows], axis[rows], feed), 0, len(rows) - 1, 0.0
            )
        )
    if faults:
        raise TandemError(faults)
    return out, [*notes, *axis_notes]


MAX_CURVES: Final = 500
"""Maximum number of curves of an engraving, those of drawings included."""


@dataclasses.dataclass(frozen=True)
class EngravedCurve:
    """Curve of an engraving.

    Attributes:
        points: Points along the curve (K, 3) [m].
        field: Field of the curve in the problem file, for messages.
    """

    points: FloatArray
    field: str


def _engraved_curves(cut: EngraveCut, key: str) -> tuple[list[EngravedCurve], list[Issue]]:
    """Return all curves of a cut, those of drawings one by one, and notes about their files.

    ``key`` is the field of the curves: ``engrave`` or ``axis_curves``.

    Raises:
        TandemError: Issues of files, ``part.guide``, or ``problem.field`` for too many curves.
    """
    out: list[EngravedCurve] = []
    faults: list[Issue] = []
    notes: list[Issue] = []
    for number, spec in enumerate(getattr(cut, key)):
        field = f"operations.cuts.{cut.name}.{key}.{number}"
        try:
            if spec.drawing is None:
                smooth = spec.bspline_mm is not None or spec.bezier_mm is not None
                curve_data, file_notes = build_guide(spec, None, Path(), field)
                out.append(EngravedCurve(_resample_curve(curve_data.points, not smooth), field))
                notes += file_notes
                continue
            drawn, file_notes = spec.drawing.curves(f"{field}.drawing")
        except TandemError as error:
            faults += error.issues
            continue
        out += [EngravedCurve(_resample_curve(curve.run_points()), f"{field}.drawing") for curve in drawn]
        notes += file_notes
    if faults:
        raise TandemError(faults)
    if len(out) > MAX_CURVES:
        message = f"{cut.name}: {key} has {len(out)} curves, those of drawings included, allowed {MAX_CURVES}"
        hint = "name layers, or distribute the curves over several cuts"
        raise issue_error("problem.field", message, field=f"operations.cuts.{cut.name}.{key}", hint=hint)
    return out, notes


def _resample_curve(points: FloatArray, corners: bool = True) -> FloatArray:
    """Return evenly spaced points (N, 3) [m] along a curve (K, 3), and its vertices if ``corners`` is set.

    The vertices of a spline are left out, because the spacing and so the direction of the feed would be
    uneven at them, and the tool would tilt differently than nearby.
    """
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    even = np.linspace(0.0, length[-1], max(int(np.ceil(length[-1] / CURVE_SPACING_M)), 2) + 1)
    lengths = np.unique(np.concatenate([even, length])) if corners else even
    return np.stack([np.interp(lengths, length, points[:, k]) for k in range(3)], axis=1)


def _engraving_tool_path(
    cut: EngraveCut,
    number: int,
    curve: EngravedCurve,
    axis_curve: EngravedCurve | None,
    face: FaceFromAbove,
    cutter: Cutter,
) -> tuple[FloatArray, FloatArray]:
    """Return tips (K, 3) [m] and axes (K, 3) along a curve.

    Args:
        cut: Engraving.
        number: Index of the curve.
        curve: Curve with K points.
        axis_curve: Curve through which the axes go, None if the cut has none.
        face: Face seen from above.
        cutter: Cutter of the arm.

    Raises:
        TandemError: Codes ``milling.*``.
    """
    projected = face.at(curve.points[:, :2])
    if not projected.on.all():
        off_face_mm = curve.points[int(np.argmin(projected.on))] / MM
        message = (
            f"{cut.name}: curve {number + 1} leaves the part's front at {off_face_mm[0]:.1f}, "
            f"{off_face_mm[1]:.1f} mm; "
        )
        low, high = face.low / MM, face.high / MM
        message += (
            f"move or shorten it: in the block's frame the front goes from {low[0]:.1f}, {low[1]:.1f} to "
        )
        message += f"{high[0]:.1f}, {high[1]:.1f} mm at most (curves are projected along z)"
        raise issue_error("milling.off_surface", message, field=curve.field)
    feed = np.gradient(projected.point, axis=0)
    if cut.axis == "upright":
        axis = np.broadcast_to([0.0, 0.0, 1.0], curve.points.shape).copy()
    elif cut.axis == "normal":
        axis = tilted_axes(projected.normal, feed, cut.lead_deg * DEG, cut.tilt_deg * DEG)
    elif axis_curve is not None:
        axis = _axes_through(cut, number, projected.point, axis_curve)
    else:
        raise ValueError("axis: curves needs axis_curves")
    contact = projected.point - cut.depth_mm * MM * projected.normal
    return tool_tips(contact, projected.normal, axis, cutter), axis


def _axes_through(cut: EngraveCut, number: int, point: FloatArray, axis_curve: EngravedCurve) -> FloatArray:
    """Return axes (N, 3) from points (N, 3) [m] to a second curve, at equal fractions of both lengths."""
    axis_points = axis_curve.points
    fractions = []
    for curve_points in (point, axis_points):
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve_points, axis=0), axis=1))])
        fractions.append(length / max(float(length[-1]), 1e-12))
    at = np.stack([np.interp(fractions[0], fractions[1], axis_points[:, k]) for k in range(3)], axis=1)
    offsets = at - point
    length = np.linalg.norm(offsets, axis=1)
    # distances of both pairs of ends, as given and with the axis curve reversed
    ends = (
        np.array([point[0] - axis_points[0], point[-1] - axis_points[-1]]),
        np.array([point[0] - axis_points[-1], point[-1] - axis_points[0]]),
    )
    if (
        length.min() < 1.0 * MM
        or np.linalg.norm(ends[1], axis=1).sum() < 0.8 * np.linalg.norm(ends[0], axis=1).sum()
    ):
        message = f"{cut.name}: axis curve {number + 1} meets its curve or runs the other way; give "
        message += "it at least 1 mm "
        message += "distance from its curve and the same direction"
        raise issue_error("milling.guides", message, field=axis_curve.field)
    return np.asarray(offsets / length[:, None])
