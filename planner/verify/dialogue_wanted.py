"""What programs should say, ask, switch and wait for: their starts and setups by the problem, operations by
their claims, error handlers by what may stop them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from planner import dialogue
from planner.claims import WireJoins
from planner.claims_dialogue import DialogueStep, DialogueStop, Figure, OperatorDialogue, asked, told
from planner.dialogue import Sentence
from planner.problem import Setup
from planner.verify.context import Context
from planner.verify.dialogue_read import Spoken
from planner.verify.job import TaskText
from planner.verify.steps import MoveStep
from planner.verify.values import RobTarget

ROUNDED: Final = 1e-4
"""What a target that is written may be off its place [m]."""
Said = tuple[Sentence, dict[str, Figure]]


@dataclasses.dataclass(frozen=True)
class Place:
    """Where steps belong. ``start``: before anything moves; ``setup``: at home before an operation;
    ``first`` and ``last``: at its first and last targets; else as `DialogueStop` has it. ``operation`` counts
    from 0."""

    kind: Literal["start", "setup", "first", "last", "before", "behind", "in"]
    operation: int = 0
    key: str = ""
    way_in: str = ""
    at: NDArray[np.float64] | None = None
    near: float = 0.0

    def holds(self, spoken: Spoken) -> bool:
        """Whether something is said there."""
        match self.kind:
            case "start":
                return spoken.before is None
            case "setup":
                return spoken.group == self.operation and spoken.at_joints and spoken.to_joints
            case "first":
                return spoken.group == self.operation and spoken.at_joints and not spoken.to_joints
            case "last":
                return spoken.group == self.operation + 1 and not spoken.at_joints and spoken.to_joints
            case "before":
                here = spoken.ahead == self.key and spoken.behind != self.key and not spoken.at_joints
            case "behind":
                here = spoken.behind == self.key and spoken.ahead != self.key and not spoken.to_joints
            case "in":
                here = spoken.behind in (self.key, self.way_in) and self._near(spoken.before)
        return here and spoken.group == self.operation + 1

    def _near(self, move: MoveStep | None) -> bool:
        if self.at is None:
            return True
        target = None if move is None else move.target
        if not isinstance(target, RobTarget):
            return False
        return bool(np.linalg.norm(target.position - self.at) <= self.near + ROUNDED)

    def __str__(self) -> str:
        number = self.operation + 1
        match self.kind:
            case "start":
                return "before anything moves"
            case "setup":
                return f"with all arms at home before operation {number}"
            case "first":
                return f"at the first targets of operation {number}"
            case "last":
                return f"at the last targets of operation {number}"
            case "before" | "behind":
                return f"{self.kind} {self.key}"
            case "in":
                where = "" if self.at is None else f" at {np.round(1e3 * self.at, 2).tolist()} mm"
                return f"in {self.key}{where}"


@dataclasses.dataclass(frozen=True)
class Part:
    """Steps that stand together at a place."""

    place: Place
    steps: tuple[DialogueStep, ...]
    repeats: bool = False
    optional: bool = False


def wanted(context: Context) -> dict[str, list[Part]]:
    """What each task should say, in order, by its name."""
    tasks = context.job.tasks
    out: dict[str, list[Part]] = {task.name: [Part(Place("start"), _start(context, task))] for task in tasks}
    opened = {setup.operations[0]: setup for setup in context.setups if setup.steps}
    for number, operation in enumerate(context.problem.operations):
        if number in opened and tasks:
            out[tasks[0].name].append(Part(Place("setup", number), _setup(opened[number])))
        group = context.by_operation.get(operation.name, ())
        for claim in group:
            if isinstance(claim, OperatorDialogue):
                speaker = next((task for task in tasks if task.arm.name in claim.arms), None)
                if speaker is not None:
                    out[speaker.name] += _operation(number, claim)
    return out


def joined(context: Context) -> bool:
    """Whether the arms are joined in some operation."""
    return any(
        isinstance(claim, WireJoins) or (isinstance(claim, OperatorDialogue) and claim.joined)
        for claim in context.claims
    )


def handler(context: Context, task: TaskText, procedure: str) -> tuple[Said, ...]:
    """What an error handler says, in this order."""
    out: list[Said] = [(dialogue.FAILED, {"procedure": procedure})]
    if _partner(context, task):
        out.append((dialogue.UNANSWERED, {"other": _partner(context, task)}))
    return (*out, (dialogue.JOINED if joined(context) else dialogue.ALONE, {}))


def aside(context: Context, task: TaskText) -> tuple[Said, ...]:
    """What may be said on a way that is decided at run time, which ends the program."""
    partner = _partner(context, task)
    return ((dialogue.UNANSWERED, {"other": partner}),) if partner else ()


def _partner(context: Context, task: TaskText) -> str:
    """The arm of the other one of two controllers, empty for one controller."""
    others = [other.arm.name for other in context.job.tasks if other is not task]
    return others[0] if context.job.readings is not None and others else ""


def _start(context: Context, task: TaskText) -> tuple[DialogueStep, ...]:
    first = bool(context.setups[0].steps)
    krl, lead = task.krl is not None, task is context.job.tasks[0]
    if krl:
        question = dialogue.KRL_CLEAR if first else dialogue.KRL_READY
    else:
        question = dialogue.CLEAR if first else dialogue.READY
    partner = _partner(context, task)
    if partner:
        earlier = asked(dialogue.KRL_EARLIER if krl else dialogue.EARLIER, other=partner)
        if not lead:
            return earlier, told(dialogue.READY_TO_MEET, other=partner)
        both = {"other": partner, "arm": task.arm.name, "start": question.words}
        return earlier, told(dialogue.START_PARTNER, other=partner), asked(dialogue.PARTNER_READY, **both)
    if not lead:
        return ()
    return (asked(dialogue.NO_WIRE if joined(context) and not krl else question),)


def _setup(setup: Setup) -> tuple[DialogueStep, ...]:
    steps = (told(dialogue.PLAIN, text=step) for step in setup.steps)
    return (*steps, asked(dialogue.PLAIN, text=setup.confirmation))


def _operation(number: int, claim: OperatorDialogue) -> Sequence[Part]:
    return [
        Part(Place("first", number), claim.first),
        *(_stop(number, stop) for stop in claim.stops),
        Part(Place("last", number), claim.last),
    ]


def _stop(number: int, stop: DialogueStop) -> Part:
    own = stop.segment
    way_in = own.at("in").key if own.name else own.key
    place = Place(stop.where, number, own.key, way_in, stop.at, stop.near)
    return Part(place, stop.steps, stop.repeats, stop.optional)
