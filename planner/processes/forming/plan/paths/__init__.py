"""Paths of the contact on the face of a pass."""
