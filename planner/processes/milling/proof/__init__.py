"""Proof of milling."""
