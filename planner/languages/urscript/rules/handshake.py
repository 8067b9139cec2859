"""Parts of verify.handshake for URScript: watchdog threads, and programs that restart after each stop."""

from typing import Final

from planner.issues import Issue
from planner.languages.urscript.reader.reader import ScriptText
from planner.programs import signals, stages
from planner.programs.handshake import restarts as restart_model
from planner.programs.handshake import wire_operations as handshake_moves
from planner.programs.handshake.automata import Wiring
from planner.programs.stages import TaskText
from planner.programs.steps import (
    CheckStep,
    MoveStep,
    ProgramStep,
    RunningStep,
    SignalStep,
    WaitStep,
    WatchStep,
)
from planner.proof.context import Context
from planner.proof.rule import step_issue
from planner.proof.rules.handshake import HANDSHAKE, MAX_EVENTS_SHOWN, MAX_FAULTS


def handshake_issues(context: Context) -> list[Issue]:
    """Return the issues of watchdog threads, and of programs that would run on each other's controller."""
    script_tasks = (task for task in context.job.tasks if isinstance(task.text, ScriptText))
    return [
        *(issue for task in script_tasks for issue in _watchdog_issues(context, task)),
        *_exchangeable_programs(context),
    ]


def _watchdog_issues(context: Context, task: TaskText) -> list[Issue]:
    """Return the issues of the thread that ends a program when the other one stops.

    UR controllers have no input for this purpose that is configured outside of the program. Therefore:

    - The thread runs while the arm moves or power is on.
    - It watches the input at which a running wire ends.
    - Before it starts, and after each question, the program has seen that the other program runs.
    - It does not run while the program's own running wire is low for a question.

    At most :data:`MAX_FAULTS` issues are returned.
    """
    wiring = stages.controller_wiring(context.problem)
    other = next(candidate for candidate in context.job.tasks if candidate is not task)
    issues: list[Issue] = []

    def add_issue(message: str, step: ProgramStep, hint: str = "") -> None:
        issues.append(step_issue(HANDSHAKE, message, task, step, hint or None))

    watched = False  # the thread runs
    partner_seen = False  # the other program has been seen to run since the last question
    powered: dict[str, ProgramStep] = {}  # outputs that are on, with the step that switched them
    running_inputs = wiring.running_inputs.get(task.name, frozenset())
    line_outputs = wiring.drives[task.name]
    for step in task.steps:
        match step:
            case WaitStep() if step.signal.lower() in running_inputs:
                partner_seen = step.value == 1.0
            case CheckStep():
                partner_seen = step.runs.lower() in running_inputs
            case RunningStep(on=on):
                partner_seen = partner_seen and on
                if watched and not on:
                    add_issue(
                        "the thread ends this program at its own question", step, "kill the thread before"
                    )
            case WatchStep(on=on):
                if on and not partner_seen:
                    message = f"{other.name} may be stopped since a question; check first that it runs"
                    add_issue(message, step)
                if step.signal.lower() not in running_inputs:
                    add_issue(f"{step.signal} is watched, but is not the end of a running wire", step)
                watched = on
                partner_seen = partner_seen and on
            case SignalStep() if step.signal.lower() not in line_outputs:
                powered.pop(step.signal.lower(), None)
                if step.value:
                    powered[step.signal.lower()] = step
        moves = isinstance(step, MoveStep)
        if not watched and (moves or powered):
            cause = "the arm moves" if moves else f"{next(iter(powered.values())).signal} is on"  # type: ignore[attr-defined]
            message = f"{cause} while nothing watches whether the program of {other.name} runs"
            add_issue(message, step, "start the thread before, or switch the power off")
            powered.clear()  # one issue for each of these outputs
    return issues[:MAX_FAULTS]


