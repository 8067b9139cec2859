"""G-code in: from the lines of a file to passes of the cutter."""
