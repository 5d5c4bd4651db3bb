"""Checks of inputs: floods are reported by sender, late or invalid topics with their rates, and no others."""

import logging
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bifrost.limits import MUTE
from harness.examples import examples
from valor.common.input_checks import REMEMBERED, ROS_TOPIC, Floods, Freshness, TopicFloods
from valor.common.topics import MOTOR, STEP_STATUS, VELOCITY, Topic

LEAST = ROS_TOPIC.burst / ROS_TOPIC.rate  # of a flood without end, until it is one [s]
RATE = 500.0


@dataclass
class Input:
    topic: str
    muted: tuple[str, ...] = ()


@given(st.lists(st.tuples(st.floats(0.0, 2.0), st.sets(st.sampled_from("abc")), st.sets(st.sampled_from("abc")))))
@examples(100)
def test_recently_muted_senders_are_reported(periods: list[tuple[float, set[str], set[str]]]) -> None:
    assert 1e9 * REMEMBERED > MUTE, "a muted sender is received for a moment between two mutes"
    now, inputs = 100.0, (Input("motor"), Input("plan"))
    floods = Floods(inputs, lambda: now)
    last: dict[str, float] = {}
    assert floods.report() == ""
    for passed, *muted in periods:
        now += passed
        for each, names in zip(inputs, muted, strict=True):
            each.muted = tuple(names)
            last |= {f"{name} floods {each.topic}": now for name in names}
        expected = sorted(flood for flood, at in last.items() if now - at < REMEMBERED)
        assert floods.report() == (f"{', '.join(expected)}: muted while it continues" if expected else "")


class Topics:
    """Messages on ``/a``, from whom it is said, at times as given."""

    def __init__(self, *publishers: str) -> None:
        self.now = 100.0
        self.taken: list[int] = []
        self.floods = TopicFloods(lambda topic: publishers if topic == "/a" else (), lambda: self.now)
        self._counted = self.floods.counted("/a", self.taken.append)

    def send(self, rate: float, seconds: float, taken: int = 1) -> None:
        """Of which every n-th is taken."""
        for number in range(1, round(rate * seconds) + 1):
            if number % taken == 0:
                self._counted(number, {"publication_sequence_number": number})
            self.now += 1.0 / rate


@given(st.floats(1.0, 0.95 * ROS_TOPIC.rate), st.floats(0.1, 5.0))
def test_what_commands_need_is_no_flood(rate: float, seconds: float) -> None:
    topics = Topics("pilot")
    topics.send(rate, seconds)
    assert topics.floods.report() == "" and topics.taken == list(range(1, len(topics.taken) + 1))


def test_publishers_that_send_in_turn_are_named_and_one_that_begins_again_is_not() -> None:
    topics = Topics("wheel", "headset")
    topics.send(100.0, 1.0)
    topics.send(100.0, 1.0)  # begun again
    assert topics.floods.report() == ""
    for number in range(1, 200):
        for each in (1000 + number, number):
            topics._counted(number, {"publication_sequence_number": each})
        topics.now += 0.01
    assert topics.floods.report() == "headset and wheel send to /a at the same time"
    topics.now += REMEMBERED
    assert topics.floods.report() == ""


@given(st.floats(2.5 * ROS_TOPIC.rate, 10_000.0))
def test_a_flooding_node_is_named_during_the_flood(rate: float) -> None:
    topics = Topics("evil")
    topics.send(rate, 2 * LEAST)
    assert topics.floods.report() == "evil floods /a"
    topics.now += REMEMBERED
    assert topics.floods.report() == ""


def test_lost_messages_count_with_a_single_publisher() -> None:
    topics = Topics("evil")
    topics.send(5_000.0, 2 * LEAST, taken=100)
    assert topics.floods.report() == "evil floods /a"
    several = Topics("evil", "pilot")
    several.send(5_000.0, 2 * LEAST, taken=100)
    assert several.floods.report() == ""  # the numbers may be those of several


