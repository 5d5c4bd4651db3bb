"""What sensors and commands say of a robot while its arm moves, in blocks of some control periods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.messages import JointMode, Motor, Proprioceptor
from valor.robot.description import RobotDescription

BLOCK = 0.01  # over which is averaged [s]


@dataclass(frozen=True)
class Record:
    """T moments of a robot of n joints.

    Attributes:
        time: (T,) [s].
        orientation: (T, 4) of the base in the world, whose z is up: w, x, y, z.
        position, velocity, effort: (T, n) measured [rad, rad/s, N·m].
        wanted_position, wanted_velocity, wanted_effort: (T, n) of the Motor that acted.
        stiffness, damping: (T, n) of the servos by that Motor [N·m/rad, N·m·s/rad].
    """

    time: FloatArray
    orientation: FloatArray
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    wanted_position: FloatArray
    wanted_velocity: FloatArray
    wanted_effort: FloatArray
    stiffness: FloatArray
    damping: FloatArray

    @classmethod
    def joined(cls, records: Sequence[Self]) -> Self:
        """Several, one after the other."""
        return cls(*(np.concatenate([getattr(each, field.name) for each in records]) for field in fields(cls)))


class Recorder:
    """Makes a ``Record`` of messages as they come."""

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._block = max(1, round(BLOCK * robot.tables.control_rate))
        self._rows: list[FloatArray] = []
        self._waiting: list[FloatArray] = []

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, measured: Proprioceptor, acting: Motor, orientation: FloatArray) -> None:
        """A control period.

        Args:
            measured: what the devices said.
            acting: the Motor that acted then, whose sequence is ``measured.motor_sequence``.
            orientation: (4,) of the base, as estimated.
        """
        robot = self._robot
        position = acting.mode == JointMode.POSITION
        self._waiting.append(
            np.concatenate(
                (
                    [1e-9 * measured.time],
                    orientation,
                    measured.joint_position,
                    measured.joint_velocity,
                    measured.joint_effort,
                    acting.position,
                    acting.velocity,
                    np.where(position, 0.0, acting.effort),
                    np.where(position, robot.servo_stiffness, acting.stiffness),
                    np.where(position, robot.servo_damping, acting.damping),
                )
            )
        )
        if len(self._waiting) == self._block:
            self._rows.append(np.mean(self._waiting, axis=0))
            self._waiting.clear()

    def interrupt(self) -> None:
        """What comes next does not follow what came last."""
        self._waiting.clear()

    def record(self) -> Record:
        """All that was added since the last call; at least one block must have been."""
        rows, n = np.array(self._rows), len(self._robot.joints)
        self._rows.clear()
        self._waiting.clear()
        parts = np.split(rows, [1, 5, *range(5 + n, 5 + 8 * n, n)], axis=1)
        return Record(parts[0][:, 0], *parts[1:])
