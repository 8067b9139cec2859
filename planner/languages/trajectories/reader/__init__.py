"""Reads trajectory files."""
