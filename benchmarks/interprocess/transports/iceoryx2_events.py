"""iceoryx2: shared memory without a copy, and an event that wakes the receiver; bytes."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from typing import Any

import iceoryx2

from benchmarks.interprocess.payloads import SIZES
from benchmarks.interprocess.transports import STAMP, Place

iceoryx2.set_log_level_from_env_or(iceoryx2.LogLevel.Error)


def _services(place: Place, payload: str) -> tuple[Any, Any, Any]:
    node = iceoryx2.NodeBuilder.new().create(iceoryx2.ServiceType.Ipc)
    name = iceoryx2.ServiceName.new(f"benchmark/{place.folder.name}/{payload}")
    messages = node.service_builder(name).publish_subscribe(iceoryx2.Slice[ctypes.c_uint8])
    messages = messages.enable_safe_overflow(True).subscriber_max_buffer_size(100).open_or_create()
    return node, messages, node.service_builder(name).event().open_or_create()


class Sender:
    """A publisher and a notifier."""

    def __init__(self, place: Place, payload: str) -> None:
        self._size = SIZES[payload]
        self._node, self._messages, self._events = _services(place, payload)
        self._publisher = self._messages.publisher_builder().initial_max_slice_len(self._size).create()
        self._notifier = self._events.notifier_builder().create()
        self._filler = bytes(self._size - STAMP.size)

    def send(self) -> None:
        """See the package."""
        content = STAMP.pack(time.monotonic_ns()) + self._filler
        sample = self._publisher.loan_slice_uninit(self._size)
        ctypes.memmove(sample.payload_ptr, content, self._size)
        sample.assume_init().send()
        self._notifier.notify()

    def close(self) -> None:
        """Withdraw them."""
        self._publisher.delete()
        self._notifier.delete()


class Receiver:
    """A subscriber and a listener."""

    def __init__(self, place: Place, payload: str) -> None:
        self._node, self._messages, self._events = _services(place, payload)
        self._subscriber = self._messages.subscriber_builder().create()
        self._listener = self._events.listener_builder().create()

    def run(self, take: Callable[[int], None], stop: Callable[[], bool]) -> None:
        """See the package."""
        tenth = iceoryx2.Duration.from_millis(100)
        while not stop():
            self._listener.timed_wait(tenth)
            while (sample := self._subscriber.receive()) is not None:
                content = bytes(sample.payload().as_memory_view())
                take(STAMP.unpack_from(content)[0])
                sample.delete()

    def close(self) -> None:
        """Withdraw them."""
        self._subscriber.delete()
        self._listener.delete()
