"""Proof of trimming, by the proof's own reading of part and curves."""
