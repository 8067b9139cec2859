"""Rules on the replayed motion of the joints and tools."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import robot
from planner.issues import Issue
from planner.verify import machines
from planner.verify.arm_ik import singularity_distance
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_node, at_sample, at_step
from planner.verify.rules_setup import at_home
from planner.verify.steps import MoveStep

FloatArray = NDArray[np.float64]

JUMP = np.deg2rad(8.0)
"""A joint that turns farther than this from one sample to the next (4 ms) has changed its solution, not
moved."""
TCP_SLACK = 1.10
"""The replay's ramps may exceed the planned speed between targets by this factor."""
TURN = np.deg2rad(90.0)
"""Fastest turning that may be stated for moves that have no time: what a tool has far from its TCP moves
with it."""
KINEMATICS = 1e-6
_DRAKE_SAMPLES = 200
_CHUNK = 65_536
"""Samples that are worked out at once where much is needed on the way."""


def reach(context: Context) -> Outcome:
    """The arms can go the path that the text states."""
    issues = [
        Issue("verify.reach", fault.message, file=fault.task, line=fault.line, index=fault.index)
        for fault in context.motion.faults
        if fault.kind in ("reach", "motion")
    ]
    return Outcome(tuple(issues))


def corners(context: Context) -> Outcome:
    """No zone joins a joint move and a straight one."""
    issues = [
        Issue(
            "verify.corner",
            fault.message,
            file=fault.task,
            line=fault.line,
            index=fault.index,
            hint="stop there",
        )
        for fault in context.motion.faults
        if fault.kind == "corner"
    ]
    return Outcome(tuple(issues))


def continuity(context: Context) -> Outcome:
    """The joints go on from where they were, from home to home: no jump between samples or moves."""
    motion = context.motion
    issues, worst = [], 0.0
    for task in context.job.tasks:
        moves = [step for step in task.steps if isinstance(step, MoveStep)]
        for move, word in zip((*moves[:1], *moves[-1:]), ("first", "last"), strict=False):
            if not at_home(move, robot(task.arm.robot), task.arm.home):
                what = f"the {word} move of {task.arm.name} does not go home by its joints"
                issues.append(at_step("verify.continuity", what, task, move))
    for arm, q in motion.q.items():
        step = np.diff(q, axis=0)
        np.abs(step, out=step)
        if not len(step):
            continue
        worst = max(worst, float(np.rad2deg(step.max())))
        for i in np.flatnonzero((step > JUMP).any(axis=1))[:20]:
            joint = int(np.argmax(step[i]))
            message = f"axis {joint + 1} jumps by {np.rad2deg(step[i, joint]):.2f} deg between two samples"
            issues.append(
                at_sample(
                    "verify.continuity",
                    message,
                    context.motion,
                    arm,
                    int(i) + 1,
                    (float(np.rad2deg(step[i, joint])), float(np.rad2deg(JUMP)), "deg"),
                    (f"axis {joint + 1}",),
                )
            )
    return Outcome(tuple(issues), worst, float(np.rad2deg(JUMP)), "deg")


def confdata(context: Context) -> Outcome:
    """RAPID: confdata alone select the joint solution that the motion has at each target."""
    motion = context.motion
    issues, worst = [], 0.0
    for task in context.job.tasks:
        arm = task.arm.name
        if task.krl is not None:
            continue  # verify.status asks the same of KRL
        if robot(task.arm.robot).coupling is not None:
            continue  # cfx of parallel-rod arms is not settled; the programs run with ConfL\Off
        selected, here = motion.node_conf_q[arm], motion.q[arm][motion.node_sample]
        straight = _straight(context, arm)
        none = straight & ~np.isfinite(selected).all(axis=1)
        far = np.abs(np.where(np.isfinite(selected), selected, here) - here).max(axis=1)
        wrong = straight & (none | (far > JUMP) | ~motion.node_conf_ok[arm])
        worst = max(worst, float(np.rad2deg(far[straight].max()))) if straight.any() else worst
        for i in np.flatnonzero(wrong):
            what = (
                "select no joint solution" if none[i] else "select another joint solution than the motion has"
            )
            issues.append(at_node("verify.confdata", f"the confdata {what}", context.motion, arm, int(i)))
    return Outcome(tuple(issues), worst, float(np.rad2deg(JUMP)), "deg")


