"""Motions by which a robot gets up: the key poses from which a search starts, and what their end must be."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.get_up_planning.rollouts import Rollouts, Target
from valor.get_up_planning.search import SLOWEST, Search
from valor.robot.get_up_table import Posture
from valor.robot.mirror import counterparts, mirrored
from valor.robot.tables import SIDES
from valor.robot_setup.posture import Chain, Poser

BALANCED = -0.5  # cost of a robot on its soles, at most
REACHES = {  # of the hands from the shoulders: forward, outward, up, in lengths of the arm
    "free the arms": (0.3, 0.6, 0.4),
    "tuck": (0.65, 0.3, 0.5),
    "push up": (0.9, 0.2, -0.2),
    "squat": (0.8, 0.15, -0.2),
}
SPREAD = 0.12  # of joints on the way over the knees [rad]
ARMS_OUT = (-0.1, 0.75, -0.35)  # as REACHES, after rolling over
CHANGE = 0.3  # of flexion [rad] and of durations [1] while a motion is tuned, at most
APART, BENT = 0.3, 0.25  # hips outward and trunk forward in a squat [rad]
DEEP = 0.97  # flexion of the legs in a squat, of the largest


class Key(NamedTuple):
    """Key pose on the way over the knees, from which a search starts, and the pelvis pitch after it.

    Flexion of hip, knee and ankle, at most DEEP, roll of the hips outward, pitch [rad]; reach as REACHES; duration [s].
    """

    name: str
    pitch: float
    hip: float
    knee: float
    ankle: float
    apart: float
    reach: tuple[float, float, float]
    duration: float
    turned: bool = False  # the arms, as overhead


FOLDED = 2.6  # flexion of the knees of a robot that squats from the floor, at least [rad]
ON_HANDS_AND_KNEES = (
    Key("hips up", 2.2, 2.05, 1.2, 0.8, 0.0, (0.1, 0.97, 0.0), 0.3),
    Key("turn the arms", 2.2, 2.05, 1.2, 0.8, 0.0, (0.1, 0.97, 0.05), 0.3, turned=True),
    Key("arms overhead", 2.1, 2.05, 1.7, 0.8, 0.0, (0.3, 0.4, 0.8), 0.3),
    Key("on all fours", 1.6, 1.9, 9.0, 0.8, 0.1, (0.73, 0.48, 0.29), 0.7),
    Key("press up", 1.4, 1.86, 9.0, 0.75, 0.0, (0.84, 0.2, 0.13), 0.4),
    Key("hands back", 1.2, 1.55, 9.0, 0.85, 0.15, (0.79, 0.1, -0.31), 0.5),
)
ON_KNEES = (
    Key("sit back", 1.4, 1.8, 9.0, 0.1, 0.45, (0.71, 0.17, 0.49), 0.5),
    Key("stretch the feet", 1.15, 2.0, 9.0, -0.42, 0.5, (0.75, 0.0, 0.35), 0.5),
    Key("hands off", 0.3, 0.9, 9.0, -0.5, 0.7, (-0.08, 0.5, -0.77), 0.6),
    Key("kneel", 0.0, 0.25, 2.05, -0.4, 0.7, (-0.29, 0.2, -0.81), 0.7),
)
ON_FEET = (
    Key("bend the toes", -0.1, 0.1, 9.0, 9.0, 0.0, (0.55, 0.28, -0.65), 0.5),
    Key("lean back", -0.8, -0.3, 9.0, 9.0, 0.0, (0.4, 0.28, -0.75), 0.9),
    Key("onto the toes", -0.7, -0.4, 1.6, 9.0, 0.0, (0.5, 0.28, -0.7), 0.3),
    Key("knees up", -0.45, 0.05, 1.45, 9.0, 0.0, (0.45, 0.28, -0.7), 0.25),
    Key("onto the soles", -0.35, 0.0, 1.15, 0.8, 0.0, (0.45, 0.28, -0.7), 0.5),
    Key("straighten", -0.1, 0.4, 1.05, 0.55, 0.0, (0.5, 0.28, -0.67), 0.6),
)


class Symmetric(Search):
    """Motion through postures with both sides alike, to a stance on both soles."""

    _moved: list[int]  # joints in the vector
    _goals: FloatArray  # (k, n) goals with the other joints [rad]

    def __init__(self, rollouts: Rollouts, onward: Sequence[Target] = ()) -> None:
        super().__init__(rollouts, onward)
        robot, self._stance = self.robot, rollouts.stance
        self._right = [robot.index[name] for limb in ("leg", "arm") for name in robot.tables.group(f"right_{limb}")]
        self._pitch = [robot.index[name] for name in self._stance.pitch_joints("left")]
        self.knee = self._pitch[1]
        axes = np.array([self._stance.data.joint(name).xaxis @ self._stance.base[1] for name in robot.joints])
        self._turns = np.sign(axes)  # (n, 3) directions of the axes along the pelvis' in the nominal posture
        self._signs = self._turns[self._pitch, 1] * (-1.0, 1.0, -1.0)  # of flexion
        hip = [robot.index[name] for name in robot.tables.group("left_leg")[:3]]
        self._hip_roll = hip[int(np.argmax(np.abs(axes[hip, 0])))]
        self._deepest = DEEP * np.max(self._signs * (robot.lower[self._pitch], robot.upper[self._pitch]), axis=0)
        self.folds = self._deepest[1] > FOLDED
        self._standing = self._signs * robot.nominal_posture[self._pitch]
        self._others = [i for name in robot.tables.group("left_leg") if (i := robot.index[name]) not in self._pitch]
        self._ahead = self._posed(self._standing, REACHES["squat"])  # the arms
        self._leg = self._stance.mean_leg_length

    def cost(self, states: Sequence[FloatArray]) -> float:
        return self._off(states[-1])

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        return self.upright(states[-1])

    def upright(self, state: FloatArray) -> bool:
        """Return whether the robot stands."""
        height = state[3] / self.robot.tables.nominal_base_height
        return bool(height > 0.93) and self._off(state) < BALANCED

    def _off(self, state: FloatArray) -> float:
        """Return the distance from rest with the CoM above the middle of level soles."""
        com, forward, tilt, height = self.rollouts.over_soles(state)
        foot, leg = self._stance.foot("left"), self._leg
        aside = np.hypot(*(com[:2] - 0.25 * (foot.heel + foot.toe) * forward))
        speed = min(self.rollouts.speed(state), 3.0)
        return (
            float(5.0 * min(tilt, 0.4) + 3.0 * min(height / leg, 0.4) + 5.0 * min(aside / leg, 0.4) + 0.2 * speed) - 1.0
        )

    def _posed(
        self, flexion: Sequence[float] | FloatArray, reach: tuple[float, float, float], near: FloatArray | None = None
    ) -> FloatArray:
        """Return a posture (n,) by the flexion of hip, knee and ankle [rad] and the reach of the hands.

        ``near``: a posture (n,) with the arms like it.
        """
        robot, posture = self.robot, self.robot.nominal_posture.copy()
        self._bend(posture, np.asarray(flexion))
        if (arm := robot.tables.group("left_arm")) and (hand := robot.tables.hands.left):
            rest = dict(zip(robot.joints, robot.nominal_posture.tolist(), strict=True))
            chain = Chain(tuple(arm), hand.site)
            like = None if near is None else dict(zip(robot.joints, near.tolist(), strict=True))
            angles = Poser(self._stance.model.mj).solve_reach(chain, np.array(reach), rest, like)
            posture[[robot.index[joint] for joint in angles]] = list(angles.values())
        return self._symmetric(posture)

    def bent(self, pose: Target, more: float) -> Target:
        """Return a key pose with both knees flexed more [rad]."""
        goal = pose.goal.copy()
        goal[self.knee] += self._signs[1] * more
        return replace(pose, goal=self._symmetric(goal))

    def _moving(self, vector: FloatArray) -> tuple[FloatArray, list[float]]:
        """Return goals (k, n) [rad] and durations (k,) [s] that a vector states for the joints that it moves."""
        goals, count = self._goals.copy(), len(self._goals)
        goals[:, self._moved] = vector[:-count].reshape(count, -1)
        return goals, vector[-count:].tolist()

    def _bend(self, posture: FloatArray, flexion: FloatArray) -> None:
        """Set the left leg's joints by the flexion of hip, knee and ankle [rad]; a folded leg does not lean outward."""
        (_, least, _), (_, most, _) = self._standing, self._deepest
        folded = np.clip((flexion[1] - least) / (most - least), 0.0, 1.0)
        posture[self._pitch] = self._signs * flexion
        posture[self._others] = (1.0 - folded) * self.robot.nominal_posture[self._others]

    def _symmetric(self, postures: FloatArray) -> FloatArray:
        """Return postures (…, n) with the right side as the mirror image of the left one."""
        postures[..., self._right] = mirrored(self.robot, postures)[..., self._right]
        return postures.clip(self.robot.lower, self.robot.upper)

    def _balanced(self, knee: float, ankle: float) -> FloatArray:
        """Return the flexion of hip, knee and ankle [rad] with the CoM nearest to above the middle of the soles."""
        model, data, foot = self._stance.model, self._stance.data, self._stance.foot("left")
        middle, found = 0.5 * (foot.heel + foot.toe), list[tuple[float, float]]()
        for hip in np.linspace(0.0, self._deepest[0], 60).tolist():
            posture = self._ahead.copy()
            self._bend(posture, np.array((hip, knee, ankle)))
            data.qpos[:] = model.nominal_qpos()
            data.qpos[model.qpos] = self._symmetric(posture)
            mujoco.mj_kinematics(model.mj, data)
            mujoco.mj_comPos(model.mj, data)
            position, rotation = self._stance.site(foot.sole)
            found.append((abs(float((self._stance.com - position) @ rotation[:, 0]) - middle), hip))
        return np.array((min(found)[1], knee, ankle))


