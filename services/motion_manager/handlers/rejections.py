"""Commands that were not obeyed: every one counted, each kind published at a bounded rate."""

from __future__ import annotations

import logging
import time

from valor.common.messages import Rejection

PERIOD = 0.2  # between publications of one kind from one sender [s]
_KINDS = 256  # remembered; more, and all are forgotten

_log = logging.getLogger("motion_manager")


class Rejections:
    """Counts rejections by topic and keeps those to be published until somebody takes them.

    Attributes:
        total: since start.
    """

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._published: dict[tuple[str, str, str], float] = {}
        self._waiting: list[Rejection] = []
        self.total = 0

    def add(self, topic: str, origin: str, kind: str, reason: str) -> None:
        """Count a rejection.

        Args:
            topic: that it came on.
            origin: the node that sent it.
            kind: one word for what is wrong; rejections of the same kind are published at a bounded rate.
            reason: one line for a person.
        """
        self.total += 1
        count = self._counts[topic] = self._counts.get(topic, 0) + 1
        now = time.monotonic()
        key = (topic, origin, kind)
        if now - self._published.get(key, -PERIOD) < PERIOD:
            return
        if key not in self._published:
            if len(self._published) >= _KINDS:
                self._published.clear()
            _log.warning("%s from %s refused: %s", topic, origin, reason)
        self._published[key] = now
        self._waiting.append(Rejection(topic=topic, origin=origin, reason=reason, count=count))

    def count(self, topic: str) -> int:
        """Rejections on a topic since start."""
        return self._counts.get(topic, 0)

    def take(self) -> list[Rejection]:
        """Those to be published now."""
        if not self._waiting:
            return []
        waiting, self._waiting = self._waiting, []
        return waiting
