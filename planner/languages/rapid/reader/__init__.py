"""Strict reader of RAPID, from text to the main flow of a task."""
