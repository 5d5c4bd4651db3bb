"""One command for every motor: what it is made of in each kind of control, and the last check before it leaves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from time import monotonic_ns

import casadi as ca
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, clipped
from valor.common.messages import JointMode, Motor
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints
from valor.robot.tables import WHOLE_BODY_GROUPS
from valor.whole_body.state import WholeBodyCommand

Modes = npt.NDArray[np.uint8]  # (n,) of JointMode


@dataclass(frozen=True, slots=True)
class Drive:
    """How the motors are driven, (n,) each."""

    mode: Modes
    stiffness: FloatArray  # [N·m/rad]
    damping: FloatArray  # [N·m·s/rad]


class MotorCommand:
    """The vectors of a Motor, (n,) each, filled anew every period by one of the methods below.

    Force-controlled and impedance-controlled joints are *compliant*; the rest have a position servo of their own. Those
    of them that the Whole-Body Controller moves get the set-points that it integrates (thesis 3.4.2).

    Attributes:
        force: which joints are driven by force alone in operation.
        impedance: which are driven by impedance.
        saturations: joint commands at or beyond an effort limit, since start.
        replaced: commands that were not finite and were replaced by the last good one, since start.
        wanted: where joints shall be: ``position`` without what makes up for what their servos leave undone [rad].
    """

    def __init__(self, robot: RobotDescription) -> None:
        n = len(robot.joints)
        control = np.array([joint.control for joint in robot.tables.joints.values()])
        self.force: Joints = control == "force"
        self.impedance: Joints = control == "impedance"
        self._compliant: Joints = self.force | self.impedance
        moved = [robot.index[name] for group in WHOLE_BODY_GROUPS for name in robot.tables.group(group)]
        self._led: Joints = self._compliant.copy()  # by the Whole-Body Controller
        self._led[moved] = True
        self._limits = CommandedLimits.of_joints(robot)
        self._began = monotonic_ns()
        stiffness, damping, nothing = robot.servo_stiffness, robot.servo_damping, np.zeros(n)
        servo, force, off = JointMode.POSITION, JointMode.FORCE, JointMode.OFF
        self._servo = Drive(self._modes(JointMode.IMPEDANCE, JointMode.IMPEDANCE, servo), stiffness, damping)
        self._operation = Drive(
            self._modes(force, JointMode.IMPEDANCE, servo),
            np.where(self.force, 0.0, stiffness),
            np.where(self.force, 0.0, damping),
        )
        self._limp = Drive(self._modes(force, force, off), nothing, np.where(self._compliant, damping, 0.0))
        self._zeros = nothing
        self._asked, self._checked, self._checks = np.zeros((6, n)), np.zeros((4, n)), np.zeros(2)
        self._check = Kernel("command", self._expressions, (self._asked,), (self._checked, self._checks))
        self.saturations = 0
        self.replaced = 0
        self.drive = self._limp
        self.velocity = self.effort = nothing
        self.position: FloatArray = self._limits.position_within(nothing)
        self.wanted = self.position

    def _modes(self, force: JointMode, impedance: JointMode, position: JointMode) -> Modes:
        """(n,) one mode for each way that joints are driven in operation."""
        return np.where(self.force, force, np.where(self.impedance, impedance, position)).astype(np.uint8)

    def set_gains(self, stiffness: FloatArray, damping: FloatArray) -> None:
        """Gains (n,) of the joints driven by impedance in operation [N·m/rad, N·m·s/rad]."""
        self._operation = Drive(
            self._operation.mode, np.where(self.force, 0.0, stiffness), np.where(self.force, 0.0, damping)
        )

    def limp(self, measured: FloatArray) -> None:
        """No effort, only damping against motion; joints with a position servo of their own are off."""
        self._set(self._limp, measured, self._zeros, self._zeros)

    def hold(self, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> None:
        """Every joint by its servo gains, around a reference and an effort [rad, rad/s, N·m]."""
        self._set(self._servo, position, velocity, effort)

    def balance(
        self,
        command: WholeBodyCommand,
        position: FloatArray,
        velocity: FloatArray,
        effort: FloatArray,
        share: float,
        *,
        offsets: FloatArray | None = None,
    ) -> None:
        """The Whole-Body Controller's command, which takes over from ``hold`` bit by bit.

        The torque of a joint goes linearly from one to the other, so that it does not jump at either end.

        Args:
            command: what the Whole-Body Controller wants.
            position: (n,) the reference that ``hold`` had, and that joints which it does not move go on with [rad].
            velocity: (n,) likewise [rad/s].
            effort: (n,) likewise [N·m].
            share: of the Whole-Body Controller, 0 to 1.
            offsets: (n,) to the Whole-Body Controller's set-points, that make up for the servos [rad]; None: none.
        """
        drive = self._operation
        offsets = self._zeros if offsets is None else offsets
        led_position, led_velocity, compliant_effort = command.position, command.velocity, command.effort
        if share < 1.0:
            rest = 1.0 - share
            servo = self._servo
            drive = Drive(
                servo.mode,
                np.where(self.force, rest * servo.stiffness, servo.stiffness),
                np.where(self.force, rest * servo.damping, servo.damping),
            )
            led_position = np.where(self.force, position, share * command.position + rest * position)
            led_velocity = np.where(self.force, velocity, share * command.velocity + rest * velocity)
            compliant_effort = share * command.effort + rest * effort
            offsets = share * offsets
        self._set(drive, position, velocity, compliant_effort, (led_position, led_velocity, offsets))

    def repeat(self) -> None:
        """The last command once more, at rest and with damping: for a period without a better one."""
        self.velocity = self._zeros
        drive = self.drive
        self.drive = Drive(drive.mode, drive.stiffness, np.maximum(drive.damping, self._limp.damping))

    def _set(
        self,
        drive: Drive,
        position: FloatArray,
        velocity: FloatArray,
        effort: FloatArray,
        led: tuple[FloatArray, FloatArray, FloatArray] | None = None,
    ) -> None:
        """Take a command if it is finite, within the limits of positions and efforts; else repeat the last.

        Args:
            drive: how.
            position: (n,) [rad].
            velocity: (n,) [rad/s].
            effort: (n,) of compliant joints; of the others unused [N·m].
            led: (n,) position, velocity and offset of joints that the Whole-Body Controller leads; None: as the others.
        """
        led = led or (position, velocity, self._zeros)
        np.concatenate((position, velocity, effort, *led), out=self._asked.reshape(-1))
        self._check()
        squares, beyond = self._checks.tolist()
        if not math.isfinite(squares):
            self.replaced += 1
            self.repeat()
            return
        self.saturations += int(beyond)
        self.drive = drive
        self.position, self.velocity, self.effort, self.wanted = self._checked.copy()

    def _expressions(self, asked: Expression) -> Sequence[Expression]:
        """(4, n) ``position``, ``velocity``, ``effort``, ``wanted``; (2,) squares of all, and efforts at a limit."""
        position, velocity, effort, *led, offsets = (asked[i, :] for i in range(6))
        joints = np.flatnonzero(self._led).tolist()
        position[joints], velocity[joints] = led[0][joints], led[1][joints]
        # Of what is asked for: no limit hides one.
        squares = ca.sumsqr(position) + ca.sumsqr(velocity) + ca.sumsqr(effort) + ca.sumsqr(offsets)
        compliant = np.flatnonzero(self._compliant).tolist()
        limit = ca.DM(self._limits.effort).T[compliant]
        limited = ca.SX(1, effort.shape[1])
        limited[compliant] = clipped(effort[compliant], -limit, limit)
        lower, upper = ca.DM(self._limits.lower).T, ca.DM(self._limits.upper).T
        told, wanted = clipped(position + offsets, lower, upper), clipped(position, lower, upper)
        beyond = ca.sum2(ca.fabs(effort[compliant]) >= limit)
        return ca.vertcat(told, velocity, limited, wanted), ca.vertcat(squares, beyond)

    def message(self, time: int, sequence: int, proprioceptor_sequence: int, behavior: str) -> Motor:
        """The command as a Motor, made in a behavior."""
        return Motor(
            time=time,
            sequence=sequence,
            proprioceptor_sequence=proprioceptor_sequence,
            mode=self.drive.mode,
            position=self.position,
            velocity=self.velocity,
            effort=self.effort,
            stiffness=self.drive.stiffness,
            damping=self.drive.damping,
            behavior=behavior,
            writer=self._began,
        )