def joint_limits(context: Context) -> Outcome:
    """Every axis stays within its limits."""
    issues, least, where = [], np.inf, ""
    for task in context.job.tasks:
        machine, arm = robot(task.arm.robot), task.arm.name
        q = context.motion.q[arm]
        rows = np.concatenate([q.argmin(axis=0), q.argmax(axis=0)])
        margin = np.concatenate([q.min(axis=0) - machine.lower, machine.upper - q.max(axis=0)])
        k = int(np.argmin(margin))
        i, joint = int(rows[k]), k % len(machine.lower)
        if margin[k] < least:
            least, where = float(margin[k]), f"{arm} axis {joint + 1}"
        if margin[k] < 0.0:
            value, limit = (
                np.rad2deg(q[i, joint]),
                np.rad2deg((machine.lower if q[i, joint] < 0 else machine.upper)[joint]),
            )
            message = (
                f"axis {joint + 1} of {arm} is at {value:.2f} deg; allowed: "
                f"{np.rad2deg(machine.lower[joint]):g} to {np.rad2deg(machine.upper[joint]):g}"
            )
            issues.append(
                at_sample(
                    "verify.joint_limits",
                    message,
                    context.motion,
                    arm,
                    i,
                    (float(value), float(limit), "deg"),
                    (f"axis {joint + 1}",),
                )
            )
    return Outcome(tuple(issues), float(np.rad2deg(least)), 0.0, "deg margin", where)


def rod_limits(context: Context) -> Outcome:
    """Parallel-rod arms: the controller's axis 3, serial angle plus axis 2, is within its own limits too."""
    issues, least = [], np.inf
    for task in context.job.tasks:
        machine, arm = robot(task.arm.robot), task.arm.name
        if machine.coupling is None:
            continue
        axis3 = context.motion.q[arm][:, 1] + context.motion.q[arm][:, 2]
        margin = np.minimum(axis3 - machine.coupling.axis3_lower, machine.coupling.axis3_upper - axis3)
        i = int(np.argmin(margin))
        least = min(least, float(margin[i]))
        if margin[i] < 0.0:
            low, high = np.rad2deg([machine.coupling.axis3_lower, machine.coupling.axis3_upper])
            message = (
                f"axis 3 of {arm}, as the controller counts it, is at {np.rad2deg(axis3[i]):.2f} deg; "
                f"allowed: {low:g} to {high:g}"
            )
            issues.append(
                at_sample(
                    "verify.rod_limits",
                    message,
                    context.motion,
                    arm,
                    i,
                    (float(np.rad2deg(axis3[i])), float(high), "deg"),
                    ("axis 3",),
                )
            )
    if not np.isfinite(least):
        return Outcome(where="no parallel-rod arm")
    return Outcome(tuple(issues), float(np.rad2deg(least)), 0.0, "deg margin")


def joint_speed(context: Context) -> Outcome:
    """Joint speeds that the times ask for are within the robot's."""
    return _rates(context, "verify.joint_speed", "speed", context.motion.speed, "deg/s")


def joint_acceleration(context: Context) -> Outcome:
    """Joint accelerations that the times ask for are within the robot's."""
    return _rates(
        context, "verify.joint_acceleration", "acceleration", context.motion.acceleration, "deg/s^2"
    )


def _rates(context: Context, code: str, word: str, rates: Callable[[str], FloatArray], unit: str) -> Outcome:
    issues, worst, where = [], 0.0, ""
    for task in context.job.tasks:
        machine, arm = robot(task.arm.robot), task.arm.name
        limit = machine.velocity if word == "speed" else machine.acceleration
        share = rates(arm)
        np.abs(share, out=share)
        share /= limit
        i, joint = np.unravel_index(int(np.argmax(share)), share.shape)
        if share[i, joint] > worst:
            worst, where = float(share[i, joint]), f"{arm} axis {joint + 1}"
        nodes = np.unique(context.motion.node[(share > 1.0).any(axis=1)])
        for node in nodes[:200]:
            rows = np.flatnonzero(context.motion.node == node)
            k = int(rows[np.argmax(share[rows].max(axis=1))])
            axis = int(np.argmax(share[k]))
            value, most = float(np.rad2deg(share[k, axis] * limit[axis])), float(np.rad2deg(limit[axis]))
            message = (
                f"axis {axis + 1} of {arm} would need the {word} {value:.1f} {unit}; allowed: {most:.1f}"
            )
            issues.append(
                at_sample(code, message, context.motion, arm, k, (value, most, unit), (f"axis {axis + 1}",))
            )
    return Outcome(tuple(issues), 100.0 * worst, 100.0, "% of the limit", where)


