"""Moves of KRL programs: approximation, accelerations and status."""

import itertools
from collections.abc import Sequence

import numpy as np

from planner.issues import Issue
from planner.languages.krl.reader.reader import KrlText
from planner.programs.stages import TaskText
from planner.programs.steps import MOST_OUTER, JointTarget, MoveStep, PassedTarget, RobTarget, StatusTarget
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.external_axes import outer_axes, outer_values, slid
from planner.proof.kinematics.inverse_kinematics import select_by_status
from planner.proof.replay.moves import flange_at, solutions
from planner.proof.rule import Outcome, at_step, mm, rule

_SAME_PLACE = 1e-5
"""A move whose TCP goes no farther [m] turns only."""
_SMALLEST_ZONE = 1.001e-6
"""Roundings so small [m] need no room: the controller itself never takes more than half of a move."""
_SMALLEST_ZONE_TURN = 1.001 * np.deg2rad(0.001)
"""Roundings of the orientation below this angle [rad] need no room either."""
_CREEP_SPEED = 0.11e-3
"""Moves slower than this [m/s], and than the next, are as fast as KRL lets them be; no feed or limit is so
low."""
_CREEP_TURN_RATE = np.deg2rad(0.15)
"""Turns slower than this rate [rad/s], and than the next turn, are as fast as KRL allows."""
_OTHER_SOLUTION = np.deg2rad(0.01)
"""Joints that differ by more [rad] are another solution."""


def move_kinds(context: Context, task: TaskText) -> Outcome:
    """Moves of a task without external axes that use one (verify.move_kinds)."""
    if outer_axes(task.arm, context.problem.cell.turntable):  # then verify.external_axes looks
        return Outcome()
    out = []
    for step in task.steps:
        if not isinstance(step, MoveStep):
            continue
        stated = np.abs(step.target.external)
        if stated[stated < MOST_OUTER].max(initial=0.0) > 0.0:
            what = "the target moves an external axis; E1 to E6 are 0 here"
            out.append(at_step("verify.move_kinds", what, task, step))
    return Outcome(tuple(out))


def hidden(context: Context, task: TaskText) -> Outcome:
    """Programs that nothing calls (verify.hidden)."""
    programs = task.text.programs if isinstance(task.text, KrlText) else {}
    return Outcome(
        tuple(
            Issue("verify.hidden", f"{program.name}() is never called", arm=task.arm.name, file=program.file)
            for name, program in programs.items()
            if ("", name) not in task.called
        )
    )


def corners(task: TaskText, moves: Sequence[MoveStep]) -> tuple[list[Issue], float]:
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


def creeps(move: MoveStep) -> bool:
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
