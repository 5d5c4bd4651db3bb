"""Cartesian goals of the hands: inverse kinematics with limited speed, integrated to arm set-points.

Each period, the hand's error e (position, rotation vector) gives the desired twist k·e, limited to the largest speeds.
Damped least squares give the rates of the arm's joints

    q̇ = Jᵀ·(J·Jᵀ + λ²·1)⁻¹·twist + (1 − J⁺·J)·k₀·(q_posture − q),

without joints at a limit (``arm_kinematics``). The joint reference follows the integrated rates like other set-points.
If straight motion ends in a corner of the limits, the arm follows a searched path (``reach_search``). A goal in odom
moves in the pelvis frame with the estimated pelvis. The status uses measured joints, and names joints that do not
follow.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.messages import HandGoalStatus
from valor.control.state import RobotState
from valor.control.tuning_tables import HandMotion, Tuning
from valor.motion_manager.hands.arm_kinematics import LESSER, ArmKinematics, Speeds
from valor.motion_manager.hands.goal_stream import GoalStream, HandGoal
from valor.motion_manager.hands.reach_search import ReachSearch, Start
from valor.motion_manager.joints.joint_reference import JointReference, Setpoint
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.robot.tables import Hand, Side

SIDES: tuple[Side, Side] = ("left", "right")
GRACE = 0.05  # delay from a goal to its first motion, for clients to stop their set-points [s]
STALLED_TIME = 0.5  # time without motion after which a goal is out of reach [s]
SETTLING = 2.5  # time for the joints to reach set-points at the goal [s]
LEAVING = 2.0  # factor on REACHED within which a reached goal stays reached
AWAY = 0.3  # time for a goal to move a hand away from an obstacle [s]
LOOK = 0.02  # period of updates of the errors [s]
SMOOTHING = 0.03  # time constant of the acceleration [s]
MARGIN = 0.02  # distance from the joint limits [rad]
REACHED = (0.005, 0.02)  # largest errors of a reached goal [m, rad]
STALLED_RATE = 0.02  # rate of every joint below which an arm stalls [rad/s]
NEARER = 0.003  # least approach within ``CIRCLING`` [m, with LESSER also rad]
CIRCLING = 3.0  # time without approach after which an arm circles [s]
STUCK = 0.06  # error of a joint larger than play and friction cause [rad]
STUCK_TIME = 1.5  # time with such an error after which a joint is stuck, and the others compensate [s]
PASSED = (0.05, 0.01)  # distance at which an intermediate, and the last, posture is passed [rad]
MOVED = 0.03  # motion of a target after which its path is searched again [m, with LESSER also rad]


class GoalControlledArm:
    """One arm and the state of its goal; ``kinematics`` has its target in pelvis."""

    def __init__(self, model: Model, hand: Hand, side: Side, nominal: FloatArray) -> None:
        robot = model.robot
        self.side = side
        self.joints = robot.group_indices(f"{side}_arm")
        table: HandMotion = robot.read(Tuning).hand_goals
        limits = CommandedLimits.of_joints(robot).select(self.joints)
        self.lower, self.upper = limits.lower + MARGIN, limits.upper - MARGIN
        highest = np.minimum(table.joint_speed * robot.velocity_limit[self.joints], limits.velocity)
        speeds, bounds = Speeds(table.max_speed, table.max_turn_rate, highest), (self.lower, self.upper)
        self.kinematics, tried = (ArmKinematics(model, hand, side, bounds, speeds) for _ in range(2))
        self.stream = GoalStream(2.0 * np.array((table.max_speed, table.max_turn_rate)))  # in odom, with the pelvis'
        self._nominal = nominal[self.joints]
        self.search = ReachSearch(model, self.kinematics, tried, nominal=self._nominal, bounds=bounds, speed=highest)
        self.still, self.standing = np.zeros(len(self.joints)), np.zeros(6)
        self._rate = self.acceleration = self.still
        self._names = [robot.joints[i] for i in self.joints]
        self.goal: HandGoal | None = None
        self.begins = 0.0
        self.position: FloatArray | None = None  # (m,) integrated [rad]
        self.stalled_since = 0.0
        self.state, self.reason = "idle", ""
        self.errors = self.led = (0.0, 0.0)  # of the hand: measured, and at the set-points [m, rad]
        self._stuck = np.zeros(len(self.joints), dtype=bool)
        self._followed_since = np.zeros(len(self.joints))  # [s]
        self._nearest, self._neared = np.inf, 0.0
        self._way = list[FloatArray]()
        self._searched: tuple[FloatArray, FloatArray] | None = None  # target of the last search

    def rest(self) -> None:
        """Stop all motion."""
        self._rate = self.acceleration = self.still
        self.search.stop()
        self.stream.clear()
        self._way = []

    def begin(self, goal: HandGoal, now: float) -> None:
        """Start a goal."""
        self.goal, self.stalled_since, self.reason = goal, now, ""
        self.stream.add(goal, now)
        self._stuck[:], self._followed_since[:] = False, now
        self._nearest, self._neared = np.inf, now
        self.kinematics.posture[:], self.kinematics.stuck[:] = self._nominal, 0.0
        self.search.stop()
        self._way, self._searched = [], None

    def arrive(self, now: float) -> None:
        """The goal is reached: restart the timers."""
        self.stalled_since, self.reason = now, ""
        self._nearest, self._neared = np.inf, now

    def target(self, state: RobotState, now: float) -> None:
        """Set the target's pose in pelvis, and its twists (6,): by the pelvis, and of a stream."""
        k, goal = self.kinematics, self.goal
        assert goal is not None
        (place, turn, twist), carried = self.stream.at(goal, now), self.standing
        if goal.in_odom:
            twist = (twist.reshape(2, 3) @ state.pelvis_rotation_in_odom).ravel()
            place, turn, carried = seen_from_pelvis(place, turn, state)
        k.place[:], k.turn[:], k.carried[:], k.streamed[:] = place, turn, carried, twist

    def advance(self, joint_position: FloatArray, dt: float) -> FloatArray:
        """Move one period towards the target, by (n,) commanded positions [rad]; returns (m,) rates [rad/s]."""
        assert self.position is not None
        k = self.kinematics
        k.stand(joint_position)
        k.position[:] = self.position
        if self._searched is None and self.search.over and not self.streamed:
            self._find_way(joint_position, tried=False)
        self._take_up_way()
        k.lead()
        self.led = (float(k.errors[0]), float(k.errors[1]))
        if self._way:
            k.posture[:] = self._way[0]
            k.move()
        rate = k.rate.copy()
        self.position = np.clip(self.position + rate * dt, self.lower, self.upper)
        self.acceleration = self.acceleration + dt / SMOOTHING * ((rate - self._rate) / dt - self.acceleration)
        self._rate = rate
        return rate

    def look(self, measured: FloatArray) -> None:
        """Update the errors of the hand by (n,) measured positions [rad]."""
        k = self.kinematics
        k.stand(measured)
        k.position[:] = measured[self.joints]
        k.look()
        self.errors = (float(k.errors[0]), float(k.errors[1]))

    def find_stuck(self, measured: FloatArray, now: float) -> None:
        """Update the stuck joints by (m,) measured positions [rad]."""
        assert self.position is not None
        np.copyto(self._followed_since, now, where=np.abs(self.position - measured) < STUCK)
        stuck = self._stuck | (now - self._followed_since > STUCK_TIME)
        if (stuck != self._stuck).any():
            self._stuck = stuck
            self.kinematics.stuck[:] = stuck
            self.search.stop()
            self._way, self._searched = [], None
        self.position = np.where(self._stuck, np.clip(measured, self.lower, self.upper), self.position)

    @property
    def moves(self) -> bool:
        """True if its set-points move."""
        return bool(np.abs(self._rate).max() > STALLED_RATE)

    @property
    def streamed(self) -> bool:
        """True while its target moves with a stream of goals."""
        return bool(self.kinematics.streamed.any())

    @property
    def under_way(self) -> bool:
        """True if it follows a searched path, or searches."""
        return bool(self._way) or not self.search.over

    def nears(self, now: float) -> bool:
        """Return whether the set-points have approached the target within ``CIRCLING``."""
        left = self.led[0] + LESSER * self.led[1]
        if left < self._nearest - NEARER:
            self._nearest, self._neared = left, now
        return now - self._neared < CIRCLING

    def looks_elsewhere(self, joint_position: FloatArray) -> bool:
        """Start a search after straight motion ended short; returns False after a search for this target."""
        k = self.kinematics
        if self._searched is not None and not self.search.straight:
            off = np.linalg.norm(k.place - self._searched[0]) + LESSER * np.abs(k.turn - self._searched[1]).max()
            if off < MOVED:
                return False
        self._find_way(joint_position, tried=True)
        return True

    def complaint(self, measured: FloatArray) -> str:
        """Reason why the hand does not reach its goal."""
        assert self.position is not None
        distance, angle = self.errors
        text = f"the {self.side} hand gets no nearer: {distance:.3f} m and {angle:.3f} rad remain"
        limited = (self.position <= self.lower) | (self.position >= self.upper)
        lag = np.abs(self.position - measured)
        if self._stuck.any():
            return f"{text}; does not follow: {self._listed(self._stuck)}"
        if self.search.barred:
            return f"{text}; no path avoids the body"
        if limited.any():
            return f"{text}; at its limit: {self._listed(limited)}"
        if not within(self.led, 1.0):
            return text
        return f"{text}; {self._names[int(lag.argmax())]} stays {lag.max():.3f} rad from its set-point"

    def _find_way(self, joint_position: FloatArray, *, tried: bool) -> None:
        assert self.position is not None
        k = self.kinematics
        self._searched = k.place.copy(), k.turn.copy()
        self.search.begin(Start(self.position.copy(), joint_position.copy(), k.stuck.copy(), tried))

    def _take_up_way(self) -> None:
        """Use the path of a finished search; continue with the next posture when one is passed."""
        self.search.advance()
        if self.search.over and self.search.way:
            self._way, self.search.way = self.search.way, []
        while self._way and np.abs(self._way[0] - self.kinematics.position).max() < PASSED[len(self._way) == 1]:
            self.kinematics.posture[:] = self._way.pop(0)
            self._nearest = np.inf

    def _listed(self, which: npt.NDArray[np.bool_]) -> str:
        return ", ".join(name for name, chosen in zip(self._names, which, strict=True) if chosen)


