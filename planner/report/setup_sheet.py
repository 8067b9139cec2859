"""The setup sheet: per setup what the operator does, mounts, clamps and measures, and how the work goes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import robot
from planner.claims import (
    CutsSurface,
    FeedWindow,
    HoldsStock,
    StraightWire,
    WireJoins,
)
from planner.plans import OperationPlan, Plan
from planner.problem import Problem, Setup
from planner.report import exhibits, markup, standing
from planner.report.inputs import kerf_shown, operation_starts
from planner.report.markup import Raw
from planner.report.setup_controller import checks
from planner.report.setup_tables import block, measure, tools
from planner.units import DEG, MM
from planner.verify.result import Proof

FloatArray = NDArray[np.float64]
_STEPS = {
    "confirm": "the program waits for the operator",
    "message": "message",
    "on": "signal on",
    "off": "signal off",
    "wait": "wait",
}


def sheet(problem: Problem, plan: Plan, proof: Proof | None = None) -> Raw:
    """All of the setup sheet for a plan, a part for each setup."""
    starts = operation_starts(plan)
    parts = []
    for setup in problem.setups:
        made = [i for i in setup.operations if i < len(plan.operations)]
        if not made:
            continue
        if len(problem.setups) > 1:
            names = ", ".join(plan.operations[i].name for i in made)
            parts.append(Raw(f"<h3>Setup {setup.number}: {markup.text(names)}</h3>"))
        if setup.steps:
            parts.append(markup.figure("To do, with all arms at home", _steps(setup)))
        parts.append(markup.figure("Robots and tools", tools(setup, plan)))
        parts.append(markup.figure("Block", block(setup, plan, _holds(setup, plan))))
        for index in made:
            operation = plan.operations[index]
            title = f"Operation {operation.name}" if len(plan.operations) > 1 else "Work"
            parts.append(markup.figure(title, _work(problem, setup, plan, operation, proof)))
            parts.append(markup.figure("Stops with something to do", _stops(operation, starts[index])))
        if setup.number == 1:
            parts.append(markup.figure("Controllers, before the first run", checks(problem, plan)))
        parts.append(markup.figure("Measure before the first run", measure(setup, plan, made[0])))
    return Raw("".join(f'<div style="margin-bottom:20px">{part}</div>' for part in parts))


def _steps(setup: Setup) -> Raw:
    """What the operator does, and what the program then asks."""
    rows = "".join(f"<li>{markup.text(step)}</li>" for step in setup.steps)
    return Raw(f"<ol>{rows}</ol><p>The program asks: <b>{markup.text(setup.confirmation)}</b></p>")


def _holds(setup: Setup, plan: Plan) -> HoldsStock | None:
    """What the controller is told of a held block."""
    for index in setup.operations:
        for claim in plan.operations[index].targets.claims if index < len(plan.operations) else ():
            if isinstance(claim, HoldsStock):
                return claim
    return None


def _work(problem: Problem, setup: Setup, plan: Plan, operation: OperationPlan, proof: Proof | None) -> Raw:
    targets = operation.targets
    items: list[tuple[object, object]] = []
    for claim in targets.claims:
        if isinstance(claim, WireJoins):
            items += _bent(claim) + _mount(setup, plan, operation, claim)
        elif isinstance(claim, StraightWire):
            items += _straight(claim)
    own = exhibits.setup_items(targets.exhibits)
    straight = any(isinstance(claim, StraightWire) for claim in targets.claims)
    # the straight wire's process says all this by itself
    items += own if own and straight else [*_cutting(operation, proof), *own]
    signals = dict.fromkeys(a.signal for a in targets.actions if a.signal)
    items += (
        [("signals", Raw(", ".join(f"<code>{markup.text(s)}</code>" for s in signals)))] if signals else []
    )
    waits = sum(a.seconds for a in targets.actions)
    items += [("waits in all", f"{markup.fixed(waits, 1)} s")] if waits else []
    return markup.facts([*items, *_controllers(problem), *_wires(problem)])


def _controllers(problem: Problem) -> list[tuple[object, object]]:
    """Tasks of ABB's arms; of KUKA's the dialect, what the controller must have, and numbers of signals."""
    controller = problem.cell.controller
    krl = [arm.name for arm in problem.cell.arms if robot(arm.robot).family == "KUKA"]
    named = [
        f"{arm.name}: {task}"
        for arm, task in zip(problem.cell.arms, controller.tasks, strict=False)
        if arm.name not in krl
    ]
    out: list[tuple[object, object]] = [("tasks", ", ".join(named))] if named else []
    dialect = {"krc4": "KRC4, KSS 8.3 on", "krc2": "KRC2"}[controller.dialect]
    for arm in krl:
        numbers = controller.io.get(arm, {})
        listed = "".join(f"; {signal} is number {number}" for signal, number in numbers.items())
        blocks = "; spline blocks, not seen on a controller" if controller.path == "spline" else ""
        out.append((f"KRL of {arm}", f"{dialect}; $ROBROOT zero{listed}{blocks}"))
    return out


def _wires(problem: Problem) -> list[tuple[object, object]]:
    """The wires between two controllers that meet by handshake."""
    controller = problem.cell.controller
    if controller.sync != "handshake":
        return []
    arms = [arm.name for arm in problem.cell.arms]
    wires = (*controller.handshake.wired(arms), *controller.handshake.wired_running(arms))
    shown = ", ".join(f"{w.output} of {w.source} to {w.input} of {w.sink}" for w in wires)
    return [("wires between the controllers", shown)]


def _bent(wire: WireJoins) -> list[tuple[object, object]]:
    return [
        ("hot length between the clamps", Raw(f"{markup.fixed(wire.length / MM, 2)} mm")),
        ("thickness in the bending plane", Raw(f"{markup.fixed(wire.thickness / MM, 3)} mm")),
        ("section", "round, may spin" if wire.round_section else "strip, must not spin"),
        ("least bend radius", Raw(f"{markup.fixed(1.0 / wire.max_curvature / MM, 1)} mm")),
        ("end error allowed for", Raw(f"{markup.fixed(wire.end_error / MM, 2)} mm")),
    ]


def _straight(wire: StraightWire) -> list[tuple[object, object]]:
    length = float(np.linalg.norm(wire.end - wire.start))
    return [
        ("bow on", wire.arm),
        ("straight wire between the clamps", Raw(f"{markup.fixed(length / MM, 1)} mm")),
        ("clamps stay clear of the block by", Raw(f"{markup.fixed(wire.margin / MM, 1)} mm")),
    ]


def _cutting(operation: OperationPlan, proof: Proof | None) -> list[tuple[object, object]]:
    """Range of speeds in the foam, and of the kerf that they make."""
    claims = operation.targets.claims
    windows = [c for c in claims if isinstance(c, FeedWindow) and c.segment.kind == "cut"]
    cuts = [c for c in claims if isinstance(c, CutsSurface)]
    out: list[tuple[object, object]] = []
    if windows:
        low, high = min(w.lower for w in windows) / MM, max(w.upper for w in windows) / MM
        speeds = f"{markup.fixed(low, 1)} to {markup.fixed(high, 1)} mm/s"
        out.append(("speed of the wire in the foam", Raw(speeds)))
    if cuts:
        name, width = kerf_shown(cuts, windows, proof)
        out.append((name, Raw(f"{markup.text(width)} mm")))
    return out


def _mount(
    setup: Setup, plan: Plan, operation: OperationPlan, wire: WireJoins
) -> list[tuple[object, object]]:
    """How the TCPs stand to each other at the first target, where the wire is mounted."""
    arms = [setup.cell.arm(name) for name in wire.arms]
    poses = [standing.flanges(arm, plan.bases, operation.q[arm.name][0]) @ arm.tool.tcp for arm in arms]
    gap = poses[1][:3, 3] - poses[0][:3, 3]
    distance = float(np.linalg.norm(gap))
    out: list[tuple[object, object]] = [
        ("as planned: distance of the TCPs at the mount", Raw(f"{markup.fixed(distance / MM, 2)} mm"))
    ]
    if distance > 1e-6:
        for name, pose in zip(wire.arms, poses, strict=True):
            angle = np.arccos(np.clip(pose[:3, 0] @ gap / distance, -1.0, 1.0)) / DEG
            words = f"as planned: TCP of {name} to the line between them"
            out.append((words, Raw(f"{markup.fixed(float(angle), 2)}°")))
    return out


def _stops(operation: OperationPlan, start: float) -> Raw:
    rows = []
    for action in operation.targets.actions:
        what = action.text or action.signal or (f"{action.seconds:g} s" if action.kind == "wait" else "")
        time = Raw(markup.fixed(float(operation.time[action.at]) + start, 1))
        rows.append((time, operation.targets.name(action.at), _STEPS[action.kind], what))
    return markup.table(("motion time [s]", "at target", "", "what"), rows) if rows else Raw("<p>none</p>")
