"""Example packages of third parties, which are found by entry points."""
