"""The rule on the way of tracks, turntables and positioners from station to station: what comes near on it.

Distances are those of the planner's own looks; where these had what rides is held against turns of the
proof's own. That what rides keeps off all that stands, what bears it excepted, is held against how far shapes
go along the lines on which the distances were found: a line between two convex shapes shows that they are
apart, whatever found it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from planner.cell import axis_way, distance
from planner.cell.axis_way import AxisWay, Look
from planner.cell.bodies import Solid
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, Shape, corners, transform
from planner.issues import Issue
from planner.problem import END, PLATE, STOCK, TILT, Cell, Setup, Turntable
from planner.verify.context import Context, Outcome, OuterAxis, mm, outer_axes, rule
from planner.verify.programs.steps import MOST_OUTER
from planner.verify.rules.clearance import of_one_arm
from planner.verify.rules.external_axes import SAME_VALUE, clamped, off_place, spun
from planner.verify.rules.setups_and_frames import FRAME_ANGLE, FRAME_POSITION

_WAY = "verify.track_way"
"""Code of the rule."""
BELOW_FOOT = 2e-3
"""What a base slides on is at most so far [m] above its foot,"""
LEAST_UPRIGHT = 0.5
"""where its way leaves it a foot: where so much of its own z axis is square to that."""
SAME_WAY = 1e-6
"""Distances that differ by no more [m] are one."""


@rule("verify.track_way")
def track_way(context: Context, models: Callable[[int], CellModel]) -> Outcome:
    """On the way of a track, turntable or positioner from station to station bodies keep their clearance, all
    arms folded at home; what is tilted keeps it from the floor, too. Where looks had what rides is held
    against the values by turns of the proof's own, and shapes that ride against all that stand but those that
    bear them, along lines. The base of a track that goes along keeps it there, too."""
    limit = context.problem.settings.clearance
    issues: list[Issue] = []
    worst, where, looks = np.inf, "", 0
    at = context.problem.homes
    for index, setup in enumerate(context.setups):
        for axis, ends in _goes(context, index, setup, at):
            model = _before(context, models(index), setup, at)
            way = _way(model, setup, at, axis, ends, limit)
            looks += len(way.looked)
            if way.least < worst:
                worst, where = way.least, f"{' and '.join(way.pair)} at {axis.shown(way.at)}"
            on = f"on the way of {axis.unit} from {axis.shown(ends[0])} to {axis.shown(ends[1])}: "
            arm = None if axis.carries in (STOCK, TILT) else axis.carries
            if way.least < limit or not way.clear:
                near = f"{' and '.join(way.pair)} are {mm(way.least):.3f} mm apart at {axis.shown(way.at)}"
                issues.append(
                    Issue(_WAY, on + near, arm=arm, value=mm(way.least), limit=mm(limit), unit="mm")
                )
            strayed = _strayed(context, models(index).cell, index, at, axis, ends, way)
            if not strayed and way.clear:
                table, tilt = setup.cell.turntable, at.get(TILT, 0.0)
                if arm is not None:
                    strayed = _base_into(model, context.bases[arm], axis, way, limit)
                elif table is not None:
                    strayed = _block_into(model, table, tilt, axis, way, limit)
            if strayed:
                issues.append(Issue(_WAY, on + strayed, arm=arm))
            at = {**at, axis.carries: ends[1]}
        for axis, ends in _along(context, index, setup):
            model = models(index).with_bases({axis.carries: _base(context, setup, axis, ends[0])})
            way = _bare(model, setup, axis, ends, limit)
            looks += len(way.looked)
            if way.least < worst:
                worst, where = way.least, f"{' and '.join(way.pair)} at {axis.shown(way.at)}"
            on = f"as {axis.unit} goes along from {axis.shown(ends[0])} to {axis.shown(ends[1])}: "
            near = f"{' and '.join(way.pair)} are {mm(way.least):.3f} mm apart at {axis.shown(way.at)}"
            strayed = "" if way.least >= limit and way.clear else near
            strayed = strayed or _strayed(context, setup.cell, index, at, axis, ends, way)
            strayed = strayed or _base_into(model, context.bases[axis.carries], axis, way, limit)
            if strayed:
                issues.append(Issue(_WAY, on + strayed, arm=axis.carries))
            ended = context.problem.stations.get(setup.operations[0], {}).get(f"{axis.carries}{END}")
            at = at if ended is None else {**at, axis.carries: ended}
    if not np.isfinite(worst):
        return Outcome(tuple(issues), nothing="no track or turntable moves")
    return Outcome(tuple(issues), mm(worst), mm(limit), "mm", f"{where}, {looks} looks")


def _goes(
    context: Context, index: int, setup: Setup, at: dict[str, float]
) -> list[tuple[OuterAxis, tuple[float, float]]]:
    """The axes that move before a setup, as the text has them one after the other, with both ends [m, rad] of
    their ways."""
    table, going = context.problem.cell.turntable, []
    for arm in setup.cell.arms:
        for axis in outer_axes(arm, table):
            own = setup.stock.stands
            value = own.get(axis.carries, arm.station)
            if value is not None and abs(value - at[axis.carries]) > SAME_VALUE:
                going.append(
                    (_arrives(context, index, arm.name, axis, value), axis, (at[axis.carries], value))
                )
    return [(axis, ends) for _, axis, ends in sorted(going, key=lambda one: one[0])]


def _along(context: Context, index: int, setup: Setup) -> list[tuple[OuterAxis, tuple[float, float]]]:
    """Tracks that go along in a setup, each with the least and largest value [m] of its straight moves."""
    out = []
    for task in context.job.tasks if setup.operations else ():
        for axis in outer_axes(task.arm, None):
            values = [
                axis.scale * float(move.target.external[axis.column])
                for number, _, other, moves in context.moves()
                if other is task and int(context.spans.of_stage[number]) == index
                for move in moves
                if not move.by_joints and abs(move.target.external[axis.column]) < MOST_OUTER
            ]
            if axis.follow is not None and values:  # what is beyond the range verify.external_axes tells
                low, high = np.clip([min(values), max(values)], axis.low, axis.high).tolist()
                out.append((axis, (low, high)))
    return out


def _base(context: Context, setup: Setup, axis: OuterAxis, value: float) -> FloatArray:
    """Where the base of an arm stands (4, 4) at a value [m] of its track."""
    track, base = setup.cell.arm(axis.carries).track, context.bases[axis.carries]
    return base if track is None else track.moved(base, value)


def _bare(
    model: CellModel, setup: Setup, axis: OuterAxis, ends: tuple[float, float], limit: float
) -> AxisWay:
    """The way of a base alone: the rest of the arm is looked at as it works (verify.clearance)."""
    homes = {other.name: other.home for other in setup.cell.arms}
    track = setup.cell.arm(axis.carries).track
    bodies = sorted({solid.body for solid in model.solids})
    every = frozenset(map(frozenset, itertools.combinations(bodies, 2)))
    direction = np.zeros(3) if track is None else track.axis
    return axis_way.along(model, axis.carries, direction, ends, homes, limit, every)


def _arrives(context: Context, index: int, arm: str, axis: OuterAxis, value: float) -> int:
    """The first stage of a setup in which the task of an arm has an axis at a value."""
    for number, _, task, moves in context.moves():
        if task.arm.name == arm and int(context.spans.of_stage[number]) == index:
            values = (axis.scale * float(move.target.external[axis.column]) for move in moves)
            if any(abs(there - value) <= SAME_VALUE for there in values):
                return number
    return len(context.job.stages)


def _before(context: Context, model: CellModel, setup: Setup, at: dict[str, float]) -> CellModel:
    """The model of a setup with all axes where they are before one of them goes, ``at``."""
    tracks = {a.name: a.track for a in setup.cell.arms if a.track is not None}
    model = model.with_bases({n: t.moved(context.bases[n], at[n]) for n, t in tracks.items()})
    table = setup.cell.turntable
    if table is None or not setup.stock.stands:
        return model
    return axis_way.stood(model, table, at, setup.stock.stands)


def _way(
    model: CellModel,
    setup: Setup,
    at: dict[str, float],
    axis: OuterAxis,
    ends: tuple[float, float],
    limit: float,
) -> AxisWay:
    """The way of one axis in a model of :func:`_before` it; ``at``: where all stand then."""
    homes = {other.name: other.home for other in setup.cell.arms}
    table = setup.cell.turntable
    if table is not None and axis.carries in table.axes:
        return axis_way.turning(model, table, axis.carries, at.get(TILT, 0.0), ends, homes, limit)
    tracks = {a.name: a.track for a in setup.cell.arms if a.track is not None}
    itself = of_one_arm(model)  # verify.own_clearance has these, which the way does not change
    return axis_way.along(model, axis.carries, tracks[axis.carries].axis, ends, homes, limit, itself)


def _strayed(
    context: Context,
    cell: Cell,
    index: int,
    at: dict[str, float],
    axis: OuterAxis,
    ends: tuple[float, float],
    way: AxisWay,
) -> str:
    """What is wrong with where looks at a way had what rides, by a model of ``cell``; ``at``: where all axes
    stand before it."""
    first, last = way.looked[0].value, way.looked[-1].value
    if abs(first - ends[0]) > SAME_VALUE or (way.clear and abs(last - ends[1]) > SAME_VALUE):
        return f"it was looked at from {axis.shown(first)} to {axis.shown(last)}"
    table, place = context.problem.cell.turntable, clamped(context, index)
    if table is None or axis.carries not in table.axes:
        track = cell.arm(axis.carries).track
        for look in way.looked:
            wanted, (pose,) = np.array(context.bases[axis.carries]), look.poses.values()
            if track is not None:
                wanted[:3, 3] += look.value * track.axis
            if not np.allclose(pose, wanted, rtol=0.0, atol=SAME_VALUE):
                return f"the base was looked at elsewhere than it is at {axis.shown(look.value)}"
        return ""
    zero = {body.name: body for body in context.problem.cell.obstacles}
    now = {body.name: body for body in cell.obstacles}
    tips = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    for look in way.looked:
        here = {**at, axis.carries: look.value}
        for name, pose in look.poses.items():
            if name in now and table.tilt is not None:
                off = 0.0
                for shape, there in zip(zero[name].shapes, now[name].shapes, strict=True):
                    wanted = spun(table.tilt, here[TILT], transform(shape.pose, tips))
                    off = max(off, float(np.abs(wanted - transform(pose @ there.pose, tips)).max()))
                astray = off > FRAME_POSITION
            elif place is None:
                return "nothing says where the block is"
            else:
                off, turn = off_place(table, place, (here[STOCK], here.get(TILT, 0.0)), pose)
                astray = off > 2.0 * FRAME_POSITION or turn > 2.0 * FRAME_ANGLE
            if astray:
                return f"{name} was looked at elsewhere than it is at {axis.shown(look.value)}"
    return ""


def _base_into(model: CellModel, base: FloatArray, axis: OuterAxis, way: AxisWay, limit: float) -> str:
    """What the base of an arm may come nearer to than ``limit`` [m] on a way that looks found clear; ``base``
    (4, 4): where it is at value 0. Shapes of obstacles that end below its foot are left out: below a plane
    along the way, in which the foot stays."""
    track = model.cell.arm(axis.carries).track
    name = f"{axis.carries}/base_link"
    own = [solid for solid in model.solids if solid.body == name]
    if track is None or not own:
        return ""
    still, there = _standing(model, {name})
    up = base[:3, 2] - (base[:3, 2] @ track.axis) * track.axis
    length = float(np.linalg.norm(up))
    up = up / max(length, LEAST_UPRIGHT)
    foot = min(-_reach(solid.shape, base @ solid.shape.pose, -up) for solid in own)
    bodies = {body.name for body in model.cell.obstacles} if length >= LEAST_UPRIGHT else set()
    low = [
        solid.body in bodies and _reach(solid.shape, pose, up) <= foot + BELOW_FOOT + SAME_WAY
        for solid, pose in zip(still, there, strict=True)
    ]

    def placed(look: Look) -> list[FloatArray]:
        here = np.array(base)
        here[:3, 3] += look.value * track.axis
        return [here @ solid.shape.pose for solid in own]

    left_out = np.broadcast_to(np.array(low, dtype=bool), (len(own), len(still)))
    return _nearer(axis, way, (own, placed), (still, there), left_out, 1.0, limit)


def _block_into(
    model: CellModel, table: Turntable, tilt: float, axis: OuterAxis, way: AxisWay, limit: float
) -> str:
    """What an axis under the block may take nearer than ``limit`` [m] to what stands, on a way that looks
    found clear, from where these had what rides; ``tilt`` [rad]: of the tilt axis before it. Left out are the
    plate as it turns, and of plate and bracket as they tilt shapes that no tilt can take into one another:
    one of them is round about the axis, or both lie one behind the other along it."""
    pivot = table.axes[axis.carries]
    ends = np.stack([pivot.centre, pivot.centre + pivot.axis])
    if axis.carries == STOCK and table.tilt is not None:
        ends = spun(table.tilt, tilt, ends)
    centre, along = ends[0], ends[1] - ends[0]
    riding = set(way.looked[0].poses)
    own = [solid for solid in model.solids if solid.body in riding]
    still, there = _standing(model, riding if axis.carries == TILT else {*riding, PLATE})
    if not own or not still:
        return ""

    def placed(look: Look) -> list[FloatArray]:
        return [look.poses[solid.body] @ solid.shape.pose for solid in own]

    begin = placed(way.looked[0])
    left_out = np.zeros((len(own), len(still)), bool)
    for i, one in enumerate(own if axis.carries == TILT else ()):
        for j, two in enumerate(still if one.body not in axis_way.RIDERS else ()):
            past = -_reach(one.shape, begin[i], -along) - _reach(two.shape, there[j], along)
            before = -_reach(two.shape, there[j], -along) - _reach(one.shape, begin[i], along)
            left_out[i, j] = -SAME_WAY < max(past, before) < axis_way.STANDING_GAP_M
            left_out[i, j] |= any(
                _round(s.shape, at, centre, along) for s, at in ((one, begin[i]), (two, there[j]))
            )
    tips = np.concatenate([transform(at, corners(s.shape)) for s, at in zip(own, begin, strict=True)])
    lever = float(np.linalg.norm(np.cross(tips - centre, along), axis=1).max())
    return _nearer(axis, way, (own, placed), (still, there), left_out, lever, limit)


def _nearer(
    axis: OuterAxis,
    way: AxisWay,
    rides: tuple[Sequence[Solid], Callable[[Look], list[FloatArray]]],
    stands: tuple[Sequence[Solid], list[FloatArray]],
    left_out: BoolArray,
    lever: float,
    limit: float,
) -> str:
    """Shapes that ride, and shapes that stand, of which no line shows that they keep ``limit`` [m] apart at
    each look and, as no point rides farther than ``lever`` [m, m/rad] by a value of 1, between two; empty
    where there are none. With each kind of shapes: where they are. Pairs (R, F) that are ``left_out``."""
    (own, placed), (still, there) = rides, stands
    first, second = np.nonzero(~left_out)
    if not len(first):
        return ""
    cores = distance.cores([*own, *still])
    before: tuple[float, float] | None = None
    for look in way.looked:
        at = placed(look)
        poses = np.stack([*at, *there])
        behind = second + len(own)
        lines = distance.distances(cores, first, behind, poses[first], poses[behind])[1]
        apart = [
            -_reach(own[i].shape, at[i], -line) - _reach(still[j].shape, there[j], line)
            for i, j, line in zip(first.tolist(), second.tolist(), lines, strict=True)
        ]
        worst = int(np.argmin(apart))
        bound = gap = float(apart[worst])
        if before is not None:
            bound = min(gap, 0.5 * (before[1] + gap - lever * abs(look.value - before[0])))
        if bound < limit - SAME_WAY:
            what = (
                f"{own[int(first[worst])].body} keeps {mm(limit):g} mm off {still[int(second[worst])].body}"
            )
            return f"nothing shows that {what} at {axis.shown(look.value)}"
        before = look.value, gap
    return ""


def _standing(model: CellModel, but: set[str]) -> tuple[list[Solid], list[FloatArray]]:
    """Solids of bodies that stand, as no link, tool or block that an arm holds does, and where they are."""
    poses = model.poses({})
    held = {"stock"} if model.stock.held_by is not None else set[str]()
    own = [
        solid
        for solid in model.solids
        if ("/" not in solid.body or solid.body.endswith("/base_link")) and solid.body not in but | held
    ]
    return own, [poses[s.body][0] @ s.shape.pose for s in own]


def _round(shape: Shape, pose: FloatArray, centre: FloatArray, along: FloatArray) -> bool:
    """Whether a shape at a pose (4, 4) is round about an axis."""
    aside = float(np.linalg.norm(np.cross(pose[:3, 3] - centre, along)))
    skew = 0.0 if shape.kind == "sphere" else float(np.linalg.norm(np.cross(pose[:3, 2], along)))
    return shape.kind in ("sphere", "cylinder", "capsule") and max(aside, skew) < SAME_WAY


def _reach(shape: Shape, pose: FloatArray, line: FloatArray) -> float:
    """How far [m] a shape at a pose (4, 4) goes along a line (3,), from the origin: in closed form."""
    seen, middle = line @ pose[:3, :3], float(line @ pose[:3, 3])
    if shape.vertices is not None:
        return middle + float((shape.vertices @ seen).max())
    if shape.kind == "box":
        return middle + 0.5 * float(np.abs(seen) @ np.asarray(shape.size))
    long = 0.5 * shape.size[1] * abs(float(seen[2])) if len(shape.size) > 1 else 0.0
    across = float(np.hypot(seen[0], seen[1])) if shape.kind == "cylinder" else float(np.linalg.norm(line))
    return middle + long + shape.size[0] * across
