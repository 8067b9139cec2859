"""What programs show, ask, switch and wait for, and what they should.

The expected dialogue follows from the problem for starts and setups, from the claims for operations, and
from possible interruptions for error handlers. A text that is shown is compared with the expected
sentence and its figures. If the problem leaves open what is mounted, the programs choose: the operator
must be shown one of the allowed items, and everything else is proven for that item.
"""

import bisect
import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from planner.claims import sentences
from planner.claims.claim import Claim, OneOf
from planner.claims.dialogue import (
    DialogueStep,
    DialogueStop,
    Figure,
    OperatorDialogue,
    message_step,
    question_step,
)
from planner.claims.sentences import Sentence
from planner.geometry.arrays import FloatArray
from planner.issues import Issue
from planner.problem import Setup
from planner.programs.dialogue_text import fit, sentence_text
from planner.programs.stages import JobText, TaskText
from planner.programs.steps import MessageStep, MoveStep, RobTarget, SignalStep, Step, WaitStep
from planner.programs.text import segment_of_name
from planner.proof.context import Context
from planner.proof.language_contribution import of_task

PANEL_STATE = "#STATE"
"""What the panel of a KUKA controller shows while a program waits, in forms that their own reader holds."""


@dataclasses.dataclass(frozen=True)
class Spoken:
    """One step of a task. ``before`` and ``after``: the moves of any task that come before it and after it,
    None for none; ``group``: how often straight moves have begun behind joint moves by then. ``meanwhile``:
    a move of another task, or of several at once, that nothing keeps from going on at the same time."""

    task: TaskText
    step: Step
    before: MoveStep | None
    after: MoveStep | None
    group: int
    meanwhile: MoveStep | None

    @property
    def kind(self) -> str:
        """``told``, ``asked``, ``on``, ``off``, ``wait`` or ``input``; "" for what no program should have."""
        step = self.step
        if isinstance(step, MessageStep):
            if step.confirm:
                return "asked" if step.certain else ""
            return "told" if step.panel == "line" else ""
        if isinstance(step, SignalStep):
            return {1.0: "on", 0.0: "off"}.get(step.value, "")
        if isinstance(step, WaitStep) and step.signal:
            return "input" if step.value == 1.0 and not step.flag and not step.again else ""
        return "wait" if isinstance(step, WaitStep) else ""

    @property
    def at_joints(self) -> bool:
        """Whether the move before goes by joints, or there is none."""
        return self.before is None or self.before.by_joints

    @property
    def to_joints(self) -> bool:
        """Whether the next move goes by joints, or there is none."""
        return self.after is None or self.after.by_joints

    @functools.cached_property
    def behind(self) -> str:
        """The key of the segment of the move before."""
        return "" if self.before is None else segment_of_name(self.before.procedure).key

    @functools.cached_property
    def ahead(self) -> str:
        """The key of the segment of the next move."""
        return "" if self.after is None else segment_of_name(self.after.procedure).key


def spoken_steps(job: JobText) -> dict[str, list[Spoken]]:
    """The steps of each task, by its name. Steps of the handshake of two controllers are left out, but for
    what they ask."""
    rows = _rows(job)
    moves = [(place, row.step) for place, row in enumerate(rows) if isinstance(row.step, MoveStep)]
    places = [place for place, _ in moves]
    group, groups, joints = 0, [0], True
    for _, move in moves:
        group += joints and not move.by_joints
        joints = move.by_joints
        groups.append(group)
    out: dict[str, list[Spoken]] = {task.name: [] for task in job.tasks}
    for place, row in enumerate(rows):
        if isinstance(row.step, MoveStep) or not _counts(row):
            continue
        k = bisect.bisect_left(places, place)
        before = moves[k - 1][1] if k else None
        after = moves[k][1] if k < len(moves) else None
        out[row.task.name].append(
            Spoken(row.task, row.step, before, after, groups[k], _meanwhile(job, row.task, row.stage))
        )
    return out


@dataclasses.dataclass(frozen=True)
class _Row:
    stage: int
    task: TaskText
    step: Step
    protocol: bool


