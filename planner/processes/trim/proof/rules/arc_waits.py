"""Waits for the arc of a torch, and what watches it while it moves."""

from collections.abc import Collection, Iterator

from planner.issues import Issue
from planner.processes.trim.claims import TrimsSheet
from planner.processes.trim.proof.torch_motion import TrimWork, longest_stay
from planner.programs.stages import TaskText
from planner.programs.steps import GuardStep, MoveStep, SignalStep, Step, WaitStep
from planner.programs.text import segment_of_name
from planner.proof.context import Context
from planner.proof.language_contribution import of_task
from planner.proof.rule import at_step, mm

LEAST_FAR = 0.2e-3
"""A thread that watches a torch may take one that gets farther than this [m] for one that moves."""


LINGER = 3.0
"""On a short stretch a torch may take so many times as long as at its least average feed,"""


LINGER_TIME = 0.5
"""and so much longer [s], as it stops at corners."""


LINGER_KERFS = 3.0
"""Such a stretch is as long as a slot is wide, so many times,"""


LEAST_STRETCH = 3e-3
"""and so long [m] at least."""


WAIT_ROUNDING = 0.001
"""Times are written with three decimals [s]."""


def waits(context: Context, work: TrimWork, others: Collection[str]) -> Iterator[Issue]:
    """Whether the program waits for the arc between its start and the next move, as the text has it; no
    other program can, that starts it. ``others``: slots of other operations, which have their own waits."""
    claim = work.claim
    if claim.ok_signal is None:
        return
    for task in context.job.tasks:
        if task.arm.name != claim.arm:
            if task.name in context.switching((claim.arm,)):
                lit = (s for s in task.steps if isinstance(s, SignalStep) and s.value)
                yield from (
                    _unwaited(task, s, claim) for s in lit if s.signal.lower() == claim.signal.lower()
                )
            continue
        started: Step | None = None
        waited = False
        for step in task.steps:
            if isinstance(step, SignalStep) and step.signal.lower() == claim.signal.lower():
                started, waited = step if step.value else None, False
            elif isinstance(step, WaitStep):
                waited |= _is_ok(step, claim)
            elif isinstance(step, MoveStep) and started is not None:
                if not waited and _slot(step) not in others:
                    yield _unwaited(task, started, claim)
                started = None


def _slot(move: MoveStep) -> str:
    return segment_of_name(move.procedure).key


def _is_ok(step: WaitStep, claim: TrimsSheet) -> bool:
    return (
        step.signal.lower() == (claim.ok_signal or "").lower()
        and step.value == 1.0
        and not step.flag
        and not step.again
        and step.seconds is not None
        and step.seconds <= claim.timeout + WAIT_ROUNDING
    )


def _unwaited(task: TaskText, step: Step, claim: TrimsSheet) -> Issue:
    what = (
        f"behind {claim.signal} the torch moves without a wait for {claim.ok_signal} of {claim.timeout:g} s "
    )
    return at_step("verify.trim_arc", what + "at most, which breaks off where no arc burns", task, step)


def unguarded(context: Context, work: TrimWork, others: Collection[str]) -> Iterator[Issue]:
    """Whether a program that goes on in the slot behind a pause watches its torch wherever that
    moves: output and input, and that it does not stand for longer than a torch may take, but for as long as
    it does. ``others`` as :func:`waits` has it."""
    claim = work.claim
    for task in context.job.tasks:
        if not of_task(task).watches_torch or task.arm.name != claim.arm:
            continue
        lit: Step | None = None
        guard: GuardStep | None = None
        for step in task.steps:
            if isinstance(step, SignalStep) and step.signal.lower() == claim.signal.lower():
                lit, guard = step if step.value else None, None
            elif isinstance(step, GuardStep):
                guard = step if step.on else None
            elif isinstance(step, MoveStep) and lit is not None and _slot(step) not in others:
                yield from _watched(task, lit, guard, work)
                lit = None


def _watched(task: TaskText, lit: Step, guard: GuardStep | None, work: TrimWork) -> Iterator[Issue]:
    """What is wrong with what watches a torch that moves, from where it was ``lit`` on."""
    claim = work.claim
    signals = claim.signal.lower(), (claim.ok_signal or "").lower()
    if guard is None or (guard.signal.lower(), guard.given.lower()) != signals:
        what = (
            f"the torch moves with {claim.signal} on, and nothing watches that it burns: behind a pause the "
        )
        yield at_step("verify.trim_arc", what + "program would go on in the slot", task, lit)
        return
    stretch = max(LINGER_KERFS * claim.kerf, LEAST_STRETCH)
    most = LINGER * stretch / (claim.least_feed * claim.feed) + LINGER_TIME
    stays = max((longest_stay(work.of_slot(key), guard.far) for key in work.slots), default=0.0)
    if not stays < guard.stood <= most or guard.far < LEAST_FAR:
        what = (
            f"the program ends where the torch is within {mm(guard.far):g} mm for {guard.stood:g} s; wanted: "
        )
        what += f"{mm(LEAST_FAR):g} mm or more, and over {stays:.2f} s, to {most:.2f} s"
        yield at_step("verify.trim_arc", what, task, guard)
