"""The rule on tracks and gantries under arms and a turntable or positioner under the block: who moves them,
and where targets have them stand.

verify.external_axes: units, values and folded arms, from the text, and the place of the block that follows.
Where arms and the block stand in all other rules is read here as well. Ways from station to station are for
verify.track_way."""

from collections.abc import Iterator, Sequence

import numpy as np

from planner.geometry.arrays import FloatArray, corners, transform
from planner.issues import Issue
from planner.problem import STOCK, TILT, RotaryAxis, Setup, Turntable
from planner.programs.stages import TaskText
from planner.programs.steps import MOST_OUTER, UNUSED_AXIS, MoveStep, RobTarget, SettingStep
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import SAME_VALUE, OuterAxis, outer_axes, place_in_turn, slid
from planner.proof.language_contribution import ExternalAxes, checked, of_task
from planner.proof.rule import Outcome, at_step, mm, rule
from planner.proof.rules.setups_and_frames import FRAME_ANGLE, FRAME_POSITION, at_home

BLIND_SPEED = 0.25
"""Highest speed [m/s] of a track, and of what a turntable carries: people may be near."""
SLACK = 1.0 + 1e-6
"""Speeds may be higher by this factor: they are rounded."""
OFF_HOME = {"mm": 1.0, "deg": 0.1}
"""How far an axis may be off home where a program begins, by the unit of its values."""
EXTERNAL_AXES = "verify.external_axes"
"""Code of the rule about units and values."""


def standing(context: Context) -> Context:
    """The same proof of the problem whose arms and block stand where the text's targets have them."""
    if not context.playable or not context.stations:
        return context
    return context.replaced(context.problem.stationed(context.stations))


@rule("verify.external_axes")
def external_axes(context: Context) -> Outcome:
    """A track, gantry, turntable or positioner is switched on once (RAPID), before anything moves, with
    offsets of its axes switched off, and looked at right before the first move, which nothing follows unless
    it is at home; each target has a value of each axis, within its range; it moves as the first thing of a
    setup, alone, what it carries at most at 250 mm/s, all arms folded at home, and is at home at the end; the
    block, and what axes carry, are where the values have them. A positioner's turn axis goes before its tilt
    axis; of a gantry those that come nearer to home go first, from the arm down, then the others, from the
    floor up. One that goes along moves with straight moves, too."""
    issues: list[Issue] = []
    told = []
    table = context.problem.cell.turntable
    for task in context.job.tasks:
        axes = outer_axes(task.arm, table)
        issues += checked(EXTERNAL_AXES, context, task).issues
        if axes:
            issues += _looked(context, task, axes)
            issues += _values(context, task, axes)
        for axis in axes:
            where = ", ".join(axis.shown(v) for v in dict.fromkeys(_stations(context, axis)))
            told.append(f"{axis.unit} ({task.arm.name}) at {where}")
    if table is not None:
        issues += _moved(context, table)
        issues += _turned(context, table)
    issues += _left_behind(context)
    nothing = "" if told else "no arm stands on a track or gantry, no block on a turntable"
    return Outcome(tuple(issues), where="; ".join(told), nothing=nothing)


def _stations(context: Context, axis: OuterAxis) -> list[float]:
    """Where an axis stands in the setups [m, rad]."""
    found = (setup.stands.get(axis.carries) for setup in context.setups)
    return [value for value in found if value is not None]


def _looked(context: Context, task: TaskText, axes: Sequence[OuterAxis]) -> Iterator[Issue]:
    """Axes at which a program does not look right before its first move: whether they are at home, so that
    this move takes none of them anywhere. Nothing may come between the look and the move but settings."""
    steps = list(task.steps)
    first = next((i for i, step in enumerate(steps) if isinstance(step, MoveStep)), len(steps))
    looks: list[SettingStep] = []
    for step in reversed(steps[:first]):
        if not isinstance(step, SettingStep) or step.stops or step.kind == "DeactUnit":
            break
        looks.append(step)
    for axis in axes:
        seen = any(of_task(task).external_axes.looks_at(context, axis, look) for look in looks)
        if not seen:
            what = f"an arm moves, and nothing looks right before whether {axis.unit} is at home"
            move = steps[first] if first < len(steps) else None
            yield at_step(EXTERNAL_AXES, f"{what} ({axis.shown(axis.home)})", task, move)


