"""Sentences that programs of any process and language show to operators.

Writers use these sentences word for word, and the proof refuses any other. A sentence is plain ASCII and has
fields for values. `OperatorDialogue` claims which sentences an operation shows, with which values. For
starts, setups and error handlers they follow from the problem (``proof/dialogue.py``). Sentences of only one
process or language are in its ``sentences.py``.

Lines of a message box have at most 55 characters, lines of the panel at most 40.
"""

import dataclasses
from typing import Final

ASCII_REPLACEMENTS: Final = str.maketrans(
    {"ß": "ss", "æ": "ae", "Æ": "Ae", "œ": "oe", "Œ": "Oe", "ø": "o", "Ø": "O", "ł": "l", "Ł": "L", "đ": "d"}
    | {"–": "-", "—": "-", "’": "'", "‘": "'", "“": '"', "”": '"', "„": '"', "°": " deg", "×": "x"}
)
"""Replacements of characters that do not decompose into ASCII and accents."""


@dataclasses.dataclass(frozen=True)
class Sentence:
    """A sentence with named fields for ``str.format``.

    The format of a field defines how its value is rounded.
    """

    words: str

    def format(self, **figures: float | str) -> str:
        """Return the text of the sentence with values for its fields."""
        return self.words.format(**figures)


HEADER: Final = "Tandem"
"""Header of each box with a question."""
PLAIN: Final = Sentence("{text}")
"""Any sentence that the user states for a setup."""

# ---- before anything moves ----

NO_WIRE: Final = Sentence(
    "Is there NO wire between the arms? Each arm now goes home alone, then to its first position, alone or "
    "at once with the other one. Take off what joins them, see that their ways are clear, then press OK."
)
"""Asked before the start if a wire will join the arms."""
READY: Final = Sentence("Is the stock in place and the way of each arm clear? Press OK to start.")
CLEAR: Final = Sentence(
    "Is the way of each arm to its home clear, and nobody in the cell? Press OK to start."
)
"""Asked before the start if the operator confirms the first setup afterwards."""
KRL_READY: Final = Sentence("Is the stock in place and the way of the arm clear?")
KRL_CLEAR: Final = Sentence("Is the way of the arm to its home clear, and nobody in the cell?")

# ---- tracks and turntables ----

KEEP_OFF: Final = Sentence(
    "Keep off the track {unit}: it takes arm {arm}, folded at its home, to {value} mm once this is confirmed."
)
"""Shown before a track moves to a station."""
KEEP_OFF_COORDINATED: Final = Sentence(
    "Keep off the track {unit}: it takes arm {arm}, folded at its home, to {value} mm once this is "
    "confirmed, and goes along while the arm works."
)
"""Shown before a coordinated track moves to where its motion with the work starts."""
KEEP_OFF_GANTRY: Final = Sentence(
    "Keep off the gantry {unit}: once this is confirmed it takes arm {arm}, folded at its home, one "
    "axis after "
    "the other, to where they stand: {values}."
)
"""Shown before the axes of a gantry move to a station."""
KEEP_OFF_TABLE: Final = Sentence(
    "Keep off the turntable {unit} and what stands on it: it turns to {value} deg once this is confirmed."
)
"""Shown before a turntable moves to a station."""
KEEP_OFF_POSITIONER: Final = Sentence(
    "Keep off the positioner {unit} and what stands on it: once this is confirmed it turns to {turn} deg, "
    "then tilts to {tilt} deg."
)
"""Shown before a positioner moves to a station."""
WORK_DONE: Final = "All work done, nobody in the cell?"
"""Asked before tracks and turntables move home after the last operation."""

# ---- two controllers ----

EARLIER_RUN: Final = Sentence(
    "Does no program of an earlier run go on at the controller of arm {other}? Press OK."
)
PARTNER_READY: Final = Sentence(
    "Does the panel of arm {other} say that it is ready to meet arm {arm}? {start}"
)
"""Asked by the leading program, together with its question before the start."""
READY_TO_MEET: Final = Sentence("Ready to meet arm {other}.")
START_PARTNER: Final = Sentence(
    "Start the program of arm {other} now. When its panel says that it is ready, press Start here."
)
"""Shown by the leading program directly before it stops."""
UNANSWERED: Final = Sentence(
    "Arm {other} did not answer in time, or its running wire is not as it should be."
)


# ---- error handlers ----

FAILED: Final = Sentence("Tandem: error in {procedure}, number")
"""Precedes the error's number."""
JOINED: Final = Sentence("The arms may be joined: move neither alone.")
ALONE: Final = Sentence("Check the arm before it moves.")
