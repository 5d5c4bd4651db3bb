"""A viewer of the operator's page that draws nothing: it speaks viser's WebSocket protocol and notes what comes.

What a browser costs this computer is so kept apart from what the page costs the robot. The station cannot tell it from
a browser: it says where its camera is, and answers each question for the browser's storage.
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass, field
from typing import Any

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from websockets.sync.client import connect

from valor.common.arrays import FloatArray

_HEAD = struct.Struct("<QQ")  # of a message: length of its words, and as they are compressed
_CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (2.0, 2.2, 1.6), "fov": 1.3, "near": 0.01,
    "far": 1000.0, "image_height": 720, "image_width": 1280, "look_at": (0.0, 0.0, 0.7),
    "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip


@dataclass
class Watched:
    """What came.

    Attributes:
        seconds: for so long.
        size: of all [B].
        scenes: messages with something of the scene.
        shown: when a place of the robot came, monotonic [s], and that place, (3,) in odom [m].
    """

    seconds: float = 0.0
    size: int = 0
    scenes: int = 0
    shown: list[tuple[float, FloatArray]] = field(default_factory=list)


def ready() -> None:
    """Called first: what must be imported has been."""


def watch(port: int, root: str, settle: float, seconds: float) -> Watched:
    """Look for a while, from ``settle`` after the page is there [s].

    Args:
        port: of the page.
        root: the robot's frame in the scene.
        settle: until it counts [s].
        seconds: for so long it counts.

    Raises:
        OSError: nobody serves the page there.
    """
    watched = Watched(seconds)
    protocol: Any = [f"viser-v{viser.__version__}"]
    with connect(f"ws://127.0.0.1:{port}", subprotocols=protocol, max_size=None, compression=None) as socket:
        socket.send(msgspec.msgpack.encode(_CAMERA))
        begin = time.monotonic() + settle
        while (now := time.monotonic()) < begin + seconds:
            try:
                data = socket.recv(begin + seconds - now)
            except TimeoutError:
                break
            assert isinstance(data, bytes)
            came = time.monotonic()
            messages = _messages(data)
            for message in messages:
                if message["type"] == "LocalStorageGetItemRequestMessage":
                    socket.send(msgspec.msgpack.encode(_answer(message["request_uuid"])))
            if came >= begin:
                watched.size += len(data)
                watched.scenes += any(message["type"].startswith("Set") for message in messages)
                watched.shown += [(came, np.array(each["position"])) for each in messages if _places(each, root)]
    return watched


def _places(message: dict[str, Any], root: str) -> bool:
    return bool(message["type"] == "SetPositionMessage" and message["name"] == root)


def _answer(question: str) -> dict[str, Any]:
    return {"type": "LocalStorageGetItemResponseMessage", "value": None, "error": None, "request_uuid": question}


def _messages(data: bytes) -> list[dict[str, Any]]:
    """In one of the WebSocket's; their arrays are left where they are."""
    length, compressed = _HEAD.unpack_from(data)
    words = zstandard.decompress(data[_HEAD.size : _HEAD.size + compressed], max_output_size=length)
    found: list[dict[str, Any]] = msgspec.msgpack.decode(words)["messages"]
    return found
