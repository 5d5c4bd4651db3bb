"""What both ends of a device's port know: robot.yaml's table of devices, where ports are, and frames on the buses."""
