"""Rules on how the tasks run together: task lists, synchronisation points, pairs of moves.

verify.task_list, sync_order, move_count, move_ids, zone_kind, move_time, speed_data, arms_alone,
wire_alone, stop_before_logic; verify.status, and what rules ask of KRL where they ask something else
of RAPID.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from planner.issues import Issue
from planner.programs.stages import Stage, TaskText, sync_points
from planner.programs.steps import (
    MOST_OUTER,
    CallStep,
    CarryStep,
    JointTarget,
    MessageStep,
    MoveStep,
    PassedTarget,
    RobTarget,
    SettingStep,
    SignalStep,
    StatusTarget,
    Step,
    single,
)
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.external_axes import outer_values, slid
from planner.proof.kinematics.inverse_kinematics import select_by_status
from planner.proof.replay.moves import flange_at, solutions
from planner.proof.rule import Outcome, at_step, mm, rule

_SAME_PLACE = 1e-5
"""A move whose TCP goes no farther [m] turns only."""
_SMALLEST_ZONE = 1.001e-6
"""Roundings so small [m] need no room: the controller itself never takes more than half of a move."""
_SMALLEST_ZONE_TURN = 1.001 * np.deg2rad(0.001)
"""The same of turns [rad]."""
_CREEP_SPEED = 0.11e-3
"""Moves slower than this [m/s], and than the next, are as fast as KRL lets them be; no feed or limit is so
low."""
_CREEP_TURN_RATE = np.deg2rad(0.15)
"""The same of turns [rad/s]."""
PAIR_TIME_SHARE = 0.01
"""How much the times of two moves that run together may differ: speeds have few digits."""
_OTHER_SOLUTION = np.deg2rad(0.01)
"""Joints that differ by more [rad] are another solution."""


def move_kinds(task: TaskText) -> list[Issue]:
    """Moves of a task without external axes that use one."""
    out = []
    for step in task.steps:
        if not isinstance(step, MoveStep):
            continue
        stated = np.abs(step.target.external)
        if stated[stated < MOST_OUTER].max(initial=0.0) > 0.0:
            what = "the target moves an external axis; E1 to E6 are 0 here"
            out.append(at_step("verify.move_kinds", what, task, step))
    return out


def accelerations(task: TaskText) -> list[Issue]:
    """Moves by joints that ask for more of their leading axis than every axis has."""
    limit, out = float(np.min(task.arm.data.acceleration)), []
    for step in task.steps:
        if isinstance(step, MoveStep) and step.acceleration is not None and step.acceleration > limit:
            given, most = np.rad2deg([step.acceleration, limit])
            what = f"the leading axis is to accelerate by {given:.1f} deg/s^2; allowed: {most:.1f}"
            out.append(at_step("verify.move_kinds", what, task, step))
    return out


def sizes(context: Context, task: TaskText) -> tuple[list[Issue], int]:
    """Files with more moves than the problem allows, and the most that one has."""
    limit, most, out = context.problem.cell.controller.max_moves, 0, []
    for program in task.krl.programs.values() if task.krl else ():
        most = max(most, program.moves)
        if program.moves > limit:
            what = f"{program.file} has {program.moves} moves; allowed: {limit}"
            out.append(Issue("verify.module_size", what, file=program.file, value=program.moves, limit=limit))
    if task.trajectory is not None:
        driven = task.trajectory.program
        most = driven.points
        if most > limit and task.arm.name == driven.arms[0].arm:
            what = f"{driven.file} has {most} points; allowed: {limit}"
            out.append(Issue("verify.module_size", what, file=driven.file, value=most, limit=limit))
    script = None if task.script is None else task.script.program
    if script is not None:
        most = script.moves
        if most > limit:
            what = f"{script.file} has {most} moves; allowed: {limit}"
            out.append(Issue("verify.module_size", what, file=script.file, value=most, limit=limit))
    return out, most


def hidden(task: TaskText) -> list[Issue]:
    """Programs that nothing calls."""
    return [
        Issue("verify.hidden", f"{program.name}() is never called", arm=task.arm.name, file=program.file)
        for name, program in (task.krl.programs.items() if task.krl else ())
        if ("", name) not in task.called
    ]


def corners(task: TaskText, moves: tuple[MoveStep, ...]) -> tuple[list[Issue], float]:
    """Corners that take more than half of a move beside them, by way or, where the TCP stands, by angle; and
    the largest size over that [mm]."""
    out, worst = [], 0.0
    steps = [_apart(a, b) for a, b in itertools.pairwise(moves)]
    for i, move in enumerate(moves):
        if move.zone.fine or move.by_joints:
            continue
        beside = [step for step in steps[max(i - 1, 0) : i + 1] if step is not None]
        if not beside:
            continue
        way, turn = min(step[0] for step in beside), min(step[1] for step in beside)
        if way > _SAME_PLACE:
            over = move.zone.tcp - max(0.5 * way, _SMALLEST_ZONE)
            worst = max(worst, mm(over))
            size, half = mm(move.zone.tcp), mm(0.5 * way)
            what = f"the corner takes {size:g} mm; half of the shorter move is {half:.4f} mm"
        else:
            over = move.zone.turn_angle - max(0.5 * turn, _SMALLEST_ZONE_TURN)
            angles = np.rad2deg([move.zone.turn_angle, 0.5 * turn])
            what = f"the corner takes {angles[0]:g} deg; half of the shorter turn is {angles[1]:.5f} deg"
        if over > 1e-9:
            out.append(at_step("verify.zone_size", what, task, move))
    return out, worst


def _apart(a: MoveStep, b: MoveStep) -> tuple[float, float] | None:
    """Way [m] and angle [rad] between the targets of two moves in one frame, None where they have none."""
    if (
        isinstance(a.target, JointTarget | PassedTarget)
        or not isinstance(b.target, RobTarget)
        or a.wobj is not b.wobj
    ):
        return None
    way = float(np.linalg.norm(a.target.position - b.target.position))
    cosine = abs(float(a.target.quaternion @ b.target.quaternion))
    return way, 2.0 * float(np.arccos(min(cosine, 1.0)))


def pair_times(a_task: TaskText, a: MoveStep, b_task: TaskText, b: MoveStep) -> Iterator[Issue]:
    """Two moves that run together, one at least by KRL, and whose times differ."""
    if a.time is None or b.time is None:
        return
    for task, move, other in ((a_task, a, b), (b_task, b, a)):
        early = move.time < (1.0 - PAIR_TIME_SHARE) * other.time if move.time and other.time else False
        if early and not (task.krl is not None and _creeps(move)):
            what = f"the move takes {move.time:.5f} s; the other arm's takes {other.time:.5f} s meanwhile"
            yield at_step("verify.move_time", what, task, move)


def _creeps(move: MoveStep) -> bool:
    """Whether a move is as slow as KRL can state it."""
    return move.speed.tcp <= _CREEP_SPEED and move.speed.turn <= np.sqrt(2.0) * _CREEP_TURN_RATE


@rule("verify.status")
def status(context: Context) -> Outcome:
    """KRL: Status and Turn of each pose that is a target by joints select one solution within the limits,
    whether or not Turn counts for axes near zero."""
    issues: list[Issue] = []
    near: list[str] = []
    targets = 0
    for task in context.job.tasks:
        for move in task.steps:
            if isinstance(move, MoveStep) and isinstance(move.target, StatusTarget):
                targets += 1
                wrong, axes = _chosen(context, task, move, move.target)
                issues += [at_step("verify.status", what, task, move) for what in wrong]
                near += [f"axis {axis} at {move.target_name}" for axis in axes]
    told = f"{targets} targets" if targets else ""
    where = f"{told}; near zero: {', '.join(near)}" if near else told
    return Outcome(tuple(issues), where=where, nothing="" if targets else "no target states Status and Turn")


def _chosen(
    context: Context, task: TaskText, move: MoveStep, target: StatusTarget
) -> tuple[list[str], tuple[int, ...]]:
    """What is wrong with Status and Turn of a move's target, and axes near zero."""
    machine, base = arm_model.machine_of(task.arm.data), context.bases[task.arm.name]
    if task.arm.axes:  # by what the target itself states
        base = np.array(base)
        base[:3, 3] += slid(task.arm, outer_values(task.arm, target.external))
    bits = f"S {target.status} and T {target.turn}"
    found = solutions(move, machine, base)
    if len(found.q) != 1:
        count = "no joint solution" if not len(found.q) else f"{len(found.q)} joint solutions"
        return [f"{bits} select {count} within the limits; one is needed"], ()
    wrong = []
    for axis in found.near_zero:
        other = select_by_status(
            machine, flange_at(move, base), target.status, target.turn ^ (1 << (axis - 1))
        )
        if any(np.abs(q - found.q[0]).max() > _OTHER_SOLUTION for q in other.q):
            wrong.append(f"{bits}: axis {axis} is near zero, and without its turn another solution fits")
    return wrong, found.near_zero


