"""The rule on what programs show and ask their operators: verify.dialogue.

The text must equal, word for word, what follows from the problem, at the right place and with nothing
added.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

from planner.claims import sentences
from planner.claims.claim import OneOf
from planner.claims.dialogue import DialogueStep, OperatorDialogue
from planner.claims.sentences import Sentence
from planner.issues import Issue
from planner.programs.dialogue_text import Fit, fit
from planner.programs.dialogue_text import sentence_text as sentence_of
from planner.programs.stages import TaskText
from planner.programs.steps import ChoiceStep, MessageStep, SettingStep, Step, WaitStep
from planner.proof import dialogue
from planner.proof.context import Context
from planner.proof.dialogue import Part, Place, Said, Spoken, spoken_steps, wanted_dialogue
from planner.proof.language_contribution import job_issues
from planner.proof.rule import Outcome, at_step, rule

DIALOGUE = "verify.dialogue"
"""Code of the rule about what is told and asked."""
DIFFERENCES = (
    "says something else",
    "comes in place of it",
    "waits for another time",
    "switches something else",
    "waits for another input, or for another time at most",
)
"""How a step may differ from what is wanted."""
WAIT_ROUNDING = 0.0005
"""Times are written with three decimals [s]."""
BOX_OPTIONS = frozenset({"buttons", "icon", "wrap"})
"""Options of a box that change nothing of what is asked."""
MOST_LINES = 40
"""Lines of a sentence at most."""


@dataclasses.dataclass(frozen=True)
class Heard:
    """A step of a dialogue as it was found, with the figures that the proof takes from the motion."""

    step: DialogueStep
    place: Place
    spoken: Spoken
    fit: Fit


@rule("verify.dialogue", OneOf, OperatorDialogue)
def messages_and_questions(context: Context) -> Outcome:
    """The operator is told and asked what follows from the problem, word for word and figure for figure, by
    the task and at the place where it belongs, confirmed by one button, with the signals and waits between
    and every arm at rest; nothing else is shown, also in handlers."""
    found, said = wanted_dialogue(context), spoken_steps(context.job)
    issues: list[Issue] = [*context.untold, *job_issues(DIALOGUE, context)]
    for task in context.job.tasks:
        _, faults = compare_steps(task, found[task.name], said[task.name], found)
        issues += faults
        issues += _aside(context, task)
    count = sum(len(steps) for steps in said.values())
    return Outcome(tuple(issues), where=f"{count} steps")


# ---- the straight ways ----


def compare_steps(
    task: TaskText, parts: Sequence[Part], said: Sequence[Spoken], every: dict[str, list[Part]]
) -> tuple[list[Heard], list[Issue]]:
    """Steps as they were found, and the first thing that is not as it should be."""
    rest = list(said)
    while rest and rest[0].kind == "off" and rest[0].before is None:
        rest.pop(0)  # power off at the very start: how many signals that are is not told to anybody
    heard: list[Heard] = []
    for part in parts:
        steps = [step for step in part.steps if not (step.kind == "wait" and step.seconds < WAIT_ROUNDING)]
        again = True
        while again:
            if (part.optional or part.repeats) and not (rest and part.place.holds(rest[0])):
                break
            for step in steps:
                one = _taken(step, part.place, rest)
                if isinstance(one, str):
                    return heard, [_fault(task, one, step, part, rest, every)]
                heard.append(one)
            again = part.repeats
    if rest:
        what = f"{_shown(rest[0])} {_where(rest[0])}, which is no part of the dialogue"
        owner = next((name for name in every if name != task.name and _fits_any(rest[0], every[name])), "")
        what += f"; it is for task {owner} to do" if owner else ""
        return heard, [at_step(DIALOGUE, what, task, rest[0].step, "take it out; programs are planned anew")]
    return heard, []


def _taken(step: DialogueStep, place: Place, rest: list[Spoken]) -> Heard | str:
    """A wanted step taken from the front of ``rest``, with all lines or boxes that it takes; else why not."""
    if not rest:
        return "is missing"
    one = rest[0]
    if one.kind != step.kind:
        return _unfit(one)
    taken = 1
    result = Fit(True)
    if step.sentence is not None:
        lines = _run(rest, step.kind)
        results = [fit(step.sentence, step.figures, _texts(lines[: k + 1])) for k in range(len(lines))]
        best = next((k for k, own in enumerate(results) if own.whole or own.wrong), None)
        if best is None:
            return DIFFERENCES[0]
        result, taken = results[best], best + 1
        if result.wrong:
            return f"has other figures: {result.wrong}"
    elif step.kind == "wait":
        if not isinstance(one.step, WaitStep) or abs(one.step.pause - step.seconds) > WAIT_ROUNDING + 1e-9:
            return DIFFERENCES[2]
    elif step.kind == "input":
        if not _waits_as(one.step, step):
            return DIFFERENCES[4]
    elif getattr(one.step, "signal", "").lower() != step.signal.lower() or getattr(one.step, "delay", 0.0):
        return DIFFERENCES[3]
    for other in rest[:taken]:
        strange = _strange(other)
        if strange:
            return strange
        if not place.holds(other):
            return "stands at another place"
        if other.meanwhile is not None:
            return f"comes while an arm may move (line {other.meanwhile.line} of {other.meanwhile.module})"
    del rest[:taken]
    return Heard(step, place, one, result)


def _waits_as(own: Step, step: DialogueStep) -> bool:
    """Whether a wait is for the wanted input, with the wanted limit of time."""
    return (
        isinstance(own, WaitStep)
        and own.signal.lower() == step.signal.lower()
        and own.seconds is not None
        and abs(own.seconds - step.seconds) <= WAIT_ROUNDING + 1e-9
    )


def _run(rest: Sequence[Spoken], kind: str) -> list[MessageStep]:
    run = itertools.takewhile(lambda one: one.kind == kind, rest[:MOST_LINES])
    return [one.step for one in run if isinstance(one.step, MessageStep)]


def _texts(steps: Sequence[MessageStep]) -> list[str]:
    return [step.text for step in steps]


def _unfit(one: Spoken) -> str:
    step = one.step
    if isinstance(step, MessageStep) and step.confirm and not step.certain:
        return "is in a box that goes on without anybody pressing OK"
    return DIFFERENCES[1]


def _strange(one: Spoken) -> str:
    """What else a message shows or does than its text."""
    step = one.step
    if not isinstance(step, MessageStep):
        return ""
    more = [name for name, _ in step.options if name not in (BOX_OPTIONS if step.confirm else ())]
    if more:
        return f"has \\{more[0]}, which shows or does more than is wanted"
    if step.kind == "UIMsgBox" and step.header not in ("", sentences.HEADER):
        return f"has the header {step.header!r}; allowed: {sentences.HEADER!r}"
    return ""


def _fault(
    task: TaskText,
    why: str,
    step: DialogueStep,
    part: Part,
    rest: Sequence[Spoken],
    every: dict[str, list[Part]],
) -> Issue:
    """The first difference, told truly: left out, added, changed, or moved."""
    need = f"{_named(step)} {part.place}"
    hint = "programs are written whole: plan again"
    if not rest:
        return Issue(
            DIALOGUE, f"{task.name}: {need} is missing", arm=task.arm.name, file=task.name, hint=hint
        )
    got = rest[0]
    if why in DIFFERENCES:
        if any(_fits(other, step) for other in rest[1:8]):
            why = f"is not wanted before {need}"
        elif _fits_any(got, [Part(part.place, part.steps)]) or _fits_later(got, step, every[task.name]):
            why = f"comes where {need} is missing"
        else:
            why = f"is not what is wanted: {need}"
    else:
        why = f"{why}; wanted: {need}"
    return at_step(DIALOGUE, f"{_shown(got)} {_where(got)} {why}", task, got.step, hint)


def _fits(one: Spoken, step: DialogueStep) -> bool:
    """Whether something said is, by itself, a wanted step, wherever it stands."""
    if one.kind != step.kind:
        return False
    if step.sentence is not None:
        own = one.step
        return isinstance(own, MessageStep) and fit(step.sentence, step.figures, [own.text]).whole
    if step.kind == "wait":
        return isinstance(one.step, WaitStep) and abs(one.step.pause - step.seconds) <= WAIT_ROUNDING
    if step.kind == "input":
        return _waits_as(one.step, step)
    return getattr(one.step, "signal", "").lower() == step.signal.lower()


def _fits_any(one: Spoken, parts: Sequence[Part]) -> bool:
    return one.kind in ("told", "asked") and any(_fits(one, step) for part in parts for step in part.steps)


def _fits_later(one: Spoken, step: DialogueStep, parts: Sequence[Part]) -> bool:
    """Whether something said is wanted behind a step that is missing."""
    steps = [own for part in parts for own in part.steps]
    place = next(k for k, own in enumerate(steps) if own is step)
    return any(_fits(one, own) for own in steps[place + 1 :])


def _named(step: DialogueStep) -> str:
    if step.sentence is not None:
        verb = "telling" if step.kind == "told" else "asking"
        return f"{verb} {sentence_of(step.sentence, step.figures)!r}"
    if step.kind == "wait":
        return f"a wait of {step.seconds:g} s"
    if step.kind == "input":
        return f"a wait for {step.signal}, for {step.seconds:g} s at most,"
    return f"switching {step.signal} {step.kind}"


def _shown(one: Spoken) -> str:
    step = one.step
    if isinstance(step, MessageStep):
        text = step.text or "nothing"
        return f"{step.kind} {text!r}"
    if isinstance(step, WaitStep):
        if step.signal:
            return f"{step.kind} {step.signal}"
        return f"a wait of {step.seconds:g} s" if step.seconds is not None else "a wait of no known time"
    return f"{getattr(step, 'signal', '')} set to {getattr(step, 'value', 0.0):g}"


def _where(one: Spoken) -> str:
    if one.before is None:
        return "before anything moves"
    if one.after is None:
        return "behind the last move"
    a = "a move by joints" if one.at_joints else one.behind
    b = "a move by joints" if one.to_joints else one.ahead
    return f"between {a} and {b}"


# ---- beside the straight ways ----


def _aside(context: Context, task: TaskText) -> Iterator[Issue]:
    """What is shown in error handlers, in UNDO, and where a program decides at run time."""
    for (module, procedure), block in task.handlers.items():
        yield from _in_handler(task, module, block, dialogue.handler(context, task, procedure))
    for block in task.undos.values():
        for step in block:
            if isinstance(step, MessageStep):
                yield at_step(
                    DIALOGUE, f"UNDO shows {step.text!r}; nobody is told anything there", task, step
                )
    allowed = dialogue.aside(context, task)
    for step, ends in _inside(task.steps):
        if isinstance(step, MessageStep) and not (ends and any(_says(step, *one) for one in allowed)):
            what = f"{step.kind} {step.text!r} is shown or not, as the program decides at run time"
            yield at_step(DIALOGUE, what, task, step, "show it in any case, or take it out")
        elif isinstance(step, WaitStep) and (step.signal or step.pause or step.seconds is None):
            what = "whether the program waits here is decided at run time"
            yield at_step(DIALOGUE, what, task, step, "take it out")


def _in_handler(
    task: TaskText, module: str, block: Sequence[Step], allowed: Sequence[Said]
) -> Iterator[Issue]:
    """Faults of what a handler shows: all of its sentences, once and in order."""
    shown = [step for step in block if isinstance(step, MessageStep)]
    for sentence, figures in allowed:
        lines = [step.text for step in shown]
        count = next((k + 1 for k in range(len(lines)) if fit(sentence, figures, lines[: k + 1]).whole), 0)
        if not count:
            need = sentence_of(sentence, figures)
            got = f"shows {lines[0]!r} where" if lines else "does not tell"
            what = f"an error handler {got} {need!r}{' is wanted' if lines else ''}"
            step = shown[0] if shown else None
            file = f"{task.name}/{module}"
            yield (
                at_step(DIALOGUE, what, task, step)
                if step is not None
                else Issue(DIALOGUE, what, arm=task.arm.name, file=file)
            )
            return
        for step in shown[:count]:
            wrong = _handler_line(step, sentence)
            if wrong:
                yield at_step(DIALOGUE, f"{step.kind} {step.text!r} in an error handler {wrong}", task, step)
                return
        del shown[:count]
    for step in shown[:1]:
        yield at_step(DIALOGUE, f"an error handler shows {step.text!r} besides what is wanted", task, step)


def _handler_line(step: MessageStep, sentence: Sentence) -> str:
    if step.panel != "line":
        return "is no line of the panel"
    wanted = (("num", "ERRNO"),) if sentence is sentences.FAILED else ()
    got = tuple((name, value.upper()) for name, value in step.options)
    if got != wanted:
        return "does not show the error's number" if wanted else f"shows more: \\{got[0][0]}"
    waits = "ERRNO=ERR_WAIT_MAXTIME" if sentence is sentences.UNANSWERED else ""
    if "".join(step.condition.upper().split()).strip("()") != waits:
        return f"hangs on {step.condition!r}" if step.condition else "is told of other errors too"
    return ""


def _inside(steps: Sequence[Step]) -> Iterator[tuple[Step, bool]]:
    """Steps of branches and loops that are decided at run time, and whether their branch ends the program."""
    for step in steps:
        if isinstance(step, ChoiceStep):
            last = step.steps[-1] if step.steps else None
            ends = isinstance(last, SettingStep) and last.kind == "EXIT"
            yield from ((own, ends) for own in step.steps if not isinstance(own, ChoiceStep))
            yield from _inside(step.steps)


def _says(step: MessageStep, sentence: Sentence, figures: dict[str, float | str | None]) -> bool:
    return step.panel == "line" and not step.options and fit(sentence, figures, [step.text]).whole
