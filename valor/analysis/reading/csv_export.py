"""A bag as tables: one CSV file per topic, one row per message (thesis, 4.3.2).

The first column is ``log_time_ns``, the time of reception by the recorder. Elements of an array are named by the joints
if the message or its parent lists as many (``position.l_elbow``), else by number (``covariance.0``).
"""

import csv
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from valor.analysis.reading.ros_types import Types
from valor.bags.errors import BagError
from valor.bags.selection import Selection
from valor.bags.stored import Condition, StoredBag, StoredTopic
from valor.common import whole_file

TIME = "log_time_ns"
MOST_NOTICES = 100
NAMES = ("name", "names", "joint_names")  # fields with names of the other fields' elements
LONGEST = 1000  # maximum length of an array; of a longer one (a picture) only the length is written
_OURS = "valor_msgs/"  # types whose arrays are in the order of the robot's joints
_TEXT = (Nodetype.BASE, ("string", 0))


@dataclass(frozen=True)
class Export:
    """Result of a CSV export."""

    files: dict[Path, int]  # number of messages by file
    notices: list[str]  # topics and messages left out, with the reason
    condition: Condition  # of the bag; of a damaged bag the readable part is written


def export(
    path: Path, out: Path, topics: Sequence[str] = (), tell: Callable[[int], None] = lambda messages: None
) -> Export:
    """Write a bag's topics as CSV into an empty or new folder.

    ``path``: an MCAP file, or a folder of them; ``topics``: shell patterns, all if empty; ``tell``: called occasionally
    with the number of messages read. Raises BagError: there is no bag, or the folder is not writable or not empty.
    """
    bag = StoredBag(path)
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise BagError(f"{out}: expected an empty folder, or a name for a new one")
        return _export(bag, out, Selection(tuple(topics)), tell)
    except OSError as error:
        raise BagError(f"{error.filename or out}: {error.strerror}") from None


def _export(bag: StoredBag, out: Path, selection: Selection, tell: Callable[[int], None]) -> Export:
    types, left_out = Types(), Counter[str]()
    tables: dict[StoredTopic, _Table | None] = {}
    names: set[str] = set()
    try:
        for count, (topic, stamp, data, _) in enumerate(bag.messages()):
            if count % 1000 == 0:
                tell(count)
            try:
                if topic not in tables:
                    tables[topic] = None
                    if topic.name in selection:
                        joints = bag.condition.origin.get("joints", "").split() if topic.type.startswith(_OURS) else ()
                        store = types.store(topic)
                        tables[topic] = _Table(out / _file_name(topic.name, names), store, topic.type, joints)
                if (table := tables[topic]) is not None:
                    table.add(stamp, types.decode(topic, data))
            except BagError as error:
                left_out[str(error)] += 1
    finally:
        made = [table for table in tables.values() if table is not None]
        for table in made:
            table.close()
    notices = [
        f"left out: {text} ({count} messages)" if count > 1 else f"left out: {text}"
        for text, count in left_out.most_common(MOST_NOTICES)
    ]
    notices += [
        f"{table.path.name}: {name}: too long; its length is written" for table in made for name in table.omitted
    ]
    return Export({table.path: table.rows for table in made if table.rows}, notices, bag.condition)


def _file_name(topic: str, taken: set[str]) -> str:
    stem = topic.strip("/").replace("/", ".") or "topic"
    name, number = stem, 1
    while name in taken:  # one topic with two types
        number += 1
        name = f"{stem}_{number}"
    taken.add(name)
    return f"{name}.csv"


class _Table:
    """One CSV file. New columns are appended at the right; earlier rows are empty there.

    ``omitted``: arrays whose length is written instead.
    """

    def __init__(self, path: Path, store: Typestore, type_name: str, joints: Sequence[str]) -> None:
        self.path = path
        self.rows = 0
        self.omitted: dict[str, None] = {}
        self._fields = store.fielddefs
        self._type = type_name
        self._joints = tuple(joints)
        self._file: TextIOWrapper | None = None
        self._columns: dict[str, None] = {}
        self._header = 0  # columns of the first line

    def add(self, stamp: int, message: Any) -> None:
        row: dict[str, Any] = {TIME: stamp}
        self._flatten(row, message, self._type, "", ())
        self._columns |= dict.fromkeys(row)
        if self._file is None:
            self._file = open(  # noqa: SIM115  # closed by ``close``
                self.path, "x", newline="", encoding="utf-8", errors="backslashreplace"
            )
            self._writer = csv.writer(self._file)
            self._writer.writerow(self._columns)
            self._header = len(self._columns)
        self._writer.writerow([row.get(name, "") for name in self._columns])
        self.rows += 1

    def close(self) -> None:
        """Close the file; if columns were added, rewrite it with rows of equal width."""
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

    def _flatten(
        self, row: dict[str, Any], message: Any, type_name: str, prefix: str, outer_labels: tuple[str, ...]
    ) -> None:
        """Add a message's fields, nested fields and array elements to a row."""
        used, labels = self._labels(message, type_name)
        labels = labels or outer_labels
        for name, (kind, detail) in self._fields[type_name][1]:
            value, path = getattr(message, name), prefix + name
            if name == used:
                continue
            if kind == Nodetype.BASE:
                row[path] = value
            elif kind == Nodetype.NAME:
                self._flatten(row, value, detail, f"{path}.", labels)
            elif len(value) > LONGEST:
                row[f"{path}.length"] = len(value)
                self.omitted[path] = None
            else:
                keys = self._keys(len(value), () if name in NAMES else labels)
                elements = value.tolist() if hasattr(value, "tolist") else value
                for key, element in zip(keys, elements, strict=True):
                    if detail[0][0] == Nodetype.BASE:
                        row[f"{path}.{key}"] = element
                    else:
                        self._flatten(row, element, detail[0][1], f"{path}.{key}.", labels)

    def _labels(self, message: Any, type_name: str) -> tuple[str, tuple[str, ...]]:
        """The field of element names, empty if it is to be written itself, and the names."""
        arrays = {
            name: detail[0]
            for name, (kind, detail) in self._fields[type_name][1]
            if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        }
        for name in NAMES:
            if arrays.get(name) == _TEXT:
                labels = tuple(getattr(message, name))
                if not labels or len(set(labels)) < len(labels):
                    return "", ()
                fits = any(len(getattr(message, other)) == len(labels) for other in arrays if other != name)
                return (name if fits else ""), labels
        return "", ()

    def _keys(self, length: int, labels: tuple[str, ...]) -> Sequence[str]:
        for known in (labels, self._joints):
            if len(known) == length:
                return known
        return [str(i) for i in range(length)]
