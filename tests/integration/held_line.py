"""A line between a client and a server on this computer that can be held up: what is said then comes later.

The server sees its own port in `Host` and `Origin`.
"""

import contextlib
import socket
import threading
from typing import Self


class HeldLine:
    """Forwards TCP, both ways, between who connects to its ``port`` and a server's port."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._flows = threading.Event()
        self._flows.set()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._sockets: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._flows.set()
        for each in (self._server, *self._sockets):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def hold(self) -> None:
        """Nothing gets through, and nothing is lost."""
        self._flows.clear()

    def release(self) -> None:
        """All that waited gets through, in its order."""
        self._flows.set()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._server.accept()
                try:
                    server = socket.create_connection(("127.0.0.1", self._target))
                except OSError:
                    client.close()
                    continue
                self._sockets += [client, server]
                own, other = f"127.0.0.1:{self.port}".encode(), f"127.0.0.1:{self._target}".encode()
                for source, sink, names in ((client, server, (own, other)), (server, client, (b"", b""))):
                    threading.Thread(target=self._forward, args=(source, sink, *names), daemon=True).start()

    def _forward(self, source: socket.socket, sink: socket.socket, own: bytes, other: bytes) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                data = data.replace(own, other) if own else data
                self._flows.wait()
                sink.sendall(data)
        for each in (source, sink):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
