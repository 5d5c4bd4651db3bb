"""Search for the key poses of a motion: the cross-entropy method on simulated falls.

Candidates are drawn around a mean; the best give the next mean and spread. A found motion is checked on other falls;
those from which it fails join the search.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import LEGS
from valor.common.errors import ValorError
from valor.get_up_planning.rollouts import Fallen, Rollouts, Target
from valor.robot.checks.stance import Stance
from valor.robot.get_up_table import Posture
from valor.robot.mirror import counterparts, mirrored
from valor.robot.tables import SIDES
from valor.robot_setup.posture import Chain, Poser

POPULATION, ELITE, KEPT = 24, 6, 0.3  # candidates, those that count, weight of the mean before
ITERATIONS, LATER = 40, 6  # of a search, and after its motion failed
ROUNDS = 6  # searches, at most
STARTS = 3  # falls of the first search; the others check its motion
PASSED = 0.85  # least share of the checks
TIME = 0.1  # cost of a motion's duration [1/s]
BALANCED = -0.5  # cost of a robot on its soles, at most
SETTLED, WAITED = 0.02, 5  # a search ends if it improves less in iterations
SLOWEST = (0.2, 1.5)  # of a motion to a key pose [s]
REACHES = {  # of the hands from the shoulders: forward, outward, up, in lengths of the arm
    "free the arms": (0.3, 0.6, 0.4),
    "tuck": (0.65, 0.3, 0.5),
    "push up": (0.9, 0.2, -0.2),
    "squat": (0.8, 0.15, -0.2),
}
DEEP = 0.97  # flexion of the legs in a squat, of the largest
Report = Callable[[str], None]


class NoMotionFoundError(ValorError):
    """The search ended without a motion that passes its checks."""


class Search(ABC):
    """Motion of unknown key poses: a vector of joint positions [rad] and durations [s]."""

    start: tuple[Posture | None, ...]
    to: str
    mean: FloatArray
    spread: FloatArray
    lower: FloatArray
    upper: FloatArray

    def __init__(self, rollouts: Rollouts) -> None:
        self.rollouts, self.robot = rollouts, rollouts.robot

    @abstractmethod
    def targets(self, vector: FloatArray) -> list[Target]:
        """Return the key poses."""

    @abstractmethod
    def cost(self, states: Sequence[FloatArray]) -> float:
        """Return the distance of the states after the poses from success."""

    @abstractmethod
    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        """Return whether the motion ends as it should."""

    def indices(self, *groups: str) -> list[int]:
        """Return the indices of the joints of groups; of an arm without those of its wrist."""
        names = [name for group in groups for name in self.robot.tables.group(group)[: None if group in LEGS else 4]]
        return [self.robot.index[name] for name in names]

    def bound(self, moved: Sequence[int], poses: int) -> None:
        """Set the limits of the vector."""
        low = np.maximum(self.robot.lower, -np.pi)[moved] + 0.01
        high = np.minimum(self.robot.upper, np.pi)[moved] - 0.01
        self.lower = np.concatenate([np.tile(low, poses), np.full(poses, SLOWEST[0])])
        self.upper = np.concatenate([np.tile(high, poses), np.full(poses, SLOWEST[1])])
        self.mean = np.clip(self.mean, self.lower, self.upper)

    def costs(self, vectors: FloatArray, starts: Sequence[Fallen]) -> FloatArray:
        """Return the costs (k, s) of vectors (k, m)."""
        motions = [(start, self.targets(vector)) for vector in vectors for start in starts]
        costs = [self.cost(states) for states in self.rollouts.play(motions)]
        times = [TIME * sum(target.duration for target in targets) for _, targets in motions]
        return (np.array(costs) + times).reshape(len(vectors), len(starts))


def find(search: Search, falls: Sequence[Fallen], seed: int, report: Report) -> list[Target]:
    """Return a motion's key poses; raises ``NoMotionFoundError``."""
    rng, usable = np.random.default_rng(seed), [fall for fall in falls if fall.way in search.start]
    starts, checks, best = [*usable[:STARTS]], usable[STARTS:], search.mean
    if not checks:
        raise NoMotionFoundError(
            f"{search.robot.name}: {len(usable)} falls to search a motion to {search.to}; expected more than {STARTS}"
        )
    for round_ in range(ROUNDS):
        best = _optimised(search, best, starts, rng, iterations=LATER if round_ else ITERATIONS, report=report)
        targets = search.targets(best)
        results = search.rollouts.play([(fall, targets) for fall in checks])
        failed = [fall for fall, states in zip(checks, results, strict=True) if not search.succeeded(states)]
        report(f"{search.to}: succeeds from {len(checks) - len(failed)} of {len(checks)} falls")
        if len(failed) <= (1.0 - PASSED) * len(checks):
            return targets
        starts += failed[: STARTS - 1]
    raise NoMotionFoundError(
        f"{search.robot.name}: the best motion found to {search.to} succeeds from {len(checks) - len(failed)} of "
        f"{len(checks)} falls; expected {PASSED:.0%}; torques or ranges of the joints may not suffice"
    )


