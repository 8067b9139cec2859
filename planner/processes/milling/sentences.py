"""Sentences that milling programs show operators."""

from typing import Final

from planner.claims.sentences import Sentence

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
