"""verify.handshake: two controllers that share no more than digital signals.

What the model check found is put in words: arms, lines of programs, signals, what waits for what.
"""

from collections.abc import Mapping, Sequence
from typing import Final

from planner.claims.handshake import SignalWire
from planner.issues import Issue
from planner.programs import stages
from planner.programs.handshake.automata import Reading, Wiring
from planner.programs.handshake.model import Action, Event, Finding, Product, RunningWire, check
from planner.programs.steps import MoveStep, SignalStep, Step
from planner.proof.context import Context
from planner.proof.language_contribution import job_issues, of_task
from planner.proof.rule import Outcome, at_step, rule

EVENTS_SHOWN = 6
"""Events that are told of the way to a fault."""


class Words:
    """Words for two programs: ``arms`` in the order of the check."""

    def __init__(
        self,
        arms: Sequence[str],
        readings: Mapping[str, Reading],
        steps: Mapping[str, Sequence[Step]],
        wires: Sequence[SignalWire],
    ) -> None:
        self.arms = arms
        self.actions = [readings[arm].actions for arm in arms]
        self.steps = [steps[arm] for arm in arms]
        self.wires = wires

    def message(self, finding: Finding) -> str:
        """The fault and the shortest way to it."""
        heads = {"deadlock": self._deadlock, "lost_edge": self._lost, "apart": self._apart}
        head = heads.get(finding.kind, self._unwatched)
        events = "; ".join(self.event(event) for event in finding.trace[-EVENTS_SHOWN:])
        way = f" The shortest way there, its last events of {finding.steps}: {events}" if events else ""
        return f"{head(finding)}.{way}"

    def step(self, finding: Finding) -> tuple[int, Step | None]:
        """Program and step that the fault is best looked for at."""
        for program in (finding.program, 1 - finding.program):
            action = self._action(program, finding.places[program])
            if action is not None:
                return program, self.steps[program][action.line]
        return finding.program, None

    def event(self, event: Event) -> str:
        """One event."""
        action = self._action(event.program, event.place)
        return f"{self.arms[event.program]} {self._does(event.program, action)}"

    def _action(self, program: int, place: int) -> Action | None:
        row = self.actions[program]
        return row[place] if place < len(row) else None

    def _line(self, program: int, action: Action) -> str:
        step = self.steps[program][action.line]
        return f"(line {step.line} of {step.module})"

    def _does(self, program: int, action: Action | None) -> str:
        if action is None:
            return "is at its end"
        at = self._line(program, action)
        wire = self.wires[action.wire] if action.kind in ("set", "wait") else None
        match action.kind:
            case "set" if wire is not None:
                return f"sets {wire.output} to {action.value} {at}"
            case "wait" if wire is not None:
                return f"has seen {wire.input} at {action.value} {at}"
            case "go":
                return f"begins what stands behind meeting {action.value} {at}"
            case "look":
                return f"has seen that the other program {'runs' if action.value else 'stands'} {at}"
            case "pause":
                return f"stops by itself {at}"
            case "done":
                return f"is through with what stands behind meeting {action.value}"
            case _:
                return f"is told that the other arm is ready {at}"

    def _where(self, program: int, finding: Finding) -> str:
        arm, action = self.arms[program], self._action(program, finding.places[program])
        if action is None:
            return f"{arm} has come to its end"
        at = self._line(program, action)
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
                return f"{arm} waits until the other program {'runs' if action.value else 'stands'} {at}"
            case "pause":
                return f"{arm} is about to stop by itself {at}"
            case "done":
                return f"{arm} is still at work behind meeting {action.value} {at}"
            case _:
                return f"{arm} waits until the other arm is ready {at}"

    def _deadlock(self, finding: Finding) -> str:
        return f"both programs wait for ever: {self._where(0, finding)}; {self._where(1, finding)}"

    def _lost(self, finding: Finding) -> str:
        action = self._action(finding.program, finding.places[finding.program])
        if action is None:
            return "a last change of a signal is never seen by the other program"
        wire = self.wires[action.wire]
        return (
            f"{self.arms[finding.program]} sets {wire.output} to {action.value} "
            f"{self._line(finding.program, action)} before {wire.sink} has seen its last change: "
            f"{self._where(1 - finding.program, finding)}"
        )

    def _apart(self, finding: Finding) -> str:
        action = self._action(finding.program, finding.places[finding.program])
        number = action.value if action is not None else 0
        at = self._line(finding.program, action) if action is not None else ""
        return (
            f"{self.arms[finding.program]} goes on behind meeting {number} {at} while "
            f"{self._where(1 - finding.program, finding)}: the arms are more than one step apart"
        )

    def _unwatched(self, finding: Finding) -> str:
        action = self._action(finding.program, finding.places[finding.program])
        at = self._line(finding.program, action) if action is not None else ""
        return (
            f"{self.arms[finding.program]} goes on behind the first meeting {at} with a running wire that is "
            "stuck, so that a stop would go unnoticed; each program must see it at 0 and then at 1 before"
        )


