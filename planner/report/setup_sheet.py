"""The setup sheet: what an operator mounts where, lengths to cut, what to set, poses to measure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner import catalogue
from planner.claims import WireJoins
from planner.geometry.rigid import to_quaternion, to_rpy
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Problem
from planner.report import exhibits, markup
from planner.report.inputs import operation_starts
from planner.report.markup import Raw
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]
_FILL = Raw('<span class="fill"></span>')
_STEPS = {
    "confirm": "the program waits for the operator",
    "message": "message",
    "on": "signal on",
    "off": "signal off",
    "wait": "wait",
}


def sheet(problem: Problem, plan: Plan) -> Raw:
    """All of the setup sheet for a plan."""
    parts = [
        markup.figure("Robots and tools", _tools(problem, plan)),
        markup.figure("Block", _block(problem, plan)),
    ]
    starts = operation_starts(plan)
    for operation, start in zip(plan.operations, starts, strict=True):
        title = f"Operation {operation.name}" if len(plan.operations) > 1 else "Work"
        parts.append(markup.figure(title, _work(problem, operation)))
        parts.append(markup.figure("Stops with something to do", _stops(operation, start)))
    parts.append(markup.figure("Measure before the first run", _measure(problem, plan)))
    return Raw("".join(f'<div style="margin-bottom:20px">{part}</div>' for part in parts))


def pose_cells(pose: FloatArray) -> tuple[Raw, Raw, Raw]:
    """Position [mm], roll-pitch-yaw [deg] and quaternion of a pose (4, 4) as text."""
    place = ", ".join(markup.fixed(float(v) / MM, 2) for v in pose[:3, 3])
    turn = ", ".join(markup.fixed(float(v) / DEG, 3) for v in to_rpy(pose[:3, :3]))
    quaternion = ", ".join(markup.fixed(float(v), 6) for v in to_quaternion(pose[:3, :3]))
    return Raw(place), Raw(turn), Raw(quaternion)


def _tools(problem: Problem, plan: Plan) -> Raw:
    tools, frames = [], []
    for arm in problem.cell.arms:
        robot = catalogue.robot(arm.robot)
        cog = ", ".join(markup.fixed(float(v) / MM, 1) for v in arm.tool.cog)
        tools.append((arm.name, robot.title, robot.controller, arm.tool.name, arm.tool.mass, Raw(cog)))
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        frames.append((f"{arm.name}: TCP on the flange", *pose_cells(arm.tool.tcp)))
        frames.append((f"{arm.name}: base in the world", *pose_cells(base)))
    heads = ("arm", "robot", "controller", "tool", "mass [kg]", "centre of gravity on the flange [mm]")
    poses = ("frame", "x, y, z [mm]", "roll, pitch, yaw [deg]", "quaternion w, x, y, z")
    return Raw(markup.table(heads, tools) + markup.table(poses, frames))


def _block(problem: Problem, plan: Plan) -> Raw:
    size = " × ".join(markup.fixed(float(v) / MM, 1) for v in problem.stock.size)
    place, turn, quaternion = pose_cells(np.asarray(plan.stock_pose))
    return markup.facts(
        [
            ("size x × y × z [mm]", Raw(size)),
            ("frame", "centre of the bottom face, z up through the block"),
            ("place in the world x, y, z [mm]", place),
            ("roll, pitch, yaw [deg]", turn),
            ("quaternion w, x, y, z", quaternion),
            ("place chosen by", "the problem" if problem.stock.place is not None else "the placement search"),
        ]
    )


def _work(problem: Problem, operation: OperationPlan) -> Raw:
    targets = operation.targets
    items: list[tuple[object, object]] = []
    joins = [c for c in targets.claims if isinstance(c, WireJoins)]
    for wire in joins:
        items += [
            ("hot length between the clamps", Raw(f"{markup.fixed(wire.length / MM, 2)} mm")),
            ("thickness in the bending plane", Raw(f"{markup.fixed(wire.thickness / MM, 3)} mm")),
            ("section", "round, may spin" if wire.round_section else "strip, must not spin"),
            ("least bend radius", Raw(f"{markup.fixed(1.0 / wire.max_curvature / MM, 1)} mm")),
            ("end error allowed for", Raw(f"{markup.fixed(wire.end_error / MM, 2)} mm")),
        ]
        items += _mount(problem, operation, wire)
    items += exhibits.setup_items(targets.exhibits)
    signals = dict.fromkeys(a.signal for a in targets.actions if a.signal)
    items += (
        [("signals", Raw(", ".join(f"<code>{markup.text(s)}</code>" for s in signals)))] if signals else []
    )
    waits = sum(a.seconds for a in targets.actions)
    items += [("waits in all", f"{markup.fixed(waits, 1)} s")] if waits else []
    named = zip(problem.cell.arms, problem.cell.controller.tasks, strict=False)
    tasks = ", ".join(f"{arm.name}: {task}" for arm, task in named)
    return markup.facts([*items, ("tasks", tasks)])


def _mount(problem: Problem, operation: OperationPlan, wire: WireJoins) -> list[tuple[object, object]]:
    """How the TCPs stand to each other at the first target, where the wire is mounted."""
    poses = [_tcp(problem.cell.arm(arm), operation.q[arm][0]) for arm in wire.arms]
    gap = poses[1][:3, 3] - poses[0][:3, 3]
    distance = float(np.linalg.norm(gap))
    out: list[tuple[object, object]] = [
        ("as planned: distance of the TCPs at the mount", Raw(f"{markup.fixed(distance / MM, 2)} mm"))
    ]
    if distance > 1e-6:
        for arm, pose in zip(wire.arms, poses, strict=True):
            angle = np.arccos(np.clip(pose[:3, 0] @ gap / distance, -1.0, 1.0)) / DEG
            out.append(
                (
                    f"as planned: TCP of {arm} to the line between them",
                    Raw(f"{markup.fixed(float(angle), 2)}°"),
                )
            )
    return out


def _tcp(arm: Arm, q: FloatArray) -> FloatArray:
    from planner.cell.robots import forward

    return np.asarray(arm.base @ forward(catalogue.robot(arm.robot), q) @ arm.tool.tcp)


def _stops(operation: OperationPlan, start: float) -> Raw:
    rows = []
    for action in operation.targets.actions:
        what = action.text or action.signal or (f"{action.seconds:g} s" if action.kind == "wait" else "")
        time = Raw(markup.fixed(float(operation.time[action.at]) + start, 1))
        rows.append((time, operation.targets.name(action.at), _STEPS[action.kind], what))
    return markup.table(("motion time [s]", "at target", "", "what"), rows) if rows else Raw("<p>none</p>")


def _measure(problem: Problem, plan: Plan) -> Raw:
    rows = []
    for operation in plan.operations[:1]:
        for arm in problem.cell.arms:
            if arm.name not in operation.q:
                continue
            q = catalogue.robot(arm.robot).to_controller(operation.q[arm.name][0])
            angles = ", ".join(markup.fixed(float(v) / DEG, 3) for v in q)
            base = np.asarray(plan.bases.get(arm.name, arm.base))
            placed = Arm(arm.name, arm.robot, base, arm.tool, arm.home)
            place, turn, _ = pose_cells(_tcp(placed, operation.q[arm.name][0]))
            name = operation.targets.name(0)
            rows.append((f"{arm.name}: TCP at {name}, world", place, turn, Raw(angles), _FILL))
    half = 0.5 * problem.stock.size
    for label, corner in (
        ("block, bottom corner −x −y", [-half[0], -half[1], 0.0]),
        ("block, bottom corner +x −y", [half[0], -half[1], 0.0]),
        ("block, bottom corner −x +y", [-half[0], half[1], 0.0]),
        ("block, top corner −x −y", [-half[0], -half[1], 2 * half[2]]),
    ):
        point = plan.stock_pose @ np.array([*corner, 1.0])
        place = Raw(", ".join(markup.fixed(float(v) / MM, 2) for v in point[:3]))
        rows.append((f"{label}, world", place, Raw(""), Raw(""), _FILL))
    heads = ("what", "x, y, z [mm]", "roll, pitch, yaw [deg]", "axes on the controller [deg]", "measured")
    return markup.table(heads, rows)
