"""A viewer that speaks viser's protocol by itself: whatever it likes, at whatever rate."""

from __future__ import annotations

import contextlib
import threading
from typing import Any, Self

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

CAMERA = {
    "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (2.0, 2.0, 1.6), "fov": 1.0, "near": 0.01, "far": 100.0,
    "image_height": 720, "image_width": 1280, "look_at": (0.0, 0.0, 0.7), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip


class RawViewer:
    """``controls``: made for it by the server, by id; ``labels``: ids by label; ``texts``: notifications."""

    def __init__(self, port: int, origin: str | None = None, *, speaks: bool = True) -> None:
        self.socket = connect(
            f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], max_size=None,
            origin=None if origin is None else Origin(origin), close_timeout=1.0, ping_interval=None,
        )  # fmt: skip
        self.controls: dict[str, dict[str, Any]] = {}
        self.texts = ""
        self.storage: dict[str, str] = {}
        self.ended = threading.Event()
        self._thread = threading.Thread(target=self._receive, daemon=True)
        if speaks:
            self._thread.start()
            self.say("ViewerCameraMessage", **CAMERA)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        if not self._thread.is_alive():  # nobody would receive the other end's farewell
            self.socket.close_socket()
        self.socket.close()

    @property
    def labels(self) -> dict[str, str]:
        return {control["props"].get("label", ""): uuid for uuid, control in list(self.controls.items())}

    def approval(self) -> dict[str, Any]:
        """Properties of the button that approves a preview."""
        props: dict[str, Any] = self.controls[self.labels["Approve and execute"]]["props"]
        return props

    def say(self, kind: str, **fields: Any) -> None:
        self.send(msgspec.msgpack.encode({"type": kind} | fields))

    def send(self, data: bytes) -> None:
        self.socket.send(data)

    def set(self, label: str, value: Any) -> None:
        self.say("GuiUpdateMessage", uuid=self.labels[label], updates={"value": value})

    def _receive(self) -> None:
        with contextlib.suppress(ConnectionClosed, OSError):
            while True:
                data = self.socket.recv()
                assert isinstance(data, bytes)
                packed = int.from_bytes(data[8:16], "little")
                inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed])
                for message in msgspec.msgpack.decode(inner)["messages"]:
                    self._take(message)
        self.ended.set()

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind.startswith("Gui") and "props" in message:
            self.controls[message["uuid"]] = message
        elif kind == "GuiRemoveMessage":
            self.controls.pop(message["uuid"], None)
        elif kind == "GuiUpdateMessage" and message["uuid"] in self.controls:
            self.controls[message["uuid"]]["props"] |= message["updates"]
        elif kind == "LocalStorageSetItemMessage":
            self.storage[message["key"]] = message["value"]
        elif kind == "LocalStorageGetItemRequestMessage":
            answer = {"value": self.storage.get(message["key"]), "error": None, "request_uuid": message["request_uuid"]}
            self.say("LocalStorageGetItemResponseMessage", **answer)
        if kind in ("NotificationShowMessage", "RunJavascriptMessage"):
            self.texts += str(message)