def _rows(job: JobText) -> list[_Row]:
    """All steps of all tasks, stage by stage."""
    stage_of = {
        id(step): number
        for number, stage in enumerate(job.stages)
        for steps in stage.steps.values()
        for step in steps
    }
    rows: list[tuple[int, int, int, _Row]] = []
    for n, task in enumerate(job.tasks):
        reading = None if job.readings is None else job.readings.get(task.name)
        stage = 0
        for k, step in enumerate(task.steps):
            stage = stage_of.get(id(step), stage)
            protocol = reading is not None and reading.protocol[k]
            rows.append((stage, n, k, _Row(stage, task, step, protocol)))
    return [row for *_, row in sorted(rows, key=lambda item: item[:3])]


def _counts(row: _Row) -> bool:
    """Whether a step is one that this is about: a wait of no time is not, nor are arrivals."""
    step = row.step
    if isinstance(step, MessageStep):
        return step.kind != PANEL_STATE
    if row.protocol:
        return False
    if isinstance(step, WaitStep):
        return bool(step.signal) or step.pause != 0.0 or (step.kind == "WaitTime" and step.seconds is None)
    return isinstance(step, SignalStep)


def _meanwhile(job: JobText, task: TaskText, number: int) -> MoveStep | None:
    """A move that may be under way while a task says something in a stage."""
    stage = job.stages[number]
    for other in job.tasks:
        if stage.moves(other.name) and (other is not task or (stage.synchronised and len(job.tasks) > 1)):
            return stage.moves(other.name)[0]
    return None


TARGET_ROUNDING: Final = 1e-4
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
    at: FloatArray | None = None
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
        return bool(np.linalg.norm(target.position - self.at) <= self.near + TARGET_ROUNDING)

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


def wanted_dialogue(context: Context) -> dict[str, list[Part]]:
    """What each task should say, in order, by its name."""
    tasks = context.job.tasks
    out: dict[str, list[Part]] = {task.name: [Part(Place("start"), _start(context, task))] for task in tasks}
    opened = {setup.operations[0]: setup for setup in context.setups if setup.steps and setup.operations}
    for number, operation in enumerate(context.problem.operations):
        if number in opened and tasks:
            out[tasks[0].name].append(Part(Place("setup", number), _setup(opened[number])))
        group = context.by_operation.get(operation.name, ())
        for claim in group:
            if isinstance(claim, OperatorDialogue):
                speaker = next((task for task in tasks if task.arm.name in claim.arms), None)
                if speaker is not None:
                    out[speaker.name] += _operation(number, claim)
    if tasks and not context.setups[-1].operations:
        end = Place("setup", len(context.problem.operations))
        out[tasks[0].name].append(Part(end, _setup(context.setups[-1])))
    return out


def joined(context: Context) -> bool:
    """Whether the arms are joined in some operation."""
    return any(
        bool(claim.joined_arms) or (isinstance(claim, OperatorDialogue) and claim.joined)
        for claim in context.claims
    )


def handler(context: Context, task: TaskText, procedure: str) -> tuple[Said, ...]:
    """What an error handler says, in this order."""
    out: list[Said] = [(sentences.FAILED, {"procedure": procedure})]
    if _partner(context, task):
        out.append((sentences.UNANSWERED, {"other": _partner(context, task)}))
    return (*out, (sentences.JOINED if joined(context) else sentences.ALONE, {}))


def aside(context: Context, task: TaskText) -> tuple[Said, ...]:
    """What may be said on a way that is decided at run time, which ends the program."""
    partner = _partner(context, task)
    return ((sentences.UNANSWERED, {"other": partner}),) if partner else ()


def _partner(context: Context, task: TaskText) -> str:
    """The arm of the other one of two controllers, empty for one controller."""
    others = [other.arm.name for other in context.job.tasks if other is not task]
    return others[0] if context.job.readings is not None and others else ""


