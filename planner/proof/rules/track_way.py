"""The rule on the way of tracks, gantries, turntables and positioners from station to station: what comes
near.

Distances are those of the planner's own looks; where these had what rides is held against turns and sums of
the proof's own. That what rides keeps off all that stands, what bears it excepted, is held against how far
shapes go along the lines on which the distances were found: a line between two convex shapes shows that they
are apart, whatever found it."""

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from planner.cell import axis_way
from planner.cell.axis_way import AxisWay, Look
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, corners, transform
from planner.problem import END, PLATE, STOCK, TILT, Arm, Cell, Setup, Turntable
from planner.programs.steps import MOST_OUTER
from planner.proof.clearance.lines_apart import SAME_WAY, nearer, reach, round_about, slides, standing
from planner.proof.context import Context
from planner.proof.findings import Findings, in_mm
from planner.proof.kinematics.external_axes import SAME_VALUE, OuterAxis, floor_of, moved_on, outer_axes, slid
from planner.proof.models import MODELS
from planner.proof.rule import Outcome, mm, rule
from planner.proof.rules.clearance import of_one_arm
from planner.proof.rules.external_axes import clamped, off_place, spun
from planner.proof.rules.setups_and_frames import FRAME_ANGLE, FRAME_POSITION

_WAY = "verify.track_way"
"""Code of the rule."""
BELOW_FOOT = 2e-3
"""What a base slides on is at most so far [m] above its foot,"""
LEAST_UPRIGHT = 0.5
"""where its way leaves it a foot: where so much of its own z axis is square to that."""
SHOWN_POSES = 1e-6
"""Poses of bodies that differ by no more [m, -] are one."""
LEVEL = 1e-9
"""Axes whose unit vectors' heights are less go level."""


@rule("verify.track_way", ahead="bodies")
def track_way(context: Context) -> Outcome:
    """On the way of a track, turntable or positioner, and of each axis of a gantry, from station to station
    bodies keep their clearance, all arms folded at home; what is tilted, raised or lowered keeps it from the
    floor, too. What axes carry is where sums of the proof's own have it, in each setup. Where looks had what
    rides is held against the values by such sums and turns, and shapes that ride against all that stand but
    those that bear them, along lines. The base of a track that goes along keeps it there, too."""
    models, limit = context.get(MODELS), context.problem.settings.clearance
    findings, looks = Findings(_WAY, context, worst=np.inf), 0
    at = context.problem.homes
    for index, setup in enumerate(context.setups):
        for what in _astray(context, models(index), setup):
            findings.add(what)
        for axis, ends in _goes(context, index, setup, at):
            model = _before(context, models(index), setup, at)
            way = _way(model, setup, at, axis, ends, limit)
            looks += len(way.looked)
            findings.lowest(way.least, f"{' and '.join(way.pair)} at {axis.shown(way.at)}")
            on = f"on the way of {axis.unit} from {axis.shown(ends[0])} to {axis.shown(ends[1])}: "
            arm = axis.arm
            if way.least < limit or not way.clear:
                near = f"{' and '.join(way.pair)} are {mm(way.least):.3f} mm apart at {axis.shown(way.at)}"
                findings.add(on + near, in_mm(way.least, limit), arm=arm)
            strayed = _strayed(context, models(index).cell, index, at, axis, ends, way)
            if not strayed and way.clear:
                table, tilt = setup.cell.turntable, at.get(TILT, 0.0)
                if arm is not None:
                    strayed = _rider_into(context, model, at, axis, way, limit)
                elif table is not None:
                    strayed = _block_into(model, table, tilt, axis, way, limit)
            if strayed:
                findings.add(on + strayed, arm=arm)
            at = {**at, axis.carries: ends[1]}
        for axis, ends in _along(context, index, setup):
            rider = setup.cell.arm(axis.carries)
            model = models(index).with_bases({rider.name: _base(context, rider, {axis.carries: ends[0]})})
            way = _bare(model, setup, axis, ends, limit)
            looks += len(way.looked)
            findings.lowest(way.least, f"{' and '.join(way.pair)} at {axis.shown(way.at)}")
            on = f"as {axis.unit} goes along from {axis.shown(ends[0])} to {axis.shown(ends[1])}: "
            near = f"{' and '.join(way.pair)} are {mm(way.least):.3f} mm apart at {axis.shown(way.at)}"
            strayed = "" if way.least >= limit and way.clear else near
            strayed = strayed or _strayed(context, setup.cell, index, at, axis, ends, way)
            strayed = strayed or _rider_into(context, model, at, axis, way, limit)
            if strayed:
                findings.add(on + strayed, arm=axis.carries)
            ended = context.problem.stations.get(setup.operations[0], {}).get(f"{axis.carries}{END}")
            at = at if ended is None else {**at, axis.carries: ended}
    findings.where += f", {looks} looks"
    return findings.outcome(mm, "mm", limit, nothing="no track or turntable moves")