def within(errors: tuple[float, float], times: float) -> bool:
    """Return whether errors are within ``times`` those of a reached goal."""
    return errors[0] <= times * REACHED[0] and errors[1] <= times * REACHED[1]


class HandGoals:
    """Goals of both arms, where the robot has them."""

    def __init__(self, model: Model, reference: JointReference, nominal: FloatArray) -> None:
        """``reference`` follows the goals; ``nominal`` (n,) is the preferred posture [rad]."""
        self._arms = {side: GoalControlledArm(model, hand, SIDES[side], nominal) for side, hand in _led(model.robot)}
        self._reference = reference
        self.changes = 0  # number of changes of the hands' ``status`` other than errors
        self._updated = -np.inf  # time of the last update of the errors [s]

    @property
    def active(self) -> bool:
        """True if a goal controls any arm."""
        return any(arm.goal is not None for arm in self._arms.values())

    @property
    def sides(self) -> Iterable[int]:
        """Hands that goals can control: 0 left, 1 right."""
        return self._arms

    def leads(self, side: int) -> bool:
        """Return whether a goal controls an arm."""
        return side in self._arms and self._arms[side].goal is not None

    def moves(self, side: int, now: float) -> bool:
        """Return whether a goal moves an arm at robot time ``now`` [s], so that its set-points are rejected."""
        return self.leads(side) and now >= self._arms[side].begins

    def start(self, side: int, goal: HandGoal, now: float) -> None:
        """Start a goal, or replace the present one."""
        arm = self._arms[side]
        if arm.goal is None:
            arm.begins = now + GRACE
        arm.begin(goal, now)
        self._updated = -np.inf
        self._set_state(arm, "moving")

    def release(self, side: int, reason: str, state: str = "idle") -> None:
        """End a goal: the arm stays where it is, and accepts set-points."""
        arm = self._arms[side]
        if arm.goal is None:
            return
        if arm.position is not None:
            self._reference.follow(Setpoint(arm.joints, arm.position, arm.still, arm.still, 0.0))
        arm.goal, arm.position, arm.reason = None, None, reason
        arm.rest()
        self._set_state(arm, state)

    def give_way(self, side: int, reason: str, measured: FloatArray, now: float) -> None:
        """End the goal of a resisted hand: its arm stays at its measured position (n,) [rad]."""
        if self.leads(side) and now > self._arms[side].begins + AWAY:
            arm = self._arms[side]
            arm.position = np.clip(measured[arm.joints], arm.lower, arm.upper)
            self.release(side, reason, "resisted")

    def release_all(self, reason: str) -> None:
        """End all goals."""
        for side in self._arms:
            self.release(side, reason)

    def advance(self, state: RobotState, measured: FloatArray, now: float, dt: float) -> None:
        """Advance by ``dt`` to robot time ``now`` [s], before the joint reference; ``measured`` is (n,) [rad]."""
        if not self.active:
            return
        moved = [arm for arm in self._arms.values() if arm.goal is not None and now >= arm.begins]
        for arm in moved:
            self._advance(arm, state, now, dt)
        if moved and now - self._updated >= LOOK:
            self._updated = now
            self._look(moved, measured, now)

    def status(self, side: int, time: int) -> HandGoalStatus:
        """Status of a hand at robot time ``time`` [ns]."""
        arm = self._arms[side]
        return HandGoalStatus(
            time=time,
            hand=side,
            state=arm.state,
            reason=arm.reason,
            position_error=arm.errors[0],
            orientation_error=arm.errors[1],
        )

    def _advance(self, arm: GoalControlledArm, state: RobotState, now: float, dt: float) -> None:
        if arm.position is None:
            arm.position = self._reference.position[arm.joints].copy()
        arm.target(state, now)
        rate = arm.advance(self._reference.position, dt)
        self._reference.follow(Setpoint(arm.joints, arm.position, rate, arm.acceleration, now))

    def _look(self, arms: Iterable[GoalControlledArm], measured: FloatArray, now: float) -> None:
        """Update errors and states of arms by (n,) measured positions [rad]."""
        for arm in arms:
            arm.look(measured)
            position = measured[arm.joints]
            arm.find_stuck(position, now)
            if not arm.streamed and within(arm.errors, LEAVING if arm.state == "reached" else 1.0):
                arm.arrive(now)
                self._set_state(arm, "reached")
            elif arm.streamed or arm.under_way or (arm.moves and arm.nears(now)):
                arm.stalled_since, arm.reason = now, ""
                self._set_state(arm, "moving")
            elif self._stalled(arm, now):
                arm.reason = arm.complaint(position)
                self._set_state(arm, "out_of_reach")

    def _stalled(self, arm: GoalControlledArm, now: float) -> bool:
        if within(arm.led, 1.0):
            return now - arm.stalled_since > SETTLING
        return now - arm.stalled_since > STALLED_TIME and not arm.looks_elsewhere(self._reference.position)

    def _set_state(self, arm: GoalControlledArm, state: str) -> None:
        if state != arm.state:
            arm.state = state
            self.changes += 1


def _led(robot: RobotDescription) -> Iterator[tuple[int, Hand]]:
    """Side (0 left, 1 right) and table of each hand on an arm."""
    for side, hand in robot.tables.hands.present():
        if robot.tables.group(f"{side}_arm"):
            yield SIDES.index(side), hand


def seen_from_pelvis(
    position: FloatArray, turn: FloatArray, state: RobotState
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pose (3,) [m], (3, 3) in pelvis of one in odom, and its twist (6,) in pelvis."""
    inverse = state.pelvis_rotation_in_odom.T
    place: FloatArray = inverse @ (position - state.pelvis_position_in_odom)
    twist, turning = np.empty(6), state.pelvis_angular_velocity_in_pelvis
    twist[:3] = -inverse @ state.pelvis_linear_velocity_in_odom - np.cross(turning, place)
    twist[3:] = -turning
    return place, inverse @ turn, twist
