"""The way of a tool through all slots of an operation: down to where each begins, along it, and up again.

Places of a slot are thinned to targets, as near to one another as straight moves between them may be off; a
tool that goes through the sheet comes down to its depth before it is near to the curve.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, corners, transform
from planner.geometry.polylines import sharp, thinned
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, has_errors, refusal
from planner.problem import Setup
from planner.processes.trim.plan import check
from planner.processes.trim.plan.cutting import Cutting
from planner.processes.trim.plan.face import Face, Laid, apart
from planner.processes.trim.plan.operation import KnifeCut, Trim
from planner.processes.trim.plan.slots import Slot, Wanted
from planner.processes.trim.plan.stretches import ahead, turning

TRIM: Final = "trim"
"""The kind of segments in which a torch cuts, and comes and goes."""
CHORD_SHARE: Final = 0.1
"""Share of the tolerance that straight moves between targets may cost."""
AXIS_LEVER: Final = 0.03
"""How far behind the TCP [m] the torch keeps within the chord between targets, too."""
LEAN_SHARE: Final = 0.85
"""Share of the cone that motion may use at targets; the rest is for what lies between them."""
HEADING_SHARE: Final = 0.4
"""Share of what a blade may stand off its curve that motion may use at targets,"""
CHORD_TURN_SHARE: Final = 0.2
"""Share of it that straight moves between targets may cost,"""
SIDE_SHARE: Final = 0.2
"""at targets its front and back are off by no more than this share of the tolerance then."""


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


def route(
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
        leant = check.leans(axis, op.cone_deg * DEG) if tool.blade is None else []
        ways = np.stack([axis, *leant], axis=1)
        low = pivot[:, None] - tool.deep * ways
        off = check.clear_of(tool.body, places, low, ways, op.clear_mm * MM)
        issues += [
            *check.wall_issue(slot, tip, off[:, 0], op, tool),
            *check.rise_issue(slot, axis, face.side),
        ]
        cut = (own_outline, tool, part, float(setup.stock.size[2]), face.side)
        issues += check.gouge_issue(slot, *check.gouged(*cut, whole), op)
        if has_errors(issues):
            continue
        ok: BoolArray = np.asarray((off[:, 1:] >= op.clear_mm * MM).all(axis=1))
        for k in range(1, ways.shape[1]):
            ok &= check.gouged(*cut, (low[:, k], ways[:, k]))[0] <= op.shape_tol_mm * MM
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
        what = f"{slot.outline}: the way in of {op.lead.length_mm:g} mm is too short for the tool to come "
        what += f"down on it before it is {low / MM:.2f} mm off the curve"
        hint = f"take a longer lead.length_mm (about {1.3 * low / MM:.1f}), or a smaller shape_tol_mm"
        value, limit = op.lead.length_mm, low / MM
        raise refusal("trim.lead", what, value=value, limit=limit, unit="mm", hint=hint)
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
