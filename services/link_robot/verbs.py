"""Does verbs of valorctl that the operator's side sends: each in a process of its own, as if it were called here."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from typing import IO

from valor.common.processes import SUPERVISED
from valor.link.classes import Kind
from valor.link.end import End
from valor.link.errors import SealError
from valor.link.verbs import pack_said, read_verb
from valor.ros.relayed import Word, worded

MODULE = "valor.valorctl.hosts.relayed"
MOST = 4  # at once
LONGEST = 150.0  # of one [s]
_log = logging.getLogger("link_robot")


@dataclass
class _Running:
    number: int
    session: int
    process: subprocess.Popen[bytes]
    said: IO[bytes]
    until: float  # monotonic [s]


class Verbs:
    """From the loop's thread, which waits for none of them."""

    def __init__(self, end: End) -> None:
        self._end = end
        self._running: list[_Running] = []

    def begin(self, number: int, content: bytes) -> None:
        """Begin one; the id of the command that brought it, what it is.

        Raises:
            SealError: it is none, or too many run.
        """
        words = read_verb(content)
        if len(self._running) >= MOST:
            raise SealError(f"{MOST} verbs run here already")
        _log.info("for the operator's side: valorctl %s", " ".join(words))
        # Without the mark of what supervisord starts, or `down` would take it for a part of the instance.
        environment = {name: value for name, value in os.environ.items() if name != SUPERVISED}
        said = tempfile.TemporaryFile()  # noqa: SIM115 (closed once it has ended)
        process = subprocess.Popen(
            [sys.executable, "-m", MODULE, *words],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=said,
            start_new_session=True,  # it outlives this process, which it may be about
        )
        session = self._end.session.number
        self._running.append(_Running(number, session, process, said, time.monotonic() + LONGEST))

    def turn(self, now: float) -> None:
        """Say what those said that have ended; ``now``: monotonic [s]."""
        for each in list(self._running):
            status = each.process.poll()
            if status is None and now < each.until:
                continue
            self._running.remove(each)
            if status is None:
                each.process.kill()
                each.process.wait()
            each.said.seek(0)
            text = each.said.read().decode(errors="replace") if status is not None else f"not over in {LONGEST:g} s"
            each.said.close()
            if each.session == self._end.session.number:
                content = worded(Word.SAID, each.number, pack_said(1 if status is None else status, text))
                try:
                    self._end.send(Kind.REPORT, content, now)
                except SealError as error:
                    _log.warning("nobody hears what a verb said: %s", error)
