"""The cell in Drake: robots, tools and bodies, and the distances between bodies.

Planning and proof both use it. It is not a step between them.
"""
