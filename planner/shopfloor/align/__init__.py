"""Alignment of the second robot of a cell, from points that both robots probed."""
