"""Beside the recording, in a thread of its own: telling rosbag2 of bags that are finished, keeping all within bounds.

The recorder never waits for it: a disk that takes its time over removing 4 GB holds up nothing but this thread.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Iterable
from pathlib import Path

from valor.bags import recordings, rosbag2_metadata
from valor.bags.files import is_own_folder
from valor.common.bounds import Bounds

PERIOD = 10.0  # between two looks at what there is; a finished bag is a reason to look at once [s]
PATIENCE = 5.0  # with it, when the recorder ends [s]

_log = logging.getLogger("bag_recorder")


class Housekeeper:
    """Keeps an instance's folder of bags in order.

    Args:
        bags: that folder.
        bounds: of all that is in it.
        finished: bags that were finished just now.
    """

    def __init__(self, bags: Path, bounds: Bounds, finished: Iterable[Path] = ()) -> None:
        self._bags, self._bounds = bags, bounds
        # Ages are told by a clock that nobody sets: one that jumped by a month would be the end of every recording.
        self._offset = time.time() - time.monotonic()
        self._floor = sum(recording.size for recording in recordings.look(bags))
        self._finished: queue.Queue[Path | None] = queue.Queue()
        for bag in finished:
            self._finished.put(bag)
        self._told = ""
        self._thread = threading.Thread(target=self._run, name="housekeeper", daemon=True)
        self._thread.start()

    def finished(self, bag: Path) -> None:
        """A bag is complete: rosbag2 shall know, and there may be too many now."""
        self._finished.put(bag)

    def close(self) -> None:
        """Let it do what is left to do."""
        self._finished.put(None)
        self._thread.join(PATIENCE)

    def _run(self) -> None:
        self._prune()
        while True:
            try:
                bag = self._finished.get(timeout=PERIOD)
            except queue.Empty:
                self._prune()
                continue
            if bag is None:
                return
            self._describe(bag)
            self._prune()

    def _describe(self, bag: Path) -> None:
        if not is_own_folder(bag):
            return
        try:
            if bag.parent.parent == self._bags:
                with recordings.changing(self._bags):
                    rosbag2_metadata.write(bag.parent)
            else:
                rosbag2_metadata.write(bag.parent)
        except OSError as error:
            self._tell(f"{error.filename or bag}: {error.strerror}: left without a new {rosbag2_metadata.FILE}")

    def _prune(self) -> None:
        try:
            gone = recordings.prune(self._bags, self._bounds, floor=self._floor, now=time.monotonic() + self._offset)
        except OSError as error:
            self._tell(f"{error.filename or self._bags}: {error.strerror}: recordings are not kept within bounds")
            return
        for each in gone:
            _log.info("%s: removed, %.1f MB: %s", each.piece.path, each.piece.size / 1e6, each.why)

    def _tell(self, what: str) -> None:
        """Once, however often it is tried."""
        if what != self._told:
            self._told = what
            _log.warning("%s", what)
