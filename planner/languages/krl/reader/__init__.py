"""Strict reader of KRL programs, from text to the steps of a task."""
