"""Features of a formed part: its surface, walls, feature tree, and the shapes of passes."""
