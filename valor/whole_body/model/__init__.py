"""Reduced model of the robot: kinematics, dynamics, effect of the arms on the centre of mass."""
