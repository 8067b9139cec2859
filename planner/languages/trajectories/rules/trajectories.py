"""Rules about files of trajectories: where moves begin, what ends them, what falls then, and the way between
points."""

import itertools
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, dots, exp_rotation, inverse, log_rotation
from planner.issues import Issue
from planner.languages.trajectories.reader.flow import columns, pose
from planner.languages.trajectories.reader.program_text import TrajectoryText
from planner.languages.trajectories.reader.rows import (
    AtRow,
    CarryRow,
    MayFail,
    MoveRow,
    OperationRow,
    Program,
    Row,
    SetRow,
    ToolRow,
)
from planner.problem import Stock
from planner.programs.dialogue_text import on_panel
from planner.programs.stages import TaskText
from planner.programs.steps import PassedTarget
from planner.proof.context import Context
from planner.proof.kinematics.arm_model import machine_of
from planner.proof.replay.driven_speed import settling_share
from planner.proof.replay.standing import (
    MAX_SAMPLES_AT_ONCE,
    first_of_each_node,
    tool_in_holder_frame,
    work_nodes,
)
from planner.proof.replay.tool_speeds import STANDS as STANDS_STILL
from planner.proof.replay.tool_speeds import tool_speeds
from planner.proof.rule import Outcome, at_sample, at_step, mm, rule
from planner.proof.rules.setups_and_frames import FRAME_POSITION, HOME_ERROR, MASS_ERROR

SAME_POSTURE: Final = 1e-9
"""How far [rad] two numbers of one place may differ."""
WITHIN_GOALS: Final = 2.0
"""Where a move begins is looked at within so many times what its goal may be off."""
BETWEEN: Final = 0.1e-3
"""How far [m] a tool may leave the straight way from point to point,"""
BETWEEN_TURN: Final = float(np.deg2rad(0.1))
"""and how far [rad] it may be turned off it."""
UNEVEN: Final = 1.55
"""How many times as fast as the fastest mean of the three ways about it a tool may go between two points; a
cubic from rest to rest reaches 1.5 times its own."""
_BACK: Final = 0.02e-3
"""How far [m] a tool may go back in one of them."""
_ROUNDED: Final = 1.0 + 1e-6
_NONE: Final = "no trajectories"


def _programs(context: Context) -> Iterator[tuple[TaskText, Program]]:
    """Each file of trajectories with the first task that it drives."""
    for task in context.job.tasks:
        text = task.text
        if isinstance(text, TrajectoryText) and task.arm.name == text.program.arms[0].arm:
            yield task, text.program


def _at(code: str, message: str, program: Program, row: Row, hint: str | None = None) -> Issue:
    return Issue(code, message, file=program.file, line=row.line, hint=hint)


def announced(context: Context) -> list[Issue]:
    """Rows of operations and tools that tell the operator something else than the problem: each operation
    once, by name and setup, right before its first move; each tool behind it, by name and mass."""
    issues: list[Issue] = []
    setups, code = context.setups, "verify.dialogue"
    wanted = [(context.problem.operations[k].name, one.number) for one in setups for k in one.operations]
    for _, program in _programs(context):
        stands = {
            step.line: setups[int(context.spans.of_stage[number])].number
            for number, stage in enumerate(context.job.stages)
            for arm in program.arms
            for step in stage.moves(arm.arm)
        }
        due, now = iter(wanted), 0
        for row, behind in itertools.zip_longest(program.rows, program.rows[1:]):
            what = ""
            if isinstance(row, OperationRow):
                name, now = next(due, ("", 0))
                if (row.operation, row.setup) != (on_panel(name) or "operation", now):
                    what = f"operation {row.operation!r}, setup {row.setup}, is told; wanted: "
                    what += f"{name!r}, setup {now}" if now else "no more"
                elif wrong := _held(setups[now - 1].stock, row):
                    what = f"operation {row.operation!r}: {wrong}"
            elif isinstance(row, ToolRow) and 0 < now <= len(setups):
                tool = setups[now - 1].cell.arm(row.arm).tool
                if row.tool != tool.name or abs(row.mass - tool.mass) > MASS_ERROR:
                    what = f"arm {row.arm} is told to have {row.tool}, {row.mass:g} kg; wanted: {tool.name}, "
                    what += f"{tool.mass:g} kg"
            elif isinstance(row, MoveRow) and stands.get(row.points[0].line, now) != now:
                what = (
                    f"this move is in setup {stands[row.points[0].line]}; the operator was told setup {now}"
                )
            if isinstance(row, OperationRow | ToolRow) and not isinstance(behind, ToolRow | AtRow):
                what = what or "behind an operation and its tools comes the look at the joints"
            if isinstance(row, CarryRow) and isinstance(behind, CarryRow) and row.arm == behind.arm:
                what = f"arm {row.arm} is asked twice what it holds"
            if what:
                issues.append(_at(code, what, program, row))
        if left := [name for name, _ in due]:
            issues.append(_at(code, f"nothing tells of operation {left[0]!r}", program, program.rows[-1]))
    return issues


