"""Getting up from the floor through the key poses of a table, each checked before the next.

The servos move the joints from key pose to key pose with minimum jerk. The table gives the pelvis attitude required at
the end of each pose; outside it, the robot has slipped or is held, and gets up no further. On the soles, DCM feedback
at the ankles moves the CoM to the middle of the soles.
"""

from math import asin, atan2, degrees, sqrt

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior, Locomotion
from valor.control.motor_command import MotorCommand
from valor.control.state import RobotState
from valor.motion_manager.locomotion.driver import Driver
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import FILE, Balance, KeyPose, load
from valor.robot.posture_move import PostureMove

AT_REST = 0.5  # angular velocity of the pelvis of a robot at rest, at most [rad/s]
COMING_TO_REST = 2.0  # timeout for rest after a pose's hold [s]
COM_SPEED_FILTER = 0.03  # time constant [s]
LOWEST_COM = 0.3  # height above the soles for the DCM, at least [m]
GRAVITY = 9.81  # [m/s²]


class GetUp:
    """Sequence of key poses of a robot. Times are robot time [s]."""

    def __init__(self, robot: RobotDescription) -> None:
        """Read the robot's table, if it has one; raises ``ConfigurationError`` if it is invalid."""
        self._robot = robot
        self._table = load(robot)
        self.goals: list[FloatArray] = []  # (n,) joint positions of each key pose [rad]
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
        self.progress = self.failure = ""  # human-readable progress, reason of a failure; empty without
        self.done = False  # whether the last key pose is reached

    def rejection(self, state: RobotState) -> str:
        """Reason why the robot cannot get up from its present pose; empty if it can."""
        if self._table is None:
            return f"getting up is not available: {self._robot.name} has no {FILE}"
        if (rate := float(np.abs(state.pelvis_angular_velocity_in_pelvis).max())) > AT_REST:
            return f"the robot does not lie still: the pelvis rotates at {rate:.1f} rad/s; expected at most {AT_REST}"
        pitch, roll = attitude(state)
        lower, upper = self._poses[0].pitch
        if abs(roll) > self._table.roll or not lower <= pitch <= upper:
            return (
                f"the robot gets up from face-down only: the pelvis is pitched {pitch:.0f}° and rolled {roll:.0f}°; "
                f"expected {lower:.0f} to {upper:.0f}° and at most {self._table.roll:.0f}°"
            )
        return ""

    def begin(self, state: RobotState, now: float) -> None:
        """Start the first key pose from the measured joint positions."""
        self.failure, self.done, self._stage = "", False, 0
        self._go(state.joint_position, now)

    def update(self, state: RobotState, now: float) -> None:
        """Continue with the next key pose, or set ``done`` or ``failure``."""
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
                    f"after {pose.name} the pelvis still rotates at {rate:.1f} rad/s; expected at most {AT_REST}"
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
    """DCM feedback on the ankles; odometry is invalid after lying, so only the CoM relative to the soles counts."""

    def __init__(self, robot: RobotDescription, table: Balance) -> None:
        self._joints = np.array([robot.index[name] for name in table.joints])
        self._limits = CommandedLimits.of_joints(robot).select(self._joints)
        self._gain, self._limit = table.gain, table.limit
        foot = robot.tables.feet.left
        self._middle = 0.5 * (foot.heel + foot.toe)  # of a sole, ahead of its frame [m]
        self._before = (-1.0, 0.0, 0.0)  # time [s], CoM ahead [m], its speed [m/s]

    def lean(self, position: FloatArray, state: RobotState, now: float) -> None:
        """Add the feedback to the joint reference ``position`` (n,) [rad]."""
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
    """Pitch of the pelvis, −180 to 180 (face-down: 90), and its roll, left side up positive, −90 to 90 [deg]."""
    forward, left, up = state.pelvis_rotation_in_odom[2].tolist()
    return degrees(atan2(-forward, up)), degrees(asin(min(1.0, max(-1.0, left))))


class GetUpDriver(Driver):
    """Gets up from the floor, then changes to Stand Prep; to Fall on failure."""

    states = (Locomotion.GET_UP,)

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        self.components.exchange.end()
        self.components.get_up.begin(state, now)

    def proceed(self, state: RobotState, now: float) -> None:
        components, get_up = self.components, self.components.get_up
        before = get_up.progress
        get_up.update(state, now)
        if get_up.failure:
            components.authority.fall(f"getting up was given up: {get_up.failure}")
        elif get_up.done and (reason := components.stance.lost(state)):
            components.authority.fall(f"getting up was given up: {reason}")
        elif get_up.done:
            components.estimator.reset()
            components.detector.reset()
            components.fsm.go(Behavior.STAND_PREP, "up again")
        elif get_up.progress != before:
            components.fsm.note(get_up.progress)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        self.components.get_up.drive(self.components.command, state, now)
