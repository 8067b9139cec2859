"""The process `trim`: from closed curves on a formed sheet to targets of one arm's torch, mill or knife, and
claims.

See `face` (curves laid on the face, slots beside them), `slots` (ways in and out, micro-joints),
`stretches` (a knife's cuts), `cutting` (what cuts), `check` (what would go wrong), `claims`, `shown`.

**Poses**: a torch's TCP is the place that is cut, a mill's and a knife's its tip, as far behind that as it
goes through the sheet; z is the tool's axis, which points into the sheet, x of a knife the way it cuts.
Motion may spin the tool, and lean it about the place that is cut within its cone where that keeps it clear
of the sheet; a knife it may spin a little, as it stands along its curve and square to the sheet.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from planner.claims import vocabulary
from planner.claims.claim import Claim
from planner.claims.vocabulary import Segment
from planner.forming.features.tree import LEAST_BUMP, build
from planner.forming.job import poses
from planner.forming.stages import formed_sheet, shown
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh, corners, from_parts, transform
from planner.geometry.corner_rounding import TURNING_LEVER_MM
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.milling.tool_path import sharp, thinned
from planner.problem import Formed, Hole, Setup
from planner.reading import sheet as sheet_file
from planner.targets import Action, Job, Rounding, ScrewFreedom, Targets
from planner.tooling import Torch
from planner.trim import check
from planner.trim.claims import claims, told
from planner.trim.cutting import Cutting, Trimmer, cutting, mounted
from planner.trim.face import Face, Laid, apart, lay
from planner.trim.operation import KnifeCut, MillCut, Trim, every_outline
from planner.trim.shown import Way, exhibits
from planner.trim.slots import Slot, Wanted, slots
from planner.trim.stretches import ahead, stretches, turning

TRIM: Final = "trim"
"""The kind of segments in which a torch cuts, and comes and goes."""
FEATURE_STEP: Final = 0.5 * MM
"""Distance of the slices of features [m]; what each one moves does not hang on it."""
CHORD_SHARE: Final = 0.1
"""Share of the tolerance that straight moves between targets may cost."""
AXIS_LEVER: Final = 0.03
"""How far behind the TCP [m] the torch keeps within the chord between targets, too."""
LEAN_SHARE: Final = 0.85
"""Share of the cone that motion may use at targets; the rest is for what lies between them."""
ROUNDED_SHARE: Final = 0.25
"""Share of the tolerance that rounded corners may take."""
MEAN_FEED_FROM_REST: Final = 0.66
"""Part of the feed that moves from or to a stop have on average, as they are faster in between."""
KNIFE_FEED: Final = (0.56, 0.8)
"""The same of a knife's moves from or to a stop, and of those beside them."""
LINGER: Final = 2.5
"""On a short stretch a torch may take so many times as long as at its least average feed; the proof allows
more."""
LINGER_TIME: Final = 0.4
"""It may also stop there for so long [s]."""
LINGER_KERFS: Final = 3.0
"""Kerfs that such a stretch is long,"""
LEAST_STRETCH: Final = 3.0 * MM
"""and so long [m] at least."""
AIR_LEVER: Final = 0.05
"""A point so far [m] behind the TCP counts for the speed in the air, where the torch turns."""
HEADING_SHARE: Final = 0.4
"""Share of what a blade may stand off its curve that motion may use at targets,"""
CHORD_TURN_SHARE: Final = 0.2
"""Share of it that straight moves between targets may cost,"""
ROUNDED_TURN_SHARE: Final = 0.1
"""Share of it that rounded corners may take;"""
SIDE_SHARE: Final = 0.2
"""at targets its front and back are off by no more than this share of the tolerance then."""
SPIN_WAY: Final = 5e-4
"""How far [m] what spins with the torch may be off, at the lever of its turning."""


