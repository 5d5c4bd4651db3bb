"""Device side of a serial line: a socket that can be unplugged."""

import contextlib
import select
import socket
from pathlib import Path

_READ = 4096


class SerialPort:
    """Line for one driver at a time. A pseudo-terminal's bytes would wait for a kernel worker of low priority."""

    def __init__(self, path: Path) -> None:
        """``path``: that the driver opens."""
        self.path = path
        self._line: socket.socket | None = None  # that drivers open
        self._driver: socket.socket | None = None
        # Readable when the port is readable; its descriptor stays the same across plug and unplug.
        self._readable = select.epoll()
        self.plug()

    def fileno(self) -> int:
        return self._readable.fileno()

    @property
    def plugged(self) -> bool:
        return self._line is not None

    def plug(self) -> None:
        """Create the port, unless it exists."""
        if self._line is not None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.unlink(missing_ok=True)
        self._line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        self._line.bind(str(self.path))
        self._line.listen(1)
        self._readable.register(self._line, select.EPOLLIN)

    def unplug(self) -> None:
        """Remove the port; a driver that has it open sees a hang-up."""
        for end in (self._line, self._driver):
            if end is not None:
                end.close()
        self._line = self._driver = None
        self.path.unlink(missing_ok=True)

    def read(self) -> bytes:
        """Received bytes of the driver, without waiting."""
        if self._line is None or not self._readable.poll(0):
            return b""
        with contextlib.suppress(OSError):  # the driver is gone, or has sent nothing yet
            if self._driver is None:
                self._driver, _ = self._line.accept()
                self._driver.setblocking(False)
                self._readable.unregister(self._line)
                self._readable.register(self._driver, select.EPOLLIN)
            if data := self._driver.recv(_READ):
                return data
            self._driver.close()
            self._driver = None
            self._readable.register(self._line, select.EPOLLIN)
        return b""

    def write(self, data: bytes) -> None:
        """Send to the driver; bytes that do not fit into the buffer are lost."""
        if self._driver is not None:
            with contextlib.suppress(OSError):
                self._driver.send(data)

    def close(self) -> None:
        self.unplug()
        self._readable.close()
