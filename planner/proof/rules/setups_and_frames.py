"""Rules on what stands or is mounted where, setup by setup, and who confirms it.

verify.tool_data, work_object, held_frame, load, base_frames: tools, work objects, held work, loads
and bases. verify.setup: who confirms setups, and what stands where in each of them.
"""

import numpy as np

from planner.catalogue.robots import RobotData
from planner.claims.claim import HoldsStock
from planner.geometry.arrays import FloatArray, inverse, log_rotation
from planner.issues import Issue
from planner.problem import Stock
from planner.programs.steps import (
    CarryStep,
    ChoiceStep,
    JointTarget,
    MessageStep,
    MoveStep,
    Step,
    Tool,
    letters,
    rotation,
)
from planner.proof.context import Context
from planner.proof.findings import Findings, in_mm
from planner.proof.rule import Outcome, at_step, mm, rule
from planner.proof.setups import Asked, all_asked, one_line, shown_letters, stays
from planner.tooling import Tool as WantedTool

FRAME_POSITION = 1e-6
"""How far a written frame may be off the problem's [m]: its last decimal."""
FRAME_ANGLE = 1e-6
"""The same of its turn [rad]."""
MASS_ERROR = 1e-3
"""How far a mass may be off [kg]: its last decimal."""
CENTRE_ERROR = 1e-5
"""How far a centre of gravity may be off [m], in each coordinate."""
INERTIA_ERROR = 5e-6
"""How far moments of inertia may be off [kg m^2]: their last decimals; those of a block by 1 % too."""
LEAST_LOAD = 0.001
"""Mass [kg] of load0."""


@rule("verify.tool_data")
def tool_data(context: Context) -> Outcome:
    """All moves use the tool that their arm has in that setup, with its TCP, mass and centre of gravity."""
    findings = Findings("verify.tool_data", context, worst=0.0)
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
                findings.highest(shift)
                if not step.tool_name:
                    faults.append("it stands in place; moves name their tool")
                for fault in faults:
                    findings.at_step(f"tool {step.tool_name or '(in place)'}: {fault}", task, step)
    return findings.outcome(mm, "mm", FRAME_POSITION)


def _tool_faults(tool: Tool, wanted: WantedTool) -> tuple[float, list[str]]:
    shift, turn = _apart(tool.pose, wanted.tcp)
    faults = []
    if shift > FRAME_POSITION or turn > FRAME_ANGLE:
        what = f"its TCP is off that of {wanted.name} by {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg"
        faults.append(what)
    if not tool.held:
        faults.append("it is not held by the robot")
    if abs(tool.load.mass - wanted.mass) > MASS_ERROR:
        faults.append(f"its mass is {tool.load.mass:g} kg, not {wanted.mass:g} kg")
    if np.abs(tool.load.centre - wanted.cog).max() > CENTRE_ERROR:
        faults.append("its centre of gravity is not the tool's")
    if np.abs(tool.load.inertia).max() > INERTIA_ERROR:
        faults.append("it has moments of inertia, of which the problem says nothing")
    return shift, faults


@rule("verify.work_object")
def work_object(context: Context) -> Outcome:
    """Straight moves are in the world or in the block's frame, which is the same in all tasks of a setup and
    where the problem wants it."""
    findings = Findings("verify.work_object", context, worst=0.0)
    for index, task, move, wobj in context.work_objects:
        if not wobj.fixed:
            continue  # a frame that moves is for verify.held_frame
        if move.in_world:
            shift, turn = _apart(wobj.user @ wobj.object, np.eye(4))
            if shift > FRAME_POSITION or turn > FRAME_ANGLE:
                what = f"{move.wobj_name} is {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg off the world"
                findings.at_step(what, task, move)
            continue
        if wobj.held or wobj.unit or not move.wobj_name:
            what = f"{move.wobj_name or 'a work object in place'} is held, moved by a unit or has no name"
            findings.at_step(what, task, move)
        place = context.places[index]
        shift, turn = _apart(wobj.user @ wobj.object, np.eye(4) if place is None else place)
        findings.highest(shift)
        if shift > FRAME_POSITION or turn > FRAME_ANGLE:
            what = f"{move.wobj_name} is {mm(shift):.4f} mm off where the block stands in setup {index + 1}"
            findings.at_step(what, task, move)
    for index in range(len(context.setups)):
        if context.stock(index).held_by is None:
            _where_it_stands(findings, index)
    return findings.outcome(mm, "mm", FRAME_POSITION)


def _where_it_stands(findings: Findings, index: int) -> None:
    """Whether the block's frame in the text is one that the problem allows."""
    context = findings.context
    stock, place = context.stock(index), context.places[index]
    if place is None:
        what = f"nothing in the programs says where the block stands in setup {index + 1}"
        findings.add(what, hint="state stock.place where no work is in its frame")
        return
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
            findings.add(message, in_mm(shift, FRAME_POSITION))
    elif not stock.leans_freely:
        tilt = float(np.linalg.norm((place[:3, :3] @ stock.attitude.T)[2, :] - [0.0, 0.0, 1.0]))
        if tilt > 2.0 * FRAME_ANGLE:
            findings.add(
                f"the block leans {np.rad2deg(tilt):.4f} deg off the attitude that the problem gives it"
            )


