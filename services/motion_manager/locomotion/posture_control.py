"""The joints by their servos, in Idle, Stand Prep and Freeze: hold where they are, or move to the nominal posture.

A servo carries the robot's weight only by a position error, so that taking a standing robot over would let it sag.
Instead the effort that a joint had is kept beside its servo, and wears off while the joint moves to the posture.
"""

from __future__ import annotations

import numpy as np

from valor.common.arrays import FloatArray
from valor.motion_manager.joints.joint_reference import JointReference
from valor.robot.description import RobotDescription
from valor.robot.posture_move import PostureMove
from valor.whole_body.motor_command import MotorCommand

SETTLING = 0.3  # after a move, until the posture counts as reached [s]
AT_REST = 0.3  # joints slower than this have settled [rad/s]


class PostureControl:
    """Fills the command of behaviors without balance control. Times are robot time [s]."""

    def __init__(self, robot: RobotDescription, reference: JointReference, command: MotorCommand) -> None:
        self._robot = robot
        self._reference = reference
        self._command = command
        self._everything = np.ones(len(robot.joints), dtype=bool)
        self._effort = np.zeros(len(robot.joints))  # kept beside the servos
        self._move: PostureMove | None = None

    def take_up(self, position: FloatArray, effort: FloatArray) -> None:
        """Hold every joint where it is found, with the effort that it was found with."""
        self._move = None
        self._reference.take_up(self._everything, position)
        self._effort = self._bounded(effort)

    def take_over(self, position: FloatArray) -> None:
        """Take the joints over from the Whole-Body Controller with the efforts that it commanded last.

        Joints driven by force had no position command and are held where they are, ``position`` (n,) [rad]; those
        with a set-point keep it.
        """
        self._move = None
        command, reference = self._command, self._reference
        # While the Whole-Body Controller was still taking over, the servos had a part of the torque.
        by_servo = np.where(command.force, command.drive.stiffness * (command.position - position), 0.0)
        self._effort = self._bounded(command.effort + by_servo)
        reference.take_up(command.force, position)
        reference.take_up(command.impedance, command.position)
        reference.hold(self._everything)

    def hold(self, now: float) -> None:
        """Brake and stay."""
        self._effort = self.effort(now)
        self._move = None
        self._reference.hold(self._everything)

    def prepare(self, now: float) -> None:
        """Move every joint to the nominal posture."""
        self._move = self._reference.move(self._everything, self._robot.nominal_posture, now)

    def _bounded(self, effort: FloatArray) -> FloatArray:
        return np.clip(effort, -self._robot.effort_limit, self._robot.effort_limit)

    def effort(self, now: float) -> FloatArray:
        """(n,) still kept beside the servos [N·m]."""
        return self._effort if self._move is None else (1.0 - self._move.gone(now)) * self._effort

    def not_arrived(self, now: float, joint_velocity: FloatArray) -> str:
        """Why the nominal posture is not reached yet; an empty text: it is."""
        if self._move is None:
            return "stand_prep has not begun"
        left = self._move.remaining(now)
        if left > 0.0:
            return f"stand_prep has {left + SETTLING:.1f} s to go"
        if self._move.since_arrival(now) < SETTLING:
            return f"stand_prep has {SETTLING - self._move.since_arrival(now):.1f} s to go"
        # A finger that trembles against something keeps nobody from standing.
        fastest = int(np.argmax(self._command.force * np.abs(joint_velocity)))
        if (speed := abs(float(joint_velocity[fastest]))) > AT_REST:
            return (
                f"stand_prep has not settled: joint {self._robot.joints[fastest]!r} moves at {speed:.2f} rad/s; "
                f"expected at most {AT_REST} rad/s"
            )
        return ""

    def drive(self, now: float) -> None:
        """Fill the command of this period."""
        self._command.hold(self._reference.position, self._reference.velocity, self.effort(now))
