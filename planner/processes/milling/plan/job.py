"""The process ``milling``: from surfaces, curves and a cutter to targets of one arm, and its claims.

See `process_plan` (cuts as passes), `flank_cut`, `point_cut` and `gcode` (kinds of cuts), `tool_path` (moves
between passes) and `check` (checks before motion planning).

**Poses**: from tips and axes to poses of the TCP. Motion planning may choose the spin about the tool.

**Exhibits** for the report: tool and spindle for the setup sheet, the cuts, the paths.

**Claims** (`milling_claims`): requirements on the job, which follow from the problem alone.
"""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from planner.claims.claim import Claim, ContactOnlyIn, FeedWindow
from planner.claims.dialogue import (
    OperatorDialogue,
    message_step,
    power_off_steps,
    power_on_steps,
    question_step,
)
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, Mesh, RuledSurface, from_parts, read_only
from planner.geometry.corner_rounding import ROTATION_LEVER_MM
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.problem import Part
from planner.processes.milling import claims as cutter_claims
from planner.processes.milling import sentences as milling_sentences
from planner.processes.milling.plan.check import check_work
from planner.processes.milling.plan.flank_cut import find_ruled_surface
from planner.processes.milling.plan.operation import (
    EngraveCut,
    FlankCut,
    GCodeCut,
    GCodeFile,
    LinesCut,
    Milling,
    Orient,
)
from planner.processes.milling.plan.process_plan import MillingPlan, PlannedCut, plan_milling
from planner.processes.milling.plan.tool_path import BLOCK_SIDES, MillingRoute, plan_route
from planner.targets import Aim, CornerRounding, Job, ScrewFreedom, TargetAction, Targets

MILL: Final = "mill"
"""Kind of the segments in which a cutter mills."""

AXIS_TOLERANCE_RAD: Final = 0.5 * DEG
"""Allowed deviation of the tool's axis from the required one [rad]."""

TIP_TOLERANCE_M: Final = 0.5 * MM
"""Minimum tolerance of the tip's path [m] if a claim on a surface decides about the shape.

It allows for the rounding of corners of the path.
"""


def milling_claims(work: MillingPlan, part: Part | None) -> tuple[Claim, ...]:
    """Return the claims of a milling job.

    They are on the spindle, the operator dialogue, feed and shape of each cut, and the faces of the part that
    no cut may enter. The feeds of G-code files and engravings are not claimed here: the proof derives them
    from the claim on the file or the curves.
    """
    op = work.operation
    out: list[Claim] = [ContactOnlyIn(("mill",), op.signal, op.spin_up_s)]
    out.append(_operator_dialogue(work))
    for number, planned in enumerate(work.cuts):
        if isinstance(planned.cut, GCodeCut):
            out.append(_program_claim(work, planned, planned.cut, number == 0))
            segments: tuple[Segment, ...] = (Segment(MILL, planned.cut.name),)
        elif isinstance(planned.cut, EngraveCut):
            out.append(_engraving_claim(work, planned, planned.cut))
            segments = tuple(run.segment for run in planned.passes)
        else:
            out += _feed_claims(work, planned)
            out += _shape_claims(work, planned, part)
            segments = tuple(run.segment for run in planned.passes)
        for face in work.faces:
            depth = planned.engraving_depth if face.name == "front" else 0.0
            mesh = (face.mesh.vertices, face.mesh.faces)
            out.append(
                cutter_claims.SparesPart(segments, op.arms[0], work.cutter, *mesh, depth, planned.tolerance)
            )
    return tuple(out)


