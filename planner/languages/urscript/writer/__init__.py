"""URScript for controllers of Universal Robots."""
