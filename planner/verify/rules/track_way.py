"""The rule on the way of tracks, turntables and positioners from station to station: what comes near on it.

Distances are those of the planner's own looks; where these had what rides is held against turns of the
proof's own. That the base of an arm on a track keeps off all that stands, what it slides on excepted, is held
against how far shapes go along the lines on which the distances were found: a line between two convex shapes
shows that they are apart, whatever found it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.cell import axis_way, distance
from planner.cell.axis_way import AxisWay
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, Shape, transform
from planner.issues import Issue
from planner.problem import STOCK, TILT, Cell, Setup
from planner.verify.context import Context, Outcome, OuterAxis, mm, outer_axes, rule
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
    against the values by turns of the proof's own, and the base of an arm against each shape that does not
    end below its foot."""
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
            if not strayed and arm is not None and way.clear:
                strayed = _run_into(model, context.bases[arm], axis, way, limit)
            if strayed:
                issues.append(Issue(_WAY, on + strayed, arm=arm))
            at = {**at, axis.carries: ends[1]}
    if not np.isfinite(worst):
        return Outcome(tuple(issues), where="no track or turntable moves")
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


def _run_into(model: CellModel, base: FloatArray, axis: OuterAxis, way: AxisWay, limit: float) -> str:
    """What the base of an arm may come nearer to than ``limit`` [m] on a way that looks found clear: no line
    that they were measured along shows otherwise. ``base`` (4, 4): where it is at value 0."""
    track = model.cell.arm(axis.carries).track
    if track is None:
        return ""
    own = [solid for solid in model.solids if solid.body == f"{axis.carries}/base_link"]
    poses = model.poses({})
    still = [s for s in model.solids if _stands(s.body, model) and s.body != f"{axis.carries}/base_link"]
    there = [poses[solid.body][0] @ solid.shape.pose for solid in still]
    up = base[:3, 2] - (base[:3, 2] @ track.axis) * track.axis  # its foot stays in a plane square to this
    length = float(np.linalg.norm(up))
    up = up / max(length, LEAST_UPRIGHT)
    foot = min((-_reach(s.shape, base @ s.shape.pose, -up) for s in own), default=np.inf)
    bodies = {body.name for body in model.cell.obstacles} if length >= LEAST_UPRIGHT else set()
    beside = [
        j
        for j, (solid, pose) in enumerate(zip(still, there, strict=True))
        if solid.body not in bodies or _reach(solid.shape, pose, up) > foot + BELOW_FOOT + SAME_WAY
    ]
    if not own or not beside:
        return ""
    first, second = (v.ravel() for v in np.meshgrid(np.arange(len(own)), beside, indexing="ij"))
    cores = distance.cores([*own, *still])
    before: tuple[float, float] | None = None
    for look in way.looked:
        here = np.array(base)
        here[:3, 3] += look.value * track.axis
        at = [*(here @ solid.shape.pose for solid in own), *there]
        placed = np.stack(at)
        _, lines, _ = distance.distances(
            cores, first, second + len(own), placed[first], placed[second + len(own)]
        )
        apart = np.array(
            [
                -_reach(own[i].shape, at[i], -line) - _reach(still[j].shape, there[j], line)
                for i, j, line in zip(first, second, lines, strict=True)
            ]
        )
        worst = int(np.argmin(apart))
        bound = gap = float(apart[worst])
        if before is not None:
            bound = min(gap, 0.5 * (before[1] + gap - abs(look.value - before[0])))
        if bound < limit - SAME_WAY:
            name = still[second[worst]].body
            return (
                f"nothing shows that the base keeps {mm(limit):g} mm off {name} at {axis.shown(look.value)}"
            )
        before = look.value, gap
    return ""


def _stands(body: str, model: CellModel) -> bool:
    """Whether a body is fixed: no link, no tool, and no block that an arm holds."""
    if body == "stock":
        return model.stock.held_by is None
    return "/" not in body or body.endswith("/base_link")


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