def _operator_dialogue(work: MillingPlan) -> OperatorDialogue:
    """Return the operator dialogue with block, cutter and spindle speed.

    The speed is left out if files state it. The proof adds the questions that it reads from the files.
    """
    op, size = work.operation, np.ptp(work.box, axis=0) / MM
    block = {"x_mm": float(size[0]), "y_mm": float(size[1]), "z_mm": float(size[2])}
    cutter = {"kind": work.cutter.kind, "diameter_mm": 2.0 * work.cutter.radius / MM}
    if op.by_files:
        block_message = message_step(milling_sentences.BLOCK_OF_FILE, **block, **cutter)
    else:
        block_message = message_step(milling_sentences.BLOCK, **block, **cutter, rpm=float(op.spindle_rpm))
    return OperatorDialogue(
        op.arms,
        (
            block_message,
            question_step(milling_sentences.BLOCK_READY),
            *power_on_steps(op.signal, op.spin_up_s),
        ),
        (*power_off_steps(op.signal, op.spin_down_s), question_step(milling_sentences.SPINDLE_STOPPED)),
    )


def program_file(gcode: GCodeFile) -> cutter_claims.ProgramFile:
    """Return the statements of the problem about a G-code file, in its own words and units."""
    return cutter_claims.ProgramFile(
        path=gcode.file,
        xyz_mm=gcode.origin.xyz_mm,
        rpy_deg=gcode.origin.rpy_deg,
        unit=gcode.unit,
        distance=gcode.distance,
        motion=gcode.motion,
        plane=gcode.plane,
        arc_centre=gcode.arc_centre,
        feed_mode=gcode.feed_mode,
        feed_mm_min=gcode.feed_mm_min,
        spindle_rpm=gcode.spindle_rpm,
        tool_axis=gcode.tool_axis,
        ijk_to=gcode.ijk_to,
        convention=gcode.convention,
        reverse=gcode.reverse,
        start_mm=gcode.start_mm,
        offsets=tuple((name, shift) for name, shift in gcode.offsets.items()),
        block_delete=gcode.block_delete,
        skip=gcode.skip,
        tool=gcode.tool,
        chord_tol_mm=gcode.chord_tol_mm,
        dwell=gcode.dwell,
    )


def _program_claim(
    work: MillingPlan, planned: PlannedCut, cut: GCodeCut, first: bool
) -> cutter_claims.MillsProgram:
    """Return the claim on the path of a G-code file, which the proof reads itself.

    ``first``: whether it is the first cut of the operation.
    """
    safe = _safe_moves(work.operation, work.box)
    file = program_file(cut.gcode)
    return cutter_claims.MillsProgram(
        cut.name, work.operation.arms[0], file, safe, planned.tolerance, AXIS_TOLERANCE_RAD, first
    )


def _engraving_claim(work: MillingPlan, planned: PlannedCut, cut: EngraveCut) -> cutter_claims.Engraves:
    """Return the claim on curves engraved in the part's front."""
    op, front = work.operation, next(face.mesh for face in work.faces if face.name == "front")
    return cutter_claims.Engraves(
        name=cut.name,
        arm=op.arms[0],
        cutter=work.cutter,
        curves=tuple(curve.to_drawn_curve() for curve in cut.engrave),
        vertices=front.vertices,
        faces=front.faces,
        depth=cut.depth_mm * MM,
        axis=cut.axis,
        axis_curves=tuple(curve.to_drawn_curve() for curve in cut.axis_curves),
        lead=cut.lead_deg * DEG,
        tilt=cut.tilt_deg * DEG,
        feed=(cut.feed_mm_s or op.feed_mm_s) * MM,
        safe=_safe_moves(op, work.box),
        tolerance=planned.tolerance,
        turn=AXIS_TOLERANCE_RAD,
    )


def _safe_moves(op: Milling, box: FloatArray) -> cutter_claims.SafeMoves:
    """Return the claim on moves to and from passes of the block ``box`` (2, 3) [m]."""
    normal_axis, end = BLOCK_SIDES[op.safe_side]
    free_side = 1.0 if end else -1.0
    level = float(box[end, normal_axis]) + free_side * op.safe_mm * MM
    return cutter_claims.SafeMoves(normal_axis, free_side, level, op.plunge_mm_s * MM, op.rapid_mm_s * MM)


