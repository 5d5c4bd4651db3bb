"""What flows through the Whole-Body Controller: the estimated state, the arms' reference, the command.

Vectors over joints have one entry a joint of the robot, in the order of ``RobotDescription.joints``. Frames: *odom* is
fixed to the ground, its origin between the feet and its x forward at the estimator's reset; *pelvis* is the floating
base; a *sole* is the site under a foot.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.whole_body.model.dynamics import Dynamics


@dataclass(slots=True)
class RobotState:
    """The floating-base estimate of one control period.

    A new one every period; its arrays are not written again. ``dynamics`` alone is shared and moves on with the
    estimator's next update.
    """

    time: int  # stamp of the Proprioceptor [ns]
    joint_position: FloatArray  # (n,) [rad]
    joint_velocity: FloatArray  # (n,) filtered [rad/s]
    joint_effort: FloatArray  # (n,) [N·m]
    dynamics: Dynamics  # of the reduced model at this state
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
    contact_probability: FloatArray  # (2,) that each foot stands still, 0 to 1
    foot_forces: FloatArray  # (2,) vertical, left and right [N]
    cop_in_odom: FloatArray  # (2,) [m]; NaN without contact
    pelvis_position_variance: FloatArray  # (3,) along the axes of odom [m²]; grows with the way: it is odometry
    pelvis_orientation_variance: FloatArray  # (3,) about the axes of odom [rad²]
    pelvis_linear_velocity_variance: FloatArray  # (3,) [m²/s²]
    pelvis_in_support: FloatArray  # (6,) from midway between the soles, along their mean heading [m]; roll, pitch, yaw

    @property
    def q(self) -> FloatArray:
        """(nq,) of the reduced model: pelvis position and orientation in odom, then its joints."""
        return np.concatenate(
            (self.pelvis_position_in_odom, self.pelvis_orientation_in_odom, self.dynamics.joint_position)
        )

    @property
    def v(self) -> FloatArray:
        """(nv,) of the reduced model: pelvis linear velocity in odom, angular in pelvis, then its joints."""
        return np.concatenate(
            (
                self.pelvis_linear_velocity_in_odom,
                self.pelvis_angular_velocity_in_pelvis,
                self.dynamics.joint_velocity,
            )
        )


@dataclass(slots=True)
class UpperBodyReference:
    """Where the joints shall be, from the Manipulation FSM. Those of the arms and the waist matter here."""

    position: FloatArray  # (n,) [rad]
    velocity: FloatArray  # (n,) [rad/s]
    acceleration: FloatArray  # (n,) [rad/s²]


class QpStatus(IntEnum):
    """How the QP of a period went (``MotionState.qp_status``)."""

    NOT_RUN = 0
    OPTIMAL = 1
    LIMITED = 2  # re-solved with rows of torque or joint limits
    INFEASIBLE = -1  # the last feasible command, with damping


@dataclass(slots=True)
class WholeBodyCommand:
    """What the joints shall do in this period. A new one every period; joints outside the WBC have effort 0."""

    effort: FloatArray  # (n,) [N·m], within the effort limits
    acceleration: FloatArray  # (n,) [rad/s²]
    position: FloatArray  # (n,) integrated set-points [rad]; measured ones for joints driven by force
    velocity: FloatArray  # (n,) integrated set-points [rad/s]; 0 for joints driven by force
    dcm_reference_in_odom: FloatArray  # (3,) [m]
    desired_foot_forces: FloatArray  # (2,) vertical, left and right, as the QP planned them [N]
    qp_status: QpStatus
    qp_failures: int  # since the controller was made
