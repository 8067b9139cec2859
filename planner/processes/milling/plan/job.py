"""The process `milling`: from surfaces, curves and a cutter to targets of one arm, and its claims.

See `process_plan` (cuts as passes), `flank_cut`, `point_cut` and `gcode` (each kind), `tool_path`
(the ways between), `check` (what would go wrong).

**Poses**: from tips and axes to poses of the TCP and to what motion may choose, the spin about the
tool.

**Exhibits** for the report: tool and spindle for the setup sheet, the cuts, the ways.

**Claims** (`claims`): what must hold of the job, from the problem alone.
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
from planner.geometry.arrays import FloatArray, Mesh, Ruled, from_parts, read_only
from planner.geometry.corner_rounding import TURNING_LEVER_MM
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.problem import Part
from planner.processes.milling import claims as facts
from planner.processes.milling import sentences as milling_sentences
from planner.processes.milling.plan.check import check
from planner.processes.milling.plan.flank_cut import surface
from planner.processes.milling.plan.operation import (
    EngraveCut,
    FlankCut,
    GCodeCut,
    GCodeFile,
    LinesCut,
    Milling,
    Orient,
)
from planner.processes.milling.plan.process_plan import Done, Work, work
from planner.processes.milling.plan.tool_path import BLOCK_SIDES, Route, lay_out
from planner.targets import Action, Aim, Job, Rounding, ScrewFreedom, Targets

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
            segments = tuple(run.segment for run in one.runs)
        else:
            out += _feed_claims(work, one)
            out += _shape(work, one, part)
            segments = tuple(run.segment for run in one.runs)
        for face in work.faces:
            deep = one.depth if face.name == "front" else 0.0
            mesh = (face.mesh.vertices, face.mesh.faces)
            out.append(facts.SparesPart(segments, op.arms[0], work.cutter, *mesh, deep, one.tolerance))
    return tuple(out)


def _dialogue(work: Work) -> OperatorDialogue:
    """The block, the cutter and its spindle's speed are told, the last one not where files say it; what files
    ask for besides, the proof reads there."""
    op, size = work.operation, np.ptp(work.box, axis=0) / MM
    block = {"x_mm": float(size[0]), "y_mm": float(size[1]), "z_mm": float(size[2])}
    cutter = {"kind": work.cutter.kind, "diameter_mm": 2.0 * work.cutter.radius / MM}
    if op.by_files:
        tell = message_step(milling_sentences.BLOCK_OF_FILE, **block, **cutter)
    else:
        tell = message_step(milling_sentences.BLOCK, **block, **cutter, rpm=float(op.spindle_rpm))
    return OperatorDialogue(
        op.arms,
        (tell, question_step(milling_sentences.BLOCK_READY), *power_on_steps(op.signal, op.spin_up_s)),
        (*power_off_steps(op.signal, op.spin_down_s), question_step(milling_sentences.STANDS)),
    )


def program_file(own: GCodeFile) -> facts.ProgramFile:
    """What the problem states of a file, word for word."""
    return facts.ProgramFile(
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


def _program(work: Work, one: Done, cut: GCodeCut, first: bool) -> facts.MillsProgram:
    """The way of a file, which the proof reads itself."""
    safe = _safe(work.operation, work.box)
    file = program_file(cut.gcode)
    return facts.MillsProgram(cut.name, work.operation.arms[0], file, safe, one.tolerance, AXIS_TURN, first)


def _engraving(work: Work, one: Done, cut: EngraveCut) -> facts.Engraves:
    """Curves on the part's front."""
    op, front = work.operation, next(face.mesh for face in work.faces if face.name == "front")
    return facts.Engraves(
        name=cut.name,
        arm=op.arms[0],
        cutter=work.cutter,
        curves=tuple(curve.drawn() for curve in cut.engrave),
        vertices=front.vertices,
        faces=front.faces,
        depth=cut.depth_mm * MM,
        axis=cut.axis,
        axis_curves=tuple(curve.drawn() for curve in cut.axis_curves),
        lead=cut.lead_deg * DEG,
        tilt=cut.tilt_deg * DEG,
        feed=(cut.feed_mm_s or op.feed_mm_s) * MM,
        safe=_safe(op, work.box),
        tolerance=one.tolerance,
        turn=AXIS_TURN,
    )


def _safe(op: Milling, box: FloatArray) -> facts.SafeWays:
    """The ways to passes and from them, by the numbers of the problem."""
    across, end = BLOCK_SIDES[op.safe_side]
    up = 1.0 if end else -1.0
    level = float(box[end, across]) + up * op.safe_mm * MM
    return facts.SafeWays(across, up, level, op.plunge_mm_s * MM, op.rapid_mm_s * MM)


