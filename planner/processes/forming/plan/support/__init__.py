"""Positions of the second tool while the first one forms."""
