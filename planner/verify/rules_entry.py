"""Rules on moves by joints, of which the text states speeds alone: the first begins nobody knows where."""

from __future__ import annotations

import numpy as np

from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_step
from planner.verify.job import TaskText
from planner.verify.steps import MoveStep

CODE = "verify.unknown_start"
SPEED = 0.25
"""Highest speed of the tool [m/s] from a place that is not known: what arms may do beside people."""
TURN = np.deg2rad(45.0)
"""Highest turning [rad/s] from there."""
SHARE = 0.10
"""Highest share of each axis' own speed from there, where shares are what a language states."""
LINEAR, ROTARY = 5.0, np.deg2rad(1000.0)
"""Highest speeds of external axes that a move may state [m/s, rad/s]; no arm here has any."""
SLACK = 1.0 + 1e-6


def unknown_start(context: Context) -> Outcome:
    """The first move of each arm begins where its start is not known, so it is no faster than what it states:
    250 mm/s and 45 deg/s, or less where the problem allows less; KRL 10 % of each axis. Joint moves state no
    times."""
    found = []
    worst = 0.0
    told: dict[str, list[str]] = {}
    limit = min(SPEED, context.problem.settings.tcp_speed)
    for task in context.job.tasks:
        moves = [step for step in task.steps if isinstance(step, MoveStep)]
        if moves:
            share, faults = _shares(task, moves[0]) if task.krl is not None else _rapid(moves[0], limit)
            worst = max(worst, share)
            told.setdefault(_words(moves[0]), []).append(task.arm.name)
            found += [at_step(CODE, f"start not known: {fault}", task, moves[0]) for fault in faults]
        for move in moves if task.krl is None else ():
            found += [at_step(CODE, fault, task, move) for fault in _stated(move)]
    words = "; ".join(f"{stated} ({', '.join(arms)})" for stated, arms in told.items())
    where = f"start not known: at most {words}" if told else "nothing moves"
    return Outcome(tuple(found), 100.0 * worst, 100.0, "% of the speed allowed", where)


def _rapid(move: MoveStep, limit: float) -> tuple[float, list[str]]:
    """The first move's share of the speeds allowed, and what is wrong with it."""
    speed = move.speed.tcp if move.velocity is None else move.velocity
    faults = []
    if speed > limit * SLACK:
        faults.append(f"the move's speed is {mm(speed):g} mm/s; allowed: {mm(limit):g} mm/s")
    if move.speed.turn > TURN * SLACK:
        turn = np.rad2deg([move.speed.turn, TURN])
        faults.append(f"the tool may turn at {turn[0]:g} deg/s; allowed: {turn[1]:g} deg/s")
    return max(speed / limit, float(move.speed.turn / TURN)), faults


def _shares(task: TaskText, move: MoveStep) -> tuple[float, list[str]]:
    """The same of KRL: a PTP, by shares of the axes' speeds."""
    if move.speed.axes is None:
        return 0.0, [f"{move.kind} does not state shares of the axes' speeds; PTP does"]
    fastest = max(move.speed.axes)
    axis = int(np.argmax(move.speed.axes)) + 1
    what = f"axis {axis} goes at {100.0 * fastest:g} % of its speed; allowed: {100.0 * SHARE:g} %"
    return fastest / SHARE, [what] if fastest > SHARE * SLACK else []


def _stated(move: MoveStep) -> list[str]:
    """What is wrong with speeds of a move that has no way of its own to hold them against."""
    faults = []
    if move.by_joints and move.time is not None:
        faults.append("a joint move states its time, and takes it however far it goes; state a speed")
    speed = move.speed
    fits = 0.0 < speed.linear <= LINEAR * SLACK and 0.0 < speed.rotary <= ROTARY * SLACK
    if move.time is None and not fits:
        what = f"external axes at {mm(speed.linear):g} mm/s and {np.rad2deg(speed.rotary):g} deg/s"
        faults.append(f"{what}; allowed: above 0, to {mm(LINEAR):g} and {np.rad2deg(ROTARY):g}")
    return faults


def _words(move: MoveStep) -> str:
    """What a move states of its speed."""
    if move.speed.axes is not None:
        return f"{100.0 * max(move.speed.axes):g} % of each axis"
    speed = move.speed.tcp if move.velocity is None else move.velocity
    return f"{mm(speed):g} mm/s, {np.rad2deg(move.speed.turn):g} deg/s"
