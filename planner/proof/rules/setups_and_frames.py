"""Rules on tools, frames and loads in each setup, and on the confirmation of setups.

verify.tool_data, work_object, held_frame, load, base_frames: tools, work objects, held work, loads and
bases. verify.setup: description and confirmation of setups.
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
    ProgramStep,
    Tool,
    normalised_text,
    rotation,
)
from planner.proof.context import Context
from planner.proof.findings import Findings, measure_in_mm
from planner.proof.rule import RuleOutcome, mm, rule, step_issue
from planner.proof.setups import (
    OperatorQuestion,
    operator_questions,
    shown_characters,
    single_spaced,
    stock_unmoved,
)
from planner.tooling import Tool as ExpectedTool

FRAME_TOLERANCE_M = 1e-6
"""Tolerance [m] between the position of a frame in the text and in the problem: the last decimal of the
text.
"""
FRAME_TOLERANCE_RAD = 1e-6
"""Tolerance [rad] between the rotation of a frame in the text and in the problem."""
MASS_TOLERANCE_KG = 1e-3
"""Tolerance [kg] of masses: the last decimal of the text."""
CENTRE_TOLERANCE_M = 1e-5
"""Tolerance [m] of each coordinate of a centre of gravity."""
INERTIA_TOLERANCE_KG_M2 = 5e-6
"""Tolerance [kg m^2] of moments of inertia: their last decimals. Those of a block may deviate by 1 % in
addition.
"""
LOAD0_MASS_KG = 0.001
"""Mass [kg] of load0, with which RAPID states that nothing is held."""


@rule("verify.tool_data")
def tool_data(context: Context) -> RuleOutcome:
    """All moves use the tool that their arm has in that setup, with its TCP, mass and centre of gravity."""
    findings = Findings("verify.tool_data", context, worst=0.0)
    for task in context.job.tasks:
        seen: set[tuple[int, int]] = set()
        for number, stage in enumerate(context.job.stages):
            index = int(context.spans.of_stage[number])
            expected = context.setups[index].cell.arm(task.arm.name).tool
            for step in stage.moves(task.name):
                if (index, id(step.tool)) in seen:
                    continue
                seen.add((index, id(step.tool)))
                shift, faults = _tool_faults(step.tool, expected)
                findings.note_highest(shift)
                if not step.tool_name:
                    faults.append("it is written in the move; moves must name their tool")
                for fault in faults:
                    findings.add_at_step(f"tool {step.tool_name or '(in place)'}: {fault}", task, step)
    return findings.outcome(mm, "mm", FRAME_TOLERANCE_M)


def _tool_faults(tool: Tool, expected: ExpectedTool) -> tuple[float, list[str]]:
    """Compare a tool in the text with the expected one: TCP, mass and centre of gravity.

    The tool must also be held by the robot and have no moments of inertia.

    Returns:
        Distance [m] of the TCPs, and all faults as texts.
    """
    shift, rotation_angle = _pose_difference(tool.pose, expected.tcp)
    faults = []
    if shift > FRAME_TOLERANCE_M or rotation_angle > FRAME_TOLERANCE_RAD:
        message = (
            f"its TCP is {mm(shift):.4f} mm and {np.rad2deg(rotation_angle):.4f} deg away from that of "
            f"{expected.name}"
        )
        faults.append(message)
    if not tool.held:
        faults.append("it is not held by the robot")
    if abs(tool.load.mass - expected.mass) > MASS_TOLERANCE_KG:
        faults.append(f"its mass is {tool.load.mass:g} kg, not {expected.mass:g} kg")
    if np.abs(tool.load.centre - expected.cog).max() > CENTRE_TOLERANCE_M:
        faults.append("its centre of gravity is not the tool's")
    if np.abs(tool.load.inertia).max() > INERTIA_TOLERANCE_KG_M2:
        faults.append("it has moments of inertia, which the problem does not state")
    return shift, faults


@rule("verify.work_object")
def work_object(context: Context) -> RuleOutcome:
    """Straight moves are in the world or in the block's frame.
    The block's frame is the same in all tasks of a setup, and is the one that the problem requires.
    """
    findings = Findings("verify.work_object", context, worst=0.0)
    for index, task, move, wobj in context.work_objects:
        if not wobj.fixed:
            continue  # moving frames are checked by verify.held_frame
        if move.in_world:
            shift, rotation_angle = _pose_difference(wobj.user @ wobj.object, np.eye(4))
            if shift > FRAME_TOLERANCE_M or rotation_angle > FRAME_TOLERANCE_RAD:
                message = (
                    f"{move.wobj_name} is {mm(shift):.4f} mm and {np.rad2deg(rotation_angle):.4f} deg off "
                    "the world"
                )
                findings.add_at_step(message, task, move)
            continue
        if wobj.held or wobj.unit or not move.wobj_name:
            message = f"{move.wobj_name or 'a work object in a move'} is held, moved by a unit or has no name"
            findings.add_at_step(message, task, move)
        stock_frame = context.stock_frames[index]
        shift, rotation_angle = _pose_difference(
            wobj.user @ wobj.object, np.eye(4) if stock_frame is None else stock_frame
        )
        findings.note_highest(shift)
        if shift > FRAME_TOLERANCE_M or rotation_angle > FRAME_TOLERANCE_RAD:
            message = (
                f"{move.wobj_name} is {mm(shift):.4f} mm away from the block's frame in setup {index + 1}"
            )
            findings.add_at_step(message, task, move)
    for index in range(len(context.setups)):
        if context.stock_at(index).held_by is None:
            _check_stock_frame(findings, index)
    return findings.outcome(mm, "mm", FRAME_TOLERANCE_M)


def _check_stock_frame(findings: Findings, index: int) -> None:
    """Check that the block's frame in the text of setup ``index`` is one that the problem allows.

    It must be the place that the problem states, or else, if the block has not been moved since the previous
    setup, the frame of that setup. If neither is known, only the block's attitude is checked, unless the
    problem leaves it free. A block without a frame is reported, too.
    """
    context = findings.context
    stock, stock_frame = context.stock_at(index), context.stock_frames[index]
    if stock_frame is None:
        message = f"the programs do not state the block's frame in setup {index + 1}"
        findings.add(message, hint="state stock.place if no work is in its frame")
        return
    expected = stock.place
    source = "the problem's"
    if expected is None and index and stock_unmoved(context.problem, context.setups[index]):
        expected = context.stock_frames[index - 1]
        source = "that of the setup before, since which nothing moves it"
    if expected is not None:
        shift, rotation_angle = _pose_difference(stock_frame, expected)
        if shift > FRAME_TOLERANCE_M or rotation_angle > FRAME_TOLERANCE_RAD:
            message = (
                f"the block's frame in setup {index + 1} is {mm(shift):.4f} mm and "
                f"{np.rad2deg(rotation_angle):.4f} deg away from {source}"
            )
            findings.add(message, measure_in_mm(shift, FRAME_TOLERANCE_M))
    elif not stock.is_attitude_free:
        # Length of the difference of the vertical unit vectors: about the tilt angle [rad] if it is small.
        # The rotation about the vertical is free.
        tilt = float(np.linalg.norm((stock_frame[:3, :3] @ stock.attitude.T)[2, :] - [0.0, 0.0, 1.0]))
        if tilt > 2.0 * FRAME_TOLERANCE_RAD:
            findings.add(
                f"the block is tilted {np.rad2deg(tilt):.4f} deg from the attitude that the problem states"
            )


@rule("verify.held_frame", HoldsStock)
def held_frame(context: Context) -> RuleOutcome:
    """Work on a held block is in the frame that its holder's flange carries, in synchronised blocks.
    The holder itself moves in the world. No other work is in a moving frame.
    """
    findings = Findings("verify.held_frame", context, worst=0.0)
    units = {task.arm.name: task.unit for task in context.job.tasks}
    holders = (context.stock_holder(index) for index in range(len(context.setups)))
    holders_without_program = sorted({held.arm for held in holders if held is not None} - set(units))
    for arm in holders_without_program:
        findings.add(f"{arm} holds the block, but has no program")
    for number, stage, task, moves in context.moves():
        index = int(context.spans.of_stage[number])
        held = context.stock_holder(index)
        seen: set[int] = set()
        for move in moves:
            if move.by_joints or id(move.wobj) in seen:
                continue
            seen.add(id(move.wobj))
            wobj, faults = move.wobj, list[str]()
            if held is None or task.arm.name == held.arm:
                if not wobj.fixed:
                    faults.append(f"{move.wobj_name} moves, but the work of {task.arm.name} does not")
                elif held is not None and not move.in_world:
                    faults.append(f"{task.arm.name} holds the block and must move in the world, in wobj0")
            elif wobj.fixed:
                faults.append(f"the block is held by {held.arm}, but {move.wobj_name} is fixed")
            else:
                tool = context.setups[index].cell.arm(held.arm).tool
                shift, rotation_angle = _pose_difference(wobj.object, tool.tcp)
                findings.note_highest(shift)
                if wobj.held:
                    faults.append(f"{move.wobj_name} is held by its own robot")
                if wobj.unit.lower() != units.get(held.arm, "").lower():
                    faults.append(f"{move.wobj_name} is moved by '{wobj.unit}', not by {units.get(held.arm)}")
                if shift > FRAME_TOLERANCE_M or rotation_angle > FRAME_TOLERANCE_RAD:
                    faults.append(
                        f"{move.wobj_name} is {mm(shift):.4f} mm and {np.rad2deg(rotation_angle):.4f} deg "
                        f"away from the TCP of {held.arm}"
                    )
                if max(_pose_difference(wobj.user, np.eye(4))) > 1e-9:  # exactly zero, but for rounding
                    message = "is not zero, but the controller sets the user frame of a moving work object"
                    faults.append(f"the user frame of {move.wobj_name} {message}")
                if not stage.synchronised:
                    faults.append("work on a held block runs outside a synchronised block")
            for fault in faults:
                findings.add_at_step(fault, task, move)
    return findings.outcome(mm, "mm", FRAME_TOLERANCE_M)


@rule("verify.load", HoldsStock)
def load(context: Context) -> RuleOutcome:
    """The controller knows the load of a held block from the confirmation of its setup until the block is
    released.
    """
    findings = Findings("verify.load", context)
    last_setup = len(context.problem.setups) - 1  # a held block stays held while axes move home at the end
    for task in context.job.tasks:
        name = task.arm.name
        loaded_setup: int | None = None  # the setup whose block's load the controller has
        for number, stage in enumerate(context.job.stages):
            index = min(int(context.spans.of_stage[number]), last_setup)
            held = context.stock_holder(index)
            expected = held if held is not None and held.arm == name else None
            confirmations = context.spans.confirmations[index]
            # early: a load before the confirmation of its setup. unconfirmed: a move before it, which belongs
            # to the previous setup.
            for step in stage.steps[task.name]:
                if isinstance(step, CarryStep):
                    early = bool(confirmations) and number <= confirmations[0].stage
                    fault, loaded_setup = _load_fault(step, expected, context.stock_at(index), index)
                    fault = f"setup {index + 1} is not confirmed yet" if early and expected else fault
                    if fault:
                        findings.add_at_step(fault, task, step)
                if isinstance(step, MoveStep):
                    unconfirmed = bool(confirmations) and number < confirmations[0].stage
                    if expected is not None and loaded_setup != index and not unconfirmed:
                        message = f"{name} moves the block of setup {index + 1} without its load"
                        findings.add_at_step(message, task, step, "call GripLoad first")
                        loaded_setup = index  # report it once
                    if expected is None and loaded_setup is not None:
                        message = f"{name} still has the load of a block that it no longer holds"
                        findings.add_at_step(message, task, step, "call GripLoad load0 first")
                        loaded_setup = None
    held_at_all = any(setup.stock_holders for setup in context.setup_claims)
    return findings.outcome_without_value("" if held_at_all else "nothing is held")


def _load_fault(
    step: CarryStep, expected: HoldsStock | None, stock: Stock, index: int
) -> tuple[str, int | None]:
    """Check a step that states a load: mass, centre of gravity and moments of inertia of the held block.

    Args:
        step: The step (GripLoad).
        expected: Claim on the block that the arm holds, None if it holds none. Then only load0 is allowed.
        stock: The block.
        index: Index of the setup.

    Returns:
        The fault as a text, "" if there is none, and the setup whose block's load the controller now has,
        None if the arm holds no block.
    """
    if expected is None:
        is_load0 = abs(step.load.mass) <= LOAD0_MASS_KG + 1e-9
        return ("" if is_load0 else f"a load of {step.load.mass:g} kg, but no block is held"), None
    if abs(step.load.mass - expected.mass) > MASS_TOLERANCE_KG:
        return f"the load is {step.load.mass:g} kg; the block is {expected.mass:.4f} kg", index
    if np.abs(step.load.centre - expected.cog).max() > CENTRE_TOLERANCE_M:
        return "the load's centre of gravity is not the block's", index
    # Inertia matrices about the centre: R diag(i) R^T with the principal axes R and moments i.
    load_axes, grip = rotation(step.load.axes), expected.grip[:3, :3]
    stated_inertia = (load_axes * step.load.inertia) @ load_axes.T
    expected_inertia = (grip * _block_inertia(stock, expected.mass)) @ grip.T
    if (  # 1 % for the solid block (INERTIA_TOLERANCE_KG_M2)
        np.abs(stated_inertia - expected_inertia).max()
        > INERTIA_TOLERANCE_KG_M2 + 0.01 * np.abs(expected_inertia).max()
    ):
        return "the load's moments of inertia are not the block's", index
    return "", index


def _block_inertia(stock: Stock, mass: float) -> FloatArray:
    """Return the moments of inertia (3,) [kg m^2] of a solid block about its own axes through its centre."""
    square = (stock.upper - stock.lower) ** 2
    return np.asarray(mass / 12.0 * (square.sum() - square))


@rule("verify.base_frames")
def base_frames(context: Context) -> RuleOutcome:
    """Each task states the base frame that its arm must have, and it is the problem's."""
    findings = Findings("verify.base_frames", context, worst=0.0)
    for task in context.job.tasks:
        declared = context.declared_bases.get(task.arm.name)
        if declared is None:
            message = f"{task.name} does not state the base frame it was planned for (CONST pose base_frame)"
            findings.add_at_step(message, task, None)
            continue
        if task.arm.base_auto:
            continue
        shift, rotation_angle = _pose_difference(declared, task.arm.base)
        findings.note_highest(shift)
        if shift > FRAME_TOLERANCE_M or rotation_angle > FRAME_TOLERANCE_RAD:
            message = (
                f"the base of {task.arm.name} is {mm(shift):.4f} mm and {np.rad2deg(rotation_angle):.4f} deg "
                "away from the problem's"
            )
            findings.add_at_step(message, task, None)
    return findings.outcome(mm, "mm", FRAME_TOLERANCE_M)


