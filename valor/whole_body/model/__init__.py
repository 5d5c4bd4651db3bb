"""The reduced model of the robot, evaluated: kinematics, dynamics, what the arms do to the centre of mass."""
