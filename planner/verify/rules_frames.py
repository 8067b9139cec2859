"""Rules on what stands or is mounted where, setup by setup: tools, work objects, bases, held work, loads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.claims import HoldsStock
from planner.geometry.rigid import inverse, log_rotation
from planner.issues import Issue
from planner.problem import Stock
from planner.tooling import Tool as WantedTool
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_step
from planner.verify.setups import stays
from planner.verify.steps import CarryStep, MoveStep
from planner.verify.values import Tool, rotation

FloatArray = NDArray[np.float64]

FRAME_POSITION = 1e-6
"""How far a written frame may be off the problem's [m]: its last decimal."""
FRAME_ANGLE = 1e-6
MASS = 1e-3
CENTRE = 1e-5
INERTIA = 5e-6
"""How far moments of inertia may be off [kg m^2]: their last decimals; those of a block by 1 % too."""
NO_LOAD = 0.001
"""Mass [kg] of load0."""


def tool_data(context: Context) -> Outcome:
    """All moves use the tool that their arm has in that setup, with its TCP, mass and centre of gravity."""
    issues, worst = [], 0.0
    for task in context.job.tasks:
        seen: set[tuple[int, int]] = set()
        for number, stage in enumerate(context.job.stages):
            index = int(context.spans.of_stage[number])
            wanted = context.setups[index].cell.arm(task.arm.name).tool
            for step in stage.moves(task.name):
                if (index, id(step.tool)) in seen:
                    continue
                seen.add((index, id(step.tool)))
                shift, faults = _tool_faults(step.tool, wanted)
                worst = max(worst, mm(shift))
                if not step.tool_name:
                    faults.append("it stands in place; moves name their tool")
                issues += [
                    at_step("verify.tool_data", f"tool {step.tool_name or '(in place)'}: {fault}", task, step)
                    for fault in faults
                ]
    return Outcome(tuple(issues), worst, mm(FRAME_POSITION), "mm")


def _tool_faults(tool: Tool, wanted: WantedTool) -> tuple[float, list[str]]:
    shift, turn = _apart(tool.pose, wanted.tcp)
    faults = []
    if shift > FRAME_POSITION or turn > FRAME_ANGLE:
        what = f"its TCP is off that of {wanted.name} by {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg"
        faults.append(what)
    if not tool.held:
        faults.append("it is not held by the robot")
    if abs(tool.load.mass - wanted.mass) > MASS:
        faults.append(f"its mass is {tool.load.mass:g} kg, not {wanted.mass:g} kg")
    if np.abs(tool.load.centre - wanted.cog).max() > CENTRE:
        faults.append("its centre of gravity is not the tool's")
    if np.abs(tool.load.inertia).max() > INERTIA:
        faults.append("it has moments of inertia, of which the problem says nothing")
    return shift, faults


def work_object(context: Context) -> Outcome:
    """Straight moves are in the world or in the block's frame, which is the same in all tasks of a setup and
    where the problem wants it."""
    issues, worst = [], 0.0
    for index, task, move, wobj in context.work_objects:
        if not wobj.fixed:
            continue  # a frame that moves is for verify.held_frame
        if move.in_world:
            shift, turn = _apart(wobj.user @ wobj.object, np.eye(4))
            if shift > FRAME_POSITION or turn > FRAME_ANGLE:
                what = f"{move.wobj_name} is {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg off the world"
                issues.append(at_step("verify.work_object", what, task, move))
            continue
        if wobj.held or wobj.unit or not move.wobj_name:
            what = f"{move.wobj_name or 'a work object in place'} is held, moved by a unit or has no name"
            issues.append(at_step("verify.work_object", what, task, move))
        place = context.places[index]
        shift, turn = _apart(wobj.user @ wobj.object, np.eye(4) if place is None else place)
        worst = max(worst, mm(shift))
        if shift > FRAME_POSITION or turn > FRAME_ANGLE:
            message = (
                f"{move.wobj_name} is {mm(shift):.4f} mm off where the block stands in setup {index + 1}"
            )
            issues.append(at_step("verify.work_object", message, task, move))
    for index in range(len(context.setups)):
        if context.stock(index).held_by is None:
            issues += _where_it_stands(context, index)
    return Outcome(tuple(issues), worst, mm(FRAME_POSITION), "mm")


