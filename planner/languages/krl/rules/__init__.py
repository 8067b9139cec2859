"""Rules of the proof on KRL programs."""
