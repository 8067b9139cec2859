"""Sentences that forming programs show operators."""

from typing import Final

from planner.claims.sentences import Sentence

SHEET: Final = Sentence("Sheet {x_mm:g} x {y_mm:g} x {z_mm:g} mm, {metal}")
RIM: Final = Sentence("Blank holder {high_mm:.2f} mm above its end, flat sheet on the die?")
LEVEL: Final = Sentence("Level {number:.0f} of {name} alone: the sheet as the levels before it left it?")
FIRST_PASS: Final = "the first pass"
"""Name of a level's pass if none is stated."""
SHEET_READY: Final = Sentence("Sheet clamped and greased, nobody in the cell?")
STAGE_READY: Final = Sentence("Sheet as it was left, greased, no loose piece, nobody in the cell?")
FORMED: Final = Sentence("Tools off the sheet, take the part out?")
STAYS: Final = Sentence("Tools off the sheet, which stays clamped?")
