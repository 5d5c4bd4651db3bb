"""Subscriptions polled by their process, where an executor's wake-up would cost more than the message."""

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup


class Untouched(CallbackGroup):  # type: ignore[misc]  # rclpy is untyped
    """Group of polled entities, which no executor runs."""

    def can_execute(self, entity: Any) -> bool:
        return False


def uncalled(_: Any) -> None:
    """Callback that is never called."""
    raise AssertionError("an executor has received a message that its process polls")


def polled(node: Any, message_type: type, topic: str, qos: Any, *, raw: bool = False) -> Any:
    """Subscription for ``take`` and ``waiting``; ``raw``: its messages are bytes."""
    return node.create_subscription(message_type, topic, uncalled, qos, callback_group=Untouched(), raw=raw)


def take(subscription: Any) -> tuple[Any, dict[str, int]] | None:
    """Oldest message and the middleware's stamps; None if there is none."""
    with subscription.handle:
        taken: tuple[Any, dict[str, int]] | None = subscription.handle.take_message(
            subscription.msg_type, subscription.raw
        )
    return taken


def waiting(subscription: Any) -> Iterator[Any]:
    """All waiting messages, the oldest first."""
    while (taken := take(subscription)) is not None:
        yield taken[0]
