"""Reader of G-code, from the lines of a file to the path of a cutter, and writer for five-axis machines."""