def _where_it_stands(context: Context, index: int) -> list[Issue]:
    """Whether the block's frame in the text is one that the problem allows."""
    stock, place = context.stock(index), context.places[index]
    if place is None:
        what = f"nothing in the programs says where the block stands in setup {index + 1}"
        return [Issue("verify.work_object", what, hint="state stock.place where no work is in its frame")]
    wanted = stock.place
    said = "the problem's"
    if wanted is None and index and stays(context.problem, context.setups[index]):
        wanted, said = context.places[index - 1], "that of the setup before, from which nothing moves it"
    if wanted is not None:
        shift, turn = _apart(place, wanted)
        if shift > FRAME_POSITION or turn > FRAME_ANGLE:
            message = (
                f"the block's frame in setup {index + 1} is {mm(shift):.4f} mm and "
                f"{np.rad2deg(turn):.4f} deg off {said}"
            )
            measure = {"value": mm(shift), "limit": mm(FRAME_POSITION), "unit": "mm"}
            return [Issue("verify.work_object", message, **measure)]  # type: ignore[arg-type]
    elif not stock.leans_freely:
        tilt = float(np.linalg.norm((place[:3, :3] @ stock.attitude.T)[2, :] - [0.0, 0.0, 1.0]))
        if tilt > 2.0 * FRAME_ANGLE:
            message = f"the block leans {np.rad2deg(tilt):.4f} deg off the attitude that the problem gives it"
            return [Issue("verify.work_object", message)]
    return []


def held_frame(context: Context) -> Outcome:
    """Work on a held block is in the frame that its holder's flange carries, in synchronised blocks, and the
    holder itself moves in the world; no other work is."""
    issues: list[Issue] = []
    worst = 0.0
    units = {task.arm.name: task.unit for task in context.job.tasks}
    holders = (context.holder(index) for index in range(len(context.setups)))
    lost = sorted({held.arm for held in holders if held is not None} - set(units))
    issues += [Issue("verify.held_frame", f"{arm} holds the block, but has no program") for arm in lost]
    for number, stage, task, moves in context.moves():
        index = int(context.spans.of_stage[number])
        held = context.holder(index)
        seen: set[int] = set()
        for move in moves:
            if move.by_joints or id(move.wobj) in seen:
                continue
            seen.add(id(move.wobj))
            wobj, faults = move.wobj, list[str]()
            if held is None or task.arm.name == held.arm:
                if not wobj.fixed:
                    faults.append(f"{move.wobj_name} moves, but what {task.arm.name} works on does not")
                elif held is not None and not move.in_world:
                    faults.append(f"{task.arm.name} holds the block and must move in the world, in wobj0")
            elif wobj.fixed:
                faults.append(f"the block is held by {held.arm}, but {move.wobj_name} stands still")
            else:
                tool = context.setups[index].cell.arm(held.arm).tool
                shift, turn = _apart(wobj.object, tool.tcp)
                worst = max(worst, mm(shift))
                if wobj.held:
                    faults.append(f"{move.wobj_name} is held by its own robot")
                if wobj.unit.lower() != units.get(held.arm, "").lower():
                    faults.append(f"{move.wobj_name} is moved by '{wobj.unit}', not by {units.get(held.arm)}")
                if shift > FRAME_POSITION or turn > FRAME_ANGLE:
                    faults.append(
                        f"{move.wobj_name} is {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg off the "
                        f"TCP of {held.arm}"
                    )
                if max(_apart(wobj.user, np.eye(4))) > 1e-9:
                    what = "is not zero; for a frame that moves the controller sets it itself"
                    faults.append(f"the user frame of {move.wobj_name} {what}")
                if not stage.synchronised:
                    faults.append("work on a held block runs outside a synchronised block")
            issues += [at_step("verify.held_frame", fault, task, move) for fault in faults]
    return Outcome(tuple(issues), worst, mm(FRAME_POSITION), "mm")


