"""A line between a browser and a page on this computer that can be held up: what is said then comes later.

Page and view have a port each, one after the other; each side sees its own ports in names and origins.
"""

import contextlib
import socket
import threading
from typing import Self


class HeldLine:
    """Forwards TCP, both ways: from ``port`` to a page's port, and from the next one to the next one."""

    def __init__(self, target: int) -> None:
        self._flows = threading.Event()
        self._flows.set()
        servers = _pair()
        self.port: int = servers[0].getsockname()[1]
        self._sockets: list[socket.socket] = [*servers]
        own, other = ([f":{port + i}".encode() for i in (0, 1)] for port in (self.port, target))
        self._names = list(zip(own, other, strict=True))
        for i, server in enumerate(servers):
            threading.Thread(target=self._accept, args=(server, target + i), daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._flows.set()
        for each in self._sockets:
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def hold(self) -> None:
        """Nothing gets through, and nothing is lost."""
        self._flows.clear()

    def release(self) -> None:
        """All that waited gets through, in its order."""
        self._flows.set()

    def _accept(self, listening: socket.socket, target: int) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = listening.accept()
                try:
                    server = socket.create_connection(("127.0.0.1", target))
                except OSError:
                    client.close()
                    continue
                self._sockets += [client, server]
                for source, sink, begins in ((client, server, b""), (server, client, b"HTTP/1")):
                    threading.Thread(target=self._forward, args=(source, sink, begins), daemon=True).start()

    def _forward(self, source: socket.socket, sink: socket.socket, begins: bytes) -> None:
        """``begins``: of a response, in which only headers name ports; empty for requests."""
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                head, end, body = data.partition(b"\r\n\r\n") if data.startswith(begins) else (b"", b"", data)
                for own, other in self._names:
                    head = head.replace(other, own) if begins else head.replace(own, other)
                data = head + end + body
                self._flows.wait()
                sink.sendall(data)
        for each in (source, sink):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)


def _pair() -> tuple[socket.socket, socket.socket]:
    """Servers on two ports, one after the other."""
    while True:
        first = socket.create_server(("127.0.0.1", 0))
        try:
            return first, socket.create_server(("127.0.0.1", first.getsockname()[1] + 1))
        except OSError:
            first.close()
