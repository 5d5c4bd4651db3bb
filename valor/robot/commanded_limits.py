"""Limits of commands, to accept, plan and limit joint commands.

Commanded velocities stay below the capabilities in ``robot.yaml``, so that servos can catch up; accelerations follow
from a fixed time to full velocity. The Motion Manager's limiter follows continuous commands within them exactly, others
within the error of ``jumping_velocity``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription

Indices = npt.NDArray[np.intp]

VELOCITY_FACTOR = 0.8  # of the joint's velocity limit
ACCELERATION_TIME = 0.1  # from rest to the joint's velocity limit [s]
SPEED_MARGIN = 1.01  # accepted overshoot: planners place way-points at the limit, and splines exceed it
PELVIS_NAMES = tuple(f"pelvis_{axis}" for axis in ("x", "y", "z", "roll", "pitch", "yaw"))


@dataclass(frozen=True)
class CommandedLimits:
    """Command limits of n joints. Vectors (n,) are in the units of positions, rad or m."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    lower: FloatArray  # -inf for continuous joints
    upper: FloatArray  # inf for continuous joints
    velocity: FloatArray  # [1/s]
    acceleration: FloatArray  # [1/s²]
    effort: FloatArray  # [N·m]; inf for quantities without effort

    @classmethod
    def of_joints(cls, robot: RobotDescription) -> CommandedLimits:
        """Return the limits of all joints of a robot, in its order."""
        return cls(
            robot.joints,
            ("rad",) * len(robot.joints),
            robot.lower,
            robot.upper,
            VELOCITY_FACTOR * robot.velocity_limit,
            robot.velocity_limit / ACCELERATION_TIME,
            robot.effort_limit,
        )

    @classmethod
    def of_pelvis(cls, robot: RobotDescription) -> CommandedLimits:
        """Return the limits of pelvis x, y, z, roll, pitch and yaw in the support frame while standing."""
        table, height = robot.tables.pelvis, robot.tables.nominal_base_height
        shift, turn = table.max_shift, (table.max_roll, table.max_pitch, table.max_yaw)
        return cls(
            PELVIS_NAMES,
            ("m",) * 3 + ("rad",) * 3,
            np.array((-shift, -shift, height - table.max_down, *(-angle for angle in turn))),
            np.array((shift, shift, height + table.max_up, *turn)),
            np.repeat((table.max_speed, table.max_turn_rate), 3),
            np.repeat((table.max_acceleration, table.max_turn_acceleration), 3),
            np.full(6, np.inf),
        )

    def select(self, joints: Indices) -> CommandedLimits:
        """Return the limits of the joints at (k,) indices, in their order."""
        return CommandedLimits(
            tuple(self.names[i] for i in joints),
            tuple(self.units[i] for i in joints),
            *(values[joints] for values in self._vectors),
        )

    def and_of(self, others: CommandedLimits) -> CommandedLimits:
        """Return these limits followed by others."""
        vectors = map(np.concatenate, zip(self._vectors, others._vectors, strict=True))
        return CommandedLimits(self.names + others.names, self.units + others.units, *vectors)

    @property
    def _vectors(self) -> tuple[FloatArray, ...]:
        return self.lower, self.upper, self.velocity, self.acceleration, self.effort

    @cached_property
    def fastest(self) -> FloatArray:
        """Largest accepted and commanded velocity (n,) [1/s]."""
        return SPEED_MARGIN * self.velocity

    # np.minimum and np.maximum: np.clip is several times slower on short vectors.

    def position_within(self, position: FloatArray) -> FloatArray:
        """Return positions (n,) clipped to the limits; NaN stays."""
        within: FloatArray = np.maximum(np.minimum(position, self.upper), self.lower)
        return within

    def velocity_within(self, velocity: FloatArray) -> FloatArray:
        """Return velocities (n,) clipped to ``fastest``; NaN stays."""
        within: FloatArray = np.maximum(np.minimum(velocity, self.fastest), -self.fastest)
        return within

    def acceleration_within(self, acceleration: FloatArray) -> FloatArray:
        """Return accelerations (n,) clipped to the limits; NaN stays."""
        within: FloatArray = np.maximum(np.minimum(acceleration, self.acceleration), -self.acceleration)
        return within

    def jumping_velocity(self, error: FloatArray) -> FloatArray:
        """Return the largest velocity (n,) of a target with velocity jumps that is followed within an error (n,).

        In the worst case the target, of velocity v, reverses whenever the follower, of acceleration a and velocity at
        most V, has just caught up. Its lag is then at most 9.3·v²/a, or (v + V)²/(2·a). A margin covers the discrete
        periods.
        """
        swinging = np.sqrt(0.1 * self.acceleration * error)
        turning = np.sqrt(1.9 * self.acceleration * error) - self.fastest
        speed: FloatArray = np.minimum(np.maximum(swinging, turning), self.fastest)
        return speed
