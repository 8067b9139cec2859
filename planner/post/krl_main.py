"""The main program of a KUKA arm, and the subprograms with moves that it calls."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from planner import dialogue
from planner.post import krl_handshake, krl_panel
from planner.post.krl_data import Data
from planner.post.krl_format import comment, mark
from planner.post.krl_moves import Lines
from planner.post.krl_ptp import UNKNOWN, percent
from planner.post.layout import Part
from planner.post.partner import Partner
from planner.post.program import (
    Carry,
    Do,
    FloatArray,
    Job,
    Joints,
    Load,
    Meet,
    OperationProgram,
    Run,
    Step,
    SyncOff,
    SyncOn,
    TaskProgram,
)
from planner.post.text import short
from planner.problem import Problem
from planner.targets import Action


class Main:
    """Writes the main program; :attr:`bodies` are then those of its subprograms by name."""

    def __init__(
        self,
        task: TaskProgram,
        job: Job,
        problem: Problem,
        data: Data,
        layout: Sequence[Part],
        moves: Sequence[Lines | None],
        stem: str,
    ) -> None:
        self.task, self.job, self.problem, self.data = task, job, problem, data
        self.layout, self.moves, self.stem = layout, moves, stem
        self.controller = problem.cell.controller
        self.dialect = problem.cell.controller.dialect
        self.partner = Partner.of(task, job)
        self.bodies: dict[str, list[str]] = {}
        self._held: Load | None = None
        self._at: FloatArray | None = None
        self._percent = 0

    def lines(self) -> list[str]:
        """The statements of the main program."""
        out = [*krl_panel.INTERRUPT, "BAS(#INITMOV,0)", "$ADVANCE=3", "$IPO_MODE=#BASE", "$ORI_TYPE=#VAR"]
        out += [self._switch(signal, False) for signal in self.job.switched(self.task)]
        out += [*krl_panel.prepared(self.dialect), *krl_panel.foot(self.task.arm.name, self.dialect)]
        clear = (dialogue.KRL_CLEAR if self.problem.setups[0].steps else dialogue.KRL_READY).say()
        if self.partner is None:
            out += krl_panel.asked(clear, self.dialect)
        else:
            steps = self.partner.start(clear)
            out += krl_handshake.lines(self.partner, self.controller, steps)
        for i, operation in enumerate(self.task.operations):
            out += self._operation(i, operation)
        if self.partner is not None:
            out += krl_handshake.lines(self.partner, self.controller, self.partner.end())
            for phases, number in self.partner.kinds(self.task).items():
                steps = self.partner.step(number)
                body = krl_handshake.lines(self.partner, self.controller, steps, shown=False)
                self.bodies[f"{self.stem}_{krl_handshake.suffix(phases)}"] = body
        return out

    def _operation(self, index: int, operation: OperationProgram) -> list[str]:
        out = comment(f"Operation {operation.name}.")
        if any(isinstance(step, Joints | Run) for step in operation.steps):
            out += [
                f"$TOOL={self.data.tool(operation.arm.tool)}",
                f"$LOAD={self.data.load(operation.arm.tool, self._held)}",
                f"$BASE={self.data.base(operation)}",
            ]
        plain = (step for step in operation.steps if not isinstance(step, SyncOn | SyncOff))
        for moving, steps in itertools.groupby(plain, lambda step: isinstance(step, Run)):
            if moving:
                out += self._runs(index, operation, [step for step in steps if isinstance(step, Run)])
            else:
                done = list(steps)
                for i, step in enumerate(done):
                    out += self._step(step, index, operation, _question_follows(done[i + 1 :]))
        return out

    def _step(self, step: Step, index: int, operation: OperationProgram, asks: bool) -> list[str]:
        """The lines of a step; ``asks``: behind it and what else is told stands a question."""
        match step:
            case Joints():
                return self._ptp(step, index, operation)
            case Meet(number, reached, seconds) if self.partner is not None:
                steps = self.partner.meet(number, seconds)
                lines = krl_handshake.lines(self.partner, self.controller, steps)
                return [*comment(f"Meeting: {reached}"), *lines]
            case Do(action):
                return self._action(action, asks)
            case Carry(load):
                self._held = load
                return [f"$LOAD={self.data.load(operation.arm.tool, load)}"]
        return []

    def _ptp(self, step: Joints, index: int, operation: OperationProgram) -> list[str]:
        limits = self.problem.settings
        share = UNKNOWN
        if self._at is not None:
            tcp, most = operation.arm.tool.tcp, limits.speed_fraction
            share = percent(self.task.robot, self._at, step.q, tcp, limits.tcp_speed, most)
        out = [f"$VEL_AXIS[{i}]={share}" for i in range(1, 7)] if share != self._percent else []
        self._at, self._percent = step.q, share
        if step.place == "start" and operation.track is not None:
            return [*out, f"PTP {self.data.start(operation, step.q, index + 1)}"]
        return [*out, f"PTP {self.data.joint(step, index + 1)}"]

    def _action(self, action: Action, asks: bool) -> list[str]:
        match action.kind:
            case "message":
                return krl_panel.told(action.text, self.dialect, before_question=asks)
            case "confirm":
                return krl_panel.asked(action.text, self.dialect)
            case "on" | "off":
                return [self._switch(action.signal, action.kind == "on")]
            case "wait":
                return [f"WAIT SEC {short(action.seconds, 3)}"]

    def _switch(self, signal: str, on: bool) -> str:
        number = self.controller.number(self.task.arm.name, signal)
        return f"$OUT[{number}]={'TRUE' if on else 'FALSE'} ; {signal}"

    # ---- moves ----

    def _runs(self, index: int, operation: OperationProgram, runs: Sequence[Run]) -> list[str]:
        """Calls of the subprograms with the moves of runs that follow one another."""
        if operation.track is None:
            return []
        first, last = runs[0].first, runs[-1].last
        inside = (p for p in self.layout if p.operation == index and first <= p.first < last)
        calls = []
        for _, grouped in itertools.groupby(inside, lambda part: part.module):
            word = f"{self.stem}_{len(self.bodies) + 1}"
            self.bodies[word] = self._moves(index, operation, grouped)
            calls.append(f"{word}()")
        self._at = operation.track.q[last - 1]
        if self.partner is not None and operation.meets[first:last].any():
            together = dialogue.TOGETHER.say(arm=self.partner.other)
            return krl_panel.during(together, calls, self.dialect)
        return calls

    def _moves(self, index: int, operation: OperationProgram, parts: Iterable[Part]) -> list[str]:
        """The lines of a file: all settings stand before its first move."""
        lines, track = self.moves[index], operation.track
        out: list[str] = []
        if lines is None or track is None:
            return out
        calls = {}
        if self.partner is not None:
            calls = {
                row: f"{self.stem}_{krl_handshake.suffix(self.partner.phases(int(operation.meets[row])))}()"
                for row in np.flatnonzero(operation.meets).tolist()
            }
        for number, part in enumerate(parts):
            seconds = short(float(track.duration[part.first : part.last].sum()), 2)
            out += comment(f"Segment {mark(part.segment)}: {part.last - part.first} moves, {seconds} s.")
            for row in range(part.first, part.last):
                out += lines.of(row, fresh=number == 0 and row == part.first)
                out += [calls[row]] if row in calls else []
        return out


def _question_follows(steps: Sequence[Step]) -> bool:
    """Whether the next step that is more than a message is a question."""
    rest = (step for step in steps if not (isinstance(step, Do) and step.action.kind == "message"))
    first = next(rest, None)
    return isinstance(first, Do) and first.action.kind == "confirm"
