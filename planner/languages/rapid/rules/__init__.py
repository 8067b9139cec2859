"""Rules of the proof on RAPID programs."""
