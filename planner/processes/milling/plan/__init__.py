"""Planning of the process ``milling``: a cutter on one arm cuts with its flank or its end.

It needs no robot model.
"""
