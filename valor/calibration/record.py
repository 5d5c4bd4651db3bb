"""Record of sensors and commands during a motion, averaged over blocks of control periods."""

from dataclasses import dataclass

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.messages import JointMode, Motor, Proprioceptor
from valor.robot.description import RobotDescription

BLOCK = 0.01  # averaged [s]


@dataclass(frozen=True)
class Record:
    """T moments of a robot of n joints."""

    time: FloatArray  # (T,) [s]
    orientation: FloatArray  # (T, 4) of the base in the world (z up), as w, x, y, z
    position: FloatArray  # (T, n) measured [rad]
    velocity: FloatArray  # (T, n) measured [rad/s]
    effort: FloatArray  # (T, n) measured [N·m]
    wanted_position: FloatArray  # (T, n) of the Motor that acted [rad]
    wanted_velocity: FloatArray  # (T, n) of that Motor [rad/s]
    wanted_effort: FloatArray  # (T, n) of that Motor [N·m]
    stiffness: FloatArray  # (T, n) of the servos by that Motor [N·m/rad]
    damping: FloatArray  # (T, n) of the servos by that Motor [N·m·s/rad]


class Recorder:
    """Builds a ``Record`` from received messages."""

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._block = max(1, round(BLOCK * robot.tables.control_rate))
        self._rows: list[FloatArray] = []
        self._waiting: list[FloatArray] = []

    def add(self, measured: Proprioceptor, acting: Motor, orientation: FloatArray) -> None:
        """Add a control period: the measurements, the Motor that acted then, the estimated base orientation (4,)."""
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
        """Discard the incomplete block, after lost messages."""
        self._waiting.clear()

    def record(self) -> Record:
        """Everything added since the last call, at least one block."""
        rows, n = np.array(self._rows), len(self._robot.joints)
        self._rows.clear()
        self._waiting.clear()
        parts = np.split(rows, [1, 5, *range(5 + n, 5 + 8 * n, n)], axis=1)
        return Record(parts[0][:, 0], *parts[1:])
