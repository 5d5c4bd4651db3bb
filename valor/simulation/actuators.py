"""What the motors make of a Motor: the law of each joint mode, and the imperfections of an actuator profile."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.messages import JointMode, Motor
from valor.robot.description import RobotDescription
from valor.robot.tables import ActuatorProfile
from valor.simulation.gears import Gears


@dataclass(frozen=True)
class JointCommand:
    """A Motor, its modes resolved: effort + stiffness·(position − q) + damping·(velocity − q̇), arrays of (n,)."""

    sequence: int  # of the Motor; that of the last one while the joints are held
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    stiffness: FloatArray
    damping: FloatArray


class Actuators:
    """The motors of all joints, in physics steps.

    Commands act after the profile's delay. Then, each step::

        e = backlash(q* − q)                      dead zone
        u = effort + kp·e + kd·(q̇* − q̇)          gains by mode: none, servo, commanded, commanded damping;
                                                  no effort where the device does not take any
        u = clip(u, ±effort limit), and none that speeds a joint up beyond its velocity limit
        u ← strength·u                            a motor that is not what it was
        τ ← τ + (1 − exp(−dt/T))·(u − τ)          first-order lag of time constant T

    Coulomb friction belongs to the plant, where MuJoCo solves for it.

    Attributes:
        effort: (n,) what acts on the joints [N·m].
        motor_sequence: of the Motor that acts; 0: none yet.
    """

    def __init__(self, robot: RobotDescription, profile: ActuatorProfile, step: float) -> None:
        n = len(robot.joints)
        self._robot = robot
        self._delay = round(profile.delay / step)
        gears = Gears.of(robot, profile)
        self._half_backlash, self._has_backlash = gears.half_backlash, bool(gears.half_backlash.any())
        self._feed_forward = gears.feed_forward
        self._strength, self._is_weak = gears.strength, bool((gears.strength < 1.0).any())
        self._gain = 1.0 - math.exp(-step / profile.torque_lag) if profile.torque_lag > 0 else 1.0
        self._highest, self._lowest = robot.effort_limit, -robot.effort_limit
        self._velocity_limit = robot.velocity_limit
        self._modes = b""
        self._step = 0
        self._waiting: deque[tuple[int, JointCommand]] = deque()
        self._command = JointCommand(0, *(np.zeros(n) for _ in range(5)))
        self._error, self._wanted = np.zeros(n), np.zeros(n)
        self.effort = np.zeros(n)

    @property
    def motor_sequence(self) -> int:
        """Sequence of the Motor that acts; 0: none yet."""
        return self._command.sequence

    def obey(self, motor: Motor) -> None:
        """Hand a sound Motor to the motors; set-points beyond the joints' limits are clamped."""
        if motor.mode.tobytes() != self._modes:  # they seldom change
            self._modes = motor.mode.tobytes()
            position, impedance, force = (
                (motor.mode == mode).astype(np.float64)
                for mode in (JointMode.POSITION, JointMode.IMPEDANCE, JointMode.FORCE)
            )
            self._own_stiffness = position * self._robot.servo_stiffness
            self._own_damping = position * self._robot.servo_damping
            self._compliant, self._damped = impedance, impedance + force
            self._tracking = position + impedance
            self._driven = (position + impedance + force) * self._feed_forward
        position = np.maximum(motor.position, self._robot.lower)
        self._send(
            JointCommand(
                sequence=motor.sequence,
                position=np.minimum(position, self._robot.upper, out=position),
                velocity=motor.velocity * self._tracking,
                effort=motor.effort * self._driven,
                stiffness=self._own_stiffness + self._compliant * motor.stiffness,
                damping=self._own_damping + self._damped * motor.damping,
            )
        )

    def hold(self, position: FloatArray, effort: FloatArray | None = None) -> None:
        """Hold the joints at a (n,) position [rad] on their own servos, beside a (n,) effort [N·m] that goes on.

        Without the effort that carried it, a joint sags until its servo carries as much.
        """
        last = self._waiting[-1][1] if self._waiting else self._command
        zero = np.zeros_like(position)
        self._send(
            JointCommand(
                last.sequence,
                position,
                zero,
                zero if effort is None else effort * self._feed_forward,
                self._robot.servo_stiffness,
                self._robot.servo_damping,
            )
        )

    def update(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """One physics step: the (n,) effort [N·m] at joint position [rad] and velocity [rad/s]."""
        while self._waiting and self._waiting[0][0] <= self._step:
            self._command = self._waiting.popleft()[1]
        self._step += 1
        command, error, wanted = self._command, self._error, self._wanted
        np.subtract(command.position, position, out=error)
        if self._has_backlash:
            error -= np.clip(error, -self._half_backlash, self._half_backlash)
        np.multiply(command.stiffness, error, out=wanted)
        np.subtract(command.velocity, velocity, out=error)
        error *= command.damping
        wanted += error
        wanted += command.effort
        np.minimum(wanted, self._highest, out=wanted)
        np.maximum(wanted, self._lowest, out=wanted)
        np.abs(velocity, out=error)
        if (error > self._velocity_limit).any():
            wanted[(error > self._velocity_limit) & (wanted * velocity > 0)] = 0.0
        if self._is_weak:
            wanted *= self._strength
        wanted -= self.effort
        wanted *= self._gain
        self.effort += wanted
        return self.effort

    def _send(self, command: JointCommand) -> None:
        self._waiting.append((self._step + self._delay, command))
