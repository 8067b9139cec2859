"""The motion that the programs' numbers make, by kinematics of the proof's own."""
