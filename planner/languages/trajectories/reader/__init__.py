"""Joint trajectories of ROS 2 read strictly: from rows to the straight way of each arm."""