def _held(stock: Stock, row: OperationRow) -> str:
    """What is wrong with who holds the block, and how, "" for nothing."""
    if row.held_by != (stock.held_by or ""):
        return f"the block is told to be held by {row.held_by or 'no arm'}; wanted: {stock.held_by or 'none'}"
    if not row.held_by:
        return ""  # where it stands verify.work_object sees
    away = inverse(stock.grip) @ pose(row.block)
    if np.linalg.norm(away[:3, 3]) > FRAME_POSITION or not np.allclose(away[:3, :3], np.eye(3), atol=1e-6):
        return f"the block is told to be elsewhere in the tool of {row.held_by}"
    return ""


@rule("verify.start_posture")
def start_posture(context: Context) -> Outcome:
    """Trajectories: before each move all joints are looked at, within twice what a goal may be off, where the
    move before has left them, the first time at home; its first point is that place, at rest, so late that
    joints that are that far off come there within the limits of joints and tools."""
    issues: list[Issue] = []
    code, worst, limit = "verify.start_posture", 0.0, 0.0
    for _, program in _programs(context):
        controller = context.problem.cell.controller
        limit = WITHIN_GOALS * controller.goal_tolerance
        homes = {arm.name: arm.home for arm in context.problem.cell.arms}
        here = np.concatenate([homes[row.arm] for row in program.arms])
        allowed, before, tools = HOME_ERROR, None, dict[str, FloatArray]()
        for row in program.rows:
            if isinstance(row, ToolRow):
                tools[row.arm] = pose(row.tcp)
            if isinstance(row, AtRow):
                worst = max(worst, row.within)
                if not 0.0 < row.within <= limit * _ROUNDED:
                    what = (
                        f"joints are looked at within {np.rad2deg(row.within):g} deg; allowed: above 0, to "
                    )
                    issues.append(_at(code, f"{what}{np.rad2deg(limit):g}", program, row))
                off = np.abs(np.array(row.at) - here)
                if off.max() > allowed:
                    place = "home" if allowed == HOME_ERROR else "where the move before ends"
                    what = f"number {int(np.argmax(off)) + 1} is {np.rad2deg(off.max()):.6f} deg off {place}"
                    issues.append(_at(code, what, program, row))
            if isinstance(row, MoveRow):
                if not isinstance(before, AtRow):
                    issues.append(
                        _at(code, "nothing looks right before this move where the joints are", program, row)
                    )
                else:
                    issues += _begins(context, program, row, before, tools)
                here, allowed = np.array(row.points[-1].q), SAME_POSTURE
            before = row
    measure = float(np.rad2deg(worst)), float(np.rad2deg(limit)), "deg"
    return Outcome(tuple(issues), *measure, nothing="" if limit else _NONE)


