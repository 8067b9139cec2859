"""Rules of the proof on URScript programs."""
