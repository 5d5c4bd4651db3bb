"""The logs of an instance's processes: their last lines, and what comes."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Iterator
from typing import Self, TextIO

from valor.common.errors import ValorError, require_one_of
from valor.common.instance import Instance
from valor.common.processes import BY_NAME

_POLL_PERIOD = 0.1  # [s]


class LogReader:
    """Reads one log, or all with their names before each line. A context manager."""

    def __init__(self, instance: Instance, name: str | None) -> None:
        """Open the logs.

        Raises:
            ValorError: unknown process, or no log of it; lists the known.
        """
        known = [*BY_NAME, "supervisord"]
        if name is not None:
            require_one_of("service", name, known)
        names = [name] if name else list(BY_NAME)
        paths = {each: instance.logs / f"{each}.log" for each in names}
        self._paths = {each: path for each, path in paths.items() if path.exists()}
        if not self._paths:
            of = f"of {name} " if name else ""
            raise ValorError(f"instance {instance.name!r}: no log {of}in {instance.logs}")
        width = max(map(len, names))
        self._prefix = {each: "" if name else f"{each:{width}} | " for each in names}
        self._files: dict[str, TextIO] = {}
        self._partial: dict[str, str] = {}
        for each in self._paths:
            self._open(each)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for file in self._files.values():
            file.close()

    def _open(self, name: str) -> None:
        self._files[name] = open(self._paths[name], errors="replace")  # noqa: SIM115
        self._partial[name] = ""

    def last(self, count: int) -> list[str]:
        """The last ``count`` lines of each log."""
        lines = []
        for name, file in self._files.items():
            lines += [self._prefix[name] + line.rstrip("\n") for line in deque(file, maxlen=count)]
        return lines

    def wait(self) -> Iterator[str]:
        """Lines that have come since; waits a moment if there are none. Follows a log that was begun anew."""
        any_line = False
        for name in self._paths:
            for line in self._new(name):
                any_line = True
                yield self._prefix[name] + line
        if not any_line:
            time.sleep(_POLL_PERIOD)

    def _new(self, name: str) -> Iterator[str]:
        text = self._partial[name] + self._files[name].read()
        *lines, self._partial[name] = text.split("\n")
        yield from lines
        if not lines and self._begun_anew(name):
            self._files[name].close()
            self._open(name)

    def _begun_anew(self, name: str) -> bool:
        try:
            there = os.stat(self._paths[name])
        except FileNotFoundError:
            return False
        ours = os.fstat(self._files[name].fileno())
        return there.st_ino != ours.st_ino or there.st_size < self._files[name].tell()
