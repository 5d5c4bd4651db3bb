"""Drivers without balance control: Idle, Stand Prep and Freeze by the joints' servos, Fall without effort.

A servo carries weight only by a position error, so a standing robot would sag when its servos take over. Therefore
each joint keeps its effort as feed-forward, which fades while the joint moves to the nominal posture.
"""

from typing import ClassVar

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Locomotion, Reaction
from valor.control.motor_command import MotorCommand
from valor.control.state import RobotState
from valor.motion_manager.joints.joint_reference import JointReference
from valor.motion_manager.locomotion.driver import Driver, Release
from valor.robot.description import RobotDescription
from valor.robot.posture_move import PostureMove

SETTLING = 0.3  # after a move, until the posture counts as reached [s]
AT_REST = 0.3  # speed below which a joint has settled [rad/s]


class PostureControl:
    """Command of behaviors without balance control. Times are robot time [s]."""

    def __init__(self, robot: RobotDescription, reference: JointReference, command: MotorCommand) -> None:
        self._robot = robot
        self._reference = reference
        self._command = command
        self._everything = np.ones(len(robot.joints), dtype=bool)
        self._effort = np.zeros(len(robot.joints))  # feed-forward
        self._move: PostureMove | None = None

    def take_up(self, position: FloatArray, effort: FloatArray) -> None:
        """Hold every joint at its measured (n,) position [rad] with its measured effort [N·m]."""
        self._move = None
        self._reference.take_up(self._everything, position)
        self._effort = self._bounded(effort)

    def take_over(self, position: FloatArray) -> None:
        """Take over with the last efforts; joints driven by force are held at ``position`` (n,) [rad]."""
        self._move = None
        command, reference = self._command, self._reference
        # Before the Whole-Body Controller has full control, the servos supply a part of the torque.
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
        """(n,) feed-forward [N·m]."""
        return self._effort if self._move is None else (1.0 - self._move.gone(now)) * self._effort

    def not_arrived(self, now: float, joint_velocity: FloatArray) -> str:
        """Reason why the nominal posture is not reached yet; empty if it is."""
        if self._move is None:
            return "stand_prep has not started"
        left = self._move.remaining(now)
        if left > 0.0:
            return f"stand_prep has {left + SETTLING:.1f} s to go"
        if self._move.since_arrival(now) < SETTLING:
            return f"stand_prep has {SETTLING - self._move.since_arrival(now):.1f} s to go"
        # Only joints driven by force count: a trembling finger must not prevent Stand.
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


class FallDriver(Driver):
    """No effort, only damping; after a landing, if the fall was detected and limp joints are not demanded."""

    states: ClassVar[tuple[Locomotion, ...]] = (Locomotion.FALL,)
    release = Release.LIMP

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        self.components.exchange.end()
        self.components.landing.active = False
        if before is not None and self.components.falling:
            self.components.landing.begin(state, now)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        command, landing = self.components.command, self.components.landing
        landing.update(now, dt)
        if landing.active and self.components.device_reactions.demand is not Reaction.LIMP:
            command.land(landing.position, landing.velocity, landing.stiffness)
        else:
            command.limp(state.joint_position)


class HoldDriver(Driver):
    """Servos hold the joints where they were found or came to rest."""

    states: ClassVar[tuple[Locomotion, ...]] = (Locomotion.IDLE, Locomotion.FREEZE)
    release = Release.HELD

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        self.components.exchange.end()
        posture = self.components.posture
        if before is None:
            posture.take_up(state.joint_position, state.joint_effort)
        elif before.release is Release.LIMP:
            posture.take_up(state.joint_position, np.zeros_like(state.joint_effort))
        elif before.release is Release.HELD:
            posture.hold(now)
        else:
            posture.take_over(state.joint_position)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        self.components.posture.drive(now)


class StandPrepDriver(HoldDriver):
    """Servos move the joints to the nominal posture, and hold them there."""

    states: ClassVar[tuple[Locomotion, ...]] = (Locomotion.STAND_PREP,)

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        super().enter(before, state, now)
        self.components.posture.prepare(now)

    def not_prepared(self, state: RobotState, now: float) -> str:
        """Reason why the nominal posture is not reached; empty if it is."""
        return self.components.posture.not_arrived(now, state.joint_velocity)
