"""A recording as the page plays it: the topics that are shown, by time, out of any bag that can be read.

A thread reads the bag once, from its beginning to its end, and keeps what is wanted in a file without a name; what has
been read can be played at once. Streams are thinned out to what can be seen.
"""

from __future__ import annotations

import os
import tempfile
import threading
from array import array
from bisect import bisect_right
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from valor.bags.event import Event
from valor.bags.stored import StoredBag, StoredMessage, in_order

SPACING = 15_000_000  # between two messages of a stream that are kept, at least [ns]


@dataclass(frozen=True)
class Wanted:
    """A topic.

    Attributes:
        topic: relative to the robot's namespace.
        stream: the newest message alone counts.
    """

    topic: str
    stream: bool


class Tape:
    """What was read so far. Times are the recorder's wall clock [ns].

    Attributes:
        begin: of the recording; 0: nothing has been read yet.
        end: of what has been read.
        whole: all has been read.
        damage: of the bag, or why no more of it can be read, in lines.
    """

    def __init__(self, bag: Path, wanted: Sequence[Wanted]) -> None:
        """Begin to read.

        Raises:
            BagError: there is no bag there.
        """
        self._bag = StoredBag(bag)
        self._wanted = list(wanted)
        self._file = tempfile.TemporaryFile()  # noqa: SIM115  # as long as the tape
        self._stamps, self._places, self._sizes, self._topics = array("q"), array("q"), array("l"), array("B")
        self._told = array("l")  # which of them are no streams
        self.begin = self.end = 0
        self.whole = False
        self.damage: list[str] = []
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._read, name="tape", daemon=True)
        self._thread.start()

    @property
    def events(self) -> list[Event]:
        """That the recorder noted, as far as it has been read."""
        return list(self._bag.condition.events)

    def between(self, after: int, until: int) -> Iterator[tuple[int, int, bytes]]:
        """Stamp, number of the topic wanted, and bytes of what came after one time and until another."""
        first, last = bisect_right(self._stamps, after), bisect_right(self._stamps, until)
        yield from map(self._message, range(first, last))

    def told_before(self, time: int) -> Iterator[tuple[int, int, bytes]]:
        """Likewise, what was said on change until a time, streams left out."""
        last = bisect_right(self._told, bisect_right(self._stamps, time) - 1)
        yield from map(self._message, self._told[:last])

    def close(self) -> None:
        """Read no more."""
        self._closing.set()
        self._thread.join()
        self._file.close()

    def _message(self, number: int) -> tuple[int, int, bytes]:
        data = os.pread(self._file.fileno(), self._sizes[number], self._places[number])
        return self._stamps[number], self._topics[number], data

    def _read(self) -> None:
        try:
            self._keep_all()
        except OSError as error:
            self.damage.append(f"{self._bag.path}: {error.strerror}: no more of it is read")
        self.damage += self._bag.condition.damage
        self.whole = True

    def _keep_all(self) -> None:
        numbers: dict[str, int | None] = {}
        kept: dict[int, int] = {}
        place = 0
        for message in in_order(self._bag.messages()):
            if self._closing.is_set():
                return
            self.begin = self.begin or message.received
            self.end = max(self.end, message.received)
            name = message.topic.name
            if name not in numbers:
                numbers[name] = self._number(name, numbers.values())
            if (number := numbers[name]) is None or not self._due(message, number, kept):
                continue
            os.pwrite(self._file.fileno(), message.data, place)
            if not self._wanted[number].stream:
                self._told.append(len(self._stamps))
            self._topics.append(number)
            self._places.append(place)
            self._sizes.append(len(message.data))
            # Last of all, and never back in time: who plays looks for stamps.
            self._stamps.append(max(message.received, self._stamps[-1] if self._stamps else 0))
            place += len(message.data)

    def _number(self, name: str, taken: Collection[int | None]) -> int | None:
        """Of the topic that it is in whatever namespace; None: it is not wanted, or another is it already."""
        for number, wanted in enumerate(self._wanted):
            if f"/{name}".endswith(f"/{wanted.topic}") and number not in taken:
                return number
        return None

    def _due(self, message: StoredMessage, number: int, kept: dict[int, int]) -> bool:
        """Whether it is to be kept."""
        if not self._wanted[number].stream:
            return True
        if message.received - kept.get(number, -SPACING) < SPACING:
            return False
        kept[number] = message.received
        return True
