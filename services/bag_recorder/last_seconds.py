"""Recording on demand: the last seconds wait in memory, and become a bag when the robot falls or somebody asks."""

from __future__ import annotations

import logging
import time
from collections import deque

from valor.bag_recorder.bag import RecordedTopic, Sink
from valor.bag_recorder.clock import ClockChange
from valor.bag_recorder.falls import FALL, Falls
from valor.bag_recorder.shelf import MARK, Shelf, told
from valor.common.messages import MotionState, SnapReply

MOST_MARKS = 100  # that are held
LIMIT = 256 << 20  # of memory for messages [B]
AFTER_FALL = 2.0  # how long a fall goes on being recorded [s]
_OVERHEAD = 200  # of a message in memory [B]

_log = logging.getLogger("bag_recorder")


class LastSeconds:
    """A sink that forgets.

    Attributes:
        failure: always empty: it writes only when asked, and then tells who asked.
    """

    failure = ""

    def __init__(self, shelf: Shelf, seconds: float, limit: int = LIMIT) -> None:
        self._shelf, self._seconds, self._limit = shelf, seconds, limit
        # when it came [monotonic s], and what is written
        self._ring: deque[tuple[float, RecordedTopic, int, int, int, bytes]] = deque()
        self._size = 0
        self._now = time.monotonic()
        self._falls = Falls()
        self._event = (0, "")  # the last fall: when [ns], and why
        self._marks: deque[tuple[float, int, str]] = deque(maxlen=MOST_MARKS)  # monotonic [s], wall [ns], text
        self._save_at: float | None = None
        self._told = False

    @property
    def sink(self) -> Sink:
        """Where messages go."""
        return self

    def write(self, topic: RecordedTopic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Keep a message for a while."""
        if topic.latched:
            self._shelf.remember(topic, publish_time, sequence, data)
        self._ring.append((self._now, topic, log_time, publish_time, sequence, data))
        self._size += len(data) + _OVERHEAD

    def heard(self, state: MotionState, stamp: int) -> None:
        """The Motion Manager's newest word, and when it was said [ns, wall clock].

        A fall is saved, once its end has been seen.
        """
        if self._falls.begins(state) and self._save_at is None:
            self._save_at = time.monotonic() + AFTER_FALL
            self._event = (stamp, state.reason)

    def attend(self) -> None:
        """Forget what is too old, save what is due."""
        self._now = now = time.monotonic()
        if self._save_at is not None and now >= self._save_at:
            self._save_at = None
            self.snap(FALL)
        oldest = now - self._seconds
        ring = self._ring
        while self._marks and self._marks[0][0] < oldest:
            self._marks.popleft()
        while ring and (ring[0][0] < oldest or self._size > self._limit):
            if ring[0][0] >= oldest and not self._told:
                self._told = True
                held = now - ring[0][0]
                _log.warning("%d MiB hold %.1f s of messages, not %g", self._limit >> 20, held, self._seconds)
            self._size -= len(ring.popleft()[-1]) + _OVERHEAD

    def snap(self, label: str) -> SnapReply:
        """Write what is held into a bag of its own, and go on holding it."""
        if not self._ring:
            return refused("nothing has come yet")
        try:
            bag = self._shelf.begin(label)
        except OSError as error:
            return _failed(told(error, self._shelf.place(label)))
        try:
            held = frozenset(entry[1].name for entry in self._ring)
            self._shelf.add_latched(bag, min(entry[2] for entry in self._ring), but=held)
            for _, topic, log_time, publish_time, sequence, data in self._ring:
                bag.write(topic, log_time, publish_time, sequence, data)
            for _, stamp, text in self._marks:
                self._shelf.event(bag, MARK, stamp, text)
            if label == FALL:
                self._shelf.event(bag, FALL, *self._event)
            messages = bag.messages
            self._shelf.finish(bag)
        except OSError as error:
            return _failed(self._shelf.give_up(bag, error))
        seconds = self._ring[-1][0] - self._ring[0][0]
        return SnapReply(accepted=True, path=str(bag.path), messages=messages, seconds=seconds, reason="")

    def mark(self, text: str, stamp: int) -> str:
        """Note a moment [ns, wall clock], for as long as what came then is held."""
        self._marks.append((time.monotonic(), stamp, text))
        return ""

    def note(self, change: ClockChange) -> None:
        """The wall clock has moved: told in the metadata of the bags to come."""

    def failed(self, error: OSError) -> None:
        """Never: nothing is written while messages come."""
        raise error

    def close(self) -> None:
        """Save a fall that was still going on."""
        if self._save_at is not None:
            self.snap(FALL)


def refused(reason: str) -> SnapReply:
    """Nothing is saved, and why."""
    return SnapReply(accepted=False, path="", messages=0, seconds=0.0, reason=reason)


def _failed(reason: str) -> SnapReply:
    _log.error("not saved: %s", reason)
    return refused(reason)
