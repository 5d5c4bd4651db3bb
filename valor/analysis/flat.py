"""A message as one row: its fields, its fields' fields and its arrays' elements side by side.

Elements of an array are named by the joints where the message, or the one around it, names as many
(``position.l_elbow``), else by their number (``covariance.0``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

NAMES = ("name", "names", "joint_names")  # fields that name the elements of their neighbours
LONGEST = 1000  # array that is written out; of a longer one (a picture) the length alone
_TEXT = (Nodetype.BASE, ("string", 0))

Shape = tuple[Any, ...]


class Flattener:
    """Flattens messages of one type.

    Args:
        store: knows the type.
        type_name: of the messages.
        joints: names the elements of arrays of just that length, where nothing else names them.
    """

    def __init__(self, store: Typestore, type_name: str, joints: Sequence[str] = ()) -> None:
        self._fields = store.fielddefs
        self._type = type_name
        self._joints = tuple(joints)

    def row(self, message: Any) -> tuple[Shape, list[Any]]:
        """The values, and what their columns depend on: equal shapes have equal columns."""
        shape: list[Any] = []
        values: list[Any] = []
        self._values(message, self._type, shape, values)
        return tuple(shape), values

    def columns(self, message: Any) -> list[str]:
        """Names of the values of ``row``."""
        columns: list[str] = []
        self._columns(message, self._type, "", (), columns)
        return columns

    def omitted(self, message: Any) -> list[str]:
        """Arrays that are too long to be written out."""
        return [name.removesuffix(".length") for name in self.columns(message) if name.endswith(".length")]

    def _values(self, message: Any, type_name: str, shape: list[Any], values: list[Any]) -> None:
        used, labels = self._labels(message, type_name)
        if labels:
            shape.append(labels)
        for name, (kind, detail) in self._fields[type_name][1]:
            value = getattr(message, name)
            if name == used:
                continue
            if kind == Nodetype.BASE:
                values.append(value)
            elif kind == Nodetype.NAME:
                self._values(value, detail, shape, values)
            else:
                length = len(value)
                shape.append(length)
                if length > LONGEST:
                    values.append(length)
                elif detail[0][0] == Nodetype.BASE:
                    values.extend(value.tolist() if hasattr(value, "tolist") else value)
                else:
                    for each in value:
                        self._values(each, detail[0][1], shape, values)

    def _columns(self, message: Any, type_name: str, prefix: str, around: tuple[str, ...], columns: list[str]) -> None:
        used, labels = self._labels(message, type_name)
        labels = labels or around
        for name, (kind, detail) in self._fields[type_name][1]:
            value, path = getattr(message, name), prefix + name
            if name == used:
                continue
            if kind == Nodetype.BASE:
                columns.append(path)
            elif kind == Nodetype.NAME:
                self._columns(value, detail, f"{path}.", labels, columns)
            elif len(value) > LONGEST:
                columns.append(f"{path}.length")
            else:
                keys = [str(i) for i in range(len(value))] if name in NAMES else self._keys(len(value), labels)
                if detail[0][0] == Nodetype.BASE:
                    columns.extend(f"{path}.{key}" for key in keys)
                else:
                    for key, each in zip(keys, value, strict=True):
                        self._columns(each, detail[0][1], f"{path}.{key}.", labels, columns)

    def _labels(self, message: Any, type_name: str) -> tuple[str, tuple[str, ...]]:
        """The names that a message gives to elements; and the field that says nothing beside them, if there is one."""
        fields = self._fields[type_name][1]
        for name, (kind, detail) in fields:
            if name in NAMES and kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) and detail[0] == _TEXT:
                labels = tuple(getattr(message, name))
                if not labels or len(set(labels)) < len(labels):
                    return "", ()
                beside = (
                    len(getattr(message, other)) == len(labels)
                    for other, (kind, _) in fields
                    if other != name and kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
                )
                return (name if any(beside) else ""), labels
        return "", ()

    def _keys(self, length: int, labels: tuple[str, ...]) -> Sequence[str]:
        for known in (labels, self._joints):
            if len(known) == length:
                return known
        return [str(i) for i in range(length)]
