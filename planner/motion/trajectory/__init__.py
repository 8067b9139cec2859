"""From a path to a trajectory: optimisation, timing, and limits of controllers."""
