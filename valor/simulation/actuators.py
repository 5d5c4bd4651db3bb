"""Motors of the simulated robot: control law of each joint mode, and imperfections of an actuator profile."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.messages import JointMode, Motor
from valor.devices.dynamixel import Dynamixel
from valor.robot.description import RobotDescription
from valor.robot.tables import ActuatorProfile, Gear
from valor.simulation.springs import SeriesElastic


@dataclass(frozen=True)
class Gears:
    """Gears of all joints; (n,) each."""

    friction: FloatArray  # Coulomb, at the joint [N·m]
    sticks: npt.NDArray[np.bool_]  # the friction is of the joint's own gear, and holds it at rest
    half_backlash: FloatArray  # motion to either side before the motor's stiffness acts [rad]
    feed_forward: FloatArray  # 1 if the device applies Motor's effort, 0 if only position and velocity
    strength: FloatArray  # fraction of the motor's torque at the joint, 0 to 1

    @classmethod
    def of(cls, robot: RobotDescription, profile: ActuatorProfile) -> Self:
        """Gears of a profile: the joint's values, else its group's, else the common ones."""
        groups = {joint: group for group, joints in robot.tables.groups.items() for joint in joints}
        common = Gear()
        gears = [
            profile.gears.get(joint) or profile.gears.get(groups.get(joint, "")) or common for joint in robot.joints
        ]
        friction = np.minimum(profile.friction, profile.friction_share * robot.effort_limit)
        sticks = np.array([gear.friction is not None for gear in gears])
        friction[sticks] = [gear.friction for gear in gears if gear.friction is not None]
        return cls(
            friction,
            sticks,
            np.array([0.5 * (profile.backlash if gear.backlash is None else gear.backlash) for gear in gears]),
            np.array([float(gear.feed_forward) for gear in gears]),
            np.array([gear.strength for gear in gears]),
        )


@dataclass(frozen=True)
class JointCommand:
    """A Motor, its modes resolved: effort + stiffness·(position − q) + damping·(velocity − q̇), arrays of (n,)."""

    sequence: int  # of the Motor; of the last one while the joints are held
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    stiffness: FloatArray
    damping: FloatArray


class Actuators:
    """Motors of all joints, in physics steps.

    Commands act after the profile's delay. Then, each step::

        e = backlash(q* − q)                      dead zone
        u = effort + kp·e + kd·(q̇* − q̇)          gains by mode: none, servo, commanded, commanded damping;
                                                  effort only if the device applies it
        u = clip(u, ±effort limit), 0 if it accelerates a joint above its velocity limit
        u ← strength·u                            a weakened motor
        τ ← τ + (1 − exp(−dt/T))·(u − τ)          first-order lag of time constant T; with a spring, SeriesElastic

    Coulomb friction is part of the plant, where MuJoCo solves for it.

    Attributes:
        effort: (n,) acting on the joints [N·m].
        elastic: the joints with springs; None if the profile has none.
        motor_sequence: of the active Motor; 0 before the first.
    """

    def __init__(self, robot: RobotDescription, profile: ActuatorProfile, step: float, spins: bool = False) -> None:
        """``spins``: joints of Dynamixel servos with a permanent speed turn, as on hardware."""
        n = len(robot.joints)
        buses = [device for device in robot.tables.devices.values() if isinstance(device, Dynamixel)]
        speeds = {robot.index[each.joint]: each.spin for bus in buses for each in bus.servos if spins and each.spin}
        self.spinning = np.array([*speeds], dtype=np.intp)  # indices of joints
        self._advance = np.array([*speeds.values()]) * step
        self._reach = (robot.effort_limit / robot.servo_stiffness)[self.spinning]  # of the servo's whole effort [rad]
        self._ahead = np.zeros(self.spinning.size)  # of the joints [rad]
        self._spun = np.zeros(self.spinning.size)  # positions in the last step [rad]
        self._robot = robot
        self._delay = round(profile.delay / step)
        gears = Gears.of(robot, profile)
        self._half_backlash, self._has_backlash = gears.half_backlash, bool(gears.half_backlash.any())
        self._feed_forward = gears.feed_forward
        self._strength, self._is_weak = gears.strength, bool((gears.strength < 1.0).any())
        self._gain = 1.0 - math.exp(-step / profile.torque_lag) if profile.torque_lag > 0 else 1.0
        noise = profile.noise.joint_effort
        springs = profile.springs
        self.elastic = None if springs is None else SeriesElastic(robot, springs, gears.friction, noise, step)
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
        return self._command.sequence

    @property
    def drive(self) -> FloatArray:
        """(n,) torques of the motors, a copy [N·m]; with a spring another than the joint's."""
        drive = self.effort.copy()
        if self.elastic is not None:
            drive[self.elastic.joints] = self.elastic.drive
        return drive

    def obey(self, motor: Motor) -> None:
        """Apply a valid Motor; set-points are clamped to the joints' limits."""
        if motor.mode.tobytes() != self._modes:  # which rarely change
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
        """Hold the joints at a (n,) position [rad] with their servos and a constant (n,) effort [N·m].

        Without the effort of its load, a joint sags until its servo carries the load.
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
        """Process one physics step; returns the (n,) effort [N·m] at joint position [rad] and velocity [rad/s]."""
        while self._waiting and self._waiting[0][0] <= self._step:
            self._command = self._waiting.popleft()[1]
        self._step += 1
        command, error, wanted = self._command, self._error, self._wanted
        np.subtract(command.position, position, out=error)
        if self.spinning.size:
            error[self.spinning] = self._lead(position[self.spinning])
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
        if (elastic := self.elastic) is not None:
            elastic.update(wanted, velocity)
        wanted -= self.effort
        wanted *= self._gain
        self.effort += wanted
        if elastic is not None:
            self.effort[elastic.joints] = elastic.torque
        return self.effort

    def _lead(self, position: FloatArray) -> FloatArray:
        """(k,) angles by which the set-points of spinning joints are ahead of them [rad]."""
        moved = np.remainder(position - self._spun + math.pi, math.tau) - math.pi
        self._spun = position
        self._ahead = np.clip(self._ahead + self._advance - moved, -self._reach, self._reach)
        return self._ahead

    def _send(self, command: JointCommand) -> None:
        self._waiting.append((self._step + self._delay, command))