def _feed_claims(work: MillingPlan, planned: PlannedCut) -> list[Claim]:
    """Return claims on the feeds of all passes of a cut.

    A lead-in may also have the speed of plunging, a lead-out that of rapid moves.
    """
    op, out = work.operation, list[Claim]()
    cut_feed = None if isinstance(planned.cut, GCodeCut) else planned.cut.feed_mm_s
    feed = (cut_feed or op.feed_mm_s) * MM
    for run in planned.passes:
        out.append(FeedWindow(run.segment.at("in"), 0.0, max(feed, op.plunge_mm_s * MM)))
        out.append(FeedWindow(run.segment, 0.0, feed))
        out.append(FeedWindow(run.segment.at("out"), 0.0, max(feed, op.rapid_mm_s * MM)))
    return out


def _shape_claims(work: MillingPlan, planned: PlannedCut, part: Part | None) -> list[Claim]:
    """Return claims on the surface that a cut produces, and on the path of the cutter over it."""
    op = work.operation
    out: list[Claim] = []
    if planned.face is not None:
        # Only the last pass of a flank cut produces the surface.
        finish = planned.passes[-1:] if isinstance(planned.cut, FlankCut) else planned.passes
        segments = tuple(run.segment for run in finish)
        mesh, margin = planned.face.mesh, 0.0
        if isinstance(planned.cut, LinesCut) and part is not None and part.front is not None:
            mesh, margin = part.front, planned.cut.margin_mm * MM
        bounds = planned.tolerance, op.share, margin
        out.append(
            cutter_claims.MillsSurface(segments, op.arms[0], work.cutter, mesh.vertices, mesh.faces, *bounds)
        )
    # If a surface is claimed, it decides about the shape. The path only ensures that nothing else is milled.
    tolerance = planned.tolerance if planned.face is None else max(planned.tolerance, TIP_TOLERANCE_M)
    if isinstance(planned.cut, LinesCut) and part is not None and part.front is not None:
        return [*out, _face_claim(work, planned, planned.cut, part.front, tolerance)]
    if isinstance(planned.cut, FlankCut):
        return [
            *out,
            _flank_claim(work, planned, planned.cut, find_ruled_surface(part, planned.cut.flank), tolerance),
        ]
    return out


def _face_claim(
    work: MillingPlan, planned: PlannedCut, cut: LinesCut, front: Mesh, tolerance: float
) -> cutter_claims.MillsOver:
    """Return the claim that the cutter's end passes over the front."""
    return cutter_claims.MillsOver(
        segments=tuple(run.segment for run in planned.passes),
        arm=work.operation.arms[0],
        cutter=work.cutter,
        vertices=front.vertices,
        faces=front.faces,
        margin=cut.margin_mm * MM,
        upright=cut.axis == "upright",
        # lead and tilt are about perpendicular axes, so their tangents add as a vector
        max_tilt=float(np.arctan(np.hypot(np.tan(cut.lead_deg * DEG), np.tan(cut.tilt_deg * DEG)))),
        safe=_safe_moves(work.operation, work.box),
        tolerance=tolerance,
        turn=AXIS_TOLERANCE_RAD,
    )


def _flank_claim(
    work: MillingPlan, planned: PlannedCut, cut: FlankCut, ruled: RuledSurface, tolerance: float
) -> cutter_claims.MillsFlank:
    """Return the claim that the cutter's side passes along a ruled surface, or its axis along two guides."""
    op, cutter = work.operation, work.cutter
    from_start, by_surface = cut.tip == "start", cut.guides == "surface"
    return cutter_claims.MillsFlank(
        segments=tuple(run.segment for run in planned.passes),
        arm=op.arms[0],
        cutter=cutter,
        low=ruled.start if from_start else ruled.end,
        high=ruled.end if from_start else ruled.start,
        outward_sign=1.0 if from_start else -1.0,
        closed=ruled.closed,
        direction=cut.direction,
        axis_offset=cutter.radius if by_surface else 0.0,
        tip_overrun=cut.overrun_mm * MM + (cutter.corner if by_surface else 0.0),
        roughing_allowance=cut.leave_mm * MM,
        stepdown=cut.stepdown_mm * MM if cut.stepdown_mm is not None and by_surface else None,
        lead_length=None if cut.lead_mm is None else cut.lead_mm * MM,
        feed=(cut.feed_mm_s or op.feed_mm_s) * MM,
        safe=_safe_moves(op, work.box),
        tolerance=tolerance,
        turn=AXIS_TOLERANCE_RAD,
    )


