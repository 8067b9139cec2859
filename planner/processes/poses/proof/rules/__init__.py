"""Rules of the proof on supplied poses."""
