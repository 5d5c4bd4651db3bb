"""Command of the Whole-Body Controller, with what its QP planned."""

from dataclasses import dataclass
from enum import IntEnum

from valor.common.arrays import FloatArray
from valor.control.controller import JointCommand


class QpStatus(IntEnum):
    """Result of a period's QP (``MotionState.qp_status``)."""

    NOT_RUN = 0
    OPTIMAL = 1
    LIMITED = 2  # solved again with torque or joint limits
    INFEASIBLE = -1  # the last feasible command, with damping


@dataclass(slots=True)
class WholeBodyCommand(JointCommand):
    """Joint command of a period; joints outside the reduced model have effort 0.

    Positions and velocities are set-points that integrate ``acceleration``; for joints driven by force, the measured
    positions and 0.
    """

    acceleration: FloatArray  # (n,) [rad/s²]
    dcm_reference_in_odom: FloatArray  # (3,) [m]
    desired_foot_forces: FloatArray  # (2,) vertical, left and right, as the QP planned them [N]
    qp_status: QpStatus
    qp_failures: int  # since construction
