"""A bag as tables: one CSV file a topic, one row a message (thesis, 4.3.2).

The first column is ``log_time_ns``, when the recorder had the message. What cannot be written is told, and the rest is
written all the same.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from valor.analysis import parquet
from valor.analysis.flat import Flattener, Shape
from valor.analysis.ros_types import Types
from valor.bags.errors import BagError
from valor.bags.selection import Selection
from valor.bags.stored import Condition, StoredBag, StoredTopic
from valor.common import whole_file

TIME = "log_time_ns"
MOST_NOTICES = 100
OPEN_FILES = 200  # topics written at the same time, at most
_OURS = "valor_msgs/"  # types whose arrays are in the order of the robot's joints


@dataclass(frozen=True)
class Export:
    """What became of it.

    Attributes:
        files: written, and how many messages each holds.
        notices: topics and messages left out, and why.
        condition: of the bag; with damage what could be saved is written.
    """

    files: dict[Path, int]
    notices: list[str]
    condition: Condition


def export(
    path: Path,
    out: Path,
    topics: Sequence[str] = (),
    tell: Callable[[int], None] = lambda messages: None,
    *,
    as_parquet: bool = False,
) -> Export:
    """Write a bag's topics as CSV, or as Parquet.

    Args:
        path: an MCAP or SQLite file, or a folder of them.
        out: a folder that is made, or is empty.
        topics: shell patterns; none: all.
        tell: told now and then how many messages have been read.
        as_parquet: turn each finished CSV into Parquet.

    Raises:
        BagError: there is no bag, nothing can be written where it shall, or Parquet needs what is not installed.
    """
    if as_parquet:
        parquet.require()
    bag = StoredBag(path)
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise BagError(f"{out}: expected an empty folder, or a name for a new one")
        return _export(bag, out, Selection(tuple(topics)), tell, as_parquet)
    except OSError as error:
        raise BagError(f"{error.filename or out}: {error.strerror}") from None


def _export(bag: StoredBag, out: Path, selection: Selection, tell: Callable[[int], None], as_parquet: bool) -> Export:
    types, notices = Types(), _Notices()
    tables: dict[StoredTopic, _Table | None] = {}
    names: set[str] = set()
    try:
        for count, (topic, stamp, data, _) in enumerate(bag.messages()):
            if count % 1000 == 0:
                tell(count)
            if topic not in tables:
                tables[topic] = None
                if topic.name not in selection:
                    continue
                try:
                    joints = bag.condition.origin.get("joints", "").split() if topic.type.startswith(_OURS) else ()
                    flattener = Flattener(types.store(topic), topic.type, joints)
                    if len(names) == OPEN_FILES:
                        raise BagError(f"{topic.name}: more than {OPEN_FILES} topics; choose some")
                    tables[topic] = _Table(out / _file_name(topic.name, names), flattener)
                except BagError as error:
                    notices.add(str(error))
            table = tables[topic]
            if table is None:
                continue
            try:
                table.add(stamp, types.decode(topic, data))
            except BagError as error:
                notices.add(str(error))
    finally:
        made = [table for table in tables.values() if table is not None]
        for table in made:
            table.close()
    for table in made:
        notices.lines += [
            f"{table.path.name}: {name}: too long to write out; its length is there" for name in table.omitted
        ]
    if as_parquet:
        for table in made:
            try:
                table.convert()
            except BagError as error:
                notices.lines.append(str(error))
    return Export({table.path: table.rows for table in made if table.rows}, notices.all(), bag.condition)


def _file_name(topic: str, taken: set[str]) -> str:
    stem = topic.strip("/").replace("/", ".") or "topic"
    name, number = stem, 1
    while name in taken:  # one name with two types
        number += 1
        name = f"{stem}_{number}"
    taken.add(name)
    return f"{name}.csv"


@dataclass
class _Notices:
    """Lines, each once, with how often it would have been told."""

    lines: list[str] = field(default_factory=list)
    _counts: dict[str, int] = field(default_factory=dict)

    def add(self, text: str) -> None:
        if text not in self._counts and len(self._counts) >= MOST_NOTICES:
            text = "and more"
        self._counts[text] = self._counts.get(text, 0) + 1

    def all(self) -> list[str]:
        counted = [f"{text} ({count} messages)" if count > 1 else text for text, count in self._counts.items()]
        return [f"left out: {text}" for text in counted] + self.lines


class _Table:
    """One CSV file. New columns are put at the right; rows that came before have nothing there.

    Attributes:
        rows: written.
        omitted: arrays of which only the length is written.
    """

    def __init__(self, path: Path, flattener: Flattener) -> None:
        self.path = path
        self.rows = 0
        self.omitted: list[str] = []
        self._flattener = flattener
        self._file: TextIOWrapper | None = None
        self._columns: dict[str, int] = {TIME: 0}
        self._types: dict[str, type] = {TIME: int}
        self._header = 0  # columns that the file's first line has
        self._places: dict[Shape, list[int] | None] = {}  # of a shape's values; None: just behind each other

    def add(self, stamp: int, message: Any) -> None:
        shape, values = self._flattener.row(message)
        if shape not in self._places:
            self._places[shape] = self._place(message, values)
        places = self._places[shape]
        row: list[Any]
        if places is None:
            row = [stamp, *values]
        else:
            row = [""] * len(self._columns)
            row[0] = stamp
            for place, value in zip(places, values, strict=True):
                row[place] = value
        if self._file is None:
            self._file = open(  # noqa: SIM115  # closed by ``close``
                self.path, "x", newline="", encoding="utf-8", errors="backslashreplace"
            )
            self._writer = csv.writer(self._file)
            self._writer.writerow(self._columns)
            self._header = len(self._columns)
        self._writer.writerow(row)
        self.rows += 1

    def _place(self, message: Any, values: Sequence[Any]) -> list[int] | None:
        columns = self._flattener.columns(message)
        for name, value in zip(columns, values, strict=True):
            self._columns.setdefault(name, len(self._columns))
            self._types.setdefault(name, _kind(value))
        for name in self._flattener.omitted(message):
            if name not in self.omitted:
                self.omitted.append(name)
        places = [self._columns[name] for name in columns]
        return None if places == list(range(1, len(self._columns))) else places

    def close(self) -> None:
        """Close the file; where columns have come later it is written anew, every row as wide as the widest."""
        if self._file is None:
            return
        self._file.close()
        if len(self._columns) == self._header:
            return
        with (
            whole_file.replacing(self.path) as beside,
            open(self.path, newline="", encoding="utf-8") as old,
            open(beside, "x", newline="", encoding="utf-8") as new,
        ):
            rows, writer = csv.reader(old), csv.writer(new)
            next(rows)
            writer.writerow(self._columns)
            width = len(self._columns)
            writer.writerows(row + [""] * (width - len(row)) for row in rows)

    def convert(self) -> None:
        """Put a Parquet file in the closed CSV's place.

        Raises:
            BagError: it cannot be; the CSV stays.
        """
        if self.rows:
            self.path = parquet.convert(self.path, self._types)


def _kind(value: Any) -> type:
    """What a column holds, by one of its values."""
    return next((kind for kind in (bool, int, float) if isinstance(value, kind)), str)
