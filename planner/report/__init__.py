"""Report, setup sheet and replay of a plan."""
