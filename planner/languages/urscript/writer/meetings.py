"""Meetings with a program on another controller of UR, by programs that watch each other themselves."""

import dataclasses

from planner.claims import sentences
from planner.languages.urscript import sentences as urscript_sentences
from planner.languages.writing.handshake import (
    Ask,
    AwaitLine,
    AwaitRunning,
    Partner,
    PartnerStep,
    SetLine,
    Tell,
)
from planner.languages.writing.layout import Do, Meet, Run, TaskProgram


@dataclasses.dataclass(frozen=True)
class Watch:
    """From here on the program itself watches the other one's running wire, where no controller does."""


WatchedStep = PartnerStep | Watch


def asking(task: TaskProgram) -> frozenset[int]:
    """Numbers of the meetings behind which, before the next one, a task's program asks somebody something."""
    out, number = set[int](), 1
    for operation in task.operations:
        for step in operation.steps:
            if isinstance(step, Meet):
                number = step.number
            elif isinstance(step, Run):
                number = int(operation.meets[step.first : step.last].max(initial=number))
            elif isinstance(step, Do) and step.action.kind == "confirm":
                out.add(number)
    return frozenset(out)


def held(partner: Partner, asked: frozenset[int]) -> frozenset[int]:
    """Meetings in the middle of which the other program asks somebody; ``asked``: those behind which it does.
    This one's line is 1 meanwhile: it waits where its own line rose, for the other one to go on."""
    return frozenset(number + 1 if partner.lead else number for number in asked)


def watched_meeting(
    partner: Partner, wait: float, longest: float = 0.0
) -> tuple[list[WatchedStep], list[WatchedStep]]:
    """The steps of a meeting: up to where both lines have been seen to rise (of the lead) or the other one's
    has (of who follows), and those behind.

    Args:
        partner: This program's side.
        wait: Longest wait [s].
        longest: How long [s] the other program may ask somebody in the middle, where that is longer.
    """
    first: list[WatchedStep] = [AwaitRunning(1, wait)]
    longest = max(wait, longest)
    if partner.lead:
        return [*first, SetLine(1), AwaitLine(1, longest), Watch()], [SetLine(0), AwaitLine(0, wait)]
    return [*first, AwaitLine(1, wait)], [SetLine(1), AwaitLine(0, longest), Watch(), SetLine(0)]


def watched_start(partner: Partner, ask: str) -> list[PartnerStep]:
    """What the program begins with, up to the first meeting. It begins anew behind each stop: its line is low
    before anybody is asked. ``ask``: the lead's question."""
    limit, other = partner.handshake.timeout, partner.other
    earlier = urscript_sentences.UR_EARLIER if partner.lead else urscript_sentences.UR_CALLED
    out: list[PartnerStep] = [SetLine(0), Ask(earlier.filled(other=other)), AwaitRunning(0, limit)]
    if partner.lead:
        ready = sentences.PARTNER_READY.filled(other=other, arm=partner.arm, start=ask)
        called = urscript_sentences.UR_START_PARTNER.filled(other=other)
        return [*out, Tell(called), Ask(ready), AwaitLine(0, limit)]
    wait = partner.handshake.patience
    return [*out, AwaitLine(0, wait), Tell(sentences.READY_TO_MEET.filled(other=other))]