@dataclasses.dataclass(frozen=True)
class Route:
    """N targets: ``tip`` and ``axis`` (N, 3), from the TCP into the torch; ``feed`` (N,) [m/s]; ``lean``:
    how far [rad] the torch may lean, or a knife spin; ``segment`` and ``stop`` (N,). ``height`` (N,) [m] of
    the nozzle off the face in slots, NaN elsewhere. ``pierce`` and ``end`` are the rows at which each slot
    begins and ends. ``heading`` (N,) [rad] is that of a knife's edge; of other tools NaN."""

    tip: FloatArray
    axis: FloatArray
    feed: FloatArray
    lean: FloatArray
    segment: tuple[Segment, ...]
    stop: BoolArray
    height: FloatArray
    pierce: tuple[int, ...]
    end: tuple[int, ...]
    heading: FloatArray


class TrimJob(Job[Trim]):
    """An operation that trims, with the torch and the sheet that it finds."""

    @functools.cached_property
    def tool(self) -> Trimmer:
        """The tool of the arm. Raises ``TandemError`` (trim.tool)."""
        return mounted(self.operation, self.setup.cell.arm(self.operation.arms[0]).tool)

    @functools.cached_property
    def cutting(self) -> Cutting:
        """How it cuts. Raises ``TandemError`` (trim.tool)."""
        return cutting(self.operation, self.tool, float(self.setup.stock.size[2]))

    @functools.cached_property
    def face(self) -> Face:
        """The face that the torch follows. Raises ``TandemError`` (trim.no_sheet) and issues of files."""
        thickness = float(self.setup.stock.size[2])
        return Face(self.formed, thickness, 1 if self.operation.side == "top" else -1)

    @functools.cached_property
    def surface(self) -> Formed:
        """What the file has of the face, and how far it may be off. Raises as :attr:`face`."""
        op, stock, part = self.operation, self.setup.stock, self.part
        if not isinstance(op.surface, str):
            place = None if op.surface.frame == "find" else np.eye(4)
            part = sheet_file.build(op.surface, Path(), stock, place)
        if stock.sheet is None or part is None or part.formed is None:
            what = f"{op.name}: there is no formed sheet; give sheet: and a part of kind sheet_mesh"
            raise TandemError(Issue("trim.no_sheet", what, field="sheet"))
        return part.formed

    @functools.cached_property
    def formed(self) -> Mesh:
        """The lower face of the sheet as it is trimmed. Raises as :attr:`face`."""
        mesh, sheet = self.surface.mesh, self.setup.stock.sheet
        stages = None if sheet is None else sheet.stages
        if isinstance(self.operation.surface, str) and stages is not None and stages.after:
            tree = build(mesh, FEATURE_STEP, max(LEAST_BUMP, self.surface.tolerance))
            done = {number for _, some in stages.before for number in some or ()}
            known = sorted(done.intersection(one.id for one in tree.features))
            mesh = formed_sheet(mesh, tree, known)
        return mesh

    @functools.cached_property
    def wanted(self) -> tuple[Wanted, ...]:
        """The outlines in the order of cutting: those that lie in most others first."""
        found = []
        for one, points in every_outline(self.operation):
            laid = lay(one.name, points, self.face)
            found.append(Wanted(one, laid, shapely.Polygon(laid.point[:, :2])))
        inside = [
            sum(
                shapely.contains_properly(o.area.buffer(0), shapely.Point(w.laid.point[0, :2])) for o in found
            )
            for w in found
        ]
        return tuple(found[k] for k in sorted(range(len(found)), key=lambda k: -inside[k]))

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``trim.*``."""
        op, tool, wanted = self.operation, self.cutting, self.wanted
        sheet = self.setup.stock.sheet
        if sheet is None:
            raise TandemError(Issue("trim.no_sheet", f"{op.name}: there is no sheet to trim", field="sheet"))
        if tool.through and sheet.die:
            what = f"{op.name}: there is a die behind the sheet, into which the {tool.word} would go"
            hint = "take the die out, and trim by a problem of its own (surface:), or by a torch or laser"
            raise TandemError(Issue("trim.die", what, field="operations.die", hint=hint))
        reach = tool.kerf + op.lead.length_mm * MM if tool.blade is None else tool.blade.width
        issues = list(check.curve_issues(wanted, sheet.opening, reach))
        if issues:
            raise TandemError(aggregate(issues))
        made: list[Slot] = []
        for one in wanted:
            try:
                if tool.blade is not None:
                    made += stretches(op, one, self.face, tool)
                    continue
                made += slots(op, one, [o for o in wanted if o is not one], self.face, tool.kerf)
            except TandemError as error:
                issues += error.issues
        if issues:
            raise TandemError(aggregate(issues))
        route, issues = _route(op, self.setup, self.face, tool, made, wanted, self.surface.tolerance)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        free = [w for w in wanted if not w.spec.joints]  # what hangs by joints stays
        cut = [Hole(w.spec.name, w.laid.point[:, :2], w.spec.drops == "inside") for w in free]
        left = shown(self.formed, (*sheet.holes, *cut), op.name) if sheet.stages is not None else {}
        return _targets(op, self.setup, self.tool, tool, made, wanted, route, self.claims(), left)

    def driven(self, targets: Targets, time: FloatArray) -> tuple[Issue, ...]:
        """Slots in which the arm is slower on average than the operation allows: the torch then burns away
        more than its kerf."""
        out = []
        op = self.operation
        if self.cutting.blade is not None:
            return ()  # it may be as slow as it likes
        for segment in dict.fromkeys(s for s in targets.segment if s.kind == TRIM and not s.phase):
            rows = np.array([s == segment for s in targets.segment])
            full = targets.feed / np.where(
                np.append(False, targets.stop[:-1]) | targets.stop, MEAN_FEED_FROM_REST, 1.0
            )
            took, ideal = np.diff(time, prepend=time[0])[rows], targets.travel[rows] / full[rows]
            share = float(ideal.sum()) / max(float(took.sum()), 1e-9)
            way = targets.travel[rows]
            level = np.cumsum(way) - way > op.lead.length_mm * MM
            if self.cutting.cutter is not None and level.any():  # the way down, however quick, is no excuse
                share = min(share, float(ideal[level].sum()) / max(float(took[level].sum()), 1e-9))
            if share < op.least_feed:
                what = f"{segment}: the arm reaches {100 * share:.0f} % of the feed on average; wanted: "
                what += f"{100 * op.least_feed:.0f} %"
                hint = (
                    f"take a lower feed_mm_s, round the corners, or allow it: least_feed: {0.95 * share:.2f}"
                )
                out.append(Issue("trim.slow", what, value=share, limit=op.least_feed, hint=hint))
            elif self.cutting.cutter is None:
                out += _lingers(op, self.cutting.kerf, segment, targets.travel[rows], time, rows)
        return tuple(out)

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        _ = self.cutting  # a cutter that does not go through is told before all else
        return claims(self.operation, self.setup, self.tool, self._rough())

    def _rough(self) -> float:
        """How far [m] the face may be off; 0 where there is none, which :meth:`targets` tells."""
        try:
            return self.surface.tolerance
        except TandemError:
            return 0.0


def _lingers(
    op: Trim, kerf: float, segment: Segment, travel: FloatArray, time: FloatArray, rows: BoolArray
) -> list[Issue]:
    """Stretches of a slot, as short as a few kerfs, on which a torch would burn away more than that;
    ``travel`` (R,) [m] on the moves to its targets, which are ``rows`` (N,) of those with ``time`` (N,)."""
    at = np.flatnonzero(rows)
    along, clock = np.append(0.0, np.cumsum(travel)), time[np.append(at[0] - 1, at)]
    stretch = max(LINGER_KERFS * kerf, LEAST_STRETCH)
    # stretches from each target on, and those up to each
    begin = np.concatenate([along, np.maximum(along - stretch, 0.0)])
    end = np.minimum(begin + stretch, along[-1])
    spent = np.interp(end, along, clock) - np.interp(begin, along, clock)
    most = LINGER * (end - begin) / (op.least_feed * op.feed_mm_s * MM) + LINGER_TIME
    k = int(np.argmax(spent - most))
    if spent[k] <= most[k]:
        return []
    what = f"{segment}: the arm takes {spent[k]:.2f} s for {(end[k] - begin[k]) / MM:.2f} mm, where the "
    what += f"torch burns away more than its kerf; allowed: {most[k]:.2f} s"
    hint = "round the corner there, let it begin elsewhere, or take a lower feed_mm_s"
    value, limit = float(spent[k]), float(most[k])
    return [Issue("trim.slow", what, value=value, limit=limit, unit="s", hint=hint)]


def _route(
    op: Trim,
    setup: Setup,
    face: Face,
    tool: Cutting,
    made: list[Slot],
    wanted: tuple[Wanted, ...],
    rough: float,
) -> tuple[Route, list[Issue]]:
    """The way through all slots: down along the tool's axis to where it pierces, along the slot, up again.
    The face may be off by ``rough`` [m]."""
    level, issues = _level(op, setup, face), list[Issue]()
    size = setup.stock.size[:2]
    places = check.face_places(face, size)
    tips: list[FloatArray] = []
    axes: list[FloatArray] = []
    feeds: list[FloatArray] = []
    leans: list[FloatArray] = []
    heights: list[FloatArray] = []
    headings: list[FloatArray] = []
    segments: list[Segment] = []
    pierce: list[int] = []
    end: list[int] = []
    most = _most_lean(op, tool)
    for number, slot in enumerate(made):
        own_outline = next(one for one in wanted if one.spec.name == slot.outline)
        try:
            rows, raised = _rows(slot, op, tool, (own_outline.laid, rough))
            whole = _whole(slot, face, tool, rows, raised)
            part = check.part_places(face, setup.stock.size, tool, whole)
        except TandemError as error:
            issues += error.issues
            continue
        point, axis = slot.point[rows], face.side * slot.normal[rows]
        heading = slot.heading[rows] if tool.blade is not None else np.full(len(rows), np.nan)
        pivot = point + raised[:, None] * axis
        tip = pivot - tool.deep * axis
        off = check.clear_of(tool.body, places, tip, axis)
        issues += [*check.wall_issue(slot, tip, off, op, tool), *check.rise_issue(slot, axis, face.side)]
        cut = (own_outline, tool, part, float(setup.stock.size[2]), face.side)
        issues += check.gouge_issue(slot, *check.gouged(*cut, whole), op)
        if has_errors(issues):
            continue
        ok = np.ones(len(tip), dtype=bool)
        for leant in check.leans(axis, op.cone_deg * DEG) if tool.blade is None else ():
            low = pivot - tool.deep * leant
            ok &= check.clear_of(tool.body, places, low, leant) >= op.clear_mm * MM
            ok &= check.gouged(*cut, (low, leant))[0] <= op.shape_tol_mm * MM
        lean = np.where(ok & np.append(ok[1:], True) & np.append(True, ok[:-1]), most, 0.0)
        if tool.through:  # not turned on the way down, and straight out again
            lean[(raised > 0.0) | np.append(True, raised[:-1] > 0.0)] = 0.0
            lean[-1] = 0.0
        above = [tip[k] + max((level - tip[k, 2]) / axis[k, 2], 2.0 * MM) * axis[k] for k in (0, -1)]
        feed = op.feed_mm_s * MM / np.maximum(np.abs(axis[:, 2]), 0.1)
        if op.feed_most_mm_s is not None:
            feed = np.minimum(feed, op.feed_most_mm_s * MM)
        # on the way to a target the wall may be flatter than there
        feed[1:] = np.minimum(feed[1:], feed[:-1])
        feed = _of_tip(feed, tool, point, tip, raised)
        own = Segment(TRIM, slot.name)
        if tool.blade is not None and number:  # turned back, or to the next stretch, in the air
            air = turning(
                (tips[-1][-1], axes[-1][-1], float(headings[-1][-1])), (above[0], axis[0], float(heading[0]))
            )
            count = len(air.heading)
            tips.append(air.tip)
            axes.append(air.axis)
            headings.append(air.heading)
            feeds.append(np.full(count, op.rapid_mm_s * MM))
            leans.append(np.zeros(count))
            heights.append(np.full(count, np.nan))
            segments += [Segment("link")] * count
        pierce.append(sum(map(len, tips)) + 1)
        end.append(pierce[-1] + len(tip) - 1)
        tips += [above[0][None], tip, above[1][None]]
        axes += [axis[:1], axis, axis[-1:]]
        headings += [heading[:1], heading, heading[-1:]]
        feeds += [
            np.array([op.rapid_mm_s * MM, op.plunge_mm_s * MM]),
            feed[1:],
            np.array([op.rapid_mm_s * MM]),
        ]
        leans += [lean[:1], lean, lean[-1:]]
        heights += [np.full(1, np.nan), raised - tool.deep, np.full(1, np.nan)]
        segments += [Segment("approach" if number == 0 else "link"), own.at("in")]
        segments += [own] * (len(tip) - 1) + [own.at("out")]
    if has_errors(issues):
        return _nowhere(), issues
    tip, axis = np.concatenate(tips), np.concatenate(axes)
    stop = np.zeros(len(tip), dtype=bool)
    for first, last in zip(pierce, end, strict=True):
        stop[[first - 1, last + 1]] = True
        stop[first : last + 1] = sharp(tip[first : last + 1])
    rise = tip[-1] + op.safe_mm * MM * axis[-1]
    heading = np.concatenate(headings)
    return Route(
        np.concatenate([tip, rise[None]]),
        np.concatenate([axis, axis[-1:]]),
        np.append(np.concatenate(feeds), op.rapid_mm_s * MM),
        np.append(np.concatenate(leans), leans[-1][-1]),
        (*segments, Segment("retreat")),
        np.append(stop, True),
        np.append(np.concatenate(heights), np.nan),
        tuple(pierce),
        tuple(end),
        np.append(heading, heading[-1]),
    ), issues


def _most_lean(op: Trim, tool: Cutting) -> float:
    """How far [rad] motion may lean the tool; a knife stands square to the face, and is so far turned about
    its axis at most."""
    if tool.blade is None or not isinstance(op.by, KnifeCut):
        return LEAN_SHARE * op.cone_deg * DEG
    long = max(tool.blade.end, float(tool.blade.front(tool.deep)))
    beside = float(np.arctan2(SIDE_SHARE * op.shape_tol_mm * MM, long))
    return min(HEADING_SHARE * op.by.heading_deg * DEG, beside)


def _whole(
    slot: Slot, face: Face, tool: Cutting, rows: IntArray, raised: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Tips and axes (N, 3) at all places of a slot; ``raised`` (R,) [m] at those of ``rows``."""
    axis = face.side * slot.normal
    above = np.interp(np.arange(len(axis)), rows, raised)
    return slot.point + (above - tool.deep)[:, None] * axis, axis


