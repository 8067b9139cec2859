"""Checks of program texts: waits for the arc of a torch, and the watchdog while the torch moves."""

from collections.abc import Collection, Iterator

from planner.issues import Issue
from planner.processes.trim.claims import TrimsSheet
from planner.processes.trim.proof.torch_motion import TrimmedSheet, longest_stay
from planner.programs.stages import TaskText
from planner.programs.steps import GuardStep, MoveStep, ProgramStep, SignalStep, WaitStep
from planner.programs.text import segment_of_name
from planner.proof.context import Context
from planner.proof.language_contribution import language_of_task
from planner.proof.rule import mm, step_issue

MIN_WATCH_DISTANCE_M = 0.2e-3
"""Minimum distance [m] at which a watchdog may consider a torch as moving."""


LINGER_FACTOR = 3.0
"""Factor by which a torch may be slower on a short stretch than its minimum average feed."""


LINGER_TIME_S = 0.5
"""Additional duration on a short stretch [s], because the torch stops at corners."""


LINGER_KERF_FACTOR = 3.0
"""Length of a short stretch, in kerfs."""


MIN_STRETCH_M = 3e-3
"""Minimum length of a short stretch [m]."""


WAIT_ROUNDING_S = 0.001
"""Resolution of times in programs [s], which have three decimals."""


def missing_waits(context: Context, sheet: TrimmedSheet, other_slots: Collection[str]) -> Iterator[Issue]:
    """Yield an issue for each start of the arc after which the program does not wait for the arc.

    The program waits for the input that reports the arc, before its next move.

    Programs of other arms must not start the arc, because they cannot wait for it. Nothing is required if the
    claim states no input.

    Args:
        context: Context of the proof.
        sheet: Claim with the motion.
        other_slots: Keys of the slots of other operations, which have their own waits.
    """
    claim = sheet.claim
    if claim.ok_signal is None:
        return
    for task in context.job.tasks:
        if task.arm.name != claim.arm:
            if task.name in context.controller_task_names((claim.arm,)):
                switch_steps = (s for s in task.steps if isinstance(s, SignalStep) and s.value)
                yield from (
                    _missing_wait_issue(task, s, claim)
                    for s in switch_steps
                    if s.signal.lower() == claim.signal.lower()
                )
            continue
        start_step: ProgramStep | None = None
        has_wait = False
        for step in task.steps:
            if isinstance(step, SignalStep) and step.signal.lower() == claim.signal.lower():
                start_step, has_wait = step if step.value else None, False
            elif isinstance(step, WaitStep):
                has_wait |= _is_arc_wait(step, claim)
            elif isinstance(step, MoveStep) and start_step is not None:
                if not has_wait and _slot_key(step) not in other_slots:
                    yield _missing_wait_issue(task, start_step, claim)
                start_step = None


def _slot_key(move: MoveStep) -> str:
    return segment_of_name(move.procedure).key


def _is_arc_wait(step: WaitStep, claim: TrimsSheet) -> bool:
    """Return whether a step waits for the arc's input, and aborts the program if it takes too long."""
    return (
        step.signal.lower() == (claim.ok_signal or "").lower()
        and step.value == 1.0
        and not step.flag
        and not step.repeats
        and step.seconds is not None
        and step.seconds <= claim.timeout + WAIT_ROUNDING_S
    )


def _missing_wait_issue(task: TaskText, step: ProgramStep, claim: TrimsSheet) -> Issue:
    message = (
        f"after {claim.signal} the torch moves without a wait for {claim.ok_signal} of at most "
        f"{claim.timeout:g} s, "
    )
    return step_issue("verify.trim_arc", message + "which aborts the program if no arc burns", task, step)


def missing_watchdogs(context: Context, sheet: TrimmedSheet, other_slots: Collection[str]) -> Iterator[Issue]:
    """Yield an issue for each start of the arc after which the torch moves without a correct watchdog.

    Only languages whose programs continue in the slot after a pause need one. It has to check output and
    input, and to abort if the torch rests longer than allowed, but not if it rests only as long as in the
    replay.

    Args:
        context: Context of the proof.
        sheet: Claim with the motion.
        other_slots: Keys of the slots of other operations, which have their own watchdogs.
    """
    claim = sheet.claim
    for task in context.job.tasks:
        if not language_of_task(task).watches_torch or task.arm.name != claim.arm:
            continue
        start_step: ProgramStep | None = None
        watchdog: GuardStep | None = None
        for step in task.steps:
            if isinstance(step, SignalStep) and step.signal.lower() == claim.signal.lower():
                start_step, watchdog = step if step.value else None, None
            elif isinstance(step, GuardStep):
                watchdog = step if step.on else None
            elif isinstance(step, MoveStep) and start_step is not None and _slot_key(step) not in other_slots:
                yield from _watchdog_issues(task, start_step, watchdog, sheet)
                start_step = None


def _watchdog_issues(
    task: TaskText, start_step: ProgramStep, watchdog: GuardStep | None, sheet: TrimmedSheet
) -> Iterator[Issue]:
    """Yield an issue if no suitable watchdog is active when the torch moves after ``start_step``.

    The watchdog is the part of a program that ends it if the arc is lost or the torch rests. It has to check
    the signals of the claim. Its time limit has to be above the longest stay of the torch in any slot, and
    short enough that the torch does not burn away more than its kerf.
    """
    claim = sheet.claim
    signals = claim.signal.lower(), (claim.ok_signal or "").lower()
    if watchdog is None or (watchdog.signal.lower(), watchdog.input.lower()) != signals:
        message = (
            f"the torch moves with {claim.signal} on, and nothing checks that it burns: after a pause the "
        )
        yield step_issue("verify.trim_arc", message + "program would continue in the slot", task, start_step)
        return
    stretch = max(LINGER_KERF_FACTOR * claim.kerf, MIN_STRETCH_M)
    max_stop = LINGER_FACTOR * stretch / (claim.min_feed_fraction * claim.feed) + LINGER_TIME_S
    longest = max(
        (longest_stay(sheet.slot_track(key), watchdog.min_distance) for key in sheet.slots), default=0.0
    )
    if not longest < watchdog.max_still_time <= max_stop or watchdog.min_distance < MIN_WATCH_DISTANCE_M:
        message = (
            f"the program ends if the torch stays within {mm(watchdog.min_distance):g} mm for "
            f"{watchdog.max_still_time:g} s, "
        )
        message += (
            f"required {mm(MIN_WATCH_DISTANCE_M):g} mm or more, and more than {longest:.2f} s, up to "
            f"{max_stop:.2f} s"
        )
        yield step_issue("verify.trim_arc", message, task, watchdog)
