"""What is sent: how large, and for those that have message types, as what."""

from __future__ import annotations

from typing import Any

import numpy as np

import bifrost

JOINTS = 38


class Number(bifrost.Message):
    """The thesis' message: a single double."""

    value: float


class Block(bifrost.Message):
    """Bytes."""

    data: bifrost.Uint8Array


class Proprioceptor(bifrost.Message):
    """As large as the robot's, 38 joints."""

    time: int
    sequence: int
    motor_sequence: int
    joint_position: bifrost.Float64Array
    joint_velocity: bifrost.Float64Array
    joint_effort: bifrost.Float64Array
    imu_orientation: bifrost.Float64Array
    imu_angular_velocity: bifrost.Float64Array
    imu_linear_acceleration: bifrost.Float64Array
    left_foot_wrench: bifrost.Float64Array
    right_foot_wrench: bifrost.Float64Array
    left_hand_wrench: bifrost.Float64Array
    right_hand_wrench: bifrost.Float64Array
    battery_voltage: float
    motor_behavior: str


def proprioceptor() -> Proprioceptor:
    """One with numbers in it."""
    vectors = [np.random.default_rng(0).normal(size=n) for n in (*3 * (JOINTS,), 4, 3, 3, 6, 6, 6, 6)]
    fields: list[Any] = [1, 2, 3, *vectors, 48.0, "stand"]
    return Proprioceptor(*fields)


# Name to size [B]; those without types send that many bytes.
SIZES: dict[str, int] = {
    "8 B": 8,
    "Proprioceptor": len(bifrost.codec(Proprioceptor).encode(proprioceptor())),
    "2 kB": 2048,
    "64 kB": 65536,
}
