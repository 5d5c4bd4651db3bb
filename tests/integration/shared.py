"""Robots that several tests share: each test leaves them standing."""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager

import pytest

from valor.common.behaviors import Behavior


@contextmanager
def left_standing(
    stand: Callable[[], object], behavior: Callable[[], str], allowed: Collection[str] = (Behavior.STAND,)
) -> Iterator[None]:
    """Fail a test that leaves a shared robot elsewhere, after bringing it to Stand for the next test.

    ``behavior`` may return the control mode instead.
    """
    yield
    if (left := behavior()) not in allowed:
        stand()
        pytest.fail(f"left the robot in {left}; expected {', '.join(sorted(allowed))}")
