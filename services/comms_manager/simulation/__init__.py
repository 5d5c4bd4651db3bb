"""The Comms Manager's devices, simulated: MuJoCo in process, actuators, sensors and two clocks."""
