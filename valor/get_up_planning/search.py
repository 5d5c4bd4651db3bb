"""Search for the key poses of a motion: the cross-entropy method on simulated falls.

Candidates are drawn around a mean; the best give the next mean and spread. A found motion is checked on other falls;
those from which it fails join the search.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import LEGS
from valor.common.errors import ValorError
from valor.get_up_planning.rollouts import Fallen, Rollouts, Target
from valor.robot.get_up_table import Posture

POPULATION, ELITE, KEPT = 24, 6, 0.3  # candidates, those that count, weight of the mean before
TRIED, SHORT = 3, 10  # short searches, iterations of each
ITERATIONS, LATER = 30, 6  # of the best one afterwards, and after its motion failed
TUNING, MANY = 12, 32  # iterations from many starts, so many
ROUNDS = 6  # searches, at most
STARTS = 6  # falls of the first search; the others check its motion
PASSED = 0.9  # least share of the checks
LOST = 0.5  # share of failed checks above which a search with a positive cost restarts
NARROW = 0.4  # spread of a search near a known motion, relative to a first one
TIME = 0.1  # cost of a motion's duration [1/s]
SETTLED, WAITED = 0.02, 5  # a search ends if it improves less in iterations
SLOWEST = (0.2, 1.5)  # of a motion to a key pose [s]
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

    def __init__(self, rollouts: Rollouts, onward: Sequence[Target] = ()) -> None:
        """Begin; ``onward``: key poses that follow the motion, in which it must end as they need."""
        self.rollouts, self.robot, self._onward = rollouts, rollouts.robot, [*onward]

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

    def play(self, motions: Sequence[tuple[Fallen, Sequence[Target]]]) -> list[list[FloatArray]]:
        """Return the states after each key pose, and those onward, for each motion."""
        return self.rollouts.play([(start, [*targets, *self._onward]) for start, targets in motions])

    def successes(self, starts: Sequence[Fallen], targets: Sequence[Target]) -> list[bool]:
        """Return for each start whether the motion ends as it should."""
        return [self.succeeded(states) for states in self.play([(start, targets) for start in starts])]

    def costs(self, vectors: FloatArray, starts: Sequence[Fallen]) -> FloatArray:
        """Return the costs (k, s) of vectors (k, m)."""
        motions = [(start, self.targets(vector)) for vector in vectors for start in starts]
        costs = [self.cost(states) for states in self.play(motions)]
        times = [TIME * self.rollouts.duration(start.posture, targets) for start, targets in motions]
        return (np.array(costs) + times).reshape(len(vectors), len(starts))


def usable(falls: Sequence[Fallen], ways: Sequence[Posture | None]) -> list[Fallen]:
    """Return the falls that ended in one of these ways of lying."""
    return [fall for fall in falls if fall.way in ways]


class Cloud(NamedTuple):
    """Distribution of candidates, the best of them, and its cost."""

    mean: FloatArray
    spread: FloatArray
    best: FloatArray
    least: float = np.inf


def _around(mean: FloatArray, spread: FloatArray) -> Cloud:
    """Return the cloud that a search starts from."""
    return Cloud(mean, spread, mean)


def find(search: Search, falls: Sequence[Fallen], seed: int, report: Report) -> list[Target]:
    """Return a motion's key poses; raises ``NoMotionFoundError``.

    The best of several short searches continues. If its motion fails from most checks, the search restarts.
    """
    rng, falls = np.random.default_rng(seed), usable(falls, search.start)
    first, checks = falls[:STARTS], falls[STARTS:]
    if not checks:
        raise NoMotionFoundError(
            f"{search.robot.name}: {len(falls)} falls to search a motion to {search.to}; expected more than {STARTS}"
        )
    starts, cloud = [*first], None
    for _ in range(ROUNDS):
        if cloud is None:
            start = _around(search.mean, search.spread)
            tried = [_optimised(search, start, first, rng, iterations=SHORT, report=report) for _ in range(TRIED)]
            best = min(tried, key=lambda cloud: cloud.least)
            cloud = _optimised(search, best, first, rng, iterations=ITERATIONS, report=report)
        else:
            near = _around(cloud.best, NARROW * search.spread)
            cloud = _optimised(search, near, starts, rng, iterations=LATER, report=report)
        targets = search.targets(cloud.best)
        succeeded = search.successes(checks, targets)
        failed = [fall for fall, success in zip(checks, succeeded, strict=True) if not success]
        report(f"{search.to}: succeeds from {len(checks) - len(failed)} of {len(checks)} falls")
        if len(failed) <= (1.0 - PASSED) * len(checks):
            return targets
        if len(failed) > LOST * len(checks) and cloud.least > 0.0:
            cloud = None
        starts += failed[: STARTS // 2]
    raise NoMotionFoundError(
        f"{search.robot.name}: the best motion found to {search.to} succeeds from {len(checks) - len(failed)} of "
        f"{len(checks)} falls; expected {PASSED:.0%}; torques or ranges of the joints may not suffice"
    )


def tuned(search: Search, starts: Sequence[Fallen], seed: int, report: Report) -> list[Target]:
    """Return the key poses near the search's mean that do best from many starts."""
    cloud = _around(search.mean, NARROW * search.spread)
    rng = np.random.default_rng(seed)
    return search.targets(_optimised(search, cloud, starts[:MANY], rng, iterations=TUNING, report=report).best)


def _optimised(
    search: Search, cloud: Cloud, starts: Sequence[Fallen], rng: np.random.Generator, *, iterations: int, report: Report
) -> Cloud:
    """Return the cloud after iterations; the more expensive half of each population starts from few falls only."""
    mean, spread, best, least = cloud
    history = list[float]()
    for iteration in range(iterations):
        vectors = rng.normal(mean, spread, (POPULATION, mean.size)).clip(search.lower, search.upper)
        vectors[:2] = mean, best
        costs = search.costs(vectors, starts[::STARTS]).mean(1)
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
        waited = WAITED if least < 0.0 else 3 * WAITED
        if len(history) > waited and history[-1 - waited] - least < SETTLED:
            break
    return Cloud(mean, spread, best, least)