def tool_poses(tip: FloatArray, axis: FloatArray) -> FloatArray:
    """Return poses (N, 4, 4) of tools whose TCP is the tip and whose z axis points out of the spindle.

    The x axis is as close as possible to one axis of the block: the one to which no tool axis comes near.
    Motion planning may rotate the tool about z.

    Args:
        tip: Tips (N, 3) [m].
        axis: Unit vectors from tip to spindle (N, 3).
    """
    reference = np.eye(3)[int(np.abs(axis).max(axis=0).argmin())]
    z = -axis
    x = reference - (z @ reference)[:, None] * z
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return from_parts(np.stack([x, np.cross(z, x), z], axis=-1), tip)


def spin_freedom(arm: str, orient: Orient, count: int) -> ScrewFreedom:
    """Return the freedom of a full rotation about the tool's axis at each target.

    Args:
        arm: Name of the arm.
        orient: ``base``: the tool's x axis should aim at the robot's base. ``best``: the rotation is free,
            and the planner only reports what would be gained by this aim.
        count: Number of targets.
    """
    twist = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])  # rotation about z, no translation
    half_turn = np.full(count, np.pi)
    aim = Aim(arm, np.array([1.0, 0.0, 0.0]), is_preferred=orient == "base")
    return ScrewFreedom(f"spin_{arm}", {arm: twist}, -half_turn, half_turn, None, True, aim)


CUT_NAMES: Final = ((FlankCut, "flank"), (LinesCut, "lines"), (GCodeCut, "G\u2011code"))
"""Names of the kinds of cuts in reports."""
MAX_CURVES_SHOWN: Final = 80
"""Maximum number of curves in the picture of the paths."""


def exhibits(work: MillingPlan, route: MillingRoute) -> dict[str, Any]:
    """Return exhibits by name, in the forms that the report knows."""
    return {"setup": _setup_exhibit(work), "cuts": _cuts_exhibit(work), "paths": _paths_exhibit(work)}


def _setup_exhibit(work: MillingPlan) -> dict[str, Any]:
    """Return the exhibit with tool, spindle, feed and safe plane for the setup sheet."""
    op, cutter = work.operation, work.cutter
    size = f"{2e3 * cutter.radius:g} mm, flute {cutter.flute / MM:g} mm"
    corner = f", corner {cutter.corner / MM:g} mm" if cutter.kind == "bull" else ""
    spindle: list[tuple[Any, ...]] = [("spindle", f"{op.spindle_rpm:g}", "1/min, clockwise (M3)")]
    if any(isinstance(planned.cut, GCodeCut) for planned in work.cuts):
        file_spindle = ("spindle in passes of files", "speed and direction as the program asks before them")
        spindle = [file_spindle] if op.by_files else [*spindle, file_spindle]
    items: list[tuple[Any, ...]] = [
        ("cutter", f"{cutter.kind}, {size}{corner}"),
        ("overhang of the cutter", f"{cutter.overhang / MM:g}", "mm from the holder's nose to the tip"),
        ("TCP", "the tip of the cutter, on its axis; z out of the spindle"),
        *spindle,
        ("spindle signal", op.signal),
        ("feed", _feed_range(work), "mm/s"),
        ("safe plane", f"{op.safe_mm:g} mm from the block, side {op.safe_side}"),
    ]
    return {"kind": "setup", "title": "Milling", "items": items}


