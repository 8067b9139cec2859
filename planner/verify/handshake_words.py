"""What the model check found, in words: arms, lines of programs, signals, what waits for what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planner.handshake import SignalWire
from planner.verify.handshake_model import Action, Event, Finding
from planner.verify.handshake_text import Reading
from planner.verify.steps import Step

SHOWN = 6
"""Events that are told of the way to a fault."""


class Words:
    """Words for two programs: ``arms`` in the order of the check."""

    def __init__(
        self,
        arms: Sequence[str],
        readings: Mapping[str, Reading],
        steps: Mapping[str, Sequence[Step]],
        wires: Sequence[SignalWire],
    ) -> None:
        self.arms = arms
        self.actions = [readings[arm].actions for arm in arms]
        self.steps = [steps[arm] for arm in arms]
        self.wires = wires

    def message(self, finding: Finding) -> str:
        """The fault and the shortest way to it."""
        heads = {"deadlock": self._deadlock, "lost_edge": self._lost, "apart": self._apart}
        head = heads.get(finding.kind, self._unwatched)
        events = "; ".join(self.event(event) for event in finding.trace[-SHOWN:])
        way = f" The shortest way there, its last events of {finding.steps}: {events}" if events else ""
        return f"{head(finding)}.{way}"

    def step(self, finding: Finding) -> tuple[int, Step | None]:
        """Program and step that the fault is best looked for at."""
        for program in (finding.program, 1 - finding.program):
            action = self._action(program, finding.places[program])
            if action is not None:
                return program, self.steps[program][action.line]
        return finding.program, None

    def event(self, event: Event) -> str:
        """One event."""
        action = self._action(event.program, event.place)
        return f"{self.arms[event.program]} {self._does(event.program, action)}"

    def _action(self, program: int, place: int) -> Action | None:
        row = self.actions[program]
        return row[place] if place < len(row) else None

    def _line(self, program: int, action: Action) -> str:
        step = self.steps[program][action.line]
        return f"(line {step.line} of {step.module})"

    def _does(self, program: int, action: Action | None) -> str:
        if action is None:
            return "is at its end"
        at = self._line(program, action)
        wire = self.wires[action.wire] if action.kind in ("set", "wait") else None
        match action.kind:
            case "set" if wire is not None:
                return f"sets {wire.output} to {action.value} {at}"
            case "wait" if wire is not None:
                return f"has seen {wire.input} at {action.value} {at}"
            case "go":
                return f"begins what stands behind meeting {action.value} {at}"
            case "look":
                return f"has seen that the other program {'runs' if action.value else 'stands'} {at}"
            case "pause":
                return f"stops by itself {at}"
            case "done":
                return f"is through with what stands behind meeting {action.value}"
            case _:
                return f"is told that the other arm is ready {at}"

    def _where(self, program: int, finding: Finding) -> str:
        """Where a program stands, and for what."""
        arm, action = self.arms[program], self._action(program, finding.places[program])
        if action is None:
            return f"{arm} has come to its end"
        at = self._line(program, action)
        match action.kind:
            case "wait":
                wire = self.wires[action.wire]
                level = f"{finding.read[action.wire]}, and {wire.output} of {wire.source}"
                level += f" is {finding.driven[action.wire]}"
                return f"{arm} waits for {wire.input} to be {action.value} {at}, which is {level}"
            case "set":
                return f"{arm} is about to set {self.wires[action.wire].output} to {action.value} {at}"
            case "go":
                return f"{arm} is at meeting {action.value} {at}"
            case "look":
                return f"{arm} waits until the other program {'runs' if action.value else 'stands'} {at}"
            case "pause":
                return f"{arm} is about to stop by itself {at}"
            case "done":
                return f"{arm} is still at work behind meeting {action.value} {at}"
            case _:
                return f"{arm} waits until the other arm is ready {at}"

    def _deadlock(self, finding: Finding) -> str:
        return f"both programs wait for ever: {self._where(0, finding)}; {self._where(1, finding)}"

    def _lost(self, finding: Finding) -> str:
        action = self._action(finding.program, finding.places[finding.program])
        if action is None:
            return "a last change of a signal is never seen by the other program"
        wire = self.wires[action.wire]
        return (
            f"{self.arms[finding.program]} sets {wire.output} to {action.value} "
            f"{self._line(finding.program, action)} before {wire.sink} has seen its last change: "
            f"{self._where(1 - finding.program, finding)}"
        )

    def _apart(self, finding: Finding) -> str:
        action = self._action(finding.program, finding.places[finding.program])
        number = action.value if action is not None else 0
        at = self._line(finding.program, action) if action is not None else ""
        return (
            f"{self.arms[finding.program]} goes on behind meeting {number} {at} while "
            f"{self._where(1 - finding.program, finding)}: the arms are more than one step apart"
        )

    def _unwatched(self, finding: Finding) -> str:
        action = self._action(finding.program, finding.places[finding.program])
        at = self._line(finding.program, action) if action is not None else ""
        return (
            f"{self.arms[finding.program]} goes on behind the first meeting {at} with a running wire that is "
            "stuck, so that a stop would go unnoticed; each program must see it at 0 and then at 1 before"
        )
