"""What programs show, ask, switch and wait for, and what they should.

The expected dialogue follows from the problem for starts and setups, from the claims for operations, and
from possible interruptions for error handlers. A shown text is compared with the expected sentence and its
values. If the problem leaves open what is mounted, the programs choose: the operator must be shown one of
the allowed items, and everything else is proven for that item.
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
from planner.programs.dialogue_text import match_sentence, sentence_text
from planner.programs.stages import JobText, TaskText
from planner.programs.steps import MessageStep, MoveStep, ProgramStep, RobTarget, SignalStep, WaitStep
from planner.programs.text import segment_of_name
from planner.proof.context import Context
from planner.proof.language_contribution import language_of_task

PANEL_STATE = "#STATE"
"""Kind of the messages on the panel of a KUKA controller while a program waits. Their own reader checks
their forms.
"""


@dataclasses.dataclass(frozen=True)
class OperatorStep:
    """One step of a task's dialogue with the operator, with the moves around it.

    Attributes:
        task: The task.
        step: The step.
        previous_move: Last move of any task before the step, None if there is none.
        next_move: First move of any task after the step, None if there is none.
        group: Number of times before the step that a straight move follows a joint move. Each operation
            starts this way.
        meanwhile: A move of another task, or of several at once, that may go on at the same time.
    """

    task: TaskText
    step: ProgramStep
    previous_move: MoveStep | None
    next_move: MoveStep | None
    group: int
    meanwhile: MoveStep | None

    @property
    def kind(self) -> str:
        """Kind of the step, as :class:`planner.claims.dialogue.DialogueStep` names it.

        ``told`` is a message, ``asked`` a question that the operator must confirm, ``on`` and ``off`` switch
        an output, ``wait`` is a pause and ``input`` a wait for an input. "" is a step that no program should
        have.
        """
        step = self.step
        if isinstance(step, MessageStep):
            if step.confirm:
                return "asked" if step.certain else ""
            return "told" if step.panel == "line" else ""
        if isinstance(step, SignalStep):
            return {1.0: "on", 0.0: "off"}.get(step.value, "")
        if isinstance(step, WaitStep) and step.signal:
            return "input" if step.value == 1.0 and not step.flag and not step.repeats else ""
        return "wait" if isinstance(step, WaitStep) else ""

    @property
    def after_joint_move(self) -> bool:
        """Whether the previous move is a joint move, or there is none."""
        return self.previous_move is None or self.previous_move.by_joints

    @property
    def before_joint_move(self) -> bool:
        """Whether the next move is a joint move, or there is none."""
        return self.next_move is None or self.next_move.by_joints

    @functools.cached_property
    def previous_segment(self) -> str:
        """Key of the segment of the previous move, "" if there is none."""
        return "" if self.previous_move is None else segment_of_name(self.previous_move.procedure).key

    @functools.cached_property
    def next_segment(self) -> str:
        """Key of the segment of the next move, "" if there is none."""
        return "" if self.next_move is None else segment_of_name(self.next_move.procedure).key


def operator_steps(job: JobText) -> dict[str, list[OperatorStep]]:
    """Return the dialogue steps of each task by its name, to compare them with the expected dialogue.

    Steps of the handshake of two controllers are left out, except for messages and questions.
    """
    steps = _all_steps(job)
    moves = [
        (position, entry.step) for position, entry in enumerate(steps) if isinstance(entry.step, MoveStep)
    ]
    move_positions = [position for position, _ in moves]
    # groups[k]: number of times that a straight move follows a joint move among the first k moves.
    group, groups, previous_by_joints = 0, [0], True
    for _, move in moves:
        group += previous_by_joints and not move.by_joints
        previous_by_joints = move.by_joints
        groups.append(group)
    out: dict[str, list[OperatorStep]] = {task.name: [] for task in job.tasks}
    for position, entry in enumerate(steps):
        if isinstance(entry.step, MoveStep) or not _is_dialogue_step(entry):
            continue
        k = bisect.bisect_left(move_positions, position)
        previous_move = moves[k - 1][1] if k else None
        next_move = moves[k][1] if k < len(moves) else None
        out[entry.task.name].append(
            OperatorStep(
                entry.task,
                entry.step,
                previous_move,
                next_move,
                groups[k],
                _simultaneous_move(job, entry.task, entry.stage),
            )
        )
    return out


@dataclasses.dataclass(frozen=True)
class _StageStep:
    """A step with the number of its stage. ``protocol``: whether it belongs to the handshake."""

    stage: int
    task: TaskText
    step: ProgramStep
    protocol: bool


def _all_steps(job: JobText) -> list[_StageStep]:
    """Return all steps of all tasks: stage by stage, in each stage task by task.

    A step that is in no stage counts to the stage of the step before it.
    """
    stage_of = {
        id(step): number
        for number, stage in enumerate(job.stages)
        for steps in stage.steps.values()
        for step in steps
    }
    rows: list[tuple[int, int, int, _StageStep]] = []
    for n, task in enumerate(job.tasks):
        automaton = None if job.automata_by_arm is None else job.automata_by_arm.get(task.name)
        stage = 0
        for k, step in enumerate(task.steps):
            stage = stage_of.get(id(step), stage)
            protocol = automaton is not None and automaton.protocol[k]
            rows.append((stage, n, k, _StageStep(stage, task, step, protocol)))
    return [row for *_, row in sorted(rows, key=lambda item: item[:3])]


def _is_dialogue_step(row: _StageStep) -> bool:
    """Return whether a step belongs to the dialogue. Moves, zero waits and handshake signals do not."""
    step = row.step
    if isinstance(step, MessageStep):
        return step.kind != PANEL_STATE
    if row.protocol:
        return False
    if isinstance(step, WaitStep):
        return bool(step.signal) or step.pause != 0.0 or (step.kind == "WaitTime" and step.seconds is None)
    return isinstance(step, SignalStep)


def _simultaneous_move(job: JobText, task: TaskText, number: int) -> MoveStep | None:
    """Return a move that may run while a task shows something in stage ``number``, None if none may.

    In a synchronised stage of several tasks, the task's own moves count, too: another task may execute its
    part of them already.
    """
    stage = job.stages[number]
    for other in job.tasks:
        if stage.moves(other.name) and (other is not task or (stage.synchronised and len(job.tasks) > 1)):
            return stage.moves(other.name)[0]
    return None


TARGET_TOLERANCE_M: Final = 1e-4
"""Tolerance [m] between a written target and its position."""
ShownText = tuple[Sentence, dict[str, Figure]]
"""A sentence that a program shows, and the values of its placeholders by name."""


@dataclasses.dataclass(frozen=True)
class DialoguePosition:
    """Position in the programs at which steps of the dialogue belong.

    Attributes:
        kind: ``start``: before anything moves; ``setup``: at home before an operation; ``first`` and
            ``last``: at the first and last targets of an operation; else as in `DialogueStop`.
        operation: Index of the operation.
        key: Key of the segment.
        approach_key: Key of the segment's lead-in.
        at: Position (3,) [m] of the target before the steps, None for any.
        tolerance: Tolerance [m] of the position.
    """

    kind: Literal["start", "setup", "first", "last", "before", "behind", "in"]
    operation: int = 0
    key: str = ""
    approach_key: str = ""
    at: FloatArray | None = None
    tolerance: float = 0.0

    def contains(self, entry: OperatorStep) -> bool:
        """Return whether a dialogue step is at this position."""
        match self.kind:
            case "start":
                return entry.previous_move is None
            case "setup":
                return entry.group == self.operation and entry.after_joint_move and entry.before_joint_move
            case "first":
                return (
                    entry.group == self.operation and entry.after_joint_move and not entry.before_joint_move
                )
            case "last":
                return (
                    entry.group == self.operation + 1
                    and not entry.after_joint_move
                    and entry.before_joint_move
                )
            case "before":
                matches = (
                    entry.next_segment == self.key
                    and entry.previous_segment != self.key
                    and not entry.after_joint_move
                )
            case "behind":
                matches = (
                    entry.previous_segment == self.key
                    and entry.next_segment != self.key
                    and not entry.before_joint_move
                )
            case "in":
                matches = entry.previous_segment in (self.key, self.approach_key) and self._is_near(
                    entry.previous_move
                )
        return matches and entry.group == self.operation + 1

    def _is_near(self, move: MoveStep | None) -> bool:
        """Return whether the target of a move is at ``at``, within the tolerance."""
        if self.at is None:
            return True
        target = None if move is None else move.target
        if not isinstance(target, RobTarget):
            return False
        return bool(np.linalg.norm(target.position - self.at) <= self.tolerance + TARGET_TOLERANCE_M)

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
class DialoguePart:
    """Steps that belong together at one position.

    Attributes:
        position: Where they belong.
        steps: The steps.
        repeats: Whether they may repeat.
        optional: Whether they may be absent.
    """

    position: DialoguePosition
    steps: tuple[DialogueStep, ...]
    repeats: bool = False
    optional: bool = False


def expected_dialogue(context: Context) -> dict[str, list[DialoguePart]]:
    """Return the expected parts of the dialogue of each task by its name, in order.

    They are the start, for each operation the setup that it opens and the dialogue that its claims state, and
    the setup at the end in which axes move home. The first task asks about setups. The dialogue of an
    operation belongs to the first task whose arm the claim names.
    """
    tasks = context.job.tasks
    out: dict[str, list[DialoguePart]] = {
        task.name: [DialoguePart(DialoguePosition("start"), _start_steps(context, task))] for task in tasks
    }
    opened = {setup.operations[0]: setup for setup in context.setups if setup.steps and setup.operations}
    for number, operation in enumerate(context.problem.operations):
        if number in opened and tasks:
            out[tasks[0].name].append(
                DialoguePart(DialoguePosition("setup", number), _setup_steps(opened[number]))
            )
        group = context.by_operation.get(operation.name, ())
        for claim in group:
            if isinstance(claim, OperatorDialogue):
                speaker = next((task for task in tasks if task.arm.name in claim.arms), None)
                if speaker is not None:
                    out[speaker.name] += _operation_parts(number, claim)
    if tasks and not context.setups[-1].operations:
        end = DialoguePosition("setup", len(context.problem.operations))
        out[tasks[0].name].append(DialoguePart(end, _setup_steps(context.setups[-1])))
    return out


def arms_joined(context: Context) -> bool:
    """Return whether the arms are joined in some operation."""
    return any(
        bool(claim.joined_arms) or (isinstance(claim, OperatorDialogue) and claim.joined)
        for claim in context.claims
    )


def handler_texts(context: Context, task: TaskText, procedure: str) -> tuple[ShownText, ...]:
    """Return the texts that the error handler of a procedure shows, in order, with their values."""
    out: list[ShownText] = [(sentences.FAILED, {"procedure": procedure})]
    if _partner_arm(context, task):
        out.append((sentences.UNANSWERED, {"other": _partner_arm(context, task)}))
    return (*out, (sentences.JOINED if arms_joined(context) else sentences.ALONE, {}))


def branch_texts(context: Context, task: TaskText) -> tuple[ShownText, ...]:
    """Return the texts that a task may show in a branch that is taken at run time and ends the program."""
    partner = _partner_arm(context, task)
    return ((sentences.UNANSWERED, {"other": partner}),) if partner else ()


def _partner_arm(context: Context, task: TaskText) -> str:
    """Return the name of the arm on the other of two controllers, "" if there is one controller."""
    others = [other.arm.name for other in context.job.tasks if other is not task]
    return others[0] if context.job.automata_by_arm is not None and others else ""


def _start_steps(context: Context, task: TaskText) -> tuple[DialogueStep, ...]:
    """Return the messages and questions of a task before anything moves.

    The first task asks. With two controllers, the other program asks about an earlier run, too.
    """
    start, is_lead = language_of_task(task).start, task is context.job.tasks[0]
    question = start.clear if context.setups[0].steps else start.ready
    partner = _partner_arm(context, task)
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
    return (question_step(start.joined if start.joined and arms_joined(context) else question),)


def _setup_steps(setup: Setup) -> tuple[DialogueStep, ...]:
    """Return the messages that describe a setup, and the question that confirms it."""
    steps = (message_step(sentences.PLAIN, text=step) for step in setup.steps)
    return (*steps, question_step(sentences.PLAIN, text=setup.confirmation))


def _operation_parts(number: int, claim: OperatorDialogue) -> Sequence[DialoguePart]:
    """Return the parts of operation ``number``: at its first targets, at stops, and at its last targets."""
    return [
        DialoguePart(DialoguePosition("first", number), claim.first),
        *(_stop_part(number, stop) for stop in claim.stops),
        DialoguePart(DialoguePosition("last", number), claim.last),
    ]


def _stop_part(number: int, stop: DialogueStop) -> DialoguePart:
    """Return the part of the dialogue at a stop of operation ``number``."""
    segment = stop.segment
    approach_key = segment.at("in").key if segment.name else segment.key
    position = DialoguePosition(stop.where, number, segment.key, approach_key, stop.at, stop.tolerance)
    return DialoguePart(position, stop.steps, stop.repeats, stop.optional)


DIALOGUE = "verify.dialogue"
"""Code of the rule that requires these sentences."""


def with_chosen_groups(context: Context) -> Context:
    """Return the context with one group of claims of each `OneOf`, so that everything is proven for it.

    A `OneOf` states several groups, one for each item that may be mounted. Chosen is the group that the text
    names at the operation's first targets. If the text names none, or more than
    one, the first group is used, and ``dialogue_issues`` has an issue of ``verify.dialogue``, so that nothing
    is proven.
    """
    if not any(isinstance(claim, OneOf) for claim in context.claims):
        return context
    steps_by_task = operator_steps(context.job) if context.is_replayable else {}
    issues: list[Issue] = []
    claims: dict[str, tuple[Claim, ...]] = {}
    numbers = {operation.name: n for n, operation in enumerate(context.problem.operations)}
    for name, group in context.by_operation.items():
        chosen: list[Claim] = []
        for claim in group:
            if isinstance(claim, OneOf):
                chosen += _choose_group(context, name, claim, numbers.get(name, 0), steps_by_task, issues)
            else:
                chosen.append(claim)
        claims[name] = tuple(chosen)
    out = context.with_changes(claims=claims)
    out.dialogue_issues = tuple(issues)
    return out


def _choose_group(
    context: Context,
    name: str,
    claim: OneOf,
    number: int,
    steps_by_task: dict[str, list[OperatorStep]],
    issues: list[Issue],
) -> tuple[Claim, ...]:
    """Return the only group of a `OneOf` that the programs show, else its first group.

    In the latter case an issue is appended to ``issues``. ``name`` and ``number`` are those of the operation,
    and ``steps_by_task`` are the dialogue steps of each task.
    """
    shown_groups = [group for group in claim.either if _is_shown(context, group, number, steps_by_task)]
    if len(shown_groups) == 1:
        return shown_groups[0]
    descriptions = "; ".join(dict.fromkeys(_describe_group(group) for group in claim.either))
    shown = "none" if not shown_groups else "more than one"
    message = f"{name}: the texts at the first targets name {shown} of the items to mount; available: "
    issues.append(Issue(DIALOGUE, message + descriptions, field=name, hint="plan again"))
    return claim.either[0]


def _dialogue(group: tuple[Claim, ...]) -> OperatorDialogue | None:
    """Return the claim on the dialogue in a group of claims, None without one."""
    return next((claim for claim in group if isinstance(claim, OperatorDialogue)), None)


def _identifying_steps(group: tuple[Claim, ...]) -> list[DialogueStep]:
    """Return the texts at the start of a group's dialogue whose values all follow from the problem.

    They identify the group.
    """
    dialogue = _dialogue(group)
    steps = () if dialogue is None else dialogue.first
    return list(itertools.takewhile(lambda s: s.kind == "told" and None not in s.figures.values(), steps))


def _describe_group(group: tuple[Claim, ...]) -> str:
    """Return the texts that identify a group, for messages."""
    return ", ".join(
        sentence_text(s.sentence, s.figures) for s in _identifying_steps(group) if s.sentence is not None
    )


def _is_shown(
    context: Context, group: tuple[Claim, ...], number: int, steps_by_task: dict[str, list[OperatorStep]]
) -> bool:
    """Return whether a task shows the texts that identify a group, before all other texts at its position.

    The position is at the first targets of operation ``number``. Each text may have one or more lines.
    """
    dialogue = _dialogue(group)
    if dialogue is None:
        return False
    speaker = next((task for task in context.job.tasks if task.arm.name in dialogue.arms), None)
    position = DialoguePosition("first", number)
    steps_here = (
        [entry for entry in steps_by_task.get(speaker.name, []) if position.contains(entry)]
        if speaker is not None
        else []
    )
    lines = [
        entry.step.text
        for entry in steps_here
        if entry.kind == "told" and isinstance(entry.step, MessageStep)
    ]
    for step in _identifying_steps(group):
        matches = (
            step.sentence is not None and match_sentence(step.sentence, step.figures, lines[:k]).matches
            for k in range(1, len(lines) + 1)
        )  # of the first k lines
        count = next((k for k, is_match in enumerate(matches, 1) if is_match), 0)
        if not count:
            return False
        lines = lines[count:]
    return bool(_identifying_steps(group))
