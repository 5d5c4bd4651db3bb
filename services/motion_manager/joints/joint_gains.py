"""Stiffness and damping of the joints that are driven by impedance, which may be changed while the robot balances."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints
from valor.whole_body.tuning_tables import Tuning

CHANGE_TIME = 0.5  # in which a gain changes by its nominal value [s]


class JointGains:
    """Gains on their way to those asked for: a gain that jumped would make the torque jump.

    Attributes:
        stiffness: (n,) in force [N·m/rad].
        damping: (n,) in force [N·m·s/rad].
        lower_stiffness, upper_stiffness, lower_damping, upper_damping: (n,) between which they may be.
    """

    def __init__(self, robot: RobotDescription, impedance: Joints) -> None:
        """The servos' own.

        Args:
            robot: its gains and limits.
            impedance: (n,) which joints may have others.
        """
        self.impedance = impedance
        self._nominal = (robot.servo_stiffness, robot.servo_damping)
        table = robot.read(Tuning).gains
        self.lower_stiffness, self.upper_stiffness = (
            factor * robot.servo_stiffness for factor in (table.min_stiffness, table.max_stiffness)
        )
        self.lower_damping, self.upper_damping = (
            factor * robot.servo_damping for factor in (table.min_damping, table.max_damping)
        )
        share = robot.control_period / CHANGE_TIME
        self._steps = (share * robot.servo_stiffness, share * robot.servo_damping)
        self.reset()

    def reset(self) -> None:
        """Be nominal, at once: for the beginning of balance."""
        self.stiffness, self.damping = self._asked = self._nominal

    def ask(self, joints: npt.NDArray[np.intp], stiffness: FloatArray, damping: FloatArray) -> None:
        """Go to gains within the limits.

        Args:
            joints: (k,) places of joints driven by impedance.
            stiffness: (k,) [N·m/rad].
            damping: (k,) [N·m·s/rad].
        """
        asked_stiffness, asked_damping = (gains.copy() for gains in self._asked)
        asked_stiffness[joints], asked_damping[joints] = stiffness, damping
        self._asked = (asked_stiffness, asked_damping)

    def advance(self) -> bool:
        """Go one control period; returns whether they changed."""
        present = (self.stiffness, self.damping)
        if present[0] is self._asked[0] and present[1] is self._asked[1]:
            return False  # nearly always
        if all(now is asked or np.array_equal(now, asked) for now, asked in zip(present, self._asked, strict=True)):
            return False
        self.stiffness, self.damping = (
            np.clip(asked, now - step, now + step)
            for asked, now, step in zip(self._asked, present, self._steps, strict=True)
        )
        return True
