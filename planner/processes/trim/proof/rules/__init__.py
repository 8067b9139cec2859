"""Rules of the proof on trimmed sheets."""
