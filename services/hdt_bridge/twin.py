"""Bifrost messages and their ROS twins, one made of the other."""

from __future__ import annotations

import array
from typing import Any, Generic, TypeVar

import numpy as np

from bifrost import Message, Received

M = TypeVar("M", bound=Message)


class Twin(Generic[M]):
    """Converts between one Bifrost type and its twin. The ROS message is made once and filled anew."""

    def __init__(self, message_type: type[M], twin_type: type[Any]) -> None:
        self._type = message_type
        self._names = message_type.__struct_fields__
        self._twin = twin_type()

    def to_ros(self, received: Received[M], stamp: Any) -> Any:
        """The twin, with the message's origin and sequence, stamped."""
        twin = self._twin
        twin.header.stamp = stamp
        twin.header.frame_id = received.origin
        twin.bifrost_sequence = received.sequence
        for name in self._names:
            value = getattr(received.message, name)
            if isinstance(value, np.ndarray):
                value = array.array("B" if value.dtype == np.uint8 else "d", value.tobytes())
            setattr(twin, name, value)
        return twin

    def from_ros(self, twin: Any) -> M:
        """The Bifrost message."""
        values = {}
        for name in self._names:
            value = getattr(twin, name)
            if isinstance(value, array.array):
                value = np.array(value, dtype=np.uint8 if value.typecode == "B" else np.float64)
            elif isinstance(value, np.ndarray):  # of bytes
                value = value.copy()
            values[name] = value
        return self._type(**values)
