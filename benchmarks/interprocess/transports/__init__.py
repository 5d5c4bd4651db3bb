"""The transports that are compared, as a table.

Each is a module with two classes. ``Sender(place, payload)`` has ``send()``, which stamps a message of the payload's
size and sends it, and ``close()``. ``Receiver(place, payload)`` has ``run(take, stop)``, which gives ``take`` the stamp
of every message as soon as it can be read, until ``stop()``, asked about ten times a second, and ``close()``. A stamp
is CLOCK_MONOTONIC [ns], taken before anything is encoded. Whoever has no message types sends bytes, the stamp in the
first eight.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import Protocol, cast

STAMP = Struct("<q")


@dataclass(frozen=True)
class Transport:
    """A way from one process to another.

    Attributes:
        module: the adapter's, in this package.
        needs: the module that must be there; None: always is.
        over: what carries the bytes.
    """

    module: str
    needs: str | None
    over: str


TRANSPORTS: dict[str, Transport] = {
    "bifrost": Transport("bifrost_typed", None, "TCP, CURVE"),
    "bifrost queue": Transport("bifrost_queue", None, "TCP, CURVE"),
    "pyzmq curve": Transport("pyzmq_curve", None, "TCP, CURVE"),
    "pyzmq": Transport("pyzmq_bare", None, "TCP"),
    "rclpy": Transport("rclpy_fastdds", "rclpy", "UDP, Fast DDS"),
    "lcm": Transport("lcm_udp", "lcm", "UDP multicast"),
    "zenoh": Transport("zenoh_tcp", "zenoh", "TCP"),
    "ecal": Transport("ecal_default", "ecal", "shared memory"),
    "iceoryx2": Transport("iceoryx2_events", "iceoryx2", "shared memory"),
    "nothing": Transport("nothing", None, "-"),
}


class Sender(Protocol):
    """See the package."""

    def send(self) -> None: ...

    def close(self) -> None: ...


class Receiver(Protocol):
    """See the package."""

    def run(self, take: Callable[[int], None], stop: Callable[[], bool]) -> None: ...

    def close(self) -> None: ...


class _Adapter(Protocol):
    Sender: Callable[[Place, str], Sender]
    Receiver: Callable[[Place, str], Receiver]


@dataclass(frozen=True)
class Place:
    """Where the two ends of a transport meet: a folder of their own, in which they can leave each other a word."""

    folder: Path

    def leave(self, name: str, text: str) -> None:
        """Leave a word."""
        temporary = self.folder / f".{name}"
        temporary.write_text(text)
        temporary.replace(self.folder / name)

    def find(self, name: str, timeout: float = 20.0) -> str:
        """Wait for a word that the other end leaves."""
        deadline = time.monotonic() + timeout
        while not (self.folder / name).exists():
            if time.monotonic() > deadline:
                raise TimeoutError(f"{name} was not there within {timeout:g} s")
            time.sleep(0.01)
        return (self.folder / name).read_text()

    @property
    def number(self) -> int:
        """One that other runs hardly have, 0 to 199."""
        return int.from_bytes(os.fsencode(self.folder.name)[-4:], "little") % 200


def missing(name: str) -> str | None:
    """Why a transport cannot be measured here, or None."""
    needs = TRANSPORTS[name].needs
    if needs is None or importlib.util.find_spec(needs) is not None:
        return None
    return f"{needs} is not installed (dependency group bench)"


def adapter(name: str) -> _Adapter:
    """The module of a transport."""
    return cast("_Adapter", importlib.import_module(f"{__name__}.{TRANSPORTS[name].module}"))
