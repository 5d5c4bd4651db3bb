"""Recording everything: into one bag, or into a row of bags that are split by size or time."""

from __future__ import annotations

import errno
import logging
import time

from valor.bag_recorder.bag import Bag, RecordedTopic, Sink
from valor.bag_recorder.clock import ClockChange, WallClock
from valor.bag_recorder.falls import FALL, Falls
from valor.bag_recorder.shelf import MARK, Shelf, told, wall_time
from valor.common.messages import MotionState

FLUSH_PERIOD = 0.5  # what SIGKILL may lose [s]
SPACE_PERIOD = 1.0  # between two looks at the disk [s]
RETRY_PERIOD = 2.0  # after a bag could not be written [s]

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # there may be room another day

_log = logging.getLogger("bag_recorder")


class Continuous:
    """A sink that writes all at once.

    Args:
        shelf: where bags come from.
        clock: by which they are stamped.
        size: of a bag, after which the next begins [B].
        age: likewise [s].

    Attributes:
        failure: why nothing is recorded now; empty: it is.

    Raises:
        OSError: by the constructor: no bag can be written there, and not because the disk is full.
    """

    def __init__(self, shelf: Shelf, clock: WallClock, size: float, age: float) -> None:
        self._shelf, self._clock = shelf, clock
        self._size, self._age = size, age
        self.failure = ""
        self._bag: Bag | None = None
        self._falls = Falls()
        self._begun = self._next_flush = self._next_look = self._next_try = 0.0
        try:
            self._begin()
        except OSError as error:
            if error.errno not in _FULL:
                raise
            self.failed(error)

    @property
    def sink(self) -> Sink | None:
        """Where messages go now; None: nowhere."""
        return None if self._bag is None else self

    def write(self, topic: RecordedTopic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add a message to the bag of now."""
        if topic.latched:
            self._shelf.remember(topic, publish_time, sequence, data)
        assert self._bag is not None
        self._bag.write(topic, log_time, publish_time, sequence, data)

    def attend(self) -> None:
        """What is due: hand all to the system, begin the next bag, look at the disk, try again.

        Raises:
            OSError: the bag cannot be written.
        """
        now, bag = time.monotonic(), self._bag
        if bag is None:
            if now >= self._next_try:
                self._try_again(now)
            return
        if now >= self._next_flush:
            self._next_flush = now + FLUSH_PERIOD
            bag.flush()
            if self._is_full(bag, now):
                self._shelf.finish(bag)
                self._bag = None
                self._begin()
                return
        if now >= self._next_look:
            self._next_look = now + SPACE_PERIOD
            self._shelf.check_space(bag.path.parent)

    def heard(self, state: MotionState, stamp: int) -> None:
        """The Motion Manager's newest word, and when it was said [ns, wall clock]: a fall is noted in the bag.

        Raises:
            OSError: the bag cannot be written.
        """
        if self._falls.begins(state) and self._bag is not None:
            self._shelf.event(self._bag, FALL, stamp, state.reason)

    def mark(self, text: str, stamp: int) -> str:
        """Note a moment [ns, wall clock]; returns why that cannot be.

        Raises:
            OSError: the bag cannot be written.
        """
        if self._bag is None:
            return f"not recording: {self.failure}"
        self._shelf.event(self._bag, MARK, stamp, text)
        return ""

    def note(self, change: ClockChange) -> None:
        """The wall clock has moved."""
        if self._bag is not None:
            self._bag.add_metadata(f"clock_{change.kind}", change.metadata())

    def failed(self, error: OSError) -> None:
        """Writing failed: save what is written and go on without a bag until there is room."""
        bag, self._bag = self._bag, None
        if bag is not None:
            self.failure = self._shelf.give_up(bag, error)
        else:  # the first, or the next of a row, could not be begun
            self.failure = told(error, self._shelf.place())
            _log.error("not recording: %s", self.failure)
        self._next_try = time.monotonic() + RETRY_PERIOD

    def close(self) -> None:
        """Finish the bag.

        Raises:
            OSError: it cannot be written.
        """
        if self._bag is not None:
            self._shelf.finish(self._bag)
            self._bag = None

    def _begin(self) -> None:
        self._bag = bag = self._shelf.begin()
        self._begun = time.monotonic()
        self._shelf.add_latched(bag, wall_time(self._clock))

    def _is_full(self, bag: Bag, now: float) -> bool:
        return bag.size >= self._size or now - self._begun >= self._age

    def _try_again(self, now: float) -> None:
        self._next_try = now + RETRY_PERIOD
        try:
            self._shelf.check_space(self._shelf.place().parent)
            self._shelf.recover_unfinished()
            self._begin()
        except OSError:
            return  # told when it began
        self.failure = ""
