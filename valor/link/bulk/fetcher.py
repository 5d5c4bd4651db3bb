"""The operator's end of the fast channel's things: asks, keeps what comes, and goes on where it was after a blackout.

What is fetched at a time is one thing, the most urgent that there is: the newest picture, the list of bags, the bags
that were asked for in their order. What it interrupts stays as it is.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from valor.link.bulk.errands import Errands
from valor.link.bulk.lane import Lane
from valor.link.bulk.pace import Pace
from valor.link.bulk.sinks import File, Memory, Sink
from valor.link.bulk.wire import MOST_RANGES, Ask, Chunk, Described, Gone, News, Want, heard, said
from valor.link.bulk.worker import Worker
from valor.link.classes import Bulk
from valor.link.errors import BulkError, SealError
from valor.link.session import Session

PROBES = 0.02  # between questions whether the channel is there [s]
NEWS = 0.5  # between questions what is new, while it is [s]
OPEN = 0.1  # so long after the last word it counts as there, where answers come quickly [s]
NOTED = 5.0  # between notes of what has come, while it comes [s]
BATCH = 16  # chunks that are worth a question of their own
LARGEST_HELD = {Bulk.PICTURE: 4 * 2**20, Bulk.LISTING: 2**20}  # of what is kept in memory [B]
TRIES = 3  # of a thing whose digest is wrong


class Fetcher:
    """Fetches.

    Attributes:
        errands: the bags that are wanted, and what became of them.
        picture: the newest that came, and its content; None: none has.
        listing: the list of bags that came last.
        taken: chunks that were of use, ever.
    """

    def __init__(self, session: Session, folder: Path) -> None:
        """``folder``: where bags go, and where an earlier process may have left some."""
        self._lane, self._folder = Lane(session), folder
        self.errands = Errands(folder)
        self._pace = Pace()
        self._worker = Worker()
        self._things: dict[Bulk, Described] = {}  # that the robot's end has
        self._done: dict[Bulk, bytes] = {}  # digests of what has come, or cannot
        self._active: tuple[Described, Sink] | None = None
        self._open = False
        self._heard = self._news_due = self._note_due = self._now = -1e9
        self.picture: tuple[Described, bytes] | None = None
        self.listing = b""
        self.taken = 0

    @property
    def open(self) -> bool:
        """Whether the channel is there, as far as things were heard on it."""
        return self._open

    @property
    def busy(self) -> bool:
        """Whether anything is under way."""
        return self._open and self._active is not None

    def receive(self, data: bytes, now: float) -> None:
        """A datagram of the robot's end.

        Raises:
            SealError: it is none, or says what cannot be.
        """
        self._renew()
        word = heard(self._lane.open(data)[0])
        self._heard, self._open = now, True
        if isinstance(word, Chunk):
            self._take(word, now)
        elif isinstance(word, News):
            self._learn(word, now)
        elif isinstance(word, Gone):
            self._lose(word.thing)
        else:
            raise SealError("the robot's end tells, and asks nothing")

    def _renew(self) -> None:
        if self._lane.renewed():  # the other end knows nothing of what it said
            self._things.clear()
            self._leave()
            self.errands.forget()

    def _take(self, chunk: Chunk, now: float) -> None:
        if self._active is None or self._active[0].tag != chunk.thing:
            return
        described, sink = self._active
        if len(chunk.content) != sink.chunks.length(chunk.place):
            raise SealError(f"chunk {chunk.place} of {described.name}: {len(chunk.content)} bytes")
        asked = sink.chunks.arrived(chunk.place)
        if asked is None:
            return
        self._pace.came(max(now - asked, 1e-6) if asked else 0.0)
        self.taken += 1
        try:
            sink.write(chunk.place, chunk.content)
        except BulkError as error:
            self._fail(described, sink, str(error))
            return
        if sink.chunks.whole:
            self._check(described, sink)

    def _check(self, described: Described, sink: Sink) -> None:
        """In another thread: the disk takes its time."""
        self._active = None
        self._news_due = self._now  # what is next?
        if described.kind is Bulk.BAG:
            self.errands.tell(described.name, "checking")
        self._worker.do((described, sink), sink.finish)

    def _checked(self) -> None:
        for (described, sink), content, error in self._worker.done():
            if error is not None:
                self._retry(described, sink, error)
            elif described.kind is Bulk.BAG:
                self.errands.end(described.name, "here")
            else:
                self._done[described.kind] = described.digest
                if described.kind is Bulk.PICTURE:
                    self.picture = (described, content)
                else:
                    self.listing = content

    def _retry(self, described: Described, sink: Sink, error: str) -> None:
        """What was checked is not what it should be, or cannot be kept."""
        if described.kind is Bulk.BAG and self.errands.again(described.name) < TRIES:
            sink.drop()
        else:
            self._fail(described, sink, error)

    def _fail(self, described: Described, sink: Sink, why: str) -> None:
        sink.drop()
        if self._active is not None and self._active[1] is sink:
            self._active = None
        if described.kind is Bulk.BAG:
            self.errands.end(described.name, f"failed: {why}")
        else:
            self._done[described.kind] = described.digest

    def _learn(self, news: News, now: float) -> None:
        for each in news.things:
            if each.kind is Bulk.BAG:
                with contextlib.suppress(SealError):
                    self.errands.describe(each)
            else:
                self._things[each.kind] = each
        if news.refused:
            self.errands.end(news.about, f"failed: {news.refused}")
        self._news_due = now + NEWS

    def _lose(self, thing: bytes) -> None:
        if self._active is not None and self._active[0].tag == thing:
            described = self._active[0]
            self._leave()
            self._things.pop(described.kind, None)
            self.errands.undescribe(described.name)
            self._news_due = self._now

    def _leave(self) -> None:
        """What is being fetched, as it is."""
        if self._active is not None:
            self._active[1].close()
            self._active = None

    def _next(self) -> Described | None:
        """The most urgent thing that is described and has not come."""
        for kind in sorted(LARGEST_HELD):
            each = self._things.get(kind)
            if each is not None and each.digest != self._done.get(kind) and not self._worker.has(each):
                if each.size <= LARGEST_HELD[kind]:
                    return each
                self._done[kind] = each.digest
        return self.errands.next(self._worker.has)

    def _choose(self) -> None:
        if (
            self._active is not None
            and self._active[0].kind is Bulk.BAG
            and not self.errands.wants(self._active[0].name)
        ):
            self._leave()
        wanted = self._next()
        if wanted is None:
            return
        if self._active is not None:
            described = self._active[0]
            if wanted.digest == described.digest or described.kind < Bulk.BAG:
                return  # of two pictures in one window the first is finished first
            self._leave()
        try:
            sink: Sink = Memory(wanted) if wanted.kind in LARGEST_HELD else File(self._folder, wanted)
        except (BulkError, SealError) as error:
            self.errands.end(wanted.name, f"failed: {error}")
            return
        self._active = (wanted, sink)
        self._note_due = self._now + NOTED
        if sink.chunks.whole:
            self._check(wanted, sink)

    def turn(self, now: float, all_heard: bool = True) -> Iterator[list[bytes]]:
        """As of ``carrier.Things``."""
        self._renew()
        self._now = now
        self._checked()
        if not self._lane.session.established:
            return
        if self._open and all_heard and now - self._heard > max(OPEN, 2.0 * self._pace.patience):
            self._close()
        if now >= self._news_due:
            self._news_due = now + PROBES
            yield [self._lane.seal(said(Ask(self.errands.unknown())))]
        if self._open:
            self._choose()
            yield from self._ask(now, all_heard)

    def _ask(self, now: float, all_heard: bool) -> Iterator[list[bytes]]:
        if self._active is None:
            return
        described, sink = self._active
        chunks = sink.chunks
        if all_heard and (late := chunks.expire(now - self._pace.patience)):
            self._pace.lost(late)
        if now >= self._note_due:
            self._note_due = now + NOTED
            sink.note()
        room = int(self._pace.credit) - chunks.under_way
        if (room >= BATCH or not chunks.under_way) and (ranges := chunks.ask(room, MOST_RANGES, now)):
            yield [self._lane.seal(said(Want(described.tag, tuple(ranges))))]
        if described.kind is Bulk.BAG:
            self.errands.progress(described.name, chunks.bytes_here, described.size)

    def _close(self) -> None:
        """A blackout: what was asked for will not come; a newer picture will be there at its end."""
        self._open = False
        self._pace.closed()
        self._things.clear()
        self._news_due = self._now
        if self._active is not None:
            described, sink = self._active
            sink.chunks.expire(float("inf"))
            sink.note()
            if described.kind is not Bulk.BAG:
                self._active = None

    def close(self) -> None:
        """Keep what has come."""
        self._worker.close()
        self._checked()
        self._leave()
