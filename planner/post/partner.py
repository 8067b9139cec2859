"""How two programs whose controllers share digital signals start, meet and end, in no language yet.

The lead asks and the other one answers, so no line changes before its last change was answered: programs that
both set their output and then wait lose an edge when one of them is late.

Each program sees the other one's running wire at 0 and then at 1 before the first meeting: the lead is
started while the other one stands, and stands itself while the other one looks. So a wire that is cut or
stuck is found before anything moves. Every meeting begins with a look at it.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from planner import dialogue
from planner.handshake import Handshake
from planner.post import running
from planner.post.program import Job, TaskProgram


@dataclasses.dataclass(frozen=True)
class SetLine:
    """The own output takes the level ``value``, 0 or 1."""

    value: int


@dataclasses.dataclass(frozen=True)
class AwaitLine:
    """Wait until the own input has the level ``value``, for ``seconds`` [s] at most."""

    value: int
    seconds: float


@dataclasses.dataclass(frozen=True)
class AwaitRunning:
    """Wait until the other controller's running wire has the level ``value``, for ``seconds`` [s] at most."""

    value: int
    seconds: float


@dataclasses.dataclass(frozen=True)
class Halt:
    """The program stops by itself, so that the running wire falls; started again, it asks ``text``."""

    text: str


@dataclasses.dataclass(frozen=True)
class Ask:
    """The operator reads ``text`` and confirms."""

    text: str


@dataclasses.dataclass(frozen=True)
class Tell:
    """The operator can read ``text``."""

    text: str


@dataclasses.dataclass(frozen=True)
class Note:
    """A comment."""

    text: str


PartnerStep = SetLine | AwaitLine | AwaitRunning | Halt | Ask | Tell | Note


@dataclasses.dataclass(frozen=True)
class Partner:
    """One side of the handshake: ``other`` is the other arm's name; the first task leads."""

    handshake: Handshake
    arm: str
    other: str
    lead: bool
    meets: int

    @staticmethod
    def of(task: TaskProgram, job: Job) -> Partner | None:
        """The side of a task; None where one controller moves all."""
        if job.handshake is None:
            return None
        other = next(item.arm.name for item in job.tasks if item.number != task.number)
        return Partner(job.handshake, task.arm.name, other, task.number == 1, job.meets)

    def phases(self, number: int) -> tuple[int, ...]:
        """Levels that the lines take, one after the other, at the meeting ``number`` [from 1]."""
        return (number % 2,) if self.handshake.kind == "toggle" else (1, 0)

    def meeting(self, number: int, wait: float) -> list[PartnerStep]:
        """The steps of a meeting, which waits ``wait`` [s] at most: the other program runs, the lines."""
        out: list[PartnerStep] = [AwaitRunning(1, wait)]
        for phase in self.phases(number):
            turn: list[PartnerStep] = [SetLine(phase), AwaitLine(phase, wait)]
            out += turn if self.lead else turn[::-1]
        return out

    def meet(self, number: int, seconds: float) -> list[PartnerStep]:
        """A meeting at which the other arm may have moved alone for ``seconds`` or asked the operator."""
        return self.meeting(number, self.handshake.patience + math.ceil(seconds))

    def step(self, number: int) -> list[PartnerStep]:
        """A meeting behind a move at which both arms move."""
        return self.meeting(number, self.handshake.timeout)

    def kinds(self, task: TaskProgram) -> dict[tuple[int, ...], int]:
        """{phases: a number} of the meetings behind the task's moves."""
        numbers = np.concatenate([operation.meets for operation in task.operations])
        return {self.phases(n): n for n in np.unique(numbers[numbers > 0]).tolist()}

    def start(self, ask: str, ok: str = "") -> list[PartnerStep]:
        """What the program begins with: lines down and seen so, the other program seen to stand, then to run,
        first meeting.

        ``ask``: the lead's question to the operator; ``ok``: how the other question is confirmed.
        """
        earlier = f"{dialogue.KRL_EARLIER.say(other=self.other)} {ok}"
        limit = self.handshake.timeout
        out: list[PartnerStep] = [Ask(earlier.strip()), SetLine(0), AwaitRunning(0, limit)]
        wait = limit if self.lead else self.handshake.patience
        if self.lead:
            ready = dialogue.PARTNER_READY.say(other=self.other, arm=self.arm, start=ask)
            out += [Tell(dialogue.START_PARTNER.say(other=self.other)), Halt(ready), AwaitLine(0, wait)]
        else:
            out += [AwaitLine(0, wait), Tell(dialogue.READY_TO_MEET.say(other=self.other))]
        return [*out, Note("First meeting: both programs run."), *self.meeting(1, wait)]

    def end(self) -> list[PartnerStep]:
        """What the program ends with, so that both lines are 0 then."""
        if self.handshake.kind == "four_phase" or self.meets % 2 == 0:
            return []
        return [Note("Last meeting: both lines are 0."), *self.meet(self.meets + 1, 0.0)]

    @property
    def unanswered(self) -> str:
        """What is said of a wait that was over its time."""
        return dialogue.UNANSWERED.say(other=self.other)

    def not_as_wanted(self, value: int) -> str:
        """What is said when the other one's running wire did not come to this level in time."""
        text = running.STANDS if value else running.RUNS
        return text.format(other=self.other, input=self.handshake.of(self.arm).partner_running)

    def header(self) -> tuple[str, str]:
        """Sentences on the signals, and on the wires between the controllers."""
        own, kind = self.handshake.of(self.arm), self.handshake.kind.replace("_", "-")
        role = "leads" if self.lead else "follows"
        wires = " ".join(
            f"Wire {wire.output} of arm {wire.source} to {wire.input} of arm {wire.sink}."
            for arms in [(self.arm, self.other)]
            for wire in (*self.handshake.wired(arms), *self.handshake.wired_running(arms))
        )
        every = "every move" if self.handshake.every == 1 else f"every {self.handshake.every} moves"
        return (
            f"Meets arm {self.other}, on a controller of its own, by {kind} handshake at {every}: sets "
            f"{own.output}, reads {own.input}, and {role}. {own.partner_running} is 1 while the program of "
            f"arm {self.other} runs; its fall stops this arm and takes its power. {own.running} is its like.",
            wires,
        )
