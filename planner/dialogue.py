"""What programs say to the operator, word for word, in one place: processes and posts write these sentences,
and the proof refuses any other.

A sentence is plain ASCII and has fields for its figures. Which ones stand where in a program, with which
figures, is claimed of each operation (``claims_dialogue``), and follows from the problem for starts, setups
and error handlers (``verify/dialogue_wanted.py``). A program that has more to say gets its sentence here, and
its place there.
"""

from __future__ import annotations

import dataclasses
from typing import Final

SPELT: Final = str.maketrans(
    {"ß": "ss", "æ": "ae", "Æ": "Ae", "œ": "oe", "Œ": "Oe", "ø": "o", "Ø": "O", "ł": "l", "Ł": "L", "đ": "d"}
    | {"–": "-", "—": "-", "’": "'", "‘": "'", "“": '"', "”": '"', "„": '"', "°": " deg", "×": "x"}
)
"""Letters and signs that do not come apart into ASCII and accents, as panels get them."""


@dataclasses.dataclass(frozen=True)
class Sentence:
    """Words with named fields as ``str.format`` takes them; the format of a field is how its figure is
    rounded."""

    words: str

    def say(self, **figures: float | str) -> str:
        """The sentence with its figures."""
        return self.words.format(**figures)


HEADER: Final = "Tandem"
"""Above each box that asks something."""
PLAIN: Final = Sentence("{text}")
"""A sentence of the user's own, in setups."""

# ---- before anything moves ----

NO_WIRE: Final = Sentence(
    "Is there NO wire between the arms? Each arm now goes alone to home and to its first position. "
    "Take off what joins them, see that their ways are clear, then press OK."
)
"""Where a wire will join the arms."""
READY: Final = Sentence("Is the stock in place and the way of each arm clear? Press OK to start.")
CLEAR: Final = Sentence(
    "Is the way of each arm to its home clear, and nobody in the cell? Press OK to start."
)
"""Where the first setup is told and confirmed afterwards."""
KRL_READY: Final = Sentence("Is the stock in place and the way of the arm clear?")
KRL_CLEAR: Final = Sentence("Is the way of the arm to its home clear, and nobody in the cell?")

# ---- two controllers ----

EARLIER: Final = Sentence(
    "Does no program of an earlier run go on at the controller of arm {other}? Press OK."
)
KRL_EARLIER: Final = Sentence("Does no program of an earlier run go on at the controller of arm {other}?")
PARTNER_READY: Final = Sentence(
    "Does the panel of arm {other} say that it is ready to meet arm {arm}? {start}"
)
"""Asked by the program that leads, together with its question before the start."""
READY_TO_MEET: Final = Sentence("Ready to meet arm {other}.")
START_PARTNER: Final = Sentence(
    "Start the program of arm {other} now. When its panel says that it is ready, press Start here."
)
"""Told by the program that leads, right before it stops."""
UNANSWERED: Final = Sentence(
    "Arm {other} did not answer in time, or its running wire is not as it should be."
)

WAITING: Final = Sentence("Waiting for arm {arm}.")
TOGETHER: Final = Sentence("Moves with arm {arm} and waits for it where they meet.")
"""On the panel of a KUKA controller while its program waits for the other arm, and moves together with it."""

# ---- where a robot stands ----

FOOT: Final = Sentence("Arm {arm}: $ROBROOT is off zero by %1 mm, %2 deg")
"""Of a KUKA robot; its controller puts the figures in."""

# ---- error handlers ----

FAILED: Final = Sentence("Tandem: error in {procedure}, number")
"""In front of the error's number."""
JOINED: Final = Sentence("The arms may be joined: move neither alone.")
ALONE: Final = Sentence("Check the arm before it moves.")

# ---- a bent wire ----

WIRE: Final = Sentence("Wire: {material} {size}")
"""Which wire to mount; ``size`` as `SectionFile.size` has it."""
MOUNT: Final = Sentence("Mount wire: {cold_mm:.1f} mm cold between clamps")
CLAMPS: Final = Sentence("Clamps {apart_mm:.1f} mm apart, wire at {start_deg:.1f} and {end_deg:.1f} deg")
CLAMPED: Final = Sentence("Wire clamped, slide free, block fixed, nobody in the cell?")
LOCKED: Final = Sentence("Slide taken up to {hot_mm:.1f} mm hot and locked?")
TAKEN_OFF: Final = Sentence("Wire cold and taken off?")

# ---- a bow ----

BOW_POWER: Final = Sentence("Wire {diameter_mm:g} mm{material}, {power_w:g} W")
"""``material``: empty, or with a space in front."""
BOW_SLOT: Final = Sentence("Wire {diameter_mm:g} mm{material}, heat for a slot of {kerf_mm:g} mm")
TAUT: Final = Sentence("Wire taut, block fixed, nobody in the cell?")
SPACERS: Final = Sentence("Put spacers of {kerf_mm:.1f} mm into the slot")
SPACED: Final = Sentence("Spacers in the slot, nobody in the cell?")
COLD: Final = Sentence("Wire cold, hands may come near?")

# ---- a cutter ----

BLOCK: Final = Sentence(
    "Block {x_mm:g} x {y_mm:g} x {z_mm:g} mm; {kind} mill of {diameter_mm:g} mm, {rpm:g} 1/min"
)
BLOCK_OF_FILE: Final = Sentence("Block {x_mm:g} x {y_mm:g} x {z_mm:g} mm; {kind} mill of {diameter_mm:g} mm")
"""Where all cuts are files: their questions name the speeds."""
BLOCK_READY: Final = Sentence("Block and cutter clamped, nobody in the cell?")
GO_ON: Final = Sentence("Go on: {asked}?")
"""Between passes of a file, ``asked`` being one or more of the next three with commas between."""
FILE_LINE: Final = Sentence("line {line} of the file")
SPEED: Final = Sentence("spindle at {rpm:.0f} 1/min")
SPEED_BACK: Final = Sentence("spindle at {rpm:.0f} 1/min counterclockwise (M4)")
STANDS: Final = Sentence("Spindle stands, take the part out?")

# ---- a sheet ----

SHEET: Final = Sentence("Sheet {x_mm:g} x {y_mm:g} x {z_mm:g} mm, {metal}")
RIM: Final = Sentence("Blank holder {high_mm:.2f} mm above its end, flat sheet on the die?")
SHEET_READY: Final = Sentence("Sheet clamped and greased, nobody in the cell?")
FORMED: Final = Sentence("Tools off the sheet, take the part out?")
