"""Sentences that trimming programs show operators."""

from typing import Final

from planner.claims.sentences import Sentence

TORCH: Final = Sentence(
    "Sheet of {t_mm:g} mm, {metal}; {cuts_by} torch, kerf {kerf_mm:g} mm, {off_mm:g} mm off the sheet"
)
TORCH_STOPPED: Final = Sentence(
    "A stop while the torch burns ends this program: nothing lights it again there"
)
TORCH_READY: Final = Sentence(
    "Sheet clamped, none of these slots in it yet, return lead on, fumes drawn off, nothing that burns "
    "beside or below the sheet, eyes shielded, nobody in the cell?"
)
TORCH_COLD: Final = Sentence(
    "Torch off and edges cold? What is cut out lies hot below the sheet. "
    "Take dross off before it is formed on."
)
TRIM_MILL: Final = Sentence(
    "Sheet of {t_mm:g} mm, {metal}; {kind} mill of {diameter_mm:g} mm, {rpm:g} 1/min, "
    "{below_mm:g} mm through the sheet"
)
TRIM_MILL_READY: Final = Sentence(
    "Sheet and cutter clamped, none of these slots in it yet, nothing below the sheet where they are, "
    "nobody in the cell?"
)
TRIM_MILL_STANDS: Final = Sentence(
    "Spindle stands? Take loose pieces out, and burrs off before it is formed on."
)
TRIM_KNIFE: Final = Sentence(
    "Sheet of {t_mm:g} mm, {metal}; knife with a blade of {wide_mm:g} x {thick_mm:g} mm, {below_mm:g} mm "
    "through the sheet"
)
TRIM_KNIFE_READY: Final = Sentence(
    "Sheet and blade clamped, its edge ahead, none of these cuts in it yet, nothing below the sheet where "
    "they are, nobody in the cell?"
)
TRIM_KNIFE_DONE: Final = Sentence("Knife still? Take loose pieces out; blade and edges are sharp.")
