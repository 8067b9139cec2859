"""Dialogue with the operator at stops: messages, questions and the figures in them."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar, Literal

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.claims.sentences import Sentence
from planner.geometry.arrays import FloatArray

Figure = float | str | None
"""A figure of a sentence. The proof takes it from the motion if it is None."""


@dataclasses.dataclass(frozen=True)
class DialogueStep:
    """One step of a dialogue.

    Attributes:
        kind: ``told``: a sentence on the panel; ``asked``: a sentence that the operator confirms; ``on``,
            ``off``: switch the signal; ``wait``: wait; ``input``: wait until the signal is 1.
        sentence: The sentence.
        figures: Figures of the sentence by name.
        signal: Name of the signal.
        seconds: Waiting time [s], for ``input`` its maximum.
    """

    kind: Literal["told", "asked", "on", "off", "wait", "input"]
    sentence: Sentence | None = None
    figures: Mapping[str, Figure] = dataclasses.field(default_factory=dict)
    signal: str = ""
    seconds: float = 0.0


def message_step(sentence: Sentence, **figures: Figure) -> DialogueStep:
    """Return a step that shows a sentence to the operator."""
    return DialogueStep("told", sentence, figures)


def question_step(sentence: Sentence, **figures: Figure) -> DialogueStep:
    """Return a step in which the operator confirms a sentence."""
    return DialogueStep("asked", sentence, figures)


def power_on_steps(signal: str, seconds: float) -> tuple[DialogueStep, DialogueStep]:
    """Return steps that switch a signal on and wait ``seconds`` [s]."""
    return DialogueStep("on", signal=signal), DialogueStep("wait", seconds=seconds)


def power_off_steps(signal: str, seconds: float) -> tuple[DialogueStep, DialogueStep]:
    """Return steps that switch a signal off and wait ``seconds`` [s]."""
    return DialogueStep("off", signal=signal), DialogueStep("wait", seconds=seconds)


@dataclasses.dataclass(frozen=True)
class DialogueStop:
    """Steps at a stop within the work.

    Attributes:
        segment: Segment of the stop.
        where: ``before`` its first move, ``behind`` its last one, or ``in`` it and its lead-in.
        steps: The steps.
        at: Position (3,) [m, stock frame] of the tool, None for any.
        tolerance: Tolerance [m] of the position.
        repeats: Whether the steps occur any number of times, each time completely.
        optional: Whether the steps may be absent as a whole.
    """

    segment: Segment
    where: Literal["before", "behind", "in"]
    steps: tuple[DialogueStep, ...]
    at: FloatArray | None = None
    tolerance: float = 0.0
    repeats: bool = False
    optional: bool = False


@dataclasses.dataclass(frozen=True)
class OperatorDialogue(Claim):
    """All that the programs show, ask, switch and wait for in an operation, in this order and nothing else.

    The first of the arms, in the cell's order, shows it, while all arms stand still.

    Attributes:
        arms: Names of the arms of the operation.
        first: Steps with all arms at their first targets.
        last: Steps with all arms at their last targets.
        stops: Stops between.
        joined: Whether the arms are joined then. The operator is asked about that before the start.
    """

    on_curves: ClassVar[bool] = True

    arms: tuple[str, ...]
    first: tuple[DialogueStep, ...] = ()
    last: tuple[DialogueStep, ...] = ()
    stops: tuple[DialogueStop, ...] = ()
    joined: bool = False
