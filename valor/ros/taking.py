"""Subscriptions whose queues a process looks into itself, where an executor's wake-up would cost more than the message.

They are created with ``uncalled`` as their callback and ``Untouched`` as their callback group.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any


def uncalled(_: Any) -> None:
    """The callback of such a subscription."""
    raise AssertionError("an executor has taken what its process takes itself")


def take(subscription: Any) -> tuple[Any, dict[str, int]] | None:
    """The oldest message that waits, its bytes if the subscription is raw, and the middleware's stamps; None: none."""
    with subscription.handle:
        taken: tuple[Any, dict[str, int]] | None = subscription.handle.take_message(
            subscription.msg_type, subscription.raw
        )
    return taken


def waiting(subscription: Any) -> Iterator[Any]:
    """All messages that wait, the oldest first."""
    while (taken := take(subscription)) is not None:
        yield taken[0]
