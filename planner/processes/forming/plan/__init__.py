"""Incremental forming of sheets: from the surface of a part to the paths of one or two tools."""
