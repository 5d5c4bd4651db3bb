"""The device's end of a serial line: a pseudo-terminal that can be unplugged."""

from __future__ import annotations

import contextlib
import os
import select
import tty
from pathlib import Path

from valor.device_emulators.emulator import FaultSwitches
from valor.device_emulators.faulty_line import FaultyLine

_READ = 4096


class SerialPort:
    """A pseudo-terminal whose other end is found by a symbolic link, as a USB adapter is under /dev/serial/by-id.

    Attributes:
        link: the path that a driver opens.
        lost: bytes that nobody fetched in time.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.lost = 0
        self._device: int | None = None
        self._driver_end: int | None = None
        # Readable when the port is; it stays the same while ports come and go.
        self._readable = select.epoll()
        self.plug()

    def fileno(self) -> int:
        """A descriptor that is readable when something has come, plugged or not."""
        return self._readable.fileno()

    @property
    def plugged(self) -> bool:
        """Whether a driver can find the port."""
        return self._device is not None

    def plug(self) -> None:
        """Make the port and its link, unless they are there."""
        if self._device is not None:
            return
        # The driver's end stays open here too: a driver that closes it does not hang the line up.
        self._device, self._driver_end = os.openpty()
        tty.setraw(self._driver_end)
        os.set_blocking(self._device, False)
        self._readable.register(self._device, select.EPOLLIN)
        self.link.parent.mkdir(parents=True, exist_ok=True)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self._driver_end))

    def unplug(self) -> None:
        """Take the port away; whoever has it open sees the line hung up."""
        if self._device is None or self._driver_end is None:
            return
        self.link.unlink(missing_ok=True)
        self._readable.unregister(self._device)
        os.close(self._device)
        os.close(self._driver_end)
        self._device = self._driver_end = None

    def read(self) -> bytes:
        """What has come from the driver; does not wait."""
        # Nothing is asked of the terminal that has nothing: the kernel would look after what is under way, and wait.
        if self._device is None or not self._readable.poll(0):
            return b""
        try:
            return os.read(self._device, _READ)
        except (BlockingIOError, OSError):
            return b""

    def write(self, data: bytes) -> None:
        """Send to the driver; what does not fit into the line's buffer is lost, as on a wire."""
        if self._device is None or self._driver_end is None:
            return
        sent = 0
        with contextlib.suppress(BlockingIOError, OSError):
            sent = os.write(self._device, data)
            # A worker of the kernel's hands the bytes over, at low priority, and looking at the other end waits for it:
            # a busy computer is to slow the robot down, not what its sensors say.
            select.select((self._driver_end,), (), (), 0.0)
        self.lost += len(data) - sent

    def close(self) -> None:
        """Give the port back."""
        self.unplug()
        self._readable.close()


def line(port: SerialPort, faults: FaultSwitches) -> FaultyLine[bytes]:
    """A line on which packets of a device's units go to its driver."""
    return FaultyLine(port.write, faults, lambda packet: packet, lambda _, data: data)
