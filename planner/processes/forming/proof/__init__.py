"""Forming tools in the sheet, from the point of view of the proof."""
