"""Scans of formed parts: their pose, their deviation from the nominal face, and the adjustment of tools."""
