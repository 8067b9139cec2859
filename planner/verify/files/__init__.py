"""The proof's own readers of part files, and the surfaces that follow from them and the problem's numbers.

Nothing here is shared with the readers and the geometry of the planner.
"""
