"""Human-readable output: lines on a pipe, one updated line on a terminal; errors on stderr; Ctrl-C.

Verbs that must finish a change handle Ctrl-C and SIGTERM later: an exception between any two instructions could leave a
process without an owner. So signals set a flag, every wait checks the flag, and the cleanup after an
``InterruptedBySignalError`` runs undisturbed.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from types import FrameType
from typing import TYPE_CHECKING, Any, Self

from valor.common.errors import ValorError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def say(text: str) -> None:
    """Print a line on stdout, unbuffered."""
    print(text, flush=True)


def complain(text: str) -> None:
    """Print an error on stderr, each line with a prefix."""
    for line in text.splitlines():
        print(f"valorctl: {line}", file=sys.stderr, flush=True)


def say_json(content: Any, one_line: bool = False) -> None:
    """Print an object as JSON."""
    say(json.dumps(content, indent=None if one_line else 2))


def rich_console(wrap: bool = False) -> Console:
    """A console for tables and colours; ``wrap`` applies on terminals, other outputs are 200 characters wide."""
    from rich.console import Console

    return Console(highlight=False, soft_wrap=not wrap, width=None if sys.stdout.isatty() else 200)


def table(*columns: str, numbers: Collection[str] = (), **style: Any) -> Table:
    """An empty table without borders; columns of numbers are right-aligned."""
    from rich.table import Table

    made = Table(box=None, pad_edge=False, header_style="dim", **style)
    for column in columns:
        made.add_column(column, justify="right" if column in numbers else "left")
    return made


def say_rows(rows: Iterable[tuple[str, str]]) -> None:
    """Print rows of two columns."""
    shown = table("", "", show_header=False)
    for row in rows:
        shown.add_row(*row)
    rich_console().print(shown)


class Progress:
    """Progress of a longer operation; on a terminal, one line shows the current step."""

    def __init__(self) -> None:
        self._live = sys.stdout.isatty()
        self._last = ""

    def waiting(self, text: str) -> None:
        """Show the current step, only on terminals."""
        if self._live and text != self._last:
            self._last = text
            width = shutil.get_terminal_size().columns - 1  # a wrapped line could not be erased
            line = f"… {text}"
            print(f"\r\033[K{line if len(line) <= width else line[: width - 1] + '…'}", end="", flush=True)

    def stage(self, text: str) -> None:
        """Show the start of a stage: on terminals as the current step, elsewhere as a line."""
        if self._live:
            self.waiting(text)
        elif text != self._last:
            self._last = text
            say(text)

    def done(self, text: str) -> None:
        """Print a finished step as a line."""
        self.clear()
        say(text)

    def clear(self) -> None:
        """Erase the current step."""
        if self._live and self._last:
            print("\r\033[K", end="", flush=True)
        self._last = ""


@contextlib.contextmanager
def progress() -> Iterator[Progress]:
    """A context with a ``Progress`` that is cleared at the end."""
    shown = Progress()
    try:
        yield shown
    finally:
        shown.clear()


@contextlib.contextmanager
def bar(what: str, total: float, unit: str, digits: int = 1) -> Iterator[Callable[[float], None]]:
    """A context with the function that shows the amount done: always on a terminal, at every tenth elsewhere."""
    tenth = 0
    with progress() as shown:

        def line(done: float) -> None:
            nonlocal tenth
            text = f"{what}: {done:.{digits}f} of {total:.{digits}f} {unit}"
            if sys.stdout.isatty():
                shown.waiting(text)
            elif tenth < int(10.0 * done / total) <= 10:
                tenth = int(10.0 * done / total)
                say(text)

        yield line


def size_text(size: float) -> str:
    """A size [B] such as ``123.4 MB`` or ``1.2 GB``."""
    unit = "MB" if size < 1e9 else "GB"
    return f"{size / (1e6 if unit == 'MB' else 1e9):.1f} {unit}"


def time_text(seconds: float) -> str:
    """A duration such as ``12 s``, ``3.5 min``, ``2.0 h`` or ``30.0 d``."""
    for limit, factor, unit in ((120.0, 1.0, "s"), (7200.0, 60.0, "min"), (172800.0, 3600.0, "h")):
        if seconds < limit:
            return f"{seconds / factor:.{0 if unit == 's' else 1}f} {unit}"
    return f"{seconds / 86400.0:.1f} d"


class InterruptedBySignalError(ValorError):
    """The process received a signal; ``exit_status`` is the shell's for that signal."""

    def __init__(self, signum: int) -> None:
        super().__init__(f"interrupted by {signal.Signals(signum).name}")
        self.exit_status = 128 + signum


class Interruption:
    """A context in which signals set a flag."""

    def __init__(self) -> None:
        self._signum = 0
        self._before: dict[int, signal._HANDLER] = {}

    def __enter__(self) -> Self:
        for signum in _SIGNALS:
            if signal.getsignal(signum) is not signal.SIG_IGN:  # ignored under nohup
                self._before[signum] = signal.signal(signum, self._note)
        return self

    def __exit__(self, *exception: object) -> None:
        for signum, handler in self._before.items():
            signal.signal(signum, handler)

    def _note(self, signum: int, _frame: FrameType | None) -> None:
        self._signum = self._signum or signum

    def check(self) -> None:
        """Raise ``InterruptedBySignalError`` if a signal was received."""
        if self._signum:
            raise InterruptedBySignalError(self._signum)


@contextlib.contextmanager
def until_interrupted() -> Iterator[None]:
    """A context that Ctrl-C ends without an error."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGINT, before)