_TIME_TOLERANCE = 1e-9
"""Times [s] of moves that run together differ by no more."""
LARGEST_ID = 2**23
"""Whole numbers beyond are not exact in single precision."""
LEAST_MOVE_TIME = 0.005
"""Least time of a move [s]; a controller that cannot plan so fast stops instead, in the foam too."""
SPEED_SLACK = 1.01
"""A time may be shorter than the stated speed makes it by this factor: both are rounded."""


@rule("verify.task_list")
def task_list(context: Context) -> Outcome:
    """Every synchronisation point names all tasks that take part."""
    tasks = context.job.tasks
    wanted = tuple(task.name for task in tasks)
    issues = []
    for task in tasks:
        for step in sync_points(task):
            if step.kind in ("WaitSyncTask", "SyncMoveOn") and tuple(step.tasks) != wanted:
                message = (
                    f"{step.kind} {step.ident} names {list(step.tasks)}; the job's tasks are {list(wanted)}"
                )
                issues.append(at_step("verify.task_list", message, task, step))
    return Outcome(tuple(issues))


@rule("verify.sync_order")
def sync_order(context: Context) -> Outcome:
    """All tasks pass the same synchronisation points in the same order, each of them once, with each block
    closed."""
    issues = []
    rows = [(task, sync_points(task)) for task in context.job.tasks]
    first = rows[0][1] if rows else ()
    for task, row in rows:
        here = [(step.kind, step.ident.lower()) for step in row]
        there = [(step.kind, step.ident.lower()) for step in first]
        if here != there:
            i = next(
                (k for k, (a, b) in enumerate(zip(here, there, strict=False)) if a != b),
                min(len(here), len(there)),
            )
            step = row[i] if i < len(row) else None
            message = f"synchronisation point {i + 1} of {task.name} is not that of the other task"
            issues.append(at_step("verify.sync_order", message, task, step))
        seen: set[str] = set()
        inside = False
        for step in row:
            if step.ident.lower() in seen:
                message = f"syncident {step.ident} is used again; each one may be used once"
                issues.append(at_step("verify.sync_order", message, task, step))
            seen.add(step.ident.lower())
            if (step.kind == "SyncMoveOn") == inside or (step.kind == "SyncMoveUndo"):
                if step.kind == "WaitSyncTask" and not inside:
                    continue
                message = f"{step.kind} {step.ident} does not stand where a block may open, close or wait"
                issues.append(at_step("verify.sync_order", message, task, step))
            inside = step.kind == "SyncMoveOn" or (inside and step.kind != "SyncMoveOff")
        if inside:
            issues.append(
                Issue("verify.sync_order", f"{task.name} never leaves its last block", arm=task.arm.name)
            )
    return Outcome(tuple(issues))


