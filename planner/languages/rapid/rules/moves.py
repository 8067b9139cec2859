"""Parts of the rules on moves that RAPID alone has: speeds from an unknown start, and kinds of moves."""

import dataclasses

import numpy as np

from planner.programs.stages import TaskText
from planner.programs.steps import UNUSED_AXIS, JointTarget, MoveStep, RobTarget, SettingStep
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.kinematics.external_axes import outer_axes
from planner.proof.rule import Outcome, at_step, mm
from planner.proof.rules.moves import (
    BLIND_SPEED,
    BLIND_TURN_RATE,
    SPEED_ROUNDING,
    UNKNOWN_START,
    unknown_start_outcome,
)

_REFUSED_OPTIONS = {
    "conc": "\\Conc lets logic run ahead of the motion",
    "z": "\\Z gives the corner another zone than the one that the move names",
    "tload": "\\TLoad counts with another load than the tool's",
    "corr": "\\Corr lets sensors change the path",
}
"""Options of moves that are refused, and why."""
_LINEAR, _ROTARY = 5.0, np.deg2rad(1000.0)
"""Highest speeds of external axes that a move may state [m/s, rad/s]; no arm here has any."""


def unknown_start(context: Context, task: TaskText) -> Outcome:
    """Speeds of the first move, and speeds that moves state without a way (verify.unknown_start)."""
    moves = [step for step in task.steps if isinstance(step, MoveStep)]
    if not moves:
        return Outcome()
    share, faults = _first(moves[0], min(BLIND_SPEED, context.problem.settings.tcp_speed))
    found = unknown_start_outcome(task, moves[0], share, faults)
    stated = (at_step(UNKNOWN_START, fault, task, move) for move in moves for fault in _stated(move))
    return dataclasses.replace(found, issues=(*found.issues, *stated))


def _first(move: MoveStep, limit: float) -> tuple[float, list[str]]:
    """The first move's share of the speeds allowed, and what is wrong with it."""
    speed = move.speed.tcp if move.velocity is None else move.velocity
    faults = []
    if speed > limit * SPEED_ROUNDING:
        faults.append(f"the move's speed is {mm(speed):g} mm/s; allowed: {mm(limit):g} mm/s")
    if move.speed.turn > BLIND_TURN_RATE * SPEED_ROUNDING:
        turn = np.rad2deg([move.speed.turn, BLIND_TURN_RATE])
        faults.append(f"the tool may turn at {turn[0]:g} deg/s; allowed: {turn[1]:g} deg/s")
    return max(speed / limit, float(move.speed.turn / BLIND_TURN_RATE)), faults


def _stated(move: MoveStep) -> list[str]:
    """What is wrong with speeds of a move that has no way of its own to hold them against."""
    faults = []
    if move.by_joints and move.time is not None:
        faults.append("a joint move states its time, and takes it however far it goes; state a speed")
    speed = move.speed
    fits = 0.0 < speed.linear <= _LINEAR * SPEED_ROUNDING and 0.0 < speed.rotary <= _ROTARY * SPEED_ROUNDING
    if move.time is None and not fits:
        what = f"external axes at {mm(speed.linear):g} mm/s and {np.rad2deg(speed.rotary):g} deg/s"
        faults.append(f"{what}; allowed: above 0, to {mm(_LINEAR):g} and {np.rad2deg(_ROTARY):g}")
    return faults


def move_kinds(context: Context, task: TaskText) -> Outcome:
    """Moves whose path is not known, and the state of ConfL (verify.move_kinds)."""
    findings = Findings("verify.move_kinds", context)
    axes = outer_axes(task.arm, context.problem.cell.turntable)
    wanted = "off" if task.arm.data.unnamed else "on"
    state = "on"
    stated = False
    for step in task.steps:
        if isinstance(step, SettingStep) and step.kind == "ConfL":
            state, stated = step.switches[0], True
        if not isinstance(step, MoveStep):
            continue
        if step.kind == "MoveJ":
            findings.at_step("the path of MoveJ is not known; use MoveL", task, step)
        for switch in step.switches:
            if switch in _REFUSED_OPTIONS:
                findings.at_step(_REFUSED_OPTIONS[switch], task, step)
        used = np.abs(step.target.external - UNUSED_AXIS) > 1e3  # in single precision 9E9 is off by 512
        if isinstance(step.target, RobTarget | JointTarget) and not axes and used.any():
            findings.at_step("the target moves an external axis", task, step)
        if step.kind == "MoveL" and (state != wanted or not stated):
            message = (
                f"ConfL is {state if stated else 'not stated'}; this arm needs ConfL\\{wanted.capitalize()}"
            )
            findings.at_step(message, task, step)
            break
    return findings.outcome_without_value()