def _values(context: Context, task: TaskText, axes: Sequence[OuterAxis]) -> Iterator[Issue]:
    """What is wrong with the values of external axes, and with their moves."""
    before: MoveStep | None = None
    moved: set[OuterAxis] = set()  # in a setup
    last = {axis.column: axis.home for axis in axes}
    came, here, off, since = -1, -1, False, 0  # since: the stage of the question before the axes' ways
    gone: list[tuple[int, int]] = []  # when axes that moved in a setup were to, in order
    for number, stage in enumerate(context.job.stages):
        index = int(context.spans.of_stage[number])
        for move in stage.moves(task.name):
            wrong = _unfit(move, axes, of_task(task).external_axes)
            if wrong:
                yield at_step(EXTERNAL_AXES, wrong, task, move)
                return  # where things stand from here on is not known
            values = {axis: axis.scale * float(move.target.external[axis.column]) for axis in axes}
            along = [axis for axis in axes if axis.follow is not None and not move.by_joints]
            changed = [axis for axis in axes if abs(values[axis] - last[axis.column]) > SAME_VALUE]
            going = [axis for axis in changed if axis not in along]  # verify.track_along has the others
            gone, moved, off, here = (gone, moved, off, here) if index == here else ([], set(), False, index)
            asked = [place.stage for place in context.spans.asked[index] if came < place.stage < number]
            off, since = off or bool(asked), max(asked, default=since)
            places = [place_in_turn(axes, one, last[one.column], values[one]) for one in going]
            in_turn = off and not moved & set(going) and (not gone or all(gone[-1] < one for one in places))
            gone, moved = [*gone, *places], moved | set(going)
            off = off and bool(going)  # nothing comes between question and axes
            if len(going) > 1:
                what = f"{' and '.join(axis.unit for axis in going)} move at once, not one after the other"
                yield at_step(EXTERNAL_AXES, what, task, move)
            for axis in axes:
                value = values[axis]
                goes = axis in going
                if before is None or goes:
                    told = before is None or in_turn
                    for what in _move_faults(context, task, axis, before, move):
                        yield at_step(EXTERNAL_AXES, what, task, move)
                    if stage.synchronised:
                        yield at_step(
                            EXTERNAL_AXES, f"{axis.unit} moves together with other arms", task, move
                        )
                    if not told:
                        what = (
                            f"{axis.unit} moves within setup {index + 1}, where nobody was told to keep off"
                        )
                        what += ", or not in its order" if len(axes) > 1 else ""
                        yield at_step(EXTERNAL_AXES, what, task, move)
                if goes:
                    for other in _not_home(context, task, number, since):
                        yield at_step(EXTERNAL_AXES, f"{axis.unit} moves while {other}", task, move)
                if before is None and goes:
                    what = f"the first move takes {axis.unit} to {axis.shown(value)}, not home "
                    yield at_step(EXTERNAL_AXES, f"{what}({axis.shown(axis.home)})", task, move)
                if before is None or goes or axis in along:  # else it stays: a little each would add up
                    last[axis.column] = value
            before, came = move, number
    for axis in axes:
        if abs(last[axis.column] - axis.home) > SAME_VALUE:
            what = f"the program ends with {axis.unit} at {axis.shown(last[axis.column])}, not home again "
            yield Issue(EXTERNAL_AXES, f"{what}({axis.shown(axis.home)})", arm=task.arm.name, file=task.name)


def _move_faults(
    context: Context, task: TaskText, axis: OuterAxis, before: MoveStep | None, move: MoveStep
) -> Iterator[str]:
    """What is wrong with a move that takes an axis somewhere: folded arm, speed."""
    folded = [m for m in (before, move) if m is not None]
    if not all(at_home(m, task.arm.data, task.arm.home) for m in folded):
        yield f"{axis.unit} moves while {task.arm.name} is not at home"
    table = context.problem.cell.turntable
    if axis.carries in (STOCK, TILT) and table is not None:
        rim = max((_rim(s, table, axis.carries) for s in context.setups), default=0.0)
        most = min(BLIND_SPEED / max(rim, 1e-3), axis.speed)
    else:
        most = min(BLIND_SPEED, axis.speed)
    speed = axis.told(move)
    if not 0.0 < speed <= most * SLACK:
        yield f"{axis.unit} goes at {axis.shown(speed)}/s; allowed: {axis.shown(most)}/s"