HANDSHAKE = "verify.handshake"
"""Code of this rule."""
MOST_FAULTS = 20
"""Faults of one program that are told."""
_BOTH_WORK: Final = ("works", "works")
"""How the running wires of both arms are, as they should be."""
_MODEL_CASES: Final[tuple[tuple[bool, tuple[RunningWire, RunningWire] | None], ...]] = (
    (True, None),
    (False, None),
    (False, ("low", "works")),
    (False, ("high", "works")),
    (False, ("works", "low")),
    (False, ("works", "high")),
    (True, _BOTH_WORK),
    (False, _BOTH_WORK),
)
"""Whether the operator does as told, and how the running wires are, in each check of the model: those that
find most at least cost come first, those with stops at any instant last."""


@rule("verify.handshake")
def handshake(context: Context) -> Outcome:
    """Two controllers that share signals meet without fail: whatever the delays, and whoever is stopped and
    started again at whatever instant, neither waits for ever, no signal change is lost, and no arm is more
    than one step ahead of the other. Neither works unless it has seen the other one stand and then run. A
    program of URScript watches the other one's running wire whenever it moves or has power; and however two
    of them are stopped, paused and started anew, none works beside one that is elsewhere."""
    readings = context.job.readings
    if readings is None:
        return Outcome(nothing="one controller")
    wiring = stages.wiring(context.problem)
    issues = _unfit(context)
    issues += _wired_wrong(context, wiring)
    for task in context.job.tasks:
        issues += [
            at_step(HANDSHAKE, what, task, step) for what, step in readings[task.name].faults[:MOST_FAULTS]
        ]
    if len(context.job.tasks) != 2:
        for task in context.job.tasks:
            lone = [a for a in readings[task.name].actions if a.kind in ("set", "wait")]
            what = "there is no other program to answer this"
            issues += [at_step(HANDSHAKE, what, task, task.steps[action.line]) for action in lone[:1]]
        return Outcome(tuple(issues), nothing="one program")
    issues += job_issues(HANDSHAKE, context)
    found, states = _model(context, wiring, bool(issues))
    restarts = next(filter(None, (of_task(task).restarts for task in context.job.tasks)), None)
    if restarts is not None and not (issues or found):
        found, more = restarts(context, wiring)
        states += more
    issues += found
    issues += _numbers(context) if not found else []
    meetings = max((reading.interval[-1] for reading in readings.values() if reading.interval), default=0)
    return Outcome(tuple(issues), where=f"{meetings} meetings, {states} states")


