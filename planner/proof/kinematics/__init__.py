"""Kinematics of the proof, independent of the planner's."""
