"""Dialogue with the operator at stops: messages, questions and the figures in them."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar, Literal

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.claims.sentences import Sentence
from planner.geometry.arrays import FloatArray

Figure = float | str | None
"""A figure of a sentence; None: the proof takes it from the motion."""


@dataclasses.dataclass(frozen=True)
class DialogueStep:
    """One step: a sentence ``told`` on the panel, one ``asked`` that the operator confirms, ``signal``
    switched ``on`` or ``off``, a ``wait`` of ``seconds``, or one until the ``input`` ``signal`` is 1, for
    ``seconds`` at most. ``figures`` of the sentence by name."""

    kind: Literal["told", "asked", "on", "off", "wait", "input"]
    sentence: Sentence | None = None
    figures: Mapping[str, Figure] = dataclasses.field(default_factory=dict)
    signal: str = ""
    seconds: float = 0.0


def message_step(sentence: Sentence, **figures: Figure) -> DialogueStep:
    """The operator can read a sentence."""
    return DialogueStep("told", sentence, figures)


def question_step(sentence: Sentence, **figures: Figure) -> DialogueStep:
    """The operator reads a sentence and confirms it."""
    return DialogueStep("asked", sentence, figures)


def power_on_steps(signal: str, seconds: float) -> tuple[DialogueStep, DialogueStep]:
    """A signal goes on, and ``seconds`` [s] pass."""
    return DialogueStep("on", signal=signal), DialogueStep("wait", seconds=seconds)


def power_off_steps(signal: str, seconds: float) -> tuple[DialogueStep, DialogueStep]:
    """A signal goes off, and ``seconds`` [s] pass."""
    return DialogueStep("off", signal=signal), DialogueStep("wait", seconds=seconds)


@dataclasses.dataclass(frozen=True)
class DialogueStop:
    """Steps at a stop within the work: ``before`` the first move of ``segment``, ``behind`` its last one, or
    ``in`` it and its way in. ``at`` (3,) [m, stock frame]: where the tool is then, within ``near`` [m].
    ``repeats``: any number of times, each time whole; ``optional``: not at all, or whole."""

    segment: Segment
    where: Literal["before", "behind", "in"]
    steps: tuple[DialogueStep, ...]
    at: FloatArray | None = None
    near: float = 0.0
    repeats: bool = False
    optional: bool = False


@dataclasses.dataclass(frozen=True)
class OperatorDialogue(Claim):
    """All that the programs say, ask, switch and wait for in an operation of ``arms``, in this order and
    nothing else: ``first`` when all arms stand at their first targets, ``stops`` on the way, ``last`` when
    they stand at their last ones. The first of the arms, in the cell's order, speaks, and meanwhile all arms
    stand still. ``joined``: the arms are joined then, which the operator is asked about before the start."""

    on_curves: ClassVar[bool] = True

    arms: tuple[str, ...]
    first: tuple[DialogueStep, ...] = ()
    last: tuple[DialogueStep, ...] = ()
    stops: tuple[DialogueStop, ...] = ()
    joined: bool = False
