"""RAPID for two controllers that share digital signals: the steps of :mod:`planner.post.partner` as text."""

from __future__ import annotations

from collections.abc import Sequence

from planner.dialogue import HEADER, UNANSWERED
from planner.post.partner import Ask, AwaitLine, AwaitRunning, Halt, Note, Partner, PartnerStep, SetLine, Tell
from planner.post.program import TaskProgram
from planner.post.rapid_format import box, comment, identifier, write_lines
from planner.post.text import short


def lines(partner: Partner, steps: Sequence[PartnerStep]) -> list[str]:
    """The statements of the steps."""
    return [line for step in steps for line in _step(partner, step)]


def call(partner: Partner, number: int) -> str:
    """The call behind a move at which the meeting ``number`` is; empty for 0."""
    return "" if number == 0 else f"{_name(partner.phases(number))};"


def procedures(partner: Partner, task: TaskProgram) -> dict[str, list[str]]:
    """Bodies of the procedures that the task's moves are followed by, by name."""
    made = {_name(p): lines(partner, partner.step(n)) for p, n in partner.kinds(task).items()}
    return {name: made[name] for name in sorted(made)}


def unanswered(partner: Partner) -> list[str]:
    """What an error handler says of a wait that was over its time."""
    text = write_lines(UNANSWERED.say(other=partner.other))
    return ["IF ERRNO=ERR_WAIT_MAXTIME THEN", *(f"  {line}" for line in text), "ENDIF"]


def header(partner: Partner) -> list[str]:
    """Comment lines on the signals."""
    signals, wires = partner.header()
    alone = "Error handlers leave these lines alone: a change would be read as an arrival."
    return [*comment(signals), *comment(f"{wires} {alone}")]


def _name(phases: tuple[int, ...]) -> str:
    return f"handshake_{phases[0]}" if len(phases) == 1 else "handshake"


def _step(partner: Partner, step: PartnerStep) -> list[str]:
    own = partner.handshake.of(partner.arm)
    match step:
        case SetLine(value):
            return [f"SetDO\\Sync,{identifier(own.output)},{value};"]
        case AwaitLine(value, seconds):
            return [f"WaitDI {identifier(own.input)},{value}\\MaxTime:={short(seconds, 3)};"]
        case AwaitRunning(value, seconds):
            return [f"WaitDI {identifier(own.partner_running)},{value}\\MaxTime:={short(seconds, 3)};"]
        case Halt(text):
            return ["Stop;", *box(HEADER, text)]
        case Ask(text):
            return box(HEADER, text)
        case Tell(text):
            return write_lines(text)
        case Note(text):
            return comment(text)
