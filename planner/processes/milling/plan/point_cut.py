"""Point milling: a face in parallel lines, and patterns of curves engraved on it.

From places on a surface to tips and axes of a cutter whose end touches it there. Lines are as near
to one another as a stepover or a ridge height asks; a pattern of curves is projected along z onto
the part's front and engraved there.
"""

import dataclasses
from pathlib import Path
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, dots, unit
from planner.geometry.face_places import Over, Places
from planner.geometry.polylines import thinned
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, TandemError, refusal
from planner.processes.milling.plan.cutter_contact import within
from planner.processes.milling.plan.operation import EngraveCut, LinesCut, Milling
from planner.processes.milling.plan.tool_path import Run, plain_path
from planner.reading.part_ruled import guide
from planner.tooling import Cutter

UPRIGHT_ANGLE: Final = 1e-3
"""A flat end that leans off the normal by less than this [rad] touches with its middle."""


def leant(normal: FloatArray, feed: FloatArray, lead: float, tilt: float) -> FloatArray:
    """Axes (N, 3): normals leant forward along the feed by ``lead`` and to its left by ``tilt`` [rad]."""
    along = unit(feed - dots(feed, normal)[:, None] * normal)
    left = np.cross(normal, along)
    return unit(normal + np.tan(lead) * along + np.tan(tilt) * left)


def tips(contact: FloatArray, normal: FloatArray, axis: FloatArray, cutter: Cutter) -> FloatArray:
    """Tips (N, 3) [m] of cutters with ``axis`` (N, 3) that touch planes with ``normal`` (N, 3) at ``contact``
    (N, 3).

    The end of every cutter is a torus, of tube radius r (its corner) about a circle of radius R - r; a ball
    has no circle, a cylinder no tube. The tube's middle is r above the contact along the normal, and the
    circle's middle is beside that, to the side to which the normal leans off the axis.
    """
    across = normal - dots(normal, axis)[:, None] * axis
    lean = np.linalg.norm(across, axis=1, keepdims=True)
    side = np.where(lean > UPRIGHT_ANGLE, across / np.maximum(lean, 1e-15), 0.0)
    circle = cutter.radius - cutter.corner
    return np.asarray(contact + cutter.corner * (normal - axis) + circle * side)


def ridge_step(height: float, radius: float, bend: FloatArray) -> FloatArray:
    """Distance (N,) [m] between neighbouring lines of a ball of ``radius`` [m] that leave ridges of
    ``height`` [m] on a surface that bends across them by ``bend`` (N,) [1/m], above zero where it is convex:
    h = s^2 / 8 (1 / R + k), the difference of two parabolas. In hollows it is twice that of a flat at most:
    such a place is small, and the next one bends otherwise."""
    return np.asarray(np.sqrt(8.0 * height / np.maximum(1.0 / radius + bend, 0.25 / radius)))


def ridge_height(step: float, radius: float, bend: FloatArray) -> FloatArray:
    """Height (N,) [m] of the ridges that lines ``step`` [m] apart leave, as :func:`ridge_step` has it;
    0 of a flat end, where ``radius`` is 0."""
    if radius == 0.0:
        return np.zeros(len(bend))
    return np.asarray(step**2 / 8.0 * np.maximum(1.0 / radius + bend, 0.0))


EDGE_MARGIN: Final = 1e-6
"""Lines keep so far [m] inside the edge, on which a place is neither on the face nor off it."""
LINE_SPACING: Final = 0.5 * MM
"""Distance [m] of the places at which a line is laid on the face."""
AXIS_LEVER: Final = 0.05
"""How far behind the tip [m] the tool keeps within the chord between targets, too."""
CHORD_SHARE: Final = 0.1
"""Share of the tolerance that straight moves between targets may cost."""
MOST_LINES: Final = 5000
"""Lines of one cut at most."""
BEND_SPAN: Final = 2.0 * MM
"""Distance [m] over which the bend of the face across a line is measured."""
RIDGE_SHARE: Final = 0.85
"""Share of the highest ridges that are allowed that is advised: with those, the tolerance holds."""
RIDGE_FACTOR: Final = 1.1
"""Ridges so many times as high as the tolerance allows are refused: those below are left to the proof."""


