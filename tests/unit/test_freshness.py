"""Which topics do not come as their row of the table says, and that no other is blamed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from valor.common.freshness import WINDOW, Freshness
from valor.common.topics import CLOCK, MOTOR, STEP_STATUS, VELOCITY, Topic

RATE = 500.0


@dataclass
class Count:
    """A subscriber's counts."""

    sequence: int = 0
    rejected: int = 0


@dataclass
class Bench:
    """A consumer of a Motor, step statuses and velocities, and the time."""

    wall: float = 100.0  # [s]
    robot: float = 0.0  # [s]
    motor: Count = field(default_factory=Count)
    steps: Count = field(default_factory=Count)
    velocity: Count = field(default_factory=Count)

    def __post_init__(self) -> None:
        inputs: dict[Topic[Any], Count] = {MOTOR: self.motor, STEP_STATUS: self.steps, VELOCITY: self.velocity}
        self.freshness = Freshness(inputs, RATE, lambda: round(self.robot * 1e9), lambda: self.wall)

    def run(self, seconds: float, motor: float, steps: float = 10.0, factor: float = 1.0) -> set[str]:
        """Let wall time pass at a real-time factor, rates in robot time [Hz]; all that was told, once a second."""
        told = set()
        begun, motors, status = self.robot, self.motor.sequence, self.steps.sequence
        for _ in range(round(seconds)):
            self.wall += 1.0
            self.robot += factor
            self.motor.sequence = motors + round((self.robot - begun) * motor)
            self.steps.sequence = status + round((self.robot - begun) * steps)
            told.add(self.freshness.told())
        return told


@examples(50)
@given(
    factor=st.floats(0.01, 20.0),
    motor=st.floats(RATE, 2 * RATE),
    steps=st.floats(10.0, 30.0),
    pauses=st.lists(st.integers(1, 30), max_size=4),
)
def test_what_comes_as_often_as_it_should_is_never_blamed(
    factor: float, motor: float, steps: float, pauses: list[int]
) -> None:
    bench = Bench()
    for pause in [*pauses, 1]:
        assert bench.run(10, motor, steps, factor) == {""}
        assert bench.run(pause, motor, steps, factor=0.0) == {""}  # robot time stands


@examples(50)
@given(factor=st.floats(0.2, 1.0), share=st.floats(0.05, 0.85))
def test_what_comes_too_seldom_is_named_with_its_rate_and_no_other(factor: float, share: float) -> None:
    bench = Bench()
    bench.run(5, RATE, factor=factor)
    told = bench.run(60, share * RATE, factor=factor)
    rates = [float(each.split()[1]) for each in told if each.startswith(MOTOR.name) and each.endswith(" of 500 Hz")]
    assert min(rates) == pytest.approx(share * RATE, rel=0.02)
    assert not any(STEP_STATUS.name in each or VELOCITY.name in each for each in told)
    bench.run(60, RATE, factor=factor)
    assert bench.run(10, RATE, factor=factor) == {""}


def test_what_falls_silent_is_named_and_what_never_came_is_not() -> None:
    bench = Bench()
    bench.run(10, RATE, steps=0.0)
    assert bench.run(10, 0.0, steps=0.0) >= {f"{MOTOR.name}: silent"}
    assert bench.velocity.sequence == bench.steps.sequence == 0


def test_a_hiccup_shorter_than_the_window_allows_is_forgiven() -> None:
    bench = Bench()
    bench.run(10, RATE)
    assert bench.run(1, 0.75 * RATE) | bench.run(10, RATE) == {""}


def test_a_publisher_that_begins_anew_is_not_blamed() -> None:
    bench = Bench()
    bench.run(10, RATE)
    bench.motor.sequence = 0
    assert bench.run(20, RATE) == {""}
    bench.robot = 0.0  # another robot
    assert bench.run(20, RATE) == {""}
    bench.robot = 0.0
    assert any(each.endswith(" of 500 Hz") for each in bench.run(10, 0.5 * RATE)), "it is looked at all the same"


@pytest.mark.parametrize("factor", [0.2, 1.0, 5.0])
def test_what_is_periodic_by_the_wall_clock_is_not_blamed_for_quick_robot_time(factor: float) -> None:
    bench = Bench()
    assert bench.run(10, RATE, steps=10.0 / factor, factor=factor) == {""}


def test_what_is_refused_is_told_even_of_what_comes_on_demand() -> None:
    bench = Bench()
    bench.run(10, RATE)
    bench.velocity.rejected = 7
    assert f"{VELOCITY.name}: 7 refused" in bench.run(3, RATE)
    bench.run(10, RATE)
    assert bench.run(10, RATE) == {""}


def test_of_many_the_first_are_named() -> None:
    wall = 0.0
    topics = {topic: Count(1) for topic in (MOTOR, STEP_STATUS, CLOCK)} | {VELOCITY: Count(1)}
    freshness = Freshness(topics, RATE, lambda: round(wall * 1e9), lambda: wall)
    freshness.told()
    topics[VELOCITY].rejected = 1
    wall = WINDOW
    assert freshness.told().endswith(f"{CLOCK.name}: silent; and 1 more")
