"""Rules on settings of the motion, and on what programs hide: verify.motion_settings and hidden."""

from planner.issues import Issue
from planner.programs.steps import (
    LoadStep,
    MessageStep,
    MoveStep,
    SettingStep,
    SignalStep,
    Step,
    SyncStep,
    WaitStep,
)
from planner.proof.context import Context
from planner.proof.language_contribution import checked
from planner.proof.rule import Outcome, at_step, rule

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
"""Instructions that stop, keep or clear the path."""


@rule("verify.motion_settings")
def motion_settings(context: Context) -> Outcome:
    """Nothing makes the moves slower than their times say (AccSet or VelSet below 100 %), lets them leave
    their path (SingArea other than Off) or drops them (ClearPath and others)."""
    slow = "AccSet and VelSet other than 100 % make the moves other than their times say"
    issues = []
    for task in context.job.tasks:
        # a program that meets another controller's may let its running wire fall before anything moves
        first = next((step for step in task.steps if isinstance(step, MoveStep)), None)
        moved = context.job.readings is None
        for step in task.steps:
            moved |= step is first
            if isinstance(step, WaitStep) and (step.seconds or 0.0) < 0.0:
                issues.append(at_step("verify.motion_settings", "a wait of less than nothing", task, step))
            if not isinstance(step, SettingStep):
                continue
            full = all(value == 100.0 for value in step.values)
            if (step.kind == "AccSet" and not full) or (step.kind == "VelSet" and _limits(step)):
                issues.append(at_step("verify.motion_settings", slow, task, step))
            if step.kind == "SingArea" and step.switches != ("off",):
                what = "SingArea lets the tool leave its path near singular postures"
                issues.append(at_step("verify.motion_settings", what, task, step, "SingArea\\Off"))
            if step.kind in _PATH_INSTRUCTIONS and (moved or step.kind != "Stop" or step.switches):
                what = f"{step.kind} on the way: the moves are no longer those of the text"
                issues.append(at_step("verify.motion_settings", what, task, step))
    return Outcome(tuple(issues))


def _limits(step: SettingStep) -> bool:
    """Whether a VelSet (share in %, highest speed in mm/s) holds any move back."""
    return step.values[0] != 100.0 or step.values[1] is None or step.values[1] < 5000.0


@rule("verify.hidden")
def hidden(context: Context) -> Outcome:
    """Nothing runs but the straight way: no procedure is left over, no module loaded, UNDO switches off; and
    nothing hides: modules have no attributes."""
    issues = list[Issue]()
    for task in context.job.tasks:
        issues += checked("verify.hidden", context, task).issues
        steps = [*task.steps, *(s for block in task.handlers.values() for s in block)]
        issues += [
            at_step("verify.hidden", f"{step.kind} of a module: what it holds is not proven", task, step)
            for step in steps
            if isinstance(step, LoadStep)
        ]
        for block in task.undos.values():
            issues += [
                at_step("verify.hidden", "UNDO does more than switch off and leave the block", task, step)
                for step in block
                if not _undoes(step)
            ]
    return Outcome(tuple(issues))


def _undoes(step: Step) -> bool:
    if isinstance(step, SignalStep):
        return not step.value and not step.delay
    if isinstance(step, SyncStep):
        return step.kind == "SyncMoveUndo"
    return isinstance(step, MessageStep) and not step.confirm
