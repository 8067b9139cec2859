"""Rules on how tasks run together: task lists, synchronisation points and pairs of moves.

verify.task_list, sync_order, move_count, move_ids, zone_kind, move_time, speed_data, arms_alone, and
stop_before_logic.
"""

import itertools
import math
from collections.abc import Iterator

from planner.issues import Issue
from planner.programs.stages import JobStage, TaskText, sync_points
from planner.programs.steps import (
    CallStep,
    CarryStep,
    MessageStep,
    MoveStep,
    ProgramStep,
    RobTarget,
    SettingStep,
    StatusTarget,
    to_single,
)
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.language_contribution import language_of_task
from planner.proof.rule import RuleOutcome, mm, rule, step_issue

_TIME_TOLERANCE = 1e-9
"""Tolerance [s] between the times of moves that run together."""
PAIR_TIME_TOLERANCE = 0.01
"""Relative tolerance between the times of two moves that run together, because speeds have few digits."""
MAX_MOVE_ID = 2**23
"""Largest move ID. Larger whole numbers are not exact in single precision."""
MIN_MOVE_TIME_S = 0.005
"""Minimum time [s] of a move. A controller that cannot plan fast enough stops instead, even inside the
foam.
"""
SPEED_SLACK_FACTOR = 1.01
"""Ratio of distance / time to the stated speed that is allowed, because both are rounded."""


@rule("verify.task_list")
def task_list(context: Context) -> RuleOutcome:
    """Every synchronisation point names all tasks that take part."""
    tasks = context.job.tasks
    expected = tuple(task.name for task in tasks)
    issues = []
    for task in tasks:
        for step in sync_points(task):
            if step.kind in ("WaitSyncTask", "SyncMoveOn") and tuple(step.tasks) != expected:
                message = (
                    f"{step.kind} {step.ident} names {list(step.tasks)}; the job's tasks are {list(expected)}"
                )
                issues.append(step_issue("verify.task_list", message, task, step))
    return RuleOutcome(tuple(issues))


@rule("verify.sync_order")
def sync_order(context: Context) -> RuleOutcome:
    """All tasks pass the same synchronisation points in the same order, each of them once.
    Each synchronised block is closed.
    """
    findings = Findings("verify.sync_order", context)
    steps_by_task = [(task, sync_points(task)) for task in context.job.tasks]
    first = steps_by_task[0][1] if steps_by_task else ()
    expected = [(step.kind, step.ident.lower()) for step in first]
    for task, steps in steps_by_task:
        points = [(step.kind, step.ident.lower()) for step in steps]
        if points != expected:
            differ = (k for k, (a, b) in enumerate(zip(points, expected, strict=False)) if a != b)
            i = next(differ, min(len(points), len(expected)))
            message = f"synchronisation point {i + 1} of {task.name} is not that of the other task"
            findings.add_at_step(message, task, steps[i] if i < len(steps) else None)
        seen: set[str] = set()
        in_block = False
        for step in steps:
            if step.ident.lower() in seen:
                findings.add_at_step(
                    f"syncident {step.ident} is used again; each one may be used once", task, step
                )
            seen.add(step.ident.lower())
            # Reported are SyncMoveOn inside a block, SyncMoveOff outside one, and SyncMoveUndo anywhere.
            if (step.kind == "SyncMoveOn") == in_block or (step.kind == "SyncMoveUndo"):
                if step.kind == "WaitSyncTask" and not in_block:
                    continue
                message = f"{step.kind} {step.ident} is not where a block may open, close or wait"
                findings.add_at_step(message, task, step)
            in_block = step.kind == "SyncMoveOn" or (in_block and step.kind != "SyncMoveOff")
        if in_block:
            findings.add(f"{task.name} never leaves its last block", arm=task.arm.name)
    return findings.outcome_without_value()


def _synchronised_blocks(context: Context) -> list[tuple[JobStage, dict[str, tuple[MoveStep, ...]]]]:
    """Return the synchronised stages, each with the moves of every task by its name."""
    tasks = context.job.tasks
    return [
        (stage, {task.name: stage.moves(task.name) for task in tasks})
        for stage in context.job.stages
        if stage.synchronised
    ]


def _move_pairs(context: Context) -> list[tuple[TaskText, MoveStep, TaskText, MoveStep]]:
    """Return the pairs of moves that run together in synchronised blocks, each move with its task.

    The n-th move of the first task in a block runs with the n-th move of every other task. Moves without
    partner are left out (verify.move_count reports them).
    """
    tasks = context.job.tasks
    out = []
    for _, moves in _synchronised_blocks(context):
        for other in tasks[1:]:
            pairs = zip(moves[tasks[0].name], moves[other.name], strict=False)
            out += [(tasks[0], a, other, b) for a, b in pairs]
    return out


