"""RAPID's part of the rules on moves: speeds from an unknown start, and kinds of moves."""

import dataclasses

import numpy as np

from planner.programs.stages import TaskText
from planner.programs.steps import UNUSED_AXIS, JointTarget, MoveStep, RobTarget, SettingStep
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.kinematics.external_axes import task_axes
from planner.proof.rule import RuleOutcome, mm, step_issue
from planner.proof.rules.moves import (
    BLIND_ROTATION_RATE_RAD_S,
    BLIND_SPEED_M_S,
    SPEED_ROUNDING_FACTOR,
    UNKNOWN_START,
    unknown_start_outcome,
)

_REFUSED_OPTIONS = {
    "conc": "\\Conc executes instructions ahead of the motion",
    "z": "\\Z overrides the zone that the move names",
    "tload": "\\TLoad overrides the load of the tool",
    "corr": "\\Corr lets sensors change the path",
}
"""Options of moves that are refused, with the reason."""
_MAX_LINEAR_SPEED_M_S = 5.0
"""Maximum speed of linear external axes that a move may state [m/s]; no axis here exceeds it."""
_MAX_ROTARY_SPEED_RAD_S = np.deg2rad(1000.0)
"""Maximum speed of rotary external axes that a move may state [rad/s]; no axis here exceeds it."""


def unknown_start(context: Context, task: TaskText) -> RuleOutcome:
    """Check the speeds that no planned path limits (verify.unknown_start).

    The arm may be anywhere when a program starts. Therefore its first move must be slow, joint moves must
    state a speed instead of a time, and speeds of external axes must be possible ones.

    Args:
        context: The proof.
        task: The task.
    """
    moves = [step for step in task.steps if isinstance(step, MoveStep)]
    if not moves:
        return RuleOutcome()
    fraction, faults = _first_move_speed(moves[0], min(BLIND_SPEED_M_S, context.problem.settings.tcp_speed))
    outcome = unknown_start_outcome(task, moves[0], fraction, faults)
    stated_issues = (
        step_issue(UNKNOWN_START, fault, task, move) for move in moves for fault in _stated_speed_faults(move)
    )
    return dataclasses.replace(outcome, issues=(*outcome.issues, *stated_issues))


def _first_move_speed(move: MoveStep, limit: float) -> tuple[float, list[str]]:
    """Return the speed of the first move as a fraction of the allowed one, and messages if it is too fast.

    Two fractions are computed: that of the TCP speed, allowed up to ``limit`` [m/s], and that of the rotation
    speed. The result is the larger one.
    """
    speed = move.speed.tcp if move.velocity is None else move.velocity
    faults = []
    if speed > limit * SPEED_ROUNDING_FACTOR:
        faults.append(f"the move's speed is {mm(speed):g} mm/s; allowed: {mm(limit):g} mm/s")
    if move.speed.turn > BLIND_ROTATION_RATE_RAD_S * SPEED_ROUNDING_FACTOR:
        rate, max_rate = np.rad2deg([move.speed.turn, BLIND_ROTATION_RATE_RAD_S])
        faults.append(f"the tool's rotation speed is {rate:g} deg/s; allowed: {max_rate:g} deg/s")
    return max(speed / limit, float(move.speed.turn / BLIND_ROTATION_RATE_RAD_S)), faults


def _stated_speed_faults(move: MoveStep) -> list[str]:
    """Return the faults of a joint move that states a time, and of stated speeds of external axes.

    The latter are checked in moves without a time only, because a time replaces them.
    """
    faults = []
    if move.by_joints and move.time is not None:
        faults.append("a joint move states a time, which applies at any distance; state a speed")
    speed = move.speed
    is_allowed = (
        0.0 < speed.linear <= _MAX_LINEAR_SPEED_M_S * SPEED_ROUNDING_FACTOR
        and 0.0 < speed.rotary <= _MAX_ROTARY_SPEED_RAD_S * SPEED_ROUNDING_FACTOR
    )
    if move.time is None and not is_allowed:
        stated = f"external axes at {mm(speed.linear):g} mm/s and {np.rad2deg(speed.rotary):g} deg/s"
        faults.append(
            f"{stated}; allowed: above 0, to {mm(_MAX_LINEAR_SPEED_M_S):g} and "
            f"{np.rad2deg(_MAX_ROTARY_SPEED_RAD_S):g}"
        )
    return faults


def move_kinds(context: Context, task: TaskText) -> RuleOutcome:
    """Refuse moves whose path is not known, and check the state of ConfL (verify.move_kinds).

    Refused are MoveJ, some options, and targets that move external axes which the arm does not have. ConfL
    must be stated before the first MoveL. It must be off for an arm whose postures confdata cannot name, and
    on for others. The check of a task ends at its first MoveL where this does not hold.

    Args:
        context: The proof.
        task: The task.
    """
    findings = Findings("verify.move_kinds", context)
    axes = task_axes(task.arm, context.problem.cell.turntable)
    required = "off" if task.arm.data.has_unnamed_postures else "on"
    state = "on"
    stated = False
    for step in task.steps:
        if isinstance(step, SettingStep) and step.kind == "ConfL":
            state = step.switches[0]
            stated = True
        if not isinstance(step, MoveStep):
            continue
        if step.kind == "MoveJ":
            findings.add_at_step("the path of MoveJ is not known; use MoveL", task, step)
        for switch in step.switches:
            if switch in _REFUSED_OPTIONS:
                findings.add_at_step(_REFUSED_OPTIONS[switch], task, step)
        # 9E9, for an unused axis, deviates in single precision by up to 512
        used = np.abs(step.target.external - UNUSED_AXIS) > 1e3
        if isinstance(step.target, RobTarget | JointTarget) and not axes and used.any():
            findings.add_at_step("the target moves an external axis", task, step)
        if step.kind == "MoveL" and (state != required or not stated):
            message = (
                f"ConfL is {state if stated else 'not stated'}; this arm needs ConfL\\{required.capitalize()}"
            )
            findings.add_at_step(message, task, step)
            break
    return findings.outcome_without_value()
