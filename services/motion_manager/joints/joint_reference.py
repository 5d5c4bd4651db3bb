"""Reference of all joints: the only source of commanded positions.

Joints hold, follow set-points, or move to a posture. The limiter filters every motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints, Limiter
from valor.robot.posture_move import PostureMove

SETPOINT_HORIZON = 0.02  # extrapolation of a set-point [s]: five periods of the VRC
MOVE_VELOCITY_FACTOR = 0.3  # velocity of moves to a posture, fraction of a joint's limit
MOVE_VELOCITY = 0.6  # velocity of moves to a posture, at most [rad/s]
SHORTEST_MOVE = 0.5  # [s]
MISMATCH = 0.6  # of velocity and fed-forward acceleration, above which no acceleration is fed forward [rad/s]
MISMATCH_TIME = 0.1  # over which they are compared [s]


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Set-point of k joints, within their limits."""

    joints: npt.NDArray[np.intp]  # (k,) indices in every joint vector
    position: FloatArray  # (k,) [rad]
    velocity: FloatArray  # (k,) [rad/s]
    acceleration: FloatArray  # (k,) [rad/s²]
    time: float  # robot time [s]


class JointReference:
    """The reference of all joints, advanced once a control period. Times are robot time [s]."""

    def __init__(self, robot: RobotDescription) -> None:
        n = len(robot.joints)
        self._limiter = Limiter(CommandedLimits.of_joints(robot))
        self._move_velocity = np.minimum(MOVE_VELOCITY_FACTOR * robot.velocity_limit, MOVE_VELOCITY)
        followed = np.zeros((4, n))  # set-points with their times [s]
        self._setpoint, self._setpoint_velocity, self._setpoint_acceleration, self._setpoint_time = followed
        self._setpoint[:] = self._limiter.position
        self._now = np.zeros(1)
        self._target, self._fresh = np.zeros((3, n)), np.zeros(1)
        self._extrapolate = Kernel("setpoints", _extrapolate, (followed, self._now), (self._target, self._fresh))
        self._targets = tuple(self._target)
        self._target_acceleration = np.zeros(n)
        self._mismatch, self._fed_mismatch = np.zeros((2, n))  # of set-points, and of what is fed forward of them
        # Joints whose velocity does not follow their acceleration, which is then not fed forward.
        self.inconsistent: Joints = np.zeros(n, dtype=bool)
        self._move: PostureMove | None = None
        self._moving: Joints = np.zeros(n, dtype=bool)
        self._extrapolating = False  # whether a set-point is extrapolated
        self.frozen: Joints = np.zeros(n, dtype=bool)  # joints that only hold

    @property
    def position(self) -> FloatArray:
        """(n,) commanded [rad]; a new array whenever it changes."""
        return self._limiter.position

    @property
    def velocity(self) -> FloatArray:
        """(n,) commanded [rad/s]."""
        return self._limiter.velocity

    @property
    def acceleration(self) -> FloatArray:
        """(n,) of the set-points, for feed-forward [rad/s²]."""
        return self._target_acceleration

    @property
    def limits(self) -> CommandedLimits:
        """Limits of the (n,) joints."""
        return self._limiter.limits

    def take_up(self, joints: Joints, position: FloatArray) -> None:
        """Hold joints that this reference did not control at (n,) measured positions [rad], unfiltered."""
        self._limiter.reset(joints, position)
        self.hold(joints)

    def hold(self, joints: Joints) -> None:
        """Brake and stay."""
        self._leave_move(joints)
        np.copyto(self._setpoint, self._limiter.stopping_point(), where=joints)
        self._setpoint_velocity[joints] = 0.0
        self._setpoint_acceleration[joints] = 0.0

    def follow(self, setpoint: Setpoint) -> None:
        """Follow a set-point."""
        joints = setpoint.joints
        if self._move is not None:
            moving = np.zeros_like(self._moving)
            moving[joints] = True
            self._leave_move(moving)
        self._setpoint[joints] = setpoint.position
        self._setpoint_velocity[joints] = setpoint.velocity
        self._setpoint_acceleration[joints] = setpoint.acceleration
        self._setpoint_time[joints] = setpoint.time
        self._extrapolating = True
        if self.frozen[joints].any():
            self.hold(self.frozen)

    def move(self, joints: Joints, goal: FloatArray, now: float) -> PostureMove:
        """Move joints to a posture (n,) [rad], all arriving together; ends a present move."""
        joints = joints & ~self.frozen
        if self._move is not None:
            self.hold(self._moving)
        start = self._limiter.position
        self._move = PostureMove(
            start,
            np.where(joints, goal, start),
            velocity=self._move_velocity,
            acceleration=self.limits.acceleration,
            began=now,
            shortest=SHORTEST_MOVE,
        )
        self._moving = joints
        np.copyto(self._setpoint, self._move.goal, where=joints)
        self._setpoint_velocity[joints] = 0.0
        self._setpoint_acceleration[joints] = 0.0
        return self._move

    def _leave_move(self, joints: Joints) -> None:
        if self._move is not None:
            self._moving = self._moving & ~joints
            if not self._moving.any():
                self._move = None

    def advance(self, now: float, dt: float) -> None:
        """Advance one control period."""
        target, velocity, acceleration = self._setpoint, self._setpoint_velocity, self._setpoint_acceleration
        if self._extrapolating:
            self._now[0] = now
            self._extrapolate()
            target, velocity, acceleration = self._targets
            if not self._fresh[0]:
                self._come_to_rest(target)
        if self._move is not None:
            position, move_velocity, move_acceleration = self._move.at(now)
            target = np.where(self._moving, position, target)
            velocity = np.where(self._moving, move_velocity, velocity)
            acceleration = np.where(self._moving, move_acceleration, acceleration)
            if self._move.progress(now) >= 1.0:
                self._move = None
        before = self._limiter.velocity
        self._limiter.advance(target, velocity, dt)
        kept, change = max(0.0, 1.0 - dt / MISMATCH_TIME), self._limiter.velocity - before - acceleration * dt
        # The limit leaves no more for accelerations of the other sign.
        self._mismatch = np.clip(kept * self._mismatch + change, -1.05 * MISMATCH, 1.05 * MISMATCH)
        self._fed_mismatch *= kept
        fed = np.minimum(self._mismatch * np.sign(acceleration), (self._fed_mismatch + change) * np.sign(acceleration))
        self.inconsistent = fed < -MISMATCH
        self._fed_mismatch += np.where(self.inconsistent, 0.0, change)
        self._target_acceleration = np.where(self.inconsistent, 0.0, acceleration)

    def _come_to_rest(self, target: FloatArray) -> None:
        """Stop at the targets; joints that cannot stop there, farther on in their direction, not behind."""
        direction = np.sign(self._setpoint_velocity)
        stop = np.where(direction == 0.0, target, self._limiter.stopping_point())
        self._setpoint[:] = np.where(direction * (stop - target) > 0.0, stop, target)
        self._setpoint_velocity[:] = self._setpoint_acceleration[:] = 0.0
        self._extrapolating = False


def _extrapolate(followed: Expression, now: Expression) -> Sequence[Expression]:
    """(3, n) set-points extrapolated to ``now``: position, velocity, acceleration; whether any is fresh."""
    position, velocity, acceleration, time = (followed[i, :] for i in range(4))
    since = now - time
    age = ca.fmax(ca.fmin(since, SETPOINT_HORIZON), 0.0)
    fresh = since < SETPOINT_HORIZON
    target = position + age * (velocity + (0.5 * age) * acceleration)
    return (
        ca.vertcat(target, fresh * (velocity + age * acceleration), fresh * acceleration),
        ca.mmax(fresh),
    )
