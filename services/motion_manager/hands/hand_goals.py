"""Cartesian goals of the hands: inverse kinematics towards an integrated arm reference, with limited speed.

Each period the hand's error e (position, rotation vector) from its goal gives a wished twist k·e, cut to the greatest
speeds; damped least squares turn it into rates of the arm's joints

    q̇ = Jᵀ·(J·Jᵀ + λ²·1)⁻¹·twist + (1 − J⁺·J)·k₀·(q_posture − q),

in which joints at a limit take no part (``arm_kinematics``). The rates are integrated to the set-points of the arm,
which the joint reference follows as it follows those of others. Where the straight way ends in a corner of the limits,
postures lead round it (``reach_search``). A goal in odom moves in the pelvis' frame as the estimated pelvis does, and
is followed with its velocity and acceleration. What is told of a hand is where the measured joints have it; joints that
do not follow stay out of it, and are named.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.messages import HandGoalStatus
from valor.motion_manager.hands.led_arm import HandGoal, LedArm, within
from valor.motion_manager.joints.joint_reference import JointReference, Setpoint
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.robot.tables import Hand, Side
from valor.whole_body.state import RobotState

SIDES: tuple[Side, Side] = ("left", "right")
GRACE = 0.05  # from a goal to its first motion, in which others learn that the arm is led by it [s]
STALLED_TIME = 0.5  # for which an arm must not get on, to say that the goal is out of reach [s]
SETTLING = 2.5  # likewise of an arm whose set-points are there, while its joints come [s]
LEAVING = 2.0  # times REACHED: what is reached stays so within it
AWAY = 0.3  # that a goal has to lead a hand away from what it presses on [s]
LOOK = 0.02  # between looks at where the hands are [s]


class HandGoals:
    """Both arms; a robot that lacks one has it led nowhere.

    Attributes:
        changes: how often a hand's ``status`` changed other than by its errors.
    """

    def __init__(self, model: Model, reference: JointReference, nominal: FloatArray) -> None:
        """Without goals.

        Args:
            model: the controller's.
            reference: of all joints; what is integrated goes there.
            nominal: (n,) posture that redundancy is used for [rad].
        """
        self._arms = {side: LedArm(model, hand, SIDES[side], nominal) for side, hand in _led(model.robot)}
        self._reference = reference
        self.changes = 0
        self._looked = -np.inf  # when at where the hands are [s]

    @property
    def active(self) -> bool:
        """Whether any arm is led by a goal."""
        return any(arm.goal is not None for arm in self._arms.values())

    @property
    def sides(self) -> Iterable[int]:
        """0 left, 1 right: the hands that goals may lead."""
        return self._arms

    def leads(self, side: int) -> bool:
        """Whether a goal leads an arm."""
        return side in self._arms and self._arms[side].goal is not None

    def moves(self, side: int, now: float) -> bool:
        """Whether set-points of an arm are refused at robot time ``now`` [s], for a goal moves it."""
        return self.leads(side) and now >= self._arms[side].begins

    def lead(self, side: int, goal: HandGoal, now: float) -> None:
        """Move a hand to a goal, instead of the one it has."""
        arm = self._arms[side]
        if arm.goal is None:
            arm.begins = now + GRACE
        arm.begin(goal, now)
        self._looked = -np.inf
        self._say(arm, "moving")

    def release(self, side: int, reason: str, state: str = "idle") -> None:
        """The arm stays where it is, and takes set-points again."""
        arm = self._arms[side]
        if arm.goal is None:
            return
        if arm.position is not None:
            self._reference.follow(Setpoint(arm.joints, arm.position, arm.still, arm.still, 0.0))
        arm.goal, arm.position, arm.reason = None, None, reason
        arm.rest()
        self._say(arm, state)

    def give_way(self, side: int, reason: str, measured: FloatArray, now: float) -> None:
        """Let a hand go that does not get through: its arm stays where it is, not where it was led; (n,) [rad]."""
        if self.leads(side) and now > self._arms[side].begins + AWAY:
            arm = self._arms[side]
            arm.position = np.clip(measured[arm.joints], arm.lower, arm.upper)
            self.release(side, reason, "resisted")

    def release_all(self, reason: str) -> None:
        """Likewise all."""
        for side in self._arms:
            self.release(side, reason)

    def advance(self, state: RobotState, measured: FloatArray, now: float, dt: float) -> None:
        """Go one control period; before the joint reference advances.

        Args:
            state: where the pelvis is, for goals in odom.
            measured: (n,) positions of the robot's joints [rad].
            now: robot time [s].
            dt: since the last period [s].
        """
        if not self.active:
            return
        moved = [arm for arm in self._arms.values() if arm.goal is not None and now >= arm.begins]
        for arm in moved:
            self._advance(arm, state, now, dt)
        if moved and now - self._looked >= LOOK:
            self._looked = now
            self._look(moved, measured, now)

    def status(self, side: int, time: int) -> HandGoalStatus:
        """How a hand fares, at robot time ``time`` [ns]."""
        arm = self._arms[side]
        return HandGoalStatus(
            time=time,
            hand=side,
            state=arm.state,
            reason=arm.reason,
            position_error=arm.errors[0],
            orientation_error=arm.errors[1],
        )

    def _advance(self, arm: LedArm, state: RobotState, now: float, dt: float) -> None:
        goal = arm.goal
        assert goal is not None
        if arm.position is None:
            arm.position = self._reference.position[arm.joints].copy()
        if goal.in_odom:
            arm.target(*seen_from_pelvis(goal.position, goal.rotation, state))
        else:
            arm.target(goal.position, goal.rotation, arm.standing)
        rate = arm.advance(self._reference.position, dt)
        self._reference.follow(Setpoint(arm.joints, arm.position, rate, arm.acceleration, now))

    def _look(self, arms: Iterable[LedArm], measured: FloatArray, now: float) -> None:
        """At where the hands are: by the measured joints, on the estimated pelvis."""
        for arm in arms:
            arm.look(measured)
            position = measured[arm.joints]
            arm.find_stuck(position, now)
            if within(arm.errors, LEAVING if arm.state == "reached" else 1.0):
                arm.arrive(now)
                self._say(arm, "reached")
            elif arm.under_way or (arm.moves and arm.nears(now)):
                arm.stalled_since, arm.reason = now, ""
                self._say(arm, "moving")
            elif self._stalled(arm, now):
                arm.reason = arm.complaint(position)
                self._say(arm, "out_of_reach")

    def _stalled(self, arm: LedArm, now: float) -> bool:
        """Whether an arm that does not get on will not, either."""
        if within(arm.led, 1.0):
            return now - arm.stalled_since > SETTLING
        return now - arm.stalled_since > STALLED_TIME and not arm.looks_elsewhere(self._reference.position)

    def _say(self, arm: LedArm, state: str) -> None:
        if state != arm.state:
            arm.state = state
            self.changes += 1


def _led(robot: RobotDescription) -> Iterator[tuple[int, Hand]]:
    """Which hand it is (0 left, 1 right), and its table: of those that an arm carries."""
    for side, hand in robot.tables.hands.present():
        if robot.tables.group(f"{side}_arm"):
            yield SIDES.index(side), hand


def seen_from_pelvis(
    position: FloatArray, turn: FloatArray, state: RobotState
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A pose (3,) [m], (3, 3) in odom: the same in pelvis, and the twist (6,) it has there as the pelvis moves."""
    inverse = state.pelvis_rotation_in_odom.T
    place: FloatArray = inverse @ (position - state.pelvis_position_in_odom)
    twist, turning = np.empty(6), state.pelvis_angular_velocity_in_pelvis
    twist[:3] = -inverse @ state.pelvis_linear_velocity_in_odom - np.cross(turning, place)
    twist[3:] = -turning
    return place, inverse @ turn, twist
