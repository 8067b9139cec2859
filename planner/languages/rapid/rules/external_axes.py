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

    Args:
        context: The proof.
        task: The task.
    """
    axes = task_axes(task.arm, context.problem.cell.turntable)
    return RuleOutcome((*_unit_issues(task, axes), *(_offset_issues(task, axes) if axes else ())))


def checks_axis(context: Context, axis: TaskAxis, step: SettingStep) -> bool:
    """Return whether a step checks an axis. verify.cell_check examines what it compares.

    Args:
        context: The proof.
        axis: The external axis.
        step: The step.
    """
    return step.kind == AXES_CHECK_PROCEDURE


def _unit_issues(task: TaskText, axes: Sequence[TaskAxis]) -> Iterator[Issue]:
    activations, moved = dict.fromkeys((axis.mechanical_unit.lower() for axis in axes), 0), False
    names = {axis.mechanical_unit.lower(): axis.mechanical_unit for axis in axes}
    for step in task.steps:
        moved |= isinstance(step, MoveStep)
        if not isinstance(step, SettingStep) or step.kind not in ("ActUnit", "DeactUnit"):
            continue
        if step.unit not in activations:
            allowed = " and ".join(names.values()) or "none"
            what = f"{step.kind} {step.unit}: the unit of {task.arm.name} is {allowed}"
            yield step_issue(EXTERNAL_AXES, what, task, step)
        elif step.kind == "DeactUnit":
            what = f"{names[step.unit]} is deactivated, so that only its brakes hold it"
            yield step_issue(EXTERNAL_AXES, what, task, step)
        else:
            activations[step.unit] += 1
            if moved or activations[step.unit] > 1:
                what = f"{names[step.unit]} must be activated once, before any move"
                yield step_issue(EXTERNAL_AXES, what, task, step)
    for unit in (names[key] for key, count in activations.items() if not count):
        what = f"{unit} is not activated, so its values have no effect"
        yield Issue(EXTERNAL_AXES, what, arm=task.arm.name, file=task.name, hint=f"ActUnit {unit};")


def _offset_issues(task: TaskText, axes: Sequence[TaskAxis]) -> Iterator[Issue]:
    r"""Moves that offsets of external axes would shift, which another program may have left active.

    These are all checks and moves before EOffsOff, and joint moves without \NoEOffs, because a start from
    elsewhere than main skips EOffsOff.
    """
    names, offsets_cleared = " and ".join(axis.label for axis in axes), False
    for step in task.steps:
        offsets_cleared |= isinstance(step, SettingStep) and step.kind == "EOffsOff"
        is_check = isinstance(step, SettingStep) and step.kind == AXES_CHECK_PROCEDURE
        if not offsets_cleared and (is_check or isinstance(step, MoveStep)):
            what = f"an offset of {names} from another program would shift its position and its moves"
            yield step_issue(EXTERNAL_AXES, what, task, step, "add EOffsOff before all checks and moves")
            return
        if not isinstance(step, MoveStep):
            continue
        if step.kind == "MoveAbsJ" and "noeoffs" not in step.switches:
            what = f"an offset of {names} would shift the move"
            yield step_issue(EXTERNAL_AXES, what, task, step, "use MoveAbsJ with \\NoEOffs")
