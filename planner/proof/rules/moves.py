"""Rules on moves: verify.unknown_start, move_kinds, zone_size and zero_length.

verify.unknown_start looks at moves by joints: the text states their speeds only, and the position before
the first one is unknown.
"""

from __future__ import annotations

import itertools

import numpy as np

from planner.languages.krl.rules import moves as krl_moves
from planner.languages.rapid.rules.settings import REFUSED_OPTIONS
from planner.languages.trajectories.reader import flow as trajectory_flow
from planner.languages.urscript.reader.syntax_tree import STAND
from planner.programs.stages import TaskText
from planner.programs.steps import (
    UNUSED_AXIS,
    JointTarget,
    MoveStep,
    PassedTarget,
    RobTarget,
    SettingStep,
    StatusTarget,
)
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import outer_axes
from planner.proof.rule import Outcome, at_step, mm, rule
from planner.proof.rules.synchronisation import straight_way

UNKNOWN_START = "verify.unknown_start"
"""Code of the rule about moves from a place that is not known."""
BLIND_SPEED = 0.25
"""Highest speed of the tool [m/s] from a place that is not known: what arms may do beside people."""
BLIND_TURN_RATE = np.deg2rad(45.0)
"""Highest turning [rad/s] from there."""
BLIND_SPEED_SHARE = 0.10
"""Highest share of each axis' own speed from there, where shares are what a language states."""
LINEAR, ROTARY = 5.0, np.deg2rad(1000.0)
"""Highest speeds of external axes that a move may state [m/s, rad/s]; no arm here has any."""
SPEED_ROUNDING = 1.0 + 1e-6
"""Speeds may be higher by this factor: they are rounded."""


@rule("verify.unknown_start")
def unknown_start(context: Context) -> Outcome:
    """The first move of each arm begins where its start is not known, so it is no faster than what it states:
    250 mm/s and 45 deg/s, or less where the problem allows less; KRL and URScript 10 % of each axis. Joint
    moves state no times."""
    found = []
    worst = 0.0
    told: dict[str, list[str]] = {}
    limit = min(BLIND_SPEED, context.problem.settings.tcp_speed)
    for task in context.job.tasks:
        moves = [step for step in task.steps if isinstance(step, MoveStep)]
        if task.text.language == "trajectories":
            continue  # verify.start_posture: nothing moves from a place that is not known
        if moves:
            share, faults = (
                _rapid(moves[0], limit) if task.text.language == "rapid" else _shares(task, moves[0])
            )
            worst = max(worst, share)
            told.setdefault(_words(moves[0]), []).append(task.arm.name)
            found += [at_step(UNKNOWN_START, f"start not known: {fault}", task, moves[0]) for fault in faults]
        for move in moves if task.text.language == "rapid" else ():
            found += [at_step(UNKNOWN_START, fault, task, move) for fault in _stated(move)]
    words = "; ".join(f"{stated} ({', '.join(arms)})" for stated, arms in told.items())
    looked = any(task.text.language == "trajectories" for task in context.job.tasks)
    none = "each move begins where it was looked at" if looked else "nothing moves"
    where, nothing = f"start not known: at most {words}", "" if told else none
    return Outcome(tuple(found), 100.0 * worst, 100.0, "% of the speed allowed", where, nothing)


def _rapid(move: MoveStep, limit: float) -> tuple[float, list[str]]:
    """The first move's share of the speeds allowed, and what is wrong with it."""
    speed = move.speed.tcp if move.velocity is None else move.velocity
    faults = []
    if speed > limit * SPEED_ROUNDING:
        faults.append(f"the move's speed is {mm(speed):g} mm/s; allowed: {mm(limit):g} mm/s")
    if move.speed.turn > BLIND_TURN_RATE * SPEED_ROUNDING:
        turn = np.rad2deg([move.speed.turn, BLIND_TURN_RATE])
        faults.append(f"the tool may turn at {turn[0]:g} deg/s; allowed: {turn[1]:g} deg/s")
    return max(speed / limit, float(move.speed.turn / BLIND_TURN_RATE)), faults


