"""RAPID for ABB controllers."""
