"""Limits of message rates: a sender that exceeds its limit is muted for a second at a time."""

import logging

import msgspec

MUTE = 1_000_000_000  # duration of a mute after the last excess [ns]
LOOKS = 64  # maximum number of undelivered messages that one call processes
_log = logging.getLogger("bifrost")


class Limit(msgspec.Struct, frozen=True):
    """Maximum rate of a sender.

    Attributes:
        rate: permanent rate by the sender's stamps [messages/s].
        burst: number of messages allowed in excess of it.
    """

    rate: float
    burst: int


class Meter:
    """Checks one sender against a limit (generic cell rate algorithm, ITU-T I.371)."""

    __slots__ = ("_due", "_interval", "_tolerance", "_topic", "muted_until", "name")

    def __init__(self, limit: Limit, topic: str = "", name: str = "") -> None:
        self.name, self._topic = name, topic
        self.muted_until = 0  # end of its mute by the receiver's clock [ns]; 0: never muted
        self._interval = int(1e9 / limit.rate)
        self._tolerance = self._interval * limit.burst
        self._due = -(2**63)

    def exceeds(self, count: int, at: int) -> bool:
        """Count messages up to a time [ns]; True, and a restart, if they exceed the limit."""
        due = self._due + count * self._interval
        if due - at > self._tolerance:
            self._due = at
            return True
        self._due = max(due, at)
        return False

    def mutes(self, count: int, at: int, now: int) -> bool:
        """Count messages sent up to ``at``; True while the sender is muted. Times by its and our clock [ns]."""
        if self.exceeds(count, at):
            if now >= self.muted_until:
                _log.warning("%s: %s floods it, and is muted while it continues", self._topic, self.name)
            self.muted_until = now + MUTE
        return now < self.muted_until
