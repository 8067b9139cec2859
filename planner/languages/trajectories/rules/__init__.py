"""Rules of the proof on trajectory files."""