PLUNGE_SHARE: Final = 0.8
"""Share of its plunge feed at which a cutter goes down: on a bent face it does not go down evenly."""
LEAST_SHARE: Final = 0.05
"""Of a feed along the face, that of a tip behind it at least."""


def _of_tip(
    feed: FloatArray, tool: Cutting, point: FloatArray, tip: FloatArray, raised: FloatArray
) -> FloatArray:
    """The feed (N,) [m/s] of a tip that is not on the face: so that it is ``feed`` there, and down no faster
    than a plunge."""
    if not tool.through:
        return feed
    out, along = feed.copy(), np.linalg.norm(np.diff(point, axis=0), axis=1)
    way, down = np.linalg.norm(np.diff(tip, axis=0), axis=1), -np.diff(raised)
    share = np.maximum(way / np.maximum(along, 1e-9), LEAST_SHARE)
    out[1:] *= np.where(along > 1e-9, np.minimum(share, 1.0), 1.0)
    steep = down > 1e-9
    most = PLUNGE_SHARE * tool.plunge * way / np.maximum(down, 1e-9)
    out[1:][steep] = np.minimum(out[1:], most)[steep]
    return out


def _nowhere() -> Route:
    none = np.zeros((0, 3))
    flat = none[:, 0]
    return Route(none, none, flat, flat, (), flat > 0.0, flat, (), (), flat)