def load(context: Context) -> Outcome:
    """The controller knows the held block's load from its setup's confirmation on until it is let go."""
    issues: list[Issue] = []
    for task in context.job.tasks:
        name = task.arm.name
        known: int | None = None  # the setup whose block the controller counts with
        for number, stage in enumerate(context.job.stages):
            index = int(context.spans.of_stage[number])
            held = context.holder(index)
            wanted = held if held is not None and held.arm == name else None
            asked = context.spans.asked[index]
            for step in stage.steps[task.name]:
                if isinstance(step, CarryStep):
                    early = bool(asked) and number <= asked[0].stage
                    fault, known = _carried(step, wanted, context.stock(index), index)
                    fault = f"setup {index + 1} is not confirmed yet" if early and wanted else fault
                    issues += [at_step("verify.load", fault, task, step)] if fault else []
                if isinstance(step, MoveStep):
                    before = bool(asked) and number < asked[0].stage
                    if wanted is not None and known != index and not before:
                        what = f"{name} moves the block of setup {index + 1} without its load"
                        issues.append(at_step("verify.load", what, task, step, "GripLoad first"))
                        known = index
                    if wanted is None and known is not None:
                        what = f"{name} still counts with a load that it no longer holds"
                        issues.append(at_step("verify.load", what, task, step, "GripLoad load0 first"))
                        known = None
    return Outcome(
        tuple(issues), where="" if any(s.holds for s in context.setup_claims) else "nothing is held"
    )


def _carried(step: CarryStep, wanted: HoldsStock | None, stock: Stock, index: int) -> tuple[str, int | None]:
    """What is wrong with a load, and the setup whose block it is, None for no load."""
    if wanted is None:
        none = abs(step.load.mass) <= NO_LOAD + 1e-9
        return ("" if none else f"a load of {step.load.mass:g} kg, but no block is held"), None
    if abs(step.load.mass - wanted.mass) > MASS:
        return f"the load is {step.load.mass:g} kg; the block is {wanted.mass:.4f} kg", index
    if np.abs(step.load.centre - wanted.cog).max() > CENTRE:
        return "the load's centre of gravity is not the block's", index
    turn, grip = rotation(step.load.axes), wanted.grip[:3, :3]
    said, true = (turn * step.load.inertia) @ turn.T, (grip * _moments(stock, wanted.mass)) @ grip.T
    if np.abs(said - true).max() > INERTIA + 0.01 * np.abs(true).max():
        return "the load's moments of inertia are not the block's", index
    return "", index


def _moments(stock: Stock, mass: float) -> FloatArray:
    """Moments of inertia (3,) [kg m^2] of a solid block about its own axes through its centre."""
    square = (stock.upper - stock.lower) ** 2
    return np.asarray(mass / 12.0 * (square.sum() - square))


def base_frames(context: Context) -> Outcome:
    """Each task states the base frame that its arm must have, and it is the problem's."""
    issues, worst = [], 0.0
    for task in context.job.tasks:
        declared = context.declared_bases.get(task.arm.name)
        if declared is None:
            message = f"{task.name} does not state the base frame it was planned for (CONST pose base_frame)"
            issues.append(Issue("verify.base_frames", message, arm=task.arm.name, file=task.name))
            continue
        if task.arm.base_auto:
            continue
        shift, turn = _apart(declared, task.arm.base)
        worst = max(worst, mm(shift))
        if shift > FRAME_POSITION or turn > FRAME_ANGLE:
            message = (
                f"the base of {task.arm.name} is {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg off "
                "the problem's"
            )
            issues.append(Issue("verify.base_frames", message, arm=task.arm.name, file=task.name))
    return Outcome(tuple(issues), worst, mm(FRAME_POSITION), "mm")


def _apart(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    relative = inverse(a) @ b
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])), float(np.linalg.norm(log_rotation(relative[:3, :3])))