def _shares(task: TaskText, move: MoveStep) -> tuple[float, list[str]]:
    """Check the fraction of the axes' speeds that a PTP (KRL) or movej (URScript) states."""
    if move.speed.axes is None:
        return 0.0, [f"{move.kind} does not state shares of the axes' speeds; PTP or movej does"]
    fastest = max(move.speed.axes)
    axis = int(np.argmax(move.speed.axes)) + 1
    what = f"axis {axis} goes at {100.0 * fastest:g} % of its speed; allowed: {100.0 * BLIND_SPEED_SHARE:g} %"
    return fastest / BLIND_SPEED_SHARE, [what] if fastest > BLIND_SPEED_SHARE * SPEED_ROUNDING else []


def _stated(move: MoveStep) -> list[str]:
    """What is wrong with speeds of a move that has no way of its own to hold them against."""
    faults = []
    if move.by_joints and move.time is not None:
        faults.append("a joint move states its time, and takes it however far it goes; state a speed")
    speed = move.speed
    fits = 0.0 < speed.linear <= LINEAR * SPEED_ROUNDING and 0.0 < speed.rotary <= ROTARY * SPEED_ROUNDING
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


_ZERO_WAY, _ZERO_TURN = 1e-8, 1e-9
TRACK_AHEAD = 5e-3
"""A track that goes along may begin to round a corner so far [m] before its tool does, as in z10: the replay
has both begin at once, and the base is off by a quarter of that at most."""
_ZONE_SLACK = 1e-6
"""[m] moves are as long as their rounded coordinates say; controllers shorten a corner that is larger."""


@rule("verify.move_kinds")
def move_kinds(context: Context) -> Outcome:
    """Only moves whose path is known: MoveAbsJ, and MoveL with ConfL as the arm needs it; no \\Conc, no
    external axes but tracks and turntables. KRL: PTP, and LIN or SLIN; URScript: movej, no faster up than
    the axes may, and movel."""
    issues = []
    for task in context.job.tasks:
        if task.text.language != "rapid":
            if not outer_axes(task.arm, context.problem.cell.turntable):  # else verify.external_axes looks
                issues += krl_moves.move_kinds(task)
            issues += krl_moves.accelerations(task)
            continue
        wanted = "off" if task.arm.data.unnamed else "on"
        state = "on"
        stated = False
        for step in task.steps:
            if isinstance(step, SettingStep) and step.kind == "ConfL":
                state, stated = step.switches[0], True
            if not isinstance(step, MoveStep):
                continue
            if step.kind == "MoveJ":
                issues.append(
                    at_step("verify.move_kinds", "the path of MoveJ is not known; use MoveL", task, step)
                )
            for switch in step.switches:
                if switch in REFUSED_OPTIONS:
                    issues += [at_step("verify.move_kinds", REFUSED_OPTIONS[switch], task, step)]
            used = np.abs(step.target.external - UNUSED_AXIS) > 1e3  # in single precision 9E9 is off by 512
            known = isinstance(step.target, RobTarget | JointTarget)
            known = known and not outer_axes(task.arm, context.problem.cell.turntable)
            if known and used.any():
                issues.append(at_step("verify.move_kinds", "the target moves an external axis", task, step))
            if step.kind == "MoveL" and (state != wanted or not stated):
                message = (
                    f"ConfL is {state if stated else 'not stated'}; this arm needs "
                    f"ConfL\\{wanted.capitalize()}"
                )
                issues.append(at_step("verify.move_kinds", message, task, step))
                break
    return Outcome(tuple(issues))


