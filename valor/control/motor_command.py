"""Motor of a control period, with the last check of every joint command."""

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
from valor.control.controller import JointCommand
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints
from valor.robot.tables import WHOLE_BODY_GROUPS

Modes = npt.NDArray[np.uint8]  # (n,) of JointMode


@dataclass(frozen=True, slots=True)
class Drive:
    """Mode and gains of the motors, (n,) each."""

    mode: Modes
    stiffness: FloatArray  # [N·m/rad]
    damping: FloatArray  # [N·m·s/rad]


class MotorCommand:
    """Vectors of a Motor, (n,) each, written every period by one of the methods below.

    Force-controlled and impedance-controlled joints are *compliant*; the others have a position servo. Joints moved by
    the Whole-Body Controller get the set-points that it integrates (thesis 3.4.2).
    """

    def __init__(self, robot: RobotDescription) -> None:
        n = len(robot.joints)
        control = np.array([joint.control for joint in robot.tables.joints.values()])
        self.force: Joints = control == "force"
        self.impedance: Joints = control == "impedance"
        self._compliant: Joints = self.force | self.impedance
        moved = [robot.index[name] for group in WHOLE_BODY_GROUPS for name in robot.tables.group(group)]
        self._led: Joints = self._compliant.copy()  # of the Whole-Body Controller
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
        )  # of the last command
        self._limp = Drive(self._modes(force, force, off), nothing, np.where(self._compliant, damping, 0.0))
        self._zeros = nothing
        # Position, velocity, effort; of the controller's joints: position, velocity, compensation; gains; measured.
        self._asked, self._checked, self._checks = np.zeros((10, n)), np.zeros((4, n)), np.zeros(2)
        self._measured, self._unknown = np.full((2, n), np.nan), np.full((2, n), np.nan)
        self._check = Kernel("command", self._expressions, (self._asked,), (self._checked, self._checks))
        self.saturations = 0  # joint commands at or above an effort limit, since start
        self.replaced = 0  # commands that were not finite, replaced by the last valid one, since start
        self.drive = self._limp
        self.velocity = self.effort = nothing
        self.position: FloatArray = self._limits.position_within(nothing)
        self.wanted = self.position  # desired positions [rad]: ``position`` without the servos' compensation

    def _modes(self, force: JointMode, impedance: JointMode, position: JointMode) -> Modes:
        """(n,) modes, from one mode for each kind of control."""
        return np.where(self.force, force, np.where(self.impedance, impedance, position)).astype(np.uint8)

    def measure(self, position: FloatArray, velocity: FloatArray) -> None:
        """Set the measured (n,) positions and velocities [rad, rad/s], at which servos keep the limits."""
        self._measured[:] = position, velocity

    def limp(self, measured: FloatArray) -> None:
        """Command no effort, only damping; joints with a position servo are off."""
        self._set(self._limp, measured, self._zeros, self._zeros)

    def hold(self, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> None:
        """Command every joint by its servo gains, around a reference and an effort [rad, rad/s, N·m]."""
        self._set(self._servo, position, velocity, effort)

    def land(self, position: FloatArray, velocity: FloatArray, stiffness: FloatArray) -> None:
        """Command every joint by a servo of (n,) ``stiffness`` [N·m/rad]; position servos have their own."""
        self._set(Drive(self._servo.mode, stiffness, self._servo.damping), position, velocity, self._zeros)

    def balance(
        self,
        command: JointCommand,
        position: FloatArray,
        velocity: FloatArray,
        effort: FloatArray,
        share: float,
        *,
        offsets: FloatArray | None = None,
        held: Joints | None = None,
    ) -> None:
        """Command a controller's output with weight ``share``, blended with ``hold`` without a jump.

        (n,) position, velocity and effort are those of ``hold``, and of joints that the controller does not move. (n,)
        ``offsets`` compensate the servos: they are added to the controller's set-points [rad]. (n,) mask ``held``:
        joints that have ``hold`` instead where they are driven by force, with the controller's effort.
        """
        drive = self._drive(command)
        offsets = self._zeros if offsets is None else offsets
        led_position, led_velocity, compliant_effort = command.position, command.velocity, command.effort
        if share < 1.0:
            rest = 1.0 - share
            servo = self._servo
            drive = Drive(
                servo.mode,
                np.where(self.force, share * drive.stiffness + rest * servo.stiffness, drive.stiffness),
                np.where(self.force, share * drive.damping + rest * servo.damping, drive.damping),
            )
            led_position = np.where(self.force, position, share * command.position + rest * position)
            led_velocity = np.where(self.force, velocity, share * command.velocity + rest * velocity)
            compliant_effort = share * command.effort + rest * effort
            offsets = share * offsets
        if held is not None and (by_servo := held & self.force).any():
            servo = self._servo
            drive = Drive(
                np.where(by_servo, servo.mode, drive.mode),
                np.where(by_servo, servo.stiffness, drive.stiffness),
                np.where(by_servo, servo.damping, drive.damping),
            )
            led_position, led_velocity = np.where(by_servo, (position, velocity), (led_position, led_velocity))
        self._set(drive, position, velocity, compliant_effort, (led_position, led_velocity, offsets))

    def _drive(self, command: JointCommand) -> Drive:
        """The command's gains; joints driven by force have a servo only where they have gains."""
        last = self._operation
        if command.stiffness is not last.stiffness or command.damping is not last.damping:
            by_force = self.force & (command.stiffness == 0.0) & (command.damping == 0.0)
            mode = np.where(by_force, JointMode.FORCE, self._servo.mode).astype(np.uint8)
            self._operation = Drive(mode, command.stiffness, command.damping)
        return self._operation

    def repeat(self) -> None:
        """Repeat the last command, with zero velocity and damping: for a period without a valid command."""
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
        """Accept a finite command, clamped to the limits; else repeat the last. ``led``: of the QP's joints."""
        self._asked[8:] = self._unknown if led is None else self._measured
        led = led or (position, velocity, self._zeros)
        given = (position, velocity, effort, *led, drive.stiffness, drive.damping)
        np.concatenate(given, out=self._asked[:8].reshape(-1))
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
        """(4, n) ``position``, ``velocity``, ``effort``, ``wanted``; (2,) sum of squares, efforts at a limit."""
        position, velocity, effort, *led, offsets, stiffness, damping, q, rate = (asked[i, :] for i in range(10))
        joints = np.flatnonzero(self._led).tolist()
        position[joints], velocity[joints] = led[0][joints], led[1][joints]
        # Before clamping, which would hide a number that is not finite.
        squares = ca.sumsqr(position) + ca.sumsqr(velocity) + ca.sumsqr(effort) + ca.sumsqr(offsets)
        compliant = np.flatnonzero(self._compliant).tolist()
        limit = ca.DM(self._limits.effort).T[compliant]
        limited, most = ca.SX(1, effort.shape[1]), ca.DM(self._limits.effort).T
        limited[compliant] = clipped(effort[compliant], -limit, limit)
        lower, upper = ca.DM(self._limits.lower).T, ca.DM(self._limits.upper).T
        sent, wanted = clipped(position + offsets, lower, upper), clipped(position, lower, upper)
        # A servo whose torque would exceed the limit gets a set-point nearer to where the joint is.
        own = limited + damping * (velocity - rate)
        bounded = q + (clipped(own + stiffness * (sent - q), -most, most) - own) / stiffness
        strong = ca.fabs(own + stiffness * (sent - q)) > most
        served = ca.DM(self._compliant.astype(float)).T * (stiffness > 0.0)
        sent = ca.if_else(strong * served, clipped(bounded, lower, upper), sent)
        beyond = ca.sum2(ca.fabs(effort[compliant]) >= limit)
        return ca.vertcat(sent, velocity, limited, wanted), ca.vertcat(squares, beyond)

    def message(self, time: int, sequence: int, proprioceptor_sequence: int, behavior: str) -> Motor:
        """Return the command as a Motor, computed in a behavior."""
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
