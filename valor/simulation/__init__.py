"""The simulated robot: MuJoCo's physics, motors and sensors with the imperfections of ``robot.yaml``.

Its caller advances its time. It replaces the devices: no controller may import it.
"""
