"""Cutters in the block, as the proof sees them."""
