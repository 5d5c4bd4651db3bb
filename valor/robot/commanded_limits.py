"""What joints may be commanded: how far, how fast, how hard. Who accepts, plans, leads or limits goes by this alone.

``robot.yaml`` says what a joint can do. What is commanded keeps below its speed, so that its servo can catch up, and is
brought to speed in a fixed time, for robots publish no acceleration limits. The limiter of the Motion Manager follows
whatever keeps these limits: exactly, if its velocity does not jump, else as near as ``jumping_velocity`` says.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription

Indices = npt.NDArray[np.intp]

VELOCITY_FACTOR = 0.8  # of what a joint can do
ACCELERATION_TIME = 0.1  # from rest to the speed that a joint can do [s]
SPEED_MARGIN = 1.01  # followed beyond the limit: planners place way-points at the limit itself, and splines swing over
PELVIS_NAMES = tuple(f"pelvis_{axis}" for axis in ("x", "y", "z", "roll", "pitch", "yaw"))


@dataclass(frozen=True)
class CommandedLimits:
    """Limits of n joints.

    Attributes:
        names: (n,) of the joints.
        units: (n,) of their positions, each rad or m.
        lower, upper: (n,) -inf and inf where a joint turns without end.
        velocity: (n,) [1/s].
        acceleration: (n,) [1/s²].
        effort: (n,) [N·m]; inf where none is commanded.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray

    @classmethod
    def of_joints(cls, robot: RobotDescription) -> CommandedLimits:
        """Of all joints of a robot, in its order."""
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
        """Of x, y, z, roll, pitch and yaw of the standing robot's pelvis, led like joints in the support frame."""
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
        """Of the joints at (k,) places, in their order."""
        return CommandedLimits(
            tuple(self.names[i] for i in joints),
            tuple(self.units[i] for i in joints),
            *(values[joints] for values in self._vectors),
        )

    def and_of(self, others: CommandedLimits) -> CommandedLimits:
        """Of these joints, then of others."""
        vectors = map(np.concatenate, zip(self._vectors, others._vectors, strict=True))
        return CommandedLimits(self.names + others.names, self.units + others.units, *vectors)

    @property
    def _vectors(self) -> tuple[FloatArray, ...]:
        return self.lower, self.upper, self.velocity, self.acceleration, self.effort

    @cached_property
    def fastest(self) -> FloatArray:
        """(n,) to which a command is brought, and up to which one is accepted [1/s]."""
        return SPEED_MARGIN * self.velocity

    # np.minimum and np.maximum: np.clip costs several times as much on vectors this short.

    def position_within(self, position: FloatArray) -> FloatArray:
        """(n,) brought within the limits; NaN stays."""
        within: FloatArray = np.maximum(np.minimum(position, self.upper), self.lower)
        return within

    def velocity_within(self, velocity: FloatArray) -> FloatArray:
        """(n,) likewise, within ``fastest``."""
        within: FloatArray = np.maximum(np.minimum(velocity, self.fastest), -self.fastest)
        return within

    def acceleration_within(self, acceleration: FloatArray) -> FloatArray:
        """(n,) likewise."""
        within: FloatArray = np.maximum(np.minimum(acceleration, self.acceleration), -self.acceleration)
        return within

    def jumping_velocity(self, error: FloatArray) -> FloatArray:
        """How fast a target may move whose velocity jumps, to be followed to within an error.

        At worst the target, of speed v, turns round whenever who follows, with the acceleration a, has just caught up.
        He catches up the faster the farther he is behind, and so swings farther from time to time: up to 9.3·v²/a
        behind, or, being no faster than V, (v + V)²/(2·a). A little is added for the periods.

        Args:
            error: (n,) [rad or m].

        Returns:
            (n,) at most ``fastest`` [1/s].
        """
        swinging = np.sqrt(0.1 * self.acceleration * error)
        turning = np.sqrt(1.9 * self.acceleration * error) - self.fastest
        speed: FloatArray = np.minimum(np.maximum(swinging, turning), self.fastest)
        return speed