def _exchangeable_programs(context: Context) -> list[Issue]:
    """Return issues if the program of one controller would also run on the other one.

    Only signal numbers prevent that: the running wire of one must not be an output of the other. Nothing is
    checked unless both programs are URScript.
    """
    tasks = context.job.tasks
    controller = context.problem.cell.controller
    if not all(isinstance(task.text, ScriptText) for task in tasks):
        return []
    issues = []
    for task, other in (tasks, tasks[::-1]):
        number = controller.signal_number(task.name, controller.handshake.of(task.name).running)
        other_outputs = signals.controller_signals(context.problem, other.arm).outputs
        if number is not None and number in other_outputs:
            message = (
                f"the running wire of {task.name} is output {number}, which is {other_outputs[number]} at "
                f"{other.name}; programs copied to each other's controller would run there"
            )
            issues.append(Issue(HANDSHAKE, message, arm=task.arm.name, hint="use another output for it"))
    return issues


_EVENT_TEXTS: Final = {
    "start": "starts at its first statement",
    "stop": "is stopped",
    "pause": "is paused",
    "go on": "is continued",
    "end": "ends",
    "step": "continues",
}
"""Texts for the events of the model of restarts."""
_RESTART_FAULTS: Final = {
    "unwatched": "{0} works while nothing watches whether the program of {1} runs",
    "apart": "{0} works while the program of {1} is elsewhere, because one of them was restarted",
    "ends": "{0} ends itself though nothing was stopped: {1} is not in the expected state",
    "stuck": "{0} and {1} wait forever",
}
"""Messages for the faults of the model of restarts; {0} is the faulty program, {1} the other one."""


def restarts(context: Context, wiring: Wiring) -> tuple[list[Issue], int]:
    """Check that two programs stay together, although each starts from its beginning after a stop.

    A model of both programs is searched for states in which one works without the other, first without any
    stop and then with stops and pauses at any step. Both programs must be URScript.

    Args:
        context: The proof.
        wiring: Wires between the controllers.

    Returns:
        The issues, at most one, and the number of examined states of the two programs.
    """
    tasks = context.job.tasks
    automata = context.job.automata_by_arm or {}
    handshake_settings = context.problem.cell.controller.handshake
    if (
        not all(isinstance(task.text, ScriptText) for task in tasks)
        or handshake_settings.kind != "four_phase"
    ):
        message = (
            "a URScript program, which restarts after a stop, can only meet another URScript program, by "
            "four-phase handshake"
        )
        return [Issue(HANDSHAKE, message)], 0
    operations, intervals = zip(
        *(
            handshake_moves.wire_operations(
                task.steps,
                automata[task.name].interval,
                wiring.drives[task.name],
                wiring.reads[task.name],
                wiring.running_inputs.get(task.name, frozenset()),
            )
            for task in tasks
        ),
        strict=True,
    )
    states = 0
    for disturbed in (False, True):  # whether a program may be stopped or paused at any step
        try:
            result = restart_model.check_restarts(operations, intervals, disturbed=disturbed)
        except OverflowError as error:
            message = f"the programs have too many states between meetings to be checked: {error}"
            return [Issue(HANDSHAKE, message, hint="split the job")], states
        states += result.states
        if result.kind is not None:
            return [_restart_issue(context, result)], states
    return [], states


def _restart_issue(context: Context, result: restart_model.RestartResult) -> Issue:
    """Return the issue of a fault that the model found, with the last events of the shortest path to it."""
    tasks = context.job.tasks

    def step_position(program: int, index: int) -> str:
        steps = tasks[program].steps
        return (
            f"(line {steps[index].line} of {steps[index].module})" if index < len(steps) else "(at its end)"
        )

    faulty, other = tasks[result.program], tasks[1 - result.program]
    head = _RESTART_FAULTS[result.kind or "stuck"].format(faulty.name, other.name)
    events = "; ".join(
        f"{tasks[program].name} {_EVENT_TEXTS[event]} {step_position(program, index)}"
        for program, event, index in result.events[-MAX_EVENTS_SHOWN:]
    )
    step_index = result.lines[result.program]
    step = faulty.steps[step_index] if step_index < len(faulty.steps) else None
    return step_issue(HANDSHAKE, f"{head}. Shortest path, last events: {events}", faulty, step)
