"""One arm that a goal leads: where it is told to go, how far its hand is, and why it gets no farther."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.motion_manager.hands.arm_kinematics import LESSER, ArmKinematics, Speeds
from valor.motion_manager.hands.reach_search import ReachSearch, Start
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.model import Model
from valor.robot.tables import Hand, Side
from valor.whole_body.tuning_tables import HandMotion, Tuning

SMOOTHING = 0.03  # of how the rates change [s]
MARGIN = 0.02  # kept from the joints' limits [rad]
REACHED = (0.005, 0.02)  # most position and orientation errors of a goal that is reached [m, rad]
STALLED_RATE = 0.02  # of every joint, below which an arm counts as not getting on [rad/s]
NEARER = 0.003  # that a hand must come nearer [m, with LESSER also rad] …
CIRCLING = 3.0  # … in so long, or its arm moves to no purpose [s]
STUCK = 0.06  # of a joint from its set-point, more than play and friction leave [rad] …
STUCK_TIME = 1.5  # … for so long: it is taken to stay there, and the others make up for it [s]
PASSED = (0.05, 0.01)  # from a posture on the way, and the last, at which what follows is gone to [rad]
MOVED = 0.03  # of a target since its way was searched, from which on it is searched anew [m, with LESSER also rad]


@dataclass(frozen=True, slots=True)
class HandGoal:
    """Where a hand shall be."""

    in_odom: bool  # else in pelvis
    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)


class LedArm:
    """One arm, and what became of its goal; ``kinematics`` has its target in pelvis."""

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
        self.errors = self.led = (0.0, 0.0)  # of the hand as it is, and as its arm is led [m, rad]
        self._stuck = np.zeros(len(self.joints), dtype=bool)
        self._followed_since = np.zeros(len(self.joints))  # [s]
        self._nearest, self._neared = np.inf, 0.0
        self._way = list[FloatArray]()
        self._searched: tuple[FloatArray, FloatArray] | None = None  # the target of the last whole search

    def rest(self) -> None:
        """Nothing moves any more."""
        self._rate = self.acceleration = self.still
        self.search.stop()
        self._way = []

    def begin(self, goal: HandGoal, now: float) -> None:
        """Go to a goal."""
        self.goal, self.stalled_since, self.reason = goal, now, ""
        self._stuck[:], self._followed_since[:] = False, now
        self._nearest, self._neared = np.inf, now
        self.kinematics.posture[:], self.kinematics.stuck[:] = self._nominal, 0.0
        self.search.stop()
        self._way, self._searched = [], None

    def arrive(self, now: float) -> None:
        """It is where it shall be."""
        self.stalled_since, self.reason = now, ""
        self._nearest, self._neared = np.inf, now

    def target(self, place: FloatArray, turn: FloatArray, carried: FloatArray) -> None:
        """Where the hand shall be in pelvis now, and the twist (6,) it has there."""
        k = self.kinematics
        k.place[:], k.turn[:], k.carried[:] = place, turn, carried

    def advance(self, joint_position: FloatArray, dt: float) -> FloatArray:
        """Go a period towards the target: the (m,) rates [rad/s]; (n,) as all joints are led [rad]."""
        assert self.position is not None
        k = self.kinematics
        k.stand(joint_position)
        k.position[:] = self.position
        if self._searched is None and self.search.over:
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
        """Note how far the hand is from its target, by (n,) measured positions [rad]."""
        k = self.kinematics
        k.stand(measured)
        k.position[:] = measured[self.joints]
        k.look()
        self.errors = (float(k.errors[0]), float(k.errors[1]))

    def find_stuck(self, measured: FloatArray, now: float) -> None:
        """Which joints do not go where they are told; (m,) positions [rad]."""
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
        """Whether its set-points do."""
        return bool(np.abs(self._rate).max() > STALLED_RATE)

    @property
    def under_way(self) -> bool:
        """Whether it goes round, or looks for a way."""
        return bool(self._way) or not self.search.over

    def nears(self, now: float) -> bool:
        """Whether the hand is led nearer to its target than it was a while ago."""
        left = self.led[0] + LESSER * self.led[1]
        if left < self._nearest - NEARER:
            self._nearest, self._neared = left, now
        return now - self._neared < CIRCLING

    def looks_elsewhere(self, joint_position: FloatArray) -> bool:
        """Going straight has ended short: whether another way is searched, none having been for this target."""
        k = self.kinematics
        if self._searched is not None and not self.search.straight:
            off = np.linalg.norm(k.place - self._searched[0]) + LESSER * np.abs(k.turn - self._searched[1]).max()
            if off < MOVED:
                return False
        self._find_way(joint_position, tried=True)
        return True

    def complaint(self, measured: FloatArray) -> str:
        """What keeps the hand from its goal."""
        assert self.position is not None
        distance, angle = self.errors
        text = f"the {self.side} hand gets no nearer: {distance:.3f} m and {angle:.3f} rad remain"
        limited = (self.position <= self.lower) | (self.position >= self.upper)
        lag = np.abs(self.position - measured)
        if self._stuck.any():
            return f"{text}; does not follow: {self._listed(self._stuck)}"
        if self.search.barred:
            return f"{text}; no way is found that keeps the arm off the body"
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
        """Whatever the search has come to; and the next posture, where one is passed."""
        self.search.advance()
        if self.search.over and self.search.way:
            self._way, self.search.way = self.search.way, []
        while self._way and np.abs(self._way[0] - self.kinematics.position).max() < PASSED[len(self._way) == 1]:
            self.kinematics.posture[:] = self._way.pop(0)
            self._nearest = np.inf

    def _listed(self, which: npt.NDArray[np.bool_]) -> str:
        return ", ".join(name for name, chosen in zip(self._names, which, strict=True) if chosen)


def within(errors: tuple[float, float], times: float) -> bool:
    """Whether a goal counts as reached."""
    return errors[0] <= times * REACHED[0] and errors[1] <= times * REACHED[1]
