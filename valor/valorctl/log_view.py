"""Lines of logs as a person sees them: each service in a colour of its own, what is grave in yellow or red."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import date

from rich.text import Text

from valor.valorctl.console import rich_console
from valor.valorctl.log_reader import SERVICES, Line

_HUES = ("cyan", "magenta", "blue", "bright_cyan", "bright_magenta", "bright_blue", "white", "bright_black")
_COLOURS = {name: _HUES[place % len(_HUES)] for place, name in enumerate(SERVICES)}
_GRAVE = {"warning": "yellow", "error": "red", "critical": "bold red"}
_WIDTH = max(map(len, SERVICES))


class LogView:
    """Prints lines; the name of the service before each, unless there is one only."""

    def __init__(self, named: bool) -> None:
        self._named = named
        self._console = rich_console()
        self._day = date.today()

    def show(self, lines: Iterable[Line]) -> None:
        """Print lines."""
        for line in lines:
            self._console.print(self._rendered(line))

    def _rendered(self, line: Line) -> Text:
        day = "" if line.when.date() == self._day else f"{line.when:%m-%d }"
        shown = f"{day}{line.when:%H:%M:%S}.{line.when.microsecond // 1000:03d} "
        text = Text(shown if line.begins else " " * len(shown), "dim")
        if self._named:
            text.append(f"{line.service:{_WIDTH}} ", _COLOURS[line.service])
        level = f"{line.level.upper()} " if line.begins and line.level != "info" else ""
        return text.append(level + line.text, _GRAVE.get(line.level, ""))
