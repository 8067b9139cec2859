"""Joint trajectories for ROS 2 controllers."""
