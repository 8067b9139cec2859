"""What the programs have chosen where the problem leaves it open: what they tell the operator to mount, which
has to be one of the things at hand. Everything is then proven of that one."""

from __future__ import annotations

import itertools

from planner.claims import Claim, OneOf
from planner.claims_dialogue import DialogueStep, OperatorDialogue
from planner.issues import Issue
from planner.verify.context import Context
from planner.verify.dialogue_read import Spoken, spoken
from planner.verify.dialogue_text import fit
from planner.verify.dialogue_text import spoken as sentence_of
from planner.verify.dialogue_wanted import Place
from planner.verify.steps import MessageStep

CODE = "verify.dialogue"


def told_choice(context: Context) -> Context:
    """The same proof with the one group of each `OneOf` that the text names at the operation's first targets.

    Where it names none, or more than one, the first group stands in, and ``untold`` has a fault of
    ``verify.dialogue``, so that nothing is proven."""
    if not any(isinstance(claim, OneOf) for claim in context.claims):
        return context
    said = spoken(context.job) if context.playable else {}
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
    out = Context(context.problem, claims, context.programs, context.unread, tuple(untold))
    out.__dict__["job"] = context.job  # it follows from the text alone
    return out


def _settled(
    context: Context,
    name: str,
    claim: OneOf,
    number: int,
    said: dict[str, list[Spoken]],
    untold: list[Issue],
) -> tuple[Claim, ...]:
    fitting = [group for group in claim.either if _is_told(context, group, number, said)]
    if len(fitting) == 1:
        return fitting[0]
    names = "; ".join(dict.fromkeys(_shown(group) for group in claim.either))
    what = "none" if not fitting else "more than one"
    message = f"{name}: of what may be mounted the operator is told {what} at the first targets; at hand are "
    untold.append(Issue(CODE, message + names, field=name, hint="plan again"))
    return claim.either[0]


def _dialogue(group: tuple[Claim, ...]) -> OperatorDialogue | None:
    return next((claim for claim in group if isinstance(claim, OperatorDialogue)), None)


def _heads(group: tuple[Claim, ...]) -> list[DialogueStep]:
    """What is told first, as far as its figures follow from the problem: it says which group it is."""
    dialogue = _dialogue(group)
    steps = () if dialogue is None else dialogue.first
    return list(itertools.takewhile(lambda s: s.kind == "told" and None not in s.figures.values(), steps))


def _shown(group: tuple[Claim, ...]) -> str:
    return ", ".join(sentence_of(s.sentence, s.figures) for s in _heads(group) if s.sentence is not None)


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
