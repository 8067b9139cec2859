"""RAPID for two controllers that share digital signals: how their programs start, meet and end.

The lead asks and the other one answers, so no line changes before its last change was answered: programs that
both set their output and then wait lose an edge when one of them is late.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from planner.handshake import Handshake
from planner.post.program import Job, TaskProgram
from planner.post.rapid_format import box, comment, identifier, short, write_lines


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

    def call(self, number: int) -> str:
        """The call behind a move at which the meeting ``number`` is; empty for 0."""
        if number == 0:
            return ""
        return "handshake;" if self.handshake.kind == "four_phase" else f"handshake_{number % 2};"

    def meeting(self, number: int, wait: float) -> list[str]:
        """The statements of the meeting ``number`` [from 1], which waits ``wait`` [s] at most."""
        if self.handshake.kind == "toggle":
            return self._turn(number % 2, wait)
        return [*self._turn(1, wait), *self._turn(0, wait)]

    def meet(self, number: int, seconds: float) -> list[str]:
        """A meeting at which the other arm may have moved alone for ``seconds`` or asked the operator."""
        return self.meeting(number, self.handshake.patience + math.ceil(seconds))

    def procedures(self, task: TaskProgram) -> dict[str, list[str]]:
        """Bodies of the procedures that the task's moves are followed by, by name."""
        numbers = np.concatenate([operation.meets for operation in task.operations])
        used = {self.call(n).rstrip(";"): n for n in np.unique(numbers[numbers > 0]).tolist()}
        return {name: self.meeting(used[name], self.handshake.timeout) for name in sorted(used)}

    def start(self, ask: str) -> list[str]:
        """What ``main`` begins with: lines down and seen so, first meeting. ``ask``: the lead's question."""
        earlier = f"Does no program of an earlier run go on at the controller of arm {self.other}? Press OK."
        out = [*box("Tandem", earlier), self._set(0)]
        wait = self.handshake.timeout if self.lead else self.handshake.patience
        if self.lead:
            ready = f"Does the panel of arm {self.other} say that it is ready to meet arm {self.arm}?"
            out += [*box("Tandem", f"{ready} {ask}"), self._wait(0, wait)]
        else:
            out += [self._wait(0, wait), *write_lines(f"Ready to meet arm {self.other}.")]
        return [*out, *comment("First meeting: both programs run."), *self.meeting(1, wait)]

    def end(self) -> list[str]:
        """What ``main`` ends with, so that both lines are 0 then."""
        if self.handshake.kind == "four_phase" or self.meets % 2 == 0:
            return []
        return [*comment("Last meeting: both lines are 0."), *self.meet(self.meets + 1, 0.0)]

    def unanswered(self) -> list[str]:
        """What an error handler says of a wait that was over its time."""
        text = write_lines(f"Arm {self.other} did not answer in time.")
        return ["IF ERRNO=ERR_WAIT_MAXTIME THEN", *(f"  {line}" for line in text), "ENDIF"]

    def header(self) -> list[str]:
        """Comment lines on the signals."""
        own, kind = self.handshake.of(self.arm), self.handshake.kind.replace("_", "-")
        role = "leads" if self.lead else "follows"
        wires = " ".join(
            f"Wire {wire.output} of arm {wire.source} to {wire.input} of arm {wire.sink}."
            for wire in self.handshake.wired((self.arm, self.other))
        )
        every = "every move" if self.handshake.every == 1 else f"every {self.handshake.every} moves"
        return [
            *comment(
                f"Meets arm {self.other}, on a controller of its own, by {kind} handshake at {every}: sets "
                f"{own.output}, reads {own.input}, and {role}."
            ),
            *comment(
                f"{wires} Error handlers leave these lines alone: a change would be read as an arrival."
            ),
        ]

    def _turn(self, phase: int, wait: float) -> list[str]:
        lines = [self._set(phase), self._wait(phase, wait)]
        return lines if self.lead else lines[::-1]

    def _set(self, value: int) -> str:
        return f"SetDO\\Sync,{identifier(self.handshake.of(self.arm).output)},{value};"

    def _wait(self, value: int, wait: float) -> str:
        return f"WaitDI {identifier(self.handshake.of(self.arm).input)},{value}\\MaxTime:={short(wait, 3)};"
