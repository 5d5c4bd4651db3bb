"""What a person reads: lines on a pipe, one live line on a terminal; errors on stderr."""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def say(text: str) -> None:
    """A line on stdout, at once."""
    print(text, flush=True)


def complain(text: str) -> None:
    """A line on stderr; of several faults, one each."""
    for line in text.splitlines():
        print(f"valorctl: {line}", file=sys.stderr, flush=True)


def say_json(content: Any, one_line: bool = False) -> None:
    """An object on stdout."""
    say(json.dumps(content, indent=None if one_line else 2))


def rich_console(wrap: bool = False) -> Console:
    """For tables and colours: as wide as it takes where no terminal sets a width; there it wraps only if told to."""
    from rich.console import Console

    return Console(highlight=False, soft_wrap=not wrap, width=None if sys.stdout.isatty() else 200)


def table(*columns: str, numbers: Collection[str] = (), **style: Any) -> Table:
    """A table without lines, to fill and to print; columns of numbers end at their right."""
    from rich.table import Table

    made = Table(box=None, pad_edge=False, header_style="dim", **style)
    for column in columns:
        made.add_column(column, justify="right" if column in numbers else "left")
    return made


def say_rows(rows: Iterable[tuple[str, str]]) -> None:
    """What, and how much: two columns."""
    shown = table("", "", show_header=False)
    for row in rows:
        shown.add_row(*row)
    rich_console().print(shown)


class Progress:
    """Tells how a longer work goes on: on a terminal what is waited for now stands in one line that changes."""

    def __init__(self) -> None:
        self._live = sys.stdout.isatty()
        self._last = ""

    def waiting(self, text: str) -> None:
        """What is waited for now; shown on terminals only."""
        if self._live and text != self._last:
            self._last = text
            width = shutil.get_terminal_size().columns - 1  # a line that wraps could not be taken back
            line = f"… {text}"
            print(f"\r\033[K{line if len(line) <= width else line[: width - 1] + '…'}", end="", flush=True)

    def stage(self, text: str) -> None:
        """A stage of a longer work begins: shown as what is waited for, and where that cannot be shown as a line."""
        if self._live:
            self.waiting(text)
        elif text != self._last:
            self._last = text
            say(text)

    def done(self, text: str) -> None:
        """A step is done."""
        self.clear()
        say(text)

    def clear(self) -> None:
        """Take the changing line away."""
        if self._live and self._last:
            print("\r\033[K", end="", flush=True)
        self._last = ""


@contextlib.contextmanager
def progress() -> Iterator[Progress]:
    """A ``Progress`` that tidies up behind itself."""
    shown = Progress()
    try:
        yield shown
    finally:
        shown.clear()


@contextlib.contextmanager
def bar(what: str, total: float, unit: str, digits: int = 1) -> Iterator[Callable[[float], None]]:
    """A bar that fills up on a terminal, with the time that is left; elsewhere a line at every tenth.

    Gives what to call with how much is done.
    """
    if not sys.stdout.isatty():
        tenth = 0

        def line(done: float) -> None:
            nonlocal tenth
            if tenth < int(10.0 * done / total) <= 10:
                tenth = int(10.0 * done / total)
                say(f"{what}: {done:.{digits}f} of {total:.{digits}f} {unit}")

        yield line
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn(f"{{task.completed:.{digits}f}} of {{task.total:.{digits}f}} {unit}"),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=rich_console(wrap=True), transient=True) as shown:
        task = shown.add_task(what, total=total)
        yield lambda done: shown.update(task, completed=max(0.0, min(done, total)))
