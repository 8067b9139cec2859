"""What must hold of a milling job, as claims, from the problem alone."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from planner.claims import dialogue
from planner.claims.claim import Claim, ContactOnlyIn, FeedWindow
from planner.claims.dialogue import (
    OperatorDialogue,
    message_step,
    power_off_steps,
    power_on_steps,
    question_step,
)
from planner.claims.milling import (
    DrawnCurve,
    Engraves,
    MillsFlank,
    MillsOver,
    MillsProgram,
    MillsSurface,
    ProgramFile,
    SafeWays,
    SparesPart,
)
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, Mesh, Ruled
from planner.milling.flank_cut import surface
from planner.milling.operation import EngraveCut, FlankCut, GCodeCut, GCodeFile, LinesCut, Milling
from planner.milling.process_plan import Done, Work
from planner.milling.tool_path import BLOCK_SIDES
from planner.problem import Part
from planner.reading.part_ruled import GuideFile
from planner.units import DEG, MM

MILL: Final = "mill"
"""The kind of segments in which a cutter mills."""

AXIS_TURN: Final = 0.5 * DEG
"""How far [rad] a tool may be turned off the axis that it is to follow."""

TIP_OFFSET: Final = 0.5 * MM
"""How far [m] the tip may be off its way where a surface says what is to be made: corners are rounded."""


def claims(work: Work, part: Part | None) -> tuple[Claim, ...]:
    """Claims on the spindle, on the feed and the shape of each cut, and on the part
    that all of them spare."""
    op = work.operation
    out: list[Claim] = [ContactOnlyIn(("mill",), op.signal, op.spin_up_s)]
    out.append(_dialogue(work))
    for number, one in enumerate(work.cuts):
        if isinstance(one.cut, GCodeCut):
            out.append(_program(work, one, one.cut, number == 0))
            segments: tuple[Segment, ...] = (Segment(MILL, one.cut.name),)
        elif isinstance(one.cut, EngraveCut):
            out.append(_engraving(work, one, one.cut))
            count = len(one.cut.engrave)
            segments = tuple(Segment(MILL, f"{one.cut.name}_c{k + 1}") for k in range(count))
        else:
            out += _feeds(work, one)
            out += _shape(work, one, part)
            segments = tuple(run.segment for run in one.runs)
        for face in work.faces:
            deep = one.depth if face.name == "front" else 0.0
            mesh = (face.mesh.vertices, face.mesh.faces)
            out.append(SparesPart(segments, op.arms[0], work.cutter, *mesh, deep, one.tolerance))
    return tuple(out)


def _dialogue(work: Work) -> OperatorDialogue:
    """The block, the cutter and its spindle's speed are told, the last one not where files say it; what files
    ask for besides, the proof reads there."""
    op, size = work.operation, np.ptp(work.box, axis=0) / MM
    block = {"x_mm": float(size[0]), "y_mm": float(size[1]), "z_mm": float(size[2])}
    cutter = {"kind": work.cutter.kind, "diameter_mm": 2.0 * work.cutter.radius / MM}
    if op.by_files:
        tell = message_step(dialogue.BLOCK_OF_FILE, **block, **cutter)
    else:
        tell = message_step(dialogue.BLOCK, **block, **cutter, rpm=float(op.spindle_rpm))
    return OperatorDialogue(
        op.arms,
        (
            tell,
            question_step(dialogue.BLOCK_READY),
            *power_on_steps(op.signal, op.spin_up_s),
        ),
        (*power_off_steps(op.signal, op.spin_down_s), question_step(dialogue.STANDS)),
    )


def program_file(own: GCodeFile) -> ProgramFile:
    """What the problem states of a file, word for word."""
    return ProgramFile(
        path=own.file,
        xyz_mm=own.origin.xyz_mm,
        rpy_deg=own.origin.rpy_deg,
        unit=own.unit,
        distance=own.distance,
        motion=own.motion,
        plane=own.plane,
        arc_centre=own.arc_centre,
        feed_mode=own.feed_mode,
        feed_mm_min=own.feed_mm_min,
        spindle_rpm=own.spindle_rpm,
        tool_axis=own.tool_axis,
        ijk_to=own.ijk_to,
        convention=own.convention,
        reverse=own.reverse,
        start_mm=own.start_mm,
        offsets=tuple((name, shift) for name, shift in own.offsets.items()),
        block_delete=own.block_delete,
        skip=own.skip,
        tool=own.tool,
        chord_tol_mm=own.chord_tol_mm,
        dwell=own.dwell,
    )


def _program(work: Work, one: Done, cut: GCodeCut, first: bool) -> MillsProgram:
    """The way of a file, which the proof reads itself."""
    safe = _safe(work.operation, work.box)
    file = program_file(cut.gcode)
    return MillsProgram(cut.name, work.operation.arms[0], file, safe, one.tolerance, AXIS_TURN, first)


def _engraving(work: Work, one: Done, cut: EngraveCut) -> Engraves:
    """Curves on the part's front."""
    op, front = work.operation, next(face.mesh for face in work.faces if face.name == "front")
    return Engraves(
        name=cut.name,
        arm=op.arms[0],
        cutter=work.cutter,
        curves=tuple(_drawn(curve) for curve in cut.engrave),
        vertices=front.vertices,
        faces=front.faces,
        depth=cut.depth_mm * MM,
        axis=cut.axis,
        axis_curves=tuple(_drawn(curve) for curve in cut.axis_curves),
        lead=cut.lead_deg * DEG,
        tilt=cut.tilt_deg * DEG,
        feed=(cut.feed_mm_s or op.feed_mm_s) * MM,
        safe=_safe(op, work.box),
        tolerance=one.tolerance,
        turn=AXIS_TURN,
    )