def _not_home(context: Context, task: TaskText, number: int, since: int) -> Iterator[str]:
    """Other arms that are not at home, by their last move before stage ``number`` and those in it; or that
    were not all the time since stage ``since``, where all other rules have all axes at their new stations."""
    stages = context.job.stages
    for other in context.job.tasks:
        if other.name == task.name:
            continue
        came = [move for stage in stages[:number] for move in stage.moves(other.name)[-1:]]
        moves = [*came[-1:], *stages[number].moves(other.name)]
        between = [move for stage in stages[since:number] for move in stage.moves(other.name)]
        if not came or not all(at_home(move, other.arm.data, other.arm.home) for move in moves):
            yield f"{other.arm.name} is not at home"
        elif not all(at_home(move, other.arm.data, other.arm.home) for move in between):
            yield f"{other.arm.name} has been away from home since it was asked for"


def _unfit(move: MoveStep, axes: Sequence[OuterAxis], stated: ExternalAxes) -> str:
    """What is wrong with the external axes of one target, and with how they are ``stated``."""
    outer, names = move.target.external, " and ".join(axis.unit for axis in axes)
    others = np.delete(outer, [axis.column for axis in axes])
    none = np.abs(others - UNUSED_AXIS) <= 1e3
    if not np.isfinite(outer).all() or not (none | (stated.zero_is_unused & (others == 0.0))).all():
        return f"the target has values of other axes than {names}, which are not there"
    for axis in axes:
        value = float(outer[axis.column])
        if abs(value) >= MOST_OUTER:
            return f"the target has no value of {axis.unit} ({stated.names[axis.column]})"
        at = axis.scale * value
        if not axis.low - SAME_VALUE <= at <= axis.high + SAME_VALUE:
            span = f"{axis.shown(axis.low)} to {axis.shown(axis.high)}"
            return f"{axis.unit} at {axis.shown(at)}; its range is {span}"
    if move.by_joints and isinstance(move.target, RobTarget):
        return f"{names} is moved to a pose, not to joints"
    return ""


# ---- gantries ----


def _left_behind(context: Context) -> Iterator[Issue]:
    """Bodies of setups that are not where the text's values have the axes under arms take those of the
    problem, by sums of its own."""
    zero = {body.name: body for body in context.problem.cell.obstacles}
    for index, setup in enumerate(context.setups):
        now = {body.name: body for body in setup.cell.obstacles}
        for arm in setup.cell.arms:
            for on, rail in arm.rails.items():
                for name in rail.carries:
                    goes = slid(arm, arm.stands, on)
                    off = max(
                        float(np.abs(a.pose[:3, 3] + goes - b.pose[:3, 3]).max())
                        + float(np.abs(a.pose[:3, :3] - b.pose[:3, :3]).max())
                        for a, b in zip(zero[name].shapes, now[name].shapes, strict=True)
                    )
                    if off > SAME_VALUE:
                        what = f"{name} is not where {rail.label} takes it in setup {index + 1}"
                        yield Issue(EXTERNAL_AXES, what, arm=arm.name)


# ---- turntables ----


def _moved(context: Context, table: Turntable) -> Iterator[Issue]:
    if all(task.arm.name != table.arm for task in context.job.tasks):
        what = f"{table.unit} is moved by the program of {table.arm}, which is not there"
        yield Issue(EXTERNAL_AXES, what, arm=table.arm)


def _turned(context: Context, table: Turntable) -> Iterator[Issue]:
    """Blocks that are not where the text's values have the stated axes take them: by turns of its own, with
    quaternions, of what the problem says of value 0."""
    for index, setup in enumerate(context.setups):
        at = clamped(context, index)
        place, value = context.places[index], table.home  # which it has again behind all operations
        lean = 0.0 if table.tilt is None else table.tilt.home
        for number in setup.operations:
            value = context.stations.get(number, {}).get(STOCK, np.nan)
            lean = context.stations.get(number, {}).get(TILT, lean if table.tilt is None else np.nan)
        if at is None or place is None or not np.isfinite(value + lean):
            what = f"nothing says where {table.unit} has the block stand in setup {index + 1}"
            yield Issue(EXTERNAL_AXES, what, hint=f"a value of {table.unit} in each target")
            continue
        off, turn = off_place(table, at, (value, lean), place)
        if off > 2.0 * FRAME_POSITION or turn > 2.0 * FRAME_ANGLE:
            shown = " and ".join(f"{np.rad2deg(v):g}" for v in (value, lean)[: len(table.axes)])
            what = f"{table.unit} at {shown} deg has the block {mm(off):.4f} mm and "
            what += f"{np.rad2deg(turn):.4f} deg off where its frame is in setup {index + 1}"
            yield Issue(EXTERNAL_AXES, what, value=mm(off), limit=mm(FRAME_POSITION), unit="mm")
        for name in _misplaced(context, setup, table, lean):
            what = (
                f"{name} is not where {table.unit} at {np.rad2deg(lean):g} deg tilts it in setup {index + 1}"
            )
            yield Issue(EXTERNAL_AXES, what)