def line_runs(
    op: Milling, cut: LinesCut, over: Over, cutter: Cutter, area: shapely.Geometry | None = None
) -> list[Run]:
    """The lines in order, those that follow one another joined, in ``area`` [m] of the plan alone. Raises
    ``TandemError`` with codes ``milling.*``."""
    turn = cut.angle_deg * DEG
    way, side = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    corners = np.array([[x, y] for x in (over.low[0], over.high[0]) for y in (over.low[1], over.high[1])])
    if area is not None:
        corners = shapely.get_coordinates(area)
    ends = [(corners @ axis).min() + EDGE_MARGIN if len(corners) else 0.0 for axis in (way, side)]
    tops = [(corners @ axis).max() - EDGE_MARGIN if len(corners) else 0.0 for axis in (way, side)]
    if min(tops[0] - ends[0], tops[1] - ends[1]) <= 0.0:
        most = 0.25 * float((over.high - over.low).min()) / MM
        what = f"lines: a margin of {cut.margin_mm:g} mm leaves nothing of the face; {most:.1f} mm would "
        what += "leave half of its width"
        raise refusal("milling.pattern", what, field="operations.cuts.margin_mm", value=cut.margin_mm)
    count = int(np.ceil((tops[0] - ends[0]) / LINE_SPACING)) + 1
    places = np.linspace(ends[0], tops[0], count)[:, None] * way
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    most = (
        RIDGE_FACTOR * tolerance / op.share**2
    )  # of a round ridge the share sqrt(tolerance / height) is within
    offsets = _offsets(cut, over, places, side, (ends[1], tops[1]), cutter, most)
    pieces: list[list[tuple[FloatArray, FloatArray]]] = []
    for number, offset in enumerate(offsets):
        laid = over.at(places + offset * side)
        if area is not None:
            laid = dataclasses.replace(laid, on=laid.on & within(area, places + offset * side))
        for first, last in _pieces(laid):
            rows = np.arange(first, last + 1)
            flip = cut.zigzag and number % 2 == 1
            line = _line_tool(cut, laid.point[rows], laid.normal[rows], way, flip, cutter)
            near = (
                pieces
                and np.linalg.norm(pieces[-1][-1][0][-1] - line[0][0]) < 3.0 * _widest(offsets) + LINE_SPACING
            )
            if cut.zigzag and near:
                pieces[-1].append(line)
            else:
                pieces.append([line])
    name, feed = f"{cut.lines}_lines", (cut.feed_mm_s or op.feed_mm_s) * MM
    out = []
    for number, piece in enumerate(pieces, 1):
        kept = [
            thinned(np.stack([t, t + AXIS_LEVER * a], axis=1), CHORD_SHARE * tolerance, op.step_mm * MM)
            for t, a in piece
        ]
        tip = np.concatenate([t[rows] for (t, _), rows in zip(piece, kept, strict=True)])
        axis = np.concatenate([a[rows] for (_, a), rows in zip(piece, kept, strict=True)])
        label = name if len(pieces) == 1 else f"{name}_p{number}"
        out.append(Run(label, plain_path(tip, axis, feed), 0, len(tip) - 1, 0.0))
    return out


def _widest(offsets: FloatArray) -> float:
    return float(np.diff(offsets).max(initial=0.0))


