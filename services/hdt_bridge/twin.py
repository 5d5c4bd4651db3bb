"""Bifrost messages and their ROS twins as bytes, one made of the other."""

from __future__ import annotations

import array
from typing import Any, Generic, TypeVar

import numpy as np

from bifrost import Message, Received
from valor.ros.fixed_layout import Layout, Stream

M = TypeVar("M", bound=Message)


class Twin(Generic[M]):
    """Converts between one Bifrost type and its twin."""

    def __init__(self, message_type: type[M], twin_type: type[Any]) -> None:
        self._type = message_type
        self._names = message_type.__struct_fields__
        self._twin_type = twin_type
        self._arrays = {
            name for name, kind in twin_type.get_fields_and_field_types().items() if kind.startswith("sequence<")
        }
        self._from = Stream(twin_type)
        self._to: tuple[tuple[str | int, ...], Layout] | None = None  # of the last, by its origin and sizes

    def to_ros(self, received: Received[M], stamp: int) -> bytes:
        """The twin, with the message's origin and sequence, stamped [ns]."""
        message = received.message
        key = (received.origin, *(getattr(message, name).size for name in self._names if name in self._arrays))
        if self._to is None or self._to[0] != key:
            self._to = key, Layout(self._pattern(received))
        layout = self._to[1]
        layout.stamp(stamp)
        layout.numbers["bifrost_sequence"][0] = received.sequence
        for name in self._names:
            layout.numbers[name][:] = getattr(message, name)
        return bytes(layout.bytes)

    def from_ros(self, twin: bytes) -> M:
        """The Bifrost message.

        Raises:
            Exception: rclpy's, of bytes that are no such twin.
        """
        numbers = self._from.received(twin)
        return self._type(
            **{name: numbers[name].copy() if name in self._arrays else numbers[name].item() for name in self._names}
        )

    def _pattern(self, received: Received[M]) -> Any:
        """A twin that is laid out as the message's."""
        twin = self._twin_type()
        twin.header.frame_id = received.origin
        for name in self._arrays:
            value = getattr(received.message, name)
            setattr(twin, name, array.array("B" if value.dtype == np.uint8 else "d", value.tobytes()))
        return twin