def _blocks(context: Context) -> list[tuple[Stage, dict[str, tuple[MoveStep, ...]]]]:
    tasks = context.job.tasks
    return [
        (stage, {task.name: stage.moves(task.name) for task in tasks})
        for stage in context.job.stages
        if stage.synchronised
    ]


def _pairs(context: Context) -> list[tuple[TaskText, MoveStep, TaskText, MoveStep]]:
    """Moves that run together: of the first task and of each other one."""
    tasks = context.job.tasks
    out = []
    for _, moves in _blocks(context):
        for other in tasks[1:]:
            pairs = zip(moves[tasks[0].name], moves[other.name], strict=False)
            out += [(tasks[0], a, other, b) for a, b in pairs]
    return out


@rule("verify.move_count")
def move_count(context: Context) -> Outcome:
    """All tasks have the same number of moves in a block."""
    issues = []
    worst = 0
    for stage, moves in _blocks(context):
        counts = {name: len(row) for name, row in moves.items()}
        worst = max(worst, max(counts.values()) - min(counts.values()))
        if len(set(counts.values())) > 1:
            message = f"block {stage.ident}: " + ", ".join(
                f"{name} has {n} moves" for name, n in counts.items()
            )
            issues.append(Issue("verify.move_count", message, hint="every move of a block needs its partner"))
    return Outcome(tuple(issues), worst, 0, "moves")


