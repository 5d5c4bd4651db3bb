"""The robot's end of the fast channel's things: answers, and remembers nothing that it could not be asked for again."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterator

from valor.link.bulk.lane import Lane
from valor.link.bulk.things import Shelf, Thing
from valor.link.bulk.wire import CHUNK, Ask, Gone, News, Want, Word, chunk, heard, said
from valor.link.datagrams import AT_ONCE
from valor.link.errors import BulkError, SealError
from valor.link.session import Session

TURN = 0.004  # of a processor that chunks may take in one turn of the loop, so that states stay on time [s]
WAITING = 4096  # chunks that may wait to be sent
FORGOTTEN = 0.5  # after so long without a word what was asked for is not wanted any more [s]
KEPT = 4  # things that may be asked for at once: the newest ones
REASON = 300  # of a refusal's characters


class Giver:
    """Serves what is on the shelf.

    Attributes:
        sent: chunks, ever.
    """

    def __init__(self, session: Session, shelf: Shelf) -> None:
        self._lane, self._shelf = Lane(session), shelf
        self._things: dict[bytes, Thing] = {}
        self._words: list[Word] = []
        self._wanted = b""  # tag of the thing whose chunks are in the queue
        self._queue: OrderedDict[int, None] = OrderedDict()
        self._newest = 0
        self._heard = -1e9
        self.sent = 0

    @property
    def busy(self) -> bool:
        """Whether something waits to be sent."""
        return bool(self._queue or self._words)

    def receive(self, data: bytes, now: float) -> None:
        """A datagram of the operator's end.

        Raises:
            SealError: it is none.
        """
        self._renew()
        content, counter = self._lane.open(data)
        if counter <= self._newest:  # overtaken, or again: what is wanted is asked for anew
            return
        word = heard(content)
        self._newest, self._heard = counter, now
        if isinstance(word, Ask):
            self._words.append(self._news(word.about))
        elif isinstance(word, Want):
            self._want(word)
        else:
            raise SealError("the operator's end asks, and tells nothing")

    def _renew(self) -> None:
        if self._lane.renewed():
            self._newest = 0
            self._words.clear()
            self._queue.clear()

    def _news(self, about: str) -> News:
        found, refused = list(self._shelf.newest()), ""
        try:
            asked = self._shelf.find(about) if about else None
            found += [asked] if asked is not None else []
        except BulkError as error:
            refused = str(error)[:REASON]
        for thing in found:
            self._remember(thing)
        return News(tuple(each.described for each in found), about, refused)

    def _remember(self, thing: Thing) -> None:
        """As one that can be asked for."""
        tag = thing.described.tag
        known = self._things.pop(tag, None)
        if known is not None and known is not thing:
            known.close()
        self._things[tag] = thing
        while len(self._things) > KEPT:
            self._forget(next(iter(self._things)))

    def _forget(self, tag: bytes) -> None:
        self._things.pop(tag).close()

    def _want(self, word: Want) -> None:
        thing = self._things.get(word.thing)
        if thing is None:
            self._words.append(Gone(word.thing))
            return
        self._things[word.thing] = self._things.pop(word.thing)  # the newest of them
        if self._wanted != word.thing:
            self._queue.clear()  # something more urgent
            self._wanted = word.thing
        last = -(-thing.described.size // CHUNK)
        for first, count in word.ranges:
            for place in range(first, min(first + count, last)):
                if len(self._queue) >= WAITING:
                    return
                self._queue[place] = None

    def turn(self, now: float, _all_heard: bool = True) -> Iterator[list[bytes]]:
        """Datagrams to send now, as of ``carrier.Things``, until ``TURN`` is over."""
        self._renew()
        if now - self._heard > FORGOTTEN:
            self._queue.clear()
            self._words.clear()
        while self._words:
            yield [self._lane.seal(said(self._words.pop(0)))]
        until = time.thread_time() + TURN
        while self._queue and time.thread_time() < until:
            tag, run = self._wanted, self._run()
            content = self._read(tag, run)
            if not content:
                self._queue.clear()
                if tag in self._things:
                    self._forget(tag)
                yield [self._lane.seal(said(Gone(tag)))]
                return
            pieces = (content[at : at + CHUNK] for at in range(0, len(content), CHUNK))
            yield [self._lane.seal(chunk(tag, *each)) for each in zip(run, pieces, strict=True)]
            for place in run:
                del self._queue[place]
            self.sent += len(run)

    def _run(self) -> range:
        """Chunks side by side that are wanted, the first of them since longest."""
        first = end = next(iter(self._queue))
        while end < first + AT_ONCE and end in self._queue:
            end += 1
        return range(first, end)

    def _read(self, tag: bytes, run: range) -> bytes:
        """Their bytes; none: they are not to be had."""
        try:
            thing = self._things[tag]
            return thing.read(run.start * CHUNK, len(run) * CHUNK)
        except (KeyError, BulkError, OSError):
            return b""

    def close(self) -> None:
        """Let go of all."""
        while self._things:
            self._forget(next(iter(self._things)))
