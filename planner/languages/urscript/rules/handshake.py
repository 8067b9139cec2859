"""Parts of verify.handshake for URScript alone: watching the other program, and starting anew after
stops.
"""

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
    """Return the faults of watchdog threads, and of programs that would run on each other's controller."""
    script_tasks = (task for task in context.job.tasks if isinstance(task.text, ScriptText))
    return [
        *(issue for task in script_tasks for issue in _watchdog_issues(context, task)),
        *_exchangeable_programs(context),
    ]


def _watchdog_issues(context: Context, task: TaskText) -> list[Issue]:
    """Return the faults of the thread by which a program stops when the other one does.

    UR controllers have no input for that which is configured outside of the program.
    """
    wiring = stages.controller_wiring(context.problem)
    other = next(candidate for candidate in context.job.tasks if candidate is not task)
    issues: list[Issue] = []

    def fault(what: str, step: ProgramStep, hint: str = "") -> None:
        issues.append(step_issue(HANDSHAKE, what, task, step, hint or None))

    watched = seen = False
    power: dict[str, ProgramStep] = {}
    watches, drives = wiring.running_inputs.get(task.name, frozenset()), wiring.drives[task.name]
    for step in task.steps:
        match step:
            case WaitStep() if step.signal.lower() in watches:
                seen = step.value == 1.0
            case CheckStep():
                seen = step.runs.lower() in watches
            case RunningStep(on=on):
                seen = seen and on
                if watched and not on:
                    fault("the thread ends this program at its own question", step, "kill the thread before")
            case WatchStep(on=on):
                if on and not seen:
                    what = f"{other.name} may be stopped since a question; check first that it runs"
                    fault(what, step)
                if step.signal.lower() not in watches:
                    fault(f"{step.signal} is watched, but is not the end of a running wire", step)
                watched, seen = on, seen and on
            case SignalStep() if step.signal.lower() not in drives:
                power.pop(step.signal.lower(), None)
                if step.value:
                    power[step.signal.lower()] = step
        moves = isinstance(step, MoveStep)
        if not watched and (moves or power):
            what = "the arm moves" if moves else f"{next(iter(power.values())).signal} is on"  # type: ignore[attr-defined]
            what += f" while nothing watches whether the program of {other.name} runs"
            fault(what, step, "start the thread before, or switch the power off")
            power.clear()
    return issues[:MAX_FAULTS]


def _exchangeable_programs(context: Context) -> list[Issue]:
    """Report two UR controllers on which each other's programs would run. Only signal numbers
    distinguish them.
    """
    tasks, controller = context.job.tasks, context.problem.cell.controller
    if not all(isinstance(task.text, ScriptText) for task in tasks):
        return []
    issues = []
    for task, other in (tasks, tasks[::-1]):
        number = controller.signal_number(task.name, controller.handshake.of(task.name).running)
        names = signals.controller_signals(context.problem, other.arm).outputs
        if number is not None and number in names:
            what = (
                f"the running wire of {task.name} is output {number}, which is {names[number]} at "
                f"{other.name}; programs copied to each other's controller would run there"
            )
            issues.append(Issue(HANDSHAKE, what, arm=task.arm.name, hint="use another output for it"))
    return issues


_RESTART_WORDS: Final = {
    "start": "starts at its first statement",
    "stop": "is stopped",
    "pause": "is paused",
    "go on": "is continued",
    "end": "ends",
    "step": "continues",
}
_RESTART_FAULTS: Final = {
    "unwatched": "{0} works while nothing watches whether the program of {1} runs",
    "apart": "{0} works while the program of {1} is elsewhere, because one of them was restarted",
    "ends": "{0} ends itself though nothing was stopped: {1} is not in the expected state",
    "stuck": "{0} and {1} wait forever",
}


def restarts(context: Context, wiring: Wiring) -> tuple[list[Issue], int]:
    """Return the faults of two programs that start anew after each stop, and the number of examined
    states.
    """
    tasks, readings = context.job.tasks, context.job.automata_by_arm or {}
    handshake_settings = context.problem.cell.controller.handshake
    if (
        not all(isinstance(task.text, ScriptText) for task in tasks)
        or handshake_settings.kind != "four_phase"
    ):
        what = "a URScript program, which restarts after a stop, can only meet another URScript program, by "
        return [Issue(HANDSHAKE, f"{what}four-phase handshake")], 0
    rows, blocks = zip(
        *(
            handshake_moves.wire_operations(
                task.steps,
                readings[task.name].interval,
                wiring.drives[task.name],
                wiring.reads[task.name],
                wiring.running_inputs.get(task.name, frozenset()),
            )
            for task in tasks
        ),
        strict=True,
    )
    states = 0
    for disturbed in (False, True):
        try:
            result = restart_model.check_restarts(rows, blocks, disturbed=disturbed)
        except OverflowError as many:
            what = f"the programs have too many states between meetings to be checked: {many}"
            return [Issue(HANDSHAKE, what, hint="split the job")], states
        states += result.states
        if result.kind is not None:
            return [_restart_issue(context, result)], states
    return [], states


def _restart_issue(context: Context, result: restart_model.RestartResult) -> Issue:
    """Describe a fault, with the last events before it."""
    tasks = context.job.tasks

    def at(program: int, line: int) -> str:
        steps = tasks[program].steps
        return f"(line {steps[line].line} of {steps[line].module})" if line < len(steps) else "(at its end)"

    faulty, other = tasks[result.program], tasks[1 - result.program]
    head = _RESTART_FAULTS[result.kind or "stuck"].format(faulty.name, other.name)
    events = "; ".join(
        f"{tasks[program].name} {_RESTART_WORDS[what]} {at(program, line)}"
        for program, what, line in result.events[-MAX_EVENTS_SHOWN:]
    )
    line_index = result.lines[result.program]
    step = faulty.steps[line_index] if line_index < len(faulty.steps) else None
    return step_issue(HANDSHAKE, f"{head}. Shortest path, last events: {events}", faulty, step)
