"""In-process springback: how far a formed place rises when the tool lets go."""