class RollOver(Symmetric):
    """Motion from the back or the right side to the face."""

    start, to, names = (Posture.BACK, Posture.RIGHT), Posture.FACE, ("wind up", "roll over", "stretch out")

    def __init__(self, rollouts: Rollouts, onward: Sequence[Target] = ()) -> None:
        super().__init__(rollouts, onward)
        self._end = -1 - len(onward)
        groups = [f"{side}_{limb}" for limb in ("leg", "arm") for side in SIDES]
        self._moved = self.indices(*groups, "torso")
        rest, count = self.robot.nominal_posture[self._moved], len(self.names)
        end = self._posed((0.0, 0.1, 0.5), ARMS_OUT, self.robot.nominal_posture)[self._moved]
        self._goals = np.tile(self.robot.nominal_posture, (count, 1))
        self.mean = np.concatenate([rest, rest, end, np.full(count, 0.6)])
        self.bound(self._moved, count)
        self.spread = np.concatenate([np.full(2 * rest.size, 0.5), np.full(rest.size, 0.2), np.full(count, 0.15)])

    def targets(self, vector: FloatArray) -> list[Target]:
        return [*map(Target, self.names, *self._moving(vector), (0.0, 0.0, 0.3))]

    def cost(self, states: Sequence[FloatArray]) -> float:
        forward, _, up = self.rollouts.upwards(states[self._end])
        speed = min(self.rollouts.speed(states[self._end]), 3.0)
        return float(1.0 + forward + abs(up) + 0.1 * speed + self._rolled(states) - self.succeeded(states))

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        return self._rolled(states) < 0.2

    def _rolled(self, states: Sequence[FloatArray]) -> float:
        """Return the largest sine of the pelvis' roll, from the end of the motion on; 1 if that is not on the face."""
        forward, _, up = self.rollouts.upwards(states[self._end])
        if forward > -0.85 or abs(up) > 0.5:
            return 1.0
        return max(abs(self.rollouts.upwards(state)[1]) for state in states[self._end :])


