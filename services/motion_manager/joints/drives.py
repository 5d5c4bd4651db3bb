"""What is known of drives before they move: as calibrated (``valor.robot.arm_calibration``), else as of good ones."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.robot import arm_calibration
from valor.robot.arm_calibration import JointCalibration
from valor.robot.description import RobotDescription

MOST_PLAY = 0.05  # to either side [rad]
FRICTION_SHARE = 0.1  # most friction, share of a joint's effort limit
ROOM = 1.5  # for more play and friction than was calibrated
RELEARNING = 0.03  # of the rate at which play and friction are learned: where they were calibrated
WEAKEST = 0.5  # servo that is made up for: a weaker one does not turn whatever it is told
_GOOD = JointCalibration(
    friction=0.0, damping=0.0, offset=0.0, backlash=0.0, effort_share=1.0, strength=1.0, residual=0.0
)


class Drives:
    """Of m joints; (m,) each.

    Attributes:
        share: of Motor's effort that the device takes. play: to either side [rad]. friction: Coulomb [N·m].
        constants: strength of the servo; damping [N·m·s/rad]; offset [N·m]; share of the rate at which play and
            friction are learned; the most that they may become.
    """

    def __init__(self, robot: RobotDescription, joints: npt.NDArray[np.intp]) -> None:
        """Of the joints at those places of every joint vector.

        Raises:
            ConfigurationError: the calibration does not fit the robot.
        """
        table = arm_calibration.load(robot) if joints.size else None
        found = table.joints() if table else {}
        names = [robot.joints[place] for place in joints]
        drives = [found.get(name, _GOOD) for name in names]
        self.share = np.array([drive.effort_share for drive in drives])
        self.play = np.array([0.5 * (drive.backlash or 0.0) for drive in drives])
        self.friction = np.array([drive.friction for drive in drives])
        self.constants: tuple[FloatArray, ...] = (
            np.array([max(drive.strength, WEAKEST) for drive in drives]),
            np.array([drive.damping for drive in drives]),
            np.array([drive.offset for drive in drives]),
            np.array([RELEARNING if name in found else 1.0 for name in names]),
            np.maximum(MOST_PLAY, ROOM * self.play),
            np.maximum(FRICTION_SHARE * robot.effort_limit[joints], ROOM * self.friction),
        )