def _offsets(
    cut: LinesCut,
    over: Over,
    places: FloatArray,
    side: FloatArray,
    ends: tuple[float, float],
    cutter: Cutter,
    most: float,
) -> FloatArray:
    """Where across the face (L,) [m] its lines are: the step to the next one is the least that any place of
    the line asks for; all are made smaller alike so that the last one lies on the edge. ``most``: how
    high [m] ridges may be."""
    if cut.scallop_mm is not None and cutter.corner == 0.0:
        what = "lines: a cylinder's end leaves no round ridges, so that scallop_mm says nothing; give a "
        what += "stepover_mm, or take a ball or bull nose"
        raise refusal("milling.pattern", what, field="operations.cuts.scallop_mm")
    found, lowest = [ends[0]], np.inf
    while found[-1] < ends[1]:
        step, ridge = _step(cut, over, places, side, found[-1], ends, cutter)
        lowest = min(lowest, ridge)
        found.append(found[-1] + step)
        if len(found) > MOST_LINES:
            raise refusal(
                "milling.pattern",
                f"lines: more than {MOST_LINES} lines; give {_wider(cut, found, ends)}",
                field="operations.cuts",
                value=float(len(found)),
                limit=float(MOST_LINES),
            )
    out = np.array(found)
    closer = (ends[1] - ends[0]) / (out[-1] - ends[0])
    if cutter.kind == "ball":  # a bull nose has a flat that leaves less
        _ridges(cut, float(lowest * closer**2), most)
    return np.asarray(ends[0] + (out - ends[0]) * closer)


def _wider(cut: LinesCut, found: list[float], ends: tuple[float, float]) -> str:
    """What would do with half as many lines as are allowed; the first of them are ``found`` [m]."""
    wide = 2.0 * (ends[1] - ends[0]) / max(found[-1] - found[0], 1e-9)
    if cut.stepover_mm is not None:
        return f"a stepover_mm of {np.ceil(wide * cut.stepover_mm * 100.0) / 100.0:.2f}"
    return f"a scallop_mm of {np.ceil(wide**2 * (cut.scallop_mm or 0.0) * 1000.0) / 1000.0:.3f}"


def _ridges(cut: LinesCut, lowest: float, most: float) -> None:
    """Refuse lines whose lowest ridge [m] already leaves too much of the face outside of its tolerance."""
    if lowest > most:
        # ridges go with the square of the step
        less = RIDGE_SHARE * most / lowest
        if cut.stepover_mm is not None:
            do = f"a stepover_mm of {np.floor(np.sqrt(less) * cut.stepover_mm * 100.0) / 100.0:.2f}"
        else:
            do = f"a scallop_mm of {np.floor(less * (cut.scallop_mm or 0.0) * 1000.0) / 1000.0:.3f}"
        what = f"lines: ridges of {lowest / MM:.3f} mm or more leave too little of it within shape_tol_mm; "
        what += f"allowed: {most / MM:.3f} mm; give {do} or less, or more tolerance"
        raise refusal(
            "milling.pattern", what, field="operations.cuts", **measurement(lowest / MM, most / MM, "mm")
        )


def _step(
    cut: LinesCut,
    over: Over,
    places: FloatArray,
    side: FloatArray,
    offset: float,
    ends: tuple[float, float],
    cutter: Cutter,
) -> tuple[float, float]:
    """Plan distance [m] from a line to the next one, and the height [m] of the lowest ridge between them."""
    aside = np.append(side, 0.0)
    wide = cut.stepover_mm * MM if cut.stepover_mm is not None else None
    steps, ridges = [], []
    guess = (
        wide
        if wide is not None
        else float(ridge_step((cut.scallop_mm or 0.0) * MM, cutter.corner, np.zeros(1))[0])
    )
    for at in (offset, min(offset + guess, ends[1])):
        rows = [over.at(places + (at + shift) * side) for shift in (-BEND_SPAN, 0.0, BEND_SPAN)]
        on = rows[0].on & rows[1].on & rows[2].on
        if not on.any():
            on = rows[1].on
            if not on.any():
                continue
            slope = np.abs(rows[1].normal[on] @ aside)
            bend = np.zeros(len(slope))
        else:
            slope = np.abs(rows[1].normal[on] @ aside)
            turn = (rows[2].normal[on] - rows[0].normal[on]) @ aside
            bend = turn / (2.0 * BEND_SPAN)
        flat = np.sqrt(np.maximum(1.0 - slope**2, 1e-4))
        if wide is not None:
            steps.append(float((wide * flat).min()))
            ridges.append(float(ridge_height(wide, cutter.corner, bend).min()))
        else:
            steps.append(float((ridge_step((cut.scallop_mm or 0.0) * MM, cutter.corner, bend) * flat).min()))
    asked = min(ridges, default=0.0) if wide is not None else (cut.scallop_mm or 0.0) * MM
    return max(min(steps, default=guess), 0.02 * MM), asked


