"""Rules on the data that moves refer to and on settings: tools, work objects, base frames, zones, error
handlers."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import robot
from planner.geometry.rigid import inverse, log_rotation
from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_step
from planner.verify.rapid_steps import (
    LoadStep,
    MessageStep,
    MoveStep,
    SettingStep,
    SignalStep,
    Step,
)
from planner.verify.rapid_values import JointTarget, RobTarget
from planner.verify.rules_sync import straight_way

FloatArray = NDArray[np.float64]

FRAME_POSITION = 1e-6
"""How far a written frame may be off the problem's [m]: its last decimal."""
FRAME_ANGLE = 1e-6
MASS = 1e-3
_ZERO_WAY, _ZERO_TURN = 1e-8, 1e-9
_ZONE_SLACK = 1e-9


def tool_data(context: Context) -> Outcome:
    """All moves use the arm's own tool, with its TCP, mass and centre of gravity."""
    issues, worst = [], 0.0
    for task in context.job.tasks:
        wanted = task.arm.tool
        seen: set[str] = set()
        for step in task.steps:
            if not isinstance(step, MoveStep) or step.tool_name in seen:
                continue
            seen.add(step.tool_name)
            shift, turn = _apart(step.tool.pose, wanted.tcp)
            worst = max(worst, mm(shift))
            faults = []
            if shift > FRAME_POSITION or turn > FRAME_ANGLE:
                faults.append(f"its TCP is off by {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg")
            if not step.tool.held:
                faults.append("it is not held by the robot")
            if abs(step.tool.load.mass - wanted.mass) > MASS:
                faults.append(f"its mass is {step.tool.load.mass:g} kg, not {wanted.mass:g} kg")
            if np.abs(step.tool.load.centre - wanted.cog).max() > 1e-5:
                faults.append("its centre of gravity is not the tool's")
            issues += [
                at_step("verify.tool_data", f"tool {step.tool_name or '(in place)'}: {fault}", task, step)
                for fault in faults
            ]
    return Outcome(tuple(issues), worst, mm(FRAME_POSITION), "mm")


def work_object(context: Context) -> Outcome:
    """Straight moves are in the world or in the stock's frame, which is the same in all tasks and where the
    problem wants it."""
    issues, worst = [], 0.0
    stock = context.problem.stock
    stands = context.stock_pose
    for task, move, wobj in context.work_objects:
        frame = wobj.user @ wobj.object
        if wobj.held or not wobj.fixed:
            issues.append(at_step("verify.work_object", f"{move.wobj_name} is held or moves", task, move))
        shift, turn = _apart(frame, stands)
        if move.wobj_name.lower() != "wobj0":
            worst = max(worst, mm(shift))
            if shift > FRAME_POSITION or turn > FRAME_ANGLE:
                message = f"{move.wobj_name} is {mm(shift):.4f} mm off the stock's frame of the other task"
                issues.append(at_step("verify.work_object", message, task, move))
    if stock.place is not None:
        shift, turn = _apart(stands, stock.place)
        if context.work_objects and (shift > FRAME_POSITION or turn > FRAME_ANGLE):
            message = (
                f"the stock's frame is {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg off the problem's"
            )
            issues.append(
                Issue("verify.work_object", message, value=mm(shift), limit=mm(FRAME_POSITION), unit="mm")
            )
    else:
        tilt = float(np.linalg.norm((stands[:3, :3] @ stock.attitude.T)[2, :] - [0.0, 0.0, 1.0]))
        if tilt > 2.0 * FRAME_ANGLE and context.work_objects:
            message = f"the stock leans {np.rad2deg(tilt):.4f} deg off the attitude that the problem gives it"
            issues.append(Issue("verify.work_object", message))
    return Outcome(tuple(issues), worst, mm(FRAME_POSITION), "mm")


def base_frames(context: Context) -> Outcome:
    """Each task states the base frame that its arm must have, and it is the problem's."""
    issues, worst = [], 0.0
    for task in context.job.tasks:
        declared = context.declared_bases.get(task.arm.name)
        if declared is None:
            message = f"{task.name} does not state the base frame it was planned for (CONST pose base_frame)"
            issues.append(Issue("verify.base_frames", message, arm=task.arm.name, file=task.name))
            continue
        shift, turn = _apart(declared, task.arm.base)
        if task.arm.base_auto:
            continue
        worst = max(worst, mm(shift))
        if shift > FRAME_POSITION or turn > FRAME_ANGLE:
            message = (
                f"the base of {task.arm.name} is {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg off "
                "the problem's"
            )
            issues.append(Issue("verify.base_frames", message, arm=task.arm.name, file=task.name))
    return Outcome(tuple(issues), worst, mm(FRAME_POSITION), "mm")


