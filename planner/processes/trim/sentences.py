"""Sentences that trimming programs show to operators."""

from typing import Final

from planner.claims.sentences import Sentence

TORCH: Final = Sentence(
    "Sheet of {t_mm:g} mm, {metal}; {cuts_by} torch, kerf {kerf_mm:g} mm, {off_mm:g} mm above the sheet"
)
TORCH_STOPPED: Final = Sentence("A stop while the torch burns ends this program: it is not lit again there")
TORCH_READY: Final = Sentence(
    "Sheet clamped, none of these slots in it yet, return lead on, fumes drawn off, nothing flammable "
    "near or below the sheet, eyes shielded, nobody in the cell?"
)
TORCH_COLD: Final = Sentence(
    "Torch off and edges cold? Cut pieces below the sheet are hot. Remove dross before it is formed further."
)
TRIM_MILL: Final = Sentence(
    "Sheet of {t_mm:g} mm, {metal}; {kind} mill of {diameter_mm:g} mm, {rpm:g} 1/min, "
    "{below_mm:g} mm through the sheet"
)
TRIM_MILL_READY: Final = Sentence(
    "Sheet and cutter clamped, none of these slots in it yet, nothing below the sheet where they are, "
    "nobody in the cell?"
)
TRIM_MILL_STOPPED: Final = Sentence(
    "Spindle stopped? Remove loose pieces, and burrs before it is formed further."
)
TRIM_KNIFE: Final = Sentence(
    "Sheet of {t_mm:g} mm, {metal}; knife with a blade of {wide_mm:g} x {thick_mm:g} mm, {below_mm:g} mm "
    "through the sheet"
)
TRIM_KNIFE_READY: Final = Sentence(
    "Sheet and blade clamped, blade edge ahead, none of these cuts in the sheet yet, nothing below the sheet "
    "where they are, nobody in the cell?"
)
TRIM_KNIFE_DONE: Final = Sentence("Knife at rest? Remove loose pieces; blade and edges are sharp.")
