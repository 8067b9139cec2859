"""Rules of the proof on wire cuts."""
