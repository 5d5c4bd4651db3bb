"""The robot's attitude, from whichever of its inertial measurement units leads."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from valor.common.rotation import Quaternion, about_z, conjugate, multiply, vertical
from valor.comms_manager.hardware.device import Device, ImuMeasurement

FRESH = 20_000_000  # younger, two samples are of one time [ns]
NOTHING = ImuMeasurement(0, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))


class AttitudeSource:
    """The newest sample of the unit that leads, its heading going on where that of the one before was.

    Headings are whatever each unit likes. By how much they differ is followed while both say theirs, so that who takes
    over from one that fell silent does so where the robot has turned since.
    """

    def __init__(self, units: Sequence[Device]) -> None:
        """``units``: that provide an attitude."""
        self._units = units
        self._turns = [0.0] * len(units)  # from each unit's heading to the robot's [rad]
        self._newest = NOTHING

    def measure(self, leader: Device | None) -> ImuMeasurement:
        """What ``leader`` says; the last sample where nothing has come."""
        if leader is None or leader.attitude is None:
            return self._newest
        sample = leader.attitude
        if len(self._units) > 1:
            turn = self._turns[self._units.index(leader)]
            sample = _turned(sample, turn)
            self._follow(leader, sample)
        self._newest = sample
        return sample

    def _follow(self, leader: Device, sample: ImuMeasurement) -> None:
        """Note by how much the others' headings differ from that of a sample."""
        now = time.monotonic_ns()
        if now - sample.stamp > FRESH:
            return
        for place, unit in enumerate(self._units):
            other = unit.attitude
            if unit is not leader and other is not None and now - other.stamp < FRESH:
                self._turns[place] = _heading(_quaternion(sample), _quaternion(other))


def tilt_between(a: ImuMeasurement, b: ImuMeasurement) -> float:
    """The angle between where two units have the vertical [rad]."""
    ups = vertical(_quaternion(a)), vertical(_quaternion(b))
    return math.acos(max(-1.0, min(1.0, sum(p * q for p, q in zip(*ups, strict=True)))))


def _quaternion(sample: ImuMeasurement) -> Quaternion:
    w, x, y, z = sample.orientation.tolist()
    return w, x, y, z


def _heading(to: Quaternion, of: Quaternion) -> float:
    """The turn about the vertical that brings one attitude nearest to another [rad]."""
    dw, _, _, dz = multiply(to, conjugate(of))
    return 2.0 * math.atan2(dz, dw)


def _turned(sample: ImuMeasurement, turn: float) -> ImuMeasurement:
    """With its heading turned [rad]; rates and forces are the unit's own."""
    if not turn:
        return sample
    orientation = np.array(multiply(about_z(turn), _quaternion(sample)))
    return ImuMeasurement(sample.stamp, orientation, sample.angular_velocity, sample.linear_acceleration)
