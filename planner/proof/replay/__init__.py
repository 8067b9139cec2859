"""Replay of the motion that programs state, with the proof's own kinematics."""
