"""verify.signals: signals of power sources."""

from collections.abc import Iterator

from planner.claims.claim import powers
from planner.issues import Issue
from planner.programs.job import group_by_controller
from planner.programs.stages import TaskText
from planner.programs.steps import MessageStep, MoveStep, ProgramStep, SignalStep
from planner.proof.context import Context
from planner.proof.language_contribution import check_task
from planner.proof.rule import RuleOutcome, rule, step_issue


@rule("verify.signals")
def signals(context: Context) -> RuleOutcome:
    """Only signals of wires, spindles, knives, torches and sinking clamps are switched.
    They are set to 0 or 1 without delay, by one task of a controller between two synchronisation points,
    and are off before the operator is asked or an arm moves.
    """
    issues: list[Issue] = []
    power_signals = {power.signal.lower() for power in powers(context.claims)}
    power_signals.add(context.problem.cell.controller.wire_signal.lower())
    issues += _possibly_left_on(context, power_signals)
    controller_tasks = {
        task.name: tasks
        for tasks in group_by_controller(context.problem, context.job.tasks)
        for task in tasks
    }
    for stage in context.job.stages:
        switches: dict[str, TaskText] = {}  # of each controller, by its first task
        for task in context.job.tasks:
            for step in stage.steps[task.name]:
                if not isinstance(step, SignalStep):
                    continue
                faults = []
                if step.signal.lower() not in power_signals:
                    faults.append(
                        f"{step.signal} is not a signal of a wire, a spindle, a knife, a clamp or a torch"
                    )
                if step.value not in (0.0, 1.0):
                    faults.append(f"{step.signal} is set to {step.value:g}; allowed: 0 or 1")
                if step.delay:
                    faults.append(f"{step.signal} is switched with a delay of {step.delay:g} s")
                first = switches.setdefault(controller_tasks[task.name][0].name, task)
                if first is not task:
                    faults.append(f"{first.name} switches a signal between the same synchronisation points")
                issues += [step_issue("verify.signals", fault, task, step) for fault in faults]
    for task in context.job.tasks:
        issues += check_task("verify.signals", context, task).issues
    return RuleOutcome(tuple(issues))


def _possibly_left_on(context: Context, power_signals: set[str]) -> list[Issue]:
    """Report signals of power sources that a task does not switch off before it first asks or moves.

    An earlier run may have left them on.
    """
    issues = []
    for task in context.job.tasks:
        switched_off: set[str] = set()
        first: ProgramStep | None = None
        for step in task.steps:
            if isinstance(step, MoveStep) or (isinstance(step, MessageStep) and step.confirm):
                first = first or step
            elif isinstance(step, SignalStep) and step.signal.lower() in power_signals:
                name = step.signal.lower()
                if name not in switched_off and (first is not None or step.value):
                    message = f"{step.signal} is not switched off first; an earlier run may have left it on"
                    issues.append(step_issue("verify.signals", message, task, step))
                switched_off.add(name)
    return issues


def all_steps(context: Context) -> Iterator[tuple[int, TaskText, ProgramStep]]:
    """Yield the steps of all tasks, stage by stage, each with the number of its stage and its task.

    In a stage the tasks follow one another. This is the order in time of switches, as only one task switches
    within a stage.
    """
    for number, stage in enumerate(context.job.stages):
        for task in context.job.tasks:
            yield from ((number, task, step) for step in stage.steps[task.name])
