"""The Comms Manager: the robot's devices, or the simulated robot, between Proprioceptor and Motor (thesis 3.4.3)."""
