"""Rules on moves: verify.unknown_start, move_kinds, zone_size and zero_length.

verify.unknown_start looks at moves by joints: the text states their speeds only, and the position before
the first one is unknown.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from planner.issues import Issue
from planner.programs.stages import TaskText
from planner.programs.steps import JointTarget, MoveStep, PassedTarget, RobTarget, StatusTarget
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import outer_axes
from planner.proof.language_contribution import checked, of_task
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
SPEED_ROUNDING = 1.0 + 1e-6
"""Speeds may be higher by this factor: they are rounded."""


@rule("verify.unknown_start")
def unknown_start(context: Context) -> Outcome:
    """The first move of each arm begins where its start is not known, so it is no faster than what it states:
    250 mm/s and 45 deg/s, or less where the problem allows less; KRL and URScript 10 % of each axis. Joint
    moves state no times."""
    found, worst = list[Issue](), 0.0
    told: dict[str, list[str]] = {}
    none = "nothing moves"
    for task in context.job.tasks:
        one = of_task(task).checks.get(UNKNOWN_START, _axis_shares)(context, task)
        found += one.issues
        worst = max(worst, one.worst or 0.0)
        none = one.nothing or none
        if one.where:
            told.setdefault(one.where, []).append(task.arm.name)
    words = "; ".join(f"{stated} ({', '.join(arms)})" for stated, arms in told.items())
    where, nothing = f"start not known: at most {words}", "" if told else none
    return Outcome(tuple(found), 100.0 * worst, 100.0, "% of the speed allowed", where, nothing)


def _axis_shares(context: Context, task: TaskText) -> Outcome:
    """Check the fraction of the axes' speeds that the first move states, a PTP (KRL) or movej (URScript)."""
    move = next((step for step in task.steps if isinstance(step, MoveStep)), None)
    if move is None:
        return Outcome()
    if move.speed.axes is None:
        what = f"{move.kind} does not state shares of the axes' speeds; PTP or movej does"
        return unknown_start_outcome(task, move, 0.0, [what])
    fastest = max(move.speed.axes)
    axis = int(np.argmax(move.speed.axes)) + 1
    what = f"axis {axis} goes at {100.0 * fastest:g} % of its speed; allowed: {100.0 * BLIND_SPEED_SHARE:g} %"
    faults = [what] if fastest > BLIND_SPEED_SHARE * SPEED_ROUNDING else []
    return unknown_start_outcome(task, move, fastest / BLIND_SPEED_SHARE, faults)


def unknown_start_outcome(task: TaskText, move: MoveStep, share: float, faults: Sequence[str]) -> Outcome:
    """Return what was found about the first move of a task.

    Args:
        task: The task.
        move: Its first move.
        share: Its speed as a fraction of the allowed one.
        faults: What is wrong with it.
    """
    issues = tuple(at_step(UNKNOWN_START, f"start not known: {fault}", task, move) for fault in faults)
    return Outcome(issues, share, where=_words(move))


def _words(move: MoveStep) -> str:
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
    issues = list[Issue]()
    for task in context.job.tasks:
        issues += checked("verify.move_kinds", context, task).issues
        issues += _accelerations(task)
    return Outcome(tuple(issues))


def _accelerations(task: TaskText) -> list[Issue]:
    """Return the moves by joints that ask for more of their leading axis than every axis has."""
    limit, out = float(np.min(task.arm.data.acceleration)), []
    for step in task.steps:
        if isinstance(step, MoveStep) and step.acceleration is not None and step.acceleration > limit:
            given, most = np.rad2deg([step.acceleration, limit])
            what = f"the leading axis is to accelerate by {given:.1f} deg/s^2; allowed: {most:.1f}"
            out.append(at_step("verify.move_kinds", what, task, step))
    return out


@rule("verify.zone_size")
def zone_size(context: Context) -> Outcome:
    """A zone takes at most half of the shorter one of the moves that meet in it, and that of a track that
    goes along begins where that of the tool does, to 5 mm."""
    issues, worst = [], 0.0
    for _, _, task, moves in context.moves():
        if task.text.is_trajectory:
            continue  # no corner is rounded there
        find_corners = of_task(task).corners
        if find_corners is not None:
            found, over = find_corners(task, moves)
            issues += found
            worst = max(worst, over)
            continue
        ways = [straight_way(a, b) for a, b in itertools.pairwise(moves)]
        rides = any(axis.follow is not None for axis in outer_axes(task.arm, None))
        for i, move in enumerate(moves):
            if move.zone.fine:
                continue
            apart = move.zone.external - max(move.zone.tcp, 0.0)
            if rides and (apart > TRACK_AHEAD + _ZONE_SLACK or move.zone.linear < 0.0):
                what = (
                    f"zone {move.zone_name} has the track leave its way {mm(move.zone.external):g} mm from "
                    f"the target, and the tool {mm(move.zone.tcp):g} mm; allowed are {mm(TRACK_AHEAD):g} mm "
                    "more, and no length below 0"
                )
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
                if all(move.kind in of_task(task).begins for task, move in still):
                    continue
                if len(still) == len(group):
                    task, move = still[0]
                    issues.append(at_step("verify.zero_length", "the move goes nowhere", task, move))
                    continue
                for task, move in still:
                    what = of_task(task).stands_still(move)
                    issues += [at_step("verify.zero_length", what, task, move)] if what else []
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
