"""RAPID's part of verify.external_axes: mechanical units, offsets, and the check of positions."""

from collections.abc import Iterator, Sequence

from planner.issues import Issue
from planner.languages.rapid.reader.flow import AXES_CHECK_PROCEDURE
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, SettingStep
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import TaskAxis, task_axes
from planner.proof.rule import RuleOutcome, step_issue
from planner.proof.rules.external_axes import EXTERNAL_AXES


def units_and_offsets(context: Context, task: TaskText) -> RuleOutcome:
    """Check that mechanical units are activated correctly and that no offsets stay active.

    Offsets are checked only if the arm has external axes.

    Args:
        context: The proof.
        task: The task.
    """
    axes = task_axes(task.arm, context.problem.cell.turntable)
    return RuleOutcome((*_unit_issues(task, axes), *(_offset_issues(task, axes) if axes else ())))


def checks_axis(context: Context, axis: TaskAxis, step: SettingStep) -> bool:
    """Return whether a step calls the check of external axes, whose text verify.cell_check examines.

    Args:
        context: The proof.
        axis: The external axis.
        step: The step.
    """
    return step.kind == AXES_CHECK_PROCEDURE


def _unit_issues(task: TaskText, axes: Sequence[TaskAxis]) -> Iterator[Issue]:
    """Yield the issues of ActUnit and DeactUnit.

    Each mechanical unit of the arm must be activated once, before any move, and never be deactivated. Other
    units must not be named. An arm without external axes has no unit.
    """
    activations = dict.fromkeys((axis.mechanical_unit.lower() for axis in axes), 0)
    moved = False
    names = {axis.mechanical_unit.lower(): axis.mechanical_unit for axis in axes}
    for step in task.steps:
        moved |= isinstance(step, MoveStep)
        if not isinstance(step, SettingStep) or step.kind not in ("ActUnit", "DeactUnit"):
            continue
        if step.unit not in activations:
            allowed = " and ".join(names.values()) or "none"
            message = f"{step.kind} {step.unit}: the unit of {task.arm.name} is {allowed}"
            yield step_issue(EXTERNAL_AXES, message, task, step)
        elif step.kind == "DeactUnit":
            message = f"{names[step.unit]} is deactivated, so that only its brakes hold it"
            yield step_issue(EXTERNAL_AXES, message, task, step)
        else:
            activations[step.unit] += 1
            if moved or activations[step.unit] > 1:
                message = f"{names[step.unit]} must be activated once, before any move"
                yield step_issue(EXTERNAL_AXES, message, task, step)
    for unit in (names[key] for key, count in activations.items() if not count):
        message = f"{unit} is not activated, so its values have no effect"
        yield Issue(EXTERNAL_AXES, message, arm=task.arm.name, file=task.name, hint=f"ActUnit {unit};")


def _offset_issues(task: TaskText, axes: Sequence[TaskAxis]) -> Iterator[Issue]:
    r"""Yield the issues of moves and checks that an offset of external axes would shift.

    All checks of external axes and all moves must follow EOffsOff. Joint moves also need \NoEOffs, because a
    program that does not start at main skips EOffsOff. After the first check or move without EOffsOff before
    it, nothing more is reported.
    """
    names = " and ".join(axis.label for axis in axes)
    offsets_cleared = False
    for step in task.steps:
        offsets_cleared |= isinstance(step, SettingStep) and step.kind == "EOffsOff"
        is_check = isinstance(step, SettingStep) and step.kind == AXES_CHECK_PROCEDURE
        if not offsets_cleared and (is_check or isinstance(step, MoveStep)):
            message = f"an offset of {names} from another program would shift its position and its moves"
            yield step_issue(EXTERNAL_AXES, message, task, step, "add EOffsOff before all checks and moves")
            return
        if not isinstance(step, MoveStep):
            continue
        if step.kind == "MoveAbsJ" and "noeoffs" not in step.switches:
            message = f"an offset of {names} would shift the move"
            yield step_issue(EXTERNAL_AXES, message, task, step, "use MoveAbsJ with \\NoEOffs")
