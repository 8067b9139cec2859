"""Planning of the process ``milling``: a cutter on one arm cuts with its flank or its end.

No robot model is needed here.
"""