@rule("verify.held_frame", HoldsStock)
def held_frame(context: Context) -> Outcome:
    """Work on a held block is in the frame that its holder's flange carries, in synchronised blocks, and the
    holder itself moves in the world; no other work is."""
    findings = Findings("verify.held_frame", context, worst=0.0)
    units = {task.arm.name: task.unit for task in context.job.tasks}
    holders = (context.holder(index) for index in range(len(context.setups)))
    lost = sorted({held.arm for held in holders if held is not None} - set(units))
    for arm in lost:
        findings.add(f"{arm} holds the block, but has no program")
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
                findings.highest(shift)
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
            for fault in faults:
                findings.at_step(fault, task, move)
    return findings.outcome(mm, "mm", FRAME_POSITION)


@rule("verify.load", HoldsStock)
def load(context: Context) -> Outcome:
    """The controller knows the held block's load from its setup's confirmation on until it is let go."""
    findings = Findings("verify.load", context)
    worked = len(context.problem.setups) - 1  # what is held stays so while axes go home behind it
    for task in context.job.tasks:
        name = task.arm.name
        known: int | None = None  # the setup whose block the controller counts with
        for number, stage in enumerate(context.job.stages):
            index = min(int(context.spans.of_stage[number]), worked)
            held = context.holder(index)
            wanted = held if held is not None and held.arm == name else None
            asked = context.spans.asked[index]
            for step in stage.steps[task.name]:
                if isinstance(step, CarryStep):
                    early = bool(asked) and number <= asked[0].stage
                    fault, known = _carried(step, wanted, context.stock(index), index)
                    fault = f"setup {index + 1} is not confirmed yet" if early and wanted else fault
                    if fault:
                        findings.at_step(fault, task, step)
                if isinstance(step, MoveStep):
                    before = bool(asked) and number < asked[0].stage
                    if wanted is not None and known != index and not before:
                        what = f"{name} moves the block of setup {index + 1} without its load"
                        findings.at_step(what, task, step, "GripLoad first")
                        known = index
                    if wanted is None and known is not None:
                        what = f"{name} still counts with a load that it no longer holds"
                        findings.at_step(what, task, step, "GripLoad load0 first")
                        known = None
    held_at_all = any(setup.stock_holders for setup in context.setup_claims)
    return findings.outcome_without_value("" if held_at_all else "nothing is held")


def _carried(step: CarryStep, wanted: HoldsStock | None, stock: Stock, index: int) -> tuple[str, int | None]:
    """What is wrong with a load, and the setup whose block it is, None for no load."""
    if wanted is None:
        none = abs(step.load.mass) <= LEAST_LOAD + 1e-9
        return ("" if none else f"a load of {step.load.mass:g} kg, but no block is held"), None
    if abs(step.load.mass - wanted.mass) > MASS_ERROR:
        return f"the load is {step.load.mass:g} kg; the block is {wanted.mass:.4f} kg", index
    if np.abs(step.load.centre - wanted.cog).max() > CENTRE_ERROR:
        return "the load's centre of gravity is not the block's", index
    turn, grip = rotation(step.load.axes), wanted.grip[:3, :3]
    said, true = (turn * step.load.inertia) @ turn.T, (grip * _moments(stock, wanted.mass)) @ grip.T
    if np.abs(said - true).max() > INERTIA_ERROR + 0.01 * np.abs(true).max():
        return "the load's moments of inertia are not the block's", index
    return "", index


def _moments(stock: Stock, mass: float) -> FloatArray:
    """Moments of inertia (3,) [kg m^2] of a solid block about its own axes through its centre."""
    square = (stock.upper - stock.lower) ** 2
    return np.asarray(mass / 12.0 * (square.sum() - square))


@rule("verify.base_frames")
def base_frames(context: Context) -> Outcome:
    """Each task states the base frame that its arm must have, and it is the problem's."""
    findings = Findings("verify.base_frames", context, worst=0.0)
    for task in context.job.tasks:
        declared = context.declared_bases.get(task.arm.name)
        if declared is None:
            message = f"{task.name} does not state the base frame it was planned for (CONST pose base_frame)"
            findings.at_step(message, task, None)
            continue
        if task.arm.base_auto:
            continue
        shift, turn = _apart(declared, task.arm.base)
        findings.highest(shift)
        if shift > FRAME_POSITION or turn > FRAME_ANGLE:
            message = (
                f"the base of {task.arm.name} is {mm(shift):.4f} mm and {np.rad2deg(turn):.4f} deg off "
                "the problem's"
            )
            findings.at_step(message, task, None)
    return findings.outcome(mm, "mm", FRAME_POSITION)


def _apart(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    relative = inverse(a) @ b
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])), float(np.linalg.norm(log_rotation(relative[:3, :3])))


