"""Parts of verify.external_axes that RAPID alone has: mechanical units, offsets, and the look at axes."""

from collections.abc import Iterator, Sequence

from planner.issues import Issue
from planner.languages.rapid.reader.flow import AXES_CHECK
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, SettingStep
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import OuterAxis, outer_axes
from planner.proof.rule import Outcome, at_step
from planner.proof.rules.external_axes import EXTERNAL_AXES


def units_and_offsets(context: Context, task: TaskText) -> Outcome:
    """Units that are not switched on as they should be, and offsets that may be left on."""
    axes = outer_axes(task.arm, context.problem.cell.turntable)
    return Outcome((*_units(task, axes), *(_offsets(task, axes) if axes else ())))


def looks_at(context: Context, axis: OuterAxis, step: SettingStep) -> bool:
    """Return whether a step looks at an axis. What it compares is for verify.cell_check."""
    return step.kind == AXES_CHECK


def _units(task: TaskText, axes: Sequence[OuterAxis]) -> Iterator[Issue]:
    on, moved = dict.fromkeys((axis.mechanism.lower() for axis in axes), 0), False
    names = {axis.mechanism.lower(): axis.mechanism for axis in axes}
    for step in task.steps:
        moved |= isinstance(step, MoveStep)
        if not isinstance(step, SettingStep) or step.kind not in ("ActUnit", "DeactUnit"):
            continue
        if step.unit not in on:
            wanted = " and ".join(names.values()) or "none"
            what = f"{step.kind} {step.unit}: the unit of {task.arm.name} is {wanted}"
            yield at_step(EXTERNAL_AXES, what, task, step)
        elif step.kind == "DeactUnit":
            what = f"{names[step.unit]} is switched off, and its brakes alone hold it"
            yield at_step(EXTERNAL_AXES, what, task, step)
        else:
            on[step.unit] += 1
            if moved or on[step.unit] > 1:
                what = f"{names[step.unit]} is to be switched on once, before any move"
                yield at_step(EXTERNAL_AXES, what, task, step)
    for unit in (names[key] for key, count in on.items() if not count):
        what = f"{unit} is not switched on: its values count for nothing"
        yield Issue(EXTERNAL_AXES, what, arm=task.arm.name, file=task.name, hint=f"ActUnit {unit};")


def _offsets(task: TaskText, axes: Sequence[OuterAxis]) -> Iterator[Issue]:
    """Moves that offsets of external axes would shift, which another program may have left on: all behind
    which none are switched off (EOffsOff), and moves of joints that do not say to pass over them (\\NoEOffs),
    as a start from elsewhere than main passes over the former."""
    names, off = " and ".join(axis.unit for axis in axes), False
    for step in task.steps:
        off |= isinstance(step, SettingStep) and step.kind == "EOffsOff"
        looks = isinstance(step, SettingStep) and step.kind == AXES_CHECK
        if not off and (looks or isinstance(step, MoveStep)):
            what = f"an offset of {names} that another program has left would shift where it is seen and goes"
            yield at_step(EXTERNAL_AXES, what, task, step, "EOffsOff; before all looks and moves")
            return
        if not isinstance(step, MoveStep):
            continue
        if step.kind == "MoveAbsJ" and "noeoffs" not in step.switches:
            what = f"an offset of {names} would shift the move"
            yield at_step(EXTERNAL_AXES, what, task, step, "MoveAbsJ with \\NoEOffs")
