"""Tables that benchmarks print: headings, each with how its cell is made of a row."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import TypeAlias, TypeVar

from rich.markup import escape
from rich.table import Table

R = TypeVar("R")
Columns: TypeAlias = tuple[tuple[str, Callable[[R], str]], ...]


def table(title: str, columns: Columns[R], rows: Iterable[R], left: Collection[str] = ()) -> Table:
    """A line a row; columns are aligned to the right, but those whose heading is in ``left``."""
    made = Table(title=escape(title))  # units in brackets are no markup
    for heading, _ in columns:
        made.add_column(escape(heading), justify="left" if heading in left else "right")
    for row in rows:
        made.add_row(*(cell(row) for _, cell in columns))
    return made
