"""Planning of incremental sheet forming: from the surface of a part to the paths of one or two tools."""
