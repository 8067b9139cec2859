"""Rules on two controllers that share no more than digital signals."""

from __future__ import annotations

from typing import Final

from planner.issues import Issue
from planner.verify import handshake_stages
from planner.verify.context import Context, Outcome
from planner.verify.findings import at_step
from planner.verify.handshake_model import RunningWire, check
from planner.verify.handshake_text import Wiring
from planner.verify.handshake_words import Words
from planner.verify.steps import MoveStep, SignalStep

CODE = "verify.handshake"
MOST = 20
"""Faults of one program that are told."""
_WORK: Final = ("works", "works")
_CASES: Final[tuple[tuple[bool, tuple[RunningWire, RunningWire] | None], ...]] = (
    (True, None),
    (False, None),
    (False, ("low", "works")),
    (False, ("high", "works")),
    (False, ("works", "low")),
    (False, ("works", "high")),
    (True, _WORK),
    (False, _WORK),
)
"""Whether the operator does as told, and how the running wires are, in each check of the model: those that
find most at least cost come first, those with stops at any instant last."""


def handshake(context: Context) -> Outcome:
    """Two controllers that share signals meet without fail: whatever the delays, and whoever is stopped and
    started again at whatever instant, neither waits for ever, no signal change is lost, and no arm is more
    than one step ahead of the other. Neither works unless it has seen the other one stand and then run."""
    readings = context.job.readings
    if readings is None:
        return Outcome(where="one controller")
    wiring = handshake_stages.wiring(context.problem)
    issues = _unfit(context)
    issues += _wired_wrong(context, wiring)
    for task in context.job.tasks:
        issues += [at_step(CODE, what, task, step) for what, step in readings[task.name].faults[:MOST]]
    if len(context.job.tasks) != 2:
        for task in context.job.tasks:
            lone = [a for a in readings[task.name].actions if a.kind in ("set", "wait")]
            what = "there is no other program to answer this"
            issues += [at_step(CODE, what, task, task.steps[action.line]) for action in lone[:1]]
        return Outcome(tuple(issues), where="one program")
    found, states = _model(context, wiring, bool(issues))
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
    programs = [readings[arm].actions for arm in arms]
    states = 0
    for gates, running in _CASES[:2] if faulty else _CASES:
        verdict = check(programs, len(wiring.wires), gates, running=running)
        states += verdict.states
        issues = []
        for finding in verdict.findings:
            program, step = words.step(finding)
            early = not gates and running in (None, _WORK)
            hint = "this is so when the operator starts or confirms too early" if early else None
            issues.append(at_step(CODE, words.message(finding), tasks[program], step, hint))
        if issues:
            return issues, states
    return [], states


def _numbers(context: Context) -> list[Issue]:
    """Programs that hold by themselves, but count their meetings otherwise."""
    counts = {name: r.interval[-1] for name, r in (context.job.readings or {}).items() if r.interval}
    if len(set(counts.values())) < 2:
        return []
    what = ", ".join(f"{name} meets {count} times" for name, count in counts.items())
    return [Issue(CODE, f"the programs do not count the same meetings: {what}")]


def _wired_wrong(context: Context, wiring: Wiring) -> list[Issue]:
    """Faults of the cell's wires, and signals that the controllers would share by name."""
    issues = [Issue(CODE, f"{name} has two wires; each end takes one") for name in wiring.doubled]
    arms = {arm.name for arm in context.problem.cell.arms}
    runs = {(wire.source, wire.sink) for wire in wiring.running}
    for task in context.job.tasks:
        for other in context.job.tasks:
            if task is not other and (task.name, other.name) not in runs:
                what = f"no wire tells the controller of {other.name} that the program of {task.name} runs"
                issues.append(Issue(CODE, f"{what}; a stop of {task.name} would go unnoticed"))
    for wire in (*wiring.wires, *wiring.running):
        if not {wire.source, wire.sink} <= arms or wire.source == wire.sink:
            what = f"the wire from {wire.output} of {wire.source} to {wire.input} of {wire.sink}"
            issues.append(Issue(CODE, f"{what} does not join the controllers of two arms"))
    power: dict[str, str] = {}
    for task in context.job.tasks:
        own = wiring.drives[task.name]
        for step in task.steps:
            if isinstance(step, SignalStep) and step.signal.lower() not in own:
                first = power.setdefault(step.signal.lower(), task.name)
                if first != task.name:
                    what = f"{step.signal} is switched on the controllers of both arms; which wire is meant?"
                    issues.append(at_step(CODE, what, task, step))
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
                f"setup {number}: a wire joins {' and '.join(claim.arms)}; arms that may be one step apart "
                "bend it out of its shape"
            )
            issues.append(Issue(CODE, what, hint=hint))
        holder = context.stock(index).held_by
        if holder is not None and holder not in {task.name for task in context.job.tasks}:
            holder = None
        for stage_number, stage in enumerate(context.job.stages):
            if holder is None or context.spans.of_stage[stage_number] != index or not stage.synchronised:
                continue
            task = next(task for task in context.job.tasks if task.name == holder)
            what = f"setup {number}: {holder} moves the block it holds while the other arm may be a step off"
            issues.append(at_step(CODE, what, task, stage.moves(holder)[0], hint))
            break
    for task in context.job.tasks:
        for step in task.steps:
            if isinstance(step, MoveStep) and not step.wobj.fixed:
                what = f"{step.wobj_name} is moved by {step.wobj.unit}, which another controller moves"
                issues.append(at_step(CODE, what, task, step, hint))
                break
    return issues
