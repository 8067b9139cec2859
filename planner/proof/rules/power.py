"""The rule on signals of power sources."""

from collections.abc import Iterator

from planner.claims.claim import powers
from planner.issues import Issue
from planner.programs.job import controllers
from planner.programs.stages import TaskText
from planner.programs.steps import MessageStep, MoveStep, SignalStep, Step
from planner.proof.context import Context
from planner.proof.language_contribution import checked
from planner.proof.rule import Outcome, at_step, rule


@rule("verify.signals")
def signals(context: Context) -> Outcome:
    """Only the signals of wires, spindles, knives, torches and clamps that sink are switched, to 0 or 1, at
    once, by one task of a controller between two synchronisation points, and are off before anybody is asked
    or an arm moves."""
    issues: list[Issue] = []
    known = {power.signal.lower() for power in powers(context.claims)}
    known.add(context.problem.cell.controller.wire_signal.lower())
    issues += _left_on(context, known)
    runs = {task.name: tasks for tasks in controllers(context.problem, context.job.tasks) for task in tasks}
    for stage in context.job.stages:
        switches: dict[str, TaskText] = {}  # of each controller, by its first task
        for task in context.job.tasks:
            for step in stage.steps[task.name]:
                if not isinstance(step, SignalStep):
                    continue
                faults = []
                if step.signal.lower() not in known:
                    faults.append(
                        f"{step.signal} is no signal of a wire, a spindle, a knife, a clamp or a torch"
                    )
                if step.value not in (0.0, 1.0):
                    faults.append(f"{step.signal} is set to {step.value:g}, neither 0 nor 1")
                if step.delay:
                    faults.append(f"{step.signal} is switched {step.delay:g} s later")
                first = switches.setdefault(runs[task.name][0].name, task)
                if first is not task:
                    faults.append(f"{first.name} switches a signal between the same synchronisation points")
                issues += [at_step("verify.signals", fault, task, step) for fault in faults]
    for task in context.job.tasks:
        issues += checked("verify.signals", context, task).issues
    return Outcome(tuple(issues))


def _left_on(context: Context, known: set[str]) -> list[Issue]:
    """Power that a program before this one may have left on, when a task asks or moves at first."""
    issues = []
    for task in context.job.tasks:
        off: set[str] = set()
        first: Step | None = None
        for step in task.steps:
            if isinstance(step, MoveStep) or (isinstance(step, MessageStep) and step.confirm):
                first = first or step
            elif isinstance(step, SignalStep) and step.signal.lower() in known:
                name = step.signal.lower()
                if name not in off and (first is not None or step.value):
                    what = f"{step.signal} is not switched off first; a run before this may have left it on"
                    issues.append(at_step("verify.signals", what, task, step))
                off.add(name)
    return issues


def all_steps(context: Context) -> Iterator[tuple[int, TaskText, Step]]:
    """Steps of all tasks, stage by stage; within a stage only one task switches."""
    for number, stage in enumerate(context.job.stages):
        for task in context.job.tasks:
            yield from ((number, task, step) for step in stage.steps[task.name])
