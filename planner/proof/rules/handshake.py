"""verify.handshake: two controllers that share only digital signals.

The findings of the model check become messages with arms, lines of programs and signals, which state which
program waits for which signal.
"""

from collections.abc import Mapping, Sequence
from typing import Final

from planner.claims.handshake import SignalWire
from planner.issues import Issue
from planner.programs import stages
from planner.programs.handshake.automata import ProgramAutomaton, Wiring
from planner.programs.handshake.model import (
    AutomatonAction,
    AutomatonEvent,
    HandshakeFault,
    ProgramProduct,
    RunningWire,
    check_handshake,
)
from planner.programs.steps import MoveStep, ProgramStep, SignalStep
from planner.proof.context import Context
from planner.proof.language_contribution import job_issues, language_of_task
from planner.proof.rule import RuleOutcome, rule, step_issue

MAX_EVENTS_SHOWN = 6
"""Maximum number of events before a fault that its message shows."""


class HandshakeMessages:
    """Messages about faults that the model check finds in two programs.

    The model check works on numbers of programs, actions and wires. Messages name arms, lines and signals.

    Attributes:
        arms: Names of the arms; the index is the number of the program in the check.
        actions: Actions of each program, in its order.
        steps: Steps of each program. An action refers to its step by the index ``line``.
        wires: Signal wires. An action refers to its wire by its index.
    """

    def __init__(
        self,
        arms: Sequence[str],
        readings: Mapping[str, ProgramAutomaton],
        steps: Mapping[str, Sequence[ProgramStep]],
        wires: Sequence[SignalWire],
    ) -> None:
        self.arms = arms
        self.actions = [readings[arm].actions for arm in arms]
        self.steps = [steps[arm] for arm in arms]
        self.wires = wires

    def message(self, finding: HandshakeFault) -> str:
        """Return the message about a fault: what is wrong, and the last events of the shortest path to it."""
        describers = {"deadlock": self._deadlock, "lost_edge": self._lost_edge, "apart": self._step_apart}
        describe = describers.get(finding.kind, self._unwatched)
        events = "; ".join(self.describe_event(event) for event in finding.trace[-MAX_EVENTS_SHOWN:])
        path = f" Shortest path, last of {finding.steps} events: {events}" if events else ""
        return f"{describe(finding)}.{path}"

    def step(self, finding: HandshakeFault) -> tuple[int, ProgramStep | None]:
        """Return the index of the program, and the step, at which a fault is reported.

        It is the next step of the faulty program, or of the other one if the faulty program is at its end. If
        both are at their ends, there is no step (None).
        """
        for program in (finding.program, 1 - finding.program):
            action = self._action(program, finding.positions[program])
            if action is not None:
                return program, self.steps[program][action.line]
        return finding.program, None

    def describe_event(self, event: AutomatonEvent) -> str:
        """Return a clause about an event, an action that a program has done: arm, action and line."""
        action = self._action(event.program, event.position)
        return f"{self.arms[event.program]} {self._describe_action(event.program, action)}"

    def _action(self, program: int, action_index: int) -> AutomatonAction | None:
        """Return an action of a program, None if the program is at its end."""
        actions = self.actions[program]
        return actions[action_index] if action_index < len(actions) else None

    def _line_text(self, program: int, action: AutomatonAction) -> str:
        """Return the line and the module of an action, in parentheses."""
        step = self.steps[program][action.line]
        return f"(line {step.line} of {step.module})"

    def _describe_action(self, program: int, action: AutomatonAction | None) -> str:
        """Return a clause about an action that a program has done, None for the end of the program.

        The kinds are those of :class:`AutomatonAction`; the last case is the answer of the operator.
        """
        if action is None:
            return "is at its end"
        at = self._line_text(program, action)
        wire = self.wires[action.wire] if action.kind in ("set", "wait") else None
        match action.kind:
            case "set" if wire is not None:
                return f"sets {wire.output} to {action.value} {at}"
            case "wait" if wire is not None:
                return f"has seen {wire.input} at {action.value} {at}"
            case "go":
                return f"starts the work after meeting {action.value} {at}"
            case "look":
                return f"has seen that the other program {'runs' if action.value else 'is stopped'} {at}"
            case "pause":
                return f"stops by itself {at}"
            case "done":
                return f"has finished the work after meeting {action.value}"
            case _:
                return f"gets the answer that the other arm is ready {at}"

    def _describe_state(self, program: int, finding: HandshakeFault) -> str:
        """Return a clause about the action that a program is about to do, or waits for, at a fault.

        For a wait it states the level that the input has, and the level of the output that drives it.
        """
        arm, action = self.arms[program], self._action(program, finding.positions[program])
        if action is None:
            return f"{arm} is at its end"
        at = self._line_text(program, action)
        match action.kind:
            case "wait":
                wire = self.wires[action.wire]
                level = f"{finding.read[action.wire]}, and {wire.output} of {wire.source}"
                level += f" is {finding.driven[action.wire]}"
                return f"{arm} waits for {wire.input} to be {action.value} {at}, which is {level}"
            case "set":
                return f"{arm} is about to set {self.wires[action.wire].output} to {action.value} {at}"
            case "go":
                return f"{arm} is at meeting {action.value} {at}"
            case "look":
                return f"{arm} waits until the other program {'runs' if action.value else 'is stopped'} {at}"
            case "pause":
                return f"{arm} is about to stop by itself {at}"
            case "done":
                return f"{arm} still works after meeting {action.value} {at}"
            case _:
                return f"{arm} waits until the other arm is ready {at}"

    def _deadlock(self, finding: HandshakeFault) -> str:
        """Describe a state in which both programs wait forever."""
        return (
            f"both programs wait forever: {self._describe_state(0, finding)}; "
            f"{self._describe_state(1, finding)}"
        )

    def _lost_edge(self, finding: HandshakeFault) -> str:
        """Describe a signal that changes before the other program has seen its last change."""
        action = self._action(finding.program, finding.positions[finding.program])
        if action is None:
            return "the other program never sees the last change of a signal"
        wire = self.wires[action.wire]
        return (
            f"{self.arms[finding.program]} sets {wire.output} to {action.value} "
            f"{self._line_text(finding.program, action)} before {wire.sink} has seen its last change: "
            f"{self._describe_state(1 - finding.program, finding)}"
        )

    def _step_apart(self, finding: HandshakeFault) -> str:
        """Describe a program that continues while the other one is more than one step behind."""
        action = self._action(finding.program, finding.positions[finding.program])
        number = action.value if action is not None else 0
        at = self._line_text(finding.program, action) if action is not None else ""
        return (
            f"{self.arms[finding.program]} continues after meeting {number} {at} while "
            f"{self._describe_state(1 - finding.program, finding)}: the arms are more than one step apart"
        )

    def _unwatched(self, finding: HandshakeFault) -> str:
        """Describe a program that works although a running wire is stuck, so that it would miss a stop."""
        action = self._action(finding.program, finding.positions[finding.program])
        at = self._line_text(finding.program, action) if action is not None else ""
        return (
            f"{self.arms[finding.program]} continues after the first meeting {at} with a stuck running wire, "
            "so that a stop would go unnoticed; each program must first see the wire at 0 and then at 1"
        )


