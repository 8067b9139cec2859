"""Reader of G-code, from the lines of a file to passes of the cutter, and writer for five-axis machines."""
