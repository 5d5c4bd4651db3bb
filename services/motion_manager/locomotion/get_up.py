"""Getting up from the floor: key poses of a table, one after the other, each checked before the next.

The joints go by their servos from key pose to key pose, minimum jerk. Which attitude the pelvis must have at the end of
each is part of the table: a robot that is elsewhere has slipped, is held or was not lying as it seemed, and gives up.
On its soles it balances: the ankles lead the CoM, which goes on as it moves, to the middle of the soles.
"""

from __future__ import annotations

from math import asin, atan2, degrees, sqrt

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import FILE, Balance, KeyPose, load
from valor.robot.posture_move import PostureMove
from valor.whole_body.motor_command import MotorCommand
from valor.whole_body.state import RobotState

AT_REST = 0.5  # lying still, or having come to rest in a pose: angular velocity of the pelvis below [rad/s]
COMING_TO_REST = 2.0  # at most so long after a pose's hold [s]
COM_SPEED_FILTER = 0.03  # time constant [s]
LOWEST_COM = 0.3  # above the soles, for the DCM [m]
GRAVITY = 9.81  # [m/s²]


class GetUp:
    """One robot's way up. Times are robot time [s].

    Attributes:
        goals: (n,) where the joints are to be in each key pose [rad].
        progress: what is being done, for people.
        failure: why it was given up; empty: it was not.
        done: whether the last key pose is reached.
    """

    def __init__(self, robot: RobotDescription) -> None:
        """Read the robot's table, if it has one.

        Raises:
            ConfigurationError: the table is wrong.
        """
        self._robot = robot
        self._table = load(robot)
        self.goals: list[FloatArray] = []
        self._poses: list[KeyPose] = self._table.face_down if self._table else []
        posture = robot.nominal_posture
        for pose in self._poses:
            posture = posture.copy()
            posture[[robot.index[name] for name in pose.joints]] = list(pose.joints.values())
            self.goals.append(posture)
        self._balance = SoleBalance(robot, self._table.balance) if self._table else None
        self._limits = CommandedLimits.of_joints(robot)
        self._no_effort = np.zeros(len(robot.joints))
        self._stage = 0
        self._move: PostureMove | None = None
        self.progress = self.failure = ""
        self.done = False

    def refusal(self, state: RobotState) -> str:
        """Why the robot cannot get up from where it lies; an empty text: it can."""
        if self._table is None:
            return f"getting up is not available: {self._robot.name} has no {FILE}"
        if (rate := float(np.abs(state.pelvis_angular_velocity_in_pelvis).max())) > AT_REST:
            return f"the robot does not lie still: the pelvis turns at {rate:.1f} rad/s; expected at most {AT_REST}"
        pitch, roll = attitude(state)
        lower, upper = self._poses[0].pitch
        if abs(roll) > self._table.roll or not lower <= pitch <= upper:
            return (
                f"the robot gets up from face-down only: the pelvis is pitched {pitch:.0f}° and rolled {roll:.0f}°; "
                f"expected {lower:.0f} to {upper:.0f}° and at most {self._table.roll:.0f}°"
            )
        return ""

    def begin(self, state: RobotState, now: float) -> None:
        """Start with the first key pose from where the joints are."""
        self.failure, self.done, self._stage = "", False, 0
        self._go(state.joint_position, now)

    def update(self, state: RobotState, now: float) -> None:
        """Go on: next key pose, done, or given up."""
        assert self._move is not None
        pose = self._poses[self._stage]
        pitch, roll = attitude(state)
        if self._table is not None and abs(roll) > self._table.roll:
            self.failure = f"{pose.name}: the pelvis rolled {roll:.0f}°; expected at most {self._table.roll:.0f}°"
            return
        if self._move.since_arrival(now) < pose.hold:
            return
        rate = float(np.abs(state.pelvis_angular_velocity_in_pelvis).max())
        if pose.hold > 0.0 and rate > AT_REST:
            if self._move.since_arrival(now) > pose.hold + COMING_TO_REST:
                self.failure = (
                    f"after {pose.name} the pelvis still turns at {rate:.1f} rad/s; expected at most {AT_REST}"
                )
            return
        lower, upper = pose.pitch
        if not lower <= pitch <= upper:
            self.failure = f"after {pose.name} the pelvis is pitched {pitch:.0f}°; expected {lower:.0f} to {upper:.0f}°"
        elif self._stage + 1 == len(self._poses):
            self.done = True
        else:
            self._stage += 1
            self._go(self._move.goal, now)

    def drive(self, command: MotorCommand, state: RobotState, now: float) -> None:
        """Fill the command of this period."""
        assert self._move is not None
        position, velocity, _ = self._move.at(now)
        if self._balance is not None and self._poses[self._stage].balanced:
            self._balance.lean(position, state, now)
        command.hold(position, velocity, self._no_effort)

    def _go(self, start: FloatArray, now: float) -> None:
        pose = self._poses[self._stage]
        self.progress = f"getting up, {self._stage + 1} of {len(self._poses)}: {pose.name}"
        self._move = PostureMove(
            start,
            self.goals[self._stage],
            velocity=self._limits.velocity,
            acceleration=self._limits.acceleration,
            began=now,
            shortest=pose.duration,
        )


class SoleBalance:
    """Feedback of the DCM along the soles on the ankles of a robot that is moved from pose to pose by its servos.

    The estimator's odometry is of no use to a robot that lay, rolled and kneeled. What is used here it has no part in:
    where the CoM is from the soles, by the joints and the IMU, and how fast that changes.
    """

    def __init__(self, robot: RobotDescription, table: Balance) -> None:
        """Take the joints by name."""
        self._joints = np.array([robot.index[name] for name in table.joints])
        self._limits = CommandedLimits.of_joints(robot).select(self._joints)
        self._gain, self._limit = table.gain, table.limit
        foot = robot.tables.feet.left
        self._middle = 0.5 * (foot.heel + foot.toe)  # of a sole, ahead of its frame [m]
        self._before = (-1.0, 0.0, 0.0)  # time [s], CoM ahead [m], its speed [m/s]

    def lean(self, position: FloatArray, state: RobotState, now: float) -> None:
        """Add to the joints' reference (n,) what leads the CoM to the middle of the soles."""
        forward = state.sole_rotations_in_odom[:, :2, 0].sum(0)
        way = state.com_in_odom[:2] - state.sole_positions_in_odom[:, :2].mean(0)
        ahead = float(way @ forward) / float(np.hypot(*forward)) - self._middle
        height = float(state.com_in_odom[2] - state.sole_positions_in_odom[:, 2].mean())
        then, before, speed = self._before
        passed = now - then
        if 0.0 < passed < COM_SPEED_FILTER:
            speed += passed / COM_SPEED_FILTER * ((ahead - before) / passed - speed)
        elif passed:
            speed = 0.0
        self._before = (now, ahead, speed)
        dcm = ahead + speed * sqrt(max(height, LOWEST_COM) / GRAVITY)
        angle = min(self._limit, max(-self._limit, self._gain * dcm))
        position[self._joints] = self._limits.position_within(position[self._joints] + angle)


def attitude(state: RobotState) -> tuple[float, float]:
    """Pitch of the pelvis, −180 to 180 (face-down: 90), and how its left side is raised, −90 to 90 [deg]."""
    forward, left, up = state.pelvis_rotation_in_odom[2].tolist()
    return degrees(atan2(-forward, up)), degrees(asin(min(1.0, max(-1.0, left))))
