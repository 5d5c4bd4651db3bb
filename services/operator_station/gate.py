"""Entrance of viser's server: which requests, viewers and messages it receives.

viser checks neither Host nor Origin, closes no connection, and sets any attribute of a control that a message names.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import msgspec
import websockets.asyncio.server
from msgspec import Meta, Struct
from viser import ViserServer
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from valor.common.errors import ConfigurationError
from valor.common.viewing import LOOPBACK, own_names

VIEWERS = 16  # at most; a further one ends another
RATE, BURST = 200.0, 600.0  # messages of one viewer [1/s, 1]
BAD = 30.0  # cost of a message that no browser sends [messages]
LARGEST = 65536  # message [B]
_SCRIPT = (Path(__file__).parent / "keys.js").read_text()
_log = logging.getLogger("operator_station")

_Fields = list[Any]  # name, type and default
Number = Annotated[float, Meta(ge=-1e9, le=1e9)]  # also rejects NaN
Size = Annotated[int, Meta(ge=0, le=100_000)]
Text = Annotated[str, Meta(max_length=2000)]
Vector = tuple[Number, Number, Number]
Quaternion = tuple[Number, Number, Number, Number]


class _Updates(Struct):
    """``value`` alone: viser would set any other attribute, too."""

    value: bool | Number | Text | Annotated[list[Number], Meta(max_length=4)]


_NODE: _Fields = [("name", Text), ("owner", Text, "")]
_MESSAGES: dict[str, _Fields] = {
    "ViewerCameraMessage": [
        ("wxyz", Quaternion), ("position", Vector), ("fov", Number), ("near", Number), ("far", Number),
        ("image_height", Size), ("image_width", Size), ("look_at", Vector), ("up_direction", Vector),
    ],
    "GuiUpdateMessage": [("uuid", Text), ("updates", _Updates)],
    "GuiButtonHoldMessage": [("uuid", Text), ("frequency", Number)],
    "ScenePointerMessage": [
        ("event_type", Literal["click"]), ("ray_origin", Vector), ("ray_direction", Vector),
        ("screen_pos", tuple[tuple[Number, Number]]), ("modifier", None),
    ],
    "TransformControlsUpdateMessage": [("name", Text), ("wxyz", Quaternion), ("position", Vector), ("owner", Text, "")],
    "TransformControlsDragStartMessage": _NODE,
    "TransformControlsDragEndMessage": _NODE,
    "LocalStorageGetItemResponseMessage": [("value", Text | None), ("error", Text | None), ("request_uuid", Text)],
}  # fmt: skip
"""Messages of a browser, as in ``viser._messages``; all others, and other fields, are dropped."""
_DECODER: msgspec.msgpack.Decoder[Struct] = msgspec.msgpack.Decoder(
    Union[tuple(msgspec.defstruct(name, fields, tag_field="type") for name, fields in _MESSAGES.items())]  # noqa: UP007
)


_push_of_viser = AsyncMessageBuffer.push


def _push(buffer: AsyncMessageBuffer, message: Any) -> None:
    """``push`` of viser's buffers, from any thread.

    viser's own sets an ``asyncio.Event`` last, which raises if the event loop changes its waiters meanwhile: the
    message is in the buffer, but not all of them are awake.
    """

    def wake() -> None:
        buffer.message_event.clear()
        buffer.message_event.set()

    try:
        _push_of_viser(buffer, message)
    except RuntimeError:
        buffer.event_loop.call_soon_threadsafe(wake)


AsyncMessageBuffer.push = _push  # type: ignore[assignment,method-assign]


class Viewer(ServerConnection):
    """Connection of one viewer; receives admissible messages only."""

    spoke = False  # whether it has sent an admissible message
    _left, _since = BURST, 0.0  # messages that it may send, at a monotonic time [s]

    async def recv(self, decode: bool | None = None) -> Any:
        """Receive the next admissible message, encoded again; ends the connection of a viewer that sends too many."""
        while True:
            data = await super().recv(decode)
            now = time.monotonic()
            self._left = min(BURST, self._left + RATE * (now - self._since)) - 1.0
            self._since = now
            try:
                message = _DECODER.decode(data if isinstance(data, bytes) else b"")
            except (msgspec.MsgspecError, ValueError, RecursionError):
                self._left -= BAD
            else:
                if self._left > 0.0:
                    self.spoke = True
                    return msgspec.msgpack.encode(message)
            if self._left <= 0.0:
                _log.warning("a viewer is disconnected: it sent too many messages, or wrong ones")
                self.transport.abort()


class Gate:
    """Entrance of the server on a port."""

    def __init__(self, port: int, operator: Callable[[], int | None]) -> None:
        """``operator`` returns the client that operates."""
        self._port, self._operator = port, operator
        self._viewers: list[Viewer] = []
        self._names = own_names(port)
        self._policy = "frame-ancestors " + " ".join(
            f"http://{name}" for name in own_names(port - 1) if "[" not in name
        )

    def open(self) -> ViserServer:
        """Open the server; raises ``ConfigurationError`` if another process has the port."""
        websockets.asyncio.server.serve = self._serve  # type: ignore[assignment,misc]  # viser offers no hook
        try:
            self._server = server = ViserServer(host=LOOPBACK, port=self._port, verbose=False)
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]
        if server.get_port() != self._port:
            server.stop()
            raise ConfigurationError(f"port {self._port} of {LOOPBACK}: another process has it")
        return server

    def _serve(self, handler: Any, host: str, port: int, *, process_request: Any, **options: Any) -> Any:
        """``websockets.asyncio.server.serve``, as viser calls it."""

        async def handle(viewer: Any) -> None:
            self._viewers.append(viewer)
            if len(self._viewers) > VIEWERS:
                self._end_one(viewer)
            try:
                await handler(viewer)
            finally:
                if viewer in self._viewers:
                    self._viewers.remove(viewer)

        def request(viewer: ServerConnection, request: Request) -> Response | None:
            return self._rejection(viewer, request) or self._page(process_request(viewer, request), request)

        options |= {"max_size": LARGEST, "create_connection": Viewer}
        return serve(handle, host, port, process_request=request, **options)

    def _end_one(self, new: Viewer) -> None:
        """End a viewer that does not operate: one that has sent nothing, else the oldest."""
        operates = self._server._websock_server._live_connections.get(self._operator())  # type: ignore[arg-type]
        others = [viewer for viewer in self._viewers if viewer not in (operates, new)]
        ended = next((viewer for viewer in others if not viewer.spoke), others[0])
        self._viewers.remove(ended)
        ended.transport.abort()

    def _rejection(self, viewer: ServerConnection, request: Request) -> Response | None:
        """Reject requests of other names and origins, and those with options for viser's page."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or hosts[0] not in self._names or origins not in ([], [f"http://{hosts[0]}"]):
            return viewer.respond(HTTPStatus.FORBIDDEN, "not from a page of another origin\n")
        if "?" in request.path:  # "?websocket=" makes the page obey another server
            return viewer.respond(HTTPStatus.FORBIDDEN, f"{request.path}: expected without ?\n")
        request.headers.pop("Accept-Encoding", None)  # the page is changed
        return None

    def _page(self, response: Response | None, request: Request) -> Response | None:
        """Add the script to the page, and forbid that other pages frame it."""
        if response is None:
            return None
        if request.path == "/":
            response.body = response.body.replace(b"<head>", f"<head><script>{_SCRIPT}</script>".encode(), 1)
            del response.headers["Content-Length"]
            response.headers["Content-Length"] = str(len(response.body))
        response.headers["Content-Security-Policy"] = self._policy
        return response