@rule("verify.move_ids")
def move_ids(context: Context) -> Outcome:
    """IDs ascend and are equal in both tasks inside a block, and there are none outside or where two
    controllers meet by signals."""
    issues = []
    for _, stage, task, moves in context.moves():
        last = -1
        for move in moves:
            if not stage.synchronised or stage.ends:
                if move.id is not None:
                    issues.append(
                        at_step(
                            "verify.move_ids", f"\\ID:={move.id} outside a block of MultiMove", task, move
                        )
                    )
                continue
            if move.id is None:
                issues.append(at_step("verify.move_ids", "a move in a block has no \\ID", task, move))
            elif move.id > LARGEST_ID:
                message = f"\\ID:={move.id}; beyond {LARGEST_ID} the controller does not tell IDs apart"
                issues.append(at_step("verify.move_ids", message, task, move))
            elif move.id <= last:
                message = f"\\ID:={move.id} follows {last}; IDs must ascend"
                issues.append(at_step("verify.move_ids", message, task, move))
            last = move.id if move.id is not None else last
    for a_task, a, b_task, b in _pairs(context):
        if a.id != b.id:
            message = f"\\ID:={b.id} runs with \\ID:={a.id} of {a_task.name} (line {a.line})"
            issues.append(at_step("verify.move_ids", message, b_task, b))
    return Outcome(tuple(issues))


@rule("verify.zone_kind")
def zone_kind(context: Context) -> Outcome:
    """Both moves of a pair stop, or both pass through a zone: the controller stops with an error at a mix.
    Zones may differ in size."""
    hint = "give both moves of an ID a zone, or both a stop"
    code = "verify.zone_kind"
    issues = [
        at_step(code, f"{b.zone_name} runs with {a.zone_name} of {a_task.name}", b_task, b, hint)
        for a_task, a, b_task, b in _pairs(context)
        if a.zone.fine != b.zone.fine
    ]
    return Outcome(tuple(issues))


@rule("verify.move_time")
def move_time(context: Context) -> Outcome:
    """Every move of a block states its time, in KRL by its speeds, and both moves of a pair the same; but the
    joint moves of a way, which state their speeds, and of a pair take the time of the slower one."""
    worst = 0.0
    issues = [
        at_step("verify.move_time", "a move in a block has no \\T above 0", task, move)
        for stage, moves in _blocks(context)
        for task in context.job.tasks
        for move in moves[task.name]
        if not stage.is_way and (move.time is None or move.time <= 0.0)
    ]
    issues += [
        at_step("verify.move_time", _too_short(move.time), task, move)
        for _, _, task, moves in context.moves()
        for move in moves
        if move.time is not None and move.time < LEAST_MOVE_TIME
    ]
    for a_task, a, b_task, b in _pairs(context):
        if a_task.krl is not None or b_task.krl is not None:
            issues += pair_times(a_task, a, b_task, b)
        elif a.time is not None and b.time is not None:
            # a time of RAPID is held in single precision, in whatever language the other one is
            apart = abs(single(a.time) - single(b.time))
            worst = max(worst, apart)
            if apart > _TIME_TOLERANCE:
                message = f"\\T:={b.time:g} runs with \\T:={a.time:g} of {a_task.name}"
                issues.append(at_step("verify.move_time", message, b_task, b))
    return Outcome(tuple(issues), worst, _TIME_TOLERANCE, "s")


def _too_short(time: float) -> str:
    least = mm(LEAST_MOVE_TIME)
    return f"the move takes {mm(time):.3g} ms, and no controller plans a move in less than {least:g} ms"


@rule("verify.speed_data")
def speed_data(context: Context) -> Outcome:
    """The speed that stands beside a time is not below what way and time ask for."""
    issues, worst = [], 0.0
    for _, _, task, moves in context.moves():
        issues += [
            at_step("verify.speed_data", "a speed of nothing or less", task, move)
            for move in moves
            if min(move.speed.tcp, move.speed.turn) <= 0.0
        ]
        for before, move in itertools.pairwise(moves):
            way = straight_way(before, move)
            if way is None or not move.time:
                continue
            share = way / move.time / max(move.speed.tcp, 1e-9)
            worst = max(worst, share)
            if share > SPEED_SLACK:
                message = (
                    f"{way * 1e3:.3f} mm in {move.time:g} s are {way / move.time * 1e3:.2f} mm/s; "
                    f"the move's own speed is {move.speed.tcp * 1e3:g} mm/s"
                )
                issues.append(at_step("verify.speed_data", message, task, move))
    return Outcome(tuple(issues), worst, SPEED_SLACK, "of the stated speed")


def straight_way(a: MoveStep, b: MoveStep) -> float | None:
    """Distance [m] between the targets of two straight moves of one frame, None where the text gives none."""
    if (
        isinstance(a.target, RobTarget | StatusTarget)
        and isinstance(b.target, RobTarget)
        and a.wobj_name == b.wobj_name
    ):
        return math.dist(a.target.position, b.target.position)
    return None