@rule("verify.move_count")
def move_count(context: Context) -> RuleOutcome:
    """All tasks have the same number of moves in a block."""
    findings = Findings("verify.move_count", context, worst=0)
    for stage, moves in _synchronised_blocks(context):
        counts = {name: len(task_moves) for name, task_moves in moves.items()}
        findings.note_highest(max(counts.values()) - min(counts.values()))
        if len(set(counts.values())) > 1:
            listed = ", ".join(f"{name} has {n} moves" for name, n in counts.items())
            findings.add(f"block {stage.ident}: {listed}", hint="every move of a block needs its partner")
    return findings.outcome(int, "moves", 0)


@rule("verify.move_ids")
def move_ids(context: Context) -> RuleOutcome:
    """IDs ascend and are equal in both tasks inside a block.
    There are none outside a block or where two controllers meet by signals.
    """
    findings = Findings("verify.move_ids", context)
    for _, stage, task, moves in context.moves():
        last = -1
        for move in moves:
            if not stage.synchronised or stage.ends:
                if move.id is not None:
                    findings.add_at_step(f"\\ID:={move.id} outside a block of MultiMove", task, move)
                continue
            if move.id is None:
                findings.add_at_step("a move in a block has no \\ID", task, move)
            elif move.id > MAX_MOVE_ID:
                message = f"\\ID:={move.id}; above {MAX_MOVE_ID} the controller cannot distinguish IDs"
                findings.add_at_step(message, task, move)
            elif move.id <= last:
                findings.add_at_step(f"\\ID:={move.id} follows {last}; IDs must ascend", task, move)
            last = move.id if move.id is not None else last
    for a_task, a, b_task, b in _move_pairs(context):
        if a.id != b.id:
            message = f"\\ID:={b.id} runs with \\ID:={a.id} of {a_task.name} (line {a.line})"
            findings.add_at_step(message, b_task, b)
    return findings.outcome_without_value()


@rule("verify.zone_kind")
def zone_kind(context: Context) -> RuleOutcome:
    """Both moves of a pair stop, or both pass through a zone.
    If they differ, the controller stops with an error. Zones may differ in size.
    """
    hint = "give both moves of an ID a zone, or both a stop"
    code = "verify.zone_kind"
    issues = [
        step_issue(code, f"{b.zone_name} runs with {a.zone_name} of {a_task.name}", b_task, b, hint)
        for a_task, a, b_task, b in _move_pairs(context)
        if a.zone.fine != b.zone.fine
    ]
    return RuleOutcome(tuple(issues))


@rule("verify.move_time")
def move_time(context: Context) -> RuleOutcome:
    """Every move of a block states its time, in KRL by its speeds, and both moves of a pair the same time.
    Joint moves of an approach, retreat or link state their speeds instead, and a pair of them takes the
    time of the slower one.
    """
    worst = 0.0
    issues = [
        step_issue("verify.move_time", "a move in a block has no \\T above 0", task, move)
        for stage, moves in _synchronised_blocks(context)
        for task in context.job.tasks
        for move in moves[task.name]
        if not stage.is_synchronised_approach and (move.time is None or move.time <= 0.0)
    ]
    issues += [
        step_issue("verify.move_time", _too_short_message(move.time), task, move)
        for _, _, task, moves in context.moves()
        for move in moves
        if move.time is not None and move.time < MIN_MOVE_TIME_S
    ]
    for a_task, a, b_task, b in _move_pairs(context):
        if language_of_task(a_task).slowest or language_of_task(b_task).slowest:
            issues += _compare_times(a_task, a, b_task, b)
        elif a.time is not None and b.time is not None:
            # RAPID stores times in single precision, whatever the language of the other task.
            difference = abs(to_single(a.time) - to_single(b.time))
            worst = max(worst, difference)
            if difference > _TIME_TOLERANCE:
                message = f"\\T:={b.time:g} runs with \\T:={a.time:g} of {a_task.name}"
                issues.append(step_issue("verify.move_time", message, b_task, b))
    return RuleOutcome(tuple(issues), worst, _TIME_TOLERANCE, "s")


def _compare_times(a_task: TaskText, a: MoveStep, b_task: TaskText, b: MoveStep) -> Iterator[Issue]:
    """Report the shorter of two moves that run together if their times differ by more than 1 %.

    It is used if the language of at least one of them states speeds instead of times (``slowest``). A move
    that is as slow as its language allows is not reported. Without both times nothing can be compared.
    """
    if a.time is None or b.time is None:
        return
    for task, move, other in ((a_task, a, b), (b_task, b, a)):
        slowest = language_of_task(task).slowest
        too_short = (
            move.time < (1.0 - PAIR_TIME_TOLERANCE) * other.time if move.time and other.time else False
        )
        if too_short and not (slowest and slowest(move)):
            message = f"the move takes {move.time:.5f} s, but that of the other arm {other.time:.5f} s"
            yield step_issue("verify.move_time", message, task, move)


