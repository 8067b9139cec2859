"""Rules on how the tasks run together: task lists, synchronisation points and pairs of moves.

verify.task_list, sync_order, move_count, move_ids, zone_kind, move_time, speed_data, arms_alone,
and stop_before_logic.
"""

import itertools
import math
from collections.abc import Iterator

from planner.issues import Issue
from planner.programs.stages import Stage, TaskText, sync_points
from planner.programs.steps import (
    CallStep,
    CarryStep,
    MessageStep,
    MoveStep,
    RobTarget,
    SettingStep,
    StatusTarget,
    Step,
    single,
)
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.language_contribution import of_task
from planner.proof.rule import Outcome, at_step, mm, rule

_TIME_TOLERANCE = 1e-9
"""Times [s] of moves that run together differ by no more."""
PAIR_TIME_SHARE = 0.01
"""How much the times of two moves that run together may differ: speeds have few digits."""
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
    findings = Findings("verify.sync_order", context)
    rows = [(task, sync_points(task)) for task in context.job.tasks]
    first = rows[0][1] if rows else ()
    there = [(step.kind, step.ident.lower()) for step in first]
    for task, row in rows:
        here = [(step.kind, step.ident.lower()) for step in row]
        if here != there:
            differ = (k for k, (a, b) in enumerate(zip(here, there, strict=False)) if a != b)
            i = next(differ, min(len(here), len(there)))
            message = f"synchronisation point {i + 1} of {task.name} is not that of the other task"
            findings.at_step(message, task, row[i] if i < len(row) else None)
        seen: set[str] = set()
        inside = False
        for step in row:
            if step.ident.lower() in seen:
                findings.at_step(
                    f"syncident {step.ident} is used again; each one may be used once", task, step
                )
            seen.add(step.ident.lower())
            if (step.kind == "SyncMoveOn") == inside or (step.kind == "SyncMoveUndo"):
                if step.kind == "WaitSyncTask" and not inside:
                    continue
                message = f"{step.kind} {step.ident} does not stand where a block may open, close or wait"
                findings.at_step(message, task, step)
            inside = step.kind == "SyncMoveOn" or (inside and step.kind != "SyncMoveOff")
        if inside:
            findings.add(f"{task.name} never leaves its last block", arm=task.arm.name)
    return findings.outcome_without_value()


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
    findings = Findings("verify.move_count", context, worst=0)
    for stage, moves in _blocks(context):
        counts = {name: len(row) for name, row in moves.items()}
        findings.highest(max(counts.values()) - min(counts.values()))
        if len(set(counts.values())) > 1:
            told = ", ".join(f"{name} has {n} moves" for name, n in counts.items())
            findings.add(f"block {stage.ident}: {told}", hint="every move of a block needs its partner")
    return findings.outcome(int, "moves", 0)


@rule("verify.move_ids")
def move_ids(context: Context) -> Outcome:
    """IDs ascend and are equal in both tasks inside a block, and there are none outside or where two
    controllers meet by signals."""
    findings = Findings("verify.move_ids", context)
    for _, stage, task, moves in context.moves():
        last = -1
        for move in moves:
            if not stage.synchronised or stage.ends:
                if move.id is not None:
                    findings.at_step(f"\\ID:={move.id} outside a block of MultiMove", task, move)
                continue
            if move.id is None:
                findings.at_step("a move in a block has no \\ID", task, move)
            elif move.id > LARGEST_ID:
                message = f"\\ID:={move.id}; beyond {LARGEST_ID} the controller does not tell IDs apart"
                findings.at_step(message, task, move)
            elif move.id <= last:
                findings.at_step(f"\\ID:={move.id} follows {last}; IDs must ascend", task, move)
            last = move.id if move.id is not None else last
    for a_task, a, b_task, b in _pairs(context):
        if a.id != b.id:
            message = f"\\ID:={b.id} runs with \\ID:={a.id} of {a_task.name} (line {a.line})"
            findings.at_step(message, b_task, b)
    return findings.outcome_without_value()


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
        if of_task(a_task).slowest or of_task(b_task).slowest:
            issues += _times_apart(a_task, a, b_task, b)
        elif a.time is not None and b.time is not None:
            # a time of RAPID is held in single precision, in whatever language the other one is
            apart = abs(single(a.time) - single(b.time))
            worst = max(worst, apart)
            if apart > _TIME_TOLERANCE:
                message = f"\\T:={b.time:g} runs with \\T:={a.time:g} of {a_task.name}"
                issues.append(at_step("verify.move_time", message, b_task, b))
    return Outcome(tuple(issues), worst, _TIME_TOLERANCE, "s")


def _times_apart(a_task: TaskText, a: MoveStep, b_task: TaskText, b: MoveStep) -> Iterator[Issue]:
    """Two moves that run together, at least one of which states speeds, and whose times differ."""
    if a.time is None or b.time is None:
        return
    for task, move, other in ((a_task, a, b), (b_task, b, a)):
        slowest = of_task(task).slowest
        early = move.time < (1.0 - PAIR_TIME_SHARE) * other.time if move.time and other.time else False
        if early and not (slowest and slowest(move)):
            what = f"the move takes {move.time:.5f} s; the other arm's takes {other.time:.5f} s meanwhile"
            yield at_step("verify.move_time", what, task, move)


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
