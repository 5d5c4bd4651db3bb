"""Which chunks of a thing have come, which were asked for, and which are to be asked for next."""

from __future__ import annotations

import msgspec

from valor.link.bulk.wire import CHUNK

MISSING, ASKED, HERE = 0, 1, 2


class Chunks:
    """Of one thing.

    Attributes:
        count: of all.
        here: how many have come.
    """

    def __init__(self, size: int) -> None:
        """``size``: of the thing [B]."""
        self._size = size
        self.count = -(-size // CHUNK)
        self.here = 0
        self._state = bytearray(self.count)
        self._cursor = 0  # nothing is missing before it
        self._asked: dict[int, float] = {}  # when, the oldest first

    @property
    def whole(self) -> bool:
        """Whether all have come."""
        return self.here == self.count

    @property
    def under_way(self) -> int:
        """How many were asked for and have not come."""
        return len(self._asked)

    @property
    def bytes_here(self) -> int:
        """How much has come [B]."""
        last = self.count and self._state[-1] == HERE
        return self.here * CHUNK - (self.count * CHUNK - self._size if last else 0)

    def length(self, place: int) -> int:
        """Of a chunk [B]; −1: there is none."""
        return min(CHUNK, self._size - place * CHUNK) if 0 <= place < self.count else -1

    def ask(self, most: int, most_ranges: int, now: float) -> list[tuple[int, int]]:
        """Chunks to ask for now, as from and how many: those missing, in order; none: all are here, or under way."""
        ranges: list[tuple[int, int]] = []
        while most > 0:
            first = self._state.find(MISSING, self._cursor)
            if first < 0:
                self._cursor = self.count
                break
            if len(ranges) == most_ranges:
                break
            end = first
            limit = min(first + most, self.count)
            while end < limit and self._state[end] == MISSING:
                self._state[end] = ASKED
                self._asked[end] = now
                end += 1
            ranges.append((first, end - first))
            most -= end - first
            self._cursor = end
        return ranges

    def arrived(self, place: int) -> float | None:
        """One has come.

        Returns:
            When it was asked for; None: it is of no use: here already, or there is none such.
        """
        if not 0 <= place < self.count or self._state[place] == HERE:
            return None
        self._state[place] = HERE
        self.here += 1
        return self._asked.pop(place, 0.0)

    def expire(self, before: float) -> int:
        """Chunks asked for earlier than that are missing again; returns how many."""
        late = []
        for place, when in self._asked.items():
            if when >= before:
                break
            late.append(place)
        for place in late:
            del self._asked[place]
            self._state[place] = MISSING
        if late:
            self._cursor = min(self._cursor, *late)
        return len(late)

    def kept(self) -> bytes:
        """What has come, to be read by ``restore`` after a restart."""
        bits = self._state.translate(bytes((0, 0, 1)) + bytes(253))
        edges, at, value = [], 0, 0
        while (at := bits.find(1 - value, at)) >= 0:
            edges.append(at)
            value = 1 - value
        return msgspec.msgpack.encode(edges)

    def restore(self, kept: bytes) -> None:
        """Have again what had come; bytes that ``kept`` has not made are as none."""
        try:
            edges = msgspec.msgpack.decode(kept, type=list[int])
        except msgspec.DecodeError:
            return
        if edges != sorted(edges) or any(not 0 <= edge < self.count for edge in edges):
            return
        for first, end in zip(edges[::2], [*edges[1::2], self.count], strict=False):
            self._state[first:end] = bytes((HERE,)) * (end - first)
        self.here = self._state.count(HERE)
