"""The Comms Manager's devices on hardware: one thread a device, and a main loop that exchanges states and commands."""
