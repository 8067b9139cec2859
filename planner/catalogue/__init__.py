"""What is built in: robots, materials, codes of issues."""
