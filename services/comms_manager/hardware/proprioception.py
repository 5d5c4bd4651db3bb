"""Proprioceptor, composed of the measurements of all devices."""

import math
import time
from collections.abc import Sequence
from typing import get_args

import numpy as np

from valor.common.messages import Proprioceptor
from valor.common.rotation import Quaternion, about_z, conjugate, multiply, vertical
from valor.comms_manager.hardware.device import Device, ImuMeasurement, providers
from valor.devices.kinds import Quantity
from valor.devices.table import WrenchPlace
from valor.robot.description import RobotDescription
from valor.robot.foot_wrenches import completion

NOMINAL_VOLTAGE = 48.0  # of the battery, until a unit reports a voltage [V]


FRESH = 20_000_000  # largest age of samples that are compared [ns]
NOTHING = ImuMeasurement(0, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
ABSENT = ImuMeasurement(0, NOTHING.orientation, np.zeros(0), np.zeros(0))


class AttitudeSource:
    """Latest sample of the primary IMU, with a heading that is continuous when another IMU becomes primary.

    IMUs have arbitrary headings. The differences are tracked while both report, so that a new primary continues from
    the present heading of the robot.
    """

    def __init__(self, units: Sequence[Device]) -> None:
        self._units = units
        self._turns = [0.0] * len(units)  # from the heading of each IMU to the robot's [rad]
        self._newest = NOTHING

    def measure(self, primary: Device | None) -> ImuMeasurement:
        """Sample of ``primary``; the last sample if it has none."""
        if primary is None or primary.attitude is None:
            return self._newest
        sample = primary.attitude
        if len(self._units) > 1:
            turn = self._turns[self._units.index(primary)]
            sample = _turned(sample, turn)
            self._follow(primary, sample)
        self._newest = sample
        return sample

    def _follow(self, primary: Device, sample: ImuMeasurement) -> None:
        now = time.monotonic_ns()
        if now - sample.stamp > FRESH:
            return
        for place, unit in enumerate(self._units):
            other = unit.attitude
            if unit is not primary and other is not None and now - other.stamp < FRESH:
                self._turns[place] = _heading(_quaternion(sample), _quaternion(other))


def tilt_between(a: ImuMeasurement, b: ImuMeasurement) -> float:
    """Angle between the vertical directions of two samples [rad]."""
    ups = vertical(_quaternion(a)), vertical(_quaternion(b))
    return math.acos(max(-1.0, min(1.0, sum(p * q for p, q in zip(*ups, strict=True)))))


def _quaternion(sample: ImuMeasurement) -> Quaternion:
    w, x, y, z = sample.orientation.tolist()
    return w, x, y, z


def _heading(to: Quaternion, of: Quaternion) -> float:
    """Rotation about the vertical that minimizes the difference of two attitudes [rad]."""
    dw, _, _, dz = multiply(to, conjugate(of))
    return 2.0 * math.atan2(dz, dw)


def _turned(sample: ImuMeasurement, turn: float) -> ImuMeasurement:
    """Rotate the heading of a sample [rad]; rates and forces stay in the IMU's frame."""
    if not turn:
        return sample
    orientation = np.array(multiply(about_z(turn), _quaternion(sample)))
    return ImuMeasurement(sample.stamp, orientation, sample.angular_velocity, sample.linear_acceleration)


class Proprioception:
    """Latest measurements of all devices; after a timeout, the last ones."""

    def __init__(self, robot: RobotDescription, devices: Sequence[Device]) -> None:
        n = len(robot.joints)
        self._moving = providers(devices, Quantity.JOINT_STATE)
        self._feeling = providers(devices, Quantity.WRENCH)
        self._second = next(iter(providers(devices, Quantity.INERTIA)), None)
        self._attitude = AttitudeSource(providers(devices, Quantity.ATTITUDE))
        self.position, self.velocity, self.effort = np.zeros(n), np.zeros(n), np.zeros(n)  # [rad, rad/s, N·m]
        self._wrenches = {place: np.zeros(6) for place in get_args(WrenchPlace)}
        carrying = [each for each in self._moving if robot.tables.device_carries(each.name)]
        self._supplied = carrying or self._moving  # others may have a supply of their own
        self._complete = completion(robot)
        self._voltage = NOMINAL_VOLTAGE
        self.update_voltage()

    def measure(self, time: int, sequence: int, motor_sequence: int, primary: Device | None) -> Proprioceptor:
        """Compose a Proprioceptor at robot ``time`` [ns]; ``primary``: IMU of the robot's attitude."""
        for device in self._moving:
            if (joints := device.joint_state) is not None:
                places = device.joints
                self.position[places] = joints.position
                self.velocity[places] = joints.velocity
                self.effort[places] = joints.effort
        for device in self._feeling:
            if (felt := device.wrench) is not None:
                self._wrenches.update(zip(device.places, felt.wrench, strict=True))
        attitude, second = self._attitude.measure(primary), self._second_imu()
        measured = Proprioceptor(
            time=time,
            sequence=sequence,
            motor_sequence=motor_sequence,
            joint_position=self.position.copy(),
            joint_velocity=self.velocity.copy(),
            joint_effort=self.effort.copy(),
            imu_orientation=attitude.orientation,
            imu_angular_velocity=attitude.angular_velocity,
            imu_linear_acceleration=attitude.linear_acceleration,
            kvh_angular_velocity=second.angular_velocity,
            kvh_linear_acceleration=second.linear_acceleration,
            **{f"{place}_wrench": wrench for place, wrench in self._wrenches.items()},
            battery_voltage=self._voltage,
            motor_behavior="",
        )
        return self._complete(measured)

    def _second_imu(self) -> ImuMeasurement:
        """Sample of the second IMU; without vectors if it has none, or is silent."""
        imu = self._second
        if imu is None or imu.inertia is None or time.monotonic_ns() - imu.inertia.stamp > 1e9 * imu.silent_after:
            return ABSENT
        return imu.inertia

    def update_voltage(self) -> None:
        """Update the battery voltage: the lowest one reported by a unit that carries the robot."""
        voltages = [record.voltage for device in self._supplied for record in device.records]
        if known := [voltage for voltage in voltages if not math.isnan(voltage)]:
            self._voltage = min(known)