class Squat(Symmetric):
    """Motion from the face to a squat."""

    start, to = (Posture.FACE,), "squat"

    def __init__(self, rollouts: Rollouts) -> None:
        super().__init__(rollouts)
        counterpart, sign = counterparts(self.robot)
        middle = [i for i in self.indices("torso") if counterpart[i] == i and sign[i] > 0.0]
        self._moved = [*self.indices("left_leg")[:-1], *self.indices("left_arm"), *middle]
        _, knee, ankle = self._deepest
        legs = ((0.1, 0.3, ankle), self._deepest, self._deepest, self._balanced(knee, ankle))
        poses = np.array([self._posed(*each) for each in zip(legs, REACHES.values(), strict=True)])
        poses[1:, self._hip_roll] += APART * self._turns[self._hip_roll, 0]
        poses[1:, middle] += BENT * self._turns[middle, 1]
        self._goals = np.tile(self.robot.nominal_posture, (len(poses), 1))
        self._goals[:, self._others] = poses[:, self._others]
        self.mean = np.concatenate([*poses[:, self._moved], (0.6, 0.6, 0.5, 0.4)])
        self.bound(self._moved, len(REACHES))
        self.spread = np.full(self.mean.size, 0.25)
        self.spread[-len(REACHES) :] = 0.1

    def targets(self, vector: FloatArray) -> list[Target]:
        goals, durations = self._moving(vector)
        last = (False, False, False, True)
        return [*map(Target, REACHES, self._symmetric(goals), durations, (0.0, 0.0, 0.0, 0.3), last)]

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        return self._off(states[-1]) < BALANCED


