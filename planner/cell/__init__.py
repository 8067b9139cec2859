"""The cell in Drake: robots, tools, bodies, their distances; stands beside the flow."""