LOW_TOLERANCES: Final = 2.0
"""Where its slot's edge is so many tolerances off the curve,"""
LOW_ROOM: Final = 0.05 * MM
"""and so much more [m], the tool is as low as it cuts: the proof asks that of all that is near to a curve."""


def _above(slot: Slot, op: Trim, tool: Cutting, near: tuple[Laid, float]) -> FloatArray:
    """How far (N,) the tool is still up on its way from where it begins, from 1 to 0; ``near``: its curve,
    of a face that may be off by so much [m]. Raises ``TandemError`` (trim.lead)."""
    curve, rough = near
    low = LOW_TOLERANCES * op.shape_tol_mm * MM + LOW_ROOM + rough
    off = apart(slot.point[: slot.first + 1], curve.point) - 0.5 * tool.kerf
    last = int(np.argmax(off < low)) - 1
    if last < 1 and tool.lift != 0.0 and tool.ramp:
        what = (
            f"{slot.outline}: the way in of {op.lead.length_mm:g} mm is too short for the tool to come down "
        )
        what += f"on it before it is {low / MM:.2f} mm off the curve"
        hint = f"take a longer lead.length_mm (about {1.3 * low / MM:.1f}), or a smaller shape_tol_mm"
        value, limit = op.lead.length_mm, low / MM
        raise TandemError(Issue("trim.lead", what, value=value, limit=limit, unit="mm", hint=hint))
    step = np.linalg.norm(np.diff(slot.point[: max(last, 1) + 1], axis=0), axis=1)
    left = np.append(np.cumsum(step[::-1])[::-1], np.zeros(len(slot.point) - len(step)))
    return np.asarray(left / float(left[0]))