def _drawn(own: GuideFile) -> DrawnCurve:
    """A curve as the problem draws it."""
    for kind in ("polyline", "bspline", "bezier"):
        points = getattr(own, f"{kind}_mm")
        if points is not None:
            return DrawnCurve(kind, tuple(points))
    if own.dxf is None:
        raise ValueError("a curve needs points or a file")
    return DrawnCurve("dxf", (), Path(own.dxf.file), own.dxf.unit, own.dxf.layer, own.dxf.z_mm)


def _safe(op: Milling, box: FloatArray) -> SafeWays:
    """The ways to passes and from them, by the numbers of the problem."""
    across, end = BLOCK_SIDES[op.safe_side]
    up = 1.0 if end else -1.0
    level = float(box[end, across]) + up * op.safe_mm * MM
    return SafeWays(across, up, level, op.plunge_mm_s * MM, op.rapid_mm_s * MM)


def _feeds(work: Work, one: Done) -> list[Claim]:
    """The feeds of all passes of a cut, ways in and out too."""
    op, out = work.operation, list[Claim]()
    own = None if isinstance(one.cut, GCodeCut) else one.cut.feed_mm_s
    feed = (own or op.feed_mm_s) * MM
    for run in one.runs:
        out.append(FeedWindow(run.segment.at("in"), 0.0, max(feed, op.plunge_mm_s * MM)))
        out.append(FeedWindow(run.segment, 0.0, feed))
        out.append(FeedWindow(run.segment.at("out"), 0.0, max(feed, op.rapid_mm_s * MM)))
    return out


def _shape(work: Work, one: Done, part: Part | None) -> list[Claim]:
    """The surface that a cut makes; where it follows curves, those."""
    op = work.operation
    out: list[Claim] = []
    if one.face is not None:
        # roughing passes leave the surface to the last one
        finish = one.runs[-1:] if isinstance(one.cut, FlankCut) else one.runs
        segments = tuple(run.segment for run in finish)
        mesh, margin = one.face.mesh, 0.0
        if isinstance(one.cut, LinesCut) and part is not None and part.front is not None:
            mesh, margin = part.front, one.cut.margin_mm * MM
        bounds = one.tolerance, op.share, margin
        out.append(MillsSurface(segments, op.arms[0], work.cutter, mesh.vertices, mesh.faces, *bounds))
    # where a surface is claimed it is the measure; the way then only says that nothing else is milled
    near = one.tolerance if one.face is None else max(one.tolerance, TIP_OFFSET)
    if isinstance(one.cut, LinesCut) and part is not None and part.front is not None:
        return [*out, _over(work, one, one.cut, part.front, near)]
    if isinstance(one.cut, FlankCut):
        return [*out, _flank(work, one, one.cut, surface(part, one.cut.flank), near)]
    return out


def _over(work: Work, one: Done, cut: LinesCut, front: Mesh, near: float) -> MillsOver:
    """The front, which the cutter's end passes over."""
    return MillsOver(
        segments=tuple(run.segment for run in one.runs),
        arm=work.operation.arms[0],
        cutter=work.cutter,
        vertices=front.vertices,
        faces=front.faces,
        margin=cut.margin_mm * MM,
        upright=cut.axis == "upright",
        lean=float(np.arctan(np.hypot(np.tan(cut.lead_deg * DEG), np.tan(cut.tilt_deg * DEG)))),
        safe=_safe(work.operation, work.box),
        tolerance=near,
        turn=AXIS_TURN,
    )


def _flank(work: Work, one: Done, cut: FlankCut, ruled: Ruled, near: float) -> MillsFlank:
    """A ruled surface that the cutter's side passes, or two guides that its axis does."""
    op, cutter = work.operation, work.cutter
    from_start, by_surface = cut.tip == "start", cut.guides == "surface"
    return MillsFlank(
        segments=tuple(run.segment for run in one.runs),
        arm=op.arms[0],
        cutter=cutter,
        low=ruled.start if from_start else ruled.end,
        high=ruled.end if from_start else ruled.start,
        out=1.0 if from_start else -1.0,
        closed=ruled.closed,
        direction=cut.direction,
        stand=cutter.radius if by_surface else 0.0,
        beyond=cut.overrun_mm * MM + (cutter.corner if by_surface else 0.0),
        leave=cut.leave_mm * MM,
        stepdown=cut.stepdown_mm * MM if cut.stepdown_mm is not None and by_surface else None,
        lead=None if cut.lead_mm is None else cut.lead_mm * MM,
        feed=(cut.feed_mm_s or op.feed_mm_s) * MM,
        safe=_safe(op, work.box),
        tolerance=near,
        turn=AXIS_TURN,
    )