@rule("verify.zone_size")
def zone_size(context: Context) -> Outcome:
    """A zone takes at most half of the shorter one of the moves that meet in it, and that of a track that
    goes along begins where that of the tool does, to 5 mm."""
    issues, worst = [], 0.0
    for _, _, task, moves in context.moves():
        if task.text.language == "krl":
            found, over = krl_moves.corners(task, moves)
            issues += found
            worst = max(worst, over)
            continue
        if task.text.language == "trajectories":
            continue  # no corner is rounded there
        ways = [straight_way(a, b) for a, b in itertools.pairwise(moves)]
        rides = any(axis.follow is not None for axis in outer_axes(task.arm, None))
        for i, move in enumerate(moves):
            if move.zone.fine:
                continue
            apart = move.zone.external - max(move.zone.tcp, 0.0)
            if rides and (apart > TRACK_AHEAD + _ZONE_SLACK or move.zone.linear < 0.0):
                what = (
                    f"zone {move.zone_name} has the track leave its way {mm(move.zone.external):g} mm from "
                )
                what += (
                    f"the target, and the tool {mm(move.zone.tcp):g} mm; allowed are {mm(TRACK_AHEAD):g} mm "
                )
                what += "more, and no length below 0"
                issues.append(at_step("verify.zone_size", what, task, move))
            sizes = (move.zone.tcp, move.zone.turn, move.zone.turn_angle)
            if min(sizes) < 0.0 or max(sizes) <= 0.0:
                what = f"zone {move.zone_name} has a size of nothing or less, and is no stop"
                issues.append(at_step("verify.zone_size", what, task, move))
            near = [way for way in ways[max(i - 1, 0) : i + 1] if way is not None]
            half = 0.5 * min(near) if near else 0.0
            size = max(move.zone.tcp, move.zone.turn, 0.0)
            worst = max(worst, mm(size - half))
            if size > half + _ZONE_SLACK:
                message = (
                    f"zone {move.zone_name} is {mm(size):g} mm; half of the shorter move is {mm(half):.4f} mm"
                )
                issues.append(at_step("verify.zone_size", message, task, move))
    return Outcome(tuple(issues), worst, 0.0, "mm over")


@rule("verify.zero_length")
def zero_length(context: Context) -> Outcome:
    """No move goes nowhere with all arms, but to where a goal of trajectories begins, and no movel of
    URScript, of which no manual says what it does."""
    issues = []
    for stage in context.job.stages:
        rows = [(task, stage.moves(task.name)) for task in context.job.tasks if stage.moves(task.name)]
        for group in [rows] if stage.synchronised else [[row] for row in rows]:
            for i in range(1, min((len(moves) for _, moves in group), default=0)):
                still = [(task, moves[i]) for task, moves in group if _still(moves[i - 1], moves[i])]
                if all(move.kind in trajectory_flow.BEGINS.values() for _, move in still):
                    continue
                if len(still) == len(group):
                    task, move = still[0]
                    issues.append(at_step("verify.zero_length", "the move goes nowhere", task, move))
                    continue
                what = f"the movel goes nowhere; {STAND} waits in place of it"
                alone = (
                    (task, move)
                    for task, move in still
                    if task.text.language == "urscript" and move.kind != STAND
                )
                issues += [at_step("verify.zero_length", what, task, move) for task, move in alone]
    return Outcome(tuple(issues))


def _still(a: MoveStep, b: MoveStep) -> bool:
    if isinstance(a.target, JointTarget) and isinstance(b.target, JointTarget):
        outer = np.abs(a.target.external - b.target.external).max() > 0.0  # a track goes
        return not outer and bool(np.abs(a.target.joints - b.target.joints).max() < _ZERO_TURN)
    if isinstance(a.target, PassedTarget) and isinstance(b.target, PassedTarget):
        return bool(np.abs(a.target.joints - b.target.joints).max() < _ZERO_TURN)
    if isinstance(a.target, RobTarget | StatusTarget) and isinstance(b.target, RobTarget):
        turn = min(np.abs(a.target.quaternion - s * b.target.quaternion).max() for s in (1.0, -1.0))
        way = straight_way(a, b)
        return way is not None and way < _ZERO_WAY and bool(turn < _ZERO_TURN)
    return False
