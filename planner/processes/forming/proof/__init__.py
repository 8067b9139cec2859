"""Forming tools in the sheet, as the proof sees them."""
