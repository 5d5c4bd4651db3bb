"""What happened while a bag was recorded: a record in its metadata, among a fall, a mark that somebody made, a gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

EVENT = "event"  # name of the metadata record


@dataclass(frozen=True)
class Event:
    """One.

    Attributes:
        stamp: when, by the recorder's wall clock [ns].
        what: ``fall``, ``mark``, ``gap``.
        reason: in words.
    """

    stamp: int
    what: str
    reason: str

    @property
    def text(self) -> str:
        """For people."""
        return f"{self.what}: {self.reason}"

    @classmethod
    def of(cls, record: Mapping[str, str]) -> Self | None:
        """Out of a metadata record of that name; None: another program's."""
        try:
            return cls(int(record["stamp_ns"]), record["what"], record["reason"])
        except (KeyError, ValueError):
            return None

    def record(self) -> dict[str, str]:
        """As a bag has it."""
        return {"what": self.what, "stamp_ns": str(self.stamp), "reason": self.reason}
