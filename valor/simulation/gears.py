"""What stands between motors and joints: friction, backlash, what a device does not take, what it cannot do.

The numbers are those of an actuator profile in robot.yaml, for whatever plays the robot's devices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.tables import ActuatorProfile, Gear


@dataclass(frozen=True)
class Gears:
    """The gears of all joints; (n,) each.

    Attributes:
        friction: Coulomb, at the joint [N·m].
        sticks: where a gear of its own says of the friction: it holds a joint at rest.
        half_backlash: the joint turns so far to either side before its motor's stiffness acts [rad].
        feed_forward: 1 where the device takes Motor's effort, 0 where it goes by position and velocity alone.
        strength: share of the motor's torque that reaches the joint, 0 to 1.
    """

    friction: FloatArray
    sticks: npt.NDArray[np.bool_]
    half_backlash: FloatArray
    feed_forward: FloatArray
    strength: FloatArray

    @classmethod
    def of(cls, robot: RobotDescription, profile: ActuatorProfile) -> Self:
        """Of a profile: a joint's own numbers, else its group's, else those of all joints."""
        groups = {joint: group for group, joints in robot.tables.groups.items() for joint in joints}
        common = Gear()
        gears = [
            profile.gears.get(joint) or profile.gears.get(groups.get(joint, "")) or common for joint in robot.joints
        ]
        friction = np.minimum(profile.friction, profile.friction_share * robot.effort_limit)
        sticks = np.array([gear.friction is not None for gear in gears])
        friction[sticks] = [gear.friction for gear in gears if gear.friction is not None]
        return cls(
            friction,
            sticks,
            np.array([0.5 * (profile.backlash if gear.backlash is None else gear.backlash) for gear in gears]),
            np.array([float(gear.feed_forward) for gear in gears]),
            np.array([gear.strength for gear in gears]),
        )
