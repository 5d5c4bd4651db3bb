"""A policy on random states: what it gives, and how long it takes."""

import time
from dataclasses import dataclass

import numpy as np

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


def run(policy: Policy, robot: RobotDescription, acts: int = 100) -> Trial:
    """Let a policy act on random states, the same ones each time: joints within limits, tilts of some 0.2 rad."""
    random, times, finite, inside = np.random.default_rng(0), [], True, []
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    policy.reset()
    for _ in range(acts):
        attitude = np.append(1.0, random.normal(0.0, 0.1, 3))
        state = Senses(
            random.uniform(lower, upper),
            random.normal(0.0, 0.1, len(lower)) * np.minimum(robot.velocity_limit, 20.0),
            attitude / np.linalg.norm(attitude),
            random.normal(0.0, 0.3, 3),
            random.normal(0.0, 0.3, 3),
            np.asarray(random.uniform(*np.clip(policy.contract.command_ranges, -1.0, 1.0))),
        )
        start = time.perf_counter()
        targets = policy.act(state)
        times.append(time.perf_counter() - start)
        given = (targets.position, targets.stiffness, targets.damping, targets.velocity, targets.effort)
        finite = finite and all(bool(np.isfinite(each).all()) for each in given if each is not None)
        at = policy.indices
        inside.append(np.mean((targets.position >= robot.lower[at]) & (targets.position <= robot.upper[at])))
    return Trial(acts, finite, float(np.mean(inside)), *map(float, np.percentile(times, (50, 99))))
