"""The station's ears: subscriptions that are looked at thirty times a second, and nothing between.

Nobody waits for these messages: each look takes the newest of a stream, and all of what is told on change. The streams
come up to 250 times a second; to wake for each would cost more than all the rest of the page.
"""

from __future__ import annotations

from rclpy.node import Node

from valor.operator_station.intake import Intake
from valor.ros.node import Untouched
from valor.ros.taking import take, uncalled


class Listener:
    """Hands what has come to an intake. From one thread."""

    def __init__(self, node: Node, intake: Intake) -> None:
        """Subscribe."""
        group = Untouched()
        self._intake = intake
        self._subscriptions = [
            node.create_subscription(each.kind, each.topic, uncalled, each.qos, callback_group=group)
            for each in intake.inputs
        ]

    def look(self, now: float) -> None:
        """Take what has come; ``now``: monotonic [s]."""
        transits = self._intake.heard.transits
        for subscription, each in zip(self._subscriptions, self._intake.inputs, strict=True):
            while (taken := take(subscription)) is not None:
                message, stamps = taken
                transits[each.topic] = 1e-9 * (stamps["received_timestamp"] - stamps["source_timestamp"])
                each.take(message, now)