HANDSHAKE = "verify.handshake"
"""Code of the rule on handshakes."""
MAX_FAULTS = 20
"""Maximum number of faults that are reported per program."""
_BOTH_RUNNING_WIRES_WORK: Final = ("works", "works")
"""State of the running wires of both arms if neither is stuck. A running wire states that a program runs. It
works, or is stuck at the level low or high.
"""
_MODEL_CASES: Final[tuple[tuple[bool, tuple[RunningWire, RunningWire] | None], ...]] = (
    (True, None),
    (False, None),
    (False, ("low", "works")),
    (False, ("high", "works")),
    (False, ("works", "low")),
    (False, ("works", "high")),
    (True, _BOTH_RUNNING_WIRES_WORK),
    (False, _BOTH_RUNNING_WIRES_WORK),
)
"""Cases of the model check: whether the operator starts and confirms as instructed, and the state of the
running wires. None stands for programs that are never stopped. Cases that are cheap and find most faults come
first.
"""


@rule("verify.handshake")
def handshake(context: Context) -> RuleOutcome:
    """Two controllers that share signals always meet.
    Whatever the delays, and whoever is stopped and restarted at any instant, neither waits forever, no
    signal change is lost, and no arm is more than one step ahead of the other. Neither works unless it
    has seen the other one stopped and then running. A URScript program watches the other's running wire
    whenever it moves or has power. However two of them are stopped, paused and restarted, none works
    while the other is elsewhere.
    """
    automata = context.job.automata_by_arm
    if automata is None:
        return RuleOutcome(nothing="one controller")
    wiring = stages.controller_wiring(context.problem)
    issues = _check_unsuitable_work(context)
    issues += _check_wiring(context, wiring)
    for task in context.job.tasks:
        issues += [
            step_issue(HANDSHAKE, fault, task, step)
            for fault, step in automata[task.name].faults[:MAX_FAULTS]
        ]
    if len(context.job.tasks) != 2:
        for task in context.job.tasks:
            unanswered = [action for action in automata[task.name].actions if action.kind in ("set", "wait")]
            message = "no other program answers this signal"
            issues += [
                step_issue(HANDSHAKE, message, task, task.steps[action.line]) for action in unanswered[:1]
            ]
        return RuleOutcome(tuple(issues), nothing="one program")
    issues += job_issues(HANDSHAKE, context)
    model_issues, states = _check_model(context, wiring, bool(issues))
    restarts = next(filter(None, (language_of_task(task).restarts for task in context.job.tasks)), None)
    if restarts is not None and not (issues or model_issues):
        model_issues, restart_states = restarts(context, wiring)
        states += restart_states
    issues += model_issues
    issues += _check_meeting_counts(context) if not model_issues else []
    meetings = max(
        (automaton.interval[-1] for automaton in automata.values() if automaton.interval), default=0
    )
    return RuleOutcome(tuple(issues), where=f"{meetings} meetings, {states} states")