def _begins(
    context: Context, program: Program, row: MoveRow, before: AtRow, tools: Mapping[str, FloatArray]
) -> list[Issue]:
    """What is wrong with the first point of a move, for joints that are looked at right before it; ``tools``
    {arm: TCP (4, 4) in the flange} as they are by then."""
    first, code = row.points[0], "verify.start_posture"
    off = np.abs(np.array(first.q) - np.array(before.at)).max()
    if off > SAME_POSTURE or any(first.v):
        return [_at(code, "the first point of this move is not where it begins, at rest", program, row)]
    out, place = list[Issue](), columns(program)
    for task in context.job.tasks:
        if not isinstance(task.text, TrajectoryText) or task.text.program is not program:
            continue
        arm = task.arm
        q, tool = np.array(first.q)[place[arm.name]], tools.get(arm.name, arm.tool.tcp)
        speed = context.problem.settings.tcp_speed
        share = settling_share(machine_of(arm.data), tool, q, before.within, first.t, speed)
        if share > 1.0:
            what = (
                f"{arm.name} has {first.t:g} s to come from {np.rad2deg(before.within):g} deg off to where "
            )
            what += f"this move begins, for which it would need {100.0 * share:.0f} % of its limits"
            out.append(_at(code, what, program, first, "let the first point come later"))
    return out


@rule("verify.goal_tolerances")
def goal_tolerances(context: Context) -> Outcome:
    """Trajectories: each move ends where a joint is farther off its way or its goal than the cell states, and
    where it is late; no tolerance is one that a controller takes for none."""
    issues: list[Issue] = []
    code, worst, found = "verify.goal_tolerances", 0.0, False
    controller = context.problem.cell.controller
    for _, program in _programs(context):
        found = True
        for row in program.rows:
            if not isinstance(row, MoveRow):
                continue
            kinds = (
                ("path", row.path, controller.path_tolerance),
                ("goal", row.goal, controller.goal_tolerance),
            )
            for word, values, most in kinds:
                worst = max(worst, max(values) / most)
                for i, value in enumerate(values):
                    if not 0.0 < value <= most * _ROUNDED:
                        got, allowed = np.rad2deg([value, most])
                        what = f"the {word} tolerance of number {i + 1} is {got:g} deg; allowed: above 0, "
                        what += f"to {allowed:g}"
                        issues.append(_at(code, what, program, row))
            if not 0.0 < row.goal_time <= controller.goal_time * _ROUNDED:
                what = (
                    f"the goal may be {row.goal_time:g} s late; allowed: above 0, to {controller.goal_time:g}"
                )
                issues.append(_at(code, what, program, row))
    return Outcome(tuple(issues), 100.0 * worst, 100.0, "% of the cell's", nothing="" if found else _NONE)


@rule("verify.power_on_failure")
def power_on_failure(context: Context) -> Outcome:
    """Trajectories: each step that may not end names all outputs that are on then, and no others, so that the
    runner takes them back; at the end of the file all are off."""
    issues: list[Issue] = []
    code, looked = "verify.power_on_failure", 0
    for _, program in _programs(context):
        on: dict[str, str] = {}
        for row in program.rows:
            if isinstance(row, SetRow):
                on = {key: name for key, name in on.items() if key != row.signal.lower()}
                if row.to:
                    on[row.signal.lower()] = row.signal
            if not isinstance(row, MayFail):
                continue
            looked += 1
            named = {name.lower(): name for name in row.on_failure}
            if left := [name for key, name in on.items() if key not in named]:
                what = f"{', '.join(left)} stays on where this step does not end; on_failure has to name it"
                issues.append(_at(code, what, program, row))
            if isinstance(row, CarryRow) and on:
                what = f"the operator is asked about a load while {', '.join(on.values())} is on"
                issues.append(_at(code, what, program, row))
            if more := [name for key, name in named.items() if key not in on]:
                issues.append(_at(code, f"on_failure names {', '.join(more)}, which is not on", program, row))
        if on:
            what = f"{', '.join(on.values())} is on at the end of the file"
            issues.append(_at(code, what, program, program.rows[-1]))
    told = f"{looked} steps", "" if looked else _NONE
    return Outcome(tuple(issues), float(len(issues)), 0.0, "steps", *told)


