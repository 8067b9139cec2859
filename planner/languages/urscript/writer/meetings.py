"""Steps of meetings between programs on two UR controllers, which watch each other by a thread."""

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
    """From here on, a thread of the program watches the other program's running wire.

    A UR controller has no input for this purpose that works without the program.
    """


WatchedStep = PartnerStep | StartWatching
"""A step of a meeting of programs that watch each other."""


def question_meetings_of(task: TaskProgram) -> frozenset[int]:
    """Return the numbers of the meetings after which a task's program asks a question.

    The question is asked before the next meeting. Questions before the first meeting do not count.
    """
    out: set[int] = set()
    number = 1  # the first meeting is part of the start, not of an operation
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
    """Return the numbers of the meetings during which the other program asks a question.

    Meanwhile this program's line is 1: it waits after the rise of its own line until the other one continues.
    The lead asks in the middle of the meeting before its question, the follower in the middle of the next
    one.

    Args:
        partner: This program's side.
        question_meetings: Numbers of the meetings after which the other program asks.
    """
    return frozenset(number + 1 if partner.lead else number for number in question_meetings)


def watched_meeting(
    partner: HandshakeSide, wait: float, longest: float = 0.0
) -> tuple[list[WatchedStep], list[WatchedStep]]:
    """Return the steps of a meeting in two parts, between which the program may ask a question.

    In the first part, the lead sets its line and waits for that of the follower, which waits for that of the
    lead. The second part completes the four-phase handshake.

    Args:
        partner: This program's side.
        wait: Maximum wait [s].
        longest: Maximum wait [s] for the other program's line while it asks in the middle of the meeting. It
            applies if it is longer than ``wait``.
    """
    first: list[WatchedStep] = [AwaitRunning(1, wait)]
    longest = max(wait, longest)
    if partner.lead:
        return [*first, SetLine(1), AwaitLine(1, longest), StartWatching()], [SetLine(0), AwaitLine(0, wait)]
    return [*first, AwaitLine(1, wait)], [SetLine(1), AwaitLine(0, longest), StartWatching(), SetLine(0)]


def watched_start(partner: HandshakeSide, ask: str) -> list[PartnerStep]:
    """Return the first steps of a program, up to the first meeting.

    A program starts from its beginning after each stop. Its line is low before it asks anything.

    Args:
        partner: This program's side.
        ask: Question of the lead whether the work may start.
    """
    limit = partner.handshake.timeout
    other = partner.other
    earlier = urscript_sentences.UR_EARLIER if partner.lead else urscript_sentences.UR_CALLED
    out: list[PartnerStep] = [SetLine(0), AskOperator(earlier.format(other=other)), AwaitRunning(0, limit)]
    if partner.lead:
        ready = sentences.PARTNER_READY.format(other=other, arm=partner.arm, start=ask)
        called = urscript_sentences.UR_START_PARTNER.format(other=other)
        return [*out, ShowText(called), AskOperator(ready), AwaitLine(0, limit)]
    wait = partner.handshake.patience
    return [*out, AwaitLine(0, wait), ShowText(sentences.READY_TO_MEET.format(other=other))]
