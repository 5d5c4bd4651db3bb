"""Device side of a serial line: a pseudo-terminal that can be unplugged."""

import contextlib
import os
import select
import tty
from pathlib import Path

_READ = 4096


class SerialPort:
    """Pseudo-terminal. A symbolic link names the driver's end, as /dev/serial/by-id does for a USB adapter."""

    def __init__(self, link: Path) -> None:
        """``link``: path that the driver opens."""
        self.link = link
        self._device: int | None = None
        self._driver_end: int | None = None
        # Readable when the port is readable; its descriptor stays the same across plug and unplug.
        self._readable = select.epoll()
        self.plug()

    def fileno(self) -> int:
        return self._readable.fileno()

    @property
    def plugged(self) -> bool:
        return self._device is not None

    def plug(self) -> None:
        """Create the port and its link, unless they exist."""
        if self._device is not None:
            return
        # The driver's end also stays open here, so that a driver that closes it does not hang up the line.
        self._device, self._driver_end = os.openpty()
        tty.setraw(self._driver_end)
        os.set_blocking(self._device, False)
        self._readable.register(self._device, select.EPOLLIN)
        self.link.parent.mkdir(parents=True, exist_ok=True)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self._driver_end))

    def unplug(self) -> None:
        """Remove the port; a driver that has it open sees a hang-up."""
        if self._device is None or self._driver_end is None:
            return
        self.link.unlink(missing_ok=True)
        self._readable.unregister(self._device)
        os.close(self._device)
        os.close(self._driver_end)
        self._device = self._driver_end = None

    def read(self) -> bytes:
        """Received bytes of the driver, without waiting."""
        # Reading an empty terminal would make the kernel wait for pending transfers.
        if self._device is None or not self._readable.poll(0):
            return b""
        try:
            return os.read(self._device, _READ)
        except (BlockingIOError, OSError):
            return b""

    def write(self, data: bytes) -> None:
        """Send to the driver; bytes that do not fit into the buffer are lost."""
        if self._device is None or self._driver_end is None:
            return
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self._device, data)
            # A low-priority kernel worker transfers the bytes; polling the driver's end waits for it, so that sensor
            # data is not delayed on a busy computer.
            select.select((self._driver_end,), (), (), 0.0)

    def close(self) -> None:
        self.unplug()
        self._readable.close()
