"""Targets and claims of poses that the user supplies."""
