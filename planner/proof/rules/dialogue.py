"""verify.dialogue: messages and questions of programs to their operators.

The texts must be, word for word, those that follow from the problem, at the right positions, and no others.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

from planner.claims import sentences
from planner.claims.claim import OneOf
from planner.claims.dialogue import DialogueStep, OperatorDialogue
from planner.claims.sentences import Sentence
from planner.issues import Issue
from planner.programs.dialogue_text import SentenceMatch, match_sentence
from planner.programs.dialogue_text import sentence_text as sentence_of
from planner.programs.stages import TaskText
from planner.programs.steps import ChoiceStep, MessageStep, ProgramStep, SettingStep, WaitStep
from planner.proof import dialogue
from planner.proof.context import Context
from planner.proof.dialogue import (
    DialoguePart,
    DialoguePosition,
    OperatorStep,
    ShownText,
    expected_dialogue,
    operator_steps,
)
from planner.proof.language_contribution import job_issues
from planner.proof.rule import RuleOutcome, rule, step_issue

DIALOGUE = "verify.dialogue"
"""Code of the rule on operator dialogue."""
DIFFERENCES = (
    "shows another text",
    "replaces it",
    "waits for another time",
    "switches another signal",
    "waits for another input, or with another time limit",
)
"""How a step may differ from the expected one."""
WAIT_ROUNDING_S = 0.0005
"""Rounding [s] of wait times, which are written with three decimals."""
BOX_OPTIONS = frozenset({"buttons", "icon", "wrap"})
"""Options of a message box that do not change the question."""
MAX_SENTENCE_LINES = 40
"""Maximum number of lines of a sentence."""


@dataclasses.dataclass(frozen=True)
class MatchedStep:
    """A step of a program that matches an expected step of the dialogue.

    Attributes:
        step: The expected step.
        position: Where it is expected.
        entry: The step of the program.
        fit: The match, with the values in the text that the proof compares with the motion.
    """

    step: DialogueStep
    position: DialoguePosition
    entry: OperatorStep
    fit: SentenceMatch


@rule("verify.dialogue", OneOf, OperatorDialogue)
def operator_dialogue(context: Context) -> RuleOutcome:
    """The operator is shown and asked what follows from the problem, word for word and figure for figure.
    Each step is in the task and at the position where it belongs, confirmed by one button, with signals
    and waits between and every arm at rest. Nothing else is shown, also in error handlers.
    """
    expected, entries = expected_dialogue(context), operator_steps(context.job)
    issues: list[Issue] = [*context.dialogue_issues, *job_issues(DIALOGUE, context)]
    for task in context.job.tasks:
        _, faults = compare_dialogue(task, expected[task.name], entries[task.name], expected)
        issues += faults
        issues += _check_side_paths(context, task)
    count = sum(len(steps) for steps in entries.values())
    return RuleOutcome(tuple(issues), where=f"{count} steps")


# ---- straight path of each task ----


def compare_dialogue(
    task: TaskText,
    parts: Sequence[DialoguePart],
    entries: Sequence[OperatorStep],
    every: dict[str, list[DialoguePart]],
) -> tuple[list[MatchedStep], list[Issue]]:
    """Compare the dialogue of a task with the expected one, step by step.

    The comparison ends at the first difference. A part that is optional or repeats is skipped unless the next
    step of the program is at its position. Expected waits that are rounded to 0 are left out.

    Args:
        task: The task.
        parts: Expected parts in order.
        entries: Dialogue steps of the task in order.
        every: Expected parts of all tasks by name, to name the task to which a surplus step belongs.

    Returns:
        The matched steps, and the first difference as an issue, if any.
    """
    rest = list(entries)
    while rest and rest[0].kind == "off" and rest[0].previous_move is None:
        rest.pop(0)  # power off at the very start, of any number of signals, is not part of the dialogue
    matched: list[MatchedStep] = []
    for part in parts:
        steps = [step for step in part.steps if not (step.kind == "wait" and step.seconds < WAIT_ROUNDING_S)]
        repeat = True
        while repeat:
            if (part.optional or part.repeats) and not (rest and part.position.contains(rest[0])):
                break
            for step in steps:
                match = _match_step(step, part.position, rest)
                if isinstance(match, str):
                    return matched, [_first_difference(task, match, step, part, rest, every)]
                matched.append(match)
            repeat = part.repeats
    if rest:
        message = (
            f"{_describe_entry(rest[0])} {_describe_position(rest[0])}, which is not part of the dialogue"
        )
        owner = next((name for name in every if name != task.name and _matches_any(rest[0], every[name])), "")
        message += f"; it belongs to task {owner}" if owner else ""
        return matched, [step_issue(DIALOGUE, message, task, rest[0].step, "remove it, or plan again")]
    return matched, []


def _match_step(
    step: DialogueStep, position: DialoguePosition, rest: list[OperatorStep]
) -> MatchedStep | str:
    """Match an expected step with the first entries of ``rest``, and remove those that it takes.

    A sentence may take several lines or boxes. If the step does not match, ``rest`` stays as it is. After the
    content, the options and headers of messages, the position, and motions at the same time are compared.

    Args:
        step: The expected step.
        position: Where it is expected.
        rest: Dialogue steps of the task that have not been matched yet.

    Returns:
        The matched step, or the difference as a text.
    """
    if not rest:
        return "is missing"
    entry = rest[0]
    if entry.kind != step.kind:
        return _kind_difference(entry)
    count = 1
    result = SentenceMatch(True)
    if step.sentence is not None:
        lines = _entries_of_kind(rest, step.kind)
        results = [
            match_sentence(step.sentence, step.figures, _texts(lines[: k + 1])) for k in range(len(lines))
        ]
        # The smallest number of lines that match, or that match but for their figures (fault).
        best = next((k for k, candidate in enumerate(results) if candidate.matches or candidate.fault), None)
        if best is None:
            return DIFFERENCES[0]
        result, count = results[best], best + 1
        if result.fault:
            return f"has other figures: {result.fault}"
    elif step.kind == "wait":
        if (
            not isinstance(entry.step, WaitStep)
            or abs(entry.step.pause - step.seconds) > WAIT_ROUNDING_S + 1e-9
        ):
            return DIFFERENCES[2]
    elif step.kind == "input":
        if not _is_expected_wait(entry.step, step):
            return DIFFERENCES[4]
    elif getattr(entry.step, "signal", "").lower() != step.signal.lower() or getattr(
        entry.step, "delay", 0.0
    ):
        return DIFFERENCES[3]
    for other in rest[:count]:
        option_fault = _unexpected_option(other)
        if option_fault:
            return option_fault
        if not position.contains(other):
            return "is at another position"
        if other.meanwhile is not None:
            return f"appears while an arm may move (line {other.meanwhile.line} of {other.meanwhile.module})"
    del rest[:count]
    return MatchedStep(step, position, entry, result)


def _is_expected_wait(program_step: ProgramStep, step: DialogueStep) -> bool:
    """Return whether a wait is for the expected input, with the expected time limit."""
    return (
        isinstance(program_step, WaitStep)
        and program_step.signal.lower() == step.signal.lower()
        and program_step.seconds is not None
        and abs(program_step.seconds - step.seconds) <= WAIT_ROUNDING_S + 1e-9
    )


def _entries_of_kind(rest: Sequence[OperatorStep], kind: str) -> list[MessageStep]:
    """Return the messages at the start of ``rest`` that are of one kind, at most ``MAX_SENTENCE_LINES``."""
    matching = itertools.takewhile(lambda entry: entry.kind == kind, rest[:MAX_SENTENCE_LINES])
    return [entry.step for entry in matching if isinstance(entry.step, MessageStep)]


def _texts(steps: Sequence[MessageStep]) -> list[str]:
    """Return the texts of messages."""
    return [step.text for step in steps]


def _kind_difference(entry: OperatorStep) -> str:
    """Return the difference of a step of another kind: a box without a press of OK, or any other step."""
    step = entry.step
    if isinstance(step, MessageStep) and step.confirm and not step.certain:
        return "is in a box that continues without a press of OK"
    return DIFFERENCES[1]


def _unexpected_option(entry: OperatorStep) -> str:
    """Return the option or header of a message that is not expected, as a text, "" if there is none."""
    step = entry.step
    if not isinstance(step, MessageStep):
        return ""
    unexpected = [name for name, _ in step.options if name not in (BOX_OPTIONS if step.confirm else ())]
    if unexpected:
        return f"has \\{unexpected[0]}, which shows or does more than expected"
    if step.kind == "UIMsgBox" and step.header not in ("", sentences.HEADER):
        return f"has the header {step.header!r}; allowed: {sentences.HEADER!r}"
    return ""


def _first_difference(
    task: TaskText,
    why: str,
    step: DialogueStep,
    part: DialoguePart,
    rest: Sequence[OperatorStep],
    every: dict[str, list[DialoguePart]],
) -> Issue:
    """Return the issue about the first difference: a step that is missing, added, changed or moved.

    A step of the program with other content (``DIFFERENCES``) counts as added if one of the next 7 steps is
    the expected one. It appears in place of a missing step if it matches another step of this part or a later
    one. Otherwise it counts as changed.

    Args:
        task: The task.
        why: Difference as a text: one of ``DIFFERENCES``, or another one.
        step: The expected step.
        part: Part of the dialogue to which it belongs.
        rest: Remaining steps of the program.
        every: Expected parts of all tasks by name.
    """
    expected = f"{_describe_expected(step)} {part.position}"
    hint = "plan again to write complete programs"
    if not rest:
        return Issue(
            DIALOGUE, f"{task.name}: {expected} is missing", arm=task.arm.name, file=task.name, hint=hint
        )
    entry = rest[0]
    if why in DIFFERENCES:
        if any(_matches(other, step) for other in rest[1:8]):
            why = f"is not expected before {expected}"
        elif _matches_any(entry, [DialoguePart(part.position, part.steps)]) or _matches_later(
            entry, step, every[task.name]
        ):
            why = f"appears where {expected} is missing"
        else:
            why = f"differs from what is expected: {expected}"
    else:
        why = f"{why}; expected: {expected}"
    return step_issue(
        DIALOGUE, f"{_describe_entry(entry)} {_describe_position(entry)} {why}", task, entry.step, hint
    )


def _matches(entry: OperatorStep, step: DialogueStep) -> bool:
    """Return whether an entry alone matches an expected step. Its position does not count."""
    if entry.kind != step.kind:
        return False
    if step.sentence is not None:
        program_step = entry.step
        return (
            isinstance(program_step, MessageStep)
            and match_sentence(step.sentence, step.figures, [program_step.text]).matches
        )
    if step.kind == "wait":
        return isinstance(entry.step, WaitStep) and abs(entry.step.pause - step.seconds) <= WAIT_ROUNDING_S
    if step.kind == "input":
        return _is_expected_wait(entry.step, step)
    return getattr(entry.step, "signal", "").lower() == step.signal.lower()


def _matches_any(entry: OperatorStep, parts: Sequence[DialoguePart]) -> bool:
    """Return whether an entry is a message or question that alone matches a step of some parts."""
    return entry.kind in ("told", "asked") and any(
        _matches(entry, step) for part in parts for step in part.steps
    )


def _matches_later(entry: OperatorStep, step: DialogueStep, parts: Sequence[DialoguePart]) -> bool:
    """Return whether an entry matches an expected step after ``step``, which is missing, in the same task."""
    steps = [later_step for part in parts for later_step in part.steps]
    position = next(k for k, later_step in enumerate(steps) if later_step is step)
    return any(_matches(entry, later_step) for later_step in steps[position + 1 :])


def _describe_expected(step: DialogueStep) -> str:
    """Describe an expected step for messages: its text, its wait, or the signal that it switches."""
    if step.sentence is not None:
        verb = "the text" if step.kind == "told" else "the question"
        return f"{verb} {sentence_of(step.sentence, step.figures)!r}"
    if step.kind == "wait":
        return f"a wait of {step.seconds:g} s"
    if step.kind == "input":
        return f"a wait for {step.signal}, for {step.seconds:g} s at most,"
    return f"switching {step.signal} {step.kind}"


def _describe_entry(entry: OperatorStep) -> str:
    """Describe a step of a program for messages: its instruction and text, its wait, or its signal."""
    step = entry.step
    if isinstance(step, MessageStep):
        text = step.text or "nothing"
        return f"{step.kind} {text!r}"
    if isinstance(step, WaitStep):
        if step.signal:
            return f"{step.kind} {step.signal}"
        return f"a wait of {step.seconds:g} s" if step.seconds is not None else "a wait of unknown time"
    return f"{getattr(step, 'signal', '')} set to {getattr(step, 'value', 0.0):g}"


def _describe_position(entry: OperatorStep) -> str:
    """Describe where a step of a program is, by the segments of the moves before and after it."""
    if entry.previous_move is None:
        return "before anything moves"
    if entry.next_move is None:
        return "after the last move"
    a = "a joint move" if entry.after_joint_move else entry.previous_segment
    b = "a joint move" if entry.before_joint_move else entry.next_segment
    return f"between {a} and {b}"


# ---- error handlers, UNDO and run-time branches ----


def _check_side_paths(context: Context, task: TaskText) -> Iterator[Issue]:
    """Check the messages in error handlers, in UNDO, and in branches that are decided at run time.

    - An error handler shows its expected texts (:func:`_check_handler`).
    - UNDO shows nothing.
    - A run-time branch shows a text only if it is allowed and the branch ends the program. It does not wait.
    """
    for (module, procedure), block in task.handlers.items():
        yield from _check_handler(task, module, block, dialogue.handler_texts(context, task, procedure))
    for block in task.undos.values():
        for step in block:
            if isinstance(step, MessageStep):
                yield step_issue(
                    DIALOGUE, f"UNDO shows {step.text!r}, but must not show anything", task, step
                )
    allowed = dialogue.branch_texts(context, task)
    for step, ends in _run_time_steps(task.steps):
        if isinstance(step, MessageStep) and not (ends and any(_shows(step, *text) for text in allowed)):
            message = f"{step.kind} {step.text!r} is shown only if a run-time condition holds"
            yield step_issue(DIALOGUE, message, task, step, "show it always, or remove it")
        elif isinstance(step, WaitStep) and (step.signal or step.pause or step.seconds is None):
            message = "a run-time condition decides whether the program waits here"
            yield step_issue(DIALOGUE, message, task, step, "remove the wait")


def _check_handler(
    task: TaskText, module: str, block: Sequence[ProgramStep], allowed: Sequence[ShownText]
) -> Iterator[Issue]:
    """Check that an error handler shows all of its sentences, once and in order, and nothing else.

    The first difference is reported.

    Args:
        task: The task.
        module: Name of the module with the handler.
        block: Steps of the handler.
        allowed: Sentences that it must show, with their values, in order.
    """
    shown = [step for step in block if isinstance(step, MessageStep)]
    for sentence, figures in allowed:
        lines = [step.text for step in shown]
        count = next(
            (k + 1 for k in range(len(lines)) if match_sentence(sentence, figures, lines[: k + 1]).matches), 0
        )
        if not count:
            expected = sentence_of(sentence, figures)
            found = f"shows {lines[0]!r} where" if lines else "does not show"
            message = f"an error handler {found} {expected!r}{' is expected' if lines else ''}"
            step = shown[0] if shown else None
            file = f"{task.name}/{module}"
            yield (
                step_issue(DIALOGUE, message, task, step)
                if step is not None
                else Issue(DIALOGUE, message, arm=task.arm.name, file=file)
            )
            return
        for step in shown[:count]:
            fault = _handler_line_fault(step, sentence)
            if fault:
                yield step_issue(
                    DIALOGUE, f"{step.kind} {step.text!r} in an error handler {fault}", task, step
                )
                return
        del shown[:count]
    for step in shown[:1]:
        yield step_issue(DIALOGUE, f"an error handler shows the unexpected {step.text!r}", task, step)


def _handler_line_fault(step: MessageStep, sentence: Sentence) -> str:
    """Return the fault of a message in an error handler that shows a sentence, "" if there is none.

    It must be a line of the panel. The sentence FAILED shows the error's number as its only option, other
    sentences have no option. The sentence UNANSWERED depends on ERR_WAIT_MAXTIME, others on no condition.
    """
    if step.panel != "line":
        return "is not a line of the panel"
    expected_options = (("num", "ERRNO"),) if sentence is sentences.FAILED else ()
    got = tuple((name, value.upper()) for name, value in step.options)
    if got != expected_options:
        return "does not show the error's number" if expected_options else f"shows more: \\{got[0][0]}"
    waits = "ERRNO=ERR_WAIT_MAXTIME" if sentence is sentences.UNANSWERED else ""
    if "".join(step.condition.upper().split()).strip("()") != waits:
        return f"depends on {step.condition!r}" if step.condition else "is shown for other errors too"
    return ""


def _run_time_steps(steps: Sequence[ProgramStep]) -> Iterator[tuple[ProgramStep, bool]]:
    """Yield the steps in branches and loops that are decided at run time, in any depth.

    Each has a flag: whether the last step of its own branch ends the program (EXIT).
    """
    for step in steps:
        if isinstance(step, ChoiceStep):
            last = step.steps[-1] if step.steps else None
            ends = isinstance(last, SettingStep) and last.kind == "EXIT"
            yield from (
                (branch_step, ends) for branch_step in step.steps if not isinstance(branch_step, ChoiceStep)
            )
            yield from _run_time_steps(step.steps)


def _shows(step: MessageStep, sentence: Sentence, figures: dict[str, float | str | None]) -> bool:
    """Return whether a message is one line of the panel that shows a sentence with given values."""
    return (
        step.panel == "line" and not step.options and match_sentence(sentence, figures, [step.text]).matches
    )