def _feed_range(work: MillingPlan) -> str:
    """Return the smallest and largest feed [mm/s] of the passes as text."""
    feeds = np.concatenate([run.path.feed[run.first + 1 : run.last + 1] for run in work.passes]) / MM
    low, high = float(feeds.min()), float(feeds.max())
    return f"{low:g}" if np.isclose(low, high) else f"{low:.3g} to {high:.3g}"


def _cuts_exhibit(work: MillingPlan) -> dict[str, Any]:
    """Return the exhibit with a table of all passes."""
    rows = []
    for planned in work.cuts:
        kind = next((name for model, name in CUT_NAMES if isinstance(planned.cut, model)), "engraving")
        for run in planned.passes:
            length = np.linalg.norm(np.diff(run.path.tip, axis=0), axis=1).sum()
            deviation = (
                f"{planned.deviation / MM:.4f}"
                if planned.deviation > 0.0 and run is planned.passes[-1]
                else ""
            )
            rows.append(
                (run.name, kind, len(run.path), f"{length:.2f}", deviation, f"{planned.tolerance / MM:g}")
            )
    columns = ("pass", "kind", "targets", "length [m]", "cutter to surface [mm]", "allowed [mm]")
    # Only flank cuts can deviate because of their geometry. Without any, the column is left out.
    shown_columns = [k for k in range(len(columns)) if k != 4 or any(row[4] for row in rows)]
    shown_rows = [tuple(row[k] for k in shown_columns) for row in rows]
    names = tuple(columns[k] for k in shown_columns)
    return {"kind": "table", "title": "Passes in order", "columns": names, "rows": shown_rows}