class StandUp(Symmetric):
    """Motion from the squat to the nominal posture: the flexion of the legs between."""

    start, to, names = (None,), Posture.STANDING, ("rise", "straighten", "upright")

    def __init__(self, rollouts: Rollouts) -> None:
        super().__init__(rollouts)
        ends = self._balanced(*self._deepest[1:]), self._standing
        between = [ends[0] + share * (ends[1] - ends[0]) for share in (0.33, 0.67)]
        self._poses = np.tile(self._ahead, (len(between), 1))
        self.mean = np.concatenate([*(self._balanced(*flexion[1:]) for flexion in between), (0.5, 0.5, 0.5)])
        self.lower = np.concatenate([np.tile(self._deepest - 2.5, 2), np.full(3, 0.3)])
        self.upper = np.concatenate([np.tile(self._deepest, 2), np.full(3, 1.5)])
        self.spread = np.concatenate([np.full(6, 0.15), np.full(3, 0.1)])

    def targets(self, vector: FloatArray) -> list[Target]:
        for pose, flexion in zip(self._poses, vector[:6].reshape(2, 3), strict=True):
            self._bend(pose, flexion)
        goals = [*self._symmetric(self._poses), self.robot.nominal_posture]
        return [*map(Target, self.names, goals, vector[6:].tolist(), (0.0, 0.0, 0.5), (True,) * 3)]

    def cost(self, states: Sequence[FloatArray]) -> float:
        upright = 1.0 - self.rollouts.upwards(states[-1])[2]
        return float(np.mean([self._off(state) for state in states]) + 5.0 * upright)


class OverKnees(Symmetric):
    """Part of the symmetric way from the face over the knees to standing."""

    keys: tuple[Key, ...]
    hold = 0.3  # after the last key pose [s]

    def __init__(self, rollouts: Rollouts) -> None:
        super().__init__(rollouts)
        count = len(self.keys)
        overhead = self._posed(self._standing, (0.2, 0.3, 0.93))
        goals = list[FloatArray]()
        for key in self.keys:
            near = overhead if key.turned else goals[-1] if goals else None
            goals.append(self._posed(np.minimum((key.hip, key.knee, key.ankle), self._deepest), key.reach, near))
        self._goals = np.array(goals)
        self._moved = [*self.indices("left_leg")[:-1], *self.indices("left_arm")]
        self._goals[:, self._hip_roll] += self._turns[self._hip_roll, 0] * np.array([key.apart for key in self.keys])
        self.mean = np.concatenate([*self._goals[:, self._moved], [key.duration for key in self.keys]])
        self.bound(self._moved, count)
        self.spread = np.concatenate([np.full(count * len(self._moved), SPREAD), np.full(count, 0.1)])

    def targets(self, vector: FloatArray) -> list[Target]:
        goals, durations = self._moving(vector)
        names, holds = [key.name for key in self.keys], [0.0] * (len(goals) - 1) + [self.hold]
        return [*map(Target, names, self._symmetric(goals), durations, holds)]

    def cost(self, states: Sequence[FloatArray]) -> float:
        off = [min(self._aside(state, key.pitch), 1.5) for state, key in zip(states, self.keys, strict=False)]
        return sum(off) + off[-1] + 0.2 * min(self.rollouts.speed(states[-1]), 3.0) - self.succeeded(states)

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        return self._aside(states[-1], self.keys[-1].pitch) < 0.25 and self.rollouts.speed(states[-1]) < 1.0

    def _aside(self, state: FloatArray, pitch: float) -> float:
        """Return the angle of the pelvis from one without roll and of that pitch [rad]."""
        forward, left, up = self.rollouts.upwards(state)
        return float(np.hypot((np.arctan2(-forward, up) - pitch + np.pi) % (2.0 * np.pi) - np.pi, left))


