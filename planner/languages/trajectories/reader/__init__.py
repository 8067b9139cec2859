"""Strict reader of ROS 2 joint trajectories, from rows to the main flow of each arm."""