def _start(context: Context, task: TaskText) -> tuple[DialogueStep, ...]:
    start, is_lead = of_task(task).start, task is context.job.tasks[0]
    question = start.clear if context.setups[0].steps else start.ready
    partner = _partner(context, task)
    if partner:
        if not is_lead:
            earlier = question_step(start.follower_earlier, other=partner)
            return earlier, message_step(sentences.READY_TO_MEET, other=partner)
        return (
            question_step(start.leader_earlier, other=partner),
            message_step(start.start_partner, other=partner),
            question_step(sentences.PARTNER_READY, other=partner, arm=task.arm.name, start=question.words),
        )
    if not is_lead:
        return ()
    return (question_step(start.joined if start.joined and joined(context) else question),)


def _setup(setup: Setup) -> tuple[DialogueStep, ...]:
    steps = (message_step(sentences.PLAIN, text=step) for step in setup.steps)
    return (*steps, question_step(sentences.PLAIN, text=setup.confirmation))


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


DIALOGUE = "verify.dialogue"
"""Code of the rule that asks for these sentences."""


def chosen_groups(context: Context) -> Context:
    """The same proof with the one group of each `OneOf` that the text names at the operation's first targets.

    Where it names none, or more than one, the first group stands in, and ``untold`` has a fault of
    ``verify.dialogue``, so that nothing is proven."""
    if not any(isinstance(claim, OneOf) for claim in context.claims):
        return context
    said = spoken_steps(context.job) if context.playable else {}
    untold: list[Issue] = []
    claims: dict[str, tuple[Claim, ...]] = {}
    numbers = {operation.name: n for n, operation in enumerate(context.problem.operations)}
    for name, group in context.by_operation.items():
        own: list[Claim] = []
        for claim in group:
            if isinstance(claim, OneOf):
                own += _settled(context, name, claim, numbers.get(name, 0), said, untold)
            else:
                own.append(claim)
        claims[name] = tuple(own)
    out = context.replaced(claims=claims)
    out.untold = tuple(untold)
    return out


def _settled(
    context: Context, name: str, claim: OneOf, number: int, said: dict[str, list[Spoken]], untold: list[Issue]
) -> tuple[Claim, ...]:
    fitting = [group for group in claim.either if _is_told(context, group, number, said)]
    if len(fitting) == 1:
        return fitting[0]
    names = "; ".join(dict.fromkeys(_shown(group) for group in claim.either))
    what = "none" if not fitting else "more than one"
    message = f"{name}: of what may be mounted the operator is told {what} at the first targets; at hand are "
    untold.append(Issue(DIALOGUE, message + names, field=name, hint="plan again"))
    return claim.either[0]


def _dialogue(group: tuple[Claim, ...]) -> OperatorDialogue | None:
    return next((claim for claim in group if isinstance(claim, OperatorDialogue)), None)


def _heads(group: tuple[Claim, ...]) -> list[DialogueStep]:
    """What is told first, as far as its figures follow from the problem: it says which group it is."""
    dialogue = _dialogue(group)
    steps = () if dialogue is None else dialogue.first
    return list(itertools.takewhile(lambda s: s.kind == "told" and None not in s.figures.values(), steps))


def _shown(group: tuple[Claim, ...]) -> str:
    return ", ".join(sentence_text(s.sentence, s.figures) for s in _heads(group) if s.sentence is not None)


def _is_told(context: Context, group: tuple[Claim, ...], number: int, said: dict[str, list[Spoken]]) -> bool:
    """Whether the task that speaks tells all of it, one line or more each, before anything else there."""
    dialogue = _dialogue(group)
    if dialogue is None:
        return False
    speaker = next((task for task in context.job.tasks if task.arm.name in dialogue.arms), None)
    place = Place("first", number)
    here = [one for one in said.get(speaker.name, []) if place.holds(one)] if speaker is not None else []
    lines = [one.step.text for one in here if one.kind == "told" and isinstance(one.step, MessageStep)]
    for step in _heads(group):
        fits = (
            step.sentence is not None and fit(step.sentence, step.figures, lines[:k]).whole
            for k in range(1, len(lines) + 1)
        )
        count = next((k for k, whole in enumerate(fits, 1) if whole), 0)
        if not count:
            return False
        lines = lines[count:]
    return bool(_heads(group))
