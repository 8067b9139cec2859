"""Dialogue with the operator at stops: messages, questions and the values in them."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar, Literal

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.claims.sentences import Sentence
from planner.geometry.arrays import FloatArray

Figure = float | str | None
"""Value of a field in a sentence: a number, a text, or None for a value that follows from the motion."""


@dataclasses.dataclass(frozen=True)
class DialogueStep:
    """One step of a dialogue.

    Attributes:
        kind: ``told``: a sentence on the panel; ``asked``: a sentence that the operator confirms; ``on``,
            ``off``: switch the signal; ``wait``: wait for a time; ``input``: wait until the signal is 1.
        sentence: The sentence that is shown, None for other steps.
        figures: Values of the fields of the sentence, by name.
        signal: Name of the signal that is switched or awaited.
        seconds: Waiting time, for ``input`` its maximum [s].
    """

    kind: Literal["told", "asked", "on", "off", "wait", "input"]
    sentence: Sentence | None = None
    figures: Mapping[str, Figure] = dataclasses.field(default_factory=dict)
    signal: str = ""
    seconds: float = 0.0


def message_step(sentence: Sentence, **figures: Figure) -> DialogueStep:
    """Return a step that shows a sentence to the operator, with values for its fields."""
    return DialogueStep("told", sentence, figures)


def question_step(sentence: Sentence, **figures: Figure) -> DialogueStep:
    """Return a step in which the operator confirms a sentence, with values for its fields."""
    return DialogueStep("asked", sentence, figures)


def power_on_steps(signal: str, seconds: float) -> tuple[DialogueStep, DialogueStep]:
    """Return steps that switch a signal on and then wait for ``seconds`` [s]."""
    return DialogueStep("on", signal=signal), DialogueStep("wait", seconds=seconds)


def power_off_steps(signal: str, seconds: float) -> tuple[DialogueStep, DialogueStep]:
    """Return steps that switch a signal off and then wait for ``seconds`` [s]."""
    return DialogueStep("off", signal=signal), DialogueStep("wait", seconds=seconds)


@dataclasses.dataclass(frozen=True)
class DialogueStop:
    """Steps at a stop within the work.

    Attributes:
        segment: Segment of the stop.
        where: Position of the stop: ``before`` the first move of the segment, ``behind`` (after) its last
            one, or ``in`` it or its lead-in.
        steps: Steps of the dialogue there.
        at: Position of the TCP in the stock frame, (3,) [m]; None for any position.
        tolerance: Tolerance of the position [m].
        repeats: Whether the steps may occur any number of times, each time completely.
        optional: Whether all the steps may be absent.
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
    """Everything that programs show, ask, switch and wait for in an operation, in this order.

    Nothing else may happen. The program of the first of the arms, in the cell's order, does this while all
    arms stand still.

    Attributes:
        arms: Names of the arms of the operation.
        first: Steps with all arms at their first targets.
        last: Steps with all arms at their last targets.
        stops: Stops between the first and the last targets.
        joined: Whether a wire or block joins the arms in the operation. The programs then ask before the
            start whether nothing joins them yet.
    """

    on_curves: ClassVar[bool] = True

    arms: tuple[str, ...]
    first: tuple[DialogueStep, ...] = ()
    last: tuple[DialogueStep, ...] = ()
    stops: tuple[DialogueStop, ...] = ()
    joined: bool = False
