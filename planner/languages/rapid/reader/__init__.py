"""RAPID read strictly: from text to the straight way of a task."""
