"""Parts of verify.handshake that only URScript has: watching the other program, starting anew after stops."""

from typing import Final

from planner.issues import Issue
from planner.languages.urscript.reader.reader import ScriptText
from planner.programs import signals, stages
from planner.programs.handshake import moves as handshake_moves
from planner.programs.handshake import restarts as restart_model
from planner.programs.handshake.automata import Wiring
from planner.programs.stages import TaskText
from planner.programs.steps import CheckStep, MoveStep, RunningStep, SignalStep, Step, WaitStep, WatchStep
from planner.proof.context import Context
from planner.proof.rule import at_step
from planner.proof.rules.handshake import EVENTS_SHOWN, HANDSHAKE, MOST_FAULTS


def handshake(context: Context) -> list[Issue]:
    """Return the faults of watching threads, and of programs that would run on each other's controller."""
    own = (task for task in context.job.tasks if isinstance(task.text, ScriptText))
    return [*(issue for task in own for issue in _watched(context, task)), *_exchanged(context)]


def _watched(context: Context, task: TaskText) -> list[Issue]:
    """Faults of the thread by which a program of URScript stops when the other one does: no controller of UR
    has an input for that which is set beside the program."""
    wiring = stages.wiring(context.problem)
    other = next(one for one in context.job.tasks if one is not task)
    issues: list[Issue] = []

    def fault(what: str, step: Step, hint: str = "") -> None:
        issues.append(at_step(HANDSHAKE, what, task, step, hint or None))

    watched = seen = False
    power: dict[str, Step] = {}
    watches, drives = wiring.watches.get(task.name, frozenset()), wiring.drives[task.name]
    for step in task.steps:
        match step:
            case WaitStep() if step.signal.lower() in watches:
                seen = step.value == 1.0
            case CheckStep():
                seen = step.runs.lower() in watches
            case RunningStep(on=on):
                seen = seen and on
                if watched and not on:
                    fault("the thread ends this program at its own question", step, "kill it before")
            case WatchStep(on=on):
                if on and not seen:
                    what = f"{other.name} may stand since a question; it must be seen to run first"
                    fault(what, step)
                if step.signal.lower() not in watches:
                    fault(f"{step.signal} is watched, which no running wire leads to", step)
                watched, seen = on, seen and on
            case SignalStep() if step.signal.lower() not in drives:
                power.pop(step.signal.lower(), None)
                if step.value:
                    power[step.signal.lower()] = step
        moves = isinstance(step, MoveStep)
        if not watched and (moves or power):
            what = "the arm moves" if moves else f"{next(iter(power.values())).signal} is on"  # type: ignore[attr-defined]
            what += f" while nothing watches whether the program of {other.name} runs"
            fault(what, step, "run the thread before, or switch it off")
            power.clear()
    return issues[:MOST_FAULTS]


def _exchanged(context: Context) -> list[Issue]:
    """Two controllers of UR on which each other's programs would run: numbers alone tell them apart."""
    tasks, controller = context.job.tasks, context.problem.cell.controller
    if not all(isinstance(task.text, ScriptText) for task in tasks):
        return []
    issues = []
    for task, other in (tasks, tasks[::-1]):
        number = controller.number(task.name, controller.handshake.of(task.name).running)
        names = signals.krl_signals(context.problem, other.arm).outputs
        if number is not None and number in names:
            what = (
                f"the running wire of {task.name} is output {number}, which is {names[number]} at "
                f"{other.name}; programs copied to each other's controller would run there"
            )
            issues.append(Issue(HANDSHAKE, what, arm=task.arm.name, hint="take another output for it"))
    return issues


_RESTART_WORDS: Final = {
    "start": "begins at its first statement",
    "stop": "is stopped",
    "pause": "is paused",
    "go on": "is continued",
    "end": "comes to its end",
    "step": "goes on",
}
_RESTART_FAULTS: Final = {
    "unwatched": "{0} works while nothing watches whether the program of {1} runs",
    "apart": "{0} works while the program of {1} runs, and stands elsewhere: one of them was started anew",
    "ends": "{0} ends itself though nobody has stopped anything: {1} is not as it looks for",
    "stuck": "{0} and {1} wait for ever",
}


def restarts(context: Context, wiring: Wiring) -> tuple[list[Issue], int]:
    """Faults of two programs that begin anew behind each stop, and how many states were looked at."""
    tasks, readings = context.job.tasks, context.job.readings or {}
    own = context.problem.cell.controller.handshake
    if not all(isinstance(task.text, ScriptText) for task in tasks) or own.kind != "four_phase":
        what = (
            "a program of URScript, which begins anew behind a stop, meets another one of its like alone, by "
        )
        return [Issue(HANDSHAKE, f"{what}four-phase handshake")], 0
    rows, blocks = zip(
        *(
            handshake_moves.moves(
                task.steps,
                readings[task.name].interval,
                wiring.drives[task.name],
                wiring.reads[task.name],
                wiring.watches.get(task.name, frozenset()),
            )
            for task in tasks
        ),
        strict=True,
    )
    states = 0
    for disturbed in (False, True):
        try:
            found = restart_model.check(rows, blocks, disturbed=disturbed)
        except OverflowError as many:
            what = f"the programs do too many different things between their meetings to be looked at: {many}"
            return [Issue(HANDSHAKE, what, hint="split the job")], states
        states += found.states
        if found.kind is not None:
            return [_restarted(context, found)], states
    return [], states


def _restarted(context: Context, found: restart_model.Restarted) -> Issue:
    """A fault in words, with the last events before it."""
    tasks = context.job.tasks

    def at(program: int, line: int) -> str:
        steps = tasks[program].steps
        return f"(line {steps[line].line} of {steps[line].module})" if line < len(steps) else "(at its end)"

    mine, other = tasks[found.program], tasks[1 - found.program]
    head = _RESTART_FAULTS[found.kind or "stuck"].format(mine.name, other.name)
    events = "; ".join(
        f"{tasks[program].name} {_RESTART_WORDS[what]} {at(program, line)}"
        for program, what, line in found.events[-EVENTS_SHOWN:]
    )
    place = found.lines[found.program]
    step = mine.steps[place] if place < len(mine.steps) else None
    return at_step(HANDSHAKE, f"{head}. The shortest way there, its last events: {events}", mine, step)