def _rows(slot: Slot, op: Trim, tool: Cutting, near: tuple[Laid, float]) -> tuple[IntArray, FloatArray]:
    """Rows of a slot's places that become targets, and how much higher (N,) [m] than in the slot the TCP is
    there; ``near`` as :func:`_above` has it. A cutter that plunges has its first place twice."""
    chord = CHORD_SHARE * min(op.shape_tol_mm, op.height_tol_mm) * MM
    chord = min(chord, CHORD_SHARE * tool.deep) if tool.through else chord
    lever = np.array([0.0, AXIS_LEVER, -tool.deep])[: 3 if tool.through else 2]
    points = slot.point[:, None] + lever[:, None] * slot.normal[:, None]
    if tool.blade is not None and isinstance(op.by, KnifeCut):  # its front and its back, too, and its heading
        far = chord / (CHORD_TURN_SHARE * op.by.heading_deg * DEG)
        ends = np.array([-max(tool.blade.end, far), max(float(tool.blade.front(tool.deep)), far)])
        ways = ahead(slot.normal, slot.heading)
        points = np.concatenate([points, slot.point[:, None] + ends[:, None] * ways[:, None]], axis=1)
    above = _above(slot, op, tool, near)
    low = int(np.argmax(above == 0.0))
    marks = [0, slot.first, slot.last, len(slot.point) - 1]
    breaks = np.unique(marks if tool.blade is not None else [*marks, low])
    found = [np.zeros(1, dtype=np.int64)]
    for first, last in zip(breaks[:-1].tolist(), breaks[1:].tolist(), strict=True):
        found.append(first + thinned(points[first : last + 1], chord, op.step_mm * MM)[1:])
    rows = np.concatenate(found)
    if tool.blade is not None:
        rows = _evened(rows, slot.point)
    if tool.ramp:
        return rows, tool.lift * above[rows]
    return np.append(0, rows), tool.lift * np.append(1.0, np.zeros(len(rows)))


