"""State of the robot, as estimated in a control period.

Vectors over joints have one entry per joint, in the order of ``RobotDescription.joints``. Frames: *odom* is
fixed to the ground, its origin between the feet and its x forward at the estimator's reset; *pelvis* is the floating
base; a *sole* is the site under a foot.
"""

from dataclasses import dataclass
from math import acos, hypot

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.control.kinematics import Kinematics


@dataclass(slots=True)
class RobotState:
    """Floating-base estimate of one control period; only ``kinematics`` changes with the estimator's next update."""

    time: int  # stamp of the Proprioceptor [ns]
    joint_position: FloatArray  # (n,) [rad]
    joint_velocity: FloatArray  # (n,) filtered [rad/s]
    joint_effort: FloatArray  # (n,) [N·m]
    kinematics: Kinematics  # of the reduced model at this state
    contacts: npt.NDArray[np.uint8]  # (2,) left, right foot: 1 in contact
    pelvis_rotation_in_odom: FloatArray  # (3, 3)
    sole_positions_in_odom: FloatArray  # (2, 3) left, right [m]
    sole_rotations_in_odom: FloatArray  # (2, 3, 3) left, right
    pelvis_position_in_odom: FloatArray  # (3,) [m]
    pelvis_orientation_in_odom: FloatArray  # (4,) w, x, y, z
    pelvis_linear_velocity_in_odom: FloatArray  # (3,) [m/s]
    pelvis_angular_velocity_in_pelvis: FloatArray  # (3,) [rad/s]
    com_in_odom: FloatArray  # (3,) [m]
    com_velocity_in_odom: FloatArray  # (3,) [m/s]
    dcm_in_odom: FloatArray  # (3,) [m]
    contact_probability: FloatArray  # (2,) probability that each foot stands still, 0 to 1
    foot_forces: FloatArray  # (2,) vertical, left and right [N]
    cop_in_odom: FloatArray  # (2,) [m]; NaN without contact
    pelvis_position_variance: FloatArray  # (3,) along the axes of odom [m²]; grows with distance: it is odometry
    pelvis_orientation_variance: FloatArray  # (3,) about the axes of odom [rad²]
    pelvis_linear_velocity_variance: FloatArray  # (3,) [m²/s²]
    # (6,) from midway between the soles, in their mean heading [m]; roll, pitch, yaw [rad]
    pelvis_in_support: FloatArray

    @property
    def tilt(self) -> float:
        """Angle of the pelvis from upright [rad]."""
        return acos(min(1.0, max(-1.0, self.pelvis_rotation_in_odom.item(8))))

    @property
    def com_speed(self) -> float:
        """Horizontal speed of the CoM [m/s]."""
        return hypot(*self.com_velocity_in_odom[:2].tolist())
