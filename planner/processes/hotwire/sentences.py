"""Sentences of hot-wire cuts that programs show to operators."""

from typing import Final

from planner.claims.sentences import Sentence

WIRE: Final = Sentence("Wire: {material} {size}")
"""The wire to mount. ``size`` is formatted by `WireSectionFile.size`."""
MOUNT: Final = Sentence("Mount wire: {cold_mm:.1f} mm cold between clamps")
CLAMPS: Final = Sentence("Clamps {apart_mm:.1f} mm apart, wire at {start_deg:.1f} and {end_deg:.1f} deg")
CLAMPED: Final = Sentence("Wire clamped, slide free, block fixed, nobody in the cell?")
LOCKED: Final = Sentence("Slide taken up to {hot_mm:.1f} mm hot and locked?")
TAKEN_OFF: Final = Sentence("Wire cold and taken off?")
BOW_POWER: Final = Sentence("Wire {diameter_mm:g} mm{material}, {power_w:g} W")
"""``material`` is empty, or starts with a space."""
BOW_SLOT: Final = Sentence("Wire {diameter_mm:g} mm{material}, heat for a slot of {kerf_mm:g} mm")
TAUT: Final = Sentence("Wire taut, block fixed, nobody in the cell?")
SPACERS: Final = Sentence("Put spacers of {kerf_mm:.1f} mm into the slot")
SPACED: Final = Sentence("Spacers in the slot, nobody in the cell?")
COLD: Final = Sentence("Wire cold, hands may come near?")