class OnHandsAndKnees(OverKnees):
    """Motion from the face to hands and knees."""

    start, to, keys, hold = (Posture.FACE,), "hands and knees", ON_HANDS_AND_KNEES, 0.0


class OnKnees(OverKnees):
    """Motion from hands and knees to the knees, without rocking there."""

    start, to, keys = (None,), "the knees", ON_KNEES

    def __init__(self, rollouts: Rollouts) -> None:
        super().__init__(rollouts)
        self.lower[-1] = self.mean[-1]  # a quicker motion ends in rocking


class OnFeet(OverKnees):
    """Motion from the knees over the toes to the nominal posture."""

    start, to, keys, hold = (None,), Posture.STANDING, ON_FEET, 0.5

    def __init__(self, rollouts: Rollouts) -> None:
        super().__init__(rollouts)
        self.mean, self.spread = np.append(self.mean, 0.6), np.append(self.spread, 0.1)  # of the last motion's duration
        self.lower, self.upper = np.append(self.lower, SLOWEST[0]), np.append(self.upper, SLOWEST[1])

    def targets(self, vector: FloatArray) -> list[Target]:
        *poses, last = super().targets(vector[:-1])
        poses += replace(last, hold=0.0), Target("upright", self.robot.nominal_posture, float(vector[-1]), self.hold)
        return [replace(each, balanced=i >= len(poses) - 3) for i, each in enumerate(poses)]

    def cost(self, states: Sequence[FloatArray]) -> float:
        upright = 1.0 - self.rollouts.upwards(states[-1])[2]
        return super().cost(states) + self._off(states[-1]) + 5.0 * upright

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        return self.upright(states[-1])


class Throw(Symmetric):
    """Given motion from the knees to standing, to be changed a little: it is narrow, and its ground and robot vary."""

    start, to = (None,), f"{Posture.STANDING} from many falls"

    def __init__(self, rollouts: Rollouts, poses: Sequence[Target]) -> None:
        super().__init__(rollouts)
        self._poses, count = poses, len(poses)
        self.mean = np.zeros(3 * count)  # flexion of the hips and of the knees [rad], durations [1]
        self.spread = np.repeat((0.12, 0.12, 0.25), count)
        self.lower, self.upper = self.mean - CHANGE, self.mean + CHANGE

    def targets(self, vector: FloatArray) -> list[Target]:
        *flexions, longer = vector.reshape(3, -1)
        goals = np.array([pose.goal for pose in self._poses])
        goals[:-1, self._pitch[:2]] += self._signs[:2] * np.transpose(flexions)[:-1]  # the last is the nominal posture
        return [
            replace(pose, goal=goal, duration=pose.duration * (1.0 + more))
            for pose, goal, more in zip(self._poses, self._symmetric(goals), longer.tolist(), strict=True)
        ]

    def cost(self, states: Sequence[FloatArray]) -> float:
        tilt = 1.0 - self.rollouts.upwards(states[-1])[2]
        return 0.1 * self._off(states[-1]) + 0.5 * min(tilt, 1.0) - 0.5 * self.succeeded(states)
