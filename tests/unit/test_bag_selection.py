"""What is recorded, in which pieces, and what became of it, in numbers."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.bag_recorder.tally import Count, Tally, table
from valor.bags.selection import EVERYTHING, Selection
from valor.common.bounds import Bounds
from valor.common.errors import ConfigurationError
from valor.common.instance import Recording
from valor.valorctl.recording_options import bounds, recording


def test_patterns_choose_topics() -> None:
    assert "/anything" in EVERYTHING
    some = Selection(only=("/bifrost/*", "/joint_states"), without=("*/statistics",))
    chosen = ["/bifrost/motion_manager/motor", "/joint_states"]
    assert all(topic in some for topic in chosen)
    assert not any(topic in some for topic in ("/odom", "/joint_states/more", "/bifrost/comms_manager/statistics"))


def test_options_become_settings() -> None:
    assert recording((), (), (), None) == Recording()
    made = recording(("/a*",), ("/ab",), ("500MB", "10min"), None)
    assert made == Recording(only=("/a*",), without=("/ab",), split_bytes=500_000_000, split_seconds=600.0)
    assert recording((), (), (), 30.0).ring_seconds == 30.0


@pytest.mark.parametrize(
    ("split", "ring", "told"),
    [
        (["10"], None, "--bag-split 10: expected a size or a time"),
        (["10 furlongs"], None, "--bag-split 10 furlongs: expected a size or a time"),
        (["-3s"], None, "--bag-split -3s: expected"),
        (["1MB", "2MB"], None, "--bag-split 2MB: expected one of each kind at most"),
        (["1kB"], None, "--bag-split: .*1048576.*, got 1000"),
        ([], 0.0, "--bag-ring: .*, got 0"),
        ([], float("nan"), "--bag-ring: expected a finite number, got nan$"),
        (["10s"], 5.0, "--bag-ring and --bag-split: expected one of them"),
    ],
)
def test_options_that_cannot_be_are_refused(split: list[str], ring: float | None, told: str) -> None:
    with pytest.raises(ConfigurationError, match=told) as caught:
        recording((), (), split, ring)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], Bounds()),
        (["5GB", "12h", "25%"], Bounds(age=43200.0, size=5 * 10**9, share=0.25)),
        (["500 MB"], Bounds(size=500_000_000)),
        (["none"], Bounds(age=None, size=None, share=None)),
    ],
)
def test_words_become_bounds(words: list[str], expected: Bounds) -> None:
    assert bounds(words, Bounds()) == expected


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["5"], "--bag-bound 5: expected a size, an age or a part of the disk"),
        (["5 parsecs"], "--bag-bound 5 parsecs: expected"),
        (["120%"], "--bag-bound 120%: .* <= 1.*, got 1.2"),
        (["1MB"], "--bag-bound 1MB: expected int >= 8388608 B, got 1000000"),
        (["0d"], "--bag-bound 0d: .*, got 0"),
        (["5GB", "6GB"], "--bag-bound 6GB: expected one of each kind"),
        (["none", "6GB"], "--bag-bound none 6GB: expected none by itself"),
    ],
)
def test_bounds_that_cannot_be_are_refused(words: list[str], told: str) -> None:
    with pytest.raises(ConfigurationError, match=told) as caught:
        bounds(words, Bounds())
    assert "\n" not in str(caught.value)


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 5), st.integers(0, 50)), min_size=1, max_size=6))
def test_the_shares_of_bags_add_up(bags: list[tuple[int, int, int]]) -> None:
    tally, received, dropped, shares = Tally(), 0, 0, []
    for came, lost, written in bags:
        received, dropped = received + came, dropped + lost
        shares.append(tally.share({"/a": (received, dropped)}, {"/a": written})["/a"])
        tally.settle({"/a": (received, dropped)}, {"/a": written})
    assert [(share.received, share.dropped, share.written) for share in shares] == bags
    assert tally.total["/a"] == Count(received, dropped, sum(written for _, _, written in bags))
    if tally.total["/a"] != Count():
        assert [int(number) for number in re.findall(r"\d+", table(tally.total)[1])] == [
            received, tally.total["/a"].written, dropped,
        ]  # fmt: skip
