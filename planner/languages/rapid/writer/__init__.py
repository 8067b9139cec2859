"""Writes RAPID programs and the configuration of ABB controllers."""