def _check_model(context: Context, wiring: Wiring, faulty: bool) -> tuple[list[Issue], int]:
    """Check all states of both programs together (the product of their automata), case by case.

    The first case with a fault ends the check.

    Args:
        context: The proof.
        wiring: Signal wires of the cell.
        faulty: Whether the programs are known to have faults. Then only the first two, cheap cases are
            checked.

    Returns:
        Issues of the first case with a fault, and the number of states that were examined.
    """
    automata = context.job.automata_by_arm or {}
    tasks = context.job.tasks
    arms = [task.name for task in tasks]
    messages = HandshakeMessages(arms, automata, {task.name: task.steps for task in tasks}, wiring.wires)
    programs = ProgramProduct([automata[arm].actions for arm in arms])
    states = 0
    for gates, running in _MODEL_CASES[:2] if faulty else _MODEL_CASES:
        verdict = check_handshake(programs, len(wiring.wires), gates, running=running)
        states += verdict.states
        issues = []
        for finding in verdict.findings:
            program, step = messages.step(finding)
            # gates: the operator starts and confirms as instructed. Without them a fault may be his error.
            early = not gates and running in (None, _BOTH_RUNNING_WIRES_WORK)
            hint = "this happens if the operator starts or confirms too early" if early else None
            issues.append(step_issue(HANDSHAKE, messages.message(finding), tasks[program], step, hint))
        if issues:
            return issues, states
    return [], states


