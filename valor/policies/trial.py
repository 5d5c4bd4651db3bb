"""A policy on random states: what it gives, and how long it takes."""

import time
from dataclasses import dataclass

import numpy as np

from valor.common.arrays import FloatArray
from valor.policies.observations import Senses
from valor.policies.policy import Policy
from valor.robot.description import RobotDescription


@dataclass(frozen=True)
class Trial:
    """Result of ``run``."""

    acts: int
    finite: bool  # all targets
    within: float  # share of target positions within the robot's limits, 0 to 1
    median: float  # time of an act [s]
    p99: float  # [s]


def senses(robot: RobotDescription, ranges: FloatArray, random: np.random.Generator, now: float) -> Senses:
    """Return a random state: joints within limits, tilt of some 0.2 rad, commands within (2, 3) ``ranges``."""
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    attitude = np.append(1.0, random.normal(0.0, 0.1, 3))
    return Senses(
        now,
        random.uniform(lower, upper),
        random.normal(0.0, 0.1, len(lower)) * np.minimum(robot.velocity_limit, 20.0),
        attitude / np.linalg.norm(attitude),
        random.normal(0.0, 0.3, 3),
        random.normal(0.0, 0.3, 3),
        np.asarray(random.uniform(*np.clip(ranges, -1.0, 1.0))),
    )


def run(policy: Policy, robot: RobotDescription, acts: int = 100) -> Trial:
    """Let a policy act on random states, the same ones each time."""
    random, times, finite, inside = np.random.default_rng(0), [], True, []
    lower, upper = robot.lower[policy.indices], robot.upper[policy.indices]
    policy.reset()
    for i in range(acts):
        state = senses(robot, policy.contract.command_ranges, random, i * policy.contract.period)
        start = time.perf_counter()
        targets = policy.act(state)
        times.append(time.perf_counter() - start)
        given = (targets.position, targets.stiffness, targets.damping, targets.velocity, targets.effort)
        finite = finite and all(bool(np.isfinite(each).all()) for each in given if each is not None)
        inside.append(np.mean((targets.position >= lower) & (targets.position <= upper)))
    return Trial(acts, finite, float(np.mean(inside)), *map(float, np.percentile(times, (50, 99))))