def _goes(
    context: Context, index: int, setup: Setup, at: dict[str, float]
) -> list[tuple[OuterAxis, tuple[float, float]]]:
    """The axes that move before a setup, as the text has them one after the other, with both ends [m, rad] of
    their ways."""
    table, going = context.problem.cell.turntable, []
    for arm in setup.cell.arms:
        for axis in outer_axes(arm, table):
            value = setup.stands.get(axis.carries)
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


def _base(context: Context, arm: Arm, values: Mapping[str, float]) -> FloatArray:
    """Where the base of an arm stands (4, 4) at values [m] of the axes under it."""
    out = np.array(context.bases[arm.name])
    out[:3, 3] += slid(arm, values)
    return out


def _bare(
    model: CellModel, setup: Setup, axis: OuterAxis, ends: tuple[float, float], limit: float
) -> AxisWay:
    """The way of a base alone: the rest of the arm is looked at as it works (verify.clearance)."""
    homes = {other.name: other.home for other in setup.cell.arms}
    bodies = sorted({solid.body for solid in model.solids})
    every = frozenset(map(frozenset, itertools.combinations(bodies, 2)))
    return axis_way.along(model, axis.carries, ends, homes, limit, every)


def _arrives(context: Context, index: int, arm: str, axis: OuterAxis, value: float) -> tuple[int, int]:
    """The first stage of a setup, and the move in it, in which the task of an arm has an axis at a value."""
    for number, _, task, moves in context.moves():
        if task.arm.name == arm and int(context.spans.of_stage[number]) == index:
            values = [axis.scale * float(move.target.external[axis.column]) for move in moves]
            there = [k for k, one in enumerate(values) if abs(one - value) <= SAME_VALUE]
            if there:
                return number, there[0]
    return len(context.job.stages), 0


def _before(context: Context, model: CellModel, setup: Setup, at: dict[str, float]) -> CellModel:
    """The model of a setup with all axes where they are before one of them goes, ``at``."""
    on = [arm for arm in setup.cell.arms if arm.axes]
    model = model.with_bases({arm.name: _base(context, arm, at) for arm in on})
    goes = moved_on(setup.cell, at, setup.stands)
    model = model.with_moved({name: way @ model.motion(name) for name, way in goes.items()})
    table = setup.cell.turntable
    under = {} if table is None else {name: setup.stock.stands[name] for name in table.axes}
    return axis_way.stood(model, {name: at[name] for name in under}, under) if under else model


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
    itself = of_one_arm(model)  # verify.own_clearance has these, which the way does not change
    return axis_way.along(model, axis.carries, ends, homes, limit, itself)


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
    if axis.arm is not None:
        return _off_sum(context, cell, cell.arm(axis.arm), at, axis, way)
    zero = {body.name: body for body in context.problem.cell.obstacles}
    now = {body.name: body for body in cell.obstacles}
    if table is None:
        return "nothing says what it turns"
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


def _off_sum(
    context: Context, cell: Cell, arm: Arm, at: Mapping[str, float], axis: OuterAxis, way: AxisWay
) -> str:
    """Looks that had a base, or what is carried, elsewhere than values have them: where the problem has them
    at 0, moved by the sum of all values times their directions."""
    foot, names = f"{arm.name}/base_link", list(arm.rails)
    riding = {body for on in names[names.index(axis.carries) :] for body in arm.rails[on].carries}
    now = {body.name: body for body in cell.obstacles}
    for look in way.looked:
        here = {**at, axis.carries: look.value}
        if missing := {foot, *riding} ^ set(look.poses):
            return f"it was looked at without {', '.join(sorted(missing))}"
        off = float(np.abs(look.poses[foot] - _base(context, arm, here)).max())
        if off > SAME_VALUE:
            return f"the base was looked at elsewhere than it is at {axis.shown(look.value)}"
        for name, wanted in _carried(context, arm, here).items():
            if name in riding:
                there = np.stack([look.poses[name] @ shape.pose for shape in now[name].shapes])
                if float(np.abs(there - wanted).max()) > SHOWN_POSES:
                    return f"{name} was looked at elsewhere than it is at {axis.shown(look.value)}"
    return ""


def _carried(context: Context, arm: Arm, values: Mapping[str, float]) -> dict[str, FloatArray]:
    """Where values [m] have the shapes (K, 4, 4) of the bodies that the axes under an arm carry."""
    zero = {body.name: body for body in context.problem.cell.obstacles}
    out = {}
    for on, rail in arm.rails.items():
        for name in rail.carries:
            out[name] = np.stack([shape.pose for shape in zero[name].shapes])
            out[name][:, :3, 3] += slid(arm, values, on)
    return out


def _astray(context: Context, model: CellModel, setup: Setup) -> Iterator[str]:
    """What is wrong with where the model of a setup has what axes under arms carry: as the proof knows it,
    and as Drake does, which measures some distances."""
    known = model.poses({})
    drake = model.checker.UpdatePositions(np.concatenate([model.cell.arm(a).home for a in model.arms]))
    now = {body.name: body for body in model.cell.obstacles}
    for arm in setup.cell.arms:
        for name, wanted in _carried(context, arm, arm.stands).items():
            seen = model.plant.EvalBodyPoseInWorld(drake, model.body(name)).GetAsMatrix4()
            for pose in (known[name][0], np.asarray(seen)):
                there = np.stack([pose @ shape.pose for shape in now[name].shapes])
                if float(np.abs(there - wanted).max()) > SHOWN_POSES:
                    yield f"{name} stands elsewhere in setup {setup.number} than the axes under it have it"
                    break