def singularity(context: Context) -> Outcome:
    """The arms keep off their singular postures by the problem's margin wherever they move straight."""
    issues, least, where = [], np.inf, ""
    limit = context.problem.settings.singularity_margin
    for task in context.job.tasks:
        arm = task.arm.name
        rows = np.flatnonzero(_straight(context, arm)[context.motion.node])
        if not len(rows):
            continue
        parts = np.array_split(rows, len(rows) // _CHUNK + 1)
        machine, q = machines.of(task.arm.robot), context.motion.q[arm]
        distance = np.concatenate([singularity_distance(machine, q[part]) for part in parts])
        k = int(np.argmin(distance))
        if distance[k] < least:
            least, where = float(distance[k]), arm
        if distance[k] < limit - np.deg2rad(0.05):
            value = float(np.rad2deg(distance[k]))
            message = (
                f"{arm} comes within {value:.2f} deg of a singular posture; allowed: {np.rad2deg(limit):.2f}"
            )
            issues.append(
                at_sample(
                    "verify.singularity",
                    message,
                    context.motion,
                    arm,
                    int(rows[k]),
                    (value, float(np.rad2deg(limit)), "deg"),
                )
            )
    return Outcome(tuple(issues), float(np.rad2deg(least)), float(np.rad2deg(limit)), "deg", where)


def tcp_speed(context: Context) -> Outcome:
    """The tools move no faster than the problem allows: where the text states the time of a move by what
    follows from it, elsewhere by the speed that it states."""
    motion = context.motion
    issues, worst, where = [], 0.0, ""
    limit = context.problem.settings.tcp_speed
    for task in context.job.tasks:
        arm = task.arm.name
        timed = _timed(context)[motion.node[1:]] & (motion.stage[1:] == motion.stage[:-1])
        step = np.linalg.norm(np.diff(motion.tcp[arm].place, axis=0), axis=1)
        speed = np.where(timed, step / np.maximum(np.diff(motion.time), 1e-6), 0.0)
        if len(speed):
            k = int(np.argmax(speed))
            if speed[k] > worst:
                worst, where = float(speed[k]), arm
            if speed[k] > TCP_SLACK * limit:
                message = f"the tool of {arm} moves at {mm(speed[k]):.1f} mm/s; allowed: {mm(limit):.1f}"
                measure = (mm(speed[k]), mm(limit), "mm/s")
                issues.append(at_sample("verify.tcp_speed", message, motion, arm, k + 1, measure))
        for step_ in task.steps:
            if not isinstance(step_, MoveStep) or step_.time is not None or step_.speed.axes is not None:
                continue
            stated = step_.velocity if step_.velocity is not None else step_.speed.tcp
            if stated > limit * (1.0 + 1e-6):
                message = f"the move's speed is {mm(stated):g} mm/s; allowed: {mm(limit):g} mm/s"
                issues.append(at_step("verify.tcp_speed", message, task, step_))
            if step_.speed.turn > TURN:
                message = (
                    f"the tool may turn at {np.rad2deg(step_.speed.turn):g} deg/s in a move without a time; "
                    f"allowed: {np.rad2deg(TURN):g} deg/s"
                )
                issues.append(at_step("verify.tcp_speed", message, task, step_))
    return Outcome(tuple(issues), mm(worst), mm(limit), "mm/s", where)


def _timed(context: Context) -> NDArray[np.bool_]:
    """Moves (K,) in which some arm runs by a stated time, or by stated shares of its axes' speeds."""
    motion = context.motion
    out = np.zeros(len(motion.node_segment), dtype=bool)
    for number, stage in enumerate(context.job.stages):
        rows = np.flatnonzero(motion.node_stage == number)
        for task in context.job.tasks:
            moves = stage.moves(task.name)[: len(rows)]
            flags = [move.time is not None or move.speed.axes is not None for move in moves]
            out[rows[: len(flags)]] |= np.array(flags, dtype=bool)
    return out


def _straight(context: Context, arm: str) -> NDArray[np.bool_]:
    """Nodes (K,) that the arm reaches by a straight move."""
    key = f"_straight_{arm}"
    if key not in context.__dict__:
        lines = context.motion.node_line[arm]
        task = next(task for task in context.job.tasks if task.arm.name == arm)
        flags = np.zeros(len(lines), dtype=bool)
        place = 0
        stages = context.motion.node_stage
        for number, stage in enumerate(context.job.stages):
            moves = stage.moves(task.name)
            rows = np.flatnonzero((stages == number) & (lines > 0))
            for row, move in zip(rows, moves, strict=False):
                flags[row] = not move.by_joints
            place += len(rows)
        context.__dict__[key] = flags
    found: NDArray[np.bool_] = context.__dict__[key]
    return found
