"""Reads KRL programs strictly: from text to the steps of a task."""