def _rider_into(
    context: Context, model: CellModel, at: Mapping[str, float], axis: OuterAxis, way: AxisWay, limit: float
) -> str:
    """What the base of an arm, or what rides with it, may come nearer to than ``limit`` [m] on a way that
    looks found clear; ``at``: where all axes are before it. For the base shapes of obstacles that end below
    its foot are left out: below a plane along the way, in which the foot stays; for what is carried those
    of obstacles that it slides along, beside such a plane, over all of the axis' range. What goes up or down
    keeps off the floor at both ends, on which a base may stand."""
    arm, foot = model.cell.arm(str(axis.arm)), f"{axis.arm}/base_link"
    line = np.array(axis.way)
    names = list(arm.rails)
    riding = {foot, *(body for on in names[names.index(axis.carries) :] for body in arm.rails[on].carries)}
    own = [solid for solid in model.solids if solid.body in riding]
    still, there = standing(model, riding)
    if not own:
        return ""
    on_axis = {body: on for on, rail in arm.rails.items() for body in rail.carries}
    built = {on: slid(arm, arm.stands, on) for on in names}  # where the cell of the model has them

    def placed(look: Look) -> list[FloatArray]:
        here = {**at, axis.carries: look.value}
        base, out = _base(context, arm, here), []
        for solid in own:
            pose = np.array(solid.shape.pose)
            if solid.body == foot:
                pose = base @ pose
            else:
                pose[:3, 3] += slid(arm, here, on_axis[solid.body]) - built[on_axis[solid.body]]
            out.append(pose)
        return out

    begin = placed(way.looked[0])
    base = _base(context, arm, dict(at))
    up = base[:3, 2] - (base[:3, 2] @ line) * line
    length = float(np.linalg.norm(up))
    up = up / max(length, LEAST_UPRIGHT)
    feet = [-reach(s.shape, pose, -up) for s, pose in zip(own, begin, strict=True) if s.body == foot]
    bodies = {body.name for body in model.cell.obstacles} if length >= LEAST_UPRIGHT else set()
    most = min(feet, default=0.0) + BELOW_FOOT + SAME_WAY
    low = np.array(
        [
            solid.body in bodies and reach(solid.shape, pose, up) <= most
            for solid, pose in zip(still, there, strict=True)
        ],
        dtype=bool,
    )
    bears = {body.name for body in model.cell.obstacles}  # no block or support, nor what others carry
    bears -= {name for two in model.cell.arms if two != arm for on in two.axes for name in on.carries}
    here = way.looked[0].value
    goes = axis.low - here, axis.high - here  # over all of its range, not only on this way
    left_out = np.zeros((len(own), len(still)), bool)
    for i, one in enumerate(own):
        if one.body == foot:
            left_out[i] = low
        else:
            left_out[i] = [
                two.body in bears and slides((one.shape, begin[i]), (two.shape, pose), line, goes)
                for two, pose in zip(still, there, strict=True)
            ]
    if abs(line[2]) > LEVEL:
        floor = floor_of(model.cell)
        for look in (way.looked[0], way.looked[-1]):
            for solid, pose in zip(own, placed(look), strict=True):
                high = -reach(solid.shape, pose, np.array([0.0, 0.0, -1.0])) - floor
                if high < (limit if solid.body != foot else -BELOW_FOOT) - SAME_WAY:
                    return f"{solid.body} is {mm(high):.3f} mm above the floor at {axis.shown(look.value)}"
    return nearer(axis, way, (own, placed), (still, there), left_out, 1.0, limit)


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
    still, there = standing(model, riding if axis.carries == TILT else {*riding, PLATE})
    if not own or not still:
        return ""

    def placed(look: Look) -> list[FloatArray]:
        return [look.poses[solid.body] @ solid.shape.pose for solid in own]

    begin = placed(way.looked[0])
    left_out = np.zeros((len(own), len(still)), bool)
    for i, one in enumerate(own if axis.carries == TILT else ()):
        for j, two in enumerate(still if one.body not in axis_way.RIDERS else ()):
            past = -reach(one.shape, begin[i], -along) - reach(two.shape, there[j], along)
            before = -reach(two.shape, there[j], -along) - reach(one.shape, begin[i], along)
            left_out[i, j] = -SAME_WAY < max(past, before) < axis_way.STANDING_GAP_M
            left_out[i, j] |= any(
                round_about(s.shape, at, centre, along) for s, at in ((one, begin[i]), (two, there[j]))
            )
    tips = np.concatenate([transform(at, corners(s.shape)) for s, at in zip(own, begin, strict=True)])
    lever = float(np.linalg.norm(np.cross(tips - centre, along), axis=1).max())
    return nearer(axis, way, (own, placed), (still, there), left_out, lever, limit)