LAST_MOVES: Final = 5
"""So many moves at the end of a knife's stretch share what thinning leaves to the last one,"""
ALIKE: Final = 1.3
"""where the others of them differ by no more than this factor; else the last two do."""


def _evened(rows: IntArray, point: FloatArray) -> IntArray:
    """Rows (K,) of places (N, 3) with the last moves evenly long, so that no short one is left."""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(point, axis=0), axis=1)))
    count = min(LAST_MOVES, len(rows) - 1)
    step = np.diff(way[rows[-count - 1 :]])
    if count > 2 and step[:-1].max() > ALIKE * step[:-1].min():
        count = 2
    if count < 2 or step[-1] >= step[-2]:
        return rows
    first = rows[-count - 1]
    wanted = np.linspace(way[first], way[rows[-1]], count + 1)[1:-1]
    inner = np.unique(np.clip(np.searchsorted(way, wanted), first + 1, rows[-1] - 1))
    return np.concatenate([rows[:-count], inner, rows[-1:]])


def _level(op: Trim, setup: Setup, face: Face) -> float:
    """Height [m] of the safe plane: off the clamp and all of the sheet, on the torch's side."""
    heights = [face.side * face.mesh.vertices[:, 2], np.array([face.side * face.rise])]
    heights += [face.side * transform(shape.pose, corners(shape))[:, 2] for shape in setup.stock.support]
    return face.side * (float(np.concatenate(heights).max()) + op.safe_mm * MM)