def _pieces(laid: Places) -> list[tuple[int, int]]:
    """First and last index of each stretch of a line that lies on the face, of two places at least."""
    on = np.concatenate([[False], laid.on, [False]])
    turns = np.flatnonzero(on[1:] != on[:-1])
    return [(int(a), int(b) - 1) for a, b in zip(turns[::2], turns[1::2], strict=True) if b - a >= 2]


def _line_tool(
    cut: LinesCut, point: FloatArray, normal: FloatArray, way: FloatArray, flip: bool, cutter: Cutter
) -> tuple[FloatArray, FloatArray]:
    """Tips and axes (N, 3) along one line."""
    if flip:
        point, normal = point[::-1], normal[::-1]
    feed = np.gradient(point, axis=0)
    if cut.axis == "upright":
        axis = np.broadcast_to([0.0, 0.0, 1.0], point.shape).copy()
    else:
        axis = leant(normal, feed, cut.lead_deg * DEG, cut.tilt_deg * DEG)
    return tips(point, normal, axis, cutter), axis


CURVE_SPACING: Final = 0.25 * MM
"""Distance [m] of the places at which a curve is laid on the face."""


def engraved_runs(op: Milling, cut: EngraveCut, over: Over, cutter: Cutter) -> tuple[list[Run], list[Issue]]:
    """One run for each curve, and notes of the files. Raises ``TandemError`` with codes ``milling.*`` and
    ``part.guide``."""
    out = []
    faults: list[Issue] = []
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    (curves, notes), (others, told) = _curves(cut, "engrave"), _curves(cut, "axis_curves")
    if others and len(others) != len(curves):
        what = f"{cut.name}: axis_curves are {len(others)} for {len(curves)} curves; give one for each"
        raise refusal("milling.guides", what, field=f"operations.cuts.{cut.name}.axis_curves")
    for number, (curve, field) in enumerate(curves):
        other = others[number] if others else None
        try:
            tip, axis = _engraving_tool(cut, number, curve, other, over, cutter, field)
        except TandemError as error:
            faults += error.issues
            continue
        rows = thinned(
            np.stack([tip, tip + AXIS_LEVER * axis], axis=1), CHORD_SHARE * tolerance, op.step_mm * MM
        )
        feed = (cut.feed_mm_s or op.feed_mm_s) * MM
        out.append(
            Run(f"{cut.name}_c{number + 1}", plain_path(tip[rows], axis[rows], feed), 0, len(rows) - 1, 0.0)
        )
    if faults:
        raise TandemError(faults)
    return out, [*notes, *told]


MOST_CURVES: Final = 500
"""Curves of an engraving at most, those of drawings among them."""


