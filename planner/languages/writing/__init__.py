"""From a plan to programs."""