def _targets(
    op: Trim,
    setup: Setup,
    mounted_tool: Trimmer,
    tool: Cutting,
    made: list[Slot],
    wanted: tuple[Wanted, ...],
    route: Route,
    stated: tuple[Claim, ...],
    sheet: dict[str, Any],
) -> Targets:
    arm, count = op.arms[0], len(route.segment)
    actions = _actions(op, setup, mounted_tool, route)
    stop = route.stop.copy()
    stop[[action.at for action in actions]] = True
    return Targets(
        arms=op.arms,
        pose={arm: _poses(route, tool)},
        frame={arm: "stock"},
        freedoms=_freedoms(arm, route.lean, tool),
        feed=_shares(stop, tool) * route.feed,
        feed_min=np.zeros(count),
        travel=_travel(route, tool),
        stop=stop,
        segment=route.segment,
        actions=actions,
        claims=stated,
        exhibits=exhibits(op, mounted_tool, tool, made, wanted, _ways(route)) | sheet,
        rounding=_rounding(op, arm, tool),
        may_stop=tool.blade is None,  # the moves beside other stops would be too fast in between
        may_join=True,
    )


def _shares(stop: BoolArray, tool: Cutting) -> FloatArray:
    """Shares (N,) of their feeds that moves have on average: less where they come from rest or to it, as they
    are faster in between; of a knife, whose stretches may be short, also those next to them."""
    rest = np.append(False, stop[:-1]) | stop
    if tool.blade is None:
        return np.where(rest, MEAN_FEED_FROM_REST, 1.0)
    near = rest | np.append(False, rest[:-1]) | np.append(rest[1:], False)
    return np.where(rest, KNIFE_FEED[0], np.where(near, KNIFE_FEED[1], 1.0))


def _ways(route: Route) -> list[Way]:
    """What each slot's way is to the report."""
    rows = [slice(a, b + 1) for a, b in zip(route.pierce, route.end, strict=True)]
    return [Way(route.tip[own], route.axis[own], route.height[own]) for own in rows]


def _poses(route: Route, tool: Cutting) -> FloatArray:
    """Poses (N, 4, 4) of the TCP; x of a knife is the way it cuts."""
    if tool.blade is None:
        return poses(route.tip, -route.axis)
    x, z = ahead(route.axis, route.heading), -route.axis
    return from_parts(np.stack([x, np.cross(z, x), z], axis=-1), route.tip)


def _freedoms(arm: str, lean: FloatArray, tool: Cutting) -> tuple[ScrewFreedom, ...]:
    """Spin of the tool, and leans about x and y within the circle of ``lean`` (N,) [rad]; all turn about the
    place of the face that is cut, as deep behind the TCP. A knife spins as far as that, and does not lean."""
    out, deep, spin = [], tool.deep, {arm: np.eye(6)[2]}
    if tool.blade is not None:
        return (ScrewFreedom(f"spin_{arm}", spin, -lean, lean),)
    # a turn w about a place p of the TCP's frame moves its origin by -w x p
    for name, k, moved in (("tilt_x", 0, [0.0, -deep, 0.0]), ("tilt_y", 1, [deep, 0.0, 0.0])):
        bound = lean / np.sqrt(2.0)
        twist = np.concatenate([np.eye(3)[k], moved])
        out.append(ScrewFreedom(f"{name}_{arm}", {arm: twist}, -bound, bound))
    turn = np.full(len(lean), np.pi)
    return (*out, ScrewFreedom(f"spin_{arm}", spin, -turn, turn, None, True))