def move_kinds(context: Context) -> Outcome:
    """Only moves whose path is known: MoveAbsJ, and MoveL with ConfL as the arm needs it; no \\Conc, no
    external axes."""
    issues = []
    for task in context.job.tasks:
        wanted = "off" if robot(task.arm.robot).coupling is not None else "on"
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
            if "conc" in step.switches:
                issues.append(
                    at_step("verify.move_kinds", "\\Conc lets logic run ahead of the motion", task, step)
                )
            if isinstance(step.target, RobTarget | JointTarget) and (step.target.external < 8.9e9).any():
                issues.append(at_step("verify.move_kinds", "the target moves an external axis", task, step))
            if step.kind == "MoveL" and (state != wanted or not stated):
                message = (
                    f"ConfL is {state if stated else 'not stated'}; this arm needs "
                    f"ConfL\\{wanted.capitalize()}"
                )
                issues.append(at_step("verify.move_kinds", message, task, step))
                break
    return Outcome(tuple(issues))


def zone_size(context: Context) -> Outcome:
    """A zone takes at most half of the shorter one of the moves that meet in it."""
    issues, worst = [], 0.0
    for _, _, task, moves in context.moves():
        ways = [straight_way(a, b) for a, b in itertools.pairwise(moves)]
        for i, move in enumerate(moves):
            if move.zone.fine:
                continue
            near = [way for way in ways[max(i - 1, 0) : i + 1] if way is not None]
            half = 0.5 * min(near) if near else 0.0
            size = max(move.zone.tcp, 0.0)
            worst = max(worst, mm(size - half))
            if size > half + _ZONE_SLACK:
                message = (
                    f"zone {move.zone_name} is {mm(size):g} mm; half of the shorter move is {mm(half):.4f} mm"
                )
                issues.append(at_step("verify.zone_size", message, task, move))
    return Outcome(tuple(issues), worst, 0.0, "mm over")


def zero_length(context: Context) -> Outcome:
    """No move goes nowhere with all arms."""
    issues = []
    for stage in context.job.stages:
        rows = [(task, stage.moves(task.name)) for task in context.job.tasks if stage.moves(task.name)]
        for group in [rows] if stage.synchronised else [[row] for row in rows]:
            for i in range(1, min((len(moves) for _, moves in group), default=0)):
                if all(_still(moves[i - 1], moves[i]) for _, moves in group):
                    task, moves = group[0]
                    issues.append(at_step("verify.zero_length", "the move goes nowhere", task, moves[i]))
    return Outcome(tuple(issues))


def error_handler(context: Context) -> Outcome:
    """Every procedure has an error handler that switches the power off first, stops, and does not go on."""
    issues = []
    signals = sorted({claim.signal for claim in context.contacts})
    for task in context.job.tasks:
        for module in task.modules:
            for procedure in module.procedures:
                handler = task.handlers.get((module.name, procedure.name))
                faults = ["it has none"] if handler is None else _handler_faults(handler, signals)
                issues += [
                    Issue(
                        "verify.error_handler",
                        f"error handler of {procedure.name}: {fault}",
                        arm=task.arm.name,
                        file=f"{task.name}/{module.name}",
                        line=procedure.line,
                        field=procedure.name,
                    )
                    for fault in faults
                ]
    return Outcome(tuple(issues))


def _handler_faults(steps: tuple[Step, ...], signals: list[str]) -> list[str]:
    faults = []
    head = [s for s in steps if not isinstance(s, MessageStep) or s.confirm][: len(signals)]
    off = {
        s.signal.lower()
        for s in head
        if isinstance(s, SignalStep) and not (s.value or s.condition or s.delay)
    }
    faults += [
        f"it does not switch {signal} off before anything else"
        for signal in signals
        if signal.lower() not in off
    ]
    if any(isinstance(step, SignalStep) and step.value for step in steps):
        faults.append("it switches something on")
    if any(isinstance(step, MoveStep | LoadStep) for step in steps):
        faults.append("it moves an arm")
    kinds = {step.kind for step in steps if isinstance(step, SettingStep)}
    if kinds & {"RETRY", "TRYNEXT", "StartMove", "RETURN"}:
        faults.append("it goes on with the program")
    if "StopMove" not in kinds:
        faults.append("it does not stop the motion (StopMove)")
    if not kinds & {"EXIT", "Stop", "RAISE"}:
        faults.append("it does not end the program")
    return faults


def motion_settings(context: Context) -> Outcome:
    """Nothing makes the moves slower than their times say (AccSet or VelSet below 100 %)."""
    message = "AccSet and VelSet below 100 % make the moves slower than their times say"
    issues = [
        at_step("verify.motion_settings", message, task, step)
        for task in context.job.tasks
        for step in task.steps
        if isinstance(step, SettingStep)
        and (
            (step.kind == "AccSet" and min(step.values, default=0.0) < 100.0)
            or (step.kind == "VelSet" and step.values[0] < 100.0)
        )
    ]
    return Outcome(tuple(issues))


def _apart(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    relative = inverse(a) @ b
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])), float(np.linalg.norm(log_rotation(relative[:3, :3])))


def _still(a: MoveStep, b: MoveStep) -> bool:
    if isinstance(a.target, JointTarget) and isinstance(b.target, JointTarget):
        return bool(np.abs(a.target.joints - b.target.joints).max() < _ZERO_TURN)
    if isinstance(a.target, RobTarget) and isinstance(b.target, RobTarget):
        turn = min(np.abs(a.target.quaternion - s * b.target.quaternion).max() for s in (1.0, -1.0))
        way = straight_way(a, b)
        return way is not None and way < _ZERO_WAY and bool(turn < _ZERO_TURN)
    return False
