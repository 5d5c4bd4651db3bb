"""The two ways to record: continuously into a series of bags, or the last seconds after a fall or on request."""

import errno
import logging
import time
from collections import deque

from valor.bag_recorder.bag import Bag, RecordedTopic, Sink
from valor.bag_recorder.bag_store import FALL, MARK, BagStore, one_line, wall_time
from valor.bag_recorder.clock import ClockChange, StampConverter
from valor.common.messages import SnapReply

FLUSH_PERIOD = 0.5  # between flushes: the most that SIGKILL loses [s]
SPACE_PERIOD = 1.0  # between checks of the free space [s]
RETRY_PERIOD = 2.0  # between attempts to start a bag after a failure [s]

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # temporary: space may become free

_log = logging.getLogger("bag_recorder")
MAX_MARKS = 100  # in memory
LIMIT = 256 << 20  # memory for messages [B]
AFTER_FALL = 2.0  # recorded after the start of a fall [s]
_OVERHEAD = 200  # of a message in memory [B]


class Continuous:
    """A sink that writes every message. Its constructor raises OSError, but not for a full disk."""

    def __init__(self, store: BagStore, clock: StampConverter, size: float, age: float) -> None:
        """``size`` [B] and ``age`` [s]: of a bag when the next one starts."""
        self._store, self._clock = store, clock
        self._size, self._age = size, age
        self.failure = ""  # why nothing is recorded now; empty while messages are recorded
        self._bag: Bag | None = None
        self._begun = self._next_flush = self._next_check = self._next_try = 0.0
        try:
            self._begin()
        except OSError as error:
            if error.errno not in _FULL:
                raise
            self.failed(error)

    @property
    def sink(self) -> Sink | None:
        """The receiver of messages; None while no bag can be written."""
        return None if self._bag is None else self

    def write(self, topic: RecordedTopic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        if topic.latched:
            self._store.remember(topic, publish_time, sequence, data)
        assert self._bag is not None
        self._bag.write(topic, log_time, publish_time, sequence, data)

    def update(self) -> None:
        """Do what is due: flush, start the next bag, check the free space, or retry."""
        now, bag = time.monotonic(), self._bag
        if bag is None:
            if now >= self._next_try:
                self._retry(now)
            return
        if now >= self._next_flush:
            self._next_flush = now + FLUSH_PERIOD
            bag.flush()
            if bag.size >= self._size or now - self._begun >= self._age:
                self._store.finish(bag)
                self._bag = None
                self._begin()
                return
        if now >= self._next_check:
            self._next_check = now + SPACE_PERIOD
            self._store.check_space(bag.path.parent)

    def fall(self, stamp: int, reason: str) -> None:
        """Note the start of a fall [ns, wall clock]."""
        if self._bag is not None:
            self._store.add_event(self._bag, FALL, stamp, reason)

    def mark(self, text: str, stamp: int) -> str:
        """Note a moment [ns, wall clock]; returns why that is not possible, or an empty string."""
        if self._bag is None:
            return f"not recording: {self.failure}"
        self._store.add_event(self._bag, MARK, stamp, text)
        return ""

    def clock_changed(self, change: ClockChange) -> None:
        if self._bag is not None:
            self._bag.add_metadata(f"clock_{change.kind}", change.metadata())

    def failed(self, error: OSError) -> None:
        """Save what is written after a failure, and continue without a bag until one can be written."""
        bag, self._bag = self._bag, None
        if bag is not None:
            self.failure = self._store.rescue(bag, error)
        else:  # the next bag could not be started
            self.failure = one_line(error, self._store.path())
            _log.error("not recording: %s", self.failure)
        self._next_try = time.monotonic() + RETRY_PERIOD

    def close(self) -> None:
        if self._bag is not None:
            self._store.finish(self._bag)
            self._bag = None

    def _begin(self) -> None:
        self._bag = bag = self._store.begin()
        self._begun = time.monotonic()
        self._store.add_latched(bag, wall_time(self._clock))

    def _retry(self, now: float) -> None:
        self._next_try = now + RETRY_PERIOD
        try:
            self._store.check_space(self._store.path().parent)
            self._store.recover_unfinished()
            self._begin()
        except OSError:
            return  # logged when recording stopped
        self.failure = ""


class LastSeconds:
    """A sink that discards messages older than some seconds."""

    failure = ""  # always: failures are reported in the reply to a request

    def __init__(self, store: BagStore, seconds: float, limit: int = LIMIT) -> None:
        self._store, self._seconds, self._limit = store, seconds, limit
        self._ring: deque[tuple[float, RecordedTopic, int, int, int, bytes]] = deque()  # reception [s], message
        self._size = 0
        self._now = time.monotonic()
        self._fall = (0, "")  # the last one: stamp [ns], reason
        self._marks: deque[tuple[float, int, str]] = deque(maxlen=MAX_MARKS)  # monotonic [s], wall [ns], text
        self._save_at: float | None = None
        self._warned = False

    @property
    def sink(self) -> Sink:
        return self

    def write(self, topic: RecordedTopic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        if topic.latched:
            self._store.remember(topic, publish_time, sequence, data)
        self._ring.append((self._now, topic, log_time, publish_time, sequence, data))
        self._size += len(data) + _OVERHEAD

    def fall(self, stamp: int, reason: str) -> None:
        """Save a fall that starts [ns, wall clock], ``AFTER_FALL`` later."""
        if self._save_at is None:
            self._save_at = time.monotonic() + AFTER_FALL
            self._fall = (stamp, reason)

    def update(self) -> None:
        """Discard what is too old, and save what is due."""
        self._now = now = time.monotonic()
        if self._save_at is not None and now >= self._save_at:
            self._save_at = None
            self.snap(FALL)
        oldest = now - self._seconds
        ring = self._ring
        while self._marks and self._marks[0][0] < oldest:
            self._marks.popleft()
        while ring and (ring[0][0] < oldest or self._size > self._limit):
            if ring[0][0] >= oldest and not self._warned:
                self._warned = True
                held = now - ring[0][0]
                _log.warning("%d MiB hold %.1f s of messages, not %g", self._limit >> 20, held, self._seconds)
            self._size -= len(ring.popleft()[-1]) + _OVERHEAD

    def snap(self, label: str) -> SnapReply:
        """Write the messages in memory into a new bag; they also stay in memory."""
        if not self._ring:
            return rejected("no message has been received yet")
        try:
            bag = self._store.begin(label)
        except OSError as error:
            return _failed(one_line(error, self._store.path(label)))
        try:
            held = frozenset(entry[1].name for entry in self._ring)
            self._store.add_latched(bag, min(entry[2] for entry in self._ring), but=held)
            for _, topic, log_time, publish_time, sequence, data in self._ring:
                bag.write(topic, log_time, publish_time, sequence, data)
            for _, stamp, text in self._marks:
                self._store.add_event(bag, MARK, stamp, text)
            if label == FALL:
                self._store.add_event(bag, FALL, *self._fall)
            messages = bag.messages
            self._store.finish(bag)
        except OSError as error:
            return _failed(self._store.rescue(bag, error))
        seconds = self._ring[-1][0] - self._ring[0][0]
        return SnapReply(accepted=True, path=str(bag.path), messages=messages, seconds=seconds, reason="")

    def mark(self, text: str, stamp: int) -> str:
        """Note a moment [ns, wall clock] until its messages are discarded."""
        self._marks.append((time.monotonic(), stamp, text))
        return ""

    def clock_changed(self, change: ClockChange) -> None:
        """Do nothing: later bags have the change in their metadata."""

    def failed(self, error: OSError) -> None:
        """Raise the error: no file is written while messages are received."""
        raise error

    def close(self) -> None:
        """Save a fall whose recording is not complete yet."""
        if self._save_at is not None:
            self.snap(FALL)


def rejected(reason: str) -> SnapReply:
    """The reply if no bag is saved."""
    return SnapReply(accepted=False, path="", messages=0, seconds=0.0, reason=reason)


def _failed(reason: str) -> SnapReply:
    _log.error("not saved: %s", reason)
    return rejected(reason)
