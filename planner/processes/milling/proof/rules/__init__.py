"""Rules of the proof on milled parts."""
