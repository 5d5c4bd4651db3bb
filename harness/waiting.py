"""Waiting for what happens, on a computer that is busy with other work."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
PATIENCE = 60.0
"""For anything to happen on a computer that is busy with other work [s]; what does happen is waited for no longer."""


def wait_until(condition: Callable[[], T | None], timeout: float, what: str, period: float = 0.02) -> T:
    """Poll until ``condition()`` is true; returns what it gave.

    Raises:
        AssertionError: not within ``timeout`` [s], nor within ``PATIENCE``; names ``what``.
    """
    timeout = max(timeout, PATIENCE)
    deadline = time.monotonic() + timeout
    while True:
        if value := condition():
            return value
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {timeout:g} s: {what}")
        time.sleep(period)


def some(value: T | None) -> T:
    """The value, which is there."""
    assert value is not None
    return value