def test_a_publisher_that_takes_over_from_another_is_no_flood() -> None:
    topics = Topics("pilot")
    for number in (7, 8, 9, 100_000, 100_001, 10, 11):
        topics._counted(number, {"publication_sequence_number": number})
        topics.now += 0.1
    assert topics.floods.report() == ""


def test_of_several_publishers_all_are_named_and_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    topics = Topics("pilot", "evil", "pilot")
    with caplog.at_level(logging.WARNING):
        topics.send(5_000.0, 10 * LEAST)
    assert topics.floods.report() == "evil or pilot floods /a"
    assert [record.getMessage() for record in caplog.records] == [
        "evil or pilot floods /a: only part of its messages is processed"
    ]


@dataclass
class Count:
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
        """Let wall time pass at a real-time factor, rates in robot time [Hz]; all that was given, once a second."""
        reported = set()
        begun, motors, status = self.robot, self.motor.sequence, self.steps.sequence
        for _ in range(round(seconds)):
            self.wall += 1.0
            self.robot += factor
            self.motor.sequence = motors + round((self.robot - begun) * motor)
            self.steps.sequence = status + round((self.robot - begun) * steps)
            reported.add(self.freshness.report())
        return reported


@examples(50)
@given(
    factor=st.floats(0.01, 20.0), motor=st.floats(RATE, 2 * RATE), steps=st.floats(10.0, 30.0),
    pauses=st.lists(st.integers(1, 30), max_size=4),
)  # fmt: skip
def test_what_comes_often_enough_is_never_blamed(factor: float, motor: float, steps: float, pauses: list[int]) -> None:
    bench = Bench()
    for pause in [*pauses, 1]:
        assert bench.run(10, motor, steps, factor) == {""}
        assert bench.run(pause, motor, steps, factor=0.0) == {""}  # robot time stands


@examples(50)
@given(factor=st.floats(0.2, 1.0), share=st.floats(0.05, 0.85))
def test_what_comes_too_seldom_is_named_with_its_rate_and_no_other(factor: float, share: float) -> None:
    bench = Bench()
    bench.run(5, RATE, factor=factor)
    reported = bench.run(60, share * RATE, factor=factor)
    rates = [float(each.split()[1]) for each in reported if each.startswith(MOTOR.name) and each.endswith(" of 500 Hz")]
    assert min(rates) == pytest.approx(share * RATE, rel=0.02)
    assert not any(STEP_STATUS.name in each or VELOCITY.name in each for each in reported)
    bench.run(60, RATE, factor=factor)
    assert bench.run(10, RATE, factor=factor) == {""}


def test_what_falls_silent_is_named_and_what_never_came_is_not() -> None:
    bench = Bench()
    bench.run(10, RATE, steps=0.0)
    assert bench.run(10, 0.0, steps=0.0) >= {f"{MOTOR.name}: silent"}
    assert bench.velocity.sequence == bench.steps.sequence == 0


@pytest.mark.parametrize("factor", [0.2, 1.0, 5.0])
def test_topics_periodic_in_wall_time_are_valid_at_any_time_ratio(factor: float) -> None:
    assert Bench().run(10, RATE, steps=10.0 / factor, factor=factor) == {""}


def test_a_short_gap_or_a_restarted_publisher_is_no_fault() -> None:
    bench = Bench()
    bench.run(10, RATE)
    assert bench.run(1, 0.75 * RATE) | bench.run(10, RATE) == {""}
    bench.motor.sequence = 0
    assert bench.run(20, RATE) == {""}
    bench.robot = 0.0  # another robot
    assert bench.run(20, RATE) == {""}
    bench.robot = 0.0
    assert any(each.endswith(" of 500 Hz") for each in bench.run(10, 0.5 * RATE)), "it is looked at all the same"


def test_what_is_rejected_is_reported_even_of_what_comes_on_demand() -> None:
    bench = Bench()
    bench.run(10, RATE)
    bench.velocity.rejected = 7
    assert f"{VELOCITY.name}: 7 rejected" in bench.run(3, RATE)
    bench.run(10, RATE)
    assert bench.run(10, RATE) == {""}
