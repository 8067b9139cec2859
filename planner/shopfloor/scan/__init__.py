"""Scans of formed parts: where they lie, how far they are off the wanted face, and what tools do about it."""
