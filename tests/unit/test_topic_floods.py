"""Who floods a ROS topic is named: by those who publish there, while it goes on, and once in the log."""

from __future__ import annotations

import logging

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.common.floods import REMEMBERED, ROS_TOPIC, TopicFloods

LEAST = ROS_TOPIC.burst / ROS_TOPIC.rate  # of a flood without end, until it is one [s]


class Topics:
    """Messages on ``/a``, from whom it is said, at times as told."""

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
    assert topics.floods.told() == ""
    assert topics.taken == list(range(1, len(topics.taken) + 1))


@given(st.floats(2.5 * ROS_TOPIC.rate, 10_000.0))
def test_who_goes_on_beyond_is_named_while_it_does(rate: float) -> None:
    topics = Topics("evil")
    topics.send(rate, 2 * LEAST)
    assert topics.floods.told() == "evil floods /a"
    topics.now += REMEMBERED
    assert topics.floods.told() == ""


def test_what_is_lost_on_its_way_counts_if_one_alone_sends() -> None:
    topics = Topics("evil")
    topics.send(5_000.0, 2 * LEAST, taken=100)
    assert topics.floods.told() == "evil floods /a"
    several = Topics("evil", "pilot")
    several.send(5_000.0, 2 * LEAST, taken=100)
    assert several.floods.told() == ""  # the numbers may be those of several


def test_a_publisher_that_takes_over_from_another_is_no_flood() -> None:
    topics = Topics("pilot")
    for number in (7, 8, 9, 100_000, 100_001, 10, 11):
        topics._counted(number, {"publication_sequence_number": number})
        topics.now += 0.1
    assert topics.floods.told() == ""


def test_of_several_publishers_all_are_named_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    topics = Topics("pilot", "evil", "pilot")
    with caplog.at_level(logging.WARNING):
        topics.send(5_000.0, 10 * LEAST)
    assert topics.floods.told() == "evil or pilot floods /a"
    assert [record.getMessage() for record in caplog.records] == ["evil or pilot floods /a: a part of it is taken"]
