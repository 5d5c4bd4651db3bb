"""The small parts that numbers and pictures are made of: signals, stamps, chosen moments, what is told of a bag."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin

from harness.analysis_bag import FREE, RATE, STAND, write
from tests.unit.test_analysis_end_effector import ROBOT
from tests.unit.test_bag_csv import COUNT
from tests.unit.test_bag_csv import write as write_foreign
from valor.analysis import pictures
from valor.analysis.bag import Bag
from valor.analysis.csv_export import MOST_NOTICES, _Notices
from valor.analysis.errors import SignalError
from valor.analysis.recording import Recording, recorded
from valor.analysis.report import about
from valor.analysis.results import Result
from valor.analysis.signals import Signal, common_rate
from valor.bags.stored import StoredBag
from valor.common.topics import PROPRIOCEPTOR

moments = st.lists(st.floats(0.01, 0.5), min_size=4, max_size=30).map(np.cumsum)


@given(moments, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_the_derivative_is_the_slope_at_the_middles(times: np.ndarray, slope: float, curve: float) -> None:
    """Of a parabola exactly, however the samples lie."""
    made = Signal.of(times, slope * times + curve * times**2).derivative()
    np.testing.assert_allclose(made.time, (times[1:] + times[:-1]) / 2)
    np.testing.assert_allclose(made.value, slope + 2.0 * curve * made.time, atol=1e-6)


@given(moments, moments, st.floats(-3.0, 3.0))
def test_two_signals_meet_where_both_are_known(first: np.ndarray, second: np.ndarray, shift: float) -> None:
    second = second + shift
    begin, end = max(first[0], second[0]), min(first[-1], second[-1])
    try:
        rate, one, two = common_rate(Signal.of(first, 2.0 * first), Signal.of(second, -second))
    except SignalError:
        rate = max((len(each) - 1) / (each[-1] - each[0]) for each in (first, second))
        assert (end - begin) * rate < 8.0
        return
    assert rate == pytest.approx(max((len(each) - 1) / (each[-1] - each[0]) for each in (first, second)))
    met = -two
    np.testing.assert_allclose(one, 2.0 * met, atol=1e-9)
    np.testing.assert_allclose(np.diff(met), 1.0 / rate, atol=1e-9)
    assert met[0] == pytest.approx(begin, abs=1e-9) and end - 1.0 / rate - 1e-9 < met[-1] <= end + 1e-9


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "reach.mcap"
    write(path, ROBOT)
    return path


def test_messages_have_the_wall_clock_of_the_bag_in_seconds(bag: Path) -> None:
    series = Bag(bag)[recorded(PROPRIOCEPTOR)]
    assert series.received[0] == series.sent[0] == 1.7e9  # as ``write_messages`` stamps the first
    assert series.time[1] - series.time[0] == pytest.approx(1.0 / RATE)


def test_before_is_the_last_moment_at_rest_and_after_the_last_one_far_away(bag: Path) -> None:
    before, after = pictures._before_and_after(Recording(Bag(bag), ROBOT))
    assert before == pytest.approx(STAND - 1.0 / RATE)
    assert FREE - 1.6 < after < FREE - 1.2  # from 1.5 s before the end on, the arm goes back


def test_a_result_tells_minutes_and_nothing_of_what_it_does_not_know() -> None:
    common = {"experiment": "x", "title": "", "reproduces": "Figure 1", "command": "", "started": "today",
              "quick": True, "settings": {"seed": "2"}, "host": {}, "text": "", "measures": []}  # fmt: skip
    assert about(Result(**common, tables=[], seconds=90.0)) == "Figure 1 · today · 1.5 min · seed 2"  # type: ignore[arg-type]
    assert about(Result(**common, tables=[])) == "Figure 1 · today · seed 2"  # type: ignore[arg-type]


def test_what_is_left_out_is_told_once_with_how_often_and_never_without_end() -> None:
    notices = _Notices(["as it is"])
    for number in range(MOST_NOTICES + 5):
        for _ in range(1 + number % 2):
            notices.add(f"kind {number}")
    told = notices.all()
    assert told[:2] == ["left out: kind 0", "left out: kind 1 (2 messages)"]
    assert told[-2:] == ["left out: and more (7 messages)", "as it is"]
    assert len(told) == MOST_NOTICES + 2


def test_what_another_says_of_itself_is_not_taken_for_the_recorders_word(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with open(path, "wb") as file:
        writer = McapWriter(file)
        writer.start("ros2", "somebody")
        writer.add_metadata("valor", {"robot": "escher"})
        writer.add_metadata("another", {"robot": "atlas"})
        writer.add_metadata("zebra", {"robot": "zoe"})
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        writer.add_message(writer.register_channel("/words", "cdr", text), 1, b"\0\1\0\0\2\0\0\0a\0", 1)
        writer.finish()
    stored = StoredBag(path)
    assert len(list(stored.messages())) == 1
    assert stored.condition.origin == {"robot": "escher"}


@pytest.mark.parametrize("cut", [0, 1, 4096])
def test_a_database_that_lacks_its_end_is_told_by_its_length(tmp_path: Path, cut: int) -> None:
    file = write_foreign(tmp_path / "bag", StoragePlugin.SQLITE3, COUNT)
    content = file.read_bytes()
    file.write_bytes(content[: len(content) - cut])
    stored = StoredBag(file)
    found = len(list(stored.messages()))
    said = [text for text in stored.condition.damage if "ends in the middle" in text]
    assert (stored.condition.truncated, len(said)) == ((1, 1) if cut else (0, 0))
    if cut:
        assert re.search(rf"{len(content) - cut} of {len(content)} bytes are there", said[0])
    else:
        assert found == 2 * COUNT
