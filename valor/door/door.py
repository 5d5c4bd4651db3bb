"""TLS and tokens in front of a server that listens on the loopback interface and knows neither.

Each connection brings one request, whose head is looked at, and is then passed on byte by byte, so that WebSockets go
through as they are. The server inside is told that it is called by its own name, and ends after each answer.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import threading
from collections.abc import Mapping
from http import HTTPStatus

from valor.common.errors import ConfigurationError
from valor.common.viewing import LOOPBACK, bracketed
from valor.door.admission import LOGIN, Admission, Request, answer, form, own_origin

PATIENCE = 10.0  # with a hand-shake, a head, a form [s]
HEAD, FORM = 32 << 10, 1 << 10  # of a request, at most [B]
MOST = 200  # connections at once
SLOW = 1.0  # that a wrong token waits for its answer [s]
_TLS = b"\x16"  # with which a hand-shake begins
_AT_ONCE = 1 << 16  # bytes that are passed on
_OWN = ("host", "origin", "cookie", "connection", "keep-alive", "proxy-connection")  # of the way up to the door

_log = logging.getLogger("door")


class Door:
    """Listens on an address; in a thread of its own."""

    def __init__(
        self, at: tuple[str, int], context: ssl.SSLContext, admission: Admission, inside: int,
        elsewhere: Mapping[str, int] | None = None,
    ) -> None:  # fmt: skip
        """Listen.

        Args:
            at: address and port.
            context: with the certificate.
            admission: who is let in.
            inside: port of the server on the loopback interface.
            elsewhere: paths that are another door's: of the same host, by its port.

        Raises:
            ConfigurationError: the address is not ours, or the port another's.
        """
        self._at, self._context, self._admission, self._inside = at, context, admission, inside
        self._elsewhere = dict(elsewhere or {})
        host, port = at
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._listening = socket.create_server(at, family=family)
        except OSError as error:
            raise ConfigurationError(f"port {port} of {host}: {error.strerror or error}") from None
        self._listening.setblocking(False)
        self._tasks: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="door", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """On which it listens."""
        return int(self._listening.getsockname()[1])

    def close(self) -> None:
        """End all connections."""
        self._loop.call_soon_threadsafe(self._accepting.cancel)
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._accepting = self._loop.create_task(self._accept())
        with contextlib.suppress(asyncio.CancelledError):
            self._loop.run_until_complete(self._accepting)
        for task in self._tasks:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*self._tasks, return_exceptions=True))
        self._loop.close()
        self._listening.close()

    async def _accept(self) -> None:
        while True:
            try:
                client, _ = await self._loop.sock_accept(self._listening)
            except OSError as error:  # it was gone before, or there are no more descriptors
                _log.warning("a connection was not taken: %s", error)
                await asyncio.sleep(SLOW)
                continue
            if len(self._tasks) >= MOST:
                client.close()
                continue
            client.setblocking(False)
            task = self._loop.create_task(self._serve(client))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _serve(self, client: socket.socket) -> None:
        """One connection, from its first byte on."""
        try:
            async with asyncio.timeout(PATIENCE):
                first = await self._first_byte(client)
            if first != _TLS:
                await self._refuse_plain(client)
                return
            reader = asyncio.StreamReader(limit=HEAD)
            protocol = asyncio.StreamReaderProtocol(reader)
            transport, _ = await self._loop.connect_accepted_socket(
                lambda: protocol, client, ssl=self._context, ssl_handshake_timeout=PATIENCE
            )
        except (OSError, TimeoutError):  # ssl.SSLError, too: a browser that does not know the certificate goes
            client.close()
            return
        writer = asyncio.StreamWriter(transport, protocol, reader, self._loop)
        try:
            await self._admit(reader, writer)
        except (OSError, TimeoutError, EOFError, ValueError, asyncio.LimitOverrunError):
            pass  # it said nothing that could be answered, or is gone
        finally:
            transport.abort()

    async def _first_byte(self, client: socket.socket) -> bytes:
        """It stays where it is, for whoever reads next."""
        readable = asyncio.Event()
        self._loop.add_reader(client, readable.set)
        try:
            await readable.wait()
        finally:
            self._loop.remove_reader(client)
        return client.recv(1, socket.MSG_PEEK)

    async def _refuse_plain(self, client: socket.socket) -> None:
        word = f"This page is served over TLS alone: https://{bracketed(self._at[0])}:{self.port}/\n"
        with contextlib.closing(client), contextlib.suppress(OSError):
            client.recv(HEAD)  # what was read is no reason for a reset
            await self._loop.sock_sendall(client, answer(HTTPStatus.UPGRADE_REQUIRED, word))
            client.shutdown(socket.SHUT_WR)

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async with asyncio.timeout(PATIENCE):
            request = Request.of(await reader.readuntil(b"\r\n\r\n"))
            said = await self._answer(request, reader)
        if said is not None:
            writer.write(said)
            await writer.drain()
            writer.close()
            await writer.wait_closed()
            return
        inside, onward = await asyncio.open_connection(LOOPBACK, self._inside)
        try:
            onward.write(self._head(request))
            ways = [asyncio.ensure_future(_pass(*way)) for way in ((reader, onward), (inside, writer))]
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            if not ways[1].done() and not request.upgrades:  # the request has come whole; its answer is on its way
                await asyncio.wait(ways[1:], timeout=PATIENCE)
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            await writer.drain()
            writer.close()
            await writer.wait_closed()
        finally:
            onward.transport.abort()

    async def _answer(self, request: Request, reader: asyncio.StreamReader) -> bytes | None:
        """Of the door itself; None: the request is passed on."""
        if not own_origin(request):
            return answer(HTTPStatus.FORBIDDEN, "not from a page of another origin")
        path = request.target.partition("?")[0]
        if request.method == "POST" and path == LOGIN:
            if not 0 <= request.length <= FORM:
                return answer(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"expected a form of at most {FORM} bytes")
            if self._admission.shown(await reader.readexactly(request.length)):
                return self._admission.welcome()
            await asyncio.sleep(SLOW)
            _log.warning("somebody showed a wrong token")
            return form(wrong=True)
        if not self._admission.knows(request):
            return form()
        if path in self._elsewhere:
            name = request.host.rpartition(":")[0] or request.host
            there = f"https://{name}:{self._elsewhere[path]}/"
            return answer(HTTPStatus.TEMPORARY_REDIRECT, "", headers=(("Location", there),))
        return None

    def _head(self, request: Request) -> bytes:
        """As the server inside is to see it."""
        own = f"{LOOPBACK}:{self._inside}"
        lines = [f"{request.method} {request.target} HTTP/1.1", f"Host: {own}"]
        if request.headers.get("Origin") is not None:
            lines.append(f"Origin: http://{own}")
        lines.append(f"Connection: {'Upgrade' if request.upgrades else 'close'}")
        lines += [f"{name}: {value}" for name, value in request.headers.items() if name.lower() not in _OWN]
        return "\r\n".join(lines).encode("latin-1") + b"\r\n\r\n"


async def _pass(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    """All that comes, until no more does."""
    while data := await source.read(_AT_ONCE):
        sink.write(data)
        await sink.drain()
