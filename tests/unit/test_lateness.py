"""Commands that were held back on their way are refused, and all others are not."""

import logging
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from valor.ros.lateness import LATE, reject_late

SECOND = 10**9


def passed(sent: int | None, received: int | None) -> bool:
    """Return whether a message gets through, as it is, with what is reported of it."""
    taken: list[tuple[Any, Any]] = []
    info = {"source_timestamp": sent, "received_timestamp": received}
    reject_late("/a", lambda message, reported: taken.append((message, reported)), others=True)("go", info)
    assert taken in ([], [("go", info)])
    return bool(taken)


@given(st.integers(1, 2**62), st.integers(-(2**61), 2**61))
@examples(200)
def test_what_was_sent_too_long_ago_is_refused(sent: int, way: int) -> None:
    received = max(1, sent + way)
    assert passed(sent, received) == ((received - sent) * 1e-9 <= LATE)


@pytest.mark.parametrize(("sent", "received"), [(0, SECOND * 9), (None, SECOND * 9), (SECOND, 0), (SECOND, None)])
def test_without_stamps_nothing_is_refused(sent: int | None, received: int | None) -> None:
    assert passed(sent, received)


def test_refusals_are_reported_once_in_a_while_with_topic_and_age(caplog: pytest.LogCaptureFixture) -> None:
    refuse = reject_late("/cmd_vel", lambda message, reported: None, others=True)
    with caplog.at_level(logging.WARNING):
        for _ in range(100):
            refuse("go", {"source_timestamp": SECOND, "received_timestamp": 4 * SECOND})
    assert 1 <= len(caplog.messages) < 100
    assert "/cmd_vel: rejected: received 3.0 s after it was sent" in caplog.messages[0]


def test_on_one_computer_nothing_is_looked_at() -> None:
    def obey(message: Any, reported: Any) -> None:
        raise AssertionError

    assert reject_late("/a", obey, others=False) is obey