def _feed_claims(work: Work, one: Done) -> list[Claim]:
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
        out.append(facts.MillsSurface(segments, op.arms[0], work.cutter, mesh.vertices, mesh.faces, *bounds))
    # where a surface is claimed it is the measure; the way then only says that nothing else is milled
    near = one.tolerance if one.face is None else max(one.tolerance, TIP_OFFSET)
    if isinstance(one.cut, LinesCut) and part is not None and part.front is not None:
        return [*out, _over(work, one, one.cut, part.front, near)]
    if isinstance(one.cut, FlankCut):
        return [*out, _flank(work, one, one.cut, surface(part, one.cut.flank), near)]
    return out


def _over(work: Work, one: Done, cut: LinesCut, front: Mesh, near: float) -> facts.MillsOver:
    """The front, which the cutter's end passes over."""
    return facts.MillsOver(
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


def _flank(work: Work, one: Done, cut: FlankCut, ruled: Ruled, near: float) -> facts.MillsFlank:
    """A ruled surface that the cutter's side passes, or two guides that its axis does."""
    op, cutter = work.operation, work.cutter
    from_start, by_surface = cut.tip == "start", cut.guides == "surface"
    return facts.MillsFlank(
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


def poses(tip: FloatArray, axis: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) of tools whose TCP is ``tip`` (N, 3) [m] and whose z axis points out of the spindle,
    against ``axis`` (N, 3); x is as near as may be to that axis of the block that no tool comes near to."""
    reference = np.eye(3)[int(np.abs(axis).max(axis=0).argmin())]
    z = -axis
    x = reference - (z @ reference)[:, None] * z
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return from_parts(np.stack([x, np.cross(z, x), z], axis=-1), tip)


def spin(arm: str, orient: Orient, count: int) -> ScrewFreedom:
    """A whole turn about the tool's axis at each target; its x axis may aim at the robot's base, or what that
    would be worth is told."""
    twist = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    turn = np.full(count, np.pi)
    aim = Aim(arm, np.array([1.0, 0.0, 0.0]), wanted=orient == "base")
    return ScrewFreedom(f"spin_{arm}", {arm: twist}, -turn, turn, None, True, aim)


CUT_NAMES: Final = ((FlankCut, "flank"), (LinesCut, "lines"), (GCodeCut, "G\u2011code"))
"""Kinds of cuts in words."""
CURVES_SHOWN: Final = 80
"""Curves that the picture of the ways shows at most."""


def exhibits(work: Work, route: Route) -> dict[str, Any]:
    """Exhibits by name, in the forms that the report knows."""
    return {"setup": _setup(work), "cuts": _cuts(work), "paths": _paths(work)}


def _setup(work: Work) -> dict[str, Any]:
    op, cutter = work.operation, work.cutter
    size = f"{2e3 * cutter.radius:g} mm, flute {cutter.flute / MM:g} mm"
    corner = f", corner {cutter.corner / MM:g} mm" if cutter.kind == "bull" else ""
    spindle: list[tuple[Any, ...]] = [("spindle", f"{op.spindle_rpm:g}", "1/min, clockwise (M3)")]
    if any(isinstance(one.cut, GCodeCut) for one in work.cuts):
        asked = ("spindle in passes of files", "speed and sense as the program asks before them")
        spindle = [asked] if op.by_files else [*spindle, asked]
    items: list[tuple[Any, ...]] = [
        ("cutter", f"{cutter.kind}, {size}{corner}"),
        ("overhang of the cutter", f"{cutter.overhang / MM:g}", "mm from the holder's nose to the tip"),
        ("TCP", "the tip of the cutter, on its axis; z out of the spindle"),
        *spindle,
        ("spindle signal", op.signal),
        ("feed", _feeds(work), "mm/s"),
        ("safe plane", f"{op.safe_mm:g} mm off the block, side {op.safe_side}"),
    ]
    return {"kind": "setup", "title": "Milling", "items": items}


def _feeds(work: Work) -> str:
    """Least and greatest feed [mm/s] of the passes."""
    feeds = np.concatenate([run.path.feed[run.first + 1 : run.last + 1] for run in work.runs]) / MM
    low, high = float(feeds.min()), float(feeds.max())
    return f"{low:g}" if np.isclose(low, high) else f"{low:.3g} to {high:.3g}"


def _cuts(work: Work) -> dict[str, Any]:
    rows = []
    for one in work.cuts:
        kind = next((name for model, name in CUT_NAMES if isinstance(one.cut, model)), "engraving")
        for run in one.runs:
            way = np.linalg.norm(np.diff(run.path.tip, axis=0), axis=1).sum()
            off = f"{one.off / MM:.4f}" if one.off > 0.0 and run is one.runs[-1] else ""
            rows.append((run.name, kind, len(run.path), f"{way:.2f}", off, f"{one.tolerance / MM:g}"))
    columns = ("pass", "kind", "targets", "way [m]", "cutter off the surface [mm]", "allowed [mm]")
    # only flanks can be off by their own geometry
    kept = [k for k in range(len(columns)) if k != 4 or any(row[4] for row in rows)]
    shown = [tuple(row[k] for k in kept) for row in rows]
    names = tuple(columns[k] for k in kept)
    return {"kind": "table", "title": "Passes in order", "columns": names, "rows": shown}


def _paths(work: Work) -> dict[str, Any]:
    runs = work.runs
    curves = [run.path.tip for run in runs[:: max(1, len(runs) // CURVES_SHOWN)]]
    return {"kind": "paths", "title": "Way of the cutter's tip", "curves": curves}


MEAN_FEED_FROM_REST: Final = 0.66
"""Part of the feed that moves from or to a stop have on average, as they are faster in between."""
AIR_LEVER: Final = 0.05
"""A point so far [m] behind the tip counts for the speed in the air, where the tool turns."""


class MillingJob(Job[Milling]):
    """An operation that mills, with the cutter and the block that it finds."""

    @functools.cached_property
    def planned(self) -> Work:
        """Cuts as passes: worked out once, and nobody can write into their arrays."""
        return read_only(work(self.operation, self.setup, self.part))

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``milling.*``."""
        made = self.planned
        route = lay_out(self.operation, made.runs, made.box)
        issues = [] if self.brief else check(made)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        claims = () if self.brief else self.claims()
        found = _targets(made, route, aggregate(issues), claims)
        return found if self.brief else dataclasses.replace(found, exhibits=exhibits(made, route))

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        return claims(self.planned, self.part)


def _targets(made: Work, route: Route, issues: tuple[Issue, ...], claims: tuple[Claim, ...]) -> Targets:
    op = made.operation
    arm, count = op.arms[0], len(route.segment)
    actions = tuple(sorted(_actions(made, route), key=lambda action: action.at))
    stop = route.stop.copy()
    stop[[action.at for action in actions]] = True
    return Targets(
        arms=op.arms,
        pose={arm: poses(route.tip, route.axis)},
        frame={arm: "stock"},
        freedoms=(spin(arm, op.orient, count),),
        feed=np.where(np.append(False, stop[:-1]) | stop, MEAN_FEED_FROM_REST, 1.0) * route.feed,
        feed_min=np.zeros(count),
        travel=_travel(route),
        stop=stop,
        segment=route.segment,
        actions=actions,
        claims=claims,
        issues=issues,
        rounding=rounding(claims),
        may_stop=True,
        may_join=True,
        feed_throughout=any(isinstance(claim, FeedWindow) for claim in claims),
        feed_source="the G-code file" if any(isinstance(one.cut, GCodeCut) for one in made.cuts) else "",
    )


WAYS: Final = (facts.MillsProgram, facts.Engraves, facts.MillsFlank, facts.MillsOver)
"""Claims on the way of the cutter."""
TURNING_LEVER: Final = TURNING_LEVER_MM * MM
"""What turning counts as [m/rad] where nothing else is known."""
TIGHT_SHARE: Final = 0.5
"""Part of a tolerance that rounded corners take at most where it is tighter than what they take anyway."""
ROUNDED_SHARE: Final = 0.15
"""Part of the tolerance of what is milled that rounded corners may take, where it is more."""
CURVE_SHARE: Final = 0.75
CURVE_WAY_SHARE: Final = 0.5
"""Parts of tolerances that curves of spline blocks may take: of those on surfaces, which corners then leave
alone, and of those on ways that are divided by a part of it themselves."""
SPIN_WAY: Final = 5e-4
"""How far [m] what spins with the tool may be off, at the lever of its turning: as a solid in the air."""


def rounding(claims: Sequence[Claim]) -> Rounding:
    """Corners and curves take a share of what is allowed of surfaces and ways.

    A cutter is a body of revolution that follows a way within an angle: its spin is worth what a solid may
    move in the air, its lean, where no surface asks for more, what that angle allows.
    """
    ways = [claim for claim in claims if isinstance(claim, WAYS)]
    spared = [claim for claim in claims if isinstance(claim, facts.SparesPart)]
    tolerance = min((claim.tolerance for claim in (*ways, *spared)), default=np.inf)
    air = min(Rounding.air, TIGHT_SHARE * tolerance)
    work = max(air, ROUNDED_SHARE * tolerance) if np.isfinite(tolerance) else air
    lean, spin = TURNING_LEVER, TURNING_LEVER * work / SPIN_WAY
    if not spared and not any(isinstance(claim, facts.MillsSurface) for claim in claims):
        lean = min([lean, *(work / (ROUNDED_SHARE * claim.turn) for claim in ways)])
    levers = {claim.arm: np.array([lean, lean, spin]) for claim in ways}
    return Rounding(work, air, air, levers, _curves(claims))


def _curves(claims: Sequence[Claim]) -> dict[str, tuple[tuple[float, float], ...]]:
    """How far [m] curves may be off straight moves, for each arm, with how far from the TCP [m]."""
    out: dict[str, tuple[tuple[float, float], ...]] = {}
    for claim in claims:
        match claim:
            case facts.MillsProgram():
                own = 0.0, CURVE_WAY_SHARE * claim.tolerance
            case facts.Engraves():
                own = claim.cutter.flute, CURVE_WAY_SHARE * claim.tolerance
            case facts.SparesPart():
                reach = 0.0 if claim.cutter is None else claim.cutter.overhang
                own = reach, CURVE_SHARE * claim.tolerance
            case facts.MillsFlank() | facts.MillsOver() | facts.MillsSurface():
                own = claim.cutter.flute, CURVE_SHARE * claim.tolerance
            case _:
                continue
        out[claim.arm] = (*out.get(claim.arm, ()), own)
    return out


def _travel(route: Route) -> FloatArray:
    """Way (N,) [m] of the fastest point of the cutter that works, on the move to each target."""
    out = np.zeros(len(route.tip))
    for reach in (0.0, np.maximum(route.reach[1:], AIR_LEVER)[:, None]):
        ends = route.tip[1:] + reach * route.axis[1:], route.tip[:-1] + reach * route.axis[:-1]
        out[1:] = np.maximum(out[1:], np.linalg.norm(ends[0] - ends[1], axis=1))
    return out


def _actions(made: Work, route: Route) -> tuple[Action, ...]:
    """What the operator is told and asked, and the spindle."""
    op = made.operation
    last = len(route.segment) - 1
    return (
        Action(0, "message", _cuts_message(made)),
        *(Action(0, "confirm", run.before) for run in made.runs[:1] if run.before),
        Action(0, "confirm", milling_sentences.BLOCK_READY.filled()),
        Action(0, "on", signal=op.signal),
        Action(0, "wait", seconds=op.spin_up_s),
        *_between(made, route),
        Action(last, "off", signal=op.signal),
        Action(last, "wait", seconds=op.spin_down_s),
        Action(last, "confirm", milling_sentences.STANDS.filled()),
    )


def _cuts_message(made: Work) -> str:
    """The block, the cutter, and the speed that its spindle is set to by hand, unless files ask it."""
    size, op = (made.box[1] - made.box[0]) / MM, made.operation
    figures = {"x_mm": size[0], "y_mm": size[1], "z_mm": size[2], "diameter_mm": 2e3 * made.cutter.radius}
    if op.by_files:
        return milling_sentences.BLOCK_OF_FILE.filled(kind=made.cutter.kind, **figures)
    return milling_sentences.BLOCK.filled(kind=made.cutter.kind, rpm=op.spindle_rpm, **figures)


def _between(made: Work, route: Route) -> Iterator[Action]:
    """What is asked on the safe plane between passes, with the spindle standing, and waits within them."""
    op = made.operation
    starts = [i for i, segment in enumerate(route.segment) if segment.kind in ("approach", "link")]
    for number, (run, start) in enumerate(zip(made.runs, starts, strict=True)):
        if run.before and number > 0:
            yield Action(start, "off", signal=op.signal)
            yield Action(start, "wait", seconds=op.spin_down_s)
            yield Action(start, "confirm", run.before)
            yield Action(start, "on", signal=op.signal)
            yield Action(start, "wait", seconds=op.spin_up_s)
        for row, seconds in run.waits:
            yield Action(start + 1 + row, "wait", seconds=seconds)