def clamped(context: Context, index: int) -> FloatArray | None:
    """Where the problem has the block (4, 4) in a setup with all axes at 0."""
    at = context.problem.stock.place
    for setup in context.setups[: index + 1]:
        for number in setup.operations:
            change = context.problem.changes.get(number)
            at = at if change is None else change.stock.get("place", at)
    return at


def _misplaced(context: Context, setup: Setup, table: Turntable, lean: float) -> Iterator[str]:
    """Bodies of a setup that are not where a positioner's tilt takes those of the problem."""
    now = {body.name: body for body in setup.cell.obstacles}
    for body in context.problem.cell.obstacles:
        if table.tilt is not None and body.name in table.tilted_bodies:
            for zero, one in zip(body.shapes, now[body.name].shapes, strict=True):
                tips = np.concatenate([np.zeros((1, 3)), np.eye(3)])
                wanted = spun(table.tilt, lean, transform(zero.pose, tips))
                if np.abs(wanted - transform(one.pose, tips)).max() > FRAME_POSITION:
                    yield body.name


def off_place(
    table: Turntable, at: FloatArray, values: tuple[float, float], place: FloatArray
) -> tuple[float, float]:
    """How far [m, about rad] the block at ``place`` is off that of values 0, turned about the turn axis and
    then about the tilt axis: its origin, and ends of its axes."""
    tips = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    wanted = at[:3, 3] + tips @ at[:3, :3].T
    wanted = spun(table, values[0], wanted)
    wanted = wanted if table.tilt is None else spun(table.tilt, values[1], wanted)
    apart = wanted - (place[:3, 3] + tips @ place[:3, :3].T)
    lean = apart[1:] - apart[0]
    return float(np.linalg.norm(apart[0])), float(np.linalg.norm(lean) / np.sqrt(2.0))


def spun(axis: RotaryAxis, value: float, points: FloatArray) -> FloatArray:
    """Points (N, 3) turned by a value [rad] about an axis through its centre: q p q* with the unit quaternion
    q = (w, v), which is p + 2 w (v x p) + 2 v x (v x p)."""
    w, v = np.cos(0.5 * value), np.sin(0.5 * value) * axis.axis
    seen = points - axis.centre
    aside = np.cross(v, seen)
    return np.asarray(points + 2.0 * (w * aside + np.cross(v, aside)))


def _rim(setup: Setup, table: Turntable, name: str) -> float:
    """How far [m] what an axis carries in a setup reaches from it: block and support, and what is tilted with
    them. The block is no farther off the turn axis by being tilted, so both are looked at where that stands
    upright; the tilt axis takes it along as the turn axis has it then."""
    stock, place, axis = setup.stock, setup.stock.place, table.axes[name]
    if place is None:
        return 0.0
    box = np.stack([stock.lower, stock.upper])
    points = [np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3)]
    points += [transform(shape.pose, corners(shape)) for shape in stock.support]
    seen = transform(place, np.concatenate(points))
    if table.tilt is not None:
        seen = spun(table.tilt, -(stock.tilt or 0.0), seen)
        bodies = [body for body in setup.upright.cell.obstacles if body.name in table.tilted_bodies]
        riding = [transform(shape.pose, corners(shape)) for body in bodies for shape in body.shapes]
        seen = np.concatenate([seen, *riding]) if name == TILT else seen
    along = (seen - axis.centre) @ axis.axis
    across = seen - axis.centre - along[:, None] * axis.axis
    return float(np.linalg.norm(across, axis=1).max())
