"""The behavior of the newest Motor, kept for the next Motion Manager: safety outlives the process that keeps it."""

from __future__ import annotations

import contextlib
import json
import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from valor.common import whole_file

_log = logging.getLogger("comms_manager")


class BehaviorLatch:
    """Remembers what the robot was last told to be in, across restarts of this process, too, until the next ``up``.

    Attributes:
        behavior: of the newest Motor since the instance came up; empty: none yet.
    """

    def __init__(self, file: Path, epoch: int) -> None:
        """Take up what an earlier process of the same instance left in ``file``.

        Args:
            file: beside the instance's settings.
            epoch: when the instance came up; what was written under another one is of another robot's life.
        """
        self._file, self._epoch = file, epoch
        self._disk = ThreadPoolExecutor(1, "latch")  # a disk that stands still must not stop the robot's loop
        self.behavior = self._read()

    def update(self, behavior: str) -> None:
        """A Motor was admitted."""
        if behavior != self.behavior:
            self.behavior = behavior
            self._disk.submit(self._write, behavior)

    def close(self) -> None:
        """Wait until what changed last is written."""
        self._disk.shutdown()

    def _read(self) -> str:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            written = json.loads(self._file.read_text())
            if written["epoch"] == self._epoch:
                return str(written["behavior"])
        return ""

    def _write(self, behavior: str) -> None:
        try:
            whole_file.write(self._file, json.dumps({"epoch": self._epoch, "behavior": behavior}))
        except OSError as error:
            _log.warning("%s: %s; after a restart the behavior %s is not known", self._file, error.strerror, behavior)
