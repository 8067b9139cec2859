"""Poses that the user supplies."""