def _pose_difference(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Return the distance [m] of the origins of two poses (4, 4), and the angle [rad] between them."""
    relative = inverse(a) @ b
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])), float(np.linalg.norm(log_rotation(relative[:3, :3])))


HOME_TOLERANCE_RAD = 1e-4
"""Tolerance [rad] within which a joint is at home."""


@rule("verify.setup")
def setup(context: Context) -> RuleOutcome:
    """Each setup is described and confirmed once, in order, with all arms at home and nothing moving
    before. No arm moves at all before the operator has confirmed something.
    """
    issues: list[Issue] = _unconfirmed_move(context)
    last_stage = -1
    for index, current in enumerate(context.setups):
        if not current.steps:
            if index:
                message = f"setup {current.number} changes the cell, but has no steps to confirm"
                issues.append(Issue("verify.setup", message, hint="name the setup's steps"))
            continue
        confirmations = context.spans.confirmations[index]
        if len(confirmations) != 1:
            count = f"{len(confirmations)} times" if confirmations else "never"
            message = f"the confirmation of setup {current.number} is asked for {count}; required: once"
            step = confirmations[1] if confirmations else None
            issues.append(
                _question_issue(step, message)
                if step
                else Issue("verify.setup", message, hint=current.confirmation)
            )
            continue
        (confirmation,) = confirmations
        if confirmation.stage <= last_stage:
            issues.append(
                _question_issue(confirmation, f"setup {current.number} is confirmed before an earlier setup")
            )
        last_stage = max(last_stage, confirmation.stage)
        if not confirmation.step.certain:
            issues.append(
                _question_issue(confirmation, f"setup {current.number} continues without a press of OK")
            )
        shown = shown_characters(context.job, confirmation)
        expected = "".join(normalised_text(step) for step in current.steps)
        if shown != expected:
            missing = next((step for step in current.steps if normalised_text(step) not in shown), None)
            fault = "with texts other than its steps" if missing is None else f"without: {missing}"
            issues.append(_question_issue(confirmation, f"setup {current.number} is confirmed {fault}"))
        issues += _arms_not_at_rest(context, confirmation, current.number, first=index == 0)
    issues += _misplaced_confirmations(context)
    return RuleOutcome(tuple(issues), nothing="" if any(s.steps for s in context.setups) else "one setup")


def _unconfirmed_move(context: Context) -> list[Issue]:
    """Report the first move of an arm if no operator has confirmed anything before it, else return no issue.

    In a stage with several tasks, a confirmation counts only for the steps after it in its own task. From the
    next stage on it counts for all tasks.
    """
    for stage in context.job.stages:
        confirmed = False
        for task in context.job.tasks:
            for step in stage.steps[task.name]:
                if isinstance(step, MessageStep) and step.confirm and step.certain:
                    confirmed = True
                    break
                if isinstance(step, MoveStep):
                    message = "an arm moves, but the operator was not asked before whether its path is clear"
                    return [step_issue("verify.setup", message, task, step, "ask the operator first")]
        if confirmed:
            return []
    return []


def _arms_not_at_rest(
    context: Context, confirmation: OperatorQuestion, number: int, first: bool
) -> list[Issue]:
    """Report arms that may move while setup ``number`` is being confirmed, or that are not at home then.

    An arm may move if the stage of the confirmation has moves. It is at home if its last move before that
    stage ends at home. Before the ``first`` confirmation all its moves must have ended at home.
    """
    issues = []
    stage = context.job.stages[confirmation.stage]
    if stage.synchronised or any(stage.moves(task.name) for task in context.job.tasks):
        issues.append(
            _question_issue(confirmation, f"an arm may move while setup {number} is being confirmed")
        )
    for task in context.job.tasks:
        machine = task.arm.data
        earlier_stages = context.job.stages[: confirmation.stage]
        moves = [move for earlier in earlier_stages for move in earlier.moves(task.name)]
        checked_moves = moves if first else moves[-1:]
        not_home = [move for move in checked_moves if not at_home(move, machine, task.arm.home)]
        if not_home:
            message = f"{task.arm.name} is not at home when setup {number} is confirmed"
            issues.append(step_issue("verify.setup", message, task, not_home[-1], "move it home first"))
    return issues


def at_home(move: MoveStep, machine: RobotData, home: FloatArray) -> bool:
    """Return whether a move ends at home and stops there.

    Only a move to a joint target does so. ``home`` (J,) [rad] are serial joint angles.
    """
    if not isinstance(move.target, JointTarget):
        return False
    q = machine.from_controller(move.target.joints)
    return bool(np.abs(q - home).max() <= HOME_TOLERANCE_RAD and move.zone.fine)


def _misplaced_confirmations(context: Context) -> list[Issue]:
    """Report messages that an operator could take for a setup's confirmation, although they are none.

    These are other questions with the words of a confirmation, and messages with its words in branches, error
    handlers and UNDO, which are not on the straight path of execution.
    """
    with_steps = [current for current in context.setups if current.steps]
    confirmation_ids = {
        id(question.step) for confirmations in context.spans.confirmations for question in confirmations
    }
    issues = [
        _question_issue(
            question, f"a question other than the confirmation of setup {current.number} has its words"
        )
        for question in operator_questions(context.job)
        for current in with_steps
        if id(question.step) not in confirmation_ids and _contains_text(question.step, current.confirmation)
    ]
    for task in context.job.tasks:
        branches = [step for step in task.steps if isinstance(step, ChoiceStep)]
        side_steps = [step for choice in branches for step in _branch_steps(choice)]
        side_steps += [
            step for block in (task.handlers, task.undos) for steps in block.values() for step in steps
        ]
        issues += [
            step_issue(
                "verify.setup", f"a branch asks for the confirmation of setup {current.number}", task, step
            )
            for step in side_steps
            for current in with_steps
            if isinstance(step, MessageStep) and _contains_text(step, current.confirmation)
        ]
    return issues


def _branch_steps(choice: ChoiceStep) -> list[ProgramStep]:
    """Return all steps of a branch, with those of the branches inside it."""
    return [
        inner_step
        for step in choice.steps
        for inner_step in ([step, *_branch_steps(step)] if isinstance(step, ChoiceStep) else [step])
    ]


def _contains_text(step: MessageStep, confirmation: str) -> bool:
    """Return whether a message contains the text of a confirmation, on one or several lines."""
    return (
        normalised_text(confirmation) in normalised_text(" ".join(step.lines))
        or single_spaced(confirmation) in step.text
    )


def _question_issue(question: OperatorQuestion, message: str) -> Issue:
    """Return an issue at the step that asks a question."""
    return step_issue("verify.setup", message, question.task, question.step)
