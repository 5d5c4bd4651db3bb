"""Proprioceptor, composed of what the devices provide, whatever they are."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import get_args

import numpy as np

from valor.common.errors import ConfigurationError
from valor.common.messages import Proprioceptor
from valor.comms_manager.hardware.attitude import AttitudeSource
from valor.comms_manager.hardware.device import FEET, Device, providers
from valor.devices.kinds import Quantity
from valor.devices.table import WrenchPlace
from valor.robot.description import RobotDescription

NOMINAL_VOLTAGE = 48.0  # of the battery, until a unit says otherwise [V]


def require_complete(robot: RobotDescription, devices: Sequence[Device]) -> None:
    """See that devices move each joint once, and feel what balance is kept by.

    Raises:
        ConfigurationError: names the file, and all that is lacking.
    """
    moved = Counter(joint for device in devices for joint in robot.tables.device_joints(device.name))
    felt = Counter[str](place for device in providers(devices, Quantity.WRENCH) for place in device.places)
    lacking = []
    if missing := [joint for joint in robot.joints if not moved[joint]]:
        lacking.append(f"none moves {', '.join(missing)}")
    if not providers(devices, Quantity.ATTITUDE):
        lacking.append("0 IMUs; expected one, for the pelvis' attitude")
    if missing := [place for place in FEET if not felt[place]]:
        lacking.append(f"no force/torque sensor at {', '.join(missing)}; expected one in each foot")
    if twice := [what for what, count in (moved + felt).items() if count > 1]:
        lacking.append(f"{', '.join(twice)}: in more than one device")
    if lacking:
        raise ConfigurationError(f"{robot.folder / 'robot.yaml'}: devices: {'; '.join(lacking)}")


class Proprioception:
    """The newest of all devices; of those that are silent the last.

    Attributes:
        position: (n,) of the joints [rad].
        velocity: (n,) [rad/s].
        effort: (n,) [N·m].
    """

    def __init__(self, robot: RobotDescription, devices: Sequence[Device]) -> None:
        n = len(robot.joints)
        self._moving = providers(devices, Quantity.JOINT_STATE)
        self._feeling = providers(devices, Quantity.WRENCH)
        self._attitude = AttitudeSource(providers(devices, Quantity.ATTITUDE))
        self.position, self.velocity, self.effort = np.zeros(n), np.zeros(n), np.zeros(n)
        self._wrenches = {place: np.zeros(6) for place in get_args(WrenchPlace)}
        self._voltage = NOMINAL_VOLTAGE

    def measure(self, time: int, sequence: int, motor_sequence: int, leader: Device | None) -> Proprioceptor:
        """What is known now.

        Args:
            time: of the robot [ns].
            sequence: of the Proprioceptor.
            motor_sequence: of the Motor that was handed out last.
            leader: whose attitude is the robot's.
        """
        for device in self._moving:
            if (joints := device.joint_state) is not None:
                places = device.joints
                self.position[places] = joints.position
                self.velocity[places] = joints.velocity
                self.effort[places] = joints.effort
        for device in self._feeling:
            if (felt := device.wrench) is not None:
                self._wrenches.update(zip(device.places, felt.wrench, strict=True))
        attitude = self._attitude.measure(leader)
        return Proprioceptor(
            time=time,
            sequence=sequence,
            motor_sequence=motor_sequence,
            joint_position=self.position.copy(),
            joint_velocity=self.velocity.copy(),
            joint_effort=self.effort.copy(),
            imu_orientation=attitude.orientation,
            imu_angular_velocity=attitude.angular_velocity,
            imu_linear_acceleration=attitude.linear_acceleration,
            **{f"{place}_wrench": wrench for place, wrench in self._wrenches.items()},
            battery_voltage=self._voltage,
            motor_behavior="",
        )

    def look_at_supply(self) -> None:
        """Take the lowest voltage that a unit which moves joints has for the battery's."""
        voltages = [record.voltage for device in self._moving for record in device.records]
        if known := [voltage for voltage in voltages if not math.isnan(voltage)]:
            self._voltage = min(known)
