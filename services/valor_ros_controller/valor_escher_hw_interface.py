"""Valor Escher HW Interface (VEHWI): the robot's state and the controllers' commands (thesis section 3.5)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.messages import BatteryStatus, ControllerStatus, MotionState, Proprioceptor
from valor.robot.commanded_limits import CommandedLimits, Indices
from valor.robot.description import RobotDescription

if TYPE_CHECKING:
    from valor.control.controller import JointCommand

PELVIS = "pelvis"  # group of the pelvis' six joints
HAND_GOAL = "hand_goal"  # controller of an arm in MotionState
PELVIS_SMOOTHING = 0.04  # time constant of the pelvis' velocity, differentiated from estimated positions [s]
LONGEST_STEP = 0.02  # largest motion of a set-point per cycle, as time at the joint's speed limit [s]


class JointClaimError(ValueError):
    """Joint claimed by two controllers."""


class ValorEscherHWInterface:
    """State and commands of n joints: the robot's, in the order of ``RobotDescription.joints``, then the pelvis' six.

    The pelvis' joints are x, y, z, roll, pitch and yaw in the frame of ``PelvisSetpoint`` [m, rad]. A joint's command
    has one writer, the controller that claimed it; controllers of offsets add to its position.

    Attributes:
        position, velocity: (n,) measured, of the pelvis estimated [rad or m, 1/s].
        command: (3, n) ``command_position``, ``command_velocity``, ``command_acceleration``, written by the claimants.
        command_offset: (n,) added to ``command_position`` [rad or m].
        written: (m,) joints whose commands are sent, ascending; a new object on each change.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self._limits = CommandedLimits.of_joints(robot).and_of(CommandedLimits.of_pelvis(robot))
        self.names = self._limits.names  # (n,) of the joints
        self.pelvis = len(robot.joints)  # index of the pelvis' first joint
        n = len(self.names)
        self.time = 0  # robot time of the latest measurement [ns]; 0 before the first
        self.measured: Proprioceptor | None = None  # latest Proprioceptor
        self.motion: MotionState | None = None  # latest MotionState
        self.position: FloatArray = np.zeros(n)
        self.velocity: FloatArray = np.zeros(n)
        self.battery: BatteryStatus | None = None  # latest BatteryStatus
        self.balance_controllers: ControllerStatus | None = None  # the Motion Manager's, latest status
        self.estimate_needed = False  # whether a cycle waits for the MotionState of its measurement
        # Of a balance controller in this cycle: joints, command, and duration of the computation [s].
        self.joint_command: tuple[Indices, JointCommand, float] | None = None
        self.frozen: tuple[str, ...] = ()  # limbs that the Motion System has frozen
        self.commanded: FloatArray = np.zeros(n)  # (n,) current set-points of the Motion System [rad or m]
        self.command = np.zeros((3, n))
        self.command_position, self.command_velocity, self.command_acceleration = self.command
        self.command_offset = np.zeros(n)
        self.situation = "nothing received yet"  # control mode, or silent process; for texts of rejections
        self.clamped = 0  # number of commands brought within limits
        self.claims: dict[int, str] = {}  # controller by joint; a new object on each change
        self._writing: dict[str, Indices] = {}
        self.written: Indices = np.zeros(0, dtype=np.intp)
        self._sent = np.zeros(n)  # last set-point of each joint; time below
        self._sent_time = np.full(n, -(2**62), dtype=np.int64)
        self._base: FloatArray = np.zeros(0)  # last set-points of the written joints
        self._base_time = 0
        self._select()

    @property
    def low_battery(self) -> str:
        """Warning of a low charge; empty without one."""
        table, status = self.robot.tables.batteries, self.battery
        share = status.charge / table.whole if table and status else 1.0
        return f"batteries at {share:.0%}" if table and share < table.low else ""

    def store_measurement(self, measured: Proprioceptor) -> None:
        self.time, self.measured = measured.time, measured
        self.position[: self.pelvis], self.velocity[: self.pelvis] = measured.joint_position, measured.joint_velocity

    def store_motion(self, motion: MotionState) -> None:
        seconds = (motion.time - self.motion.time) * 1e-9 if self.motion else 0.0
        self.motion, n = motion, self.pelvis
        self.commanded[:n], self.commanded[n:] = motion.joint_setpoint, motion.pelvis_setpoint
        place, velocity = self.position[n:], self.velocity[n:]
        if seconds > 0.0:
            velocity += (motion.pelvis_in_support - place - seconds * velocity) / max(seconds, PELVIS_SMOOTHING)
        place[:] = motion.pelvis_in_support

    def held(self, joints: Indices) -> FloatArray:
        """Current set-points of the Motion System, less the offsets that are added to commands [rad or m]."""
        return self.commanded[joints] - self.command_offset[joints]

    def group_indices(self, groups: Sequence[str]) -> Indices:
        """Indices of the joints of robot.yaml's groups or the pelvis, in the order of ``groups``."""
        six = np.arange(self.pelvis, self.pelvis + 6)
        return np.concatenate([six if group == PELVIS else self.robot.group_indices(group) for group in groups])

    def limits(self, joints: Indices) -> CommandedLimits:
        """Names and limits of joints, in their order."""
        return self._limits.select(joints)

    def claim(self, controller: str, joints: Indices) -> None:
        """Make a controller the only writer of joints.

        Raises JointClaimError: another controller has claimed one of them; nothing changed.
        """
        for joint in joints.tolist():
            owner = self.claims.get(joint, controller)
            if owner != controller:
                raise JointClaimError(
                    f"{controller} and {owner} both write {self.names[joint]}; expected one writer per joint"
                )
        self.claims = self.claims | dict.fromkeys(joints.tolist(), controller)

    def release(self, controller: str) -> None:
        self.claims = {joint: owner for joint, owner in self.claims.items() if owner != controller}
        self.pause(controller)

    def write(self, controller: str, joints: Indices) -> None:
        """Send the controller's joints from now on."""
        if controller not in self._writing:
            self._writing[controller] = joints
            self._select()

    def pause(self, controller: str) -> None:
        """Stop sending the controller's joints."""
        if self._writing.pop(controller, None) is not None:
            self._select()

    def _select(self) -> None:
        self._sent[self.written] = self._base
        self._sent_time[self.written] = self._base_time
        groups = list(self._writing.values())
        self.written = indices = np.sort(np.concatenate(groups)) if groups else np.zeros(0, dtype=np.intp)
        self._selected = self._limits.select(indices)
        # A joint begins at its controller's start, the Motion System's set-point; one sent recently continues.
        recent = np.abs(self.time - self._sent_time[indices]) <= LONGEST_STEP * 1e9
        self._base = np.where(recent, self._sent[indices], self._wanted())

    def _wanted(self) -> FloatArray:
        return self.command_position[self.written] + self.command_offset[self.written]

    def rectify(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Commands to send, with offsets, within limits and without jumps (command rectification).

        A position moves at most as far as the joint can in the time since the last one. A command that is not finite is
        replaced by the last one.

        Returns:
            (m,) position [rad or m], velocity [1/s] and acceleration [1/s²] of the ``written`` joints.
        """
        indices, base, limits = self.written, self._base, self._selected
        wanted = self._wanted()
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
