"""Meetings with a program on another UR controller, by programs that watch each other themselves."""

import dataclasses

from planner.claims import sentences
from planner.languages.urscript import sentences as urscript_sentences
from planner.languages.writing.handshake import (
    AskOperator,
    AwaitLine,
    AwaitRunning,
    HandshakeSide,
    PartnerStep,
    SetLine,
    ShowText,
)
from planner.languages.writing.layout import ActionStep, Meeting, SegmentRun, TaskProgram


@dataclasses.dataclass(frozen=True)
class StartWatching:
    """From here on the program itself watches the other one's running wire, because no controller does."""


WatchedStep = PartnerStep | StartWatching


def question_meetings_of(task: TaskProgram) -> frozenset[int]:
    """Return the meetings after which, before the next one, a task's program asks something."""
    out, number = set[int](), 1
    for operation in task.operations:
        for step in operation.steps:
            if isinstance(step, Meeting):
                number = step.number
            elif isinstance(step, SegmentRun):
                number = int(operation.meets[step.first : step.last].max(initial=number))
            elif isinstance(step, ActionStep) and step.action.kind == "confirm":
                out.add(number)
    return frozenset(out)


def held_meetings(partner: HandshakeSide, question_meetings: frozenset[int]) -> frozenset[int]:
    """Return the meetings during which the other program asks a question.

    This program's line is 1 meanwhile: it waits where its own line rose, for the other one to continue.

    Args:
        partner: This program's side.
        question_meetings: Meetings after which the other program asks.
    """
    return frozenset(number + 1 if partner.lead else number for number in question_meetings)


def watched_meeting(
    partner: HandshakeSide, wait: float, longest: float = 0.0
) -> tuple[list[WatchedStep], list[WatchedStep]]:
    """Return the steps of a meeting in two parts.

    The first part goes up to where the lead has seen both lines rise, or the follower the other one's.

    Args:
        partner: This program's side.
        wait: Maximum wait [s].
        longest: Time [s] for which the other program may ask in the middle, if that is longer.
    """
    first: list[WatchedStep] = [AwaitRunning(1, wait)]
    longest = max(wait, longest)
    if partner.lead:
        return [*first, SetLine(1), AwaitLine(1, longest), StartWatching()], [SetLine(0), AwaitLine(0, wait)]
    return [*first, AwaitLine(1, wait)], [SetLine(1), AwaitLine(0, longest), StartWatching(), SetLine(0)]


def watched_start(partner: HandshakeSide, ask: str) -> list[PartnerStep]:
    """Return the first steps of a program, up to the first meeting.

    It starts anew after each stop, so its line is low before anybody is asked.

    Args:
        partner: This program's side.
        ask: The lead's question.
    """
    limit, other = partner.handshake.timeout, partner.other
    earlier = urscript_sentences.UR_EARLIER if partner.lead else urscript_sentences.UR_CALLED
    out: list[PartnerStep] = [SetLine(0), AskOperator(earlier.format(other=other)), AwaitRunning(0, limit)]
    if partner.lead:
        ready = sentences.PARTNER_READY.format(other=other, arm=partner.arm, start=ask)
        called = urscript_sentences.UR_START_PARTNER.format(other=other)
        return [*out, ShowText(called), AskOperator(ready), AwaitLine(0, limit)]
    wait = partner.handshake.patience
    return [*out, AwaitLine(0, wait), ShowText(sentences.READY_TO_MEET.format(other=other))]