@rule("verify.between_points")
def between_points(context: Context) -> Outcome:
    """Trajectories: between two points of work the cubic in joint space keeps the tool on the straight way
    from one to the other, within 0.1 mm and 0.1 degrees; it never goes back, and is nowhere faster than 1.55
    times its mean speeds to this point and to those beside it."""
    issues: list[Issue] = []
    code, worst, found = "verify.between_points", 0.0, False
    motion = context.motion
    for task in context.job.tasks:
        if not isinstance(task.text, TrajectoryText):
            continue
        arm, found = task.arm.name, True
        work, before, after, holders = work_nodes(context, task)
        issues += _uneven(context, task)
        looks = motion.looks
        rows = np.flatnonzero(work[looks.node])
        for first in range(0, len(rows), MAX_SAMPLES_AT_ONCE):
            some = rows[first : first + MAX_SAMPLES_AT_ONCE]
            node = looks.node[some]
            here = tool_in_holder_frame(context, arm, holders[node], looks.row[some], motion.poses)
            off, turn = _off(before[node], after[node], here)
            worst = max(worst, float(off.max(initial=0.0)))
            bad = np.flatnonzero((off > BETWEEN) | (turn > BETWEEN_TURN))
            for k in first_of_each_node(node[bad], bad)[:20].tolist():
                what = f"between two points the tool of {arm} is {mm(off[k]):.4f} mm and "
                what += (
                    f"{np.rad2deg(turn[k]):.4f} deg off the straight way; allowed: {mm(BETWEEN):g} mm and "
                )
                what += f"{np.rad2deg(BETWEEN_TURN):g} deg"
                measure = (mm(float(off[k])), mm(BETWEEN), "mm")
                issues.append(at_sample(code, what, motion, arm, int(looks.sample[some[k]]), measure))
    return Outcome(tuple(issues), mm(worst), mm(BETWEEN), "mm", nothing="" if found else _NONE)


def _uneven(context: Context, task: TaskText) -> list[Issue]:
    """Points before which the tool goes back on its way, or far faster than from point to point about
    there."""
    out: list[Issue] = []
    speeds = tool_speeds(context)[task.arm.name]
    moves, mean = speeds.moves, speeds.mean
    works = np.array([isinstance(move.target, PassedTarget) for move in moves])
    about = np.maximum(mean, np.maximum(np.append(mean[1:], 0.0), np.append(0.0, mean[:-1])))
    goes = works & (speeds.length > STANDS_STILL)
    times = np.where(goes, speeds.peak / np.maximum(about, 1e-9), 0.0)
    for k in np.flatnonzero(times > UNEVEN)[:20].tolist():
        what = f"before this point the tool of {task.arm.name} goes up to {mm(speeds.peak[k]):.2f} mm/s, "
        what += f"{times[k]:.2f} times as fast as from point to point there; allowed: {UNEVEN:g} times"
        out.append(at_step("verify.between_points", what, task, moves[k]))
    for k in np.flatnonzero(goes & (speeds.back > _BACK))[:20].tolist():
        what = f"before this point the tool of {task.arm.name} goes back by {mm(speeds.back[k]):.3f} mm; "
        out.append(at_step("verify.between_points", f"{what}allowed: {mm(_BACK):g} mm", task, moves[k]))
    return out


def _off(start: FloatArray, end: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far (S,) [m], [rad] poses (S, 4, 4) are off the straight ways from ``start`` to ``end`` (S, 4, 4),
    turning evenly."""
    way = end[:, :3, 3] - start[:, :3, 3]
    turning = log_rotation(np.swapaxes(start[:, :3, :3], 1, 2) @ end[:, :3, :3])
    gone = pose[:, :3, 3] - start[:, :3, 3]
    length, angle = np.linalg.norm(way, axis=1), np.linalg.norm(turning, axis=1)
    turned = log_rotation(np.swapaxes(start[:, :3, :3], 1, 2) @ pose[:, :3, :3])
    by_way = dots(gone, way) / np.maximum(length, 1e-9) ** 2
    by_turn = dots(turned, turning) / np.maximum(angle, 1e-9) ** 2
    share = np.clip(np.where(length > 1e-6, by_way, np.where(angle > 1e-6, by_turn, 0.0)), 0.0, 1.0)
    off = np.linalg.norm(gone - share[:, None] * way, axis=1)
    wanted = start[:, :3, :3] @ exp_rotation(share[:, None] * turning)
    apart = log_rotation(np.swapaxes(wanted, 1, 2) @ pose[:, :3, :3])
    return off, np.asarray(np.linalg.norm(apart, axis=1))
