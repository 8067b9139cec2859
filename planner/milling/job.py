"""The process `milling`: from surfaces, curves and a cutter to the poses of one arm that mills.

See `process_plan` (cuts as passes), `flank_cut`, `point_cut` and `gcode.passes` (each kind),
`tool_path` (the ways between), `check` (what would go wrong), `claims` (what must hold).

**Poses**: from tips and axes to poses of the TCP and to what motion may choose, the spin about the
tool.

**Exhibits** for the report: tool and spindle for the setup sheet, the cuts, the ways.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from planner.claims import dialogue
from planner.claims.claim import Claim, FeedWindow
from planner.claims.milling import (
    Engraves,
    MillsFlank,
    MillsOver,
    MillsProgram,
    MillsSurface,
    SparesPart,
)
from planner.geometry.arrays import FloatArray, read_only
from planner.geometry.corner_rounding import TURNING_LEVER_MM
from planner.geometry.rigid import from_parts
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.milling import claims as mill_claims
from planner.milling.check import check
from planner.milling.operation import FlankCut, GCodeCut, LinesCut, Milling, Orient
from planner.milling.process_plan import Work, work
from planner.milling.tool_path import Route, lay_out
from planner.targets import Action, Aim, Job, Rounding, ScrewFreedom, Targets
from planner.units import MM


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


KINDS: Final = ((FlankCut, "flank"), (LinesCut, "lines"), (GCodeCut, "G\u2011code"))
SHOWN: Final = 80
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
        kind = next((name for model, name in KINDS if isinstance(one.cut, model)), "engraving")
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
    curves = [run.path.tip for run in runs[:: max(1, len(runs) // SHOWN)]]
    return {"kind": "paths", "title": "Way of the cutter's tip", "curves": curves}


FROM_REST: Final = 0.66
"""Part of the feed that moves from or to a stop have on average, as they are faster in between."""
LEVER: Final = 0.05
"""A point so far [m] behind the tip counts for the speed in the air, where the tool turns."""


class MillingJob(Job[Milling]):
    """An operation that mills, with the cutter and the block that it finds."""

    @functools.cached_property
    def made(self) -> Work:
        """Cuts as passes: worked out once, and nobody can write into their arrays."""
        return read_only(work(self.operation, self.setup, self.part))

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``milling.*``."""
        made = self.made
        route = lay_out(self.operation, made.runs, made.box)
        issues = check(made)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        return _targets(made, route, aggregate(issues), self.claims())

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        return mill_claims.claims(self.made, self.part)


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
        feed=np.where(np.append(False, stop[:-1]) | stop, FROM_REST, 1.0) * route.feed,
        feed_min=np.zeros(count),
        travel=_travel(route),
        stop=stop,
        segment=route.segment,
        actions=actions,
        claims=claims,
        exhibits=exhibits(made, route),
        issues=issues,
        rounding=rounding(claims),
        may_stop=True,
        may_join=True,
        feed_throughout=any(isinstance(claim, FeedWindow) for claim in claims),
        feed_source="the G-code file" if any(isinstance(one.cut, GCodeCut) for one in made.cuts) else "",
    )


WAYS: Final = (MillsProgram, Engraves, MillsFlank, MillsOver)
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
    spared = [claim for claim in claims if isinstance(claim, SparesPart)]
    tolerance = min((claim.tolerance for claim in (*ways, *spared)), default=np.inf)
    air = min(Rounding.air, TIGHT_SHARE * tolerance)
    work = max(air, ROUNDED_SHARE * tolerance) if np.isfinite(tolerance) else air
    lean, spin = TURNING_LEVER, TURNING_LEVER * work / SPIN_WAY
    if not spared and not any(isinstance(claim, MillsSurface) for claim in claims):
        lean = min([lean, *(work / (ROUNDED_SHARE * claim.turn) for claim in ways)])
    levers = {claim.arm: np.array([lean, lean, spin]) for claim in ways}
    return Rounding(work, air, air, levers, _curves(claims))


def _curves(claims: Sequence[Claim]) -> dict[str, tuple[tuple[float, float], ...]]:
    """How far [m] curves may be off straight moves, for each arm, with how far from the TCP [m]."""
    out: dict[str, tuple[tuple[float, float], ...]] = {}
    for claim in claims:
        match claim:
            case MillsProgram():
                own = 0.0, CURVE_WAY_SHARE * claim.tolerance
            case Engraves():
                own = claim.cutter.flute, CURVE_WAY_SHARE * claim.tolerance
            case SparesPart():
                reach = 0.0 if claim.cutter is None else claim.cutter.overhang
                own = reach, CURVE_SHARE * claim.tolerance
            case MillsFlank() | MillsOver() | MillsSurface():
                own = claim.cutter.flute, CURVE_SHARE * claim.tolerance
            case _:
                continue
        out[claim.arm] = (*out.get(claim.arm, ()), own)
    return out


def _travel(route: Route) -> FloatArray:
    """Way (N,) [m] of the fastest point of the cutter that works, on the move to each target."""
    out = np.zeros(len(route.tip))
    for reach in (0.0, np.maximum(route.reach[1:], LEVER)[:, None]):
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
        Action(0, "confirm", dialogue.BLOCK_READY.say()),
        Action(0, "on", signal=op.signal),
        Action(0, "wait", seconds=op.spin_up_s),
        *_between(made, route),
        Action(last, "off", signal=op.signal),
        Action(last, "wait", seconds=op.spin_down_s),
        Action(last, "confirm", dialogue.STANDS.say()),
    )


def _cuts_message(made: Work) -> str:
    """The block, the cutter, and the speed that its spindle is set to by hand, unless files ask it."""
    size, op = (made.box[1] - made.box[0]) / MM, made.operation
    figures = {"x_mm": size[0], "y_mm": size[1], "z_mm": size[2], "diameter_mm": 2e3 * made.cutter.radius}
    if op.by_files:
        return dialogue.BLOCK_OF_FILE.say(kind=made.cutter.kind, **figures)
    return dialogue.BLOCK.say(kind=made.cutter.kind, rpm=op.spindle_rpm, **figures)


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
