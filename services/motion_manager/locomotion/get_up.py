"""Getting up from the floor: motions from one way of lying to another, and to standing, until the robot stands.

The robot looks how it lies, by the estimated pelvis attitude, executes the motion that starts there, and looks again. A
motion moves the joints from key pose to key pose with minimum jerk, on their servos. Where the table gives the pelvis
attitude after a pose, it is required; outside it the robot has slipped or is held: it goes limp, comes to rest, and
tries again, until ``ATTEMPTS`` motions have failed. On the soles, DCM feedback at the ankles moves the CoM to their
middle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior, Locomotion
from valor.control.motor_command import MotorCommand
from valor.control.state import RobotState
from valor.motion_manager.locomotion.driver import Driver
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import FILE, KeyPose, Motion, Posture, attitude, goals, load, lying, other, posture_move
from valor.robot.mirror import mirrored
from valor.robot.posture_move import PostureMove
from valor.robot.sole_balance import SoleBalance

AT_REST = 0.5  # angular velocity of the pelvis of a robot at rest, at most [rad/s]
COMING_TO_REST = 2.0  # timeout for rest after a pose's hold [s]
RESTING = 0.3  # time at rest before the robot looks how it lies [s]
SETTLING = 6.0  # timeout for it [s]
ATTEMPTS = 5  # motions that fail, at most


@dataclass(frozen=True, slots=True)
class Way:
    """A motion, to one of the two sides."""

    to: Posture
    poses: list[KeyPose]
    goals: list[FloatArray]  # (n,) joint positions of each key pose [rad]
    other_side: Way | None = None  # its mirror image, if it starts the same


class GetUp:
    """Gets up along the motions of a robot's table. Times are robot time [s]."""

    def __init__(self, robot: RobotDescription) -> None:
        """Read the robot's table, if it has one; raises ``ConfigurationError`` if it is invalid."""
        self._robot = robot
        self._table = load(robot)
        self.ways: dict[Posture, Way] = {}  # by how the robot lies
        for motion in self._table.motions if self._table else ():
            self._add(motion)
        self._balance = SoleBalance(robot, self._table.balance) if self._table else None
        self._limits = CommandedLimits.of_joints(robot)
        self._no_effort = np.zeros(len(robot.joints))
        self.way: Way | None = None  # the present motion; None: limp, coming to rest
        self._before: Way | None = None  # the latest one
        self._stage = self._failed = 0
        self._move: PostureMove | None = None
        self._since = self._still = 0.0  # limp, at rest
        self.progress = self.failure = ""  # human-readable progress, reason of a failure; empty without
        self.trouble = ""  # reason why the latest motion was abandoned
        self.done = False  # whether the last key pose is reached

    def _add(self, motion: Motion) -> None:
        way = Way(motion.to, motion.poses, goals(self._robot, motion.poses))
        image = Way(other(motion.to), motion.poses, [mirrored(self._robot, goal) for goal in way.goals])
        for start in motion.start:
            if other(start) is start:
                self.ways[start] = replace(way, other_side=image)
            else:
                self.ways[start] = way
                self.ways.setdefault(other(start), image)

    def rejection(self, state: RobotState) -> str:
        """Reason why the robot cannot get up from its present pose; empty if it can."""
        if self._table is None:
            name = self._robot.name
            return f"getting up is not available: {name} has no {FILE}; `valorctl robot get-up {name}` makes it"
        return self._no_way(state)

    def _no_way(self, state: RobotState) -> str:
        way = lying(state.pelvis_rotation_in_odom[2])
        if way in self.ways:
            return ""
        pitch, roll = attitude(state.pelvis_rotation_in_odom[2])
        found = f"it lies on its {way}" if way else "it does not lie"
        return (
            f"{found} (pelvis pitched {pitch:.0f}°, rolled {roll:.0f}°), and {self._robot.name} gets up from "
            f"lying on its {', '.join(self.ways)}"
        )

    def begin(self, state: RobotState, now: float) -> None:
        """Start with the motion for how the robot lies, once it is at rest."""
        self.failure, self._failed, self._before = "", 0, None
        if (rate := turning(state)) > AT_REST:
            self._come_to_rest(f"the pelvis {_rotates(rate)}", now)
        else:
            self.trouble, self.done = "", False
            self._look(state, now)

    def abandon(self, why: str, now: float) -> None:
        """Abandon the motion, and try again from where the robot comes to rest."""
        self._failed += 1
        self._come_to_rest(why, now)

    def _come_to_rest(self, why: str, now: float) -> None:
        self.done, self.way, self._since, self._still, self.trouble = False, None, now, now, why
        self.progress = f"getting up, coming to rest: {why}"

    def update(self, state: RobotState, now: float) -> None:
        """Continue with the next key pose or motion, or set ``done`` or ``failure``."""
        if self.way is None:
            self._rest(state, now)
            return
        assert self._move is not None and self._table is not None
        pose = self.way.poses[self._stage]
        pitch, roll = attitude(state.pelvis_rotation_in_odom[2])
        if pose.pitch is not None and abs(roll) > self._table.roll:
            self.abandon(f"{pose.name}: the pelvis rolled {roll:.0f}°; expected at most {self._table.roll:.0f}°", now)
            return
        if self._move.since_arrival(now) < pose.hold:
            return
        if pose.hold > 0.0 and (rate := turning(state)) > AT_REST:
            if self._move.since_arrival(now) > pose.hold + COMING_TO_REST:
                what = f"the pelvis still {_rotates(rate)}"
                self.abandon(f"after {pose.name} {what}", now)
            return
        lower, upper = pose.pitch or (-180.0, 180.0)
        if not lower <= pitch <= upper:
            what = f"the pelvis is pitched {pitch:.0f}°; expected {lower:.0f} to {upper:.0f}°"
            self.abandon(f"after {pose.name} {what}", now)
        elif self._stage + 1 < len(self.way.poses):
            self._stage += 1
            self._go(self._move.goal, now)
        elif self.way.to is Posture.STANDING:
            self.done = True
        elif (way := lying(state.pelvis_rotation_in_odom[2])) is self.way.to:
            self._look(state, now)
        else:
            self.abandon(f"after {pose.name} it lies on its {way or 'feet'}; expected {self.way.to}", now)

    def drive(self, command: MotorCommand, state: RobotState, now: float) -> None:
        """Fill the command of this period."""
        if self.way is None:
            command.limp(state.joint_position)
            return
        assert self._move is not None
        position, velocity, _ = self._move.at(now)
        if self._balance is not None and self.way.poses[self._stage].balanced:
            com = state.com_in_odom - state.sole_positions_in_odom.mean(0)
            self._balance.lean(position, com, state.sole_rotations_in_odom[:, :2, 0].sum(0), now)
        command.hold(position, velocity, self._no_effort)

    def _rest(self, state: RobotState, now: float) -> None:
        rate = turning(state)
        if rate > AT_REST:
            self._still = now
        if now - self._still >= RESTING:
            self._look(state, now)
        elif now - self._since > SETTLING:
            self.failure = f"the pelvis still {_rotates(rate)}; {self.trouble}"

    def _look(self, state: RobotState, now: float) -> None:
        """Start the motion for how the robot lies, or fail."""
        start = lying(state.pelvis_rotation_in_odom[2])
        if start is None or start not in self.ways:
            self.failure = f"{self._no_way(state)}; {self.trouble}"
        elif self._failed == ATTEMPTS:
            self.failure = f"{ATTEMPTS} motions failed; {self.trouble}"
        else:
            way = self.ways[start]
            again = way is self._before and way.other_side  # a motion that failed may do on the other side
            self.way = self._before = again or way
            self._stage = 0
            self._go(state.joint_position, now)

    def _go(self, start: FloatArray, now: float) -> None:
        assert self.way is not None
        way, pose = self.way, self.way.poses[self._stage]
        again = f", again after {self._failed} failed" if self._failed else ""
        self.progress = f"getting up{again} to {way.to}, {self._stage + 1} of {len(way.poses)}: {pose.name}"
        self._move = posture_move(self._limits, start, way.goals[self._stage], pose.duration, now)


def turning(state: RobotState) -> float:
    """Largest angular velocity of the pelvis about one of its axes [rad/s]."""
    return float(np.abs(state.pelvis_angular_velocity_in_pelvis).max())


def _rotates(rate: float) -> str:
    return f"rotates at {rate:.1f} rad/s; expected at most {AT_REST}"


class GetUpDriver(Driver):
    """Gets up from the floor, then changes to Stand Prep; to Fall if it gives up."""

    states = (Locomotion.GET_UP,)

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        self.components.exchange.end()
        self.components.get_up.begin(state, now)

    def proceed(self, state: RobotState, now: float) -> None:
        components, get_up = self.components, self.components.get_up
        before = get_up.progress
        get_up.update(state, now)
        if get_up.done and (lost := components.stance.lost(state)):
            get_up.abandon(lost, now)
        if get_up.failure:
            components.authority.fall(f"getting up was given up: {get_up.failure}")
        elif get_up.done:
            components.estimator.reset()
            components.detector.reset()
            components.fsm.go(Behavior.STAND_PREP, "up again")
        elif get_up.progress != before:
            components.fsm.note(get_up.progress)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        self.components.get_up.drive(self.components.command, state, now)
