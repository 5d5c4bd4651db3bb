"""What the robot's end has for the operator: the newest picture, the list of bags, and the bags that are finished."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import msgspec

from valor.bags import recordings
from valor.common.fetching import Bag
from valor.link.bulk.things import Held, Opened, Thing
from valor.link.bulk.wire import checked_name
from valor.link.classes import Bulk
from valor.link.errors import BulkError, SealError

LOOKS = 2.0  # between two at the folder of bags [s]
LISTED = 1000  # pieces: the newest
REMEMBERED = 256  # digests
Identity = tuple[str, int, int, int]


class RobotShelf:
    """Used from the loop's thread; digests of files are made in another."""

    def __init__(self, bags: Path, picture: Callable[[], Held | None]) -> None:
        """``bags``: folder of recordings; ``picture``: the newest, None: there is none."""
        self._bags, self._picture = bags, picture
        self._paths: dict[str, Path] = {}
        self._listing: Held | None = None
        self._listed = b""
        self._due = 0.0
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="digests")
        self._digests: dict[Identity, Future[bytes]] = {}

    def newest(self) -> tuple[Thing, ...]:
        """As of ``Shelf``."""
        self._look(time.monotonic())
        return tuple(each for each in (self._picture(), self._listing) if each is not None)

    def _look(self, now: float) -> None:
        if now < self._due:
            return
        self._due = now + LOOKS
        found: list[Bag] = []
        paths: dict[str, Path] = {}
        for recording in reversed(recordings.look(self._bags)):
            for path in recording.finished():
                if len(found) < LISTED and path.name not in paths and _nameable(path.name):
                    paths[path.name] = path
                    size = next(size for each, size, _ in recording.files if each == path)
                    found.append(Bag(path.name, size, recording.begun, recording.kept, recording.label))
        self._paths = paths
        listed = msgspec.json.encode(found)
        if listed != self._listed or self._listing is None:
            self._listed, self._listing = listed, Held(Bulk.LISTING, "bags", listed)

    def find(self, name: str) -> Thing | None:
        """As of ``Shelf``."""
        self._look(time.monotonic())
        path = self._paths.get(name)
        if path is None:
            raise BulkError(f"{name}: the robot has no finished bag of that name")
        opened = Opened(path)
        known = self._digests.get(opened.identity)
        if known is None:
            while len(self._digests) >= REMEMBERED:
                del self._digests[next(iter(self._digests))]
            self._digests[opened.identity] = self._pool.submit(_digest, path)
        if known is None or not known.done():
            opened.close()
            return None
        try:
            opened.describe(known.result())
        except (BulkError, OSError) as error:
            del self._digests[opened.identity]
            opened.close()
            raise BulkError(f"{name}: {error}") from None
        return opened

    def close(self) -> None:
        """Wait for the digest that is being made."""
        self._pool.shutdown(cancel_futures=True)


def _digest(path: Path) -> bytes:
    opened = Opened(path)
    try:
        return opened.digest()
    finally:
        opened.close()


def _nameable(name: str) -> bool:
    try:
        checked_name(name)
    except SealError:
        return False
    return True
