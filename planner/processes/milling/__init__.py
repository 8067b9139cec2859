"""Milling: flank, point and engraving cuts, and paths of G-code."""