def _model(context: Context, wiring: Wiring, faulty: bool) -> tuple[list[Issue], int]:
    """Faults of the product of both automata, and how many states it has; of programs that are ``faulty``
    anyway only what is found at little cost."""
    readings = context.job.readings or {}
    tasks = context.job.tasks
    arms = [task.name for task in tasks]
    words = Words(arms, readings, {task.name: task.steps for task in tasks}, wiring.wires)
    programs = Product([readings[arm].actions for arm in arms])
    states = 0
    for gates, running in _MODEL_CASES[:2] if faulty else _MODEL_CASES:
        verdict = check(programs, len(wiring.wires), gates, running=running)
        states += verdict.states
        issues = []
        for finding in verdict.findings:
            program, step = words.step(finding)
            early = not gates and running in (None, _BOTH_WORK)
            hint = "this is so when the operator starts or confirms too early" if early else None
            issues.append(at_step(HANDSHAKE, words.message(finding), tasks[program], step, hint))
        if issues:
            return issues, states
    return [], states


def _numbers(context: Context) -> list[Issue]:
    """Programs that hold by themselves, but count their meetings otherwise."""
    counts = {name: r.interval[-1] for name, r in (context.job.readings or {}).items() if r.interval}
    if len(set(counts.values())) < 2:
        return []
    what = ", ".join(f"{name} meets {count} times" for name, count in counts.items())
    return [Issue(HANDSHAKE, f"the programs do not count the same meetings: {what}")]


def _wired_wrong(context: Context, wiring: Wiring) -> list[Issue]:
    """Faults of the cell's wires, and signals that the controllers would share by name."""
    issues = [Issue(HANDSHAKE, f"{name} has two wires; each end takes one") for name in wiring.doubled]
    arms = {arm.name for arm in context.problem.cell.arms}
    runs = {(wire.source, wire.sink) for wire in wiring.running}
    for task in context.job.tasks:
        for other in context.job.tasks:
            if task is not other and (task.name, other.name) not in runs:
                what = f"no wire tells the controller of {other.name} that the program of {task.name} runs"
                issues.append(Issue(HANDSHAKE, f"{what}; a stop of {task.name} would go unnoticed"))
    for wire in (*wiring.wires, *wiring.running):
        if not {wire.source, wire.sink} <= arms or wire.source == wire.sink:
            what = f"the wire from {wire.output} of {wire.source} to {wire.input} of {wire.sink}"
            issues.append(Issue(HANDSHAKE, f"{what} does not join the controllers of two arms"))
    power: dict[str, str] = {}
    for task in context.job.tasks:
        own = wiring.drives[task.name]
        for step in task.steps:
            if isinstance(step, SignalStep) and step.signal.lower() not in own:
                first = power.setdefault(step.signal.lower(), task.name)
                if first != task.name:
                    what = f"{step.signal} is switched on the controllers of both arms; which wire is meant?"
                    issues.append(at_step(HANDSHAKE, what, task, step))
                    break
    return issues


def _unfit(context: Context) -> list[Issue]:
    """Work that cannot live with arms that are one step apart."""
    issues = []
    hint = "use one MultiMove controller for both arms"
    for index, setup in enumerate(context.setup_claims):
        number = context.setups[index].number
        for claim in setup.joined:
            what = (
                f"setup {number}: a wire joins {' and '.join(claim.joined_arms)}; arms that may be one step "
                "apart bend it out of its shape"
            )
            issues.append(Issue(HANDSHAKE, what, hint=hint))
        holder = context.stock(index).held_by
        if holder is not None and holder not in {task.name for task in context.job.tasks}:
            holder = None
        for stage_number, stage in enumerate(context.job.stages):
            if holder is None or context.spans.of_stage[stage_number] != index or not stage.synchronised:
                continue
            task = next(task for task in context.job.tasks if task.name == holder)
            what = f"setup {number}: {holder} moves the block it holds while the other arm may be a step off"
            issues.append(at_step(HANDSHAKE, what, task, stage.moves(holder)[0], hint))
            break
    for task in context.job.tasks:
        for step in task.steps:
            if isinstance(step, MoveStep) and not step.wobj.fixed:
                what = f"{step.wobj_name} is moved by {step.wobj.unit}, which another controller moves"
                issues.append(at_step(HANDSHAKE, what, task, step, hint))
                break
    return issues