def _paths_exhibit(work: MillingPlan) -> dict[str, Any]:
    runs = work.passes
    curves = [run.path.tip for run in runs[:: max(1, len(runs) // MAX_CURVES_SHOWN)]]
    return {"kind": "paths", "title": "Path of the cutter's tip", "curves": curves}


MEAN_FEED_FRACTION: Final = 0.66
"""Mean speed of moves from or to a stop, as a fraction of the feed."""
AIR_LEVER_M: Final = 0.05
"""Distance behind the tip [m] of a point whose speed counts, too, so that the tool rotates slowly in the
air.
"""


class MillingJob(Job[Milling]):
    """Job of an operation that mills, with its cutter and the block as the operation finds it."""

    @functools.cached_property
    def planned(self) -> MillingPlan:
        """Cuts as passes. The result is computed once, and its arrays are read-only."""
        return read_only(plan_milling(self.operation, self.setup, self.part))

    def targets(self) -> Targets:
        """Return the targets of the operation.

        Raises:
            TandemError: Codes ``milling.*``.
        """
        plan = self.planned
        route = plan_route(self.operation, plan.passes, plan.box)
        issues = [] if self.is_brief else check_work(plan)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        claims = () if self.is_brief else self.claims()
        targets = _build_targets(plan, route, aggregate(issues), claims)
        return targets if self.is_brief else dataclasses.replace(targets, exhibits=exhibits(plan, route))

    def make_claims(self) -> tuple[Claim, ...]:
        """Return the claims of the job, from the problem alone."""
        return milling_claims(self.planned, self.part)


def _build_targets(
    plan: MillingPlan, route: MillingRoute, issues: tuple[Issue, ...], claims: tuple[Claim, ...]
) -> Targets:
    """Return the targets of a route, with actions, freedoms and claims."""
    op = plan.operation
    arm, count = op.arms[0], len(route.segment)
    actions = tuple(sorted(_build_actions(plan, route), key=lambda action: action.target))
    stop = route.stop.copy()
    stop[[action.target for action in actions]] = True
    return Targets(
        arms=op.arms,
        pose={arm: tool_poses(route.tip, route.axis)},
        frame={arm: "stock"},
        freedoms=(spin_freedom(arm, op.orient, count),),
        # moves that start or end at a stop count with their mean speed
        feed=np.where(np.append(False, stop[:-1]) | stop, MEAN_FEED_FRACTION, 1.0) * route.feed,
        feed_min=np.zeros(count),
        travel=_travel_lengths(route),
        stop=stop,
        segment=route.segment,
        actions=actions,
        claims=claims,
        issues=issues,
        rounding=rounding(claims),
        may_stop=True,
        may_join=True,
        feed_throughout=any(isinstance(claim, FeedWindow) for claim in claims),
        feed_source="the G-code file"
        if any(isinstance(planned.cut, GCodeCut) for planned in plan.cuts)
        else "",
    )


PATH_CLAIMS: Final = (
    cutter_claims.MillsProgram,
    cutter_claims.Engraves,
    cutter_claims.MillsFlank,
    cutter_claims.MillsOver,
)
"""Claims on the path of the cutter."""
TURNING_LEVER: Final = ROTATION_LEVER_MM * MM
"""Length [m/rad] that converts rotations to distances if no claim requires another one."""
TIGHT_FRACTION: Final = 0.5
"""Fraction of a tolerance that rounded corners may use, if it is less than their usual deviation in the
air.
"""
ROUNDED_FRACTION: Final = 0.15
"""Fraction of the tightest tolerance of a cut that rounded corners may use, if it is more than in the air."""
CURVE_FRACTION: Final = 0.75
"""Fraction of tolerances on surfaces that curves of spline blocks may use.

Rounded corners then use no part of these tolerances.
"""
CURVE_PATH_FRACTION: Final = 0.5
"""Fraction of tolerances on paths that curves of spline blocks may use.

The division of these paths into targets uses a part of the tolerance, too.
"""
SPIN_TOLERANCE_M: Final = 5e-4
"""Allowed displacement [m] by a deviation of the spin, at ``TURNING_LEVER`` from the tool's axis.

It is the usual one of a body in the air, because a spinning cutter is a body of revolution.
"""


def rounding(claims: Sequence[Claim]) -> CornerRounding:
    """Return the deviations that rounded corners and curves may use of the tolerances on surfaces and paths.

    A cutter is a body of revolution that follows a path within an angle. Its spin may therefore deviate as
    much as that of a body in the air. Its tilt may deviate by a fraction of the angle, unless a surface or a
    spared face requires less.

    Args:
        claims: Claims of the job.
    """
    path_claims = [claim for claim in claims if isinstance(claim, PATH_CLAIMS)]
    spare_claims = [claim for claim in claims if isinstance(claim, cutter_claims.SparesPart)]
    tolerance = min((claim.tolerance for claim in (*path_claims, *spare_claims)), default=np.inf)
    air = min(CornerRounding.air, TIGHT_FRACTION * tolerance)
    work = max(air, ROUNDED_FRACTION * tolerance) if np.isfinite(tolerance) else air
    # levers [m/rad] convert deviations of tilt and spin to distances, which then must not exceed ``work``
    tilt_lever, spin_lever = TURNING_LEVER, TURNING_LEVER * work / SPIN_TOLERANCE_M
    if not spare_claims and not any(isinstance(claim, cutter_claims.MillsSurface) for claim in claims):
        tilt_lever = min([tilt_lever, *(work / (ROUNDED_FRACTION * claim.turn) for claim in path_claims)])
    levers = {claim.arm: np.array([tilt_lever, tilt_lever, spin_lever]) for claim in path_claims}
    return CornerRounding(work, air, air, levers, _curve_tolerances(claims))


def _curve_tolerances(claims: Sequence[Claim]) -> dict[str, tuple[tuple[float, float], ...]]:
    """Return the allowed deviations of curves from straight moves, by arm.

    Each entry is a distance [m] from the TCP, and the deviation [m] that is allowed up to this distance.
    """
    out: dict[str, tuple[tuple[float, float], ...]] = {}
    for claim in claims:
        match claim:
            case cutter_claims.MillsProgram():
                entry = 0.0, CURVE_PATH_FRACTION * claim.tolerance
            case cutter_claims.Engraves():
                entry = claim.cutter.flute, CURVE_PATH_FRACTION * claim.tolerance
            case cutter_claims.SparesPart():
                reach = 0.0 if claim.cutter is None else claim.cutter.overhang
                entry = reach, CURVE_FRACTION * claim.tolerance
            case cutter_claims.MillsFlank() | cutter_claims.MillsOver() | cutter_claims.MillsSurface():
                entry = claim.cutter.flute, CURVE_FRACTION * claim.tolerance
            case _:
                continue
        out[claim.arm] = (*out.get(claim.arm, ()), entry)
    return out


def _travel_lengths(route: MillingRoute) -> FloatArray:
    """Return the distance (N,) [m] that the fastest working point of the cutter moves to each target.

    The first value is 0. Working points are the tip, and a point at the reach of the cutter, at least
    `AIR_LEVER_M` behind the tip.
    """
    out = np.zeros(len(route.tip))
    for reach in (0.0, np.maximum(route.reach[1:], AIR_LEVER_M)[:, None]):
        ends = route.tip[1:] + reach * route.axis[1:], route.tip[:-1] + reach * route.axis[:-1]
        out[1:] = np.maximum(out[1:], np.linalg.norm(ends[0] - ends[1], axis=1))
    return out


def _build_actions(plan: MillingPlan, route: MillingRoute) -> tuple[TargetAction, ...]:
    """Return the actions of the job: messages, questions, waits, and switching of the spindle."""
    op = plan.operation
    last = len(route.segment) - 1
    return (
        TargetAction(0, "message", _cuts_message(plan)),
        *(TargetAction(0, "confirm", run.question) for run in plan.passes[:1] if run.question),
        TargetAction(0, "confirm", milling_sentences.BLOCK_READY.format()),
        TargetAction(0, "on", signal=op.signal),
        TargetAction(0, "wait", seconds=op.spin_up_s),
        *_actions_between(plan, route),
        TargetAction(last, "off", signal=op.signal),
        TargetAction(last, "wait", seconds=op.spin_down_s),
        TargetAction(last, "confirm", milling_sentences.SPINDLE_STOPPED.format()),
    )


def _cuts_message(plan: MillingPlan) -> str:
    """Return the message on block, cutter and spindle speed. The speed is left out if files state it."""
    size, op = (plan.box[1] - plan.box[0]) / MM, plan.operation
    values = {"x_mm": size[0], "y_mm": size[1], "z_mm": size[2], "diameter_mm": 2e3 * plan.cutter.radius}
    if op.by_files:
        return milling_sentences.BLOCK_OF_FILE.format(kind=plan.cutter.kind, **values)
    return milling_sentences.BLOCK.format(kind=plan.cutter.kind, rpm=op.spindle_rpm, **values)


def _actions_between(plan: MillingPlan, route: MillingRoute) -> Iterator[TargetAction]:
    """Yield questions between passes, on the safe plane with the spindle stopped, and waits inside passes."""
    op = plan.operation
    starts = [i for i, segment in enumerate(route.segment) if segment.kind in ("approach", "link")]
    for number, (run, start) in enumerate(zip(plan.passes, starts, strict=True)):
        if run.question and number > 0:
            yield TargetAction(start, "off", signal=op.signal)
            yield TargetAction(start, "wait", seconds=op.spin_down_s)
            yield TargetAction(start, "confirm", run.question)
            yield TargetAction(start, "on", signal=op.signal)
            yield TargetAction(start, "wait", seconds=op.spin_up_s)
        for row, seconds in run.waits:
            yield TargetAction(start + 1 + row, "wait", seconds=seconds)
