"""What the operator is told and asked before power goes on, and when it has gone off."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

from planner.claims import ConfirmedPower
from planner.issues import Issue
from planner.verify.context import Context
from planner.verify.findings import at_step
from planner.verify.job import TaskText
from planner.verify.setups import one_line
from planner.verify.steps import MessageStep, MoveStep, SignalStep, Step, WaitStep
from planner.verify.words import letters

CODE = "verify.spindle"


@dataclasses.dataclass
class _Seen:
    """Whether the power is ``on``, and how many ``times`` it went on; since it last went off, how long the
    text has ``waited`` [s], moves left out, and what the operator was ``told`` and ``asked``."""

    on: bool = False
    waited: float = float("inf")
    times: int = 0
    told: str = ""
    asked: list[str] = dataclasses.field(default_factory=list)


def confirmed(context: Context) -> list[Issue]:
    """Faults of all claims on power that is confirmed, in the order of their operations."""
    claims: dict[str, list[ConfirmedPower]] = {}
    for setup in context.setup_claims:
        for group in setup.groups:
            for claim in group:
                if isinstance(claim, ConfirmedPower):
                    claims.setdefault(claim.signal.lower(), []).append(claim)
    return [issue for own in claims.values() for issue in _faults(context, own)]


def _faults(context: Context, claims: Sequence[ConfirmedPower]) -> Iterator[Issue]:
    """Faults of one signal."""
    signal = claims[0].signal
    wanted = [(claim, questions) for claim in claims for questions in claim.asked]
    last = {
        id(claim): number + len(claim.asked) for claim, number in zip(claims, _starts(claims), strict=True)
    }
    seen = _Seen()
    due: ConfirmedPower | None = None  # whose end is still to be asked
    for task, step in _steps(context):
        if isinstance(step, MessageStep) and step.confirm:
            rest = wanted[min(max(seen.times - 1, 0), len(wanted) - 1)][0].rest
            if not seen.on and seen.waited < rest - 1e-6:
                what = f"a question {seen.waited:g} s after {signal} goes off; it runs down for {rest:g} s"
                yield at_step(CODE, what, task, step, "wait before the question")
            if step.certain:
                seen.asked.append(one_line(step.text))
            due = None if due is not None and one_line(due.done) in seen.asked else due
        elif isinstance(step, MessageStep):
            seen.told += " " + step.text
        elif isinstance(step, WaitStep):
            seen.waited += step.pause
        elif isinstance(step, SignalStep) and step.signal.lower() == signal.lower():
            if step.value and not seen.on:
                if due is not None:
                    yield at_step(CODE, f"{signal} goes on again before: {due.done}", task, step)
                yield from _on(task, step, wanted, seen)
                seen.times += 1
            elif seen.on and not step.value:
                seen.waited, seen.asked, seen.told = 0.0, [], ""
                done = [claim for claim in claims if last[id(claim)] == seen.times]
                due = done[0] if done else due
            seen.on = bool(step.value)
        elif isinstance(step, MoveStep) and due is not None and step.by_joints:
            yield at_step(CODE, f"an arm goes on by joints before: {due.done}", task, step)
            due = None
    if seen.times != len(wanted):
        what = f"{signal} goes on {seen.times} times; wanted: {len(wanted)}"
        yield Issue(CODE, what, value=seen.times, limit=len(wanted))
    if due is not None:
        yield Issue(CODE, f"the programs end without: {due.done}")


def _on(
    task: TaskText, step: Step, wanted: Sequence[tuple[ConfirmedPower, tuple[str, ...]]], seen: _Seen
) -> Iterator[Issue]:
    """Faults of what was said before the power goes on."""
    if seen.times >= len(wanted):
        return
    claim, questions = wanted[seen.times]
    for question in questions:
        if one_line(question) not in seen.asked:
            what = f"{claim.signal} goes on, and nobody has confirmed before: {question}"
            yield at_step(CODE, what, task, step, "ask with the spindle standing")
    first = seen.times == 0 or wanted[seen.times - 1][0] is not claim
    if first and letters(claim.told) not in letters(seen.told):
        yield at_step(CODE, f"{claim.signal} goes on, and the operator is not told: {claim.told}", task, step)


def _starts(claims: Sequence[ConfirmedPower]) -> list[int]:
    """How often the power went on before each claim's own."""
    out, count = [], 0
    for claim in claims:
        out.append(count)
        count += len(claim.asked)
    return out


def _steps(context: Context) -> Iterator[tuple[TaskText, Step]]:
    """Steps of all tasks, stage by stage."""
    for stage in context.job.stages:
        for task in context.job.tasks:
            yield from ((task, step) for step in stage.steps[task.name])
