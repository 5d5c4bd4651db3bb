"""Valor Escher HW Interface (VEHWI): where the robot's state and the controllers' commands are kept (section 3.5).

Also the claims: a joint's command has one writer, the controller that claimed it. Robot-level controllers may add to
what the writer wrote.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.messages import MotionState, Proprioceptor
from valor.robot.commanded_limits import CommandedLimits, Indices
from valor.robot.description import RobotDescription

PELVIS = "pelvis"
"""Stands for the pelvis' six among the groups of joints."""
HAND_GOAL = "hand_goal"
"""As MotionState says who leads an arm."""
PELVIS_SMOOTHING = 0.04
"""Time constant of the pelvis' velocity, which is taken from its estimated places [s]."""
LONGEST_STEP = 0.02
"""A set-point never moves farther at once than its joint may in this time [s], however late the cycle is."""


class JointClaimError(ValueError):
    """Two controllers want to write the same joint."""


class ValorEscherHWInterface:
    """State and commands of n joints: the robot's, in the order of ``RobotDescription.joints``, then the pelvis' six.

    The pelvis is led as if x, y, z, roll, pitch and yaw were joints, in the frame of ``PelvisSetpoint`` [m, rad].

    Attributes:
        names: (n,) of the joints.
        pelvis: place of the pelvis' first.
        time: robot time of the newest measurement [ns]; 0 before the first.
        measured: the newest Proprioceptor.
        motion: the newest MotionState.
        position, velocity: (n,) measured [rad], [rad/s]; of the pelvis, estimated.
        commanded: (n,) by the Motion System now [rad].
        command: (3, n) ``command_position``, ``command_velocity``, ``command_acceleration``, written by the claimants.
        command_offset: (n,) what robot-level controllers add to the position in this cycle [rad].
        claims: joint → the controller that claimed it; a new object whenever it changes.
        written: (m,) the joints whose commands are sent, ascending; a new object whenever it changes.
        situation: the control mode, or who is silent; for the text of refusals.
        clamped: how often a command had to be brought within a limit.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self._limits = CommandedLimits.of_joints(robot).and_of(CommandedLimits.of_pelvis(robot))
        self.names = self._limits.names
        self.pelvis = len(robot.joints)
        n = len(self.names)
        self.time = 0
        self.measured: Proprioceptor | None = None
        self.motion: MotionState | None = None
        self.position: FloatArray = np.zeros(n)
        self.velocity: FloatArray = np.zeros(n)
        self.commanded: FloatArray = np.zeros(n)
        self.command = np.zeros((3, n))
        self.command_position, self.command_velocity, self.command_acceleration = self.command
        self.command_offset = np.zeros(n)
        self.situation = "nothing heard yet"
        self.clamped = 0
        self.claims: dict[int, str] = {}
        self._writing: dict[str, Indices] = {}
        self.written: Indices = np.zeros(0, dtype=np.intp)
        self._sent = np.zeros(n)  # last set-point of every joint, and when
        self._sent_time = np.full(n, -(2**62), dtype=np.int64)
        self._base: FloatArray = np.zeros(0)  # of the joints written: what the next set-point must not jump from
        self._base_time = 0
        self._select()

    # --- what is heard --------------------------------------------------------------------------------------------

    def take_measurement(self, measured: Proprioceptor) -> None:
        """Store the newest measurement."""
        self.time, self.measured = measured.time, measured
        self.position[: self.pelvis], self.velocity[: self.pelvis] = measured.joint_position, measured.joint_velocity

    def take_motion(self, motion: MotionState) -> None:
        """Store what the Motion System does."""
        seconds = (motion.time - self.motion.time) * 1e-9 if self.motion else 0.0
        self.motion, n = motion, self.pelvis
        self.commanded[:n], self.commanded[n:] = motion.joint_setpoint, motion.pelvis_setpoint
        place, velocity = self.position[n:], self.velocity[n:]
        if seconds > 0.0:
            velocity += (motion.pelvis_in_support - place - seconds * velocity) / max(seconds, PELVIS_SMOOTHING)
        place[:] = motion.pelvis_in_support

    # --- what there is --------------------------------------------------------------------------------------------

    def group_indices(self, groups: Sequence[str]) -> Indices:
        """Places of the joints of groups of robot.yaml, or of the pelvis, in the groups' order."""
        six = np.arange(self.pelvis, self.pelvis + 6)
        return np.concatenate([six if group == PELVIS else self.robot.group_indices(group) for group in groups])

    def limits(self, joints: Indices) -> CommandedLimits:
        """Names and limits of some joints, in their order."""
        return self._limits.select(joints)

    # --- who writes what ------------------------------------------------------------------------------------------

    def claim(self, controller: str, joints: Indices) -> None:
        """Make a controller the one writer of joints.

        Raises:
            JointClaimError: another controller has claimed one of them; nothing has changed.
        """
        for joint in joints.tolist():
            owner = self.claims.get(joint, controller)
            if owner != controller:
                raise JointClaimError(
                    f"{controller} and {owner} both write {self.names[joint]}; expected one writer a joint"
                )
        self.claims = self.claims | dict.fromkeys(joints.tolist(), controller)

    def release(self, controller: str) -> None:
        """Give up a controller's joints."""
        self.claims = {joint: owner for joint, owner in self.claims.items() if owner != controller}
        self.pause(controller)

    def write(self, controller: str, joints: Indices) -> None:
        """The controller's joints are to be sent from now on."""
        if controller not in self._writing:
            self._writing[controller] = joints
            self._select()

    def pause(self, controller: str) -> None:
        """The controller's joints are not to be sent for now."""
        if self._writing.pop(controller, None) is not None:
            self._select()

    def _select(self) -> None:
        """Lay out anew what is sent."""
        self._sent[self.written] = self._base
        self._sent_time[self.written] = self._base_time
        groups = list(self._writing.values())
        self.written = indices = np.sort(np.concatenate(groups)) if groups else np.zeros(0, dtype=np.intp)
        self._selected = self._limits.select(indices)
        # A joint that joins begins where its controller begins, at what the Motion System commands; one that was
        # sent a moment ago goes on from there.
        recent = np.abs(self.time - self._sent_time[indices]) <= LONGEST_STEP * 1e9
        self._base = np.where(recent, self._sent[indices], self.command_position[indices])

    def rectify(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The commands to send: base plus offsets, within limits, without a jump (command rectification).

        No position is farther from the one before than the joint may move in the time between them. A command that
        is not finite leaves the joint where it was.

        Returns:
            (m,) position [rad or m], velocity [1/s], acceleration [1/s²] of the joints ``written``.
        """
        indices, base, limits = self.written, self._base, self._selected
        wanted = self.command_position[indices] + self.command_offset[indices]
        step = limits.fastest * min(max(0, self.time - self._base_time) * 1e-9, LONGEST_STEP) + 1e-9
        self._base_time = self.time
        position = limits.position_within(np.minimum(np.maximum(wanted, base - step), base + step))
        velocity = limits.velocity_within(self.command_velocity[indices])
        acceleration = self.command_acceleration[indices]
        if not np.isfinite(position.sum() + velocity.sum() + acceleration.sum()):
            bad = ~(np.isfinite(position) & np.isfinite(velocity) & np.isfinite(acceleration))
            position[bad], velocity[bad], acceleration[bad] = base[bad], 0.0, 0.0
            self.clamped += int(bad.sum())
        elif not np.array_equal(position, wanted):
            self.clamped += 1
        self._base = position
        return position, velocity, acceleration
