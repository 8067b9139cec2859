"""Sheets that a torch trims, by the proof's own reading of part and curves."""
