"""Ctrl-C and SIGTERM while something must be put in order first.

An exception raised between any two instructions could leave a process that nobody knows of. So signals set a flag,
every wait looks at it, and what follows an ``InterruptedBySignalError`` runs undisturbed.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType, TracebackType
from typing import Self

from valor.common.errors import ValorError

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class InterruptedBySignalError(ValorError):
    """Somebody asked us to stop. Its exit status is the shell's for the signal."""

    def __init__(self, signum: int) -> None:
        super().__init__(f"interrupted by {signal.Signals(signum).name}")
        self.exit_status = 128 + signum


class Interruption:
    """A context in which signals are noted rather than obeyed at once."""

    def __init__(self) -> None:
        self._signum = 0
        self._before: dict[int, signal._HANDLER] = {}

    def __enter__(self) -> Self:
        for signum in _SIGNALS:
            if signal.getsignal(signum) is not signal.SIG_IGN:  # as under nohup
                self._before[signum] = signal.signal(signum, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for signum, handler in self._before.items():
            signal.signal(signum, handler)

    def _note(self, signum: int, _frame: FrameType | None) -> None:
        self._signum = self._signum or signum

    def check(self) -> None:
        """Raise ``InterruptedBySignalError`` if a signal has come."""
        if self._signum:
            raise InterruptedBySignalError(self._signum)


@contextlib.contextmanager
def until_interrupted() -> Iterator[None]:
    """Ctrl-C is how a person ends what is inside: then it is over, and that is no failure."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGINT, before)
