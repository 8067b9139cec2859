"""Where the second robot of a cell stands, from points that both robots probed."""
