"""verify.motion_settings and verify.hidden: settings of the motion, and hidden program parts."""

from planner.issues import Issue
from planner.programs.steps import (
    LoadStep,
    MessageStep,
    MoveStep,
    ProgramStep,
    SettingStep,
    SignalStep,
    SyncStep,
    WaitStep,
)
from planner.proof.context import Context
from planner.proof.language_contribution import check_task
from planner.proof.rule import RuleOutcome, rule, step_issue

_PATH_INSTRUCTIONS = (
    "StopMove",
    "StartMove",
    "ClearPath",
    "StorePath",
    "RestoPath",
    "Stop",
    "RAISE",
    "RETRY",
    "TRYNEXT",
)
"""RAPID instructions that stop, store or clear the path."""


@rule("verify.motion_settings")
def motion_settings(context: Context) -> RuleOutcome:
    """No setting slows moves down, lets them leave their path or drops them.
    These are AccSet or VelSet below 100 %, SingArea other than Off, and ClearPath and similar
    instructions.
    """
    slow_message = "AccSet or VelSet other than 100 % changes the times of the moves"
    issues = []
    for task in context.job.tasks:
        # With a handshake, a program may stop before its first move to drop its running wire.
        first_move = next((step for step in task.steps if isinstance(step, MoveStep)), None)
        stop_matters = context.job.automata_by_arm is None
        for step in task.steps:
            stop_matters |= step is first_move  # from the first move on
            if isinstance(step, WaitStep) and (step.seconds or 0.0) < 0.0:
                issues.append(step_issue("verify.motion_settings", "a wait has a negative time", task, step))
            if not isinstance(step, SettingStep):
                continue
            is_full = all(value == 100.0 for value in step.values)
            if (step.kind == "AccSet" and not is_full) or (step.kind == "VelSet" and _slows_down(step)):
                issues.append(step_issue("verify.motion_settings", slow_message, task, step))
            if step.kind == "SingArea" and step.switches != ("off",):
                message = "SingArea lets the tool leave its path near singularities"
                issues.append(step_issue("verify.motion_settings", message, task, step, "SingArea\\Off"))
            if step.kind in _PATH_INSTRUCTIONS and (stop_matters or step.kind != "Stop" or step.switches):
                message = f"{step.kind} between moves: the motion no longer follows from the text"
                issues.append(step_issue("verify.motion_settings", message, task, step))
    return RuleOutcome(tuple(issues))


def _slows_down(step: SettingStep) -> bool:
    """Return whether a VelSet (percentage, maximum speed in mm/s) may change the speed of a move.

    It does unless it states 100 % and a maximum of at least 5000 mm/s, which no move exceeds.
    """
    return step.values[0] != 100.0 or step.values[1] is None or step.values[1] < 5000.0


@rule("verify.hidden")
def hidden(context: Context) -> RuleOutcome:
    """Only the straight path of the program runs, and nothing is hidden.
    No procedure is left over, no module is loaded, UNDO only switches off, and modules have no
    attributes.
    """
    issues = list[Issue]()
    for task in context.job.tasks:
        issues += check_task("verify.hidden", context, task).issues
        steps = [*task.steps, *(s for block in task.handlers.values() for s in block)]
        issues += [
            step_issue("verify.hidden", f"{step.kind} of a module: its contents are not proven", task, step)
            for step in steps
            if isinstance(step, LoadStep)
        ]
        for block in task.undos.values():
            issues += [
                step_issue("verify.hidden", "UNDO does more than switch off and leave the block", task, step)
                for step in block
                if not _is_allowed_in_undo(step)
            ]
    return RuleOutcome(tuple(issues))


def _is_allowed_in_undo(step: ProgramStep) -> bool:
    """Return whether a step is allowed in UNDO: an immediate switch to off, SyncMoveUndo, or a message."""
    if isinstance(step, SignalStep):
        return not step.value and not step.delay
    if isinstance(step, SyncStep):
        return step.kind == "SyncMoveUndo"
    return isinstance(step, MessageStep) and not step.confirm
