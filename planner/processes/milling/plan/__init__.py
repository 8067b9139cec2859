"""The process ``milling``: a cutter on one arm cuts along its flank or with its end; it knows no robot."""
