"""Transfer of the latest camera picture over the fast channel."""

import contextlib
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.emulated_channel import DRC_FAST, Conditions
from harness.examples import examples
from tests.unit.link.test_link import pair
from valor.common.instance import LINK_RATE
from valor.link.errors import SealError
from valor.link.picture import CHUNK, LARGEST, Picture, PictureReceiver, PictureSender

BAD = Conditions(bandwidth=300e6, delay=0.01, loss=0.03, duplication=0.05, reordering=0.05, held=0.05, waiting=10**6)


def picture(size: int, seed: int = 0, clock: int = 500) -> Picture:
    return Picture(clock, "jpeg", "head_camera", random.Random(seed).randbytes(size))


@pytest.mark.parametrize("conditions", [DRC_FAST, BAD], ids=["darpa", "bad"])
def test_a_picture_arrives_in_a_window_with_its_age_and_not_on_the_slow_channel(conditions: Conditions) -> None:
    link = pair(fast=conditions, windows=[(5.0, 7.0)], picture=picture(100_000))
    link.until(lambda: link.now > 4.9, 10.0)
    assert link.operator.picture is None and link.operator.picture_age(link.now) == float("inf")
    slow = sum(line.passed for (_, channel), line in link.lines.items() if channel == 0)
    began = link.now
    link.until(lambda: link.operator.picture, 3.0)
    assert link.operator.picture == link.picture
    true = link.robot_time - (0.5 + link.robot._started)
    assert true - 2e-3 <= link.operator.picture_age(link.now) < true + 1.0
    link.run(2.0)
    slow = sum(line.passed for (_, channel), line in link.lines.items() if channel == 0) - slow
    assert slow <= LINK_RATE * (link.now - began + 0.5)


def test_a_newer_picture_replaces_an_older_one_and_one_of_a_closed_window_is_abandoned() -> None:
    link = pair(fast=DRC_FAST, windows=[(5.0, 5.2), (10.0, 12.0)], picture=picture(1_000_000))
    link.until(lambda: link.now > 9.0, 10.0)
    assert link.operator.picture is None
    link.picture = newer = picture(20_000, 1)
    link.until(lambda: link.operator.picture, 3.0)
    assert link.operator.picture == newer
    link.picture = newest = picture(20_000, 2)
    link.until(lambda: link.operator.picture == newest, 2.0)


def test_a_picture_that_is_too_large_is_not_sent() -> None:
    sender = PictureSender(lambda: large)
    large = picture(LARGEST)
    assert sender.turn(0.0) == [] and sender.turn(1.0) == []


def test_an_empty_picture_is_transferred() -> None:
    empty = Picture(1, "", "", b"")
    (body,) = PictureSender(lambda: empty).turn(0.0)
    assert PictureReceiver().take(body) == empty


@examples(100)
@given(st.binary(max_size=2 * CHUNK))
def test_malformed_bytes_raise_only_the_links_error(data: bytes) -> None:
    with contextlib.suppress(SealError):
        PictureReceiver().take(data)
    with contextlib.suppress(SealError):
        Picture.decode(data)