def _too_short_message(time: float) -> str:
    """Return the message about a move that takes only ``time`` [s]."""
    min_ms = mm(MIN_MOVE_TIME_S)
    return f"the move takes {mm(time):.3g} ms; controllers need at least {min_ms:g} ms per move"


@rule("verify.speed_data")
def speed_data(context: Context) -> RuleOutcome:
    """The speed that is stated beside a time is not below what distance and time require."""
    issues, worst = [], 0.0
    for _, _, task, moves in context.moves():
        issues += [
            step_issue("verify.speed_data", "the speed is not positive", task, move)
            for move in moves
            if min(move.speed.tcp, move.speed.turn) <= 0.0
        ]
        for previous, move in itertools.pairwise(moves):
            distance = straight_distance(previous, move)
            if distance is None or not move.time:
                continue
            ratio = distance / move.time / max(move.speed.tcp, 1e-9)
            worst = max(worst, ratio)
            if ratio > SPEED_SLACK_FACTOR:
                message = (
                    f"{distance * 1e3:.3f} mm in {move.time:g} s are {distance / move.time * 1e3:.2f} mm/s; "
                    f"the move's own speed is {move.speed.tcp * 1e3:g} mm/s"
                )
                issues.append(step_issue("verify.speed_data", message, task, move))
    return RuleOutcome(tuple(issues), worst, SPEED_SLACK_FACTOR, "of the stated speed")


def straight_distance(a: MoveStep, b: MoveStep) -> float | None:
    """Return the length [m] of the straight path of move ``b``, which starts at the target of move ``a``.

    It is None if a target is not a pose, or if both targets are not in one work object.
    """
    if (
        isinstance(a.target, RobTarget | StatusTarget)
        and isinstance(b.target, RobTarget)
        and a.wobj_name == b.wobj_name
    ):
        return math.dist(a.target.position, b.target.position)
    return None


@rule("verify.arms_alone")
def arms_alone(context: Context) -> RuleOutcome:
    """Outside synchronised blocks only one arm moves at a time, and the other tasks only wait for it."""
    issues = []
    for number, stage in enumerate(context.job.stages):
        moving = [task for task in context.job.tasks if stage.moves(task.name)]
        if not stage.synchronised and len(moving) > 1:
            first = stage.moves(moving[1].name)[0]
            message = (
                f"stage {number + 1}: {' and '.join(task.name for task in moving)} move at the same time, "
                "unsynchronised"
            )
            issues.append(step_issue("verify.arms_alone", message, moving[1], first))
        for task in context.job.tasks if moving else ():
            if stage.moves(task.name):
                continue
            forbidden = [step for step in stage.steps[task.name] if not _is_allowed_meanwhile(step)]
            message = f"{task.name} asks, switches or waits while {moving[0].name} moves"
            issues += [step_issue("verify.arms_alone", message, task, step) for step in forbidden[:1]]
    return RuleOutcome(tuple(issues))


@rule("verify.stop_before_logic")
def stop_before_logic(context: Context) -> RuleOutcome:
    """The arms stop before every synchronisation point outside a block, signal, wait and message."""
    issues = []
    for _, stage, task, _ in context.moves():
        last: MoveStep | None = None
        for step in stage.steps[task.name]:
            if isinstance(step, MoveStep):
                last = step
            elif last is not None and not _is_neutral_setting(step) and not last.zone.fine:
                message = (
                    f"{last.zone_name} is used before {type(step).__name__.removesuffix('Step').lower()} "
                    f"logic in line {step.line}"
                )
                issues.append(step_issue("verify.stop_before_logic", message, task, last))
        if last is not None and not last.zone.fine:
            message = f"{last.zone_name} is used before a synchronisation point or the end"
            issues.append(step_issue("verify.stop_before_logic", message, task, last))
    return RuleOutcome(tuple(issues))


def _is_allowed_meanwhile(step: ProgramStep) -> bool:
    """Return whether a step of a task is allowed while another task moves: a message, a setting or a load."""
    is_message = isinstance(step, MessageStep) and not step.confirm
    return is_message or isinstance(step, CarryStep | CallStep) or _is_neutral_setting(step)


def _is_neutral_setting(step: ProgramStep) -> bool:
    """Return whether a step is a setting of the motion that needs no stop."""
    return isinstance(step, SettingStep) and step.kind in ("ConfL", "ConfJ", "SingArea", "AccSet", "VelSet")