@rule("verify.arms_alone")
def arms_alone(context: Context) -> Outcome:
    """Outside synchronised blocks only one arm moves at a time, and the other tasks only wait for it."""
    issues = []
    for number, stage in enumerate(context.job.stages):
        moving = [task for task in context.job.tasks if stage.moves(task.name)]
        if not stage.synchronised and len(moving) > 1:
            first = stage.moves(moving[1].name)[0]
            message = (
                f"stage {number + 1}: {' and '.join(task.name for task in moving)} move at once, "
                "unsynchronised"
            )
            issues.append(at_step("verify.arms_alone", message, moving[1], first))
        for task in context.job.tasks if moving else ():
            if stage.moves(task.name):
                continue
            busy = [step for step in stage.steps[task.name] if not _quiet(step)]
            message = f"{task.name} asks, switches or waits while {moving[0].name} moves"
            issues += [at_step("verify.arms_alone", message, task, step) for step in busy[:1]]
    return Outcome(tuple(issues))


@rule("verify.wire_alone")
def wire_alone(context: Context) -> Outcome:
    """No arm moves alone while a bent wire is mounted or powered: each one has one run of synchronised
    stages. A powered bow or spindle goes straight, and arms without one keep still meanwhile."""
    issues = _moves_with_power(context)
    for index, setup in enumerate(context.setup_claims):
        runs, wires = context.runs(index), len(setup.joined)
        if wires and len(runs) != wires:
            message = (
                f"{wires} wires are mounted, and there are {len(runs)} runs of synchronised moves between "
                "lone ones"
            )
            hint = "move both arms together while a wire is mounted"
            lone = [
                at_step("verify.wire_alone", message, task, moves[0], hint)
                for number, stage, task, moves in context.moves()
                if (not stage.synchronised or stage.is_way) and runs and runs[0][0] < number < runs[-1][-1]
            ]
            issues += lone[:1] or [Issue("verify.wire_alone", message, hint=hint)]
    there = bool(context.contacts) or any(setup.joined for setup in context.setup_claims)
    return Outcome(tuple(issues), nothing="" if there else "no wire and no spindle")


def _moves_with_power(context: Context) -> list[Issue]:
    """Moves that must not be while a signal that powers a wire or a spindle is on."""
    signals = {claim.signal.lower() for claim in context.contacts}
    issues, on = [], set[str]()
    for number, stage in enumerate(context.job.stages):
        setup = context.setup_claims[context.spans.of_stage[number]]
        lone = not stage.synchronised or stage.is_way
        for task in context.job.tasks:
            arm = task.arm.name
            edged = arm in setup.straight or bool(setup.mills(arm) or setup.trims(arm))
            for step in stage.steps[task.name]:
                if isinstance(step, SignalStep) and step.signal.lower() in signals:
                    name = step.signal.lower()
                    on = on | {name} if step.value else on - {name}
                if not isinstance(step, MoveStep) or not on:
                    continue
                alone = lone and (bool(setup.joined) or not edged)
                if alone or (not setup.joined and step.by_joints):
                    how = "alone" if alone else "by joints"
                    message = f"an arm moves {how} while {', '.join(sorted(on))} is on"
                    issues.append(at_step("verify.wire_alone", message, task, step))
    return issues


@rule("verify.stop_before_logic")
def stop_before_logic(context: Context) -> Outcome:
    """The arms stand before every synchronisation point outside a block, signal, wait and message."""
    issues = []
    for _, stage, task, _ in context.moves():
        last: MoveStep | None = None
        for step in stage.steps[task.name]:
            if isinstance(step, MoveStep):
                last = step
            elif last is not None and not _harmless(step) and not last.zone.fine:
                message = (
                    f"{last.zone_name} stands before {type(step).__name__.removesuffix('Step').lower()} "
                    f"logic in line {step.line}"
                )
                issues.append(at_step("verify.stop_before_logic", message, task, last))
        if last is not None and not last.zone.fine:
            message = f"{last.zone_name} stands before a synchronisation point or the end"
            issues.append(at_step("verify.stop_before_logic", message, task, last))
    return Outcome(tuple(issues))


def _quiet(step: Step) -> bool:
    """What a task may do while another one moves: say something, state settings or what it carries."""
    talks = isinstance(step, MessageStep) and not step.confirm
    return talks or isinstance(step, CarryStep | CallStep) or _harmless(step)


def _harmless(step: Step) -> bool:
    return isinstance(step, SettingStep) and step.kind in ("ConfL", "ConfJ", "SingArea", "AccSet", "VelSet")
