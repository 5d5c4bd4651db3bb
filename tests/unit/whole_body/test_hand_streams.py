"""Goals of a hand that are streamed, as from a headset: followed with the velocity that they have."""

from collections.abc import Callable
from math import cos, sin

import numpy as np
import pytest

from harness.closed_loop import load_robot
from harness.manipulating_robot import ManipulatingRobot
from valor.common.arrays import FloatArray

RADIUS, SPEED = 0.06, 0.1  # of a circle in front of the robot [m, m/s]
NEAR = np.array((0.4, -0.3, 0.2))  # of the right hand in pelvis [m]
CYCLE = 2  # control periods of a cycle of the VRC
LATE = 0.15  # [s]
OFF = 0.005  # [m]


class Streamed:
    """A robot whose right hand is led along a circle about where it was."""

    def __init__(self) -> None:
        self.robot = ManipulatingRobot(load_robot(), "hardware", seed=0)
        self.goals = self.robot.manager.components.hand_goals
        self.home, self.turn = self.robot.in_odom(NEAR, np.eye(3))
        self.go(self.home)

    def go(self, place: FloatArray) -> None:
        """By a single goal."""
        self.robot.send(1, place, self.turn)
        assert self.robot.run_until(self.reached, 8.0), self.goals.status(1, 0)
        self.robot.run(0.5)

    def reached(self) -> bool:
        return self.goals.status(1, 0).state == "reached"

    def wanted(self, time: float) -> FloatArray:
        angle = SPEED / RADIUS * time
        return self.home + RADIUS * np.array((0.0, cos(angle) - 1.0, sin(angle)))

    def stream(self, rate: float, seconds: float, jitter: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Times (k,) since the first goal, and where the hand was (k, 3)."""
        random, due, began = np.random.default_rng(1), 0.0, self.robot.time
        times, hands = list[float](), list[FloatArray]()
        while (now := self.robot.time - began) < seconds:
            if len(times) % CYCLE == 0 and due <= now:
                self.robot.send(1, self.wanted(now), self.turn)
                due += (1.0 + jitter * random.uniform(-1.0, 1.0)) / rate
            self.robot.step()
            times.append(self.robot.time - began)
            hands.append(self.robot.hand(1)[0])
        return np.array(times), np.array(hands)


@pytest.fixture(scope="module")
def streamed() -> Streamed:
    return Streamed()


@pytest.mark.parametrize(("rate", "jitter"), [(10, 0.2), (60, 0.5), (250, 0.0)])
def test_a_streamed_circle_is_followed_to_its_last_goal(streamed: Streamed, rate: float, jitter: float) -> None:
    streamed.go(streamed.home)
    times, hands = streamed.stream(rate, 3.5, jitter)
    times, hands = times[times > 1.5], hands[times > 1.5]
    center = streamed.home - (0.0, RADIUS, 0.0)
    off = np.hypot(np.hypot(*(hands - center)[:, 1:].T) - RADIUS, hands[:, 0] - center[0])
    assert off.max() < (OFF if rate > 20 else 2.0 * OFF), off.max()

    def far(late: float) -> float:
        return float(np.square(hands - [streamed.wanted(time - late) for time in times]).sum())

    assert min(np.arange(-0.1, 0.7, 0.01), key=far) < LATE
    last = streamed.wanted(3.5)
    assert streamed.robot.run_until(streamed.reached, 3.0)
    assert np.linalg.norm(streamed.robot.hand(1)[0] - last) < 3.0 * OFF


def cancel(streamed: Streamed) -> None:
    streamed.goals.release(1, "over")


def stop(streamed: Streamed) -> None:
    pass


def jump(streamed: Streamed) -> None:
    streamed.robot.send(1, streamed.home + np.array((0.0, 0.0, -0.1)), streamed.turn)


@pytest.mark.parametrize("end", [cancel, stop, jump])
def test_a_stream_ends_as_a_single_goal_does(streamed: Streamed, end: Callable[[Streamed], None]) -> None:
    """Nothing goes on with the velocity that it had; joints keep their limits."""
    streamed.go(streamed.home)
    streamed.stream(60, 1.0)
    reference, joints = streamed.robot.manager.components.reference, streamed.robot.robot.group_indices("right_arm")
    before, there = reference.velocity.copy(), streamed.robot.hand(1)[0]
    end(streamed)
    farthest = 0.0
    for _ in range(3000 if end is jump else 1000):
        streamed.robot.step()
        change = np.abs(reference.velocity - before) / streamed.robot.robot.control_period
        assert (change <= 1.001 * reference.limits.acceleration)[joints].all()
        assert (np.abs(reference.velocity) <= reference.limits.fastest)[joints].all()
        before = reference.velocity.copy()
        farthest = max(farthest, float(np.linalg.norm(streamed.robot.hand(1)[0] - there)))
    assert np.abs(before[joints]).max() < 0.02
    assert streamed.reached() is (end is not cancel)
    assert end is jump or farthest < 0.015
