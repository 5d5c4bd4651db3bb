"""Cartesian goals of the hands: inverse kinematics towards an integrated arm reference, with limited speed.

Each period the hand's error e (position, rotation vector) from its goal gives a wished twist k·e, cut to the greatest
speeds; damped least squares turn it into rates of the arm's joints (Wampler 1986; Nakamura & Hanafusa 1986)

    q̇ = Jᵀ·(J·Jᵀ + λ²·1)⁻¹·twist + (1 − J⁺·J)·k₀·(q_nominal − q),

in which joints at a limit take no part. The rates are integrated to the set-points of the arm, which the joint
reference follows as it follows those of others. The waist's set-point counts as it is; nothing measured enters but,
for goals in odom, where the pelvis is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.messages import HandGoalStatus
from valor.motion_manager.joints.joint_reference import JointReference, Setpoint
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.robot.tables import Hand, Side
from valor.whole_body.model.dynamics import ModelJoints
from valor.whole_body.state import RobotState
from valor.whole_body.tuning_tables import HandMotion, Tuning

SIDES: tuple[Side, Side] = ("left", "right")
GRACE = 0.05  # from a goal to its first motion, in which others learn that the arm is led by it [s]
APPROACH = 2.0  # speed per distance from the goal [1/s]
POSTURE = 0.3  # rate per distance from the nominal posture, where it does not move the hand [1/s]
DAMPING = 0.05  # λ: from here on singular values are damped
MARGIN = 0.02  # kept from the joints' limits [rad]
REACHED = (0.005, 0.02)  # most position and orientation errors of a goal that is reached [m, rad]
STALLED_RATE = 0.02  # of every joint, below which an arm counts as not getting on [rad/s]
STALLED_TIME = 0.5  # for which it must not get on, to say that the goal is out of reach [s]


@dataclass(frozen=True, slots=True)
class HandGoal:
    """Where a hand shall be."""

    in_odom: bool  # else in pelvis
    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)


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
        self._places = ModelJoints(model).places
        data = mujoco.MjData(model.mj)
        data.qpos[:] = 0.0
        data.qpos[3] = 1.0
        self._arms = {side: _Arm(model, data, hand, SIDES[side], nominal) for side, hand in _led(model.robot)}
        self._model, self._data = model.mj, data
        self._reference = reference
        self.changes = 0

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
        arm.goal, arm.stalled_since, arm.reason = goal, now, ""
        self._say(arm, "moving")

    def release(self, side: int, reason: str) -> None:
        """The arm stays where it is, and takes set-points again."""
        arm = self._arms[side]
        if arm.goal is None:
            return
        if arm.position is not None:
            self._reference.follow(Setpoint(arm.joints, arm.position, arm.still, arm.still, 0.0))
        arm.goal, arm.position, arm.reason = None, None, reason
        self._say(arm, "idle")

    def release_all(self, reason: str) -> None:
        """Likewise all."""
        for side in self._arms:
            self.release(side, reason)

    def advance(self, state: RobotState, now: float, dt: float) -> None:
        """Go one control period; before the joint reference advances."""
        if not self.active:
            return
        self._data.qpos[7:] = self._reference.position[self._places]
        for arm in self._arms.values():
            if arm.goal is not None and now >= arm.begins:
                self._advance(arm, state, now, dt)

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

    def _advance(self, arm: _Arm, state: RobotState, now: float, dt: float) -> None:
        goal, data = arm.goal, self._data
        assert goal is not None
        if arm.position is None:
            arm.position = self._reference.position[arm.joints].copy()
        data.qpos[arm.qpos] = arm.position
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        position, turn = goal.position, goal.rotation
        if goal.in_odom:
            inverse = state.pelvis_rotation_in_odom.T
            position, turn = inverse @ (position - state.pelvis_position_in_odom), inverse @ turn
        rate = arm.rate(self._model, data, position, turn)
        arm.position = np.clip(arm.position + rate * dt, arm.lower, arm.upper)
        self._reference.follow(Setpoint(arm.joints, arm.position, rate, arm.still, now))
        distance, angle = arm.errors
        if distance <= REACHED[0] and angle <= REACHED[1]:
            arm.stalled_since, arm.reason = now, ""
            self._say(arm, "reached")
        elif np.abs(rate).max() > STALLED_RATE:
            arm.stalled_since, arm.reason = now, ""
            self._say(arm, "moving")
        elif now - arm.stalled_since > STALLED_TIME:
            arm.reason = f"the {arm.side} hand gets no nearer: {distance:.3f} m and {angle:.3f} rad remain"
            self._say(arm, "out_of_reach")

    def _say(self, arm: _Arm, state: str) -> None:
        if state != arm.state:
            arm.state = state
            self.changes += 1


def _led(robot: RobotDescription) -> Iterator[tuple[int, Hand]]:
    """Which hand it is (0 left, 1 right), and its table: of those that an arm carries."""
    for side, hand in robot.tables.hands.present():
        if robot.tables.group(f"{side}_arm"):
            yield SIDES.index(side), hand


class _Arm:
    """One arm, and what became of its goal."""

    def __init__(self, model: Model, data: mujoco.MjData, hand: Hand, side: Side, nominal: FloatArray) -> None:
        robot = model.robot
        self.side = side
        self.joints = robot.group_indices(f"{side}_arm")
        dof = ModelJoints(model).group(f"{side}_arm")
        self.qpos, self._dof = 7 + dof, 6 + dof
        self._table: HandMotion = robot.read(Tuning).hand_goals
        self._site = model.site(hand.site)
        self._place: FloatArray = data.site_xpos[self._site]
        self._turn: FloatArray = data.site_xmat[self._site].reshape(3, 3)
        self._jacobian = np.zeros((6, model.mj.nv))
        self._nominal = nominal[self.joints]
        limits = CommandedLimits.of_joints(robot).select(self.joints)
        self.lower, self.upper = limits.lower + MARGIN, limits.upper - MARGIN
        self._highest = np.minimum(self._table.joint_speed * robot.velocity_limit[self.joints], limits.velocity)
        self.still = np.zeros(len(self.joints))
        self.goal: HandGoal | None = None
        self.begins = 0.0
        self.position: FloatArray | None = None  # (m,) integrated [rad]
        self.stalled_since = 0.0
        self.state, self.reason = "idle", ""
        self.errors = (0.0, 0.0)  # [m, rad]

    def rate(self, model: mujoco.MjModel, data: mujoco.MjData, position: FloatArray, turn: FloatArray) -> FloatArray:
        """(m,) of the joints, towards a pose in pelvis [rad/s]; notes the errors."""
        assert self.position is not None
        mujoco.mj_jacSite(model, data, self._jacobian[:3], self._jacobian[3:], self._site)
        twist = np.empty(6)
        twist[:3] = position - self._place
        twist[3:] = rotation.rotation_vector(turn @ self._turn.T)
        distance, angle = float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:]))
        self.errors = (distance, angle)
        # Both parts arrive together: one factor for the whole twist.
        twist *= min(
            APPROACH, self._table.max_speed / max(distance, 1e-9), self._table.max_turn_rate / max(angle, 1e-9)
        )
        jacobian = self._jacobian[:, self._dof]
        idle = POSTURE * (self._nominal - self.position)
        rate = _least_squares(jacobian, twist, idle)
        blocked = ((self.position <= self.lower) & (rate < 0.0)) | ((self.position >= self.upper) & (rate > 0.0))
        if blocked.any():
            rate = _least_squares(np.where(blocked, 0.0, jacobian), twist, np.where(blocked, 0.0, idle))
        rate *= 1.0 / max(1.0, float((np.abs(rate) / self._highest).max()))
        return rate


def _least_squares(jacobian: FloatArray, twist: FloatArray, idle: FloatArray) -> FloatArray:
    """(m,) damped least squares for a twist (6,); what does not move the hand goes as ``idle`` says."""
    square = jacobian @ jacobian.T
    square.flat[::7] += DAMPING * DAMPING
    result: FloatArray = idle + jacobian.T @ np.linalg.solve(square, twist - jacobian @ idle)
    return result