def _check_meeting_counts(context: Context) -> list[Issue]:
    """Report programs with different numbers of meetings, in one issue.

    The last step of a program is in the interval whose number is that of its meetings.
    """
    counts = {
        name: automaton.interval[-1]
        for name, automaton in (context.job.automata_by_arm or {}).items()
        if automaton.interval
    }
    if len(set(counts.values())) < 2:
        return []
    count_texts = ", ".join(f"{name} meets {count} times" for name, count in counts.items())
    return [Issue(HANDSHAKE, f"the programs have different numbers of meetings: {count_texts}")]


def _check_wiring(context: Context, wiring: Wiring) -> list[Issue]:
    """Report faults of the cell's signal wires, and signals of power sources that both controllers switch.

    - Each end of a wire belongs to one wire, and a wire connects the controllers of two different arms.
    - A running wire leads from each program to the other one.
    - An output that drives no wire is switched by one controller only. One issue is reported per task.
    """
    issues = [Issue(HANDSHAKE, f"{name} has two wires; each end takes one") for name in wiring.doubled]
    arms = {arm.name for arm in context.problem.cell.arms}
    running_wires = {(wire.source, wire.sink) for wire in wiring.running}
    for task in context.job.tasks:
        for other in context.job.tasks:
            if task is not other and (task.name, other.name) not in running_wires:
                message = f"no wire tells the controller of {other.name} that the program of {task.name} runs"
                issues.append(Issue(HANDSHAKE, f"{message}; a stop of {task.name} would go unnoticed"))
    for wire in (*wiring.wires, *wiring.running):
        if not {wire.source, wire.sink} <= arms or wire.source == wire.sink:
            message = f"the wire from {wire.output} of {wire.source} to {wire.input} of {wire.sink}"
            issues.append(Issue(HANDSHAKE, f"{message} does not connect the controllers of two arms"))
    power: dict[str, str] = {}
    for task in context.job.tasks:
        driven_outputs = wiring.drives[task.name]
        for step in task.steps:
            if isinstance(step, SignalStep) and step.signal.lower() not in driven_outputs:
                first = power.setdefault(step.signal.lower(), task.name)
                if first != task.name:
                    message = f"{step.signal} is switched on both controllers, so the wire is ambiguous"
                    issues.append(step_issue(HANDSHAKE, message, task, step))
                    break
    return issues


def _check_unsuitable_work(context: Context) -> list[Issue]:
    """Report work for which both arms must be synchronous, which two controllers are not.

    These are setups in which a wire joins arms, setups in which an arm moves its held block in a stage with
    the other arm, and moves in a work object that another unit carries. There is one issue per claim that
    joins arms, at most one per setup for a held block, and at most one per task for moves.
    """
    issues = []
    hint = "use one MultiMove controller for both arms"
    for index, setup in enumerate(context.setup_claims):
        number = context.setups[index].number
        for claim in setup.joined:
            message = (
                f"setup {number}: a wire joins {' and '.join(claim.joined_arms)}; arms that are one step "
                "apart would deform it"
            )
            issues.append(Issue(HANDSHAKE, message, hint=hint))
        holder = context.stock_at(index).held_by
        if holder is not None and holder not in {task.name for task in context.job.tasks}:
            holder = None
        for stage_number, stage in enumerate(context.job.stages):
            if holder is None or context.spans.of_stage[stage_number] != index or not stage.synchronised:
                continue
            task = next(task for task in context.job.tasks if task.name == holder)
            message = (
                f"setup {number}: {holder} moves its held block while the other arm may be one step apart"
            )
            issues.append(step_issue(HANDSHAKE, message, task, stage.moves(holder)[0], hint))
            break
    for task in context.job.tasks:
        for step in task.steps:
            if isinstance(step, MoveStep) and not step.wobj.fixed:
                message = (
                    f"{step.wobj_name} is moved by {step.wobj.unit}, which belongs to another controller"
                )
                issues.append(step_issue(HANDSHAKE, message, task, step, hint))
                break
    return issues