def _curves(cut: EngraveCut, key: str) -> tuple[list[tuple[FloatArray, str]], list[Issue]]:
    """All curves of a cut, those of drawings one by one, each with its field; and notes. Raises
    ``TandemError``: issues of files, ``part.guide``, ``problem.field`` for too many."""
    out: list[tuple[FloatArray, str]] = []
    faults: list[Issue] = []
    notes: list[Issue] = []
    for number, spec in enumerate(getattr(cut, key)):
        field = f"operations.cuts.{cut.name}.{key}.{number}"
        try:
            if spec.drawing is None:
                smooth = spec.bspline_mm is not None or spec.bezier_mm is not None
                own, told = guide(spec, None, Path(), field)
                out.append((_along(own.points, not smooth), field))
                notes += told
                continue
            found, told = spec.drawing.curves(f"{field}.drawing")
        except TandemError as error:
            faults += error.issues
            continue
        out += [(_along(curve.run()), f"{field}.drawing") for curve in found]
        notes += told
    if faults:
        raise TandemError(faults)
    if len(out) > MOST_CURVES:
        what = f"{cut.name}: {key} are {len(out)} curves with those of drawings; allowed: {MOST_CURVES}"
        hint = "name layers, or divide them among cuts"
        raise refusal("problem.field", what, field=f"operations.cuts.{cut.name}.{key}", hint=hint)
    return out, notes


def _along(own: FloatArray, corners: bool = True) -> FloatArray:
    """Places (N, 3) [m] along a curve (K, 3), evenly apart, with its ``corners`` if it has some: points of a
    spline that is bent tightly would have a tool lean otherwise than places beside them."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(own, axis=0), axis=1))])
    even = np.linspace(0.0, length[-1], max(int(np.ceil(length[-1] / CURVE_SPACING)), 2) + 1)
    at = np.unique(np.concatenate([even, length])) if corners else even
    return np.stack([np.interp(at, length, own[:, k]) for k in range(3)], axis=1)


def _engraving_tool(
    cut: EngraveCut,
    number: int,
    curve: FloatArray,
    other: tuple[FloatArray, str] | None,
    over: Over,
    cutter: Cutter,
    field: str,
) -> tuple[FloatArray, FloatArray]:
    laid = over.at(curve[:, :2])
    if not laid.on.all():
        at = curve[int(np.argmin(laid.on))] / MM
        what = f"{cut.name}: curve {number + 1} leaves the part's front at {at[0]:.1f}, {at[1]:.1f} mm; "
        low, high = over.low / MM, over.high / MM
        what += f"move or shorten it: in the block's frame the front goes from {low[0]:.1f}, {low[1]:.1f} to "
        what += f"{high[0]:.1f}, {high[1]:.1f} mm at most (curves are projected along z)"
        raise refusal("milling.off_surface", what, field=field)
    feed = np.gradient(laid.point, axis=0)
    if cut.axis == "upright":
        axis = np.broadcast_to([0.0, 0.0, 1.0], curve.shape).copy()
    elif cut.axis == "normal":
        axis = leant(laid.normal, feed, cut.lead_deg * DEG, cut.tilt_deg * DEG)
    elif other is not None:
        axis = _toward(cut, number, laid.point, *other)
    else:
        raise ValueError("axis: curves needs axis_curves")
    contact = laid.point - cut.depth_mm * MM * laid.normal
    return tips(contact, laid.normal, axis, cutter), axis


def _toward(cut: EngraveCut, number: int, point: FloatArray, other: FloatArray, field: str) -> FloatArray:
    """Axes (N, 3) through a second curve, at equal shares of both curves' lengths."""
    shares = []
    for row in (point, other):
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(row, axis=0), axis=1))])
        shares.append(length / max(float(length[-1]), 1e-12))
    at = np.stack([np.interp(shares[0], shares[1], other[:, k]) for k in range(3)], axis=1)
    way = at - point
    length = np.linalg.norm(way, axis=1)
    ends = (
        np.array([point[0] - other[0], point[-1] - other[-1]]),
        np.array([point[0] - other[-1], point[-1] - other[0]]),
    )
    if (
        length.min() < 1.0 * MM
        or np.linalg.norm(ends[1], axis=1).sum() < 0.8 * np.linalg.norm(ends[0], axis=1).sum()
    ):
        what = f"{cut.name}: axis curve {number + 1} meets its curve or runs the other way; give "
        what += "it at least 1 mm "
        what += "off its curve and in the same direction"
        raise refusal("milling.guides", what, field=field)
    return np.asarray(way / length[:, None])
