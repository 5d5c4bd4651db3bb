"""Balance on both soles by the ankles, while Get Up rises."""

from math import sqrt

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import Balance

COM_SPEED_FILTER = 0.03  # time constant [s]
LOWEST_COM = 0.3  # height above the soles for the DCM, at least [m]
GRAVITY = 9.81  # [m/s²]


class SoleBalance:
    """DCM feedback on the ankles; odometry is invalid after lying, so only the CoM relative to the soles counts."""

    def __init__(self, robot: RobotDescription, table: Balance) -> None:
        self._joints = np.array([robot.index[name] for name in table.joints])
        self._limits = CommandedLimits.of_joints(robot).select(self._joints)
        self._gain, self._limit = table.gain, table.limit
        foot = robot.tables.feet.left
        self._middle = 0.5 * (foot.heel + foot.toe)  # of a sole, ahead of its frame [m]
        self._before = (-1.0, 0.0, 0.0)  # time [s], CoM ahead [m], its speed [m/s]

    def lean(self, position: FloatArray, com: FloatArray, forward: FloatArray, now: float) -> None:
        """Add the feedback to the joint reference ``position`` (n,) [rad].

        ``com`` (3,) [m]: from between the soles' frames; ``forward``: sum (2,) of the soles' axes, seen from above.
        """
        ahead = float(com[:2] @ forward) / float(np.hypot(*forward)) - self._middle
        then, before, speed = self._before
        passed = now - then
        if 0.0 < passed < COM_SPEED_FILTER:
            speed += passed / COM_SPEED_FILTER * ((ahead - before) / passed - speed)
        elif passed:
            speed = 0.0
        self._before = (now, ahead, speed)
        dcm = ahead + speed * sqrt(max(float(com[2]), LOWEST_COM) / GRAVITY)
        angle = min(self._limit, max(-self._limit, self._gain * dcm))
        position[self._joints] = self._limits.position_within(position[self._joints] + angle)
