"""From a path to a trajectory: optimised, timed, as controllers take it."""
