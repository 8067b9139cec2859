"""Sentences that milling programs show to operators."""

from typing import Final

from planner.claims.sentences import Sentence

BLOCK: Final = Sentence(
    "Block {x_mm:g} x {y_mm:g} x {z_mm:g} mm; {kind} mill of {diameter_mm:g} mm, {rpm:g} 1/min"
)
BLOCK_OF_FILE: Final = Sentence("Block {x_mm:g} x {y_mm:g} x {z_mm:g} mm; {kind} mill of {diameter_mm:g} mm")
"""Message about block and cutter if all cuts are G-code files, whose questions state the spindle speeds."""
BLOCK_READY: Final = Sentence("Block and cutter clamped, nobody in the cell?")
CONTINUE: Final = Sentence("Go on: {asked}?")
"""Question between passes of a file. ``asked`` is a list of the next three sentences, with commas between."""
FILE_LINE: Final = Sentence("line {line} of the file")
SPEED: Final = Sentence("spindle at {rpm:.0f} 1/min")
SPEED_COUNTERCLOCKWISE: Final = Sentence("spindle at {rpm:.0f} 1/min counterclockwise (M4)")
SPINDLE_STOPPED: Final = Sentence("Spindle stands, take the part out?")