def _rounding(op: Trim, arm: str, tool: Cutting) -> Rounding:
    """Corners take a share of what the cut edge may be off. A torch or a cutter may spin as it likes, a knife
    by a share of what it may stand off its curve."""
    work = min(Rounding.work, ROUNDED_SHARE * min(op.shape_tol_mm, op.height_tol_mm) * MM)
    spin = TURNING_LEVER_MM * MM * work / SPIN_WAY
    if tool.blade is not None and isinstance(op.by, KnifeCut):
        spin = max(tool.blade.width, work / (ROUNDED_TURN_SHARE * op.by.heading_deg * DEG))
    levers = {arm: np.array([TURNING_LEVER_MM * MM, TURNING_LEVER_MM * MM, spin])}
    return Rounding(work, work, min(Rounding.air, work), levers)


def _travel(route: Route, tool: Cutting) -> FloatArray:
    """Way (N,) [m] of the TCP on the move to each target; in the air that of a point behind it, where
    longer, and of a knife of one before it."""
    out = np.zeros(len(route.tip))
    out[1:] = np.linalg.norm(np.diff(route.tip, axis=0), axis=1)
    ends = [route.tip + AIR_LEVER * route.axis]
    if tool.blade is not None:
        ends.append(route.tip + AIR_LEVER * ahead(route.axis, route.heading))
    far = np.max([np.linalg.norm(np.diff(end, axis=0), axis=1) for end in ends], axis=0)
    air = np.array([s.kind != TRIM or s.phase != "" for s in route.segment[1:]])
    out[1:] = np.where(air, np.maximum(out[1:], far), out[1:])
    return out


def _actions(op: Trim, setup: Setup, torch: Trimmer, route: Route) -> tuple[Action, ...]:
    """What the operator is told and asked, and the arc, or the spindle."""
    last, figures = len(route.segment) - 1, told(op, setup, torch)
    if isinstance(op.by, MillCut):
        tell = Action(0, "message", vocabulary.TRIM_MILL.filled(**figures))
        ask = Action(0, "confirm", vocabulary.TRIM_MILL_READY.filled())
        asked = Action(last, "confirm", vocabulary.TRIM_MILL_STANDS.filled())
        return tell, ask, *_switched(op, last, op.by.spin_up_s, op.by.spin_down_s), asked
    if isinstance(op.by, KnifeCut):
        tell = Action(0, "message", vocabulary.TRIM_KNIFE.filled(**figures))
        ask = Action(0, "confirm", vocabulary.TRIM_KNIFE_READY.filled())
        asked = Action(last, "confirm", vocabulary.TRIM_KNIFE_DONE.filled())
        return tell, ask, *_switched(op, last, op.by.start_up_s, op.by.run_down_s), asked
    out = [
        Action(0, "message", vocabulary.TORCH.filled(**figures)),
        Action(0, "message", vocabulary.TORCH_STOPPED.filled()),
        Action(0, "confirm", vocabulary.TORCH_READY.filled()),
    ]
    stretch = max(LINGER_KERFS * torch.kerf, LEAST_STRETCH) if isinstance(torch, Torch) else LEAST_STRETCH
    stands = LINGER * stretch / (op.least_feed * op.feed_mm_s * MM) + LINGER_TIME
    for first, end in zip(route.pierce, route.end, strict=True):
        out.append(Action(first, "on", signal=op.signal or "", stands=stands))
        if op.ok_signal is not None:
            out.append(Action(first, "input", signal=op.ok_signal, seconds=op.ok_timeout_s))
        if op.pierce.seconds > 0.0:
            out.append(Action(first, "wait", seconds=op.pierce.seconds))
        out.append(Action(end, "off", signal=op.signal or ""))
    return (*out, Action(last, "confirm", vocabulary.TORCH_COLD.filled()))


def _switched(op: Trim, last: int, up: float, down: float) -> tuple[Action, ...]:
    """What is switched all the while, if anything is: on at the first target, off at the ``last`` one."""
    if op.signal is None:
        return ()
    return (
        Action(0, "on", signal=op.signal),
        Action(0, "wait", seconds=up),
        Action(last, "off", signal=op.signal),
        Action(last, "wait", seconds=down),
    )
