"""What became of each topic's messages: received, written, dropped."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Count:
    """Of one topic.

    Attributes:
        received: came to the recorder.
        dropped: lost on their way, refused, not convertible, or come while no bag could be written.
        written: are in the bag. Received ones that are neither were left out by the topic's ``record_every``, or are
            not yet in a bag.
    """

    received: int = 0
    dropped: int = 0
    written: int = 0


class Tally:
    """Counts by topic, of which each bag gets its share.

    Attributes:
        total: since the recorder's start.
    """

    def __init__(self) -> None:
        self.total: dict[str, Count] = {}

    def share(self, received: Mapping[str, tuple[int, int]], written: Mapping[str, int]) -> dict[str, Count]:
        """What falls to a bag: all since the one before was settled.

        Args:
            received: by topic, received and dropped since the recorder's start.
            written: by topic, what is in the bag.
        """
        counts = {}
        for topic in sorted(received.keys() | written.keys()):
            before = self.total.get(topic, Count())
            came, lost = received.get(topic, (before.received, before.dropped))
            counts[topic] = Count(came - before.received, lost - before.dropped, written.get(topic, 0))
        return counts

    def settle(self, received: Mapping[str, tuple[int, int]], written: Mapping[str, int]) -> None:
        """The bag is closed: count it, once."""
        for topic, count in self.share(received, written).items():
            before = self.total.get(topic, Count())
            self.total[topic] = Count(
                before.received + count.received, before.dropped + count.dropped, before.written + count.written
            )


def metadata(counts: Mapping[str, Count]) -> dict[str, str]:
    """As a metadata record of the bag."""
    return {topic: json.dumps(asdict(count)) for topic, count in counts.items()}


def table(counts: Mapping[str, Count]) -> list[str]:
    """Lines for people: topics that had messages."""
    shown = {topic: count for topic, count in counts.items() if count != Count()}
    width = max(map(len, shown), default=0)
    lines = [f"{'topic':{width}} {'received':>9} {'written':>9} {'dropped':>9}"]
    for topic, count in shown.items():
        lines.append(f"{topic:{width}} {count.received:9d} {count.written:9d} {count.dropped:9d}")
    return lines
