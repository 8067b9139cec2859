"""Rules of the proof on formed sheets."""
