"""Writer of joint trajectories for the joint_trajectory_controller of ROS 2."""
