"""Where every joint shall be: the one place that positions commanded to the robot come from.

Joints hold, follow set-points, or move to a posture. Whatever they do, and whenever that changes, the limiter stands
between it and the robot.
"""

from __future__ import annotations

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

SETPOINT_HORIZON = 0.02  # a set-point with velocity runs on for this long [s]: five periods of the VRC
MOVE_VELOCITY_FACTOR = 0.3  # of a joint's velocity limit, in moves to a posture
MOVE_VELOCITY = 0.6  # the same, at most [rad/s]
SHORTEST_MOVE = 0.5  # [s]


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Where k joints shall be at a time, within their limits."""

    joints: npt.NDArray[np.intp]  # (k,) their places in every joint vector
    position: FloatArray  # (k,) [rad]
    velocity: FloatArray  # (k,) [rad/s]
    acceleration: FloatArray  # (k,) [rad/s²]
    time: float  # robot time [s]


class JointReference:
    """The reference of all joints, advanced once a control period.

    Times are robot time [s].
    """

    def __init__(self, robot: RobotDescription) -> None:
        n = len(robot.joints)
        self._limiter = Limiter(CommandedLimits.of_joints(robot))
        self._move_velocity = np.minimum(MOVE_VELOCITY_FACTOR * robot.velocity_limit, MOVE_VELOCITY)
        followed = np.zeros((4, n))  # what is followed, of which time it is [s]
        self._setpoint, self._setpoint_velocity, self._setpoint_acceleration, self._setpoint_time = followed
        self._setpoint[:] = self._limiter.position
        self._now = np.zeros(1)
        self._target, self._fresh = np.zeros((3, n)), np.zeros(1)
        self._run_on = Kernel("setpoints", _run_on, (followed, self._now), (self._target, self._fresh))
        self._targets = tuple(self._target)
        self._target_acceleration = np.zeros(n)
        self._move: PostureMove | None = None
        self._moving: Joints = np.zeros(n, dtype=bool)
        self._running_on = False  # whether a set-point with velocity or acceleration is in force

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
        """(n,) of what is followed, for feed-forward [rad/s²]."""
        return self._target_acceleration

    @property
    def limits(self) -> CommandedLimits:
        """Of the (n,) joints."""
        return self._limiter.limits

    def take_up(self, joints: Joints, position: FloatArray) -> None:
        """Hold joints where they are found: the only way a reference changes without passing the limiter.

        For joints that were not held by this reference until now.
        """
        self._limiter.reset(joints, position)
        self.hold(joints)

    def hold(self, joints: Joints) -> None:
        """Brake and stay."""
        self._leave_move(joints)
        np.copyto(self._setpoint, self._limiter.stopping_point(), where=joints)
        self._setpoint_velocity[joints] = 0.0
        self._setpoint_acceleration[joints] = 0.0

    def follow(self, setpoint: Setpoint) -> None:
        """Follow a set-point from now on."""
        joints = setpoint.joints
        if self._move is not None:
            moving = np.zeros_like(self._moving)
            moving[joints] = True
            self._leave_move(moving)
        self._setpoint[joints] = setpoint.position
        self._setpoint_velocity[joints] = setpoint.velocity
        self._setpoint_acceleration[joints] = setpoint.acceleration
        self._setpoint_time[joints] = setpoint.time
        self._running_on = True

    def move(self, joints: Joints, goal: FloatArray, now: float) -> PostureMove:
        """Move joints to a posture, all arriving together; a move that is under way ends."""
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
        self._moving = joints.copy()
        np.copyto(self._setpoint, self._move.goal, where=joints)
        self._setpoint_velocity[joints] = 0.0
        self._setpoint_acceleration[joints] = 0.0
        return self._move

    def _leave_move(self, joints: Joints) -> None:
        """These joints take no further part in a move."""
        if self._move is not None:
            self._moving = self._moving & ~joints
            if not self._moving.any():
                self._move = None

    def advance(self, now: float, dt: float) -> None:
        """Go one control period."""
        target, velocity, acceleration = self._setpoint, self._setpoint_velocity, self._setpoint_acceleration
        if self._running_on:
            self._now[0] = now
            self._run_on()
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
        self._target_acceleration = acceleration
        self._limiter.advance(target, velocity, dt)

    def _come_to_rest(self, target: FloatArray) -> None:
        """No set-point is fresh: what they had run on to is where the joints stay."""
        self._setpoint[:] = target
        self._setpoint_velocity[:] = self._setpoint_acceleration[:] = 0.0
        self._running_on = False


def _run_on(followed: Expression, now: Expression) -> Sequence[Expression]:
    """(3, n) positions, velocities and accelerations at ``now`` of what is followed; whether any of it is fresh."""
    position, velocity, acceleration, time = (followed[i, :] for i in range(4))
    since = now - time
    age = ca.fmax(ca.fmin(since, SETPOINT_HORIZON), 0.0)
    fresh = since < SETPOINT_HORIZON
    target = position + age * (velocity + (0.5 * age) * acceleration)
    return (
        ca.vertcat(target, fresh * (velocity + age * acceleration), fresh * acceleration),
        ca.mmax(fresh),
    )
