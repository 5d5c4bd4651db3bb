"""The simulated robot: MuJoCo's physics, motors and sensors with the imperfections of ``robot.yaml``.

Whoever runs it keeps its time. It stands in for the devices, so no controller may import it.
"""
