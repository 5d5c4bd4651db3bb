"""What marks a message's array fields; without NumPy, which only those need who have some."""

from __future__ import annotations

from enum import Enum


class ArrayKind(Enum):
    """What the elements of an array field are, by NumPy's name of them; marks the field's annotation."""

    FLOAT64 = "float64"
    UINT8 = "uint8"
