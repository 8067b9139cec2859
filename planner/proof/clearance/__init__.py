"""Clearance between bodies along the replayed motion."""