HOME_ERROR = 1e-4
"""How far a joint may be off home [rad] to be there."""


@rule("verify.setup")
def setup(context: Context) -> Outcome:
    """Each setup is told and confirmed once, in order, with all arms at home and nothing moving till then,
    and no arm moves at all before the operator has confirmed something."""
    issues: list[Issue] = _unasked(context)
    last = -1
    for index, here in enumerate(context.setups):
        if not here.steps:
            if index:
                what = f"setup {here.number} changes the cell, but says nothing that could be confirmed"
                issues.append(Issue("verify.setup", what, hint="name the setup's steps"))
            continue
        places = context.spans.asked[index]
        if len(places) != 1:
            count = f"{len(places)} times" if places else "never"
            what = f"the confirmation of setup {here.number} is asked for {count}; it must be asked for once"
            step = places[1] if places else None
            issues.append(_at(step, what) if step else Issue("verify.setup", what, hint=here.confirmation))
            continue
        (place,) = places
        if place.stage <= last:
            issues.append(_at(place, f"setup {here.number} is confirmed before the one that comes first"))
        last = max(last, place.stage)
        if not place.step.certain:
            issues.append(_at(place, f"setup {here.number} goes on without anybody pressing OK"))
        shown, wanted = shown_letters(context.job, place), "".join(letters(step) for step in here.steps)
        if shown != wanted:
            missing = next((step for step in here.steps if letters(step) not in shown), None)
            what = "with something else than what is to be done" if missing is None else f"without: {missing}"
            issues.append(_at(place, f"setup {here.number} is confirmed {what}"))
        issues += _standing(context, place, here.number, first=index == 0)
    issues += _lookalikes(context)
    return Outcome(tuple(issues), nothing="" if any(s.steps for s in context.setups) else "one setup")


def _unasked(context: Context) -> list[Issue]:
    """A first move that nobody has confirmed."""
    for stage in context.job.stages:
        asked = False
        for task in context.job.tasks:
            for step in stage.steps[task.name]:
                if isinstance(step, MessageStep) and step.confirm and step.certain:
                    asked = True
                    break
                if isinstance(step, MoveStep):
                    what = "an arm moves, and nobody was asked before whether its way is clear"
                    return [at_step("verify.setup", what, task, step, "ask the operator first")]
        if asked:
            return []
    return []


def _standing(context: Context, place: Asked, number: int, first: bool) -> list[Issue]:
    """Faults of arms that move at the confirmation, are not at home, or moved before the first one."""
    issues = []
    stage = context.job.stages[place.stage]
    if stage.synchronised or any(stage.moves(task.name) for task in context.job.tasks):
        issues.append(_at(place, f"an arm may move while setup {number} is being confirmed"))
    for task in context.job.tasks:
        machine = task.arm.data
        moves = [m for earlier in context.job.stages[: place.stage] for m in earlier.moves(task.name)]
        away = [m for m in (moves if first else moves[-1:]) if not at_home(m, machine, task.arm.home)]
        if away:
            what = f"{task.arm.name} is not at home when setup {number} is confirmed"
            issues.append(at_step("verify.setup", what, task, away[-1], "let it go home first"))
    return issues


def at_home(move: MoveStep, machine: RobotData, home: FloatArray) -> bool:
    """Whether a move ends at home and stops there."""
    if not isinstance(move.target, JointTarget):
        return False
    q = machine.from_controller(move.target.joints)
    return bool(np.abs(q - home).max() <= HOME_ERROR and move.zone.fine)


def _lookalikes(context: Context) -> list[Issue]:
    """Other questions that hold a setup's words, and setup texts where the proof does not follow."""
    wanted = [s for s in context.setups if s.steps]
    own = {id(q.step) for places in context.spans.asked for q in places}
    issues = [
        _at(question, f"a question other than the confirmation of setup {here.number} holds its words")
        for question in all_asked(context.job)
        for here in wanted
        if id(question.step) not in own and _like(question.step, here.confirmation)
    ]
    for task in context.job.tasks:
        aside = [step for step in task.steps if isinstance(step, ChoiceStep)]
        hidden = [s for choice in aside for s in _inside(choice)]
        hidden += [s for block in (task.handlers, task.undos) for steps in block.values() for s in steps]
        issues += [
            at_step("verify.setup", f"the confirmation of setup {here.number} is asked for aside", task, step)
            for step in hidden
            for here in wanted
            if isinstance(step, MessageStep) and _like(step, here.confirmation)
        ]
    return issues


def _inside(choice: ChoiceStep) -> list[Step]:
    return [
        s
        for step in choice.steps
        for s in ([step, *_inside(step)] if isinstance(step, ChoiceStep) else [step])
    ]


def _like(step: MessageStep, confirmation: str) -> bool:
    return letters(confirmation) in letters(" ".join(step.lines)) or one_line(confirmation) in step.text


def _at(asked: Asked, message: str) -> Issue:
    return at_step("verify.setup", message, asked.task, asked.step)
