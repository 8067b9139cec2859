"""Loops that run while a part is formed: force, compliance, and springback from level to level."""
