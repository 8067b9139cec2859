"""URScript for Universal Robots controllers."""