def _optimised(
    search: Search,
    mean: FloatArray,
    starts: Sequence[Fallen],
    rng: np.random.Generator,
    *,
    iterations: int,
    report: Report,
) -> FloatArray:
    """Return the best vector; the more expensive half of each population starts only once."""
    spread = search.spread * (1.0 if iterations == ITERATIONS else 0.4)
    best, least, history = mean, np.inf, list[float]()
    for iteration in range(iterations):
        vectors = rng.normal(mean, spread, (POPULATION, mean.size)).clip(search.lower, search.upper)
        vectors[:2] = mean, best
        costs = search.costs(vectors, starts[:1])[:, 0]
        vectors = vectors[costs.argsort()[: POPULATION // 2]]
        every = search.costs(vectors, starts)
        order = (costs := every.mean(1) + 0.3 * every.max(1)).argsort()
        if costs[order[0]] < least:
            best, least = vectors[order[0]], costs[order[0]]
        elite = vectors[order[:ELITE]]
        mean = KEPT * mean + (1.0 - KEPT) * elite.mean(0)
        spread = 0.4 * spread + 0.6 * (elite.std(0) + 0.005 * (search.upper - search.lower))
        report(f"{search.to} {iteration + 1}/{iterations}: cost {least:.2f}")
        history.append(least)
        if len(history) > WAITED and history[-1 - WAITED] - least < SETTLED and least < 0.0:
            break
    return best


class RollOver(Search):
    """Motion from the back or the right side to the face."""

    start, to, names = (Posture.BACK, Posture.RIGHT), Posture.FACE, ("wind up", "roll over", "stretch out")

    def __init__(self, rollouts: Rollouts) -> None:
        super().__init__(rollouts)
        groups = [f"{side}_{limb}" for limb in ("leg", "arm") for side in SIDES]
        self._moved = self.indices(*groups, "torso")
        rest, count = self.robot.nominal_posture[self._moved], len(self.names)
        self.mean = np.concatenate([np.tile(rest, count), np.full(count, 0.6)])
        self.bound(self._moved, count)
        self.spread = np.concatenate([np.full(2 * rest.size, 0.5), np.full(rest.size, 0.2), np.full(count, 0.15)])

    def targets(self, vector: FloatArray) -> list[Target]:
        count = len(self.names)
        goals = np.tile(self.robot.nominal_posture, (count, 1))
        goals[:, self._moved] = vector[:-count].reshape(count, -1)
        return [*map(Target, self.names, goals, vector[-count:].tolist(), (0.0, 0.0, 0.3))]

    def cost(self, states: Sequence[FloatArray]) -> float:
        forward, _, up = self.rollouts.upwards(states[-1])
        speed = min(self.rollouts.speed(states[-1]), 3.0)
        return float(1.0 + forward + abs(up) + 0.1 * speed - self.succeeded(states))

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        forward, _, up = self.rollouts.upwards(states[-1])
        return bool(forward < -0.85 and abs(up) < 0.5)


class OnSoles(Search):
    """Symmetric motion to a stance on both soles."""

    def __init__(self, rollouts: Rollouts) -> None:
        super().__init__(rollouts)
        robot, self._stance = self.robot, Stance(self.robot)
        self._right = [robot.index[name] for limb in ("leg", "arm") for name in robot.tables.group(f"right_{limb}")]
        self.ankles = [self._stance.pitch_joints(side)[-1] for side in SIDES]
        self._pitch = [robot.index[name] for name in self._stance.pitch_joints("left")]
        self.knee = self._pitch[1]
        axes = [self._stance.data.joint(robot.joints[i]).xaxis @ self._stance.base[1][:, 1] for i in self._pitch]
        self._signs = np.sign(axes) * (-1.0, 1.0, -1.0)  # of flexion
        self._deepest = DEEP * np.max(self._signs * (robot.lower[self._pitch], robot.upper[self._pitch]), axis=0)
        self._standing = self._signs * robot.nominal_posture[self._pitch]
        self._ahead = self._posed(self._standing, REACHES["squat"])  # the arms
        self._data, self._leg = mujoco.MjData(rollouts.model.mj), self._stance.mean_leg_length

    def cost(self, states: Sequence[FloatArray]) -> float:
        return self._off(states[-1])

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        return self._off(states[-1]) < BALANCED

    def _off(self, state: FloatArray) -> float:
        """Return the distance from rest with the CoM above the middle of level soles."""
        model, data = self.rollouts.model, self._data
        data.qpos[:] = state[1 : 1 + model.mj.nq]
        mujoco.mj_kinematics(model.mj, data)
        mujoco.mj_comPos(model.mj, data)
        middles, tilt, height = [], 0.0, 0.0
        for side in SIDES:
            foot, site = self._stance.foot(side), data.site(self._stance.foot(side).sole)
            middles.append(site.xpos + 0.5 * (foot.heel + foot.toe) * site.xmat[::3])
            tilt, height = tilt + 0.5 * (1.0 - site.xmat[8]), height + 0.5 * abs(middles[-1][2]) / self._leg
        aside = np.hypot(*(data.subtree_com[model.body(self.robot.tables.base)] - np.mean(middles, axis=0))[:2])
        speed = min(self.rollouts.speed(state), 3.0)
        return (
            float(5.0 * min(tilt, 0.4) + 3.0 * min(height, 0.4) + 5.0 * min(aside / self._leg, 0.4) + 0.2 * speed) - 1.0
        )

    def _posed(self, flexion: Sequence[float] | FloatArray, reach: tuple[float, float, float]) -> FloatArray:
        """Return a posture (n,) by the flexion of hip, knee and ankle [rad] and the reach of the hands."""
        robot, posture = self.robot, self.robot.nominal_posture.copy()
        posture[self._pitch] = self._signs * flexion
        if (arm := robot.tables.group("left_arm")) and (hand := robot.tables.hands.left):
            rest = dict(zip(robot.joints, robot.nominal_posture.tolist(), strict=True))
            chain = Chain(tuple(arm), hand.site)
            angles = Poser(self._stance.model.mj).solve_reach(chain, np.array(reach), rest)
            posture[[robot.index[joint] for joint in angles]] = list(angles.values())
        return self._symmetric(posture)

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
            posture[self._pitch] = self._signs * (hip, knee, ankle)
            data.qpos[:] = model.nominal_qpos()
            data.qpos[model.qpos] = self._symmetric(posture)
            mujoco.mj_kinematics(model.mj, data)
            mujoco.mj_comPos(model.mj, data)
            position, rotation = self._stance.site(foot.sole)
            found.append((abs(float((self._stance.com - position) @ rotation[:, 0]) - middle), hip))
        return np.array((min(found)[1], knee, ankle))


class Squat(OnSoles):
    """Motion from the face to a squat."""

    start, to = (Posture.FACE,), "squat"

    def __init__(self, rollouts: Rollouts) -> None:
        super().__init__(rollouts)
        counterpart, sign = counterparts(self.robot)
        middle = [i for i in self.indices("torso") if counterpart[i] == i and sign[i] > 0.0]
        self._moved = [*self.indices("left_leg")[:-1], *self.indices("left_arm"), *middle]
        _, knee, ankle = self._deepest
        legs = ((0.1, 0.3, ankle), self._deepest, self._deepest, self._balanced(knee, ankle))
        poses = [self._posed(*each) for each in zip(legs, REACHES.values(), strict=True)]
        self.mean = np.concatenate([*(pose[self._moved] for pose in poses), (0.6, 0.6, 0.5, 0.4)])
        self.bound(self._moved, len(REACHES))
        self.spread = np.full(self.mean.size, 0.25)
        self.spread[-len(REACHES) :] = 0.1

    def targets(self, vector: FloatArray) -> list[Target]:
        count = len(REACHES)
        goals = np.tile(self.robot.nominal_posture, (count, 1))
        goals[:, self._moved] = vector[:-count].reshape(count, -1)
        return [*map(Target, REACHES, self._symmetric(goals), vector[-count:].tolist(), (0.0, 0.0, 0.0, 0.3))]


class StandUp(OnSoles):
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
        self._poses[:, self._pitch] = self._signs * vector[:6].reshape(2, 3)
        goals = [*self._symmetric(self._poses), self.robot.nominal_posture]
        return [*map(Target, self.names, goals, vector[6:].tolist(), (0.0, 0.0, 0.5))]

    def cost(self, states: Sequence[FloatArray]) -> float:
        upright = 1.0 - self.rollouts.upwards(states[-1])[2]
        return float(np.mean([self._off(state) for state in states]) + 5.0 * upright)

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        height = states[-1][3] / self.robot.tables.nominal_base_height
        return height > 0.93 and super().succeeded(states)
